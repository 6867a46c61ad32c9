//! Errors of electronic data sheets.

use thiserror::Error;

use super::{MAX_SECTIONS, MAX_VARIABLES};

/// Why a file is no electronic data sheet: the line, what is wrong there, what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum EdsError {
    /// A line of no known form.
    #[error("{line}: neither a [section] nor key=value nor a comment behind `;`")]
    Line { line: u32 },
    /// A key that belongs nowhere.
    #[error("{line}: a key before the first [section]; put it into one")]
    NoSection { line: u32 },
    /// A section for the second time.
    #[error("{line}: this section stands on line {first} already; merge the two")]
    DuplicateSection { line: u32, first: u32 },
    /// A key for the second time in its section.
    #[error("{line}: this key stands on line {first} already; remove one of the two")]
    DuplicateKey { line: u32, first: u32 },
    /// A section that is named almost as an object.
    #[error("{line}: no object is called so; write four hex digits as [1018], or [1018sub1]")]
    NotAnObject { line: u32 },
    /// A sub-index of something that has none.
    #[error(
        "{line}: a sub-index, and [{index:04X}] is not there as an array or record without CompactSubObj; mend its ObjectType or remove this section"
    )]
    Orphan { line: u32, index: u16 },
    /// A section that lacks what it needs.
    #[error("{line}: the section lacks {key}; add it")]
    Missing { line: u32, key: &'static str },
    /// An object that is only listed.
    #[error(
        "{line}: object {index:#06x} is listed and not described; add its section or take it from the list"
    )]
    Undescribed { line: u32, index: u16 },
    /// The declared count differs from the number of entries.
    #[error("{line}: {key} says {said} and {found} are there; correct it")]
    Count {
        line: u32,
        key: &'static str,
        said: i128,
        found: usize,
    },
    /// Not a number.
    #[error(
        "{line}: not a number; write decimal, hex as 0x1F or octal as 017; a value adds the node-ID as $NODEID+0x80"
    )]
    Number { line: u32 },
    /// Neither a decimal fraction nor the 0x… bits of one, or not finite.
    #[error("{line}: not a finite real number")]
    Real { line: u32 },
    /// Not bytes.
    #[error("{line}: not a row of bytes; write two hex digits for each")]
    Bytes { line: u32 },
    /// A number that its place cannot hold.
    #[error("{line}: out of range; {low} to {high} fit")]
    Range { line: u32, low: i128, high: i128 },
    /// A parameter value beyond the object's own limits.
    #[error("{line}: the parameter value is beyond the object's limits {low} to {high}")]
    Limits { line: u32, low: i128, high: i128 },
    /// Not an access type.
    #[error("{line}: unknown access type; use ro, wo, rw, rwr, rww or const")]
    Access { line: u32 },
    /// Not an object type, or one that cannot be here.
    #[error(
        "{line}: object type {found} cannot be here; a variable is 0x7, an array 0x8, a record 0x9"
    )]
    ObjectType { line: u32, found: i128 },
    /// More than any device has.
    #[error("{line}: more than {MAX_VARIABLES} variables; split the file")]
    TooMany { line: u32 },
    /// More than the most variables take.
    #[error("{line}: more than {MAX_SECTIONS} sections; split the file")]
    TooManySections { line: u32 },
}
