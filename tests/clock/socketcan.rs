//! The SocketCAN port with the real kernel and the real `can-utils`.
//!
//! Required hardware, with `HIL_CAN` set: any interface that is up, and root, since most tests make a
//! virtual interface of their own beside it.

use std::process::{Command, Stdio};
use std::time::Duration;

use can::candump::Entry;
use can::{
    ControllerState, Counters, ExtendedId, Frame, Id, Instant, OpenError, Port, PortError, Received, SocketCanOptions,
    SocketCanPort, StandardId, clock,
};
use kit::bench::{Body, bodies_on_vcan};

/// Upper bound for the duration of every step.
const PATIENCE: Duration = Duration::from_secs(5);

pub(crate) fn sh(command: &str) {
    let status = Command::new("sh").args(["-c", command]).status().unwrap();
    assert!(status.success(), "{command}: {status}");
}

/// A virtual interface of one test, removed on drop.
pub(crate) struct Vcan(pub(crate) &'static str);

impl Vcan {
    pub(crate) fn new(name: &'static str) -> Self {
        sh(&format!("ip link add dev {name} type vcan && ip link set {name} up"));
        Self(name)
    }
}

impl Drop for Vcan {
    fn drop(&mut self) {
        let _ = Command::new("ip").args(["link", "del", self.0]).stderr(Stdio::null()).status();
    }
}

fn open(interface: &str) -> SocketCanPort {
    SocketCanPort::open(interface, &SocketCanOptions::default()).unwrap()
}

fn standard(raw: u16) -> Id {
    StandardId::new(raw).unwrap().into()
}

fn numbered(number: u32) -> Frame {
    Frame::new(standard(0x123), &number.to_le_bytes()).unwrap()
}

/// Receives until there are `count` frames or the time limit ends.
fn receive(port: &mut SocketCanPort, count: usize) -> Vec<Received> {
    let deadline = clock::now() + PATIENCE;
    let mut into = [Received { frame: numbered(0), at: Instant::ZERO }; 64];
    let mut all = Vec::new();
    while all.len() < count && port.wait_readable(deadline).unwrap() {
        let some = port.receive(clock::now(), &mut into).unwrap();
        all.extend_from_slice(&into[..some]);
    }
    all
}

fn frames(received: &[Received]) -> Vec<Frame> {
    received.iter().map(|received| received.frame).collect()
}

/// Waits until `done` returns true, and checks every few milliseconds. The wait itself reads no clock.
fn wait_until(port: &mut SocketCanPort, mut done: impl FnMut(&mut SocketCanPort) -> bool) -> bool {
    let deadline = clock::now() + PATIENCE;
    while clock::now() < deadline {
        if done(port) {
            return true;
        }
        port.wait_readable(clock::now() + Duration::from_millis(5)).unwrap();
        let mut into = [Received { frame: numbered(0), at: Instant::ZERO }; 1];
        let _ = port.receive(clock::now(), &mut into);
    }
    false
}

#[test]
fn the_port_on_a_real_kernel() {
    let bodies: [Body; 11] = [
        ("every kind of frame comes back in order and stamped", every_kind_of_frame_comes_back_in_order_and_stamped),
        ("only accepted identifiers are received", only_accepted_identifiers_are_received),
        ("candump reads what is sent", candump_reads_what_is_sent),
        ("what cansend sends arrives", what_cansend_sends_arrives),
        ("error frames change the state and are not handed out", error_frames_change_the_state_and_are_not_handed_out),
        ("a slow bus refuses and loses nothing it took", a_slow_bus_refuses_and_loses_nothing_it_took),
        ("a port works again once its interface is up again", a_port_works_again_once_its_interface_is_up_again),
        ("a removed interface is gone for good", a_removed_interface_is_gone_for_good),
        ("frames the kernel dropped are counted", frames_the_kernel_dropped_are_counted),
        (
            "an interface that cannot be opened is refused for its own reason",
            an_interface_that_cannot_be_opened_is_refused_for_its_own_reason,
        ),
        ("waiting ends at its deadline", waiting_ends_at_its_deadline),
    ];
    bodies_on_vcan("socketcan::the_port_on_a_real_kernel", &bodies, |interface, body| body(interface));
}

fn every_kind_of_frame_comes_back_in_order_and_stamped(interface: &str) {
    let (mut here, mut there) = (open(interface), open(interface));
    let extended = ExtendedId::new(0x1ABC_DEF0).unwrap();
    let sent = [
        Frame::new(standard(0), &[]).unwrap(),
        Frame::new(standard(0x7FF), &[1, 2, 3, 4, 5, 6, 7, 8]).unwrap(),
        Frame::new(extended, &[0xAB]).unwrap(),
        Frame::remote(standard(0x701), 1).unwrap(),
        Frame::remote(extended, 8).unwrap(),
    ];
    let before = clock::now();
    assert_eq!(here.send(before, &sent), Ok(sent.len()));
    let after = clock::now();
    // The sender receives nothing. Frames that are read late still carry their time of arrival.
    assert_eq!(here.wait_readable(after + Duration::from_millis(50)), Ok(false));
    let received = receive(&mut there, sent.len());
    assert_eq!(frames(&received), sent);
    assert!(received.is_sorted_by_key(|received| received.at), "{received:?}");
    // The time stamp is converted from CLOCK_REALTIME, which may be slewed in the meantime.
    let (slewed, delivered) = (Duration::from_millis(1), Duration::from_millis(25));
    for Received { at, .. } in received {
        let there = at + slewed >= before && at <= after + delivered;
        assert!(there, "{before} {at} {after}");
    }
    assert_eq!(here.counters(), Counters { sent: 5, bits: there.counters().bits, ..Counters::default() });
    assert_eq!(there.counters(), Counters { received: 5, bits: here.counters().bits, ..Counters::default() });
}

fn only_accepted_identifiers_are_received(interface: &str) {
    let accept = vec![StandardId::new(0x181).unwrap(), StandardId::new(0x581).unwrap()];
    let options = SocketCanOptions { accept, ..SocketCanOptions::default() };
    let mut there = SocketCanPort::open(interface, &options).unwrap();
    let mut here = open(interface);
    let data = |id: Id| Frame::new(id, &[1]).unwrap();
    let extended = ExtendedId::new(0x181).unwrap();
    let remote = Frame::remote(standard(0x181), 1).unwrap();
    let sent = [data(standard(0x180)), data(standard(0x181)), data(extended.into()), remote, data(standard(0x581))];
    assert_eq!(here.send(clock::now(), &sent), Ok(5));
    assert_eq!(frames(&receive(&mut there, 2)), [sent[1], sent[4]]);
    assert_eq!(there.wait_readable(clock::now()), Ok(false));
}

fn candump_reads_what_is_sent(interface: &str) {
    let mut port = open(interface);
    let sent = [
        Frame::new(standard(0x601), &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]).unwrap(),
        Frame::new(ExtendedId::new(0x123).unwrap(), &[]).unwrap(),
        Frame::remote(standard(0x701), 1).unwrap(),
    ];
    let listeners = || std::fs::read_to_string("/proc/net/can/rcvlist_all").unwrap().lines().count();
    let before = listeners();
    let candump = Command::new("candump")
        .args(["-L", "-n", "3", "-T", "5000", interface])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    assert!(wait_until(&mut port, |_| listeners() > before), "candump does not listen");
    assert_eq!(port.send(clock::now(), &sent), Ok(3));
    let output = candump.wait_with_output().unwrap();
    let lines = output.stdout.trim_ascii_end().split(|&byte| byte == b'\n');
    let entries: Vec<_> = lines.map(|line| Entry::parse(line).unwrap()).collect();
    let read: Vec<_> = entries.iter().map(|entry| entry.frame).collect();
    assert_eq!(read, sent);
    assert!(entries.iter().all(|entry| entry.interface.as_str() == interface));
}

