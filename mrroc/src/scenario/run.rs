//! A scenario in progress: begins and ends its faults in the emulated world.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::Instant;
use hil::{DriveId, FaultInEffect, World, WorldFault};

use super::{FaultTime, MotionEvent, Scenario};
use crate::bench::drive_ids::DriveIds;
use crate::cell::CellFile;

/// A scenario in progress.
pub struct ScenarioRun {
    faults: Vec<Planned>,
    passed: Instant,
    /// Interval at which events are looked for.
    period: Duration,
    look_at: Instant,
}

/// The faults of a scenario that have acted, for the report of a run. Clones read the same state.
#[derive(Clone, Debug, Default)]
pub struct ScenarioProbe(Vec<(String, Arc<AtomicBool>)>);

impl ScenarioProbe {
    /// The faults that have not acted: each has not begun, or has damaged no frame and no telegram.
    pub fn idle(&self) -> Vec<String> {
        let idle = self.0.iter().filter(|(_, acted)| !acted.load(Ordering::Relaxed));
        idle.map(|(label, _)| format!("scenario: {label} has not acted")).collect()
    }
}

struct Planned {
    /// Number, kind and beginning, for reports.
    label: String,
    acted: Arc<AtomicBool>,
    time: FaultTime,
    duration: Option<Duration>,
    faults: Vec<WorldFault>,
    /// The drives whose motion the event concerns, with their greatest velocities, rad/s.
    watched: Vec<(DriveId, f64)>,
    /// Greatest share of the permitted velocity at the last look.
    speed: f64,
    /// Time since which all drives have been at rest.
    still_since: Instant,
    state: State,
}

enum State {
    Waiting,
    InEffect(Vec<FaultInEffect>, Option<Instant>),
    Over,
}

/// Share of the greatest velocity below which a robot is at rest.
const REST: f64 = 2e-3;

/// Share of the greatest velocity by which the speed changes at least in a period of acceleration.
const CHANGE: f64 = 2e-4;

/// Time at rest after which a robot is idle.
const IDLE: Duration = Duration::from_millis(100);

impl ScenarioRun {
    /// The scenario in the world of a cell, or what is wrong with it.
    pub fn new(scenario: &Scenario, file: &CellFile, ids: &DriveIds) -> anyhow::Result<Self> {
        let mut run = Self::empty(file);
        run.add(scenario, file, ids)?;
        Ok(run)
    }

    /// A run without faults, in a world of this period.
    pub fn empty(file: &CellFile) -> Self {
        Self { faults: Vec::new(), passed: Instant::ZERO, period: file.cell.period(), look_at: Instant::ZERO }
    }

    /// Adds the faults of a scenario. Faults of the past begin at once.
    pub fn add(&mut self, scenario: &Scenario, file: &CellFile, ids: &DriveIds) -> anyhow::Result<()> {
        let faults = scenario.resolve(file, ids)?;
        let still_since = self.passed;
        self.faults.extend(faults.into_iter().map(|fault| Planned {
            label: fault.label,
            acted: Arc::default(),
            time: fault.time,
            duration: fault.duration,
            faults: fault.faults,
            watched: fault.watched,
            speed: 0.0,
            still_since,
            state: State::Waiting,
        }));
        Ok(())
    }

    /// Begins and ends the faults that are due by `until`, in the order of their times.
    pub fn advance(&mut self, world: &mut World, until: Instant) {
        while let Some(at) = self.next().filter(|at| *at <= until) {
            let at = at.max(self.passed);
            self.passed = at;
            if at >= self.look_at {
                world.advance(at);
                self.look(world, at);
                self.look_at = at + self.period;
            }
            for fault in &mut self.faults {
                fault.act(world, at, self.period);
            }
        }
        self.passed = self.passed.max(until);
    }

    /// Notes the faults that have acted in the world, after the world was advanced.
    pub fn note(&self, world: &World) {
        self.faults.iter().for_each(|fault| fault.note(world));
    }

    /// The present faults, and whether each has acted.
    pub fn watch(&self) -> ScenarioProbe {
        ScenarioProbe(self.faults.iter().map(|fault| (fault.label.clone(), fault.acted.clone())).collect())
    }

    fn next(&self) -> Option<Instant> {
        let waits = |fault: &Planned| matches!((&fault.state, fault.time), (State::Waiting, FaultTime::When(..)));
        let look = self.faults.iter().any(waits).then_some(self.look_at);
        self.faults.iter().filter_map(|fault| fault.due(self.period)).chain(look).min()
    }

    fn look(&mut self, world: &World, now: Instant) {
        for fault in &mut self.faults {
            let FaultTime::When(event, after) = fault.time else {
                continue;
            };
            if !matches!(fault.state, State::Waiting) {
                continue;
            }
            let share =
                |(drive, most): &(DriveId, f64)| world.plant(*drive).map_or(0.0, |it| it.velocity().abs() / most);
            let speed = fault.watched.iter().map(share).fold(0.0, f64::max);
            let change = speed - fault.speed;
            fault.speed = speed;
            if speed > REST {
                fault.still_since = now;
            }
            let happens = match event {
                MotionEvent::Idle => now.since(fault.still_since) >= IDLE,
                MotionEvent::Moving => speed > REST,
                MotionEvent::Accelerating => speed > 10.0 * REST && change > CHANGE,
                MotionEvent::Cruising => speed > 10.0 * REST && change.abs() <= CHANGE,
                MotionEvent::Braking => speed > 10.0 * REST && change < -CHANGE,
            };
            if happens && now >= Instant::ZERO + after {
                fault.time = FaultTime::At(now.since(Instant::ZERO));
            }
        }
    }
}

impl Planned {
    /// Time of the next begin or end.
    fn due(&self, period: Duration) -> Option<Instant> {
        match (&self.state, self.time) {
            (State::Waiting, FaultTime::At(at)) => Some(Instant::ZERO + at),
            (State::Waiting, FaultTime::Cycle(cycle)) => Some(Instant::ZERO + period * cycle),
            (State::InEffect(_, end), _) => *end,
            (State::Waiting, FaultTime::When(..)) | (State::Over, _) => None,
        }
    }

    fn note(&self, world: &World) {
        let State::InEffect(faults, _) = &self.state else {
            return;
        };
        if !self.acted.load(Ordering::Relaxed) && faults.iter().any(|fault| world.has_acted(fault)) {
            self.acted.store(true, Ordering::Relaxed);
        }
    }

    fn act(&mut self, world: &mut World, now: Instant, period: Duration) {
        if self.due(period).is_none_or(|due| due > now) {
            return;
        }
        if matches!(self.state, State::InEffect(..)) {
            world.advance(now);
            self.note(world);
        }
        self.state = match std::mem::replace(&mut self.state, State::Over) {
            State::Waiting => {
                let begun = self.faults.iter().map(|fault| world.begin_fault(fault, now)).collect();
                State::InEffect(begun, self.duration.map(|duration| now + duration))
            }
            State::InEffect(faults, _) => {
                faults.iter().for_each(|fault| world.end_fault(fault, now));
                State::Over
            }
            State::Over => State::Over,
        };
    }
}
