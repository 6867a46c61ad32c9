//! The library of robot programs: cell files, benches, runs and their results.

pub mod bench;
pub mod budget;
pub mod cell;
pub mod cell_file;
mod configuration;
mod programs;
pub mod rehearsal;
pub mod report;
pub mod run;
pub mod setup;
pub mod spikes;
pub mod streams;
mod trace;
pub mod wire;
