//! Arbitration, times and faults of the virtual bus.

use super::*;
use can::{ExtendedId, Port, StandardId, VirtualPort, virtual_port};
use std::time::Duration;

fn standard(id: u16, data: &[u8]) -> Frame {
    Frame::new(StandardId::new(id).unwrap(), data).unwrap()
}

fn at(micros: u64) -> Instant {
    Instant::from_nanos(micros * 1000)
}

/// A bus with `ports` hosts. The last host only listens.
fn hosts(ports: usize) -> (VirtualBus, Vec<VirtualPort>) {
    let mut bus = VirtualBus::new(Bitrate::KBPS_1000);
    let ports = (0..=ports)
        .map(|_| {
            let (port, peer) = virtual_port(64);
            bus.attach_host(peer);
            port
        })
        .collect();
    (bus, ports)
}

fn heard(port: &mut VirtualPort) -> Vec<(String, u64)> {
    let mut into = [Received { frame: standard(0, &[]), at: Instant::ZERO }; 64];
    let count = port.receive(Instant::FAR_FUTURE, &mut into).unwrap();
    let nanos = |received: &Received| (received.frame.to_string(), received.at.as_nanos());
    into[..count].iter().map(nanos).collect()
}

#[test]
fn the_strongest_identifier_goes_first_whoever_sends_it() {
    let extended = |id: u32| Frame::new(ExtendedId::new(id).unwrap(), &[]).unwrap();
    let remote = |id: u16| Frame::remote(StandardId::new(id).unwrap(), 0).unwrap();
    let remote_extended = Frame::remote(ExtendedId::new(0x100 << 18).unwrap(), 0).unwrap();
    // In the order in which they must appear on the wire.
    let order = [
        standard(0x000, &[]),
        standard(0x080, &[]),
        extended((0x100 << 18) - 1),
        standard(0x100, &[1]),
        remote(0x100),
        extended(0x100 << 18),
        remote_extended,
        extended((0x100 << 18) + 1),
        standard(0x101, &[]),
        remote(0x7FF),
    ];
    let (mut bus, mut ports) = hosts(order.len());
    for (frame, port) in order.iter().rev().zip(&mut ports) {
        assert_eq!(port.send(at(10), &[*frame]), Ok(1));
    }
    bus.advance(at(10_000));
    let frames: Vec<_> = heard(ports.last_mut().unwrap()).into_iter().map(|(frame, _)| frame).collect();
    assert_eq!(frames, order.map(|frame| frame.to_string()));
}

#[test]
fn frames_end_after_exactly_their_bits_and_follow_each_other_without_a_gap() {
    // 0x080 without data: 51 bits; 0x601 of the SDO request: 123 bits; both with intermission.
    let (mut bus, mut ports) = hosts(2);
    let request = standard(0x601, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]);
    ports[0].send(at(0), &[request]).unwrap();
    // Pending while the request is on the wire: the frame cannot interrupt the request, but is sent next.
    ports[1].send(at(50), &[standard(0x080, &[])]).unwrap();
    bus.advance(at(1000));
    let expected = [("601#4041600000000000".to_owned(), 120_000), ("080#".to_owned(), 123_000 + 48_000)];
    assert_eq!(heard(&mut ports[2]), expected);
    // No node receives its own frames.
    assert_eq!(heard(&mut ports[0]), expected[1..]);
    assert_eq!(heard(&mut ports[1]), expected[..1]);
}

#[test]
fn slower_rates_stretch_every_bit() {
    let mut bus = VirtualBus::new(Bitrate::KBPS_125);
    let (mut sender, peer) = virtual_port(1);
    bus.attach_host(peer);
    let (mut listener, peer) = virtual_port(1);
    bus.attach_host(peer);
    sender.send(at(0), &[standard(0x080, &[])]).unwrap();
    bus.advance(at(1000));
    assert_eq!(heard(&mut listener), [("080#".to_owned(), 48 * 8_000)]);
}

