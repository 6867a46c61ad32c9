//! The drive that both protocols share, and the cabinet of several drives.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use can::Instant;
use serial::nfv2::Gains;

use super::AxisControllerConfig;
use crate::{Demand, Feedback, PlantAxis, Trip};

const SUB_STEP: Duration = Duration::from_micros(100);
const SUB_STEP_NANOS: u64 = SUB_STEP.as_nanos() as u64;
/// Number of sub-steps between checks of the switches and the index pulse: 1 ms.
const CHUNK: u32 = 10;
/// Longest interval between two advances of the axis.
const LAZIEST: Duration = Duration::from_millis(20);
/// Full pulse width of the power stage.
const FULL: f64 = 1000.0;
/// Denominator of the gains.
const ONE: f64 = 32_768.0;

/// Modes of the power stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Open until a mode is set.
    Manual,
    /// Pulse widths.
    Pwm,
    /// Current control.
    Current,
    /// Open until [`Mode::Manual`] is set.
    Error,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Search {
    Off,
    Armed,
    Found,
}

/// Faults latched until [`Mode::Manual`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Faults {
    pub(super) over_current: bool,
    /// The winding is too hot, or the supply was off.
    pub(super) power_stage: bool,
}

pub(super) struct Drive {
    pub(super) axis: PlantAxis,
    pub(super) feedback: Feedback,
    /// Time up to which the axis has been simulated.
    inner: Instant,
    supply: f64,
    pub(super) mode: Mode,
    /// Set-point of the current mode: pulse width, or mA.
    set_point: f64,
    pub(super) search: Search,
    /// Position counter = raw counter + offset.
    offset: i32,
    pub(super) synchronized: bool,
    faults: Faults,
    cabinet: Cabinet,
    /// The chunk in progress of an axis in a scene: number of sub-steps done, and the demand.
    chunk: Option<(u32, Demand)>,
}

impl Drive {
    pub(super) fn new(config: &AxisControllerConfig) -> Self {
        let mut settings = config.axis;
        settings.amplifier.max_voltage = config.supply;
        let axis = PlantAxis::mounted(&settings, config.seed, config.mount.as_ref());
        let mut drive = Self {
            feedback: axis.feedback(),
            axis,
            inner: config.power_on,
            supply: config.supply,
            mode: Mode::Manual,
            set_point: 0.0,
            search: Search::Off,
            offset: config.counter,
            synchronized: config.synchronized,
            faults: Faults::default(),
            cabinet: config.cabinet.clone(),
            chunk: None,
        };
        drive.set_current_gains(Gains::POWER_ON);
        drive
    }

    /// Advances the axis to the last sub-step before `now`. An axis in a scene is already there, and only its chunk
    /// ends.
    pub(super) fn catch_up(&mut self, now: Instant) {
        // A chunk in progress may have begun in a scene that has ended since.
        self.cut_chunk();
        if self.axis.in_scene() {
            return;
        }
        loop {
            let left = now.since(self.inner).as_nanos() / SUB_STEP.as_nanos();
            let steps = CHUNK.min(u32::try_from(left).unwrap_or(CHUNK));
            if steps == 0 {
                return;
            }
            self.check_supply();
            self.axis.advance(steps, self.demand());
            self.conclude(steps);
        }
    }

    /// Advances an axis in a scene to the last sub-step before `now`.
    pub(super) fn advance_mechanics(&mut self, now: Instant) {
        if !self.axis.in_scene() {
            return;
        }
        let reached = self.inner.as_nanos() + self.chunk.map_or(0, |(steps, _)| u64::from(steps)) * SUB_STEP_NANOS;
        for _ in 0..now.as_nanos().saturating_sub(reached) / SUB_STEP_NANOS {
            let (steps, demand) = self.chunk.unwrap_or_else(|| {
                self.check_supply();
                let demand = self.demand();
                self.axis.begin(demand);
                (0, demand)
            });
            self.axis.sub_step(steps, demand);
            self.chunk = Some((steps + 1, demand));
            if steps + 1 == CHUNK {
                self.cut_chunk();
            }
        }
    }

    /// Ends the chunk in progress of an axis in a scene. The next sub-step begins a chunk with a new demand.
    fn cut_chunk(&mut self) {
        if let Some((steps, _)) = self.chunk.take() {
            self.axis.end(steps);
            self.conclude(steps);
        }
    }

    /// A power stage that loses its supply while in use stays off. The stop is checked once per chunk.
    fn check_supply(&mut self) {
        self.faults.power_stage |= self.mode != Mode::Manual && self.cabinet.is_open(self.inner);
    }

    /// Reads the sensors after a chunk of `steps` sub-steps.
    fn conclude(&mut self, steps: u32) {
        self.inner += steps * SUB_STEP;
        self.feedback = self.axis.feedback();
        self.faults.over_current |= self.feedback.trip == Some(Trip::OverCurrent);
        self.faults.power_stage |= self.feedback.trip == Some(Trip::OverTemperature);
        if self.search == Search::Armed
            && let Some(at) = self.axis.take_index()
        {
            self.offset = at.wrapping_neg();
            self.synchronized = true;
            self.search = Search::Found;
        }
    }

