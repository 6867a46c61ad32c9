//! Meetings of the robots of the laboratory in the record of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// An axis of each robot.
pub const AXES: [&str; 6] =
    ["irb6.column", "irp6-track.track", "rnt.leg-1", "polycrank.q1", "gripper.jaws", "conveyor.belt"];

/// Entry of one axis in a record: cycle, phase, commanded motor position, counts.
pub type Row = (u64, String, f64, i64);

/// The rows of the first axis of each robot, or of `axis` of the only robot.
pub fn record(path: &Path, wanted: &[&str]) -> BTreeMap<String, Vec<Row>> {
    let file = BufReader::new(File::open(path).expect("the record is there"));
    let mut rows = BTreeMap::<String, Vec<Row>>::new();
    for line in file.lines().skip(1) {
        let line = line.expect("the record is text");
        let mut columns = line.split(',');
        let mut next = || columns.next().expect("a record has its columns");
        let (cycle, _, axis, phase) = (next(), next(), next(), next());
        if !wanted.contains(&axis) {
            continue;
        }
        let (_, commanded, _, counts) = (next(), next(), next(), next());
        rows.entry(axis.to_owned()).or_default().push((
            cycle.parse().expect("a number"),
            phase.to_owned(),
            commanded.parse().expect("a number"),
            counts.parse().expect("a number"),
        ));
    }
    rows
}

/// Cycles in which an axis enters the phase `into`.
pub fn beginnings(rows: &[Row], into: &str) -> Vec<u64> {
    let pairs = rows.windows(2);
    let begins = pairs.filter(|pair| pair[0].1 != into && pair[1].1 == into);
    begins.map(|pair| pair[1].0).collect()
}

/// Asserts by a record that every robot left the three meetings in the same cycle as all other robots. Returns the rows of
/// one axis of each robot.
pub fn left_meetings(log: &Path) -> BTreeMap<String, Vec<Row>> {
    let rows = record(log, &AXES);
    assert_eq!(rows.len(), AXES.len());
    let starts = rows.values().map(|rows| beginnings(rows, "Moving"));
    let starts: BTreeSet<_> = starts.collect();
    assert_eq!(starts.len(), 1, "{starts:?}");
    assert_eq!(starts.first().unwrap().len(), 3, "{starts:?}");
    rows
}
