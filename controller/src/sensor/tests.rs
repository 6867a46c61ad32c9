//! The three shells of virtual sensors, the period of their readings, and bundles of several sensors.

mod shells;

use std::any::TypeId;
use std::time::Duration;

use drive::cia401::{InputImage, IoConfig, RehearsedIo};
use drive::cia402::{Identity, NodeId};

use super::*;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Height(u32);

impl SensorReading for Height {}

/// Gives a reading three milliseconds after it was asked for one, or in every millisecond if it works by itself.
struct Probe {
    asked: Option<Instant>,
    by_itself: bool,
}

impl VirtualSensor for Probe {
    type Reading = Height;
    type Command = bool;

    fn configure(&mut self, by_itself: &bool) {
        self.by_itself = *by_itself;
    }

    fn initiate(&mut self, now: Instant) {
        self.asked = Some(now);
    }

    fn poll(&mut self, now: Instant) -> Option<(Instant, Height)> {
        let height = Height(now.since(Instant::ZERO).as_millis() as u32);
        if self.by_itself {
            return Some((now, height));
        }
        let asked = self.asked.filter(|asked| now.since(*asked) >= Duration::from_millis(3))?;
        Some((asked, height))
    }
}

fn at(millis: u64) -> Instant {
    Instant::ZERO + Duration::from_millis(millis)
}

fn sensors(shell: Shell, period: u16) -> Sensors {
    let mut sensors = Sensors::default();
    sensors.install(Probe { asked: None, by_itself: shell == Shell::NonInteractive }, shell, period).unwrap();
    sensors.begin();
    sensors
}

/// What a step takes from the sensor with readings of type `R`.
fn taken<R: SensorReading>(sensors: &Sensors) -> Received<R> {
    *sensors.reading(TypeId::of::<R>()).unwrap().0.downcast_ref().unwrap()
}

fn ready(sensors: &Sensors) -> bool {
    sensors.is_ready(TypeId::of::<Height>())
}

fn reading(sensors: &Sensors) -> Received<Height> {
    taken(sensors)
}

#[test]
fn a_sensor_that_works_by_itself_gives_its_latest_reading_to_each_step() {
    let mut sensors = sensors(Shell::NonInteractive, 1);
    sensors.initiate(at(0));
    for now in 0..4 {
        sensors.poll(at(now));
        assert!(ready(&sensors));
        let sample = Sample { at: at(now), age: Duration::ZERO, value: Height(now as u32) };
        assert_eq!(reading(&sensors), Received::New(sample));
    }
    sensors.initiate(at(4));
    assert!(matches!(reading(&sensors), Received::Old(Sample { value: Height(3), .. })));
}

#[test]
fn only_the_interactive_shell_waits_for_a_reading() {
    for shell in [Shell::Interactive, Shell::InteractiveWithoutWait] {
        let mut sensors = sensors(shell, 1);
        sensors.initiate(at(0));
        sensors.poll(at(2));
        assert_eq!(ready(&sensors), shell != Shell::Interactive);
        assert_eq!(reading(&sensors), Received::None);
        sensors.poll(at(5));
        assert!(ready(&sensors));
        let sample = Sample { at: at(0), age: Duration::from_millis(5), value: Height(5) };
        assert_eq!(reading(&sensors), Received::New(sample));
    }
}

#[test]
fn a_reading_of_every_third_macrostep_is_new_in_one_step_and_old_in_two() {
    let mut sensors = sensors(Shell::InteractiveWithoutWait, 3);
    let mut new = Vec::new();
    for step in 0..9 {
        sensors.initiate(at(20 * step));
        for millis in 1..20 {
            sensors.poll(at(20 * step + millis));
        }
        new.push(matches!(reading(&sensors), Received::New(_)));
    }
    assert_eq!(new, [true, false, false, true, false, false, true, false, false]);
}

#[test]
fn a_sensor_with_a_period_gives_its_latest_reading_to_the_step_that_takes_it_and_old_ones_to_the_others() {
    let mut sensors = sensors(Shell::NonInteractive, 3);
    for step in 0..9 {
        let end = 20 * step + 19;
        sensors.initiate(at(20 * step));
        (20 * step..=end).for_each(|now| sensors.poll(at(now)));
        let taken = 60 * (step / 3) + 19;
        let age = Duration::from_millis(end - taken);
        let sample = Sample { at: at(taken), age, value: Height(taken as u32) };
        assert_eq!(reading(&sensors), if taken == end { Received::New(sample) } else { Received::Old(sample) });
    }
}

