//! Checks of force sensors.

use controller::robot::Mass;
use drive::wrench::ConfigError;

use super::can_force_sensor::greatest_count;
use super::{Checked, buses, can_force_sensor, name, no_effect, refused, robots::NEAR, twice, unique, within};
use crate::bench::interfaces::Interface;
use crate::cell::{Cell, EmulatedTemperature, ForceSensor, Path, Plant, Range, quoted};

/// Greatest number of force sensors of a cell.
pub(super) const MOST: usize = 32;

/// Greatest length of a quaternion's deviation from a unit quaternion.
const UNIT: f64 = 1e-3;

/// Gravitational acceleration, m/s².
const GRAVITY: f64 = 9.81;

/// Greatest noise of a sample in standard deviations: one sample of 5e8 has more.
const NOISE: f64 = 6.0;

/// Latest time of an emulated event, s.
const LATEST: f64 = 1e6;

pub(super) fn check(cell: &Cell) -> Checked {
    let sensors = Path::to("force_sensor");
    if cell.force_sensor.len() > MOST {
        return Err((sensors, format!("has {} force sensors, may have {MOST}", cell.force_sensor.len())));
    }
    for (index, sensor) in cell.force_sensor.iter().enumerate() {
        let path = sensors.then(index);
        check_name(cell, &sensors, index)?;
        check_robot(cell, &path, &sensor.robot, "robot")?;
        match &sensor.can {
            Some(can) if sensor.line.is_none() => can_force_sensor::check_keys(cell, &path, index, sensor, can)?,
            Some(_) => return refused(&path, "line", "is given beside can: a sensor is on a line or on a bus"),
            None => check_line(cell, &sensors, index)?,
        }
        check_numbers(cell, &path, sensor)?;
        if sensor.can.is_some() {
            // The driver of the bus checks the sensor with all other nodes of the bus.
            continue;
        }
        sensor.config(cell.period()).check().map_err(|error| (place_of(&path, error), error.to_string()))?;
    }
    Ok(())
}

/// The name is that of no bus, no bundle of lines, no axis and no other sensor.
fn check_name(cell: &Cell, sensors: &Path, index: usize) -> Checked {
    let (path, own) = (sensors.then(index), &cell.force_sensor[index].name);
    check_name_of(cell, &path, own)?;
    unique(sensors, "name", index, cell.force_sensor.iter().map(|it| &it.name), |it| format!("force sensor {it:?}"))
}

/// The name of a sensor is that of no bus, no bundle of lines and no axis.
pub(super) fn check_name_of(cell: &Cell, path: &Path, own: &str) -> Checked {
    name(path, "name", own)?;
    let bus = cell.bus.iter().position(|bus| bus.name == own).map(|bus| Path::to("bus").then(bus));
    let bundle = || cell.serial.iter().position(|it| it.name == own).map(|it| Path::to("serial").then(it));
    let axis = || {
        let axes = cell.robot.iter().enumerate();
        let mut axes = axes.flat_map(|(robot, it)| it.axis.iter().enumerate().map(move |axis| (robot, axis)));
        axes.find(|(_, (_, axis))| axis.name == own).map(|(robot, (axis, _))| Path::axis(robot, axis))
    };
    match bus.or_else(bundle).or_else(axis) {
        Some(first) => refused(path, "name", twice(&format!("the name {own:?}"), &first)),
        None => Ok(()),
    }
}

/// The robot exists and has a flange whose load its emulated motors feel.
pub(super) fn check_robot(cell: &Cell, path: &Path, robot: &str, key: &'static str) -> Checked {
    let Some(found) = cell.robot.iter().find(|it| it.name == robot) else {
        let known: Vec<_> = cell.robot.iter().map(|robot| robot.name.as_str()).collect();
        return refused(path, key, format!("no robot is called {}, only {}", quoted(robot), known.join(", ")));
    };
    if found.numbers().mechanism().is_none() {
        return refused(path, key, format!("is {}, which has no flange: name an arm", quoted(robot)));
    }
    if let Some(axis) = found.axis.iter().find(|it| it.emulator.plant == Plant::Wut) {
        let why =
            format!("is {}, whose axis {:?} feels no load with plant wut: use physical", quoted(robot), axis.name);
        return refused(path, key, why);
    }
    Ok(())
}

