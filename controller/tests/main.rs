//! Tests of the controller by its public interface, in one executable.

mod allocation;
mod bench;
mod carry_allocation;
mod chain_allocation;
mod counting;
mod generators;
mod ideal;
mod jog;
mod law_allocation;
mod law_in_servo;
mod letter;
mod lines;
mod motions;
mod overrides;
#[path = "../src/random.rs"]
mod random;
mod team_allocation;
