//! Random legal cells: the numbers of an example cell, altered together. A cell that `mrroc check` calls ready runs
//! without a fault.
//!
//! The functions are those of `mrroc check` and `mrroc run --bench lockstep`, called in this process. `MRROC_RANDOM_CASE`
//! selects one case and prints its cell.

use std::panic::{AssertUnwindSafe, catch_unwind};

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{Cell, CellFile, EmulatedPayload, Instruction, JointGenerator, Joints, LineInstruction};
use ::mrroc::report::{FaultReport, RunOutcome, RunReport};
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::CarriedTask;
use controller::robot::Arm;
use kit::draw::Draw;
use kit::mrroc::{example, shorten, text};

use super::numbers::{Alteration, Numbers};
use super::variable;
use super::verdict::in_turns;

/// Number of cells in a default run.
const CELLS: u64 = 300;

/// Percentage of the cells that the check accepts. The others have one value beyond a bound.
const READY: u64 = 70;

/// The example cells, and their relative frequency.
const EXAMPLES: [(&str, usize); 8] = [
    ("irb6", 4),
    ("irb6-serial", 4),
    ("irb6-hi-moxa", 2),
    ("irp6", 3),
    ("irp6-track", 1),
    ("rnt", 4),
    ("polycrank", 3),
    ("lab", 1),
];

/// Greatest number of altered keys of a cell.
const ALTERATIONS: usize = 8;

/// Shares of the drawn way from home. The robot goes the first that is in its reach.
const WAYS: [f64; 8] = [1.0, -1.0, 0.5, -0.5, 0.2, -0.2, 0.1, -0.1];

/// Result of a cell.
#[derive(Debug, PartialEq)]
enum Verdict {
    /// The check refuses the cell.
    Refused(String),
    /// The cell ran to its end. `calm`: no axis oscillated.
    Completed { calm: bool },
    /// The check warns of an axis by nominal numbers, and the run ends by a fault of this axis.
    Foretold(String),
    /// The check accepts the cell. The run refuses it, ends by another fault or panics.
    Failed(String),
}

/// A cell with altered numbers.
struct Altered {
    file: CellFile,
    numbers: Numbers,
    alterations: Vec<Alteration>,
}

impl Altered {
    /// Case `case` of a seed, which the checks of the file accept.
    fn of(seed: u64, case: u64) -> Self {
        let mut draw = Draw::of(seed, case);
        let (file, cell) = example_cell(&mut draw);
        let numbers = Numbers::of(&cell);
        let mut altered = Self { file, numbers, alterations: Vec::new() };
        for _ in 0..1 + draw.below(ALTERATIONS) {
            altered.alter(&mut draw);
        }
        altered
    }

    /// Alters one key. A refused value is replaced by the last value on the way that is accepted.
    fn alter(&mut self, draw: &mut Draw) {
        let mut alteration = self.numbers.draw(draw);
        self.numbers.apply(&alteration);
        if self.numbers.parse().is_err() {
            self.numbers.revert(&alteration);
            (alteration, _) = self.numbers.bound(&alteration);
            self.numbers.apply(&alteration);
            assert!(self.numbers.parse().is_ok(), "{alteration}");
        }
        if !alteration.is_idle() {
            self.alterations.push(alteration);
        }
    }

    fn judge(&self) -> Verdict {
        match self.numbers.parse() {
            Ok(cell) => judge(&self.file, cell, self.numbers.text()),
            Err(error) => Verdict::Refused(error.to_string()),
        }
    }

    /// Takes back all alterations without which the cell fails as well.
    fn shrink(&mut self) {
        let mut number = self.alterations.len();
        while number > 0 {
            number -= 1;
            // A key may have been altered again later.
            let kept: Vec<_> = (0..self.alterations.len()).filter(|other| *other != number).collect();
            let whole = self.numbers.clone();
            self.alterations.iter().rev().for_each(|it| self.numbers.revert(it));
            kept.iter().for_each(|&it| self.numbers.apply(&self.alterations[it]));
            if matches!(self.judge(), Verdict::Failed(_)) {
                self.alterations.remove(number);
            } else {
                self.numbers = whole;
            }
        }
    }
}

