//! A port without a card: the host holds one end, a bus model the other.
//!
//! Frames keep their order and carry times in both directions; nothing here waits, locks or
//! allocates after [`virtual_port`] returned. Bit times and arbitration are the bus model's work.
//! Read [`VirtualPort`] for what a driver sees, [`VirtualPeer`] for what a bus does with it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rtrb::{Consumer, Producer, RingBuffer};

use crate::error_frame::state_after;
use crate::timing::bits_on_wire;
use crate::{ControllerState, Counters, Frame, Instant, Port, PortError, Received};

/// Both ends of a virtual port, with room for `capacity` frames each way.
///
/// The capacity stands for the card's transmit queue one way and for the receive buffer the other.
pub fn virtual_port(capacity: usize) -> (VirtualPort, VirtualPeer) {
    let (to_bus, sent) = RingBuffer::new(capacity);
    let (to_host, received) = RingBuffer::new(capacity);
    let shared = Arc::new(Shared::default());
    let port = VirtualPort {
        to_bus,
        received,
        shared: Arc::clone(&shared),
        counters: Counters::default(),
        state: ControllerState::Active,
        most_unsent: usize::MAX,
    };
    let peer = VirtualPeer { sent, to_host, shared };
    (port, peer)
}

/// The host's end.
///
/// [`Port::send`] takes what fits and no more. [`Port::receive`] holds back frames later than `now`.
/// Once the bus's end was dropped, sending is [`PortError::Gone`], and so is receiving as soon as the
/// queue is empty.
pub struct VirtualPort {
    to_bus: Producer<Counted>,
    received: Consumer<Counted>,
    shared: Arc<Shared>,
    counters: Counters,
    state: ControllerState,
    /// Greatest number of frames in flight at which `send` accepts frames.
    most_unsent: usize,
}

/// State of the interface that both ends share.
#[derive(Debug, Default)]
struct Shared {
    dropped: AtomicU64,
    /// The interface is down.
    down: AtomicBool,
    /// The transmit queue takes nothing.
    full: AtomicBool,
    /// The port does not learn which frames wait for the bus.
    blind: AtomicBool,
}

/// A frame and its number of bits on the wire, which are counted once.
#[derive(Clone, Copy)]
struct Counted {
    received: Received,
    bits: u32,
}

impl Port for VirtualPort {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        if self.to_bus.is_abandoned() {
            self.counters.refused += frames.len() as u64;
            return Err(PortError::Gone);
        }
        if self.shared.down.load(Ordering::Relaxed) {
            self.counters.refused += frames.len() as u64;
            return Err(PortError::Down);
        }
        let unsent = self.to_bus.buffer().capacity() - self.to_bus.slots();
        let bounded = !self.shared.blind.load(Ordering::Relaxed);
        let full = self.shared.full.load(Ordering::Relaxed) || bounded && unsent > self.most_unsent;
        let mut taken = 0;
        for &frame in frames.iter().filter(|_| !full) {
            let bits = bits_on_wire(&frame);
            if self.to_bus.push(Counted { received: Received { frame, at: now }, bits }).is_err() {
                break;
            }
            taken += 1;
            self.counters.bits += u64::from(bits);
        }
        self.counters.sent += taken as u64;
        self.counters.refused += (frames.len() - taken) as u64;
        Ok(taken)
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        // Asked before the queue is read: what was delivered before the end was dropped still counts.
        let gone = self.received.is_abandoned();
        if self.shared.down.load(Ordering::Relaxed) {
            while self.received.pop().is_ok() {}
            return Err(PortError::Down);
        }
        let mut count = 0;
        while count < into.len() {
            let Ok(&Counted { received, bits }) = self.received.peek() else {
                if gone && count == 0 {
                    return Err(PortError::Gone);
                }
                break;
            };
            if received.at > now {
                break;
            }
            self.received.pop().expect("one was peeked");
            if let Some(state) = state_after(&received.frame, self.state) {
                self.counters.errors += 1;
                self.counters.count_state(self.state, state);
                self.state = state;
                continue;
            }
            into[count] = received;
            count += 1;
            self.counters.received += 1;
            self.counters.bits += u64::from(bits);
        }
        Ok(count)
    }

    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        self.most_unsent = most;
        Ok(())
    }

    fn counters(&self) -> Counters {
        Counters { dropped: self.shared.dropped.load(Ordering::Relaxed), ..self.counters }
    }

    fn state(&self) -> ControllerState {
        self.state
    }
}

