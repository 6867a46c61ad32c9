//! A position loop closed by the servo. The inputs are set-points and samples. The output is a velocity, a torque or a
//! duty.

use drive::{AxisState, Finite, Setpoint};

use crate::axis::REMEMBERED;
use crate::regulator::{Incremental, Proportional};
use crate::{FeedForward, HostLoop, Knot, Law, Output};

/// Number of samples in a row above the limit that count as a runaway. A cycle may be half a period late without being
/// counted. The sample then shows the displacement of one and a half periods, which looks like one period. The next
/// sample is punctual and shows the true velocity.
const RUNAWAY_SAMPLES: u32 = 2;

/// Number of cycles at rest after which the output of a loop counts as the output that holds the load.
const REST: u32 = 25;

/// Greatest position error of a motor at rest, and its greatest motion between two samples, increments.
const STILL: f64 = 2.0;

/// The output that held the load at a rest.
#[derive(Clone, Copy, Debug)]
struct Held {
    /// Output without the constant feed-forward.
    output: f64,
    /// Part of the output that fed the weight forward.
    weight: f64,
    /// Position of the motor, rad.
    position: f64,
}

/// The loop of one axis.
///
/// Each cycle first [`observe`](Self::observe)s a sample and then [`regulate`](Self::regulate)s. Errors compare a
/// sample with the command of [`DriveGroup::delay`](drive::DriveGroup::delay) cycles before. While answers are
/// missing, the error keeps its value, as if the axis moved as commanded, and nothing is integrated. The next sample
/// shows the whole error.
#[derive(Clone, Debug)]
pub(crate) struct Loop {
    config: HostLoop,
    law: Regulator,
    delay: usize,
    /// Absolute value of the increments per radian. The law uses the direction of the motor.
    increments_per_radian: f64,
    /// Commanded positions, the newest first, including cycles without a new set-point.
    references: [f64; REMEMBERED],
    /// Velocity of the last set-point, rad/s.
    velocity: f64,
    /// Position of the last sample, rad, and the cycles and periods since then.
    sample: Option<f64>,
    cycles: usize,
    periods: u32,
    /// Periods between the last cycle and the one before.
    last_periods: u32,
    /// Velocity between the last two samples, rad/s.
    pub(crate) measured_velocity: f64,
    /// Samples in a row with a velocity beyond the limit.
    beyond: u32,
    /// Errors of the last sample, rad and rad/s.
    error: f64,
    velocity_error: f64,
    /// Position error used by the law, rad.
    taken: f64,
    /// Number of consecutive cycles at rest.
    rests: u32,
    /// Output that held the load at the last rest. `None` before the first rest, and after [`forget`](Self::forget).
    held: Option<Held>,
}

#[derive(Clone, Debug)]
enum Regulator {
    Incremental(Incremental),
    Cascade { position_gain: f64, velocity_loop: Proportional },
    Proportional(Proportional),
}

impl Loop {
    pub(crate) fn new(config: HostLoop, increments_per_radian: f64, delay: usize) -> Self {
        Self {
            law: match config.law {
                Law::Incremental(law) => Regulator::Incremental(Incremental::new(law)),
                Law::Cascade(law) => Regulator::Cascade {
                    position_gain: law.position_gain,
                    velocity_loop: Proportional::new(law.velocity_loop()),
                },
                Law::Proportional(law) => Regulator::Proportional(Proportional::new(law)),
            },
            config,
            delay,
            increments_per_radian: increments_per_radian.abs(),
            references: [0.0; REMEMBERED],
            velocity: 0.0,
            sample: None,
            cycles: 0,
            periods: 0,
            last_periods: 1,
            measured_velocity: 0.0,
            beyond: 0,
            error: 0.0,
            velocity_error: 0.0,
            taken: 0.0,
            rests: 0,
            held: None,
        }
    }

    /// Takes a sample, `periods` of `dt` seconds after the last cycle.
    pub(crate) fn observe(&mut self, state: &AxisState, periods: u32, dt: f64) {
        self.cycles += 1;
        // With a delay above 1, the sample was taken at the SYNC of the last cycle, so the periods before that cycle
        // apply.
        let before = std::mem::replace(&mut self.last_periods, periods);
        let periods = if self.delay > 1 { before } else { periods };
        self.periods = self.periods.saturating_add(periods);
        if state.age > 0 {
            return;
        }
        // Set-points whose effect is visible in this sample and in the sample before.
        let (now, before) = (self.reference(self.delay - 1), self.reference(self.delay - 1 + self.cycles));
        self.error = now - state.position;
        let last = self.sample.replace(state.position);
        self.measured_velocity = last.map_or(0.0, |last| (state.position - last) / (f64::from(self.periods) * dt));
        self.beyond =
            if self.measured_velocity.abs() > self.config.runaway_velocity { self.beyond.saturating_add(1) } else { 0 };
        self.velocity_error = (now - before) / (self.cycles as f64 * dt) - self.measured_velocity;
        (self.cycles, self.periods) = (0, 0);
    }

