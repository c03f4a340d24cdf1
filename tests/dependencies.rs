//! What may come into the tree of dependencies: licences that fit, one registry, no crate in more versions than are known.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Licences under which a dependency may be used here.
const LICENCES: [&str; 12] = [
    "MIT",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "ISC",
    "Zlib",
    "CC0-1.0",
    "Unicode-3.0",
    "Unlicense",
    "0BSD",
    "BSL-1.0",
];

/// Crates that are there in several versions, because others ask for these.
const SEVERAL: [&str; 10] = [
    "constant_time_eq",
    "equator",
    "equator-macro",
    "foldhash",
    "hashbrown",
    "itertools",
    "shlex",
    "syn",
    "thiserror",
    "thiserror-impl",
];

/// Whether an expression of licences can be met: `or` of them in alternatives, `and` in parts, parentheses first.
fn is_met(expression: &str) -> bool {
    let expression = expression.replace('/', " OR ");
    let mut words: Vec<String> = Vec::new();
    for word in expression.replace('(', " ( ").replace(')', " ) ").split_whitespace() {
        match words.last_mut() {
            Some(last) if word == "WITH" || last.ends_with("WITH") => *last = format!("{last} {word}"),
            _ => words.push(word.to_string()),
        }
    }
    fn any(words: &[String], at: &mut usize) -> bool {
        let mut is_met = all(words, at);
        while words.get(*at).is_some_and(|word| word == "OR") {
            *at += 1;
            is_met |= all(words, at);
        }
        is_met
    }
    fn all(words: &[String], at: &mut usize) -> bool {
        let mut is_met = one(words, at);
        while words.get(*at).is_some_and(|word| word == "AND") {
            *at += 1;
            is_met &= one(words, at);
        }
        is_met
    }
    fn one(words: &[String], at: &mut usize) -> bool {
        let word = words.get(*at).cloned().unwrap_or_default();
        *at += 1;
        if word == "(" {
            let is_met = any(words, at);
            *at += 1;
            return is_met;
        }
        LICENCES.contains(&word.as_str())
    }
    any(&words, &mut 0)
}

fn packages() -> Vec<Value> {
    let words = ["metadata", "--format-version", "1", "--locked"];
    let mut command = Command::new(env!("CARGO"));
    let output = command.current_dir(env!("CARGO_MANIFEST_DIR")).args(words).output().expect("cargo starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    metadata["packages"].as_array().expect("a list").clone()
}

#[test]
fn expressions_of_licences_are_read() {
    for met in [
        "MIT",
        "GPL-3.0 OR MIT",
        "MIT/Apache-2.0",
        "(GPL-3.0 OR MIT) AND Unicode-3.0",
        "Apache-2.0 WITH LLVM-exception",
    ] {
        assert!(is_met(met), "{met}");
    }
    for not in ["", "GPL-3.0", "MIT AND GPL-3.0", "(MIT OR Zlib) AND LGPL-2.1", "GPL-2.0 WITH LLVM-exception"] {
        assert!(!is_met(not), "{not}");
    }
}

#[test]
fn dependencies_have_licences_that_fit_and_come_from_one_registry() {
    let all = packages();
    assert!(all.len() > 50);
    for package in &all {
        let name = package["name"].as_str().expect("a name");
        let licence = package["license"].as_str().unwrap_or_default();
        assert!(is_met(licence), "`{name}`: `{licence}`");
        let source = package["source"].as_str();
        let is_own = source.is_none() && name == env!("CARGO_PKG_NAME");
        assert!(
            is_own || source.is_some_and(|s| s.ends_with("github.com/rust-lang/crates.io-index")),
            "`{name}`: {source:?}"
        );
        for dependency in package["dependencies"].as_array().into_iter().flatten().filter(|_| is_own) {
            assert_ne!(dependency["req"], "*", "`{}` in any version", dependency["name"]);
        }
    }
}

#[test]
fn no_crate_is_there_in_more_versions_than_are_known() {
    let mut versions: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for package in packages() {
        let text = |key: &str| package[key].as_str().expect("a text").to_string();
        versions.entry(text("name")).or_default().insert(text("version"));
    }
    let several: Vec<&String> = versions.iter().filter(|(_, v)| v.len() > 1).map(|(name, _)| name).collect();
    let unknown: Vec<_> = several.into_iter().filter(|name| !SEVERAL.contains(&name.as_str())).collect();
    assert!(unknown.is_empty(), "{unknown:?}: take a version that is there already, or say why not in `SEVERAL`");
}
