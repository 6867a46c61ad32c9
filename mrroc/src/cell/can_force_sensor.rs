//! The keys of force/torque sensors on CAN buses.

use std::time::Duration;

use can::StandardId;
use canopen::pdo::PdoNumber;
use canopen::{NodeId, Object, cob};
use drive::cia402::Identity;
use drive::wrench::{Content, Trigger, WrenchAxis, WrenchField, WrenchNodeConfig, WrenchPdo};
use serde::{Deserialize, Serialize};

use super::{Cell, ForceSensor, Parameter, defaults};

/// A CANopen node that sends the wrench as process data, beside drives or without them. The keys describe the process data
/// of the node, so that sensors of any vendor fit.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CanForceSensor {
    /// The CAN bus of the sensor.
    pub bus: String,
    /// Node-ID, which no other device of the bus has.
    pub node: u8,
    /// Vendor-ID, object 0x1018:01.
    pub vendor: u32,
    /// Product code, object 0x1018:02; not checked where absent.
    pub product: Option<u32>,
    /// Revision number, object 0x1018:03; not checked where absent.
    pub revision: Option<u32>,
    /// Device type, object 0x1000; not checked where absent.
    pub device_type: Option<u32>,
    /// Number of SYNCs per sample, 1 to 240. The time of a sample is the time of its SYNC.
    #[serde(default = "defaults::count::<1, u8>")]
    pub every_syncs: u8,
    /// Time between two samples by the event timer of the node, ms. The time of a sample is the receive time of its first
    /// frame. SYNC triggers the samples where absent.
    pub event_timer_ms: Option<u16>,
    /// Further objects to write before operation, such as a filter of the vendor.
    #[serde(default)]
    pub parameter: Vec<Parameter>,
    /// The TPDOs of a sample, 1 to 4. Each component of the wrench is in exactly one of them.
    pub pdo: Vec<SensorPdo>,
}

/// A TPDO of a force/torque sensor.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SensorPdo {
    /// Number of the TPDO in the node, 1 to 4.
    pub number: u8,
    /// COB-ID; that of the predefined connection set where absent.
    pub cob_id: Option<u16>,
    /// Whether the mapping of the node is fixed. A fixed mapping is not written.
    #[serde(default)]
    pub fixed_mapping: bool,
    /// The fields in the order of the frame, up to 8 bytes in total.
    pub field: Vec<SensorField>,
}

/// A field of a TPDO, little endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SensorField {
    /// Index of the object that the field carries.
    pub index: u16,
    /// Sub-index of the object.
    #[serde(default)]
    pub subindex: u8,
    /// Content of the field.
    pub content: FieldContent,
    /// Length, bytes: 2 or 4 for a component of the wrench, 1 to 4 for a counter or a status, 1 to 8 for an ignored field.
    pub bytes: u8,
    /// Error bits of a status. A set bit is a fault of the sensor. Only for a status, none where absent.
    pub errors: Option<u32>,
}

/// Contents of a field. Components of the wrench are signed counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum FieldContent {
    /// Force along x.
    Fx,
    /// Force along y.
    Fy,
    /// Force along z.
    Fz,
    /// Torque about x.
    Tx,
    /// Torque about y.
    Ty,
    /// Torque about z.
    Tz,
    /// Number of the sample, which wraps around. The TPDOs of one sample have the same number.
    Counter,
    /// Status of the sensor.
    Status,
    /// Ignored.
    Ignored,
}

impl FieldContent {
    /// The component of the wrench.
    pub(crate) fn component(self) -> Option<WrenchAxis> {
        match self {
            Self::Fx => Some(WrenchAxis::Fx),
            Self::Fy => Some(WrenchAxis::Fy),
            Self::Fz => Some(WrenchAxis::Fz),
            Self::Tx => Some(WrenchAxis::Tx),
            Self::Ty => Some(WrenchAxis::Ty),
            Self::Tz => Some(WrenchAxis::Tz),
            Self::Counter | Self::Status | Self::Ignored => None,
        }
    }
}

