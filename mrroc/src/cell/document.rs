//! The text of a cell file as a TOML document. The size is checked before parsing, and errors name the line.

use toml::de::{DeTable, DeValue};

use super::error::CellError;
use super::locate::line_at;
use super::text::excerpt;

/// Greatest size of a cell file, bytes. The largest example has 26 kB.
pub const LARGEST: usize = 1 << 20;

/// Greatest number of characters in a cell file that make elements: `.`, `,`, `=`, `[` and `{`. Each may create a
/// table, which takes a kilobyte of memory. A taught pose of six joints has thirteen such characters.
const MOST_ELEMENTS: usize = 1 << 16;

pub(super) fn text(bytes: &[u8]) -> Result<&str, CellError> {
    if bytes.len() > LARGEST {
        let length = bytes.len();
        let problem = format!("the file has {length} bytes, a cell file may have {LARGEST}");
        return Err(CellError::of_text(1, problem));
    }
    str::from_utf8(bytes).map_err(|error| {
        let before = &bytes[..error.valid_up_to()];
        let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
        let byte = bytes[error.valid_up_to()];
        let problem = format!("the byte {byte:#04x} is no UTF-8 text: save the file as UTF-8");
        CellError::of_text(line, problem)
    })
}

pub(super) fn parse(text: &str) -> Result<DeValue<'_>, CellError> {
    self::text(text.as_bytes())?;
    let elements = |byte: &u8| matches!(byte, b'.' | b',' | b'=' | b'[' | b'{');
    let mut excess = text.bytes().enumerate().filter(|(_, byte)| elements(byte));
    if let Some((offset, _)) = excess.nth(MOST_ELEMENTS) {
        let problem = format!(
            "the file has too many elements: it may have {MOST_ELEMENTS} of the characters . , = [ and {{"
        );
        return Err(CellError::of_text(line_at(text, offset), problem));
    }
    let document = DeTable::parse(text).map_err(|error| {
        let span = error.span().unwrap_or_default();
        let message = error.message().lines().collect::<Vec<_>>().join(", ");
        let found = text.get(span.clone()).unwrap_or_default();
        let (key, problem) = match message.as_str() {
            "duplicate key" => (excerpt(found), "is given twice".to_owned()),
            _ => (String::new(), excerpt(&message)),
        };
        let line = line_at(text, span.start);
        CellError { line, key, problem }
    })?;
    Ok(DeValue::Table(document.into_inner()))
}
