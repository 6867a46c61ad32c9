//! Rehearsal with the scene: the task on the emulated cell in virtual time, with contact and sensors.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};

use super::{Extent, Rehearsed, aside, beside_home, courses, from_home, run};
use crate::bench::BenchKind;
use crate::cell::CellFile;
use crate::report::{RunOutcome, RunReport, counted};
use crate::run::{Progress, Requests, RunOptions, run_rehearsed};
use crate::tasks::Program;

/// Greatest number of faults that a refusal describes. All further faults are only counted.
const TOLD: usize = 3;

/// Rehearses a task on the emulated cell with its scene, like a run with [`BenchKind::Lockstep`]. The emulated cell has
/// contact, sensors with their faults, and drives that home, accelerate and may be overloaded. A fault that the task
/// does not handle is a refusal. The rehearsal ends early, with a refusal, once `stop` is set.
///
/// Ideal drives rehearse the task as well ([`rehearse`](super::rehearse)), for the places beside the home positions. A
/// refusal by ideal drives does not count if the task needs contact or sensors before the refused instruction.
pub fn rehearse_with_scene(file: &CellFile, program: &Program, stop: &Arc<AtomicBool>) -> anyhow::Result<Rehearsed> {
    if file.cell.scene.is_none() {
        bail!(
            "--rehearse-with-scene needs a scene, and the cell has no table [scene]: add one, or leave the option out"
        );
    }
    let in_scene = in_scene(file, program, stop).context("in the rehearsal with the scene, nothing has moved")?;
    let InScene { duration, instructions, moved } = in_scene;
    let wanted = moved.clone();
    let rehearsed = aside(file, program, move |file, program, turns| {
        match from_home(file, program, turns) {
            Ok(rehearsed) => {
                beside_home(file, program, &wanted, turns)?;
                Ok(rehearsed)
            }
            Err(_) => {
                let (home, never) = (courses(file, &|home| home.motors), AtomicBool::new(false));
                // A first motion that needs contact is already refused from home.
                if run(file, program, &home, Extent::FirstMotions(&wanted), &never, turns).is_ok() {
                    beside_home(file, program, &wanted, turns)?;
                }
                Ok(Rehearsed::unknown(wanted))
            }
        }
    })?;
    Ok(Rehearsed { with_scene: Some(duration), instructions, moved, ..rehearsed })
}

/// Result of a rehearsal with the scene.
struct InScene {
    /// Duration with homing.
    duration: Duration,
    instructions: u64,
    /// Whether a generator commanded each robot.
    moved: Vec<bool>,
}

fn in_scene(file: &CellFile, program: &Program, stop: &Arc<AtomicBool>) -> anyhow::Result<InScene> {
    let robots = file.cell.robot.len();
    let (mut instructions, mut moved) = (0, vec![false; robots]);
    let mut note = |news: Progress| {
        instructions += news.ended;
        moved[news.robot] |= news.moved;
    };
    let (options, requests) = (RunOptions::on(BenchKind::Lockstep), Requests::stopped_by(stop));
    let before = Rehearsed::unknown(vec![false; robots]);
    let program = program.clone().rehearsed_with_scene();
    let report = run_rehearsed(file, &options, &requests, &program, (&before, None), &mut note)?;
    match report.outcome {
        RunOutcome::Completed => {
            let duration = Duration::from_micros(report.cycle.cycles * u64::from(report.cycle.period_us));
            Ok(InScene { duration, instructions, moved })
        }
        RunOutcome::Stopped => bail!("the rehearsal was stopped"),
        RunOutcome::Faulted => Err(refusal(&report)),
    }
}

/// The faults of a rehearsal as one refusal.
fn refusal(report: &RunReport) -> anyhow::Error {
    let mut told: Vec<_> = report.faults.iter().take(TOLD).map(ToString::to_string).collect();
    if report.faults.len() > TOLD {
        told.push(format!("and {}", counted(report.faults.len() - TOLD, "more fault")));
    }
    anyhow!("{}", told.join("; "))
}

impl Rehearsed {
    /// A task that no rehearsal on ideal drives has completed.
    fn unknown(moved: Vec<bool>) -> Self {
        Self {
            duration: None,
            with_scene: None,
            instructions: 0,
            moved,
            refused: None,
            overloads: Vec::new(),
            lags: Vec::new(),
            blocked: Duration::ZERO,
        }
    }
}
