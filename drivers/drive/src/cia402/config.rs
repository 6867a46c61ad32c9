//! Configuration of a drive group and its axes, and the checks made before the first frame.

use std::time::Duration;

use canopen::cia402::ModeOfOperation;
use canopen::{NodeId, Object};
use master::sdo::CAPACITY;
use thiserror::Error;

use super::reserved::{Reserved, reserved};
use crate::cia401::IoQuantity;
use crate::scale::rpm_magnitude;
use crate::{Increments, Scale};

/// Heartbeat periods without a heartbeat after which the other side counts as lost, in both directions.
pub(super) const HEARTBEATS_TO_LOSE: u32 = 3;

/// Least time of listening for another controller, whose periods are not known.
const LISTENING_AT_LEAST: Duration = Duration::from_secs(1);

/// What the drives of a group have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupConfig {
    /// The SYNC period, equal to the servo period. An EPOS4 accepts whole milliseconds up to 100.
    pub period: Duration,
    /// Tolerated number of missing answers in a row; one more is [`Fault::Silent`](crate::Fault::Silent). The same
    /// number of set-points in a row may be refused by the port; one more is
    /// [`Fault::NotSent`](crate::Fault::NotSent).
    pub tolerated_missing: u32,
    /// Heartbeat period of the drives and of the host, whole milliseconds. Three periods without a heartbeat count as
    /// a loss, in the host and in the drives (object 0x1016).
    pub heartbeat_period: Duration,
    /// The node-ID under which the host sends its heartbeat.
    pub host_node: NodeId,
    /// How long an answer to a service request may take.
    pub sdo_timeout: Duration,
    /// How often a service request is repeated before it counts as timed out.
    pub sdo_retries: u8,
    /// Time-out for the boot of a node, and again for its change to operational. The latter is extended by a heartbeat
    /// period.
    pub boot_timeout: Duration,
    /// Time-out for a change of power state or mode of operation.
    pub transition_timeout: Duration,
}

/// One drive and its motor.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisConfig {
    /// Node-ID of the drive.
    pub node: NodeId,
    /// Expected content of object 0x1018.
    pub identity: Identity,
    /// The cyclic mode of operation.
    pub mode: CyclicMode,
    /// Scale between motor positions and the drive's increments.
    pub scale: Scale,
    /// Rated torque of the motor, N·m (object 0x6076). Objects 0x6071 and 0x6077 count thousandths of it.
    pub rated_torque: f64,
    /// How the drive searches for its reference.
    pub homing: HomingConfig,
    /// Plausibility bound, rad/s. A faster change of position counts as a jump of the counter. The motor must not
    /// reach this speed even in a runaway loop.
    pub plausible_velocity: f64,
    /// Greatest acceleration that the motor can physically have, rad/s². A step of the counter in motion that needs more
    /// counts as a jump of the counter.
    pub plausible_acceleration: f64,
    /// Following error at which the drive itself faults, rad of motor rotation (object 0x6065).
    pub following_error: f64,
    /// Deceleration of a quick stop, rad/s² (object 0x6085).
    pub quick_stop_deceleration: f64,
    /// Bit of object 0x60FD that is a normally closed contact of the emergency stop: set while the contact is closed. The
    /// drive then sends the object at every SYNC, by TPDO 3. The object has the bits 0 to 31.
    pub emergency_input: Option<u8>,
    /// Least and greatest position of the motor in the cell, rad. Bring-up compares the software position limits of the
    /// drive (object 0x607D) with them; `None` compares nothing.
    pub position_range: Option<(f64, f64)>,
    /// The objects of the device configuration file, then those of the cell, which prevail. They are downloaded in order
    /// before the settings of this driver. None of them may be [`reserved`](super::reserved).
    pub configuration: Vec<Setting>,
}

/// Expected identity of a drive (object 0x1018); `None` accepts any value.
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
    /// The drive closes the position loop and adds a torque to the output of its loops. The torque arrives with each
    /// position (object 0x60B2; torque feed-forward in CiA 402-2 §17.4). EPOS4's default PDO of this mode maps the
    /// torque beside the position.
    CspWithTorque,
    /// The drive closes the velocity loop.
    Csv,
    /// The drive closes the torque loop.
    ///
    /// This driver sets no speed limit in this mode. Object 0x6080 is the greatest speed that the motor permits (CiA
    /// 402-2), from its data sheet. Whether a drive limits the speed to it in this mode depends on the vendor:
    /// Nanotec's PD4-E lists 0x6080 for this mode, Lenze's i700 has 0x2946 instead, and for maxon's drives the
    /// behaviour is unknown. The host monitors the speed and stops the motor.
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
    /// Longest time from the start of homing to the first sign of a search.
    pub start_timeout: Duration,
}

