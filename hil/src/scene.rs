//! The bodies and surfaces of a cell, and the contact forces between them and the robots.
//!
//! A [`Scene`] is the set of bodies and surfaces around the robots of a cell. A scene belongs to the
//! [`World`](crate::World), which is the whole emulated side of a cell. Robots with drives on different buses are
//! therefore in the same scene.
//!
//! * Walls are surfaces at rest: half-spaces and boxes ([`WallConfig`]). A wall may have a belt, which runs at a set
//!   velocity or is driven by a motor of the cell.
//! * Bodies are boxes and bars that move freely ([`BodyConfig`]). Their corners touch walls and faces of other bodies.
//! * Robots are [`Mechanism`]s. Their tools have tips, which are spheres ([`TipConfig`]). The transpose of the Jacobian
//!   converts forces on tips and in grippers to motor torques. Tips have no mass of their own.
//! * A grip holds a body by a spring and a damper in six dimensions ([`GripConfig`]). A body may be held by several
//!   grippers. The tips of a robot do not touch the bodies that the robot holds. If a tip is inside a body when
//!   the robot releases the body, their contact begins only after the tip has left the body. The release therefore adds
//!   no energy. A digital output may open and close a gripper ([`GripperConfig`]).
//! * Workpieces are height fields ([`WorkpieceConfig`]), which cutting tools of robots carve ([`CutterConfig`]).
//! * Light gates have beams, which bodies break ([`BeamConfig`]). Bodies may be placed on a conveyor at a later time
//!   ([`Scene::place_body`]).
//! * Sensors between flange and tool measure the wrench of these forces ([`SensorConfig`]). Forces on the tips actuate
//!   switches of touch probes ([`Scene::add_touch`]). Sensors at a distance see walls and bodies through a [`View`].
//!
//! The scene advances in steps of 100 µs ([`STEP`]). Each step has three parts. First, the motors of the robots move by
//! one sub-step under the forces of the last step. Then the bodies move. Last, the forces at the end of the step are
//! computed. The result depends only on the configuration and on the demands on the motors. Two runs of the same build
//! are equal bit for bit.
//!
//! The flange of a robot is not computed in the steps in which no tip can reach a surface. A scene with bodies or with
//! cutting tools at workpieces computes each flange in each step. The results are the same bit for bit.
//!
//! # Momentum and energy
//!
//! The integration of bodies is implicit. The work of a spring force over a step is equal to the decrease of the
//! spring's energy. Forces between bodies therefore conserve momentum, and surfaces at rest add no energy. Both
//! statements hold at any stiffness, up to rounding. The equations of a step are solved by fixed-point iteration. A
//! step that does not converge is halved, down to [`SHORTEST`]. [`Scene::unsolved`] counts the steps of this shortest
//! length that did not converge.
//!
//! Motors are integrated by semi-implicit Euler, also without a scene. The contact forces on a motor are those at the
//! beginning of its sub-step. The relative energy error of a contact with a robot is therefore about (step · natural
//! frequency of the contact)². For 1e5 N/m and 5 kg the error is 2e-4 of the energy of the impact. Friction in the
//! gears dissipates more.
//!
//! Left out: contacts of edges with edges and of tips with tips, and bending of links and tools. Joints and gears are
//! rigid. A force does not move the robot in a direction in which no motor moves the tool. Forces do not act on a motor
//! with the regression model.
//!
//! # Rigid-body libraries
//!
//! Rapier 0.36 and parry 0.31 were considered, by their documentation and issues. Rapier solves for impulses
//! iteratively. Its contacts have a natural frequency and a damping ratio, and no stiffness in N/m. Energy may grow in
//! stiff contacts (rapier issues 97 and 630), and a robot must be a multibody of rapier. From parry, the scene would
//! need only the distance of a point from a box, which [`Shape`] computes in twenty lines.

mod arm;
mod beam;
mod body;
mod contact;
mod conveyor;
mod cutter;
mod error;
mod forces;
mod grip;
mod gripper;
mod motion;
mod probe;
mod separate;
mod surface;
#[cfg(test)]
mod tests;
mod view;
mod workpiece;

