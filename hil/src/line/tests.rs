//! Byte times, latency and faults of the emulated line.

use super::*;
use serial::{Line, VirtualLine, virtual_line};
use std::collections::VecDeque;

const SETTINGS: Settings = Settings::AXIS_CONTROLLER;

fn at(micros: u64) -> Instant {
    Instant::from_nanos(micros * 1000)
}

/// Sends received bytes back `delay` later.
struct Echo {
    delay: Duration,
    heard: Vec<(u8, Instant)>,
    pending: VecDeque<(u8, Instant)>,
}

impl LineDevice for Echo {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.heard.push((byte, now));
        self.pending.push_back((byte, now + self.delay));
    }
    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        let &(byte, _) = self.pending.front().filter(|(_, at)| *at <= now)?;
        self.pending.pop_front();
        Some(byte)
    }
    fn poll_timeout(&self) -> Option<Instant> {
        self.pending.front().map(|&(_, at)| at)
    }
    fn handle_timeout(&mut self, _now: Instant) {}
}

struct Rig {
    line: SerialLine,
    host: VirtualLine,
}

fn rig(latency: Option<Duration>, delay: Duration) -> Rig {
    let echo = Echo { delay, heard: Vec::new(), pending: VecDeque::new() };
    let mut line = SerialLine::new(SETTINGS, latency, Box::new(echo));
    let (host, peer) = virtual_line(1024);
    line.attach_host(peer);
    Rig { line, host }
}

impl Rig {
    fn heard(&self) -> &[(u8, Instant)] {
        &self.line.device::<Echo>().unwrap().heard
    }

    /// Advances from event to event until `until`. Returns the times at which bytes could be read, and their numbers.
    fn reads(&mut self, until: Instant) -> Vec<(u64, usize)> {
        let mut reads = Vec::new();
        loop {
            let now = self.line.next_event().map_or(until, |at| at.min(until));
            self.line.advance(now);
            let count = self.host.read(now, &mut [0; 1024]).unwrap();
            if count > 0 {
                reads.push((now.as_nanos(), count));
            }
            if now == until {
                return reads;
            }
        }
    }
}

fn nanos(count: usize) -> u64 {
    SETTINGS.line_time(count).as_nanos() as u64
}

#[test]
fn bytes_take_their_line_times_both_ways() {
    let delay = Duration::from_micros(300);
    let mut rig = rig(None, delay);
    rig.host.write(at(1000), b"abc").unwrap();
    let reads = rig.reads(at(5000));
    let expected = [1, 2, 3].map(|count| 1_000_000 + nanos(count));
    assert_eq!(rig.heard().iter().map(|&(_, at)| at.as_nanos()).collect::<Vec<_>>(), expected);
    // Each byte returns one delay after its arrival. The returned bytes follow each other without a gap, apart from
    // rounding.
    let first = 1_000_000 + nanos(1) + 300_000;
    assert_eq!(reads[0], (first + nanos(1), 1));
    assert_eq!(reads.len(), 3);
    assert!(reads[2].0 - first <= nanos(3) + 3, "{reads:?}");
}

#[test]
fn a_long_burst_does_not_gather_rounding() {
    let mut rig = rig(None, Duration::from_secs(1));
    rig.host.write(at(0), &[0; 1000]).unwrap();
    rig.line.advance(at(100_000));
    assert_eq!(rig.heard()[999].1.as_nanos(), nanos(1000));
}

#[test]
fn both_directions_carry_at_once() {
    let mut rig = rig(None, Duration::ZERO);
    rig.host.write(at(0), &[7; 100]).unwrap();
    let reads = rig.reads(at(5000));
    let (last, _) = *reads.last().unwrap();
    assert!(last <= nanos(101) + 100, "one byte behind the request, not after all of it: {last}");
}

#[test]
fn what_is_handed_over_late_goes_on_the_line_at_once() {
    let mut rig = rig(None, Duration::from_secs(1));
    rig.line.advance(at(500));
    rig.host.write(at(100), &[1]).unwrap();
    rig.line.advance(at(505));
    assert_eq!(rig.heard(), [], "still on the wire");
    rig.line.advance(at(1000));
    assert_eq!(rig.heard()[0].1.as_nanos(), 500_000 + nanos(1));
}

