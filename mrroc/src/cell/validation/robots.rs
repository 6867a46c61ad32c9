//! Checks of robots: names, parameters, axes, emulated payloads.

use super::axis::{self, Place};
use super::{Checked, MOST, first_same, name, program, refused, some, twice, weight, within};
use crate::cell::error::Problem;
use crate::cell::{Axis, Cell, Path, Plant, Range, Robot};

pub(super) fn check(cell: &Cell) -> Checked {
    let robots = Path::default().then("robot");
    some(&robots, cell.robot.len(), MOST, "robots")?;
    let mut taken: Vec<(String, Path)> = Vec::new();
    for (index, robot) in cell.robot.iter().enumerate() {
        let path = robots.then(index);
        name(&path.then("name"), &robot.name)?;
        let before = cell.robot[..index].iter().map(|it| &it.name);
        if let Some(first) = first_same(before, &&robot.name) {
            let problem = twice(format!("robot {:?}", robot.name), &robots.then(first));
            return Err((path.then("name"), problem));
        }
        check_parameters(&path.then("parameters"), robot)?;
        let kinematics = robot
            .kinematics()
            .map_err(|error| (path.then("parameters"), Problem::Refused(error.to_string())))?;
        let (found, expected) = (robot.axis.len(), robot.model.axes());
        if found != expected {
            let what = "axes";
            let problem = Problem::Count {
                found,
                expected,
                what,
            };
            return Err((path.then("axis"), problem));
        }
        let axes = path.then("axis");
        let (limits, home) = (kinematics.motor_limits(), kinematics.home());
        for (number, axis) in robot.axis.iter().enumerate() {
            let path = axes.then(number);
            name(&path.then("name"), &axis.name)?;
            let before = robot.axis[..number].iter().map(|it| &it.name);
            if let Some(first) = first_same(before, &&axis.name) {
                let problem = twice(format!("axis {:?}", axis.name), &axes.then(first));
                return Err((path.then("name"), problem));
            }
            let place = Place::of(cell, &axis.bus).ok_or_else(|| {
                let (kind, name) = ("bus", axis.bus.clone());
                (path.then("bus"), Problem::Unknown { kind, name })
            })?;
            axis::check(
                &path,
                cell.period(),
                axis,
                place,
                limits[number],
                home[number],
            )?;
            if !robot
                .model
                .parameters()
                .plants()
                .contains(&axis.emulator.plant)
            {
                let why = "is wut, which is known of the robots on pedestals only: use physical";
                return refused(path.then("emulator").then("plant"), why);
            }
            let (key, what) = place_of(&path, axis, place)?;
            if let Some((_, first)) = taken.iter().find(|(other, _)| *other == what) {
                return Err((path.then(key), twice(what, first)));
            }
            taken.push((what, path));
        }
        check_tool(&path.then("tool"), robot)?;
        weight::check(&path, robot, &*kinematics)?;
        program::check(&path.then("program"), robot)?;
        check_payloads(&path.then("emulated_payload"), robot)?;
    }
    Ok(())
}

/// The bus or bundle of an axis, and the key that names it.
fn place_of(
    path: &Path,
    axis: &Axis,
    place: Place<'_>,
) -> Result<(&'static str, String), (Path, Problem)> {
    match place {
        Place::Bus(bus) => {
            let what = format!("node {} of bus {:?}", axis.node, bus.name);
            if axis.node == bus.host_node {
                let first = "the host".into();
                return Err((path.then("node"), Problem::Twice { what, first }));
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
    let usual = robot.model.parameters();
    match &robot.parameters {
        Some(given) if given.name() != usual.name() => {
            let (found, expected) = (given.name(), usual.name());
            let why = format!("is of an {found}, must be {{ {expected} = … }} for this model");
            refused(path.clone(), why)
        }
        _ => Ok(()),
    }
}

fn check_tool(path: &Path, robot: &Robot) -> Checked {
    for (number, part) in robot.tool.into_iter().enumerate() {
        within(&path.then(number), part, Range::new(-10.0, 10.0, "m"))?;
    }
    Ok(())
}

fn check_payloads(path: &Path, robot: &Robot) -> Checked {
    for (number, payload) in robot.emulated_payload.iter().enumerate() {
        let path = path.then(number);
        if robot.model.parameters().mechanism().is_none() {
            let why = "is of a gripper or conveyor, whose emulation carries nothing: leave it out";
            return refused(path, why);
        }
        if let Some(axis) = robot.axis.iter().find(|it| it.emulator.plant == Plant::Wut) {
            let name = &axis.name;
            let why =
                format!("would not be felt by axis {name:?}, whose plant is wut: use physical");
            return refused(path, why);
        }
        within(&path.then("at_s"), payload.at_s, Range::new(0.0, 1e6, "s"))?;
        within(&path.then("mass"), payload.mass, Range::new(0.0, 1e3, "kg"))?;
        for (number, part) in payload.centre.into_iter().enumerate() {
            let centre = path.then("centre").then(number);
            within(&centre, part, Range::new(-10.0, 10.0, "m"))?;
        }
    }
    Ok(())
}
