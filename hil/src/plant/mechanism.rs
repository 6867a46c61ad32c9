//! Coupled dynamics of the motors of one robot: gravity, inertia and payload.

mod chain;
mod irp6;
mod polycrank;
mod rnt;
mod screw;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use chain::Body;
pub use chain::Load;
use irp6::Irp6;
use polycrank::Polycrank;
use rnt::Rnt;

/// The robot whose mechanics couple the motors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MechanismConfig {
    /// Five axes. At home the lower arm is upright. Upper arm, wrist and gripper are level, in one line.
    Irb6,
    /// Six axes. At home as [`MechanismConfig::Irb6`], except that the gripper is level across the wrist.
    Irp6,
    /// The IRp-6 on a track, which is the first of seven axes.
    Irp6OnTrack,
    /// Three legs and a wrist of three axes, all parameters nominal. At home the wrist is straight.
    Rnt {
        /// Length of each leg between its universal joints when its own motor is at home, m.
        home_lengths: [f64; 3],
    },
    /// Seven axes.
    Polycrank {
        /// Whether motors 1 to 3 and 4 to 6 set sums of joint angles. Motors that drive a group from its base through
        /// parallel cranks do so. Otherwise each motor turns one joint.
        coupled: bool,
        /// Denavit-Hartenberg joint angles at home, rad.
        at_home: [f64; 7],
    },
}

/// The links of one robot, on which its axes are mounted. Clones refer to the same robot.
///
/// Each motor carries the weight and the inertia that its own rotation moves, in the present pose of all motors.
/// Screws, parallelograms, rods and platforms couple the motors as in the robot. The load is computed once per
/// millisecond. Left out: bending; friction that depends on load; forces from accelerations and speeds of the other
/// axes. An exception is a change of inertia by the other axes, which conserves momentum.
///
/// The load of an axis follows from the last simulated positions of the other axes. The result is a function of
/// configurations, seeds and the order of all calls. A [`World`](crate::World) keeps that order. If several threads
/// advance the drives, the results stay valid but differ in their last bits from run to run. A drive without calls
/// lags by up to 20 ms.
#[derive(Clone, Debug)]
pub struct Mechanism(Arc<Mutex<Robot>>);

/// The place of one axis in a [`Mechanism`].
#[derive(Clone, Debug)]
pub struct Mount {
    mechanism: Mechanism,
    number: usize,
}

/// Largest number of axes of a robot.
const AXES: usize = 7;

#[derive(Clone, Debug)]
struct Robot {
    links: Links,
    count: usize,
    /// Motor angles at home, rad.
    homes: [f64; AXES],
    /// Motor angles relative to home, rad.
    motors: [f64; AXES],
}

#[derive(Clone, Debug)]
enum Links {
    Irp6(Irp6),
    Rnt(Rnt),
    Polycrank(Polycrank),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Loaded {
    /// Weight and inertia of the links, at the motor.
    pub(super) links: Load,
    /// Inertia of parts that turn at motor speed, kg·m².
    pub(super) turning: f64,
    /// Ratio of the transmission to the links if it changes with the motor's own angle; otherwise a constant.
    pub(super) ratio: f64,
}

impl Loaded {
    pub(super) fn inertia(&self) -> f64 {
        self.turning + self.links.inertia
    }

    /// Speed change of a motor when its reflected load changes and no torque acts.
    ///
    /// A transmission ratio that changes with the motor's own angle conserves kinetic energy. A change of inertia by
    /// the other axes conserves momentum; the other axes supply the difference in energy.
    pub(super) fn slows_by(&self, next: &Self) -> f64 {
        let gear = self.ratio / next.ratio;
        let geared = self.turning + self.links.inertia * gear * gear;
        (self.inertia() / geared).sqrt() * geared / next.inertia()
    }
}

impl Mechanism {
    /// A robot at home and without a payload, until axes are mounted.
    pub fn new(config: MechanismConfig) -> Self {
        let (links, count) = match config {
            MechanismConfig::Irb6 => (Links::Irp6(Irp6::with_straight_wrist()), 5),
            MechanismConfig::Irp6 => (Links::Irp6(Irp6::new(false)), 6),
            MechanismConfig::Irp6OnTrack => (Links::Irp6(Irp6::new(true)), 7),
            MechanismConfig::Rnt { home_lengths } => (Links::Rnt(Rnt::new(home_lengths)), 6),
            MechanismConfig::Polycrank { coupled, at_home } => (Links::Polycrank(Polycrank::new(coupled, at_home)), 7),
        };
        Self(Arc::new(Mutex::new(Robot { links, count, homes: [0.0; AXES], motors: [0.0; AXES] })))
    }

    /// Number of axes of the robot.
    pub fn axes(&self) -> usize {
        self.lock().count
    }

    /// The mount of axis `number`, counted from 0. `home` is the motor angle at which the axis is at home, rad.
    /// `None` if the robot has no such axis.
    pub fn mount(&self, number: usize, home: f64) -> Option<Mount> {
        let mut robot = self.lock();
        if number >= robot.count {
            return None;
        }
        robot.homes[number] = home;
        Some(Mount { mechanism: self.clone(), number })
    }

    /// Sets the payload, in place of the previous payload: `mass`, kg, with its centre at `centre`, m, in the flange
    /// frame. The z axis of the frame is the tool axis. Its origin depends on the robot:
    ///
    /// * IRb-6: 95 mm beyond the pitch axis, before the gripper.
    /// * IRp-6: the intersection of roll and flange axis, before the gripper.
    /// * RNT: 100 mm beyond the wrist centre.
    /// * Polycrank: the frame of the last joint.
    pub fn set_payload(&self, mass: f64, centre: [f64; 3]) {
        let mut robot = self.lock();
        let payload = match &mut robot.links {
            Links::Irp6(irp6) => &mut irp6.chain.payload,
            Links::Rnt(rnt) => &mut rnt.wrist.payload,
            Links::Polycrank(polycrank) => &mut polycrank.chain.payload,
        };
        *payload = Body::point(mass, centre);
    }

    /// Load on the motor of axis `number` in the present pose; zero for an absent axis.
    pub fn load(&self, number: usize) -> Load {
        let mut robot = self.lock();
        if number >= robot.count {
            return Load::default();
        }
        let loaded = robot.load(number);
        Load { torque: loaded.links.torque, inertia: loaded.inertia() }
    }

    fn lock(&self) -> MutexGuard<'_, Robot> {
        // A panic of another thread leaves valid numbers behind.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Mount {
    /// Sets the motor to `angle`, rad, from any angle, and moves the links accordingly.
    pub(super) fn place(&self, angle: f64) {
        let mut robot = self.mechanism.lock();
        robot.motors[self.number] = angle - robot.homes[self.number];
        let motors = robot.motors;
        if let Links::Rnt(rnt) = &mut robot.links {
            rnt.settle(&motors);
        }
    }

    /// Records the motor's new `angle`, rad, for the loads of the other axes. Returns the motor's load there.
    pub(super) fn load(&self, angle: f64) -> Loaded {
        let mut robot = self.mechanism.lock();
        robot.motors[self.number] = angle - robot.homes[self.number];
        robot.load(self.number)
    }
}

impl Robot {
    fn load(&mut self, number: usize) -> Loaded {
        match &mut self.links {
            Links::Irp6(irp6) => irp6.load(number, &self.motors),
            Links::Rnt(rnt) => rnt.load(number, &self.motors),
            Links::Polycrank(polycrank) => polycrank.load(number, &self.motors),
        }
    }
}