fn what_cansend_sends_arrives(interface: &str) {
    let mut port = open(interface);
    for text in ["601#4041600000000000", "0000ABCD#11", "701#R1", "080#"] {
        sh(&format!("cansend {interface} {text}"));
        let received = receive(&mut port, 1);
        assert_eq!(received[0].frame.to_string(), text);
    }
}

fn error_frames_change_the_state_and_are_not_handed_out(_: &str) {
    let bus = Vcan::new("vcanerr");
    let mut port = open(bus.0);
    let cases = [
        ("20000004#0004000000000000", ControllerState::Warning),
        ("20000004#0010000000000000", ControllerState::Passive),
        ("20000040#0000000000000000", ControllerState::BusOff),
        ("20000100#0000000000000000", ControllerState::Active),
    ];
    for (count, (text, state)) in (1..).zip(cases) {
        sh(&format!("cansend {} {text}", bus.0));
        assert!(wait_until(&mut port, |port| port.state() == state), "{text}");
        let (passive, bus_off) = (u64::from(count >= 2), u64::from(count >= 3));
        assert_eq!(port.counters(), Counters { errors: count, passive, bus_off, ..Counters::default() });
    }
}

fn a_slow_bus_refuses_and_loses_nothing_it_took(_: &str) {
    let bus = Vcan::new("vcanslow");
    sh(&format!("tc qdisc add dev {} root tbf rate 1mbit burst 200 limit 1600", bus.0));
    // The short queue is filled first: EAGAIN. The long queue overruns the 100 frames of the interface:
    // ENOBUFS.
    for send_queue in [0, 9, 1000] {
        let options = SocketCanOptions { send_queue, ..SocketCanOptions::default() };
        let mut here = SocketCanPort::open(bus.0, &options).unwrap();
        let mut there = open(bus.0);
        let all: Vec<_> = (0..1000).map(numbered).collect();
        let deadline = clock::now() + PATIENCE;
        let mut taken = 0;
        while taken < all.len() && clock::now() < deadline {
            let begun = clock::now();
            let some = here.send(begun, &all[taken..]).unwrap();
            if taken == 0 {
                // The bus accepts a burst of twelve frames at once. Its clock continues to run: it accepts
                // a frame of 16 bytes every 128 µs, and a few more at once.
                let waiting = send_queue.clamp(6, 100);
                let later = clock::now().since(begun).as_micros() as usize / 128;
                let expected = waiting + 12..waiting + 20 + later;
                assert!(expected.contains(&some), "{some} taken with a queue of {send_queue}");
            }
            taken += some;
            here.wait_readable(clock::now() + Duration::from_millis(1)).unwrap();
        }
        assert_eq!(frames(&receive(&mut there, all.len())), all);
        let counters = here.counters();
        assert_eq!(counters.sent, 1000);
        assert!(counters.refused > 0);
        assert_eq!(there.counters().dropped, 0);
    }
}

