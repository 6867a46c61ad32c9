//! Errors of electronic data sheets.

use thiserror::Error;

use super::{MAX_SECTIONS, MAX_VARIABLES};

/// Why a file is no electronic data sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{line}: {cause}")]
pub struct EdsError {
    /// The line, from 1.
    pub line: u32,
    /// What is wrong there.
    pub cause: EdsCause,
}

/// What is wrong in a line, and what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum EdsCause {
    /// A line of no known form.
    #[error("neither a [section] nor key=value nor a comment behind `;`")]
    Line,
    /// A key that belongs nowhere.
    #[error("a key before the first [section]; put it into one")]
    NoSection,
    /// A section for the second time.
    #[error("this section stands on line {first} already; merge the two")]
    DuplicateSection { first: u32 },
    /// A key for the second time in its section.
    #[error("this key stands on line {first} already; remove one of the two")]
    DuplicateKey { first: u32 },
    /// A section that is named almost as an object.
    #[error("no object is called so; write four hex digits as [1018], or [1018sub1]")]
    NotAnObject,
    /// A sub-index of something that has none.
    #[error(
        "a sub-index, and [{index:04X}] is not there as an array or record without CompactSubObj; mend its ObjectType or remove this section"
    )]
    Orphan { index: u16 },
    /// A section that lacks what it needs.
    #[error("the section lacks {key}; add it")]
    Missing { key: &'static str },
    /// An object that is only listed.
    #[error("object {index:#06x} is listed and not described; add its section or take it from the list")]
    Undescribed { index: u16 },
    /// The declared count differs from the number of entries.
    #[error("{key} says {said} and {found} are there; correct it")]
    Count { key: &'static str, said: i128, found: usize },
    /// Not a number.
    #[error("not a number; write decimal, hex as 0x1F or octal as 017; a value adds the node-ID as $NODEID+0x80")]
    Number,
    /// Neither a decimal fraction nor the 0x… bits of one, or not finite.
    #[error("not a finite real number")]
    Real,
    /// Not bytes.
    #[error("not a row of bytes; write two hex digits for each")]
    Bytes,
    /// A number that its place cannot hold.
    #[error("out of range; {low} to {high} fit")]
    Range { low: i128, high: i128 },
    /// A parameter value beyond the object's own limits.
    #[error("the parameter value is beyond the object's limits {low} to {high}")]
    Limits { low: i128, high: i128 },
    /// Not an access type.
    #[error("unknown access type; use ro, wo, rw, rwr, rww or const")]
    Access,
    /// Not an object type, or one that cannot be here.
    #[error("object type {found} cannot be here; a variable is 0x7, an array 0x8, a record 0x9")]
    ObjectType { found: i128 },
    /// More than any device has.
    #[error("more than {MAX_VARIABLES} variables; split the file")]
    TooMany,
    /// More than the most variables take.
    #[error("more than {MAX_SECTIONS} sections; split the file")]
    TooManySections,
}

impl EdsCause {
    /// The error in this line.
    pub const fn at(self, line: u32) -> EdsError {
        EdsError { line, cause: self }
    }
}
