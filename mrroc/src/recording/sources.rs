//! The channels of a cell's recordings, and the words that its drivers and laws take from other threads.

use controller::sensor::ForceTorque;
use drive::Word;

use super::file::Channel;
use super::messages::{
    BusEvent, Call, LineData, Lost, RobotCycle, RobotFault, RobotOrder, Timing, Word as WordMessage,
};
use super::schema::Schema;
use crate::cell::CellFile;
use crate::setup::Devices;

/// Channels of a recording: first the servo's, then one per robot, per bus and per line.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    channels: Vec<Channel>,
    robots: usize,
    buses: usize,
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
        let lines = axes.chain(sensors).chain(matrices);
        channels.extend(lines.map(|name| channel::<LineData>(format!("/line/{name}"))));
        Self { channels, robots: cell.robot.len(), buses: cell.bus.len() }
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
    /// matrices.
    pub(super) fn line(&self, line: usize) -> u16 {
        (FIXED + self.robots + self.buses + line) as u16
    }

    pub(super) fn lines(&self) -> usize {
        self.channels.len() - FIXED - self.robots - self.buses
    }
}

fn channel<M: Schema>(topic: impl Into<String>) -> Channel {
    Channel { topic: topic.into(), message: M::NAME }
}

/// The words that the drivers and laws of a cell take from other threads, always in the same order.
pub(crate) fn words(devices: &Devices, sensors: &[ForceTorque]) -> Vec<Word> {
    let io = devices.io.iter().flat_map(|link| link.words());
    let wrenches = devices.sensors.iter().flat_map(|link| link.words());
    let matrices = devices.matrices.iter().map(|link| link.word());
    let zeros = sensors.iter().flat_map(ForceTorque::words);
    // New words follow at the end, so that words of older recordings keep their numbers.
    io.chain(wrenches).chain(matrices).chain(zeros).chain(sensors.iter().flat_map(ForceTorque::payload_words)).collect()
}
