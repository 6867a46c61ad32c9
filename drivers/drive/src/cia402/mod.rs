//! CiA 402 drives on one CAN bus in the cyclic synchronous modes (CiA 402-2 §17 to §19), as the EPOS4 implements them.
//!
//! [`CanBus`](crate::bus::CanBus) brings the drives up and exchanges one RPDO and one TPDO with each drive per SYNC.
//! The group moves the drives through the power states and through homing, and monitors answers, heartbeats, EMCY and
//! statuswords. Bring-up also sets and reads back the reaction of a drive that loses the host: after three missing host
//! heartbeats, the drive brakes by its quick stop and holds.
//!
//! TPDO 2 reports a change of the mode of operation. A change that the group did not command is a fault. A drive
//! normally sends nothing on TPDO 2, so the monitoring costs no bus load.
//!
//! Before its first frame, the group listens ([`GroupConfig::listening`]). The group refuses the start if a frame can
//! only come from another controller. In operation, such a frame is a fault of every axis ([`Sign`](crate::bus::Sign)).
//!
//! # Commands
//! - [`Off`](AxisCommand::Off) removes the voltage, also from a moving axis. The servo brakes the axis first where
//!   necessary.
//! - [`Stand`](AxisCommand::Stand) in CSP holds the position of the first answer that showed torque, or the last
//!   set-point followed. In CSV and CST, the command means zero velocity or torque. A load may then move the axis, so
//!   the caller must send [`Follow`](AxisCommand::Follow) at once.
//! - [`Follow`](AxisCommand::Follow) is refused before [`Power::On`], with the wrong kind of set-point for the mode, or
//!   with a set-point beyond the range of the drive. [`Fault::Refused`] names the axis, and no axis of the group
//!   changes its target in this cycle. During a change of mode, [`AxisState::following`] is false. The set-point is
//!   then ignored, and the drive stands.
//! - [`Home`](AxisCommand::Home) changes to the mode HM by service requests, and starts the search of the drive. The
//!   whole group sends at most one service frame per cycle. Another command halts an unfinished search, and the drive
//!   returns to the cyclic mode with its present position as target.
//! - A quick stop brakes an axis with a latched fault, as long as the drive itself has no fault. Only `Off` and
//!   `ResetFault` end this state.
//! - [`ResetFault`](AxisCommand::ResetFault) brings up a drive that booted, left the state operational, or sends
//!   neither answers nor heartbeats. The steps of this recovery are reset of the communication, check of the identity,
//!   configuration with read-back, and start. The other nodes of the bus continue meanwhile. The reference is lost,
//!   unless the drive itself reports a reference. The change of the command to `ResetFault` begins one recovery.
//!   [`AxisState::recovering`] is true until the end of the recovery.
//!
//! No set-point is clamped, queued or sent twice.
//!
//! # Which objects are written
//!
//! [`AxisConfig::configuration`] is written first, and may not contain a [`reserved`] object. The reserved objects
//! belong to this driver. Last, before operation, the driver writes and reads back these objects:
//! - heartbeats (0x1016:01, 0x1017);
//! - reactions (0x1029:01, 0x6007, 0x605A, 0x6085), and the deadline of set-points (0x1400:05), if the drive has this
//!   object;
//! - interpolation period (0x60C2);
//! - following error window (0x6065);
//! - homing (0x6098, 0x6099, 0x609A, 0x607C and maxon's 0x30B0, 0x30B1);
//! - offsets (0x60B0 to 0x60B2);
//! - process data: RPDO 1, TPDO 1 and TPDO 2 are mapped, and TPDO 3 for a contact of the emergency stop. The other PDOs
//!   are switched off;
//! - mode of operation (0x6060).
//!
//! Not supported: profile modes, interpolated position (EPOS2), and several axes behind one node-ID. Read
//! [`DriveGroup`](crate::DriveGroup) first, then `axis` and `program`.

mod agreement;
mod answer_age;
mod axis;
mod config;
mod contact;
mod homing;
mod measurement;
mod process_data;
mod program;
mod recording;
mod recovery;
mod reserved;
mod search_evidence;
mod search_watch;
mod service;
mod status_warnings;
mod target;

#[cfg(test)]
pub(crate) mod tests;

use std::time::Duration;

use can::{Frame, Instant};
use canopen::emcy::Emergency;
use master::sdo::Client;

