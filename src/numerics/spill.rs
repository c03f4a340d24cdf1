//! Values that are made once and read often: in memory as far as a budget reaches, beyond it in files that are read as they are needed.
//!
//! ```text
//! Vec ─► keep ─► Values: held, while the budget lasts │ mapped from a file without a name, which goes when nothing reads it
//! ```
//!
//! A mapped value is read like one in memory, and is the same to the last bit; the system drops its pages when it needs their room. The
//! file has no name, so that nothing is left behind whatever becomes of the program.

use crate::error::{Context, Error, Result};
use bytemuck::Pod;
use memmap2::Mmap;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Least size of a file, bytes: mappings are few whatever the values are.
const FILE_BYTES: usize = 1 << 26;
/// Values begin at multiples of it, bytes.
const ALIGNMENT: usize = 8;

/// Where values are kept.
#[derive(Debug)]
pub struct Spill {
    /// Bytes that the budget has left.
    left: Arc<AtomicUsize>,
    /// Folder of the files.
    dir: PathBuf,
    open: Mutex<Option<Block>>,
}

/// The file that is being filled.
#[derive(Debug)]
struct Block {
    file: File,
    map: Arc<Mmap>,
    used: usize,
}

impl Spill {
    /// Keeps up to `budget_bytes` in memory, and what is more in files of `dir`.
    pub fn new(budget_bytes: usize, dir: &Path) -> Self {
        Self { left: Arc::new(AtomicUsize::new(budget_bytes)), dir: dir.into(), open: Mutex::default() }
    }

    /// Keeps everything in memory.
    pub fn none() -> Self {
        Self::new(usize::MAX, Path::new(""))
    }

    /// Whether so many bytes more are kept in memory.
    pub fn has_room(&self, bytes: usize) -> bool {
        bytes <= self.left.load(Ordering::Relaxed)
    }

    /// Keeps values.
    ///
    /// # Errors
    /// When they go to a file that cannot be made or written, for want of space, say.
    pub fn keep<T: Pod>(&self, values: Vec<T>) -> Result<Values<T>> {
        let bytes = size_of::<T>() * values.len();
        let take = |left: usize| left.checked_sub(bytes);
        if self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take).is_ok() {
            return Ok(Values::Held { values, _share: Some(Share { of: self.left.clone(), bytes }) });
        }
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let what =
            || format!("cannot put {bytes} bytes that are more than the memory budget into `{}`", self.dir.display());
        if open.as_ref().is_none_or(|block| block.map.len() - block.used < bytes) {
            *open = Some(Block::new(&self.dir, bytes.max(FILE_BYTES)).context(what)?);
        }
        let block = open.as_mut().ok_or_else(|| Error::new(what()))?;
        let range = block.used..block.used + bytes;
        block.file.seek(SeekFrom::Start(range.start as u64)).context(what)?;
        block.file.write_all(bytemuck::cast_slice(&values)).context(what)?;
        block.used = range.end.next_multiple_of(ALIGNMENT);
        Values::mapped(&block.map, range)
    }
}

impl Block {
    fn new(dir: &Path, bytes: usize) -> std::io::Result<Self> {
        let file = tempfile::tempfile_in(dir)?;
        // A hole: what is not written takes no space.
        file.set_len(bytes as u64)?;
        let map = Arc::new(mapped(&file)?);
        Ok(Self { file, map, used: 0 })
    }
}

/// The content of a file, read as it is needed.
///
/// # Errors
/// When the file cannot be mapped.
pub fn mapped(file: &File) -> std::io::Result<Mmap> {
    // SAFETY: a file without a name is written where no value has been handed out yet and nowhere else; files with a name that are mapped
    // belong to the cache, in which nothing is changed in place. Whoever shortens one from outside ends the program by a signal.
    unsafe { Mmap::map(file) }
}

