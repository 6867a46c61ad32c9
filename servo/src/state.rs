//! State machines of the servo, and stop categories. An effector ([`ServoState`]), a team ([`TeamState`]) and the cell
//! ([`CellState`]) have one machine each. Each machine has one transition function, which a test compares with a table of
//! all states and events.

mod cell;
mod effector;
mod team;

use serde::Serialize;

pub(crate) use cell::CellEvent;
pub use cell::CellState;
pub use effector::{After, Answer, ServoEvent, ServoState};
pub(crate) use team::TeamEvent;
pub use team::TeamState;

/// Stop category (IEC 60204-1). A stop can only become stricter, in the order of the variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(into = "u8")]
pub enum StopCategory {
    /// Category 2: a controlled stop, after which the power stays on.
    Two,
    /// Category 1: a controlled stop, after which the power is removed.
    One,
    /// Category 0: the power is removed at once.
    Zero,
}

impl From<StopCategory> for u8 {
    fn from(category: StopCategory) -> Self {
        match category {
            StopCategory::Two => 2,
            StopCategory::One => 1,
            StopCategory::Zero => 0,
        }
    }
}
