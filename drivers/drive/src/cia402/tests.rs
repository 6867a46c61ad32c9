//! The group against frames written by hand.

mod bench;
mod bring_up;
mod configuration;
mod cycle;
mod faults;
mod homing;
