//! Golden exchanges over a line, as a host's bytes and what comes back when.

use std::time::Duration;

use can::Instant;
use serial::nfv2::{Answer, Command, Frame, FrameBuilder, Gains, Mode, Status};
use serial::{Line, Settings, VirtualLine, hi_moxa};

use super::{AxisControllerConfig, GAP, HiMoxaAxisController, Nfv2AxisController};
use crate::{AxisConfig, Irp6Axis, LineDevice, LineFaults, LineId, Stuck, WireFaults, World};

const PERIOD: Duration = Duration::from_millis(2);
const ADDRESS: u8 = 8;
const READS: [Command; 3] = [
    Command::ReadPosition,
    Command::ReadCurrent,
    Command::ReadStatus,
];

struct Rig {
    world: World,
    line: LineId,
    host: VirtualLine,
    now: Instant,
}

impl Rig {
    fn new(device: Box<dyn LineDevice>) -> Self {
        let mut world = World::new();
        let line = world.add_line(Settings::AXIS_CONTROLLER, None, device);
        let host = world.host_line(line, 4096);
        Self {
            world,
            line,
            host,
            now: Instant::ZERO,
        }
    }

    fn nfv2(config: AxisControllerConfig) -> Self {
        Self::new(Box::new(Nfv2AxisController::new(ADDRESS, config)))
    }

    fn hi_moxa(config: AxisControllerConfig) -> Self {
        Self::new(Box::new(HiMoxaAxisController::new(config)))
    }

