//! Teach-in of the IRb-6 by an operator at standard input: the cell, the orders and the taught positions.

use std::fs;
use std::path::{Path, PathBuf};

use controller::trajectory_file::{Coordinates, TrajectoryFile};

use crate::mrroc::{Directory, shorten};

/// Orders that teach three positions.
pub const ORDERS: [&str; 8] = [
    "record",
    "move column 0.3",
    "move lower-arm -0.1",
    "record",
    "move wrist-pitch 0.2",
    "move upper-arm 0.1",
    "record",
    "done",
];

/// The first four joints of the taught positions, as displacements from the first position, rad.
pub const TAUGHT: [[f64; 4]; 3] = [[0.0; 4], [0.3, -0.1, 0.0, 0.0], [0.3, -0.1, 0.1, 0.2]];

/// A cell without a program, with these parameters of its task.
pub fn cell(directory: &Directory, parameters: &str) -> PathBuf {
    directory.cell("irb6", |cell| {
        shorten(cell);
        cell.robot[0].program.clear();
        cell.task = toml::from_str(parameters).unwrap();
    })
}

pub fn arguments<'a>(cell: &'a Path, task: &'a str, options: &[&'a str]) -> Vec<&'a str> {
    let mut arguments = vec!["run", cell.to_str().unwrap(), "--task", task];
    arguments.extend(options);
    arguments
}

/// The taught file, with its three positions checked.
#[track_caller]
pub fn taught(path: &Path) -> TrajectoryFile {
    let file = TrajectoryFile::parse(&fs::read_to_string(path).unwrap()).unwrap();
    assert_eq!((file.coordinates(), file.columns(), file.poses().len()), (Coordinates::Joint, 5, 3));
    let first = file.poses()[0].position;
    for (pose, by) in file.poses().iter().zip(TAUGHT) {
        for (axis, by) in by.into_iter().enumerate() {
            let found = pose.position[axis] - first[axis];
            assert!((found - by).abs() < 1e-6, "axis {axis}: {found} for {by}");
        }
    }
    file
}
