//! Tests of drive groups and sensors on scripted lines, in one executable.
#![allow(clippy::unwrap_used, reason = "a test")]

mod axis_controller;
mod board;
mod devices;
mod no_allocation;
mod robustness;
mod scripted;
mod ultrasonic;
mod wrench;
