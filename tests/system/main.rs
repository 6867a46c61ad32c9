//! System tests: whole cells, on the bench that `HIL_CAN` names.

#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

mod architecture;
mod bench;
mod cli_check;
mod cli_refusals;
mod cli_run;
mod mrroc;
mod regression;
mod socketcan;
mod uml;
