//! Dense grids of delays: late answers of serial lines and held frames of the host, in every phase and robot.

use ::faults::{FaultOptions, FaultPhase, fault_table, grid_faults};
use ::mrroc::cell::CellFile;
use kit::draw::Draw;
use kit::mrroc::example;

use super::extent;

/// Rows of a default run. The long ring plays all of them.
const ROWS: usize = 12;

/// Cells with serial lines of both protocols, and with buses.
const CELLS: [&str; 3] = ["irb6-serial", "irb6-hi-moxa", "irb6"];

#[test]
fn each_row_of_the_grids_ends_within_its_bound() {
    let (seed, times) = extent();
    let faults: Vec<_> = grid_faults().collect();
    let all: Vec<_> = CELLS
        .iter()
        .flat_map(|cell| FaultPhase::ALL.map(|phase| (*cell, phase)))
        .flat_map(|(cell, phase)| faults.iter().map(move |fault| (cell, phase, *fault)))
        .collect();
    let mut draw = Draw::of(seed, 0);
    let rows = (ROWS * times as usize).min(all.len());
    let chosen: Vec<_> = match rows == all.len() {
        true => all,
        false => (0..rows).map(|_| draw.among(&all)).collect(),
    };
    let mut played = 0;
    for (cell, phase, fault) in chosen {
        let file = CellFile::read(example(cell)).unwrap();
        let options = FaultOptions {
            fault: vec![fault.to_owned()],
            phase: vec![phase],
            once: true,
            grids: true,
            ..FaultOptions::default()
        };
        let table = fault_table(&file, &options).unwrap();
        played += table.played();
        assert_eq!(table.red().count(), 0, "{cell}: {}", table.page(false));
    }
    println!("{played} rows");
    assert!(played > 0);
}
