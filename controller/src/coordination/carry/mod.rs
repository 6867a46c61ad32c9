//! Two arms that hold one rigid object: the coordinator moves the object, and each arm keeps its grip.
//!
//! In each macrostep, [`Carry`] computes the pose X of the object and orders each arm the pose X · G of its grip. The
//! arms run [`Hold`]. With two arms of five axes and vertical tools, the object has four motions: x, y, z and the
//! rotation about the vertical axis ([`ObjectPath`]). [`Grips::check`] refuses a path that an arm cannot follow, or on
//! which a joint is too fast, before any motion.
//!
//! # Internal force
//! With p₁ and p₂ the forces of the two grips on the object, the sum p₁ + p₂ moves the object. Half of the difference,
//! (p₁ − p₂) / 2, is the internal force. Its component along the line between the grips strains the object and the
//! arms, and does no work on a rigid object. Sum and difference are expressed in the axes of the cell. Errors of the
//! calibration of the bases, of the kinematics, and of the position loops cause internal forces. The object and the
//! arms are stiff only along the line between the grips: across this line, a displacement turns the object. The line is
//! therefore the internal direction that is regulated.
//!
//! [`Regulation`] yields to the internal force along this line. Both arms yield by the same amount in opposite
//! directions, so that the object keeps its path.
//!
//! # Stability
//! Each arm yields to a spring between two grips that both move. The stiffness that the law meets is therefore twice the
//! stiffness of the two grips in series: 1e5 N/m for grips of 1e5 N/m each. The default compliance is stable up to
//! 34 kN/m in each servo cycle, and up to 9 kN/m once per macrostep in a whole cell ([`law`](crate::law)). Inertia and damping
//! multiplied by a factor multiply these limits by the same factor: [`Regulation::CYCLE`] uses 4. In the coordinator, an
//! answer is one macrostep older than a reading in a generator. [`Regulation::MACROSTEP`] therefore has 40 times the
//! damping.

mod path;
#[cfg(test)]
mod tests;

use std::f64::consts::PI;
use std::time::Duration;

use can::counted;
use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

use super::{Coordinator, NextOrders, Orders};
use crate::generator::{A, Answer, EffectorImage, Generator, GeneratorError, Next, Pose, Sample, Setpoint, V};
use crate::law::{Compliance, Direction, ForceTask, TaskAxes};
use crate::path::PoseState;
use crate::robot::{Arm, Axes, KinematicsError};
use crate::sensor::ForceReading;
pub use path::{ObjectLimits, ObjectPath};

/// Time between two poses of a check, s.
const CHECKED_EVERY: f64 = 0.02;

/// Reasons why an object cannot be carried. Members count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum CarryError {
    #[error("a path of {}: give two at the least", counted(*.given, "place"))]
    Places { given: usize },
    #[error("leg {number} of the path has no length, or a coordinate that is not finite")]
    Leg { number: usize },
    #[error("the {limit} of the object is {value}, it must be above 0 and finite")]
    Limit { limit: &'static str, value: f64 },
    /// An arm cannot take the pose of its grip. The position of the grip is in the frame of the cell, m.
    #[error(
        "the grip of member {member} does not reach ({:.3}, {:.3}, {:.3}) m of the cell at {time:.2} s of the path: {cause}",
        .at[0], .at[1], .at[2]
    )]
    Unreachable { member: usize, time: f64, at: [f64; 3], cause: KinematicsError },
    /// A joint would move faster than its limit, rad/s (m/s for a linear joint). Axes count from 0.
    #[error(
        "joint {axis} of member {member} would move at {velocity:.3} rad/s (m/s) at {time:.2} s of the path, at most {limit:.3}: \
         carry the object more slowly, or farther from the axes of the arm"
    )]
    TooFast { member: usize, axis: usize, time: f64, velocity: f64, limit: f64 },
}

/// Geometry of two arms and of the object that they hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grips {
    /// Base of each arm in the frame of the cell.
    pub cell_from_base: [Pose; 2],
    /// Tool of each arm in the frame of the object.
    pub object_from_tool: [Pose; 2],
}

