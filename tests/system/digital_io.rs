//! A CiA 401 module on the bus of a drive: this project's owner of the bus against the emulated module.

use std::task::Poll;
use std::time::Duration;

use ::mrroc::cell::{Cell, DriveControl};
use can::Instant;
use can::timing::Bitrate;
use canopen::NodeId;
use drive::bus::CanBus;
use drive::cia401::{IoConfig, IoFault, IoLink};
use drive::cia402::Identity;
use drive::{AxisCommand, AxisState, DriveGroup};
use hil::plant::Irp6Axis;
use hil::{AxisConfig, DeviceId, DigitalIo, DigitalIoConfig, Epos4, Epos4Config, World};

use crate::host_closed::closed_by_host;
use crate::mrroc::text;

/// Node-ID of the module.
const NODE: u8 = 40;

/// A drive, a module of eight inputs and eight outputs, and their host, in virtual time.
struct Stage {
    world: World,
    module: DeviceId,
    bus: CanBus<can::VirtualPort>,
    link: IoLink,
    states: [AxisState; 1],
    period: Duration,
    heartbeat: Duration,
    now: Instant,
}

impl Stage {
    /// The stage with both nodes up and 20 cycles done.
    fn up() -> Self {
        let mut cell = Cell::parse(&text("irb6")).unwrap();
        // The emulated drive of this axis has the motor data of the velocity loop.
        closed_by_host(&mut cell.robot[0].axis[0], Irp6Axis::Column, DriveControl::Velocity);
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::from_kbps(cell.bus[0].bitrate_kbps).unwrap());
        let port = world.host_port(bus, 256);
        let axis = &cell.robot[0].axis[0];
        let drive = Epos4Config::new(NodeId::new(axis.node).unwrap(), AxisConfig::irp6(Irp6Axis::Column));
        world.add_device(bus, Box::new(Epos4::new(drive)));
        let node = NodeId::new(NODE).unwrap();
        let emulated = DigitalIoConfig::new(node);
        let io = IoConfig {
            node,
            identity: Identity { vendor: emulated.vendor, product: Some(emulated.product), revision: None },
            inputs: 8,
            outputs: 8,
            inhibit_time: Duration::from_millis(1),
            event_timer: Duration::from_millis(100),
            // Output 7 keeps its level.
            error_mode: 0x7F,
            error_value: 0x02,
        };
        let module = world.add_device(bus, Box::new(DigitalIo::new(emulated).unwrap()));
        let config = cell.group_config(0);
        let (bus, links) = CanBus::with_io(port, config, &[axis.drive_config(0.0)], &[io]).unwrap();
        let mut stage = Self {
            world,
            module,
            bus,
            link: links[0].clone(),
            states: [AxisState::default()],
            period: config.period,
            heartbeat: config.heartbeat_period,
            now: Instant::ZERO,
        };
        loop {
            match stage.bus.bring_up(stage.now) {
                Poll::Pending => stage.pass(),
                Poll::Ready(ended) => break assert_eq!(ended, Ok(())),
            }
        }
        stage.cycles(20);
        stage
    }

    fn pass(&mut self) {
        self.now += self.period;
        self.world.advance(self.now);
    }

    fn cycles(&mut self, count: u32) {
        for _ in 0..count {
            self.bus.read(self.now, &mut self.states);
            self.bus.write(self.now, &[AxisCommand::Off]);
            self.bus.send(self.now);
            self.pass();
        }
    }

    /// Levels of the outputs of the module.
    fn outputs(&self) -> u64 {
        let module: &DigitalIo = self.world.device(self.module).unwrap();
        module.outputs()
    }

    /// Acts on the module itself, now.
    fn act<R>(&mut self, act: impl FnOnce(&mut DigitalIo) -> R) -> R {
        self.world.change(self.module, self.now, act).unwrap()
    }
}

#[test]
fn an_edge_of_the_module_arrives_with_its_time() {
    let mut stage = Stage::up();
    let at = stage.now + Duration::from_micros(700);
    stage.act(|module| module.set_input(at, 3, true)).unwrap();
    stage.cycles(5);
    let image = stage.link.inputs.read();
    let input = image.input(3).unwrap();
    assert_eq!((input.level, input.edges), (true, 1));
    // A frame of one byte takes at most 75 µs at 1 Mbit/s, and waits for a few others.
    let late = input.last_edge.unwrap().since(at);
    assert!(late > Duration::ZERO && late < Duration::from_millis(1), "{late:?}");
    assert_eq!(image.input(2).unwrap().edges, 0);
    // The life sign keeps the inputs valid.
    let second = (Duration::from_secs(1).as_nanos() / stage.period.as_nanos()) as u32;
    stage.cycles(3 * second);
    assert_eq!(stage.link.inputs.read().fault, None);
    assert_eq!(stage.states[0].fault, None);
}

#[test]
fn outputs_follow_the_command_and_take_their_error_state_when_the_host_dies() {
    let mut stage = Stage::up();
    assert_eq!(stage.outputs(), 0x02);
    stage.link.outputs.set_all(0xC1);
    stage.cycles(3);
    assert_eq!(stage.outputs(), 0xC1);
    assert_eq!(stage.link.inputs.read().sent.unwrap().levels, 0xC1);
    let end = stage.now + 4 * stage.heartbeat;
    while stage.now < end {
        stage.pass();
    }
    assert_eq!(stage.outputs(), 0x82);
}

#[test]
fn a_module_without_supply_has_no_levels() {
    let mut stage = Stage::up();
    let now = stage.now;
    stage.act(|module| module.set_power(false, now));
    let until = stage.now + Duration::from_millis(350);
    while stage.now < until {
        stage.cycles(1);
    }
    let image = stage.link.inputs.read();
    assert!(matches!(image.fault, Some(IoFault::InputsSilent { node: NODE, .. })), "{:?}", image.fault);
    assert_eq!(image.input(0), None);
}
