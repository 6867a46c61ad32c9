//! One row of the fault table: a fault strikes a robot in a phase, in lockstep.

use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use can::Instant;
use hil::{DriveId, FaultInEffect, PlantAxis, PlantFault, WorldFault};
use mrroc::bench::emulation::Emulation;
use mrroc::bench::plants::plant;
use mrroc::cell::CellFile;
use mrroc::scenario::{FaultKind, axis_place};
use mrroc::{run, setup};
use serial::Line;
use servo::{EffectorLink, MAX_AXES, Order, Phase, Servo, ServoFault, ServoState, StopCategory, StopCause, lockstep};

use super::bounds::smallest_step;
use super::catalogue::FaultCase;
use super::detector::{Detector, Without};
use super::origin::{CONTACT, Flaw, Missed, Origin};
use super::phase::{Course, FaultPhase, FixedMotion};

/// Longest preparation: enabling and referencing.
const PREPARATION: Duration = Duration::from_secs(20);
/// Greatest time-out of homing. The cell's own is minutes.
const HOMING: Duration = Duration::from_secs(30);
/// Time for which a robot is observed after the detection.
const STOPPED: Duration = Duration::from_millis(1200);
/// Time for which all axes must stay at rest.
const REST: Duration = Duration::from_millis(300);
/// Distance, rad, within which a motor is at rest. A motor that a loop holds trembles by an increment of its encoder.
const TREMBLE: f64 = 0.1;
/// Longest reset.
const RESET: Duration = Duration::from_secs(2);
/// Longest enabling.
const ENABLE: Duration = Duration::from_secs(4);
/// Greatest motion of a motor, rad, when its drive is enabled again: the load is taken up.
const JUMP: f64 = 0.3;

/// What happened in a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Observation {
    /// The first fault of the servo, and the time from the strike.
    pub(super) detected: Option<(Duration, ServoFault)>,
    /// Stop category of IEC 60204-1.
    pub(super) category: Option<u8>,
    /// Time from the strike to standstill of all axes; `None` if they still move at the end.
    pub(super) still_after: Option<Duration>,
    /// Greatest distance of each motor from its position at the strike, rad.
    pub(super) distances: [f64; MAX_AXES],
    /// Whether the planned motion ended, or homing goes on.
    pub(super) completed: bool,
    /// Distance of each motor from its last set-point at the end of the observation, rad; `None` without a reference.
    pub(super) strays: Option<[f64; MAX_AXES]>,
    pub(super) recovery: Recovery,
}

/// How the robot was brought back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Recovery {
    /// The robot never stopped.
    None,
    /// A stop order: the robot stands with power on.
    Stop,
    /// Reset of the fault, and enabling.
    Reset,
    /// As before, and homing, because a reference was lost.
    Home,
    /// The fault cannot be reset.
    Restart,
    /// The reset worked, and a motor jumped by this much, rad, when it was enabled.
    Jumped(f64),
}

/// A robot, and its partner in a team, with their emulated world.
struct Stage<'a> {
    file: &'a CellFile,
    servo: Servo,
    links: Vec<EffectorLink>,
    emulation: Emulation,
    /// Drives of the axes, robot after robot.
    drives: Vec<Vec<DriveId>>,
    motions: Vec<FixedMotion>,
    course: Course,
    /// The spring of a row of contact.
    spring: Option<FaultInEffect>,
    /// The deadlines that the host misses, and the number of cycles since the strike.
    missed: Option<(Missed, u64)>,
    now: Instant,
}

/// The velocities of the fixed motion, and what [`Observation`] says.
pub(super) struct Played {
    pub(super) velocity: [f64; MAX_AXES],
    pub(super) observation: Observation,
}

