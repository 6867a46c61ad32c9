//! Texts and numbers from files in messages: short, on one line, and without effect on a terminal.

use std::fmt::{self, Write as _};

/// Greatest number of characters that a message quotes.
const LONGEST: usize = 60;

/// A text without effect on a terminal. Control characters, line separators, and invisible characters or those that
/// change the direction of writing are written as escapes (`\n`, `\u{1b}`).
///
/// Every text that was read from a file must pass through this function before printing.
pub fn printable(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for character in text.chars() {
        let acts = character.is_control()
            || matches!(
                character,
                '\u{ad}'
                    | '\u{61c}'
                    | '\u{200b}'..='\u{200f}'
                    | '\u{2028}'..='\u{202e}'
                    | '\u{2060}'..='\u{206f}'
                    | '\u{fe00}'..='\u{fe0f}'
                    | '\u{feff}'
                    | '\u{fff9}'..='\u{fffb}'
                    | '\u{e0000}'..='\u{e0fff}'
            );
        if acts {
            shown.extend(character.escape_default());
        } else {
            shown.push(character);
        }
    }
    shown
}

/// The beginning of a text, for a message without quotes.
pub(super) fn excerpt(text: &str) -> String {
    match text.char_indices().nth(LONGEST) {
        None => printable(text),
        Some((end, _)) => format!(
            "{}… ({} characters)",
            printable(&text[..end]),
            text.chars().count()
        ),
    }
}

/// The beginning of a text in quotes, for a message.
pub fn quoted(text: &str) -> String {
    match text.char_indices().nth(LONGEST) {
        None => format!("{text:?}"),
        Some((end, _)) => format!("{:?}… ({} characters)", &text[..end], text.chars().count()),
    }
}

/// A number in a message: 1000001, 0.25, 1e300.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure(pub f64);

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value) = *self;
        if value == 0.0 || (1e-4..1e15).contains(&value.abs()) {
            write!(f, "{value}")
        } else {
            write!(f, "{value:e}")
        }
    }
}

/// The permitted range of a number, including both ends. [`f64::MIN_POSITIVE`] as the low end means all positive
/// numbers. [`f64::MIN`] and [`f64::MAX`] mean no limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Low end.
    pub low: f64,
    /// High end.
    pub high: f64,
    /// The unit and the origin of the limits, as part of a message; may be empty.
    pub of: &'static str,
}

impl Range {
    pub(super) const fn new(low: f64, high: f64, of: &'static str) -> Self {
        Self { low, high, of }
    }

    /// Whether `value` is in the range; false for NaN.
    pub(super) fn has(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (low, high) = (inner(self.low, f64::ceil), inner(self.high, f64::floor));
        let (above_zero, no_low) = (self.low == f64::MIN_POSITIVE, self.low == f64::MIN);
        match (self.high == f64::MAX, above_zero, no_low) {
            (true, true, _) => f.write_str("above 0"),
            (true, _, true) => f.write_str("a number"),
            (true, false, false) => write!(f, "at least {low}"),
            (false, true, _) => write!(f, "above 0 and at most {high}"),
            (false, _, true) => write!(f, "at most {high}"),
            (false, false, false) if self.low == self.high => write!(f, "{low}"),
            (false, false, false) => write!(f, "between {low} and {high}"),
        }?;
        if self.of.is_empty() {
            Ok(())
        } else {
            write!(f, " ({})", self.of)
        }
    }
}

/// An end of a range with few digits, rounded to the inside of the range. The printed number is therefore permitted.
fn inner(end: f64, round: fn(f64) -> f64) -> String {
    let exact = Figure(end).to_string();
    let power = format!("{end:e}");
    if exact.len().min(power.len()) <= 9 {
        return if exact.len() <= 9 { exact } else { power };
    }
    let decimals = 3 - end.abs().log10().floor() as i32;
    let scale = 10_f64.powi(decimals);
    let rounded = round(end * scale) / scale;
    if (1e-4..1e9).contains(&end.abs()) {
        format!("{rounded:.*}", decimals.max(0) as usize)
    } else {
        format!("{rounded:.3e}")
    }
}

/// Words as a list: `a`, `a or b`, `a, b or c`.
pub(super) fn one_of(words: &[&str]) -> String {
    let mut list = String::new();
    for (number, word) in words.iter().enumerate() {
        let join = match number {
            0 => "",
            _ if number + 1 == words.len() => " or ",
            _ => ", ",
        };
        let _ = write!(list, "{join}{word:?}");
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_acts_on_a_terminal_is_shown_as_an_escape() {
        let table = [
            ("lower arm, é, π", "lower arm, é, π"),
            ("\u{1b}[31mred\u{1b}[0m", "\\u{1b}[31mred\\u{1b}[0m"),
            ("two\nlines\r\tand a tab", "two\\nlines\\r\\tand a tab"),
            ("\u{9b}2J\u{7f}\0", "\\u{9b}2J\\u{7f}\\u{0}"),
            ("left\u{202e}right\u{2066}", "left\\u{202e}right\\u{2066}"),
            ("no\u{200b}width\u{2028}", "no\\u{200b}width\\u{2028}"),
        ];
        for (text, shown) in table {
            assert_eq!(printable(text), shown);
        }
    }

    #[test]
    fn a_long_text_is_quoted_by_its_beginning() {
        assert_eq!(excerpt("short"), "short");
        assert_eq!(quoted("a \u{1b} \u{202e}"), "\"a \\u{1b} \\u{202e}\"");
        let (long, begin) = ("é".repeat(300), "é".repeat(60));
        assert_eq!(excerpt(&long), format!("{begin}… (300 characters)"));
        assert_eq!(quoted(&long), format!("\"{begin}\"… (300 characters)"));
    }

    #[test]
    fn no_number_takes_more_than_two_dozen_characters() {
        let table = [
            (0.0, "0"),
            (1_000_001.0, "1000001"),
            (-0.25, "-0.25"),
            (1e300, "1e300"),
            (-1.5e-300, "-1.5e-300"),
            (f64::MAX, "1.7976931348623157e308"),
            (5e-324, "5e-324"),
        ];
        for (value, shown) in table {
            assert_eq!(Figure(value).to_string(), shown);
        }
    }

    #[test]
    fn a_range_is_said_by_the_ends_that_it_has() {
        let table = [
            ((f64::MIN_POSITIVE, f64::MAX), "above 0"),
            ((f64::MIN, f64::MAX), "a number"),
            ((0.0, f64::MAX), "at least 0"),
            ((f64::MIN_POSITIVE, 2.5), "above 0 and at most 2.5"),
            ((f64::MIN, 2.5), "at most 2.5"),
            ((1.0, 1e6), "between 1 and 1000000"),
            ((1.0, 1.0), "1"),
            ((920.0 / 1200.0, 2.0 / 3.0), "between 0.7667 and 0.6666"),
            ((5000.0 / 3.0, 1e7 / 3.0), "between 1667 and 3333000"),
            ((1e-5 / 3.0, 1e13 / 3.0), "between 3.334e-6 and 3.333e12"),
        ];
        for ((low, high), words) in table {
            assert_eq!(Range::new(low, high, "").to_string(), words);
            let with_unit = Range::new(low, high, "rad").to_string();
            assert_eq!(with_unit, format!("{words} (rad)"));
        }
    }
}