/// A value of any length of an object of a drive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// The object.
    pub object: Object,
    /// The value in wire format, up to [`CAPACITY`] bytes.
    pub data: Vec<u8>,
    /// The object can be read; bring-up then reads it back.
    pub readable: bool,
    /// What bring-up does with the value.
    pub purpose: Purpose,
}

/// What bring-up does with a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// The value is written.
    Write,
    /// The value is read, and written if the drive holds another value.
    WriteIfDifferent,
    /// The value is read. A difference is a warning.
    Compare,
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum ConfigError {
    /// No drive and no I/O node.
    #[error("a bus needs a drive or an I/O node")]
    NoNodes,
    #[error("node {0} occurs twice")]
    DuplicateNode(u8),
    /// Object 0x60C2 cannot represent this period exactly.
    #[error("a period of {0:?} is not a count of up to 255 times a power of ten of a second")]
    Period(Duration),
    /// Objects 0x1016 and 0x1017 cannot represent this period or its time-out.
    #[error("a heartbeat period of {0:?} is not 1 to 21845 whole milliseconds")]
    HeartbeatPeriod(Duration),
    /// A setting that cannot or must not be written.
    #[error("node {node}: {object} cannot be configured: {why}")]
    Setting { node: u8, object: Object, why: &'static str },
    #[error("node {node}: {quantity} is out of range")]
    OutOfRange { node: u8, quantity: Quantity },
    /// A quantity of an I/O node.
    #[error("node {node}: {quantity}")]
    IoOutOfRange { node: u8, quantity: IoQuantity },
}

/// A quantity of an axis that the drive holds in its own unit and integer size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum Quantity {
    #[error("rated torque")]
    RatedTorque,
    #[error("plausible velocity")]
    PlausibleVelocity,
    #[error("plausible acceleration")]
    PlausibleAcceleration,
    #[error("following error")]
    FollowingError,
    #[error("quick stop deceleration")]
    QuickStopDeceleration,
    #[error("homing search speed")]
    SearchSpeed,
    #[error("homing zero speed")]
    ZeroSpeed,
    #[error("homing acceleration")]
    HomingAcceleration,
    #[error("input of the emergency stop")]
    EmergencyInput,
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
    /// Checks the bus and its drives without sending a frame. [`cia401::check`](crate::cia401::check) checks the I/O
    /// nodes.
    pub fn check(&self, axes: &[AxisConfig]) -> Result<(), ConfigError> {
        for (i, axis) in axes.iter().enumerate() {
            let earlier = axes[..i].iter().map(|axis| axis.node);
            if earlier.chain([self.host_node]).any(|node| node == axis.node) {
                return Err(ConfigError::DuplicateNode(axis.node.raw()));
            }
            axis.drive_units()?;
            axis.check_writes()?;
        }
        self.interpolation_period()?;
        self.heartbeat_times()?;
        Ok(())
    }

    /// Object 0x60C2: value and power of ten, s. The unit is milliseconds if possible, otherwise the coarsest unit
    /// that is exact.
    pub(super) fn interpolation_period(&self) -> Result<(u8, i8), ConfigError> {
        let nanos = self.period.as_nanos();
        [(-3, 1_000_000), (-4, 100_000), (-5, 10_000), (-6, 1_000)]
            .into_iter()
            .filter(|(_, unit)| nanos > 0 && nanos.is_multiple_of(*unit))
            .find_map(|(exponent, unit)| Some((u8::try_from(nanos / unit).ok()?, exponent)))
            .ok_or(ConfigError::Period(self.period))
    }

    /// Milliseconds between heartbeats (object 0x1017) and until a heartbeat counts as lost (object 0x1016).
    pub(crate) fn heartbeat_times(&self) -> Result<(u16, u16), ConfigError> {
        let error = ConfigError::HeartbeatPeriod(self.heartbeat_period);
        let nanos = self.heartbeat_period.as_nanos();
        let period = u16::try_from(nanos / 1_000_000).map_err(|_| error)?;
        let lost = period.checked_mul(HEARTBEATS_TO_LOSE as u16).ok_or(error)?;
        if period == 0 || !nanos.is_multiple_of(1_000_000) { Err(error) } else { Ok((period, lost)) }
    }

    /// How long the group listens to the bus before its first frame: three periods of the heartbeat or of SYNC,
    /// whichever is longer. The drives of a controller silent for that long have detected its loss and stopped by
    /// themselves.
    pub fn listening(&self) -> Duration {
        let periods = self.heartbeat_period.max(self.period) * HEARTBEATS_TO_LOSE;
        periods.max(LISTENING_AT_LEAST)
    }

    /// Time without a heartbeat of the host after which a drive brakes by itself and enters pre-operational (object
    /// 0x1016). The drive does not act on set-points that are held for longer.
    pub fn host_lost_after(&self) -> Duration {
        self.heartbeat_lost_after()
    }

    /// Longest latency of an answer: a period where the host closes a loop, and the tolerated number of missing answers more
    /// where the drive closes the position loop.
    pub(crate) fn tolerated_latency(&self, mode: CyclicMode) -> Duration {
        match mode {
            CyclicMode::Csp | CyclicMode::CspWithTorque => self.tolerated_missing.saturating_add(1) * self.period,
            CyclicMode::Csv | CyclicMode::Cst => self.period,
        }
    }

    /// Time without a heartbeat after which a drive counts as lost.
    pub(crate) fn heartbeat_lost_after(&self) -> Duration {
        self.heartbeat_period * HEARTBEATS_TO_LOSE
    }
}