use std::time::Duration;

use can::Instant;
use nalgebra::{Isometry3, Vector3};

use crate::{InputProbe, Mechanism};
use arm::Arm;
pub use arm::FlangeProbe;
use beam::Beams;
pub use beam::{BeamConfig, BeamEdge, BeamProbe, SHORTEST_RESPONSE};
use body::{Body, CORNERS};
pub use body::{BodyConfig, BodyState};
use contact::{Sphere, Surface, clearance};
use conveyor::{Arrivals, Belt, Drift};
pub use cutter::CutterConfig;
use cutter::Cutting;
pub use error::SceneError;
use forces::holds;
pub use grip::GripConfig;
use grip::{End, Hold};
use gripper::Gripper;
pub use gripper::{GripProbe, GripperConfig};
use motion::{Motion, Moving};
use probe::Touch;
pub use probe::{BodyProbe, SensorConfig, SensorProbe, UnsolvedProbe, WrenchProbe};
pub(crate) use separate::RobotOfScene;
pub use surface::{Material, Shape};
use view::SeenBodies;
pub use view::{Hit, View};
pub use workpiece::{HeightField, MOST_CELLS, WorkpieceConfig, WorkpieceProbe};

/// Duration of a step.
pub const STEP: Duration = Duration::from_micros(100);
const STEP_SECONDS: f64 = 1e-4;
/// Number of times that a step may be halved.
const HALVINGS: u32 = 6;
/// Duration of the shortest part of a step.
pub const SHORTEST: Duration = Duration::from_nanos(100_000 >> HALVINGS);
/// Iterations after which a step counts as not converging.
const REPETITIONS: u32 = 40;
/// Tolerance of a solved step: the velocity changes between two iterations by at most the first value, m/s, plus the
/// second value times the speed.
const SOLVED: (f64, f64) = (1e-11, 1e-12);

/// Greatest angle between the upward directions of a robot and of its scene, rad.
const MOST_LEANING: f64 = 1e-3;

/// A surface at rest in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallConfig {
    /// The solid behind the surface.
    pub shape: Shape,
    /// The frame of the shape in the world.
    pub pose: Isometry3<f64>,
    /// Elasticity and friction.
    pub material: Material,
}

/// The spherical tip of a tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipConfig {
    /// Centre of the sphere in the flange frame of [`Mechanism::set_payload`], m.
    pub centre: [f64; 3],
    /// Radius, m. Zero is a point.
    pub radius: f64,
}

/// The mount of a gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holder {
    /// The flange of a robot.
    Robot(RobotId),
    /// The world: a clamp.
    World,
}

/// A wall of one [`Scene`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct WallId(usize);

/// A body of one [`Scene`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BodyId(usize);

/// A robot of one [`Scene`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RobotId(usize);

/// A grip of one [`Scene`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GripId(usize);

/// Bodies, surfaces and robots of a cell.
pub struct Scene {
    now: Instant,
    gravity: Vector3<f64>,
    walls: Vec<Wall>,
    bodies: Vec<Body>,
    probes: Vec<(usize, BodyProbe)>,
    seen: Option<SeenBodies>,
    arms: Vec<Arm>,
    corners: Vec<CornersOn>,
    tips: Vec<TipOn>,
    grips: Vec<Option<Grip>>,
    beams: Beams,
    arrivals: Arrivals,
    grippers: Vec<Gripper>,
    cutting: Cutting,
    unsolved: UnsolvedProbe,
}

struct Wall {
    surface: Surface,
    motion: Motion,
    moving: Moving,
    belt: Option<Belt>,
    drift: Option<Drift>,
}

/// The solid that a sphere touches: the index of a wall or of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ground {
    Wall(usize),
    Body(usize),
}

/// A pair for the contact check: the corners of a body, and a surface.
struct CornersOn {
    body: usize,
    ground: Ground,
    bristles: [Vector3<f64>; CORNERS],
    /// The bristles at the end of the present step.
    next: [Vector3<f64>; CORNERS],
}

