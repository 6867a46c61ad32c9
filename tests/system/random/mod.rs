//! Random programs and random cells. A cell that `mrroc check` calls ready runs to its end in lockstep, and a cell that it
//! refuses is refused by `mrroc run` in the same words.

mod draw;
mod homed;
mod verdict;
