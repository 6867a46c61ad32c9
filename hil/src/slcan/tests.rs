//! Dialogues of the emulated slcan adapter.

use super::*;
use crate::World;
use can::{ExtendedId, Port, Received, StandardId};

const BUS: Bitrate = Bitrate::KBPS_1000;

fn adapter() -> SlcanDevice {
    SlcanDevice::new(BUS)
}

fn at(millis: u64) -> Instant {
    Instant::from_nanos(millis * 1_000_000)
}

fn standard(id: u16, data: &[u8]) -> Frame {
    Frame::new(StandardId::new(id).unwrap(), data).unwrap()
}

/// All bytes for the host: a bell is shown as `!`, a carriage return as `.`.
fn said(device: &mut SlcanDevice) -> String {
    let mut said = String::new();
    while !device.bytes().is_empty() {
        let count = device.bytes().len();
        said += str::from_utf8(device.bytes()).unwrap();
        device.consume(count);
    }
    said.replace('\r', ".").replace('\x07', "!")
}

/// Answer of the adapter to a text in which `.` stands for a carriage return.
fn tell(device: &mut SlcanDevice, text: &str) -> String {
    device.handle_bytes(text.replace('.', "\r").as_bytes(), Instant::ZERO);
    said(device)
}

fn sent(device: &mut SlcanDevice) -> Vec<String> {
    std::iter::from_fn(|| device.poll_transmit(Instant::ZERO)).map(|frame| frame.to_string()).collect()
}

#[test]
fn commands_are_answered_by_what_the_channel_allows() {
    // Bytes from the host, and the answer.
    let cases = [
        // slcand; python-can; the kernel's driver with a bit rate and a reset of errors.
        ("C.S8.O.", "..."),
        ("C.S8..O.O.", "....."),
        ("C.S8.F.O.", "..F00.."),
        // The bit rate must be set first, and an open channel cannot be configured.
        ("O.L.l.", "!!!"),
        ("S8.O.S8.s0014.Z1.X0.M00000000.mFFFFFFFF.", "..!!!!!!"),
        ("S8.O.L.l.C.L.O.", "..!!..!"),
        ("S8.Z1.X1.U0.M00000000.mFFFFFFFF.s0014.", "......."),
        // Frames need an open channel that may transmit.
        ("t0800.", "!"),
        ("S8.t0800.O.t0800.T000000800.r0800.C.t0800.", ".!.....!"),
        ("S8.L.t0800.", "..!"),
        ("V.v.N.F.", "V1010.v0100.NHIL1.F00."),
        // Polling needs an open channel without automatic reports.
        ("P.A.S8.O.P.A.", "!!..!!"),
        ("S8.X0.O.P.A.", "....A."),
        // Unknown commands, and bytes that form no valid line.
        ("S9.x.t08\x07\x07", "!!!"),
        ("O\u{7f}.1111111111111111111111111111111111111111.C.", "!!."),
    ];
    for (told, heard) in cases {
        assert_eq!(tell(&mut adapter(), told), heard, "{told}");
    }
}

#[test]
fn a_line_may_come_in_pieces() {
    let mut device = adapter();
    assert_eq!(tell(&mut device, "S8.O.t601"), "..");
    assert_eq!(tell(&mut device, "840416000"), "");
    assert_eq!(tell(&mut device, "00000000."), ".");
    assert_eq!(sent(&mut device), ["601#4041600000000000"]);
}

#[test]
fn frames_go_out_in_order_and_come_in_as_lines() {
    let mut device = adapter();
    assert_eq!(tell(&mut device, "S8.O.t0800.T000000011AB.r7011."), ".....");
    assert_eq!(sent(&mut device), ["080#", "00000001#AB", "701#R1"]);
    device.handle(&standard(0x581, &[0x60, 0x40]), at(1));
    device.handle(&Frame::new(ExtendedId::new(1).unwrap(), &[]).unwrap(), at(2));
    assert_eq!(said(&mut device), "t58126040.T000000010.");
    let counts = SlcanCounts { sent: 3, received: 2, ..SlcanCounts::default() };
    assert_eq!(device.counts(), counts);
}

