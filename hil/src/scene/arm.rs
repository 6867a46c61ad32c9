//! A robot in the scene: its flange, the tips of its tool, and its force sensors.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::contact::Sphere;
use super::motion::{Motion, Moving, Place, Wrench};
use super::probe::{ForceSensor, History, Touch};
use super::{RobotId, Scene, SensorConfig, SensorProbe};
use crate::plant::{Kinematics, Mechanism, Shafts};

/// A robot. Its flange is not computed in the steps in which no force can act on the tool and nothing needs the flange.
// Different threads may advance two robots. Two robots therefore share no cache line.
#[repr(align(128))]
pub(super) struct Arm {
    seat: Seat,
    kinematics: Kinematics,
    /// The flange at the last step and at this step, for the motion of bodies. Not computed while the scene has none.
    before: Place,
    now: Place,
    /// The flange at this step. While the robot is [far](Self::is_far): at the last computed step.
    pub(super) flange: Moving,
    /// The flange over the present part of the step.
    pub(super) motion: Motion,
    tips: Vec<Sphere>,
    /// What the force sensors measure; `None` without a sensor.
    history: Option<Arc<Mutex<History>>>,
    /// Switches that the tips of the tool close.
    pub(super) touches: Vec<Touch>,
    /// Wrench of the forces on the tool about the origin of the flange, in the axes of the world.
    pub(super) wrench: Wrench,
    /// Sum of the forces on the tips, N, in the axes of the world.
    tip_force: Vector3<f64>,
    /// The motor shafts at this step.
    shafts: Shafts,
    reach: Reach,
    is_far: bool,
}

/// Distance that the tips of a robot can move without a contact.
struct Reach {
    /// Greatest displacement of a tip per rad of each motor, m/rad, within [`Kinematics::room`] of a pose.
    travel: [f64; Shafts::COUNT],
    /// Distance from the nearest surface at the last computed step, m. Infinite without tips or surfaces. Zero: the next
    /// step is computed.
    clearance: f64,
    /// Angles of the motor shafts at that step, rad.
    angles: [f64; Shafts::COUNT],
}

impl Reach {
    /// Part of the clearance that is left for rounding errors: a share, and a distance, m.
    const MARGIN: (f64, f64) = (1e-6, 1e-9);

    /// Whether no tip can touch a surface with the motor shafts at these angles, rad.
    fn is_free(&self, angles: &[f64; Shafts::COUNT]) -> bool {
        if self.clearance.is_infinite() {
            return true;
        }
        let turned = angles.iter().zip(&self.angles).map(|(angle, last)| (angle - last).abs());
        let moved: f64 = self.travel.iter().zip(turned).map(|(travel, turned)| travel * turned).sum();
        // The comparison is false for NaN.
        moved < self.clearance * (1.0 - Self::MARGIN.0) - Self::MARGIN.1
    }
}

/// A mechanism and the place of its base.
#[derive(Clone, Debug)]
pub(super) struct Seat {
    mechanism: Mechanism,
    /// Origin and axes of the base in the world.
    base: (Vector3<f64>, Matrix3<f64>),
}

impl Seat {
    pub(super) fn mechanism(&self) -> &Mechanism {
        &self.mechanism
    }

    /// The flange in the world.
    pub(super) fn flange(&self, shafts: &Shafts) -> Moving {
        self.moving(&self.mechanism.kinematics_at(shafts), shafts)
    }

    fn moving(&self, kinematics: &Kinematics, shafts: &Shafts) -> Moving {
        let twist = kinematics.twist(&shafts.velocities);
        let (origin, axes) = &self.base;
        Moving {
            origin: origin + axes * kinematics.flange.origin,
            axes: axes * kinematics.flange.axes,
            velocity: axes * twist.velocity,
            spin: axes * twist.spin,
        }
    }
}

impl Arm {
    /// A robot whose mechanism has already entered the scene. `base`: pose of the base frame in the world.
    pub(super) fn new(mechanism: &Mechanism, base: &Isometry3<f64>) -> Self {
        let base = (base.translation.vector, base.rotation.to_rotation_matrix().into_inner());
        let shafts = mechanism.shafts();
        let seat = Seat { mechanism: mechanism.clone(), base };
        let kinematics = mechanism.kinematics_at(&shafts);
        let flange = seat.moving(&kinematics, &shafts);
        Self {
            kinematics,
            seat,
            before: place(&flange),
            now: place(&flange),
            flange,
            motion: Motion::standing(Vector3::zeros(), Matrix3::identity()),
            tips: Vec::new(),
            history: None,
            touches: Vec::new(),
            wrench: Wrench::default(),
            tip_force: Vector3::zeros(),
            reach: Reach { travel: mechanism.travel(0.0), clearance: 0.0, angles: shafts.angles },
            shafts,
            is_far: false,
        }
    }

    /// Takes the present motor angles, computes the flange, and clears the forces. With `alone` the scene has no bodies
    /// and no cutting tools; the flange of a robot that is [far](Self::is_far) is then not computed.
    pub(super) fn follow(&mut self, alone: bool) {
        self.shafts = self.seat.mechanism.shafts();
        self.is_far = alone && self.reach.is_free(&self.shafts.angles);
        if !self.is_far {
            self.compute();
        }
        if !alone {
            self.before = self.now;
            self.now = place(&self.flange);
            // Two quaternions of opposite sign describe the same rotation. The interpolation needs the nearer one.
            if self.before.turn.coords.dot(&self.now.turn.coords) < 0.0 {
                self.now.turn = UnitQuaternion::new_unchecked(-self.now.turn.into_inner());
            }
        }
        self.wrench = Wrench::default();
        self.tip_force = Vector3::zeros();
    }

