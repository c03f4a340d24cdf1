//! Independent reference results, read from outside the repository where they are present.

/// Rows of `name` by column; None, with a message, where the file is absent.
pub fn columns(name: &str) -> Option<Vec<Vec<f64>>> {
    let root = env!("CARGO_MANIFEST_DIR");
    let paths = ["..", "../.."].map(|up| format!("{root}/{up}/shared/reference/opensees/{name}"));
    let Some(text) = paths.iter().find_map(|path| std::fs::read_to_string(path).ok()) else {
        println!("skipped: no reference file `{}`", paths[0]);
        return None;
    };
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for line in text.lines().skip(1) {
        let numbers = line.split(',').map(|x| x.trim().parse::<f64>().expect("a number"));
        for (i, x) in numbers.enumerate() {
            if columns.len() <= i {
                columns.push(Vec::new());
            }
            columns[i].push(x);
        }
    }
    Some(columns)
}
