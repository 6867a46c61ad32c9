//! Faults of frames and of the host's controller.

use can::timing::Bitrate;
use can::{ControllerState, Frame, Instant, Port, PortError, Received, StandardId, VirtualPort, virtual_port};
use std::time::Duration;

use super::{FrameFault, Frames, HostFault};
use crate::bus::VirtualBus;
use crate::{Device, DeviceFault};

fn at(micros: u64) -> Instant {
    Instant::from_nanos(micros * 1000)
}

fn frame(id: u16) -> Frame {
    Frame::new(StandardId::new(id).unwrap(), &[]).unwrap()
}

/// Sends its frames at once, and keeps what it hears.
#[derive(Default)]
struct Node {
    sends: Vec<Frame>,
    heard: Vec<u16>,
}

impl Device for Node {
    fn handle(&mut self, frame: &Frame, _now: Instant) {
        self.heard.extend(frame.standard_data_id().map(|id| id.raw()));
    }
    fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        (!self.sends.is_empty()).then(|| self.sends.remove(0))
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
    fn handle_timeout(&mut self, _now: Instant) {}
}

/// A bus with a host and a node, and another host that listens. The node has sent nothing yet.
fn bus() -> (VirtualBus, VirtualPort, VirtualPort) {
    let mut bus = VirtualBus::new(Bitrate::KBPS_1000);
    let [host, listener] = [(), ()].map(|()| {
        let (port, peer) = virtual_port(64);
        bus.attach_host(peer);
        port
    });
    bus.attach_device(Box::new(Node::default()));
    (bus, host, listener)
}

/// Identifiers and times, µs, of the frames that a port received.
fn heard(port: &mut VirtualPort) -> Vec<(u16, u64)> {
    let mut into = [Received { frame: frame(0), at: Instant::ZERO }; 16];
    let count = port.receive(Instant::FAR_FUTURE, &mut into).unwrap();
    let heard = into[..count].iter().map(|it| (it.frame.standard_data_id().unwrap().raw(), it.at.as_nanos() / 1000));
    heard.collect()
}

/// What the listener hears of three frames of the host under a fault of frames 0x182.
fn under(fault: FrameFault, count: Option<u32>) -> Vec<(u16, u64)> {
    let (mut bus, mut host, mut listener) = bus();
    let number = bus.begin_frame_fault(Frames::Id(StandardId::new(0x182).unwrap()), fault, (1.0, count, 1));
    host.send(at(0), &[frame(0x181), frame(0x182), frame(0x182), frame(0x183)]).unwrap();
    bus.advance(at(2_000));
    bus.end_frame_fault(number, at(2_000));
    bus.advance(at(10_000));
    heard(&mut listener)
}

#[test]
fn a_fault_damages_the_frames_that_it_names() {
    let sound = under(FrameFault::Lost, Some(0));
    let ids = |heard: &[(u16, u64)]| heard.iter().map(|(id, _)| *id).collect::<Vec<_>>();
    assert_eq!(ids(&sound), [0x181, 0x182, 0x182, 0x183]);
    assert_eq!(ids(&under(FrameFault::Lost, None)), [0x181, 0x183]);
    assert_eq!(ids(&under(FrameFault::Lost, Some(1))), [0x181, 0x182, 0x183]);
    assert_eq!(ids(&under(FrameFault::Duplicated, Some(1))), [0x181, 0x182, 0x182, 0x182, 0x183]);
    // The first of the two is delivered after the second.
    assert_eq!(ids(&under(FrameFault::Swapped, None)), [0x181, 0x182, 0x182, 0x183]);
    let late = under(FrameFault::Late(Duration::from_millis(1)), Some(1));
    assert_eq!(ids(&late), [0x181, 0x182, 0x183, 0x182]);
    assert_eq!(late[3].1, sound[1].1 + 1_000);
    // The sender repeats a frame whose receiver found a CRC error, for ever if the error stays.
    let corrupted = under(FrameFault::Corrupted, Some(1));
    assert_eq!(ids(&corrupted), ids(&sound));
    assert!(corrupted[1].1 > sound[1].1 + 50, "{corrupted:?}");
    let blocked = under(FrameFault::Corrupted, None);
    assert!(blocked[1].1 > 2_000, "the bus is free after the end of the fault: {blocked:?}");
}

#[test]
fn the_same_seed_damages_the_same_frames() {
    let damaged = |seed| {
        let (mut bus, mut host, mut listener) = bus();
        bus.begin_frame_fault(Frames::FromHost, FrameFault::Lost, (0.5, None, seed));
        for number in 0..16 {
            host.send(at(number * 100), &[frame(0x180 + number as u16)]).unwrap();
        }
        bus.advance(at(10_000));
        heard(&mut listener)
    };
    assert_eq!(damaged(1), damaged(1));
    assert_ne!(damaged(1), damaged(2));
    assert!((4..13).contains(&damaged(1).len()));
}

