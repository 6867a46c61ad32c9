//! Values of objects in electronic data sheets.

use std::fmt;

use super::ini::{self, Text};
use super::{DataType, EdsCause, EdsError};
use crate::NodeId;

/// A default, a limit or a parameter value of a variable.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Value {
    /// Of the integer types and BOOLEAN: a number, to which the node-ID is added where the file says `$NODEID`.
    Integer { value: i128, plus_node: bool },
    /// Of REAL32 and REAL64: finite.
    Real(f64),
    /// Of VISIBLE_STRING and UNICODE_STRING, and of the types that have no value syntax, as it stands in the file.
    Text(String),
    /// Of OCTET_STRING.
    Bytes(Vec<u8>),
}

impl Value {
    /// A plain number.
    pub const fn number(value: i128) -> Self {
        Self::Integer { value, plus_node: false }
    }

    /// The number, at a device with this node-ID; `None` if it is none.
    pub fn integer(&self, node: NodeId) -> Option<i128> {
        match self {
            Self::Integer { value, plus_node } => Some(value + i128::from(*plus_node) * i128::from(node.raw())),
            Self::Real(_) | Self::Text(_) | Self::Bytes(_) => None,
        }
    }

    /// The value as it goes over the bus; `None` for a type without known layout, and for a value that does not fit
    /// the type, which no file yields.
    pub fn encode(&self, data_type: DataType, node: NodeId) -> Option<Vec<u8>> {
        match self {
            Self::Integer { .. } => {
                let (low, high) = data_type.range()?;
                let value = self.integer(node).filter(|v| (low..=high).contains(v))?;
                Some(value.to_le_bytes()[..data_type.size()?].to_vec())
            }
            Self::Real(value) => match data_type {
                DataType::Real32 => Some((*value as f32).to_le_bytes().to_vec()),
                DataType::Real64 => Some(value.to_le_bytes().to_vec()),
                _ => None,
            },
            // ISO 8859-1, one byte each.
            Self::Text(text) if data_type == DataType::VisibleString => {
                text.chars().map(|letter| u8::try_from(u32::from(letter)).ok()).collect()
            }
            Self::Text(text) if data_type == DataType::UnicodeString => {
                Some(text.encode_utf16().flat_map(u16::to_le_bytes).collect())
            }
            Self::Text(_) => None,
            Self::Bytes(bytes) => Some(bytes.clone()),
        }
    }

    /// The value that came over the bus as these bytes; `None` if it has another size than its type, or no line of a file
    /// can hold it. A device may send four bytes for a shorter number (CiA 301 §7.2.4.3.5), and zeros behind a text.
    pub fn decode(data_type: DataType, data: &[u8]) -> Option<Self> {
        let size = data_type.size();
        let data = match size {
            Some(size) if data.len() == size || data.len() == 4 && size < 4 => data.get(..size)?,
            Some(_) => return None,
            None => data,
        };
        let value = match data_type {
            DataType::Real32 => Self::Real(f64::from(f32::from_le_bytes(data.try_into().ok()?))),
            DataType::Real64 => Self::Real(f64::from_le_bytes(data.try_into().ok()?)),
            DataType::OctetString => Self::Bytes(data.to_owned()),
            DataType::VisibleString => {
                let end = data.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
                Self::Text(data[..end].iter().map(|&byte| char::from(byte)).collect())
            }
            _ => {
                let (low, high) = data_type.range()?;
                let bits = data.iter().rev().fold(0_i128, |bits, byte| bits << 8 | i128::from(*byte));
                let value = if low < 0 && bits > high { bits + low - high - 1 } else { bits };
                Self::number(value)
            }
        };
        // A text may look like a comment or end in a space, and a number may not be finite.
        let text = value.to_string();
        let line = ini::uncommented(&text);
        let read = Self::parse(data_type, Text { line: 0, text: line }).ok().filter(|_| !line.is_empty());
        read.filter(|read| *read == value && !text.contains(char::is_control))
    }

    /// A default or a limit, with the error of its line. A number whose meaning is certain is read in other spellings as
    /// well.
    pub(super) fn read(data_type: DataType, text: Text<'_>) -> (Option<Self>, Option<EdsError>) {
        match Self::parse(data_type, text) {
            Ok(value) => (Some(value), None),
            Err(error) => {
                let plain = plain(data_type, text.text);
                let value = plain.and_then(|plain| Self::parse(data_type, Text { text: &plain, ..text }).ok());
                let error = if value.is_some() { EdsCause::Spelling.at(text.line) } else { error };
                (value, Some(error))
            }
        }
    }

