//! Emulated nodes on a bus without a driver: whatever is sent to them, their shafts stay finite and time goes on.

use std::sync::LazyLock;
use std::time::Duration;

use arbitrary::{Arbitrary, Result, Unstructured};
use can::timing::Bitrate;
use can::{Instant, Port, VirtualPort};
use hil::{
    BusId, CanForceSensor, CanForceSensorConfig, DeviceId, DigitalIo, DigitalIoConfig, Epos4, TransducerConfig, World,
    WrenchProbe,
};
use mrroc::bench::emulation;
use mrroc::cell::CellFile;

use crate::frames::{AnyFrame, MODULE, SENSOR, empty};

/// The cell of the drives.
pub(crate) static CELL: LazyLock<CellFile> = LazyLock::new(|| of_example("irb6"));

/// An example cell.
pub(crate) fn of_example(name: &str) -> CellFile {
    let path = format!("{}/../../cells/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    CellFile::read(path).expect("the examples are sound")
}

/// A load that swings.
pub(crate) struct Load;

impl WrenchProbe for Load {
    fn wrench(&mut self, now: Instant) -> [f64; 6] {
        let phase = now.since(Instant::ZERO).as_secs_f64();
        std::array::from_fn(|axis| 2.0 * (phase + axis as f64).sin())
    }
}

/// A drive, an I/O module and a force/torque sensor on a bus.
pub(crate) struct Nodes {
    pub(crate) world: World,
    pub(crate) bus: BusId,
    pub(crate) drive: DeviceId,
    pub(crate) module: DeviceId,
    pub(crate) sensor: DeviceId,
}

impl Nodes {
    pub(crate) fn new() -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let drive = emulation::config(&CELL, 0, 0, Instant::ZERO);
        let drive = world.add_device(bus, Box::new(Epos4::new(drive)));
        let module = world.add_device(bus, Box::new(DigitalIo::new(DigitalIoConfig::new(MODULE)).unwrap()));
        let sensor = CanForceSensorConfig::new(SENSOR, TransducerConfig::default());
        let sensor = world.add_device(bus, Box::new(CanForceSensor::new(sensor, Box::new(Load)).unwrap()));
        Self { world, bus, drive, module, sensor }
    }

    /// All shafts are where a shaft can be.
    pub(crate) fn check(&self) {
        let drive: &Epos4 = self.world.device(self.drive).unwrap();
        let axis = drive.axis();
        assert!(axis.angle().is_finite() && axis.velocity().is_finite(), "{} {}", axis.angle(), axis.velocity());
    }
}

/// A host that sends arbitrary frames.
pub fn can_devices(data: &[u8]) {
    let mut nodes = Nodes::new();
    let mut port = nodes.world.host_port(nodes.bus, 256);
    let mut now = Instant::ZERO + Duration::from_millis(60);
    nodes.world.advance(now);
    let _ = converse(&mut nodes, &mut port, &mut now, &mut Unstructured::new(data));
    nodes.check();
}

fn converse(nodes: &mut Nodes, port: &mut VirtualPort, now: &mut Instant, input: &mut Unstructured) -> Result<()> {
    let mut into = [empty(); 64];
    for _ in 0..200 {
        if input.is_empty() {
            break;
        }
        let AnyFrame(frame) = AnyFrame::arbitrary(input)?;
        let wait = match u8::arbitrary(input)? {
            short @ ..240 => Duration::from_micros(u64::from(short) * 20),
            long => Duration::from_millis(u64::from(long - 239) * 20),
        };
        let _ = port.send(*now, &[frame]);
        *now += wait;
        nodes.world.advance(*now);
        while port.receive(*now, &mut into).is_ok_and(|count| count == into.len()) {}
        nodes.check();
    }
    Ok(())
}
