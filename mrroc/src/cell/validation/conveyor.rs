//! Checks of emulated conveyors, of objects on them, and of light gates.

use nalgebra::Vector3;

use super::{Checked, refused, within};
use crate::cell::{Cell, EmulatedConveyor, EmulatedGate, EmulatedObject, EmulatedScene, Path, Range, quoted};

/// Greatest number of conveyors, of objects and of light gates, each.
pub(super) const MOST: usize = 64;

/// Greatest share of the travel direction that may be vertical.
const LEVEL: f64 = 1e-6;

pub(super) fn check(cell: &Cell, scene: &EmulatedScene, path: &Path) -> Checked {
    for (key, found) in [("conveyor", scene.conveyor.len()), ("object", scene.object.len()), ("gate", scene.gate.len())]
    {
        if found > MOST {
            return refused(path, key, format!("has {found} entries, may have {MOST}"));
        }
    }
    for (index, conveyor) in scene.conveyor.iter().enumerate() {
        check_conveyor(&path.then("conveyor").then(index), conveyor)?;
    }
    for (index, object) in scene.object.iter().enumerate() {
        check_object(&path.then("object").then(index), object, &scene.conveyor)?;
    }
    for index in 0..scene.gate.len() {
        check_gate(cell, &path.then("gate"), &scene.gate, index)?;
    }
    Ok(())
}

fn check_conveyor(path: &Path, conveyor: &EmulatedConveyor) -> Checked {
    point(&path.then("position"), conveyor.position)?;
    for (axis, size) in conveyor.size.into_iter().enumerate() {
        within(&path.then("size"), axis, size, Range::new(1e-3, 100.0, "m"))?;
    }
    let length = Vector3::from(conveyor.direction).norm();
    if !(length.is_finite() && length > 1e-6) {
        return refused(path, "direction", "has no direction");
    }
    if conveyor.direction[2].abs() > LEVEL * length {
        return refused(path, "direction", "is not horizontal: give a direction without a vertical component");
    }
    within(path, "speed", conveyor.speed, Range::new(-10.0, 10.0, "m/s"))?;
    within(path, "drift", conveyor.drift, Range::new(0.0, 1.0, ""))?;
    within(path, "drift_period_s", conveyor.drift_period_s, Range::new(1e-2, 1e6, "s"))?;
    within(path, "friction", conveyor.friction, Range::new(0.0, 10.0, ""))?;
    within(path, "stiffness", conveyor.stiffness, Range::new(1.0, 1e8, "N/m"))?;
    within(path, "damping", conveyor.damping, Range::new(0.0, 1e6, "N·s/m"))
}

fn check_object(path: &Path, object: &EmulatedObject, conveyors: &[EmulatedConveyor]) -> Checked {
    let (number, count) = (object.conveyor, conveyors.len());
    let Some(conveyor) = conveyors.get(number) else {
        let why = format!("is {number}, and the scene has {count} conveyors, counted from 0");
        return refused(path, "conveyor", why);
    };
    for (axis, size) in object.size.into_iter().enumerate() {
        within(&path.then("size"), axis, size, Range::new(1e-3, 10.0, "m"))?;
    }
    within(path, "mass", object.mass, Range::new(1e-3, 1e4, "kg"))?;
    within(path, "along", object.along, Range::new(-100.0, 100.0, "m"))?;
    within(path, "across", object.across, Range::new(-100.0, 100.0, "m"))?;
    // Only the corners of an object touch the surface.
    for (axis, (key, place)) in [("along", object.along), ("across", object.across)].into_iter().enumerate() {
        let reach = place.abs() + object.size[axis] / 2.0;
        if reach >= conveyor.size[axis] / 2.0 {
            let half = conveyor.size[axis] / 2.0;
            let why = format!("the object reaches {reach:.3} m from the centre, and the surface ends at {half:.3} m");
            return refused(path, key, why);
        }
    }
    within(path, "at_s", object.at_s, Range::new(0.0, 1e6, "s"))
}

fn check_gate(cell: &Cell, path: &Path, gates: &[EmulatedGate], index: usize) -> Checked {
    let (gate, here) = (&gates[index], path.then(index));
    let Some(line) = cell.input_line(&gate.input) else {
        let why = format!("no input is called {}: name one of [[io.input]]", quoted(&gate.input));
        return refused(&here, "input", why);
    };
    let input = cell.io[line.node].input.iter().find(|input| input.line == line.line);
    if input.is_some_and(|input| !input.emulated_edges_s.is_empty()) {
        let why = format!("the input {} has emulated_edges_s: leave out either these or the gate", quoted(&gate.input));
        return refused(&here, "input", why);
    }
    if let Some(first) = gates[..index].iter().position(|other| other.input == gate.input) {
        let why = format!("the input {} has a gate already, {}", quoted(&gate.input), path.then(first));
        return refused(&here, "input", why);
    }
    point(&here.then("from"), gate.from)?;
    point(&here.then("to"), gate.to)?;
    let length = gate.from.iter().zip(gate.to).map(|(from, to)| (to - from).powi(2)).sum::<f64>().sqrt();
    if length < 1e-6 {
        return refused(&here, "to", "is the same point as `from`: a beam has a length");
    }
    within(&here, "response_us", gate.response_us, Range::new(200.0, 1e6, "µs"))?;
    within(&here, "jitter_us", gate.jitter_us, Range::new(0.0, 1e6, "µs"))
}

fn point(path: &Path, point: [f64; 3]) -> Checked {
    for (axis, value) in point.into_iter().enumerate() {
        within(path, axis, value, Range::new(-100.0, 100.0, "m"))?;
    }
    Ok(())
}