/// Plays a row. Robot 0 of the cell has the fault on `axis`; robot 1, if there is one, is its partner.
pub(super) fn play(
    file: &CellFile,
    case: &FaultCase,
    phase: FaultPhase,
    axis: usize,
    without: &[Detector],
) -> anyhow::Result<Played> {
    let mut stage = Stage::new(file, phase, without, Course::of(file, case.at_top_speed))?;
    stage.prepare(phase)?;
    if phase == FaultPhase::Homing {
        stage.order(0, Order::Home);
        stage.cycle();
    } else if phase.moves() {
        if let Origin::Generator(flaw) = case.origin {
            stage.spoil(phase, axis, flaw);
        }
        stage.begin_motion(phase)?;
    }
    let strike = stage.now + phase.strikes_after(&stage.course);
    let buffer_at = stage.now + stage.course.ramp;
    let mut pressed = phase != FaultPhase::Contact;
    while stage.now < strike {
        if !pressed && stage.now >= buffer_at {
            stage.press(axis)?;
            pressed = true;
        }
        stage.cycle();
        if let Some(fault) = stage.servo.fault(0) {
            bail!("the robot stopped before the fault: {fault}");
        }
    }
    let velocity = stage.motions[0].velocity;
    Ok(Played { velocity, observation: stage.observe(case, axis)? })
}

impl<'a> Stage<'a> {
    fn new(file: &'a CellFile, phase: FaultPhase, without: &[Detector], course: Course) -> anyhow::Result<Self> {
        let (mut emulation, ends) = Emulation::with(file, phase != FaultPhase::Homing);
        let boxed = |line| Box::new(line) as Box<dyn Line>;
        let lines = ends.lines.into_iter().map(|bundle| bundle.into_iter().map(boxed).collect()).collect();
        let groups = setup::devices(file, ends.ports, lines, Vec::new(), None)?.groups;
        let mut config = setup::servo_config(file);
        for effector in &mut config.effectors {
            effector.homing_timeout = effector.homing_timeout.min(HOMING);
        }
        without.iter().for_each(|detector| detector.remove_from(&mut config));
        let groups = groups.into_iter().map(|group| Without::wrap(group, without)).collect();
        let (mut servo, links) = Servo::new(&config, groups)?;
        let up = lockstep::bring_up(&mut servo, Instant::ZERO, |next| emulation.advance(next));
        let now = up.map_err(|why| run::diagnosed(file, &servo, why)).context("bring-up")?;
        let ids = emulation.ids().clone();
        let robots = file.cell.robot.iter().enumerate();
        let drives = robots.map(|(robot, given)| {
            let axis = |axis| ids.drives.get(&(robot, axis)).copied().context("an axis without a drive");
            (0..given.axis.len()).map(axis).collect::<anyhow::Result<_>>()
        });
        let drives = drives.collect::<anyhow::Result<_>>()?;
        let motions = Vec::new();
        Ok(Self { file, servo, links, emulation, drives, motions, course, spring: None, missed: None, now })
    }

    fn cycle(&mut self) {
        for robot in 0..self.motions.len() {
            self.feed(robot);
        }
        self.miss_deadlines();
        self.servo.step(self.now);
        self.now += self.servo.period();
        self.emulation.advance(self.now);
        for link in &mut self.links {
            while link.reports.pop().is_ok() {}
        }
    }

    /// Lets the deadlines pass that the host misses before a cycle.
    fn miss_deadlines(&mut self) {
        let Some((missed, cycle)) = &mut self.missed else {
            return;
        };
        let count = missed.before(*cycle, self.file.cell.max_missed_in_row);
        *cycle += 1;
        if count > 0 {
            self.now += self.servo.period() * count;
            self.emulation.advance(self.now);
            self.servo.missed(count);
        }
    }

    /// Lets the generator of the robot err in the first macrostep that begins after the strike. A partner in a team gets a
    /// macrostep of the same length.
    fn spoil(&mut self, phase: FaultPhase, axis: usize, flaw: Flaw) {
        let after = phase.strikes_after(&self.course);
        self.motions[0].spoil(self.file, 0, axis, after, flaw);
        if flaw != Flaw::Absent {
            self.motions[1..].iter_mut().for_each(|motion| motion.cut(after));
        }
    }

