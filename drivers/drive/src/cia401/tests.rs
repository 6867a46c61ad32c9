//! Tests of I/O nodes on the bus of a drive, against frames written by hand from CiA 401 and CiA 301.

mod bench;
mod bring_up;
mod inputs;
mod outputs;
mod reset;
mod routing;
mod silence;
