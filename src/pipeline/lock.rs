//! One owner per key, across threads, processes and hosts that share a file system.
//!
//! The operating system holds the lock, so a killed owner releases it; the text in the file only says who it is. The file is
//! removed on release, hence a new owner must look again whether the name still leads to the file it has locked.

use super::files::make_dirs;
use crate::error::{Context, Error, Result};
use serde::{Deserialize, Serialize};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Who holds a lock.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Owner {
    /// Name of the machine.
    pub host: String,
    /// Process number there.
    pub pid: u32,
    /// When it took the lock, seconds since 1970-01-01 UTC.
    pub since_unix_s: u64,
}

impl Owner {
    /// This process, now.
    pub(super) fn this_process() -> Self {
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { host: host.trim().to_string(), pid: std::process::id(), since_unix_s: since.as_secs() }
    }
}

/// A held lock; released when dropped.
#[derive(Debug)]
pub struct Lock {
    file: File,
    path: PathBuf,
}

impl Lock {
    /// Takes the lock if nobody holds it.
    ///
    /// # Errors
    /// When the file cannot be made or locks are not supported there.
    pub fn try_acquire(path: &Path) -> Result<Option<Self>> {
        let what = || format!("cannot lock `{}`", path.display());
        loop {
            let file = lock_file(path)?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(e)) => return Err(e).context(what),
            }
            if !has_name(&file, path) {
                continue; // the last owner removed the file between our open and our lock
            }
            let mut lock = Self { file, path: path.to_path_buf() };
            let text = toml::to_string(&Owner::this_process()).context(what)?;
            lock.file.set_len(0).and_then(|()| lock.file.write_all(text.as_bytes())).context(what)?;
            return Ok(Some(lock));
        }
    }

    /// Waits until the lock is free; `waiting` is told once who holds it.
    ///
    /// # Errors
    /// As [`Lock::try_acquire`].
    pub fn acquire(path: &Path, mut waiting: impl FnMut(Option<Owner>)) -> Result<Self> {
        let mut has_told = false;
        let mut pause = Duration::from_millis(5);
        loop {
            if let Some(lock) = Self::try_acquire(path)? {
                return Ok(lock);
            }
            if !std::mem::replace(&mut has_told, true) {
                waiting(Self::text(path));
            }
            std::thread::sleep(pause);
            pause = (pause * 2).min(Duration::from_millis(500));
        }
    }

    /// Who holds the lock now; makes no file.
    pub fn holder(path: &Path) -> Option<Owner> {
        let file = File::open(path).ok()?;
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => {
                Self::text(path).or_else(|| Some(Owner { host: String::new(), pid: 0, since_unix_s: 0 }))
            }
            _ => None,
        }
    }

    fn text(path: &Path) -> Option<Owner> {
        toml::from_str(&fs::read_to_string(path).ok()?).ok()
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Name first, lock second (on close): whoever locks the nameless file sees that it has no name and starts over. Where somebody
        // removed the name before, the file that has it now is of another owner.
        if has_name(&self.file, &self.path) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Whether `path` leads to this open file.
fn has_name(file: &File, path: &Path) -> bool {
    let place = |found: fs::Metadata| (found.dev(), found.ino());
    file.metadata().ok().map(place) == fs::metadata(path).ok().map(place)
}

/// The file of a lock, made with its folder where it is not there.
fn lock_file(path: &Path) -> Result<File> {
    let what = || format!("cannot lock `{}`", path.display());
    if path.is_symlink() {
        let what = format!("`{}` is a lock and may not be a link: it would be written through", path.display());
        return Err(Error::new(what).hint("remove it"));
    }
    if let Some(folder) = path.parent() {
        make_dirs(folder).context(|| format!("cannot make the folder `{}`", folder.display()))?;
    }
    OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).context(what)
}

/// A share in a cache: many runs have one at a time, or one collection has all. The operating system takes it back from whoever dies.
#[derive(Debug)]
pub struct Lease {
    _file: File,
}

