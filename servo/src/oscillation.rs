//! Monitoring of the following error for oscillation.
//!
//! The following error of a stable loop comes to rest after each change of the set-points. The error of a loop that
//! oscillates turns again and again at equal intervals. A *swing* is the way of the error from one turning point to the
//! next. An axis *oscillates* if the last [`SWINGS`] swings have all of these properties:
//!
//! - each swing is at least [`LEAST`] increments long;
//! - the longest is less than twice as long as the shortest, in increments and in time;
//! - the amplitude does not fade;
//! - the motor is faster than a motor that counts as still.
//!
//! An oscillation *grows* if each of the last [`GROWING`] swings is at least as long as the one before, the newest at
//! least twice as long as the oldest, and the amplitude exceeds half of the permitted following error. A loop that the
//! servo closes cannot brake such a motor.
//!
//! # Limits
//! A set-point that turns its acceleration with each swing, such as weaving or a cycle law in contact, drives the error
//! by itself. Swings with more than [`REVERSALS`] reversals of the commanded acceleration are not judged. An oscillation
//! with less than [`LEAST`] increments from peak to peak is not found.

use std::fmt;

/// Swings of an oscillation: four whole periods.
const SWINGS: usize = 8;
/// Swings of an oscillation that grows.
const GROWING: usize = 5;
/// Least length of a swing, increments. The resolution of an encoder makes swings of up to two increments.
const LEAST: f64 = 8.0;
/// Share of the oldest swing that the newest one must have, so that the oscillation does not fade.
const LASTING: f64 = 0.8;
/// Ratio of the longest to the shortest swing, in length and in duration.
const EQUAL: f64 = 2.0;
/// Greatest number of reversals of the commanded acceleration.
const REVERSALS: u32 = 2;
/// Share of the greatest acceleration below which the commanded acceleration has no sign.
const ACCELERATES: f64 = 0.01;
/// Share of a swing by which the error must return from its extreme to count as turned.
const RETURNS: f64 = 0.25;

/// An oscillation of the measured position about its set-point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Frequency, Hz.
    pub frequency: f64,
    /// Amplitude of the position of the motor, rad: half of the distance from peak to peak.
    pub amplitude: f64,
    /// Whether the set-point stood still.
    pub at_rest: bool,
}

impl Oscillation {
    /// Amplitude of the velocity of the motor, rad/s.
    pub fn velocity(&self) -> f64 {
        std::f64::consts::TAU * self.frequency * self.amplitude
    }
}

impl fmt::Display for Oscillation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frequency, amplitude, at_rest } = self;
        let when = if *at_rest { "at rest" } else { "in motion" };
        write!(f, "oscillates {when} with {frequency:.1} Hz, {amplitude:.4} rad and {:.1} rad/s", self.velocity())
    }
}

/// Bounds of one axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// Increments per radian.
    pub(crate) increments_per_radian: f64,
    /// Greatest speed of a motor that counts as still, rad/s.
    pub(crate) still_below: f64,
    /// Greatest acceleration, rad/s².
    pub(crate) max_acceleration: f64,
    /// Permitted following error, rad.
    pub(crate) following_error: f64,
}

/// Result of one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Finding {
    Lasting(Oscillation),
    Growing(Oscillation),
}

/// From one turning point to the next: length, rad, duration, s, and reversals of the commanded acceleration.
#[derive(Clone, Copy, Debug, Default)]
struct Swing {
    length: f64,
    duration: f64,
    reversals: u32,
}

/// The last swings of a following error.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct OscillationWatch {
    /// The newest first.
    swings: [Swing; SWINGS],
    known: usize,
    /// The last turning point, rad, and the extreme since then.
    turned: f64,
    extreme: f64,
    begun: bool,
    rises: bool,
    /// Time from the last turning point to the extreme and from the extreme to now, s.
    to_extreme: f64,
    since_extreme: f64,
    /// Reversals since the last turning point, and the last sign of the commanded acceleration.
    reversals: u32,
    accelerates: Option<bool>,
    velocity: f64,
}

