//! Files that appear whole or not at all: written beside, flushed to disk, renamed; and files to read that are files.

use crate::error::{Context, Result};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file under a temporary name beside its target; removed on drop unless [`Partial::publish`]ed.
#[derive(Debug)]
pub struct Partial {
    target: PathBuf,
    temporary: PathBuf,
    is_published: bool,
}

impl Partial {
    /// Creates the temporary file of `target`.
    ///
    /// # Errors
    /// When the folder does not exist or cannot be written.
    pub fn create(target: &Path) -> Result<(Self, File)> {
        let name = target.file_name().unwrap_or_default().to_string_lossy();
        let temporary = target.with_file_name(format!(".{name}.{}.partial", std::process::id()));
        let file = File::create(&temporary).context(|| format!("cannot create `{}`", temporary.display()))?;
        Ok((Self { target: target.to_path_buf(), temporary, is_published: false }, file))
    }

    /// Flushes `file` to disk and gives it its name.
    ///
    /// # Errors
    /// When the disk is full or the rename is refused.
    pub fn publish(mut self, file: &File) -> Result<()> {
        let target = self.target.display().to_string();
        file.sync_all().context(|| format!("cannot write `{target}` to disk"))?;
        std::fs::rename(&self.temporary, &self.target).context(|| format!("cannot name `{target}`"))?;
        self.is_published = true;
        // The name itself is durable only once its folder is.
        let folder = self.target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder).and_then(|f| f.sync_all()).context(|| format!("cannot write `{}` to disk", folder.display()))
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.is_published {
            // Nothing more can be done for a file that cannot be removed; it carries a name nobody reads.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}

/// Writes `target` by `fill`, whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn write(target: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let (partial, file) = Partial::create(target)?;
    let mut out = BufWriter::with_capacity(1 << 16, file);
    fill(&mut out).and_then(|()| out.flush()).context(|| format!("cannot write `{}`", target.display()))?;
    partial.publish(out.get_ref())
}

/// Opens a file to read. A pipe or a device, which may never end, is none.
///
/// # Errors
/// When there is no such file, or it cannot be read.
pub fn open(path: &Path) -> io::Result<File> {
    if std::fs::metadata(path)?.is_file() { File::open(path) } else { Err(io::Error::other("it is no regular file")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_neither_target_nor_temporary() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.txt");
        assert!(write(&target, |_| Err(io::Error::other("no space"))).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        write(&target, |out| out.write_all(b"whole")).unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"whole");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_named() {
        let error = write(Path::new("/nonexistent/x/a.txt"), |_| Ok(())).unwrap_err();
        assert!(error.what().contains("/nonexistent/x/"), "{error}");
    }
}
