//! Commands to an axis.

/// A number that is neither NaN nor infinite; nothing else reaches a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Finite(f64);

impl Finite {
    /// Zero.
    pub const ZERO: Self = Self(0.0);

    /// `None` for NaN and the infinities.
    pub fn new(value: f64) -> Option<Self> {
        value.is_finite().then_some(Self(value))
    }

    /// The number.
    pub const fn get(self) -> f64 {
        self.0
    }
}

/// What a drive is to follow during one cycle, at the motor shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setpoint {
    /// Motor position, rad. The drive closes the position loop (CSP).
    Position(Finite),
    /// Motor position, rad, and a torque, N·m, that the drive adds to what its loops ask for
    /// ([`CyclicMode::CspWithTorque`](crate::cia402::CyclicMode::CspWithTorque)).
    PositionWithTorque {
        /// Motor position, rad.
        position: Finite,
        /// The torque, N·m.
        torque: Finite,
    },
    /// Motor velocity, rad/s. The host closes the position loop (CSV).
    Velocity(Finite),
    /// Motor torque, N·m. The host closes every other loop (CST, and axis controllers by current).
    Torque(Finite),
    /// Fraction of the full pulse width, -1 to 1: the share of the supply voltage that the motor gets.
    /// The host closes every loop.
    Duty(Finite),
}

/// What one axis is asked to do in one cycle.
///
/// It is a level, not an event: the group brings the drive to it by as many transitions as that
/// takes and keeps it there, and [`AxisState`](crate::AxisState) says how far it got.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AxisCommand {
    /// No torque. A latched fault stays latched.
    #[default]
    Off,
    /// No torque, and a latched drive fault is to be cleared.
    ResetFault,
    /// Torque on, standing where the drive was when it was enabled, or where the last set-point
    /// left it. Velocity or torque zero, for drives that close only those loops.
    Stand,
    /// Torque on, homing by the method the drive was configured with. Leaving it stops homing.
    Home,
    /// Torque on, following the set-point. Only after [`Power::On`](crate::Power::On) was seen.
    Follow(Setpoint),
    /// The same, and the drive takes the next index pulse for its reference: for drives that the host
    /// homes. The counter is set there, and then the state says
    /// [`Homing::Attained`](crate::Homing::Attained).
    Seek(Setpoint),
}
