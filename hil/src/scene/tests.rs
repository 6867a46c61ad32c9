//! Momentum and energy of bodies, and forces that robots feel.

mod bodies;
mod random;
mod robots;
mod world;