pub(crate) use agreement::Agreement;
pub use canopen::NodeId;
pub(crate) use config::check_settings;
pub use config::{
    AxisConfig, ConfigError, CyclicMode, GroupConfig, HomingConfig, Identity, Purpose, Quantity, Setting,
};
pub use process_data::pdo_setups;
pub(crate) use process_data::{SHOWN_APART, is_timer, mode_shown, request_len};
pub(crate) use program::program;
pub use recording::Recording;
pub use reserved::{Reserved, reserved, reserved_by_any};

#[cfg(doc)]
use crate::Power;
use crate::bus::{Member, Syncs, begin_transfer};
use crate::{AxisCommand, AxisState, EmergencyStop, Fault, Warning, Warnings};
use answer_age::{AnswerAge, Finding};
use axis::CanAxis;
use process_data::Answer;
use recovery::Recovery;
use service::Service;
use target::Target;

/// Delay of CiA 402 drives, cycles: [`DriveGroup::delay`](crate::DriveGroup::delay).
pub const DELAY: usize = 3;

/// The drives of one bus in operation. The owner of the bus passes received frames in and sends the frames of
/// [`write`](Self::write).
pub(crate) struct Cia402Group {
    drives: Vec<Drive>,
}

/// Conditions of the bus for the RPDOs of a cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    /// The drives have been sent a heartbeat, whose absence they would notice.
    pub(crate) watched: bool,
    /// RPDOs that lead a drive to torque, or keep its torque, are withheld.
    pub(crate) withholds: bool,
    /// The other RPDOs of a drive in a position mode are withheld.
    pub(crate) waits: bool,
    /// The SYNC of this cycle is left out, and all RPDOs are withheld.
    pub(crate) leaves_out: bool,
}

/// What the answers of a drive show, beyond their content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Oddity {
    /// All answers of this node come late by this number of periods.
    Late { node: u8, periods: u32, latency: Duration },
    /// This number of answers of the node came without a SYNC.
    Surplus { node: u8, answers: u32 },
}

/// One drive in operation. Service requests use the SDO client of its [`Member`].
struct Drive {
    axis: CanAxis,
    service: Option<Service>,
    recovery: Recovery,
    age: AnswerAge,
    /// Time from the last SYNC before an answer to the last answer.
    since_sync: Duration,
    setpoint: Option<Target>,
    /// The batch of this cycle has a frame for this drive.
    queued: bool,
    /// Fault at the end of the last cycle.
    fault: Option<Fault>,
}

impl Cia402Group {
    /// Drives that have not been brought up. States and commands come in the order of `axes`.
    pub(crate) fn new(config: &GroupConfig, axes: &[AxisConfig]) -> Self {
        let drive = |axis| Drive {
            axis: CanAxis::new(config, axis),
            service: None,
            recovery: Recovery::None,
            age: AnswerAge::default(),
            since_sync: Duration::ZERO,
            setpoint: None,
            queued: false,
            fault: None,
        };
        Self { drives: axes.iter().map(drive).collect() }
    }

    pub(crate) fn axes(&self) -> usize {
        self.drives.len()
    }

    /// Node-ID of a drive.
    pub(crate) fn node(&self, drive: usize) -> u8 {
        self.drives[drive].axis.node()
    }

    /// Longest latency that the loop of a drive permits.
    pub(crate) fn tolerated_latency(&self, drive: usize, config: &GroupConfig) -> Duration {
        config.tolerated_latency(self.drives[drive].axis.mode())
    }

    /// Discards the service requests under way, whose clients are replaced.
    pub(crate) fn forget_services(&mut self) {
        for drive in &mut self.drives {
            (drive.service, drive.recovery) = (None, Recovery::None);
        }
    }

    /// Starts operation after bring-up, which measured how many periods late the answers of each drive are.
    pub(crate) fn begin(&mut self, now: Instant, members: &[Member], lags: impl Iterator<Item = u32>) {
        for ((drive, member), lag) in self.drives.iter_mut().zip(members).zip(lags) {
            drive.axis.begin(now, member.bring_up.learnt);
            drive.age = AnswerAge::of(lag);
            drive.fault = None;
        }
    }