/// A pair for the contact check: a tip of a robot, and a surface.
struct TipOn {
    arm: usize,
    tip: usize,
    ground: Ground,
    /// The robot holds the body, or the tip has been inside the body since the robot held it: no contact.
    inside: bool,
    bristle: Vector3<f64>,
    next: Vector3<f64>,
}

struct Grip {
    config: GripConfig,
    holder: Holder,
    anchor: End,
    body: usize,
    held: End,
    /// Forces on the body at the last step.
    hold: Hold,
}

impl Default for Scene {
    fn default() -> Self {
        Self::new()
    }
}

impl Scene {
    /// An empty scene at [`Instant::ZERO`]. Gravity is 9.81 m/s² along −z of the world.
    pub fn new() -> Self {
        Self {
            now: Instant::ZERO,
            gravity: Vector3::new(0.0, 0.0, -9.81),
            walls: Vec::new(),
            bodies: Vec::new(),
            probes: Vec::new(),
            seen: None,
            arms: Vec::new(),
            corners: Vec::new(),
            tips: Vec::new(),
            grips: Vec::new(),
            beams: Beams::default(),
            arrivals: Arrivals::default(),
            grippers: Vec::new(),
            cutting: Cutting::default(),
            unsolved: UnsolvedProbe::default(),
        }
    }

    /// Sets the gravitational acceleration of bodies and in force sensors, m/s², in the axes of the world. The weight
    /// of mechanisms does not change. Fails if a number is invalid, or if a robot of the scene has another upward direction.
    pub fn set_gravity(&mut self, gravity: [f64; 3]) -> Result<(), SceneError> {
        if !gravity.iter().all(|value| value.is_finite()) {
            return Err(SceneError::NotFinite { what: "the gravity" });
        }
        let gravity = Vector3::from(gravity);
        self.arms.iter().try_for_each(|arm| upright(&arm.up(), &gravity))?;
        self.gravity = gravity;
        Ok(())
    }

    /// Adds a wall. Fails if the surface is not passive or a number is invalid.
    pub fn add_wall(&mut self, config: &WallConfig) -> Result<WallId, SceneError> {
        passive(&config.material)?;
        finite(&config.pose, "the place of a wall")?;
        if let Shape::Box { half } = config.shape {
            lengths(half)?;
        }
        let (origin, axes) = parts(&config.pose);
        let wall = self.walls.len();
        self.walls.push(Wall {
            surface: Surface { shape: config.shape, material: config.material, belt: Vector3::zeros() },
            motion: Motion::standing(origin, axes),
            moving: Moving { origin, axes, velocity: Vector3::zeros(), spin: Vector3::zeros() },
            belt: None,
            drift: None,
        });
        for body in 0..self.bodies.len() {
            self.corners.push(CornersOn::new(body, Ground::Wall(wall)));
        }
        self.meet_tips(Ground::Wall(wall));
        Ok(WallId(wall))
    }

    /// Adds a body. Fails if a number is invalid or the surface is not passive.
    pub fn add_body(&mut self, config: &BodyConfig) -> Result<BodyId, SceneError> {
        config.check()?;
        let body = self.bodies.len();
        self.bodies.push(Body::new(config));
        for wall in 0..self.walls.len() {
            self.corners.push(CornersOn::new(body, Ground::Wall(wall)));
        }
        for other in 0..body {
            self.corners.push(CornersOn::new(body, Ground::Body(other)));
            self.corners.push(CornersOn::new(other, Ground::Body(body)));
        }
        self.meet_tips(Ground::Body(body));
        self.show_to_views(BodyId(body));
        Ok(BodyId(body))
    }

    /// Adds a robot. `base` is the pose of its base frame in the world; [`Mechanism::up`] describes this frame. Fails
    /// if the mechanism already belongs to a scene, or if its upward direction differs from the upward direction of the
    /// scene.
    pub fn add_robot(&mut self, mechanism: &Mechanism, base: &Isometry3<f64>) -> Result<RobotId, SceneError> {
        finite(base, "the place of a robot")?;
        let up = base.rotation * Vector3::from(mechanism.up());
        upright(&up, &self.gravity)?;
        if mechanism.enter_scene() {
            return Err(SceneError::Taken);
        }
        self.arms.push(Arm::new(mechanism, base));
        Ok(RobotId(self.arms.len() - 1))
    }

