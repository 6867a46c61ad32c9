//! Handshake of homing with drives on CAN: old results, searches that never begin, and counters that are set late.

use std::f64::consts::TAU;
use std::task::Poll;
use std::time::Duration;

use can::timing::Bitrate;
use can::{Instant, VirtualPort};
use canopen::NodeId;
use canopen::cia402::HomingMethod;
use canopen::objects::EPOS4_HOMING_CURRENT_THRESHOLD;
use drive::bus::CanBus;
use drive::cia402::{AxisConfig, CyclicMode, GroupConfig, HomingConfig, Identity, Purpose, Setting};
use drive::{AxisCommand, AxisState, DriveGroup, Fault, Finite, Homing, Power, Scale, Setpoint};
use hil::plant::{EndStops, PlantConfig, PlantFault, Switch};
use hil::{Device, DeviceId, Epos4, Epos4Config, HomingDeviation, Irp6Axis, World};

const COUNTS: i32 = 4000;
/// Angle of one count, rad.
const COUNT: f64 = TAU / COUNTS as f64;
const NODE: u8 = 2;
/// Limit switches, and end stops behind them, this far from the index pulse, rad.
const LIMIT: f64 = 60.0;
const STOP: f64 = 63.0;
const START: f64 = 20.0;
/// Current that indicates a stop, mA. The homing acceleration needs less.
const STOP_CURRENT: u16 = 6_000;
/// Longest search, and longest change of power or mode.
const LONGEST: Duration = Duration::from_secs(20);

/// An old result that outlives the start bit by 20 ms, or by six periods where these are longer.
fn old_result(period: Duration) -> HomingDeviation {
    HomingDeviation { old_result: Some(Duration::from_millis(20).max(6 * period)), ..HomingDeviation::default() }
}

/// The column of an IRp-6 with its index pulse at 0 rad, its home switch below and limit switches at either end. The
/// motor starts at `start`, rad. A method that feels for a stop finds no limit switch.
fn plant(method: i8, start: f64) -> hil::AxisConfig {
    let switch = |from, to| (method > 0).then_some(Switch { from, to, bounce: 0 });
    let mut axis = hil::AxisConfig::irp6(Irp6Axis::Column).with_home(0.0);
    axis.start_angle = start;
    axis.negative_limit = switch(f64::NEG_INFINITY, -LIMIT);
    axis.positive_limit = switch(LIMIT, f64::INFINITY);
    if let PlantConfig::Physical(motor) = &mut axis.plant {
        motor.end_stops = motor.end_stops.map(|stops| EndStops { negative: -STOP, positive: STOP, ..stops });
    }
    axis
}

/// A drive and its group, without a servo.
struct Rig {
    group: CanBus<VirtualPort>,
    world: World,
    device: DeviceId,
    now: Instant,
    period: Duration,
    state: AxisState,
}

impl Rig {
    fn new(method: i8, period: Duration, homing: HomingDeviation) -> Self {
        Self::starting_at(START, method, period, homing)
    }

    /// A drive whose counter reads zero at the motor angle `start`, rad.
    fn starting_at(start: f64, method: i8, period: Duration, homing: HomingDeviation) -> Self {
        let node = NodeId::new(NODE).unwrap();
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let drive = Epos4Config { homing, rated_torque: Some(0.42), ..Epos4Config::new(node, plant(method, start)) };
        let device = world.add_device(bus, Box::new(Epos4::new(drive)));
        let config = GroupConfig {
            period,
            tolerated_missing: 5,
            heartbeat_period: Duration::from_millis(100),
            host_node: NodeId::new(127).unwrap(),
            sdo_timeout: Duration::from_millis(500),
            sdo_retries: 2,
            boot_timeout: Duration::from_secs(2),
            transition_timeout: Duration::from_secs(5),
        };
        let stop_current = Setting {
            object: EPOS4_HOMING_CURRENT_THRESHOLD,
            data: STOP_CURRENT.to_le_bytes().to_vec(),
            readable: true,
            purpose: Purpose::Write,
        };
        let axis = AxisConfig {
            node,
            identity: Identity { vendor: 0xFB, product: None, revision: None },
            mode: CyclicMode::Csp,
            scale: Scale::new(COUNTS, 0.0).unwrap(),
            rated_torque: 0.42,
            homing: HomingConfig {
                method,
                search_speed: 15.0,
                zero_speed: 3.5,
                acceleration: 150.0,
                start_timeout: Duration::from_secs(1),
            },
            plausible_velocity: 480.0,
            plausible_acceleration: 30_000.0,
            following_error: 2.0,
            quick_stop_deceleration: 1500.0,
            emergency_input: None,
            position_range: None,
            configuration: (method < 0).then_some(stop_current).into_iter().collect(),
        };
        let group = CanBus::new(port, config, &[axis]).unwrap();
        let mut rig = Self { group, world, device, now: Instant::ZERO, period, state: AxisState::default() };
        rig.bring_up();
        rig.enable();
        rig
    }

