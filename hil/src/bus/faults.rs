//! Faults of a virtual bus: of frames on the wire, and of the controller of the host.

#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use can::{Frame, Instant, Received, StandardId};
use canopen::cob;

use super::End;
use crate::plant::Noise;

/// A fault of single frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameFault {
    /// The frame is acknowledged, and no node receives it: a receive buffer overran.
    Lost,
    /// All nodes receive the frame later by this time. The bus is free meanwhile.
    Late(Duration),
    /// All nodes receive the frame twice, the second time one frame duration later.
    Duplicated,
    /// A node finds a CRC error and sends an error frame. The controller of the sender transmits the frame again
    /// (ISO 11898-1, automatic retransmission).
    Corrupted,
    /// All nodes receive the frame after the next frame that the fault concerns.
    Swapped,
}

/// Frames that a fault concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frames {
    /// All frames of the bus.
    All,
    /// Frames with this COB-ID.
    Id(StandardId),
    /// Frames that a node sends, by the predefined connection set (CiA 301 §7.3.5): TPDOs, SDO answers, EMCY and heartbeat.
    FromNode(u8),
    /// Frames that the host sends.
    FromHost,
}

/// A fault of the CAN controller of the host, or of its interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostFault {
    /// The controller has left the bus. It neither sends nor receives until the end of the fault, when it restarts.
    BusOff,
    /// The controller reports that it is error passive, and works.
    ErrorPassive,
    /// The interface is down.
    Down,
    /// The transmit queue is full.
    QueueFull,
    /// The plug of the host is out: no node acknowledges the frames of the host, whose controller repeats the first
    /// frame for ever. The host receives nothing. The other nodes hear each other.
    Unacknowledged,
    /// The adapter of the host accepts and acknowledges every frame of the host, and sends none until the end of the fault.
    /// Then it sends all of them in order, as fast as the bus takes them. The host receives meanwhile.
    Held,
    /// The interface is removed for ever, for example a USB adapter. The fault has no end.
    Removed,
}

/// One fault of frames in effect.
#[derive(Clone, Debug)]
pub(super) struct FrameFaultInEffect {
    pub(super) number: u64,
    pub(super) frames: Frames,
    pub(super) fault: FrameFault,
    pub(super) probability: f64,
    /// Frames still to damage.
    pub(super) left: Option<u32>,
    /// Whether the fault has damaged a frame.
    pub(super) damaged: bool,
    pub(super) noise: Noise,
}

impl FrameFaultInEffect {
    /// Whether the fault damages this frame. Uses one frame of the count.
    fn strikes(&mut self, frame: &Frame, sender: End) -> bool {
        let Some(id) = frame.standard_data_id() else {
            return false;
        };
        let raw = id.raw();
        let concerned = match self.frames {
            Frames::All => true,
            Frames::Id(wanted) => id == wanted,
            Frames::FromNode(node) => {
                raw & 0x7F == u16::from(node)
                    && raw > cob::SYNC.raw()
                    && matches!(sender, End::Device(_) | End::Foreign(_))
            }
            Frames::FromHost => matches!(sender, End::Host(_)),
        };
        let strikes = concerned
            && self.left != Some(0)
            && (self.probability >= 1.0 || 0.5 * (self.noise.symmetric() + 1.0) < self.probability);
        if let Some(left) = self.left.as_mut().filter(|_| strikes) {
            *left -= 1;
        }
        self.damaged |= strikes;
        strikes
    }
}

/// A frame that is delivered later.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldFrame {
    /// Time of the delivery; `None`: after the next frame of the fault.
    pub(super) due: Option<Instant>,
    pub(super) received: Received,
    pub(super) sender: End,
    pub(super) fault: u64,
}

/// A frame of a node that is not part of the cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foreign {
    pub(super) number: u64,
    pub(super) next: Received,
    /// Time between two frames; `None` for a single frame.
    pub(super) every: Option<Duration>,
}

/// The faults of a bus.
#[derive(Debug, Default)]
pub(super) struct BusFaults {
    pub(super) frames: Vec<FrameFaultInEffect>,
    pub(super) held: Vec<HeldFrame>,
    /// Frames of nodes that are not part of the cell.
    pub(super) foreign: Vec<Foreign>,
    /// The controller of the first host is cut off the bus.
    pub(super) cut_off: bool,
    /// The adapter of the first host holds its frames.
    pub(super) holds: bool,
    /// Frames in the adapter of the first host, which holds them or has not sent all of them yet.
    pub(super) adapter: VecDeque<Received>,
    numbers: u64,
}

