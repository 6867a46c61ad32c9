//! Behaviour of the directions of a task frame, and its form as parameters of a macrostep.

use nalgebra::{UnitQuaternion, Vector3};
use servo::{LAW_PARAMETERS, LawFault, LawParameters};

use super::rate;

/// Parameters of one direction.
const PER_DIRECTION: usize = 5;

/// Parameters behind those of the six directions: the guard, and the axes of the task frame.
const GUARD: usize = 6 * PER_DIRECTION;
const AXES: usize = GUARD + 3;

const _: () = assert!(AXES + 4 <= LAW_PARAMETERS);

/// Inertia and damping of a compliant direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compliance {
    /// Virtual inertia, kg or kg·m².
    pub inertia: f64,
    /// Reciprocal of the virtual damper, m/(N·s) or rad/(N·m·s).
    pub reciprocal_damping: f64,
}

impl Compliance {
    /// The default along an axis: 20 kg and 0.005 m/(N·s).
    pub const LINEAR: Self = Self { inertia: 20.0, reciprocal_damping: 0.005 };

    /// The default about an axis: 0.5 kg·m² and 0.1 rad/(N·m·s).
    pub const ROTARY: Self = Self { inertia: 0.5, reciprocal_damping: 0.1 };
}

/// Behaviour of one direction of the task frame. Velocities are in m/s or rad/s, forces in N or N·m.
///
/// A speed override and a pause slow the motion of `Unguarded`, `Guarded` and `Contact` in free space
/// ([`velocity_at_rate`](super::velocity_at_rate)). They slow no motion by which a direction yields, and do not change
/// the force in contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Direction {
    /// The direction moves at the velocity, whatever the force is.
    Unguarded {
        /// Velocity beside the planned path.
        velocity: f64,
    },
    /// The direction moves at the velocity and yields to forces. In contact, the force is velocity / reciprocal damping.
    Guarded {
        /// Velocity beside the planned path.
        velocity: f64,
        /// Inertia and damping.
        compliance: Compliance,
    },
    /// The direction moves until the tool applies the force to its environment. In free space, the velocity is
    /// force · reciprocal damping.
    Contact {
        /// Force of the tool on its environment.
        force: f64,
        /// Inertia and damping.
        compliance: Compliance,
    },
    /// The direction yields like a spring, and returns to the planned path without force. A task with such a direction
    /// keeps its displacement for the next instruction under the same task: the next path begins at the end of the last
    /// path, and the spring stays tensioned.
    Admittance {
        /// Stiffness of the spring, N/m or N·m/rad.
        stiffness: f64,
        /// Inertia and damping.
        compliance: Compliance,
    },
}

impl Direction {
    /// A direction without motion beside the planned path.
    pub const HELD: Self = Self::Unguarded { velocity: 0.0 };

    pub(super) fn gains(self) -> Gains {
        let none = Compliance { inertia: 0.0, reciprocal_damping: 0.0 };
        let (compliance, force, velocity, stiffness) = match self {
            Self::Unguarded { velocity } => (none, 0.0, velocity, 0.0),
            Self::Guarded { velocity, compliance } => (compliance, 0.0, velocity, 0.0),
            Self::Contact { force, compliance } => (compliance, force, 0.0, 0.0),
            Self::Admittance { stiffness, compliance } => (compliance, 0.0, 0.0, stiffness),
        };
        Gains { compliance, force, velocity, stiffness }
    }
}

/// Numbers of the law in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gains {
    compliance: Compliance,
    force: f64,
    velocity: f64,
    stiffness: f64,
}

impl Gains {
    /// Velocity after a period of `dt` seconds, from the velocity of the last period, the displacement and the force, at
    /// a rate of motion time.
    pub(super) fn velocity(&self, last: f64, displacement: f64, force: f64, rate: f64, dt: f64) -> f64 {
        let Compliance { inertia, reciprocal_damping: beta } = self.compliance;
        let drive = beta * (self.force - force - self.stiffness * displacement) + self.velocity;
        let approach = beta * self.force + self.velocity;
        let drive = drive - rate::withheld(approach, drive - approach, -beta * force, rate);
        (drive * dt + beta * inertia * last) / (dt + beta * inertia + beta * self.stiffness * dt * dt)
    }
}

/// End of a motion at a touch. The touch counts if force or torque of the contact exceeds its threshold in a number of
/// samples in a row.
///
/// Weight and inertia of the declared tool are no contact ([`SensorMotion::commanded`](crate::force::SensorMotion::commanded)).
/// The thresholds must exceed the noise of the sensor, and what the compensation leaves: the forces of vibrations, and the
/// mass behind the sensor times the greatest jerk times the error of the lag. For 2 kg on an emulated IRb-6 at 5.5 m/s², the
/// rest is 2.7 N, in place of 11 N without compensation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guard {
    /// Threshold of the absolute value of the force, N.
    pub force: f64,
    /// Threshold of the absolute value of the torque about the origin of the task frame, N·m.
    pub torque: f64,
    /// Number of samples, 1 to 255.
    pub samples: u8,
}