    /// One cycle: returns the set-point for the drive from the set-point `knot` and the torque, N·m, that holds the
    /// weight there. `excitation` is added to the output; afterwards `excitation` holds the part that the output limit
    /// let pass.
    pub(crate) fn regulate(&mut self, knot: Knot, torque: f64, dt: f64, excitation: &mut f64) -> Setpoint {
        self.references.rotate_right(1);
        self.references[0] = knot.position;
        let last_velocity = std::mem::replace(&mut self.velocity, knot.velocity);
        let feed = &self.config.feed_forward;
        // The output acts from the last set-point to this one.
        let velocity = 0.5 * (last_velocity + knot.velocity);
        let feed_forward = feed.velocity * velocity
            + feed.acceleration * (knot.velocity - last_velocity) / dt
            + feed.dry(velocity)
            + feed.weight.unwrap_or(0.0) * torque
            + feed.constant;
        let integrated = if self.cycles == 0 { dt } else { 0.0 };
        let grown = self.error - std::mem::replace(&mut self.taken, self.error);
        let output = match &mut self.law {
            Regulator::Incremental(law) => law.step(grown * self.increments_per_radian, feed_forward),
            Regulator::Cascade { position_gain, velocity_loop } => {
                let error = self.velocity_error + *position_gain * self.error;
                velocity_loop.step(error, feed_forward, integrated)
            }
            Regulator::Proportional(law) => law.step(self.error, feed_forward, integrated),
        };
        self.learn(last_velocity == 0.0 && knot.velocity == 0.0 && *excitation == 0.0, torque, dt);
        let output = if *excitation == 0.0 {
            output
        } else {
            let limit = self.config.law.limit();
            let excited = (output + *excitation).clamp(-limit, limit);
            *excitation = excited - output;
            excited
        };
        let output = Finite::new(output).unwrap_or_default();
        match self.config.output {
            Output::Velocity => Setpoint::Velocity(output),
            Output::Torque => Setpoint::Torque(output),
            Output::Duty => Setpoint::Duty(output),
        }
    }

    /// Stores the output that holds the load, if the motor has been at rest for [`REST`] cycles. `still` says whether
    /// the set-point is at rest. `torque` is as in [`Self::regulate`].
    fn learn(&mut self, still: bool, torque: f64, dt: f64) {
        let sample = self.sample.filter(|_| {
            let motion = self.measured_velocity.abs() * dt;
            still && self.cycles == 0 && self.error.abs().max(motion) * self.increments_per_radian <= STILL
        });
        let Some(position) = sample else {
            self.rests = 0;
            return;
        };
        self.rests = self.rests.saturating_add(1);
        if self.rests >= REST {
            let integral = match &self.law {
                Regulator::Incremental(law) => law.integral(),
                Regulator::Cascade { velocity_loop, .. } => velocity_loop.integral(),
                // The velocity loop of the drive holds the load.
                Regulator::Proportional(_) => return,
            };
            let weight = self.config.feed_forward.weight.unwrap_or(0.0) * torque;
            self.held = Some(Held { output: integral + weight, weight, position });
        }
    }

    /// Distance of `position` from the last rest, rad. 0 if the output of a rest is not stored.
    pub(crate) fn distance_from_rest(&self, position: f64) -> f64 {
        self.held.map_or(0.0, |held| (position - held.position).abs())
    }

    /// Discards the output that held the load at the last rest, because the load has changed.
    pub(crate) fn forget(&mut self) {
        self.held = None;
    }