    pub(super) fn parse(data_type: DataType, text: Text<'_>) -> Result<Self, EdsError> {
        let Text { line, text } = text;
        match data_type {
            DataType::Real32 | DataType::Real64 => real(data_type, text).map(Self::Real).ok_or(EdsCause::Real.at(line)),
            DataType::OctetString => bytes(text).map(Self::Bytes).ok_or(EdsCause::Bytes.at(line)),
            _ => match data_type.range() {
                Some(range) => integer(range, line, text),
                None => Ok(Self::Text(text.to_owned())),
            },
        }
    }
}

/// As a data sheet has it.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // A number of this size is a COB-ID, a mapping, an identity or a mask.
            Self::Integer { value: value @ 0x1_0000.., plus_node: false } => write!(f, "{value:#010x}"),
            Self::Integer { value, plus_node: false } => write!(f, "{value}"),
            Self::Integer { value: value @ ..0, plus_node: true } => write!(f, "$NODEID+{value}"),
            Self::Integer { value, plus_node: true } => write!(f, "$NODEID+{value:#x}"),
            Self::Real(value) => write!(f, "{value:?}"),
            Self::Text(text) => f.write_str(text),
            Self::Bytes(bytes) => bytes.iter().try_for_each(|byte| write!(f, "{byte:02X}")),
        }
    }
}

/// A number as the standard writes it, of one with a comment behind `#`, with the suffix of a C literal, or with another
/// name of the node-ID; `None` if it has none of these.
fn plain(data_type: DataType, text: &str) -> Option<String> {
    const NAMES: [&str; 2] = ["$MY_NODE_ID", "$NODE_ID"];
    let mut plain = text.split('#').next().unwrap_or(text).trim().to_owned();
    for name in NAMES {
        if let Some(at) = plain.to_ascii_uppercase().find(name) {
            plain.replace_range(at..at + name.len(), "$NODEID");
        }
    }
    let is_hex = plain.starts_with("0x") || plain.starts_with("0X");
    let suffix: &[char] = match data_type {
        DataType::Real32 | DataType::Real64 if is_hex => &[],
        DataType::Real32 | DataType::Real64 => &['f', 'F', 'l', 'L'],
        _ => &['u', 'U', 'l', 'L'],
    };
    let letters = plain.len() - plain.trim_end_matches(suffix).len();
    if !plain.to_ascii_uppercase().ends_with("$NODEID") && letters <= 3 {
        plain.truncate(plain.len() - letters);
    }
    (plain != text).then_some(plain)
}

/// A decimal, hexadecimal or octal number (CiA 306-1 §6.3), with a sign in front if it is below zero.
pub(super) fn number(text: &str) -> Option<i128> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (digits, radix) = match digits.as_bytes() {
        [b'0', b'x' | b'X', ..] => (&digits[2..], 16),
        [b'0', _, ..] => (&digits[1..], 8),
        _ => (digits, 10),
    };
    // The parser of the standard library would take a second sign.
    if !digits.starts_with(|first: char| first.is_ascii_hexdigit()) {
        return None;
    }
    let value = i128::from(u64::from_str_radix(digits, radix).ok()?);
    Some(if negative { -value } else { value })
}

fn integer((low, high): (i128, i128), line: u32, text: &str) -> Result<Value, EdsError> {
    let error = EdsCause::Number.at(line);
    let (text, plus_node) = without_node_id(text).ok_or(error)?;
    let value = if text.is_empty() && plus_node { 0 } else { number(text).ok_or(error)? };
    // The bits of a negative number.
    let bits = text.starts_with("0x") || text.starts_with("0X");
    let value = if bits && low < 0 && value > high && value <= high - low { value + low - high - 1 } else { value };
    let room = if plus_node { i128::from(NodeId::MAX.raw()) } else { 0 };
    let high = high - room;
    if (low..=high).contains(&value) {
        Ok(Value::Integer { value, plus_node })
    } else {
        Err(EdsCause::Range { low, high }.at(line))
    }
}

