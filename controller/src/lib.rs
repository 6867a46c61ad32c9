//! Robots, generators, the effector control process and the cell file.

pub mod ecp;
pub mod generator;
pub mod robot;
