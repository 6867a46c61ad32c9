//! System tests: whole cells, on the bench that `HIL_CAN` names.

#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

mod adapter;
mod allocations;
mod architecture;
mod bench;
mod card;
mod cell;
mod cli_check;
mod cli_refusals;
mod cli_run;
mod configuration;
mod cycle;
mod cycle_calls;
mod doctor;
mod emulate_slcan;
mod epos_service;
mod faults;
mod heap;
mod homing;
mod host_closed;
mod identify;
mod jitter;
mod kinematics;
mod lab;
mod loops;
mod lss;
mod motion;
mod mrroc;
mod payload;
mod peers;
mod qemu;
mod regression;
mod repetition;
mod serial_cli;
mod serial_faults;
mod serial_homing;
mod serial_refusals;
mod service;
mod slcan;
mod socketcan;
mod spikes;
mod uml;
mod vcan;
mod watch;
mod wire;
