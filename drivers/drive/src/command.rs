//! Commands to an axis.

/// A finite number. Only finite numbers reach a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Finite(f64);

impl Finite {
    /// Zero.
    pub const ZERO: Self = Self(0.0);

    /// `None` for NaN and infinities.
    pub fn new(value: f64) -> Option<Self> {
        value.is_finite().then_some(Self(value))
    }

    /// The number.
    pub const fn get(self) -> f64 {
        self.0
    }
}

/// Set-point of a drive for one cycle, at the motor shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Setpoint {
    /// Motor position, rad. The drive closes the position loop (CSP).
    Position(Finite),
    /// Motor position, rad, and a torque, N·m, that the drive adds to the output of its loops
    /// ([`CyclicMode::CspWithTorque`](crate::cia402::CyclicMode::CspWithTorque)).
    PositionWithTorque { position: Finite, torque: Finite },
    /// Motor velocity, rad/s. The host closes the position loop (CSV).
    Velocity(Finite),
    /// Motor torque, N·m. The host closes every other loop (CST, and axis controllers by current).
    Torque(Finite),
    /// Fraction of the full pulse width, -1 to 1: the motor voltage as a fraction of the supply voltage. The host
    /// closes every loop.
    Duty(Finite),
}

/// Commanded state of one axis for one cycle.
///
/// A command is a level, not an event. The group brings the drive to the commanded state by as many transitions as
/// necessary, and keeps the drive there. [`AxisState`](crate::AxisState) shows the progress.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AxisCommand {
    /// No torque. A latched fault stays latched.
    #[default]
    Off,
    /// No torque, and reset of a latched drive fault.
    ResetFault,
    /// Torque on, holding the position at which the drive was enabled or the last set-point. In a velocity or torque
    /// mode, velocity or torque zero.
    Stand,
    /// Torque on, homing by the configured method. Any other command stops homing.
    Home,
    /// Torque on, following the set-point. Only after [`Power::On`](crate::Power::On) was seen.
    Follow(Setpoint),
    /// Like `Follow`, and the drive sets its counter at the next index pulse, for axes homed by the host. The state
    /// then shows [`Homing::Attained`](crate::Homing::Attained).
    Seek(Setpoint),
}