impl Lease {
    /// A share for a run; where a collection is at work, `waiting` is told and its end waited for.
    ///
    /// # Errors
    /// When the file cannot be made or locks are not supported there.
    pub(super) fn shared(path: &Path, waiting: impl FnOnce()) -> Result<Self> {
        let file = lock_file(path)?;
        let locked = match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => {
                waiting();
                file.lock_shared()
            }
            Err(TryLockError::Error(e)) => Err(e),
            Ok(()) => Ok(()),
        };
        locked.context(|| format!("cannot lock `{}`", path.display())).map(|()| Self { _file: file })
    }

    /// All of it for a collection; `None` where a run is at work.
    ///
    /// # Errors
    /// As [`Lease::shared`].
    pub(super) fn alone(path: &Path) -> Result<Option<Self>> {
        let file = lock_file(path)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(e)) => Err(e).context(|| format!("cannot lock `{}`", path.display())),
        }
    }
}

/// A share in the folder of a site for runs with the same settings; the last of them removes the file that says which.
#[derive(Debug)]
pub(super) struct Agreement {
    file: File,
    path: PathBuf,
}

impl Agreement {
    /// A share; `None` where a run with other `settings` has one.
    ///
    /// # Errors
    /// When the file cannot be made or locks are not supported there.
    pub fn on(path: &Path, settings: &str) -> Result<Option<Self>> {
        let what = || format!("cannot lock `{}`", path.display());
        loop {
            let file = lock_file(path)?;
            if file.try_lock().is_ok() {
                fs::write(path, settings).context(what)?;
                file.unlock().context(what)?;
            }
            file.lock_shared().context(what)?;
            if !has_name(&file, path) {
                continue; // the last of other runs removed it meanwhile
            }
            let is_agreed = fs::read_to_string(path).context(what)? == settings;
            return Ok(is_agreed.then(|| Self { file, path: path.to_path_buf() }));
        }
    }
}

impl Drop for Agreement {
    fn drop(&mut self) {
        if self.file.try_lock().is_ok() && has_name(&self.file, &self.path) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn one_owner_at_a_time_and_no_file_left() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("k/key.lock");
        let (inside, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..20 {
                        let _lock = Lock::acquire(&path, |_| ()).expect("lockable");
                        most.fetch_max(inside.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                        std::thread::yield_now();
                        inside.fetch_sub(1, Ordering::SeqCst);
                    }
                });
            }
        });
        assert_eq!(most.load(Ordering::SeqCst), 1);
        assert!(!path.exists());
    }

    #[test]
    fn a_lock_is_no_link_and_an_owner_whose_file_was_removed_leaves_that_of_the_next() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let (path, outside) = (dir.path().join("key.lock"), dir.path().join("outside"));
        fs::write(&outside, "mine").expect("writable");
        std::os::unix::fs::symlink(&outside, &path).expect("writable");
        assert!(Lock::try_acquire(&path).expect_err("a link").what().contains("may not be a link"));
        assert_eq!(fs::read_to_string(&outside).expect("readable"), "mine");
        fs::remove_file(&path).expect("removable");
        let first = Lock::try_acquire(&path).expect("lockable").expect("free");
        fs::remove_file(&path).expect("removable");
        let second = Lock::try_acquire(&path).expect("lockable").expect("its name is free");
        drop(first);
        assert!(path.exists());
        drop(second);
        assert!(!path.exists());
    }

    #[test]
    fn runs_agree_on_settings_or_the_later_is_refused() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("settings");
        let take = |settings| Agreement::on(&path, settings).expect("lockable");
        let (first, second) = (take("a").expect("free"), take("a").expect("the same"));
        assert!(take("b").is_none());
        drop(first);
        assert!(take("b").is_none());
        drop(second);
        let other = take("b").expect("free again");
        assert!(take("a").is_none());
        drop(other);
        assert!(!path.exists());
    }

    #[test]
    fn the_file_names_its_owner_and_a_left_over_file_is_no_lock() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("key.lock");
        fs::write(&path, "host = 'gone'\npid = 1\nsince_unix_s = 1\n").expect("writable");
        assert_eq!(Lock::holder(&path), None);
        let lock = Lock::try_acquire(&path).expect("lockable").expect("free");
        assert_eq!(Lock::holder(&path).map(|o| o.pid), Some(std::process::id()));
        assert!(Lock::try_acquire(&path).expect("lockable").is_none());
        drop(lock);
        assert_eq!(Lock::holder(&path), None);
    }
}