    /// Bumpless transfer: moves the integral part of the law at rest, N·m, into the feed-forward torque, at most
    /// `torque`, and returns the amount moved.
    ///
    /// Where weight is fed forward, the rest of the output at standstill opposes dry friction. The transfer drops that
    /// part, up to the friction of the axis, since the next motion may start in the other direction and has its
    /// friction fed forward. The axis sticks during the transfer, unless it carries an unknown load: then the torque
    /// steps by the friction at most.
    pub(crate) fn hand_over(&mut self, torque: f64) -> f64 {
        let FeedForward { weight, coulomb, stiction, .. } = self.config.feed_forward;
        let Some(weight) = weight.filter(|weight| *weight != 0.0) else {
            return 0.0;
        };
        let given = self.give(weight * torque) / weight;
        let stuck = coulomb.max(stiction.unwrap_or(0.0));
        self.give(stuck);
        self.give(-stuck);
        given
    }

    fn give(&mut self, output: f64) -> f64 {
        match &mut self.law {
            Regulator::Incremental(law) => law.give(output),
            Regulator::Cascade { velocity_loop, .. } => velocity_loop.give(output),
            Regulator::Proportional(_) => 0.0,
        }
    }

    /// Restarts the loop at rest at `position`. `torque` is as in [`Self::regulate`], or 0 if the weight is not known.
    /// The integral part begins with the output that held the load at the last rest. The part of this output for the
    /// weight is left out, unless `torque` is 0, because `torque` feeds the weight forward.
    pub(crate) fn capture(&mut self, position: f64, torque: f64) {
        let preset = self.held.map_or(0.0, |held| if torque == 0.0 { held.output } else { held.output - held.weight });
        match &mut self.law {
            Regulator::Incremental(law) => law.restart(preset),
            Regulator::Cascade { velocity_loop, .. } => velocity_loop.restart(preset),
            Regulator::Proportional(law) => law.reset(),
        }
        self.rests = 0;
        self.follow([position; REMEMBERED], 0.0);
    }

    /// Continues with other commands, the newest first, as if the axis had followed them.
    pub(crate) fn follow(&mut self, commands: [f64; REMEMBERED], velocity: f64) {
        self.references = commands;
        self.velocity = velocity;
        (self.error, self.velocity_error, self.taken) = (0.0, 0.0, 0.0);
    }

    /// Moves all remembered positions by `step`, rad, because the counter was set.
    pub(crate) fn shift(&mut self, step: f64) {
        self.references.iter_mut().for_each(|r| *r += step);
        self.sample = self.sample.map(|sample| sample + step);
        if let Some(held) = &mut self.held {
            held.position += step;
        }
    }

    /// Following error, rad, for a sample `age` cycles old. The function is called before this cycle's command is
    /// stored.
    pub(crate) fn error(&self, state: &AxisState) -> f64 {
        self.reference((self.delay - 1).saturating_add(state.age as usize)) - state.position
    }

    /// The measured velocity and the limit, both rad/s, if [`RUNAWAY_SAMPLES`] samples exceeded the limit.
    pub(crate) fn runaway(&self) -> Option<(f64, f64)> {
        let (velocity, limit) = (self.measured_velocity, self.config.runaway_velocity);
        (velocity.is_nan() || self.beyond >= RUNAWAY_SAMPLES).then_some((velocity, limit))
    }

