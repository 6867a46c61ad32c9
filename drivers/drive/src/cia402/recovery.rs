//! Recovery of a drive that booted again, left the state operational or is silent. The recovery consists of the steps
//! of bring-up, with one service frame per cycle. The other nodes of the bus continue meanwhile.
//!
//! ```text
//!            reset of the fault             last step              heartbeat 0x05 and an answer to SYNC
//!   faulted ──────────────────► Configuring ─────────► Starting ───────────────────────────────────────► off
//!      ▲ │                         ▲ │ error             ▲ │ error, boot-up
//!      └◄│─────────────────────────│─┴───────────────────│─┘
//!        │ pre-operational         │ differs             │
//!        └─────────────────► Verifying ──────────────────┘
//!                                      last step
//! ```
//!
//! A drive in pre-operational may have lost only the heartbeat of the host. Its configuration is read back, without a reset
//! of the communication. The NMT start follows answers to requests that were sent behind all earlier frames of the host, so
//! a buffer that held these frames is empty.

use can::Instant;
use canopen::nmt::{Command, NmtState};

use super::{Cia402Group, Drive};
use crate::bus::Member;
use crate::{BringUpError, Fault};

/// Where the recovery of a drive is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Recovery {
    #[default]
    None,
    /// The configuration of the node is read back.
    Verifying,
    /// The node was sent a reset of its communication, and is configured.
    Configuring,
    /// The node was sent the NMT start at `since`.
    Starting { since: Instant },
}

impl Cia402Group {
    /// Advances the recoveries of all drives by one cycle, and begins those that a reset of the fault demands. With
    /// `may_send`, a command to one node can be sent in this cycle. Returns the index of the drive and the command.
    pub(crate) fn recover(
        &mut self,
        members: &mut [Member],
        now: Instant,
        mut may_send: bool,
    ) -> Option<(usize, Command)> {
        let mut sent = None;
        for (index, (drive, member)) in self.drives.iter_mut().zip(members).enumerate() {
            if let Some(command) = drive.recover(member, now, may_send) {
                sent = Some((index, command));
                may_send = false;
            }
        }
        sent
    }

    /// Whether a drive is being brought up again.
    pub(crate) fn recovers(&self, drive: usize) -> bool {
        self.drives[drive].recovers()
    }

    /// Latches a fault of the bus at every drive. The fault ends all recoveries.
    pub(crate) fn latch_all(&mut self, fault: Fault, members: &mut [Member]) {
        self.drives.iter_mut().zip(members).for_each(|(drive, member)| drive.latch_of_bus(fault, member));
    }

    /// Takes a heartbeat or boot-up message of a drive, received at `at`.
    pub(crate) fn heard(&mut self, drive: usize, state: NmtState, at: Instant, member: &mut Member, now: Instant) {
        let drive = &mut self.drives[drive];
        match (drive.recovery, state) {
            (Recovery::None, _) => drive.axis.heard(state, at),
            (Recovery::Starting { .. }, NmtState::Initialising) => drive.give_up(None, member),
            _ => member.bring_up.heard(state, &mut member.sdo, now),
        }
    }
}

impl Drive {
    pub(super) fn recovers(&self) -> bool {
        self.recovery != Recovery::None
    }

    fn recover(&mut self, member: &mut Member, now: Instant, may_send: bool) -> Option<Command> {
        if self.recovery == Recovery::None {
            if !may_send || !self.axis.begin_recovery() {
                return None;
            }
            member.sdo.reset();
            self.service = None;
            if self.axis.may_be_configured() {
                member.bring_up.verify(now);
                self.recovery = Recovery::Verifying;
                return None;
            }
            member.bring_up.reset(now);
            self.recovery = Recovery::Configuring;
            return Some(Command::ResetCommunication);
        }
        let Member { bring_up, sdo } = member;
        if let Err(error) = bring_up.advance(sdo, now) {
            if self.recovery == Recovery::Verifying && bring_up.verifies() {
                sdo.reset();
                self.recovery = Recovery::None;
                self.axis.begin_anew();
            } else {
                self.give_up(Some(error), member);
            }
            return None;
        }
        match self.recovery {
            Recovery::Verifying | Recovery::Configuring if bring_up.configured() && may_send => {
                bring_up.start(now);
                self.recovery = Recovery::Starting { since: now };
                return Some(Command::Start);
            }
            // The drive may act on controlwords from here. It is sent none that enables it before `begin`.
            Recovery::Starting { .. } if bring_up.operational() && self.axis.is_answered() => {
                self.recovery = Recovery::None;
                self.axis.begin(now, bring_up.learnt);
                // The answer that ended the recovery.
                self.axis.in_time();
                self.fault = None;
            }
            // The drive shows the state operational, and answers no SYNC.
            Recovery::Starting { since } if now.since(since) > bring_up.start_timeout() => {
                let (node, waited) = (bring_up.node().raw(), now.since(since));
                self.give_up(Some(BringUpError::NotOperational { node, waited }), member);
            }
            Recovery::None | Recovery::Verifying | Recovery::Configuring | Recovery::Starting { .. } => {}
        }
        None
    }

    /// Ends a recovery without success. The next reset of the fault begins anew.
    fn give_up(&mut self, error: Option<BringUpError>, member: &mut Member) {
        member.sdo.reset();
        self.recovery = Recovery::None;
        self.axis.end_recovery(error);
    }

    /// Latches a fault. A fault of the bus ends a recovery, and replaces the fault before.
    fn latch_of_bus(&mut self, fault: Fault, member: &mut Member) {
        if self.recovers() {
            member.sdo.reset();
            self.recovery = Recovery::None;
            self.axis.end_recovery_by(fault);
        }
        self.axis.latch(fault);
    }
}
