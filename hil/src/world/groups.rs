//! Parts of a world that do not influence each other within an advance.

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;

use super::{Helpers, VirtualBus};
use crate::line::SerialLine;
use crate::scene::{RobotOfScene, STEP, Scene};
use crate::{Cabinet, Mechanism, PlantAxis};

/// The work of the host beside an advance is counted as the work of the advance, divided by this number. In the
/// laboratory, the measured work of the host is only a fifth of an advance, but a third distributes the groups best.
const HOST: usize = 3;

/// Buses and lines that advance together.
// Different threads may advance two groups. Two groups therefore share no cache line.
#[repr(align(128))]
pub(super) struct Group {
    /// Buses and lines in ascending order, as in the group of all.
    buses: Vec<usize>,
    lines: Vec<usize>,
    robots: Vec<usize>,
    /// Number of the thread that advances the group, unless another thread has nothing left to do. The thread is mostly the
    /// same in every advance, so its cache keeps the data of the group.
    thread: usize,
    /// Couplings of the devices with other devices.
    couplings: Vec<Coupling>,
    /// Time of the next event of each bus, then of each line, during an advance.
    next: Vec<Instant>,
}

/// The groups of a world.
pub(super) struct Groups {
    groups: Vec<Group>,
    /// Whether each group has the robots of its devices, and no group influences another.
    separate: bool,
}

/// An object through which devices influence each other between two steps of the scene.
enum Coupling {
    /// A robot, whether in the scene or not.
    Robot(Mechanism),
    Cabinet(Cabinet),
}

impl PartialEq for Coupling {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Robot(one), Self::Robot(other)) => one.is(other),
            (Self::Cabinet(one), Self::Cabinet(other)) => one.is(other),
            (Self::Robot(_), Self::Cabinet(_)) | (Self::Cabinet(_), Self::Robot(_)) => false,
        }
    }
}

/// Interval of an advance.
#[derive(Clone, Copy)]
struct Interval {
    /// Times of the last step of the scene before the interval and of the last step in the interval. `None` without a
    /// scene.
    steps: Option<(Instant, Instant)>,
    until: Instant,
}

/// A separate group during an advance, with its buses, lines and robots.
struct Part<'a> {
    group: &'a mut Group,
    buses: Vec<&'a mut VirtualBus>,
    lines: Vec<&'a mut SerialLine>,
    robots: Vec<RobotOfScene<'a>>,
}

