//! Random programs on random chains: 1 to 8 joints with random frames, masses, ratios and couplings. The check and the
//! run agree, and a run that completes keeps every limit of its motors and joints.
//!
//! `MRROC_RANDOM_CASE` selects one case and prints its cell.

use std::fmt::Write as _;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::CellFile;
use ::mrroc::report::{RunOutcome, RunReport};
use ::mrroc::run::{Requests, RunOptions};
use ::mrroc::tasks::CarriedTask;
use kit::draw::Draw;
use kit::mrroc::Directory;

use super::variable;
use super::verdict::in_turns;

/// Number of chains in a default run.
const CHAINS: u64 = 100;

/// Velocity of a nominal motor, rad/s, and time from rest to it, s.
const MOTOR: f64 = 300.0;
const RISE: f64 = 0.5;

/// Result of a cell.
#[derive(Debug)]
enum Verdict {
    /// Check and run refuse the cell in the same words.
    Refused,
    /// The check warns of an axis that then stops the run.
    Foretold,
    /// The run completed within all limits.
    Completed,
    Failed(String),
}

/// One joint of a random chain.
struct Joint {
    is_linear: bool,
    low: f64,
    high: f64,
    velocity: f64,
    effort: f64,
    ratio: f64,
    text: String,
}

fn triple(draw: &mut Draw, size: f64) -> [f64; 3] {
    std::array::from_fn(|_| draw.within(-size, size))
}

/// The joints in their order, drawn from the last to the first. Each joint has the effort that the links behind it
/// need.
fn joints(draw: &mut Draw) -> Vec<Joint> {
    let count = 1 + draw.below(8);
    let (mut mass, mut reach) = (0.0, 0.0);
    let mut joints: Vec<_> = (0..count).rev().map(|number| joint(draw, number, &mut mass, &mut reach)).collect();
    joints.reverse();
    joints
}

fn joint(draw: &mut Draw, number: usize, mass: &mut f64, reach: &mut f64) -> Joint {
    let is_linear = draw.one_in(5);
    let (low, high) = match is_linear {
        true => (draw.within(-0.3, -0.05), draw.within(0.05, 0.3)),
        false => (draw.within(-3.0, -0.5), draw.within(0.5, 3.0)),
    };
    let velocity = if is_linear { draw.within(0.1, 0.5) } else { draw.within(0.5, 3.0) };
    let own = draw.within(0.5, 4.0);
    let (centre, place, turn) = (triple(draw, 0.1), triple(draw, 0.25), triple(draw, 3.0));
    // The tensor of a box.
    let [a, b, c] = triple(draw, 0.1).map(|side| own * side * side);
    *mass += own;
    *reach = f64::max(*reach, 0.2);
    let load = match is_linear {
        true => *mass * (9.81 + velocity / RISE),
        false => *mass * *reach * (9.81 + *reach * velocity / RISE),
    };
    *reach += place.iter().map(|it| it * it).sum::<f64>().sqrt() + if is_linear { 0.3 } else { 0.0 };
    let kind = if is_linear { "prismatic" } else { "revolute" };
    let text = format!(
        "[[robot.chain.joint]]\nname = \"q{number}\"\nkind = \"{kind}\"\norigin = {{ xyz = {place:?}, rpy = {turn:?} }}\n\
         limits = {{ low = {low:?}, high = {high:?} }}\nvelocity = {velocity:?}\n\
         body = {{ mass = {own:?}, centre = {centre:?}, inertia = {:?} }}\n",
        [b + c, a + c, a + b, 0.0, 0.0, 0.0]
    );
    let ratio = MOTOR / velocity * draw.within(0.5, 1.0) * if draw.one_in(2) { -1.0 } else { 1.0 };
    Joint { is_linear, low, high, velocity, effort: (2.5 * load).max(10.0), ratio, text }
}

/// Matrix from joints to motors: the ratios alone, or belts that turn each motor with the joints before its own.
fn matrix(draw: &mut Draw, joints: &[Joint]) -> Vec<Vec<f64>> {
    let is_coupled = joints.len() > 1 && draw.one_in(3);
    let share = |draw: &mut Draw, is_coupled: bool| if is_coupled { draw.within(-0.3, 0.3) } else { 0.0 };
    let mut rows = vec![vec![0.0; joints.len()]; joints.len()];
    for (row, (numbers, joint)) in rows.iter_mut().zip(joints).enumerate() {
        for (column, number) in numbers.iter_mut().enumerate().take(row + 1) {
            let alike = joint.is_linear == joints[column].is_linear;
            *number = match column == row {
                true => joint.ratio,
                false => joint.ratio * share(draw, is_coupled && alike),
            };
        }
    }
    rows
}

