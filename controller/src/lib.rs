//! Robots, generators, the effector control process and the cell file.

pub mod robot;