impl Groups {
    /// The groups of a world. If robots may influence each other through the scene, all buses and lines are in one
    /// group. Otherwise there is one group for each robot, one for each bus without a robot, and one for all lines
    /// without couplings. Buses and lines with a common robot or cabinet are in one group. The results do not depend on
    /// the groups. Separate groups are faster, because the data of one group fit into the cache of a processor, and
    /// because several threads can share the groups. `threads` is the number of threads.
    pub(super) fn new(scene: Option<&Scene>, buses: &[VirtualBus], lines: &[SerialLine], threads: usize) -> Self {
        let of_buses = buses.iter().flat_map(VirtualBus::devices).filter_map(|device| device.plant());
        let motors: Vec<_> = of_buses.chain(lines.iter().filter_map(|line| line.any_device().plant())).collect();
        let robots: Option<Vec<Mechanism>> = match scene {
            Some(scene) => scene.independent_robots().map(|robots| robots.cloned().collect()),
            None => Some(Vec::new()),
        };
        let robots = robots.filter(|robots| {
            let of =
                |axis: &PlantAxis, robot: &Mechanism| axis.mechanism().is_some_and(|mechanism| robot.is(mechanism));
            let is_known = |robot: &Mechanism| motors.iter().filter(|axis| of(axis, robot)).count() == robot.mounted();
            // Each motor of a robot must be known here, and no other device may read a shaft.
            robots.iter().all(is_known) && !motors.iter().any(|axis| axis.is_probed())
        });
        let Some(robots) = robots else {
            let mut all = Group::new(Vec::new());
            (all.buses, all.lines) = ((0..buses.len()).collect(), (0..lines.len()).collect());
            return Self { groups: vec![all.closed()], separate: false };
        };
        let of_robot = |(number, robot)| Group { robots: vec![number], ..Group::new(vec![Coupling::Robot(robot)]) };
        let mut groups: Vec<Group> = robots.into_iter().enumerate().map(of_robot).collect();
        for (number, bus) in buses.iter().enumerate() {
            let robots = bus.devices().filter_map(|device| device.mechanism()).cloned().map(Coupling::Robot);
            join(&mut groups, Group { buses: vec![number], ..Group::new(robots.collect()) });
        }
        let mut uncoupled = Group::new(Vec::new());
        for (number, line) in lines.iter().enumerate() {
            let device = line.any_device();
            let robot = device.mechanism().cloned().map(Coupling::Robot);
            let cabinet = device.cabinet().cloned().map(Coupling::Cabinet);
            let couplings: Vec<_> = robot.into_iter().chain(cabinet).collect();
            if couplings.is_empty() {
                uncoupled.lines.push(number);
            } else {
                join(&mut groups, Group { lines: vec![number], ..Group::new(couplings) });
            }
        }
        if !uncoupled.lines.is_empty() {
            groups.push(uncoupled);
        }
        // The groups are assigned in descending order of their work, each group to the thread with the least work.
        // Among threads with equal work, the thread with the highest number takes the group.
        let motors = |group: &Group| {
            let at_buses = group.buses.iter().flat_map(|&bus| buses[bus].devices());
            at_buses.filter(|device| device.plant().is_some()).count() + group.lines.len()
        };
        groups.sort_by_key(|group| std::cmp::Reverse(motors(group)));
        let mut work = vec![0; threads];
        // The helped thread, number 0, also does the work of the host.
        work[0] = groups.iter().map(motors).sum::<usize>() / HOST;
        for group in &mut groups {
            group.thread = (0..threads).rev().min_by_key(|&thread| work[thread]).unwrap_or(0);
            work[group.thread] += motors(group);
        }
        Self { groups: groups.into_iter().map(Group::closed).collect(), separate: true }
    }

    /// Advances the buses and lines to `until`, and the scene to its last step at or before `until`. The calling thread
    /// first does `work`, while helpers already advance their shares.
    pub(super) fn advance(
        &mut self,
        until: Instant,
        mut scene: Option<&mut Scene>,
        buses: &mut [VirtualBus],
        lines: &mut [SerialLine],
        helpers: Option<&Helpers>,
        work: impl FnOnce(),
    ) {
        let steps = scene.as_ref().map(|scene| {
            let start = scene.now();
            let steps = until.since(start).as_nanos() as u64 / STEP.as_nanos() as u64;
            (start, start + Duration::from_nanos(steps * STEP.as_nanos() as u64))
        });
        let interval = Interval { steps, until };
        if self.separate {
            let parts = self.parts(scene.as_deref_mut(), buses, lines);
            let advance = |part: Part| part.advance(interval);
            match helpers {
                Some(helpers) => {
                    let mut shares: Vec<_> = (0..helpers.threads()).map(|_| VecDeque::new()).collect();
                    parts.into_iter().for_each(|part| shares[part.group.thread].push_back(part));
                    helpers.share(shares, work, advance);
                }
                None => {
                    work();
                    parts.into_iter().for_each(advance);
                }
            }
            if let (Some(scene), Some((_, end))) = (scene, steps) {
                scene.end_steps(end);
            }
            return;
        }
        work();
        let Some(all) = self.groups.first_mut() else {
            return;
        };
        let (mut buses, mut lines) = (buses.iter_mut().collect::<Vec<_>>(), lines.iter_mut().collect::<Vec<_>>());
        if let (Some(scene), Some((start, end))) = (scene, steps) {
            all.next.fill(Instant::ZERO);
            let mut now = start;
            while now < end {
                now += STEP;
                all.move_to(now, &mut buses, &mut lines);
                scene.step();
                all.sense(now, &mut buses);
            }
        }
        buses.into_iter().for_each(|bus| bus.advance(until));
        lines.into_iter().for_each(|line| line.advance(until));
    }

