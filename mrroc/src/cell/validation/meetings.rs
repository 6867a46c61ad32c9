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
        let (robot, found) = (
            meetings[usize::from(Gates::COUNT)].robots[0],
            meetings.len(),
        );
        let most = Gates::COUNT;
        let why = format!("is one of {found} meetings of the cell, which may have {most}");
        let (index, _) = cell.robot[robot].meetings().next().unwrap_or_default();
        return Err((instruction_path(robot, index).then("meet"), why));
    }
    if let Some(lonely) = meetings
        .iter()
        .find_map(|meeting| lonely(cell, &meetings, meeting))
    {
        return Err(lonely);
    }
    hold(cell).map_or(Ok(()), Err)
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
        let why = format!("no robot but {:?} comes to meeting {name:?}", called(robot));
        return Some((path, why));
    }
    let other = *first
        .robots
        .iter()
        .find(|it| !meeting.robots.contains(it))?;
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
    let mut programs: Vec<_> = cell
        .robot
        .iter()
        .map(|it| it.meetings().peekable())
        .collect();
    let comers = |name: &str| {
        let robots = cell.robot.iter().enumerate();
        let comes = robots.filter(move |(_, robot)| robot.meetings().any(|it| it.1 == name));
        comes.map(|(number, _)| number).collect::<Vec<_>>()
    };
    loop {
        let waiting: Vec<_> = programs.iter_mut().map(|it| it.peek().copied()).collect();
        let at = |robot: usize| waiting[robot].map(|(_, name)| name);
        let names = waiting.iter().flatten().map(|(_, name)| *name);
        let mut complete = names.filter(|name| {
            comers(name)
                .into_iter()
                .all(|robot| at(robot) == Some(name))
        });
        if let Some(name) = complete.next() {
            for robot in comers(name) {
                programs[robot].next();
            }
            continue;
        }
        let (robot, (index, name)) = waiting
            .iter()
            .enumerate()
            .find_map(|(robot, it)| Some((robot, (*it)?)))?;
        let other = comers(name)
            .into_iter()
            .find(|&other| at(other) != Some(name))?;
        let why = format!(
            "meeting {name:?} is never held: robot {:?} waits for robot {:?} there, which waits at {:?}",
            cell.robot[robot].name,
            cell.robot[other].name,
            at(other).unwrap_or("no meeting"),
        );
        return Some((instruction_path(robot, index).then("meet"), why));
    }
}