    /// Takes TPDO 1 of a drive. Returns the time from the last SYNC to this answer; zero for the answer to an earlier
    /// SYNC. `None` means an undecodable answer, or an answer without a SYNC.
    pub(crate) fn answered(&mut self, drive: usize, data: &[u8], at: Instant, syncs: &Syncs) -> Option<Duration> {
        let answer = Answer::decode(data)?;
        let Drive { age, axis, recovery, since_sync, .. } = &mut self.drives[drive];
        age.count(syncs.is_present(at));
        let recovers = *recovery != Recovery::None;
        let sampled = syncs.of_late_answer(at, age.lag())?;
        let received = syncs.of_answer(at)?;
        let fresh = Some(received) == syncs.last;
        *since_sync = at.since(received);
        if fresh {
            axis.in_time();
        }
        // A drive that is being configured may count from elsewhere.
        if !recovers {
            axis.answered(answer, sampled, at);
        }
        Some(if fresh { at.since(sampled) } else { Duration::ZERO })
    }

    /// Takes TPDO 2 of a drive. `None` means an undecodable frame.
    pub(crate) fn shows(&mut self, drive: usize, data: &[u8], member: &mut Member) -> Option<()> {
        let mode = mode_shown(data)?;
        let drive = &mut self.drives[drive];
        if drive.recovers() {
            member.bring_up.shows(mode);
        } else {
            drive.axis.shows(mode);
        }
        Some(())
    }

    /// Takes TPDO 3 of a drive. `None` means an undecodable or unexpected frame.
    pub(crate) fn inputs(&mut self, drive: usize, data: &[u8]) -> Option<()> {
        self.drives[drive].axis.inputs(data)
    }

    /// The contacts of the emergency stop that are open or not known.
    pub(crate) fn emergency_stops(&self) -> impl Iterator<Item = EmergencyStop> {
        self.drives.iter().filter_map(|drive| drive.axis.emergency_stop())
    }

    /// Discards the reference of a drive.
    pub(crate) fn doubt_reference(&mut self, drive: usize) {
        self.drives[drive].axis.doubt_reference();
    }

    /// Takes an EMCY. Returns whether the EMCY is a warning: an error of the bus alone, or of a drive that is not commanded to
    /// be on, or an error beside an earlier fault. An EMCY that explains a fault may arrive before the statusword that
    /// shows the fault, and is a warning until then.
    pub(crate) fn emergency(&mut self, drive: usize, emergency: &Emergency) -> bool {
        let axis = &mut self.drives[drive].axis;
        axis.emergency(emergency);
        !emergency.is_reset() && axis.fault() != Some(axis.drive_fault(emergency.code))
    }

    /// Takes the result of a service request, if `sdo` has one.
    pub(crate) fn finish_service(&mut self, drive: usize, sdo: &mut Client, now: Instant) {
        self.drives[drive].finish_service(sdo, now);
    }

    /// Latches that no SYNC was sent for so long that the drives braked by themselves.
    pub(crate) fn left_alone(&mut self, waited: Duration) {
        self.drives.iter_mut().for_each(|drive| drive.axis.left_alone(waited));
    }

    /// Ends the reading of a cycle. `due` is true if the last cycle had to send a SYNC. `after` is the time since the
    /// start of operation. Returns the number of missing answers.
    pub(crate) fn end_of_read(
        &mut self,
        now: Instant,
        due: bool,
        members: &mut [Member],
        (warnings, after): (&mut Warnings, Duration),
        states: &mut [AxisState],
    ) -> u64 {
        let mut missed = 0;
        for ((drive, member), state) in self.drives.iter_mut().zip(members).zip(states) {
            drive.finish_service(&mut member.sdo, now);
            let before = drive.fault;
            let (read, missing) = drive.axis.end_of_read(now, due);
            *state = AxisState { lag: drive.age.lag(), ..read };
            drive.fault = read.fault;
            let node = drive.axis.node();
            for cause in drive.axis.take_warnings() {
                warnings.add(Warning { after, node, cause, count: 1 });
            }
            if let Some(Fault::Drive { node, code }) = read.fault.filter(|_| read.fault != before) {
                warnings.explain(node, code);
            }
            missed += u64::from(missing);
        }
        missed
    }

