//! Measurements of the scene by devices.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use can::Instant;
use nalgebra::{Isometry3, Matrix3, Vector3};

use super::arm::Seat;
use super::body::BodyState;
use super::motion::{Moving, Wrench};
use crate::plant::Shafts;
use crate::{InputProbe, Mechanism};

/// Source of the true wrench on a force/torque sensor, for an emulated device.
pub trait WrenchProbe: Send {
    /// Wrench at `now` in the frame of the sensor: three forces, N, then three torques, N·m. `now` never decreases.
    fn wrench(&mut self, now: Instant) -> [f64; 6];

    /// The robot in a scene whose wrench this is.
    fn mechanism(&self) -> Option<&Mechanism> {
        None
    }
}

/// A force/torque sensor between flange and tool.
///
/// The wrench is the load of the tool on the sensor, about the origin of the sensor's frame and in its axes. The load
/// has two parts: contact and grip forces on the tool, and gravity and inertial forces of all parts beyond the sensor.
/// At rest and without a contact the sensor measures the weight of the tool.
///
/// `mass` is used for the measurement only and adds no load to the motors: for the motors, the mass of the tool is part
/// of the links or of the payload of the mechanism. The mass of a body in a gripper is not part of `mass`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorConfig {
    /// The frame of the sensor in the flange frame of [`Mechanism::set_payload`](crate::Mechanism::set_payload).
    pub pose: Isometry3<f64>,
    /// Mass beyond the sensor, kg.
    pub mass: f64,
    /// Centre of that mass, in the frame of the sensor, m.
    pub centre: [f64; 3],
    /// Moments of inertia about `centre`, kg·m², in the axes of the sensor. Products of inertia are zero.
    pub inertia: [f64; 3],
}

/// A [`WrenchProbe`] of one sensor of a scene. Clones read the same sensor.
///
/// The wrench is that of the last step of the scene, up to 100 µs ago. Its accelerations are means over the last
/// millisecond.
#[derive(Clone, Debug, Default)]
pub struct SensorProbe(Option<Arc<ForceSensor>>);

impl SensorProbe {
    pub(super) fn new(sensor: ForceSensor) -> Self {
        Self(Some(Arc::new(sensor)))
    }

    /// The wrench at the last step, N and N·m, in the order of [`WrenchProbe::wrench`].
    pub fn last(&self) -> [f64; 6] {
        self.0.as_ref().map_or([0.0; 6], |sensor| sensor.measure())
    }
}

impl WrenchProbe for SensorProbe {
    fn wrench(&mut self, _now: Instant) -> [f64; 6] {
        self.last()
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.0.as_ref().map(|sensor| sensor.seat.mechanism())
    }
}

/// The true pose and motion of one body, for emulated devices. Clones read the same body.
#[derive(Clone, Debug)]
pub struct BodyProbe(Arc<Mutex<BodyState>>);

impl BodyProbe {
    pub(super) fn new(state: BodyState) -> Self {
        Self(Arc::new(Mutex::new(state)))
    }

    /// Place and motion of the body at the last step of the scene.
    pub fn state(&self) -> BodyState {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn show(&self, state: BodyState) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }
}

/// A switch of a touch probe at the tool of a robot, which the force on the tips actuates.
pub(super) struct Touch {
    /// Contact force that actuates the switch, N.
    threshold: f64,
    /// Level of the input during a touch.
    touched: bool,
    probe: InputProbe,
}

impl Touch {
    pub(super) fn new(threshold: f64, touched: bool, probe: &InputProbe) -> Self {
        probe.set(!touched);
        Self { threshold, touched, probe: probe.clone() }
    }

    /// Sets the switch. `force`: sum of the forces on the tips, N.
    pub(super) fn measure(&self, force: &Vector3<f64>) {
        self.probe.set((force.norm() >= self.threshold) == self.touched);
    }
}

/// The number of parts of steps whose equations were not solved, for the report of a run. Clones read the same count.
#[derive(Clone, Debug, Default)]
pub struct UnsolvedProbe(Arc<AtomicU64>);

