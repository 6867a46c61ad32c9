//! Robots, paths, generators and the effector control process.

pub mod ecp;
pub mod generator;
pub mod path;
pub mod robot;
