//! System tests: whole cells, on the bench that `HIL_CAN` names.

#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

mod adapter;
mod allocations;
mod architecture;
mod bench;
mod cell;
mod cli_check;
mod cli_refusals;
mod cli_run;
mod configuration;
mod cycle;
mod emulate_slcan;
mod faults;
mod homing;
mod jitter;
mod loops;
mod lss;
mod motion;
mod mrroc;
mod peers;
mod regression;
mod repetition;
mod service;
mod slcan;
mod socketcan;
mod uml;
mod vcan;
mod watch;
