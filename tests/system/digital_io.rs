//! A CiA 401 module on the bus of a drive: this project's owner of the bus against the emulated module, alone and in an
//! example cell.

use std::task::Poll;
use std::time::Duration;

use ::mrroc::cell::{Bus, Cell, CellFile, DriveControl};
use can::Instant;
use can::timing::Bitrate;
use canopen::NodeId;
use drive::bus::CanBus;
use drive::cia401::{IoConfig, IoFault, IoLink};
use drive::cia402::Identity;
use drive::{AxisCommand, AxisState, DriveGroup};
use hil::plant::Irp6Axis;
use hil::{AxisConfig, DeviceId, DigitalIo, DigitalIoConfig, Epos4, Epos4Config, World};
use kit::mrroc::{Directory, mrroc, text};
use kit::refusals::refused;
use kit::touch_cell::TouchCell;
use servo::lockstep;

use crate::host_closed::closed_by_host;

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
        Self::up_with(|_| {})
    }

    /// As [`up`](Self::up), with a changed configuration of the module's host.
    fn up_with(change: impl FnOnce(&mut IoConfig)) -> Self {
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
        let mut io = IoConfig {
            node,
            identity: Identity { vendor: emulated.vendor, product: Some(emulated.product), revision: None },
            inputs: 8,
            outputs: 8,
            inhibit_time: Duration::from_millis(1),
            event_timer: Duration::from_millis(100),
            inverted_inputs: 0,
            emergency_inputs: 0,
            filtered_inputs: 0,
            inverted_outputs: 0,
            // Output 7 keeps its level.
            error_mode: 0x7F,
            error_value: 0x02,
            configuration: Vec::new(),
        };
        change(&mut io);
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

#[test]
fn a_module_that_lost_its_supply_works_again_after_a_reset_while_the_axis_goes_on() {
    let mut stage = Stage::up();
    stage.link.outputs.set_all(0xC1);
    stage.cycles(3);
    for on in [false, true] {
        let now = stage.now;
        stage.act(|module| module.set_power(on, now));
        let until = stage.now + Duration::from_millis(400);
        while stage.now < until {
            stage.cycles(1);
        }
    }
    assert!(stage.link.inputs.read().fault.is_some());
    stage.link.reset_fault();
    let until = stage.now + Duration::from_secs(5);
    while let Some(fault) = stage.link.inputs.read().fault {
        stage.cycles(1);
        assert!(stage.now < until, "{fault}");
    }
    stage.cycles(3);
    // Output 7 keeps its level, the others have their error values, and then commands and edges are as before.
    assert_eq!(stage.outputs(), 0x82);
    stage.link.outputs.set_all(0x84);
    let at = stage.now;
    stage.act(|module| module.set_input(at, 5, true)).unwrap();
    stage.cycles(5);
    assert_eq!(stage.outputs(), 0x84);
    let input = stage.link.inputs.read().input(5).unwrap();
    assert_eq!((input.level, input.edges), (true, 1));
    assert_eq!(stage.states[0].fault, None);
}

#[test]
fn a_module_with_outputs_alone_that_falls_silent_has_a_lost_heartbeat() {
    let mut stage = Stage::up_with(|io| io.inputs = 0);
    assert_eq!(stage.link.inputs.read().fault, None);
    let now = stage.now;
    stage.act(|module| module.set_power(false, now));
    let until = stage.now + 4 * stage.heartbeat;
    while stage.now < until {
        stage.cycles(1);
    }
    let fault = stage.link.inputs.read().fault;
    assert!(matches!(fault, Some(IoFault::HeartbeatLost { node: NODE, .. })), "{fault:?}");
    // The axis goes on.
    assert_eq!(stage.states[0].fault, None);
}

#[test]
fn inverted_lines_are_inverted_at_the_terminals_in_operation_and_in_the_error_state() {
    let mut stage = Stage::up_with(|io| (io.inverted_inputs, io.inverted_outputs) = (0x01, 0x03));
    // The error value 0x02 before the first command.
    assert_eq!(stage.outputs(), 0x01);
    let image = stage.link.inputs.read();
    assert_eq!([0, 1].map(|number| image.input(number).unwrap().level), [true, false]);
    stage.link.outputs.set_all(0x80);
    stage.cycles(3);
    assert_eq!(stage.outputs(), 0x83);
    let end = stage.now + 4 * stage.heartbeat;
    while stage.now < end {
        stage.pass();
    }
    // Output 1 is true, and so low; output 0 is false, and so high; output 7 keeps its level.
    assert_eq!(stage.outputs(), 0x81);
}

#[test]
fn a_refusal_of_an_io_node_names_the_node_and_the_object() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-touch", |cell| cell.io[0].parameter[0].index = 0x2100);
    let run = mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref()]);
    refused(&run, &["bus arm, I/O node tool: node 40: 0x2100:00 refused 0x", "object does not exist"]);
}

