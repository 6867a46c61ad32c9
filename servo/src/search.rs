//! The search of one axis for its reference, where the servo homes it.

use std::time::Duration;

use can::Instant;
use drive::{AxisState, Homing, Switches};
use thiserror::Error;

use crate::{Direction, HomingLeg, HostHoming, Knot};

/// Where homing by the servo is.
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
    /// Waiting for the drive to follow and for the switches to be known.
    Look,
    /// Away from the home switch.
    Leave {
        /// It was closed on this way or before.
        seen: bool,
    },
    /// Towards the home switch.
    Switch,
    /// Off the home switch to the index pulse.
    Zero {
        /// The home switch opened on this way: pulses count from there, since where the axis rested depends on how
        /// fast it came.
        open: bool,
    },
    /// Braking, then pausing since the time given, before what comes next.
    Rest(Option<Instant>, Next),
    /// The counter is set, the motor at rest.
    Done,
}

/// What follows a rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Next {
    Switch,
    Zero,
    Done,
}

/// Why the servo did not find the reference of an axis. What it does then is a stop within the axis's
/// homing acceleration, and off.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum HomingFailure {
    /// The home switch never closed.
    #[error("no home switch within {distance:.1} rad")]
    NoSwitch {
        /// How far it was searched, rad.
        distance: f64,
    },
    /// The home switch did not open again, or never closed on the way back from a limit switch.
    #[error("the home switch was not left within {distance:.1} rad")]
    SwitchNotLeft {
        /// How far the axis went, rad.
        distance: f64,
    },
    /// The axis came to rest beyond the home switch.
    #[error("stopped beyond the home switch; search slower, or brake harder")]
    SwitchPassed,
    /// No index pulse.
    #[error("no index pulse within {distance:.1} rad")]
    NoIndex {
        /// How far it was searched, rad.
        distance: f64,
    },
    /// A leg took too long.
    #[error("nothing found within {waited:?}")]
    TimedOut {
        /// Time the leg took.
        waited: Duration,
    },
    /// A limit switch was in the way.
    #[error("ran onto the {} limit switch", if *.upper { "upper" } else { "lower" })]
    LimitSwitch {
        /// At the upper end of the counter's travel, not at its lower.
        upper: bool,
    },
}

/// The search at work. Its velocity never changes faster than the configured acceleration, but for a limit switch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Search {
    config: HostHoming,
    /// Sign of the increments per radian: which limit switch is where.
    counter: f64,
    phase: Phase,
    /// When the leg began, and the way gone in it, rad.
    since: Option<Instant>,
    travelled: f64,
    /// A limit switch turned the search round.
    reversed: bool,
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

    /// Whether the next index pulse is to be taken for the reference.
    pub(crate) fn is_seeking(&self) -> bool {
        self.phase == Phase::Zero { open: true }
    }

    /// Whether a limit switch turned it round.
    pub(crate) fn is_reversed(&self) -> bool {
        self.reversed
    }

    /// One period of `dt` seconds: moves `knot` on.
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
                    self.begin(if self.home.closed {
                        Phase::Leave { seen: true }
                    } else {
                        Phase::Switch
                    });
                }
                0.0
            }
            Phase::Leave { seen } => {
                let seen = seen || self.home.closed;
                self.phase = Phase::Leave { seen };
                if seen && !self.home.closed {
                    self.rest(Next::Switch)
                } else if let Some(upper) = self.limit(-self.sense()) {
                    return Err(HomingFailure::LimitSwitch { upper });
                } else {
                    let distance = self.watch(self.config.search, now)?;
                    if let Some(distance) = distance {
                        return Err(HomingFailure::SwitchNotLeft { distance });
                    }
                    -self.sense() * self.config.search.velocity
                }
            }
            Phase::Switch => {
                if self.home.closed {
                    self.rest(Next::Zero)
                } else if let Some(upper) = self.limit(self.sense()) {
                    if self.reversed || !self.config.reverse_at_limit {
                        return Err(HomingFailure::LimitSwitch { upper });
                    }
                    self.reversed = true;
                    // Neither brakes nor rests: the drive lets nothing pass in this sense any more, and a loop that
                    // held the motor there would push against that with all its torque.
                    self.velocity = 0.0;
                    self.begin(Phase::Leave { seen: false });
                    0.0
                } else {
                    let distance = self.watch(self.config.search, now)?;
                    if let Some(distance) = distance {
                        return Err(HomingFailure::NoSwitch { distance });
                    }
                    self.sense() * self.config.search.velocity
                }
            }
            Phase::Zero { open } => {
                let open = open || !self.home.closed;
                self.phase = Phase::Zero { open };
                if state.homing == Homing::Attained {
                    self.rest(Next::Done)
                } else if let Some(upper) = self.limit(-self.sense()) {
                    return Err(HomingFailure::LimitSwitch { upper });
                } else {
                    let distance = self.watch(self.config.zero, now)?;
                    if let Some(distance) = distance {
                        return Err(if open {
                            HomingFailure::NoIndex { distance }
                        } else {
                            HomingFailure::SwitchNotLeft { distance }
                        });
                    }
                    -self.sense() * self.config.zero.velocity
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

    /// One period of a stop in the middle.
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

    /// The velocity to brake to.
    fn rest(&mut self, next: Next) -> f64 {
        self.phase = Phase::Rest(None, next);
        0.0
    }

    /// Takes the switches of a sample; whether all are known.
    fn look(&mut self, state: &AxisState) -> bool {
        let Switches {
            home,
            lower_limit,
            upper_limit,
        } = state.switches;
        let enough = self.config.debounce;
        if state.age == 0 {
            self.home.take(home, enough);
            self.lower.take(lower_limit, enough);
            self.upper.take(upper_limit, enough);
        }
        self.home.known && self.lower.known && self.upper.known
    }

    /// Whether time or way of a leg is over: an error, or the way.
    fn watch(&mut self, leg: HomingLeg, now: Instant) -> Result<Option<f64>, HomingFailure> {
        let waited = now.since(*self.since.get_or_insert(now));
        if waited > leg.timeout {
            return Err(HomingFailure::TimedOut { waited });
        }
        Ok((self.travelled > leg.distance).then_some(self.travelled))
    }

    /// +1 or -1: where the home switch is searched.
    fn sense(&self) -> f64 {
        match self.config.direction {
            Direction::Negative => -1.0,
            Direction::Positive => 1.0,
        }
    }

    /// The limit switch, upper or not, that stands in the way of motion in `sense`.
    fn limit(&self, sense: f64) -> Option<bool> {
        let upper = sense * self.counter > 0.0;
        let switch = if upper { &self.upper } else { &self.lower };
        switch.closed.then_some(upper)
    }
}

/// A switch that counts as open or closed once enough samples in a row say so.
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
