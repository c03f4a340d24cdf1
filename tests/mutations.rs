//! Any bytes in: a value or a message comes out, never a panic, an abort, a value that is not finite, or a wait without end.
//!
//! `MUTATIONS=1000 cargo test --release --test mutations -- --nocapture` reads a thousand mutations of each file instead of a few; guided
//! by coverage, `tests/fuzz` does the same.

#[path = "support/readers.rs"]
mod readers;

use readers::{READERS, Reader};
use std::fs;
use std::process::Command;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// The reader that a process of its own tries, and its name on the way there.
const READER: &str = "FLARE_PIPE_TEST_READER";
/// Memory of that process, KiB.
const MEMORY_KIB: u64 = 2 << 20;
/// Longest time that one file may take.
const LONGEST: Duration = Duration::from_secs(20);

/// Numbers that look drawn and are the same in every run.
struct Drawn(u64);

impl Drawn {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n.max(1)
    }
}

/// What stands where a number or a word was.
const SPLICES: [&str; 14] = [
    "NaN",
    "inf",
    "-1",
    "0",
    "1e308",
    "1e-320",
    "99999999999999999999",
    "9223372036854775807",
    "",
    "\n",
    "[[",
    "\"",
    "..",
    "\u{0}",
];

/// Changes a file in one to four places.
fn mutated(sound: &[u8], drawn: &mut Drawn) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for _ in 0..=drawn.below(4) {
        let at = drawn.below(bytes.len());
        let end = (at + 1 + drawn.below(12)).min(bytes.len());
        match drawn.below(8) {
            _ if bytes.is_empty() => bytes.push(drawn.below(256) as u8),
            0 => bytes[at] ^= 1 << drawn.below(8),
            1 => bytes[at] = [0, 1, 127, 128, 255][drawn.below(5)],
            2 => bytes.truncate(at),
            3 => _ = bytes.drain(at..end),
            4 => {
                let copied = bytes[at..end].to_vec();
                bytes.splice(at..at, copied);
            }
            5 => bytes[at..end].fill(255),
            _ => _ = bytes.splice(at..end, SPLICES[drawn.below(SPLICES.len())].bytes()),
        }
    }
    bytes
}

/// Reads mutations of one file; of what it was told to do by its surroundings.
#[test]
fn one_reader_in_a_process_of_its_own() {
    let Ok(name) = std::env::var(READER) else { return };
    let reader = READERS.iter().find(|reader| reader.name == name).expect("a reader");
    let count = std::env::var("MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(60);
    let place = tempfile::tempdir().expect("a folder");
    let folder = place.path().join("read");
    (reader.prepare)(&folder).expect("a sound file");
    (reader.read)(&folder).unwrap_or_else(|error| panic!("a sound file is refused: {error}"));
    let sound = fs::read(folder.join(reader.file)).expect("readable");
    static BEGUN: Mutex<Option<Instant>> = Mutex::new(None);
    std::thread::spawn(|| {
        loop {
            std::thread::sleep(Duration::from_millis(200));
            if BEGUN.lock().expect("whole").is_some_and(|begun| begun.elapsed() > LONGEST) {
                eprintln!("a file takes longer than {LONGEST:?}");
                std::process::abort();
            }
        }
    });
    let mut drawn = Drawn(name.len() as u64 + 1);
    let (mut read, mut refused) = (0, 0);
    for number in 0..count {
        let bytes = mutated(&sound, &mut drawn);
        fs::write(folder.join(reader.file), &bytes).expect("writable");
        *BEGUN.lock().expect("whole") = Some(Instant::now());
        let outcome = std::panic::catch_unwind(|| (reader.read)(&folder));
        *BEGUN.lock().expect("whole") = None;
        match outcome {
            Ok(Ok(())) => read += 1,
            Ok(Err(error)) => {
                assert!(!error.what().trim().is_empty(), "mutation {number} is refused without a word");
                refused += 1;
            }
            Err(_) => panic!("mutation {number} of `{name}`"),
        }
    }
    println!("{name:18} {count:6} mutations: {read} read, {refused} refused");
}

#[test]
fn any_bytes_give_a_value_or_a_message() {
    let try_out = |reader: &Reader| -> Option<String> {
        let program = std::env::current_exe().expect("this test");
        let script =
            format!("ulimit -v {MEMORY_KIB}; exec \"$0\" --exact one_reader_in_a_process_of_its_own --nocapture");
        let mut command = Command::new("sh");
        let output = command.arg("-c").arg(script).arg(program).env(READER, reader.name).output().expect("starts");
        let [stdout, stderr] = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
        stdout.lines().filter(|line| line.contains("mutations:")).for_each(|line| println!("{line}"));
        (!output.status.success()).then(|| format!("{}: {}\n{stdout}\n{stderr}", reader.name, output.status))
    };
    let failed: Vec<String> = READERS.iter().filter_map(try_out).collect();
    assert!(failed.is_empty(), "{}", failed.join("\n\n"));
}