    fn parts<'a>(
        &'a mut self,
        scene: Option<&'a mut Scene>,
        buses: &'a mut [VirtualBus],
        lines: &'a mut [SerialLine],
    ) -> Vec<Part<'a>> {
        let mut buses: Vec<_> = buses.iter_mut().map(Some).collect();
        let mut lines: Vec<_> = lines.iter_mut().map(Some).collect();
        let mut robots: Vec<_> = scene.map(|scene| scene.robots().map(Some).collect()).unwrap_or_default();
        let part = |group: &'a mut Group| {
            let buses = group.buses.iter().filter_map(|&bus| buses[bus].take()).collect();
            let lines = group.lines.iter().filter_map(|&line| lines[line].take()).collect();
            let robots = group.robots.iter().filter_map(|&robot| robots[robot].take()).collect();
            Part { group, buses, lines, robots }
        };
        self.groups.iter_mut().map(part).collect()
    }
}

impl Part<'_> {
    fn advance(mut self, interval: Interval) {
        // The devices of a bus may read the scene in each step. In a group without robots and buses, only lines that
        // are coupled with each other need steps.
        let coupled_lines = self.lines.len() > 1 && !self.group.couplings.is_empty();
        let stepped = !self.robots.is_empty() || !self.buses.is_empty() || coupled_lines;
        if let Some((start, end)) = interval.steps.filter(|_| stepped) {
            self.group.next.fill(Instant::ZERO);
            let mut now = start;
            while now < end {
                now += STEP;
                self.group.move_to(now, &mut self.buses, &mut self.lines);
                self.robots.iter_mut().for_each(RobotOfScene::step);
                self.group.sense(now, &mut self.buses);
            }
        }
        self.buses.into_iter().for_each(|bus| bus.advance(interval.until));
        self.lines.into_iter().for_each(|line| line.advance(interval.until));
    }
}

impl Group {
    /// A group of no bus and no line yet.
    fn new(couplings: Vec<Coupling>) -> Self {
        Self { buses: Vec::new(), lines: Vec::new(), robots: Vec::new(), thread: 0, couplings, next: Vec::new() }
    }

    /// The group with all its buses and lines.
    fn closed(mut self) -> Self {
        self.buses.sort_unstable();
        self.lines.sort_unstable();
        self.next = vec![Instant::ZERO; self.buses.len() + self.lines.len()];
        self
    }

    /// Processes the events before `step`, and moves the motors to `step`. A bus or a line is left out of the steps in
    /// which it has no event.
    fn move_to(&mut self, step: Instant, buses: &mut [&mut VirtualBus], lines: &mut [&mut SerialLine]) {
        let before = step - Duration::from_nanos(1);
        let (on_buses, on_lines) = self.next.split_at_mut(buses.len());
        for (bus, next) in buses.iter_mut().zip(on_buses.iter_mut()) {
            if *next <= before {
                *next = bus.advance_to(before);
            }
        }
        for (line, next) in lines.iter_mut().zip(on_lines.iter_mut()) {
            if *next <= before {
                *next = line.advance_to(before);
            }
        }
        for (bus, next) in buses.iter_mut().zip(on_buses) {
            if bus.advance_mechanics(step) {
                *next = Instant::ZERO;
            }
        }
        for (line, next) in lines.iter_mut().zip(on_lines) {
            if line.advance_mechanics(step) {
                *next = Instant::ZERO;
            }
        }
    }

    fn sense(&mut self, step: Instant, buses: &mut [&mut VirtualBus]) {
        for (bus, next) in buses.iter_mut().zip(&mut self.next) {
            if bus.sense(step) {
                *next = Instant::ZERO;
            }
        }
    }
}

/// Adds a group, and unites it with all groups that share a coupling with it.
fn join(groups: &mut Vec<Group>, mut group: Group) {
    let is_coupled = |other: &mut Group| other.couplings.iter().any(|coupling| group.couplings.contains(coupling));
    for other in groups.extract_if(.., is_coupled).collect::<Vec<_>>() {
        group.buses.extend(other.buses);
        group.lines.extend(other.lines);
        group.robots.extend(other.robots);
        group.couplings.extend(other.couplings);
    }
    groups.push(group);
}

#[cfg(test)]
mod tests;