impl Cell {
    /// Indices in [`force_sensor`](Self::force_sensor) of the force sensors on bus `bus`.
    pub fn sensors_on(&self, bus: usize) -> impl Iterator<Item = usize> {
        let name = self.bus.get(bus).map(|bus| bus.name.as_str());
        let is_on = move |sensor: &ForceSensor| sensor.can.as_ref().is_some_and(|can| Some(&*can.bus) == name);
        (0..self.force_sensor.len()).filter(move |&sensor| is_on(&self.force_sensor[sensor]))
    }

    /// Configurations of the force sensors on bus `bus`, in the order of [`sensors_on`](Self::sensors_on).
    pub fn sensor_configs(&self, bus: usize) -> Vec<WrenchNodeConfig> {
        let config = |sensor: usize| self.force_sensor[sensor].node_config();
        self.sensors_on(bus).map(|sensor| config(sensor).expect("a sensor on a bus has its keys")).collect()
    }

    /// Node-ID of force sensor `sensor`; `None` for a sensor on a serial line.
    pub fn node_of_sensor(&self, sensor: usize) -> Option<u8> {
        self.force_sensor[sensor].can.as_ref().map(|can| can.node)
    }
}

impl ForceSensor {
    /// Configuration of the driver of a sensor on a CAN bus; `None` for a sensor on a serial line.
    pub fn node_config(&self) -> Option<WrenchNodeConfig> {
        let can = self.can.as_ref()?;
        Some(WrenchNodeConfig {
            node: can.node_id(),
            identity: Some(Identity { vendor: can.vendor, product: can.product, revision: can.revision }),
            device_type: can.device_type,
            sensor: self.wrench_config(),
            trigger: can.trigger(),
            pdos: can.pdo.iter().map(|pdo| pdo.config(can.node_id())).collect(),
            configuration: can.parameter.iter().map(Parameter::setting).collect(),
        })
    }
}

impl CanForceSensor {
    /// Node-ID of a parsed cell.
    pub(crate) fn node_id(&self) -> NodeId {
        NodeId::new(self.node).expect("a parsed cell has valid node-IDs")
    }

    fn trigger(&self) -> Trigger {
        let timer = self.event_timer_ms.map(|millis| Trigger::EventTimer(Duration::from_millis(millis.into())));
        timer.unwrap_or(Trigger::Sync { every: self.every_syncs })
    }

    /// Time between two samples at the servo period `period`.
    pub fn sample_period(&self, period: Duration) -> Duration {
        match self.trigger() {
            Trigger::Sync { every } => period * u32::from(every),
            Trigger::EventTimer(time) => time,
        }
    }
}

impl SensorPdo {
    fn config(&self, node: NodeId) -> WrenchPdo {
        let number = PdoNumber::ALL[usize::from(self.number - 1)];
        let given = self.cob_id.map(|id| StandardId::new(id).expect("a parsed cell has 11-bit identifiers"));
        WrenchPdo {
            number,
            cob_id: given.unwrap_or_else(|| cob::tpdo(number, node)),
            fields: self.field.iter().map(SensorField::config).collect(),
            mapped: !self.fixed_mapping,
        }
    }
}

impl SensorField {
    fn config(&self) -> WrenchField {
        let &Self { index, subindex, content, bytes, errors } = self;
        let content = match (content.component(), content) {
            (Some(axis), _) if bytes == 2 => Content::I16(axis),
            (Some(axis), _) => Content::I32(axis),
            (None, FieldContent::Counter) => Content::Counter { bytes },
            (None, FieldContent::Status) => Content::Status { bytes, errors: errors.unwrap_or(0) },
            (None, _) => Content::Ignored { bytes },
        };
        WrenchField { object: Object::new(index, subindex), content }
    }
}
