//! Stability of a position loop that the servo closes, with the dead time of its drives.
//!
//! The loop is linear: limits, dry friction and the resolution of the encoder are left out. The motor is a lag: the
//! feed-forward of acceleration and velocity states its inertia and its damping. A loop is accepted if it is stable
//! with [`MARGIN`] times its gain, and with its gain divided by [`MARGIN`]. The second condition concerns loops with
//! integration, which are unstable if the velocity gain is too low for the inertia.
//!
//! Two loops are not checked: the incremental law, whose coefficients are no gains, and a cascade without a feed-forward of
//! acceleration, whose motor has no known inertia.

use std::time::Duration;

use super::refusal::{KeyError, Range, within};
use super::{FeedForward, Law};
use crate::regulator::CascadeConfig;

/// Gain margin of an accepted loop, 6 dB.
const MARGIN: f64 = 2.0;
/// Least and greatest number of cycles in which the response to a displacement and a velocity is computed. The first half
/// is left out of the verdict.
const CYCLES: (usize, usize) = (2048, 65_536);
/// Least duration of the response, in rad of the slowest oscillation: the half that is judged has six oscillations.
const RESPONSE: f64 = 75.0;
/// Longest dead time, cycles.
const LONGEST: usize = 8;
/// Bisections of the greatest gain that fits.
const BISECTIONS: u32 = 20;

/// What a loop acts on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopPlant {
    /// The servo period.
    pub period: Duration,
    /// Cycles from a set-point to the sample that shows its effect: [`DriveGroup::delay`](drive::DriveGroup::delay).
    pub delay: usize,
    /// Inertia, output per rad/s². For a drive that is sent velocities, the lag of its velocity loop, s.
    pub inertia: f64,
    /// Damping, output per rad/s. 1 for a drive that is sent velocities.
    pub damping: f64,
}

