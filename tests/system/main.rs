//! System tests: whole cells, on the bench that `HIL_CAN` names.

mod architecture;
mod bench;
mod regression;
mod socketcan;
mod uml;
