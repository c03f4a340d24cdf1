//! The pipelines that come with the program: files of `pipelines/`, which one of the same name in a project stands in for.

/// A pipeline by name.
#[derive(Debug)]
pub struct Entry {
    /// What a manifest calls it.
    pub name: &'static str,
    /// Its text.
    pub text: &'static str,
}

macro_rules! entry {
    ($name:literal) => {
        Entry { name: $name, text: include_str!(concat!("../../pipelines/", $name, ".toml")) }
    };
}

/// All of them.
pub const PIPELINES: &[Entry] = &[entry!("close-loop"), entry!("diagnose"), entry!("flare-t"), entry!("source-study")];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    #[test]
    fn every_file_of_the_folder_is_built_in() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines");
        let name = |e: std::fs::DirEntry| e.path().file_stem().unwrap().to_str().unwrap().to_string();
        let files: BTreeSet<String> = folder.read_dir().unwrap().map(|e| name(e.unwrap())).collect();
        assert_eq!(files, PIPELINES.iter().map(|p| p.name.to_string()).collect());
    }
}
