//! Checks of the emulated surroundings.

use super::{Checked, conveyor, force::check_robot, refused, some, within};
use crate::cell::{Cell, EmulatedPlane, Path, Range};

/// Greatest number of planes of a scene.
const MOST: usize = 32;

pub(super) fn check(cell: &Cell) -> Checked {
    let Some(scene) = &cell.scene else {
        return Ok(());
    };
    let path = Path::to("scene");
    check_robot(cell, &path, &scene.robot, "robot")?;
    within(&path, "tip_radius", scene.tip_radius, Range::new(0.0, 1.0, "m"))?;
    let planes = path.then("plane");
    // A scene has planes or conveyors.
    if scene.conveyor.is_empty() || scene.plane.len() > MOST {
        some(&path, "plane", scene.plane.len(), MOST, "planes")?;
    }
    conveyor::check(cell, scene, &path)?;
    for (index, plane) in scene.plane.iter().enumerate() {
        let path = planes.then(index);
        let &EmulatedPlane { normal, height, stiffness, damping, friction } = plane;
        let length = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
        if !(length.is_finite() && length > 1e-6) {
            return refused(&path, "normal", "has no direction");
        }
        within(&path, "height", height, Range::new(-100.0, 100.0, "m"))?;
        within(&path, "stiffness", stiffness, Range::new(1.0, 1e8, "N/m"))?;
        within(&path, "damping", damping, Range::new(0.0, 1e6, "N·s/m"))?;
        within(&path, "friction", friction, Range::new(0.0, 10.0, ""))?;
    }
    Ok(())
}
