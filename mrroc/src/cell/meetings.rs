//! The meetings in the programs of a cell.

use super::{Cell, Instruction, Robot};

/// A meeting, which its robots may hold any number of times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Meeting {
    /// Its name.
    pub name: String,
    /// Indices of the robots whose programs name the meeting.
    pub robots: Vec<usize>,
}

impl Cell {
    /// The meetings of all programs. The order only numbers the meetings and is not an order in time.
    pub fn meetings(&self) -> Vec<Meeting> {
        let mut meetings: Vec<Meeting> = Vec::new();
        for (number, robot) in self.robot.iter().enumerate() {
            for (_, name) in robot.meetings() {
                match meetings.iter_mut().find(|it| it.name == name) {
                    Some(meeting) if meeting.robots.contains(&number) => {}
                    Some(meeting) => meeting.robots.push(number),
                    None => meetings.push(Meeting { name: name.to_owned(), robots: vec![number] }),
                }
            }
        }
        meetings
    }
}

impl Robot {
    /// The meetings of the robot's program in order, each with the index of its instruction.
    pub(super) fn meetings(&self) -> impl Iterator<Item = (usize, &str)> {
        self.program.iter().enumerate().filter_map(|(index, instruction)| match instruction {
            Instruction::Meet(name) => Some((index, name.as_str())),
            Instruction::Joints(_) | Instruction::Line(_) => None,
        })
    }
}