/// The line is that of no axis controller, no adapter of a bus and no other sensor.
fn check_line(cell: &Cell, sensors: &Path, index: usize) -> Checked {
    let path = sensors.then(index);
    let Some(line) = &cell.force_sensor[index].line else {
        return refused(&path, "line", "is missing: give the tty as line, or the node on a CAN bus as can");
    };
    check_line_of(cell, &path, line, "a force sensor")?;
    let earlier = cell.force_sensor[..index].iter().position(|it| it.line.as_ref() == Some(line));
    earlier.map_or(Ok(()), |first| refused(&path, "line", twice(&format!("line {line:?}"), &sensors.then(first))))
}

/// The line of a sensor is that of no axis controller and no adapter of a bus.
pub(super) fn check_line_of(cell: &Cell, path: &Path, line: &str, what: &str) -> Checked {
    buses::text(path, "line", line)?;
    for (robot, it) in cell.robot.iter().enumerate() {
        let shared = it.axis.iter().position(|axis| axis.controller.as_ref().is_some_and(|it| it.line == line));
        if let Some(axis) = shared {
            let shared = twice(&format!("line {line:?}"), &Path::axis(robot, axis).then("controller"));
            return refused(path, "line", format!("{shared}: {what} needs a line of its own"));
        }
    }
    let adapter = cell.bus.iter().position(|bus| match Interface::parse(&bus.interface) {
        Interface::Slcan { path, .. } | Interface::Epos { path, .. } => path == line,
        Interface::SocketCan(_) => false,
    });
    match adapter {
        Some(bus) => refused(path, "line", twice(&format!("line {line:?}"), &Path::to("bus").then(bus))),
        None => Ok(()),
    }
}

fn check_numbers(cell: &Cell, path: &Path, sensor: &ForceSensor) -> Checked {
    within(path, "baud", sensor.settings().baud, Range::new(9_600.0, 4e6, "bit/s"))?;
    let needed = 1e6 / f64::from(cell.period_us);
    if sensor.can.is_none() && f64::from(sensor.samples_per_second()) < needed {
        let why = format!(
            "is {}, must be {needed:.0} (Hz) at the least: the servo takes a sample in each period of {} µs",
            sensor.samples_per_second(),
            cell.period_us
        );
        return refused(path, "rate_hz", why);
    }
    let given = [("force_per_count", sensor.force_per_count), ("torque_per_count", sensor.torque_per_count)];
    for (key, scale) in given {
        if let Some(scale) = scale {
            within(path, key, scale.abs(), Range::new(1e-9, 1e5, "per count"))?;
        }
    }
    let ranges = [("force_range", sensor.force_range, "N"), ("torque_range", sensor.torque_range, "N·m")];
    for ((key, ranges, unit), count) in ranges.into_iter().zip(sensor.counts()) {
        for (axis, range) in ranges.into_iter().enumerate() {
            let component = axis + if key == "force_range" { 0 } else { 3 };
            // A reading on a serial line has 16 bits.
            let greatest = sensor.can.as_ref().map_or(f64::from(i16::MAX), |can| greatest_count(can, component));
            let most = greatest * count.abs();
            within(&path.then(key), axis, range, Range::new(count.abs(), most, unit))?;
        }
    }
    for (axis, part) in sensor.position.into_iter().enumerate() {
        within(&path.then("position"), axis, part, NEAR)?;
    }
    if let Some(quaternion) = sensor.quaternion {
        check_quaternion(path, quaternion)?;
    }
    let tool = path.then("tool");
    within(&tool, "mass", sensor.tool.mass, Range::new(0.0, Mass::MOST, "kg"))?;
    for (axis, part) in sensor.tool.centre.into_iter().enumerate() {
        within(&tool.then("centre"), axis, part, NEAR)?;
    }
    for (axis, moment) in sensor.tool_inertia.into_iter().enumerate() {
        within(&path.then("tool_inertia"), axis, moment, Range::new(0.0, 1e3, "kg·m²"))?;
    }
    if let Err(error) = sensor.load() {
        return refused(path, "tool_inertia", error.to_string());
    }
    within(path, "tool_lag_s", sensor.tool_lag_s, Range::new(0.0, 0.02, "s"))?;
    let greatest = sensor.max_offset.into_iter().flatten().zip(sensor.ranges());
    for (channel, (offset, range)) in greatest.enumerate() {
        within(&path.then("max_offset"), channel, offset, Range::new(0.0, range, "N or N·m"))?;
    }
    within(path, "zero_samples", sensor.zero_samples, Range::new(1.0, 10_000.0, "samples"))?;
    within(path, "tolerated_missing", sensor.tolerated_missing, Range::new(0.0, 1000.0, "samples"))?;
    let emulator = path.then("emulator");
    within(&emulator, "silent_from_s", sensor.emulator.silent_from_s.unwrap_or(0.0), Range::new(0.0, LATEST, "s"))?;
    for (channel, (offset, noise)) in sensor.emulator.offset.into_iter().zip(sensor.emulator.noise).enumerate() {
        within(&emulator.then("offset"), channel, offset, Range::new(-1e5, 1e5, "N or N·m"))?;
        within(&emulator.then("noise"), channel, noise, Range::new(0.0, 1e5, "N or N·m"))?;
    }
    for (channel, drift) in sensor.emulator.drift.into_iter().enumerate() {
        within(&emulator.then("drift"), channel, drift, Range::new(-1e3, 1e3, "N/K or N·m/K"))?;
    }
    match sensor.emulator.temperature {
        None => no_effect(&emulator, "drift", sensor.emulator.drift != [0.0; 6], "without temperature")?,
        Some(EmulatedTemperature { start, end, time_constant_s }) => {
            let path = emulator.then("temperature");
            let celsius = Range::new(-273.15, 1e3, "°C");
            within(&path, "start", start, celsius)?;
            within(&path, "end", end, celsius)?;
            within(&path, "time_constant_s", time_constant_s, Range::new(0.0, LATEST, "s"))?;
        }
    }
    check_load(path, sensor)
}