#[test]
fn a_reading_that_no_step_has_taken_stays_new() {
    let mut sensors = sensors(Shell::NonInteractive, 1);
    sensors.initiate(at(0));
    sensors.poll(at(0));
    assert!(matches!(reading(&sensors), Received::New(_)));
    // The plan of the first step takes five milliseconds, and then its outputs are committed.
    (1..=5).for_each(|now| sensors.poll(at(now)));
    sensors.configure(&false as &dyn Any);
    sensors.initiate(at(5));
    sensors.poll(at(6));
    let sample = Sample { at: at(5), age: Duration::from_millis(1), value: Height(5) };
    assert_eq!(reading(&sensors), Received::New(sample));
    sensors.poll(at(7));
    assert!(matches!(reading(&sensors), Received::Old(_)));
}

/// A sensor with commands of the type of [`Probe`].
struct Switch;

#[derive(Clone, Copy)]
struct Closed;

impl SensorReading for Closed {}

impl VirtualSensor for Switch {
    type Reading = Closed;
    type Command = bool;

    fn poll(&mut self, now: Instant) -> Option<(Instant, Closed)> {
        Some((now, Closed))
    }
}

#[test]
fn a_second_sensor_with_the_same_readings_or_commands_is_refused_unless_it_is_marked() {
    let probe = || Probe { asked: None, by_itself: true };
    let mut sensors = sensors(Shell::NonInteractive, 1);
    let refusal = sensors.install(probe(), Shell::Interactive, 1).unwrap_err();
    assert_eq!(refusal, SensorRefused::SameReading { reading: type_name::<Height>() });
    let refusal = sensors.install(Switch, Shell::Interactive, 1).unwrap_err();
    assert_eq!(refusal, SensorRefused::SameCommand { command: type_name::<bool>() });
    assert!(ready(&sensors));
    sensors.install(probe().marked::<Closed>(), Shell::NonInteractive, 1).unwrap();
    sensors.install(Switch.marked::<u8>(), Shell::NonInteractive, 1).unwrap();
    assert!(sensors.remove::<Height>() && !sensors.remove::<Height>());
    sensors.install(Switch, Shell::NonInteractive, 1).unwrap();
}

/// A rehearsed I/O node with three inputs, of which input `high` becomes high at once, and its sensor.
fn node(raw: u8, high: u8) -> (RehearsedIo, DigitalInputs, drive::cia401::OutputCommand) {
    let config = IoConfig {
        node: NodeId::new(raw).unwrap(),
        identity: Identity { vendor: 0, product: None, revision: None },
        inputs: 3,
        outputs: 3,
        inhibit_time: Duration::from_millis(1),
        event_timer: Duration::from_millis(100),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        inverted_outputs: 0,
        error_mode: 0,
        error_value: 0,
        configuration: Vec::new(),
    };
    let (io, link) = RehearsedIo::new(&config, [(Instant::ZERO, high)]);
    let outputs = link.outputs.clone();
    (io, DigitalInputs::new(link.inputs, link.outputs), outputs)
}

#[test]
fn two_io_nodes_are_two_sensors_of_one_bundle_with_readings_and_commands_of_their_own() {
    enum Door {}
    type Doors = Marked<InputImage, Door>;
    let ((mut probe, probe_inputs, probe_outputs), (mut door, door_inputs, door_outputs)) = (node(1, 0), node(2, 2));
    let mut sensors = Sensors::default();
    sensors.install(probe_inputs, Shell::NonInteractive, 1).unwrap();
    sensors.install(door_inputs.marked::<Door>(), Shell::NonInteractive, 1).unwrap();
    sensors.begin();
    probe.advance(at(1));
    door.advance(at(1));
    sensors.initiate(at(1));
    sensors.poll(at(1));
    let levels = |image: &InputImage| [0, 1, 2].map(|input| image.input(input).unwrap().level);
    let of_probe: Received<InputImage> = taken(&sensors);
    let of_door: Received<Doors> = taken(&sensors);
    assert_eq!(levels(&of_probe.sample().unwrap().value), [true, false, false]);
    assert_eq!(levels(&of_door.sample().unwrap().value), [false, false, true]);
    assert!(sensors.configure(&0b001_u64) && sensors.configure(&Marked::<u64, Door>::new(0b100)));
    assert_eq!((probe_outputs.levels(), door_outputs.levels()), (0b001, 0b100));
}

#[test]
fn a_command_reaches_the_sensor_that_takes_its_type_and_an_instruction_begins_without_a_reading() {
    let mut sensors = sensors(Shell::InteractiveWithoutWait, 1);
    assert!(!sensors.configure(&1_u8 as &dyn Any));
    assert!(sensors.configure(&true as &dyn Any));
    sensors.initiate(at(0));
    sensors.poll(at(1));
    assert!(matches!(reading(&sensors), Received::New(_)));
    sensors.begin();
    assert_eq!(reading(&sensors), Received::None);
}
