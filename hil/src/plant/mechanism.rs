//! What the motors of one robot have to do with each other.

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

/// Which robot's mechanics stand between the motors and the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MechanismConfig {
    /// Five axes; at home the lower arm stands upright, and upper arm, wrist and gripper are level, in one line.
    Irb6,
    /// Six axes; the same at home, but for the gripper, which is level across the wrist.
    Irp6,
    /// The same behind a track as the first of seven axes.
    Irp6OnTrack,
    /// Three legs and three axes of a wrist; nominal throughout. At home the wrist is straight.
    Rnt {
        /// Of each leg where its own motor is at home, between its universal joints, m.
        home_lengths: [f64; 3],
    },
    /// Seven axes.
    Polycrank {
        /// Whether motors 1 to 3 and 4 to 6 set sums of joint angles, as motors do that stand at the base of their
        /// group behind parallel cranks; otherwise each turns one joint.
        coupled: bool,
        /// Joint angles at home by Denavit and Hartenberg, rad.
        at_home: [f64; 7],
    },
}

/// The links of one robot, on which its axes are mounted. Clones are the same robot.
///
/// Each motor carries the weight and the inertia that its own turn moves, in the present pose of all motors. Screws,
/// parallelograms, rods and platforms act between the motors as in the robot. The load is computed once per
/// millisecond. Left out: forces that arise from the other axes' accelerations and speeds, except that inertia which
/// they fold together keeps its momentum; bending; friction that depends on load.
///
/// An axis finds the others where they last were moved on to. The result is a function of configurations, seeds and
/// the order of all calls, and a [`World`](crate::World) keeps that order. Drives that several threads advance stay
/// correct, but two runs differ in their last bits. A drive without calls lags up to 20 ms behind.
#[derive(Clone, Debug)]
pub struct Mechanism(Arc<Mutex<Robot>>);

/// The place of one axis in a [`Mechanism`].
#[derive(Clone, Debug)]
pub struct Mount {
    mechanism: Mechanism,
    number: usize,
}

/// The most axes of any robot.
const AXES: usize = 7;

#[derive(Clone, Debug)]
struct Robot {
    links: Links,
    count: usize,
    /// Motor angles at home, rad.
    homes: [f64; AXES],
    /// How far the motors are from home, rad.
    motors: [f64; AXES],
}

#[derive(Clone, Debug)]
enum Links {
    Irp6(Irp6),
    Rnt(Rnt),
    Polycrank(Polycrank),
}

/// What a motor has behind it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loaded {
    /// Of weight, N·m.
    pub(super) torque: f64,
    /// Of the links, at the motor, kg·m².
    pub(super) reflected: f64,
    /// Of what turns as fast as the motor, kg·m².
    pub(super) turning: f64,
    /// Of the gear that carries `reflected`, if it changes with the motor's own angle; otherwise constant.
    pub(super) ratio: f64,
}

impl Loaded {
    pub(super) fn inertia(&self) -> f64 {
        self.turning + self.reflected
    }

    /// Speed change of a motor when its reflected load changes and no torque acts.
    ///
    /// A gear that changes as the motor turns keeps the energy; an inertia that the other axes change keeps the
    /// momentum, and the energy is theirs.
    pub(super) fn slows_by(&self, next: &Self) -> f64 {
        let gear = self.ratio / next.ratio;
        let geared = self.turning + self.reflected * gear * gear;
        (self.inertia() / geared).sqrt() * geared / next.inertia()
    }
}

impl Mechanism {
    /// At home and without a payload, until axes are mounted.
    pub fn new(config: MechanismConfig) -> Self {
        let (links, count) = match config {
            MechanismConfig::Irb6 => (Links::Irp6(Irp6::with_straight_wrist()), 5),
            MechanismConfig::Irp6 => (Links::Irp6(Irp6::new(false)), 6),
            MechanismConfig::Irp6OnTrack => (Links::Irp6(Irp6::new(true)), 7),
            MechanismConfig::Rnt { home_lengths } => (Links::Rnt(Rnt::new(home_lengths)), 6),
            MechanismConfig::Polycrank { coupled, at_home } => {
                (Links::Polycrank(Polycrank::new(coupled, at_home)), 7)
            }
        };
        Self(Arc::new(Mutex::new(Robot {
            links,
            count,
            homes: [0.0; AXES],
            motors: [0.0; AXES],
        })))
    }

    /// How many axes it has.
    pub fn axes(&self) -> usize {
        self.lock().count
    }

    /// Where axis `number`, counted from 0, is mounted: `home` is the angle of its motor, rad, at which it is at
    /// home. `None` if the robot has no such axis.
    pub fn mount(&self, number: usize, home: f64) -> Option<Mount> {
        let mut robot = self.lock();
        if number >= robot.count {
            return None;
        }
        robot.homes[number] = home;
        Some(Mount {
            mechanism: self.clone(),
            number,
        })
    }

    /// Has the robot carry `mass`, kg, with its centre at `centre`, m, in the frame of its flange, whose z axis is that
    /// of the tool: of the IRb-6 95 mm beyond the pitch axis, of the IRp-6 where roll and flange axis meet, each before the
    /// gripper; of RNT 100 mm beyond the wrist's
    /// centre; of Polycrank the last. In place of whatever it carried before.
    pub fn set_payload(&self, mass: f64, centre: [f64; 3]) {
        let payload = Body::point(mass, centre);
        match &mut self.lock().links {
            Links::Irp6(irp6) => irp6.set_payload(payload),
            Links::Rnt(rnt) => rnt.set_payload(payload),
            Links::Polycrank(polycrank) => polycrank.set_payload(payload),
        }
    }

    /// Load on the motor of axis `number` in the present pose; zero for an absent axis.
    pub fn load(&self, number: usize) -> Load {
        let mut robot = self.lock();
        if number >= robot.count {
            return Load::default();
        }
        let loaded = robot.load(number);
        Load {
            torque: loaded.torque,
            inertia: loaded.inertia(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Robot> {
        // A panic of another thread leaves valid numbers behind.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Mount {
    /// The robot that it is of.
    pub fn mechanism(&self) -> &Mechanism {
        &self.mechanism
    }

    /// Puts the motor at `angle`, rad, wherever it was, and the links with it.
    pub(super) fn place(&self, angle: f64) {
        let mut robot = self.mechanism.lock();
        robot.motors[self.number] = angle - robot.homes[self.number];
        let motors = robot.motors;
        if let Links::Rnt(rnt) = &mut robot.links {
            rnt.settle(&motors);
        }
    }

    /// Tells the others that the motor has come to `angle`, rad, and what it has to carry there.
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
