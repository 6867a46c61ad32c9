//! Parts of a world that do not influence each other within an advance.

use std::time::Duration;

use can::Instant;

use super::VirtualBus;
use crate::line::SerialLine;
use crate::scene::{STEP, Scene};
use crate::{Cabinet, Mechanism, PlantAxis};

/// Buses and lines that advance together, in the steps of the scene.
pub(super) struct Group {
    /// Buses and lines in ascending order, as in the group of all.
    buses: Vec<usize>,
    lines: Vec<usize>,
    robots: Vec<usize>,
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

impl Groups {
    /// If the robots of the scene do not influence each other: one group per robot, and one per bus without a robot.
    /// Buses and lines with a common robot or cabinet are in one group. A line that is coupled with nothing needs no
    /// steps. Otherwise one group of all. The results are the same. Separate groups are faster, because the data of one
    /// group fit into the cache of a processor.
    pub(super) fn new(scene: &Scene, buses: &[VirtualBus], lines: &[SerialLine]) -> Self {
        let robots: Option<Vec<Mechanism>> = scene.independent_robots().map(|robots| robots.cloned().collect());
        let robots = robots.filter(|robots| {
            let of_buses = buses.iter().flat_map(VirtualBus::devices).filter_map(|device| device.plant());
            let motors: Vec<_> = of_buses.chain(lines.iter().filter_map(|line| line.any_device().plant())).collect();
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
        for (number, line) in lines.iter().enumerate() {
            let device = line.any_device();
            let robot = device.mechanism().cloned().map(Coupling::Robot);
            let cabinet = device.cabinet().cloned().map(Coupling::Cabinet);
            let couplings = robot.into_iter().chain(cabinet).collect();
            join(&mut groups, Group { lines: vec![number], ..Group::new(couplings) });
        }
        // The devices of a bus may read the scene in each step.
        groups.retain(|group| !group.robots.is_empty() || !group.buses.is_empty() || group.lines.len() > 1);
        Self { groups: groups.into_iter().map(Group::closed).collect(), separate: true }
    }

    /// Advances to the last step of the scene up to `until`.
    pub(super) fn advance(
        &mut self,
        until: Instant,
        scene: &mut Scene,
        buses: &mut [VirtualBus],
        lines: &mut [SerialLine],
    ) {
        let start = scene.now();
        let steps = until.since(start).as_nanos() as u64 / STEP.as_nanos() as u64;
        let end = start + Duration::from_nanos(steps * STEP.as_nanos() as u64);
        for group in &mut self.groups {
            let mut now = start;
            group.next.fill(Instant::ZERO);
            while now < end {
                now += STEP;
                group.move_to(now, buses, lines);
                if self.separate {
                    group.robots.iter().for_each(|&robot| scene.step_robot(robot));
                } else {
                    scene.step();
                }
                group.sense(now, buses);
            }
        }
        if self.separate {
            scene.end_steps(end);
        }
    }
}

impl Group {
    /// A group of no bus and no line yet.
    fn new(couplings: Vec<Coupling>) -> Self {
        Self { buses: Vec::new(), lines: Vec::new(), robots: Vec::new(), couplings, next: Vec::new() }
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
    fn move_to(&mut self, step: Instant, buses: &mut [VirtualBus], lines: &mut [SerialLine]) {
        let before = step - Duration::from_nanos(1);
        let (on_buses, on_lines) = self.next.split_at_mut(self.buses.len());
        for (&bus, next) in self.buses.iter().zip(on_buses.iter_mut()) {
            if *next <= before {
                *next = buses[bus].advance_to(before);
            }
        }
        for (&line, next) in self.lines.iter().zip(on_lines.iter_mut()) {
            if *next <= before {
                *next = lines[line].advance_to(before);
            }
        }
        for (&bus, next) in self.buses.iter().zip(on_buses) {
            if buses[bus].advance_mechanics(step) {
                *next = Instant::ZERO;
            }
        }
        for (&line, next) in self.lines.iter().zip(on_lines) {
            if lines[line].advance_mechanics(step) {
                *next = Instant::ZERO;
            }
        }
    }

    fn sense(&mut self, step: Instant, buses: &mut [VirtualBus]) {
        for (&bus, next) in self.buses.iter().zip(&mut self.next) {
            if buses[bus].sense(step) {
                *next = Instant::ZERO;
            }
        }
    }
}

/// Adds a group, which becomes one with all groups that have one of its couplings.
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