#[test]
fn a_host_keeps_its_own_order_whatever_the_identifiers() {
    let (mut bus, mut ports) = hosts(1);
    let frames = [standard(0x700, &[]), standard(0x001, &[]), standard(0x300, &[])];
    ports[0].send(at(0), &frames).unwrap();
    bus.advance(at(1000));
    let order: Vec<_> = heard(&mut ports[1]).into_iter().map(|(frame, _)| frame).collect();
    assert_eq!(order, ["700#", "001#", "300#"]);
}

#[test]
fn a_frame_longer_than_the_advance_ends_in_a_later_one() {
    let (mut bus, mut ports) = hosts(1);
    ports[0].send(at(0), &[standard(0x080, &[])]).unwrap();
    bus.advance(at(47));
    assert_eq!(heard(&mut ports[1]), []);
    bus.advance(at(48));
    assert_eq!(heard(&mut ports[1]).len(), 1);
}

#[test]
fn frames_handed_over_late_or_early_count_from_when_they_can() {
    let (mut bus, mut ports) = hosts(2);
    bus.advance(at(500));
    ports[0].send(at(100), &[standard(0x080, &[])]).unwrap();
    ports[1].send(at(900), &[standard(0x080, &[])]).unwrap();
    bus.advance(at(2000));
    let times: Vec<_> = heard(&mut ports[2]).iter().map(|(_, at)| *at).collect();
    assert_eq!(times, [548_000, 948_000]);
}

/// Answers each SYNC with frames of these identifiers, and sends one at each multiple of 1 ms.
struct Echo {
    answers: Vec<u16>,
    queue: VecDeque<Frame>,
    next: Instant,
}

impl Echo {
    fn new(answers: &[u16]) -> Box<Self> {
        Box::new(Self { answers: answers.to_vec(), queue: VecDeque::new(), next: at(1000) })
    }
}

impl Device for Echo {
    fn handle(&mut self, frame: &Frame, _now: Instant) {
        if frame.standard_data_id() == StandardId::new(0x080) {
            self.queue.extend(self.answers.iter().map(|&id| standard(id, &[])));
        }
    }
    fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        self.queue.pop_front()
    }
    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }
    fn handle_timeout(&mut self, now: Instant) {
        assert_eq!(now, self.next, "time-outs come on time");
        self.queue.push_back(standard(0x77F, &[]));
        self.next += Duration::from_millis(1);
    }
}

#[test]
fn devices_queue_in_their_own_order_and_compete_with_their_heads() {
    let (mut bus, mut ports) = hosts(1);
    bus.attach_device(Echo::new(&[0x300, 0x100]));
    bus.attach_device(Echo::new(&[0x200, 0x400]));
    ports[0].send(at(0), &[standard(0x080, &[])]).unwrap();
    bus.advance(at(999));
    let order: Vec<_> = heard(&mut ports[1]).into_iter().map(|(frame, _)| frame).collect();
    assert_eq!(order, ["080#", "200#", "300#", "100#", "400#"]);
}

#[test]
fn time_outs_fall_between_the_frames_at_their_instant() {
    let (mut bus, mut ports) = hosts(1);
    bus.attach_device(Echo::new(&[]));
    bus.advance(at(3500));
    let times: Vec<_> = heard(&mut ports[1]).iter().map(|(frame, at)| (frame.clone(), at / 1_000_000)).collect();
    assert_eq!(times, [1, 2, 3].map(|millis| ("77F#".to_owned(), millis)).to_vec());
}

#[test]
fn a_device_that_is_never_content_does_not_stop_time() {
    struct Restless;
    impl Device for Restless {
        fn handle(&mut self, _: &Frame, _: Instant) {}
        fn poll_transmit(&mut self, _: Instant) -> Option<Frame> {
            None
        }
        fn poll_timeout(&self) -> Option<Instant> {
            Some(Instant::ZERO)
        }
        fn handle_timeout(&mut self, _: Instant) {}
    }
    let mut bus = VirtualBus::new(Bitrate::KBPS_1000);
    bus.attach_device(Box::new(Restless));
    bus.advance(at(1000));
    assert!(bus.next_event() > Some(at(1000)));
}
