//! A Python with packages, to read our files with independent software.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A Python that can run `imports`, with `packages` installed into a folder `name` of the target folder when absent; nothing,
/// and a word about it, where there is no Python at all.
pub fn python(name: &str, imports: &str, packages: &[&str]) -> Option<PathBuf> {
    let Ok(version) = Command::new("python3").arg("--version").output() else {
        println!("skipped: there is no python3 to read the file independently");
        return None;
    };
    assert!(version.status.success());
    let venv = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let python = venv.join("bin/python");
    let has_packages =
        |python: &Path| Command::new(python).args(["-c", imports]).output().is_ok_and(|output| output.status.success());
    if has_packages(Path::new("python3")) {
        return Some("python3".into());
    }
    if !has_packages(&python) {
        let run = |command: &mut Command, what: &str| {
            let out = command.output().unwrap_or_else(|e| panic!("{what}: {e}"));
            assert!(out.status.success(), "{what}: {}", String::from_utf8_lossy(&out.stderr));
        };
        run(Command::new("python3").args(["-m", "venv"]).arg(&venv), "python3 -m venv");
        let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
        run(Command::new(&python).args(install).args(packages), "pip install");
    }
    Some(python)
}