    fn compute(&mut self) {
        self.kinematics = self.seat.mechanism.kinematics_at(&self.shafts);
        self.flange = self.seat.moving(&self.kinematics, &self.shafts);
    }

    /// Whether no tip of the robot can touch a surface at this step. The flange is then not computed, and no force acts
    /// on the tool.
    pub(super) fn is_far(&self) -> bool {
        self.is_far
    }

    /// Computes the flange at the last step, if it was not computed then. The next step is computed as well. The caller
    /// is about to change the surroundings of the robot.
    pub(super) fn catch_up(&mut self) {
        if self.is_far {
            self.is_far = false;
            self.compute();
        }
        self.now = place(&self.flange);
        self.reach.clearance = 0.0;
    }

    /// Begins the computation of the distance of the tips from the nearest surface at this step.
    pub(super) fn begin_clearance(&mut self) {
        if !self.is_far {
            self.reach.clearance = f64::INFINITY;
            self.reach.angles = self.shafts.angles;
        }
    }

    /// Reduces the distance of the tips from the nearest surface, m, also to the displacement that can be bounded.
    pub(super) fn limit_clearance(&mut self, clearance: f64) {
        self.reach.clearance = self.reach.clearance.min(clearance).min(self.kinematics.room);
    }

    /// Sets the motion of the flange over a part of the last step: from the share `from` of the step to the share `to`.
    /// The part lasts `dt` seconds.
    pub(super) fn set_motion(&mut self, from: f64, to: f64, dt: f64) {
        let place = |share| self.before.towards(&self.now, share);
        self.motion = Motion::between(&place(from), &place(to), dt);
    }

    /// Upward direction of the mechanism, in the world.
    pub(super) fn up(&self) -> Vector3<f64> {
        self.seat.base.1 * Vector3::from(self.seat.mechanism.up())
    }

    /// Place of the flange in the world.
    pub(super) fn place(&self) -> Isometry3<f64> {
        let place = if self.is_far { place(&self.seat.flange(&self.shafts)) } else { place(&self.flange) };
        Isometry3::from_parts(place.origin.into(), place.turn)
    }

    pub(super) fn mechanism(&self) -> &Mechanism {
        &self.seat.mechanism
    }

    /// The tips of the tool.
    pub(super) fn tips(&self) -> &[Sphere] {
        &self.tips
    }

    /// Adds a tip to the tool.
    pub(super) fn add_tip(&mut self, tip: Sphere) {
        self.catch_up();
        self.tips.push(tip);
        let farthest = self.tips.iter().map(|tip| tip.centre.norm()).fold(0.0, f64::max);
        self.reach.travel = self.seat.mechanism.travel(farthest);
    }

    /// Adds a force sensor between flange and tool.
    pub(super) fn add_sensor(&mut self, config: &SensorConfig) -> SensorProbe {
        let history = self.history.get_or_insert_default();
        SensorProbe::new(ForceSensor::new(config, &self.seat, history))
    }

    /// Adds a force, N, on the tool at a point, m. Both are in the axes of the world.
    pub(super) fn push(&mut self, at: &Vector3<f64>, force: &Vector3<f64>) {
        self.wrench.push(&(at - self.flange.origin), force);
    }

    /// Adds a force, N, on a tip of the tool at a point, m. Both are in the axes of the world.
    pub(super) fn push_tip(&mut self, at: &Vector3<f64>, force: &Vector3<f64>) {
        self.tip_force += force;
        self.push(at, force);
    }

    /// Applies the forces to the sensors, the switches and the motors.
    pub(super) fn finish(&mut self, gravity: &Vector3<f64>) {
        if let Some(history) = &self.history {
            let flange = (!self.is_far).then_some(&self.flange);
            let mut history = history.lock().unwrap_or_else(PoisonError::into_inner);
            history.record(&self.shafts, flange, &self.wrench, gravity);
        }
        if self.is_far {
            // The last computed step had no contact: the switches are released, and the motors have no load.
            return;
        }
        for touch in &self.touches {
            touch.measure(&self.tip_force);
        }
        let axes = &self.seat.base.1;
        let (force, torque) = (axes.tr_mul(&self.wrench.force), axes.tr_mul(&self.wrench.torque));
        self.seat.mechanism.push(&self.kinematics, &force, &torque);
    }
}

fn place(flange: &Moving) -> Place {
    let turn = Rotation3::from_matrix_unchecked(flange.axes);
    Place { origin: flange.origin, turn: UnitQuaternion::from_rotation_matrix(&turn) }
}

/// The place of the flange of one robot, for emulated devices. Clones read the same robot.
#[derive(Clone, Debug)]
pub struct FlangeProbe(Seat);

impl FlangeProbe {
    /// Place of the flange in the world, from the last positions of the motors.
    pub fn pose(&self) -> Isometry3<f64> {
        let place = place(&self.0.flange(&self.0.mechanism.shafts()));
        Isometry3::from_parts(place.origin.into(), place.turn)
    }

    /// The robot.
    pub fn mechanism(&self) -> &Mechanism {
        &self.0.mechanism
    }
}

impl Scene {
    /// The place of the flange of a robot of this scene, for emulated devices.
    pub fn watch_flange(&self, robot: RobotId) -> FlangeProbe {
        FlangeProbe(self.arms[robot.0].seat.clone())
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        self.seat.mechanism.leave_scene();
    }
}
