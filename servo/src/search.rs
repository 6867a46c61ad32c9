//! Homing of one axis by the servo: the search for the reference.

use std::time::Duration;

use can::Instant;
use drive::{AxisState, Homing};
use thiserror::Error;

use crate::{Direction, HomingLeg, HostHoming, Knot};

/// State machine of homing by the servo.
///
/// ```text
/// Look ──open──▶ Switch ──closed──▶ rest ──▶ Zero ──attained──▶ rest ──▶ Done
///   │               ▲ │
///   │               │ └─limit switch, once─┐
///   └─closed────────│──▶ Leave ◀───────────┘
///                   └─ rest ◀─┘ closed, then open
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Waits until the drive follows and the states of the switches are known.
    Look,
    /// Moves away from the home switch. `seen`: the switch was closed in this phase or before.
    Leave { seen: bool },
    /// Moves towards the home switch.
    Switch,
    /// Moves off the home switch to the index pulse. `open`: the switch has opened in this phase. Only later index
    /// pulses count, because the point where the axis rested on the switch depends on the speed of the axis.
    Zero { open: bool },
    /// Brakes and then pauses, from the given time on, before the next phase.
    Rest(Option<Instant>, Next),
    /// The counter is set and the motor is at rest.
    Done,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Next {
    Switch,
    Zero,
    Done,
}

/// Why the servo did not find the reference of an axis. The servo then stops the axis within its homing acceleration
/// and switches it off.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum HomingFailure {
    /// The home switch never closed.
    #[error("no home switch within {distance:.1} rad")]
    NoSwitch { distance: f64 },
    /// The home switch did not open again, or did not close on the way back from a limit switch.
    #[error("the home switch was not left within {distance:.1} rad")]
    SwitchNotLeft { distance: f64 },
    /// The axis came to rest beyond the home switch.
    #[error("stopped beyond the home switch; search slower, or brake harder")]
    SwitchPassed,
    #[error("no index pulse within {distance:.1} rad")]
    NoIndex { distance: f64 },
    /// A phase of the search took too long.
    #[error("nothing found within {waited:?}")]
    TimedOut { waited: Duration },
    /// The axis reached a limit switch: the upper one is at the upper end of the counter's travel.
    #[error("ran onto the {} limit switch", if *.upper { "upper" } else { "lower" })]
    LimitSwitch { upper: bool },
}

/// A search under way. Its velocity never changes faster than the configured acceleration, except at a limit switch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Search {
    config: HostHoming,
    /// Sign of the increments per radian, which determines the limit switch in each direction.
    counter: f64,
    phase: Phase,
    /// Start time of the phase, and the distance travelled in the phase, rad.
    since: Option<Instant>,
    travelled: f64,
    /// A limit switch reversed the search.
    pub(crate) reversed: bool,
    home: Debounce,
    lower: Debounce,
    upper: Debounce,
    /// Commanded velocity, rad/s.
    velocity: f64,
}

impl Search {
    pub(crate) fn new(config: HostHoming, increments_per_radian: f64) -> Self {
        Self {
            config,
            counter: increments_per_radian.signum(),
            phase: Phase::Look,
            since: None,
            travelled: 0.0,
            reversed: false,
            home: Debounce::default(),
            lower: Debounce::default(),
            upper: Debounce::default(),
            velocity: 0.0,
        }
    }

    pub(crate) fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    /// Whether the drive has to take the next index pulse as the reference.
    pub(crate) fn is_seeking(&self) -> bool {
        self.phase == Phase::Zero { open: true }
    }

