//! The latest state of an effector, for any number of readers.
//!
//! The servo publishes a [`Snapshot`] per effector and cycle ([`drive::latest`]). Neither side waits for the other.

use std::array;

use can::Instant;
use drive::Switches;

use crate::{MAX_AXES, Phase, Trail, trail};

/// State of one effector in one cycle. The arrays hold one value per axis; entries from [`axes`](Self::axes) on are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Number of the cycle, from 0.
    pub cycle: u64,
    /// Time of the cycle, which read the samples.
    pub at: Instant,
    /// Phase of the effector.
    pub phase: Phase,
    /// Whether every axis is homed.
    pub homed: bool,
    /// Number of the macrostep that is executed, or of the last one begun; 0 before the first.
    pub macrostep: u64,
    /// Number of macrosteps that its team began since the last [tie](crate::Order::Tie) of the effector; 0 before the
    /// first tie. The number stays when the team ends.
    pub team_macrostep: u64,
    /// Whether the effector stands and waits for partners: at a barrier, or with a macrostep that a partner of its team
    /// lacks.
    pub waiting: bool,
    /// Speed of the motion time: 1, or less by a [`SpeedOverride`](crate::SpeedOverride), and 0 in a pause.
    pub rate: f64,
    /// Number of axes.
    pub axes: u8,
    /// Motor positions commanded in this cycle, rad.
    pub commanded: [f64; MAX_AXES],
    /// Motor velocities commanded in this cycle, rad/s.
    pub commanded_velocity: [f64; MAX_AXES],
    /// Displacements from the planned path by a [cycle law](crate::CycleLaw), rad; part of [`commanded`](Self::commanded).
    /// Zero after the motion, unless the law [keeps](crate::CycleLaw::keeps) the displacement for the next motion.
    pub displacement: [f64; MAX_AXES],
    /// Measured motor positions, rad: the effect of the commands of
    /// [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before.
    pub measured: [f64; MAX_AXES],
    /// Measured motor velocities, rad/s.
    pub velocity: [f64; MAX_AXES],
    /// Measured motor torques, N·m; zero where the drive does not report them.
    pub torque: [f64; MAX_AXES],
    /// Switches of the axes; open where the drive does not report them.
    pub switches: [Switches; MAX_AXES],
    /// Time at which each drive took its sample: when the SYNC or the telegram that it answered was sent.
    /// [`Instant::ZERO`] before the first sample.
    pub sampled: [Instant; MAX_AXES],
    /// Cycles in a row without an answer to the last SYNC or telegram: 0 if this cycle read one.
    pub age: [u32; MAX_AXES],
}

/// Number of words per axis.
const PER_AXIS: usize = 9;

/// Number of words before those of the axes: cycle, time, macrostep, flags, rate and macrostep of the team.
const COMMON: usize = 6;

/// Words of a snapshot.
const WORDS: usize = COMMON + PER_AXIS * MAX_AXES;

impl Snapshot {
    fn words(&self) -> [u64; WORDS] {
        let mut words = [0; WORDS];
        let (homed, waiting) = (u64::from(self.homed) << 8, u64::from(self.waiting) << 9);
        let flags = u64::from(self.phase as u8) | homed | waiting | u64::from(self.axes) << 16;
        let rate = self.rate.to_bits();
        let common = [self.cycle, self.at.as_nanos(), self.macrostep, flags, rate, self.team_macrostep];
        words[..COMMON].copy_from_slice(&common);
        let axes = words[COMMON..].chunks_exact_mut(PER_AXIS).take(self.axes.into());
        for (axis, words) in axes.enumerate() {
            let Switches { home, lower_limit, upper_limit } = self.switches[axis];
            words.copy_from_slice(&[
                self.commanded[axis].to_bits(),
                self.measured[axis].to_bits(),
                self.velocity[axis].to_bits(),
                self.torque[axis].to_bits(),
                u64::from(home) | u64::from(lower_limit) << 1 | u64::from(upper_limit) << 2,
                self.sampled[axis].as_nanos(),
                u64::from(self.age[axis]),
                self.commanded_velocity[axis].to_bits(),
                self.displacement[axis].to_bits(),
            ]);
        }
        words
    }

    fn from_words(words: &[u64; WORDS]) -> Self {
        let flags = words[3];
        let word = |axis: usize, at: usize| words[COMMON + PER_AXIS * axis + at];
        let number = |at: usize| array::from_fn(|axis| f64::from_bits(word(axis, at)));
        Self {
            cycle: words[0],
            at: Instant::from_nanos(words[1]),
            phase: Phase::ALL.into_iter().find(|phase| *phase as u8 == flags as u8).unwrap_or_default(),
            homed: flags & 1 << 8 != 0,
            macrostep: words[2],
            team_macrostep: words[5],
            waiting: flags & 1 << 9 != 0,
            rate: f64::from_bits(words[4]),
            axes: (flags >> 16) as u8,
            commanded: number(0),
            measured: number(1),
            velocity: number(2),
            torque: number(3),
            switches: array::from_fn(|axis| {
                let bits = word(axis, 4);
                Switches { home: bits & 1 != 0, lower_limit: bits & 2 != 0, upper_limit: bits & 4 != 0 }
            }),
            sampled: array::from_fn(|axis| Instant::from_nanos(word(axis, 5))),
            age: array::from_fn(|axis| word(axis, 6) as u32),
            commanded_velocity: number(7),
            displacement: number(8),
        }
    }
}

