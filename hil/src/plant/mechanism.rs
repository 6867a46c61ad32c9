//! Coupled dynamics of the motors of one robot: gravity, inertia and payload.

mod bodies;
mod chain;
mod coupling;
mod irp6;
mod kinematics;
mod linkage;
mod polycrank;
mod rnt;
mod screw;
mod serial;
mod shaft;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pub use bodies::{ChainBodies, ChainBodyJoint, ChainError};
use chain::Body;
pub use chain::Load;
pub(super) use coupling::CoupledMotor;
use coupling::{Coupled, Coupling};
use irp6::Irp6;
pub(crate) use kinematics::{Kinematics, Shafts};
use linkage::Linkage;
pub use linkage::{LinkBody, LinkPoses, LinkageBodies, LinkageError};
use nalgebra::Vector3;
use polycrank::Polycrank;
use rnt::Rnt;
use serial::SerialChain;
use shaft::Shaft;

/// The robot whose mechanics couple the motors.
#[derive(Clone, Debug, PartialEq)]
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
    /// One to eight axes in series, with any axes, masses and inertias.
    Chain(Arc<ChainBodies>),
    /// Links in any arrangement. A function computes their poses.
    Linkage(Arc<LinkageBodies>),
}

/// The links of one robot, on which its axes are mounted. Clones refer to the same robot.
///
/// Each motor carries the weight and the inertia that its own rotation moves, in the present pose of all motors.
/// Screws, parallelograms, rods and platforms couple the motors as in the robot. The load is computed once per
/// millisecond. Left out: bending; friction that depends on load.
///
/// In a [`MechanismConfig::Chain`] and a [`MechanismConfig::Linkage`], accelerations and velocities of all axes act on
/// each motor (inertial coupling, Coriolis and centrifugal torques). Motors that advance together, such as the motors
/// of a [`Scene`](crate::scene::Scene), couple in each sub-step of 100 µs. Otherwise the torques of the other motors
/// act on a motor when its own drive advances, for example once per SYNC. An axis without a motor is held, and so is an
/// axis with the regression model. The models of the laboratory's robots leave these torques out, except that a
/// change of inertia by the other axes conserves the momentum.
///
/// In a [`Scene`](crate::scene::Scene), the forces on the flange also load the motors, in each sub-step.
///
/// The load of an axis follows from the last simulated positions of the other axes. The result is a function of
/// configurations, seeds and the order of all calls. A [`World`](crate::World) keeps that order. If several threads
/// advance the drives of one robot, the results stay valid but differ in their last bits from run to run. A drive
/// without calls lags by up to 20 ms.
#[derive(Clone, Debug)]
pub struct Mechanism(Arc<Shared>);

#[derive(Debug)]
// Different threads may advance two robots. Two robots therefore share no cache line.
#[repr(align(128))]
struct Shared {
    robot: Mutex<Robot>,
    /// The motor shafts in each sub-step, if the mechanism is in a scene.
    shafts: [Shaft; AXES],
    in_scene: AtomicBool,
}

/// The place of one axis in a [`Mechanism`].
#[derive(Clone, Debug)]
pub struct Mount {
    mechanism: Mechanism,
    number: usize,
}

/// Largest number of axes of a robot.
pub(crate) const AXES: usize = 8;

#[derive(Clone, Debug)]
struct Robot {
    links: Links,
    count: usize,
    /// Whether each axis has a mount.
    mounted: [bool; AXES],
    /// Motor angles at home, rad.
    homes: [f64; AXES],
    /// Motor angles relative to home, rad.
    motors: [f64; AXES],
    /// The last load of each motor, and the motor angles that it is for. A robot at rest keeps its loads.
    loads: [Option<([f64; AXES], Loaded)>; AXES],
}