    fn reference(&self, age: usize) -> f64 {
        self.references[age.min(REMEMBERED - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regulator::{CascadeConfig, IRP6};

    const DT: f64 = 0.002;
    const CASCADE: CascadeConfig =
        CascadeConfig { position_gain: 40.0, velocity_gain: 0.02, integral_rate: 50.0, limit: 100.0 };

    fn cascade(feed_forward: FeedForward) -> Loop {
        let config =
            HostLoop { law: Law::Cascade(CASCADE), output: Output::Torque, feed_forward, runaway_velocity: 300.0 };
        Loop::new(config, -636.6, 2)
    }

    fn torque(setpoint: Setpoint) -> f64 {
        match setpoint {
            Setpoint::Torque(torque) => torque.get(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_cascade_acts_on_both_errors_by_their_gains_and_integrates_the_velocity_error() {
        let mut held = cascade(FeedForward::default());
        held.capture(0.1, 0.0);
        // Position errors of 0.1 and 0.096 rad; the second sample moved at 2 rad/s.
        for (position, expected) in [(0.0, 0.02 * 40.0 * 0.1), (0.004, 0.02 * (40.0 * 0.096 - 2.0) + 0.08 * 50.0 * DT)]
        {
            let state = AxisState { position, ..AxisState::default() };
            held.observe(&state, 1, DT);
            let knot = Knot::at_rest(0.1);
            let found = torque(held.regulate(knot, 0.0, DT, &mut 0.0));
            assert!((found - expected).abs() < 1e-12, "{position}: {found}");
        }
    }

    #[test]
    fn feed_forward_is_what_the_way_to_the_set_point_needs() {
        let mut held = cascade(FeedForward {
            velocity: 0.5,
            acceleration: 0.01,
            coulomb: 0.25,
            weight: Some(0.5),
            constant: -0.125,
            ..FeedForward::default()
        });
        // Velocities of set-points, weight, and the resulting torque from mean velocity, acceleration, dry friction
        // and weight.
        let cases = [
            (0.0, 0.0, -0.125),
            (2.0, 0.0, 0.5 + 10.0 + 0.25 - 0.125),
            (2.0, 3.0, 1.0 + 0.25 + 1.5 - 0.125),
            (-2.0, -1.0, -20.0 - 0.5 - 0.125),
            (-4.0, 0.0, -1.5 - 10.0 - 0.25 - 0.125),
        ];
        for (velocity, weight, expected) in cases {
            let knot = Knot::new(0.0, velocity);
            let found = torque(held.regulate(knot, weight, DT, &mut 0.0));
            assert!((found - expected).abs() < 1e-9, "{velocity}: {found}");
        }
    }

    #[test]
    fn dry_friction_is_greatest_at_break_away_and_turns_round_without_a_step() {
        let feed =
            FeedForward { coulomb: 0.08, stiction: Some(0.12), stribeck_velocity: Some(5.0), ..FeedForward::default() };
        let cases = [
            (0.0, 0.0),
            (1e-9, 0.12e-6),
            (-5e-4, -0.06),
            (0.01, 0.12),
            (5.0, 0.08 + 0.04 / std::f64::consts::E),
            (-5.0, -0.08 - 0.04 / std::f64::consts::E),
            (100.0, 0.08),
        ];
        for (velocity, expected) in cases {
            let found = feed.dry(velocity);
            assert!((found - expected).abs() < 1e-6, "{velocity}: {found}");
        }
    }

    #[test]
    fn what_a_law_has_come_to_hold_by_itself_changes_hands_without_a_step() {
        let incremental = Law::Incremental(IRP6[1]);
        for law in [incremental, Law::Cascade(CASCADE)] {
            let mut held = Loop::new(
                HostLoop {
                    law,
                    output: Output::Torque,
                    feed_forward: FeedForward { weight: Some(2.0), ..FeedForward::default() },
                    runaway_velocity: 300.0,
                },
                636.6,
                2,
            );
            let knot = Knot::at_rest(0.01);
            held.capture(0.0, 0.0);
            // An error caused by a weight, which the integral part then corrects.
            for (position, cycles) in [(0.0, 10), (0.01, 300)] {
                let state = AxisState { position, ..AxisState::default() };
                for _ in 0..cycles {
                    held.observe(&state, 1, DT);
                    held.regulate(knot, 0.0, DT, &mut 0.0);
                }
            }
            let before = torque(held.regulate(knot, 0.0, DT, &mut 0.0));
            assert!(before > 1e-4, "{law:?}: {before} N·m");
            assert_eq!(held.hand_over(-1.0), 0.0, "{law:?}: the other way");
            for asked in [0.25 * before / 2.0, before] {
                // The second transfer requests more than is left.
                let given = held.hand_over(asked);
                assert!(given > 0.0 && given <= asked, "{law:?}: {given}");
                let after = torque(held.regulate(knot, given, DT, &mut 0.0));
                let expected = before - if asked == before { 0.25 * before } else { 0.0 };
                assert!((after - expected).abs() < 1e-9, "{law:?}: {after} for {expected}");
            }
        }
    }

    #[test]
    fn a_loop_that_begins_again_holds_the_load_that_it_held_at_rest() {
        for law in [Law::Incremental(IRP6[0]), Law::Cascade(CASCADE)] {
            let feed_forward = FeedForward { weight: Some(1.0), ..FeedForward::default() };
            let config = HostLoop { law, output: Output::Torque, feed_forward, runaway_velocity: 300.0 };
            let mut held = Loop::new(config, 636.6, 2);
            let rest_at = |held: &mut Loop, position: f64, cycles: u32| {
                let state = AxisState { position, ..AxisState::default() };
                let outputs = (0..cycles).map(|_| {
                    held.observe(&state, 1, DT);
                    torque(held.regulate(Knot::at_rest(0.01), 0.02, DT, &mut 0.0))
                });
                outputs.last().expect("cycles")
            };
            held.capture(0.0, 0.02);
            assert!((torque(held.regulate(Knot::at_rest(0.0), 0.02, DT, &mut 0.0)) - 0.02).abs() < 1e-12, "{law:?}");
            rest_at(&mut held, 0.0, 300);
            let load = rest_at(&mut held, 0.01, 2 * REST);
            assert!((load - 0.02).abs() > 1e-4, "{law:?}: {load} N·m");
            // The motor is blocked more than two increments away from its set-point. This output is not stored.
            rest_at(&mut held, 0.0, 2 * REST);
            // The weight 0.02 was fed forward at the rest. Another weight is fed forward at another pose.
            for (fed_forward, expected) in [(0.0, load), (0.02, load), (0.5, load - 0.02 + 0.5)] {
                let state = AxisState { position: 0.3, ..AxisState::default() };
                (0..2).for_each(|_| held.observe(&state, 1, DT));
                held.capture(0.3, fed_forward);
                held.observe(&state, 1, DT);
                let again = torque(held.regulate(Knot::at_rest(0.3), fed_forward, DT, &mut 0.0));
                assert!((again - expected).abs() < 1e-9, "{law:?}: {again} N·m for {expected}");
            }
            assert!((held.distance_from_rest(0.3) - 0.29).abs() < 1e-9);
            // The load changes.
            held.forget();
            held.observe(&AxisState { position: 1.0, ..AxisState::default() }, 1, DT);
            held.capture(1.0, 0.0);
            assert_eq!(torque(held.regulate(Knot::at_rest(1.0), 0.0, DT, &mut 0.0)), 0.0, "{law:?}");
        }
    }

    #[test]
    fn while_answers_are_missing_errors_stay_and_nothing_is_integrated() {
        let mut held = cascade(FeedForward::default());
        let knot = Knot::at_rest(0.1);
        held.capture(0.0, 0.0);
        let mut state = AxisState::default();
        for _ in 0..5 {
            held.observe(&state, 1, DT);
            held.regulate(knot, 0.0, DT, &mut 0.0);
        }
        let mut outputs = Vec::new();
        for age in 1..=5 {
            state.age = age;
            held.observe(&state, 1, DT);
            outputs.push(torque(held.regulate(knot, 0.0, DT, &mut 0.0)));
        }
        assert!(outputs[0] > 0.08, "{outputs:?}");
        assert!(outputs.iter().all(|output| *output == outputs[0]), "{outputs:?}");
        // The next sample is compared with the command that belongs to it.
        state.age = 0;
        held.observe(&state, 1, DT);
        assert!(torque(held.regulate(knot, 0.0, DT, &mut 0.0)) >= outputs[0]);
    }

    #[test]
    fn velocities_are_over_the_whole_time_between_samples() {
        let mut held = cascade(FeedForward::default());
        let at = |position, age| AxisState { position, age, ..AxisState::default() };
        held.observe(&at(1.0, 0), 1, DT);
        assert_eq!(held.measured_velocity, 0.0, "one sample has no velocity");
        held.observe(&at(1.0, 1), 1, DT);
        held.observe(&at(1.4, 0), 1, DT);
        assert!((held.measured_velocity - 100.0).abs() < 1e-9);
        // After two missed deadlines, the next sample is the one taken later.
        held.observe(&at(1.6, 0), 3, DT);
        assert!((held.measured_velocity - 100.0).abs() < 1e-9);
        held.observe(&at(2.2, 0), 1, DT);
        assert!((held.measured_velocity - 100.0).abs() < 1e-9);
        assert_eq!(held.runaway(), None);
    }

    #[test]
    fn two_samples_in_a_row_are_a_runaway_and_one_is_not() {
        // Displacements per period, in units of 250 rad/s, and the result at the last sample.
        let cases: [(&[f64], bool); 6] = [
            (&[1.0, 1.5, 0.5], false),
            (&[1.0, 1.5], false),
            (&[1.0, 1.5, 0.5, 1.5, 1.0, 1.5], false),
            (&[1.0, 1.21, 1.21], true),
            (&[-1.0, -1.21, -1.21], true),
            (&[1.0, f64::NAN], true),
        ];
        for (ways, expected) in cases {
            let mut held = cascade(FeedForward::default());
            let mut state = AxisState::default();
            held.observe(&state, 1, DT);
            for (number, way) in ways.iter().enumerate() {
                assert_eq!(held.runaway(), None, "{ways:?} at {number}");
                state.position += way * 250.0 * DT;
                held.observe(&state, 1, DT);
            }
            assert_eq!(held.runaway().is_some(), expected, "{ways:?}");
        }
    }
}