impl Grips {
    /// Motion of the tool of an arm in its base frame, for a motion of the object in the frame of the cell.
    pub fn tool(&self, member: usize, object: &PoseState) -> PoseState {
        let PoseState { pose, linear, angular, linear_acceleration, angular_acceleration } = *object;
        let grip = self.object_from_tool[member];
        let lever = pose.rotation * grip.translation.vector;
        let base_from_cell = self.cell_from_base[member].inverse();
        let turn = base_from_cell.rotation;
        let centripetal = angular.cross(&angular.cross(&lever));
        PoseState {
            pose: base_from_cell * pose * grip,
            linear: turn * (linear + angular.cross(&lever)),
            angular: turn * angular,
            linear_acceleration: turn * (linear_acceleration + angular_acceleration.cross(&lever) + centripetal),
            angular_acceleration: turn * angular_acceleration,
        }
    }

    /// Pose of the object in the frame of the cell, from the poses of both tools in their base frames. Each tool gives an
    /// estimate of the pose. The origin is the mean of both estimates, and the orientation is that of the first tool.
    pub fn object(&self, tools: [&Pose; 2]) -> Pose {
        let of = |member: usize| self.cell_from_base[member] * tools[member] * self.object_from_tool[member].inverse();
        let (first, second) = (of(0), of(1));
        let mean = (first.translation.vector + second.translation.vector) / 2.0;
        Pose::from_parts(mean.into(), first.rotation)
    }

    /// Direction from the first grip to the second in the frame of the cell, for a pose of the object.
    pub fn line(&self, object: &Pose) -> Vector3<f64> {
        let [first, second] = self.object_from_tool.map(|grip| grip.translation.vector);
        object.rotation * (second - first).normalize()
    }

    /// Internal force in the frame of the cell, N, by the forces on both tools in their base frames.
    pub fn internal(&self, on_tools: [Vector3<f64>; 2]) -> Vector3<f64> {
        let [first, second] = self.on_object(on_tools);
        (first - second) / 2.0
    }

    /// Forces of both grips on the object in the frame of the cell, N, by the forces on both tools in their base frames.
    pub fn on_object(&self, on_tools: [Vector3<f64>; 2]) -> [Vector3<f64>; 2] {
        let [first, second] = self.cell_from_base.map(|it| it.rotation);
        [-(first * on_tools[0]), -(second * on_tools[1])]
    }

    /// Checks that both arms can follow the path, and that no joint is faster than its limit. The postures at the start of
    /// the path are near the joint positions `near`. `fastest`: greatest speeds of the joints of each arm, rad/s (m/s for a
    /// linear joint). Speeds are means over 20 ms. Accelerations are not checked.
    pub fn check(
        &self,
        path: &ObjectPath,
        arms: [&Arm; 2],
        near: [Axes; 2],
        fastest: [Axes; 2],
    ) -> Result<(), CarryError> {
        let steps = (path.duration() / CHECKED_EVERY).ceil() as u32;
        for (member, (arm, mut near)) in arms.into_iter().zip(near).enumerate() {
            for step in 0..=steps {
                let time = f64::from(step) * CHECKED_EVERY;
                let object = path.at(time);
                let pose = self.tool(member, &object).pose;
                let reached = arm.inverse(&pose, &near).and_then(|joints| arm.motors(&joints).map(|_| joints));
                let last = near;
                near = reached.map_err(|cause| {
                    let at = (object.pose * self.object_from_tool[member]).translation.vector.into();
                    CarryError::Unreachable { member, time, at, cause }
                })?;
                for axis in (0..arm.axes()).filter(|_| step > 0) {
                    let velocity = (near[axis] - last[axis]).abs() / CHECKED_EVERY;
                    let limit = fastest[member][axis];
                    let within = velocity <= limit;
                    if !within {
                        return Err(CarryError::TooFast { member, axis, time, velocity, limit });
                    }
                }
            }
        }
        Ok(())
    }
}

/// How two arms yield to the internal force along the line between their grips.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Regulation {
    /// Not at all: the arms keep their positions.
    #[default]
    None,
    /// By the coordinator, once per macrostep, from the forces in the answers of both arms.
    Macrostep(Compliance),
    /// By the force law of each arm, in each servo cycle, from the force at its own wrist. The desired force of each arm
    /// is the mean of the grip forces of both arms in their last answers: the part that moves the object. Both robots
    /// need a force law in the cell file.
    Cycle(Compliance),
}

impl Regulation {
    /// Regulation in each servo cycle of 2 ms, for two grips of 1e5 N/m: 80 kg and 800 N·s/m.
    pub const CYCLE: Self = Self::Cycle(Compliance { inertia: 80.0, reciprocal_damping: 1.25e-3 });