    /// Adds a tip to the tool of a robot of this scene. Fails if a number is invalid.
    pub fn add_tip(&mut self, robot: RobotId, config: &TipConfig) -> Result<(), SceneError> {
        if !config.centre.iter().all(|value| value.is_finite()) {
            return Err(SceneError::NotFinite { what: "the centre of a tip" });
        }
        if !(config.radius >= 0.0 && config.radius.is_finite()) {
            return Err(SceneError::Length { what: "the radius of a tip", value: config.radius });
        }
        let arm = &mut self.arms[robot.0];
        let tip = arm.tips().len();
        arm.add_tip(Sphere { centre: config.centre.into(), radius: config.radius });
        let walls = (0..self.walls.len()).map(Ground::Wall);
        let bodies = (0..self.bodies.len()).map(Ground::Body);
        let grips = &self.grips;
        self.tips.extend(walls.chain(bodies).map(|ground| {
            let inside = matches!(ground, Ground::Body(body) if holds(grips, robot.0, body));
            TipOn { inside, ..TipOn::new(robot.0, tip, ground) }
        }));
        Ok(())
    }

    /// Adds a force sensor between the flange and the tool of a robot of this scene. Fails if a number is invalid.
    pub fn add_sensor(&mut self, robot: RobotId, config: &SensorConfig) -> Result<SensorProbe, SceneError> {
        finite(&config.pose, "the place of a force sensor")?;
        let values = config.centre.iter().chain(&config.inertia);
        if !(config.mass.is_finite() && values.clone().all(|value| value.is_finite())) {
            return Err(SceneError::NotFinite { what: "the mass beyond a force sensor" });
        }
        Ok(self.arms[robot.0].add_sensor(config))
    }

    /// Adds a touch probe to the tool of a robot of this scene. Its switch sets `input` to the level `touched` while the
    /// sum of the forces on the tips of the tool is at least `threshold`, N, otherwise to the other level. Fails unless
    /// the threshold is above zero and finite.
    pub fn add_touch(
        &mut self,
        robot: RobotId,
        threshold: f64,
        touched: bool,
        input: &InputProbe,
    ) -> Result<(), SceneError> {
        if !(threshold > 0.0 && threshold.is_finite()) {
            return Err(SceneError::Threshold { threshold });
        }
        self.arms[robot.0].touches.push(Touch::new(threshold, touched, input));
        Ok(())
    }

    /// Closes a gripper on a body of this scene. The spring of the grip is relaxed when two frames coincide: `gripper`,
    /// a pose in the frame of the holder, and `held`, a pose in the frame of the body. With `None` for `held`, the
    /// spring is relaxed in the present pose of the body. Fails if the grip is not passive or a number is invalid.
    pub fn hold(
        &mut self,
        config: &GripConfig,
        holder: Holder,
        gripper: &Isometry3<f64>,
        body: BodyId,
        held: Option<&Isometry3<f64>>,
    ) -> Result<GripId, SceneError> {
        if !config.is_passive() {
            return Err(SceneError::Grip { stiffness: config.stiffness, damping: config.damping });
        }
        finite(gripper, "the place of a grip")?;
        let anchor = End::from(gripper);
        let held = match held {
            Some(held) => {
                finite(held, "the place of a grip")?;
                End::from(held)
            }
            None => {
                let (holder, body) = (self.holder(holder), self.bodies[body.0].moving());
                let point = holder.origin + holder.axes * anchor.point;
                End {
                    point: body.axes.tr_mul(&(point - body.origin)),
                    axes: body.axes.tr_mul(&(holder.axes * anchor.axes)),
                }
            }
        };
        if let Holder::Robot(RobotId(arm)) = holder {
            let of_body = |pair: &&mut TipOn| pair.arm == arm && pair.ground == Ground::Body(body.0);
            self.tips.iter_mut().filter(of_body).for_each(|pair| pair.inside = true);
        }
        self.grips.push(Some(Grip { config: *config, holder, anchor, body: body.0, held, hold: Hold::default() }));
        Ok(GripId(self.grips.len() - 1))
    }

