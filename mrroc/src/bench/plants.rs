//! The motors, sensors, switches and mechanisms behind the emulated drives of a cell.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;
use canopen::cia402::HomingMethod;
use controller::robot::Limits;
use hil::scene::{BeamProbe, FlangeProbe};
use nalgebra::Isometry3;

use hil::{AxisConfig, InputProbe, Mechanism, Mount, OutputProbe, plant::PlantConfig};

use crate::bench::drive_ids::DriveIds;
use crate::cell::{CellFile, EmulatedPayload, Path};

/// The flange of the mechanism of a robot, and the flange of the cell file in its frame.
type CarryingFlange = (FlangeProbe, Isometry3<f64>);

/// A cell whose devices are emulated.
pub struct EmulatedCell<'a> {
    /// The cell.
    pub file: &'a CellFile,
    /// The mechanism of each robot that has one. The axes of a mechanism may be on several buses and lines.
    pub(super) mechanisms: Vec<Option<Mechanism>>,
    /// The terminal of the output that closes each gripper.
    pub(super) valves: Vec<OutputProbe>,
    /// The terminal of the output that turns each spindle.
    pub(super) spindles: Vec<OutputProbe>,
    /// The outputs of the light gates of the scene.
    pub(super) beams: Vec<BeamProbe>,
    /// Switches of the touch probes of the scene.
    pub(super) touches: Vec<InputProbe>,
    /// The flange of each robot that carries a device of another crate.
    pub(super) flanges: RefCell<Vec<Option<CarryingFlange>>>,
    /// Whether the axis controllers on serial lines had power before, and have their reference.
    pub(super) referenced: Cell<bool>,
    /// The buses and drives added to a world so far.
    pub(super) ids: RefCell<DriveIds>,
}

impl<'a> EmulatedCell<'a> {
    /// All mechanisms at home and without payloads.
    pub fn of(file: &'a CellFile) -> Self {
        let mechanisms = file.cell.robot.iter().map(|robot| robot.numbers().mechanism().map(Mechanism::new)).collect();
        let scene = file.cell.scene.as_ref();
        let [grippers, cutters, gates, probes] = scene.map_or([0; 4], |scene| {
            [scene.gripper.len(), scene.cutter.len(), scene.gate.len(), scene.touch_probe.len()]
        });
        let terminals = |count| (0..count).map(|_| OutputProbe::default()).collect();
        let beams = (0..gates).map(|_| BeamProbe::default()).collect();
        let touches = (0..probes).map(|_| InputProbe::default()).collect();
        Self {
            file,
            mechanisms,
            valves: terminals(grippers),
            spindles: terminals(cutters),
            beams,
            touches,
            flanges: RefCell::new(vec![None; file.cell.robot.len()]),
            referenced: Cell::new(false),
            ids: RefCell::default(),
        }
    }

    /// The buses and drives that were added to a world.
    pub fn ids(&self) -> DriveIds {
        self.ids.borrow().clone()
    }

    /// The mount of an axis in its robot; `None` if the axis moves its own load.
    pub fn mount(&self, robot: usize, number: usize) -> Option<Mount> {
        let home = self.file.arms[robot].robot().home()[number];
        self.mechanisms[robot].as_ref()?.mount(number, home)
    }
}

/// The emulated payloads of a cell, in order of time.
pub struct Payloads(VecDeque<(Instant, Mechanism, EmulatedPayload)>);

impl Payloads {
    /// The payloads of a cell whose drives are switched on at `power_on`.
    pub fn of(emulated: &EmulatedCell, power_on: Instant) -> Self {
        let robots = emulated.file.cell.robot.iter().zip(&emulated.mechanisms);
        let payloads = robots.filter_map(|(robot, mechanism)| Some((robot, mechanism.as_ref()?)));
        let payloads = payloads.flat_map(|(robot, mechanism)| {
            let due = move |payload: &EmulatedPayload| power_on + Duration::from_secs_f64(payload.at_s);
            robot.emulated_payload.iter().map(move |payload| (due(payload), mechanism.clone(), *payload))
        });
        let mut payloads: Vec<_> = payloads.collect();
        payloads.sort_by_key(|(due, ..)| *due);
        Self(payloads.into())
    }