    /// Regulation once per macrostep of 20 ms, for two grips of 1e5 N/m: 200 kg and 8,000 N·s/m.
    pub const MACROSTEP: Self = Self::Macrostep(Compliance { inertia: 200.0, reciprocal_damping: 1.25e-4 });
}

/// Order to an arm. All vectors are in the axes of the base of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripOrder {
    /// Pose of the tool at the start of the path.
    pub begin: Pose,
    /// Motion of the tool.
    pub tool: PoseState,
    /// What the force law of the arm does, if it regulates.
    pub law: Option<GripLaw>,
}

/// Order to the force law of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripLaw {
    /// Direction from the first grip to the second.
    pub line: Vector3<f64>,
    /// Desired force of the tool on the object along this direction, N.
    pub force: f64,
    /// Inertia and damping along this direction.
    pub compliance: Compliance,
}

impl GripLaw {
    /// The behaviour of the law: contact along the line, no other motion beside the path.
    pub fn task(&self) -> ForceTask {
        let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
        let turn = UnitQuaternion::rotation_between(&Vector3::x(), &self.line);
        // Half a turn has no least rotation.
        let turn = turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI));
        task.rotation = turn.scaled_axis();
        task.directions[0] = Direction::Contact { force: self.force, compliance: self.compliance };
        task
    }
}

/// Answer of an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripForce {
    /// Force of the object on the tool, N, in the axes of the base of the arm.
    pub on_tool: Vector3<f64>,
}

/// The coordinator of two arms that hold an object.
#[derive(Clone, Debug)]
pub struct Carry {
    grips: Grips,
    path: ObjectPath,
    regulation: Regulation,
    /// Greatest internal force, N.
    limit: f64,
    /// Duration of a macrostep, s.
    macrostep: f64,
}

/// Memory of [`Carry`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Carried {
    /// Number of the macrostep.
    pub step: u32,
    /// Internal force along the line between the grips, N: positive presses the object.
    pub pressed: f64,
    /// Mean force of the grips on the object along this line, N.
    pub mean: f64,
    /// Displacement of each grip along this line from its place on the object, m: positive outward.
    pub opening: f64,
    /// Velocity of this displacement, m/s.
    pub rate: f64,
}

/// Greatest displacement of each grip by the regulation of each macrostep, m.
const FARTHEST: f64 = 5e-3;

impl Carry {
    /// Error of a motion whose internal force exceeds the limit of the coordinator.
    pub const TOO_GREAT: GeneratorError = GeneratorError::User(30);

    /// Error of a motion in which the regulation of each macrostep has displaced the grips by more than 5 mm.
    pub const TOO_FAR: GeneratorError = GeneratorError::User(31);

    /// Carries the object along a path. An internal force above `limit`, N, in any direction stops both arms
    /// ([`Self::TOO_GREAT`]). A limit that is not finite stops them at the first step.
    pub fn new(grips: Grips, path: ObjectPath, regulation: Regulation, limit: f64) -> Self {
        Self { grips, path, regulation, limit, macrostep: 0.0 }
    }

    fn orders(&self, memory: Carried, change: f64) -> NextOrders<GripOrder, Carried, 2> {
        let object = self.path.at(f64::from(memory.step) * self.macrostep);
        let line = self.grips.line(&object.pose);
        let begin = self.path.at(0.0);
        let order = |member: usize| {
            let mut tool = self.grips.tool(member, &object);
            let line = self.grips.cell_from_base[member].rotation.inverse() * line;
            let outward = line * [-1.0, 1.0][member];
            tool.pose.translation.vector += outward * memory.opening;
            tool.linear += outward * memory.rate;
            tool.linear_acceleration += outward * change;
            let law = match self.regulation {
                Regulation::Cycle(compliance) => Some(GripLaw { line, force: memory.mean, compliance }),
                Regulation::None | Regulation::Macrostep(_) => None,
            };
            GripOrder { begin: self.grips.tool(member, &begin).pose, tool, law }
        };
        NextOrders::new([order(0), order(1)], memory)
    }
}