    /// Advances the search and `knot` by one period of `dt` seconds.
    pub(crate) fn advance(
        &mut self,
        knot: &mut Knot,
        state: &AxisState,
        follows: bool,
        now: Instant,
        dt: f64,
    ) -> Result<(), HomingFailure> {
        let known = self.look(state);
        let target = match self.phase {
            Phase::Look => {
                if known && follows {
                    self.begin(if self.home.closed { Phase::Leave { seen: true } } else { Phase::Switch });
                }
                0.0
            }
            Phase::Leave { seen } => {
                let seen = seen || self.home.closed;
                self.phase = Phase::Leave { seen };
                if seen && !self.home.closed {
                    self.rest(Next::Switch)
                } else {
                    let failure = |distance| HomingFailure::SwitchNotLeft { distance };
                    self.travel(-self.sense(), self.config.search, now, failure)?
                }
            }
            Phase::Switch => {
                if self.home.closed {
                    self.rest(Next::Zero)
                } else if self.limit(self.sense()).is_some() && self.config.reverse_at_limit && !self.reversed {
                    self.reversed = true;
                    // The commanded velocity drops to zero at once, without a braking ramp. The drive blocks all
                    // torque in this direction, and a loop would push against the block with its full torque.
                    self.velocity = 0.0;
                    self.begin(Phase::Leave { seen: false });
                    0.0
                } else {
                    self.travel(self.sense(), self.config.search, now, |distance| HomingFailure::NoSwitch { distance })?
                }
            }
            Phase::Zero { open } => {
                let open = open || !self.home.closed;
                self.phase = Phase::Zero { open };
                if state.homing == Homing::Attained {
                    self.rest(Next::Done)
                } else {
                    let failure = |distance| match open {
                        true => HomingFailure::NoIndex { distance },
                        false => HomingFailure::SwitchNotLeft { distance },
                    };
                    self.travel(-self.sense(), self.config.zero, now, failure)?
                }
            }
            Phase::Rest(since, next) => {
                match since {
                    None if self.velocity == 0.0 => self.phase = Phase::Rest(Some(now), next),
                    Some(since) if now.since(since) >= self.config.pause => match next {
                        Next::Switch => self.begin(Phase::Switch),
                        Next::Zero if !self.home.closed => return Err(HomingFailure::SwitchPassed),
                        Next::Zero => self.begin(Phase::Zero { open: false }),
                        Next::Done => self.phase = Phase::Done,
                    },
                    _ => {}
                }
                0.0
            }
            Phase::Done => 0.0,
        };
        self.ramp(knot, target, dt);
        Ok(())
    }

    /// One period of braking, for an interrupted search.
    pub(crate) fn brake(&mut self, knot: &mut Knot, dt: f64) {
        self.phase = Phase::Done;
        self.ramp(knot, 0.0, dt);
    }

    fn ramp(&mut self, knot: &mut Knot, target: f64, dt: f64) {
        let change = self.config.acceleration * dt;
        let last = self.velocity;
        self.velocity += (target - last).clamp(-change, change);
        let step = 0.5 * (last + self.velocity) * dt;
        self.travelled += step.abs();
        knot.position += step;
        knot.velocity = self.velocity;
    }

    fn begin(&mut self, phase: Phase) {
        self.phase = phase;
        self.since = None;
        self.travelled = 0.0;
    }

    /// Enters the rest before `next`, and returns the target velocity zero.
    fn rest(&mut self, next: Next) -> f64 {
        self.phase = Phase::Rest(None, next);
        0.0
    }

    /// Takes the switches of a sample. True once the state of every switch is known.
    fn look(&mut self, state: &AxisState) -> bool {
        let switches = state.switches;
        let enough = self.config.debounce;
        if state.age == 0 {
            self.home.take(switches.home, enough);
            self.lower.take(switches.lower_limit, enough);
            self.upper.take(switches.upper_limit, enough);
        }
        self.home.known && self.lower.known && self.upper.known
    }

    /// The target velocity of a leg in `sense`. A closed limit switch, a time-out and an exceeded distance are errors;
    /// `failure` names the error of the distance.
    fn travel(
        &mut self,
        sense: f64,
        leg: HomingLeg,
        now: Instant,
        failure: impl FnOnce(f64) -> HomingFailure,
    ) -> Result<f64, HomingFailure> {
        if let Some(upper) = self.limit(sense) {
            return Err(HomingFailure::LimitSwitch { upper });
        }
        let waited = now.since(*self.since.get_or_insert(now));
        if waited > leg.timeout {
            return Err(HomingFailure::TimedOut { waited });
        }
        if self.travelled > leg.distance {
            return Err(failure(self.travelled));
        }
        Ok(sense * leg.velocity)
    }

    fn sense(&self) -> f64 {
        match self.config.direction {
            Direction::Negative => -1.0,
            Direction::Positive => 1.0,
        }
    }

    /// The limit switch that blocks motion in `sense`: true for the upper one.
    fn limit(&self, sense: f64) -> Option<bool> {
        let upper = sense * self.counter > 0.0;
        let switch = if upper { &self.upper } else { &self.lower };
        switch.closed.then_some(upper)
    }
}

/// A debounced switch: the state counts once enough samples in a row agree.
#[derive(Clone, Copy, Debug, Default)]
struct Debounce {
    closed: bool,
    known: bool,
    last: bool,
    row: u32,
}

impl Debounce {
    fn take(&mut self, closed: bool, enough: u32) {
        let same = closed == self.last && self.row > 0;
        self.row = if same { self.row.saturating_add(1) } else { 1 };
        self.last = closed;
        if self.row >= enough {
            self.closed = closed;
            self.known = true;
        }
    }
}
