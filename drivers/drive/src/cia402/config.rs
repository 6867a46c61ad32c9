//! What a drive group and its axes are configured to, and what is refused before a frame is sent.

use std::fmt;
use std::time::Duration;

use canopen::cia402::ModeOfOperation;
use canopen::sdo::CAPACITY;
use canopen::{NodeId, Object};
use thiserror::Error;

use super::reserved::reserved;
use crate::Scale;
use crate::scale::rpm_magnitude;

/// How many of its own periods a heartbeat may be late before it counts as lost, in both directions.
pub(super) const HEARTBEATS_TO_LOSE: u32 = 3;

/// Least time of listening for another controller, whose periods are not known.
const LISTENING_AT_LEAST: Duration = Duration::from_secs(1);

/// What the drives of a group have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupConfig {
    /// The SYNC period, which is the servo period. Whole milliseconds up to 100 are what an EPOS4 takes.
    pub period: Duration,
    /// Missing answers in a row that are ridden through; one more is [`Fault::Silent`](crate::Fault::Silent).
    /// As many set-points in a row may be refused by the port; one more is [`Fault::NotSent`](crate::Fault::NotSent).
    pub tolerated_missing: u32,
    /// Period of the drives' heartbeats and of ours, whole milliseconds. Three periods of silence are a
    /// loss, here and in the drives (object 0x1016).
    pub heartbeat_period: Duration,
    /// The node-ID under which the host sends its heartbeat.
    pub host_node: NodeId,
    /// How long an answer to a service request may take.
    pub sdo_timeout: Duration,
    /// How often a service request is repeated before it counts as timed out.
    pub sdo_retries: u8,
    /// How long a node may take to boot, and again to become operational, less a heartbeat period.
    pub boot_timeout: Duration,
    /// How long a drive may take to reach an asked power state or mode of operation.
    pub transition_timeout: Duration,
}

/// One drive and its motor.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisConfig {
    /// Its node-ID.
    pub node: NodeId,
    /// What object 0x1018 must say.
    pub identity: Identity,
    /// The cyclic mode of operation it works in.
    pub mode: CyclicMode,
    /// Between motor positions and its counts.
    pub scale: Scale,
    /// Rated torque of the motor, N·m: object 0x6076, whose thousandths 0x6071 and 0x6077 count.
    pub rated_torque: f64,
    /// How it finds its reference.
    pub homing: HomingConfig,
    /// Plausibility bound, rad/s: a faster change of position is a counter that jumped. No motor turns so fast, not even
    /// in a runaway loop.
    pub plausible_velocity: f64,
    /// Following error at which the drive faults by itself, rad of motor rotation (object 0x6065).
    pub following_error: f64,
    /// Deceleration of a quick stop, rad/s² (object 0x6085).
    pub quick_stop_deceleration: f64,
    /// The objects of its device configuration file, in order, downloaded before `parameters`. None of them may be
    /// [`reserved`](super::reserved).
    pub configuration: Vec<Setting>,
    /// Further objects to download, in order, before all that this driver sets itself. None of them may be
    /// [`reserved`](super::reserved).
    pub parameters: Vec<Parameter>,
}

/// Who a drive must be (object 0x1018); `None` accepts any.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Vendor-ID; 0x0000_00FB is maxon.
    pub vendor: u32,
    /// Product code.
    pub product: Option<u32>,
    /// Revision number.
    pub revision: Option<u32>,
}

/// A cyclic synchronous mode of operation: one set-point per SYNC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CyclicMode {
    /// The drive closes the position loop.
    Csp,
    /// The same, and it adds a torque that it gets with each position (object 0x60B2) to what its loops ask for:
    /// torque feed-forward in CiA 402-2, mapped beside the position in an EPOS4's own default PDO of the mode.
    CspWithTorque,
    /// The drive closes the velocity loop.
    Csv,
    /// The drive closes the torque loop.
    ///
    /// No limit of speed is set in it. Object 0x6080 is the most that the motor stands (CiA 402-2), from its data sheet;
    /// whether a drive heeds it in this mode is its maker's choice (Nanotec's PD4-E lists it for the mode, Lenze's i700
    /// has 0x2946 instead, and of maxon's nothing is known here). The host sees how fast the motor is, and stops it.
    Cst,
}

/// How a drive searches for its reference (mode of operation HM).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingConfig {
    /// Homing method, in the drive's own sense of direction (object 0x6098).
    pub method: i8,
    /// Speed while searching for a switch or stop, rad/s (object 0x6099:1).
    pub search_speed: f64,
    /// Speed while searching for the zero, rad/s (object 0x6099:2).
    pub zero_speed: f64,
    /// Acceleration, rad/s² (object 0x609A).
    pub acceleration: f64,
}

