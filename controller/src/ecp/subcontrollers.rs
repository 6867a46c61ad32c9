//! The subcontrollers C1 to Cn of one cell, and the meetings between them.

use can::Instant;
use servo::Gates;

use super::{Ecp, Planner, Status};

/// The effector control processes of one cell, one per robot, and the meetings between them.
pub struct Subcontrollers {
    ecps: Vec<Ecp>,
    meetings: Meetings,
}

impl Subcontrollers {
    /// The processes, in the order of the cell's robots.
    pub fn new(ecps: Vec<Ecp>, meetings: Meetings) -> Self {
        Self { ecps, meetings }
    }

    /// Gives each process a planner of its own.
    pub fn plan_with(&mut self, mut planner: impl FnMut() -> Box<dyn Planner>) {
        self.ecps.iter_mut().for_each(|ecp| ecp.plan_with(planner()));
    }

    /// The processes, and the meetings between them.
    pub(crate) fn parts(&mut self) -> (&mut [Ecp], &mut Meetings) {
        (&mut self.ecps, &mut self.meetings)
    }

    /// The processes.
    pub(crate) fn ecps(&self) -> &[Ecp] {
        &self.ecps
    }

    /// Status of each process, robot by robot.
    pub fn statuses(&self) -> impl Iterator<Item = Status> {
        self.ecps.iter().map(Ecp::status)
    }
}

/// The meetings of a cell's effector control processes. Each meeting is held once, when all its partners have come.
///
/// All partners continue in the same servo cycle. When all have come, they are admitted. Each partner then sends a
/// gate, plans its next motion and sends its first orders to the servo. When all partners have sent these orders, the
/// gate opens for all at once.
/// A preemption of the calling thread in between does not change the result.
#[derive(Debug)]
pub struct Meetings {
    meetings: Vec<Meeting>,
    gates: Gates,
}

#[derive(Debug)]
struct Meeting {
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
    /// At most [`Gates::COUNT`] meetings, each a list of partners by the indices of their processes.
    pub fn new(partners: impl IntoIterator<Item = Vec<usize>>, gates: Gates) -> Self {
        let meeting = |partners| Meeting { partners, progress: Progress::Gathering };
        Self { meetings: partners.into_iter().map(meeting).collect(), gates }
    }

    /// Advances the meetings whose partners are ready. The processes were polled until they returned no more events.
    pub(crate) fn poll(&mut self, ecps: &mut [Ecp], now: Instant) {
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
                Progress::Admitted => meeting.partners.iter().for_each(|&at| ecps[at].wait_at_gate(now)),
                Progress::Gathering | Progress::Held => {}
            }
        }
    }
}
