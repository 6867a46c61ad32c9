//! Reaction of a robot to a light gate, judged on the frames of the bus.
//!
//! The arm stands and reads the gate in every macrostep. A step that sees the expected level moves the column. The reaction
//! is the time from the frame with the new level of the gate to the first frame with a changed set-point.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use ::mrroc::Program;
use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::prelude::{
    AxesState, Cell, Generator, GeneratorError, InputImage, Next, Outcome, Pace, RunOutcome, Setpoint, Shell, V,
};
use ::mrroc::run::{self, Requests, RunOptions};
use can::Instant;
use can::candump::Entry;

use crate::mrroc::{Directory, trace};

/// Duration of a motion in macrosteps of the cell, and its displacement, rad.
const MACROSTEPS: u32 = 3;

const DISPLACEMENT: f64 = 0.003;

/// Edges of the gate: the first comes after homing, s, and the others at all moments of a macrostep, in periods.
const FIRST_EDGE: f64 = 16.0;

pub const EDGES: usize = 40;

const GAP: f64 = 75.0;

const MORE: f64 = 0.85;

/// Node-ID of the module, the bit of the gate in its frame, and the identifier of SYNC.
const NODE: u32 = 40;

const GATE: u8 = 1 << 3;

const SYNC: u32 = 0x80;

/// Times of the cycles whose inputs showed the expected level for the first time.
type Readings = Arc<Mutex<Vec<Instant>>>;

/// Stands until the gate has the expected level, then turns the column forth or back.
struct React {
    gate: u8,
    level: bool,
    pace: Pace,
    /// Number of macrosteps of this pace in the motion, and their duration, s.
    steps: u32,
    macrostep: f64,
    readings: Readings,
}

impl Generator for React {
    type First = ();
    type Every = V<InputImage>;
    type Out = ();
    /// Number of macrosteps of the motion done.
    type Memory = u32;

    fn pace(&self, _: Pace) -> Pace {
        self.pace
    }

    fn first_step(&mut self, (): &(), macrostep: Duration) -> Result<Next<u32>, GeneratorError> {
        self.macrostep = macrostep.as_secs_f64();
        Ok(Next::remember(0))
    }

    fn terminal(&self, done: &u32, _: &V<InputImage>) -> bool {
        *done == self.steps
    }

    fn next_step(&self, done: &u32, v: &V<InputImage>) -> Result<Next<u32>, GeneratorError> {
        let inputs = v.0.younger_than(Duration::from_millis(300))?;
        let input = inputs.input(self.gate).ok_or(GeneratorError::User(1))?;
        if *done == 0 && input.level != self.level {
            return Ok(Next::remember(0));
        }
        if *done == 0 {
            self.readings.lock().expect("no panic").push(inputs.at);
        }
        let share = |done: u32| f64::from(done) / f64::from(self.steps);
        let way = |u: f64| u * u * (3.0 - 2.0 * u);
        let (before, after) = (share(*done), share(done + 1));
        let sense = if self.level { DISPLACEMENT } else { -DISPLACEMENT };
        let rate = sense / (f64::from(self.steps) * self.macrostep);
        let (mut by, mut velocity) = ([0.0; servo::MAX_AXES], [0.0; servo::MAX_AXES]);
        by[0] = sense * (way(after) - way(before));
        velocity[0] = if done + 1 == self.steps { 0.0 } else { rate * 6.0 * after * (1.0 - after) };
        Ok(Next::command(Setpoint::JointsBy(AxesState::new(by, velocity)), done + 1))
    }
}

async fn react(cell: &mut Cell, pace: Pace, readings: &Readings) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    let gate = cell.input("gate")?;
    irb6.enable().await?;
    irb6.home().await?;
    irb6.sense(gate.sensor(), Shell::NonInteractive, 1)?;
    for edge in 0..EDGES {
        let steps = MACROSTEPS * 10 / u32::from(pace.periods);
        let (level, readings) = (edge.is_multiple_of(2), Arc::clone(readings));
        irb6.execute(React { gate: gate.number(), level, pace, steps, macrostep: 0.0, readings }).await?;
    }
    Ok(())
}

