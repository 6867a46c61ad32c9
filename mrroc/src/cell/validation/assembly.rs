//! Checks that drive groups and the servo accept the cell, with refusals reported by the keys of the cell.
//!
//! The bounds in the other modules are narrower and use the units of the file. The checks here are those of the
//! drivers and the servo.

use controller::robot::ParameterError;
use drive::{axis_controller, cia401, cia402, wrench};

use super::{Checked, can_force_sensor};
use crate::cell::{Cell, Path};

pub(super) fn check(cell: &Cell) -> Checked {
    let homes = cell.robot.iter().map(|robot| {
        let robot = robot.kinematics()?;
        Ok((robot.home(), robot.motor_limits().to_vec()))
    });
    let homes: Result<Vec<_>, ParameterError> = homes.collect();
    let homes = homes.map_err(|error| (Path::to("robot"), error.to_string()))?;
    let given = |&(robot, axis): &(usize, usize)| (&cell.robot[robot].axis[axis], homes[robot].0[axis]);
    for index in 0..cell.bus.len() {
        let axes: Vec<_> = cell.axes_on(index).collect();
        let configs: Vec<_> = axes.iter().map(given).map(|(axis, home)| axis.drive_config(home)).collect();
        cell.group_config(index).check(&configs).map_err(|error| {
            let bus = Path::to("bus").then(index);
            (place_of_drive(cell, &bus, &axes, error), error.to_string())
        })?;
        let io = cell.io_configs(index);
        let sensors = cell.sensor_configs(index);
        let group = cell.group_config(index);
        let only_sensors = axes.is_empty() && io.is_empty() && !sensors.is_empty();
        let checked = if only_sensors { Ok(()) } else { cia401::check(&group, &configs, &io) };
        checked.map_err(|error| {
            let nodes = Path::to("io");
            let concerned = cell.io_on(index).find(|&node| concerns(error, cell.io[node].node));
            let place = concerned.map_or(nodes.clone(), |node| nodes.then(node));
            (place_of_io(place, error), error.to_string())
        })?;
        wrench::check(&group, &configs, &io, &sensors)
            .map_err(|error| (can_force_sensor::place_of(cell, index, &error), error.to_string()))?;
    }
    for (index, bundle) in cell.serial.iter().enumerate() {
        let axes: Vec<_> = cell.axes_on(cell.bus.len() + index).collect();
        let configs: Vec<_> = axes.iter().map(given).map(|(axis, home)| axis.controller_config(home)).collect();
        match bundle.group_config(cell.period()).check(&configs, axes.len()) {
            // The budget of the line refuses such a period and proposes one that fits.
            Ok(()) | Err(axis_controller::ConfigError::Period { .. }) => {}
            Err(error) => {
                let bundle = Path::to("serial").then(index);
                return Err((place_of_controller(cell, &bundle, &axes, error), error.to_string()));
            }
        }
    }
    for (number, robot) in cell.robot.iter().enumerate() {
        for axis in 0..robot.axis.len() {
            if let Some(field) = robot.servo_config(axis, 0, 0, homes[number].1[axis]).nonsense() {
                return Err((Path::axis(number, axis), format!("{field} makes no sense")));
            }
        }
    }
    Ok(())
}

