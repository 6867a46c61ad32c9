//! Meetings: robots that wait for one another and go on in the same servo cycle.

use servo::Gates;

use super::Ecp;

/// The meetings of a cell's effector control processes: each is held once, when all its partners have come.
///
/// All partners go on in the same servo cycle. Once they have come they are admitted; what each does next is queued
/// at its servo behind a gate; and when all have sent it, the gate opens for all of them at once. So it does not matter
/// how long the thread that calls here loses the processor in between.
#[derive(Debug)]
pub struct Meetings {
    meetings: Vec<Meeting>,
    gates: Gates,
}

#[derive(Debug)]
struct Meeting {
    /// Indices of their processes.
    partners: Vec<usize>,
    progress: Progress,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Gathering,
    Admitted,
    Held,
}

impl Meetings {
    /// Meetings of partners given by their place among the processes, at most [`Gates::COUNT`].
    pub fn new(partners: impl IntoIterator<Item = Vec<usize>>, gates: Gates) -> Self {
        let meeting = |partners| Meeting {
            partners,
            progress: Progress::Gathering,
        };
        Self {
            meetings: partners.into_iter().map(meeting).collect(),
            gates,
        }
    }

    /// Holds the meetings whose time has come. Call it after every process was polled until it had no more to tell.
    pub fn poll(&mut self, ecps: &mut [Ecp]) {
        for (meeting, number) in self.meetings.iter_mut().zip(0..) {
            let mut partners = meeting.partners.iter();
            match meeting.progress {
                Progress::Gathering if partners.all(|&at| ecps[at].meeting() == Some(number)) => {
                    for &at in &meeting.partners {
                        ecps[at].admit();
                    }
                    meeting.progress = Progress::Admitted;
                }
                Progress::Admitted if partners.all(|&at| ecps[at].has_left(number)) => {
                    self.gates.open(number);
                    meeting.progress = Progress::Held;
                }
                Progress::Gathering | Progress::Admitted | Progress::Held => {}
            }
        }
    }
}