#[test]
fn a_closed_channel_hears_nothing_and_forgets_what_waited() {
    let mut device = adapter();
    device.handle(&standard(0x701, &[5]), at(1));
    assert_eq!(tell(&mut device, "S8.O.t0800.C."), "....");
    device.handle(&standard(0x701, &[5]), at(2));
    assert_eq!(said(&mut device), "");
    assert_eq!(sent(&mut device), [""; 0]);
}

#[test]
fn who_only_listens_hears_everything() {
    let mut device = adapter();
    tell(&mut device, "S8.L.");
    device.handle(&standard(0x701, &[5]), at(1));
    assert_eq!(said(&mut device), "t701105.");
}

#[test]
fn a_channel_that_loops_back_stays_off_the_bus() {
    let mut device = adapter();
    assert_eq!(tell(&mut device, "S8.l.t08011A."), "..t08011A..");
    device.handle(&standard(0x701, &[5]), at(1));
    assert_eq!(said(&mut device), "");
    assert_eq!(sent(&mut device), [""; 0]);
}

#[test]
fn time_stamps_are_milliseconds_of_a_minute() {
    let mut device = adapter();
    tell(&mut device, "Z1.S8.O.");
    for millis in [0, 59_999, 60_000] {
        device.handle(&standard(0x080, &[]), at(millis));
    }
    assert_eq!(said(&mut device), "t08000000.t0800EA5F.t08000000.");
}

#[test]
fn without_auto_poll_frames_wait_to_be_asked_for() {
    let mut device = adapter();
    tell(&mut device, "S8.X0.O.");
    for id in 1..=70 {
        device.handle(&standard(id, &[]), at(1));
    }
    assert_eq!(tell(&mut device, "P.P."), "t0010.t0020.");
    let rest = tell(&mut device, "A.");
    assert_eq!((rest.matches('t').count(), rest.ends_with("t0400.A.")), (62, true));
    assert_eq!(tell(&mut device, "P.F.F."), ".F01.F00.");
    assert_eq!((device.counts().received, device.counts().lost), (64, 6));
}

#[test]
fn a_host_that_does_not_read_loses_frames_but_no_answers() {
    let mut device = adapter();
    tell(&mut device, "S8.O.");
    let frame = standard(0x701, &[0; 8]);
    for _ in 0..1000 {
        device.handle(&frame, at(1));
    }
    let SlcanCounts { received, lost, .. } = device.counts();
    assert_eq!((received, lost), (174, 826));
    device.handle_bytes(b"F\rF\r", at(1));
    assert!(said(&mut device).ends_with("t70180000000000000000.F08.F00."));
    // The room for answers is bounded as well.
    for _ in 0..5 {
        device.handle_bytes(&[b'\r'; 1000], at(1));
    }
    assert_eq!(device.counts().unsaid, 5000 - 4096);
}

#[test]
fn a_bus_that_takes_nothing_holds_the_host_up() {
    let mut device = adapter();
    tell(&mut device, "S8.O.");
    assert_eq!(device.room(), 1024);
    let frames: String = (0..40).map(|id| format!("t{id:03X}0.")).collect();
    assert_eq!(tell(&mut device, &frames), ".".repeat(32));
    assert_eq!(device.room(), 1024 - 8 * 6);
    // One frame leaves, and the next line is executed.
    assert_eq!(device.poll_transmit(at(1)), Some(standard(0, &[])));
    assert_eq!(said(&mut device), ".");
    let rest: Vec<_> = (1..40).map(|id| format!("{id:03X}#")).collect();
    assert_eq!(sent(&mut device), rest);
    assert_eq!((device.room(), said(&mut device)), (1024, ".".repeat(7)));
    // A host that sends without room loses its bytes.
    device.handle_bytes(&"t0800\r".repeat(300).into_bytes(), at(1));
    assert_eq!(device.counts().overrun, 300 * 6 - 1024);
}

