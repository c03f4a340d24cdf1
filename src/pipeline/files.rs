//! Durable writes: fsync before rename, and nothing is rewritten whose bytes are the same.

use crate::error::{Context, Result};
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::Path;

/// How the name of a file begins that is not whole yet.
pub(super) const HALF_WRITTEN: &str = ".writing-";

/// Writes `bytes` to `path` by a temporary sibling and rename, unless the file already holds them. Says whether it wrote.
///
/// # Errors
/// When the folder cannot be written.
pub fn write_if_changed(path: &Path, bytes: &[u8]) -> Result<bool> {
    let same_size = fs::metadata(path).is_ok_and(|m| m.is_file() && m.len() == bytes.len() as u64);
    if same_size && fs::read(path).is_ok_and(|old| old == bytes) {
        return Ok(false);
    }
    let write = || -> std::io::Result<()> {
        let folder = path.parent().unwrap_or(Path::new("."));
        make_dirs(folder)?;
        let mut file = tempfile::Builder::new().prefix(HALF_WRITTEN).permissions(readable()).tempfile_in(folder)?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        file.persist(path)?;
        sync_dir(folder)
    };
    write().context(|| format!("cannot write `{}`", path.display()))?;
    Ok(true)
}

fn readable() -> fs::Permissions {
    use std::os::unix::fs::PermissionsExt;
    fs::Permissions::from_mode(0o644)
}

/// Copies `from` to `to` unless the bytes are the same. Says whether it wrote.
pub(super) fn copy_if_changed(from: &Path, to: &Path) -> Result<bool> {
    let bytes = fs::read(from).context(|| format!("cannot read `{}`", from.display()))?;
    write_if_changed(to, &bytes)
}

/// Fsyncs every file and folder under `dir`, `dir` included.
pub(super) fn sync_tree(dir: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_tree(&entry.path())?;
        } else {
            File::open(entry.path())?.sync_all()?;
        }
    }
    sync_dir(dir)
}

/// Makes a folder and those that it is in, the name of each on the disk when this returns.
pub(super) fn make_dirs(dir: &Path) -> std::io::Result<()> {
    if dir.as_os_str().is_empty() || dir.is_dir() {
        return Ok(());
    }
    let parent = dir.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    make_dirs(parent)?;
    match fs::create_dir(dir) {
        // Somebody else was at it.
        Err(error) if error.kind() == ErrorKind::AlreadyExists && dir.is_dir() => {}
        Err(error) if error.kind() == ErrorKind::AlreadyExists => return Err(ErrorKind::NotADirectory.into()),
        made => made?,
    }
    sync_dir(parent)
}

/// Fsyncs one folder, so that names made or renamed in it survive.
pub(super) fn sync_dir(dir: &Path) -> std::io::Result<()> {
    File::open(dir)?.sync_all()
}

/// Relative names of all files under `dir`, sorted, with `/` between folders.
pub(super) fn list(dir: &Path) -> std::io::Result<Vec<String>> {
    fn walk(dir: &Path, prefix: &str, names: &mut Vec<String>) -> std::io::Result<()> {
        for entry in fs::read_dir(dir)? {
            let entry = entry?;
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.file_type()?.is_dir() {
                walk(&entry.path(), &format!("{name}/"), names)?;
            } else {
                names.push(name);
            }
        }
        Ok(())
    }
    let mut names = Vec::new();
    walk(dir, "", &mut names)?;
    names.sort();
    Ok(names)
}

/// Removes a file if there is one.
pub(super) fn remove_file(path: &Path) -> Result<()> {
    if !path.is_file() {
        return Ok(());
    }
    match fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(e).context(|| format!("cannot remove `{}`", path.display()))
        }
        _ => Ok(()),
    }
}

/// Removes a folder and all in it; absent is fine.
pub(super) fn remove_dir(dir: &Path) -> Result<()> {
    match fs::remove_dir_all(dir) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(e).context(|| format!("cannot remove `{}`", dir.display()))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_bytes_are_not_written_twice() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("a/b.txt");
        assert!(write_if_changed(&path, b"one").expect("writable"));
        assert!(!write_if_changed(&path, b"one").expect("writable"));
        assert!(write_if_changed(&path, b"two").expect("writable"));
        assert_eq!(list(dir.path()).expect("readable"), ["a/b.txt"]);
    }
}