#[derive(Clone, Debug)]
enum Links {
    Irp6(Irp6),
    Rnt(Rnt),
    Polycrank(Polycrank),
    Chain(SerialChain),
    Linkage(Linkage),
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
            MechanismConfig::Chain(bodies) => {
                let axes = bodies.axes();
                (Links::Chain(SerialChain::new(bodies)), axes)
            }
            MechanismConfig::Linkage(bodies) => {
                let linkage = Linkage::new(bodies);
                let axes = linkage.axes();
                (Links::Linkage(linkage), axes)
            }
        };
        let robot = Robot {
            links,
            count,
            mounted: [false; AXES],
            homes: [0.0; AXES],
            motors: [0.0; AXES],
            loads: [None; AXES],
        };
        let shafts = std::array::from_fn(|_| Shaft::default());
        Self(Arc::new(Shared { robot: Mutex::new(robot), shafts, in_scene: AtomicBool::new(false) }))
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
        robot.mounted[number] = true;
        robot.homes[number] = home;
        self.0.shafts[number].set(home + robot.motors[number], 0.0);
        Some(Mount { mechanism: self.clone(), number })
    }

    /// Sets the payload, in place of the previous payload: `mass`, kg, with its centre at `centre`, m, in the flange
    /// frame. The z axis of the frame is the tool axis. Its origin depends on the robot:
    ///
    /// * IRb-6: 95 mm beyond the pitch axis, before the gripper.
    /// * IRp-6: the intersection of roll and flange axis, before the gripper.
    /// * RNT: 100 mm beyond the wrist centre.
    /// * Polycrank: the frame of the last joint.
    /// * Chain: the flange of its description.
    /// * Linkage: the flange that its function places.
    pub fn set_payload(&self, mass: f64, centre: [f64; 3]) {
        let mut robot = self.lock();
        let (motors, payload) = (robot.motors, Body::point(mass, centre));
        match &mut robot.links {
            Links::Irp6(irp6) => irp6.chain.payload = payload,
            Links::Rnt(rnt) => rnt.wrist.payload = payload,
            Links::Polycrank(polycrank) => polycrank.chain.payload = payload,
            Links::Chain(chain) => chain.set_payload(payload, &motors),
            Links::Linkage(linkage) => linkage.set_payload(payload, &motors),
        }
        robot.loads = [None; AXES];
    }

    /// Load on the motor of axis `number` in the present pose; zero for an absent axis. The query does not change the
    /// motion.
    pub fn load(&self, number: usize) -> Load {
        let robot = self.lock();
        if number >= robot.count {
            return Load::default();
        }
        let loaded = match &robot.links {
            Links::Chain(chain) => chain.load(number, &robot.motors),
            Links::Linkage(linkage) => linkage.load(number, &robot.motors),
            Links::Irp6(_) | Links::Rnt(_) | Links::Polycrank(_) => robot.clone().load(number),
        };
        Load { torque: loaded.links.torque, inertia: loaded.inertia() }
    }

    /// Load on each motor with the motor shafts at these `angles`, rad. The pose of the mechanism does not change.
    pub fn loads_at(&self, angles: &[f64]) -> Vec<Load> {
        let mut robot = self.lock().clone();
        let (homes, count) = (robot.homes, robot.count);
        let placed = angles.iter().zip(homes).map(|(angle, home)| angle - home);
        robot.motors.iter_mut().zip(placed).take(count).for_each(|(motor, placed)| *motor = placed);
        let motors = robot.motors;
        if let Links::Rnt(rnt) = &mut robot.links {
            rnt.settle(&motors);
        }
        let load = |loaded: Loaded| Load { torque: loaded.links.torque, inertia: loaded.inertia() };
        (0..robot.count).map(|number| load(robot.load(number))).collect()
    }

    /// Unit vector against gravity in the base frame. The origin of that frame depends on the robot:
    ///
    /// * IRb-6 and IRp-6: the shoulder, z up. On the track: the place of the shoulder with the carriage at zero. The
    ///   carriage moves along y.
    /// * RNT: the centre of the legs' joints in the base, z along the central leg.
    /// * Polycrank: on axis 1, which is the z axis.
    /// * Chain: the base of its description.
    /// * Linkage: the base of its function.
    pub fn up(&self) -> [f64; 3] {
        match &self.lock().links {
            Links::Irp6(_) => irp6::UP,
            Links::Rnt(_) => rnt::UP,
            Links::Polycrank(_) => polycrank::UP,
            Links::Chain(chain) => chain.bodies.up,
            Links::Linkage(linkage) => linkage.up(),
        }
        .into()
    }

    /// Effective mass, kg, of a point of the tool in a direction: force per acceleration, with all motors free and
    /// without friction. `point`, m, is in the flange frame, and `direction` in the base frame. Infinite if no motor
    /// moves the point in this direction. The inertia of each motor is given by [`Mechanism::load`]; the inertial
    /// coupling between motors is neglected, except in a [`MechanismConfig::Chain`] or a [`MechanismConfig::Linkage`].
    ///
    /// A drive that holds its position adds resistance only after its reaction time. The effective mass determines the
    /// peak force of an impact that is shorter than this time.
    pub fn effective_mass(&self, point: [f64; 3], direction: [f64; 3]) -> f64 {
        let (kinematics, _) = self.kinematics();
        let arm = kinematics.flange.axes * Vector3::from(point);
        let force = Vector3::from(direction).normalize();
        let torques = kinematics.torques(&force, &arm.cross(&force));
        let robot = self.lock();
        match &robot.links {
            Links::Chain(chain) => return 1.0 / chain.mobility(&robot.motors, &torques),
            Links::Linkage(linkage) => return 1.0 / linkage.mobility(&robot.motors, &torques),
            Links::Irp6(_) | Links::Rnt(_) | Links::Polycrank(_) => {}
        }
        let mut robot = robot.clone();
        let motors = torques.iter().take(robot.count).enumerate();
        let mobility: f64 = motors.map(|(number, torque)| torque * torque / robot.load(number).inertia()).sum();
        1.0 / mobility
    }

    /// Makes the mechanism part of a scene. Returns whether the mechanism was already part of a scene.
    pub(crate) fn enter_scene(&self) -> bool {
        let robot = self.lock();
        let shafts = self.0.shafts.iter().zip(robot.homes.iter().zip(&robot.motors));
        for (shaft, (home, motor)) in shafts {
            shaft.set(home + motor, 0.0);
        }
        self.0.in_scene.swap(true, Ordering::Relaxed)
    }

    /// Removes the mechanism from its scene, and clears all forces on the flange.
    pub(crate) fn leave_scene(&self) {
        self.0.in_scene.store(false, Ordering::Relaxed);
        for shaft in &self.0.shafts {
            shaft.set_torque(0.0);
        }
    }

    pub(crate) fn in_scene(&self) -> bool {
        self.0.in_scene.load(Ordering::Relaxed)
    }

    /// The flange at the present motor angles, and the velocities of the motor shafts, rad/s. Without a scene, the
    /// angles are the last angles of [`Mechanism::load`], and the velocities are zero.
    pub(crate) fn kinematics(&self) -> (Kinematics, [f64; AXES]) {
        if self.in_scene() {
            let shafts = self.shafts();
            return (self.kinematics_at(&shafts), shafts.velocities);
        }
        let mut robot = self.lock();
        let motors = robot.motors;
        (robot.kinematics(&motors), [0.0; AXES])
    }

    /// The motor shafts of a mechanism in a scene.
    pub(crate) fn shafts(&self) -> Shafts {
        let shafts = &self.0.shafts;
        Shafts { angles: shafts.each_ref().map(Shaft::angle), velocities: shafts.each_ref().map(Shaft::velocity) }
    }

    /// The flange with the motor shafts at these angles.
    pub(crate) fn kinematics_at(&self, shafts: &Shafts) -> Kinematics {
        let mut robot = self.lock();
        let motors = robot.relative_to_home(&shafts.angles);
        robot.kinematics(&motors)
    }

    /// Greatest displacement of a point of the tool per rad of each motor, m/rad, within [`Kinematics::room`] of a
    /// pose. The point is at most `distance`, m, from the origin of the flange.
    pub(crate) fn travel(&self, distance: f64) -> [f64; AXES] {
        match &self.lock().links {
            Links::Irp6(irp6) => irp6.travel(distance),
            Links::Rnt(rnt) => rnt.travel(distance),
            Links::Polycrank(polycrank) => polycrank.travel(distance),
            Links::Chain(chain) => chain.travel(distance),
            // The flange is computed in each step, because its room is 0.
            Links::Linkage(_) => [0.0; AXES],
        }
    }

    /// Sets the wrench that loads the motors until the next call: a force, N, at the origin of the flange, and a
    /// torque, N·m, both in the base frame.
    pub(crate) fn push(&self, kinematics: &Kinematics, force: &Vector3<f64>, torque: &Vector3<f64>) {
        for (shaft, torque) in self.0.shafts.iter().zip(kinematics.torques(force, torque)) {
            shaft.set_torque(torque);
        }
    }

    /// Number of axes with a mount.
    pub(crate) fn mounted(&self) -> usize {
        self.lock().mounted.iter().filter(|mounted| **mounted).count()
    }

    /// Whether both refer to the same robot.
    pub(crate) fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    fn lock(&self) -> MutexGuard<'_, Robot> {
        // A panic of another thread leaves valid numbers behind.
        self.0.robot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Mount {
    /// Sets the motor to `angle`, rad, from any angle, and moves the links accordingly.
    pub(super) fn place(&self, angle: f64) {
        let mut robot = self.mechanism.lock();
        robot.motors[self.number] = angle - robot.homes[self.number];
        self.shaft().set(angle, 0.0);
        let motors = robot.motors;
        match &mut robot.links {
            Links::Rnt(rnt) => rnt.settle(&motors),
            Links::Chain(chain) => chain.coupling.place(self.number),
            Links::Linkage(linkage) => linkage.coupling.place(self.number),
            Links::Irp6(_) | Links::Polycrank(_) => {}
        }
    }

    /// Lets the motor take part in coupled dynamics. Returns whether the robot has coupled dynamics.
    pub(super) fn release(&self) -> bool {
        let mut robot = self.mechanism.lock();
        let coupling = robot.links.coupling();
        let is_coupled = coupling.is_some();
        coupling.into_iter().for_each(|coupling| coupling.release(self.number));
        is_coupled
    }

    /// Begins a sub-step of the motor of a robot with coupled dynamics; `None` for another robot.
    pub(super) fn begin(&self) -> Option<CoupledMotor> {
        let mut robot = self.mechanism.lock();
        let motors = robot.motors;
        match &mut robot.links {
            Links::Chain(chain) => Some(chain.begin(self.number, &motors)),
            Links::Linkage(linkage) => Some(linkage.begin(self.number, &motors)),
            Links::Irp6(_) | Links::Rnt(_) | Links::Polycrank(_) => None,
        }
    }

    /// Ends a sub-step of the motor of a robot with coupled dynamics: its torques have changed its velocity by
    /// `change`, rad/s, and the motor has turned to `angle`, rad.
    pub(super) fn end(&self, change: f64, angle: f64) {
        let mut robot = self.mechanism.lock();
        robot.motors[self.number] = angle - robot.homes[self.number];
        let Some(coupling) = robot.links.coupling() else {
            return;
        };
        if change != 0.0 {
            coupling.push(self.number, change);
        }
        if self.in_scene() {
            for (shaft, velocity) in self.mechanism.0.shafts.iter().zip(&coupling.velocities) {
                shaft.set_velocity(*velocity);
            }
        }
    }

    /// Records the motor's new `angle`, rad, for the loads of the other axes. Returns the motor's load there.
    pub(super) fn load(&self, angle: f64) -> Loaded {
        let mut robot = self.mechanism.lock();
        robot.motors[self.number] = angle - robot.homes[self.number];
        robot.load(self.number)
    }

    pub(super) fn mechanism(&self) -> &Mechanism {
        &self.mechanism
    }

    /// Whether the mechanism is part of a scene.
    pub(super) fn in_scene(&self) -> bool {
        self.mechanism.in_scene()
    }

    /// The motor's shaft, as the scene sees it.
    pub(super) fn shaft(&self) -> &Shaft {
        &self.mechanism.0.shafts[self.number]
    }
}