impl OscillationWatch {
    /// Forgets all swings, because the error has another cause.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Notes the commanded velocity of a cycle, rad/s, `elapsed` seconds after the last cycle.
    pub(crate) fn command(&mut self, velocity: f64, elapsed: f64, bounds: &Bounds) {
        let acceleration = (velocity - std::mem::replace(&mut self.velocity, velocity)) / elapsed;
        self.since_extreme += elapsed;
        if acceleration.abs() > ACCELERATES * bounds.max_acceleration {
            let now = acceleration > 0.0;
            if self.accelerates.replace(now).is_some_and(|before| before != now) {
                self.reversals = self.reversals.saturating_add(1);
            }
        }
    }

    /// Takes the following error of a new sample, rad.
    pub(crate) fn observe(&mut self, error: f64, bounds: &Bounds) -> Option<Finding> {
        if !error.is_finite() {
            self.forget();
            return None;
        }
        if !self.begun {
            (self.begun, self.turned, self.extreme) = (true, error, error);
            self.since_extreme = 0.0;
            return None;
        }
        let beyond = if self.rises { error >= self.extreme } else { error <= self.extreme };
        if beyond {
            self.extreme = error;
            self.to_extreme += std::mem::take(&mut self.since_extreme);
            return None;
        }
        let length = (self.extreme - self.turned).abs();
        let resolution = 0.5 * LEAST / bounds.increments_per_radian.abs();
        if (self.extreme - error).abs() < resolution.max(RETURNS * length) {
            return None;
        }
        let swing = Swing { length, duration: self.to_extreme, reversals: std::mem::take(&mut self.reversals) };
        self.swings.rotate_right(1);
        self.swings[0] = swing;
        self.known = (self.known + 1).min(SWINGS);
        (self.turned, self.extreme, self.rises) = (self.extreme, error, !self.rises);
        self.to_extreme = std::mem::take(&mut self.since_extreme);
        self.judge(bounds)
    }

    fn judge(&self, bounds: &Bounds) -> Option<Finding> {
        let least = LEAST / bounds.increments_per_radian.abs();
        let of = |number: usize| self.swings.get(..number).filter(|_| self.known >= number);
        let growing = of(GROWING).filter(|swings| {
            let grows = swings.windows(2).all(|pair| pair[0].length >= pair[1].length);
            grows && swings[0].length >= 2.0 * swings[GROWING - 1].length
        });
        if let Some(found) = growing.and_then(|swings| self.regular(swings, least)) {
            let amplitude = 0.5 * self.swings[0].length;
            let found = Oscillation { amplitude, ..found };
            if amplitude > 0.5 * bounds.following_error && found.velocity() > bounds.still_below {
                return Some(Finding::Growing(found));
            }
        }
        let lasting = of(SWINGS).filter(|swings| {
            let (shortest, longest) = range(swings.iter().map(|swing| swing.length));
            longest <= EQUAL * shortest && swings[0].length >= LASTING * swings[SWINGS - 1].length
        });
        let found = lasting.and_then(|swings| self.regular(swings, least))?;
        (found.velocity() > bounds.still_below).then_some(Finding::Lasting(found))
    }

