//! Checks of the emulated surroundings.

use super::{Checked, conveyor, force::check_robot, name, refused, robots::NEAR, touch, twice, unique, within};
use crate::cell::{Cell, EmulatedBar, EmulatedBlock, EmulatedGripper, EmulatedPlane, Path, Place, Range, quoted};

/// Greatest number of planes, blocks, tips, bars, grippers, workpieces or cutting tools of a scene.
const MOST: usize = 32;

/// Coordinates in a cell.
pub(super) const WITHIN: Range = Range::new(-100.0, 100.0, "m");

/// Angle of a place.
const TURN: Range = Range::new(-10.0, 10.0, "rad");

pub(super) fn check(cell: &Cell) -> Checked {
    check_bases(cell)?;
    let Some(scene) = &cell.scene else {
        return Ok(());
    };
    let path = Path::to("scene");
    let counts = [
        ("tip", scene.tip.len()),
        ("plane", scene.plane.len()),
        ("block", scene.block.len()),
        ("bar", scene.bar.len()),
        ("gripper", scene.gripper.len()),
        ("workpiece", scene.workpiece.len()),
        ("cutter", scene.cutter.len()),
    ];
    for (key, found) in counts {
        if found > MOST {
            return refused(&path, key, format!("has {found} entries, may have {MOST}"));
        }
    }
    let solids = scene.plane.len() + scene.block.len() + scene.bar.len() + scene.conveyor.len() + scene.workpiece.len();
    if solids == 0 {
        return refused(
            &path,
            "plane",
            "has no planes, blocks, bars, conveyors and workpieces, must have at least one",
        );
    }
    if let Some(robot) = &scene.robot {
        check_robot(cell, &path, robot, "robot")?;
    } else if scene.tip_radius != 0.0 {
        return refused(&path, "tip_radius", "has no effect without robot: add the robot, or use [[scene.tip]]");
    }
    within(&path, "tip_radius", scene.tip_radius, RADIUS)?;
    check_tips(cell, &path)?;
    let planes = path.then("plane");
    for (index, plane) in scene.plane.iter().enumerate() {
        check_plane(&planes.then(index), plane)?;
    }
    let blocks = path.then("block");
    for (index, block) in scene.block.iter().enumerate() {
        check_block(&blocks.then(index), block)?;
    }
    let bars = path.then("bar");
    for (index, bar) in scene.bar.iter().enumerate() {
        check_bar(&bars.then(index), bar)?;
        unique(&bars, "name", index, scene.bar.iter().map(|it| &it.name), |name| format!("bar {name:?}"))?;
    }
    let grippers = path.then("gripper");
    for (index, gripper) in scene.gripper.iter().enumerate() {
        check_gripper(cell, &grippers.then(index), gripper)?;
        unique(&grippers, "robot", index, scene.gripper.iter().map(|it| &it.robot), |it| format!("robot {it:?}"))?;
    }
    conveyor::check(cell, scene, &path)?;
    touch::check(cell, &path, scene)?;
    super::workpiece::check(cell, scene, &path)
}

const RADIUS: Range = Range::new(0.0, 1.0, "m");

fn check_bases(cell: &Cell) -> Checked {
    let robots = Path::to("robot");
    for (index, robot) in cell.robot.iter().enumerate() {
        let path = robots.then(index);
        check_place(&path.then("base"), &robot.base, WITHIN)?;
        check_place(&path.then("emulated_base_error"), &robot.emulated_base_error, NEAR)?;
    }
    Ok(())
}

fn check_tips(cell: &Cell, path: &Path) -> Checked {
    let Some(scene) = &cell.scene else {
        return Ok(());
    };
    let tips = path.then("tip");
    for (index, tip) in scene.tip.iter().enumerate() {
        let here = tips.then(index);
        check_robot(cell, &here, &tip.robot, "robot")?;
        within(&here, "radius", tip.radius, RADIUS)?;
        if scene.robot.as_ref() == Some(&tip.robot) {
            return refused(&here, "robot", twice(&format!("robot {:?}", tip.robot), &path.then("robot")));
        }
        unique(&tips, "robot", index, scene.tip.iter().map(|it| &it.robot), |it| format!("robot {it:?}"))?;
    }
    Ok(())
}

fn check_plane(path: &Path, plane: &EmulatedPlane) -> Checked {
    let &EmulatedPlane { normal, height, stiffness, damping, friction } = plane;
    let length = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
    if !(length.is_finite() && length > 1e-6) {
        return refused(path, "normal", "has no direction");
    }
    within(path, "height", height, WITHIN)?;
    check_material(path, stiffness, damping, friction)
}

fn check_block(path: &Path, block: &EmulatedBlock) -> Checked {
    let &EmulatedBlock { centre, size, stiffness, damping, friction } = block;
    for (axis, (centre, size)) in centre.into_iter().zip(size).enumerate() {
        within(&path.then("centre"), axis, centre, WITHIN)?;
        within(&path.then("size"), axis, size, Range::new(1e-4, 100.0, "m"))?;
    }
    check_material(path, stiffness, damping, friction)
}

pub(super) fn check_material(path: &Path, stiffness: f64, damping: f64, friction: f64) -> Checked {
    within(path, "stiffness", stiffness, Range::new(1.0, 1e8, "N/m"))?;
    within(path, "damping", damping, Range::new(0.0, 1e6, "N·s/m"))?;
    within(path, "friction", friction, Range::new(0.0, 10.0, ""))
}

fn check_bar(path: &Path, bar: &EmulatedBar) -> Checked {
    name(path, "name", &bar.name)?;
    within(path, "mass", bar.mass, Range::new(1e-3, 1e3, "kg"))?;
    within(path, "length", bar.length, Range::new(1e-3, 10.0, "m"))?;
    within(path, "width", bar.width, Range::new(1e-3, 10.0, "m"))?;
    check_place(&path.then("place"), &bar.place, WITHIN)
}

fn check_gripper(cell: &Cell, path: &Path, gripper: &EmulatedGripper) -> Checked {
    check_robot(cell, path, &gripper.robot, "robot")?;
    if cell.output_line(&gripper.output).is_none() {
        let why = format!("no digital output is called {}: add it as [[io.output]]", quoted(&gripper.output));
        return refused(path, "output", why);
    }
    within(path, "reach", gripper.reach, RADIUS)?;
    within(path, "stiffness", gripper.stiffness, Range::new(0.0, 1e8, "N/m"))?;
    within(path, "damping", gripper.damping, Range::new(0.0, 1e6, "N·s/m"))?;
    within(path, "turning_stiffness", gripper.turning_stiffness, Range::new(0.0, 1e8, "N·m/rad"))?;
    within(path, "turning_damping", gripper.turning_damping, Range::new(0.0, 1e6, "N·m·s/rad"))
}

pub(super) fn check_place(path: &Path, place: &Place, range: Range) -> Checked {
    let position = path.then("position");
    for (axis, part) in place.position.into_iter().enumerate() {
        within(&position, axis, part, range)?;
    }
    within(path, "yaw", place.yaw, TURN)
}
