//! Emulated force/torque sensors of a cell: on serial lines and on CAN buses.

use std::time::Duration;

use can::{Frame, Instant};
use drive::wrench::Content;
use hil::{
    BusId, CanForceSensor, CanForceSensorConfig, Device, LineDevice, Mechanism, Resolution, SerialForceSensor,
    SerialForceSensorConfig, TemperatureCourse, TransducerConfig, World, scene::SensorProbe,
};
use serial::VirtualLine;

use crate::bench::emulation::{Absent, LINE};
use crate::bench::plants::EmulatedCell;
use crate::bench::random::Stream;
use crate::bench::scene::{EmulatedSurroundings, SceneTruth};
use crate::cell::{CellFile, FieldContent, ForceSensor, ForceSensorEmulator, Path, SensorField};

/// Number of µN or µN·m in a newton or newton-metre: the emulated node gives its resolution in whole ones.
const MICRO: f64 = 1e6;

impl EmulatedCell<'_> {
    /// Adds all force sensors and the scene that loads them, switched on at [`Instant::ZERO`]. The buses and the axes of
    /// their robots are in `world` already. Returns the host's ends of the sensors on serial lines, and the truth of the
    /// scene.
    ///
    /// A sensor measures the weight and the inertia of its tool, the forces on the tip of the tool, and those of the
    /// gripper.
    pub fn add_sensors(&self, world: &mut World, buses: &[BusId]) -> (Vec<VirtualLine>, SceneTruth) {
        let EmulatedSurroundings { scene, sensors, truth } = self.surroundings();
        if let Some(scene) = scene {
            world.set_scene(scene);
        }
        let cell = &self.file.cell;
        let mut lines = Vec::new();
        for (number, (sensor, probe)) in cell.force_sensor.iter().zip(sensors).enumerate() {
            let Some(can) = &sensor.can else {
                let line = world.add_line(sensor.settings(), None, self.on_line(number, sensor, probe));
                lines.push(world.host_line(line, LINE));
                continue;
            };
            if !sensor.emulator.absent {
                let bus = cell.bus.iter().position(|bus| bus.name == can.bus).expect("a parsed cell has the bus");
                world.add_device(buses[bus], self.on_bus(number, sensor, probe));
            }
        }
        (lines, truth)
    }

    fn on_line(&self, number: usize, sensor: &ForceSensor, probe: SensorProbe) -> Box<dyn LineDevice> {
        if sensor.emulator.absent {
            return Box::new(Absent);
        }
        // A negative count is that of a transducer with the opposite sense.
        let transducer = self.transducer(number, sensor, sensor.counts().map(f64::signum));
        let [force_per_count, torque_per_count] = sensor.counts().map(f64::abs);
        let config =
            SerialForceSensorConfig { force_per_count, torque_per_count, ..SerialForceSensorConfig::new(transducer) };
        let device = SerialForceSensor::new(config, Box::new(probe)).expect("a parsed cell has sound sensors");
        match sensor.emulator.silent_from_s {
            None => Box::new(device),
            Some(at) => Box::new(Unplugged::new(device, at)),
        }
    }

    fn on_bus(&self, number: usize, sensor: &ForceSensor, probe: SensorProbe) -> Box<dyn Device> {
        let can = sensor.can.as_ref().expect("the sensor is on a bus");
        // The resolution of the node is a whole number of µN. The gain of the transducer compensates the rounding.
        let whole = sensor.counts().map(|count| (count.abs() * MICRO).round().max(1.0));
        let gain = std::array::from_fn(|kind| whole[kind] / MICRO / sensor.counts()[kind]);
        let resolution = Resolution { force_micronewtons: whole[0] as u32, torque_micronewton_metres: whole[1] as u32 };
        let usual = CanForceSensorConfig::new(can.node_id(), self.transducer(number, sensor, gain));
        let config = CanForceSensorConfig {
            vendor: can.vendor,
            product: can.product.unwrap_or(usual.product),
            revision: can.revision.unwrap_or(usual.revision),
            resolution_16: resolution,
            resolution_32: resolution,
            ..usual
        };
        let device = CanForceSensor::new(config, Box::new(probe)).expect("a parsed cell has sound sensors");
        match sensor.emulator.silent_from_s {
            None => Box::new(device),
            Some(at) => Box::new(Unplugged::new(device, at)),
        }
    }

    /// The transducer of a sensor whose node or board counts `gain` times the true force and torque.
    fn transducer(&self, number: usize, sensor: &ForceSensor, gain: [f64; 2]) -> TransducerConfig {
        let ForceSensorEmulator { offset, noise, drift, temperature, .. } = sensor.emulator;
        let seed = Stream::Force(number).seed(self.file);
        let scaled = |values: [f64; 6]| std::array::from_fn(|channel| values[channel] * gain[channel / 3].abs());
        TransducerConfig {
            gain: std::array::from_fn(|channel| gain[channel / 3]),
            range: scaled(sensor.ranges()),
            offset: scaled(offset),
            noise: scaled(noise),
            drift: scaled(drift),
            temperature: temperature.map_or(TemperatureCourse::CONSTANT, |given| TemperatureCourse {
                start: given.start,
                end: given.end,
                time_constant: Duration::from_secs_f64(given.time_constant_s),
            }),
            seed,
        }
    }
}

