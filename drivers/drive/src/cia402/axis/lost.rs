//! A drive that left the state operational or is silent, its recovery, and service requests to the drive.

use can::Instant;
use canopen::cia402::{ModeOfOperation, PowerState, Statusword};
use canopen::nmt;
use canopen::sdo::AbortCode;

use super::{CanAxis, Goal, Service};
use crate::{BringUpError, Fault};

impl CanAxis {
    /// Clears the fault, unless the drive itself is in its fault state or is not configured: only a recovery clears the
    /// fault of such a drive. A cause that persists is latched again at the next reading.
    pub(super) fn reset(&mut self) {
        let faulted = matches!(self.statusword.power_state(), PowerState::Fault | PowerState::FaultReactionActive);
        if !faulted && !self.booted {
            self.state.fault = None;
            self.error_code = 0;
            self.unserved = false;
        }
    }

    /// Demands a recovery if only a recovery helps: once in a reset, whose first cycle is `first`. A drive may show only later
    /// that it left the state operational.
    pub(super) fn demand_recovery(&mut self, first: bool, now: Instant) {
        if !self.recovery_tried && (first && self.is_lost(now) || self.is_pre_operational()) {
            (self.recovery_due, self.recovery_tried) = (true, true);
        }
    }

    /// Whether only a new bring-up helps: the drive booted, left the state operational, or is silent and may have done so
    /// unheard.
    fn is_lost(&self, now: Instant) -> bool {
        let silent = self.state.age > self.group.tolerated_missing;
        let unheard = self.heartbeat.is_some_and(|heard| now.since(heard) > self.group.heartbeat_lost_after());
        self.booted || !self.is_operational() || silent && unheard
    }

    /// Whether the node may still have the configuration of bring-up: it shows pre-operational, as after the loss of the
    /// host's heartbeat, and no boot was heard.
    pub(in super::super) fn may_be_configured(&self) -> bool {
        self.is_pre_operational()
    }

    /// Notes that the node has another configuration. The recovery begins anew, with a reset of the communication.
    pub(in super::super) fn begin_anew(&mut self) {
        (self.booted, self.recovery_due) = (true, true);
    }

    pub(super) fn is_operational(&self) -> bool {
        self.node_state == nmt::NmtState::Operational
    }

    fn is_pre_operational(&self) -> bool {
        self.node_state == nmt::NmtState::PreOperational && !self.booted
    }

    /// Begins a recovery, if one is due. The reference is lost, unless the drive reports one at its end.
    pub(in super::super) fn begin_recovery(&mut self) -> bool {
        let due = std::mem::take(&mut self.recovery_due);
        if due {
            self.state.recovering = true;
            self.search.forget();
            self.latch(Fault::LeftOperational { node: self.config.node.raw() });
        }
        due
    }

    /// Ends a recovery that failed.
    pub(in super::super) fn end_recovery(&mut self, error: Option<BringUpError>) {
        let node = self.config.node.raw();
        self.end_recovery_by(match error {
            Some(error) => Fault::NotBack { error },
            None => Fault::LeftOperational { node },
        });
    }

    /// Ends a recovery by a fault.
    pub(in super::super) fn end_recovery_by(&mut self, fault: Fault) {
        self.state.recovering = false;
        self.state.fault = Some(fault);
        // The node is not configured.
        self.booted = true;
    }

    /// Whether the last SYNC was answered.
    pub(in super::super) fn is_answered(&self) -> bool {
        self.answered
    }

    /// The next service request to the drive, for an idle SDO client.
    pub(in super::super) fn next_service(&mut self) -> Option<Service> {
        if self.booted || self.unserved {
            return None;
        }
        if !self.is_operational() {
            return self.switching_off();
        }
        if self.state.fault == Some(self.drive_fault(0)) {
            return Some(Service::ErrorCode);
        }
        // A drive in a mode that the group did not command stays in it while the quick stop brakes.
        if matches!(self.state.fault, Some(Fault::ModeChanged { .. })) {
            return None;
        }
        let request = self.modes.next(self.wanted_mode())?;
        let tells = matches!(request, Service::Tell(_));
        let braking = self.goal == Goal::Stopped
            && matches!(self.statusword.power_state(), PowerState::OperationEnabled | PowerState::QuickStopActive);
        // CiA 402 leaves open what a change of mode does to a drive that brakes.
        if braking && tells {
            return None;
        }
        self.telling = tells;
        Some(request)
    }

    /// The next request that removes the torque of a drive in pre-operational, which hears no controlword by RPDO: a drive
    /// that lost the heartbeat of the host brakes and holds there (objects 0x1029:1, 0x6007, 0x605A). The request is
    /// repeated until the drive shows that it has no torque, as RPDOs are.
    fn switching_off(&self) -> Option<Service> {
        let torque = matches!(
            self.statusword.power_state(),
            PowerState::OperationEnabled | PowerState::QuickStopActive | PowerState::FaultReactionActive
        );
        let off = matches!(self.goal, Goal::Off | Goal::ResetFault);
        let request = if self.switched_off { Service::Statusword } else { Service::SwitchOff };
        (off && torque && self.is_pre_operational()).then_some(request)
    }

    /// Takes the answer to a service request: the value of the object, or the abort code.
    pub(in super::super) fn served(&mut self, service: Service, result: Result<u32, u32>) {
        match (service, result) {
            (Service::Tell(mode), Ok(_)) => self.modes.taken(mode),
            (Service::Look, Ok(value)) => {
                self.modes.seen(ModeOfOperation::from_raw(value as i8));
            }
            (Service::ErrorCode, Ok(code @ 1..)) => self.name_fault(code as u16),
            // The drive has a fault but reports no error code.
            (Service::ErrorCode, Ok(0)) => self.unserved = true,
            (Service::SwitchOff, Ok(_)) => self.switched_off = true,
            (Service::Statusword, Ok(value)) => {
                self.statusword = Statusword(value as u16);
                self.switched_off = false;
            }
            // The frames of the host may still wait in a buffer.
            (_, Err(code)) if AbortCode(code) == AbortCode::TIME_OUT && !self.is_operational() => {
                self.switched_off = false;
            }
            (_, Err(code)) => {
                self.unserved = true;
                self.latch(Fault::Aborted { node: self.config.node.raw(), object: service.object(), code });
            }
        }
        self.telling = false;
    }
}
