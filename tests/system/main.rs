//! System tests: whole cells, on the bench that `HIL_CAN` names.

mod allocations;
mod architecture;
mod bench;
mod cell;
mod cycle;
mod faults;
mod homing;
mod motion;
mod regression;
mod repetition;
mod socketcan;
mod uml;
mod watch;