/// One reaction. Times are those of the frames.
#[derive(Debug)]
pub struct Reaction {
    /// From the frame of the gate to the first changed set-point, and number of SYNC frames in between.
    pub time: Duration,
    pub syncs: usize,
    /// From the frame of the gate to the cycle that read the level.
    pub read_after: Duration,
}

/// The reactions in a trace.
fn reactions(entries: &[Entry], readings: &[Instant]) -> Vec<Reaction> {
    let mut reactions = Vec::new();
    let (mut level, mut edge, mut targets) = (false, None::<usize>, [const { Vec::new() }; 128]);
    for (place, Entry { frame, .. }) in entries.iter().enumerate() {
        let (function, node) = (frame.raw_id() & 0x780, (frame.raw_id() & 0x7F) as usize);
        if function == 0x180 && frame.raw_id() & 0x7F == NODE && !frame.data().is_empty() {
            let high = frame.data()[0] & GATE != 0;
            if high != level {
                (level, edge) = (high, Some(place));
            }
        } else if function == 0x200 && (1..=5).contains(&node) {
            let changed = targets[node] != frame.data();
            targets[node] = frame.data().to_vec();
            if let Some(begin) = edge.filter(|_| changed) {
                let (received, sent) = (entries[begin].at, entries[place].at);
                let between = &entries[begin..place];
                let Some(read) = readings.get(reactions.len()) else { break };
                reactions.push(Reaction {
                    time: sent.since(received),
                    syncs: between.iter().filter(|entry| entry.frame.raw_id() == SYNC).count(),
                    read_after: read.since(received),
                });
                edge = None;
            }
        }
    }
    reactions
}

/// Runs the cell on `bench` with this servo period. `None` if the run has a fault.
pub fn run(bench: BenchKind, period: Duration, pace: Pace) -> Option<Vec<Reaction>> {
    let directory = Directory::new();
    let path = directory.cell("irb6-touch", |cell| {
        let gate = cell.io[0].input.iter_mut().find(|input| input.name == "gate").unwrap();
        let mut at = FIRST_EDGE;
        gate.emulated_edges_s.clear();
        for edge in 0..EDGES {
            gate.emulated_edges_s.push(at);
            at += (GAP + MORE * (edge * 7 % 12) as f64) * period.as_secs_f64();
        }
        cell.period_us = period.as_micros() as u32;
        // With fine counts, a motion changes the target position within its first period.
        cell.robot[0].axis[0].drive.as_mut().unwrap().counts_per_revolution = 40_000;
    });
    let file = CellFile::read(path).unwrap();
    let frames = directory.path("frames.log");
    let options = RunOptions { trace: Some(frames.clone()), ..RunOptions::on(bench) };
    let readings = Readings::default();
    let seen = Arc::clone(&readings);
    let program = Program::of(async move |cell: &mut Cell| react(cell, pace, &seen).await);
    let report = run::run(&file, &options, &Requests::default(), &program, &mut |_| {}).unwrap();
    if report.outcome != RunOutcome::Completed {
        eprintln!("{:?}", report.faults.iter().map(|fault| &fault.what).collect::<Vec<_>>());
        return None;
    }
    let readings = readings.lock().expect("no panic");
    // The rehearsal read the same edges before.
    let readings = &readings[readings.len() - EDGES..];
    let reactions = reactions(&trace(&frames), readings);
    assert_eq!(reactions.len(), EDGES, "{reactions:?}");
    Some(reactions)
}

const COARSE: Pace = Pace { periods: 10, read_at: 8 };

pub const PERIOD: Duration = Duration::from_millis(2);

/// Servo period by the clock, which leaves the controller of a busy host time for its steps.
pub const BY_THE_CLOCK: Duration = Duration::from_millis(8);

/// Greatest reaction to an edge in the period before the reading, and to an edge at any moment, in periods.
pub const BOUNDS: [(Pace, usize, usize); 2] = [(COARSE, 5, 14), (Pace::PERIOD, 3, 3)];