    /// Takes the commands of a cycle and appends one RPDO of each drive to `batch`, except for RPDOs that are withheld.
    /// Returns the number of withheld RPDOs for torque.
    pub(crate) fn write(
        &mut self,
        now: Instant,
        commands: &[AxisCommand],
        Conditions { watched, withholds, waits, leaves_out }: Conditions,
        members: &mut [Member],
        batch: &mut Vec<Frame>,
    ) -> usize {
        let mut refused = false;
        for (drive, &command) in self.drives.iter_mut().zip(commands) {
            drive.setpoint = match drive.axis.check(command) {
                Ok(setpoint) => setpoint,
                Err(refusal) => {
                    refused = true;
                    drive.axis.refuse(refusal);
                    None
                }
            };
        }
        let mut withheld = 0;
        for ((drive, member), &command) in self.drives.iter_mut().zip(members).zip(commands) {
            let frame = drive.axis.command(command, drive.setpoint, refused, watched, now);
            let for_torque = drive.axis.is_for_torque();
            let held = if for_torque { withholds } else { waits && drive.axis.holds_position() };
            drive.queued = !(held || leaves_out);
            withheld += usize::from(for_torque && !drive.queued);
            batch.extend(drive.queued.then_some(frame));
            drive.start_service(&mut member.sdo, now);
        }
        withheld
    }

    /// Whether the batch of this cycle has a controlword that leads a drive to torque.
    pub(crate) fn sent_for_torque(&self) -> bool {
        self.drives.iter().any(|drive| drive.queued && drive.axis.is_for_torque())
    }

    /// Whether every drive has a fault, so that the group has no set-points. `false` without drives.
    pub(crate) fn are_stopped(&self) -> bool {
        !self.drives.is_empty() && self.drives.iter().all(|drive| drive.fault.is_some())
    }

    /// Whether the age of the answers of a drive is in doubt, and no command to a drive forbids to leave out a SYNC: no drive
    /// has a fault or is being brought up again, and none is to lose its torque.
    pub(crate) fn ask_for_proof(&self, commands: &[AxisCommand]) -> bool {
        let may_wait = |(drive, command): (&Drive, &AxisCommand)| {
            let ends = matches!(command, AxisCommand::Off | AxisCommand::ResetFault) && drive.axis.is_for_torque();
            drive.fault.is_none() && !drive.recovers() && !ends
        };
        self.drives.iter().any(|drive| drive.age.is_doubtful()) && self.drives.iter().zip(commands).all(may_wait)
    }

    /// Begins the period of a batch. `synced` says that the port took its SYNC, and `leaves_out` that the SYNC was left out. A
    /// lag that the loop or the tolerated number does not permit is a fault. `found` takes what the answers show.
    pub(crate) fn begin_period(
        &mut self,
        synced: bool,
        leaves_out: bool,
        config: &GroupConfig,
        mut found: impl FnMut(Oddity),
    ) {
        for drive in &mut self.drives {
            if drive.recovers() {
                drive.age = AnswerAge::unknown();
                continue;
            }
            let node = drive.axis.node();
            match drive.age.begin_period(synced, leaves_out, config.tolerated_missing.saturating_add(1)) {
                Some(Finding::Proven(periods @ 1..)) => {
                    let latency = drive.since_sync + periods * config.period;
                    found(Oddity::Late { node, periods, latency });
                    drive.axis.judge_lag(periods, latency);
                }
                Some(Finding::Surplus(answers)) => found(Oddity::Surplus { node, answers }),
                Some(Finding::Proven(0)) | None => {}
            }
        }
    }

    /// Notes how many frames of the batch the port took: `syncs` SYNCs, then `setpoints` set-points.
    pub(crate) fn handed_over(&mut self, taken: usize, syncs: usize, setpoints: usize) {
        let mut through = 0;
        for drive in &mut self.drives {
            through += usize::from(drive.queued);
            // A SYNC alone carries no set-point that could be lost.
            drive.axis.handed_over(taken >= syncs + setpoints.min(through));
        }
    }
}

impl Drive {
    fn start_service(&mut self, sdo: &mut Client, now: Instant) {
        if self.service.is_some() || self.recovers() {
            return;
        }
        let Some(service) = self.axis.next_service() else {
            return;
        };
        begin_transfer(sdo, service.object(), service.write(), now);
        self.service = Some(service);
    }

    fn finish_service(&mut self, sdo: &mut Client, now: Instant) {
        if self.recovers() {
            return;
        }
        sdo.handle_timeout(now);
        let Some(result) = sdo.poll() else {
            return;
        };
        let Some(service) = self.service.take() else {
            return;
        };
        let value = result.map(|transfer| canopen::number(transfer.data)).map_err(|error| error.cause.abort_code().0);
        self.axis.served(service, value);
    }
}