/// A value for one object of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Object index.
    pub index: u16,
    /// Sub-index.
    pub subindex: u8,
    /// The value; of a signed object its two's complement, cut to `size`.
    pub value: u32,
    /// Bytes of the object: 1, 2 or 4.
    pub size: u8,
}

/// A value of any length for one object of a drive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Object index.
    pub index: u16,
    /// Sub-index.
    pub subindex: u8,
    /// The value as it goes over the bus, up to [`CAPACITY`] bytes.
    pub data: Vec<u8>,
    /// Whether it can be read back, and is.
    pub readable: bool,
}

impl Setting {
    pub(super) fn object(&self) -> Object {
        Object::new(self.index, self.subindex)
    }
}

impl Parameter {
    pub(super) fn object(&self) -> Object {
        Object::new(self.index, self.subindex)
    }
}

/// Why a group cannot be configured so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ConfigError {
    /// No axis at all, or more than node-IDs.
    #[error("a group has 1 to 126 axes, not {0}")]
    Axes(usize),
    /// Two nodes of one bus share a node-ID.
    #[error("node {0} occurs twice")]
    DuplicateNode(u8),
    /// Object 0x60C2 cannot say this period exactly.
    #[error("a period of {0:?} is not a count of up to 255 times a power of ten of a second")]
    Period(Duration),
    /// Objects 0x1016 and 0x1017 cannot say this period, or the watch over it.
    #[error("a heartbeat period of {0:?} is not 1 to 21845 whole milliseconds")]
    HeartbeatPeriod(Duration),
    /// A setting that cannot be, or must not be, written.
    #[error("node {node}: {index:#06x}:{subindex:02x} cannot be configured: {why}")]
    Setting {
        /// Node-ID.
        node: u8,
        /// Object index.
        index: u16,
        /// Sub-index.
        subindex: u8,
        /// Why.
        why: &'static str,
    },
    /// A quantity of an axis that is zero, negative, not finite, or beyond what the drive can hold.
    #[error("node {node}: {quantity} is out of range")]
    OutOfRange {
        /// Node-ID.
        node: u8,
        /// Which quantity.
        quantity: Quantity,
    },
}

/// A quantity of an axis that its drive has in a unit and a number of bits of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// [`AxisConfig::rated_torque`].
    RatedTorque,
    /// [`AxisConfig::plausible_velocity`].
    PlausibleVelocity,
    /// [`Parameter::size`].
    ParameterSize,
    /// [`AxisConfig::following_error`].
    FollowingError,
    /// [`AxisConfig::quick_stop_deceleration`].
    QuickStopDeceleration,
    /// [`HomingConfig::search_speed`].
    SearchSpeed,
    /// [`HomingConfig::zero_speed`].
    ZeroSpeed,
    /// [`HomingConfig::acceleration`].
    HomingAcceleration,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::RatedTorque => "rated torque",
            Self::PlausibleVelocity => "plausible velocity",
            Self::ParameterSize => "parameter size",
            Self::FollowingError => "following error",
            Self::QuickStopDeceleration => "quick stop deceleration",
            Self::SearchSpeed => "homing search speed",
            Self::ZeroSpeed => "homing zero speed",
            Self::HomingAcceleration => "homing acceleration",
        })
    }
}

impl CyclicMode {
    pub(super) fn of_operation(self) -> ModeOfOperation {
        match self {
            Self::Csp | Self::CspWithTorque => ModeOfOperation::CyclicSynchronousPosition,
            Self::Csv => ModeOfOperation::CyclicSynchronousVelocity,
            Self::Cst => ModeOfOperation::CyclicSynchronousTorque,
        }
    }
}

impl GroupConfig {
    /// Object 0x60C2: value and power of ten, s. Milliseconds if they are whole, else as coarse as
    /// is exact.
    pub(super) fn interpolation_period(&self) -> Result<(u8, i8), ConfigError> {
        let nanos = self.period.as_nanos();
        [(-3, 1_000_000), (-4, 100_000), (-5, 10_000), (-6, 1_000)]
            .into_iter()
            .filter(|(_, unit)| nanos > 0 && nanos.is_multiple_of(*unit))
            .find_map(|(exponent, unit)| Some((u8::try_from(nanos / unit).ok()?, exponent)))
            .ok_or(ConfigError::Period(self.period))
    }

