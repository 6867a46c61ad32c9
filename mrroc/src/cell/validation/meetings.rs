//! Checks that all meetings of a cell's programs can take place.

use servo::Gates;

use super::Checked;
use crate::cell::{Cell, Meeting, Path, instruction_path};

/// Robots with a common meeting must come to it equally often. The order of the meetings must not make robots wait for
/// each other forever.
pub(super) fn check(cell: &Cell) -> Checked {
    for (number, robot) in cell.robot.iter().enumerate() {
        // Each occurrence of a name is a meeting of its own.
        let (own, most) = (robot.meetings().count(), usize::from(Gates::COUNT));
        if let Some((index, _)) = robot.meetings().nth(most) {
            let why = format!("is one of {own} meetings of the robot, which may have {most}");
            return Err((instruction_path(number, index).then("meet"), why));
        }
    }
    let meetings = cell.meetings();
    if meetings.len() > usize::from(Gates::COUNT) {
        let (most, found) = (Gates::COUNT, meetings.len());
        let robot = meetings[usize::from(most)].robots[0];
        let why = format!("is one of {found} meetings of the cell, which may have {most}");
        let (index, _) = cell.robot[robot].meetings().next().unwrap_or_default();
        return Err((instruction_path(robot, index).then("meet"), why));
    }
    meetings.iter().find_map(|it| lonely(cell, &meetings, it)).or_else(|| hold(cell)).map_or(Ok(()), Err)
}

/// The error of a meeting with a wrong number of robots.
fn lonely(cell: &Cell, meetings: &[Meeting], meeting: &Meeting) -> Option<(Path, String)> {
    let name = &meeting.name;
    let first = meetings.iter().find(|it| it.name == *name)?;
    let robot = *meeting.robots.first()?;
    let comes = |robot: usize| cell.robot[robot].meetings().filter(|it| it.1 == name);
    let index = comes(robot).nth(meeting.occurrence)?.0;
    let path = instruction_path(robot, index).then("meet");
    let called = |robot: usize| &cell.robot[robot].name;
    if first.robots.len() < 2 {
        return Some((path, format!("no robot but {:?} comes to meeting {name:?}", called(robot))));
    }
    let other = *first.robots.iter().find(|it| !meeting.robots.contains(it))?;
    let why = format!(
        "robot {:?} comes {} times to meeting {name:?}, robot {:?} {} times",
        called(robot),
        comes(robot).count(),
        called(other),
        comes(other).count(),
    );
    Some((path, why))
}

/// Holds meetings in order, until all were held or the remaining robots wait for each other.
fn hold(cell: &Cell) -> Option<(Path, String)> {
    let mut programs: Vec<_> = cell.robot.iter().map(|it| it.meetings().peekable()).collect();
    let comers = |name: &str| {
        let comes = cell.robot.iter().enumerate().filter(move |(_, robot)| robot.meetings().any(|it| it.1 == name));
        comes.map(|(number, _)| number).collect::<Vec<_>>()
    };
    loop {
        let waiting: Vec<_> = programs.iter_mut().map(|it| it.peek().copied()).collect();
        let at = |robot: usize| waiting[robot].map(|(_, name)| name);
        let mut names = waiting.iter().flatten().map(|(_, name)| *name);
        let is_at = |name, robot: &usize| at(*robot) == Some(name);
        if let Some(name) = names.find(|name| comers(name).iter().all(|it| is_at(name, it))) {
            for robot in comers(name) {
                programs[robot].next();
            }
            continue;
        }
        let (robot, (index, name)) = waiting.iter().enumerate().find_map(|(robot, it)| Some((robot, (*it)?)))?;
        let other = comers(name).into_iter().find(|it| !is_at(name, it))?;
        let why = format!(
            "meeting {name:?} is never held: robot {:?} waits for robot {:?} there, which waits at {:?}",
            cell.robot[robot].name,
            cell.robot[other].name,
            at(other).unwrap_or("no meeting"),
        );
        return Some((instruction_path(robot, index).then("meet"), why));
    }
}
