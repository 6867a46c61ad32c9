//! Momentum and energy of bodies, and forces that robots feel.

mod beams;
mod bodies;
mod robots;
mod world;