    /// Milliseconds between heartbeats (object 0x1017) and until one is lost (object 0x1016).
    pub(super) fn heartbeat_times(&self) -> Result<(u16, u16), ConfigError> {
        let error = ConfigError::HeartbeatPeriod(self.heartbeat_period);
        let nanos = self.heartbeat_period.as_nanos();
        let period = u16::try_from(nanos / 1_000_000).map_err(|_| error)?;
        let lost = period.checked_mul(HEARTBEATS_TO_LOSE as u16).ok_or(error)?;
        if period == 0 || !nanos.is_multiple_of(1_000_000) {
            Err(error)
        } else {
            Ok((period, lost))
        }
    }

    /// How long the bus is listened to before the first frame is sent: three periods of the heartbeat and of SYNC, and a
    /// second at least, since the other controller may have longer periods. A controller of the same periods that is
    /// silent for that long has lost its drives, which have stopped by themselves.
    pub fn listening(&self) -> Duration {
        let periods = self.heartbeat_period.max(self.period) * HEARTBEATS_TO_LOSE;
        periods.max(LISTENING_AT_LEAST)
    }

    /// How long a heartbeat may stay away.
    pub(super) fn heartbeat_lost_after(&self) -> Duration {
        self.heartbeat_period * HEARTBEATS_TO_LOSE
    }
}

/// An axis's quantities in the drive's units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DriveUnits {
    /// Increments.
    pub(super) following_error: u32,
    /// rpm/s.
    pub(super) quick_stop_deceleration: u32,
    /// rpm.
    pub(super) search_speed: u32,
    /// rpm.
    pub(super) zero_speed: u32,
    /// rpm/s.
    pub(super) homing_acceleration: u32,
}

impl AxisConfig {
    /// Refuses what cannot or must not be written by a setting or a parameter.
    fn check_writes(&self) -> Result<(), ConfigError> {
        let refusal = |object: Object, why| ConfigError::Setting {
            node: self.node.raw(),
            index: object.index,
            subindex: object.subindex,
            why,
        };
        let settings = self.configuration.iter().map(Setting::object);
        let mut objects = settings.chain(self.parameters.iter().map(Parameter::object));
        if let Some(error) = objects.find_map(|object| {
            let found = reserved(self.identity.vendor, object.index, object.subindex)?;
            Some(refusal(object, found.why()))
        }) {
            return Err(error);
        }
        let mut settings = self.configuration.iter();
        match settings.find(|setting| setting.data.len() > CAPACITY) {
            Some(long) => Err(refusal(long.object(), "256 bytes at most are transferred")),
            None => Ok(()),
        }
    }

    pub(super) fn drive_units(&self) -> Result<DriveUnits, ConfigError> {
        let out_of_range = |quantity| ConfigError::OutOfRange {
            node: self.node.raw(),
            quantity,
        };
        let positive = |quantity, value: Option<u32>| {
            let value = value.filter(|value| *value > 0);
            value.ok_or(out_of_range(quantity))
        };
        for (quantity, value) in [
            (Quantity::RatedTorque, self.rated_torque),
            (Quantity::PlausibleVelocity, self.plausible_velocity),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(out_of_range(quantity));
            }
        }
        let possible = |parameter: &Parameter| matches!(parameter.size, 1 | 2 | 4);
        if !self.parameters.iter().all(possible) {
            return Err(out_of_range(Quantity::ParameterSize));
        }
        let homing = &self.homing;
        Ok(DriveUnits {
            following_error: positive(
                Quantity::FollowingError,
                self.scale.distance(self.following_error),
            )?,
            quick_stop_deceleration: positive(
                Quantity::QuickStopDeceleration,
                rpm_magnitude(self.quick_stop_deceleration),
            )?,
            search_speed: positive(Quantity::SearchSpeed, rpm_magnitude(homing.search_speed))?,
            zero_speed: positive(Quantity::ZeroSpeed, rpm_magnitude(homing.zero_speed))?,
            homing_acceleration: positive(
                Quantity::HomingAcceleration,
                rpm_magnitude(homing.acceleration),
            )?,
        })
    }
}

impl GroupConfig {
    /// Refuses what cannot work before a frame is sent: all that [`Cia402Group::new`](super::Cia402Group::new) refuses.
    pub fn check(&self, axes: &[AxisConfig]) -> Result<(), ConfigError> {
        if !(1..=126).contains(&axes.len()) {
            return Err(ConfigError::Axes(axes.len()));
        }
        for (i, axis) in axes.iter().enumerate() {
            let earlier = axes[..i].iter().map(|axis| axis.node);
            if earlier
                .chain([self.host_node])
                .any(|node| node == axis.node)
            {
                return Err(ConfigError::DuplicateNode(axis.node.raw()));
            }
            axis.drive_units()?;
            axis.check_writes()?;
        }
        self.interpolation_period()?;
        self.heartbeat_times()?;
        Ok(())
    }
}
