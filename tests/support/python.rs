//! A Python with packages, to read our files with independent software.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A Python that can run `imports`, with `packages` installed into a folder `name` of the target folder when absent; nothing,
/// and a word about it, where there is no Python at all. `PYTHON` names one that is not `python3`.
pub fn python(name: &str, imports: &str, packages: &[&str]) -> Option<PathBuf> {
    let own = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let Ok(version) = Command::new(&own).arg("--version").output() else {
        println!("skipped: there is no {own} to run independent software");
        return None;
    };
    assert!(version.status.success());
    let venv = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let python = venv.join("bin/python");
    let has_packages =
        |python: &Path| Command::new(python).args(["-c", imports]).output().is_ok_and(|output| output.status.success());
    if has_packages(Path::new(&own)) {
        return Some(own.into());
    }
    if !has_packages(&python) {
        let run = |command: &mut Command, what: &str| {
            let out = command.output().unwrap_or_else(|e| panic!("{what}: {e}"));
            assert!(out.status.success(), "{what}: {}", String::from_utf8_lossy(&out.stderr));
        };
        run(Command::new(&own).args(["-m", "venv"]).arg(&venv), "python -m venv");
        let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
        run(Command::new(&python).args(install).args(packages), "pip install");
    }
    Some(python)
}
