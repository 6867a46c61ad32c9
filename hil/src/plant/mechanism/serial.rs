//! A serial chain of revolute and prismatic joints with any axes, from the numbers of a description.

use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3, Unit};

use super::bodies::ChainBodies;
use super::chain::{Body, GRAVITY, Load, Vector};
use super::coupling::Coupling;
use super::kinematics::{Frame, Kinematics, Twist};
use super::{AXES, Loaded};

/// Displacement of a prismatic joint for which the bound of [`SerialChain::travel`] holds, m.
const EXTENSION: f64 = 2.0;

#[derive(Clone, Debug)]
pub(super) struct SerialChain {
    pub(super) bodies: Arc<ChainBodies>,
    /// A point mass in the frame of the flange.
    pub(super) payload: Body,
    pub(super) coupling: Box<Coupling>,
}

/// The links of a chain in one pose. All vectors are in the axes of the base.
pub(super) struct Pose {
    pub(super) links: [Placed; AXES],
    pub(super) flange: Frame,
}

/// A link in one pose.
#[derive(Clone, Copy)]
pub(super) struct Placed {
    /// Motion of the link per velocity of its joint. `velocity` is that of the point of the link at the origin of the
    /// base.
    pub(super) joint: Twist,
    /// Mass, kg, and centre of mass, m, with the payload.
    pub(super) mass: f64,
    pub(super) centre: Vector,
    /// Inertia about the centre of mass, kg·m².
    pub(super) inertia: Matrix3<f64>,
}

impl SerialChain {
    pub(super) fn new(bodies: Arc<ChainBodies>) -> Self {
        Self { bodies, payload: Body::NONE, coupling: Box::new(Coupling::new()) }
    }

    pub(super) fn axes(&self) -> usize {
        self.bodies.links.len()
    }

    /// Joint positions, rad or m, with the motors at these angles from home, rad.
    pub(super) fn joints(&self, motors: &[f64; AXES]) -> [f64; AXES] {
        let mut joints =
            self.bodies.joints_from_motors.map(|row| row.iter().zip(motors).map(|(it, motor)| it * motor).sum());
        for (joint, link) in joints.iter_mut().zip(&self.bodies.links) {
            *joint += link.at_home;
        }
        joints
    }

    /// Velocities of the joints per rad/s of a motor.
    fn rates(&self, motor: usize) -> [f64; AXES] {
        self.bodies.joints_from_motors.map(|row| row[motor])
    }

    pub(super) fn load(&self, number: usize, motors: &[f64; AXES]) -> Loaded {
        let pose = self.pose(&self.joints(motors));
        let (mut motion, mut load) = (Twist::default(), Load::default());
        for (link, rate) in pose.links.iter().zip(self.rates(number)).take(self.axes()) {
            motion.velocity += link.joint.velocity * rate;
            motion.spin += link.joint.spin * rate;
            let velocity = motion.velocity + motion.spin.cross(&link.centre);
            load = load.and(Load {
                torque: -GRAVITY * link.mass * self.bodies.up.dot(&velocity),
                inertia: link.mass * velocity.norm_squared() + motion.spin.dot(&(link.inertia * motion.spin)),
            });
        }
        Loaded { links: load, turning: self.bodies.rotors[number], ratio: 1.0 }
    }

    /// The flange, and its motion per rad/s of each motor.
    pub(super) fn kinematics(&self, motors: &[f64; AXES]) -> Kinematics {
        let joints = self.joints(motors);
        let pose = self.pose(&joints);
        let origin = pose.flange.origin;
        let twists = pose.links.map(|Placed { joint, .. }| Twist {
            velocity: joint.velocity + joint.spin.cross(&origin),
            spin: joint.spin,
        });
        let prismatic = self.bodies.links.iter().zip(joints).filter(|(link, _)| link.prismatic);
        // Each prismatic joint moves the tool by its own displacement.
        let room = prismatic.map(|(_, joint)| EXTENSION - joint.abs()).fold(f64::INFINITY, f64::min);
        let motors = std::array::from_fn(|motor| Twist::sum(&twists, &self.rates(motor)));
        Kinematics { flange: pose.flange, motors, room }
    }

    /// Greatest displacement of a point of the tool, at most `distance`, m, from the origin of the flange, per rad of each
    /// motor, m/rad. It holds while no prismatic joint is farther than [`EXTENSION`] from its zero.
    pub(super) fn travel(&self, distance: f64) -> [f64; AXES] {
        let mut arms = [0.0; AXES];
        let mut reach = self.bodies.flange.0.norm() + distance;
        for (arm, link) in arms.iter_mut().zip(&self.bodies.links).rev() {
            if link.prismatic {
                *arm = 1.0;
                reach += EXTENSION;
            } else {
                *arm = reach;
            }
            reach += link.offset.norm();
        }
        std::array::from_fn(|motor| arms.iter().zip(self.rates(motor)).map(|(arm, rate)| arm * rate.abs()).sum())
    }

    /// The links with the joints at these positions, rad or m. Absent links have no mass and do not move.
    pub(super) fn pose(&self, joints: &[f64; AXES]) -> Pose {
        let absent = Placed { joint: Twist::default(), mass: 0.0, centre: Vector::zeros(), inertia: Matrix3::zeros() };
        let mut links = [absent; AXES];
        let mut frame = Frame::BASE;
        for ((link, placed), &position) in self.bodies.links.iter().zip(&mut links).zip(joints) {
            frame.origin += frame.axes * link.offset;
            frame.axes *= link.turn;
            let axis = frame.axes * link.axis;
            placed.joint = if link.prismatic {
                frame.origin += axis * position;
                Twist { velocity: axis, spin: Vector::zeros() }
            } else {
                let turned = Rotation3::from_axis_angle(&Unit::new_unchecked(link.axis), position);
                frame.axes *= turned.matrix();
                Twist { velocity: frame.origin.cross(&axis), spin: axis }
            };
            placed.mass = link.mass;
            placed.centre = frame.origin + frame.axes * link.centre;
            placed.inertia = frame.axes * link.inertia * frame.axes.transpose();
        }
        let (offset, turn) = &self.bodies.flange;
        let flange = Frame { origin: frame.origin + frame.axes * offset, axes: frame.axes * turn };
        if self.payload.mass > 0.0 {
            links[self.axes() - 1].attach(self.payload.mass, flange.origin + flange.axes * self.payload.centre);
        }
        Pose { links, flange }
    }
}

impl Placed {
    /// Adds a point mass, kg, at `centre`, m.
    fn attach(&mut self, mass: f64, centre: Vector) {
        let sum = self.mass + mass;
        let apart = centre - self.centre;
        self.centre += apart * (mass / sum);
        let reduced = self.mass * mass / sum;
        self.inertia += (Matrix3::identity() * apart.norm_squared() - apart * apart.transpose()) * reduced;
        self.mass = sum;
    }
}