    /// Keeps the queue of a robot full as long as it moves.
    fn feed(&mut self, robot: usize) {
        let stopped = self.servo.fault(robot).is_some();
        while !stopped && self.links[robot].orders.slots() > 4 {
            let Some(step) = self.motions[robot].next() else {
                return;
            };
            if self.links[robot].orders.push(Order::Move(step)).is_err() {
                return;
            }
        }
    }

    fn order(&mut self, robot: usize, order: Order) {
        let _ = self.links[robot].orders.push(order);
    }

    fn phase(&self, robot: usize) -> Phase {
        self.servo.state(robot).map_or(Phase::Off, ServoState::phase)
    }

    fn until(&mut self, limit: Duration, what: &str, done: impl Fn(&Self) -> bool) -> anyhow::Result<()> {
        let end = self.now + limit;
        while !done(self) {
            if let Some(fault) = self.servo.fault(0).filter(|_| self.now >= end) {
                bail!("{what}: {fault}");
            }
            if self.now >= end {
                bail!("{what}: not within {limit:?}");
            }
            self.cycle();
        }
        Ok(())
    }

    /// Enables all robots, and gives them their references unless the row is about homing.
    fn prepare(&mut self, phase: FaultPhase) -> anyhow::Result<()> {
        let robots = self.links.len();
        let standing = |stage: &Self| (0..robots).all(|robot| stage.phase(robot) == Phase::Standing);
        (0..robots).for_each(|robot| self.order(robot, Order::Enable));
        self.cycle();
        self.until(PREPARATION, "enabling", standing)?;
        if phase != FaultPhase::Homing {
            (0..robots).for_each(|robot| self.order(robot, Order::Home));
            self.cycle();
            self.until(PREPARATION, "homing", standing)?;
        }
        let from = |robot: usize| self.links[robot].latest.read();
        let motion = |robot| {
            let snapshot = from(robot);
            FixedMotion::of(self.file, robot, snapshot.commanded, snapshot.macrostep, self.course)
        };
        let motions: Vec<_> = (0..robots).map(motion).collect();
        // The fixed motion gives the velocities for the bounds of all phases.
        self.motions = motions;
        if !phase.moves() {
            self.motions.iter_mut().for_each(|motion| while motion.next().is_some() {});
        }
        Ok(())
    }

    fn begin_motion(&mut self, phase: FaultPhase) -> anyhow::Result<()> {
        if phase == FaultPhase::Team {
            if self.links.len() < 2 {
                bail!("the cell has no second robot");
            }
            (0..2).for_each(|robot| self.order(robot, Order::Tie { members: 0b11 }));
        }
        self.cycle();
        self.until(Duration::from_secs(1), "motion", |stage| stage.phase(0) == Phase::Moving)
    }

    /// Puts a spring in the way of an axis. The spring takes a third of the rated torque at the end of the motion.
    fn press(&mut self, axis: usize) -> anyhow::Result<()> {
        let given = &self.file.cell.robot[0].axis[axis];
        let rated = match (&given.drive, &given.controller) {
            (Some(drive), _) => drive.rated_torque,
            (None, Some(controller)) => controller.max_current * controller.torque_constant / 3.0,
            (None, None) => bail!("an axis without a drive"),
        };
        let way = self.motions[0].velocity[axis].abs() * (self.course.cruise + self.course.ramp).as_secs_f64();
        let fault = PlantFault::Buffer { distance: 0.25 * way, stiffness: rated / 3.0 / (0.75 * way).max(1e-3) };
        self.spring = Some(self.emulation.begin_fault(&WorldFault::Plant { drive: self.drives[0][axis], fault }));
        Ok(())
    }

    /// True positions of the motors of a robot, rad.
    fn truth(&self, robot: usize) -> [f64; MAX_AXES] {
        let drives = &self.drives[robot];
        let plant = |axis: usize| self.emulation.plant(*drives.get(axis)?).map(PlantAxis::angle);
        std::array::from_fn(|axis| plant(axis).unwrap_or_default())
    }

