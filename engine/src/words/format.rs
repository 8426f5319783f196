//! How numbers are written for people. `None` is what is not known.

/// What stands for a number that is not known, on a page.
pub const DASH: &str = "\u{2013}";
/// What keeps a number and its unit on one line, on a page.
pub const FIXED_SPACE: &str = "\u{a0}";
/// What sets thousands apart, on a page.
pub const NARROW_SPACE: char = '\u{202f}';

/// A number with so many digits, with a true minus and no negative zero.
pub fn decimal(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    let is_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if is_zero { text.replace('-', "") } else { text.replace('-', "\u{2212}") }
}

/// The same with what stands for a number that is not known.
pub fn decimal_or_dash(value: Option<f64>, digits: usize) -> String {
    value.map_or(DASH.to_owned(), |value| decimal(value, digits))
}

/// A whole number with a true minus and its thousands set apart, or what stands for one that is not known.
pub fn whole_or_dash(value: Option<impl ToString>) -> String {
    value.map_or(DASH.to_owned(), |value| grouped(value, NARROW_SPACE).replace('-', "\u{2212}"))
}

/// A number with so many digits for a terminal, `-` where it is not known.
pub fn plain(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
}

/// A number with its thousands set apart.
pub fn grouped(number: impl ToString, separator: char) -> String {
    let digits = number.to_string();
    let (sign, digits) = digits.split_at(usize::from(digits.starts_with('-')));
    let mut text = sign.to_owned();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(separator);
        }
        text.push(digit);
    }
    text
}

/// `count` and a word, which gets an s where there is not just one.
pub fn counted(count: usize, word: &str) -> String {
    format!("{} {word}{}", grouped(count, ','), if count == 1 { "" } else { "s" })
}

/// A share as a percentage in a sentence: whole, or with two digits below one.
pub fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent < 1.0 { format!("{percent:.2} %") } else { format!("{percent:.0} %") }
}

/// A relative standard deviation as a percentage, in plain letters.
pub fn percent_or_open(sigma: f64) -> String {
    if sigma.is_finite() { format!("{:.2} %", 100.0 * sigma) } else { "not determined".to_owned() }
}

/// A share as a percentage with so many digits and `space` before the sign, on a page.
pub fn percent_of(share: f64, digits: usize, space: &str) -> String {
    format!("{}{space}%", decimal(100.0 * share, digits))
}

/// A length in centimetres, in plain letters; `inf` where it is not determined.
pub fn centimetres(length_m: f64) -> String {
    if length_m.is_infinite() { "inf".to_owned() } else { format!("{:.1} cm", 100.0 * length_m) }
}

/// A length in centimetres, on a page.
pub fn cm(length_m: f64) -> String {
    format!("{}{FIXED_SPACE}cm", decimal(100.0 * length_m, 1))
}

/// The same with what stands for a length that is not known.
pub fn cm_or_dash(length_m: Option<f64>) -> String {
    length_m.map_or(DASH.to_owned(), cm)
}

/// An estimated number of any size: four digits, at least.
pub fn estimated(value: f64) -> String {
    let digits = match value.abs() {
        v if v >= 100.0 => 2,
        v if v >= 1.0 => 3,
        v if v >= 1e-4 || v == 0.0 => 5,
        _ => return format!("{value:.3e}"),
    };
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_in_one_way_each() {
        assert_eq!([decimal(-0.001, 2), decimal(-1.5, 1)], ["0.00", "\u{2212}1.5"]);
        assert_eq!([percent(0.005), percent(0.5)], ["0.50 %", "50 %"]);
        assert_eq!([percent_or_open(0.5), percent_or_open(f64::INFINITY)], ["50.00 %", "not determined"]);
        assert_eq!(percent_of(0.5, 1, FIXED_SPACE), "50.0\u{a0}%");
        assert_eq!([centimetres(0.5), cm(0.5), cm_or_dash(None)], ["50.0 cm", "50.0\u{a0}cm", DASH]);
        assert_eq!([estimated(123.456), estimated(0.0), estimated(1e-5)], ["123.46", "0.00000", "1.000e-5"]);
        assert_eq!(whole_or_dash(Some(-12345)), "\u{2212}12\u{202f}345");
    }
}
