//! The lines of a data sheet: sections and their keys, each with its line.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::{EdsCause, EdsError, MAX_SECTIONS};

/// A section with its keys, lower-cased.
pub(super) struct Section<'a> {
    pub(super) name: &'a str,
    pub(super) line: u32,
    pub(super) keys: BTreeMap<String, Text<'a>>,
}

/// The value of a key, trimmed and not empty: `key=` says as much as no key at all.
#[derive(Clone, Copy)]
pub(super) struct Text<'a> {
    pub(super) line: u32,
    pub(super) text: &'a str,
}

impl<'a> Section<'a> {
    /// The value of `key`, whatever the case of its letters in the file.
    pub(super) fn get(&self, key: &str) -> Option<Text<'a>> {
        let found = self.keys.get(&key.to_ascii_lowercase()).copied();
        found.filter(|value| !value.text.is_empty())
    }

    /// The keys that are numbers, with their values.
    pub(super) fn numbered(&self) -> impl Iterator<Item = (u32, Text<'a>)> {
        self.keys.iter().filter_map(|(key, value)| Some((key.parse().ok()?, *value)))
    }
}

/// Valid UTF-8 is decoded as UTF-8, other bytes as ISO 8859-1. Both contain ISO 646, the only character set of the
/// standard (CiA 306-1 §6.2).
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect(),
    }
}

/// What stands before a comment at the end of a line.
pub(super) fn uncommented(line: &str) -> &str {
    let comment =
        line.match_indices(';').find(|(at, _)| line[..*at].chars().next_back().is_none_or(char::is_whitespace));
    comment.map_or(line, |(at, _)| &line[..at]).trim()
}

pub(super) fn sections(text: &str) -> Result<Vec<Section<'_>>, EdsError> {
    let mut sections: Vec<Section<'_>> = Vec::new();
    let mut seen = BTreeMap::new();
    // A lone carriage return ends a line as well.
    let lines = text.split('\n').flat_map(|line| {
        let line = line.strip_suffix('\r').unwrap_or(line);
        line.split('\r')
    });
    for (line, number) in lines.zip(1..) {
        let line = uncommented(line);
        if line.is_empty() {
            continue;
        }
        if let Some(name) = line.strip_prefix('[') {
            let name = name.strip_suffix(']').ok_or(EdsCause::Line.at(number))?;
            let name = name.trim();
            if let Some(first) = seen.insert(name.to_ascii_lowercase(), number) {
                return Err(EdsCause::DuplicateSection { first }.at(number));
            }
            if sections.len() == MAX_SECTIONS {
                return Err(EdsCause::TooManySections.at(number));
            }
            sections.push(Section { name, line: number, keys: BTreeMap::new() });
            continue;
        }
        let Some((key, value)) = line.split_once('=') else {
            return Err(EdsCause::Line.at(number));
        };
        let section = sections.last_mut().ok_or(EdsCause::NoSection.at(number))?;
        let value = Text { line: number, text: value.trim() };
        let earlier = section.keys.insert(key.trim().to_ascii_lowercase(), value);
        if let Some(Text { line: first, .. }) = earlier {
            return Err(EdsCause::DuplicateKey { first }.at(number));
        }
    }
    Ok(sections)
}