/// The text of a random cell.
fn cell(draw: &mut Draw) -> String {
    let joints = joints(draw);
    let rows = matrix(draw, &joints);
    let is_coupled = rows.iter().enumerate().any(|(row, numbers)| numbers[..row].iter().any(|number| *number != 0.0));
    let buses = joints.len().div_ceil(6);
    let of_a_bus = joints.len().div_ceil(buses);
    let mut text = format!(
        "name = \"random\"\nperiod_us = 2000\nmacrostep = 10\nseed = {}\n\
         realtime = {{ policy = \"best-effort\", priority = 80 }}\n",
        draw.number() >> 32
    );
    for bus in 0..buses {
        let _ = writeln!(text, "[[bus]]\nname = \"can{bus}\"\ninterface = \"can{bus}\"");
    }
    let _ = writeln!(text, "[[robot]]\nname = \"arm\"\n[robot.chain]\nup = {:?}", triple(draw, 1.0));
    if is_coupled {
        let _ = writeln!(text, "motors_from_joints = {rows:?}");
    }
    for joint in &joints {
        let _ = writeln!(text, "{}effort = {:?}", joint.text, joint.effort);
        if !is_coupled {
            let _ = writeln!(text, "ratio = {:?}", joint.ratio);
        }
    }
    for (number, (joint, row)) in joints.iter().zip(&rows).enumerate() {
        let velocity: f64 = row.iter().zip(&joints).map(|(it, joint)| it.abs() * joint.velocity).sum();
        let torque = joint.effort / joint.ratio.abs();
        let _ = writeln!(
            text,
            "[[robot.axis]]\nname = \"m{number}\"\nbus = \"can{}\"\nnode = {}\n\
             drive = {{ vendor = 0xFB, counts_per_revolution = 4000, rated_torque = {:?}, max_torque = {torque:?} }}\n\
             max_velocity = {velocity:?}\nmax_acceleration = {:?}\nfollowing_error = 2.0\n\
             homing = {{ method = 37, search_velocity = 15.0, zero_velocity = 3.5, acceleration = 150.0 }}\n\
             emulator = {{ start = 0.0 }}",
            number / of_a_bus,
            number % of_a_bus + 1,
            0.5 * torque,
            velocity / RISE
        );
    }
    text + &program(draw, &joints)
}

/// Short motions of the joints, some of them beyond a limit.
fn program(draw: &mut Draw, joints: &[Joint]) -> String {
    let mut text = String::new();
    for _ in 0..1 + draw.below(2) {
        let share = if draw.one_in(12) { 1.3 } else { 0.2 };
        let mut pose = || -> Vec<f64> {
            let to = |draw: &mut Draw, joint: &Joint| draw.within(share * joint.low, share * joint.high);
            joints.iter().map(|joint| to(draw, joint)).collect()
        };
        let poses: Vec<_> = [pose(), pose()].into();
        let generator = draw.among(&["newsmooth", "jerk-limited"]);
        let (velocity, acceleration) = (draw.within(0.5, 1.0), draw.within(0.5, 1.0));
        let _ = writeln!(
            text,
            "[[robot.program]]\njoints = {{ poses = {:?}, generator = \"{generator}\", velocity = {velocity:?}, \
             acceleration = {acceleration:?} }}",
            &poses[..1 + draw.below(2)]
        );
    }
    if draw.one_in(4) {
        let [x, y, z] = triple(draw, 0.5);
        let _ = writeln!(
            text,
            "[[robot.program]]\nline = {{ position = [{x:?}, {y:?}, {z:?}], velocity = 0.1, acceleration = 0.5 }}"
        );
    }
    text
}

/// Checks a cell, runs it, and compares both.
fn judge(text: &str) -> Verdict {
    let folder = Directory::new();
    let path = folder.write("cell.toml", text);
    let file = match CellFile::read(&path) {
        Ok(file) => file,
        Err(error) => return Verdict::Failed(format!("the cell is not read: {error:#}")),
    };
    let program = CarriedTask::Programs.program();
    let record = folder.path("run.csv");
    let options = RunOptions { record: Some(record.clone()), ..RunOptions::on(BenchKind::Lockstep) };
    let checked = ::mrroc::check(&file, &program);
    let run = || ::mrroc::run::run(&file, &options, &Requests::default(), &program, &mut |_| {});
    let Ok(run) = catch_unwind(AssertUnwindSafe(run)) else {
        return Verdict::Failed("panicked".to_owned());
    };
    let (checked, report) = match (checked, run) {
        (Err(one), Err(other)) if format!("{one:#}") == format!("{other:#}") => return Verdict::Refused,
        (Err(one), Err(other)) => return Verdict::Failed(format!("refused in other words: {one:#} and {other:#}")),
        (Err(error), Ok(_)) => return Verdict::Failed(format!("the check alone refuses the cell: {error:#}")),
        (Ok(_), Err(error)) => return Verdict::Failed(format!("the run alone refuses the cell: {error:#}")),
        (Ok(checked), Ok(report)) => (checked, report),
    };
    if report.outcome != RunOutcome::Completed || !report.faults.is_empty() {
        return faulted(&report, &checked.warnings);
    }
    match within_limits(&file, &fs::read_to_string(record).expect("the run wrote its record")) {
        Ok(()) => Verdict::Completed,
        Err(what) => Verdict::Failed(what),
    }
}

