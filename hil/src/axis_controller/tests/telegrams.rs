//! Reception of telegrams, and content and time of the answers.

use super::*;
use crate::{LineFaults, Stuck, WireFaults};

#[test]
fn nfv2_answers_are_the_bytes_of_the_line() {
    let mut kept = column();
    kept.counter = -1234;
    kept.synchronized = true;
    // Requests and answers. No request powers the drive.
    let cases: [(&[u8], &[u8]); 4] = [
        (
            &[0x23, 0x0E, 0xF1, 0x08, 0x14, 0x02, 0x64, 0x00, 0x1A, 0x00, 0x1B, 0x00, 0x1F, 0x00, 0xE0],
            &[
                0x23, 0x12, 0xED, 0x08, 0x1A, 0x04, 0x2E, 0xFB, 0xFF, 0xFF, 0x1B, 0x02, 0x00, 0x00, 0x1F, 0x02, 0x10,
                0x00,
            ],
        ),
        // Five bytes of prefix, followed by the requested status alone.
        (
            &[0, 0, 0, 0, 0, 0x23, 0x09, 0xF6, 0x08, 0x10, 0x01, 0x00, 0x1F, 0x00, 0],
            &[0x23, 0x08, 0xF7, 0x08, 0x1F, 0x02, 0x10, 0xC0],
        ),
        // Reset of the synchronised flag in error mode: executed, and the drive stays in error.
        (
            &[0x23, 0x0C, 0xF3, 0x08, 0x1E, 0x04, 0x02, 0x00, 0x00, 0x00, 0x1F, 0x00, 0],
            &[0x23, 0x08, 0xF7, 0x08, 0x1F, 0x02, 0x00, 0xC0],
        ),
        (&[0x23, 0x09, 0xF6, 0x08, 0x10, 0x01, 0x01, 0x1F, 0x00, 0], &[0x23, 0x08, 0xF7, 0x08, 0x1F, 0x02, 0x00, 0x00]),
    ];
    let mut rig = Rig::nfv2(&kept);
    for (request, answer) in cases {
        let with_crc = |bytes: &[u8]| {
            let start = bytes.iter().position(|&byte| byte == 0x23).unwrap();
            serial::nfv2::crc8(&bytes[start + 3..])
        };
        let mut request = request.to_vec();
        let last = request.len() - 1;
        request[last] = with_crc(&request[..last]);
        let mut expected = answer.to_vec();
        expected.push(with_crc(answer));
        assert_eq!(rig.exchange(&request), expected, "{request:02x?}");
    }
}

#[test]
fn hi_moxa_answers_are_the_bytes_of_the_line() {
    let mut kept = column();
    kept.counter = 70_000;
    kept.synchronized = true;
    let mut rig = Rig::hi_moxa(&kept);
    let cases: [(&[u8], [u8; 8]); 4] = [
        // Manual mode, with trailing garbage.
        (&[0, 0, 0, 0, 0x23, 0x9F, 0, 0, 0xAA, 0x55], [0x23, 0x80, 0, 0, 0x70, 0x11, 0x01, 0]),
        (&[0, 0, 0, 0, 0x23, 0x2F, 0x50, 0x46, 0, 0], [0x23, 0x80, 0, 0, 0x70, 0x11, 0x01, 0]),
        (&[0, 0, 0, 0, 0x23, 0x1F, 0, 0, 0, 0], [0x23, 0x00, 0, 0, 0x70, 0x11, 0x01, 0]),
        (&[0, 0, 0, 0, 0x23, 0x9F, 4, 0, 0, 0], [0x23, 0x50, 0, 0, 0x70, 0x11, 0x01, 0]),
    ];
    for (request, answer) in cases {
        assert_eq!(rig.exchange(request), answer, "{request:02x?}");
    }
}

#[test]
fn an_answer_ends_after_both_line_times_and_the_delay() {
    let line = Settings::AXIS_CONTROLLER;
    let mut config = column();
    config.answer_delay = Duration::from_micros(70);
    let old = hi_moxa::Request::Set(hi_moxa::Parameter::Synchronized(true)).encode();
    let new = frame(ADDRESS, &[Command::SetPwm(0)]);
    let cases = [(Rig::nfv2(&config.clone()), new, 19), (Rig::hi_moxa(&config), old.to_vec(), 8)];
    for (mut rig, request, length) in cases {
        for written in [0, 5_123_456, 13_000_001].map(Instant::from_nanos) {
            rig.host.write(written, &request).unwrap();
            let due = written + line.line_time(request.len()) + Duration::from_micros(70) + line.line_time(length);
            rig.world.advance(written + PERIOD);
            let mut into = [0; 64];
            let early = due - Duration::from_nanos(1);
            assert_eq!(rig.host.read(early, &mut into), Ok(length - 1));
            assert_eq!(rig.host.read(due, &mut into), Ok(1));
        }
    }
}

