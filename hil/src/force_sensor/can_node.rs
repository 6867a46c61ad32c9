//! The sensor on a CAN bus: a CANopen node whose TPDOs carry the reading.
//!
//! The node has SDO server, identity, heartbeat and LSS of all emulated nodes. At each SYNC the sensor takes a sample,
//! and the synchronous TPDOs of this SYNC carry the sample. TPDOs with an event timer carry the last sample, which is
//! at most [`CanForceSensorConfig::sample_period`] old. The comments of the data sheet ([`CanForceSensor::eds`])
//! describe the manufacturer-specific objects.

use std::borrow::Cow;
use std::time::Duration;

use can::{Frame, Instant};
use canopen::Object;

use super::table::{BIAS, BIAS_MARK, COUNTS_16, COUNTS_32, STATUS, TEMPERATURE, table};
use super::transducer::{Transducer, counts, counts_16};
use super::{CanForceSensorConfig, ForceSensorError, Resolution, WrenchProbe};
use crate::node::errors::Error as NodeError;
use crate::node::objects::Objects;
use crate::node::table::{Entry, Slot};
use crate::node::{Application, Applied, Identity, Node, NodeConfig};
use crate::{Device, Mechanism};

/// A force/torque sensor on a CAN bus.
pub struct CanForceSensor {
    node: Node<Sensor>,
}

impl CanForceSensor {
    /// A sensor switched on at [`CanForceSensorConfig::power_on`].
    pub fn new(config: CanForceSensorConfig, probe: Box<dyn WrenchProbe>) -> Result<Self, ForceSensorError> {
        for scale in [config.resolution_16, config.resolution_32] {
            let (force, torque) = (scale.force(), scale.torque());
            if force == 0.0 || torque == 0.0 {
                return Err(ForceSensorError::Count { force, torque });
            }
        }
        if config.sample_period.is_zero() {
            return Err(ForceSensorError::NoSamplePeriod);
        }
        let table = table(&config);
        let node = NodeConfig {
            id: config.node,
            identity: Identity {
                vendor: config.vendor,
                product: config.product,
                revision: config.revision,
                serial: config.serial,
            },
            power_on: config.power_on,
            boot_delay: config.boot_delay,
            answer_delay: config.answer_delay,
            lss_delay: Duration::ZERO,
        };
        let sensor = Sensor {
            slots: Slots::of(&table),
            transducer: Transducer::new(config.transducer, config.power_on, probe)?,
            resolution_16: config.resolution_16,
            resolution_32: config.resolution_32,
            period: config.sample_period,
            sample_at: config.power_on,
            sampled_at: None,
            now: config.power_on,
        };
        let objects = Objects::new(Cow::Owned(table), config.node, &[]);
        let mut node = Node::new(node, objects, sensor);
        node.schedule();
        Ok(Self { node })
    }

    /// Switches the supply off or on at `now`. A sensor without supply is silent, and loses its bias.
    pub fn set_power(&mut self, on: bool, now: Instant) {
        self.node.set_power(on, now);
    }
}

impl Device for CanForceSensor {
    fn hears(&self, frame: &Frame) -> bool {
        self.node.hears(frame)
    }

    fn handle(&mut self, frame: &Frame, now: Instant) {
        self.node.handle(frame, now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.node.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.node.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.node.handle_timeout(now);
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.node.application.transducer.mechanism()
    }
}

/// The objects that a sample writes, and the bias that a host writes.
struct Slots {
    counts_16: Slot,
    counts_32: Slot,
    status: Slot,
    temperature: Slot,
    bias: Slot,
}

impl Slots {
    fn of(table: &[Entry]) -> Self {
        let slot = |index, sub| Slot::of(table, Object::new(index, sub));
        Self {
            counts_16: slot(COUNTS_16, 1),
            counts_32: slot(COUNTS_32, 1),
            status: slot(STATUS, 0),
            temperature: slot(TEMPERATURE, 0),
            bias: slot(BIAS, 0),
        }
    }
}

/// The application of the node: the transducer and its sample times.
struct Sensor {
    slots: Slots,
    transducer: Transducer,
    resolution_16: Resolution,
    resolution_32: Resolution,
    period: Duration,
    /// Time of the next sample without SYNC.
    sample_at: Instant,
    sampled_at: Option<Instant>,
    now: Instant,
}

impl Sensor {
    /// Takes a sample, unless the last sample was taken at this instant.
    fn sample(&mut self, objects: &mut Objects) {
        if self.sampled_at != Some(self.now) {
            self.sample_again(objects);
        }
    }

    fn sample_again(&mut self, objects: &mut Objects) {
        self.sampled_at = Some(self.now);
        self.sample_at = self.now + self.period;
        let reading = self.transducer.read(self.now);
        for (at, value) in (0..).zip(reading.values) {
            let scale = |resolution: Resolution| if at < 3 { resolution.force() } else { resolution.torque() };
            let narrow = i32::from(counts_16(value, scale(self.resolution_16)));
            let wide = counts(value, scale(self.resolution_32));
            objects.set(self.slots.counts_16.plus(at), narrow as u32);
            objects.set(self.slots.counts_32.plus(at), wide as u32);
        }
        objects.set(self.slots.status, u32::from(reading.saturated));
        let tenths = i32::from(counts_16(self.transducer.temperature(self.now), 0.1));
        objects.set(self.slots.temperature, tenths as u32);
    }
}

impl Application for Sensor {
    fn catch_up(&mut self, now: Instant, _exact: bool, objects: &mut Objects) -> Option<NodeError> {
        self.now = now;
        if now >= self.sample_at {
            self.sample(objects);
        }
        None
    }

    fn poll_timeout(&self, event_driven: bool) -> Option<Instant> {
        event_driven.then_some(self.sample_at)
    }

    fn react(&mut self, _error: NodeError, _objects: &mut Objects) {}

    fn faulted(&self) -> bool {
        false
    }

    fn end_connection(&mut self, _objects: &mut Objects) -> Option<NodeError> {
        None
    }

    fn reset(&mut self, all: bool) {
        if all {
            self.transducer.clear_bias();
        }
    }

    fn start(&mut self, objects: &mut Objects) {
        // The reset of the dictionary has cleared the last sample.
        self.sample_again(objects);
    }

    fn publish(&mut self, _objects: &mut Objects) {}

    fn synchronise(&mut self, objects: &mut Objects, _now: Instant) {
        self.sample(objects);
    }

    fn apply(&mut self, marks: u8, objects: &mut Objects) -> Applied {
        if marks & BIAS_MARK != 0 {
            if objects.u(self.slots.bias) == 1 {
                self.transducer.set_bias(self.now);
            } else {
                self.transducer.clear_bias();
            }
            self.sample_again(objects);
        }
        Applied::default()
    }
}