impl UnsolvedProbe {
    /// The count since the start of the scene.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    pub(super) fn add(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// Steps over which accelerations are means: 1 ms.
const WINDOW: usize = 10;

/// The last steps of a robot, for its force sensors. A sensor that is read seldom costs little in each step: the flange
/// of a step without contacts is computed when a sensor is read.
#[derive(Debug, Default)]
pub(super) struct History {
    /// The last steps. Step `n` is at `n % (WINDOW + 1)`.
    past: [Past; WINDOW + 1],
    /// Number of recorded steps, and of the last step.
    steps: u64,
    /// The forces on the tool at the last step, about the origin of the flange, in the axes of the world.
    wrench: Wrench,
    /// Gravitational acceleration, m/s², in the axes of the world.
    gravity: Vector3<f64>,
}

#[derive(Debug, Default)]
struct Past {
    shafts: Shafts,
    /// The flange, if the scene has computed the flange.
    flange: Option<Moving>,
}

impl History {
    /// Records a step. `flange`: the flange, if the scene has computed the flange.
    pub(super) fn record(&mut self, shafts: &Shafts, flange: Option<&Moving>, wrench: &Wrench, gravity: &Vector3<f64>) {
        self.steps += 1;
        let past = &mut self.past[place_of(self.steps)];
        past.shafts = *shafts;
        past.flange = flange.copied();
        (self.wrench, self.gravity) = (*wrench, *gravity);
    }

    /// The flange at one of the last steps.
    fn flange(&self, step: u64, seat: &Seat) -> Moving {
        let past = &self.past[place_of(step)];
        past.flange.unwrap_or_else(|| seat.flange(&past.shafts))
    }
}

/// Index of a step in [`History::past`].
fn place_of(step: u64) -> usize {
    (step % (WINDOW as u64 + 1)) as usize
}

/// A force sensor of a robot.
#[derive(Debug)]
pub(super) struct ForceSensor {
    /// Origin and axes in the flange frame.
    origin: Vector3<f64>,
    axes: Matrix3<f64>,
    mass: f64,
    centre: Vector3<f64>,
    inertia: Vector3<f64>,
    seat: Seat,
    history: Arc<Mutex<History>>,
    /// Number of recorded steps of the robot before the sensor was added.
    since: u64,
}

impl ForceSensor {
    pub(super) fn new(config: &SensorConfig, seat: &Seat, history: &Arc<Mutex<History>>) -> Self {
        Self {
            origin: config.pose.translation.vector,
            axes: config.pose.rotation.to_rotation_matrix().into_inner(),
            mass: config.mass,
            centre: config.centre.into(),
            inertia: config.inertia.into(),
            seat: seat.clone(),
            since: history.lock().unwrap_or_else(PoisonError::into_inner).steps,
            history: Arc::clone(history),
        }
    }

    /// The wrench at the last step; zero before the first step.
    fn measure(&self) -> [f64; 6] {
        let history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        if history.steps == self.since {
            return [0.0; 6];
        }
        let flange = history.flange(history.steps, &self.seat);
        let (acceleration, turning) = self.accelerations(&history, &flange);
        let History { wrench, gravity, .. } = &*history;
        let axes = flange.axes * self.axes;
        let origin = flange.axes * self.origin;
        let arm = axes * self.centre;
        let spin = flange.spin;
        let from_flange = origin + arm;
        let centre = acceleration + turning.cross(&from_flange) + spin.cross(&spin.cross(&from_flange));
        let inertial = self.mass * (gravity - centre);
        let of_spin = |spin: &Vector3<f64>| axes * self.inertia.component_mul(&axes.tr_mul(spin));
        let force = wrench.force + inertial;
        let torque = wrench.torque - origin.cross(&wrench.force) + arm.cross(&inertial)
            - of_spin(&turning)
            - spin.cross(&of_spin(&spin));
        let (force, torque) = (axes.tr_mul(&force), axes.tr_mul(&torque));
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }

    /// Acceleration of the flange's origin, m/s², and angular acceleration, rad/s².
    fn accelerations(&self, history: &History, now: &Moving) -> (Vector3<f64>, Vector3<f64>) {
        let count = (history.steps - self.since - 1).min(WINDOW as u64);
        if count == 0 {
            return (Vector3::zeros(), Vector3::zeros());
        }
        let before = history.flange(history.steps - count, &self.seat);
        let passed = count as f64 * super::STEP_SECONDS;
        ((now.velocity - before.velocity) / passed, (now.spin - before.spin) / passed)
    }
}
