//! Checks of the emulated surroundings.

use super::{Checked, force::check_robot, refused, some, touch, within};
use crate::cell::{Cell, EmulatedBlock, EmulatedPlane, Path, Range};

/// Greatest number of planes and blocks of a scene.
const MOST: usize = 32;

pub(super) fn check(cell: &Cell) -> Checked {
    let Some(scene) = &cell.scene else {
        return Ok(());
    };
    let path = Path::to("scene");
    check_robot(cell, &path, &scene.robot, "robot")?;
    within(&path, "tip_radius", scene.tip_radius, Range::new(0.0, 1.0, "m"))?;
    let planes = path.then("plane");
    let count = scene.plane.len() + scene.block.len();
    some(&path, if scene.plane.is_empty() { "block" } else { "plane" }, count, MOST, "planes and blocks")?;
    for (index, plane) in scene.plane.iter().enumerate() {
        let path = planes.then(index);
        let &EmulatedPlane { normal, height, stiffness, damping, friction } = plane;
        let length = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
        if !(length.is_finite() && length > 1e-6) {
            return refused(&path, "normal", "has no direction");
        }
        within(&path, "height", height, Range::new(-100.0, 100.0, "m"))?;
        check_material(&path, stiffness, damping, friction)?;
    }
    let blocks = path.then("block");
    for (index, block) in scene.block.iter().enumerate() {
        let path = blocks.then(index);
        let &EmulatedBlock { centre, size, stiffness, damping, friction } = block;
        for (axis, (centre, size)) in centre.into_iter().zip(size).enumerate() {
            within(&path.then("centre"), axis, centre, Range::new(-100.0, 100.0, "m"))?;
            within(&path.then("size"), axis, size, Range::new(1e-4, 100.0, "m"))?;
        }
        check_material(&path, stiffness, damping, friction)?;
    }
    touch::check(cell, &path, &scene.touch_probe)
}

fn check_material(path: &Path, stiffness: f64, damping: f64, friction: f64) -> Checked {
    within(path, "stiffness", stiffness, Range::new(1.0, 1e8, "N/m"))?;
    within(path, "damping", damping, Range::new(0.0, 1e6, "N·s/m"))?;
    within(path, "friction", friction, Range::new(0.0, 10.0, ""))
}
