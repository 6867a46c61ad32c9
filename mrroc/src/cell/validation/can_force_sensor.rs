//! Checks of force sensors on CAN buses.

use drive::cia402;
use drive::wrench::{self, ConfigError, NodeQuantity};

use super::axis::check_parameters;
use super::io::check_node;
use super::{Checked, no_effect, refused, some, twice, within};
use crate::cell::{CanForceSensor, Cell, FieldContent, ForceSensor, Path, Range, SensorPdo};

/// Greatest COB-ID of a PDO.
const LAST_ID: f64 = 0x7FF as f64;

/// The keys of force sensor `index` on a CAN bus, at `path`.
pub(super) fn check_keys(
    cell: &Cell,
    path: &Path,
    index: usize,
    sensor: &ForceSensor,
    can: &CanForceSensor,
) -> Checked {
    no_effect(path, "baud", sensor.baud.is_some(), "for a sensor on a CAN bus")?;
    no_effect(path, "rate_hz", sensor.rate_hz.is_some(), "for a sensor on a CAN bus")?;
    for (key, given) in [("force_per_count", sensor.force_per_count), ("torque_per_count", sensor.torque_per_count)] {
        if given.is_none() {
            return refused(path, key, "is missing: a sensor on a CAN bus needs the scale of its counts");
        }
    }
    let here = path.then("can");
    check_node(cell, &here, &can.bus, can.node, "a force sensor with can")?;
    let what = format!("node {} of bus {:?}", can.node, can.bus);
    if let Some(first) = cell.io.iter().position(|io| io.bus == can.bus && io.node == can.node) {
        return refused(&here, "node", twice(&what, &Path::to("io").then(first)));
    }
    let same = |other: &ForceSensor| other.can.as_ref().is_some_and(|it| it.bus == can.bus && it.node == can.node);
    if let Some(first) = cell.force_sensor[..index].iter().position(same) {
        return refused(&here, "node", twice(&what, &Path::to("force_sensor").then(first)));
    }
    if can.event_timer_ms.is_some() {
        no_effect(&here, "every_syncs", can.every_syncs != 1, "with event_timer_ms")?;
    }
    within(&here, "every_syncs", can.every_syncs, Range::new(1.0, 240.0, "SYNCs"))?;
    within(&here, "event_timer_ms", can.event_timer_ms.unwrap_or(1), Range::new(1.0, f64::from(u16::MAX), "ms"))?;
    check_parameters(&here, &can.parameter, wrench::reserved)?;
    some(&here, "pdo", can.pdo.len(), 4, "TPDOs")?;
    can.pdo.iter().enumerate().try_for_each(|(number, pdo)| check_pdo(&here.then("pdo").then(number), pdo))
}

fn check_pdo(path: &Path, pdo: &SensorPdo) -> Checked {
    within(path, "number", pdo.number, Range::new(1.0, 4.0, ""))?;
    within(path, "cob_id", pdo.cob_id.unwrap_or(1), Range::new(1.0, LAST_ID, ""))?;
    some(path, "field", pdo.field.len(), 8, "fields")?;
    for (number, field) in pdo.field.iter().enumerate() {
        let path = path.then("field").then(number);
        no_effect(
            &path,
            "errors",
            field.errors.is_some() && field.content != FieldContent::Status,
            "but for a status",
        )?;
        let (fits, lengths) = match (field.content.component(), field.content) {
            (Some(_), _) => (matches!(field.bytes, 2 | 4), "2 or 4, as a component of the wrench"),
            (None, FieldContent::Ignored) => ((1..=8).contains(&field.bytes), "1 to 8"),
            (None, _) => ((1..=4).contains(&field.bytes), "1 to 4, as a counter or status"),
        };
        if !fits {
            return refused(&path, "bytes", format!("is {}, must be {lengths}", field.bytes));
        }
    }
    Ok(())
}

/// Greatest magnitude of a count in the process data of a sensor.
pub(super) fn greatest_count(can: &CanForceSensor, component: usize) -> f64 {
    let mut fields = can.pdo.iter().flat_map(|pdo| &pdo.field);
    let field = fields.find(|field| field.content.component().is_some_and(|axis| axis as usize == component));
    if field.is_some_and(|field| field.bytes == 4) { f64::from(i32::MAX) } else { f64::from(i16::MAX) }
}

/// The key of the cell for an error of the sensors on bus `bus`.
pub(super) fn place_of(cell: &Cell, bus: usize, error: &ConfigError) -> Path {
    let of_node = |node: u8| {
        let sensor = cell.sensors_on(bus).find(|&sensor| cell.node_of_sensor(sensor) == Some(node));
        sensor.map_or(Path::to("bus").then(bus), |sensor| Path::to("force_sensor").then(sensor).then("can"))
    };
    match error {
        ConfigError::Node { node, quantity: NodeQuantity::Trigger } => of_node(*node).then("every_syncs"),
        ConfigError::Node { node, .. } | ConfigError::CobId { node, .. } => of_node(*node).then("pdo"),
        ConfigError::Bus(cia402::ConfigError::DuplicateNode(node)) => of_node(*node).then("node"),
        ConfigError::Bus(cia402::ConfigError::Setting { node, .. }) => of_node(*node).then("parameter"),
        _ => Path::to("bus").then(bus),
    }
}
