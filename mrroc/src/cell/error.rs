//! Errors of a cell file: line, key and problem.

use std::fmt;

use thiserror::Error;

use super::locate::{self, Path};
use super::text::{printable, quoted};
use super::{Figure, Range};

/// The error of a refused cell file, in one line without control characters.
#[derive(Clone, Debug, PartialEq)]
pub struct CellError {
    /// The line, counted from 1.
    pub line: usize,
    /// The dotted key, empty where the text is not TOML.
    pub key: String,
    /// The problem.
    pub problem: Problem,
}

impl CellError {
    /// An error found by another part of the program, for a value of the right structure.
    pub fn at(text: &str, path: &Path, problem: impl fmt::Display) -> Self {
        Self {
            line: locate::line_of(text, path),
            key: path.to_string(),
            problem: Problem::Refused(problem.to_string()),
        }
    }
}

impl fmt::Display for CellError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.line)?;
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&printable(&self.problem.to_string()))
    }
}

impl std::error::Error for CellError {}

/// Problems of a cell file.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Problem {
    /// Not TOML, a key that does not exist, or a value of the wrong type.
    #[error("{0}")]
    Shape(String),
    /// NaN or infinity.
    #[error("must be a finite number")]
    NotFinite,
    /// A required key is missing.
    #[error("is missing")]
    Missing,
    /// A number outside its range.
    #[error("is {}, must be {range}", Figure(*value))]
    OutOfRange {
        /// The number.
        value: f64,
        /// The range.
        range: Range,
    },
    /// A number that is not one of the permitted ones.
    #[error("is {}, must be {expected}", Figure(*value))]
    NoneOf {
        /// The number.
        value: f64,
        /// Description of the permitted numbers.
        expected: &'static str,
    },
    /// A lower limit above its upper limit.
    #[error("is {}, not below the upper limit {}", Figure(*low), Figure(*high))]
    UpsideDown {
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// An upper limit below the model's lower limit.
    #[error("is {}, not above the lower limit {}", Figure(*high), Figure(*low))]
    BelowLow {
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// A limit outside those of the model.
    #[error("is {}, must lie within the model's limits {} and {}", Figure(*value), Figure(*low), Figure(*high))]
    BeyondModel {
        /// The limit.
        value: f64,
        /// The model's lower limit.
        low: f64,
        /// The model's upper limit.
        high: f64,
    },
    /// A text that is not a valid name.
    #[error("is {}, must be a name: {NAME_RULE}", quoted(.0))]
    NotName(String),
    /// A second use of something that must be unique.
    #[error("{what} is used twice, first by {first}")]
    Twice {
        /// The repeated value.
        what: String,
        /// The key of the first use.
        first: String,
    },
    /// A reference to an unknown name.
    #[error("no {kind} is called {}", quoted(name))]
    Unknown {
        /// Kind of the referenced object.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// An empty list that needs an element.
    #[error("has no {what}, must have at least one")]
    None {
        /// Kind of the elements.
        what: &'static str,
    },
    /// A wrong number of elements.
    #[error("has {found} {what}, must have {expected}")]
    Count {
        /// Number of elements found.
        found: usize,
        /// Number of elements expected.
        expected: usize,
        /// Kind of the elements.
        what: &'static str,
    },
    /// Too many elements.
    #[error("has {found} {what}, may have {most}")]
    TooMany {
        /// Number of elements found.
        found: usize,
        /// Greatest number of elements.
        most: usize,
        /// Kind of the elements.
        what: &'static str,
    },
    /// A key without effect at its place.
    #[error("has no effect {because}: leave it out")]
    NoEffect {
        /// The reason, as the rest of a sentence.
        because: &'static str,
    },
    /// A refusal by another part of the program.
    #[error("{0}")]
    Refused(String),
}

/// Rule for names, as part of a message.
pub(super) const NAME_RULE: &str =
    "1 to 64 letters of A to Z, digits, - and _, of which the first is a letter or a digit";