/// What is left of `$NODEID+0x80` or `0x80+$NODEID`, and whether it was one; `None` if it stands elsewhere. The
/// standard has the first form only (CiA 306-1 §6.3).
fn without_node_id(text: &str) -> Option<(&str, bool)> {
    const NODE_ID: &str = "$NODEID";
    let at = |from: usize| text.get(from..from + NODE_ID.len());
    let is_node_id = |part: Option<&str>| part.is_some_and(|p| p.eq_ignore_ascii_case(NODE_ID));
    if is_node_id(at(0)) {
        let rest = text[NODE_ID.len()..].trim_start();
        return match rest.strip_prefix('+') {
            Some(rest) if !rest.trim().is_empty() => Some((rest.trim(), true)),
            Some(_) => None,
            None => rest.is_empty().then_some(("", true)),
        };
    }
    let Some(end) = text.len().checked_sub(NODE_ID.len()) else {
        return Some((text, false));
    };
    if is_node_id(at(end)) {
        let rest = text[..end].trim_end().strip_suffix('+')?.trim_end();
        return (!rest.is_empty()).then_some((rest, true));
    }
    Some((text, false))
}

fn real(data_type: DataType, text: &str) -> Option<f64> {
    let bits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let value = match (bits, data_type) {
        (Some(bits), DataType::Real32) => f64::from(f32::from_bits(u32::from_str_radix(bits, 16).ok()?)),
        (Some(bits), _) => f64::from_bits(u64::from_str_radix(bits, 16).ok()?),
        (None, _) => text.parse().ok()?,
    };
    let fits = match data_type {
        DataType::Real32 => (value as f32).is_finite(),
        _ => value.is_finite(),
    };
    fits.then_some(value)
}