    fn bring_up(&mut self) {
        while self.group.bring_up(self.now) != Poll::Ready(Ok(())) {
            self.pass();
            assert!(self.now < Instant::ZERO + LONGEST, "bring-up did not end");
        }
    }

    fn pass(&mut self) {
        self.now += self.period;
        self.world.advance(self.now);
    }

    fn cycle(&mut self, command: AxisCommand) {
        let mut states = [self.state];
        self.group.read(self.now, &mut states);
        [self.state] = states;
        self.group.write(self.now, &[command]);
        self.group.send(self.now);
        self.pass();
    }

    /// Commands `command` until `done`. Returns the time that it took.
    fn until(&mut self, command: AxisCommand, done: impl Fn(&AxisState) -> bool) -> Duration {
        let start = self.now;
        self.cycle(command);
        while !done(&self.state) {
            self.cycle(command);
            assert!(self.now < start + LONGEST, "{command:?}: {:?}", self.state);
        }
        self.now.since(start)
    }

    fn enable(&mut self) {
        self.until(AxisCommand::Stand, |state| state.power == Power::On && state.following);
    }

    fn reset(&mut self) {
        self.until(AxisCommand::Off, |state| state.power == Power::Off);
        self.until(AxisCommand::ResetFault, |state| state.fault.is_none());
    }

    /// Homes the axis until its group reports an end, and returns to set-points. Returns the end and the time to it.
    fn home(&mut self) -> (Homing, Option<Fault>, Duration) {
        self.until(AxisCommand::Home, |state| state.homing == Homing::InProgress);
        let took = self.until(AxisCommand::Home, |state| state.homing != Homing::InProgress || state.fault.is_some());
        let (homing, fault) = (self.state.homing, self.state.fault);
        if fault.is_none() {
            self.until(AxisCommand::Stand, |state| state.following);
        }
        (homing, fault, took)
    }

    fn attain(&mut self, what: &str) -> Duration {
        let (homing, fault, took) = self.home();
        assert_eq!((homing, fault), (Homing::Attained, None), "{what}");
        took
    }

    /// Moves the axis by `distance`, rad, at 10 rad/s.
    fn travel(&mut self, distance: f64) {
        let start = self.state.position;
        let steps = (distance.abs() / (10.0 * self.period.as_secs_f64())).ceil() as usize;
        for step in 1..=steps + 50 {
            let position = start + distance * (step as f64 / steps as f64).min(1.0);
            self.cycle(AxisCommand::Follow(Setpoint::Position(Finite::new(position).unwrap())));
        }
        assert_eq!(self.state.fault, None);
    }

    fn angle(&self) -> f64 {
        self.world.device::<Epos4>(self.device).unwrap().axis().angle()
    }

    /// The true angle at which the counter reads zero, rad, at rest.
    fn zero(&mut self) -> f64 {
        for _ in 0..50 {
            self.cycle(AxisCommand::Stand);
        }
        self.angle() - self.state.position
    }

    fn set_fault(&mut self, fault: PlantFault, on: bool) {
        let set = |device: &mut Epos4| device.plant_mut().unwrap().set_fault(fault, on);
        self.world.change(self.device, self.now, set).unwrap();
    }
}

/// Distance of two references, counts; for methods with an index pulse that any turn has, within a turn.
fn apart(method: i8, found: f64, expected: f64) -> f64 {
    let counts = (found - expected) / COUNT;
    let turns = if matches!(method, 7 | 33 | 34) { (counts / f64::from(COUNTS)).round() } else { 0.0 };
    counts - turns * f64::from(COUNTS)
}

/// The second homing begins where the first one ended: at the zero of the method.
#[test]
fn homing_twice_in_a_row_succeeds_for_every_method_at_every_period() {
    for method in HomingMethod::EPOS4.map(|method| method.0) {
        for millis in [1, 2, 5, 10, 20] {
            let period = Duration::from_millis(millis);
            let deviations = [
                HomingDeviation::default(),
                HomingDeviation { old_result: Some(Duration::ZERO), ..HomingDeviation::default() },
                old_result(period),
            ];
            for deviation in deviations {
                let what = format!("method {method} at {period:?}, {deviation:?}");
                let mut rig = Rig::new(method, period, deviation);
                rig.attain(&what);
                let first = rig.zero();
                rig.attain(&what);
                let second = rig.zero();
                // A switch or stop is sampled every millisecond, at 3.5 rad/s.
                let off = apart(method, second, first);
                assert!(off.abs() < 8.0, "{what}: {off:.1} counts apart");
            }
        }
    }
}

