//! The figures of a rendered report as pictures of their own.

use std::collections::BTreeMap;

/// What the page says of pictures that they need by themselves.
const STYLE: &str =
    "svg{font-family:system-ui,sans-serif;fill:#3c424a}.hint{fill:transparent}svg image{image-rendering:pixelated}";

/// Name and SVG of every figure of a report, in its order: they are named by the heading that they stand under.
pub fn pictures(report: &str) -> Vec<(String, String)> {
    let mut found: Vec<(String, String)> = Vec::new();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut at = 0;
    while let Some(start) = report[at..].find("<svg ").map(|i| at + i) {
        let Some(end) = report[start..].find("</svg>").map(|i| start + i + "</svg>".len()) else { break };
        at = end;
        let svg = &report[start..end];
        let Some((head, body)) = svg.split_once('>').filter(|(head, _)| head.contains("role=\"img\"")) else {
            continue;
        };
        let heading = heading_before(&report[..start]).unwrap_or("figure");
        let count = counts.entry(heading).or_insert(0);
        *count += 1;
        let whole = format!("{head} xmlns=\"http://www.w3.org/2000/svg\"><style>{STYLE}</style>{body}");
        found.push((format!("{heading}-{count}"), whole));
    }
    found
}

/// The anchor of the last section or heading that begins in `text`.
fn heading_before(text: &str) -> Option<&str> {
    let starts = ["<section id=\"", "<h3 id=\""].into_iter().filter_map(|tag| Some(text.rfind(tag)? + tag.len()));
    let rest = &text[starts.max()?..];
    rest.split('"')
        .next()
        .filter(|id| !id.is_empty() && id.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_named_by_their_headings_and_stand_alone() {
        let report = "<section id=\"loop\"><svg viewBox=\"0 0 2 1\" aria-hidden=\"true\"><path/></svg>\
                      <svg viewBox=\"0 0 1 1\" role=\"img\"><text>a</text></svg><h3 id=\"loop-errors\"></h3>\
                      <svg role=\"img\"></svg><svg role=\"img\"></svg>";
        let found = pictures(report);
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["loop-1", "loop-errors-1", "loop-errors-2"]);
        assert_eq!(
            found[0].1,
            format!(
                "<svg viewBox=\"0 0 1 1\" role=\"img\" xmlns=\"http://www.w3.org/2000/svg\"><style>{STYLE}</style><text>a</text></svg>"
            )
        );
    }
}
