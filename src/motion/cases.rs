//! Case numbers as typed in a manifest: `"1-80"`, `"81-100"`, `"1-10, 15, 20-30"`.

use crate::error::{Error, Result};
use std::collections::BTreeSet;

/// Most cases of an ensemble: what names the series of a learning set has to fit the header of its file.
pub const MOST_CASES: usize = 100_000;

/// Case numbers of a range list; numbers count from 1.
///
/// # Errors
/// When a part is not a number or a rising range, or a number comes twice.
pub fn parse_cases(text: &str) -> Result<BTreeSet<usize>> {
    let mut cases = BTreeSet::new();
    for part in text.split(',').map(str::trim) {
        let (first, last) = match part.split_once('-') {
            Some((a, b)) => (number(a, text)?, number(b, text)?),
            None => (number(part, text)?, number(part, text)?),
        };
        if first > last {
            return Err(Error::new(format!("case range `{part}` falls"))
                .hint(format!("write `{last}-{first}`"))
                .usage());
        }
        for case in first..=last {
            if !cases.insert(case) {
                return Err(Error::new(format!("case {case} comes twice in `{text}`")).usage());
            }
        }
    }
    Ok(cases)
}

fn number(part: &str, text: &str) -> Result<usize> {
    match part.trim().parse::<usize>() {
        Ok(case @ 1..=MOST_CASES) => Ok(case),
        _ => Err(Error::new(format!("`{}` in `{text}` is not a case number (1…{MOST_CASES})", part.trim()))
            .hint("write ranges as `1-80` or `1-10, 15`")
            .usage()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ranges_and_single_cases_are_read() {
        assert_eq!(parse_cases("1-3, 7,9-10").unwrap(), BTreeSet::from([1, 2, 3, 7, 9, 10]));
        assert_eq!(parse_cases("1-100000").unwrap().len(), MOST_CASES);
        for wrong in ["", "3-1", "0-2", "1-x", "1,1", "1-2-3", "-", "100001"] {
            assert!(parse_cases(wrong).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[-0-9, x]{0,20}") {
            let _ = parse_cases(&text);
        }
    }
}