/// Values that are kept.
#[derive(Debug)]
pub enum Values<T> {
    /// In memory.
    Held {
        /// They themselves.
        values: Vec<T>,
        /// What they take of a budget.
        _share: Option<Share>,
    },
    /// In a file.
    Mapped {
        /// All of the file.
        map: Arc<Mmap>,
        /// Where they are in it, bytes.
        range: Range<usize>,
    },
}

impl<T: Pod> Values<T> {
    /// Those in bytes `range` of `map`.
    ///
    /// # Errors
    /// When the file has no such bytes or they are no such values.
    pub fn mapped(map: &Arc<Mmap>, range: Range<usize>) -> Result<Self> {
        let is_sound = map.get(range.clone()).is_some_and(|bytes| bytemuck::try_cast_slice::<u8, T>(bytes).is_ok());
        let wrong = || format!("bytes {range:?} of a file of {} are no values of {} bytes", map.len(), size_of::<T>());
        is_sound.then(|| Self::Mapped { map: map.clone(), range: range.clone() }).ok_or_else(|| Error::new(wrong()))
    }
}

impl<T: Pod> Deref for Values<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match self {
            Self::Held { values, .. } => values,
            Self::Mapped { map, range } => bytemuck::cast_slice(&map[range.clone()]),
        }
    }
}

impl<T> From<Vec<T>> for Values<T> {
    fn from(values: Vec<T>) -> Self {
        Self::Held { values, _share: None }
    }
}

impl<T> FromIterator<T> for Values<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        Vec::from_iter(values).into()
    }
}

impl<T: Pod> Clone for Values<T> {
    /// A copy of what is in memory is no part of its budget.
    fn clone(&self) -> Self {
        match self {
            Self::Held { values, .. } => values.clone().into(),
            Self::Mapped { map, range } => Self::Mapped { map: map.clone(), range: range.clone() },
        }
    }
}

impl<T: Pod + PartialEq> PartialEq for Values<T> {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

/// What values take of a budget; given back when they go.
#[derive(Debug)]
pub struct Share {
    of: Arc<AtomicUsize>,
    bytes: usize,
}

impl Drop for Share {
    fn drop(&mut self) {
        self.of.fetch_add(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_more_than_the_budget_is_mapped_and_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let spill = Spill::new(100, dir.path());
        let series = |n: usize| (0..n).map(|i| i as f32).collect::<Vec<f32>>();
        let first = spill.keep(series(20)).unwrap();
        let odd = spill.keep(series(7)).unwrap();
        let long = spill.keep((0..FILE_BYTES).map(|i| i as f64).collect()).unwrap();
        let after = spill.keep(vec![1.5_f64; 3]).unwrap();
        assert!(matches!(first, Values::Held { .. }) && matches!(odd, Values::Mapped { .. }));
        assert!(matches!(long, Values::Mapped { .. }) && matches!(after, Values::Mapped { .. }));
        assert_eq!((&first[..], &odd[..], &after[..]), (&series(20)[..], &series(7)[..], &[1.5; 3][..]));
        assert!(long.iter().enumerate().all(|(i, v)| *v == i as f64));
        // Nothing has a name, and what goes gives its share back.
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        drop(first);
        assert!(matches!(spill.keep(series(25)).unwrap(), Values::Held { .. }));
        // A copy of what is mapped is mapped.
        let copy = odd.clone();
        drop(odd);
        assert_eq!(&copy[..], series(7));
    }

    #[test]
    fn what_cannot_be_written_is_an_error_with_its_place() {
        let error = Spill::new(0, Path::new("nowhere/at/all")).keep(vec![1.0_f32]).unwrap_err().to_string();
        assert!(error.contains("4 bytes that are more than the memory budget into `nowhere/at/all`"), "{error}");
        let spill = Spill::new(0, tempfile::tempdir().unwrap().path());
        assert!(spill.keep(vec![0_f32; 4]).is_err());
        assert_eq!(spill.keep(Vec::<f32>::new()).unwrap().len(), 0);
    }
}
