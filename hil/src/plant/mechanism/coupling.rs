//! Coupled dynamics of links and motors: torques from the velocities and from the accelerations of all axes.
//!
//! With the matrix of inertia A, the motor angles θ and the torques τ of motors, friction and weight, Lagrange's
//! equation reads `d/dt (A θ̇) = ½ ∇(θ̇ᵀ A θ̇) + τ`. Each drive advances its own motor, in sub-steps and in any order.
//! The velocities of all motors are therefore common to the robot, and each sub-step of a motor is a motion of that
//! motor alone:
//!
//! * Its torque, times the sub-step, is an impulse that changes the velocities of all motors by its column of A⁻¹.
//! * While it turns, A changes by ∂A/∂θᵢ θ̇ᵢ. The momenta A θ̇ of all other motors stay, and its own momentum changes by
//!   ½ θ̇ᵀ ∂A/∂θᵢ θ̇. This keeps the kinetic energy.
//!
//! The sum over all motors is Lagrange's equation. The work of each torque is the change of the energy, whatever the
//! other drives do and however far their time lags. Friction and brakes only take energy away.
//!
//! A⁻¹, the weight and the changes are held for up to 1 ms and taken at the middle of that time (second order). A joint
//! that turns fast shortens the time. The drift of the energy is measured in the tests.

use nalgebra::{Matrix3, SMatrix, SVector};

use super::AXES;
use super::chain::{GRAVITY, Vector};
use super::kinematics::Twist;
use super::serial::{Placed, Pose, SerialChain};
use crate::plant::SUB_STEP;

pub(super) type Square = SMatrix<f64, AXES, AXES>;
pub(super) type Column = SVector<f64, AXES>;

/// Most sub-steps for which the quantities of a pose are held.
const LONGEST: u32 = 10;
/// Angle by which a joint turns at most while they are held, rad. One sub-step is the shortest time.
const LARGEST_TURN: f64 = 0.02;

/// State of the coupled motors.
#[derive(Clone, Debug)]
pub(super) struct Coupling {
    /// Axes with a motor that follows torques. All other axes are held where they are.
    free: [bool; AXES],
    /// Velocities of the motor shafts, rad/s.
    pub(super) velocities: Column,
    /// The inverse of the inertia matrix of the free axes, 1/(kg·m²). Zero for held axes.
    mobility: Square,
    /// The inertia matrix of all axes, kg·m².
    inertia: Square,
    /// Torque of the weight on each motor, N·m.
    weight: Column,
    /// Whether the present pose has no inertia of its own. The inertia of an earlier pose is then held.
    holds: bool,
    /// A column for each motor: accelerations of all motors, rad/s², because that motor turns.
    changes: Square,
    /// Motors for which these quantities are held.
    turning: Turning,
    /// Number of sub-steps for which the quantities are held, and number of sub-steps of each axis since then.
    interval: u32,
    age: [u32; AXES],
    /// Number of sub-steps of all motors, and that number at the last sub-step of each motor.
    count: u64,
    last: [u64; AXES],
}

/// Motors that turn while quantities are held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Turning {
    /// All motors advance in turn, by one sub-step each.
    All,
    /// One motor advances by several sub-steps. The drives of all other motors are ahead or lag, so those stand still.
    One(usize),
}

/// A motor at the beginning of a sub-step.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct CoupledMotor {
    /// Velocity, rad/s.
    pub(in super::super) velocity: f64,
    /// Torque of the weight, N·m.
    pub(in super::super) weight: f64,
    /// Change of the velocity per impulse on the motor, 1/(kg·m²).
    pub(in super::super) mobility: f64,
}

/// Inertia of the motors and torques on the motors in one state.
#[derive(Clone, Copy)]
pub(super) struct Dynamics {
    /// Matrix of inertia, kg·m², with 1 on the diagonal for absent axes.
    pub(super) inertia: Square,
    /// Torque of the weight, N·m.
    pub(super) weight: Column,
}

