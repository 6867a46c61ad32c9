//! Force/torque sensors: this project's drivers on the emulated sensors, at a serial line and on the bus of a drive, in
//! virtual time.

use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use ::mrroc::cell::{Cell, DriveControl};
use can::timing::Bitrate;
use can::{Instant, VirtualPort};
use canopen::pdo::PdoNumber;
use canopen::{NodeId, Object, cob};
use drive::bus::CanBus;
use drive::cia402::{self, Identity};
use drive::wrench::{
    Channel, Content, SerialWrenchConfig, SerialWrenchSensor, Trigger, WrenchAxis, WrenchConfig, WrenchError,
    WrenchFault, WrenchField, WrenchLink, WrenchNodeConfig, WrenchPdo, WrenchState, ZeroMethod,
};
use drive::{AxisCommand, AxisState, BringUpError, DriveGroup};
use hil::plant::Irp6Axis;
use hil::{
    AxisConfig, CanForceSensor, CanForceSensorConfig, DeviceId, Epos4, Epos4Config, LineFaults, LineId,
    SerialForceSensor, SerialForceSensorConfig, Stuck, TransducerConfig, WireFaults, World, WrenchProbe,
};
use kit::mrroc::text;
use serial::VirtualLine;

use crate::host_closed::closed_by_host;

const PERIOD: Duration = Duration::from_millis(2);

/// Node-ID of the sensor on the bus.
const NODE: u8 = 40;

/// Counts of the emulated sensors: on the line, and 16 bits on the bus, N and N·m.
const ON_LINE: [f64; 2] = [10.0 / 115.0, 5.0 / 940.0];

const ON_BUS: [f64; 2] = [0.02, 0.001];

/// Change of the load with time, N/s and N·m/s. In a period, the load changes by more than two counts of each sensor.
const RAMP: [f64; 2] = [100.0, 8.0];

const RAMP_TIME: Duration = Duration::from_millis(250);

/// Longest time of SYNC on the bus. The emulated sensor samples at the end of SYNC.
const SYNC_FRAME: Duration = Duration::from_micros(55);

/// A load that the tests change. Each component changes with time, so that a reading has the time of its sample.
#[derive(Clone, Default)]
pub(crate) struct Load(Arc<Mutex<[f64; 6]>>);

impl Load {
    pub(crate) fn set(&self, load: [f64; 6]) {
        *self.0.lock().unwrap() = load;
    }

    /// The wrench at `now`: the load that was set, and a [`RAMP`] that begins again each [`RAMP_TIME`].
    fn at(&self, now: Instant) -> [f64; 6] {
        let since = Duration::from_nanos(now.as_nanos() % RAMP_TIME.as_nanos() as u64).as_secs_f64();
        let load = *self.0.lock().unwrap();
        std::array::from_fn(|axis| load[axis] + RAMP[axis / 3] * since)
    }
}

impl WrenchProbe for Load {
    fn wrench(&mut self, now: Instant) -> [f64; 6] {
        self.at(now)
    }
}

/// Asserts that the wrench agrees with the load at the time of the sample, within half a count of each channel. The
/// sample may be `late`.
#[track_caller]
fn is_of_its_time(state: &WrenchState, load: &Load, count: [f64; 2], late: Duration) {
    let truth = load.at(state.sampled);
    for (axis, (found, truth)) in state.wrench.into_iter().zip(truth).enumerate() {
        let error = count[axis / 3] / 2.0 + RAMP[axis / 3] * late.as_secs_f64() + 1e-6;
        assert!((found - truth).abs() <= error, "{axis}: {found}, expected {truth} ± {error}, in {state:?}");
    }
}

/// A driver on an emulated sensor.
pub(crate) struct Stage<G> {
    pub(crate) world: World,
    group: G,
    link: WrenchLink,
    pub(crate) load: Load,
    pub(crate) states: Vec<AxisState>,
    pub(crate) now: Instant,
}

impl<G: DriveGroup> Stage<G> {
    fn pass(&mut self) {
        self.now += PERIOD;
        self.world.advance(self.now);
    }

    pub(crate) fn bring_up(&mut self) -> Result<(), BringUpError> {
        loop {
            match self.group.bring_up(self.now) {
                Poll::Pending => self.pass(),
                Poll::Ready(ended) => break ended,
            }
        }
    }

    fn cycle(&mut self) -> WrenchState {
        self.group.read(self.now, &mut self.states);
        let commands = vec![AxisCommand::Off; self.states.len()];
        self.group.write(self.now, &commands);
        assert!(self.group.send(self.now));
        let state = self.link.read();
        assert_eq!(state.at, self.now);
        self.pass();
        state
    }

