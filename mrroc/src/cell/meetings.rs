//! The meetings in the programs of a cell.

use super::{Cell, Instruction, Robot};

/// One meeting: the first, second, … occurrence of its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Meeting {
    /// Its name.
    pub name: String,
    /// Number of earlier meetings of this name.
    pub occurrence: usize,
    /// Indices of the robots whose programs name the meeting so many times.
    pub robots: Vec<usize>,
}

impl Cell {
    /// The meetings of all programs. The order only numbers the meetings and is not an order in time.
    pub fn meetings(&self) -> Vec<Meeting> {
        let mut meetings: Vec<Meeting> = Vec::new();
        for (number, robot) in self.robot.iter().enumerate() {
            let mut names: Vec<&str> = Vec::new();
            for (_, name) in robot.meetings() {
                let occurrence = names.iter().filter(|before| **before == name).count();
                names.push(name);
                match meetings.iter_mut().find(|it| it.name == name && it.occurrence == occurrence) {
                    Some(meeting) => meeting.robots.push(number),
                    None => meetings.push(Meeting { name: name.to_owned(), occurrence, robots: vec![number] }),
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

    /// The index in `meetings` of the meeting at instruction `index` of this robot's program.
    pub(super) fn meeting_at(&self, index: usize, meetings: &[Meeting]) -> Option<u8> {
        let (_, name) = self.meetings().find(|(at, _)| *at == index)?;
        let occurrence = self.meetings().take_while(|(at, _)| *at < index).filter(|(_, other)| *other == name).count();
        u8::try_from(meetings.iter().position(|it| it.name == name && it.occurrence == occurrence)?).ok()
    }
}
