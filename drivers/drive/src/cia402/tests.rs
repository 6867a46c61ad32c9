//! Tests of the group against frames written by hand.

mod agreement;
mod answer_age;
pub(crate) mod bench;
mod bring_up;
mod configuration;
mod contact;
mod cycle;
mod error_clearing;
mod faults;
mod homing;
mod mode_watch;
mod other_controller;
mod own_heartbeat;
mod plausibility;
mod recovery;
mod reserved;
mod small_drives;
mod stale;
mod stored;
mod warnings;