/// An example cell with a short program, and its file.
fn example_cell(draw: &mut Draw) -> (CellFile, Cell) {
    let weighted: Vec<_> = EXAMPLES.iter().flat_map(|(name, weight)| vec![*name; *weight]).collect();
    let name = draw.among(&weighted);
    let file = CellFile::read(example(name)).expect("the example cells are sound");
    let mut cell = Cell::parse(&text(name)).expect("the example cells are sound");
    shorten(&mut cell);
    cell.seed = draw.number() >> 32;
    for robot in &mut cell.robot {
        let arm = robot.arm().expect("the example cells are sound");
        robot.program = program(draw, &arm);
        if arm.axes() > 1 && draw.one_in(2) {
            let centre = [0.0, 0.0, 0.1];
            robot.emulated_payload = vec![EmulatedPayload { at_s: 0.5, mass: 1.0, centre }];
        }
        for axis in &mut robot.axis {
            if let Some(drive) = &mut axis.drive {
                drive.plausible_acceleration = Some(20.0 * axis.max_acceleration);
                axis.homing.start_timeout_ms = Some(1_000);
            }
            if let Some(controller) = &mut axis.controller {
                controller.plausible_velocity = Some(4.0 / 3.0 * axis.max_velocity);
                controller.plausible_acceleration = Some(20.0 * axis.max_acceleration);
                controller.r#loop.runaway_velocity = Some(1.2 * axis.max_velocity);
            }
        }
    }
    if draw.one_in(2) {
        cell.serial.iter_mut().for_each(|serial| serial.emulated_latency_ms = Some(1));
    }
    (file, cell)
}

/// A motion of the joints from home, then a short line of an arm.
fn program(draw: &mut Draw, arm: &Arm) -> Vec<Instruction> {
    let home = arm.joints(&arm.robot().home().padded()).expect("home is a posture");
    let axes = arm.axes();
    let mut way = home.map(|_| 0.0);
    for (number, joint) in way[..axes].iter_mut().enumerate() {
        *joint = match number {
            _ if axes == 1 => draw.within(0.0, 0.002),
            // Legs of a parallel robot are near their upper limits at home. The wrist is singular there.
            0..3 => draw.within(-0.06, -0.01),
            _ => draw.within(0.3, 0.5),
        };
    }
    // A robot that stays at home shows nothing of its loops.
    let along = |share: f64| std::array::from_fn(|axis| home[axis] + share * way[axis]);
    let there = WAYS.into_iter().map(along).find(|there| arm.motors(there).is_ok()).expect("some way is free");
    let joints = Instruction::Joints(Joints {
        poses: vec![there[..axes].to_vec()],
        generator: if draw.one_in(2) { JointGenerator::JerkLimited } else { JointGenerator::Newsmooth },
        velocity: 0.5,
        acceleration: 0.5,
        duration: None,
    });
    let mut end = there;
    end[1] += draw.within(-0.03, 0.03);
    end[2] += draw.within(-0.03, 0.03);
    if axes == 1 || arm.motors(&end).is_err() {
        return vec![joints];
    }
    let pose = arm.forward(&end).expect("a posture has a pose");
    // Five axes have one orientation per position of the tool and turn about its axis.
    let q = pose.rotation.quaternion();
    let line = Instruction::Line(LineInstruction {
        constant_speed: false,
        position: pose.translation.vector.into(),
        quaternion: Some([q.w, q.i, q.j, q.k]),
        velocity: 0.2,
        acceleration: 0.5,
    });
    vec![joints, line]
}

/// Runs a cell after its rehearsal and the budget of its buses. The file was checked before, or not at all.
fn judge(file: &CellFile, cell: Cell, text: String) -> Verdict {
    let mut file = file.clone();
    let Ok(arms) = (0..cell.robot.len()).map(|robot| cell.robot[robot].arm()).collect::<Result<Vec<_>, _>>() else {
        return Verdict::Refused("parameters of a robot".to_owned());
    };
    (file.cell, file.text, file.arms) = (cell, text, arms);
    let program = CarriedTask::Programs.program();
    let checked = match ::mrroc::check(&file, &program) {
        Ok(checked) => checked,
        Err(error) => return Verdict::Refused(format!("{error:#}")),
    };
    let options = RunOptions::on(BenchKind::Lockstep);
    let run = || ::mrroc::run::run(&file, &options, &Requests::default(), &program, &mut |_| {});
    match catch_unwind(AssertUnwindSafe(run)) {
        Err(_) => Verdict::Failed("panicked".to_owned()),
        Ok(Err(error)) => Verdict::Failed(format!("the run refuses the cell: {error:#}")),
        Ok(Ok(report)) => of_report(&report, &checked.warnings),
    }
}