/// Refuses settings of a node that cannot be written, or whose object is `reserved`.
pub(crate) fn check_settings(
    node: NodeId,
    settings: &[Setting],
    reserved: impl Fn(Object) -> Option<Reserved>,
) -> Result<(), ConfigError> {
    let refusal = |object: Object, why| ConfigError::Setting { node: node.raw(), object, why };
    let mut written = settings.iter().filter(|setting| setting.purpose != Purpose::Compare);
    if let Some(found) = written.find_map(|setting| reserved(setting.object)) {
        return Err(refusal(found.object, found.why));
    }
    let other = settings.iter().find(|setting| !(1..=CAPACITY).contains(&setting.data.len()));
    other.map_or(Ok(()), |other| Err(refusal(other.object, "1 to 256 bytes are transferred")))
}

/// Quantities of an axis in the drive's units: the following error in increments, speeds in rpm, accelerations in rpm/s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DriveUnits {
    pub(super) following_error: u32,
    pub(super) quick_stop_deceleration: u32,
    pub(super) search_speed: u32,
    pub(super) zero_speed: u32,
    pub(super) homing_acceleration: u32,
}

impl AxisConfig {
    /// Refuses settings that cannot or must not be written.
    fn check_writes(&self) -> Result<(), ConfigError> {
        let reserved = |object: Object| reserved(self.identity.vendor, object.index, object.subindex);
        check_settings(self.node, &self.configuration, reserved)
    }

    /// Least and greatest position of the motor in the cell, as the homed counter of the drive; `None` beyond 32 bits.
    pub(super) fn counter_range(&self) -> Option<[Increments; 2]> {
        let (low, high) = self.position_range?;
        let (low, high) = (self.scale.increments(low)?, self.scale.increments(high)?);
        Some([low.min(high), low.max(high)])
    }

    pub(super) fn drive_units(&self) -> Result<DriveUnits, ConfigError> {
        let out_of_range = |quantity| ConfigError::OutOfRange { node: self.node.raw(), quantity };
        let positive = |quantity, value: Option<u32>| {
            let value = value.filter(|value| *value > 0);
            value.ok_or(out_of_range(quantity))
        };
        let rpm = |quantity, value| positive(quantity, rpm_magnitude(value));
        for (quantity, value) in [
            (Quantity::RatedTorque, self.rated_torque),
            (Quantity::PlausibleVelocity, self.plausible_velocity),
            (Quantity::PlausibleAcceleration, self.plausible_acceleration),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(out_of_range(quantity));
            }
        }
        if self.emergency_input.is_some_and(|input| u32::from(input) >= u32::BITS) {
            return Err(out_of_range(Quantity::EmergencyInput));
        }
        let homing = &self.homing;
        Ok(DriveUnits {
            following_error: positive(Quantity::FollowingError, self.scale.distance(self.following_error))?,
            quick_stop_deceleration: rpm(Quantity::QuickStopDeceleration, self.quick_stop_deceleration)?,
            search_speed: rpm(Quantity::SearchSpeed, homing.search_speed)?,
            zero_speed: rpm(Quantity::ZeroSpeed, homing.zero_speed)?,
            homing_acceleration: rpm(Quantity::HomingAcceleration, homing.acceleration)?,
        })
    }
}