/// The bus's end.
///
/// Frames are taken in the order of sending and delivered in the order of their times.
pub struct VirtualPeer {
    sent: Consumer<Counted>,
    to_host: Producer<Counted>,
    shared: Arc<Shared>,
}

impl VirtualPeer {
    /// The oldest frame of the host and the time of its transmission request. The frame stays in the queue, as in a
    /// card's mailbox, and takes part in arbitration until it is taken.
    pub fn peek_sent(&self) -> Option<&Received> {
        self.sent.peek().ok().map(|counted| &counted.received)
    }

    /// Number of bits on the wire of the oldest frame of the host; 0 without a frame.
    pub fn bits_of_sent(&self) -> u32 {
        self.sent.peek().map_or(0, |counted| counted.bits)
    }

    /// Takes the oldest frame the host sent, with the time at which it was handed over, and so makes
    /// room for another.
    pub fn take_sent(&mut self) -> Option<Received> {
        self.sent.pop().ok().map(|counted| counted.received)
    }

    /// Hands a frame to the host, who sees it once its clock reaches `received.at`. It took `bits` on the wire
    /// ([`bits_on_wire`]), which the host's counters take over.
    ///
    /// `false` if the host's queue is full: the frame is lost and shows in [`Counters::dropped`].
    /// Times must not decrease: a frame holds back those delivered after it. Error frames reach the
    /// host's counters and state, as from the kernel.
    pub fn deliver(&mut self, received: Received, bits: u32) -> bool {
        let delivered = self.to_host.push(Counted { received, bits }).is_ok();
        if !delivered {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
        delivered
    }

    /// Takes the interface down, or brings it up. While the interface is down, both calls of the host fail with
    /// [`PortError::Down`]. The frames in both queues are lost, as in the kernel.
    pub fn set_down(&mut self, down: bool) {
        self.shared.down.store(down, Ordering::Relaxed);
        if down {
            while self.sent.pop().is_ok() {}
        }
    }

    /// Fills the transmit queue of the host, or empties it: a full queue takes no frame.
    pub fn set_full(&mut self, full: bool) {
        self.shared.full.store(full, Ordering::Relaxed);
    }

    /// Lets the port ignore the bound of [`Port::bound_unsent`], or observe it again: a port on an adapter does not learn
    /// which frames wait for the bus.
    pub fn set_blind(&mut self, blind: bool) {
        self.shared.blind.store(blind, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StandardId;

    fn frame(id: u16) -> Frame {
        Frame::new(StandardId::new(id).unwrap(), &[]).unwrap()
    }

    fn at(nanos: u64) -> Instant {
        Instant::from_nanos(nanos)
    }

    fn received(id: u16, nanos: u64) -> Received {
        Received { frame: frame(id), at: at(nanos) }
    }

    fn receive(port: &mut VirtualPort, now: u64) -> Result<Vec<Received>, PortError> {
        let mut into = [received(0, 0); 4];
        port.receive(at(now), &mut into).map(|count| into[..count].to_vec())
    }

    #[test]
    fn a_full_queue_takes_only_what_fits_and_counts_the_rest() {
        let (mut port, mut peer) = virtual_port(2);
        assert_eq!(port.send(at(7), &[frame(1), frame(2), frame(3)]), Ok(2));
        assert_eq!(port.send(at(8), &[frame(3)]), Ok(0));
        assert_eq!(peer.peek_sent(), Some(&received(1, 7)));
        assert_eq!(peer.take_sent(), Some(received(1, 7)));
        assert_eq!(port.send(at(9), &[frame(3)]), Ok(1));
        assert_eq!(peer.take_sent(), Some(received(2, 7)));
        assert_eq!(peer.take_sent(), Some(received(3, 9)));
        assert_eq!(peer.take_sent(), None);
        let expected = Counters {
            sent: 3,
            refused: 2,
            bits: [1, 2, 3].map(|id| u64::from(bits_on_wire(&frame(id)))).iter().sum(),
            ..Counters::default()
        };
        assert_eq!(port.counters(), expected);
    }

    #[test]
    fn a_frame_is_held_back_until_its_time() {
        let (mut port, mut peer) = virtual_port(4);
        let frames = [10, 10, 20].map(|nanos| received(1, nanos));
        assert!(frames.iter().all(|&received| peer.deliver(received, 50)));
        assert_eq!(receive(&mut port, 9).unwrap(), []);
        assert_eq!(receive(&mut port, 10).unwrap(), frames[..2]);
        assert_eq!(receive(&mut port, 19).unwrap(), []);
        assert_eq!(receive(&mut port, 20).unwrap(), frames[2..]);
        assert_eq!((port.counters().received, port.counters().bits), (3, 150));
    }

    #[test]
    fn a_frame_for_a_full_host_is_dropped_and_counted() {
        let (mut port, mut peer) = virtual_port(1);
        assert!(peer.deliver(received(1, 1), 47));
        assert!(!peer.deliver(received(2, 2), 47));
        assert_eq!(receive(&mut port, 2).unwrap(), [received(1, 1)]);
        assert_eq!(port.counters().dropped, 1);
    }

    #[test]
    fn an_error_frame_shows_in_state_and_counters_alone() {
        let (mut port, mut peer) = virtual_port(2);
        let bus_off = Frame::from_raw(0x2000_0040, 8, [0; 8]).unwrap();
        for frame in [bus_off, frame(1)] {
            peer.deliver(Received { frame, at: at(5) }, 47);
        }
        assert_eq!(port.state(), ControllerState::Active);
        assert_eq!(receive(&mut port, 5).unwrap().len(), 1);
        assert_eq!(port.state(), ControllerState::BusOff);
        assert_eq!((port.counters().errors, port.counters().bus_off), (1, 1));
    }

    #[test]
    fn an_interface_that_is_down_loses_its_frames() {
        let (mut port, mut peer) = virtual_port(4);
        assert_eq!(port.send(at(1), &[frame(1)]), Ok(1));
        peer.deliver(received(2, 1), 47);
        peer.set_down(true);
        assert_eq!(port.send(at(2), &[frame(3)]), Err(PortError::Down));
        assert_eq!(receive(&mut port, 2), Err(PortError::Down));
        peer.set_down(false);
        assert_eq!((peer.take_sent(), receive(&mut port, 3).unwrap()), (None, vec![]));
        peer.set_full(true);
        assert_eq!(port.send(at(3), &[frame(4)]), Ok(0));
        peer.set_full(false);
        assert_eq!(port.send(at(4), &[frame(4)]), Ok(1));
        assert_eq!(port.counters().refused, 2);
    }

    #[test]
    fn a_bounded_port_takes_nothing_while_earlier_frames_wait_for_the_bus() {
        let (mut port, mut peer) = virtual_port(8);
        port.bound_unsent(1).unwrap();
        assert_eq!(port.send(at(1), &[frame(1), frame(2)]), Ok(2));
        assert_eq!(port.send(at(2), &[frame(3), frame(4)]), Ok(0));
        assert_eq!(port.counters().refused, 2);
        peer.take_sent();
        assert_eq!(port.send(at(3), &[frame(5), frame(6)]), Ok(2), "one frame may wait");
        assert_eq!(port.send(at(4), &[frame(7)]), Ok(0));
        peer.set_blind(true);
        assert_eq!(port.send(at(5), &[frame(8)]), Ok(1), "the port does not see the frames that wait");
        peer.set_blind(false);
        assert_eq!(port.send(at(6), &[frame(9)]), Ok(0));
        port.bound_unsent(usize::MAX).unwrap();
        assert_eq!(port.send(at(7), &[frame(9)]), Ok(1));
    }

    #[test]
    fn a_dropped_bus_is_gone_once_its_frames_were_read() {
        let (mut port, mut peer) = virtual_port(4);
        peer.deliver(received(1, 1), 47);
        drop(peer);
        assert_eq!(port.send(at(1), &[frame(1)]), Err(PortError::Gone));
        assert_eq!(receive(&mut port, 1).unwrap().len(), 1);
        assert_eq!(receive(&mut port, 1), Err(PortError::Gone));
    }
}
