//! Checks of ultrasonic matrices.

use drive::ultrasonic::UltrasonicConfigError;

use super::force::{check_line_of, check_name_of, check_quaternion};
use super::{Checked, refused, robots::NEAR, twice, unique, within};
use crate::cell::{Cell, Path, Range, Ultrasonic, quoted};

/// Greatest number of matrices of a cell.
pub(super) const MOST: usize = 32;

/// Latest time of an emulated event, s.
const LATEST: f64 = 1e6;

pub(super) fn check(cell: &Cell) -> Checked {
    let list = Path::to("ultrasonic");
    if cell.ultrasonic.len() > MOST {
        return Err((list, format!("has {} matrices, may have {MOST}", cell.ultrasonic.len())));
    }
    for (index, matrix) in cell.ultrasonic.iter().enumerate() {
        let path = list.then(index);
        check_name_of(cell, &path, &matrix.name)?;
        unique(&list, "name", index, cell.ultrasonic.iter().map(|it| &it.name), |it| {
            format!("ultrasonic matrix {it:?}")
        })?;
        if !cell.robot.iter().any(|robot| robot.name == matrix.robot) {
            let known: Vec<_> = cell.robot.iter().map(|robot| robot.name.as_str()).collect();
            let why = format!("no robot is called {}, only {}", quoted(&matrix.robot), known.join(", "));
            return refused(&path, "robot", why);
        }
        check_line_of(cell, &path, &matrix.line, "an ultrasonic matrix")?;
        unique(&list, "line", index, cell.ultrasonic.iter().map(|it| &it.line), |line| format!("line {line:?}"))?;
        for (number, sensor) in cell.force_sensor.iter().enumerate() {
            let first = Path::to("force_sensor").then(number);
            if sensor.name == matrix.name {
                return refused(&path, "name", twice(&format!("the name {:?}", matrix.name), &first));
            }
            if sensor.line.as_ref() == Some(&matrix.line) {
                return refused(&path, "line", twice(&format!("line {:?}", matrix.line), &first));
            }
        }
        check_numbers(&path, matrix)?;
        matrix.config(cell.period()).check().map_err(|error| (place_of(&path, error), error.to_string()))?;
    }
    Ok(())
}

fn check_numbers(path: &Path, matrix: &Ultrasonic) -> Checked {
    within(path, "baud", matrix.baud, Range::new(9_600.0, 4e6, "bit/s"))?;
    within(path, "half_cone", matrix.half_cone, Range::new(0.001, 1.0, "rad"))?;
    within(path, "speed_of_sound", matrix.speed_of_sound, Range::new(100.0, 2000.0, "m/s"))?;
    within(path, "deviation", matrix.deviation, Range::new(1e-5, 0.1, "m"))?;
    for (axis, part) in matrix.position.into_iter().enumerate() {
        within(&path.then("position"), axis, part, NEAR)?;
    }
    check_quaternion(path, matrix.quaternion)?;
    within(path, "tolerated_missing", matrix.tolerated_missing, Range::new(0.0, 1000.0, "queries"))?;
    let emulator = path.then("emulator");
    let given = matrix.emulator;
    within(&emulator, "silent_from_s", given.silent_from_s.unwrap_or(0.0), Range::new(0.0, LATEST, "s"))?;
    within(&emulator, "size", given.size.unwrap_or(1), Range::new(1.0, 64.0, "elements"))?;
    within(&emulator, "noise", given.noise.unwrap_or(0.0), Range::new(0.0, 1.0, "m"))?;
    within(&emulator, "lost_echoes", given.lost_echoes, Range::new(0.0, 1.0, "of the echoes"))
}

/// The key for an error of the driver.
fn place_of(path: &Path, error: UltrasonicConfigError) -> Path {
    match error {
        UltrasonicConfigError::Size { .. } => path.then("size"),
        UltrasonicConfigError::Pitch { .. } => path.then("pitch"),
        UltrasonicConfigError::Slot { .. } => path.then("slot_us"),
        UltrasonicConfigError::Period => path.clone(),
    }
}