#[test]
fn an_old_result_does_not_end_a_search() {
    for (millis, method) in [(2, 34), (10, 34), (2, 7), (10, 7), (2, 37), (10, 37), (20, 33)] {
        let period = Duration::from_millis(millis);
        let what = format!("method {method} at {period:?}");
        let mut rig = Rig::new(method, period, old_result(period));
        rig.attain(&what);
        rig.travel(2.0);
        let begun_at = rig.angle();
        rig.attain(&what);
        let zero = rig.zero();
        let expected = if method == 37 { begun_at } else { 0.0 };
        assert!(apart(method, zero, expected).abs() < 8.0, "{what}: zero at {zero:.3} rad, begun at {begun_at:.3}");
        let from_zero = rig.state.position / COUNT;
        assert!(from_zero.abs() < 8.0, "{what}: stands {from_zero:.1} counts from zero");
    }
}

/// A counter that jumped is no reference until the drive has searched again.
#[test]
fn an_old_result_does_not_restore_a_reference_in_doubt() {
    for millis in [2, 10] {
        let period = Duration::from_millis(millis);
        let mut rig = Rig::new(34, period, old_result(period));
        rig.attain("first homing");
        rig.set_fault(PlantFault::EncoderJump(1300 * millis as i32), true);
        rig.until(AxisCommand::Stand, |state| state.fault.is_some());
        rig.reset();
        rig.enable();
        assert_eq!(rig.state.homing, Homing::NotHomed);
        rig.attain("homing after a jump");
        let off = apart(34, rig.zero(), 0.0);
        assert!(off.abs() < 8.0, "at {period:?}: {off:.1} counts off");
    }
}

#[test]
fn an_old_failure_does_not_end_a_search() {
    let mut rig = Rig::new(7, Duration::from_millis(2), old_result(Duration::from_millis(2)));
    rig.set_fault(PlantFault::HomeSwitchDead, true);
    let (homing, fault, _) = rig.home();
    assert_eq!((homing, fault), (Homing::Failed, None));
    rig.set_fault(PlantFault::HomeSwitchDead, false);
    rig.attain("a retry");
}

#[test]
fn a_drive_that_never_searches_is_a_failure_with_this_reason() {
    for method in [37, 34, 11, -3] {
        for old_result in [None, Some(Duration::from_millis(20)), Some(LONGEST)] {
            let deviation = HomingDeviation { old_result, never_searches: true, ..HomingDeviation::default() };
            let mut rig = Rig::new(method, Duration::from_millis(2), deviation);
            rig.travel(1.0);
            let (_, fault, took) = rig.home();
            let named = matches!(fault, Some(Fault::NoSearch { node: NODE, .. }));
            assert!(named, "method {method}, {old_result:?}: {fault:?}");
            assert!((0.99..1.05).contains(&took.as_secs_f64()), "{took:?}");
            rig.reset();
            assert_eq!(rig.state.homing, Homing::NotHomed);
        }
    }
}

/// The drive shows success, and its counter in later answers.
#[test]
fn a_counter_that_is_set_after_the_success_is_waited_for() {
    // From 24.5 rad, the counter before the search is within the following error from the one after it.
    for (method, start) in [(34, START), (34, 24.5), (34, 25.0), (7, START), (37, START)] {
        for periods in [1, 2, 3, 4] {
            let period = Duration::from_millis(2);
            let deviation = HomingDeviation { counter_late: periods * period, ..HomingDeviation::default() };
            let mut rig = Rig::starting_at(start, method, period, deviation);
            rig.attain("homing");
            let at = rig.angle();
            let zero = rig.zero();
            let moved = (rig.angle() - at) / COUNT;
            assert!(moved.abs() < 8.0, "method {method}, {periods} periods late: moved by {moved:.1} counts");
            let expected = if method == 37 { at } else { 0.0 };
            assert!(apart(method, zero, expected).abs() < 8.0, "method {method}: zero at {zero:.3} rad");
        }
    }
}

#[test]
fn a_counter_that_the_search_does_not_set_is_a_failure() {
    let deviation = HomingDeviation { counter_late: LONGEST, ..HomingDeviation::default() };
    let mut rig = Rig::new(7, Duration::from_millis(2), deviation);
    let (_, fault, _) = rig.home();
    assert!(matches!(fault, Some(Fault::NotAtZero { node: NODE, .. })), "{fault:?}");
    rig.reset();
    assert_eq!(rig.state.homing, Homing::NotHomed);
}
