//! Errors of a cell file: line, key and problem.

use std::fmt::Display;

use thiserror::Error;

use super::locate::{self, Path};
use super::text::printable;

/// The error of a refused cell file, in one line without control characters.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{line}: {key}{}{}", if .key.is_empty() { "" } else { ": " }, printable(.problem))]
pub struct CellError {
    /// The line, counted from 1.
    pub line: usize,
    /// The dotted key, empty where the text is not TOML.
    pub key: String,
    /// The problem.
    pub problem: String,
}

impl CellError {
    /// The problem of the value at `path`.
    pub fn at(text: &str, path: &Path, problem: impl Display) -> Self {
        Self {
            line: locate::line_of(text, path),
            key: path.to_string(),
            problem: problem.to_string(),
        }
    }

    /// The problem of a text that is no TOML.
    pub(super) fn of_text(line: usize, problem: String) -> Self {
        Self {
            line,
            key: String::new(),
            problem,
        }
    }
}
