//! Numbers as people read them: a fixed number of significant figures, a true minus sign, a dash for what is missing.

/// `value` with `digits` decimals, a true minus sign, and a dash if it is not finite.
pub(super) fn fixed(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| b == b'0' || b == b'.') => rest.into(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// `value` with about three significant figures; powers of ten beyond 0.001 and 100 000.
pub(super) fn significant(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() || size == 0.0 {
        return fixed(value, 0);
    }
    if !(1e-3..1e5).contains(&size) {
        let exponent = size.log10().floor();
        let mantissa = fixed(value / 10f64.powf(exponent), 2);
        return format!("{mantissa}×10{}", superscript(exponent as i32));
    }
    fixed(value, (2 - size.log10().floor() as i32).clamp(0, 5) as usize)
}

/// A length or a step as one would say it: at most four significant figures, no trailing zeros (`6`, `0.005`, `11.25`).
pub(super) fn plain(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() || size == 0.0 || !(1e-6..1e7).contains(&size) {
        return significant(value);
    }
    let text = fixed(value, (3 - size.log10().floor() as i32).clamp(0, 9) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// An optional measure with `digits` decimals, a dash if there is none.
pub(super) fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".into(), |v| fixed(v, digits))
}

/// A time span: `0.42 s`, `37 s`, `12 min 5 s`, `3 h 07 min`.
pub(super) fn duration(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() || s < 0.0 => "–".into(),
        s if s < 9.95 => format!("{} s", fixed(s, if s < 0.995 { 2 } else { 1 })),
        s if s < 59.5 => format!("{s:.0} s"),
        s if s < 3570.0 => {
            let whole = s.round() as u64;
            format!("{} min {:02} s", whole / 60, whole % 60)
        }
        s => {
            let minutes = (s / 60.0).round() as u64;
            format!("{} h {:02} min", minutes / 60, minutes % 60)
        }
    }
}

/// Median of the finite values, `None` if there are none.
pub(super) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        n if n % 2 == 1 => Some(sorted[middle]),
        _ => Some((sorted[middle - 1] + sorted[middle]) / 2.0),
    }
}

/// A tick of a logarithmic axis as a power of ten: `10⁻³`, `2×10⁻³`.
pub(super) fn power_of_ten(value: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor();
    let factor = (value / 10f64.powf(exponent)).round();
    let power = format!("10{}", superscript(exponent as i32));
    if factor == 1.0 { power } else { format!("{factor}×{power}") }
}

fn superscript(exponent: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digits = exponent.unsigned_abs().to_string();
    let sign = if exponent < 0 { "⁻" } else { "" };
    sign.chars().chain(digits.bytes().map(|b| DIGITS[usize::from(b - b'0')])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_figures_and_a_true_minus() {
        assert_eq!(significant(12.345), "12.3");
        assert_eq!(significant(0.012345), "0.0123");
        assert_eq!(significant(-1234.5), if 1234.5f64.round() == 1235.0 { "−1234" } else { "−1235" });
        assert_eq!(significant(2.5e-7), "2.50×10⁻⁷");
        assert_eq!(significant(0.0), "0");
        assert_eq!(fixed(-0.0001, 2), "0.00");
        assert_eq!(fixed(f64::NAN, 2), "–");
    }

    #[test]
    fn plain_numbers_and_ticks_carry_no_needless_digits() {
        assert_eq!([plain(6.0), plain(0.005), plain(11.25), plain(120.0)], ["6", "0.005", "11.25", "120"]);
        assert_eq!([power_of_ten(1e-3), power_of_ten(5e-4)], ["10⁻³", "5×10⁻⁴"]);
    }

    #[test]
    fn durations_read_naturally() {
        assert_eq!(duration(0.416), "0.42 s");
        assert_eq!(duration(37.2), "37 s");
        assert_eq!(duration(725.0), "12 min 05 s");
        assert_eq!(duration(11_220.0), "3 h 07 min");
    }

    #[test]
    fn median_ignores_what_is_not_finite() {
        assert_eq!(median([3.0, f64::NAN, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0]), Some(2.5));
        assert_eq!(median([]), None);
    }
}
