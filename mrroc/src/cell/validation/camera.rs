//! Checks of network cameras.

use std::net::SocketAddr;

use super::force::{check_name_of, check_quaternion};
use super::{Checked, refused, robots::NEAR, twice, unique, within};
use crate::cell::{Camera, Cell, Path, Range, quoted};

/// Greatest number of cameras of a cell.
pub(super) const MOST: usize = 8;

/// Latest time of an emulated event, s.
const LATEST: f64 = 1e6;

pub(super) fn check(cell: &Cell) -> Checked {
    let list = Path::to("camera");
    if cell.camera.len() > MOST {
        return Err((list, format!("has {} cameras, may have {MOST}", cell.camera.len())));
    }
    for (index, camera) in cell.camera.iter().enumerate() {
        let path = list.then(index);
        check_name_of(cell, &path, &camera.name)?;
        unique(&list, "name", index, cell.camera.iter().map(|it| &it.name), |it| format!("camera {it:?}"))?;
        let forces = cell.force_sensor.iter().position(|it| it.name == camera.name);
        let matrices = || cell.ultrasonic.iter().position(|it| it.name == camera.name);
        let forces = forces.map(|number| Path::to("force_sensor").then(number));
        if let Some(first) = forces.or_else(|| matrices().map(|number| Path::to("ultrasonic").then(number))) {
            return refused(&path, "name", twice(&format!("the name {:?}", camera.name), &first));
        }
        if !cell.robot.iter().any(|robot| robot.name == camera.robot) {
            let known: Vec<_> = cell.robot.iter().map(|robot| robot.name.as_str()).collect();
            let why = format!("no robot is called {}, only {}", quoted(&camera.robot), known.join(", "));
            return refused(&path, "robot", why);
        }
        if !camera.address.parse::<SocketAddr>().is_ok_and(|address| address.port() != 0) {
            let why =
                format!("is {}, must be an IP address and a port, like 192.168.1.20:5600", quoted(&camera.address));
            return refused(&path, "address", why);
        }
        unique(&list, "address", index, cell.camera.iter().map(|it| &it.address), |it| format!("address {it:?}"))?;
        check_numbers(&path, camera)?;
    }
    Ok(())
}

fn check_numbers(path: &Path, camera: &Camera) -> Checked {
    let sides = || Range::new(16.0, 1024.0, "pixels");
    let periods = || Range::new(10.0, 4000.0, "ms");
    within(path, "width", camera.width, sides())?;
    within(path, "height", camera.height, sides())?;
    within(path, "field_of_view", camera.field_of_view, Range::new(0.01, 3.0, "rad"))?;
    within(path, "period_ms", camera.period_ms, periods())?;
    for (axis, part) in camera.position.into_iter().enumerate() {
        within(&path.then("position"), axis, part, NEAR)?;
    }
    check_quaternion(path, camera.quaternion)?;
    within(path, "tolerated_missing", camera.tolerated_missing, Range::new(0.0, 1000.0, "pictures"))?;
    let emulator = path.then("emulator");
    let given = camera.emulator;
    within(&emulator, "silent_from_s", given.silent_from_s.unwrap_or(0.0), Range::new(0.0, LATEST, "s"))?;
    within(&emulator, "width", given.width.unwrap_or(camera.width), sides())?;
    within(&emulator, "period_ms", given.period_ms.unwrap_or(camera.period_ms), periods())?;
    let period = given.period_ms.unwrap_or(camera.period_ms);
    within(&emulator, "exposure_ms", given.exposure_ms, Range::new(0.001, period.into(), "ms"))?;
    within(&emulator, "noise", given.noise, Range::new(0.0, 100.0, "grey levels"))
}