impl Coupling {
    pub(super) fn new() -> Self {
        Self {
            free: [false; AXES],
            velocities: Column::zeros(),
            mobility: Square::zeros(),
            inertia: Square::zeros(),
            weight: Column::zeros(),
            holds: false,
            changes: Square::zeros(),
            turning: Turning::All,
            interval: 1,
            age: [u32::MAX; AXES],
            count: 0,
            last: [0; AXES],
        }
    }

    /// Lets the motor of an axis follow its torques.
    pub(super) fn release(&mut self, axis: usize) {
        self.free[axis] = true;
        self.expire();
    }

    /// The motor of an axis has been placed somewhere, at rest.
    pub(super) fn place(&mut self, axis: usize) {
        self.velocities[axis] = 0.0;
        self.expire();
    }

    fn expire(&mut self) {
        self.age = [u32::MAX; AXES];
    }

    /// Counts a sub-step of one motor. Returns the motors that turn at present.
    fn advance(&mut self, axis: usize) -> Turning {
        let since = self.count - self.last[axis];
        self.last[axis] = self.count;
        self.count += 1;
        let motors = self.free.iter().filter(|free| **free).count() as u64;
        if since == motors { Turning::All } else { Turning::One(axis) }
    }

    /// Share of the velocities that the motors keep when the links return to a pose with an inertia of its own. The
    /// kinetic energy does not grow.
    fn slowed_by(&self, inertia: &Square) -> f64 {
        let energy = |inertia: &Square| self.velocities.dot(&(inertia * self.velocities));
        let share = (energy(&self.inertia) / energy(inertia)).sqrt();
        // The share is not a number if the motors are at rest.
        if share < 1.0 { share } else { 1.0 }
    }

    /// Changes the velocity of one motor by an impulse on that motor, and the velocities of all other motors with it.
    pub(super) fn push(&mut self, axis: usize, change: f64) {
        let impulse = change / self.mobility[(axis, axis)];
        self.velocities += self.mobility.column(axis) * impulse;
    }
}

/// Links whose inertia couples their motors.
pub(super) trait Coupled {
    /// The links in one pose.
    type Pose;

    fn coupling(&self) -> &Coupling;

    fn coupling_mut(&mut self) -> &mut Coupling;

    /// Inertia of the rotors, kg·m².
    fn rotors(&self) -> &[f64; AXES];

    /// The links with the motors at these angles from home, rad. `None` if the links cannot take this pose.
    fn pose_at(&self, motors: &[f64; AXES]) -> Option<Self::Pose>;

    /// Speed of the fastest revolute joint while the motors turn at these velocities, rad/s.
    fn fastest_turn(&self, velocities: &Column) -> f64;

    fn dynamics(&self, pose: &Self::Pose) -> Dynamics;

    /// A column for each motor: torques on all motors, N·m, because that motor turns while all motors have these
    /// velocities, rad/s. The sum of the columns is the torque of the velocities (Coriolis and centrifugal).
    fn impulses(&self, pose: &Self::Pose, velocities: &Column) -> Square;

    fn attach(&mut self, payload: super::chain::Body);

    /// Begins a sub-step of one motor, with the motors at these angles from home, rad.
    fn begin(&mut self, axis: usize, motors: &[f64; AXES]) -> CoupledMotor {
        let turning = self.coupling_mut().advance(axis);
        if self.coupling().turning != turning || self.coupling().age[axis] >= self.coupling().interval {
            self.evaluate(turning, motors);
        }
        let coupling = self.coupling_mut();
        coupling.age[axis] += 1;
        coupling.velocities += coupling.changes.column(axis) * SUB_STEP;
        CoupledMotor {
            velocity: coupling.velocities[axis],
            weight: coupling.weight[axis],
            mobility: coupling.mobility[(axis, axis)],
        }
    }