#[test]
fn a_host_that_is_cut_off_neither_sends_nor_receives() {
    // The kernel discards the frames of a controller that is bus-off. Without an acknowledgement, they wait.
    for (fault, state, sent_later) in
        [(HostFault::BusOff, ControllerState::BusOff, 0), (HostFault::Unacknowledged, ControllerState::Passive, 1)]
    {
        let (mut bus, mut host, mut listener) = bus();
        bus.set_host_fault(fault, true, at(0));
        host.send(at(10), &[frame(0x181)]).unwrap();
        listener.send(at(10), &[frame(0x182)]).unwrap();
        bus.advance(at(1_000));
        assert_eq!((heard(&mut host), host.state()), (vec![], state));
        assert_eq!(heard(&mut listener), []);
        bus.set_host_fault(fault, false, at(1_000));
        bus.advance(at(2_000));
        assert_eq!((heard(&mut host), host.state()), (vec![], ControllerState::Active));
        assert_eq!(heard(&mut listener).len(), sent_later);
    }
    let (mut bus, mut host, _listener) = bus();
    bus.set_host_fault(HostFault::Down, true, at(0));
    assert_eq!(host.send(at(1), &[frame(0x181)]), Err(PortError::Down));
    bus.set_host_fault(HostFault::Down, false, at(1));
    bus.set_host_fault(HostFault::QueueFull, true, at(1));
    assert_eq!(host.send(at(1), &[frame(0x181)]), Ok(0));
    bus.set_host_fault(HostFault::QueueFull, false, at(1));
    bus.set_host_fault(HostFault::ErrorPassive, true, at(1));
    assert_eq!(host.send(at(1), &[frame(0x181)]), Ok(1));
    assert_eq!((heard(&mut host), host.state()), (vec![], ControllerState::Passive));
}

#[test]
fn held_frames_are_sent_in_order_at_the_end_while_the_host_receives() {
    let (mut bus, mut host, mut listener) = bus();
    host.bound_unsent(0).unwrap();
    bus.set_host_fault(HostFault::Held, true, at(0));
    // The adapter takes more frames than wait in any port.
    let sent: Vec<_> = (0..100).map(|number| 0x200 + number).collect();
    for (number, &id) in (0..).zip(&sent) {
        assert_eq!(host.send(at(number * 100), &[frame(id)]), Ok(1));
        bus.advance(at(number * 100 + 50));
    }
    listener.send(at(10_000), &[frame(0x182)]).unwrap();
    bus.advance(at(11_000));
    assert_eq!(heard(&mut listener), []);
    assert_eq!(heard(&mut host).len(), 1);
    bus.set_host_fault(HostFault::Held, false, at(11_000));
    // A later frame waits behind the held ones.
    assert_eq!(host.send(at(11_000), &[frame(0x300)]), Ok(1));
    let steps = (11_000..100_000).step_by(200).map(|now| {
        bus.advance(at(now));
        heard(&mut listener)
    });
    let heard: Vec<_> = steps.flatten().collect();
    let ids: Vec<_> = heard.iter().map(|(id, _)| *id).collect();
    assert_eq!(ids, [&sent[..], &[0x300]].concat());
    assert!(heard[0].1 > 11_000 && heard.windows(2).all(|pair| pair[0].1 < pair[1].1), "{heard:?}");
    // Afterwards the port observes its bound again.
    host.send(at(100_000), &[frame(0x301)]).unwrap();
    assert_eq!(host.send(at(100_000), &[frame(0x302)]), Ok(0));
}

#[test]
fn a_removed_interface_is_gone_for_ever() {
    let (mut bus, mut host, mut listener) = bus();
    host.send(at(0), &[frame(0x181)]).unwrap();
    bus.set_host_fault(HostFault::Removed, true, at(10));
    bus.set_host_fault(HostFault::Removed, false, at(20));
    assert_eq!(host.send(at(30), &[frame(0x181)]), Err(PortError::Gone));
    listener.send(at(30), &[frame(0x182)]).unwrap();
    bus.advance(at(1_000));
    let mut into = [Received { frame: frame(0), at: Instant::ZERO }; 1];
    assert_eq!(host.receive(at(1_000), &mut into), Err(PortError::Gone));
    assert_eq!(heard(&mut listener), []);
}

#[test]
fn an_unplugged_device_hears_nothing_and_a_foreign_node_is_heard_by_all() {
    let (mut bus, mut host, mut listener) = bus();
    assert!(bus.set_device_fault(0, DeviceFault::Unplugged, true, at(0)));
    let foreign = bus.begin_foreign(frame(0x703), at(0), Some(Duration::from_millis(1)));
    bus.advance(at(1_500));
    assert!(bus.set_device_fault(0, DeviceFault::Unplugged, false, at(1_500)));
    bus.advance(at(2_500));
    bus.end_frame_fault(foreign, at(2_500));
    bus.advance(at(10_000));
    assert_eq!((heard(&mut host).len(), heard(&mut listener).len()), (3, 3));
    let device: &dyn std::any::Any = bus.device(0).unwrap();
    assert_eq!(device.downcast_ref::<Node>().unwrap().heard, [0x703]);
}