impl BusFaults {
    pub(super) fn add(
        &mut self,
        frames: Frames,
        fault: FrameFault,
        probability: f64,
        count: Option<u32>,
        seed: u64,
    ) -> u64 {
        self.numbers += 1;
        let noise = Noise::new(seed);
        let number = self.numbers;
        self.frames.push(FrameFaultInEffect { number, frames, fault, probability, left: count, damaged: false, noise });
        number
    }

    pub(super) fn add_foreign(&mut self, frame: Frame, at: Instant, every: Option<Duration>) -> u64 {
        self.numbers += 1;
        let number = self.numbers;
        self.foreign.push(Foreign { number, next: Received { frame, at }, every });
        number
    }

    /// Takes the sent frame of a foreign node from its queue.
    pub(super) fn sent_foreign(&mut self, at: usize, now: Instant) {
        match self.foreign[at].every {
            Some(every) => self.foreign[at].next.at = now.max(self.foreign[at].next.at + every),
            None => _ = self.foreign.remove(at),
        }
    }

    /// Ends a fault of frames. Held frames without a time are due now.
    pub(super) fn remove(&mut self, number: u64, now: Instant) {
        self.frames.retain(|fault| fault.number != number);
        self.foreign.retain(|foreign| foreign.number != number);
        for held in self.held.iter_mut().filter(|held| held.fault == number) {
            held.due.get_or_insert(now);
        }
    }

    /// Whether fault `number` of frames has damaged a frame.
    pub(super) fn has_damaged(&self, number: u64) -> bool {
        self.frames.iter().any(|fault| fault.number == number && fault.damaged)
    }

    /// The fault that damages this frame, and its number.
    pub(super) fn strike(&mut self, frame: &Frame, sender: End) -> Option<(FrameFault, u64)> {
        self.frames.iter_mut().find_map(|fault| {
            let strikes = fault.strikes(frame, sender);
            strikes.then_some((fault.fault, fault.number))
        })
    }

    /// Time of the next delivery of a held frame.
    pub(super) fn next_held(&self) -> Option<Instant> {
        self.held.iter().filter_map(|held| held.due).min()
    }

    /// Takes a held frame that is due.
    pub(super) fn take_held(&mut self, now: Instant) -> Option<HeldFrame> {
        let at = self.held.iter().position(|held| held.due.is_some_and(|due| due <= now))?;
        Some(self.held.remove(at))
    }

    /// Makes the frame due that waited for the next frame of fault `number`.
    pub(super) fn release(&mut self, number: u64, now: Instant) {
        if let Some(held) = self.held.iter_mut().find(|held| held.fault == number && held.due.is_none()) {
            held.due = Some(now);
        }
    }

    /// Whether a frame waits for the next frame of fault `number`.
    pub(super) fn waits(&self, number: u64) -> bool {
        self.held.iter().any(|held| held.fault == number && held.due.is_none())
    }
}

/// Bits of an error frame and the intermission: six bits of the first flag, six of the echoed flags, the delimiter of
/// eight, three of intermission.
pub(super) const ERROR_FRAME: u32 = 6 + 6 + 8 + 3;

/// What the kernel reports about the controller of the host (Linux, `include/uapi/linux/can/error.h`).
pub(super) mod report {
    use can::Frame;

    const BUS_ERROR: u32 = 0x088;
    const NO_ACKNOWLEDGE: u32 = 0x020;
    const CONTROLLER: u32 = 0x004;
    const BUS_OFF: u32 = 0x040;
    const RESTARTED: u32 = 0x100;
    const PASSIVE: u8 = 0x20;
    const ACTIVE: u8 = 0x40;

    fn error(classes: u32, flags: u8) -> Frame {
        Frame::from_raw(0x2000_0000 | classes, 8, [0, flags, 0, 0, 0, 0, 0, 0]).expect("an error frame of eight bytes")
    }

    pub(in super::super) fn bus_error() -> Frame {
        error(BUS_ERROR, 0)
    }
    pub(in super::super) fn bus_off() -> Frame {
        error(BUS_OFF, 0)
    }
    pub(in super::super) fn restarted() -> Frame {
        error(RESTARTED, 0)
    }
    pub(in super::super) fn passive() -> Frame {
        error(CONTROLLER, PASSIVE)
    }
    pub(in super::super) fn unacknowledged() -> Frame {
        error(CONTROLLER | NO_ACKNOWLEDGE, PASSIVE)
    }
    pub(in super::super) fn active() -> Frame {
        error(CONTROLLER, ACTIVE)
    }
}
