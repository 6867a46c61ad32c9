//! Momentum and energy of bodies, and forces that robots feel.

mod beams;
mod bodies;
mod random;
mod robots;
mod world;