#[test]
fn io_nodes_on_a_bus_of_their_own_work_as_those_beside_drives() {
    let directory = Directory::new();
    let cell = directory.cell("irb6-touch", |cell| {
        let bus = Bus { name: "cabinet".into(), interface: "can1".into(), ..cell.bus[0].clone() };
        cell.bus.push(bus);
        cell.io[0].bus = "cabinet".into();
    });
    for arguments in [["check", "--json"], ["run", "--bench=lockstep"]] {
        let output = mrroc([arguments[0].as_ref(), cell.as_os_str(), arguments[1].as_ref()]);
        assert!(output.status.success(), "{arguments:?}: {}", output.stderr);
        // Only the drives need SYNC.
        if arguments[0] == "check" {
            let report = output.json();
            let syncs = report["buses"].as_array().unwrap().iter().map(|bus| {
                let messages = bus["messages"].as_array().unwrap();
                (bus["name"].as_str().unwrap(), messages.iter().filter(|message| message["what"] == "SYNC").count())
            });
            assert_eq!(syncs.collect::<Vec<_>>(), [("arm", 1), ("cabinet", 0)]);
        }
    }
    let mut file = CellFile::read(cell).unwrap();
    file.cell.io[0].input[0].emulated_edges_s = vec![0.0, 4.0001];
    let mut touch = TouchCell::of(file);
    let start = lockstep::bring_up(&mut touch.servo, Instant::ZERO, |next| touch.emulation.advance(next)).unwrap();
    let end = start + Duration::from_secs(4);
    let advance = |next| touch.emulation.advance(next);
    lockstep::run(&mut touch.servo, start, |_| {}, advance, |_, now| now > end);
    assert_eq!(touch.probe.inputs.read().input(0).map(|input| (input.level, input.edges)), Some((true, 1)));
}

#[test]
fn scheduled_edges_of_a_cell_are_seen_within_two_periods_and_the_inhibit_time() {
    let edges = [0.0, 4.0001, 4.0149, 4.5007, 5.0, 5.0063];
    let TouchCell { file, mut emulation, mut servo, _links, probe } = TouchCell::with_edges(&edges);
    let period = file.cell.period();
    let within = 2 * period + file.cell.io_configs(0)[0].inhibit_time;
    let at = |seconds: f64| Instant::ZERO + Duration::from_secs_f64(seconds);
    let start = lockstep::bring_up(&mut servo, Instant::ZERO, |next| emulation.advance(next)).unwrap();
    assert!(start < at(edges[1]), "{start:?}");
    let mut seen = Vec::new();
    let look = |_| {
        let image = probe.inputs.read();
        let input = image.input(0).expect("no fault");
        if input.edges > seen.len() as u64 {
            seen.push((image.at, input));
        }
    };
    let end = at(5.1);
    lockstep::run(&mut servo, start, look, |next| emulation.advance(next), |_, now| now > end);
    // The first edge came before the end of bring-up.
    assert_eq!(seen.len(), edges.len() - 1);
    for (number, ((seen, input), edge)) in seen.into_iter().zip(&edges[1..]).enumerate() {
        // The probe is inverted: its terminal is high from the first edge on.
        assert_eq!((input.edges, input.level), (number as u64 + 1, number % 2 == 0));
        let (edge, stamp) = (at(*edge), input.last_edge.unwrap());
        assert!(edge < stamp && stamp < seen && seen.since(edge) <= within, "{edge:?} {stamp:?} {seen:?}");
    }
    assert_eq!(probe.inputs.read().fault, None);
    drop(servo);
    assert_eq!(probe.inputs.read().fault, Some(IoFault::Ended { node: 40 }));
}