/// A run that ended by a fault, which a warning of the check may have foretold.
fn faulted(report: &RunReport, warnings: &[String]) -> Verdict {
    let said: Vec<_> = report.faults.iter().map(|fault| fault.what.as_str()).collect();
    let foretold = report.faults.iter().any(|fault| {
        let axis = fault.axis.as_ref().and_then(|axis| axis.rsplit('.').next()).unwrap_or_default();
        warnings.iter().any(|warning| warning.starts_with(&format!("robot arm: axis {axis} ")))
    });
    if foretold { Verdict::Foretold } else { Verdict::Failed(format!("{}: {}", report.outcome, said.join("; "))) }
}

/// Whether the motors keep their limits of velocity in all cycles and follow their commands, and the joints keep their
/// ranges. A motor may exceed its limit by its following error in a tenth of a second. A faster motor gained energy
/// without a cause.
fn within_limits(file: &CellFile, record: &str) -> Result<(), String> {
    let (robot, arm) = (&file.cell.robot[0], &file.arms[0]);
    let mut lines = record.lines();
    let head: Vec<_> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| head.iter().position(|it| *it == name).expect("a column of the record");
    let [name, phase, commanded, measured, velocity] =
        ["axis", "phase", "commanded_rad", "measured_rad", "velocity_rad_per_s"].map(column);
    let mut motors = vec![0.0; robot.axis.len()];
    for line in lines {
        let row: Vec<_> = line.split(',').collect();
        let number = |column: usize| row[column].parse::<f64>().unwrap_or(f64::NAN);
        let axis = robot.axis.iter().position(|axis| row[name] == axis.name);
        let axis = axis.ok_or_else(|| format!("{line}: of no axis"))?;
        let given = &robot.axis[axis];
        let is_slow = number(velocity).abs() <= given.max_velocity + given.following_error / 0.1;
        if !is_slow {
            return Err(format!("{line}: faster than {} rad/s", given.max_velocity));
        }
        if row[phase] != "Moving" {
            continue;
        }
        let follows = (number(commanded) - number(measured)).abs() <= 2.0 * given.following_error;
        if !follows {
            return Err(format!("{line}: does not follow"));
        }
        motors[axis] = number(commanded);
        if axis + 1 == motors.len() {
            let joints = arm.joints(&std::array::from_fn(|axis| motors.get(axis).copied().unwrap_or(0.0)));
            let joints = joints.map_err(|error| format!("{line}: {error}"))?;
            let limits = arm.robot().joint_limits().iter().zip(joints);
            if !limits.into_iter().all(|(range, joint)| (range.low - 1e-6..=range.high + 1e-6).contains(&joint)) {
                return Err(format!("{line}: beyond the range of a joint: {joints:?}"));
            }
        }
    }
    Ok(())
}

#[test]
fn random_programs_on_random_chains_run_within_their_limits_or_are_refused() {
    let seed = variable("MRROC_RANDOM_SEED", 1);
    let times = variable("MRROC_RANDOM_TIMES", 1);
    let one = variable("MRROC_RANDOM_CASE", u64::MAX);
    let cases = if one == u64::MAX { 0..CHAINS * times } else { one..one + 1 };
    let count = cases.end - cases.start;
    let verdicts = in_turns(count, |number| {
        let case = cases.start + number;
        let text = cell(&mut Draw::of(seed, case));
        if one != u64::MAX {
            println!("{text}");
        }
        let verdict = judge(&text);
        if let Verdict::Failed(said) = &verdict {
            println!("seed {seed}, case {case}: {said}");
            return Err(format!("seed {seed}, case {case}: {said}"));
        }
        Ok(verdict)
    });
    let failed: Vec<_> = verdicts.iter().filter_map(|it| it.as_ref().err()).map(String::as_str).collect();
    assert!(failed.is_empty(), "{} of {count} chains:\n{}", failed.len(), failed.join("\n"));
    let of = |wanted: fn(&Verdict) -> bool| verdicts.iter().flatten().filter(|verdict| wanted(verdict)).count();
    let completed = of(|verdict| matches!(verdict, Verdict::Completed));
    let foretold = of(|verdict| matches!(verdict, Verdict::Foretold));
    let refused = of(|verdict| matches!(verdict, Verdict::Refused));
    println!(
        "{completed} of {count} chains run, {refused} are refused, {foretold} fail in an axis that the check warns of"
    );
    assert!(one != u64::MAX || completed as u64 > count / 3, "{completed} of {count} chains run");
    assert!(one != u64::MAX || foretold as u64 <= count / 10, "{foretold} of {count} chains fail after a warning");
}
