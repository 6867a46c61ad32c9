//! Examination of a host: fitness for a cell, and jitter of its threads.

pub mod doctor;
pub mod jitter;