#[test]
fn acceptance_is_that_of_an_sja1000_with_two_filters() {
    let standard_one = standard(0x123, &[0xAB]);
    let empty = standard(0x123, &[]);
    let remote = Frame::remote(StandardId::new(0x123).unwrap(), 0).unwrap();
    let extended = Frame::new(ExtendedId::new(0x1234_5678).unwrap(), &[]).unwrap();
    // Code, mask, frame, and whether the filter accepts the frame.
    let cases = [
        (0_u32, u32::MAX, standard_one, true),
        (0, 0, standard_one, false),
        // 0x123 << 5 is 0x2460.
        (0x2460_FFFF, 0x001F_000F, standard_one, true),
        (0x2460_FFFF, 0x000F_000F, remote, false),
        (0x2470_FFFF, 0x000F_000F, remote, true),
        (0xFFFF_2460, 0x0000_000F, standard_one, true),
        (0xFFFF_2480, 0x0000_000F, standard_one, false),
        // The first filter compares the first data byte, in two halves, if there is one.
        (0x246A_FFFB, 0x0000_0000, standard_one, true),
        (0x246A_FFFC, 0x0000_0000, standard_one, false),
        (0x246A_FFFC, 0x0000_0000, empty, true),
        // Bits 28 to 13 of 0x1234_5678 are 0x91A2.
        (0x91A2_0000, 0, extended, true),
        (0x0000_91A2, 0, extended, true),
        (0x91A3_91A3, 0, extended, false),
        (0x91A3_91A3, 0x0000_0001, extended, true),
    ];
    for (code, mask, frame, passes) in cases {
        let mut device = adapter();
        tell(&mut device, &format!("M{code:08X}.m{mask:08X}.S8.O."));
        device.handle(&frame, at(1));
        assert_eq!(!said(&mut device).is_empty(), passes, "{code:08X} {mask:08X} {frame}");
    }
}

#[test]
fn the_state_is_reported_when_it_changes() {
    let mut device = adapter();
    device.set_error_counters(0, 200);
    assert_eq!(said(&mut device), "");
    tell(&mut device, "S8.O.");
    // Receive and transmit counters, and the report to the host.
    let cases = [
        (0, 95, ""),
        (96, 8, "sw096008."),
        (97, 8, ""),
        (0, 128, "sp000128."),
        (127, 0, "sw127000."),
        (0, 256, "sb000256."),
        (0, 0, "sa000000."),
    ];
    for (receive, transmit, heard) in cases {
        device.set_error_counters(receive, transmit);
        assert_eq!(said(&mut device), heard);
    }
    device.report_errors(BusErrors::ACKNOWLEDGE | BusErrors::CRC);
    assert_eq!(said(&mut device), "e2ac.");
    assert_eq!(tell(&mut device, "F."), "FA4.");
}

#[test]
fn bus_off_ends_when_the_channel_is_opened_anew() {
    let mut device = adapter();
    tell(&mut device, "S8.O.t0800.");
    device.set_error_counters(0, 256);
    device.handle(&standard(0x701, &[5]), at(1));
    assert_eq!(said(&mut device), "sb000256.");
    assert_eq!(sent(&mut device), [""; 0]);
    assert_eq!(tell(&mut device, "t0800.C.O.t0810."), "!...");
    assert_eq!(sent(&mut device), ["081#"]);
}

#[test]
fn a_wrong_bit_rate_is_bus_off_for_who_speaks_and_errors_for_who_listens() {
    // A bit rate, and whether the bus has the same bit rate.
    for (set, right) in [("S8.", true), ("s0014.", true), ("S6.", false), ("s031C.", false)] {
        let mut device = adapter();
        tell(&mut device, &format!("{set}O."));
        assert_eq!(tell(&mut device, "t0800."), if right { "." } else { "sb000256.." });
        assert_eq!(sent(&mut device).len(), usize::from(right));
    }
    let mut device = adapter();
    tell(&mut device, "S6.O.");
    for _ in 0..200 {
        device.handle(&standard(0x080, &[]), at(1));
    }
    assert_eq!(said(&mut device), "sw096000.sp128000.");
    assert_eq!(tell(&mut device, "F."), "FA4.");
}