#[test]
fn an_adapter_hands_over_when_its_timer_runs_out_or_a_packet_is_full() {
    // Times at which bytes are written, and the reads of the host with their times.
    type Reads = &'static [(u64, usize)];
    let cases: [(u64, usize, Reads); 5] = [
        (100, 3, &[(16_000_000, 3)]),
        // The byte does not start the timer.
        (15_000, 3, &[(16_000_000, 3)]),
        (15_990, 3, &[(32_000_000, 3)]),
        // The timer expires while the byte is on its way back.
        (15_980, 1, &[(32_000_000, 1)]),
        (
            0,
            100,
            // 62 bytes as soon as they are there, one byte time after the request. The rest follows 16 ms later.
            &[(11_936 + 740_018, 62), (16_751_954, 38)],
        ),
    ];
    for (micros, count, expected) in cases {
        let mut rig = rig(Some(Duration::from_millis(16)), Duration::ZERO);
        rig.host.write(at(micros), &vec![5; count]).unwrap();
        let reads = rig.reads(at(100_000));
        assert_eq!(reads.len(), expected.len(), "{reads:?}");
        for (read, expected) in reads.iter().zip(expected) {
            assert_eq!(read.1, expected.1);
            assert!(read.0.abs_diff(expected.0) < 100, "{reads:?}");
        }
    }
}

#[test]
fn a_low_latency_adapter_is_sixteen_times_as_quick() {
    let mut rig = rig(Some(Duration::from_millis(1)), Duration::ZERO);
    rig.host.write(at(100), &[1, 2, 3]).unwrap();
    assert_eq!(rig.reads(at(100_000)), [(1_000_000, 3)]);
}

#[test]
fn a_new_host_end_takes_over_from_the_old_one() {
    let mut rig = rig(None, Duration::ZERO);
    let (host, peer) = virtual_line(8);
    rig.line.attach_host(peer);
    let mut old = std::mem::replace(&mut rig.host, host);
    assert!(old.write(at(0), &[1]).is_err());
    rig.host.write(at(0), &[2]).unwrap();
    assert_eq!(rig.reads(at(1000)).len(), 1);
    assert_eq!(rig.heard()[0].0, 2);
}

#[test]
fn faults_damage_their_direction_at_their_rate_and_are_counted() {
    const COUNT: usize = 1000;
    let wire = WireFaults::default();
    let some = |rate: f64| 0.8 * rate * COUNT as f64..1.2 * rate * COUNT as f64;
    type Check = fn(&LineStatistics) -> u64;
    let cases: [(WireFaults, Check, std::ops::Range<f64>); 6] = [
        (wire, |s| s.corrupted + s.lost + s.duplicated, 0.0..0.5),
        (WireFaults { bit_error_rate: 0.05, ..wire }, |s| s.corrupted, some(1.0 - 0.95_f64.powi(8))),
        (WireFaults { duplicate: 0.2, ..wire }, |s| s.duplicated, some(0.2)),
        // Bursts of ten bytes: the bytes that follow the lost byte are lost as well.
        (WireFaults { tear: 0.1, ..wire }, |s| s.lost, some(1.0 - (0.9 - 0.9_f64.powi(11)) / 0.1 / 10.0)),
        (WireFaults { stuck: Some(Stuck::Silent), ..wire }, |s| s.lost, some(1.0)),
        (WireFaults { stuck: Some(Stuck::At(0xFF)), ..wire }, |s| s.corrupted, some(1.0)),
    ];
    for (faults, count, expected) in cases {
        for towards_device in [true, false] {
            let mut rig = rig(None, Duration::ZERO);
            let mut both = LineFaults { seed: 5, ..LineFaults::default() };
            if towards_device {
                both.to_device = faults;
            } else {
                both.to_host = faults;
            }
            rig.line.set_faults(&both);
            let mut read = 0;
            for burst in 0..COUNT as u64 / 10 {
                rig.host.write(at(burst * 1000), &[0x5A; 10]).unwrap();
                let reads = rig.reads(at(burst * 1000 + 999));
                read += reads.into_iter().map(|(_, count)| count).sum::<usize>();
            }
            let statistics = rig.line.statistics();
            let counted = count(&statistics);
            assert!(expected.contains(&(counted as f64)), "{faults:?}: {counted}");
            assert_eq!(statistics.to_device, COUNT as u64);
            let arrived = COUNT as u64 + statistics.duplicated - statistics.lost;
            assert_eq!(read as u64, arrived);
            assert_eq!(rig.heard().len() as u64 == arrived, towards_device || arrived == 1000);
        }
    }
}

#[test]
fn a_device_that_is_never_content_does_not_stop_time() {
    struct Restless;
    impl LineDevice for Restless {
        fn receive(&mut self, _: u8, _: Instant) {}
        fn poll_transmit(&mut self, _: Instant) -> Option<u8> {
            None
        }
        fn poll_timeout(&self) -> Option<Instant> {
            Some(Instant::ZERO)
        }
        fn handle_timeout(&mut self, _: Instant) {}
    }
    let mut line = SerialLine::new(SETTINGS, None, Box::new(Restless));
    line.advance(at(1000));
    assert!(line.next_event().unwrap() > at(1000));
}