/// A key of a law, and its field in the linear law.
type Key = (&'static str, fn(&mut Linear) -> &mut f64);

/// A linear law: `gain * (s + rate * ∫s)` with `s = position * error + velocity * velocity error`.
#[derive(Clone, Copy)]
struct Linear {
    gain: f64,
    position: f64,
    velocity: f64,
    rate: f64,
}

impl Linear {
    fn of(law: &CascadeConfig) -> Self {
        let (gain, position, rate) = (law.velocity_gain, law.position_gain, law.integral_rate);
        Self { gain, position, velocity: 1.0, rate }
    }
}

impl LoopPlant {
    /// The motor under a law with this feed-forward.
    pub fn new(period: Duration, delay: usize, law: &Law, feed_forward: &FeedForward) -> Self {
        let damping = if matches!(law, Law::Proportional(_)) { 1.0 } else { feed_forward.velocity };
        Self { period, delay, inertia: feed_forward.acceleration, damping }
    }

    /// Refuses a law that is unstable with twice or half its gain. The error names the greatest value of one key that
    /// fits. Keys are those of a cell file below `law`. The law and its feed-forward have passed their other checks.
    pub fn check(&self, law: &Law) -> Result<(), KeyError> {
        match *law {
            Law::Proportional(it) => {
                let linear = Linear { gain: it.position_gain, position: 1.0, velocity: 0.0, rate: it.integral_rate };
                self.judge(
                    linear,
                    [
                        ("proportional.integral_rate", |it| &mut it.rate),
                        ("proportional.position_gain", |it| &mut it.gain),
                    ],
                )
            }
            Law::Cascade(it) if self.inertia > 0.0 => self.judge(
                Linear::of(&it),
                [
                    ("cascade.integral_rate", |it: &mut Linear| &mut it.rate),
                    ("cascade.position_gain", |it| &mut it.position),
                    ("cascade.velocity_gain", |it| &mut it.gain),
                ],
            ),
            Law::Incremental(_) | Law::Cascade(_) => Ok(()),
        }
    }

    /// Refuses the first key without which the loop is stable. Each later key is judged without the earlier ones.
    fn judge<const N: usize>(&self, mut law: Linear, keys: [Key; N]) -> Result<(), KeyError> {
        if self.is_stable(law) {
            return Ok(());
        }
        for (number, (key, field)) in keys.into_iter().enumerate() {
            let given = *field(&mut law);
            let with = |value| {
                let mut law = law;
                *field(&mut law) = value;
                self.is_stable(law)
            };
            let is_last = number + 1 == N;
            if with(0.0) || is_last {
                let (mut fits, mut not) = (0.0, given);
                for _ in 0..BISECTIONS {
                    let middle = 0.5 * (fits + not);
                    *if with(middle) { &mut fits } else { &mut not } = middle;
                }
                let of = if self.fades(law, MARGIN) {
                    "a loop that is stable with half its gain, or a greater velocity_gain for this inertia"
                } else {
                    "a loop with a gain margin of 2 at this period and dead time"
                };
                return within(key, given, Range::new(0.0, fits, of));
            }
            *field(&mut law) = 0.0;
        }
        Ok(())
    }

    /// Whether the loop is stable with [`MARGIN`] times its gain, and with its gain divided by [`MARGIN`].
    fn is_stable(&self, law: Linear) -> bool {
        self.fades(law, MARGIN) && self.fades(law, 1.0 / MARGIN)
    }

    /// Number of cycles of the response under this law.
    fn cycles(&self, law: Linear) -> usize {
        let slowest = (law.gain * law.position / self.inertia).sqrt() * self.period.as_secs_f64();
        let cycles = if slowest.is_finite() && slowest > 0.0 { (RESPONSE / slowest).ceil() } else { 0.0 };
        (cycles as usize).clamp(CYCLES.0, CYCLES.1)
    }

    /// Whether the velocity after a displacement and a velocity fades with `factor` times the gain.
    fn fades(&self, law: Linear, factor: f64) -> bool {
        let law = Linear { gain: factor * law.gain, ..law };
        let cycles = self.cycles(law);
        let mut response = Response { position: 1.0, velocity: 1.0, last: 1.0, ..Response::default() };
        let mut greatest = [0.0_f64; 2];
        for cycle in 0..cycles {
            response.step(self, law, 0.0);
            if !response.position.is_finite() {
                return false;
            }
            if cycle >= cycles / 2 {
                let half = usize::from(cycle >= cycles * 3 / 4);
                greatest[half] = greatest[half].max((response.position - response.last).abs());
            }
        }
        greatest[1] <= greatest[0]
    }

    /// Greatest displacement of a motor at rest, rad, after a constant load begins to act. The load is in the unit of
    /// the output. `None` for a loop that is unstable or not checked, and for a velocity loop of the drive.
    pub fn sag(&self, law: &Law, load: f64) -> Option<f64> {
        let Law::Cascade(cascade) = law else { return None };
        let law = Linear::of(cascade);
        let is_known = self.inertia > 0.0 && self.is_stable(law);
        let mut response = Response::default();
        let positions = (0..self.cycles(law)).map(|_| {
            response.step(self, law, load);
            response.position.abs()
        });
        is_known.then(|| positions.fold(0.0, f64::max))
    }
}

/// Response of a loop without commands.
#[derive(Default)]
struct Response {
    position: f64,
    velocity: f64,
    /// Position at the last sample.
    last: f64,
    integral: f64,
    /// The last outputs, the newest first.
    outputs: [f64; LONGEST],
}

impl Response {
    /// Exact motion over a period under a constant output and a constant load.
    fn step(&mut self, plant: &LoopPlant, law: Linear, load: f64) {
        let dt = plant.period.as_secs_f64();
        let s = -law.position * self.position - law.velocity * (self.position - self.last) / dt;
        self.outputs.rotate_right(1);
        self.outputs[0] = law.gain * (s + self.integral);
        self.integral += law.rate * s * dt;
        self.last = self.position;
        let output = self.outputs[plant.delay.clamp(1, LONGEST) - 1] + load;
        // Share of the velocity that is lost in a period is 1 - exp(-fading).
        let fading = plant.damping * dt / plant.inertia;
        if plant.inertia == 0.0 {
            self.position += output / plant.damping * dt;
        } else if fading < 1e-6 {
            let acceleration = output / plant.inertia;
            self.position += (self.velocity + 0.5 * acceleration * dt) * dt;
            self.velocity += acceleration * dt;
        } else {
            let (kept, end) = ((-fading).exp(), output / plant.damping);
            self.position += end * dt + (self.velocity - end) * (1.0 - kept) / fading * dt;
            self.velocity = end + (self.velocity - end) * kept;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regulator::ProportionalConfig;

    const FEED_FORWARD: FeedForward = FeedForward {
        velocity: 0.001,
        acceleration: 0.00043,
        coulomb: 0.08,
        stiction: None,
        stribeck_velocity: None,
        weight: None,
        constant: 0.0,
    };
    const CASCADE: CascadeConfig =
        CascadeConfig { position_gain: 25.0, velocity_gain: 0.043, integral_rate: 10.0, limit: 2.1 };

    fn refused(law: Law, delay: usize, period_us: u64) -> Option<(&'static str, String)> {
        let plant = LoopPlant::new(Duration::from_micros(period_us), delay, &law, &FEED_FORWARD);
        plant.check(&law).err().map(|error| (error.key, error.reason.to_string()))
    }

    fn proportional(position_gain: f64, integral_rate: f64) -> Law {
        Law::Proportional(ProportionalConfig { position_gain, integral_rate, limit: 240.0 })
    }

    #[test]
    fn a_gain_beyond_half_the_limit_of_stability_is_refused_with_the_greatest_that_fits() {
        let without_lag = |delay, gain: f64| {
            let law = proportional(gain, 0.0);
            let plant =
                LoopPlant { inertia: 0.0, ..LoopPlant::new(Duration::from_millis(2), delay, &law, &FEED_FORWARD) };
            plant.check(&law).is_ok()
        };
        // An integrator behind d periods is stable below 2 sin(π / (4 d + 2)) per period.
        for delay in 1..5 {
            let limit = 2.0 * (std::f64::consts::PI / (4.0 * (delay as f64 - 1.0) + 2.0)).sin() / 0.002;
            assert!(without_lag(delay, 0.49 * limit) && !without_lag(delay, 0.51 * limit), "{delay}: {limit}");
        }
    }

    #[test]
    fn loops_that_run_well_are_accepted_and_loops_that_swing_are_refused_at_their_key() {
        let key = |law, delay, period| refused(law, delay, period).map(|(key, _)| key);
        for (law, delay, period, expected) in [
            (Law::Cascade(CASCADE), 2, 2000, None),
            (Law::Cascade(CASCADE), 2, 10_000, Some("cascade.velocity_gain")),
            (Law::Cascade(CASCADE), 2, 6000, Some("cascade.velocity_gain")),
            (Law::Cascade(CascadeConfig { velocity_gain: 0.215, ..CASCADE }), 2, 2000, Some("cascade.velocity_gain")),
            (Law::Cascade(CascadeConfig { integral_rate: 500.0, ..CASCADE }), 2, 2000, Some("cascade.integral_rate")),
            (Law::Cascade(CascadeConfig { position_gain: 300.0, ..CASCADE }), 2, 2000, Some("cascade.position_gain")),
            (proportional(50.0, 0.0), 3, 2000, None),
            (proportional(50.0, 0.0), 3, 13_000, Some("proportional.position_gain")),
            (proportional(200.0, 0.0), 3, 2000, Some("proportional.position_gain")),
            (proportional(50.0, 5.0), 3, 2000, None),
            (proportional(50.0, 5000.0), 3, 2000, Some("proportional.integral_rate")),
        ] {
            assert_eq!(key(law, delay, period), expected, "{law:?}, {delay} cycles, {period} µs");
        }
        let said = refused(proportional(200.0, 0.0), 3, 2000).unwrap().1;
        assert!(said.starts_with("is 200, must be between 0 and 14"), "{said}");
    }

    #[test]
    fn a_load_moves_a_soft_loop_further_than_a_stiff_one() {
        let sag = |velocity_gain, integral_rate| {
            let law = Law::Cascade(CascadeConfig { velocity_gain, integral_rate, ..CASCADE });
            LoopPlant::new(Duration::from_millis(2), 2, &law, &FEED_FORWARD).sag(&law, 0.4).unwrap()
        };
        // Without integration, the loop rests where gain * position gain * displacement is the load.
        let rest = 0.4 / (CASCADE.velocity_gain * CASCADE.position_gain);
        assert!((sag(CASCADE.velocity_gain, 0.0) / rest - 1.0).abs() < 0.02, "{}", sag(CASCADE.velocity_gain, 0.0));
        let (stiff, soft) = (sag(CASCADE.velocity_gain, 10.0), sag(0.2 * CASCADE.velocity_gain, 10.0));
        assert!(stiff < rest && soft > 4.0 * stiff && soft < 10.0 * stiff, "{stiff}, {soft}");
        // An unstable loop does not come to rest.
        let law = Law::Cascade(CascadeConfig { velocity_gain: 10.0 * CASCADE.velocity_gain, ..CASCADE });
        assert_eq!(LoopPlant::new(Duration::from_millis(2), 2, &law, &FEED_FORWARD).sag(&law, 0.4), None);
    }

    #[test]
    fn a_loop_that_integrates_is_refused_if_its_velocity_gain_is_too_low_for_the_inertia() {
        // Without dead time and damping, s³ + ω s² + ω (p + r) s + ω p r is stable above ω = p r / (p + r), with the
        // position gain p, the integral rate r, and the velocity gain over the inertia ω.
        let least = CASCADE.position_gain * CASCADE.integral_rate / (CASCADE.position_gain + CASCADE.integral_rate);
        let undamped = FeedForward { velocity: 0.0, ..FEED_FORWARD };
        let check = |bandwidth: f64, integral_rate| {
            let law = Law::Cascade(CascadeConfig {
                velocity_gain: bandwidth * undamped.acceleration,
                integral_rate,
                ..CASCADE
            });
            LoopPlant::new(Duration::from_millis(2), 2, &law, &undamped).check(&law)
        };
        assert_eq!(check(2.3 * least, CASCADE.integral_rate), Ok(()));
        let refused = check(1.7 * least, CASCADE.integral_rate).unwrap_err();
        assert_eq!(refused.key, "cascade.integral_rate");
        let said = refused.reason.to_string();
        assert!(said.contains("must be between 0 and 6.") && said.contains("a greater velocity_gain"), "{said}");
        // A loop without integration is stable with any gain, however slow.
        for bandwidth in [1e-4, 1e-3, 0.01, 0.1, 1.0, 10.0] {
            assert_eq!(check(bandwidth, 0.0), Ok(()), "{bandwidth}");
        }
    }
}
