//! The object dictionary of the sensor on a CAN bus: communication, and manufacturer-specific objects for readings.

use canopen::Object;
use canopen::eds::DataType::{
    Integer16 as I16, Integer32 as I32, Unsigned8 as U8, Unsigned16 as U16, Unsigned32 as U32,
};
use canopen::pdo::{Entry as MapEntry, PdoKind};

use super::{CanForceSensorConfig, CountWidth};
use crate::node::table::{COMMUNICATION, Entry, RPDO_ROWS, TPDO_ROWS, pdo_rows, ro, rw, status_rows, text};

/// Readings in counts of 16 bits, and of 32 bits, at sub-indices 1 to 6.
pub(super) const COUNTS_16: u16 = 0x2000;
pub(super) const COUNTS_32: u16 = 0x2001;
/// Saturated channels.
pub(super) const STATUS: u16 = 0x2002;
/// 1 sets the bias, 0 removes it.
pub(super) const BIAS: u16 = 0x2003;
/// Scale of the counts: 16-bit force, 16-bit torque, 32-bit force, 32-bit torque.
pub(super) const RESOLUTION: u16 = 0x2004;
/// Temperature, 0.1 °C.
pub(super) const TEMPERATURE: u16 = 0x2005;
/// Sample period, µs.
pub(super) const SAMPLE_PERIOD: u16 = 0x2006;

/// Mark of object 0x2003: the sensor applies a write to this object.
pub(super) const BIAS_MARK: u8 = 1;

/// COB-IDs without the node-ID. All RPDOs are switched off. TPDO 3 is switched on with 32-bit counts.
const RECEIVED_COB: [u32; 4] = [0x8000_0200, 0x8000_0300, 0x8000_0400, 0x8000_0500];
const TRANSMITTED_COB: [u32; 4] = [0x4000_0180, 0x4000_0280, 0xC000_0380, 0xC000_0480];
/// Bit 31 of a COB-ID: the PDO is switched off.
const OFF: u32 = 1 << 31;

/// Transmission type of the TPDOs after a reset: every SYNC.
const EVERY_SYNC: u32 = 1;

/// The dictionary of a sensor, in ascending order.
pub(super) fn table(config: &CanForceSensorConfig) -> Vec<Entry> {
    let (index, bits, per_frame) = match config.width {
        CountWidth::Bits16 => (COUNTS_16, 16, 3),
        CountWidth::Bits32 => (COUNTS_32, 32, 2),
    };
    let mapped: Vec<u32> = (1..=6).map(|sub| MapEntry::new(Object::new(index, sub), bits).raw()).collect();
    let mut frames = mapped.chunks(per_frame);
    let mut next = || frames.next().unwrap_or(&[]);
    let mapping = [next(), next(), next(), next()];
    let mut cob = TRANSMITTED_COB;
    if config.width == CountWidth::Bits32 {
        cob[2] &= !OFF;
    }
    // Device type 0: the node follows no device profile (CiA 301 §7.5.2.1).
    let mut rows = Vec::from(status_rows(0));
    rows.extend([
        text(0x1008, 0, "Force/torque sensor"),
        text(0x1009, 0, "emulated"),
        text(0x100A, 0, "1"),
        rw(0x1015, 0, U16, 0),
    ]);
    rows.extend(COMMUNICATION);
    rows.extend(pdo_rows::<RPDO_ROWS>(PdoKind::Rpdo, RECEIVED_COB, 0, [&[]; 4]));
    rows.extend(pdo_rows::<TPDO_ROWS>(PdoKind::Tpdo, cob, 0, mapping));
    // The values change with every sample, and a change is no event. Only SYNC and the event timer therefore send them.
    let value = |index, sub, kind| ro(index, sub, kind, 0).tx().counts_events();
    for (index, kind) in [(COUNTS_16, I16), (COUNTS_32, I32)] {
        rows.push(ro(index, 0, U8, 6));
        rows.extend((1..=6).map(|sub| value(index, sub, kind)));
    }
    rows.push(ro(STATUS, 0, U16, 0).tx());
    rows.push(rw(BIAS, 0, U8, 0).range(0, 1).volatile().marks(BIAS_MARK));
    rows.push(ro(RESOLUTION, 0, U8, 4));
    let scales = [config.resolution_16, config.resolution_32];
    let scales = scales.map(|scale| [scale.force_micronewtons, scale.torque_micronewton_metres]);
    rows.extend((1..).zip(scales.as_flattened()).map(|(sub, scale)| ro(RESOLUTION, sub, U32, i64::from(*scale))));
    rows.push(value(TEMPERATURE, 0, I16));
    let period = u16::try_from(config.sample_period.as_micros()).unwrap_or(u16::MAX);
    rows.push(ro(SAMPLE_PERIOD, 0, U16, i64::from(period)));
    let mut set = |object, value| {
        if let Some(row) = rows.iter_mut().find(|row| row.object == object) {
            row.default = value;
        }
    };
    for (sub, value) in (1..).zip([config.vendor, config.product, config.revision, config.serial]) {
        set(Object::new(0x1018, sub), value);
    }
    for tpdo in 0..4 {
        set(Object::new(0x1800 + tpdo, 2), EVERY_SYNC);
    }
    rows.sort_by_key(|row| row.object);
    rows
}
