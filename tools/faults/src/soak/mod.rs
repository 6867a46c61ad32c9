//! Soak: a cell works for hours of virtual time, with one random fault of the fault table per minute.
//!
//! Each robot moves continuously between two poses. After a fault, the task resets the fault, enables the robot, and
//! homes the robot if its reference was lost. If all attempts fail, the controller ends, and another controller starts
//! on the same drives (a restart). After three failed starts, the supply of the drives is switched off and on.
//!
//! At each pose, the true position of each motor is compared with the measured position. After the reference was taken,
//! the difference may change by at most 1.1 increments of the encoder. The measured position is up to two periods old, and
//! a motor at a pose still moves by less than an increment. The comparison therefore waits until no motor of the robot
//! has moved for two periods. An axis that homes to an index pulse must have the same difference after each homing.
//!
//! The same seed gives the same soak.

mod plan;
mod report;
mod stage;
mod work;

use std::f64::consts::TAU;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::anyhow;
use can::Instant;
use hil::FaultInEffect;
use mrroc::cell::{Axis, CellFile};
use mrroc::report::counted;
use mrroc::scenario::axis_place;
use servo::MAX_AXES;

pub use report::{MOST_GROWTH_KIB, SoakKind, SoakNote, SoakReport};

use crate::catalogue::CASES;
use plan::{PlannedFault, Random};
use stage::{Controller, Stage};

/// Time of one fault.
const MINUTE: Duration = Duration::from_secs(60);
/// Time after a fault within which the robots must work again.
const RECOVERY: Duration = Duration::from_secs(300);
/// Rounds of a robot after a fault that show that it works.
const ROUNDS: u64 = 2;
/// Greatest change of the difference between true and measured position, increments of the encoder.
const DRIFT: f64 = 1.1;
/// Greatest motion of a motor at standstill within two periods, increments of the encoder.
const STILL: f64 = 0.01;
/// Failed starts of a controller after which the supply is switched.
const STARTS: u32 = 3;
/// Starts of a controller after which the soak ends.
const MOST_STARTS: u32 = 10;

/// Options of a soak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoakOptions {
    /// Virtual time.
    pub duration: Duration,
    /// Seed of the faults.
    pub seed: u64,
}

/// A soak in progress.
struct Soak<'a> {
    stage: Stage,
    random: Random,
    report: SoakReport,
    /// Difference of true and measured position after the reference was taken, for each robot.
    references: Vec<Option<[f64; MAX_AXES]>>,
    /// The same after the first reference of each robot.
    first: Vec<Option<[f64; MAX_AXES]>>,
    /// Rests whose positions were compared.
    compared: Vec<u64>,
    /// True positions of the motors of each robot, rad, in the present cycle and in the two cycles before.
    truths: Vec<[[f64; MAX_AXES]; 3]>,
    progress: &'a mut dyn FnMut(Duration) -> Option<u64>,
}

/// A fault that was planned, strikes, or is being recovered from.
struct Strike {
    planned: PlannedFault,
    at: Instant,
    in_effect: Vec<FaultInEffect>,
    begun: bool,
    ended: bool,
    detected: Option<Duration>,
    restarts: u32,
    power_switched: bool,
    /// Rounds of the robots at the end of the fault.
    rounds: Vec<u64>,
}

/// Runs a soak. `progress` receives the virtual time after each minute, and returns the memory of the process, KiB, if the
/// caller measures it.
///
/// An error means that the cell does not work without faults, or no longer.
pub fn soak(
    file: &CellFile,
    options: &SoakOptions,
    progress: &mut dyn FnMut(Duration) -> Option<u64>,
) -> anyhow::Result<SoakReport> {
    let stage = Stage::new(file)?;
    let robots = file.cell.robot.len();
    let soak = Soak {
        stage,
        random: Random(options.seed),
        report: SoakReport::new(file, options),
        references: vec![None; robots],
        first: vec![None; robots],
        compared: vec![0; robots],
        truths: vec![[[0.0; MAX_AXES]; 3]; robots],
        progress,
    };
    soak.run(options)
}