    /// Time of the next change of payload.
    pub fn next(&self) -> Option<Instant> {
        self.0.front().map(|(due, ..)| *due)
    }

    /// Attaches the payloads that are due to their robots.
    pub fn take_over(&mut self, now: Instant) {
        while self.next().is_some_and(|due| due <= now) {
            if let Some((_, mechanism, payload)) = self.0.pop_front() {
                mechanism.set_payload(payload.mass, payload.centre);
            }
        }
    }
}

/// Why the emulated drive of an axis cannot home by its method, and the key of the method; `None` if it can. A real
/// robot may be wired differently.
pub fn homing_problem(file: &CellFile, (robot, number): (usize, usize)) -> Option<(Path, String)> {
    let axis = &file.cell.robot[robot].axis[number];
    let method = axis.homing.method.filter(|_| !axis.emulator.absent)?;
    let needed = HomingMethod(method).references()?;
    if !needed.home_switch {
        return None;
    }
    let plant = plant(file, robot, number);
    let lowest = plant.negative_limit.map_or(f64::NEG_INFINITY, |limit| limit.to);
    let why = match plant.home_switch {
        None => "needs a home switch, which the emulated axis does not have: use 33, 34 or 37",
        Some(_) if needed.positive_limit && plant.positive_limit.is_none() => {
            "turns round at a positive limit switch, which the emulated axis does not have: use 11 or 27"
        }
        // The drive leaves the switch against the direction of its search, which is upwards.
        Some(switch) if needed.positive_limit && switch.from <= lowest => {
            "leaves the home switch downwards, where that of the emulated axis never opens: use 11 or 27"
        }
        Some(_) => return None,
    };
    let key = Path::axis(robot, number).then("homing").then("method");
    Some((key, format!("is {method}, which {why}")))
}

/// Motor, load, sensors and switches of an axis.
pub fn plant(file: &CellFile, robot: usize, number: usize) -> AxisConfig {
    let axis = &file.cell.robot[robot].axis[number];
    let home = file.arms[robot].robot().home()[number];
    let preset = file.cell.robot[robot].numbers().plant(axis.emulator.plant, number, home);
    let mut plant = AxisConfig {
        counts_per_revolution: axis.counts_per_revolution(),
        start_angle: axis.emulator.start.unwrap_or(preset.start_angle),
        ..preset
    };
    plant.amplifier.setpoint_filter = axis.emulator.setpoint_filter_s;
    if let Some(most) = axis.drive.as_ref().and_then(|drive| drive.max_torque) {
        let current = most / plant.plant.torque_constant();
        plant.amplifier.trip_current *= current / plant.amplifier.max_current;
        plant.amplifier.max_current = current;
    }
    if let PlantConfig::Physical(motor) = &mut plant.plant {
        let share = axis.emulator.dry_friction.unwrap_or(1.0);
        motor.friction.coulomb *= share;
        motor.friction.stiction *= share;
    }
    bounded(plant, file.arms[robot].robot().motor_limits()[number])
}

/// Moves limit switches and buffers, if the axis has any, beyond the range of the motor, rad.
fn bounded(mut plant: AxisConfig, range: Limits) -> AxisConfig {
    if let Some(switch) = &mut plant.negative_limit {
        switch.to = switch.to.min(range.low - SWITCHES);
    }
    if let Some(switch) = &mut plant.positive_limit {
        switch.from = switch.from.max(range.high + SWITCHES);
    }
    if let PlantConfig::Physical(motor) = &mut plant.plant
        && let Some(stops) = &mut motor.end_stops
    {
        stops.negative = stops.negative.min(range.low - BUFFERS);
        stops.positive = stops.positive.max(range.high + BUFFERS);
    }
    plant
}

/// Distance of the limit switches from the range of the motor, rad. A motor that stops at the end of its range
/// overshoots by some counts, and must not close a switch.
const SWITCHES: f64 = 1.0;

/// Distance of the buffers from the range of the motor, rad.
const BUFFERS: f64 = 3.0;