impl Coordinator<2> for Carry {
    type Order = GripOrder;
    type Answer = GripForce;
    type Sensors = ();
    type Out = ();
    type Memory = Carried;

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(self.orders(Carried::default(), 0.0))
    }

    fn terminal(&self, memory: &Carried, _: &[Sample<GripForce>; 2], (): &()) -> bool {
        f64::from(memory.step) * self.macrostep >= self.path.duration()
    }

    fn next_step(
        &self,
        memory: &Carried,
        forces: &[Sample<GripForce>; 2],
        (): &(),
    ) -> Result<Orders<Self, 2>, GeneratorError> {
        let on_tools = forces.each_ref().map(|answer| answer.value.on_tool);
        let internal = self.grips.internal(on_tools);
        let is_safe = self.limit.is_finite() && internal.norm() <= self.limit;
        if !is_safe {
            return Err(Self::TOO_GREAT);
        }
        let object = self.path.at(f64::from(memory.step) * self.macrostep);
        let line = self.grips.line(&object.pose);
        let [first, second] = self.grips.on_object(on_tools);
        let (pressed, mean) = (internal.dot(&line), 0.5 * (first + second).dot(&line));
        let rate = match self.regulation {
            Regulation::None | Regulation::Cycle(_) => 0.0,
            Regulation::Macrostep(Compliance { inertia, reciprocal_damping: beta }) => {
                let t = self.macrostep;
                (beta * pressed * t + beta * inertia * memory.rate) / (t + beta * inertia)
            }
        };
        let opening = memory.opening + (memory.rate + rate) / 2.0 * self.macrostep;
        if opening.abs() > FARTHEST {
            return Err(Self::TOO_FAR);
        }
        let change = (rate - memory.rate) / self.macrostep;
        Ok(self.orders(Carried { step: memory.step + 1, pressed, mean, opening, rate }, change))
    }
}

/// The generator of an arm that holds an object. Class 7: reads its effector, its force sensor and the order of [`Carry`].
///
/// The regulation of an earlier motion may have left the tool beside its place on the object. The arm keeps this
/// displacement. The memory is the displacement in the axes of the tool, m, once the first order has come.
#[derive(Clone, Copy, Debug)]
pub struct Hold {
    /// Greatest age of a sample of the force sensor. An older sample stops both arms.
    stale: Duration,
    /// Pose of the tool before the motion.
    start: Pose,
}

/// Greatest distance between the tool and its place at the start of the path, m, and greatest angle, rad.
const NEAR: (f64, f64) = (5e-3, 1e-3);

impl Hold {
    /// An arm whose force sensor gives a sample at least every `stale`.
    pub fn new(stale: Duration) -> Self {
        Self { stale, start: Pose::identity() }
    }

    fn displacement(&self, begin: &Pose) -> Result<Vector3<f64>, GeneratorError> {
        let away = self.start.translation.vector - begin.translation.vector;
        let (distance, angle) = (away.norm(), self.start.rotation.angle_to(&begin.rotation));
        if distance > NEAR.0 || angle > NEAR.1 {
            return Err(GeneratorError::NotAtStart { distance, angle });
        }
        Ok(begin.rotation.inverse() * away)
    }
}

impl Generator for Hold {
    type First = EffectorImage;
    type Every = (EffectorImage, V<ForceReading>, A<GripOrder>);
    type Out = Answer<GripForce>;
    type Memory = Option<Vector3<f64>>;

    fn first_step(&mut self, e: &EffectorImage, _: Duration) -> Result<Next<Self::Memory, Self::Out>, GeneratorError> {
        self.start = e.commanded.pose;
        Ok(Next::remember(None).with(Answer(GripForce::default())))
    }

    fn terminal(&self, _: &Self::Memory, _: &Self::Every) -> bool {
        false // the coordinator ends the motion
    }

    fn next_step(
        &self,
        displacement: &Self::Memory,
        (e, v, a0): &Self::Every,
    ) -> Result<Next<Self::Memory, Self::Out>, GeneratorError> {
        let GripOrder { begin, mut tool, law } = a0.0.sample().ok_or(GeneratorError::NothingReceived)?.value;
        let displacement = displacement.map_or_else(|| self.displacement(&begin), Ok)?;
        tool.pose.translation.vector += tool.pose.rotation * displacement;
        let contact = v.0.younger_than(self.stale)?.in_tool()?;
        let on_tool = e.measured.pose.rotation * contact.force;
        let next = Next::command(Setpoint::Tool(tool), Some(displacement)).with(Answer(GripForce { on_tool }));
        Ok(match law {
            Some(law) => next.under(law.task()),
            None => next,
        })
    }
}
