//! Teach-in by the clock.

use std::path::Path;

use kit::mrroc::{Directory, Output, Running};
use kit::teach::{ORDERS, arguments, cell, taught};
use kit::{PERIOD, by_the_clock};

/// Teaches with these orders. Standard input stays open.
fn teach(cell: &Path, orders: &[&str], options: &[&str]) -> Output {
    Running::with_input(orders, arguments(cell, "teach", &[&["--operator"], options].concat())).output()
}

#[test]
fn a_teach_in_by_the_clock_ends_although_standard_input_stays_open() {
    by_the_clock(0.25, PERIOD, || {
        let directory = Directory::new();
        let cell = cell(&directory, "file = 'poses.trj'\nvelocity = 1.0\nacceleration = 1.0");
        let run = teach(&cell, &ORDERS, &["--bench=emulated"]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        taught(&directory.path("poses.trj"));
    });
}
