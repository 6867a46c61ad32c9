//! The object dictionary of the module: communication, and objects of CiA 401 for digital inputs and outputs in bytes.
//!
//! The defaults of the objects of CiA 401 come from manuals of modules.

use canopen::Object;
use canopen::eds::DataType::{Boolean, Unsigned8 as U8, Unsigned16 as U16};
use canopen::pdo::{Entry as MapEntry, PdoKind};

use super::DigitalIoConfig;
use crate::node::table::{COMMUNICATION, Entry, RPDO_ROWS, TPDO_ROWS, pdo_rows, ro, rw, status_rows, text};

pub(super) const READ_INPUT: u16 = 0x6000;
pub(super) const POLARITY_INPUT: u16 = 0x6002;
pub(super) const FILTER_CONSTANT: u16 = 0x6003;
pub(super) const INTERRUPT_ENABLE: u16 = 0x6005;
pub(super) const ANY_CHANGE: u16 = 0x6006;
pub(super) const LOW_TO_HIGH: u16 = 0x6007;
pub(super) const HIGH_TO_LOW: u16 = 0x6008;
pub(super) const WRITE_OUTPUT: u16 = 0x6200;
pub(super) const POLARITY_OUTPUT: u16 = 0x6202;
pub(super) const ERROR_MODE: u16 = 0x6206;
pub(super) const ERROR_VALUE: u16 = 0x6207;
pub(super) const FILTER_MASK: u16 = 0x6208;

/// Marks of writes that the module applies: parameters of inputs, values of outputs, parameters of outputs.
pub(super) const INPUTS: u8 = 1;
pub(super) const OUTPUTS: u8 = 1 << 1;
pub(super) const SHAPE: u8 = 1 << 2;

/// COB-IDs before the node-ID is added: the first PDO of each kind exists.
const RECEIVED_COB: [u32; 4] = [0x0000_0200, 0x8000_0300, 0x8000_0400, 0x8000_0500];
const TRANSMITTED_COB: [u32; 4] = [0x4000_0180, 0xC000_0280, 0xC000_0380, 0xC000_0480];

fn is_boolean(value: u32) -> bool {
    value <= 1
}

/// The dictionary of a module, in ascending order.
pub(super) fn table(config: &DigitalIoConfig) -> Vec<Entry> {
    let (inputs, outputs) = (config.input_bytes, config.output_bytes);
    // Device profile 401, and one bit for each kind of lines (CiA 401, object 0x1000).
    let device_type = 0x0191 | u32::from(inputs > 0) << 16 | u32::from(outputs > 0) << 17;
    let bytes = |index, count| (1..=count).map(move |sub| MapEntry::new(Object::new(index, sub), 8).raw());
    let received: Vec<u32> = bytes(WRITE_OUTPUT, outputs).collect();
    let transmitted: Vec<u32> = bytes(READ_INPUT, inputs).collect();
    let mut rows = Vec::from(status_rows(device_type));
    rows.extend([
        text(0x1008, 0, "Digital I/O"),
        text(0x1009, 0, "emulated"),
        text(0x100A, 0, "1"),
        rw(0x1015, 0, U16, 0),
    ]);
    rows.extend(COMMUNICATION);
    rows.extend(pdo_rows::<RPDO_ROWS>(PdoKind::Rpdo, RECEIVED_COB, 0, [&received, &[], &[], &[]]));
    rows.extend(pdo_rows::<TPDO_ROWS>(PdoKind::Tpdo, TRANSMITTED_COB, 0, [&transmitted, &[], &[], &[]]));
    let mut array = |index: u16, count: u8, row: fn(u16, u8) -> Entry| {
        if count > 0 {
            rows.push(ro(index, 0, U8, count.into()));
            rows.extend((1..=count).map(|sub| row(index, sub)));
        }
    };
    array(READ_INPUT, inputs, |index, sub| ro(index, sub, U8, 0).tx().counts_events());
    array(POLARITY_INPUT, inputs, |index, sub| rw(index, sub, U8, 0).marks(INPUTS));
    array(FILTER_CONSTANT, inputs, |index, sub| rw(index, sub, U8, 0).marks(INPUTS));
    array(ANY_CHANGE, inputs, |index, sub| rw(index, sub, U8, 0xFF));
    array(LOW_TO_HIGH, inputs, |index, sub| rw(index, sub, U8, 0));
    array(HIGH_TO_LOW, inputs, |index, sub| rw(index, sub, U8, 0));
    array(WRITE_OUTPUT, outputs, |index, sub| rw(index, sub, U8, 0).rx().volatile().marks(OUTPUTS));
    array(POLARITY_OUTPUT, outputs, |index, sub| rw(index, sub, U8, 0).marks(SHAPE));
    array(ERROR_MODE, outputs, |index, sub| rw(index, sub, U8, 0xFF));
    array(ERROR_VALUE, outputs, |index, sub| rw(index, sub, U8, 0));
    array(FILTER_MASK, outputs, |index, sub| rw(index, sub, U8, 0xFF).marks(SHAPE));
    if inputs > 0 {
        rows.push(rw(INTERRUPT_ENABLE, 0, Boolean, 1).only(is_boolean));
    }
    for (sub, value) in (1..).zip([config.vendor, config.product, config.revision, config.serial]) {
        let identity = rows.iter_mut().find(|row| row.object == Object::new(0x1018, sub));
        if let Some(row) = identity {
            row.default = value;
        }
    }
    rows.sort_by_key(|row| row.object);
    rows
}
