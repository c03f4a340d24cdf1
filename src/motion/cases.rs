//! Case numbers as typed in a manifest: `"1-80"`, `"81-100"`, `"1-10, 15, 20-30"`.

use crate::error::{Error, Result};

/// Case numbers of a range list, ascending as typed; numbers count from 1.
///
/// # Errors
/// When a part is not a number or a rising range, or a number comes twice.
pub fn parse_cases(text: &str) -> Result<Vec<usize>> {
    let mut cases = Vec::new();
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
            if cases.contains(&case) {
                return Err(Error::new(format!("case {case} comes twice in `{text}`")).usage());
            }
            cases.push(case);
        }
    }
    Ok(cases)
}

fn number(part: &str, text: &str) -> Result<usize> {
    match part.trim().parse::<usize>() {
        Ok(case @ 1..=9999) => Ok(case),
        _ => Err(Error::new(format!("`{}` in `{text}` is not a case number (1…9999)", part.trim()))
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
        assert_eq!(parse_cases("1-3, 7,9-10").unwrap(), vec![1, 2, 3, 7, 9, 10]);
        for wrong in ["", "3-1", "0-2", "1-x", "1,1", "1-2-3", "-"] {
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