    /// Lets the fault strike on `axis`. A wrong macrostep was given to the servo before.
    fn begin(&mut self, case: &FaultCase, axis: usize) -> anyhow::Result<Vec<FaultInEffect>> {
        let kind = match case.origin {
            Origin::Emulated(kind) => kind,
            Origin::Deadlines(missed) => {
                self.missed = Some((missed, 0));
                return Ok(Vec::new());
            }
            Origin::EmergencyStop => {
                self.set_contact(false)?;
                return Ok(Vec::new());
            }
            Origin::Generator(_) => return Ok(Vec::new()),
        };
        let struck = if case.disables || case.all_axes { 0..self.drives[0].len() } else { axis..axis + 1 };
        let mut numbers = case.numbers();
        if let Some(multiple) = case.jump {
            let speed = if self.phase(0) == Phase::Moving { self.motions[0].velocity[axis].abs() } else { 0.0 };
            let given = &self.file.cell.robot[0].axis[axis];
            numbers.increments = (multiple * smallest_step(self.file, given, speed)).ceil() as i32;
        }
        if kind == FaultKind::SaggingSupply && self.phase(0) == Phase::Moving {
            // A supply that is sufficient for the motion is no fault. It therefore provides at most half of the
            // back-EMF.
            let plant = plant(self.file, 0, axis);
            let back = plant.plant.torque_constant() * self.motions[0].velocity[axis].abs();
            numbers.share = numbers.share.min(0.5 * back / plant.amplifier.max_voltage);
        }
        let mut faults = Vec::new();
        for axis in struck {
            let place = axis_place(self.file, self.emulation.ids(), (0, axis)).context("an axis without a drive")?;
            faults.extend(kind.faults(&place, &numbers).map_err(|problem| anyhow!("the fault {problem}"))?);
        }
        Ok(faults.iter().map(|fault| self.emulation.begin_fault(fault)).collect())
    }

    /// Ends the fault.
    fn end(&mut self, case: &FaultCase, in_effect: &[FaultInEffect]) -> anyhow::Result<()> {
        in_effect.iter().for_each(|fault| self.emulation.end_fault(fault));
        self.missed = None;
        if case.origin == Origin::EmergencyStop { self.set_contact(true) } else { Ok(()) }
    }

    /// Closes or opens the contact of the emergency stop.
    fn set_contact(&mut self, closed: bool) -> anyhow::Result<()> {
        let (node, input) = CONTACT;
        if self.emulation.set_input(node, input, closed) { Ok(()) } else { bail!("the cell has no contact") }
    }