    /// Opens a gripper. The contact of a tip that is inside the body begins only after the tip has left the body.
    pub fn release(&mut self, grip: GripId) {
        self.grips[grip.0] = None;
    }

    /// Force, N, and torque, N·m, of a grip on its body at the last step, in the axes of the world. The torque is about
    /// the grip point of the body. Zero after the release.
    pub fn grip_wrench(&self, grip: GripId) -> [f64; 6] {
        let hold = self.grips[grip.0].as_ref().map(|grip| grip.hold).unwrap_or_default();
        let (force, torque) = (hold.force, hold.torque);
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }

    /// Place and motion of a body of this scene.
    pub fn body(&self, body: BodyId) -> BodyState {
        self.bodies[body.0].state()
    }

    /// A probe of the place of a body of this scene.
    pub fn watch(&mut self, body: BodyId) -> BodyProbe {
        let probe = BodyProbe::new(self.body(body));
        self.probes.push((body.0, probe.clone()));
        probe
    }

    /// Place of the flange of a robot of this scene at the last step.
    pub fn flange(&self, robot: RobotId) -> Isometry3<f64> {
        self.arms[robot.0].place()
    }

    /// Kinetic and potential energy of all bodies, and energy of all springs in contacts and grips, J.
    pub fn energy(&self) -> f64 {
        let of_body = |body: &Body| body.kinetic_energy() - body.mass * self.gravity.dot(&body.place.origin);
        let of_pair = |pair: &CornersOn| {
            let (carrier, (surface, ground)) = (self.bodies[pair.body].moving(), self.ground(pair.ground));
            let corners = self.bodies[pair.body].corners.iter().zip(&pair.bristles);
            corners.map(|(sphere, bristle)| spring_energy(sphere, &carrier, surface, &ground, bristle)).sum::<f64>()
        };
        let of_tip = |pair: &TipOn| {
            let (surface, ground) = self.ground(pair.ground);
            let arm = &self.arms[pair.arm];
            spring_energy(&arm.tips()[pair.tip], &arm.flange, surface, &ground, &pair.bristle)
        };
        let of_grip = |grip: &Grip| {
            let holder = self.holder(grip.holder);
            let body = self.bodies[grip.body].moving();
            grip::energy(&grip.config, (&holder, &grip.anchor), (&body, &grip.held))
        };
        self.bodies.iter().map(of_body).sum::<f64>()
            + self.corners.iter().map(of_pair).sum::<f64>()
            + self.tips.iter().filter(|pair| !pair.inside).map(of_tip).sum::<f64>()
            + self.grips.iter().flatten().map(of_grip).sum::<f64>()
            + self.cutting.energy()
    }

    /// Momentum, kg·m/s, and angular momentum about the origin of the world, kg·m²/s, of all bodies.
    pub fn momentum(&self) -> (Vector3<f64>, Vector3<f64>) {
        let of_body = |body: &Body| {
            let linear = body.mass * body.velocity;
            (linear, body.place.origin.cross(&linear) + body.momentum)
        };
        let zero = (Vector3::zeros(), Vector3::zeros());
        self.bodies.iter().map(of_body).fold(zero, |sum, one| (sum.0 + one.0, sum.1 + one.1))
    }

    /// Number of parts of steps with the duration [`SHORTEST`] whose equations were not solved.
    pub fn unsolved(&self) -> u64 {
        self.unsolved.count()
    }

    /// A probe of the count of [`unsolved`](Self::unsolved) parts of steps.
    pub fn watch_unsolved(&self) -> UnsolvedProbe {
        self.unsolved.clone()
    }

    /// Time of the last step.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Sets the time of the last step to the last multiple of [`STEP`] up to `now`. The state does not change.
    pub(crate) fn begin(&mut self, now: Instant) {
        let steps = now.as_nanos() / STEP.as_nanos() as u64;
        self.now = Instant::from_nanos(steps * STEP.as_nanos() as u64);
    }

