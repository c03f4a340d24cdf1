//! The rooms of the library use each other as `src/lib.rs` says.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn sources(dir: &Path) -> Vec<PathBuf> {
    let all = fs::read_dir(dir).expect("a folder").map(|entry| entry.expect("an entry").path());
    let of = |path: PathBuf| if path.is_dir() { sources(&path) } else { vec![path] };
    all.flat_map(of).filter(|path| path.extension().is_some_and(|e| e == "rs")).collect()
}

/// Rooms that a text names after `crate::`, alone or in braces.
fn used(text: &str) -> BTreeSet<String> {
    let name = |rest: &str| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let after = text.split("crate::").skip(1);
    let names = |rest: &str| -> Vec<String> {
        let Some(list) = rest.strip_prefix('{') else { return vec![name(rest)] };
        // Names at the first level of the braces.
        let mut depth = 0;
        let mut parts = vec![String::new()];
        for c in list.chars() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => parts.push(String::new()),
                c if depth == 0 => parts.last_mut().expect("one").push(c),
                _ => {}
            }
        }
        parts.iter().map(|part| name(part.trim())).collect()
    };
    after.flat_map(names).collect()
}

#[test]
fn a_room_uses_those_before_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let lib = fs::read_to_string(src.join("lib.rs")).expect("lib.rs");
    let line = lib.replace("\n//! ", " ");
    let line =
        line.split("and no others: `").nth(1).and_then(|rest| rest.split('`').next()).expect("the line of rooms");
    let rooms: Vec<&str> = line.split_whitespace().collect();
    let place = |room: &str| rooms.iter().position(|r| *r == room);
    let declared = lib.lines().filter_map(|l| l.strip_prefix("pub mod ")?.strip_suffix(';'));
    let missing: Vec<&str> = declared.filter(|room| place(room).is_none()).collect();
    assert!(missing.is_empty(), "rooms that the line does not have: {missing:?}");
    let mut wrong = Vec::new();
    for path in sources(&src) {
        let inside = path.strip_prefix(&src).expect("in src");
        let own = inside.iter().next().expect("a name").to_string_lossy().replace(".rs", "");
        let Some(own_place) = place(&own) else { continue };
        for room in used(&fs::read_to_string(&path).expect("a source")) {
            if place(&room).is_some_and(|other| other > own_place) {
                wrong.push(format!("{} uses {room}", inside.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn names_in_braces_are_seen() {
    let text = "use crate::{column, effects::{self, Array}, soil::Law};\nuse crate::records::Split;";
    assert_eq!(used(text).into_iter().collect::<Vec<_>>(), ["column", "effects", "records", "soil"]);
}