    fn cycles(&mut self, count: usize) -> Vec<WrenchState> {
        (0..count).map(|_| self.cycle()).collect()
    }

    /// Number of cycles until a fault, and the state with the fault.
    fn until_fault(&mut self) -> (usize, WrenchState) {
        let states = (1..1_000).map(|cycle| (cycle, self.cycle()));
        states.into_iter().find(|(_, state)| state.fault.is_some()).expect("a fault within 1000 cycles")
    }
}

fn on_line(line: fn(&mut World, SerialForceSensor) -> LineId) -> (Stage<SerialWrenchSensor<VirtualLine>>, LineId) {
    let (mut world, load) = (World::new(), Load::default());
    let emulated = SerialForceSensorConfig::new(TransducerConfig::default());
    let device = SerialForceSensor::new(emulated, Box::new(load.clone())).unwrap();
    let id = line(&mut world, device);
    let host = world.host_line(id, 4096);
    let (group, link) = SerialWrenchSensor::new(host, SerialWrenchConfig::new(PERIOD)).unwrap();
    (Stage { world, group, link, load, states: Vec::new(), now: Instant::ZERO }, id)
}

fn card(world: &mut World, device: SerialForceSensor) -> LineId {
    world.add_line(SerialForceSensor::SETTINGS, None, Box::new(device))
}

#[test]
fn a_wrench_of_the_serial_sensor_is_that_of_its_time_in_every_cycle() {
    let (mut stage, _) = on_line(card);
    // Bring-up discards the text after power-on.
    assert_eq!(stage.bring_up(), Ok(()));
    stage.cycles(2);
    for load in [[0.0; 6], [10.0, -20.0, 30.0, 1.0, -2.0, 2.5], [-60.0, 35.0, -120.0, -4.5, 2.0, 0.0]] {
        stage.load.set(load);
        stage.cycle();
        for state in stage.cycles(500) {
            assert_eq!((state.age, state.fault), (0, None));
            // The query was sent a period ago and takes one byte.
            assert_eq!(state.at.since(state.sampled), PERIOD - Duration::from_nanos(86_806), "{state:?}");
            is_of_its_time(&state, &stage.load, ON_LINE, Duration::ZERO);
        }
    }
    let counters = stage.group.sensor_counters();
    assert_eq!((counters.samples, counters.missing, counters.garbage, counters.late), (1_504, 0, 0, 0));
}

#[test]
fn faults_of_the_line_of_the_serial_sensor_have_their_types() {
    let deaf = LineFaults {
        to_host: WireFaults { stuck: Some(Stuck::Silent), ..WireFaults::default() },
        ..LineFaults::default()
    };
    let torn =
        LineFaults { seed: 7, to_host: WireFaults { tear: 0.3, ..WireFaults::default() }, ..LineFaults::default() };
    let (mut stage, line) = on_line(card);
    assert_eq!(stage.bring_up(), Ok(()));
    let last = *stage.cycles(20).last().unwrap();
    stage.world.line_mut(line).set_faults(&deaf);
    let (_, state) = stage.until_fault();
    assert_eq!((state.fault, state.age, state.measured()), (Some(WrenchFault::Silent { cycles: 4 }), 4, None));
    assert!(state.sampled.since(last.sampled) <= PERIOD, "{last:?} {state:?}");
    stage.world.line_mut(line).set_faults(&LineFaults::default());
    stage.cycles(5);
    stage.link.reset_fault();
    assert_eq!(stage.cycles(2)[1].fault, None);
    stage.world.line_mut(line).set_faults(&torn);
    let (_, state) = stage.until_fault();
    assert!(matches!(state.fault, Some(WrenchFault::Garbage { .. })), "{state:?}");
    stage.world.line_mut(line).set_faults(&LineFaults::default());
    stage.cycles(5);
    stage.link.reset_fault();
    stage.cycles(3);
    // Beyond 65 N, where the transducer of the emulator still measures.
    stage.load.set([0.0, -100.0, 0.0, 0.0, 0.0, 0.0]);
    let (cycles, state) = stage.until_fault();
    assert!(matches!(state.fault, Some(WrenchFault::Saturated { axis: WrenchAxis::Fy, counts: ..=-747 })), "{state:?}");
    // The first sample with the load, the tolerated one and the fault.
    assert_eq!((cycles, state.age), (3, 2));
    stage.world.line_mut(line).hang_up();
    stage.link.reset_fault();
    // The fault before stays until the sensor or the line shows another.
    let state = *stage.cycles(5).last().unwrap();
    assert_eq!(state.fault, Some(WrenchFault::Line(serial::LineError::Gone)));
}

