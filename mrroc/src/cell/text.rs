//! Texts and numbers from files in messages: short, on one line, and without effect on a terminal.

use std::fmt::Write as _;

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
    beginning(text, printable)
}

/// The beginning of a text in quotes, for a message.
pub fn quoted(text: &str) -> String {
    beginning(text, |text| format!("{text:?}"))
}

fn beginning(text: &str, shown: impl Fn(&str) -> String) -> String {
    match text.char_indices().nth(LONGEST) {
        None => shown(text),
        Some((end, _)) => format!("{}… ({} characters)", shown(&text[..end]), text.chars().count()),
    }
}

/// Words as a list: `a`, `a or b`, `a, b or c`.
pub(crate) fn one_of(words: &[&str]) -> String {
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
}