/// A sensor whose cable breaks at a given time.
pub(crate) struct Unplugged<D> {
    device: D,
    from: Instant,
}

impl<D> Unplugged<D> {
    /// A sensor whose cable breaks `at` seconds after power-on.
    pub(crate) fn new(device: D, at: f64) -> Self {
        Self { device, from: Instant::ZERO + Duration::from_secs_f64(at) }
    }
}

impl<D: LineDevice> LineDevice for Unplugged<D> {
    fn receive(&mut self, byte: u8, now: Instant) {
        if now < self.from {
            self.device.receive(byte, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        self.device.poll_transmit(now).filter(|_| now < self.from)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.device.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.device.handle_timeout(now);
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.device.mechanism()
    }
}

impl<D: Device> Device for Unplugged<D> {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        if now < self.from {
            self.device.handle(frame, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.device.poll_transmit(now).filter(|_| now < self.from)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.device.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.device.handle_timeout(now);
    }

    fn mechanism(&self) -> Option<&Mechanism> {
        self.device.mechanism()
    }
}

/// Process data of force sensors that the emulated node lacks. The node has the objects of `force-sensor-emulated.eds`.
pub(super) fn problems(file: &CellFile) -> impl Iterator<Item = anyhow::Error> {
    let sensors = file.cell.force_sensor.iter().enumerate();
    let nodes = sensors.filter_map(|(number, sensor)| Some((number, sensor.can.as_ref()?, sensor.node_config()?)));
    nodes.flat_map(move |(number, can, config)| {
        let path = Path::to("force_sensor").then(number).then("can");
        let other = can.device_type.filter(|kind| *kind != 0).map(|kind| {
            let why = format!("is {kind:#x}, and the emulated sensor has 0: leave it out without hardware");
            file.refuse(&path.then("device_type"), why)
        });
        let fields = can.pdo.iter().zip(config.pdos).enumerate().flat_map(|(pdo, (given, config))| {
            let fields = given.field.iter().zip(config.fields).enumerate();
            let unknown = fields.filter(|(_, (field, config))| !is_emulated(field, config.content));
            let places: Vec<_> = unknown.map(|(field, _)| (pdo, field)).collect();
            places
        });
        let fields = fields.map(|(pdo, field)| {
            let place = path.then("pdo").then(pdo).then("field").then(field);
            file.refuse(&place, "is no object of the emulated sensor: force-sensor-emulated.eds lists its objects")
        });
        other.into_iter().chain(fields).collect::<Vec<_>>()
    })
}

/// Whether the emulated node has the object of a field with this content.
fn is_emulated(field: &SensorField, content: Content) -> bool {
    let object = (field.index, field.subindex, field.bytes);
    match content {
        Content::I16(axis) => object == (0x2000, axis as u8 + 1, 2),
        Content::I32(axis) => object == (0x2001, axis as u8 + 1, 4),
        Content::Status { .. } => object == (0x2002, 0, 2),
        Content::Counter { .. } => false,
        Content::Ignored { .. } => field.content == FieldContent::Ignored && object == (0x2005, 0, 2),
    }
}