/// Whether a warning of the check names the axis of each fault.
fn are_foretold(faults: &[FaultReport], warnings: &[String]) -> bool {
    let warned = |robot: &str, axis: &str| {
        let begin = format!("robot {robot}: axis {axis} ");
        warnings.iter().any(|warning| warning.starts_with(&begin))
    };
    let foretold = |fault: &FaultReport| {
        let axis = fault.axis.as_ref().and_then(|axis| axis.rsplit('.').next());
        fault.robot.as_ref().zip(axis).is_some_and(|(robot, axis)| warned(robot, axis))
    };
    !faults.is_empty() && faults.iter().all(foretold)
}

fn of_report(report: &RunReport, warnings: &[String]) -> Verdict {
    if report.outcome == RunOutcome::Completed && report.faults.is_empty() {
        return Verdict::Completed { calm: report.oscillations.is_empty() };
    }
    let faults = report.faults.iter().map(|it| it.what.as_str());
    let said = format!("{}: {}", report.outcome, faults.collect::<Vec<_>>().join("; "));
    if are_foretold(&report.faults, warnings) { Verdict::Foretold(said) } else { Verdict::Failed(said) }
}

/// A disagreement that is permitted, with the reason.
struct Exception {
    /// A key without which the cell runs. A trailing dot stands for every key of the table.
    key: &'static str,
    /// A text in the fault.
    said: &'static str,
    why: &'static str,
}

const EXCEPTIONS: &[Exception] = &[Exception {
    key: "robot.axis.controller.loop.feed_forward.",
    said: "overcurrent protection acted",
    why: "a feed-forward beyond friction and load moves the motor by itself, and the cell has no data of both",
}];

/// A bound that the check derives from other keys: what is beyond it by the margin does not run well.
struct Law {
    key: &'static str,
    /// Factor towards the refused values.
    towards: f64,
    margin: f64,
}

const fn at_least(key: &'static str, margin: f64) -> Law {
    Law { key, towards: 1e-5, margin }
}

const fn at_most(key: &'static str, margin: f64) -> Law {
    Law { key, towards: 1e4, margin }
}

const LAWS: [Law; 8] = [
    // A heartbeat of a third of the period arrives just in time.
    at_least("bus.heartbeat_ms", 4.0),
    // Two retries, and nodes that have no request.
    at_least("bus.sdo_timeout_ms", 4.0),
    at_least("bus.boot_timeout_ms", 1.1),
    at_most("serial.emulated_latency_ms", 1.5),
    // Accepted loops have a margin of two. Friction and limits are not in the linear loop.
    at_most("robot.axis.controller.loop.law.cascade.velocity_gain", 4.0),
    at_most("robot.axis.controller.loop.law.cascade.position_gain", 4.0),
    at_most("robot.axis.controller.loop.law.cascade.integral_rate", 8.0),
    at_most("robot.axis.drive.loop.law.proportional.position_gain", 4.0),
];

impl Altered {
    /// The cell with the numbers of a law beyond its bound by the margin. `None` if the bound is of another key, or no
    /// whole number is so far beyond.
    fn beyond(&mut self, law: &Law) -> Option<String> {
        let far = self.numbers.multiplied(law.key, law.towards)?;
        self.numbers.apply(&far);
        let is_refused = self.numbers.parse().is_err();
        self.numbers.revert(&far);
        let (_, refused) = is_refused.then(|| self.numbers.bound(&far))?;
        self.numbers.apply(&refused);
        let last = law.key.rsplit('.').next().expect("a key has a last part");
        let error = self.numbers.parse().err().filter(|error| error.key.ends_with(last));
        let margin = if law.towards < 1.0 { 1.0 / law.margin } else { law.margin };
        let beyond = self.numbers.multiplied(law.key, margin)?;
        self.numbers.apply(&beyond);
        let error = error.filter(|_| beyond.value() >= 1e-9)?;
        Some(format!("{refused} is refused ({error}); with {}", beyond.value()))
    }
}

