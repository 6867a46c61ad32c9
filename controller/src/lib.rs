//! Robots, paths, generators, trajectory files, effector control processes, and tasks as programs.

pub mod ecp;
pub mod executor;
pub mod generator;
pub mod path;
pub mod robot;
pub mod trajectory_file;
