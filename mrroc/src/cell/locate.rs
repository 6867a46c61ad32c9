//! Location of a key in the text of a cell file.

use std::fmt;

use toml::de::DeTable;

/// One step from a table to its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// To the value of a key.
    Key(&'static str),
    /// To an element of an array, counted from 0.
    At(usize),
}

impl From<&'static str> for Step {
    fn from(key: &'static str) -> Self {
        Self::Key(key)
    }
}

impl From<usize> for Step {
    fn from(index: usize) -> Self {
        Self::At(index)
    }
}

/// The path from the top of the file to a value, written as `robot[0].axis[2].node`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Path(Vec<Step>);

impl Path {
    /// This path, extended by one step.
    pub fn then(&self, step: impl Into<Step>) -> Self {
        let mut steps = self.0.clone();
        steps.push(step.into());
        Self(steps)
    }

    /// The index of the robot that the path leads to.
    pub fn robot(&self) -> Option<usize> {
        match *self.0 {
            [Step::Key("robot"), Step::At(robot), ..] => Some(robot),
            _ => None,
        }
    }
}

impl fmt::Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (position, step) in self.0.iter().enumerate() {
            match step {
                Step::Key(key) if position == 0 => write!(f, "{key}")?,
                Step::Key(key) => write!(f, ".{key}")?,
                Step::At(index) => write!(f, "[{index}]")?,
            }
        }
        Ok(())
    }
}

/// The line, counted from 1, of the byte at `offset` of `text`.
pub(super) fn line_at(text: &str, offset: usize) -> usize {
    let upto = offset.min(text.len());
    text.as_bytes()[..upto]
        .iter()
        .filter(|&&byte| byte == b'\n')
        .count()
        + 1
}

/// The line of the value at `path`, or of the nearest enclosing table in the file.
pub(super) fn line_of(text: &str, path: &Path) -> usize {
    let Ok(document) = DeTable::parse(text) else {
        return 1;
    };
    let mut offset = document.span().start;
    let mut steps = path.0.iter();
    let mut value = match steps.next() {
        Some(Step::Key(key)) => match document.get_ref().get(*key) {
            Some(value) => value,
            None => return 1,
        },
        _ => return 1,
    };
    loop {
        offset = if value.span().is_empty() {
            offset
        } else {
            value.span().start
        };
        let Some(step) = steps.next() else {
            return line_at(text, offset);
        };
        let inner = match step {
            Step::Key(key) => value.get_ref().get(*key),
            Step::At(index) => value.get_ref().get(*index),
        };
        match inner {
            Some(inner) => value = inner,
            None => return line_at(text, offset),
        }
    }
}