#[test]
fn several_requests_at_once_are_answered_in_order() {
    let mut rig = Rig::nfv2(&column());
    let one = frame(ADDRESS, &[Command::SetMisc(Command::SET_SYNCHRONIZED)]);
    let other = frame(9, &[Command::SetMode(Mode::Pwm)]);
    let everybody = frame(0xFF, &[Command::SetMode(Mode::Error)]);
    let last = frame(ADDRESS, &[]);
    let answer = rig.exchange(&[one, other, everybody, last].concat());
    assert_eq!(answer.len(), 2 * 19);
    assert_eq!(answer[16..18], [0x10, 0x00]);
    assert_eq!(answer[35..37], [0x10, 0xC0], "the broadcast was obeyed");
}

#[test]
fn what_it_does_not_understand_it_does_not_answer() {
    let mut rig = Rig::nfv2(&column());
    let good = frame(ADDRESS, &[]);
    let unknown = {
        let mut bytes = vec![0x23, 0x08, 0xF7, ADDRESS, 0x1F, 0x00, 0x99, 0x00];
        bytes.push(serial::nfv2::crc8(&bytes[3..]));
        bytes
    };
    let mut damaged = good.clone();
    damaged[5] ^= 0x10;
    let old = hi_moxa::Request::Set(hi_moxa::Parameter::MaxCurrent(18_000));
    let cases: [(&str, Vec<u8>); 8] = [
        ("unknown code beside a known one", unknown),
        ("damaged", damaged),
        ("speed", frame(ADDRESS, &[Command::SetSpeed(5)])),
        ("position", frame(ADDRESS, &[Command::SetMode(Mode::Position)])),
        ("other address", frame(9, &[])),
        ("the older telegram", old.encode_cyclic().to_vec()),
        ("zeros", vec![0; 300]),
        ("starts", vec![0x23; 300]),
    ];
    for (what, bytes) in cases {
        // A burst of 300 bytes takes longer than a period.
        assert_eq!(rig.exchange(&bytes), [0_u8; 0], "{what}");
        rig.now += 3 * PERIOD;
        assert_eq!(rig.exchange(&good).len(), 19, "after {what}");
    }
}

#[test]
fn random_noise_is_never_answered_without_a_frame_in_it() {
    let mut noise = crate::plant::Noise::new(11);
    let mut rig = Rig::nfv2(&column());
    for _ in 0..200 {
        // Without the start byte the bytes contain no frame.
        let bytes: Vec<u8> =
            std::iter::repeat_with(|| noise.bits() as u8).filter(|&byte| byte != 0x23).take(100).collect();
        assert_eq!(rig.exchange(&bytes), [0_u8; 0]);
    }
    assert_eq!(rig.cycle(&[]).status, Status(0));
}

#[test]
fn a_torn_request_does_not_cost_the_one_behind_it() {
    // NFv2 finds its frame with or without a pause.
    let request = frame(ADDRESS, &[Command::SetMisc(Command::SET_SYNCHRONIZED)]);
    for offset in 0..request.len() {
        let mut rig = Rig::nfv2(&column());
        let torn = [&request[..offset], &request].concat();
        assert_eq!(rig.exchange(&torn).len(), 19, "at once, torn at {offset}");
        assert_eq!(rig.exchange(&request[..offset]), [0_u8; 0]);
        assert_eq!(rig.exchange(&request).len(), 19, "torn at {offset}");
        // The end of a frame alone is no frame.
        if offset > 0 {
            assert_eq!(rig.exchange(&request[offset..]), [0_u8; 0]);
            assert_eq!(rig.exchange(&request).len(), 19, "tail from {offset}");
        }
    }
    // The older protocol needs the pause.
    let request = hi_moxa::Request::Set(hi_moxa::Parameter::Synchronized(true)).encode();
    for offset in 0..request.len() {
        let mut rig = Rig::hi_moxa(&column());
        assert_eq!(rig.exchange(&request[..offset]), [0_u8; 0]);
        assert_eq!(rig.exchange(&request).len(), 8, "torn at {offset}");
        if offset > 0 {
            assert_eq!(rig.exchange(&request[offset..]), [0_u8; 0]);
            assert_eq!(rig.exchange(&request).len(), 8, "tail from {offset}");
        }
        // Without a pause the drive loses at most one telegram.
        let torn = [&request[..offset], &request].concat();
        let answers = rig.exchange(&torn).len() / 8;
        assert!((1..=2).contains(&answers), "{answers}");
    }
}

