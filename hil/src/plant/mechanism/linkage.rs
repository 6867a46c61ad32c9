//! A mechanism of links in any arrangement, from a function that places the links.
//!
//! The poses of the links are functions of the motors. All other quantities are derivatives of these functions,
//! computed by central differences:
//!
//! * Motions of each link per rad/s of each motor: velocity v of its centre of mass and angular velocity ω.
//! * Matrix of inertia: M = Σ m vᵀv + ωᵀIω, plus the rotors. Torque of the weight: −∂V/∂θ of the potential energy V.
//! * Changes of the inertia ∂M/∂θ, which give the Coriolis and centrifugal torques.
//!
//! The steps of the differences are a small part of a radian or metre of a joint. The relative error of M is of the
//! order of 1e-9 and that of ∂M/∂θ of the order of 1e-7, for links whose path curves by about 1 rad per radian or
//! metre of a joint.

use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Point3};
use thiserror::Error;

use super::bodies;
use super::chain::{self, GRAVITY, Load, Vector};
use super::coupling::{Column, Coupled, Coupling, Dynamics, Square};
use super::kinematics::{Frame, Kinematics, Twist};
use super::{AXES, Loaded};

/// Largest number of links of a linkage.
const LINKS: usize = 16;

/// Half of the interval of a difference, rad or m of a joint: for motions of links, and for changes of the inertia.
const MOTION: f64 = 1e-4;
const CHANGE: f64 = 3e-4;

/// Greatest change of the inertia over the interval of a difference, as a share of the inertia. Nearer to a singular
/// pose, such as stretched links of a closed loop, differences and sub-steps are too coarse.
const STEEP: f64 = 0.05;

/// Poses of the links of a mechanism as functions of its motors.
pub trait LinkPoses: fmt::Debug + Send + Sync {
    /// Writes poses in the base frame, with the motors at these angles from home, rad: the pose of each link, then the
    /// pose of the flange. Returns false if the links cannot take such a pose.
    ///
    /// The mechanism then keeps its last inertia and has no weight. Near a singular pose, where the inertia at a motor
    /// changes by its own size within a hundredth of a radian or metre of the joint, the mechanism does the same.
    ///
    /// An emulation calls this function many times per millisecond, so it must not allocate.
    fn place(&self, motors: &[f64], poses: &mut [Isometry3<f64>]) -> bool;
}

/// Mass of one link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkBody {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the frame of the link, m.
    pub centre: [f64; 3],
    /// Inertia about the centre of mass, kg·m², in the axes of the link's frame: xx, yy, zz, xy, xz, yz. The last three
    /// are elements of the tensor (the sign convention of URDF).
    pub inertia: [f64; 6],
}

/// Refused numbers of a linkage. Links and motors are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LinkageError {
    /// The number of motors is out of range.
    #[error("{count} motors, 1 to {AXES} are possible")]
    Motors {
        /// Number of motors.
        count: usize,
    },
    /// The number of links is out of range.
    #[error("{count} links, 1 to {LINKS} are possible")]
    Links {
        /// Number of links.
        count: usize,
    },
    /// A number of a link is NaN or infinite.
    #[error("link {link}: {quantity} is not a finite number")]
    NotFinite {
        /// Number of the link.
        link: usize,
        /// The quantity.
        quantity: &'static str,
    },
    /// A mass is below zero.
    #[error("link {link}: the mass is {mass} kg, it must be 0 or above")]
    Mass {
        /// Number of the link.
        link: usize,
        /// Mass, kg.
        mass: f64,
    },
    /// Some motion of the link would have a kinetic energy below zero.
    #[error("link {link}: no link has the principal moments of inertia {moments:?} kg·m²: none may be below 0")]
    Inertia {
        /// Number of the link.
        link: usize,
        /// Principal moments in ascending order, kg·m².
        moments: [f64; 3],
    },
    /// The vector against gravity has no direction.
    #[error("the vector against gravity is {up:?}, it must have a direction")]
    Up {
        /// The vector.
        up: [f64; 3],
    },
    /// A motor has no ratio, or its rotor no inertia.
    #[error("motor {motor}: {quantity} is {value}, it must be above 0 and finite")]
    Motor {
        /// Number of the motor.
        motor: usize,
        /// The quantity.
        quantity: &'static str,
        /// Its value.
        value: f64,
    },
    /// The links have no pose at home.
    #[error("the links have no pose with all motors at home")]
    Home,
}

