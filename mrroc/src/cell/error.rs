//! Errors of a cell file, and the location of a key in its text.

use std::borrow::Cow;
use std::fmt::{self, Display};
use std::iter::successors;

use thiserror::Error;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::text::{excerpt, printable, quoted};

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
        Self { line: line_of(text, path), key: path.to_string(), problem: problem.to_string() }
    }

    /// The problem of a text that is no TOML.
    pub(super) fn of_text(line: usize, problem: String) -> Self {
        Self { line, key: String::new(), problem }
    }
}

/// One step from a table to its content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// To the value of a key.
    Key(Cow<'static, str>),
    /// To an element of an array, counted from 0.
    At(usize),
}

impl From<&'static str> for Step {
    fn from(key: &'static str) -> Self {
        Self::Key(key.into())
    }
}

impl From<usize> for Step {
    fn from(index: usize) -> Self {
        Self::At(index)
    }
}

/// The path from the top of the file to a value, written as `robot[0].axis[2].node`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Path(pub(super) Vec<Step>);

impl Path {
    /// This path, extended by one step.
    pub fn then(&self, step: impl Into<Step>) -> Self {
        let mut steps = self.0.clone();
        steps.push(step.into());
        Self(steps)
    }

    /// The path to the table or list `key` at the top of the file.
    pub fn to(key: &'static str) -> Self {
        Self::default().then(key)
    }

    /// The path to axis `axis` of robot `robot`.
    pub fn axis(robot: usize, axis: usize) -> Self {
        Self::to("robot").then(robot).then("axis").then(axis)
    }

    /// The index of the robot that the path leads to.
    pub fn robot(&self) -> Option<usize> {
        match &*self.0 {
            [Step::Key(key), Step::At(robot), ..] if key == "robot" => Some(*robot),
            _ => None,
        }
    }
}

impl Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (position, step) in self.0.iter().enumerate() {
            match step {
                Step::At(index) => write!(f, "[{index}]")?,
                Step::Key(name) => {
                    let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                    let is_bare = !name.is_empty() && name.chars().all(bare);
                    f.write_str(if position == 0 { "" } else { "." })?;
                    f.write_str(&if is_bare { excerpt(name) } else { quoted(name) })?;
                }
            }
        }
        Ok(())
    }
}

/// The line, counted from 1, of the byte at `offset` of `text`.
pub(super) fn line_at(text: &[u8], offset: usize) -> usize {
    let before = &text[..offset.min(text.len())];
    before.iter().filter(|&&byte| byte == b'\n').count() + 1
}

/// The line of the value at `path`, or of the nearest enclosing table in the file.
pub(super) fn line_of(text: &str, path: &Path) -> usize {
    let Ok(document) = DeTable::parse(text) else {
        return 1;
    };
    let document = Spanned::new(0..0, DeValue::Table(document.into_inner()));
    let mut steps = path.0.iter();
    let values = successors(Some(&document), |value| match steps.next()? {
        Step::Key(key) => value.get_ref().get(key.as_ref()),
        Step::At(index) => value.get_ref().get(*index),
    });
    // A table of dotted keys alone has no offset in the text.
    let placed = values.map(Spanned::span).filter(|span| !span.is_empty());
    line_at(text.as_bytes(), placed.last().map_or(0, |span| span.start))
}
