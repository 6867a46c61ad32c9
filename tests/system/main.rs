//! System tests: whole cells, on the bench that `HIL_CAN` names.
mod regression;