/// The links of a mechanism, and the function that places them. All numbers have been checked.
#[derive(Clone, Debug)]
pub struct LinkageBodies {
    poses: Arc<dyn LinkPoses>,
    links: Vec<Body>,
    up: Vector,
    /// Magnitude of motor angle per joint position, rad/rad or rad/m.
    ratios: [f64; AXES],
    rotors: [f64; AXES],
    axes: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Body {
    mass: f64,
    centre: Vector,
    inertia: Matrix3<f64>,
}

/// Two linkages are equal if they share the function that places the links, and have equal numbers.
impl PartialEq for LinkageBodies {
    fn eq(&self, other: &Self) -> bool {
        let numbers = |it: &Self| (it.up, it.ratios, it.rotors, it.axes);
        Arc::ptr_eq(&self.poses, &other.poses) && self.links == other.links && numbers(self) == numbers(other)
    }
}

impl LinkageBodies {
    /// The links of a mechanism. `up`: direction against gravity in the base frame. `ratios`: motor angle per joint
    /// position, rad/rad or rad/m, which determines the steps of the differences. `rotors`: inertia of the parts that
    /// turn at motor speed, kg·m². Both have one number for each motor.
    pub fn new(
        poses: Arc<dyn LinkPoses>,
        links: &[LinkBody],
        up: [f64; 3],
        ratios: &[f64],
        rotors: &[f64],
    ) -> Result<Self, LinkageError> {
        let axes = ratios.len();
        if axes == 0 || axes > AXES || rotors.len() != axes {
            return Err(LinkageError::Motors { count: axes });
        }
        if links.is_empty() || links.len() > LINKS {
            return Err(LinkageError::Links { count: links.len() });
        }
        let towards = Vector::from(up).try_normalize(0.0).filter(|it| it.iter().all(|part| part.is_finite()));
        let links = links.iter().enumerate().map(|(index, link)| link.body(index + 1));
        let linkage = Self {
            poses,
            links: links.collect::<Result<_, _>>()?,
            up: towards.ok_or(LinkageError::Up { up })?,
            ratios: above_zero("the magnitude of the ratio", ratios.iter().map(|ratio| ratio.abs()))?,
            rotors: above_zero("the inertia of the rotor", rotors.iter().copied())?,
            axes,
        };
        if linkage.place(&[0.0; AXES]).is_none() {
            return Err(LinkageError::Home);
        }
        Ok(linkage)
    }

    /// Poses of the links, and of the flange behind them, with the motors at these angles from home, rad.
    fn place(&self, motors: &[f64; AXES]) -> Option<[Isometry3<f64>; LINKS + 1]> {
        let mut poses = [Isometry3::identity(); LINKS + 1];
        let used = &mut poses[..=self.links.len()];
        let is_placed = self.poses.place(&motors[..self.axes], used);
        let is_finite = |pose: &Isometry3<f64>| {
            let turn = pose.rotation.coords.iter();
            turn.chain(pose.translation.vector.iter()).all(|number| number.is_finite())
        };
        (is_placed && used.iter().all(is_finite)).then_some(poses)
    }

    /// Values of `what` on both sides of a pose, `by` radians or metres of the joint away, and the difference of both
    /// motor angles, rad.
    fn around<T>(
        &self,
        motors: &[f64; AXES],
        axis: usize,
        by: f64,
        what: impl Fn(&[f64; AXES]) -> Option<T>,
    ) -> Option<([T; 2], f64)> {
        let by = by * self.ratios[axis];
        let at = |by: f64| {
            let mut motors = *motors;
            motors[axis] += by;
            what(&motors)
        };
        Some(([at(-by)?, at(by)?], 2.0 * by))
    }
}

fn above_zero(quantity: &'static str, values: impl Iterator<Item = f64>) -> Result<[f64; AXES], LinkageError> {
    let mut every = [1.0; AXES];
    for (index, (known, value)) in every.iter_mut().zip(values).enumerate() {
        if !(value > 0.0 && value.is_finite()) {
            return Err(LinkageError::Motor { motor: index + 1, quantity, value });
        }
        *known = value;
    }
    Ok(every)
}

impl LinkBody {
    /// A thin uniform rod from the origin of its frame along x: mass, kg, and length, m.
    pub fn rod(mass: f64, length: f64) -> Self {
        let inertia = mass * length * length / 12.0;
        Self { mass, centre: [0.5 * length, 0.0, 0.0], inertia: [0.0, inertia, inertia, 0.0, 0.0, 0.0] }
    }

