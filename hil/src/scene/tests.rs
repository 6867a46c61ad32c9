//! Momentum and energy of bodies, and forces that robots feel.

mod bodies;
mod robots;
mod world;
