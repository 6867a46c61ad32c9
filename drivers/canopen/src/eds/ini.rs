//! The lines of a data sheet: sections and their keys, each with its line.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use super::{EdsCause, EdsError, MAX_SECTIONS};

/// A section with its keys, lower-cased. A repeated section continues the first, and a repeated key keeps the first
/// value.
pub(super) struct Section<'a> {
    pub(super) name: &'a str,
    pub(super) line: u32,
    pub(super) keys: BTreeMap<String, Text<'a>>,
    /// Lines that are not as they should be, and change nothing of the keys.
    pub(super) odd: Vec<EdsError>,
    /// Keys with two values, each with the line of the second value.
    pub(super) ambiguous: Vec<(String, EdsError)>,
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

    /// The second value of `key`, if it has two.
    pub(super) fn second(&self, key: &str) -> Option<EdsError> {
        let found = self.ambiguous.iter().find(|(known, _)| known.eq_ignore_ascii_case(key));
        found.map(|(_, error)| *error)
    }

    /// Whether the section states a value for the device.
    pub(super) fn states(&self) -> bool {
        ["ParameterValue", "DownloadFile"].into_iter().any(|key| self.get(key).is_some())
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

/// The name under which a section is known: `[1018SUB01]` is `[1018sub1]`.
pub(super) fn known_name(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    match name.split_once("sub") {
        Some((index, subindex)) if subindex.len() > 1 => {
            let digits = subindex.trim_start_matches('0');
            format!("{index}sub{}", if digits.is_empty() { "0" } else { digits })
        }
        _ => name,
    }
}

/// Whether a line begins a section, perhaps one whose name cannot be read.
pub(super) fn is_heading(line: &str) -> bool {
    (line.starts_with('[') || line.ends_with(']') && !line.contains('=')) && !line.starts_with('#')
}

/// The name in a heading. A comment may follow the heading.
pub(super) fn heading(line: &str) -> Option<&str> {
    let (name, rest) = line.strip_prefix('[')?.split_once(']')?;
    let rest = rest.trim_start();
    (rest.is_empty() || rest.starts_with('#')).then(|| name.trim())
}

/// The sections, and the errors of lines before the first.
pub(super) fn sections(text: &str) -> Result<(Vec<Section<'_>>, Vec<EdsError>), EdsError> {
    let mut sections: Vec<Section<'_>> = Vec::new();
    let mut seen = BTreeMap::new();
    let mut before = Vec::new();
    let (mut current, mut repeated) = (None, false);
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
        if is_heading(line) {
            let name = heading(line);
            let first = name.and_then(|name| seen.get(&known_name(name)).copied());
            repeated = first.is_some();
            if let Some(first) = first {
                let section: &mut Section<'_> = &mut sections[first];
                section.odd.push(EdsCause::DuplicateSection { first: section.line }.at(number));
                current = Some(first);
                continue;
            }
            if sections.len() == MAX_SECTIONS {
                return Err(EdsCause::TooManySections.at(number));
            }
            if let Some(name) = name {
                seen.insert(known_name(name), sections.len());
            }
            // The keys below a heading that cannot be read belong to no section that is known.
            let odd = if name.is_none() { vec![EdsCause::Line.at(number)] } else { Vec::new() };
            let keys = BTreeMap::new();
            current = Some(sections.len());
            sections.push(Section { name: name.unwrap_or(""), line: number, keys, odd, ambiguous: Vec::new() });
            continue;
        }
        let pair = if line.starts_with('#') { None } else { line.split_once('=') };
        let cause = if line.starts_with('#') { EdsCause::Hash } else { EdsCause::Line };
        let Some(section) = current.map(|current| &mut sections[current]) else {
            before.push(pair.map_or(cause, |_| EdsCause::NoSection).at(number));
            continue;
        };
        let Some((key, value)) = pair else {
            section.odd.push(cause.at(number));
            continue;
        };
        let key = key.trim().to_ascii_lowercase();
        let value = Text { line: number, text: value.trim() };
        match section.keys.entry(key) {
            Entry::Vacant(place) => {
                place.insert(value);
            }
            Entry::Occupied(known) => {
                let Text { line: first, text } = *known.get();
                let error = EdsCause::DuplicateKey { first }.at(number);
                match text == value.text {
                    true if repeated => {}
                    true => section.odd.push(error),
                    false => section.ambiguous.push((known.key().clone(), error)),
                }
            }
        }
    }
    Ok((sections, before))
}

/// The line of `bytes`, from 1, that has a value of `key` in `section`. The case of letters does not matter.
pub fn line_of(bytes: &[u8], section: &str, key: &str) -> Option<u32> {
    let text = decode(bytes);
    let (sections, _) = sections(&text).ok()?;
    let name = known_name(section);
    let section = sections.iter().find(|section| known_name(section.name) == name)?;
    section.get(key).map(|value| value.line)
}

/// What the name of a section says.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Object(u16),
    Sub(u16, u8),
    /// `[1003Name]`: names of a compact array (CiA 306-1 §6.6.3.4).
    Names(u16),
    /// `[1003Value]`: parameter values of a compact array (CiA 306-1 §7.3.4.3).
    Values(u16),
    Other,
}

/// The meaning of a section.
pub(super) fn kind(section: &Section<'_>) -> Result<Kind, EdsError> {
    let name = section.name;
    let error = EdsCause::NotAnObject.at(section.line);
    let index = name.get(..4).and_then(hex);
    let Some(index) = index.and_then(|index| u16::try_from(index).ok()) else {
        // `[60400]` is meant as an object and `[FileInfo]` is not.
        return if name.starts_with(|first: char| first.is_ascii_digit()) { Err(error) } else { Ok(Kind::Other) };
    };
    let rest = name[4..].to_ascii_lowercase();
    match rest.as_str() {
        "" => Ok(Kind::Object(index)),
        "name" => Ok(Kind::Names(index)),
        "value" => Ok(Kind::Values(index)),
        "denotation" | "objectlinks" => Ok(Kind::Other),
        rest => {
            let Some(digits) = rest.strip_prefix("sub") else {
                // `[Feedback]` is a vendor's own, although its first letters are digits.
                return name.starts_with(|first: char| first.is_ascii_alphabetic()).then_some(Kind::Other).ok_or(error);
            };
            let subindex = hex(digits).and_then(|subindex| u8::try_from(subindex).ok());
            Ok(Kind::Sub(index, subindex.ok_or(error)?))
        }
    }
}

/// Hex digits alone, without a sign.
fn hex(digits: &str) -> Option<u32> {
    let all = !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    all.then(|| u32::from_str_radix(digits, 16).ok())?
}
