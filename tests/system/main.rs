//! System tests: whole cells, on the bench that `HIL_CAN` names.

mod architecture;
mod bench;
mod cli_run;
mod mrroc;
mod regression;
mod socketcan;
mod uml;
