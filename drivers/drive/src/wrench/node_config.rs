//! Configuration of a force/torque sensor on a CAN bus, and the checks made before the first frame.

use std::time::Duration;

use can::StandardId;
use can::schedule::Sender;
use canopen::cob::{self, Function};
use canopen::pdo::{Entry, MappingError, PdoCobId, PdoKind, PdoMapping, PdoNumber, TransmissionType};
use canopen::{NodeId, Object};
use master::pdo::PdoSetup;
use thiserror::Error;

use super::config::{ConfigError, WrenchConfig};
use super::rate::Pace;
use super::state::WrenchAxis;
use crate::bus::Traffic;
use crate::cia401::IoConfig;
use crate::cia402::{self, AxisConfig, GroupConfig, Identity, Setting, check_settings};

/// One force/torque sensor on a CAN bus. The heartbeat periods are those of the bus
/// ([`GroupConfig::heartbeat_period`]).
#[derive(Clone, Debug, PartialEq)]
pub struct WrenchNodeConfig {
    /// Node-ID.
    pub node: NodeId,
    /// Expected content of object 0x1018; `None` accepts any sensor.
    pub identity: Option<Identity>,
    /// Expected content of object 0x1000; `None` accepts any device type.
    pub device_type: Option<u32>,
    /// Scales, ranges and tolerances.
    pub sensor: WrenchConfig,
    /// What makes the node send a sample.
    pub trigger: Trigger,
    /// The TPDOs of one sample, 1 to 4 TPDOs. Each component of the wrench is in exactly one of them.
    pub pdos: Vec<WrenchPdo>,
    /// Objects downloaded in order before the settings of this driver. The communication objects 0x1000 to 0x1FFF belong
    /// to the driver.
    pub configuration: Vec<Setting>,
}

/// What makes a node send a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// Every n-th SYNC, n from 1 to 240 (CiA 301 §7.5.2.37). The time of a sample is the time of its SYNC.
    Sync {
        /// Number of SYNCs per sample.
        every: u8,
    },
    /// The event timer of the node. The value is the time between two samples: 1 to 65 535 whole milliseconds. The time
    /// of a sample is the receive time of its first frame.
    EventTimer(Duration),
}

/// One TPDO of a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct WrenchPdo {
    /// Number of the TPDO in the node.
    pub number: PdoNumber,
    /// Identifier of the TPDO. [`cob::tpdo`] gives the predefined identifier.
    pub cob_id: StandardId,
    /// Fields in the order of the frame, up to 8 bytes in total.
    pub fields: Vec<WrenchField>,
    /// Whether bring-up writes the mapping. A node with a fixed mapping takes `false`.
    pub mapped: bool,
}

/// One field of a TPDO, little endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrenchField {
    /// The object that the field carries.
    pub object: Object,
    /// Meaning of the field.
    pub content: Content,
}

/// Meaning of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Counts of a component, 16 bits signed.
    I16(WrenchAxis),
    /// Counts of a component, 32 bits signed.
    I32(WrenchAxis),
    /// Number of the sample, 1 to 4 bytes, which wraps around. An unchanged number means the same sample. Each PDO may
    /// have one counter; the PDOs of one sample have the same number.
    Counter {
        /// Length, bytes.
        bytes: u8,
    },
    /// Status of the sensor, 1 to 4 bytes.
    Status {
        /// Length, bytes.
        bytes: u8,
        /// Mask of the error bits. A set error bit is the fault [`WrenchFault::Status`](super::WrenchFault::Status).
        errors: u32,
    },
    /// Ignored, 1 to 8 bytes.
    Ignored {
        /// Length, bytes.
        bytes: u8,
    },
}

impl Content {
    pub(super) fn bytes(self) -> u8 {
        match self {
            Self::I16(_) => 2,
            Self::I32(_) => 4,
            Self::Counter { bytes } | Self::Status { bytes, .. } | Self::Ignored { bytes } => bytes,
        }
    }

    pub(super) fn axis(self) -> Option<WrenchAxis> {
        match self {
            Self::I16(axis) | Self::I32(axis) => Some(axis),
            Self::Counter { .. } | Self::Status { .. } | Self::Ignored { .. } => None,
        }
    }

    fn is_of_known_length(self) -> bool {
        let most = if matches!(self, Self::Ignored { .. }) { 8 } else { 4 };
        (1..=most).contains(&self.bytes())
    }
}