impl Links {
    /// The state of motors with coupled dynamics; `None` for another robot.
    fn coupling(&mut self) -> Option<&mut Coupling> {
        match self {
            Self::Chain(chain) => Some(&mut chain.coupling),
            Self::Linkage(linkage) => Some(&mut linkage.coupling),
            Self::Irp6(_) | Self::Rnt(_) | Self::Polycrank(_) => None,
        }
    }
}

impl Robot {
    /// Motor angles relative to home, rad, with the motor shafts at these angles, rad.
    fn relative_to_home(&self, angles: &[f64; AXES]) -> [f64; AXES] {
        let mut motors = self.motors;
        let angles = angles.iter().zip(&self.homes).take(self.count);
        for (motor, (angle, home)) in motors.iter_mut().zip(angles) {
            *motor = angle - home;
        }
        motors
    }

    fn kinematics(&mut self, motors: &[f64; AXES]) -> Kinematics {
        match &mut self.links {
            Links::Irp6(irp6) => irp6.kinematics(motors),
            Links::Rnt(rnt) => rnt.kinematics(motors),
            Links::Polycrank(polycrank) => polycrank.kinematics(motors),
            Links::Chain(chain) => chain.kinematics(motors),
            Links::Linkage(linkage) => linkage.kinematics(motors),
        }
    }

    fn load(&mut self, number: usize) -> Loaded {
        if let Some((_, load)) = self.loads[number].filter(|(motors, _)| *motors == self.motors) {
            return load;
        }
        let load = match &mut self.links {
            Links::Irp6(irp6) => irp6.load(number, &self.motors),
            Links::Rnt(rnt) => rnt.load(number, &self.motors),
            Links::Polycrank(polycrank) => polycrank.load(number, &self.motors),
            Links::Chain(chain) => chain.load(number, &self.motors),
            Links::Linkage(linkage) => linkage.load(number, &self.motors),
        };
        self.loads[number] = Some((self.motors, load));
        load
    }
}