/// Axes of the task frame. Its origin is that of the tool.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum TaskAxes {
    /// The axes turn with the tool.
    #[default]
    Tool,
    /// The axes stay parallel to those of the base.
    Base,
}

/// Behaviour of an arm under [`PositionForce`](super::PositionForce) during a macrostep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceTask {
    /// Motion along x, y, z and about x, y, z of the task frame.
    pub directions: [Direction; 6],
    /// The frame that `rotation` refers to.
    pub axes: TaskAxes,
    /// Orientation of the task frame in these axes, as a rotation vector, rad.
    pub rotation: Vector3<f64>,
    /// End of the motion at a touch, if any.
    pub guard: Option<Guard>,
}

impl Default for ForceTask {
    /// All directions held, in the axes of the tool, without guard.
    fn default() -> Self {
        Self { directions: [Direction::HELD; 6], axes: TaskAxes::Tool, rotation: Vector3::zeros(), guard: None }
    }
}

impl From<ForceTask> for LawParameters {
    fn from(task: ForceTask) -> Self {
        let mut parameters = Self::default();
        let values = &mut parameters.0;
        for (direction, values) in task.directions.iter().zip(values.chunks_exact_mut(PER_DIRECTION)) {
            let Gains { compliance, force, velocity, stiffness } = direction.gains();
            values.copy_from_slice(&[compliance.inertia, compliance.reciprocal_damping, force, velocity, stiffness]);
        }
        if let Some(Guard { force, torque, samples }) = task.guard {
            values[GUARD..AXES].copy_from_slice(&[force, torque, f64::from(samples)]);
        }
        values[AXES] = if task.axes == TaskAxes::Base { 1.0 } else { 0.0 };
        values[AXES + 1..AXES + 4].copy_from_slice(task.rotation.as_slice());
        parameters
    }
}

/// A task as the law reads it from the parameters of a macrostep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Behaviour {
    pub(super) gains: [Gains; 6],
    pub(super) guard: Option<Guard>,
    pub(super) frame: Frame,
}

/// Orientation of the task frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Frame {
    axes: TaskAxes,
    rotation: UnitQuaternion<f64>,
}

impl Frame {
    /// Rotation from the axes of the task frame to those of the base.
    pub(super) fn base_from_task(&self, base_from_tool: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self.axes {
            TaskAxes::Tool => base_from_tool * self.rotation,
            TaskAxes::Base => self.rotation,
        }
    }
}

impl Behaviour {
    /// Whether a direction has a spring, whose force depends on the displacement from the path.
    pub(super) fn has_spring(&self) -> bool {
        self.gains.iter().any(|gains| gains.stiffness > 0.0)
    }

    /// Reads parameters, all of which are finite. Names the first parameter that is out of its range.
    pub(super) fn read(parameters: &LawParameters) -> Result<Self, LawFault> {
        let values = &parameters.0;
        let refused = |index: usize| LawFault::Parameter { index: index as u8, value: values[index] };
        let gains = std::array::from_fn(|direction| {
            let at = PER_DIRECTION * direction;
            Gains {
                compliance: Compliance { inertia: values[at], reciprocal_damping: values[at + 1] },
                force: values[at + 2],
                velocity: values[at + 3],
                stiffness: values[at + 4],
            }
        });
        // Inertia, reciprocal damping and stiffness are not negative. Without damping, no force has an effect.
        for direction in 0..6 {
            let at = PER_DIRECTION * direction;
            if let Some(index) = [at, at + 1, at + 4].into_iter().find(|&index| values[index] < 0.0) {
                return Err(refused(index));
            }
            if let Some(index) = [at, at + 2, at + 4].into_iter().find(|&index| values[index] != 0.0)
                && values[at + 1] == 0.0
            {
                return Err(refused(index));
            }
        }
        let [force, torque, samples] = [values[GUARD], values[GUARD + 1], values[GUARD + 2]];
        let guard = (samples != 0.0).then_some(Guard { force, torque, samples: samples as u8 });
        if guard.is_some_and(|guard| f64::from(guard.samples) != samples) {
            return Err(refused(GUARD + 2));
        }
        if let Some(index) = [GUARD, GUARD + 1].into_iter().find(|&index| guard.is_some() == (values[index] <= 0.0)) {
            return Err(refused(index));
        }
        let axes = match values[AXES] {
            0.0 => TaskAxes::Tool,
            1.0 => TaskAxes::Base,
            _ => return Err(refused(AXES)),
        };
        let rotation = Vector3::from_column_slice(&values[AXES + 1..AXES + 4]);
        Ok(Self { gains, guard, frame: Frame { axes, rotation: UnitQuaternion::from_scaled_axis(rotation) } })
    }
}
