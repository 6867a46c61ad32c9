//! Values of objects: conversion from command line to bytes, and from bytes to text.

use std::fmt;

use clap::ValueEnum;
use mrroc::report::counted;
use serde::Serialize;
use thiserror::Error;

/// The types of a value: data types of CiA 301, and plain bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Type {
    /// BOOLEAN.
    Bool,
    /// UNSIGNED8.
    U8,
    /// UNSIGNED16.
    U16,
    /// UNSIGNED32.
    U32,
    /// UNSIGNED64.
    U64,
    /// INTEGER8.
    I8,
    /// INTEGER16.
    I16,
    /// INTEGER32.
    I32,
    /// INTEGER64.
    I64,
    /// REAL32.
    F32,
    /// REAL64.
    F64,
    /// VISIBLE_STRING.
    String,
    /// Bytes in the order of transmission, two hexadecimal digits each.
    Hex,
}

/// Reason why a text is not a value of a type.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub(super) enum ValueError {
    /// Not a number, or a number outside the range of the type.
    #[error("{text:?} is no {ty}: {least} to {most}, decimal or 0x…")]
    Number { text: String, ty: String, least: i128, most: i128 },
    #[error("{0:?} is no real number")]
    Real(String),
    #[error("{0:?} are no bytes: two hexadecimal digits each, such as 7f00")]
    Bytes(String),
    /// A character outside ASCII.
    #[error("{0:?} has a character outside ASCII")]
    Text(String),
}

impl Type {
    /// Size of a number, bytes; `None` for types of variable length.
    pub(super) const fn bytes(self) -> Option<usize> {
        match self {
            Self::Bool | Self::U8 | Self::I8 => Some(1),
            Self::U16 | Self::I16 => Some(2),
            Self::U32 | Self::I32 | Self::F32 => Some(4),
            Self::U64 | Self::I64 | Self::F64 => Some(8),
            Self::String | Self::Hex => None,
        }
    }

    const fn is_signed(self) -> bool {
        matches!(self, Self::I8 | Self::I16 | Self::I32 | Self::I64)
    }

    /// Name on the command line.
    fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Converts `text` to bytes in the order of transmission. For a signed type, 0x… may be the bit pattern.
    pub(super) fn encode(self, text: &str) -> Result<Vec<u8>, ValueError> {
        match self {
            Self::String if text.is_ascii() => Ok(text.as_bytes().to_owned()),
            Self::String => Err(ValueError::Text(text.to_owned())),
            Self::Hex => bytes(text).ok_or_else(|| ValueError::Bytes(text.to_owned())),
            Self::F32 => match text.parse::<f32>() {
                Ok(real) if real.is_finite() => Ok(real.to_le_bytes().to_vec()),
                _ => Err(ValueError::Real(text.to_owned())),
            },
            Self::F64 => match text.parse::<f64>() {
                Ok(real) if real.is_finite() => Ok(real.to_le_bytes().to_vec()),
                _ => Err(ValueError::Real(text.to_owned())),
            },
            Self::Bool | Self::U8 | Self::U16 | Self::U32 | Self::U64 => self.integer(text),
            Self::I8 | Self::I16 | Self::I32 | Self::I64 => self.integer(text),
        }
    }

    fn integer(self, text: &str) -> Result<Vec<u8>, ValueError> {
        let size = self.bytes().expect("integers have sizes");
        let bits = 8 * size as u32;
        let (least, most) = match (self, self.is_signed()) {
            (Self::Bool, _) => (0, 1),
            (_, true) => (-(1_i128 << (bits - 1)), (1_i128 << (bits - 1)) - 1),
            (_, false) => (0, (1_i128 << bits) - 1),
        };
        let fits = |(value, hexadecimal): &(i128, bool)| {
            let as_bits = *hexadecimal && self.is_signed() && (0..1_i128 << bits).contains(value);
            (least..=most).contains(value) || as_bits
        };
        let refused = || ValueError::Number { text: text.to_owned(), ty: self.name(), least, most };
        let (value, _) = integer(text).filter(fits).ok_or_else(refused)?;
        Ok(value.to_le_bytes()[..size].to_vec())
    }
}

