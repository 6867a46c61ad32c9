//! Records of each cycle in a bounded ring, which another thread drains.

use std::time::Duration;

use can::Instant;
use drive::{AxisCommand, Homing, Increments};

use crate::{MAX_AXES, Phase};

/// One cycle of one effector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Record {
    /// Number of the cycle, from 0.
    pub cycle: u64,
    /// Time of the cycle.
    pub at: Instant,
    /// Time since the SYNC of the last cycle; zero in the first cycle. Control laws use the nominal period instead.
    pub dt: Duration,
    /// Index of the effector.
    pub effector: u8,
    /// Number of used entries of `axis`.
    pub axes: u8,
    /// Phase of the effector.
    pub phase: Phase,
    /// Whether the effector has a latched fault.
    pub faulted: bool,
    /// Records of the axes.
    pub axis: [AxisRecord; MAX_AXES],
}

/// One cycle of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisRecord {
    /// Motor position commanded in this cycle, rad.
    pub commanded: f64,
    /// Displacement from the planned path by the [cycle law](crate::CycleLaw) of the effector, rad; part of `commanded`.
    pub displacement: f64,
    /// Command to the drive in this cycle.
    pub command: AxisCommand,
    /// Value added by the [`Excitation`](crate::Excitation) of the axis, in its unit; zero unless the axis is
    /// [excited](crate::Servo::excite).
    pub excitation: f64,
    /// Last measured motor position, rad: the effect of the command of [`DriveGroup::delay`](drive::DriveGroup::delay)
    /// cycles before.
    pub measured: f64,
    /// Motor position, rad, of the command that `measured` answers, by which the servo finds the tracking error. Present
    /// in cycles that read a new sample of a referenced axis while its effector stood or moved by set-points.
    pub expected: Option<f64>,
    /// The same as the drive counts it.
    pub increments: Increments,
    /// Motor velocity measured, rad/s.
    pub velocity: f64,
    /// Motor torque measured, N·m.
    pub torque: f64,
    /// Homing state reported by the drive.
    pub homing: Homing,
}

/// The servo's end of a recording.
#[derive(Debug)]
pub(crate) struct Recorder {
    ring: rtrb::Producer<Record>,
    pub(crate) dropped: u64,
}

impl Recorder {
    /// A ring of `capacity` records, each for one effector and cycle.
    pub(crate) fn new(capacity: usize) -> (Self, rtrb::Consumer<Record>) {
        let (mut ring, mut records) = rtrb::RingBuffer::new(capacity);
        // Every page of the ring is touched here: no cycle waits for one.
        for _ in 0..capacity {
            let _ = ring.push(Record::default());
            let _ = records.pop();
        }
        (Self { ring, dropped: 0 }, records)
    }

    /// Stores one record, or counts it as dropped.
    pub(crate) fn record(&mut self, record: Record) {
        self.dropped += u64::from(self.ring.push(record).is_err());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_counted() {
        let (mut recorder, mut records) = Recorder::new(2);
        for cycle in 0..5 {
            recorder.record(Record { cycle, ..Record::default() });
        }
        assert_eq!(recorder.dropped, 3);
        assert_eq!(records.pop().unwrap().cycle, 0);
        recorder.record(Record::default());
        assert_eq!(recorder.dropped, 3);
    }
}