    /// Computes the quantities that are held from now on.
    ///
    /// Angles are half a sub-step ahead of velocities, because each motor turns with its new velocity. The forces of n
    /// sub-steps act at the angles after 0 to n − 1 sub-steps. The velocities in their middle are those after n / 2.
    fn evaluate(&mut self, turning: Turning, motors: &[f64; AXES]) {
        let Coupling { mut velocities, free, .. } = *self.coupling();
        let turns = Column::from_fn(|axis, _| match turning {
            Turning::All => f64::from(u8::from(free[axis])),
            Turning::One(one) => f64::from(u8::from(axis == one)),
        });
        let fastest = self.fastest_turn(&velocities);
        // The cast saturates.
        let interval = ((LARGEST_TURN / (fastest * SUB_STEP)) as u32).clamp(1, LONGEST);
        let angles_ahead = 0.5 * f64::from(interval - 1) * SUB_STEP;
        let velocities_ahead = 0.5 * f64::from(interval) * SUB_STEP;
        let middle = std::array::from_fn(|axis| motors[axis] + angles_ahead * velocities[axis] * turns[axis]);
        let Some(pose) = self.pose_at(&middle) else {
            self.hold(turning);
            return;
        };
        let Dynamics { inertia, weight } = self.dynamics(&pose);
        if self.coupling().holds {
            velocities *= self.coupling().slowed_by(&inertia);
        }
        let mobility = inverse(&inertia, &free);
        let now = weight.component_mul(&turns) + self.impulses(&pose, &velocities) * turns;
        let later = velocities + mobility * now * velocities_ahead;
        let changes = mobility * self.impulses(&pose, &later);
        let coupling = self.coupling_mut();
        (coupling.mobility, coupling.weight, coupling.changes) = (mobility, weight, changes);
        (coupling.velocities, coupling.inertia, coupling.holds) = (velocities, inertia, false);
        (coupling.turning, coupling.interval, coupling.age) = (turning, interval, [0; AXES]);
    }

    /// Holds the inertia of the last pose while the links cannot take the present pose. Without an earlier pose, each
    /// motor turns its rotor alone. The links have no weight meanwhile, so the energy does not grow.
    fn hold(&mut self, turning: Turning) {
        let rotors = *self.rotors();
        let coupling = self.coupling_mut();
        if coupling.inertia == Square::zeros() {
            coupling.inertia = Square::from_diagonal(&Column::from(rotors));
        }
        for (axis, rotor) in rotors.iter().enumerate().filter(|(axis, _)| coupling.free[*axis]) {
            if coupling.mobility[(axis, axis)] == 0.0 {
                coupling.mobility[(axis, axis)] = 1.0 / rotor;
            }
        }
        (coupling.changes, coupling.weight, coupling.holds) = (Square::zeros(), Column::zeros(), true);
        (coupling.turning, coupling.interval, coupling.age) = (turning, LONGEST, [0; AXES]);
    }

    /// Changes the payload. The payload was at rest before: the momentum of each motor is conserved.
    fn set_payload(&mut self, payload: super::chain::Body, motors: &[f64; AXES]) {
        let inertia = |links: &Self| links.pose_at(motors).map(|pose| links.dynamics(&pose).inertia);
        let momentum = inertia(self).map(|inertia| inertia * self.coupling().velocities);
        self.attach(payload);
        let moving = momentum.filter(|momentum| momentum.norm_squared() > 0.0);
        if let Some((momentum, inertia)) = moving.zip(inertia(self)) {
            self.coupling_mut().velocities = inverse(&inertia, &self.coupling().free) * momentum;
        }
        self.coupling_mut().expire();
    }

    /// Velocity change per impulse along torques on the motors, 1/(kg·m²), with all motors free.
    fn mobility(&self, motors: &[f64; AXES], torques: &[f64; AXES]) -> f64 {
        let torques = Column::from(*torques);
        let mobility = |pose| inverse(&self.dynamics(&pose).inertia, &[true; AXES]);
        self.pose_at(motors).map_or(0.0, |pose| torques.dot(&(mobility(pose) * torques)))
    }
}