impl WrenchPdo {
    /// Whether the frames carry the number of their sample.
    pub(super) fn has_counter(&self) -> bool {
        self.fields.iter().any(|field| matches!(field.content, Content::Counter { .. }))
    }

    pub(super) fn mapping(&self) -> Result<PdoMapping, MappingError> {
        let entry = |field: &WrenchField| Entry::new(field.object, field.content.bytes().saturating_mul(8));
        PdoMapping::new(&self.fields.iter().map(entry).collect::<Vec<_>>())
    }
}

/// Refused part of the configuration of a sensor node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document the variants")]
pub enum NodeQuantity {
    #[error("a sample comes every 1 to 240 SYNCs, or by an event timer of 1 to 65535 whole milliseconds")]
    Trigger,
    #[error("a sample takes 1 to 4 PDOs, each with a number of its own")]
    Pdos,
    #[error("a counter or status has 1 to 4 bytes, a field that is ignored 1 to 8")]
    Field,
    #[error("a PDO has at most one counter")]
    Counter,
    #[error("{0} must be in one field of one PDO")]
    Component(WrenchAxis),
    #[error("object {0} is mapped for {1} and for {2}: each component needs an object of its own")]
    Shared(Object, WrenchAxis, WrenchAxis),
    #[error("PDO mapping: {0}")]
    Mapping(MappingError),
}

/// Checks the force/torque sensors of a bus with these drives and I/O nodes: node-IDs, identifiers and quantities. No
/// frame is sent.
pub fn check(
    group: &GroupConfig,
    axes: &[AxisConfig],
    io: &[IoConfig],
    sensors: &[WrenchNodeConfig],
) -> Result<(), ConfigError> {
    let others = || axes.iter().map(|axis| axis.node).chain(io.iter().map(|io| io.node)).chain([group.host_node]);
    for (i, config) in sensors.iter().enumerate() {
        let node = config.node.raw();
        let earlier = sensors[..i].iter().map(|earlier| earlier.node);
        if others().chain(earlier).any(|other| other == config.node) {
            return Err(cia402::ConfigError::DuplicateNode(node).into());
        }
        config.sensor.check(false)?;
        config.check_pdos().map_err(|quantity| ConfigError::Node { node, quantity })?;
        check_settings(config.node, &config.configuration, reserved)?;
    }
    let nodes = || others().chain(sensors.iter().map(|sensor| sensor.node));
    let mut taken = Vec::new();
    for (config, pdo) in sensors.iter().flat_map(|config| config.pdos.iter().map(move |pdo| (config, pdo))) {
        let free = match Function::of(pdo.cob_id) {
            Some(Function::Tpdo(_, node)) => node == config.node || nodes().all(|other| other != node),
            // A received RPDO of a node of this bus is taken for a frame of another controller.
            Some(Function::Rpdo(_, node)) => nodes().all(|other| other != node),
            Some(
                Function::Nmt
                | Function::Sync
                | Function::Emcy(_)
                | Function::Time
                | Function::SdoResponse(_)
                | Function::SdoRequest(_)
                | Function::Heartbeat(_),
            ) => false,
            None => true,
        };
        if !free || cob::reserved(pdo.cob_id) || taken.contains(&pdo.cob_id) {
            return Err(ConfigError::CobId { node: config.node.raw(), cob_id: pdo.cob_id.raw() });
        }
        taken.push(pdo.cob_id);
    }
    Ok(())
}

/// Why the host may not write `object` of a sensor: the objects of communication belong to the driver. `None` for an object
/// that the configuration may write.
pub fn reserved(object: Object) -> Option<cia402::Reserved> {
    match object.index {
        0x1000..=0x1FFF => {
            let found = cia402::reserved(0, object.index, object.subindex)?;
            Some(cia402::Reserved { why: "the driver sets how the node communicates", ..found })
        }
        _ => None,
    }
}

