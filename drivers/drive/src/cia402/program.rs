//! The steps of a drive's bring-up, in order.

use canopen::cia402::{HomingMethod, ModeOfOperation};
use canopen::objects::*;
use canopen::sdo::Write;

use super::agreement;
use super::config::{AxisConfig, ConfigError, GroupConfig};
use super::process_data;
use crate::bus::{Need, Step};

/// Vendor-ID of maxon.
pub(super) const MAXON: u32 = 0x0000_00FB;
/// Object 0x6007: the drive brakes by a quick stop when the connection is lost.
const ABORT_CONNECTION_BY_QUICK_STOP: i16 = 3;
/// Object 0x1029:1 (CiA 301 §7.5.2.32): the drive enters pre-operational when the connection is lost, where no RPDO reaches
/// it. Set-points that a buffer held until then can neither enable nor move the drive. The drive brakes and holds its axis
/// under torque. The host removes the torque by SDO, and starts the drive again after a reset.
const PRE_OPERATIONAL: u8 = 0;
/// Object 0x605A (CiA 402-2 §8.4.5): the quick stop brakes on its ramp, and the drive then holds the axis.
const QUICK_STOP_RAMP_AND_HOLD: i16 = 6;
/// Objects 0x605B to 0x605D (CiA 402-2 §8.4.6 to §8.4.8): the drive brakes on its profile deceleration (0x6084) before
/// it takes the torque away, and at a halt.
const BRAKE_ON_PROFILE: i16 = 1;
/// Object 0x605E (CiA 402-2 §8.4.9): a fault takes the torque away at once. A drive with a following error does not
/// control its motor: an encoder that fails or a motor with swapped phases would accelerate on a ramp.
const FAULT_DISABLES: i16 = 0;

/// All steps before a drive is started.
pub(crate) fn program(group: &GroupConfig, axis: &AxisConfig) -> Result<Vec<Step>, ConfigError> {
    let units = axis.drive_units()?;
    let (period, exponent) = group.interpolation_period()?;
    let mode = axis.mode.of_operation();
    let mut steps: Vec<Step> = Step::identity(&axis.identity).collect();
    steps.push(Step::Modes([mode, ModeOfOperation::Homing]));
    // A previous controller may have left the drive enabled.
    steps.push(Step::required(Write::new(CONTROLWORD, 0_u16)));
    let settings = axis.configuration.iter().enumerate();
    steps.extend(settings.map(|(number, setting)| Step::Configure(setting.object, number)));
    // Behind the cell's own objects, whose writing may change others in the drive. First the limits of the ramps.
    let ramp = units.quick_stop_deceleration.max(units.homing_acceleration);
    for object in [MAX_ACCELERATION, MAX_DECELERATION] {
        steps.push(Step::AtLeast(object, ramp));
        steps.push(Step::Set(Write::new(object, ramp), Need::Limit));
    }
    steps.extend(Step::heartbeats(group)?);
    steps.extend(
        [
            Write::new(ABORT_CONNECTION_OPTION, ABORT_CONNECTION_BY_QUICK_STOP),
            Write::new(QUICK_STOP_OPTION, QUICK_STOP_RAMP_AND_HOLD),
            Write::new(QUICK_STOP_DECELERATION, units.quick_stop_deceleration),
            Write::new(INTERPOLATION_PERIOD_VALUE, period),
            Write::new(INTERPOLATION_PERIOD_INDEX, exponent),
            Write::new(FOLLOWING_ERROR_WINDOW, units.following_error),
            Write::new(HOMING_METHOD, HomingMethod(axis.homing.method).0),
            Write::new(HOMING_SWITCH_SPEED, units.search_speed),
            Write::new(HOMING_ZERO_SPEED, units.zero_speed),
            Write::new(HOMING_ACCELERATION, units.homing_acceleration),
        ]
        .map(Step::required),
    );
    steps.extend(
        [
            Write::new(ERROR_BEHAVIOUR, PRE_OPERATIONAL),
            // What a drive has stored would decide how an axis brakes, when it faults and which way it turns.
            Write::new(SHUTDOWN_OPTION, BRAKE_ON_PROFILE),
            Write::new(DISABLE_OPERATION_OPTION, BRAKE_ON_PROFILE),
            Write::new(HALT_OPTION, BRAKE_ON_PROFILE),
            Write::new(FAULT_REACTION_OPTION, FAULT_DISABLES),
            Write::new(FOLLOWING_ERROR_TIME_OUT, 0_u16),
            Write::new(MIN_POSITION_RANGE, 0_i32),
            Write::new(MAX_POSITION_RANGE, 0_i32),
            Write::new(POLARITY, 0_u8),
            Write::new(PROFILE_DECELERATION, units.quick_stop_deceleration),
            Write::new(MOTION_PROFILE_TYPE, 0_i16),
            // Offsets outlive a host that added them and died, and are added to every set-point
            // (CiA 402-2 §17.4).
            Write::new(POSITION_OFFSET, 0_i32),
            Write::new(VELOCITY_OFFSET, 0_i32),
            Write::new(TORQUE_OFFSET, 0_i16),
            // The homed counter must read zero at home, which is the position of the reference. EPOS4 has two objects of
            // its own in place of the home offset.
            Write::new(HOME_OFFSET, 0_i32),
        ]
        .map(Step::optional),
    );
    if axis.identity.vendor == MAXON {
        steps.extend(
            [EPOS4_HOME_POSITION, EPOS4_HOME_OFFSET_MOVE].map(|object| Step::optional(Write::new(object, 0_i32))),
        );
    }
    // After all writes that may change these objects.
    for agreement in agreement::of(axis) {
        steps.extend(agreement.divisor.map(|_| Step::Value(agreement)));
        steps.push(Step::Agree(agreement));
    }
    if let Some(range) = axis.counter_range() {
        steps.extend([Step::LowerLimit, Step::UpperLimit(range)]);
    }
    let mut maps_mode = false;
    let (_, deadline) = group.heartbeat_times()?;
    for write in process_data::mapping_writes(axis, deadline) {
        maps_mode |= process_data::maps_mode(write.object);
        steps.push(match process_data::may_be_absent(write.object) {
            // All of TPDO 2 but its first write, which switches it off.
            _ if maps_mode => Step::Set(write, Need::Watch),
            true => Step::optional(write),
            false => Step::required(write),
        });
    }
    steps.push(Step::required(Write::new(MODE_OF_OPERATION, mode.raw())));
    steps.extend([Step::Shown(mode), Step::Statusword, Step::Position, Step::ErrorCode]);
    steps.extend(axis.emergency_input.map(|_| Step::Inputs));
    Ok(steps)
}