    /// Advances by one step. The caller has already moved the motors of all robots to the end of the step.
    pub fn step(&mut self) {
        self.place_due();
        self.beams.note(&self.bodies);
        self.now += STEP;
        let alone = self.bodies.is_empty() && self.cutting.is_empty();
        for arm in &mut self.arms {
            arm.follow(alone);
        }
        self.switch_grippers();
        for wall in &mut self.walls {
            if let Some(belt) = &mut wall.belt {
                let angle = belt.shaft.angle();
                wall.surface.belt = belt.way * ((angle - belt.angle) / STEP_SECONDS);
                belt.angle = angle;
            }
            if let Some(drift) = &wall.drift {
                wall.surface.belt = drift.at(self.now);
            }
        }
        self.move_bodies(0.0, 1.0, HALVINGS);
        self.push_tips();
        self.pull_grips();
        self.cutting.step(&mut self.arms);
        for arm in &mut self.arms {
            arm.finish(&self.gravity);
        }
        self.show_grippers();
        for (body, probe) in &self.probes {
            probe.show(self.bodies[*body].state());
        }
        self.beams.look(&self.bodies, self.now);
    }

    fn meet_tips(&mut self, ground: Ground) {
        for (number, arm) in self.arms.iter_mut().enumerate() {
            arm.catch_up();
            self.tips.extend((0..arm.tips().len()).map(|tip| TipOn::new(number, tip, ground)));
        }
    }

    fn ground(&self, ground: Ground) -> (&Surface, Moving) {
        match ground {
            Ground::Wall(wall) => (&self.walls[wall].surface, self.walls[wall].moving),
            Ground::Body(body) => (&self.bodies[body].surface, self.bodies[body].moving()),
        }
    }

    fn holder(&self, holder: Holder) -> Moving {
        match holder {
            Holder::Robot(robot) => self.arms[robot.0].flange,
            Holder::World => Moving::WORLD,
        }
    }
}

impl CornersOn {
    const LOOSE: [Vector3<f64>; CORNERS] = [Vector3::new(0.0, 0.0, 0.0); CORNERS];

    fn new(body: usize, ground: Ground) -> Self {
        Self { body, ground, bristles: Self::LOOSE, next: Self::LOOSE }
    }
}

impl TipOn {
    fn new(arm: usize, tip: usize, ground: Ground) -> Self {
        Self { arm, tip, ground, inside: false, bristle: Vector3::zeros(), next: Vector3::zeros() }
    }
}

/// Energy of the spring and of the bristle between a sphere and a surface, J.
fn spring_energy(sphere: &Sphere, carrier: &Moving, surface: &Surface, ground: &Moving, bristle: &Vector3<f64>) -> f64 {
    let gap = clearance(sphere, carrier, surface, ground);
    if gap >= 0.0 {
        return 0.0;
    }
    surface.material.energy(gap) + 0.5 * surface.material.stiffness * bristle.norm_squared()
}

fn parts(pose: &Isometry3<f64>) -> (Vector3<f64>, nalgebra::Matrix3<f64>) {
    (pose.translation.vector, pose.rotation.to_rotation_matrix().into_inner())
}

/// Checks that a robot with the upward direction `up` stands upright. Without gravity, every direction is upright.
fn upright(up: &Vector3<f64>, gravity: &Vector3<f64>) -> Result<(), SceneError> {
    let angle = up.angle(&-gravity);
    if angle > MOST_LEANING { Err(SceneError::Leaning { angle }) } else { Ok(()) }
}

fn passive(material: &Material) -> Result<(), SceneError> {
    let Material { stiffness, damping, friction } = *material;
    if material.is_passive() { Ok(()) } else { Err(SceneError::Surface { stiffness, damping, friction }) }
}

fn lengths(half: [f64; 3]) -> Result<(), SceneError> {
    match half.into_iter().find(|half| !(*half > 0.0 && half.is_finite())) {
        Some(half) => Err(SceneError::Length { what: "an edge", value: 2.0 * half }),
        None => Ok(()),
    }
}

fn finite(pose: &Isometry3<f64>, what: &'static str) -> Result<(), SceneError> {
    let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
    if numbers.into_iter().all(|number| number.is_finite()) { Ok(()) } else { Err(SceneError::NotFinite { what }) }
}