impl WrenchNodeConfig {
    fn check_pdos(&self) -> Result<(), NodeQuantity> {
        self.event_timer_ms()?;
        let numbers: Vec<_> = self.pdos.iter().map(|pdo| pdo.number).collect();
        let doubled = numbers.iter().enumerate().any(|(i, number)| numbers[..i].contains(number));
        if doubled || numbers.is_empty() {
            return Err(NodeQuantity::Pdos);
        }
        for pdo in &self.pdos {
            if !pdo.fields.iter().all(|field| field.content.is_of_known_length()) {
                return Err(NodeQuantity::Field);
            }
            if pdo.fields.iter().filter(|field| matches!(field.content, Content::Counter { .. })).count() > 1 {
                return Err(NodeQuantity::Counter);
            }
            pdo.mapping().map_err(NodeQuantity::Mapping)?;
        }
        let fields = || self.pdos.iter().flat_map(|pdo| &pdo.fields);
        let once = |axis| fields().filter(|field| field.content.axis() == Some(axis)).count() == 1;
        if let Some(axis) = WrenchAxis::ALL.into_iter().find(|axis| !once(*axis)) {
            return Err(NodeQuantity::Component(axis));
        }
        let components: Vec<_> = fields().filter_map(|field| Some((field.object, field.content.axis()?))).collect();
        for (i, &(object, axis)) in components.iter().enumerate() {
            if let Some((_, first)) = components[..i].iter().find(|(earlier, _)| *earlier == object) {
                return Err(NodeQuantity::Shared(object, *first, axis));
            }
        }
        Ok(())
    }

    /// Event timer, ms; `None` for SYNC.
    fn event_timer_ms(&self) -> Result<Option<u16>, NodeQuantity> {
        match self.trigger {
            Trigger::Sync { every: 1..=240 } => Ok(None),
            Trigger::Sync { .. } => Err(NodeQuantity::Trigger),
            Trigger::EventTimer(time) => {
                let millis = u16::try_from(time.as_millis()).ok().filter(|millis| *millis > 0);
                let whole = millis.filter(|millis| Duration::from_millis(u64::from(*millis)) == time);
                whole.ok_or(NodeQuantity::Trigger).map(Some)
            }
        }
    }

    pub(super) fn pace(&self, group: &GroupConfig) -> Pace {
        let period = group.period;
        match self.trigger {
            Trigger::Sync { every } => Pace::Requested { every: every.into(), period },
            Trigger::EventTimer(declared) => Pace::Own { declared, period },
        }
    }

    /// Greatest number of frames with samples that arrive within a period.
    pub(crate) fn frames_per(&self, period: Duration) -> usize {
        let samples = match self.trigger {
            Trigger::Sync { .. } => 1,
            Trigger::EventTimer(time) => 1 + (period.as_nanos() / time.as_nanos().max(1)) as usize,
        };
        samples * self.pdos.len()
    }

    /// The TPDOs of the node as bring-up sets them. The configuration must have passed [`check`].
    pub fn pdo_setups(&self) -> Result<Vec<PdoSetup>, ConfigError> {
        let of_node = |quantity| ConfigError::Node { node: self.node.raw(), quantity };
        let event_timer = self.event_timer_ms().map_err(of_node)?;
        let transmission = match self.trigger {
            Trigger::Sync { every } => TransmissionType(every),
            Trigger::EventTimer(_) => TransmissionType::EVENT_PROFILE,
        };
        let setup = |pdo: &WrenchPdo| {
            Ok(PdoSetup {
                kind: PdoKind::Tpdo,
                number: pdo.number,
                cob_id: PdoCobId::new(pdo.cob_id).without_rtr(),
                mapping: pdo.mapping().map_err(NodeQuantity::Mapping).map_err(of_node)?,
                transmission,
                inhibit_time: event_timer.map(|_| 0),
                event_timer,
            })
        };
        self.pdos.iter().map(setup).collect()
    }

    /// Whether SYNC makes the node sample.
    pub(crate) fn needs_sync(&self) -> bool {
        match self.trigger {
            Trigger::Sync { .. } => true,
            Trigger::EventTimer(_) => false,
        }
    }

    /// The frames of the samples. With SYNC, a frame must arrive before the next SYNC.
    pub(crate) fn samples(&self, group: &GroupConfig) -> impl Iterator<Item = Traffic> {
        let (sender, period) = (Sender::Node(self.node.raw()), self.pace(group).declared());
        let cyclic = self.needs_sync();
        self.pdos.iter().map(move |pdo| {
            let bytes = pdo.fields.iter().map(|field| field.content.bytes()).sum();
            Traffic { cob_id: pdo.cob_id, bytes, sender, period, cyclic, what: "wrench" }
        })
    }
}
