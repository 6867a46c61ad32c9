//! Checks of touch probes in the emulated surroundings.

use super::{Checked, refused, within};
use crate::cell::{Cell, EmulatedScene, Path, Range, quoted};

/// Greatest number of touch probes of a scene.
const MOST: usize = 32;

pub(super) fn check(cell: &Cell, path: &Path, scene: &EmulatedScene) -> Checked {
    let probes = &scene.touch_probe;
    if probes.len() > MOST {
        return refused(path, "touch_probe", format!("has {} probes, may have {MOST}", probes.len()));
    }
    if !probes.is_empty() && scene.robot.is_none() {
        return refused(path, "robot", "is missing: touch probes are at the tool of this robot");
    }
    for (index, probe) in probes.iter().enumerate() {
        let path = path.then("touch_probe").then(index);
        let lines = || cell.io.iter().flat_map(|io| &io.input);
        let Some(input) = lines().find(|input| input.name == probe.input) else {
            let known: Vec<_> = lines().map(|input| input.name.as_str()).collect();
            let why = format!("no input is called {}, only {}", quoted(&probe.input), known.join(", "));
            return refused(&path, "input", why);
        };
        if !input.emulated_edges_s.is_empty() {
            let why =
                format!("is {}, whose levels are scheduled: leave out its emulated_edges_s", quoted(&probe.input));
            return refused(&path, "input", why);
        }
        if probes[..index].iter().any(|other| other.input == probe.input) {
            return refused(&path, "input", format!("is {}, which has a touch probe already", quoted(&probe.input)));
        }
        if scene.gate.iter().any(|gate| gate.input == probe.input) {
            return refused(&path, "input", format!("is {}, which has a light gate already", quoted(&probe.input)));
        }
        within(&path, "force", probe.force, Range::new(1e-3, 1e4, "N"))?;
    }
    Ok(())
}