/// Both ends of the latest state of an effector of `axes` axes. Before the first snapshot, the value is
/// [`Snapshot::default`].
pub fn latest(axes: usize) -> (Publisher, Latest) {
    let (publisher, latest) = drive::latest::latest_of(COMMON + PER_AXIS * axes, Snapshot::default().words());
    let (trails, trail) = drive::latest::latest_of(trail::words_of(axes), Trail::default().words());
    (Publisher(publisher, trails), Latest(latest, trail))
}

/// The writing end. There is one per value.
#[derive(Debug)]
pub struct Publisher(drive::latest::Publisher<WORDS>, drive::latest::Publisher<{ trail::WORDS }>);

impl Publisher {
    /// Replaces the value. The function neither waits nor allocates.
    pub fn publish(&mut self, snapshot: &Snapshot) {
        self.0.publish(&snapshot.words());
    }

    /// Replaces the last set-points. The function neither waits nor allocates.
    pub fn publish_trail(&mut self, trail: &Trail) {
        self.1.publish(&trail.words());
    }
}

/// The reading end. Clones read the same value. A read does not change the value and does not delay the servo.
#[derive(Clone, Debug)]
pub struct Latest(drive::latest::Latest<WORDS>, drive::latest::Latest<{ trail::WORDS }>);

impl Latest {
    /// The latest snapshot. All its fields are of one cycle.
    pub fn read(&self) -> Snapshot {
        Snapshot::from_words(&self.0.read())
    }

    /// The last set-points. All of them end with the same cycle, which may be one cycle later or earlier than that of a
    /// snapshot.
    pub fn trail(&self) -> Trail {
        Trail::from_words(&self.1.read())
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use proptest::prelude::*;

    use super::*;

    /// A snapshot whose every field follows from `number`.
    fn of(number: u64) -> Snapshot {
        let axes = number as usize % (MAX_AXES + 1);
        let value = |offset: u64| {
            array::from_fn(|axis| if axis < axes { (number + offset) as f64 + axis as f64 / 8.0 } else { 0.0 })
        };
        let bit = |bit: u64| (number >> bit) & 1 == 1;
        Snapshot {
            cycle: number,
            at: Instant::from_nanos(number),
            phase: Phase::ALL[number as usize % Phase::ALL.len()],
            homed: bit(0),
            rate: 0.25,
            macrostep: number,
            team_macrostep: number / 3,
            waiting: bit(1),
            axes: axes as u8,
            commanded: value(0),
            measured: value(1),
            velocity: value(2),
            torque: value(3),
            switches: of_axes(axes, Switches { home: bit(0), lower_limit: bit(1), upper_limit: bit(2) }),
            sampled: of_axes(axes, Instant::from_nanos(number)),
            age: of_axes(axes, number as u32),
            commanded_velocity: value(4),
            displacement: value(5),
        }
    }

    /// `value` for each axis, and the default beyond.
    fn of_axes<T: Copy + Default>(axes: usize, value: T) -> [T; MAX_AXES] {
        array::from_fn(|axis| if axis < axes { value } else { T::default() })
    }

    proptest! {
        #[test]
        fn what_is_published_is_read(number in 0..u64::from(u32::MAX)) {
            let (mut publisher, latest) = latest(MAX_AXES);
            publisher.publish(&of(number + 1));
            publisher.publish(&of(number));
            prop_assert_eq!(latest.read(), of(number));
            prop_assert_eq!(latest.clone().read(), of(number));
        }
    }

    #[test]
    fn before_the_first_cycle_the_effector_is_off() {
        let (_publisher, latest) = latest(MAX_AXES);
        assert_eq!(latest.read(), Snapshot::default());
    }

    #[test]
    fn readers_never_see_two_cycles_in_one_snapshot_nor_an_earlier_one_after_a_later_one() {
        const LAST: u64 = 200_000;
        let (mut publisher, latest) = latest(MAX_AXES);
        thread::scope(|scope| {
            for _ in 0..2 {
                let latest = latest.clone();
                scope.spawn(move || {
                    let mut last = 0;
                    while last < LAST {
                        let snapshot = latest.read();
                        if snapshot != Snapshot::default() {
                            assert_eq!(snapshot, of(snapshot.cycle));
                        }
                        assert!(snapshot.cycle >= last);
                        last = snapshot.cycle;
                    }
                });
            }
            (1..=LAST).for_each(|number| publisher.publish(&of(number)));
        });
    }
}
