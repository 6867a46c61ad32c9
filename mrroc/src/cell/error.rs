//! What a refused cell file is refused for: the line, the key, the problem.

use std::fmt;

use thiserror::Error;

use super::locate::{self, Path};
use super::text::{printable, quoted};
use super::{Figure, Range};

/// A refused cell file: where and why, in one line that has no effect on a terminal.
#[derive(Clone, Debug, PartialEq)]
pub struct CellError {
    /// The line, from 1.
    pub line: usize,
    /// The dotted key, empty where the text is not TOML.
    pub key: String,
    /// What is wrong.
    pub problem: Problem,
}

impl CellError {
    /// The error of a value that is in its shape but cannot be used, found by another part of the program.
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

/// What can be wrong with a cell file.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Problem {
    /// Not TOML, a key that does not exist, or a value of the wrong type.
    #[error("{0}")]
    Shape(String),
    /// NaN or infinity.
    #[error("must be a finite number")]
    NotFinite,
    /// A required key that is not there.
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
    /// A number that is none of those possible.
    #[error("is {}, must be {expected}", Figure(*value))]
    NoneOf {
        /// The number.
        value: f64,
        /// Those possible, in words.
        expected: &'static str,
    },
    /// Limits upside down.
    #[error("is {}, not below the upper limit {}", Figure(*low), Figure(*high))]
    UpsideDown {
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// An upper limit below the lower one that the model has.
    #[error("is {}, not above the lower limit {}", Figure(*high), Figure(*low))]
    BelowLow {
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// A limit outside those that the model has.
    #[error("is {}, must lie within the model's limits {} and {}", Figure(*value), Figure(*low), Figure(*high))]
    BeyondModel {
        /// The limit.
        value: f64,
        /// The model's lower limit.
        low: f64,
        /// The model's upper limit.
        high: f64,
    },
    /// A text that is no name.
    #[error("is {}, must be a name: {NAME_RULE}", quoted(.0))]
    NotName(String),
    /// A second use of something that must be unique.
    #[error("{what} is used twice, first by {first}")]
    Twice {
        /// What is used twice.
        what: String,
        /// The key that used it first.
        first: String,
    },
    /// A name that nothing bears.
    #[error("no {kind} is called {}", quoted(name))]
    Unknown {
        /// What was looked for.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// An empty list that must have an element.
    #[error("has no {what}, must have at least one")]
    None {
        /// Of what.
        what: &'static str,
    },
    /// A wrong number of things.
    #[error("has {found} {what}, must have {expected}")]
    Count {
        /// How many there are.
        found: usize,
        /// How many there must be.
        expected: usize,
        /// Of what.
        what: &'static str,
    },
    /// Too many things.
    #[error("has {found} {what}, may have {most}")]
    TooMany {
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
        /// Of what.
        what: &'static str,
    },
    /// A key that means nothing where it stands.
    #[error("has no effect {because}: leave it out")]
    NoEffect {
        /// Why, as the rest of a sentence.
        because: &'static str,
    },
    /// Something that another part of the program refused.
    #[error("{0}")]
    Refused(String),
}

/// What a name is made of, in the words of a message.
pub(super) const NAME_RULE: &str =
    "1 to 64 letters of A to Z, digits, - and _, of which the first is a letter or a digit";
