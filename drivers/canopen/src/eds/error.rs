//! Errors of electronic data sheets: why a file is refused, and flaws of a file that was read.

use std::fmt::{self, Display, Formatter};
use std::mem::discriminant;

use thiserror::Error;

use super::{MAX_SECTIONS, MAX_VARIABLES};
use crate::Object;

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
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum EdsCause {
    #[error("neither a [section] nor key=value nor a comment behind `;`")]
    Line,
    #[error("a key before the first [section]; put it into one")]
    NoSection,
    #[error("this section stands on line {first} already; merge the two")]
    DuplicateSection { first: u32 },
    #[error("this key stands on line {first} already; remove one of the two")]
    DuplicateKey { first: u32 },
    #[error("a comment begins with `;`, not with `#`; change its first character")]
    Hash,
    #[error("not a plain number; leave out suffixes as in 0x10UL and 0.5f and comments behind `#`, and write $NODEID")]
    Spelling,
    #[error("no object is called so; write four hex digits as [1018], or [1018sub1]")]
    NotAnObject,
    #[error(
        "a sub-index, and [{index:04X}] is not there as an array or record without CompactSubObj; mend its ObjectType or remove this section"
    )]
    Orphan { index: u16 },
    #[error("the section lacks {key}; add it")]
    Missing { key: &'static str },
    #[error("object {index:#06x} is listed and not described; add its section or take it from the list")]
    Undescribed { index: u16 },
    #[error("object {index:#06x} is described and not listed; add it to the list of its kind")]
    Unlisted { index: u16 },
    #[error("{key} says {said} and {found} are there; correct it")]
    Count { key: &'static str, said: i128, found: usize },
    #[error("not a number; write decimal, hex as 0x1F or octal as 017; a value adds the node-ID as $NODEID+0x80")]
    Number,
    /// Neither a decimal fraction nor the 0x… bits of one, or not finite.
    #[error("not a finite real number")]
    Real,
    #[error("not a row of bytes; write two hex digits for each")]
    Bytes,
    #[error("out of range; {low} to {high} fit")]
    Range { low: i128, high: i128 },
    #[error("the parameter value is beyond the object's limits {low} to {high}")]
    Limits { low: i128, high: i128 },
    #[error("unknown access type; use ro, wo, rw, rwr, rww or const")]
    Access,
    #[error("object type {found} cannot be here; a variable is 0x7, an array 0x8, a record 0x9")]
    ObjectType { found: i128 },
    #[error("more than {MAX_VARIABLES} variables; split the file")]
    TooMany,
    #[error("more than {MAX_SECTIONS} sections; split the file")]
    TooManySections,
}

/// A line that is not as the standard has it, in a file that was read nevertheless.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flaw {
    /// The line and its error.
    pub error: EdsError,
    /// What depends on the line. This part is absent from what was read, or ambiguous.
    pub part: Part,
    /// A value that the file states for its device depends on the line.
    pub stated: bool,
}

/// The part of a data sheet that depends on a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Nothing that this reader reads.
    Nothing,
    /// Node-ID or bit rate in `[DeviceComissioning]`.
    Place,
    /// Vendor-ID, product code or revision number in `[DeviceInfo]`.
    Identity,
    /// All variables of an object.
    Entry(u16),
    /// A variable.
    Variable(Object),
    /// The default of a variable.
    Default(Object),
    /// The limits of a variable.
    Limits(Object),
}

/// The lines with one kind of error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlawedLines {
    /// The first line and its error.
    pub first: EdsError,
    /// The other lines, ascending.
    pub further: Vec<u32>,
}

impl FlawedLines {
    /// The errors by kind, in the order of their first lines. The errors are in ascending order of their lines.
    pub fn of(errors: impl IntoIterator<Item = EdsError>) -> Vec<Self> {
        let mut kinds: Vec<Self> = Vec::new();
        for error in errors {
            let kind = |known: &&mut Self| discriminant(&known.first.cause) == discriminant(&error.cause);
            match kinds.iter_mut().find(kind) {
                Some(known) => known.further.push(error.line),
                None => kinds.push(Self { first: error, further: Vec::new() }),
            }
        }
        kinds
    }
}

impl Display for FlawedLines {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.first)?;
        for (at, line) in self.further.iter().enumerate() {
            match at {
                0 => write!(f, "; the same kind in {} further lines: {line}", self.further.len())?,
                _ => write!(f, ", {line}")?,
            }
        }
        Ok(())
    }
}

impl EdsCause {
    /// The error in this line.
    pub const fn at(self, line: u32) -> EdsError {
        EdsError { line, cause: self }
    }
}