/// Parses an integer, decimal or hexadecimal, with optional sign and `_` between groups of digits. A decimal number has
/// no leading zeros. Also returns whether the number is hexadecimal.
fn integer(text: &str) -> Option<(i128, bool)> {
    let digits = text.replace('_', "");
    let (negative, digits) = match digits.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, digits.as_str()),
    };
    let hexadecimal = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    // A second sign is refused.
    if digits.starts_with(['+', '-']) || hexadecimal.is_some_and(|digits| digits.starts_with('+')) {
        return None;
    }
    // A number such as 017 is refused: data sheets write octal 15 this way, and other readers understand 17.
    if hexadecimal.is_none() && digits.len() > 1 && digits.starts_with('0') {
        return None;
    }
    let value = match hexadecimal {
        Some(digits) => i128::from_str_radix(digits, 16).ok()?,
        None => digits.parse().ok()?,
    };
    Some((if negative { -value } else { value }, hexadecimal.is_some()))
}

/// Parses an unsigned number on the command line, decimal or hexadecimal.
pub(super) fn number(text: &str) -> Option<u64> {
    integer(text).and_then(|(value, _)| u64::try_from(value).ok())
}

fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|byte| *byte != b' ').collect();
    let pairs = digits.chunks(2).map(|pair| {
        let pair = str::from_utf8(pair).ok().filter(|pair| pair.len() == 2)?;
        pair.bytes().all(|digit| digit.is_ascii_hexdigit()).then(|| u8::from_str_radix(pair, 16).ok())?
    });
    pairs.collect()
}

/// Unsigned value of little-endian bytes; `None` unless there are 1 to 8.
pub(super) fn unsigned(data: &[u8]) -> Option<u64> {
    let mut bytes = [0; 8];
    bytes.get_mut(..data.len())?.copy_from_slice(data);
    (!data.is_empty()).then_some(u64::from_le_bytes(bytes))
}

/// Signed value of little-endian bytes; `None` unless there are 1 to 8.
pub(super) fn signed(data: &[u8]) -> Option<i64> {
    unsigned(data).map(|raw| {
        let unused = 64 - 8 * data.len() as u32;
        (raw << unused) as i64 >> unused
    })
}

/// A value in all plausible representations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Shown {
    /// Bytes in the order of transmission, two hexadecimal digits each.
    pub(super) bytes: String,
    /// Value as an integer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) value: Option<i128>,
    /// Value as a real number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) real: Option<f64>,
    /// Value as text.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) text: Option<String>,
    /// The representations in one line.
    #[serde(skip)]
    line: String,
}

impl Shown {
    /// Without a type, 1, 2, 4 or 8 bytes are a number. Four or more bytes are also text if they are printable.
    ///
    /// `is_signed` says whether an object without a type is known to hold a signed number.
    pub(super) fn of(data: &[u8], ty: Option<Type>, is_signed: bool) -> Self {
        let sized = ty.map_or(matches!(data.len(), 1 | 2 | 4 | 8), |ty| ty.bytes() == Some(data.len()));
        let real = match (ty, data) {
            (Some(Type::F32), &[a, b, c, d]) => Some(f64::from(f32::from_le_bytes([a, b, c, d]))),
            (Some(Type::F64), &[a, b, c, d, e, f, g, h]) => Some(f64::from_le_bytes([a, b, c, d, e, f, g, h])),
            _ => None,
        };
        let raw = unsigned(data).filter(|_| sized && real.is_none());
        let as_signed = raw.and_then(|_| signed(data));
        let is_signed = ty.map_or(is_signed, Type::is_signed);
        let value = if is_signed { as_signed.map(i128::from) } else { raw.map(i128::from) };
        let text = match ty {
            Some(Type::String) => Some(String::from_utf8_lossy(data)),
            None if data.len() >= 4 => printable(data),
            _ => None,
        };
        let text = text.map(|text| text.trim_end_matches('\0').to_owned());
        let bytes: String = data.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut line = match (raw, value, real) {
            (Some(raw), Some(value), _) => format!("{raw:#0width$x}, {value}", width = 2 + 2 * data.len()),
            (_, _, Some(real)) => real.to_string(),
            _ if data.is_empty() => "no bytes".to_owned(),
            _ => format!("{} {bytes}", counted(data.len(), "byte")),
        };
        // The sign of the type is not known.
        if let Some(or @ ..0) = as_signed.filter(|_| ty.is_none() && !is_signed) {
            line += &format!(" or {or}");
        }
        match &text {
            Some(text) if ty == Some(Type::String) => line = format!("{text:?}"),
            Some(text) => line += &format!(", {text:?}"),
            None => {}
        }
        Self { bytes, value, real, text, line }
    }
}

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.line)
    }
}

