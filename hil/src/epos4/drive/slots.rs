//! Slots of the dictionary that the drive reads and writes, by the names of their objects.

use canopen::objects as named;

use crate::epos4::table::Slot;

macro_rules! slots {
    ($($name:ident),* $(,)?) => { $(pub(in crate::epos4) const $name: Slot = Slot::of(named::$name);)* };
}

slots!(
    CONTROLWORD,
    STATUSWORD,
    MODE_OF_OPERATION,
    MODE_OF_OPERATION_DISPLAY,
    POSITION_ACTUAL,
    VELOCITY_ACTUAL,
    TORQUE_ACTUAL,
    TARGET_POSITION,
    TARGET_VELOCITY,
    TARGET_TORQUE,
    POSITION_OFFSET,
    VELOCITY_OFFSET,
    TORQUE_OFFSET,
    FOLLOWING_ERROR_WINDOW,
    FOLLOWING_ERROR_ACTUAL,
    MIN_POSITION_LIMIT,
    MAX_POSITION_LIMIT,
    MAX_PROFILE_VELOCITY,
    MAX_MOTOR_SPEED,
    PROFILE_VELOCITY,
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    QUICK_STOP_DECELERATION,
    QUICK_STOP_OPTION,
    SHUTDOWN_OPTION,
    DISABLE_OPERATION_OPTION,
    HALT_OPTION,
    FAULT_REACTION_OPTION,
    HOMING_METHOD,
    HOMING_SWITCH_SPEED,
    HOMING_ZERO_SPEED,
    HOMING_ACCELERATION,
    EPOS4_HOME_POSITION,
    EPOS4_HOME_OFFSET_MOVE,
    EPOS4_HOMING_CURRENT_THRESHOLD,
    EPOS4_NOMINAL_CURRENT,
    EPOS4_TORQUE_CONSTANT,
    EPOS4_CURRENT_ACTUAL,
    MOTOR_RATED_TORQUE,
    VELOCITY_UNIT,
    INTERPOLATION_PERIOD_VALUE,
    INTERPOLATION_PERIOD_INDEX,
    MAX_ACCELERATION,
    DIGITAL_INPUTS,
    ABORT_CONNECTION_OPTION,
);
pub(in crate::epos4) const POSITION_DEMAND: Slot = Slot::of(canopen::Object::new(0x6062, 0));
pub(in crate::epos4) const VELOCITY_DEMAND: Slot = Slot::of(canopen::Object::new(0x606B, 0));
pub(in crate::epos4) const CURRENT_AVERAGE: Slot = Slot::of(canopen::Object::new(0x30D1, 1));
pub(in crate::epos4) const OUTPUT_CURRENT_LIMIT: Slot = Slot::of(canopen::Object::new(0x3001, 2));
pub(in crate::epos4) const INPUT_STATES: Slot = Slot::of(canopen::Object::new(0x3141, 1));
pub(in crate::epos4) const STANDSTILL_WINDOW: Slot = Slot::of(canopen::Object::new(0x30E0, 1));
pub(in crate::epos4) const STANDSTILL_WINDOW_TIME: Slot = Slot::of(canopen::Object::new(0x30E0, 2));
pub(in crate::epos4) const STANDSTILL_WINDOW_TIME_OUT: Slot = Slot::of(canopen::Object::new(0x30E0, 3));
pub(in crate::epos4) const POSITION_WINDOW: Slot = Slot::of(canopen::Object::new(0x6067, 0));
pub(in crate::epos4) const POSITION_WINDOW_TIME: Slot = Slot::of(canopen::Object::new(0x6068, 0));