/// The quaternion of the table at `path` has unit length.
pub(super) fn check_quaternion(path: &Path, quaternion: [f64; 4]) -> Checked {
    let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    if (length - 1.0).abs() <= UNIT {
        return Ok(());
    }
    refused(path, "quaternion", format!("has the length {length:.3}, must be a unit quaternion"))
}

/// No channel is saturated by the weight of the tool in any orientation, nor by the emulated offset, drift and noise in addition.
fn check_load(path: &Path, sensor: &ForceSensor) -> Checked {
    let weight = sensor.tool.mass * GRAVITY;
    let [x, y, z] = sensor.tool.centre;
    let torques = [y.hypot(z), z.hypot(x), x.hypot(y)].map(|arm| weight * arm);
    let loads = [[weight; 3], torques].concat();
    for (channel, (load, range)) in loads.into_iter().zip(sensor.ranges()).enumerate() {
        let drift = sensor.emulator.final_drift()[channel].abs();
        let load = load + sensor.emulator.offset[channel].abs() + drift + NOISE * sensor.emulator.noise[channel];
        if load >= range {
            let (key, unit) = if channel < 3 { ("force_range", "N") } else { ("torque_range", "N·m") };
            let why = format!(
                "is {range} {unit}, and the tool with the emulated offset, drift and noise alone can load the channel by {load:.3} \
                 {unit}"
            );
            return refused(&path.then(key), channel % 3, why);
        }
    }
    Ok(())
}

/// The key for an error of the driver.
fn place_of(path: &Path, error: ConfigError) -> Path {
    let of_axis = |keys: [&'static str; 2], axis: usize| path.then(keys[axis / 3]);
    match error {
        ConfigError::Period { .. } => path.then("baud"),
        ConfigError::Scale { axis, .. } => of_axis(["force_per_count", "torque_per_count"], axis as usize),
        ConfigError::Range { axis, .. } => of_axis(["force_range", "torque_range"], axis as usize),
        ConfigError::ZeroSamples => path.then("zero_samples"),
        ConfigError::NoBias
        | ConfigError::BiasGap
        | ConfigError::Node { .. }
        | ConfigError::CobId { .. }
        | ConfigError::Bus(_) => path.clone(),
    }
}