    fn body(&self, link: usize) -> Result<Body, LinkageError> {
        let numbers: [(&'static str, &[f64]); 3] =
            [("the mass", &[self.mass]), ("the centre of mass", &self.centre), ("the inertia", &self.inertia)];
        for (quantity, numbers) in numbers {
            if !numbers.iter().all(|number| number.is_finite()) {
                return Err(LinkageError::NotFinite { link, quantity });
            }
        }
        if self.mass < 0.0 {
            return Err(LinkageError::Mass { link, mass: self.mass });
        }
        let inertia = bodies::inertia(self.inertia).map_err(|moments| LinkageError::Inertia { link, moments })?;
        Ok(Body { mass: self.mass, centre: self.centre.into(), inertia })
    }
}

/// A linkage with its payload and the state of its motors.
#[derive(Clone, Debug)]
pub(super) struct Linkage {
    pub(super) bodies: Arc<LinkageBodies>,
    /// A point mass in the frame of the flange.
    payload: Body,
    pub(super) coupling: Box<Coupling>,
    /// The flange in the last pose that the links could take.
    flange: Kinematics,
}

/// Motion of each body per rad/s of a motor, the payload behind the links: velocity of its centre in the axes of the
/// base, and angular velocity in the axes of its link.
type Motions = [Twist; LINKS + 1];

/// A linkage in one pose.
pub(super) struct LinkagePose {
    dynamics: Dynamics,
    /// Change of the matrix of inertia per rad of each motor.
    slopes: [Square; AXES],
}

const UNMOVED: Twist = Twist { velocity: Vector::new(0.0, 0.0, 0.0), spin: Vector::new(0.0, 0.0, 0.0) };

impl Linkage {
    pub(super) fn new(bodies: Arc<LinkageBodies>) -> Self {
        let payload = Body { mass: 0.0, centre: Vector::zeros(), inertia: Matrix3::zeros() };
        let flange = Kinematics { flange: Frame::BASE, motors: [UNMOVED; AXES], room: 0.0 };
        let mut linkage = Self { bodies, payload, coupling: Box::new(Coupling::new()), flange };
        linkage.kinematics(&[0.0; AXES]);
        linkage
    }

    fn all_bodies(&self) -> impl Iterator<Item = &Body> {
        self.bodies.links.iter().chain([&self.payload])
    }

    /// Motions of all bodies while a motor turns.
    fn motions(&self, motors: &[f64; AXES], axis: usize) -> Option<Motions> {
        let ([low, high], difference) = self.bodies.around(motors, axis, MOTION, |motors| self.bodies.place(motors))?;
        let mut motions = [UNMOVED; LINKS + 1];
        for ((motion, body), (low, high)) in motions.iter_mut().zip(self.all_bodies()).zip(low.iter().zip(&high)) {
            let centre = Point3::from(body.centre);
            motion.velocity = (high * centre - low * centre) / difference;
            motion.spin = turned(low, high, difference);
        }
        Some(motions)
    }

    /// Matrix of inertia, and torque of the weight.
    fn inertia(&self, motors: &[f64; AXES]) -> Option<Dynamics> {
        let count = self.bodies.axes;
        let mut motions = [[UNMOVED; LINKS + 1]; AXES];
        for (axis, motions) in motions.iter_mut().enumerate().take(count) {
            *motions = self.motions(motors, axis)?;
        }
        let mut inertia = Square::from_diagonal(&Column::from(self.bodies.rotors));
        let mut weight = Column::zeros();
        for (number, body) in self.all_bodies().enumerate() {
            for row in 0..count {
                let Twist { velocity, spin } = motions[row][number];
                let (momentum, moment) = (velocity * body.mass, body.inertia * spin);
                weight[row] -= GRAVITY * self.bodies.up.dot(&momentum);
                for (column, motions) in motions.iter().enumerate().take(count) {
                    let other = &motions[number];
                    inertia[(row, column)] += momentum.dot(&other.velocity) + moment.dot(&other.spin);
                }
            }
        }
        Some(Dynamics { inertia, weight })
    }

    /// Load of one motor; no load in a pose that the links cannot take.
    pub(super) fn load(&self, number: usize, motors: &[f64; AXES]) -> Loaded {
        let mut load = Load::default();
        for (body, motion) in self.motions(motors, number).iter().flat_map(|motions| self.all_bodies().zip(motions)) {
            load = load.and(Load {
                torque: -GRAVITY * body.mass * self.bodies.up.dot(&motion.velocity),
                inertia: body.mass * motion.velocity.norm_squared() + motion.spin.dot(&(body.inertia * motion.spin)),
            });
        }
        Loaded { links: load, turning: self.bodies.rotors[number], ratio: 1.0 }
    }

    /// The flange, and its motion per rad/s of each motor. No displacement of the tool is bounded.
    pub(super) fn kinematics(&mut self, motors: &[f64; AXES]) -> Kinematics {
        if let Some(flange) = self.flange_at(motors) {
            self.flange = flange;
        }
        self.flange
    }

    fn flange_at(&self, motors: &[f64; AXES]) -> Option<Kinematics> {
        let last = self.bodies.links.len();
        let flange = |motors: &[f64; AXES]| self.bodies.place(motors).map(|poses| poses[last]);
        let here = flange(motors)?;
        let mut twists = [UNMOVED; AXES];
        for (axis, twist) in twists.iter_mut().enumerate().take(self.bodies.axes) {
            let ([low, high], difference) = self.bodies.around(motors, axis, MOTION, flange)?;
            twist.velocity = (high.translation.vector - low.translation.vector) / difference;
            twist.spin = here.rotation * turned(&low, &high, difference);
        }
        let axes = here.rotation.to_rotation_matrix().into_inner();
        Some(Kinematics { flange: Frame { axes, origin: here.translation.vector }, motors: twists, room: 0.0 })
    }

    pub(super) fn up(&self) -> Vector {
        self.bodies.up
    }

    pub(super) fn axes(&self) -> usize {
        self.bodies.axes
    }
}

/// Angular velocity in the axes of a link that turns from one pose to the next.
fn turned(low: &Isometry3<f64>, high: &Isometry3<f64>, difference: f64) -> Vector {
    let turn = low.rotation.inverse() * high.rotation;
    // The quaternion of a small turn is half of its vector. Both signs describe the same rotation.
    turn.imag() * (2.0 * turn.w.signum() / difference)
}

impl Coupled for Linkage {
    type Pose = LinkagePose;

    fn coupling(&self) -> &Coupling {
        &self.coupling
    }

    fn coupling_mut(&mut self) -> &mut Coupling {
        &mut self.coupling
    }

    fn rotors(&self) -> &[f64; AXES] {
        &self.bodies.rotors
    }

    fn pose_at(&self, motors: &[f64; AXES]) -> Option<LinkagePose> {
        let dynamics = self.inertia(motors)?;
        let mut slopes = [Square::zeros(); AXES];
        for (axis, slope) in slopes.iter_mut().enumerate().take(self.bodies.axes) {
            let inertia = |motors: &[f64; AXES]| self.inertia(motors).map(|dynamics| dynamics.inertia);
            let ([low, high], difference) = self.bodies.around(motors, axis, CHANGE, inertia)?;
            // The other elements are ones on the diagonal.
            let size = |inertia: &Square| inertia.view((0, 0), (self.bodies.axes, self.bodies.axes)).norm();
            let is_gentle = size(&(high - low)) <= STEEP * size(&dynamics.inertia);
            if !is_gentle {
                return None;
            }
            *slope = (high - low) / difference;
        }
        Some(LinkagePose { dynamics, slopes })
    }

    fn fastest_turn(&self, velocities: &Column) -> f64 {
        let turns = velocities.iter().zip(self.bodies.ratios).take(self.bodies.axes);
        turns.map(|(velocity, ratio)| velocity.abs() / ratio).fold(0.0, f64::max)
    }

    fn dynamics(&self, pose: &LinkagePose) -> Dynamics {
        pose.dynamics
    }

    fn impulses(&self, pose: &LinkagePose, velocities: &Column) -> Square {
        let mut impulses = Square::zeros();
        for (motor, slope) in pose.slopes.iter().enumerate().take(self.bodies.axes) {
            let change = slope * velocities;
            impulses.set_column(motor, &(change * -velocities[motor]));
            impulses[(motor, motor)] += 0.5 * change.dot(velocities);
        }
        impulses
    }

    fn attach(&mut self, payload: chain::Body) {
        self.payload = Body { mass: payload.mass, centre: payload.centre, inertia: Matrix3::zeros() };
    }
}