impl SerialChain {
    /// Velocities of the joints while the motors turn at these velocities, rad/s.
    pub(super) fn joint_rates(&self, velocities: &Column) -> [f64; AXES] {
        self.bodies.joints_from_motors.map(|row| row.iter().zip(velocities).map(|(it, rate)| it * rate).sum())
    }

    /// Torques on the motors, N·m, of efforts at the joints, N·m or N.
    fn at_motors(&self, efforts: &[f64; AXES]) -> Column {
        let ratios = &self.bodies.joints_from_motors;
        Column::from_fn(|motor, _| efforts.iter().zip(ratios).map(|(effort, row)| effort * row[motor]).sum())
    }
}

impl Coupled for SerialChain {
    type Pose = Pose;

    fn coupling(&self) -> &Coupling {
        &self.coupling
    }

    fn coupling_mut(&mut self) -> &mut Coupling {
        &mut self.coupling
    }

    fn rotors(&self) -> &[f64; AXES] {
        &self.bodies.rotors
    }

    fn pose_at(&self, motors: &[f64; AXES]) -> Option<Pose> {
        Some(self.pose(&self.joints(motors)))
    }

    fn fastest_turn(&self, velocities: &Column) -> f64 {
        let rates = self.joint_rates(velocities);
        let revolute = rates.iter().zip(&self.bodies.links).filter(|(_, link)| !link.prismatic);
        revolute.map(|(rate, _)| rate.abs()).fold(0.0, f64::max)
    }

    fn attach(&mut self, payload: super::chain::Body) {
        self.payload = payload;
    }

    fn dynamics(&self, pose: &Pose) -> Dynamics {
        let count = self.axes();
        let mut joints = [[0.0; AXES]; AXES];
        let mut weights = [0.0; AXES];
        let mut outer = Mass::default();
        for outermost in (0..count).rev() {
            outer.add(&Mass::of(&pose.links[outermost]));
            let momentum = outer.momentum(&pose.links[outermost].joint);
            weights[outermost] = -GRAVITY * self.bodies.up.dot(&momentum.velocity);
            for (inner, link) in pose.links.iter().enumerate().take(outermost + 1) {
                let inertia = along(&link.joint, &momentum);
                (joints[inner][outermost], joints[outermost][inner]) = (inertia, inertia);
            }
        }
        let mut inertia = Square::from_diagonal(&Column::from(self.bodies.rotors));
        let ratios = &self.bodies.joints_from_motors;
        for motor in 0..count {
            // Momentum of each joint while the motor turns at 1 rad/s.
            let momentum = joints.map(|row| row.iter().zip(ratios).map(|(it, ratio)| it * ratio[motor]).sum());
            let column = self.at_motors(&momentum);
            for other in 0..count {
                inertia[(other, motor)] += column[other];
            }
        }
        Dynamics { inertia, weight: self.at_motors(&weights) }
    }

