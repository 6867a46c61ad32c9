//! The three shells of virtual sensors, and the period of their readings.

use std::any::TypeId;
use std::time::Duration;

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
    sensors.install(Probe { asked: None, by_itself: shell == Shell::NonInteractive }, shell, period);
    sensors.begin();
    sensors
}

fn reading(sensors: &Sensors) -> Received<Height> {
    *sensors.reading(TypeId::of::<Height>()).unwrap().0.downcast_ref().unwrap()
}

#[test]
fn a_sensor_that_works_by_itself_gives_its_latest_reading_to_each_step() {
    let mut sensors = sensors(Shell::NonInteractive, 1);
    sensors.initiate(at(0));
    for now in 0..4 {
        sensors.poll(at(now));
        assert!(sensors.are_ready());
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
        assert_eq!(sensors.are_ready(), shell != Shell::Interactive);
        assert_eq!(reading(&sensors), Received::None);
        sensors.poll(at(5));
        assert!(sensors.are_ready());
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
