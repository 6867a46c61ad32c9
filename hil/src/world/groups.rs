//! Parts of a world that do not influence each other within an advance.

use std::time::Duration;

use can::Instant;

use super::VirtualBus;
use crate::line::SerialLine;
use crate::scene::{STEP, Scene};
use crate::{Mechanism, PlantAxis};

/// Buses and lines that advance together, in the steps of the scene.
pub(super) struct Group {
    buses: Vec<usize>,
    lines: Vec<usize>,
    robots: Vec<usize>,
    /// Time of the next event of each bus, then of each line, during an advance.
    next: Vec<Instant>,
}

/// The groups of a world.
pub(super) struct Groups {
    groups: Vec<Group>,
    /// Whether each group has the robots of its devices, and no group influences another.
    separate: bool,
}

impl Groups {
    /// One group per robot and per bus without a robot, if the robots of the scene do not influence each other; a line
    /// without a robot then needs no steps. Otherwise one group of all. The results are the same. Separate groups are
    /// faster, because the data of one group fit into the cache of a processor.
    pub(super) fn new(scene: &Scene, buses: &[VirtualBus], lines: &[SerialLine]) -> Self {
        let robots: Option<Vec<Mechanism>> = scene.independent_robots().map(|robots| robots.cloned().collect());
        let robots = robots.filter(|robots| {
            let of_buses = buses.iter().flat_map(VirtualBus::devices).filter_map(|device| device.plant());
            let motors: Vec<_> = of_buses.chain(lines.iter().filter_map(|line| line.any_device().plant())).collect();
            let of =
                |axis: &PlantAxis, robot: &Mechanism| axis.mechanism().is_some_and(|mechanism| robot.is(mechanism));
            // Each motor of a robot must be known here, and no other device may read its shaft.
            robots.iter().all(|robot| {
                let own: Vec<_> = motors.iter().filter(|axis| of(axis, robot)).collect();
                own.len() == robot.mounted() && !own.iter().any(|axis| axis.is_probed())
            })
        });
        let Some(robots) = robots else {
            let all = Group::new((0..buses.len()).collect(), (0..lines.len()).collect(), Vec::new());
            return Self { groups: vec![all], separate: false };
        };
        let mut groups: Vec<Group> =
            (0..robots.len()).map(|robot| Group::new(Vec::new(), Vec::new(), vec![robot])).collect();
        for (number, bus) in buses.iter().enumerate() {
            let used: Vec<_> = bus.devices().filter_map(|device| robot_of(device.mechanism(), &robots)).collect();
            match joined(&mut groups, &used) {
                Some(group) => group.buses.push(number),
                // Its devices may read the scene in each step.
                None => groups.push(Group::new(vec![number], Vec::new(), Vec::new())),
            }
        }
        for (number, line) in lines.iter().enumerate() {
            let used = robot_of(line.any_device().mechanism(), &robots);
            if let Some(group) = joined(&mut groups, used.as_slice()) {
                group.lines.push(number);
            }
        }
        for group in &mut groups {
            group.next = vec![Instant::ZERO; group.buses.len() + group.lines.len()];
        }
        Self { groups, separate: true }
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
    fn new(buses: Vec<usize>, lines: Vec<usize>, robots: Vec<usize>) -> Self {
        let next = vec![Instant::ZERO; buses.len() + lines.len()];
        Self { buses, lines, robots, next }
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

/// The number of a mechanism among the robots of the scene.
fn robot_of(mechanism: Option<&Mechanism>, robots: &[Mechanism]) -> Option<usize> {
    let mechanism = mechanism?;
    robots.iter().position(|robot| robot.is(mechanism))
}

/// The group of all these robots, which become one group; `None` without robots.
fn joined<'a>(groups: &'a mut Vec<Group>, robots: &[usize]) -> Option<&'a mut Group> {
    let mut of_robots = groups.extract_if(.., |group| group.robots.iter().any(|robot| robots.contains(robot)));
    let mut group = of_robots.next()?;
    for other in of_robots {
        group.buses.extend(other.buses);
        group.lines.extend(other.lines);
        group.robots.extend(other.robots);
    }
    groups.push(group);
    groups.last_mut()
}

#[cfg(test)]
mod tests;
