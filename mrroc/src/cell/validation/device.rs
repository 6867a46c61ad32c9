//! Checks of devices of other crates.

use can::counted;
use drive::device::{DeviceValue, count_of, names_of};

use super::force::{check_line_of, check_name_of, check_quaternion, check_robot};
use super::{Checked, refused, robots::NEAR, twice, unique, within};
use crate::cell::{Cell, Device, Path, Range};

/// Greatest number of devices of a cell.
pub(super) const MOST: usize = 32;

/// Latest time of an emulated event, s.
const LATEST: f64 = 1e6;

pub(super) fn check(cell: &Cell) -> Checked {
    let list = Path::to("device");
    if cell.device.len() > MOST {
        return Err((list, format!("has {} devices, may have {MOST}", cell.device.len())));
    }
    for (index, device) in cell.device.iter().enumerate() {
        let (path, keys) = (list.then(index), &device.keys);
        check_name_of(cell, &path, &keys.name)?;
        unique(&list, "name", index, cell.device.iter().map(|it| &it.keys.name), |it| format!("device {it:?}"))?;
        if let Some(robot) = &keys.robot {
            check_robot(cell, &path, robot, "robot")?;
        }
        check_line_of(cell, &path, &keys.line, "a device")?;
        unique(&list, "line", index, cell.device.iter().map(|it| &it.keys.line), |line| format!("line {line:?}"))?;
        check_apart(cell, &path, device)?;
        for (axis, part) in keys.position.into_iter().enumerate() {
            within(&path.then("position"), axis, part, NEAR)?;
        }
        check_quaternion(&path, keys.quaternion)?;
        within(&path, "tolerated_missing", keys.tolerated_missing, Range::new(0.0, 1000.0, "samples"))?;
        within(&path, "boot_timeout_ms", keys.boot_timeout_ms, Range::new(1.0, 600_000.0, "ms"))?;
        let (emulator, given) = (path.then("emulator"), keys.emulator);
        within(&emulator, "silent_from_s", given.silent_from_s.unwrap_or(0.0), Range::new(0.0, LATEST, "s"))?;
        within(&emulator, "noise", given.noise, Range::new(0.0, 1e6, ""))?;
        device.own.check().map_err(|problem| (path.clone(), problem))?;
        let of_kind = |problem| (path.then("kind"), format!("declares {problem}"));
        device.config(cell.period()).check().map_err(|problem| of_kind(problem.to_string()))?;
        check_rehearsed(device.own.values(), &device.own.rehearsed_numbers()).map_err(of_kind)?;
    }
    Ok(())
}

/// A rehearsal gives the declared numbers, each within its range.
pub(crate) fn check_rehearsed(values: &'static [DeviceValue], numbers: &[f64]) -> Result<(), String> {
    let count = count_of(values);
    if numbers.len() != count {
        return Err(format!("{} for a rehearsal, must be {count}", counted(numbers.len(), "number")));
    }
    for ((name, value), number) in names_of(values).zip(numbers) {
        if !value.permits(*number) {
            let [low, high] = value.range;
            return Err(format!("{number} as {name} for a rehearsal, must be {low} to {high}"));
        }
    }
    Ok(())
}

/// Refuses the name or the line of another sensor.
fn check_apart(cell: &Cell, path: &Path, device: &Device) -> Checked {
    let forces = cell.force_sensor.iter().map(|it| (&it.name, it.line.as_ref())).enumerate();
    let matrices = cell.ultrasonic.iter().map(|it| (&it.name, Some(&it.line))).enumerate();
    let cameras = cell.camera.iter().map(|it| (&it.name, None)).enumerate();
    let forces = forces.map(|it| ("force_sensor", it));
    let others = forces.chain(matrices.map(|it| ("ultrasonic", it))).chain(cameras.map(|it| ("camera", it)));
    for (list, (number, (name, line))) in others {
        let first = Path::to(list).then(number);
        if *name == device.keys.name {
            return refused(path, "name", twice(&format!("the name {name:?}"), &first));
        }
        if line == Some(&device.keys.line) {
            return refused(path, "line", twice(&format!("line {:?}", device.keys.line), &first));
        }
    }
    Ok(())
}