/// The key for an error of a drive group on `bus`.
fn place_of_drive(cell: &Cell, bus: &Path, axes: &[(usize, usize)], error: cia402::ConfigError) -> Path {
    use cia402::{ConfigError, Quantity};
    let of_node = |node: u8| {
        let axis = |&&(robot, axis): &&(usize, usize)| cell.robot[robot].axis[axis].node == node;
        axes.iter().find(axis).map_or(bus.clone(), |&(robot, axis)| Path::axis(robot, axis))
    };
    match error {
        ConfigError::NoNodes => bus.clone(),
        ConfigError::Period(_) => Path::to("period_us"),
        ConfigError::HeartbeatPeriod(_) => bus.then("heartbeat_ms"),
        ConfigError::DuplicateNode(node) => of_node(node).then("node"),
        ConfigError::IoOutOfRange { .. } => bus.clone(),
        ConfigError::Setting { node, .. } => of_node(node).then("drive").then("parameter"),
        ConfigError::OutOfRange { node, quantity } => {
            let axis = of_node(node);
            match quantity {
                Quantity::RatedTorque => axis.then("drive").then("rated_torque"),
                Quantity::PlausibleVelocity => axis.then("max_velocity"),
                Quantity::PlausibleAcceleration => axis.then("max_acceleration"),
                Quantity::FollowingError => axis.then("following_error"),
                Quantity::QuickStopDeceleration => axis.then("max_acceleration"),
                Quantity::SearchSpeed => axis.then("homing").then("search_velocity"),
                Quantity::ZeroSpeed => axis.then("homing").then("zero_velocity"),
                Quantity::HomingAcceleration => axis.then("homing").then("acceleration"),
                Quantity::EmergencyInput => axis.then("drive").then("emergency_stop").then("input"),
            }
        }
    }
}

/// Whether an error is of the I/O node with this node-ID.
fn concerns(error: cia402::ConfigError, io: u8) -> bool {
    use cia402::ConfigError;
    match error {
        ConfigError::IoOutOfRange { node, .. }
        | ConfigError::Setting { node, .. }
        | ConfigError::DuplicateNode(node) => node == io,
        ConfigError::NoNodes
        | ConfigError::Period(_)
        | ConfigError::HeartbeatPeriod(_)
        | ConfigError::OutOfRange { .. } => false,
    }
}

/// The key for an error of the I/O node at `io`.
fn place_of_io(io: Path, error: cia402::ConfigError) -> Path {
    use cia401::IoQuantity;
    match error {
        cia402::ConfigError::DuplicateNode(_) => io.then("node"),
        cia402::ConfigError::Setting { .. } => io.then("parameter"),
        cia402::ConfigError::IoOutOfRange { quantity, .. } => match quantity {
            IoQuantity::Channels | IoQuantity::InputMask => io.then("input"),
            IoQuantity::OutputMask => io.then("output"),
            IoQuantity::InhibitTime => io.then("inhibit_us"),
            IoQuantity::EventTimer => io.then("event_timer_ms"),
        },
        cia402::ConfigError::NoNodes
        | cia402::ConfigError::Period(_)
        | cia402::ConfigError::HeartbeatPeriod(_)
        | cia402::ConfigError::OutOfRange { .. } => io,
    }
}

/// The key for an error of a group of axis controllers on `bundle`.
fn place_of_controller(
    cell: &Cell,
    bundle: &Path,
    axes: &[(usize, usize)],
    error: axis_controller::ConfigError,
) -> Path {
    use axis_controller::{ConfigError, Quantity};
    let of_line = |line: u8| axes[usize::from(line)];
    match error {
        ConfigError::Axes(_) | ConfigError::Lines { .. } => bundle.clone(),
        ConfigError::Period { .. } => bundle.then("baud"),
        ConfigError::ToleratedMissing => bundle.then("tolerated_missing"),
        ConfigError::NeedsNfv2 { line } => {
            let (robot, axis) = of_line(line);
            Path::axis(robot, axis).then("controller").then("control")
        }
        ConfigError::OutOfRange { line, quantity } => {
            let (robot, axis) = of_line(line);
            let path = Path::axis(robot, axis);
            let controller = path.then("controller");
            let given = cell.robot[robot].axis[axis].axis_controller();
            let plausible = |key, given: Option<f64>, of_axis| match given {
                Some(_) => controller.then(key),
                None => path.then(of_axis),
            };
            match quantity {
                Quantity::Address => path.then("node"),
                Quantity::TorqueConstant => controller.then("torque_constant"),
                Quantity::MaxCurrent => controller.then("max_current"),
                Quantity::MaxVelocity => plausible("plausible_velocity", given.plausible_velocity, "max_velocity"),
                Quantity::MaxAcceleration => {
                    plausible("plausible_acceleration", given.plausible_acceleration, "max_acceleration")
                }
            }
        }
    }
}
