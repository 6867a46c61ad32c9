//! Checks that all meetings of a cell's programs can take place.

use super::Checked;
use crate::cell::{Cell, Meeting, Path, instruction_path};
use can::counted;

/// Greatest number of meetings of a cell, each counted once.
const MOST: usize = 256;

/// Robots with a common meeting must come to it equally often. The order of the meetings must not make robots wait for
/// each other forever.
pub(super) fn check(cell: &Cell) -> Checked {
    let meetings = cell.meetings();
    if let Some(Meeting { name, robots }) = meetings.get(MOST) {
        let robot = robots.first().copied().unwrap_or_default();
        let found = meetings.len();
        let (index, _) = cell.robot[robot].meetings().find(|(_, it)| it == name).unwrap_or_default();
        let why = format!("is one of {found} meetings of the cell, which may have {MOST}");
        return Err((instruction_path(robot, index).then("meet"), why));
    }
    meetings.iter().find_map(|it| lonely(cell, it)).or_else(|| hold(cell)).map_or(Ok(()), Err)
}

/// The error of a meeting with a single robot, or to which the robots do not come equally often.
fn lonely(cell: &Cell, Meeting { name, robots }: &Meeting) -> Option<(Path, String)> {
    let comes = |robot: usize| cell.robot[robot].meetings().filter(move |(_, it)| it == name);
    let times = |robot: usize| comes(robot).count();
    let called = |robot: usize| &cell.robot[robot].name;
    let path = |robot: usize, occurrence: usize| {
        let index = comes(robot).nth(occurrence)?.0;
        Some(instruction_path(robot, index).then("meet"))
    };
    if let [robot] = robots[..] {
        return Some((path(robot, 0)?, format!("no robot but {:?} comes to meeting {name:?}", called(robot))));
    }
    let other = robots.iter().copied().min_by_key(|robot| times(*robot))?;
    let least = times(other);
    let robot = robots.iter().copied().find(|robot| times(*robot) > least)?;
    let why = format!(
        "robot {:?} comes {} to meeting {name:?}, robot {:?} {}",
        called(robot),
        counted(times(robot), "time"),
        called(other),
        counted(least, "time"),
    );
    Some((path(robot, least)?, why))
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
