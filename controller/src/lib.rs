//! Robots, paths, generators, virtual sensors, wrenches, cycle laws, trajectory files, effector control processes,
//! coordination, and tasks as programs.

pub mod coordination;
pub mod ecp;
pub mod executor;
pub mod force;
pub mod generator;
pub mod law;
pub mod path;
#[cfg(test)]
mod random;
pub mod robot;
pub mod sensor;
pub mod trajectory_file;
