//! Reasons for the refusal of a configuration: the key, and the value or the range that is permitted.

use std::fmt;

use thiserror::Error;

/// A refused configuration.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{key}: {reason}")]
pub struct KeyError {
    /// The key below the checked table, with dots.
    pub key: &'static str,
    /// The reason.
    pub reason: KeyProblem,
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum KeyProblem {
    #[error("is {}, must be {range}", Figure(*value))]
    OutOfRange { value: f64, range: Range },
    /// A key that means nothing where it stands, with the reason as the rest of a sentence.
    #[error("has no effect {because}: leave it out")]
    NoEffect { because: &'static str },
    /// A key that contradicts or lacks another.
    #[error("{0}")]
    Conflict(&'static str),
}

pub(crate) fn within(key: &'static str, value: f64, range: Range) -> Result<(), KeyError> {
    if range.has(value) {
        return Ok(());
    }
    Err(KeyError { key, reason: KeyProblem::OutOfRange { value, range } })
}

/// Refuses a key that is given where it means nothing.
pub(crate) fn no_effect(key: &'static str, given: bool, because: &'static str) -> Result<(), KeyError> {
    if !given {
        return Ok(());
    }
    Err(KeyError { key, reason: KeyProblem::NoEffect { because } })
}

/// Refuses a key that contradicts or lacks another.
pub(crate) fn conflict(key: &'static str, why: &'static str) -> Result<(), KeyError> {
    Err(KeyError { key, reason: KeyProblem::Conflict(why) })
}

/// The first field of a table whose condition does not hold.
pub(crate) fn first_wrong<const N: usize>(fields: [(bool, &'static str); N]) -> Option<&'static str> {
    fields.into_iter().find(|(is_right, _)| !is_right).map(|(_, field)| field)
}

pub(crate) const fn is_positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

pub(crate) const fn is_not_negative(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}

/// A number as a message shows it: 1000001, 0.25, 1e300.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure(pub f64);

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value) = *self;
        if value == 0.0 || (1e-4..1e15).contains(&value.abs()) { write!(f, "{value}") } else { write!(f, "{value:e}") }
    }
}

/// The values that a number may have, both ends included. [`f64::MIN_POSITIVE`] as the low end stands for all above 0,
/// [`f64::MIN`] and [`f64::MAX`] for no end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Low end.
    pub low: f64,
    /// High end.
    pub high: f64,
    /// The unit and what the ends follow from, in the words of a message; may be empty.
    pub of: &'static str,
}

impl Range {
    /// From `low` to `high`.
    pub const fn new(low: f64, high: f64, of: &'static str) -> Self {
        Self { low, high, of }
    }

    /// Whether `value` is in it; never, if it is not a number.
    pub fn has(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (low, high) = (inner(self.low, f64::ceil), inner(self.high, f64::floor));
        let (above_zero, no_low) = (self.low == f64::MIN_POSITIVE, self.low == f64::MIN);
        match (self.high == f64::MAX, above_zero, no_low) {
            (true, true, _) => f.write_str("above 0"),
            (true, _, true) => f.write_str("a number"),
            (true, false, false) => write!(f, "at least {low}"),
            (false, true, _) => write!(f, "above 0 and at most {high}"),
            (false, _, true) => write!(f, "at most {high}"),
            (false, false, false) if self.low == self.high => write!(f, "{low}"),
            (false, false, false) => write!(f, "between {low} and {high}"),
        }?;
        if self.of.is_empty() { Ok(()) } else { write!(f, " ({})", self.of) }
    }
}

/// An end of a range in few digits, rounded towards its inside: whatever is shown is possible.
fn inner(end: f64, round: fn(f64) -> f64) -> String {
    let exact = Figure(end).to_string();
    let power = format!("{end:e}");
    if exact.len().min(power.len()) <= 9 {
        return if exact.len() <= 9 { exact } else { power };
    }
    let decimals = 3 - end.abs().log10().floor() as i32;
    let scale = 10_f64.powi(decimals);
    let rounded = round(end * scale) / scale;
    if (1e-4..1e9).contains(&end.abs()) {
        format!("{rounded:.*}", decimals.max(0) as usize)
    } else {
        format!("{rounded:.3e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_number_takes_more_than_two_dozen_characters() {
        let table = [
            (0.0, "0"),
            (1_000_001.0, "1000001"),
            (-0.25, "-0.25"),
            (1e300, "1e300"),
            (-1.5e-300, "-1.5e-300"),
            (f64::MAX, "1.7976931348623157e308"),
            (5e-324, "5e-324"),
        ];
        for (value, shown) in table {
            assert_eq!(Figure(value).to_string(), shown);
        }
    }

    #[test]
    fn a_range_is_said_by_the_ends_that_it_has() {
        let table = [
            ((f64::MIN_POSITIVE, f64::MAX), "above 0"),
            ((f64::MIN, f64::MAX), "a number"),
            ((0.0, f64::MAX), "at least 0"),
            ((f64::MIN_POSITIVE, 2.5), "above 0 and at most 2.5"),
            ((f64::MIN, 2.5), "at most 2.5"),
            ((1.0, 1e6), "between 1 and 1000000"),
            ((1.0, 1.0), "1"),
            ((920.0 / 1200.0, 2.0 / 3.0), "between 0.7667 and 0.6666"),
            ((5000.0 / 3.0, 1e7 / 3.0), "between 1667 and 3333000"),
            ((1e-5 / 3.0, 1e13 / 3.0), "between 3.334e-6 and 3.333e12"),
        ];
        for ((low, high), words) in table {
            assert_eq!(Range::new(low, high, "").to_string(), words);
            let with_unit = Range::new(low, high, "rad").to_string();
            assert_eq!(with_unit, format!("{words} (rad)"));
        }
    }
}
