//! Tests of sensors on the bus of a drive, against frames written by hand. Tests of sensors on serial lines are in
//! `drivers/drive/tests/wrench`.

mod bench;
mod bring_up;
mod configuration;
mod faults;
mod samples;
