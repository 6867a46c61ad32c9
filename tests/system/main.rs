//! System tests: whole cells, on the bench that `HIL_CAN` names.

#![allow(
    clippy::disallowed_methods,
    reason = "tests keep pace with other processes"
)]
#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

mod adapter;
mod agreement;
mod allocations;
mod architecture;
mod bench;
mod card;
mod cell;
mod cli_check;
mod cli_refusals;
mod cli_run;
mod closed_output;
mod configuration;
mod conformance;
mod cycle;
mod cycle_calls;
mod datasheet;
mod doctor;
mod drive_parameters;
mod emulate_slcan;
mod epos_service;
mod faults;
mod feed_forward;
mod heap;
mod homing;
mod host_closed;
mod identify;
mod inputs;
mod jitter;
mod kinematics;
mod lab;
mod loops;
mod lss;
mod motion;
mod mrroc;
mod outputs;
mod outside;
mod peers;
mod qemu;
mod random;
mod readme;
mod referenced;
mod regression;
mod repetition;
mod report;
mod second_controller;
mod serial_cli;
mod serial_faults;
mod serial_hang_up;
mod serial_homing;
mod serial_refusals;
mod service;
mod signals;
mod slcan;
mod socketcan;
mod spikes;
mod statics;
mod uml;
mod vcan;
mod vcan_cells;
mod vm;
mod watch;
mod weights;
mod wire;