    /// The oscillation of `swings`, if their durations are equal and the command does not drive them.
    fn regular(&self, swings: &[Swing], least: f64) -> Option<Oscillation> {
        let (shortest, longest) = range(swings.iter().map(|swing| swing.duration));
        let reversals = swings.iter().fold(0_u32, |sum, swing| sum.saturating_add(swing.reversals));
        let long = swings.iter().all(|swing| swing.length >= least);
        if !long || reversals > REVERSALS || shortest <= 0.0 || longest > EQUAL * shortest {
            return None;
        }
        let number = swings.len() as f64;
        let time = swings.iter().map(|swing| swing.duration).sum::<f64>();
        let length = swings.iter().map(|swing| swing.length).sum::<f64>() / number;
        Some(Oscillation { frequency: 0.5 * number / time, amplitude: 0.5 * length, at_rest: self.velocity == 0.0 })
    }
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, 0.0), |(least, most), value| (value.min(least), value.max(most)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.002;
    const BOUNDS: Bounds = Bounds {
        increments_per_radian: 4000.0 / std::f64::consts::TAU,
        still_below: 2.5,
        max_acceleration: 1500.0,
        following_error: 12.0,
    };

    /// The findings of two seconds, of an error and a commanded velocity by time.
    fn findings(error: impl Fn(f64) -> f64, velocity: impl Fn(f64) -> f64) -> Vec<Finding> {
        let mut watch = OscillationWatch::default();
        let cycle = |number| {
            let time = f64::from(number) * DT;
            watch.command(velocity(time), DT, &BOUNDS);
            watch.observe(error(time), &BOUNDS)
        };
        (0..1000).filter_map(cycle).collect()
    }

    fn sine(frequency: f64, time: f64) -> f64 {
        (std::f64::consts::TAU * frequency * time).sin()
    }

    #[test]
    fn an_oscillation_is_found_with_its_frequency_and_amplitude() {
        for (frequency, amplitude) in [(5.0, 1.0), (20.0, 0.1), (60.0, 0.05), (120.0, 0.02)] {
            let found = findings(|t| 0.3 + amplitude * sine(frequency, t), |_| 0.0);
            let Some(Finding::Lasting(it)) = found.first() else { panic!("{frequency} Hz: {found:?}") };
            assert!((it.frequency / frequency - 1.0).abs() < 0.05 && it.at_rest, "{frequency} Hz: {it:?}");
            assert!((it.amplitude / amplitude - 1.0).abs() < 0.2, "{frequency} Hz: {it:?}");
            assert!(found.iter().all(|it| matches!(it, Finding::Lasting(_))));
        }
    }

    #[test]
    fn an_oscillation_in_motion_is_found_and_one_that_the_command_drives_is_not() {
        let found = findings(|t| 2.0 + 0.1 * sine(20.0, t), |t| 100.0 * t.min(1.0));
        assert!(matches!(found.first(), Some(Finding::Lasting(it)) if !it.at_rest), "{found:?}");
        let found = findings(|t| 0.5 * sine(4.0, t), |t| 80.0 * sine(4.0, t));
        assert_eq!(found, [], "weaving");
    }

    #[test]
    fn an_error_that_fades_drifts_or_flickers_is_no_oscillation() {
        for decay in [4.0, 10.0, 40.0] {
            assert_eq!(findings(|t| (-decay * t).exp() * sine(5.0, t), |_| 0.0), [], "decay {decay}");
        }
        assert_eq!(findings(|t| t * t, |_| 0.0), [], "drift");
        assert_eq!(findings(|t| 0.005 * sine(200.0, t), |_| 0.0), [], "resolution");
        assert_eq!(findings(|t| 0.03 * sine(1.0, t), |_| 0.0), [], "slower than a motor that counts as still");
        assert_eq!(findings(|t| if t < 1.0 { sine(5.0, t) } else { f64::NAN }, |_| 0.0).len(), 2, "forgets at NaN");
    }

    #[test]
    fn growth_is_found_beyond_half_of_the_following_error_and_never_in_a_steady_oscillation() {
        let grown = findings(|t| 0.01 * (8.0 * t).exp().min(1e6) * sine(8.0, t), |_| 0.0);
        let Some(Finding::Growing(it)) = grown.iter().find(|it| matches!(it, Finding::Growing(_))) else {
            panic!("{grown:?}")
        };
        assert!((6.0..12.0).contains(&it.amplitude), "{it:?}");
        // A limit cycle below that amplitude.
        let limited = findings(|t| (0.01 * (8.0 * t).exp()).min(5.0) * sine(8.0, t), |_| 0.0);
        assert!(limited.iter().all(|it| matches!(it, Finding::Lasting(_))), "{limited:?}");
        assert!(!limited.is_empty());
        // A steady one beyond it.
        let steady = findings(|t| 11.0 * sine(8.0, t), |_| 0.0);
        assert!(!steady.is_empty() && steady.iter().all(|it| matches!(it, Finding::Lasting(_))), "{steady:?}");
    }
}