/// Pairs of hexadecimal digits without a prefix (CiA 306-1 §6.3). Spaces between the digits are ignored.
fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text
        .bytes()
        .filter(|byte| !byte.is_ascii_whitespace())
        .map(|byte| Some(char::from(byte).to_digit(16)? as u8))
        .collect::<Option<_>>()?;
    let pairs = digits.chunks_exact(2);
    pairs.remainder().is_empty().then(|| pairs.map(|pair| pair[0] << 4 | pair[1]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(data_type: DataType, text: &str) -> Result<Value, EdsError> {
        Value::parse(data_type, Text { line: 7, text })
    }

    fn plus_node(value: i128) -> Value {
        Value::Integer { value, plus_node: true }
    }

    #[test]
    fn numbers_are_decimal_hex_or_octal_and_may_add_the_node_id() {
        use DataType::{Boolean, Integer8, Integer32, Integer64, Unsigned8, Unsigned32, Unsigned64};
        let table = [
            (Unsigned32, "42", Value::number(42)),
            (Unsigned32, "0x2a", Value::number(42)),
            (Unsigned32, "0X2A", Value::number(42)),
            (Unsigned32, "052", Value::number(42)),
            (Unsigned32, "0", Value::number(0)),
            (Unsigned32, "000000", Value::number(0)),
            (Unsigned8, "255", Value::number(255)),
            (Boolean, "1", Value::number(1)),
            (Integer8, "-3", Value::number(-3)),
            (Integer8, "+3", Value::number(3)),
            (Integer8, "0xFD", Value::number(-3)),
            (Integer32, "0x80000000", Value::number(-0x8000_0000)),
            (Integer32, "0x7FFFFFFF", Value::number(0x7FFF_FFFF)),
            (Unsigned64, "0xFFFFFFFFFFFFFFFF", Value::number(u64::MAX.into())),
            (Integer64, "-9223372036854775808", Value::number(i64::MIN.into())),
            (Unsigned32, "$NODEID+0x40000180", plus_node(0x4000_0180)),
            (Unsigned32, "$nodeid + 384", plus_node(384)),
            (Unsigned32, "0x600+$NODEID", plus_node(0x600)),
            (Unsigned32, "$NODEID", plus_node(0)),
            (Integer8, "$NODEID+0x90", plus_node(-112)),
        ];
        for (data_type, text, value) in table {
            assert_eq!(parse(data_type, text).as_ref(), Ok(&value), "{text}");
            assert_eq!(parse(data_type, &value.to_string()), Ok(value), "{text} as it is written");
        }
    }

    #[test]
    fn what_is_no_number_or_does_not_fit_is_refused() {
        let number = EdsCause::Number.at(7);
        let range = |low, high| EdsCause::Range { low, high }.at(7);
        let table = [
            (DataType::Unsigned32, "0x", number),
            (DataType::Unsigned32, "08", number),
            (DataType::Unsigned32, "--1", number),
            (DataType::Unsigned32, "0x-1", number),
            (DataType::Unsigned32, "1 2", number),
            (DataType::Unsigned32, "ten", number),
            (DataType::Unsigned32, "$NODEID-1", number),
            (DataType::Unsigned32, "$NODEID+", number),
            (DataType::Unsigned32, "+$NODEID", number),
            (DataType::Unsigned32, "$NODEID+$NODEID", number),
            (DataType::Unsigned64, "18446744073709551616", number),
            (DataType::Unsigned8, "256", range(0, 255)),
            (DataType::Unsigned8, "-1", range(0, 255)),
            (DataType::Unsigned8, "$NODEID+200", range(0, 128)),
            (DataType::Integer8, "128", range(-128, 127)),
            (DataType::Integer8, "0x100", range(-128, 127)),
            (DataType::Boolean, "2", range(0, 1)),
        ];
        for (data_type, text, error) in table {
            assert_eq!(parse(data_type, text), Err(error), "{text}");
        }
        for text in ["nan", "inf", "1e39", "x", "0x7F800000"] {
            assert_eq!(parse(DataType::Real32, text), Err(EdsCause::Real.at(7)));
        }
        for text in ["1", "1G", "é1"] {
            assert_eq!(parse(DataType::OctetString, text), Err(EdsCause::Bytes.at(7)));
        }
    }

    #[test]
    fn values_from_the_bus_are_those_that_a_file_can_hold() {
        let decode = |data_type, data: &[u8]| Value::decode(data_type, data).map(|value| value.to_string());
        let table: [(DataType, &[u8], Option<&str>); 15] = [
            (DataType::Integer8, &[0xFD], Some("-3")),
            (DataType::Integer16, &[0xFE, 0xFF, 0, 0], Some("-2")),
            (DataType::Unsigned16, &[1, 2, 3], None),
            (DataType::Unsigned32, &[1, 2, 3, 4], Some("0x04030201")),
            (DataType::Unsigned64, &[0xFF; 8], Some("0xffffffffffffffff")),
            (DataType::Integer64, &[0xFF; 8], Some("-1")),
            (DataType::Boolean, &[1], Some("1")),
            (DataType::Boolean, &[0x10], None),
            (DataType::Real32, &[0, 0, 0xC0, 0x3F], Some("1.5")),
            (DataType::Real32, &[0, 0, 0x80, 0x7F], None),
            (DataType::VisibleString, b"EPOS4\0\0", Some("EPOS4")),
            (DataType::VisibleString, b"two\nlines", None),
            (DataType::VisibleString, b"a ; b", None),
            (DataType::OctetString, &[1, 0xAF], Some("01AF")),
            (DataType::Domain, &[1], None),
        ];
        for (data_type, data, text) in table {
            assert_eq!(decode(data_type, data).as_deref(), text, "{data_type:?} {data:?}");
        }
    }

    #[test]
    fn values_go_over_the_bus_as_these_bytes() {
        let node = NodeId::new(5).unwrap();
        let table: [(DataType, &str, &[u8]); 11] = [
            (DataType::Boolean, "1", &[1]),
            (DataType::Integer16, "-2", &[0xFE, 0xFF]),
            (DataType::Unsigned24, "0x123456", &[0x56, 0x34, 0x12]),
            (DataType::Unsigned32, "$NODEID+0x80000200", &[0x05, 0x02, 0x00, 0x80]),
            (DataType::Integer64, "-2", &[0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]),
            (DataType::Real32, "1.5", &[0, 0, 0xC0, 0x3F]),
            (DataType::Real32, "0x3FC00000", &[0, 0, 0xC0, 0x3F]),
            (DataType::Real64, "-2", &[0, 0, 0, 0, 0, 0, 0, 0xC0]),
            (DataType::VisibleString, "Sm\u{f8}r", b"Sm\xF8r"),
            (DataType::UnicodeString, "\u{3c0}", &[0xC0, 0x03]),
            (DataType::OctetString, "01 aF", &[0x01, 0xAF]),
        ];
        for (data_type, text, bytes) in table {
            let value = parse(data_type, text).unwrap();
            assert_eq!(value.encode(data_type, node).as_deref(), Some(bytes), "{text}");
            let again = parse(data_type, &value.to_string());
            assert_eq!(again.as_ref(), Ok(&value), "{text}");
        }
        let text = parse(DataType::VisibleString, "\u{3c0}").unwrap();
        assert_eq!(text.encode(DataType::VisibleString, node), None);
        let domain = parse(DataType::Domain, "0").unwrap();
        assert_eq!(domain.encode(DataType::Domain, node), None);
    }
}
