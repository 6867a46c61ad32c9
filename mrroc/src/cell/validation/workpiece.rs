//! Checks of emulated workpieces and cutting tools.

use hil::scene::MOST_CELLS;

use super::scene::{WITHIN, check_material, check_place};
use super::{Checked, force::check_robot, name, refused, unique, within};
use crate::cell::{Cell, EmulatedCutter, EmulatedScene, EmulatedWorkpiece, Path, Range, quoted};

pub(super) fn check(cell: &Cell, scene: &EmulatedScene, path: &Path) -> Checked {
    let workpieces = path.then("workpiece");
    for (index, workpiece) in scene.workpiece.iter().enumerate() {
        check_workpiece(&workpieces.then(index), workpiece)?;
        unique(&workpieces, "name", index, scene.workpiece.iter().map(|it| &it.name), |name| {
            format!("workpiece {name:?}")
        })?;
    }
    let cutters = path.then("cutter");
    for (index, cutter) in scene.cutter.iter().enumerate() {
        check_cutter(cell, &cutters.then(index), cutter)?;
        unique(&cutters, "robot", index, scene.cutter.iter().map(|it| &it.robot), |it| format!("robot {it:?}"))?;
    }
    if !scene.cutter.is_empty() && scene.workpiece.is_empty() {
        return refused(path, "cutter", "has nothing to cut: add the workpiece as [[scene.workpiece]]");
    }
    Ok(())
}

fn check_workpiece(path: &Path, workpiece: &EmulatedWorkpiece) -> Checked {
    name(path, "name", &workpiece.name)?;
    check_place(&path.then("place"), &workpiece.place, WITHIN)?;
    within(path, "cell_width", workpiece.cell_width, Range::new(1e-5, 0.1, "m"))?;
    for (axis, size) in workpiece.size.into_iter().enumerate() {
        let least = if axis < 2 { workpiece.cell_width } else { 1e-5 };
        within(&path.then("size"), axis, size, Range::new(least, 10.0, "m"))?;
    }
    let [columns, rows] = workpiece.config().cells();
    if columns.saturating_mul(rows) > MOST_CELLS {
        let why = format!("gives {columns} by {rows} cells, may give {MOST_CELLS}: use wider cells or a smaller size");
        return refused(path, "cell_width", why);
    }
    within(path, "specific_force", workpiece.specific_force, Range::new(0.0, 1e10, "N/m²"))?;
    within(path, "edge_force", workpiece.edge_force, Range::new(0.0, 1e6, "N/m"))?;
    check_material(path, workpiece.stiffness, workpiece.damping, workpiece.friction)
}

fn check_cutter(cell: &Cell, path: &Path, cutter: &EmulatedCutter) -> Checked {
    check_robot(cell, path, &cutter.robot, "robot")?;
    within(path, "diameter", cutter.diameter, Range::new(1e-4, 0.2, "m"))?;
    if let Some(spindle) = &cutter.spindle
        && cell.output_line(spindle).is_none()
    {
        let why = format!("no digital output is called {}: add it as [[io.output]]", quoted(spindle));
        return refused(path, "spindle", why);
    }
    Ok(())
}
