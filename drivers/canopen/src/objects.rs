//! The objects this project reads and writes, by the names of CiA 301, CiA 402 and maxon.
//!
//! PDO parameters are numbered and live in [`crate::pdo`].

use std::fmt;

/// The address of one entry of an object dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Object {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub subindex: u8,
}

impl Object {
    /// An address.
    pub const fn new(index: u16, subindex: u8) -> Self {
        Self { index, subindex }
    }

    /// The name of an object of [`TABLE`].
    pub fn name(self) -> Option<&'static str> {
        TABLE.iter().find(|(object, _)| *object == self).map(|(_, name)| *name)
    }
}

/// As `0x1018:01`.
impl fmt::Display for Object {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#06x}:{:02x}", self.index, self.subindex)
    }
}

macro_rules! objects {
    ($($name:ident = $index:literal : $subindex:literal, $text:literal;)*) => {
        $(#[doc = concat!("Object ", stringify!($index), ", sub-index ", $subindex, ": ", $text, ".")]
        pub const $name: Object = Object::new($index, $subindex);)*

        /// Every object named here, in ascending order, with its name.
        pub const TABLE: &[(Object, &str)] = &[$(($name, $text)),*];
    };
}

objects! {
    DEVICE_TYPE = 0x1000:0, "device type";
    ERROR_REGISTER = 0x1001:0, "error register";
    ERROR_HISTORY_COUNT = 0x1003:0, "number of stored errors";
    ERROR_HISTORY_NEWEST = 0x1003:1, "newest stored error";
    SYNC_COB_ID = 0x1005:0, "COB-ID of SYNC";
    DEVICE_NAME = 0x1008:0, "manufacturer device name";
    STORE_ALL = 0x1010:1, "store all parameters";
    RESTORE_ALL = 0x1011:1, "restore all default parameters";
    EMCY_COB_ID = 0x1014:0, "COB-ID of EMCY";
    CONSUMER_HEARTBEAT_COUNT = 0x1016:0, "number of heartbeat consumers";
    CONSUMER_HEARTBEAT_1 = 0x1016:1, "heartbeat consumer 1";
    PRODUCER_HEARTBEAT = 0x1017:0, "heartbeat producer time";
    VENDOR_ID = 0x1018:1, "vendor-ID";
    PRODUCT_CODE = 0x1018:2, "product code";
    REVISION = 0x1018:3, "revision number";
    SERIAL_NUMBER = 0x1018:4, "serial number";
    SYNC_COUNTER_OVERFLOW = 0x1019:0, "SYNC counter overflow";
    ERROR_BEHAVIOUR = 0x1029:1, "reaction to a communication error";
    EPOS2_CURRENT_SETTING = 0x2030:0, "EPOS2 current mode setting value";
    EPOS2_POSITION_SETTING = 0x2062:0, "EPOS2 position mode setting value";
    EPOS2_VELOCITY_SETTING = 0x206B:0, "EPOS2 velocity mode setting value";
    EPOS2_DIGITAL_INPUTS = 0x2071:1, "EPOS2 digital input state";
    EPOS2_HOMING_CURRENT_THRESHOLD = 0x2080:0, "EPOS2 current threshold of homing";
    EPOS2_HOME_POSITION = 0x2081:0, "EPOS2 home position";
    EPOS2_INTERPOLATION_DATA = 0x20C1:0, "EPOS2 interpolation data record";
    EPOS2_INTERPOLATION_STATUS = 0x20C4:1, "EPOS2 interpolation buffer status";
    EPOS4_SUPPLY_VOLTAGE = 0x2200:1, "EPOS4 supply voltage";
    EPOS4_MAIN_SENSOR_RESOLUTION = 0x3000:5, "EPOS4 main sensor resolution";
    EPOS4_NOMINAL_CURRENT = 0x3001:1, "EPOS4 nominal current";
    EPOS4_TORQUE_CONSTANT = 0x3001:5, "EPOS4 torque constant";
    EPOS4_HOME_POSITION = 0x30B0:0, "EPOS4 home position";
    EPOS4_HOME_OFFSET_MOVE = 0x30B1:0, "EPOS4 home offset move distance";
    EPOS4_HOMING_CURRENT_THRESHOLD = 0x30B2:0, "EPOS4 current threshold of homing";
    EPOS4_CURRENT_ACTUAL = 0x30D1:2, "EPOS4 current actual value";
    ABORT_CONNECTION_OPTION = 0x6007:0, "abort connection option code";
    ERROR_CODE = 0x603F:0, "error code";
    CONTROLWORD = 0x6040:0, "controlword";
    STATUSWORD = 0x6041:0, "statusword";
    QUICK_STOP_OPTION = 0x605A:0, "quick stop option code";
    SHUTDOWN_OPTION = 0x605B:0, "shutdown option code";
    DISABLE_OPERATION_OPTION = 0x605C:0, "disable operation option code";
    HALT_OPTION = 0x605D:0, "halt option code";
    FAULT_REACTION_OPTION = 0x605E:0, "fault reaction option code";
    MODE_OF_OPERATION = 0x6060:0, "modes of operation";
    MODE_OF_OPERATION_DISPLAY = 0x6061:0, "modes of operation display";
    POSITION_ACTUAL = 0x6064:0, "position actual value";
    FOLLOWING_ERROR_WINDOW = 0x6065:0, "following error window";
    FOLLOWING_ERROR_TIME_OUT = 0x6066:0, "following error time-out";
    VELOCITY_ACTUAL = 0x606C:0, "velocity actual value";
    TARGET_TORQUE = 0x6071:0, "target torque";
    MAX_TORQUE = 0x6072:0, "max torque";
    MOTOR_RATED_TORQUE = 0x6076:0, "motor rated torque";
    TORQUE_ACTUAL = 0x6077:0, "torque actual value";
    CURRENT_ACTUAL = 0x6078:0, "current actual value";
    TARGET_POSITION = 0x607A:0, "target position";
    MIN_POSITION_RANGE = 0x607B:1, "position range limit, minimum";
    MAX_POSITION_RANGE = 0x607B:2, "position range limit, maximum";
    HOME_OFFSET = 0x607C:0, "home offset";
    MIN_POSITION_LIMIT = 0x607D:1, "software position limit, minimum";
    MAX_POSITION_LIMIT = 0x607D:2, "software position limit, maximum";
    POLARITY = 0x607E:0, "polarity";
    MAX_PROFILE_VELOCITY = 0x607F:0, "max profile velocity";
    MAX_MOTOR_SPEED = 0x6080:0, "max motor speed";
    PROFILE_VELOCITY = 0x6081:0, "profile velocity";
    PROFILE_ACCELERATION = 0x6083:0, "profile acceleration";
    PROFILE_DECELERATION = 0x6084:0, "profile deceleration";
    QUICK_STOP_DECELERATION = 0x6085:0, "quick stop deceleration";
    MOTION_PROFILE_TYPE = 0x6086:0, "motion profile type";
    POSITION_ENCODER_INCREMENTS = 0x608F:1, "position encoder resolution, encoder increments";
    POSITION_ENCODER_REVOLUTIONS = 0x608F:2, "position encoder resolution, motor revolutions";
    GEAR_MOTOR_REVOLUTIONS = 0x6091:1, "gear ratio, motor revolutions";
    GEAR_SHAFT_REVOLUTIONS = 0x6091:2, "gear ratio, shaft revolutions";
    FEED = 0x6092:1, "feed constant, feed";
    FEED_SHAFT_REVOLUTIONS = 0x6092:2, "feed constant, shaft revolutions";
    HOMING_METHOD = 0x6098:0, "homing method";
    HOMING_SWITCH_SPEED = 0x6099:1, "homing speed during search for switch";
    HOMING_ZERO_SPEED = 0x6099:2, "homing speed during search for zero";
    HOMING_ACCELERATION = 0x609A:0, "homing acceleration";
    VELOCITY_UNIT = 0x60A9:0, "SI unit velocity";
    POSITION_OFFSET = 0x60B0:0, "position offset";
    VELOCITY_OFFSET = 0x60B1:0, "velocity offset";
    TORQUE_OFFSET = 0x60B2:0, "torque offset";
    INTERPOLATION_PERIOD_VALUE = 0x60C2:1, "interpolation time period value";
    INTERPOLATION_PERIOD_INDEX = 0x60C2:2, "interpolation time index";
    MAX_ACCELERATION = 0x60C5:0, "max acceleration";
    MAX_DECELERATION = 0x60C6:0, "max deceleration";
    FOLLOWING_ERROR_ACTUAL = 0x60F4:0, "following error actual value";
    DIGITAL_INPUTS = 0x60FD:0, "digital inputs";
    DIGITAL_OUTPUTS = 0x60FE:1, "physical outputs";
    TARGET_VELOCITY = 0x60FF:0, "target velocity";
    SUPPORTED_MODES = 0x6502:0, "supported drive modes";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_ascends_without_doubles() {
        for pair in TABLE.windows(2) {
            assert!(pair[0].0 < pair[1].0, "{}", pair[1].0);
        }
    }

    #[test]
    fn objects_have_names_and_print_as_index_and_subindex() {
        assert_eq!(STATUSWORD.name(), Some("statusword"));
        assert_eq!(Object::new(0x1018, 1).name(), Some("vendor-ID"));
        assert_eq!(Object::new(0x5FFF, 0).name(), None);
        assert_eq!(PRODUCT_CODE.to_string(), "0x1018:02");
    }
}
