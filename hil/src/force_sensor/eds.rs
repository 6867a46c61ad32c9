//! The electronic data sheet of the sensor on a CAN bus.

use canopen::eds::Eds;
use canopen::objects as named;

use super::table::{RESOLUTION, table};
use super::{CanForceSensor, CanForceSensorConfig};
use crate::node::eds::{Head, Sheet};

/// Comments of the data sheet: the objects of the sensor, and choices of the emulator. The text is ASCII without
/// semicolons, which begin comments in data sheets.
const STATEMENTS: &[&str] = &[
    "Data sheet of an emulated sensor. The objects 2000 to 2006 are not taken from any product.",
    "Communication: that of the emulated drive (epos4-emulated.eds), with the inhibit time of EMCY (1015). No object can be received.",
    "Readings (2000, 2001): sub-indices 1 to 6 are Fx, Fy, Fz, Tx, Ty, Tz in the frame of the sensor.",
    "Readings (2000): INTEGER16 in the scale of 2004:1 and 2004:2. Readings (2001): INTEGER32 in the scale of 2004:3 and 2004:4.",
    "Readings: a saturated channel shows the limit of its range less the bias. Counts are limited to their data type.",
    "Status (2002): bits 0 to 5 are set while the channels Fx to Tz are saturated. A change triggers event-driven TPDOs.",
    "Bias (2003): 1 makes the next sample the zero of the readings. 0 removes the bias. Reset node removes the bias.",
    "Scale (2004): force in uN per count and torque in uN m per count, for 2000 and then for 2001.",
    "Temperature (2005): in 0.1 degrees Celsius. Sample period (2006): in us.",
    "TPDO 1 and TPDO 2: forces and torques of 2000. A sensor with 32-bit counts has two values of 2001 in each of TPDO 1 to 3.",
    "TPDO, types 1 to 240: SYNC takes the sample that the TPDOs carry. Types 254 and 255: sent by the event timer.",
    "TPDO, type 0: sent once, since a new value is no event. Status (2002) is an event.",
    "Store parameters (1010): not stored are the bias and the error history.",
];

/// Names of the sensor's objects, see [`Sheet::names`].
const NAMES: &[(u16, u8, &str)] = &[
    (0x1009, 0, "Manufacturer hardware version"),
    (0x100A, 0, "Manufacturer software version"),
    (0x1015, 0, "Inhibit time EMCY"),
    (0x2000, 0, "Wrench 16-bit"),
    (0x2000, 1, "Force x 16-bit"),
    (0x2000, 2, "Force y 16-bit"),
    (0x2000, 3, "Force z 16-bit"),
    (0x2000, 4, "Torque x 16-bit"),
    (0x2000, 5, "Torque y 16-bit"),
    (0x2000, 6, "Torque z 16-bit"),
    (0x2001, 0, "Wrench 32-bit"),
    (0x2001, 1, "Force x 32-bit"),
    (0x2001, 2, "Force y 32-bit"),
    (0x2001, 3, "Force z 32-bit"),
    (0x2001, 4, "Torque x 32-bit"),
    (0x2001, 5, "Torque y 32-bit"),
    (0x2001, 6, "Torque z 32-bit"),
    (0x2002, 0, "Sensor status"),
    (0x2003, 0, "Bias"),
    (0x2004, 0, "Scale of counts"),
    (0x2004, 1, "Force per count 16-bit"),
    (0x2004, 2, "Torque per count 16-bit"),
    (0x2004, 3, "Force per count 32-bit"),
    (0x2004, 4, "Torque per count 32-bit"),
    (0x2005, 0, "Temperature"),
    (0x2006, 0, "Sample period"),
];

impl CanForceSensor {
    /// The electronic data sheet of a unit. Units of one kind differ only in the serial number.
    pub fn eds(config: &CanForceSensorConfig) -> Eds {
        let table = table(config);
        let sheet = Sheet {
            table: &table,
            names: NAMES,
            records: &[RESOLUTION],
            stated: &[],
            individual: &[named::SERIAL_NUMBER],
        };
        let head = Head {
            file_name: "force-sensor-emulated.eds",
            description: "Emulated force/torque sensor",
            creation_date: "11-23-2026",
            vendor_name: "mrroc",
            product_name: "Force/torque sensor (emulated)",
            identity: [config.vendor, config.product, config.revision],
        };
        sheet.eds(&head, STATEMENTS.iter().map(|&line| line.to_owned()).collect())
    }
}