    fn impulses(&self, pose: &Pose, velocities: &Column) -> Square {
        let count = self.axes();
        let rates = self.joint_rates(velocities);
        // Motion of each link's predecessor, and mass and momentum of all links from each link to the last one.
        let mut motions = [Twist::default(); AXES];
        let mut motion = Twist::default();
        for ((link, rate), before) in pose.links.iter().zip(rates).zip(&mut motions).take(count) {
            *before = motion;
            motion.velocity += link.joint.velocity * rate;
            motion.spin += link.joint.spin * rate;
        }
        let mut masses = [Mass::default(); AXES];
        let mut momenta = [Twist::default(); AXES];
        let (mut mass, mut momentum) = (Mass::default(), Twist::default());
        for number in (0..count).rev() {
            let link = Mass::of(&pose.links[number]);
            mass.add(&link);
            let of_link = link.momentum(&motion);
            momentum.velocity += of_link.velocity;
            momentum.spin += of_link.spin;
            (masses[number], momenta[number]) = (mass, momentum);
            motion = motions[number];
        }
        // A row for each joint that turns: change of the momentum along each joint, at constant velocities.
        let mut slopes = [[0.0; AXES]; AXES];
        for (turned, slopes) in slopes.iter_mut().enumerate().take(count) {
            // The links behind the joint turn. Seen from them, the motion of the links before the joint turns back.
            let joint = &pose.links[turned].joint;
            let before = &motions[turned];
            let change = Twist {
                velocity: before.spin.cross(&joint.velocity) + before.velocity.cross(&joint.spin),
                spin: before.spin.cross(&joint.spin),
            };
            let behind = &momenta[turned];
            let mut whole = masses[turned].momentum(&change);
            whole.velocity += joint.spin.cross(&behind.velocity);
            whole.spin += joint.spin.cross(&behind.spin) + joint.velocity.cross(&behind.velocity);
            for (number, slope) in slopes.iter_mut().enumerate().take(count) {
                let other = &pose.links[number].joint;
                *slope = if number < turned {
                    along(other, &whole)
                } else {
                    along(other, &masses[number].momentum(&change))
                };
            }
        }
        let ratios = &self.bodies.joints_from_motors;
        let mut impulses = Square::zeros();
        for motor in 0..count {
            let mut slope = [0.0; AXES];
            for (joint, row) in slopes.iter().enumerate().take(count).filter(|(joint, _)| ratios[*joint][motor] != 0.0)
            {
                for (sum, row) in slope.iter_mut().zip(row) {
                    *sum += row * ratios[joint][motor];
                }
            }
            let slope = self.at_motors(&slope);
            impulses.set_column(motor, &(slope * -velocities[motor]));
            impulses[(motor, motor)] += 0.5 * slope.dot(velocities);
        }
        impulses
    }
}

/// Masses with their moments about the origin of the base.
#[derive(Clone, Copy, Default)]
struct Mass {
    /// kg.
    mass: f64,
    /// kg·m.
    first: Vector,
    /// kg·m².
    second: Matrix3<f64>,
}

impl Mass {
    fn of(link: &Placed) -> Self {
        let centre = &link.centre;
        let square = Matrix3::identity() * centre.norm_squared() - centre * centre.transpose();
        Self { mass: link.mass, first: centre * link.mass, second: link.inertia + square * link.mass }
    }

    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.first += other.first;
        self.second += other.second;
    }

    /// Linear momentum, and angular momentum about the origin of the base, of a motion.
    fn momentum(&self, motion: &Twist) -> Twist {
        Twist {
            velocity: motion.velocity * self.mass + motion.spin.cross(&self.first),
            spin: self.second * motion.spin + self.first.cross(&motion.velocity),
        }
    }
}

/// Component of a momentum, or of a force and its torque about the origin of the base, along the motion of a joint.
fn along(joint: &Twist, momentum: &Twist) -> f64 {
    joint.velocity.dot(&momentum.velocity) + joint.spin.dot(&momentum.spin)
}

/// Inverse of the part of a matrix of inertia that belongs to free axes. Zero for all other axes.
fn inverse(inertia: &Square, free: &[bool; AXES]) -> Square {
    let part = |whole: &Square, held: f64| {
        Square::from_fn(|row, column| match (free[row] && free[column], row == column) {
            (true, _) => whole[(row, column)],
            (false, true) => held,
            (false, false) => 0.0,
        })
    };
    // Rounding may leave a matrix of extreme numbers indefinite. Without coupling, its axes still move.
    let alone = || Square::from_diagonal(&inertia.diagonal().map(|it| 1.0 / it));
    part(&part(inertia, 1.0).cholesky().map_or_else(alone, |factors| factors.inverse()), 0.0)
}
