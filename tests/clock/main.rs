//! Tests by the clock: whole cells on benches by the clock, on the bus that `HIL_CAN` names.

#![allow(clippy::disallowed_methods, reason = "tests keep pace with other processes")]
#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

mod bench_steps;
mod camera;
mod card;
mod cells_on_vcan;
mod cli_refusals;
mod cli_run;
mod closed_output;
mod cycle_calls;
mod digital_io;
mod doctor;
mod emulate_slcan;
mod epos_service;
mod error_classes;
mod guardian;
mod hang;
mod heap;
mod host_dies;
mod hostile_host;
mod identify;
mod jitter;
mod outside;
mod peers;
mod qemu;
mod reaction;
mod recordings;
mod referenced;
mod relay;
mod report;
mod second_controller;
mod serial_cli;
mod serial_hang_up;
mod serial_refusals;
mod service;
mod servo_hangs;
mod signals;
mod slcan;
mod socketcan;
mod spikes;
mod start_stop_cycles;
mod teach;
mod uml;
mod vcan;
mod vcan_laboratory;
mod vm;
mod watchdog;