impl Soak<'_> {
    fn run(mut self, options: &SoakOptions) -> anyhow::Result<SoakReport> {
        let end = Instant::ZERO + options.duration;
        let mut controller = self.stage.start()?;
        // The robots work before the first fault.
        let first = self.stage.now;
        while self.rounds().iter().any(|rounds| *rounds < ROUNDS) {
            if self.stage.now.since(first) > RECOVERY || !self.cycle(&mut controller, None) {
                let (error, _) = self.stage.end(controller);
                return Err(anyhow!("the robots do not work: {}", error.as_deref().unwrap_or("too slow")));
            }
        }
        let mut minute = self.stage.now;
        while self.stage.now < end {
            let planned = PlannedFault::random(&self.stage.file, &mut self.random);
            let strike = Strike {
                at: minute + planned.delay,
                planned,
                in_effect: Vec::new(),
                begun: false,
                ended: false,
                detected: None,
                restarts: 0,
                power_switched: false,
                rounds: Vec::new(),
            };
            controller = self.strike(controller, strike)?;
            minute = (minute + MINUTE).max(self.stage.now);
            while self.stage.now < minute {
                if !self.cycle(&mut controller, None) {
                    self.fail("between two faults", None, "the task ended");
                    controller = self.restart(controller, None)?;
                }
            }
            let time = self.stage.now.since(Instant::ZERO);
            if let Some(memory) = (self.progress)(time).filter(|_| time >= options.duration / 4) {
                self.report.note_memory(memory);
            }
        }
        controller.add_lost(&mut self.stage.lost);
        let (error, off) = self.stage.end(controller);
        if let Some(error) = error.filter(|_| !off) {
            self.fail("end", None, &error);
        }
        let Self { mut report, stage, .. } = self;
        report.complete(&stage);
        Ok(report)
    }

    /// Lets a fault strike, and the robots recover.
    fn strike(&mut self, mut controller: Controller, mut strike: Strike) -> anyhow::Result<Controller> {
        let case = strike.planned.case();
        let latest = strike.at + strike.planned.lasts.unwrap_or_default() + RECOVERY;
        while !strike.is_over(&self.rounds()) {
            if self.stage.now > latest {
                let what = format!("{} of axis {:?}", case.name, strike.planned.axis);
                self.fail(&what, Some(&strike), "the robots do not work again in time");
                self.end_fault(&mut strike);
                self.report.kind(case.name).failed += 1;
                return self.with_new_power(controller);
            }
            if !self.cycle(&mut controller, Some(&mut strike)) {
                while strike.begun && !strike.ended {
                    let period = self.stage.file.cell.period();
                    self.stage.wait(period);
                    self.act(&mut strike)?;
                }
                strike.restarts += 1;
                controller = self.restart(controller, Some(&mut strike))?;
                strike.rounds = self.rounds();
            }
            self.act(&mut strike)?;
        }
        let kind = self.report.kind(case.name);
        match strike.detected {
            Some(after) => {
                kind.detected += 1;
                kind.slowest_detection = kind.slowest_detection.max(after.as_secs_f64());
            }
            None => kind.tolerated += 1,
        }
        match (strike.detected, strike.restarts, strike.power_switched) {
            (_, _, true) => kind.power_switched += 1,
            (_, 1.., false) => kind.restarted += 1,
            (Some(_), 0, false) => kind.recovered += 1,
            (None, 0, false) => {}
        }
        if self.report.drifted_since(strike.at) {
            self.report.kind(case.name).drifted += 1;
            return self.with_new_power(controller);
        }
        Ok(controller)
    }

    /// Begins or ends the fault, if it is due.
    fn act(&mut self, strike: &mut Strike) -> anyhow::Result<()> {
        if !strike.begun && self.stage.now >= strike.at {
            strike.begun = true;
            self.report.kind(strike.planned.case().name).injected += 1;
            let ids = self.stage.emulation.ids();
            let place = axis_place(&self.stage.file, ids, strike.planned.axis).expect("the stage has all drives");
            let (kind, numbers) = (strike.planned.kind(), strike.planned.numbers());
            let faults = kind.faults(&place, &numbers).map_err(|why| anyhow!("the fault {why}"))?;
            strike.in_effect.extend(faults.iter().map(|fault| self.stage.emulation.begin_fault(fault)));
        }
        let due = strike.planned.lasts.map_or(strike.at, |lasts| strike.at + lasts);
        if strike.begun && !strike.ended && self.stage.now >= due {
            self.end_fault(strike);
        }
        Ok(())
    }

    fn end_fault(&mut self, strike: &mut Strike) {
        strike.in_effect.drain(..).for_each(|fault| self.stage.emulation.end_fault(&fault));
        strike.ended = true;
        strike.rounds = self.rounds();
    }

    /// One cycle with its comparisons. Returns whether the task goes on.
    fn cycle(&mut self, controller: &mut Controller, strike: Option<&mut Strike>) -> bool {
        let going = self.stage.cycle(controller);
        let sound = strike.as_ref().is_none_or(|strike| strike.ended || !strike.begun);
        if let Some(strike) = strike
            && strike.begun
            && strike.detected.is_none()
            && (0..self.compared.len()).any(|robot| controller.fault(robot).is_some())
        {
            strike.detected = Some(self.stage.now.since(strike.at));
        }
        for robot in 0..self.compared.len() {
            self.truths[robot].rotate_right(1);
            self.truths[robot][0] = self.stage.truth(robot);
            if self.references[robot].is_some() && !controller.is_homed(robot) {
                self.references[robot] = None;
            }
            let rests = self.stage.counts[robot].rests.load(Ordering::Relaxed);
            if rests != self.compared[robot] && self.stands(robot) {
                self.compared[robot] = rests;
                if sound && controller.is_homed(robot) {
                    self.compare(controller, robot);
                }
            }
        }
        going
    }

    /// Whether no motor of a robot moved in the last two periods.
    fn stands(&self, robot: usize) -> bool {
        let [now, _, before] = &self.truths[robot];
        self.stage.file.cell.robot[robot].axis.iter().enumerate().all(|(axis, given)| {
            let increment = TAU / f64::from(given.counts_per_revolution());
            (now[axis] - before[axis]).abs() <= STILL * increment
        })
    }

    /// Compares true and measured positions of a robot at rest.
    fn compare(&mut self, controller: &Controller, robot: usize) {
        self.report.comparisons[robot] += 1;
        let (truth, measured) = (self.truths[robot][0], controller.measured(robot));
        let difference: [f64; MAX_AXES] = std::array::from_fn(|axis| truth[axis] - measured[axis]);
        let file = &self.stage.file;
        for (axis, given) in file.cell.robot[robot].axis.iter().enumerate() {
            let increment = TAU / f64::from(given.counts_per_revolution());
            self.report.note_reference(difference[axis] / increment);
            let Some(reference) = self.references[robot] else {
                let first = self.first[robot].unwrap_or(difference);
                let off = (difference[axis] - first[axis]).abs() / increment;
                if off > DRIFT && homes_to_index(given) {
                    let name = file.axis_name(robot, axis);
                    self.report
                        .drift(self.stage.now, format!("{name}: homed at another place, by {off:.1} increments"));
                }
                continue;
            };
            let drift = (difference[axis] - reference[axis]).abs() / increment;
            self.report.note_drift(drift);
            if drift > DRIFT {
                let name = file.axis_name(robot, axis);
                let what = format!("{name}: the reference drifted by {drift:.1} increments");
                self.report.drift(self.stage.now, what);
            }
        }
        if self.references[robot].is_none() {
            self.report.references += 1;
            self.first[robot].get_or_insert(difference);
            self.references[robot] = Some(difference);
        }
    }

    fn rounds(&self) -> Vec<u64> {
        self.stage.counts.iter().map(|counts| counts.rounds.load(Ordering::Relaxed)).collect()
    }

    /// Ends a controller and starts another one.
    fn restart(&mut self, controller: Controller, mut strike: Option<&mut Strike>) -> anyhow::Result<Controller> {
        self.report.restarts += 1;
        controller.add_lost(&mut self.stage.lost);
        let (error, off) = self.stage.end(controller);
        let mut error = error.unwrap_or_else(|| "the task ended".to_owned());
        if !off {
            // A drive that restarted does not say that it is off.
            let name = strike.as_ref().map_or("no fault", |strike| strike.planned.case().name);
            if self.stage.has_current() {
                self.fail(name, strike.as_deref(), "a robot still has power after the end of a controller");
            } else {
                self.report.note(self.stage.now, format!("{name}: a robot did not say that it is off"));
            }
        }
        for start in 1..MOST_STARTS {
            self.stage.wait(Duration::from_secs(1));
            match self.stage.start() {
                Ok(controller) => return Ok(controller),
                Err(why) => error = format!("{why:#}"),
            }
            self.report.failed_starts += 1;
            if start % STARTS == 0 {
                self.report.note(self.stage.now, format!("no start before the supply was switched: {error}"));
                if let Some(strike) = &mut strike {
                    strike.power_switched = true;
                }
                self.stage.switch_power();
            }
        }
        Err(anyhow!("no controller starts any more: {error}"))
    }

    /// Ends a controller, switches the supply and starts another one.
    fn with_new_power(&mut self, controller: Controller) -> anyhow::Result<Controller> {
        controller.add_lost(&mut self.stage.lost);
        self.stage.end(controller);
        self.stage.switch_power();
        self.references.iter_mut().for_each(|reference| *reference = None);
        self.stage.start()
    }

    fn fail(&mut self, what: &str, strike: Option<&Strike>, why: &str) {
        let restarts = strike.map_or(0, |strike| strike.restarts);
        let what = format!("{what}: {why} ({})", counted(restarts, "restart"));
        self.report.fail(self.stage.now, what);
    }
}

impl Strike {
    /// Whether the fault has ended and all robots work.
    fn is_over(&self, rounds: &[u64]) -> bool {
        self.ended && rounds.iter().zip(&self.rounds).all(|(now, then)| *now >= then + ROUNDS)
    }
}

/// Whether homing leads to the same index pulse each time: by a switch or stop and an index pulse (CiA 402-2 §11.3), or on a
/// serial line.
fn homes_to_index(axis: &Axis) -> bool {
    axis.homing.method.is_none_or(|method| matches!(method, -2 | -1 | 1 | 2 | 7 | 11))
}

/// Names of all faults of the table.
fn names() -> impl Iterator<Item = &'static str> {
    CASES.iter().map(|case| case.name)
}