    /// Latest time at which the axis has to be advanced.
    pub(super) fn poll_timeout(&self) -> Instant {
        self.inner + LAZIEST
    }

    fn demand(&self) -> Demand {
        if self.faults != Faults::default() {
            return Demand::Off;
        }
        let into_switch = self.set_point > 0.0 && self.feedback.positive_limit
            || self.set_point < 0.0 && self.feedback.negative_limit;
        match self.mode {
            Mode::Manual | Mode::Error => Demand::Off,
            Mode::Pwm | Mode::Current if into_switch => Demand::Duty(0.0),
            Mode::Pwm => Demand::Duty(self.set_point / FULL),
            Mode::Current => Demand::Current(self.set_point * 1e-3),
        }
    }

    /// Restarts the unit: manual mode, no reference, and the counter begins at zero.
    pub(super) fn restart(&mut self) {
        self.set_mode(Mode::Manual);
        self.set_point = 0.0;
        self.search = Search::Off;
        self.offset = self.feedback.counts.wrapping_neg();
        self.synchronized = false;
    }

    /// Changes the mode. Setting the current mode again keeps the set-point. Only manual mode leaves error mode.
    pub(super) fn set_mode(&mut self, mode: Mode) {
        if self.mode == Mode::Error && mode != Mode::Manual {
            return;
        }
        if mode == Mode::Manual {
            self.faults = Faults::default();
        }
        if mode != self.mode {
            match (self.mode, mode) {
                (Mode::Error, _) => self.cabinet.leave_error(self.inner),
                (_, Mode::Error) => self.cabinet.enter_error(self.inner),
                _ => {}
            }
            self.mode = mode;
            self.set_point = 0.0;
        }
    }

    /// Sets a pulse width or a current, mA, for the mode that follows it.
    pub(super) fn set_point(&mut self, mode: Mode, value: i16) {
        if mode == self.mode {
            let value = f64::from(value);
            self.set_point = match mode {
                Mode::Pwm => value.clamp(-FULL, FULL),
                Mode::Current => value,
                Mode::Manual | Mode::Error => 0.0,
            };
        }
    }

    /// Starts or ends the index search. During the search the next index pulse zeroes the counter.
    pub(super) fn search_index(&mut self, on: bool) {
        if !on {
            self.search = Search::Off;
        } else if self.search == Search::Off {
            self.axis.take_index();
            self.search = Search::Armed;
        }
    }

    /// Current limit, mA. With a limit of zero or less, any current trips the drive.
    pub(super) fn set_max_current(&mut self, current: i16) {
        self.axis.amplifier.config.trip_current = f64::from(current.max(0)) * 1e-3;
    }

    pub(super) fn set_current_gains(&mut self, gains: Gains) {
        // Conversion from pulse width per mA to V/A.
        let scale = self.supply / FULL * 1e3 / ONE;
        let (p, i) = (f64::from(gains.p) * scale, f64::from(gains.i) * scale);
        // The integral of the axis's loop lags by one sub-step. Adding the integral gain to the proportional gain
        // compensates.
        self.axis.amplifier.set_current_gains(p + i, i);
    }

    pub(super) fn cabinet(&self) -> &Cabinet {
        &self.cabinet
    }

    pub(super) fn position(&self) -> i32 {
        self.feedback.counts.wrapping_add(self.offset)
    }

    /// Current, mA.
    pub(super) fn current(&self) -> i16 {
        (self.feedback.current * 1e3).round() as i16
    }

    /// The faults that both protocols report. An open stop is shown as a fault of the power stage.
    pub(super) fn faults(&self) -> Faults {
        Faults { power_stage: self.faults.power_stage || self.cabinet.is_open(self.inner), ..self.faults }
    }
}

/// Drives that share one emergency stop. The stop is open while any of the drives is in error. Clones refer to the
/// same cabinet. All drives of a cabinet belong to one world.
#[derive(Clone, Debug, Default)]
pub struct Cabinet(Arc<Stop>);

/// The order of the two atomics does not matter: one thread at a time moves the drives of a cabinet.
#[derive(Debug, Default)]
struct Stop {
    in_error: AtomicU32,
    /// Time of the last opening or closing, ns.
    changed: AtomicU64,
}

impl Cabinet {
    /// Whether a drive of the cabinet is in its error state, which opens the emergency stop.
    pub fn has_error(&self) -> bool {
        self.0.in_error.load(Ordering::Relaxed) > 0
    }

    /// Whether both refer to the same cabinet.
    pub(crate) fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    fn enter_error(&self, now: Instant) {
        if self.0.in_error.fetch_add(1, Ordering::Relaxed) == 0 {
            self.change(now);
        }
    }

    fn leave_error(&self, now: Instant) {
        if self.0.in_error.fetch_sub(1, Ordering::Relaxed) == 1 {
            self.change(now);
        }
    }

    fn change(&self, now: Instant) {
        self.0.changed.store(now.as_nanos(), Ordering::Relaxed);
    }

    /// Whether the stop is open at `at`, which may be past for a lagging drive, back to the last change but one.
    fn is_open(&self, at: Instant) -> bool {
        let open = self.0.in_error.load(Ordering::Relaxed) > 0;
        let changed = self.0.changed.load(Ordering::Relaxed);
        open == (at.as_nanos() >= changed)
    }
}