fn a_port_works_again_once_its_interface_is_up_again(_: &str) {
    let bus = Vcan::new("vcandown");
    let (mut here, mut there) = (open(bus.0), open(bus.0));
    let mut into = [Received { frame: numbered(0), at: Instant::ZERO }];
    sh(&format!("ip link set {} down", bus.0));
    assert_eq!(there.wait_readable(clock::now() + PATIENCE), Ok(true));
    assert_eq!(there.receive(clock::now(), &mut into), Err(PortError::Down));
    for _ in 0..3 {
        assert_eq!(here.send(clock::now(), &[numbered(1)]), Err(PortError::Down));
    }
    assert_eq!(here.counters().refused, 3);
    let refusal = SocketCanPort::open(bus.0, &SocketCanOptions::default()).err();
    assert!(matches!(refusal, Some(OpenError::Down(_))), "{refusal:?}");

    sh(&format!("ip link set {} up", bus.0));
    assert_eq!(here.send(clock::now(), &[numbered(2)]), Ok(1));
    assert_eq!(frames(&receive(&mut there, 1)), [numbered(2)]);
}

fn a_removed_interface_is_gone_for_good(_: &str) {
    let bus = Vcan::new("vcangone");
    let (mut here, mut there) = (open(bus.0), open(bus.0));
    let mut into = [Received { frame: numbered(0), at: Instant::ZERO }];
    drop(bus);
    let bus = Vcan::new("vcangone");
    for _ in 0..2 {
        assert_eq!(here.send(clock::now(), &[numbered(1)]), Err(PortError::Gone));
        assert_eq!(there.receive(clock::now(), &mut into), Err(PortError::Gone));
        assert_eq!(there.wait_readable(clock::now() + PATIENCE), Err(PortError::Gone));
    }
    assert_eq!(open(bus.0).send(clock::now(), &[numbered(1)]), Ok(1));
}

fn frames_the_kernel_dropped_are_counted(_: &str) {
    let bus = Vcan::new("vcanfull");
    let options = SocketCanOptions { receive_queue: 0, ..SocketCanOptions::default() };
    let mut there = SocketCanPort::open(bus.0, &options).unwrap();
    assert_eq!((there.receive_queue(), open(bus.0).receive_queue()), (3, 10_000));
    let mut here = open(bus.0);
    let burst: Vec<_> = (0..200).map(numbered).collect();
    assert_eq!(here.send(clock::now(), &burst), Ok(200));
    let mut into = [Received { frame: numbered(0), at: Instant::ZERO }; 256];
    let mut kept = 0;
    while there.wait_readable(clock::now() + Duration::from_millis(100)).unwrap() {
        kept += there.receive(clock::now(), &mut into).unwrap();
    }
    assert!(kept < 200, "{kept}");
    // The kernel reports the loss with the next frame that it keeps.
    assert_eq!(here.send(clock::now(), &[numbered(200)]), Ok(1));
    assert_eq!(frames(&receive(&mut there, 1)), [numbered(200)]);
    assert_eq!(there.counters().dropped, 200 - kept as u64);
}

fn an_interface_that_cannot_be_opened_is_refused_for_its_own_reason(_: &str) {
    let refusal = |name| SocketCanPort::open(name, &SocketCanOptions::default()).err();
    let absent = refusal("can9");
    assert!(matches!(absent, Some(OpenError::Absent(name)) if name.as_str() == "can9"), "{absent:?}");
    let other = refusal("lo");
    assert!(matches!(other, Some(OpenError::NotCan(_))), "{other:?}");
}

fn waiting_ends_at_its_deadline(interface: &str) {
    let port = open(interface);
    let deadline = clock::now() + Duration::from_millis(20);
    assert_eq!(port.wait_readable(deadline), Ok(false));
    let late = clock::now().since(deadline);
    assert!(clock::now() >= deadline && late < Duration::from_secs(1), "{late:?}");
    assert_eq!(port.wait_readable(Instant::ZERO), Ok(false));
}