#[test]
fn an_adapter_with_the_usual_latency_is_refused_with_the_remedy() {
    let (mut stage, _) = on_line(|world, device| {
        world.add_line(SerialForceSensor::SETTINGS, Some(Duration::from_millis(16)), Box::new(device))
    });
    match stage.bring_up() {
        Err(BringUpError::WrenchLine { error: error @ WrenchError::Late { .. } }) => {
            assert!(error.to_string().contains("latency timer"), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

pub(crate) fn sensor(trigger: Trigger) -> WrenchNodeConfig {
    let node = NodeId::new(NODE).unwrap();
    let emulated = CanForceSensorConfig::new(node, TransducerConfig::default());
    let field = |axis| WrenchField { object: Object::new(0x2000, axis as u8 + 1), content: Content::I16(axis) };
    // One bit per saturated channel.
    let status = WrenchField { object: Object::new(0x2002, 0), content: Content::Status { bytes: 2, errors: 0x3F } };
    let pdo = |number, fields| WrenchPdo { number, cob_id: cob::tpdo(number, node), fields, mapped: true };
    let (forces, torques) = WrenchAxis::ALL.split_at(3);
    let [mut forces, torques] = [forces, torques].map(|axes| axes.iter().copied().map(field).collect::<Vec<_>>());
    forces.push(status);
    let channel = |axis: usize| Channel { scale: ON_BUS[axis / 3], range: 32_767 };
    WrenchNodeConfig {
        node,
        identity: Some(Identity { vendor: emulated.vendor, product: Some(emulated.product), revision: None }),
        device_type: Some(0),
        sensor: WrenchConfig {
            channels: std::array::from_fn(channel),
            tolerated_missing: 3,
            tolerated_saturated: 0,
            zero: ZeroMethod::Host { samples: 10 },
        },
        trigger,
        pdos: vec![pdo(PdoNumber::One, forces), pdo(PdoNumber::Two, torques)],
        configuration: Vec::new(),
    }
}

pub(crate) const SYNC: Trigger = Trigger::Sync { every: 1 };

/// A sensor on a bus, beside a drive or without one.
pub(crate) fn on_bus(config: &WrenchNodeConfig, with_drive: bool) -> (Stage<CanBus<VirtualPort>>, DeviceId) {
    let mut cell = Cell::parse(&text("irb6")).unwrap();
    // The emulated drive has the motor data of the velocity loop.
    closed_by_host(&mut cell.robot[0].axis[0], Irp6Axis::Column, DriveControl::Velocity);
    let (mut world, load) = (World::new(), Load::default());
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let port = world.host_port(bus, 256);
    let axis = &cell.robot[0].axis[0];
    let mut axes: Vec<cia402::AxisConfig> = Vec::new();
    if with_drive {
        let drive = Epos4Config::new(NodeId::new(axis.node).unwrap(), AxisConfig::irp6(Irp6Axis::Column));
        world.add_device(bus, Box::new(Epos4::new(drive)));
        axes.push(axis.drive_config(0.0));
    }
    let emulated = CanForceSensorConfig::new(config.node, TransducerConfig::default());
    let device = world.add_device(bus, Box::new(CanForceSensor::new(emulated, Box::new(load.clone())).unwrap()));
    let group = cell.group_config(0);
    assert_eq!(group.period, PERIOD);
    let (group, _, links) = CanBus::with_sensors(port, group, &axes, &[], std::slice::from_ref(config)).unwrap();
    let states = vec![AxisState::default(); axes.len()];
    let link = links.into_iter().next().unwrap();
    (Stage { world, group, link, load, states, now: Instant::ZERO }, device)
}

#[test]
fn a_wrench_of_the_sensor_on_a_bus_is_that_of_its_sync() {
    for with_drive in [true, false] {
        let (mut stage, _) = on_bus(&sensor(SYNC), with_drive);
        assert_eq!(stage.bring_up(), Ok(()), "with drive: {with_drive}");
        stage.cycles(3);
        for load in [[0.0; 6], [10.0, -20.0, 30.0, 1.0, -2.0, 3.0], [-100.0, 100.0, -380.0, -9.0, 7.0, 0.0]] {
            stage.load.set(load);
            stage.cycles(2);
            for state in stage.cycles(500) {
                assert_eq!((state.age, state.fault), (0, None));
                assert_eq!(state.at.since(state.sampled), PERIOD, "{state:?}");
                is_of_its_time(&state, &stage.load, ON_BUS, SYNC_FRAME);
            }
        }
        assert!(stage.states.iter().all(|state| state.fault.is_none()));
        assert_eq!(stage.group.counters().unexpected, 0);
    }
}

#[test]
fn the_sensor_on_a_bus_samples_at_every_fifth_sync_or_by_its_timer() {
    let (mut stage, _) = on_bus(&sensor(Trigger::Sync { every: 5 }), true);
    assert_eq!(stage.bring_up(), Ok(()));
    stage.cycles(10);
    let states = stage.cycles(100);
    for state in &states {
        assert_eq!(state.fault, None);
        is_of_its_time(state, &stage.load, ON_BUS, SYNC_FRAME);
    }
    assert_eq!(states.iter().filter(|state| state.age == 0).count(), 20);
    assert_eq!(states.iter().map(|state| state.age).max(), Some(4));
    let (mut stage, _) = on_bus(&sensor(Trigger::EventTimer(Duration::from_millis(5))), false);
    assert_eq!(stage.bring_up(), Ok(()));
    stage.cycles(10);
    let states = stage.cycles(1_000);
    // Two seconds have 400 samples.
    assert!(states.iter().all(|state| state.fault.is_none() && state.age <= 3));
    assert!(states.iter().filter(|state| state.age == 0).count().abs_diff(400) <= 1);
}

#[test]
fn the_sensor_on_a_bus_is_zeroed_by_the_mean_of_ten_samples() {
    let (mut stage, _) = on_bus(&sensor(SYNC), true);
    assert_eq!(stage.bring_up(), Ok(()));
    stage.load.set([10.0, -20.0, 30.0, 1.0, -2.0, 3.0]);
    stage.cycles(3);
    // The ramp does not begin again during the zeroing.
    while stage.now.as_nanos() % RAMP_TIME.as_nanos() as u64 > 100_000_000 {
        stage.cycle();
    }
    let request = stage.link.zero();
    let states = stage.cycles(12);
    let done: Vec<_> = states.iter().map(|state| state.zeroing.is_done(request)).collect();
    assert_eq!(done.iter().position(|done| *done), Some(10), "{done:?}");
    // The mean of the ramp over ten samples is the value in their middle, four and a half periods before the last
    // sample.
    let [last, middle] = [states[10].wrench[0], RAMP[0] * 4.5 * PERIOD.as_secs_f64()];
    assert!((last - middle).abs() <= ON_BUS[0], "{last} {middle}");
}

#[test]
fn faults_of_the_sensor_on_a_bus_have_their_types_and_do_not_stop_the_drive() {
    let (mut stage, device) = on_bus(&sensor(SYNC), true);
    assert_eq!(stage.bring_up(), Ok(()));
    stage.cycles(20);
    stage.load.set([0.0, 0.0, 0.0, 0.0, -20.0, 0.0]);
    let (_, state) = stage.until_fault();
    // Channel Ty.
    assert_eq!((state.fault, state.measured()), (Some(WrenchFault::Status { status: 1 << 4 }), None));
    stage.load.set([0.0; 6]);
    stage.cycles(3);
    stage.link.reset_fault();
    assert_eq!(stage.cycles(2)[1].fault, None);
    let now = stage.now;
    stage.world.change(device, now, |sensor: &mut CanForceSensor| sensor.set_power(false, now)).unwrap();
    let (_, state) = stage.until_fault();
    assert_eq!((state.fault, state.age), (Some(WrenchFault::Silent { cycles: 4 }), 4));
    assert_eq!(stage.states[0].fault, None);
}

#[test]
fn a_sensor_that_is_absent_or_another_one_ends_bring_up_with_its_node() {
    let (mut stage, device) = on_bus(&sensor(SYNC), false);
    stage
        .world
        .change(device, stage.now, |sensor: &mut CanForceSensor| sensor.set_power(false, Instant::ZERO))
        .unwrap();
    match stage.bring_up() {
        Err(BringUpError::WrenchNode { node: NODE, error: WrenchError::Absent { .. } }) => {}
        other => panic!("{other:?}"),
    }
    let identity = Identity { vendor: 0, product: Some(0x1234), revision: None };
    let other = WrenchNodeConfig { identity: Some(identity), ..sensor(SYNC) };
    let found = on_bus(&other, true).0.bring_up();
    let expected = BringUpError::WrongIdentity { node: NODE, subindex: 2, expected: 0x1234, found: 0x0F76 };
    assert_eq!(found, Err(expected));
    let other = WrenchNodeConfig { device_type: Some(0x0002_0194), ..sensor(SYNC) };
    let found = on_bus(&other, true).0.bring_up();
    let error = WrenchError::OfAnotherType { expected: 0x0002_0194, found: 0 };
    assert_eq!(found, Err(BringUpError::WrenchNode { node: NODE, error }));
}
