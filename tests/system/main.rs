//! System tests: whole cells, on the bench that `HIL_CAN` names.

#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

mod allocations;
mod architecture;
mod bench;
mod cell;
mod cli_check;
mod cli_refusals;
mod cli_run;
mod cycle;
mod faults;
mod homing;
mod lss;
mod motion;
mod mrroc;
mod regression;
mod repetition;
mod slcan;
mod socketcan;
mod uml;
mod vcan;
mod watch;
