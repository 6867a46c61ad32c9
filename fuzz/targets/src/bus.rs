//! The owner of a CAN bus against emulated nodes, while frames are forged and nodes, wire and controller have faults.

use std::task::Poll;
use std::time::Duration;

use arbitrary::{Arbitrary, Unstructured};
use can::{Instant, VirtualPort};
use canopen::pdo::PdoNumber;
use canopen::{Object, cob};
use drive::bus::CanBus;
use drive::cia401::{IoConfig, IoLink};
use drive::cia402::Identity;
use drive::wrench::{
    Channel, Content, Trigger, WrenchAxis, WrenchConfig, WrenchField, WrenchLink, WrenchNodeConfig, WrenchPdo,
    ZeroMethod,
};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup, Finite, Power, Setpoint};
use hil::{DeviceFault, DriveId, FaultInEffect, FrameFault, Frames, HostFault, PlantFault, WorldFault};

use crate::devices::{CELL, Nodes};
use crate::frames::{AnyFrame, MODULE, SENSOR};

/// Most cycles of an input.
const MOST: u32 = 400;

/// Velocity of the set-points, rad per period.
const STEP: f64 = 0.01;

struct Bench {
    nodes: Nodes,
    bus: CanBus<VirtualPort>,
    io: IoLink,
    wrench: WrenchLink,
    states: [AxisState; 1],
    period: Duration,
    now: Instant,
    cycles: u32,
    faults: Vec<FaultInEffect>,
}

/// A drive, a module and a sensor under their driver.
pub fn can_bus(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let mut bench = Bench::new();
    let in_bring_up = bool::arbitrary(&mut input).unwrap_or_default();
    if in_bring_up {
        let _ = bench.bring_up(&mut input);
    } else {
        bench.bring_up(&mut Unstructured::new(&[])).expect("nothing disturbs this bring-up");
    }
    let _ = bench.disturb(&mut input);
    bench.end();
}

impl Bench {
    fn new() -> Self {
        let mut nodes = Nodes::new();
        let port = nodes.world.host_port(nodes.bus, 256);
        let config = CELL.cell.group_config(0);
        let axis = CELL.cell.robot[0].axis[0].drive_config(0.0);
        let (bus, mut io, mut wrench) = CanBus::with_sensors(port, config, &[axis], &[module()], &[sensor()]).unwrap();
        let (io, wrench) = (io.remove(0), wrench.remove(0));
        Self {
            nodes,
            bus,
            io,
            wrench,
            states: [AxisState::default()],
            period: config.period,
            now: Instant::ZERO,
            cycles: 0,
            faults: Vec::new(),
        }
    }

    /// Brings the bus up with a disturbance per period, as long as there are any. Returns why the nodes are not up.
    fn bring_up(&mut self, input: &mut Unstructured) -> Result<(), BringUpError> {
        // Every wait of the bring-up has a deadline: this is far beyond their sum.
        for _ in 0..60_000 {
            match self.bus.bring_up(self.now) {
                Poll::Ready(Ok(())) => return Ok(()),
                Poll::Ready(Err(error)) => {
                    assert!(!error.to_string().is_empty());
                    return Err(error);
                }
                Poll::Pending => {}
            }
            if !input.is_empty() && bool::arbitrary(input).unwrap_or_default() {
                let _ = self.act(input);
            } else if input.is_empty() {
                self.heal();
            }
            self.pass();
        }
        panic!("the bring-up does not end");
    }

    fn pass(&mut self) {
        self.now += self.period;
        self.nodes.world.advance(self.now);
    }

    fn disturb(&mut self, input: &mut Unstructured) -> arbitrary::Result<()> {
        while self.cycles < MOST && !input.is_empty() {
            if u8::arbitrary(input)? < 128 {
                let command = self.command(input)?;
                for _ in 0..input.int_in_range(1..=20)? {
                    self.cycle(command);
                }
            } else {
                self.act(input)?;
            }
        }
        Ok(())
    }

    fn command(&self, input: &mut Unstructured) -> arbitrary::Result<AxisCommand> {
        let follow = |value| Setpoint::Position(Finite::new(value).unwrap());
        Ok(match input.int_in_range(0..=9_u8)? {
            0 => AxisCommand::Off,
            1 => AxisCommand::ResetFault,
            2..=4 => AxisCommand::Stand,
            5 => AxisCommand::Home,
            6 => AxisCommand::Follow(Setpoint::Torque(Finite::ZERO)),
            7 => {
                AxisCommand::Follow(follow(f64::arbitrary(input).ok().filter(|value| value.is_finite()).unwrap_or(0.0)))
            }
            _ => AxisCommand::Follow(follow(self.states[0].position + STEP)),
        })
    }