#[test]
fn two_adapters_and_a_port_share_a_bus_with_its_bit_times() {
    let mut world = World::new();
    let bus = world.add_bus(BUS);
    let mut port = world.host_port(bus, 8);
    let ids = [(); 2].map(|()| world.add_device(bus, Box::new(adapter())));
    for id in ids {
        world.change(id, at(1), |device: &mut SlcanDevice| tell(device, "S8.O."));
    }
    // The frame with the higher priority is handed over second, 10 µs after the start of the first frame, which lasts
    // at least 47 bits.
    let start = at(2);
    let hand = |world: &mut World, id, text: &str, now| {
        world.change(id, now, |device: &mut SlcanDevice| tell(device, text)).unwrap()
    };
    assert_eq!(hand(&mut world, ids[0], "t7FF0.", start), ".");
    assert_eq!(world.next_event(), Some(start));
    let later = Instant::from_nanos(start.as_nanos() + 10_000);
    assert_eq!(hand(&mut world, ids[1], "t0010.", later), ".");
    world.advance(at(3));
    let mut received = [Received { frame: standard(0, &[]), at: Instant::ZERO }; 8];
    assert_eq!(port.receive(at(3), &mut received), Ok(2));
    let arrivals = received[..2].iter().map(|received| {
        let micros = received.at.since(start).as_micros();
        (received.frame.to_string(), micros)
    });
    let first = u128::from(can::timing::bits_on_wire(&standard(0x7FF, &[])));
    let second = u128::from(can::timing::bits_on_wire(&standard(0x001, &[])));
    let expected = [("7FF#".to_owned(), first - 3), ("001#".to_owned(), first + second - 3)];
    assert!(arrivals.eq(expected));
    for (id, heard) in ids.into_iter().zip(["t0010.", "t7FF0."]) {
        let found = world.change(id, at(3), |device: &mut SlcanDevice| said(device));
        assert_eq!(found.unwrap(), heard);
    }
    assert_eq!(world.next_event(), None);
    assert!(world.change(ids[0], at(3), |_: &mut crate::Epos4| ()).is_none());
}

#[test]
fn a_drive_answers_behind_an_adapter_within_bit_times_and_its_own() {
    let mut world = World::new();
    let bus = world.add_bus(BUS);
    let axis = crate::AxisConfig::wut(crate::Irp6Axis::ALL[0]);
    let config = crate::Epos4Config::new(canopen::NodeId::new(2).unwrap(), axis);
    let (boot, delay) = (config.boot_delay, config.answer_delay);
    world.add_device(bus, Box::new(crate::Epos4::new(config)));
    let adapter = world.add_device(bus, Box::new(adapter()));
    let hand = |world: &mut World, text: &str, now| {
        let told = |device: &mut SlcanDevice| tell(device, text);
        world.change(adapter, now, told).unwrap()
    };
    assert_eq!(hand(&mut world, "C.S8.O.", Instant::ZERO), "...");
    let booted = Instant::ZERO + boot + std::time::Duration::from_millis(1);
    assert_eq!(hand(&mut world, "", booted), "t702100.");
    assert_eq!(hand(&mut world, "t60284041600000000000.", booted), ".");
    let bits = |id, data: u64| can::timing::bits_on_wire(&standard(id, &data.to_be_bytes()));
    let (request, answer) = (0x4041_6000_0000_0000, 0x4B41_6000_4004_0000);
    // Each frame is received at its last bit, before the intermission.
    let bits = bits(0x602, request) + bits(0x582, answer) - 2 * can::timing::INTERMISSION;
    let due = booted + BUS.duration(bits) + delay;
    let moment = std::time::Duration::from_nanos(1);
    assert_eq!(hand(&mut world, "", due - moment), "");
    assert_eq!(hand(&mut world, "", due), "t58284B41600040040000.");
}