#[test]
fn nothing_that_a_bound_refuses_by_its_margin_runs_well() {
    let seed = variable("MRROC_RANDOM_SEED", 1);
    let times = variable("MRROC_RANDOM_TIMES", 1);
    let one = variable("MRROC_RANDOM_CASE", u64::MAX);
    let cases = if one == u64::MAX { 0..CELLS * times * (100 - READY) / 100 } else { one..one + 1 };
    let first = cases.start;
    let verdicts = in_turns(cases.end - first, |number| {
        let case = first + number;
        let mut altered = Altered::of(!seed, case);
        if altered.file.cell.robot.len() > 1 {
            return None;
        }
        let mut laws = (0..LAWS.len()).map(|turn| &LAWS[(case as usize + turn) % LAWS.len()]);
        let what = laws.find_map(|law| {
            let legal = altered.numbers.clone();
            let what = altered.beyond(law);
            if what.is_none() {
                altered.numbers = legal;
            }
            what
        })?;
        let cell = altered.numbers.unchecked()?;
        let verdict = judge(&altered.file, cell, altered.numbers.text());
        if matches!(verdict, Verdict::Refused(_)) {
            return None;
        }
        let line = format!("seed {seed}, case {case}, {}: {what}: {verdict:?}", altered.file.cell.name);
        println!("{line}");
        Some((verdict == Verdict::Completed { calm: true }, line))
    });
    let judged: Vec<_> = verdicts.iter().flatten().collect();
    let wrong: Vec<_> = judged.iter().filter(|(well, _)| *well).map(|(_, line)| line.as_str()).collect();
    assert!(wrong.is_empty(), "{} of {} cells:\n{}", wrong.len(), judged.len(), wrong.join("\n"));
    println!("{} of {} cells are beyond a bound", judged.len(), verdicts.len());
    assert!(one != u64::MAX || judged.len() > verdicts.len() / 6, "{} cells are judged", judged.len());
}

impl Exception {
    fn covers(&self, altered: &Altered, said: &str) -> bool {
        let names = |alteration: &Alteration| match self.key.strip_suffix('.') {
            Some(table) => alteration.key.starts_with(table),
            None => alteration.key == self.key,
        };
        said.contains(self.said) && altered.alterations.iter().any(names)
    }
}

#[test]
fn a_random_cell_that_is_ready_runs_without_a_fault() {
    let seed = variable("MRROC_RANDOM_SEED", 1);
    let times = variable("MRROC_RANDOM_TIMES", 1);
    let one = variable("MRROC_RANDOM_CASE", u64::MAX);
    let cases = if one == u64::MAX { 0..CELLS * times * READY / 100 } else { one..one + 1 };
    let count = cases.end - cases.start;
    let verdicts = in_turns(count, |number| {
        let case = cases.start + number;
        let mut altered = Altered::of(seed, case);
        if one != u64::MAX {
            println!("{}", altered.numbers.text());
            altered.alterations.iter().for_each(|it| println!("{it}"));
        }
        let verdict = altered.judge();
        if let Verdict::Failed(said) = &verdict {
            altered.shrink();
            let keys: Vec<_> = altered.alterations.iter().map(Alteration::to_string).collect();
            let line = format!("seed {seed}, case {case}, {}: {said}\n  {}", altered.file.cell.name, keys.join("\n  "));
            println!("{line}");
            match EXCEPTIONS.iter().find(|it| it.covers(&altered, said)) {
                Some(exception) => println!("  permitted: {}", exception.why),
                None => return Err(line),
            }
        }
        match &verdict {
            Verdict::Refused(why) => println!("case {case}: {why}"),
            Verdict::Foretold(said) => println!("case {case}: the check warns of {said}"),
            Verdict::Completed { .. } | Verdict::Failed(_) => {}
        }
        Ok(verdict)
    });
    let failed: Vec<_> = verdicts.iter().filter_map(|it| it.as_ref().err()).map(String::as_str).collect();
    assert!(failed.is_empty(), "{} of {count} cells:\n{}", failed.len(), failed.join("\n"));
    let completed = verdicts.iter().filter(|it| matches!(it, Ok(Verdict::Completed { .. }))).count();
    let foretold = verdicts.iter().filter(|it| matches!(it, Ok(Verdict::Foretold(_)))).count();
    println!("{completed} of {count} cells are ready and run, {foretold} fail in an axis that the check warns of");
    assert!(one != u64::MAX || foretold as u64 <= count / 20, "{foretold} of {count} cells fail after a warning");
    assert!(one != u64::MAX || completed as u64 > count / 3, "{completed} of {count} cells are ready");
}
