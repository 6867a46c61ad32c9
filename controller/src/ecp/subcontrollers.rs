//! The subcontrollers C1 to Cn of one cell, polled in a fixed order.

use can::Instant;

use super::{Ecp, EcpEvent, Meetings, Status};

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

    /// Polls the processes at `now`, robot by robot, then holds the meetings whose partners have come.
    ///
    /// `ended` receives each ended instruction, with the index of its robot and the process. Returns whether any
    /// process still has an instruction. Call this function at macrostep rate or faster.
    pub fn poll(&mut self, now: Instant, mut ended: impl FnMut(usize, &mut Ecp, EcpEvent)) -> bool {
        for (robot, ecp) in self.ecps.iter_mut().enumerate() {
            while let Some(event) = ecp.poll(now) {
                ended(robot, ecp, event);
            }
        }
        self.meetings.poll(&mut self.ecps);
        self.statuses().any(|status| status.instruction.is_some())
    }

    /// Status of each process, robot by robot.
    pub fn statuses(&self) -> impl Iterator<Item = Status> {
        self.ecps.iter().map(Ecp::status)
    }
}
