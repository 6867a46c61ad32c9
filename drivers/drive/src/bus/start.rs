//! Bring-up of all nodes of a bus: listening, reset, configuration, start, and the latency of the drives.

use can::{Frame, Instant, Port, Received};
use canopen::heartbeat::Heartbeat;
use canopen::pdo::PdoNumber;
use canopen::{NodeId, cob, nmt};

use super::routes::Place;
use super::{CanBus, Member, SDO_FRAMES_PER_CALL, Sign, Stage};
use crate::BringUpError;
use crate::cia401::IoNode;
use crate::cia402;
use crate::wrench::WrenchNode;

impl<P: Port> CanBus<P> {
    fn order(&mut self, command: nmt::Command) {
        let frames = self.members.iter().map(|member| command.to(member.bring_up.node()).encode());
        self.batch.extend(frames);
    }

    /// Ends the listening and discards all earlier requests to the nodes.
    fn begin(&mut self, now: Instant) {
        self.stage = Stage::Configuring;
        self.batch.clear();
        self.service = None;
        self.drives.forget_services();
        for member in &mut self.members {
            member.bring_up.reset(now);
            member.sdo = member.bring_up.client();
        }
        self.order(nmt::Command::ResetCommunication);
    }

    /// Takes one frame during bring-up.
    fn take_in_bring_up(&mut self, received: Received, now: Instant) {
        let Received { frame, at } = received;
        if matches!(self.stage, Stage::Starting { .. }) && self.take_sample(&received).is_some() {
            return;
        }
        match frame.standard_data_id().and_then(cob::Function::of) {
            Some(cob::Function::Heartbeat(node)) => {
                if let Some(heartbeat) = Heartbeat::decode(&frame)
                    && let Some(member) = self.routes.member(node)
                {
                    let Member { bring_up, sdo } = &mut self.members[member];
                    bring_up.heard(heartbeat.state, sdo, now);
                    match self.routes.place(node) {
                        Some(Place::Io(io)) => self.io[io].heard(heartbeat.state, at),
                        Some(Place::Sensor(sensor)) => self.sensors[sensor].heard(heartbeat.state, at),
                        Some(Place::Drive(_)) | None => {}
                    }
                }
            }
            Some(cob::Function::SdoResponse(node)) => {
                if let Some(member) = self.routes.member(node) {
                    self.members[member].sdo.handle(&frame, now);
                }
            }
            Some(cob::Function::Tpdo(number, node)) => match (self.routes.place(node), number) {
                (Some(Place::Drive(drive)), PdoNumber::Two) => {
                    if let Some(mode) = cia402::mode_shown(frame.data()) {
                        self.members[drive].bring_up.shows(mode);
                    }
                }
                (Some(Place::Drive(drive)), PdoNumber::One) => self.lone.answered(drive, at),
                (Some(Place::Io(io)), PdoNumber::One) if matches!(self.stage, Stage::Starting { .. }) => {
                    // A frame of another length is ignored. Bring-up then ends with `BringUpError::NoInputs`.
                    _ = self.io[io].inputs(frame.data(), at);
                }
                _ => {}
            },
            _ => {}
        }
    }

    pub(super) fn advance_bring_up(&mut self, now: Instant) -> Result<bool, BringUpError> {
        if matches!(self.stage, Stage::Down | Stage::Up) {
            let until = now + self.config.listening();
            self.stage = Stage::Listening { until };
            self.port.bound_unsent(usize::MAX)?;
            self.io.iter_mut().for_each(IoNode::reset);
            self.sensors.iter_mut().for_each(WrenchNode::reset);
            self.lone.reset();
        }
        let count = self.port.receive(now, &mut self.received)?;
        let nodes = self.received[..count].iter().filter_map(|received| sender(&received.frame));
        self.counters.heard |= nodes.fold(0, |nodes, node| nodes | 1 << node.raw());
        let mut heard = self.received[..count].iter();
        let ours = |node| self.routes.place(node).is_some();
        if let Some(sign) = heard.find_map(|received| Sign::of_bring_up(&received.frame, self.config.host_node, ours)) {
            return Err(BringUpError::OtherController { sign });
        }
        if let Stage::Listening { until } = self.stage {
            if now < until {
                return Ok(false);
            }
            self.begin(now);
        }
        for i in 0..count {
            self.take_in_bring_up(self.received[i], now);
        }
        for member in &mut self.members {
            member.bring_up.advance(&mut member.sdo, now)?;
        }
        if self.stage == Stage::Configuring && self.members.iter().all(|member| member.bring_up.configured()) {
            self.stage = Stage::Starting { since: now };
            self.members.iter_mut().for_each(|member| member.bring_up.start(now));
            self.order(nmt::Command::Start);
        }
        if self.batch.is_empty() {
            while self.batch.len() < SDO_FRAMES_PER_CALL
                && let Some(service) = self.next_sdo_frame(now)
            {
                self.batch.push(service.frame);
            }
        }
        if !self.batch.is_empty() {
            let taken = self.port.send(now, &self.batch)?;
            self.batch.drain(..taken.min(self.batch.len()));
        }
        let Stage::Starting { since } = self.stage else {
            return Ok(false);
        };
        let mut ready = self.members.iter().all(|member| member.bring_up.operational());
        for io in &self.io {
            ready &= io.has_inputs(now.since(since))?;
        }
        let ready = ready && self.latencies_are_known(now)?;
        if ready {
            self.bound_frames_in_flight()?;
        }
        Ok(ready)
    }
}

/// The node that sent `frame`, by its identifier in the predefined connection set.
fn sender(frame: &Frame) -> Option<NodeId> {
    match cob::Function::of(frame.standard_data_id()?)? {
        cob::Function::Emcy(node)
        | cob::Function::Heartbeat(node)
        | cob::Function::SdoResponse(node)
        | cob::Function::Tpdo(_, node) => Some(node),
        cob::Function::Nmt
        | cob::Function::Sync
        | cob::Function::Time
        | cob::Function::Rpdo(..)
        | cob::Function::SdoRequest(_) => None,
    }
}
