//! Checks of robots: names, parameters, axes, emulated payloads.

use super::axis::{self, Place};
use super::{Checked, MOST, count, name, program, refused, some, twice, unique, weight, within};
use crate::cell::{Axis, Cell, Model, Path, Plant, Range, Robot, quoted};

/// Coordinates of a tool and of a centre of mass.
pub(super) const NEAR: Range = Range::new(-10.0, 10.0, "m");

pub(super) fn check(cell: &Cell) -> Checked {
    let robots = Path::to("robot");
    some(&Path::default(), "robot", cell.robot.len(), MOST, "robots")?;
    let mut taken: Vec<(String, Path)> = Vec::new();
    for (index, robot) in cell.robot.iter().enumerate() {
        let path = robots.then(index);
        name(&path, "name", &robot.name)?;
        unique(&robots, "name", index, cell.robot.iter().map(|it| &it.name), |name| format!("robot {name:?}"))?;
        check_parameters(&path, robot)?;
        let key = if robot.chain.is_some() { "chain" } else { "parameters" };
        let kinematics = robot.kinematics().map_err(|error| (path.then(key), error.to_string()))?;
        robot.numbers().check_mechanism().map_err(|error| (path.then(key), error))?;
        let axes = path.then("axis");
        count(axes.clone(), robot.axis.len(), robot.numbers().axes(), "axis")?;
        let (limits, home) = (kinematics.motor_limits(), kinematics.home());
        for (number, axis) in robot.axis.iter().enumerate() {
            let path = axes.then(number);
            name(&path, "name", &axis.name)?;
            unique(&axes, "name", number, robot.axis.iter().map(|it| &it.name), |name| format!("axis {name:?}"))?;
            let Some(place) = Place::of(cell, &axis.bus) else {
                return refused(&path, "bus", format!("no bus is called {}", quoted(&axis.bus)));
            };
            axis::check(&path, cell.period(), axis, place, limits[number], home[number])?;
            if !robot.numbers().plants().contains(&axis.emulator.plant) {
                let why = "is wut, which is known of the robots on pedestals only: use physical";
                return refused(&path.then("emulator"), "plant", why);
            }
            let (key, what) = place_of(&path, axis, place)?;
            if let Some((_, first)) = taken.iter().find(|(other, _)| *other == what) {
                return refused(&path, key, twice(&what, first));
            }
            taken.push((what, path));
        }
        for (number, part) in robot.tool.into_iter().enumerate() {
            within(&path.then("tool"), number, part, NEAR)?;
        }
        weight::check(&path, robot, &*kinematics)?;
        program::check(&path, robot)?;
        check_payloads(&path.then("emulated_payload"), robot)?;
    }
    Ok(())
}

/// The bus or bundle of an axis, and the key that names it.
fn place_of(path: &Path, axis: &Axis, place: Place<'_>) -> Result<(&'static str, String), (Path, String)> {
    match place {
        Place::Bus(bus) => {
            let what = format!("node {} of bus {:?}", axis.node, bus.name);
            if axis.node == bus.host_node {
                return Err((path.then("node"), twice(&what, &"the host")));
            }
            Ok(("node", what))
        }
        Place::Serial(_) => {
            let line = axis.controller.as_ref().map_or("", |it| it.line.as_str());
            Ok(("controller", format!("line {line:?}")))
        }
    }
}

/// The parameters must be of the robot's model, even if another model has as many axes.
fn check_parameters(path: &Path, robot: &Robot) -> Checked {
    let Some(usual) = robot.model.map(Model::parameters) else {
        return Ok(());
    };
    match &robot.parameters {
        Some(given) if given.name() != usual.name() => {
            let (found, expected) = (given.name(), usual.name());
            refused(path, "parameters", format!("is of an {found}, must be {{ {expected} = … }} for this model"))
        }
        _ => Ok(()),
    }
}

fn check_payloads(payloads: &Path, robot: &Robot) -> Checked {
    for (number, payload) in robot.emulated_payload.iter().enumerate() {
        let path = payloads.then(number);
        if robot.numbers().mechanism().is_none() {
            let why = "is of a robot whose emulated axes carry no common load: leave it out";
            return refused(payloads, number, why);
        }
        if let Some(axis) = robot.axis.iter().find(|it| it.emulator.plant == Plant::Wut) {
            let why = format!("would not be felt by axis {:?}, whose plant is wut: use physical", axis.name);
            return refused(payloads, number, why);
        }
        within(&path, "at_s", payload.at_s, Range::new(0.0, 1e6, "s"))?;
        within(&path, "mass", payload.mass, Range::new(0.0, 1e3, "kg"))?;
        for (number, part) in payload.centre.into_iter().enumerate() {
            within(&path.then("centre"), number, part, NEAR)?;
        }
    }
    Ok(())
}
