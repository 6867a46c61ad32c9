//! The subcontrollers C1 to Cn of one cell, and the meetings between them.

use super::partners::Barrier;
use super::{Ecp, Planner, Status, StepRecords, step_log};
use crate::coordination::CoordinatorJournal;

/// The effector control processes of one cell, one per robot, and the meetings between them.
pub struct Subcontrollers {
    ecps: Vec<Ecp>,
    meetings: Meetings,
    /// Journal of the coordinators.
    journal: CoordinatorJournal,
}

impl Subcontrollers {
    /// The processes, in the order of the cell's robots.
    pub fn new(ecps: Vec<Ecp>, meetings: Meetings) -> Self {
        Self { ecps, meetings, journal: CoordinatorJournal::default() }
    }

    /// Gives each process a planner of its own.
    pub fn plan_with(&mut self, mut planner: impl FnMut() -> Box<dyn Planner>) {
        self.ecps.iter_mut().for_each(|ecp| ecp.plan_with(planner()));
    }

    /// Keeps a journal of the steps of each process, and last a journal of the steps of all coordinators. Each journal has
    /// room for `size` events that wait for their reader.
    pub fn keep_steps(&mut self, size: usize) -> Vec<StepRecords> {
        let journal = |ecp: &mut Ecp| {
            let (log, records) = step_log(size);
            ecp.keep_steps(log);
            records
        };
        let mut all: Vec<_> = self.ecps.iter_mut().map(journal).collect();
        let (log, records) = step_log(size);
        self.journal.log = Some(log);
        all.push(records);
        all
    }

    /// The processes, the meetings between them, and the journal of the coordinators.
    pub(crate) fn parts(&mut self) -> (&mut [Ecp], &mut Meetings, &mut CoordinatorJournal) {
        (&mut self.ecps, &mut self.meetings, &mut self.journal)
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

/// The meetings of a cell's effector control processes. The same partners may hold a meeting any number of times.
///
/// All partners continue in the same servo cycle. When all have come to a barrier, they are admitted: each plans its
/// next motion and sends its barrier and the first macrosteps at once ([`Order::Meet`](servo::Order::Meet) or
/// [`Order::Tie`](servo::Order::Tie)). The servo lets all pass together. A preemption of the calling thread in between
/// does not change the result.
#[derive(Debug)]
pub struct Meetings {
    /// Bit set of the partners of each meeting.
    partners: Vec<u32>,
}

impl Meetings {
    /// The meetings, each a list of partners by the indices of their processes, below 32.
    pub fn new(partners: impl IntoIterator<Item = Vec<usize>>) -> Self {
        let bits = |partners: Vec<usize>| partners.into_iter().fold(0, |all, index| all | bit(index));
        Self { partners: partners.into_iter().map(bits).collect() }
    }

    /// Admits the processes whose partners are all at the same barrier. The processes were polled until they returned
    /// no more events.
    pub(crate) fn poll(&self, ecps: &mut [Ecp]) {
        for index in 0..ecps.len() {
            let Some(barrier) = ecps[index].barrier() else {
                continue;
            };
            let members = match barrier {
                Barrier::Meeting(meeting) => self.partners.get(usize::from(meeting)).copied().unwrap_or_default(),
                Barrier::Team(members) => members,
            };
            // The servo refuses a barrier without its effector.
            let partners = if members & bit(index) == 0 { bit(index) } else { members };
            let is_partner = |index: usize| partners & bit(index) != 0;
            if ecps.iter().enumerate().all(|(index, ecp)| !is_partner(index) || ecp.barrier() == Some(barrier)) {
                let partners = ecps.iter_mut().enumerate().filter(|(index, _)| is_partner(*index));
                partners.for_each(|(_, ecp)| ecp.admit(members));
            }
        }
    }
}

fn bit(index: usize) -> u32 {
    1u32.checked_shl(index as u32).unwrap_or(0)
}