#[test]
fn a_pause_ends_a_request_whose_length_is_wrong() {
    let mut rig = Rig::nfv2(&column());
    // The beginning of a frame of 256 bytes, which would swallow a dozen valid frames.
    assert_eq!(rig.exchange(&[0x23, 0xFF, 0x00, ADDRESS]), [0_u8; 0]);
    assert!(PERIOD > GAP);
    assert_eq!(rig.cycle(&[]).position, 0);
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let run = || {
        let mut rig = Rig::nfv2(&column());
        rig.cycle(&[Command::SetMode(Mode::Pwm)]);
        (0..300_i16).flat_map(|k| rig.exchange(&frame(ADDRESS, &[Command::SetPwm(k % 97 - 30)]))).collect::<Vec<u8>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn the_older_drive_does_not_answer_what_is_no_request() {
    let good = hi_moxa::Request::Set(hi_moxa::Parameter::Synchronized(true)).encode();
    let position = hi_moxa::Request::Drive { mode: hi_moxa::Mode::Position, value: 5, latch_index: false };
    let newer = [&[0; 5][..], &frame(ADDRESS, &[Command::SetPwm(100)])].concat();
    let cases: [(&str, &[u8]); 6] = [
        ("the newer telegram", &newer),
        ("position", &position.encode_cyclic()),
        ("unknown command", &[0, 0, 0, 0, 0x23, 0x03, 0, 0, 0, 0]),
        ("short preamble", &[1, 0, 0, 0, 0x23, 0x1F, 1, 0, 0, 0]),
        ("zeros", &[0; 100]),
        ("spaces", &[0x20; 100]),
    ];
    let mut rig = Rig::hi_moxa(&column());
    for (what, bytes) in cases {
        assert_eq!(rig.exchange(bytes), [0_u8; 0], "{what}");
        assert_eq!(rig.exchange(&good).len(), 8, "after {what}");
    }
}

#[test]
fn a_bad_line_costs_telegrams_and_not_the_drive() {
    let wire = WireFaults { bit_error_rate: 0.002, tear: 0.005, duplicate: 0.005, stuck: None };
    for seed in 0..4 {
        let faults = LineFaults { seed, to_device: wire, ..LineFaults::default() };
        let mut rig = Rig::nfv2(&column());
        let request = frame(ADDRESS, &[Command::SetMisc(Command::SET_SYNCHRONIZED)]);
        rig.world.line_mut(rig.line).set_faults(&faults);
        let answered = (0..1000).filter(|_| !rig.exchange(&request).is_empty()).count();
        // 21 bytes of 8 bits in each of two directions: about a third of the exchanges is lost.
        assert!((500..800).contains(&answered), "seed {seed}: {answered}");
        rig.world.line_mut(rig.line).set_faults(&LineFaults::default());
        for _ in 0..10 {
            assert_eq!(rig.exchange(&request).len(), 19, "seed {seed}");
        }
    }
}

#[test]
fn a_stuck_line_is_silence() {
    use Stuck::{At, Silent};
    for stuck in [Silent, At(0x00), At(0xFF)].map(Some) {
        let hangs = WireFaults { stuck, ..WireFaults::default() };
        for to_device in [true, false] {
            let mut faults = LineFaults::default();
            if to_device {
                faults.to_device = hangs;
            } else {
                faults.to_host = hangs;
            }
            let mut rig = Rig::nfv2(&column());
            rig.world.line_mut(rig.line).set_faults(&faults);
            let answer = rig.exchange(&frame(ADDRESS, &[]));
            let expected = match stuck {
                Some(At(level)) if !to_device => vec![level; 19],
                _ => vec![],
            };
            assert_eq!(answer, expected, "{faults:?}");
        }
    }
}

#[test]
fn after_any_noise_and_a_pause_a_drive_works() {
    for seed in 0..50 {
        let mut noise = crate::plant::Noise::new(seed);
        // Random bytes with many that begin requests.
        let bytes: Vec<u8> = std::iter::repeat_with(|| match noise.bits() % 8 {
            0 | 1 => 0x23,
            2..=4 => 0x00,
            _ => noise.bits() as u8,
        })
        .take(1000)
        .collect();
        let mut rig = Rig::nfv2(&column());
        rig.exchange(&bytes);
        rig.now += 10 * PERIOD;
        rig.exchange(&[]);
        rig.cycle(&[]);
        let mut rig = Rig::hi_moxa(&column());
        rig.exchange(&bytes);
        rig.now += 10 * PERIOD;
        rig.exchange(&[]);
        rig.old_cycle(hi_moxa::Request::Set(hi_moxa::Parameter::Synchronized(true)));
    }
}