    /// Lets the fault strike, and observes the robot until it has been at rest, and then while it is brought back.
    fn observe(&mut self, case: &FaultCase, axis: usize) -> anyhow::Result<Observation> {
        let began = self.now;
        let at_strike = self.truth(0);
        let in_effect = self.begin(case, axis)?;
        if case.disables {
            self.motions.clear();
            self.order(0, Order::Disable);
        }
        let mut ended = false;
        let mut observed = Observation {
            detected: None,
            category: None,
            still_after: None,
            distances: [0.0; MAX_AXES],
            completed: false,
            strays: None,
            recovery: Recovery::None,
        };
        let places = |stage: &Self| -> Vec<_> { (0..stage.links.len()).map(|robot| stage.truth(robot)).collect() };
        let (mut anchor, mut still_since) = (places(self), began);
        let mut was_moving = self.phase(0) == Phase::Moving || self.phase(0) == Phase::Homing;
        let observed_for = case.observed_for + self.course.longer();
        while self.now.since(began) < observed_for {
            // A long observation ends after the stop, when all axes have been at rest: a loop may close its last error
            // slowly.
            let rested = self.now.since(still_since) >= REST;
            let over = observed.detected.is_some_and(|(at, _)| rested && self.now.since(began + at) >= STOPPED);
            if over {
                break;
            }
            if !ended && case.lasts.is_some_and(|lasts| self.now.since(began) >= lasts) {
                self.end(case, &in_effect)?;
                ended = true;
            }
            self.cycle();
            let state = self.servo.state(0).unwrap_or_default();
            if observed.detected.is_none()
                && let Some(fault) = self.servo.fault(0)
            {
                observed.detected = Some((self.now.since(began), fault));
                observed.category = Some(match state {
                    _ if matches!(fault.cause, StopCause::Partner { .. } | StopCause::BrakeSlips { .. }) => 2,
                    _ if fault.category == StopCategory::Zero => 0,
                    ServoState::Braking(_) | ServoState::Halting(_) => 1,
                    _ => u8::from(!was_moving),
                });
            }
            was_moving = matches!(state.phase(), Phase::Moving | Phase::Homing);
            let truth = self.truth(0);
            for (number, distance) in observed.distances.iter_mut().enumerate() {
                *distance = distance.max((truth[number] - at_strike[number]).abs());
            }
            let here = places(self);
            let moved = here.iter().flatten().zip(anchor.iter().flatten()).any(|(it, was)| (it - was).abs() > TREMBLE);
            if moved {
                (anchor, still_since) = (here, self.now);
            }
        }
        observed.still_after = (self.now.since(still_since) >= REST).then(|| still_since.since(began));
        let off = case.disables && self.phase(0) == Phase::Off;
        observed.completed =
            self.servo.fault(0).is_none() && (off || matches!(self.phase(0), Phase::Standing | Phase::Homing));
        let snapshot = self.links[0].latest.read();
        if snapshot.homed {
            let truth = self.truth(0);
            let used = self.drives[0].len();
            let stray = |axis: usize| if axis < used { (truth[axis] - snapshot.commanded[axis]).abs() } else { 0.0 };
            observed.strays = Some(std::array::from_fn(stray));
        }
        if !ended {
            self.end(case, &in_effect)?;
        }
        if matches!(case.origin, Origin::Deadlines(_)) && self.servo.counters().missed_cycles == 0 {
            bail!("no deadline was missed");
        }
        if observed.detected.is_some() {
            observed.recovery = self.recover();
        }
        Ok(observed)
    }

    fn recover(&mut self) -> Recovery {
        self.motions.clear();
        // A spring would push an arm without a brake while its power is off.
        if let Some(spring) = self.spring.take() {
            self.emulation.end_fault(&spring);
        }
        // A drive that restarted needs time to boot.
        for _ in 0..50 {
            self.cycle();
        }
        if self.phase(0) == Phase::Standing {
            self.order(0, Order::Stop);
            self.cycle();
            let stands = self.servo.fault(0).is_none() && self.phase(0) == Phase::Standing;
            return if stands { Recovery::Stop } else { Recovery::Restart };
        }
        self.order(0, Order::ResetFault);
        self.cycle();
        let reset = |stage: &Self| stage.phase(0) == Phase::Off && stage.servo.fault(0).is_none();
        if self.until(RESET, "reset", reset).is_err() {
            return Recovery::Restart;
        }
        let before = self.truth(0);
        self.order(0, Order::Enable);
        self.cycle();
        let standing = |stage: &Self| stage.phase(0) == Phase::Standing;
        if self.until(ENABLE, "enabling", standing).is_err() {
            return Recovery::Restart;
        }
        for _ in 0..50 {
            self.cycle();
        }
        if self.servo.fault(0).is_some() {
            return Recovery::Restart;
        }
        let after = self.truth(0);
        let jump = before.iter().zip(after).map(|(before, after)| (after - before).abs()).fold(0.0, f64::max);
        if jump > JUMP {
            return Recovery::Jumped(jump);
        }
        if self.links[0].latest.read().homed { Recovery::Reset } else { Recovery::Home }
    }
}