#[test]
fn a_line_that_hung_up_carries_nothing_either_way() {
    let mut rig = rig(None, Duration::from_micros(300));
    rig.host.write(at(0), b"ab").unwrap();
    rig.reads(at(5));
    rig.line.hang_up();
    let gone = Err(serial::LineError::Gone);
    assert_eq!(rig.host.write(at(10), b"c"), gone);
    rig.line.advance(at(10_000));
    assert_eq!(rig.heard().len(), 1, "the byte that was on the wire");
    assert_eq!(rig.host.read(at(10_000), &mut [0; 8]), gone);
}

/// Telegrams of one byte that reach the host undamaged, of five that the device sends back; then the bytes that the
/// device received.
fn undamaged(faults: LineFaults) -> ([bool; 5], usize) {
    let mut rig = rig(None, Duration::from_micros(300));
    rig.line.set_faults(&LineFaults { seed: 1, ..faults });
    let arrived = [0, 1, 2, 3, 4].map(|number| {
        let sent = 10_000 * number;
        rig.host.write(at(sent), b"x").unwrap();
        rig.line.advance(at(sent + 5000));
        let mut bytes = [0; 8];
        let count = rig.host.read(at(sent + 5000), &mut bytes).unwrap();
        rig.line.advance(at(sent + 9000));
        let late = rig.host.read(at(sent + 9000), &mut [0; 8]).unwrap();
        (&bytes[..count], late) == (b"x", 0)
    });
    (arrived, rig.heard().len())
}

#[test]
fn a_fault_with_a_count_damages_no_further_telegram() {
    let none = WireFaults::default();
    let stuck = |stuck| WireFaults { stuck: Some(stuck), ..none };
    let cases = [
        WireFaults { bit_error_rate: 1.0, ..none },
        WireFaults { tear: 1.0, ..none },
        WireFaults { duplicate: 1.0, ..none },
        stuck(Stuck::Silent),
        stuck(Stuck::At(0)),
        stuck(Stuck::Garbled),
    ];
    for to_host in cases {
        let faults = LineFaults { to_host, count: Some(2), ..LineFaults::default() };
        assert_eq!(undamaged(faults), ([false, false, true, true, true], 5), "{to_host:?}");
        assert_eq!(undamaged(LineFaults { count: None, ..faults }).0, [false; 5], "{to_host:?}");
        let again = LineFaults { count: Some(0), ..faults };
        assert_eq!(undamaged(again).0, [true; 5], "{to_host:?}");
    }
    let late = LineFaults { late: Duration::from_millis(7), count: Some(1), ..LineFaults::default() };
    assert_eq!(undamaged(late), ([false, true, true, true, true], 5));
}

#[test]
fn both_directions_of_a_fault_share_its_count() {
    let twice = WireFaults { duplicate: 1.0, ..WireFaults::default() };
    let faults = LineFaults { to_device: twice, to_host: twice, count: Some(1), ..LineFaults::default() };
    // The first request arrives twice, and both answers to it arrive once.
    assert_eq!(undamaged(faults), ([false, true, true, true, true], 6));
}

#[test]
fn a_fault_with_a_count_damages_a_telegram_as_a_whole() {
    let mut rig = rig(None, Duration::from_secs(1));
    let to_device = WireFaults { stuck: Some(Stuck::Silent), ..WireFaults::default() };
    rig.line.set_faults(&LineFaults { to_device, count: Some(1), ..LineFaults::default() });
    rig.host.write(at(0), b"lost").unwrap();
    rig.line.advance(at(5000));
    assert_eq!((rig.heard(), rig.line.damaged()), (&[][..], 1));
    rig.host.write(at(5000), b"here").unwrap();
    rig.line.advance(at(10_000));
    assert_eq!((rig.heard().len(), rig.line.damaged()), (4, 1));
}

#[test]
fn held_bytes_arrive_in_order_at_the_end_while_the_host_receives() {
    let mut rig = rig(None, Duration::ZERO);
    rig.line.set_faults(&LineFaults { held: true, ..LineFaults::default() });
    for number in 0..100 {
        let now = at(u64::from(number) * 1_000);
        assert_eq!(rig.host.write(now, &[number; 20]), Ok(20));
        rig.line.advance(now);
    }
    rig.line.inject(&[7], true, at(100_000));
    assert_eq!(rig.host.read(at(100_000), &mut [0; 8]), Ok(1));
    assert_eq!((rig.heard(), rig.line.damaged()), (&[][..], 1));
    rig.line.set_faults(&LineFaults::default());
    rig.host.write(at(100_000), &[200]).unwrap();
    rig.line.advance(at(100_000_000));
    let bytes: Vec<_> = rig.heard().iter().map(|(byte, _)| *byte).collect();
    let sent = (0..100).flat_map(|number| [number; 20]).chain([200]);
    assert_eq!(bytes, sent.collect::<Vec<_>>());
}
