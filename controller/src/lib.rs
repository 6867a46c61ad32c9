//! Robots, paths, generators, effector control processes, and tasks as programs.

pub mod ecp;
pub mod executor;
pub mod generator;
pub mod path;
#[cfg(test)]
mod random;
pub mod robot;
