//! Torques that hold the weight of links and load.

use nalgebra::{UnitVector3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use servo::MAX_AXES;
use thiserror::Error;

use super::{KinematicsError, Link, Motors, Robot};

/// Free fall, m/s².
const GRAVITY: f64 = 9.81;

/// Turn of a motor to either side over which potential energy is differentiated, rad.
///
/// The central difference misses f‴ / 6 · 1e-6: behind gears of 50 and more, 1e-10 of the torque. What 200 J lose by
/// rounding adds 2e-11 N·m.
const STEP: f64 = 1e-3;

/// The mass of one link, or of what the flange carries, at its centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mass {
    /// kg.
    pub mass: f64,
    /// Centre in the link's frame, m. A link's frame is that of its joint, as `mrroc urdf` writes it.
    pub centre: [f64; 3],
}

impl Mass {
    /// The most that a link or a load of these robots can have, kg.
    pub const MOST: f64 = 1000.0;

    /// The farthest that its centre can be, m.
    pub const FARTHEST: f64 = 10.0;

    pub(super) const fn new(mass: f64, centre: [f64; 3]) -> Self {
        Self { mass, centre }
    }
}

/// Links of a robot with their masses, for the torques that hold them.
#[derive(Clone, Debug, PartialEq)]
pub struct Weight {
    /// From base to flange, the load with the last.
    links: Vec<(Link, Mass)>,
    load: Mass,
    /// Against gravity, in the base frame.
    up: UnitVector3<f64>,
}

/// Why masses are not those of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum WeightError {
    /// A robot whose links are not known one by one.
    #[error("the robot has no links that weigh on its motors")]
    NoLinks,
    /// As many masses as links are needed.
    #[error("{given} masses for {links} links")]
    Count {
        /// Links of the robot.
        links: usize,
        /// Masses given.
        given: usize,
    },
    /// A mass below zero, above [`Mass::MOST`], or no number.
    #[error("a mass of {mass} kg is not between 0 and {} kg", Mass::MOST)]
    Mass {
        /// Index of the link; one more than the last for the load.
        link: usize,
        /// kg.
        mass: f64,
    },
    /// A centre farther away than [`Mass::FARTHEST`], or not finite.
    #[error(
        "a centre of mass at {coordinate} m is not within {} m of its frame",
        Mass::FARTHEST
    )]
    Centre {
        /// Index of the link; one more than the last for the load.
        link: usize,
        /// The coordinate that is, m.
        coordinate: f64,
    },
    /// No direction against gravity.
    #[error("up has no direction")]
    Up,
}

impl WeightError {
    /// The link it is about; one more than the last for the load.
    pub fn link(&self) -> Option<usize> {
        match *self {
            Self::Mass { link, .. } | Self::Centre { link, .. } => Some(link),
            Self::NoLinks | Self::Count { .. } | Self::Up => None,
        }
    }
}

impl Weight {
    /// The weights of `robot`: one mass per link of [`Robot::links`], the load in the frame of the flange, and the
    /// upward direction in the base frame, of any length.
    pub fn new(
        robot: &dyn Robot,
        masses: &[Mass],
        load: Mass,
        up: [f64; 3],
    ) -> Result<Self, WeightError> {
        let links = robot.links().ok_or(WeightError::NoLinks)?.0;
        if links.len() != masses.len() {
            return Err(WeightError::Count {
                links: links.len(),
                given: masses.len(),
            });
        }
        for (link, &Mass { mass, centre }) in masses.iter().chain([&load]).enumerate() {
            if !(0.0..=Mass::MOST).contains(&mass) {
                return Err(WeightError::Mass { link, mass });
            }
            let near = |coordinate: &f64| coordinate.abs() <= Mass::FARTHEST;
            if let Some(coordinate) = centre.into_iter().find(|coordinate| !near(coordinate)) {
                return Err(WeightError::Centre { link, coordinate });
            }
        }
        let up = UnitVector3::try_new(Vector3::from(up), 1e-6).filter(|up| up.norm().is_finite());
        Ok(Self {
            links: links.into_iter().zip(masses.iter().copied()).collect(),
            load,
            up: up.ok_or(WeightError::Up)?,
        })
    }

    /// Torques of the motors, N·m, that hold `robot` at these motor positions; all finite. `robot` must be the robot
    /// that the weight was made for.
    ///
    /// A motor's is the change of potential energy per turn of it while the others stand: virtual work, whatever
    /// gears, screws, couplings and parallel legs lie between. Gears are without losses here. The links' potential
    /// energy is worked out twice per motor: some 5 µs for six axes.
    pub fn torque(
        &self,
        robot: &dyn Robot,
        motors: &Motors,
    ) -> Result<[f64; MAX_AXES], KinematicsError> {
        let mut torques = [0.0; MAX_AXES];
        for axis in 0..motors.len() {
            let at = |step: f64| {
                let mut moved = *motors;
                moved[axis] += step;
                self.potential(robot, &moved)
            };
            let torque = (at(STEP)? - at(-STEP)?) / (2.0 * STEP);
            if !torque.is_finite() {
                return Err(KinematicsError::NotFinite);
            }
            torques[axis] = torque;
        }
        Ok(torques)
    }

    /// Potential energy above the base's origin, J.
    pub(super) fn potential(
        &self,
        robot: &dyn Robot,
        motors: &Motors,
    ) -> Result<f64, KinematicsError> {
        let joints = robot.joints_from_motors(motors)?;
        let moment_of = |body: &Mass| Vector3::from(body.centre) * body.mass;
        // From the flange to the base: the mass of all that is carried and its first moment, in the frame of the link.
        let (mut mass, mut moment) = (self.load.mass, moment_of(&self.load));
        for (link, body) in self.links.iter().rev() {
            mass += body.mass;
            moment += moment_of(body);
            let placed = link.placed(&joints);
            moment = placed.rotation * moment + placed.translation.vector * mass;
        }
        Ok(GRAVITY * self.up.dot(&moment))
    }
}
