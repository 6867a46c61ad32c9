//! Leaves values out of the text of a DCF. All other lines stay as they are, with their numbers.

use std::collections::{BTreeMap, BTreeSet};

use super::ini;

/// A DCF without some of its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stripped {
    /// The text of the file.
    pub bytes: Vec<u8>,
    /// The lines that are comments now, from 1.
    pub lines: BTreeSet<u32>,
}

/// A line of the file.
struct Line<'a> {
    bytes: &'a [u8],
    /// Line feed, carriage return, both, or nothing at the end of the file.
    end: &'a [u8],
    /// Number of the heading above, or of the line itself if it is a heading.
    section: usize,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Heading,
    /// `ParameterValue` or `DownloadFile`.
    Value,
    Other,
}

/// Makes comments of the values that `refused` concerns. `refused` has the reason by line. A reason concerns all values of
/// the section of its line, or the line itself if the section has none. A section `[1016Value]` is left
/// out as a whole if the reason is at its heading.
pub fn strip(bytes: &[u8], refused: &BTreeMap<u32, String>) -> Stripped {
    let (lines, names) = lines(bytes);
    let mut left_out: BTreeMap<usize, &str> = BTreeMap::new();
    for (line, reason) in refused {
        let at = *line as usize - 1;
        let Some(found) = lines.get(at) else {
            continue;
        };
        let name = names.get(&found.section);
        let of_section = |line: &Line<'_>| {
            line.section == found.section || name.is_some_and(|name| names.get(&line.section) == Some(name))
        };
        let values = || (0..lines.len()).filter(|at| lines[*at].kind == Kind::Value && of_section(&lines[*at]));
        let wanted: Vec<usize> = match found.kind {
            _ if values().next().is_some() => values().collect(),
            Kind::Value | Kind::Other => vec![at],
            Kind::Heading => (0..lines.len()).filter(|at| lines[*at].section == found.section).collect(),
        };
        for at in wanted {
            left_out.entry(at).or_insert(reason);
        }
    }
    let mut text = Vec::with_capacity(bytes.len());
    for (at, line) in lines.iter().enumerate() {
        match left_out.get(&at) {
            Some(reason) => {
                text.extend_from_slice(b"; ");
                text.extend_from_slice(line.bytes);
                text.extend_from_slice(format!(" ; left out: {reason}").as_bytes());
            }
            None => text.extend_from_slice(line.bytes),
        }
        text.extend_from_slice(line.end);
    }
    Stripped { bytes: text, lines: left_out.keys().map(|at| *at as u32 + 1).collect() }
}

/// The lines, numbered as the reader numbers them, and the names of their sections by the number of the heading.
fn lines(bytes: &[u8]) -> (Vec<Line<'_>>, BTreeMap<usize, String>) {
    let (mut lines, mut names) = (Vec::new(), BTreeMap::new());
    let (mut rest, mut section) = (bytes, 0);
    while !rest.is_empty() {
        let length = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(rest.len());
        let end = match &rest[length..] {
            [b'\r', b'\n', ..] => 2,
            [_, ..] => 1,
            [] => 0,
        };
        let (line, after) = rest.split_at(length + end);
        let (bytes, end) = line.split_at(length);
        let text = ini::decode(bytes);
        let text = ini::uncommented(&text);
        let kind = match text.split_once('=') {
            _ if ini::is_heading(text) => Kind::Heading,
            Some((key, _)) if is_value(key.trim()) => Kind::Value,
            _ => Kind::Other,
        };
        if kind == Kind::Heading {
            section = lines.len();
            names.extend(ini::heading(text).map(|name| (section, ini::known_name(name))));
        }
        lines.push(Line { bytes, end, section, kind });
        rest = after;
    }
    (lines, names)
}

fn is_value(key: &str) -> bool {
    ["ParameterValue", "DownloadFile"].iter().any(|value| value.eq_ignore_ascii_case(key))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stripped(text: &str, refused: &[u32]) -> (String, Vec<u32>) {
        let refused = refused.iter().map(|line| (*line, "no".to_owned())).collect();
        let Stripped { bytes, lines } = strip(text.as_bytes(), &refused);
        (String::from_utf8(bytes).unwrap(), lines.into_iter().collect())
    }

    const FILE: &str =
        "[2000]\r\nDataType=5\r\nParameterValue=1 ; one\r\n[2001]\nLowLimit=x\nparametervalue = 2\n[2002]\nx";

    #[test]
    fn a_value_becomes_a_comment_and_no_other_byte_changes() {
        let (text, lines) = stripped(FILE, &[3]);
        assert_eq!(text, FILE.replace("ParameterValue=1 ; one", "; ParameterValue=1 ; one ; left out: no"));
        assert_eq!(lines, [3]);
        assert_eq!(stripped(FILE, &[]), (FILE.to_owned(), vec![]));
        assert_eq!(stripped(FILE, &[99]).1, []);
        let bytes = b"[2000]\nParameterName=\xB0C\nParameterValue=1";
        let refused = [(3, "no".to_owned())].into();
        assert_eq!(strip(bytes, &refused).bytes, b"[2000]\nParameterName=\xB0C\n; ParameterValue=1 ; left out: no");
    }

    #[test]
    fn a_reason_at_another_line_leaves_out_the_values_of_its_section() {
        assert_eq!(stripped(FILE, &[4]).1, [6]);
        assert_eq!(stripped(FILE, &[5]).1, [6]);
        // A section without a value: the line itself, never a heading.
        assert_eq!(stripped(FILE, &[8]).1, [8]);
        assert_eq!(stripped("[1016Value]\nNrOfEntries=1\n1=5\n[1]\n", &[1]).1, [1, 2, 3]);
        assert_eq!(stripped("[1016Value]\nNrOfEntries=1\n1=5\n[1]\n", &[3]).1, [3]);
        // A section that stands there twice.
        let twice = "[1000]\nParameterValue=1\n[2]\n[1000]\nParameterValue=2\n";
        assert_eq!(stripped(twice, &[4]).1, [2, 5]);
    }
}
