//! What a loss of power leaves: the calls of a run are recorded, and whatever is published must have been on the disk before, and what refers
//! to it after. Writes that are not synced, and names in folders that are not, are what a loss of power takes.

#[path = "support/small_site.rs"]
mod small_site;

use small_site::SMALL;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What is not on the disk yet.
#[derive(Default)]
struct Unsynced {
    /// Files that were written to.
    files: BTreeSet<PathBuf>,
    /// Names that were made or moved in their folder.
    names: BTreeSet<PathBuf>,
}

impl Unsynced {
    /// Follows one call; what was not on the disk though it should have been.
    fn follow(&mut self, call: &str, cache: &Path) -> Vec<String> {
        let name = call.split('(').next().unwrap_or_default();
        // Of a descriptor `5</path>`, and what is quoted.
        let of_descriptor = || Some(PathBuf::from(call.split_once('<')?.1.split_once('>')?.0));
        let quoted: Vec<PathBuf> = call.split('"').skip(1).step_by(2).map(PathBuf::from).collect();
        match name {
            "write" | "writev" | "pwrite64" => self.files.extend(of_descriptor()),
            "openat" if call.contains("O_CREAT") => self.names.extend(quoted),
            "mkdir" => self.names.extend(quoted),
            "fsync" | "fdatasync" => {
                let synced = of_descriptor().unwrap_or_default();
                self.files.remove(&synced);
                self.names.retain(|name| name.parent() != Some(&synced));
            }
            "rename" | "renameat" | "renameat2" => {
                if let [from, to] = quoted.as_slice() {
                    return self.rename(from, to, cache);
                }
            }
            _ => {}
        }
        Vec::new()
    }

    fn rename(&mut self, from: &Path, to: &Path, cache: &Path) -> Vec<String> {
        let is_moved = |path: &&PathBuf| path.starts_with(from);
        let mut lacking: Vec<PathBuf> = self.files.iter().filter(is_moved).cloned().collect();
        lacking.extend(self.names.iter().filter(is_moved).filter(|path| *path != from).cloned());
        // What a site has stored is said when it is.
        let is_entry = |path: &&PathBuf| path.starts_with(cache) && path.extension().is_none();
        if to.ends_with("last.toml") {
            lacking.extend(self.names.iter().filter(is_entry).filter(|path| !path.ends_with("lease")).cloned());
        }
        let moved = |path: &PathBuf| path.strip_prefix(from).map_or(path.clone(), |rest| to.join(rest));
        self.files = self.files.iter().map(moved).collect();
        self.names = self.names.iter().filter(|path| *path != from).map(moved).collect();
        self.names.insert(to.to_path_buf());
        lacking.into_iter().map(|path| format!("{} when {} is made", path.display(), to.display())).collect()
    }
}

#[test]
fn what_is_published_is_on_the_disk_before_and_what_refers_to_it_after() {
    let dir = tempfile::tempdir().expect("a folder");
    let place = dir.path().canonicalize().expect("a path");
    let (calls, runs) = (place.join("calls"), place.join("runs"));
    let mut command = Command::new("strace");
    command.args(["-f", "-y", "-s", "0", "-e"]);
    command.arg("trace=openat,write,pwrite64,writev,rename,renameat,renameat2,fsync,fdatasync,mkdir");
    command.arg("-o").arg(&calls).arg(env!("CARGO_BIN_EXE_flare-pipe"));
    command.args(["run", "configs/smoke.toml", "--until", "distill", "-q"]).args(SMALL).arg("--run-dir").arg(&runs);
    let done = command.current_dir(env!("CARGO_MANIFEST_DIR")).stdin(Stdio::null()).output();
    let calls = std::fs::read_to_string(&calls).unwrap_or_default();
    if calls.is_empty() {
        println!("skipped: calls cannot be recorded here (strace)");
        return;
    }
    assert!(done.is_ok_and(|output| output.status.success()));
    let (mut unsynced, mut lacking, mut renames) = (Unsynced::default(), Vec::new(), 0);
    for line in calls.lines() {
        // `1234 call(…) = 0`; what ends later begins here, and what begins there is no call.
        let Some((_, call)) = line.trim_start().split_once(' ') else { continue };
        let call = call.trim_start();
        renames += usize::from(call.starts_with("rename"));
        lacking.extend(unsynced.follow(call, &runs.join("cache")));
    }
    assert!(renames > 20, "{renames}");
    assert!(lacking.is_empty(), "not on the disk: {lacking:#?}");
}

#[test]
fn what_is_not_synced_is_noticed() {
    let mut unsynced = Unsynced::default();
    let cache = Path::new("/c");
    let mut follow = |call: &str| unsynced.follow(call, cache);
    assert!(
        follow("openat(AT_FDCWD</w>, \"/c/k/1.partial/a\", O_WRONLY|O_CREAT, 0666) = 5</c/k/1.partial/a>").is_empty()
    );
    assert!(follow("write(5</c/k/1.partial/a>, \"\"..., 5) = 5").is_empty());
    assert_eq!(follow("rename(\"/c/k/1.partial\", \"/c/k/1\") = 0").len(), 2);
    // The name of the entry is not in its folder yet.
    assert!(!follow("rename(\"/s/.writing\", \"/s/last.toml\") = 0").is_empty());
    follow("fsync(7</c/k>) = 0");
    assert!(!follow("rename(\"/s/.writing\", \"/s/last.toml\") = 0").iter().any(|text| text.starts_with("/c/k/1 ")));
}