    /// One disturbance.
    fn act(&mut self, input: &mut Unstructured) -> arbitrary::Result<()> {
        let (bus, drive) = (self.nodes.bus, DriveId::Node(self.nodes.drive));
        let fault = match input.int_in_range(0..=15_u8)? {
            0..=6 => WorldFault::Foreign { bus, frame: AnyFrame::arbitrary(input)?.0, every: None },
            7 => {
                let every = Some(Duration::from_micros(u64::from(u16::arbitrary(input)?) + 500));
                WorldFault::Foreign { bus, frame: AnyFrame::arbitrary(input)?.0, every }
            }
            8..=9 => WorldFault::Frames {
                bus,
                frames: match input.int_in_range(0..=3_u8)? {
                    0 => Frames::All,
                    1 => Frames::FromHost,
                    2 => Frames::FromNode(1),
                    _ => Frames::FromNode(*input.choose(&[MODULE.raw(), SENSOR.raw()])?),
                },
                fault: match input.int_in_range(0..=4_u8)? {
                    0 => FrameFault::Lost,
                    1 => FrameFault::Late(Duration::from_micros(u64::from(u16::arbitrary(input)?))),
                    2 => FrameFault::Duplicated,
                    3 => FrameFault::Corrupted,
                    _ => FrameFault::Swapped,
                },
                probability: f64::from(u8::arbitrary(input)?) / 255.0,
                count: Some(u32::from(u8::arbitrary(input)?)),
                seed: u64::from(u8::arbitrary(input)?),
            },
            10 => {
                let fault = *input.choose(&[
                    HostFault::BusOff,
                    HostFault::ErrorPassive,
                    HostFault::Down,
                    HostFault::QueueFull,
                    HostFault::Unacknowledged,
                    HostFault::Removed,
                    HostFault::Held,
                ])?;
                WorldFault::Host { bus, fault }
            }
            11 => {
                let device = *input.choose(&[self.nodes.drive, self.nodes.module, self.nodes.sensor])?;
                let fault = *input.choose(&[DeviceFault::Unplugged, DeviceFault::Reset, DeviceFault::PowerOff])?;
                WorldFault::Device { drive: DriveId::Node(device), fault }
            }
            12 => {
                let jump = PlantFault::EncoderJump(i32::arbitrary(input)?);
                let faults = [PlantFault::Blocked, PlantFault::EncoderFrozen, jump, PlantFault::EncoderInverted];
                WorldFault::Plant { drive, fault: *input.choose(&faults)? }
            }
            13 => {
                self.heal();
                return Ok(());
            }
            14 => {
                self.io.outputs.set_all(u64::arbitrary(input)?);
                self.io.reset_fault();
                return Ok(());
            }
            _ => {
                self.wrench.zero();
                self.wrench.reset_fault();
                return Ok(());
            }
        };
        let effect = self.nodes.world.begin_fault(&fault, self.now);
        self.faults.push(effect);
        Ok(())
    }

    /// Ends all faults.
    fn heal(&mut self) {
        for fault in self.faults.drain(..) {
            self.nodes.world.end_fault(&fault, self.now);
        }
    }

    fn cycle(&mut self, command: AxisCommand) {
        self.bus.read(self.now, &mut self.states);
        let [state] = &self.states;
        for value in [state.position, state.velocity, state.torque] {
            assert!(value.is_finite(), "{state:?}");
        }
        assert!(state.sampled <= self.now && state.at <= self.now, "{state:?}");
        if let Some(fault) = state.fault {
            assert!(!fault.to_string().is_empty());
        }
        // A faulted axis never claims to follow.
        assert!(state.fault.is_none() || !state.following, "{state:?}");
        self.bus.write(self.now, &[command]);
        self.bus.send(self.now);
        let wrench = self.wrench.read();
        assert!(wrench.wrench.iter().all(|component| component.is_finite()), "{wrench:?}");
        let image = self.io.inputs.read();
        assert!(image.fault.is_none() || image.input(0).is_none(), "a faulted module has no levels");
        for fault in [wrench.fault.map(|fault| fault.to_string()), image.fault.map(|fault| fault.to_string())] {
            assert!(fault.is_none_or(|fault| !fault.is_empty()));
        }
        self.cycles += 1;
        self.pass();
        self.nodes.check();
    }

    /// After all faults, the drive can be switched off, and its fault is either reset or persists as a fault.
    fn end(&mut self) {
        self.heal();
        for _ in 0..20 {
            self.cycle(AxisCommand::ResetFault);
        }
        for _ in 0..20 {
            self.cycle(AxisCommand::Off);
        }
        let [state] = &self.states;
        assert!(state.fault.is_some() || state.power != Power::On, "{state:?}");
    }
}

fn module() -> IoConfig {
    IoConfig {
        node: MODULE,
        identity: Identity { vendor: 0, product: None, revision: None },
        inputs: 8,
        outputs: 8,
        inhibit_time: Duration::from_millis(1),
        event_timer: Duration::from_millis(100),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        inverted_outputs: 0,
        error_mode: 0x7F,
        error_value: 0x02,
        configuration: Vec::new(),
    }
}

fn sensor() -> WrenchNodeConfig {
    let field = |axis| WrenchField { object: Object::new(0x2000, axis as u8 + 1), content: Content::I16(axis) };
    let status = WrenchField { object: Object::new(0x2002, 0), content: Content::Status { bytes: 2, errors: 0x3F } };
    let pdo = |number, fields| WrenchPdo { number, cob_id: cob::tpdo(number, SENSOR), fields, mapped: true };
    let (forces, torques) = WrenchAxis::ALL.split_at(3);
    let [mut forces, torques] = [forces, torques].map(|axes| axes.iter().copied().map(field).collect::<Vec<_>>());
    forces.push(status);
    let channel = |axis: usize| Channel { scale: [0.02, 0.001][axis / 3], range: 32_767 };
    WrenchNodeConfig {
        node: SENSOR,
        identity: None,
        device_type: None,
        sensor: WrenchConfig {
            channels: std::array::from_fn(channel),
            tolerated_missing: 3,
            tolerated_saturated: 0,
            zero: ZeroMethod::Host { samples: 10 },
        },
        trigger: Trigger::Sync { every: 1 },
        pdos: vec![pdo(PdoNumber::One, forces), pdo(PdoNumber::Two, torques)],
        configuration: Vec::new(),
    }
}
