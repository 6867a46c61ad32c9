//! Checks of the force laws of robots.

use super::{Checked, refused, within};
use crate::cell::{Cell, ForceLaw, Path, Range, Robot, quoted};
use can::counted;

pub(super) fn check(cell: &Cell) -> Checked {
    for (index, robot) in cell.robot.iter().enumerate() {
        if let Some(law) = &robot.force_law {
            check_law(cell, robot, &Path::to("robot").then(index).then("force_law"), law)?;
        }
    }
    Ok(())
}

fn check_law(cell: &Cell, robot: &Robot, path: &Path, law: &ForceLaw) -> Checked {
    let Some(sensor) = law.sensor(&cell.force_sensor).map(|index| &cell.force_sensor[index]) else {
        return refused(path, "sensor", format!("no force sensor is called {}", quoted(&law.sensor)));
    };
    if sensor.robot != robot.name {
        let why = format!("{:?} sits at robot {:?}, and must sit at robot {:?}", law.sensor, sensor.robot, robot.name);
        return refused(path, "sensor", why);
    }
    let wrenches = [("force", law.force, sensor.force_range, "N"), ("torque", law.torque, sensor.torque_range, "N·m")];
    for (key, limits, ranges, unit) in wrenches {
        for (axis, (limit, range)) in limits.into_iter().zip(ranges).enumerate() {
            // A limit beyond the range would never be exceeded: a saturated sensor is a fault by itself.
            within(&path.then(key), axis, limit, Range::new(1e-6, range, unit))?;
        }
    }
    let count = robot.axis.len();
    let lists = [("displacement", &law.displacement), ("velocity", &law.velocity), ("acceleration", &law.acceleration)];
    for (key, values) in lists {
        if values.len() != count {
            return refused(
                path,
                key,
                format!("has {}, must have {count}, one per axis", counted(values.len(), "value")),
            );
        }
    }
    let arm = robot.kinematics().map_err(|error| (path.clone(), error.to_string()))?;
    for (axis, (given, limits)) in robot.axis.iter().zip(arm.motor_limits()).enumerate() {
        let travel = limits.high - limits.low;
        within(&path.then("displacement"), axis, law.displacement[axis], Range::new(1e-9, travel, "rad"))?;
        within(&path.then("velocity"), axis, law.velocity[axis], Range::new(1e-9, given.max_velocity, "rad/s"))?;
        let most = Range::new(1e-9, given.max_acceleration, "rad/s²");
        within(&path.then("acceleration"), axis, law.acceleration[axis], most)?;
    }
    // A sample is one period old when the next one is due in the same cycle.
    let interval = sensor.sample_period(cell.period()).div_duration_f64(cell.period()).ceil();
    within(path, "max_age_periods", law.max_age_periods, Range::new(1.0 + interval, 1000.0, "periods"))
}