    /// Writes now, and returns what has come back a period later.
    fn exchange(&mut self, request: &[u8]) -> Vec<u8> {
        assert_eq!(self.host.write(self.now, request), Ok(request.len()));
        self.now += PERIOD;
        self.world.advance(self.now);
        let mut into = [0; 4096];
        let count = self.host.read(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    /// One cycle with NFv2: `commands`, then the three reads.
    fn cycle(&mut self, commands: &[Command]) -> Reading {
        let answer = self.exchange(&frame(ADDRESS, commands));
        let frame = Frame::parse(&answer).unwrap_or_else(|| panic!("no frame: {answer:02x?}"));
        assert_eq!(frame.address, ADDRESS);
        let answers: Result<Vec<_>, _> = frame.answers().collect();
        match answers.as_deref() {
            Ok(
                &[
                    Answer::Position(position),
                    Answer::Current(current),
                    Answer::Status(status),
                ],
            ) => Reading {
                position,
                current,
                status,
            },
            other => panic!("{other:?}"),
        }
    }

    /// The same with the older telegrams.
    fn old_cycle(&mut self, request: hi_moxa::Request) -> hi_moxa::Answer {
        let answer = self.exchange(&request.encode_cyclic());
        hi_moxa::Answer::decode(answer.try_into().expect("one answer"))
    }

    fn device(&self) -> &Nfv2AxisController {
        self.world.line_device(self.line).expect("it is one")
    }
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    position: i32,
    current: i16,
    status: Status,
}

impl Reading {
    fn is(&self, bit: u16) -> bool {
        self.status.any(bit)
    }
}

fn frame(address: u8, commands: &[Command]) -> Vec<u8> {
    let all = commands.iter().chain(&READS);
    let mut builder = all.fold(FrameBuilder::new(address), |frame, command| {
        frame.command(*command)
    });
    builder.finish().expect("it fits").to_vec()
}

fn column() -> AxisControllerConfig {
    AxisControllerConfig::new(AxisConfig::irp6(Irp6Axis::Column))
}

#[test]
fn nfv2_answers_are_the_bytes_of_the_line() {
    let mut kept = column();
    kept.counter = -1234;
    kept.synchronized = true;
    // Requests and answers, without powering anything.
    let cases: [(&[u8], &[u8]); 4] = [
        (
            &[
                0x23, 0x0E, 0xF1, 0x08, 0x14, 0x02, 0x64, 0x00, 0x1A, 0x00, 0x1B, 0x00, 0x1F, 0x00,
                0xE0,
            ],
            &[
                0x23, 0x12, 0xED, 0x08, 0x1A, 0x04, 0x2E, 0xFB, 0xFF, 0xFF, 0x1B, 0x02, 0x00, 0x00,
                0x1F, 0x02, 0x10, 0x00,
            ],
        ),
        // Five bytes of prefix, and only the status asked for.
        (
            &[
                0, 0, 0, 0, 0, 0x23, 0x09, 0xF6, 0x08, 0x10, 0x01, 0x00, 0x1F, 0x00, 0,
            ],
            &[0x23, 0x08, 0xF7, 0x08, 0x1F, 0x02, 0x10, 0x80],
        ),
        // Reset synchronised in error: done, and still in error.
        (
            &[
                0x23, 0x0C, 0xF3, 0x08, 0x1E, 0x04, 0x02, 0x00, 0x00, 0x00, 0x1F, 0x00, 0,
            ],
            &[0x23, 0x08, 0xF7, 0x08, 0x1F, 0x02, 0x00, 0x80],
        ),
        (
            &[0x23, 0x09, 0xF6, 0x08, 0x10, 0x01, 0x01, 0x1F, 0x00, 0],
            &[0x23, 0x08, 0xF7, 0x08, 0x1F, 0x02, 0x00, 0x00],
        ),
    ];
    let mut rig = Rig::nfv2(kept);
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
    assert_eq!(rig.device().heard().obeyed, 4);
}

#[test]
fn hi_moxa_answers_are_the_bytes_of_the_line() {
    let mut kept = column();
    kept.counter = 70_000;
    kept.synchronized = true;
    let mut rig = Rig::hi_moxa(kept);
    let cases: [(&[u8], [u8; 8]); 4] = [
        // Manual, and its trailing garbage.
        (
            &[0, 0, 0, 0, 0x23, 0x9F, 0, 0, 0xAA, 0x55],
            [0x23, 0x80, 0, 0, 0x70, 0x11, 0x01, 0],
        ),
        (
            &[0, 0, 0, 0, 0x23, 0x2F, 0x50, 0x46, 0, 0],
            [0x23, 0x80, 0, 0, 0x70, 0x11, 0x01, 0],
        ),
        (
            &[0, 0, 0, 0, 0x23, 0x1F, 0, 0, 0, 0],
            [0x23, 0x00, 0, 0, 0x70, 0x11, 0x01, 0],
        ),
        (
            &[0, 0, 0, 0, 0x23, 0x9F, 4, 0, 0, 0],
            [0x23, 0x40, 0, 0, 0x70, 0x11, 0x01, 0],
        ),
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
    let cases = [
        (Rig::nfv2(config.clone()), new, 19),
        (Rig::hi_moxa(config), old.to_vec(), 8),
    ];
    for (mut rig, request, length) in cases {
        for written in [0, 5_123_456, 13_000_001].map(Instant::from_nanos) {
            rig.host.write(written, &request).unwrap();
            let due = written
                + line.line_time(request.len())
                + Duration::from_micros(70)
                + line.line_time(length);
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
    let mut rig = Rig::nfv2(column());
    let one = frame(ADDRESS, &[Command::SetMisc(Command::SET_SYNCHRONIZED)]);
    let other = frame(9, &[Command::SetMode(Mode::Pwm)]);
    let everybody = frame(0xFF, &[Command::SetMode(Mode::Error)]);
    let last = frame(ADDRESS, &[]);
    let answer = rig.exchange(&[one, other, everybody, last].concat());
    assert_eq!(answer.len(), 2 * 19);
    assert_eq!(answer[16..18], [0x10, 0x00]);
    assert_eq!(answer[35..37], [0x10, 0x80], "the broadcast was obeyed");
    let heard = rig.device().heard();
    assert_eq!((heard.obeyed, heard.foreign, heard.skipped), (3, 1, 0));
}

#[test]
fn what_it_does_not_understand_it_does_not_answer() {
    let mut rig = Rig::nfv2(column());
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
        (
            "position",
            frame(ADDRESS, &[Command::SetMode(Mode::Position)]),
        ),
        ("other address", frame(9, &[])),
        ("the older telegram", old.encode_cyclic().to_vec()),
        ("zeros", vec![0; 300]),
        ("starts", vec![0x23; 300]),
    ];
    for (what, bytes) in cases {
        // A burst of 300 bytes takes longer than a period.
        assert_eq!(rig.exchange(&bytes), [], "{what}");
        rig.now += 3 * PERIOD;
        assert_eq!(rig.exchange(&good).len(), 19, "after {what}");
    }
    let heard = rig.device().heard();
    assert_eq!((heard.refused, heard.foreign, heard.damaged), (3, 1, 1));
    assert!(heard.skipped >= 600);
}

#[test]
fn random_noise_is_never_answered_without_a_frame_in_it() {
    let mut noise = crate::plant::Noise::new(11);
    let mut rig = Rig::nfv2(column());
    for _ in 0..200 {
        // Without the start byte there is no frame.
        let bytes: Vec<u8> = std::iter::repeat_with(|| noise.bits() as u8)
            .filter(|&byte| byte != 0x23)
            .take(100)
            .collect();
        assert_eq!(rig.exchange(&bytes), []);
    }
    assert_eq!(rig.cycle(&[]).status, Status(0));
}

#[test]
fn a_torn_request_does_not_cost_the_one_behind_it() {
    // NFv2 finds its frame whether or not there was a pause.
    let request = frame(ADDRESS, &[Command::SetMisc(Command::SET_SYNCHRONIZED)]);
    for offset in 0..request.len() {
        let mut rig = Rig::nfv2(column());
        let torn = [&request[..offset], &request].concat();
        assert_eq!(rig.exchange(&torn).len(), 19, "at once, torn at {offset}");
        assert_eq!(rig.exchange(&request[..offset]), []);
        assert_eq!(rig.exchange(&request).len(), 19, "torn at {offset}");
        assert_eq!(rig.device().heard().obeyed, 2);
        // Its end alone is nothing either.
        if offset > 0 {
            assert_eq!(rig.exchange(&request[offset..]), []);
            assert_eq!(rig.exchange(&request).len(), 19, "tail from {offset}");
        }
    }
    // The older telegram needs the pause.
    let request = hi_moxa::Request::Set(hi_moxa::Parameter::Synchronized(true)).encode();
    for offset in 0..request.len() {
        let mut rig = Rig::hi_moxa(column());
        assert_eq!(rig.exchange(&request[..offset]), []);
        assert_eq!(rig.exchange(&request).len(), 8, "torn at {offset}");
        if offset > 0 {
            assert_eq!(rig.exchange(&request[offset..]), []);
            assert_eq!(rig.exchange(&request).len(), 8, "tail from {offset}");
        }
        // Without one the drive is at a loss for a telegram at most.
        let torn = [&request[..offset], &request].concat();
        let answers = rig.exchange(&torn).len() / 8;
        assert!((1..=2).contains(&answers), "{answers}");
    }
}

#[test]
fn a_pause_ends_a_request_whose_length_is_wrong() {
    let mut rig = Rig::nfv2(column());
    // The beginning of a frame of 256 bytes, which would swallow a dozen good ones.
    assert_eq!(rig.exchange(&[0x23, 0xFF, 0x00, ADDRESS]), []);
    assert!(PERIOD > GAP);
    assert_eq!(rig.cycle(&[]).position, 0);
    assert_eq!(rig.device().heard().skipped, 4);
}

#[test]
fn pulse_widths_and_currents_drive_the_motor_only_in_their_modes() {
    // Mode, set-point, and whether it moves.
    // Each would move the axis, without dry friction, if it were taken for the other.
    let pwm = Command::SetPwm(200);
    let current = Command::SetCurrent(200);
    let cases = [
        (Mode::Manual, pwm, false),
        (Mode::Manual, current, false),
        (Mode::Pwm, pwm, true),
        (Mode::Pwm, current, false),
        (Mode::SyncPwm, pwm, true),
        (Mode::Current, current, true),
        (Mode::Current, pwm, false),
        (Mode::SyncCurrent, current, true),
        (Mode::Error, pwm, false),
    ];
    for (mode, set_point, moves) in cases {
        let mut config = column();
        if let crate::PlantConfig::Physical(motor) = &mut config.axis.plant {
            motor.friction = crate::plant::FrictionConfig::NONE;
        }
        let mut rig = Rig::nfv2(config);
        rig.cycle(&[Command::SetMode(mode), set_point]);
        let before = rig.cycle(&[]).position;
        for _ in 0..50 {
            rig.cycle(&[]);
        }
        let after = rig.cycle(&[]);
        assert_eq!(
            after.position - before > 20,
            moves,
            "{mode:?} {set_point:?}"
        );
        assert_eq!(after.is(Status::ERROR), mode == Mode::Error);
    }
}

#[test]
fn a_pulse_width_is_its_share_of_48_volts() {
    let mut rig = Rig::nfv2(column());
    rig.cycle(&[Command::SetMode(Mode::Pwm)]);
    // Ramped, since a step from rest would trip.
    for pwm in 0..=100 {
        rig.cycle(&[Command::SetPwm(pwm)]);
    }
    for _ in 0..500 {
        rig.cycle(&[]);
    }
    let (start, current) = {
        let reading = rig.cycle(&[]);
        (reading.position, f64::from(reading.current) * 1e-3)
    };
    for _ in 0..499 {
        rig.cycle(&[]);
    }
    let turns = f64::from(rig.cycle(&[]).position - start) / 4000.0;
    let speed = turns * std::f64::consts::TAU;
    // 4.8 V less the winding's share, over 0.105 V·s/rad.
    let expected = (4.8 - 0.6 * current) / 0.105;
    assert!(
        (speed - expected).abs() < 0.02 * expected,
        "{speed} {expected}"
    );
}

#[test]
fn the_drives_own_loop_settles_on_the_current_within_two_milliseconds() {
    for axis in Irp6Axis::ALL {
        let mut config = AxisControllerConfig::new(AxisConfig::irp6(axis));
        // Held, so that there is no back-EMF, and with a trip out of the way.
        if let crate::PlantConfig::Physical(motor) = &mut config.axis.plant {
            motor.friction.stiction = 100.0;
            motor.friction.coulomb = 100.0;
        }
        let asked = (config.axis.amplifier.max_current * 500.0) as i16;
        let mut rig = Rig::nfv2(config);
        rig.cycle(&[Command::SetMode(Mode::Current), Command::SetCurrent(asked)]);
        rig.cycle(&[]);
        let read = rig.cycle(&[]).current;
        let off = (f64::from(read) / f64::from(asked) - 1.0).abs();
        assert!(off < 0.05, "{axis:?}: {read} mA for {asked}");
    }
}

#[test]
fn other_gains_make_another_loop() {
    let mut rig = Rig::nfv2(column());
    let weak = Gains {
        p: 3,
        i: 3,
        d: 0,
        t: 0,
    };
    rig.cycle(&[
        Command::SetCurrentRegulator(weak),
        Command::SetMode(Mode::Current),
        Command::SetCurrent(5000),
    ]);
    let read = rig.cycle(&[]).current;
    assert!((0..1000).contains(&read), "{read} mA after 2 ms");
}

#[test]
fn over_current_is_latched_until_manual_mode() {
    let mut rig = Rig::nfv2(column());
    let go = [Command::SetMode(Mode::Pwm), Command::SetPwm(300)];
    rig.cycle(&[Command::SetMaxCurrent(5000)]);
    rig.cycle(&go);
    // 14.4 V through 0.6 Ω at rest would be 24 A.
    let tripped = rig.cycle(&[]);
    assert!(tripped.is(Status::OVERCURRENT), "{tripped:?}");
    let tripped = rig.cycle(&go);
    assert!(tripped.is(Status::OVERCURRENT) && tripped.current == 0);
    let cleared = rig.cycle(&[Command::SetMode(Mode::Manual)]);
    assert!(!cleared.is(Status::OVERCURRENT));
    // With more patience it runs.
    rig.cycle(&[Command::SetMaxCurrent(25_000)]);
    rig.cycle(&go);
    for _ in 0..20 {
        assert!(!rig.cycle(&[]).is(Status::OVERCURRENT));
    }
}

#[test]
fn a_limit_switch_stops_what_runs_into_it_and_lets_it_out() {
    for (start, sign, bit) in [
        (449.0, 1, Status::UPPER_LIMIT),
        (-469.0, -1, Status::LOWER_LIMIT),
    ] {
        for current in [false, true] {
            let mut config = column();
            config.axis.start_angle = start;
            let mut rig = Rig::nfv2(config);
            let set = |value: i16| {
                if current {
                    Command::SetCurrent(sign * 15 * value)
                } else {
                    Command::SetPwm(sign * value)
                }
            };
            let mode = if current { Mode::Current } else { Mode::Pwm };
            rig.cycle(&[Command::SetMode(mode), set(100)]);
            for _ in 0..300 {
                rig.cycle(&[]);
            }
            let stopped = rig.cycle(&[]);
            assert!(stopped.is(bit), "{stopped:?}");
            let device = rig.device();
            // The switch closes a radian from the start, the buffer begins three further on.
            let beyond = f64::from(sign) * (device.axis().angle() - start) - 1.0;
            assert!((0.0..3.0).contains(&beyond), "{beyond} rad into the switch");
            assert_eq!(rig.cycle(&[]).position, stopped.position, "it stands");
            rig.cycle(&[set(-100)]);
            for _ in 0..300 {
                rig.cycle(&[]);
            }
            assert!(!rig.cycle(&[]).is(bit), "it came out");
        }
    }
}

#[test]
fn a_set_point_stays_without_a_watchdog_and_ends_with_one() {
    for watchdog in [None, Some(Duration::from_millis(20))] {
        let mut config = column();
        config.watchdog = watchdog;
        let mut rig = Rig::nfv2(config);
        rig.cycle(&[Command::SetMode(Mode::Pwm), Command::SetPwm(100)]);
        // The host falls silent.
        rig.now += Duration::from_millis(500);
        let before = rig.cycle(&[]).position;
        rig.now += Duration::from_millis(100);
        let after = rig.cycle(&[]).position;
        assert_eq!(after - before > 100, watchdog.is_none(), "{watchdog:?}");
    }
}

#[test]
fn a_lost_supply_is_a_power_stage_fault_until_manual_mode() {
    let mut rig = Rig::nfv2(column());
    rig.cycle(&[Command::SetMode(Mode::Pwm), Command::SetPwm(100)]);
    let supply = |rig: &mut Rig, on| {
        let line = rig.line;
        let device: &mut Nfv2AxisController = rig.world.line_device_mut(line).unwrap();
        device.set_supply(on);
    };
    let manual = [Command::SetMode(Mode::Manual)];
    supply(&mut rig, false);
    assert!(rig.cycle(&[]).is(Status::POWER_STAGE_FAULT));
    assert!(
        rig.cycle(&manual).is(Status::POWER_STAGE_FAULT),
        "still off"
    );
    supply(&mut rig, true);
    assert!(rig.cycle(&[]).is(Status::POWER_STAGE_FAULT));
    assert!(!rig.cycle(&manual).is(Status::POWER_STAGE_FAULT));
}

/// The homing cycle by hand: towards the switch, back off it with the index armed, until the counter
/// was zeroed. `step` takes a pulse width and whether the index is armed, and says whether the switch
/// is closed, the index came, and where the counter is.
fn home(mut step: impl FnMut(i16, bool) -> (bool, bool, i32)) {
    let mut until = |pwm, armed, done: fn((bool, bool, i32)) -> bool| {
        (0..5000)
            .map(|_| step(pwm, armed))
            .find(|&seen| done(seen))
            .expect("it gets there")
    };
    let (_, index, _) = until(-60, false, |(switch, ..)| switch);
    assert!(!index);
    for _ in 0..250 {
        until(0, false, |_| true);
    }
    let (_, index, _) = until(40, true, |(switch, ..)| !switch);
    assert!(!index, "the index lies 2 rad beyond the edge");
    let (_, _, position) = until(40, true, |(_, index, _)| index);
    assert!((0..200).contains(&position), "zeroed {position} counts ago");
    until(0, false, |(_, index, _)| !index);
}

#[test]
fn homing_by_hand_zeroes_the_counter_at_the_index() {
    let mut rig = Rig::nfv2(column());
    rig.cycle(&[Command::SetMode(Mode::Pwm)]);
    home(|pwm, armed| {
        let mode = if armed { Mode::SyncPwm } else { Mode::Pwm };
        let reading = rig.cycle(&[Command::SetMode(mode), Command::SetPwm(pwm)]);
        (
            reading.is(Status::HOME_SWITCH),
            reading.is(Status::INDEX),
            reading.position,
        )
    });
    let referenced = |rig: &mut Rig| {
        let reading = rig.cycle(&[Command::SetPwm(0)]);
        assert!(reading.is(Status::SYNCHRONIZED));
        // The axis says where it truly is: the index lies at -15.9 rad.
        let truth = (rig.device().axis().angle() + 15.9) * 4000.0 / std::f64::consts::TAU;
        assert!(
            (f64::from(reading.position) - truth).abs() < 2.0,
            "{} for {truth}",
            reading.position
        );
    };
    for _ in 0..100 {
        rig.cycle(&[Command::SetPwm(0)]);
    }
    referenced(&mut rig);
    // The host restarts: the drive has not noticed.
    rig.host = rig.world.host_line(rig.line, 64);
    referenced(&mut rig);
}

#[test]
fn homing_by_hand_works_with_the_older_telegrams() {
    let mut rig = Rig::hi_moxa(column());
    home(|value, latch_index| {
        let answer = rig.old_cycle(hi_moxa::Request::Drive {
            mode: hi_moxa::Mode::Pwm,
            value,
            latch_index,
        });
        let is = |bit| answer.flags.any(bit);
        (
            is(hi_moxa::Flags::HOME_SWITCH),
            is(hi_moxa::Flags::INDEX),
            answer.position,
        )
    });
    let state = rig.old_cycle(hi_moxa::Request::Set(hi_moxa::Parameter::DriverMode(
        hi_moxa::DriverMode::Manual,
    )));
    assert_eq!(state.flags.0, hi_moxa::Flags::SYNCHRONIZED);
}

#[test]
fn the_regression_model_takes_currents_and_pulse_widths() {
    let settle = |commands: &[Command]| {
        let config = AxisControllerConfig::new(AxisConfig::wut(Irp6Axis::Column));
        let mut rig = Rig::nfv2(config);
        rig.cycle(commands);
        let before = (0..100).map(|_| rig.cycle(&[]).position).last();
        let turns = f64::from(rig.cycle(&[]).position - before.unwrap()) / 4000.0;
        turns * std::f64::consts::TAU / PERIOD.as_secs_f64()
    };
    // 10 A · 0.105 N·m/A against 0.02 N·m·s/rad.
    let speed = settle(&[Command::SetMode(Mode::Current), Command::SetCurrent(10_000)]);
    assert!((speed - 52.5).abs() < 1.0, "{speed}");
    // (4.8 V - 0.105 w) / 0.6 · 0.105 = 0.02 w.
    let speed = settle(&[Command::SetMode(Mode::Pwm), Command::SetPwm(100)]);
    let expected = 4.8 * 0.105 / (0.02 * 0.6 + 0.105 * 0.105);
    assert!((speed - expected).abs() < 1.0, "{speed} for {expected}");
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let run = || {
        let mut rig = Rig::nfv2(column());
        rig.cycle(&[Command::SetMode(Mode::Pwm)]);
        (0..300_i16)
            .flat_map(|k| rig.exchange(&frame(ADDRESS, &[Command::SetPwm(k % 97 - 30)])))
            .collect::<Vec<u8>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn the_older_drive_does_not_answer_what_is_no_request() {
    let good = hi_moxa::Request::Set(hi_moxa::Parameter::Synchronized(true)).encode();
    let position = hi_moxa::Request::Drive {
        mode: hi_moxa::Mode::Position,
        value: 5,
        latch_index: false,
    };
    let newer = [&[0; 5][..], &frame(ADDRESS, &[Command::SetPwm(100)])].concat();
    let cases: [(&str, &[u8]); 6] = [
        ("the newer telegram", &newer),
        ("position", &position.encode_cyclic()),
        ("unknown command", &[0, 0, 0, 0, 0x23, 0x03, 0, 0, 0, 0]),
        ("short preamble", &[1, 0, 0, 0, 0x23, 0x1F, 1, 0, 0, 0]),
        ("zeros", &[0; 100]),
        ("spaces", &[0x20; 100]),
    ];
    let mut rig = Rig::hi_moxa(column());
    for (what, bytes) in cases {
        assert_eq!(rig.exchange(bytes), [], "{what}");
        assert_eq!(rig.exchange(&good).len(), 8, "after {what}");
    }
    let device: &HiMoxaAxisController = rig.world.line_device(rig.line).unwrap();
    assert_eq!((device.heard().obeyed, device.heard().refused), (6, 3));
}

#[test]
fn a_bad_line_costs_telegrams_and_not_the_drive() {
    let wire = WireFaults {
        bit_error_rate: 0.002,
        tear: 0.005,
        duplicate: 0.005,
        stuck: None,
    };
    for seed in 0..4 {
        let faults = LineFaults {
            seed,
            to_device: wire,
            to_host: WireFaults::default(),
        };
        let mut rig = Rig::nfv2(column());
        let request = frame(ADDRESS, &[Command::SetMisc(Command::SET_SYNCHRONIZED)]);
        rig.world.set_line_faults(rig.line, &faults);
        let answered = (0..1000)
            .filter(|_| !rig.exchange(&request).is_empty())
            .count();
        // 21 bytes of 8 bits and two chances to be hit: a third or so is lost.
        assert!((500..800).contains(&answered), "seed {seed}: {answered}");
        let heard = rig.device().heard();
        assert!(heard.damaged > 50 && heard.skipped > 1000, "{heard:?}");
        // A CRC of five effective bits lets one of 32 damaged frames through.
        assert!(heard.obeyed - answered as u64 <= 20, "{heard:?}");
        rig.world.set_line_faults(rig.line, &LineFaults::default());
        for _ in 0..10 {
            assert_eq!(rig.exchange(&request).len(), 19, "seed {seed}");
        }
    }
}

#[test]
fn a_stuck_line_is_silence() {
    use Stuck::{At, Silent};
    for stuck in [Silent, At(0x00), At(0xFF)].map(Some) {
        let hangs = WireFaults {
            stuck,
            ..WireFaults::default()
        };
        for to_device in [true, false] {
            let mut faults = LineFaults::default();
            if to_device {
                faults.to_device = hangs;
            } else {
                faults.to_host = hangs;
            }
            let mut rig = Rig::nfv2(column());
            rig.world.set_line_faults(rig.line, &faults);
            let answer = rig.exchange(&frame(ADDRESS, &[]));
            let expected = match stuck {
                Some(At(level)) if !to_device => vec![level; 19],
                _ => vec![],
            };
            assert_eq!(answer, expected, "{faults:?}");
            assert_eq!(rig.device().heard().obeyed, u64::from(!to_device));
        }
    }
}
