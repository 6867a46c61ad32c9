//! The channels of a cell's recordings, and the words that its drivers and laws take from other threads.

use std::collections::BTreeMap;

use controller::sensor::ForceTorque;
use drive::Word;
use drive::device::{DeviceValue, count_of, names_of};

use super::file::Channel;
use super::messages::{
    BusEvent, Call, LineData, Lost, RobotCycle, RobotFault, RobotOrder, Timing, Word as WordMessage,
};
use super::samples::DeviceSample;
use super::schema::Schema;
use crate::cell::{CellFile, Device};
use crate::setup::Devices;

/// Channels of a recording: first the servo's, then one per robot, per bus, per line, and per device of another crate.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    channels: Vec<Channel>,
    robots: usize,
    buses: usize,
    lines: usize,
    /// Numbers in a sample of each device of another crate.
    devices: Vec<usize>,
}

/// Number of channels of the servo.
const FIXED: usize = 6;

impl Layout {
    pub(crate) fn of(file: &CellFile) -> Self {
        let cell = &file.cell;
        let mut channels = vec![
            channel::<Call>("/servo/calls"),
            channel::<RobotOrder>("/servo/orders"),
            channel::<RobotFault>("/servo/faults"),
            channel::<WordMessage>("/servo/words"),
            channel::<Timing>("/servo/timing"),
            channel::<Lost>("/recording/lost"),
        ];
        debug_assert_eq!(channels.len(), FIXED);
        channels.extend(cell.robot.iter().map(|robot| channel::<RobotCycle>(format!("/robot/{}/cycle", robot.name))));
        channels.extend(cell.bus.iter().map(|bus| channel::<BusEvent>(format!("/bus/{}", bus.name))));
        let bundles = cell.bus.len()..cell.bus.len() + cell.serial.len();
        let axes = bundles.flat_map(|group| cell.axes_on(group)).map(|(robot, axis)| file.axis_name(robot, axis));
        let sensors = cell.serial_sensors().map(|sensor| cell.force_sensor[sensor].name.clone());
        let matrices = cell.ultrasonic.iter().map(|matrix| matrix.name.clone());
        let devices = cell.device.iter().map(|device| device.keys.name.clone());
        let lines = axes.chain(sensors).chain(matrices).chain(devices);
        let before = channels.len();
        channels.extend(lines.map(|name| channel::<LineData>(format!("/line/{name}"))));
        let lines = channels.len() - before;
        channels.extend(cell.device.iter().map(of_device));
        let devices = cell.device.iter().map(|device| count_of(device.own.values())).collect();
        Self { channels, robots: cell.robot.len(), buses: cell.bus.len(), lines, devices }
    }

    pub(super) fn channels(&self) -> &[Channel] {
        &self.channels
    }

    pub(super) fn calls(&self) -> u16 {
        0
    }

    pub(super) fn orders(&self) -> u16 {
        1
    }

    pub(super) fn faults(&self) -> u16 {
        2
    }

    pub(super) fn words(&self) -> u16 {
        3
    }

    pub(super) fn timing(&self) -> u16 {
        4
    }

    pub(super) fn lost(&self) -> u16 {
        5
    }

    /// Whether the messages of `channel` are from the journal of the servo. Each drain of the queues begins with these.
    pub(super) fn is_of_journal(&self, channel: u16) -> bool {
        channel < self.robot(0) && channel != self.lost()
    }

    pub(super) fn robot(&self, robot: usize) -> u16 {
        (FIXED + robot) as u16
    }

    pub(super) fn bus(&self, bus: usize) -> u16 {
        (FIXED + self.robots + bus) as u16
    }

    /// The channel of line `line`. Lines of axes by bundle come first, then lines of force sensors, then lines of ultrasonic
    /// matrices, then lines of devices of other crates.
    pub(super) fn line(&self, line: usize) -> u16 {
        (FIXED + self.robots + self.buses + line) as u16
    }

    pub(super) fn lines(&self) -> usize {
        self.lines
    }

    /// The channel of the samples of device `device`.
    pub(super) fn device(&self, device: usize) -> u16 {
        self.line(self.lines + device)
    }

    /// Numbers in a sample of each device.
    pub(super) fn devices(&self) -> &[usize] {
        &self.devices
    }
}

fn channel<M: Schema>(topic: impl Into<String>) -> Channel {
    Channel { topic: topic.into(), message: M::NAME, metadata: BTreeMap::new() }
}

/// The samples of a device. The metadata have name and unit of each number.
fn of_device(device: &Device) -> Channel {
    let shown = |(name, value): (String, &DeviceValue)| match value.unit {
        "" => name,
        unit => format!("{name} [{unit}]"),
    };
    let values: Vec<_> = names_of(device.own.values()).map(shown).collect();
    let metadata = [("kind", device.own.kind().to_owned()), ("values", values.join(", "))];
    let metadata = metadata.map(|(key, text)| (key.to_owned(), text)).into();
    Channel { metadata, ..channel::<DeviceSample>(format!("/device/{}", device.keys.name)) }
}

/// The words that the drivers and laws of a cell take from other threads, always in the same order.
pub(crate) fn words(devices: &Devices, sensors: &[ForceTorque]) -> Vec<Word> {
    let io = devices.io.iter().flat_map(|link| link.words());
    let wrenches = devices.sensors.iter().flat_map(|link| link.words());
    let matrices = devices.matrices.iter().map(|link| link.word());
    let zeros = sensors.iter().flat_map(ForceTorque::words);
    // New words follow at the end, so that words of older recordings keep their numbers.
    let payloads = sensors.iter().flat_map(ForceTorque::payload_words);
    let own = devices.own.iter().map(|link| link.word());
    io.chain(wrenches).chain(matrices).chain(zeros).chain(payloads).chain(own).collect()
}