fn printable(data: &[u8]) -> Option<std::borrow::Cow<'_, str>> {
    let end = data.iter().rposition(|byte| *byte != 0)? + 1;
    let text = &data[..end];
    text.iter().all(|byte| matches!(byte, b' '..=b'~')).then(|| String::from_utf8_lossy(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_become_the_bytes_of_their_type() {
        let table: [(Type, &str, &[u8]); 18] = [
            (Type::U8, "255", &[0xFF]),
            (Type::U8, "0", &[0]),
            (Type::U8, "0x0F", &[0x0F]),
            (Type::U16, "0x6041", &[0x41, 0x60]),
            (Type::U32, "1_000_000", &[0x40, 0x42, 0x0F, 0x00]),
            (Type::I8, "-1", &[0xFF]),
            (Type::I16, "-0x10", &[0xF0, 0xFF]),
            (Type::I32, "-2", &[0xFE, 0xFF, 0xFF, 0xFF]),
            (Type::I32, "0xFFFFFFFE", &[0xFE, 0xFF, 0xFF, 0xFF]),
            (Type::U64, "0xFFFFFFFFFFFFFFFF", &[0xFF; 8]),
            (Type::I64, "-9223372036854775808", &[0, 0, 0, 0, 0, 0, 0, 0x80]),
            (Type::Bool, "1", &[1]),
            (Type::F32, "1.5", &[0x00, 0x00, 0xC0, 0x3F]),
            (Type::F64, "-2", &[0, 0, 0, 0, 0, 0, 0x00, 0xC0]),
            (Type::String, "save", b"save"),
            (Type::String, "", b""),
            (Type::Hex, "7f00Ab", &[0x7F, 0x00, 0xAB]),
            (Type::Hex, "7f 00", &[0x7F, 0x00]),
        ];
        for (ty, text, bytes) in table {
            assert_eq!(ty.encode(text).as_deref(), Ok(bytes), "{ty:?} {text}");
        }
    }

    #[test]
    fn what_a_type_does_not_hold_is_refused() {
        let table = [
            (Type::U8, "256"),
            (Type::U8, "-1"),
            (Type::U8, "0x100"),
            (Type::I8, "128"),
            (Type::I8, "0x100"),
            (Type::I16, "-32769"),
            (Type::U16, ""),
            (Type::U16, "--1"),
            (Type::U16, "+1"),
            (Type::U16, "017"),
            (Type::I16, "-017"),
            (Type::U16, "00"),
            (Type::U16, "0x-1"),
            (Type::U16, "0x+1"),
            (Type::U16, "1.0"),
            (Type::U64, "0x10000000000000000"),
            (Type::Bool, "2"),
            (Type::F32, "nan"),
            (Type::F32, "1e39"),
            (Type::F64, "inf"),
            (Type::F64, ""),
            (Type::String, "zażółć"),
            (Type::Hex, "7f0"),
            (Type::Hex, "7g"),
            (Type::Hex, "+f"),
        ];
        for (ty, text) in table {
            assert!(ty.encode(text).is_err(), "{ty:?} {text}");
        }
        let error = Type::I8.encode("200").unwrap_err();
        assert_eq!(error.to_string(), "\"200\" is no i8: -128 to 127, decimal or 0x…");
    }

    #[test]
    fn bytes_are_shown_in_every_way_that_makes_sense() {
        let table: [(&[u8], Option<Type>, bool, &str); 12] = [
            (&[0x37, 0x02], None, false, "0x0237, 567"),
            (&[0xFE, 0xFF], None, false, "0xfffe, 65534 or -2"),
            (&[0xFE, 0xFF], None, true, "0xfffe, -2"),
            (&[0xFE, 0xFF], Some(Type::U16), false, "0xfffe, 65534"),
            (&[0xFE, 0xFF], Some(Type::I16), false, "0xfffe, -2"),
            (b"save", None, false, "0x65766173, 1702257011, \"save\""),
            (b"EPOS4\0\0", None, false, "7 bytes 45504f53340000, \"EPOS4\""),
            (b"EPOS4", Some(Type::String), false, "\"EPOS4\""),
            (&[1, 2, 3], None, false, "3 bytes 010203"),
            (&[1, 2, 3], Some(Type::U16), false, "3 bytes 010203"),
            (&[0x00, 0x00, 0xC0, 0x3F], Some(Type::F32), false, "1.5"),
            (&[], None, false, "no bytes"),
        ];
        for (data, ty, is_signed, text) in table {
            assert_eq!(Shown::of(data, ty, is_signed).to_string(), text);
        }
    }
}
