//! Bytes guided by coverage into one reader, that of `READER`; see `tests/fuzz/run`. `SEED` is where a sound file goes first.

#![no_main]

#[path = "../../support/readers.rs"]
mod readers;

use libfuzzer_sys::{Corpus, fuzz_target};
use readers::{READERS, Reader};
use std::path::PathBuf;
use std::sync::OnceLock;

/// The reader and the folder in which it reads.
fn chosen() -> &'static (&'static Reader, PathBuf) {
    static CHOSEN: OnceLock<(&Reader, PathBuf)> = OnceLock::new();
    CHOSEN.get_or_init(|| {
        let name = std::env::var("READER").expect("`READER` names what reads");
        let reader = READERS.iter().find(|reader| reader.name == name).expect("`READER` is none of the readers");
        let folder = tempfile::tempdir().expect("a folder").keep();
        (reader.prepare)(&folder).expect("a sound file");
        if let Ok(seed) = std::env::var("SEED") {
            std::fs::copy(folder.join(reader.file), seed).expect("writable");
        }
        (reader, folder)
    })
}

fuzz_target!(|bytes: &[u8]| -> Corpus {
    let (reader, folder) = chosen();
    std::fs::write(folder.join(reader.file), bytes).expect("writable");
    match (reader.read)(folder) {
        Ok(()) => Corpus::Keep,
        Err(error) => {
            assert!(!error.what().trim().is_empty());
            Corpus::Keep
        }
    }
});
