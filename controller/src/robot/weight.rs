//! Gravity compensation: motor torques that balance the weight of links and load.

use can::{counted, counted_as};
use nalgebra::{Point3, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};
use servo::MAX_AXES;
use thiserror::Error;

use super::{KinematicsError, Link, Motors, Robot};

/// Gravitational acceleration, m/s².
const GRAVITY: f64 = 9.81;

/// Motor displacement to either side for the numerical derivative of the potential energy, rad.
///
/// The truncation error of the central difference is f‴ / 6 · 1e-6: 1e-10 of the torque at a gear ratio of 50, less at
/// higher ratios. Rounding of an energy of 200 J adds 2e-11 N·m.
const STEP: f64 = 1e-3;

/// The mass of one link, or of the load on the flange, at its centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Mass {
    /// Mass, kg.
    pub mass: f64,
    /// Centre in the link's frame, m. The link's frame is its joint's frame, as written by `mrroc urdf`.
    pub centre: [f64; 3],
}

impl Mass {
    /// Largest mass of a link or a load, kg.
    pub const MOST: f64 = 1000.0;

    /// Largest coordinate of a centre of mass, m.
    pub const FARTHEST: f64 = 10.0;

    pub(super) const fn new(mass: f64, centre: [f64; 3]) -> Self {
        Self { mass, centre }
    }
}

/// Gravity model of a robot: links with their masses, the load, and the upward direction.
#[derive(Clone, Debug, PartialEq)]
pub struct Weight {
    /// Links from base to flange, without the load.
    links: Vec<(Link, Mass)>,
    /// The load, in the frame of the last link.
    load: Mass,
    /// Upward direction, opposite to gravity, in the base frame.
    up: UnitVector3<f64>,
}

/// Reasons why a gravity model is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum WeightError {
    /// The robot has no links, for example a gripper or a conveyor.
    #[error("the robot has no links that weigh on its motors")]
    NoLinks,
    /// The number of masses differs from the number of links.
    #[error("{} for {}", counted_as(*.given, "mass", "masses"), counted(*.links, "link"))]
    Count {
        /// Number of links of the robot.
        links: usize,
        /// Number of masses passed.
        given: usize,
    },
    /// A mass is below zero, above [`Mass::MOST`], or not finite.
    #[error("a mass of {mass} kg is not between 0 and {} kg", Mass::MOST)]
    Mass {
        /// Index of the link; for the load, the number of links.
        link: usize,
        /// Mass, kg.
        mass: f64,
    },
    /// A coordinate of a centre of mass exceeds [`Mass::FARTHEST`], or is not finite.
    #[error("a centre of mass at {coordinate} m is not within {} m of its frame", Mass::FARTHEST)]
    Centre {
        /// Index of the link; for the load, the number of links.
        link: usize,
        /// The invalid coordinate, m.
        coordinate: f64,
    },
    /// The upward vector is shorter than 1e-6, or not finite.
    #[error("up has no direction")]
    Up,
}

impl Weight {
    /// Gravity model of `robot`, with one mass per link of [`Robot::links`]. `load` is in the flange frame. `up` is in
    /// the base frame and need not be a unit vector.
    pub fn new(robot: &dyn Robot, masses: &[Mass], load: Mass, up: [f64; 3]) -> Result<Self, WeightError> {
        let links = robot.links();
        if links.is_empty() {
            return Err(WeightError::NoLinks);
        }
        if links.len() != masses.len() {
            return Err(WeightError::Count { links: links.len(), given: masses.len() });
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
        let centre = robot.link_from_flange() * Point3::from(load.centre);
        let load = Mass { mass: load.mass, centre: centre.into() };
        let up = Vector3::from(up);
        let up = UnitVector3::try_new(up, 1e-6).filter(|_| up.norm().is_finite());
        Ok(Self {
            links: links.into_iter().zip(masses.iter().copied()).collect(),
            load,
            up: up.ok_or(WeightError::Up)?,
        })
    }

    /// Torques of the motors, N·m, that balance the weight of `robot` at these motor positions. All torques are
    /// finite. `robot` must be the robot passed to [`new`](Self::new).
    ///
    /// Principle of virtual work: the torque of a motor is the partial derivative of the potential energy with respect
    /// to the motor angle. The principle covers gears, screws, couplings and parallel legs. Gear losses are neglected.
    /// The potential energy is computed twice per motor: about 5 µs for six axes.
    pub fn torque(&self, robot: &dyn Robot, motors: &Motors) -> Result<[f64; MAX_AXES], KinematicsError> {
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

    /// Potential energy of links and load, J; zero for masses at the height of the base origin.
    pub(super) fn potential(&self, robot: &dyn Robot, motors: &Motors) -> Result<f64, KinematicsError> {
        let joints = robot.joints_from_motors(motors)?;
        let moment_of = |body: &Mass| Vector3::from(body.centre) * body.mass;
        // The loop runs from flange to base, and adds up mass and first moment in the frame of the current link.
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
