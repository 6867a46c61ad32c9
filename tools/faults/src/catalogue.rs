//! Faults of the table: kind, wires and phases in which each fault has a meaning, and the expected detectors.

use std::time::Duration;

use mrroc::scenario::{FaultKind, FaultNumbers};

use super::bounds::Within;
use super::detector::Detector;
use super::origin::{Flaw, Missed, Origin};
use super::phase::FaultPhase;

/// Wire of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wire {
    Can,
    /// Serial lines with NFv2 telegrams.
    Nfv2,
    /// Serial lines with the older telegrams.
    HiMoxa,
}

/// Expected end of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expected {
    /// The motion goes on to its end.
    Tolerated,
    /// One of these detectors stops the robot.
    By(&'static [Detector]),
    /// The motion goes on, or one of these detectors stops the robot: the seed decides.
    Either(&'static [Detector]),
}

/// A fault of the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaultCase {
    /// Name in the table.
    pub(super) name: &'static str,
    pub(super) origin: Origin,
    /// The fault strikes all axes of the robot, which is switched off by an order at the same time.
    pub(super) disables: bool,
    /// The fault strikes all axes of the robot.
    pub(super) all_axes: bool,
    /// The motion has the greatest speed that limits and room permit.
    pub(super) at_top_speed: bool,
    /// Jump of a counter, as a multiple of the smallest step that the drive group finds.
    pub(super) jump: Option<f64>,
    /// The soak plans the fault. Without the others, the plans of its published runs stay as they are.
    pub(super) in_soak: bool,
    /// Wires on which the fault is played.
    pub(super) wires: &'static [Wire],
    /// Greatest number of damaged frames.
    pub(super) count: Option<u32>,
    /// Duration; `None` until the robot is brought back.
    pub(super) lasts: Option<Duration>,
    /// Duration of the observation.
    pub(super) observed_for: Duration,
    /// Changes the numbers of the fault.
    pub(super) adapt: fn(&mut FaultNumbers),
    /// Expected end of a row on a wire in a phase, or the reason why the phase has no meaning.
    pub(super) expected: fn(Wire, FaultPhase) -> Result<Expected, &'static str>,
    pub(super) within: Within,
}

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

use Detector as D;
use Expected::{By, Either, Tolerated};
use FaultKind as K;
use FaultPhase as P;
use Wire::{Can, HiMoxa, Nfv2};

const BOTH: &[Wire] = &[Can, Nfv2, HiMoxa];
const CAN: &[Wire] = &[Can];
const SERIAL: &[Wire] = &[Nfv2, HiMoxa];

/// Detectors of an axis that does not follow. Drives on CAN have a following error of their own.
const NOT_FOLLOWING: &[Detector] = &[D::FollowingError, D::DriveStatus, D::Runaway, D::Frozen, D::Plausibility];

const USUAL: FaultCase = FaultCase {
    name: "",
    origin: Origin::Emulated(K::Lost),
    disables: false,
    all_axes: false,
    at_top_speed: false,
    jump: None,
    in_soak: true,
    wires: BOTH,
    count: None,
    lasts: None,
    observed_for: ms(1500),
    adapt: |_| {},
    expected: |_, _| Ok(Tolerated),
    within: Within::Answers,
};

/// A fault that must be found by one of these detectors in each phase.
const fn found(name: &'static str, kind: FaultKind, wires: &'static [Wire], within: Within) -> FaultCase {
    FaultCase { name, origin: Origin::Emulated(kind), wires, within, ..USUAL }
}

/// Frames that the adapter of the host holds for longer than the cell tolerates, and then sends.
const fn held(name: &'static str, milliseconds: u64) -> FaultCase {
    FaultCase {
        lasts: Some(ms(milliseconds)),
        expected: |_, _| Ok(By(&[D::Answers])),
        observed_for: ms(2500),
        ..found(name, FaultKind::HostHeld, BOTH, Within::Cut)
    }
}

/// The same, for no longer than the answers may be missing on CAN.
const fn held_shortly(name: &'static str, milliseconds: u64) -> FaultCase {
    FaultCase {
        expected: |wire, _| Ok(if wire == Can { Tolerated } else { By(&[D::Answers]) }),
        ..held(name, milliseconds)
    }
}

/// Answers of a serial line that begin to come late by a constant time, of one drive or of all of them.
const fn late(name: &'static str, adapt: fn(&mut FaultNumbers), all_axes: bool) -> FaultCase {
    FaultCase {
        adapt,
        all_axes,
        in_soak: false,
        expected: |_, _| Ok(By(&[D::Answers])),
        // A delay of three periods of the older protocol takes a second telegram that is left out.
        ..found(name, FaultKind::Late, SERIAL, Within::Time(ms(26)))
    }
}

/// The same delay within the period: the answers still come in time.
const fn in_time(name: &'static str, adapt: fn(&mut FaultNumbers), all_axes: bool) -> FaultCase {
    FaultCase { expected: |_, _| Ok(Tolerated), ..late(name, adapt, all_axes) }
}

/// A jump of the counter by a multiple of the smallest step that is found, at rest or at top speed.
const fn jump(name: &'static str, multiple: f64, at_top_speed: bool) -> FaultCase {
    FaultCase {
        at_top_speed,
        jump: Some(multiple),
        in_soak: false,
        expected: match (multiple > 1.0, at_top_speed) {
            (true, true) => |_, phase| at_top(phase, By(JUMPED)),
            (true, false) => |_, phase| at_rest(phase, By(JUMPED)),
            // Other checks find smaller steps in some cells: the reach of the motor, and a counter that starts at once.
            (false, true) => |_, phase| at_top(phase, Either(JUMPED)),
            (false, false) => |_, phase| at_rest(phase, Either(JUMPED)),
        },
        observed_for: ms(2500),
        // Three answers, and the delays of a serial line.
        ..found(name, FaultKind::EncoderJump, BOTH, Within::Time(ms(30)))
    }
}

/// Detectors of a counter that jumps. A motor at rest that seems to step and to stand may also be taken for a counter that
/// fails, and the loop answers the jump.
const JUMPED: &[Detector] = &[D::Plausibility, D::Frozen, D::FollowingError, D::DriveStatus];

/// A motor at rest whose answers have neither number nor address.
fn resting(wire: Wire, phase: FaultPhase) -> bool {
    wire == HiMoxa && phase == P::Idle
}

fn at_rest(phase: FaultPhase, expected: Expected) -> Result<Expected, &'static str> {
    if phase == P::Idle { Ok(expected) } else { Err("the robot is at rest") }
}

fn at_top(phase: FaultPhase, expected: Expected) -> Result<Expected, &'static str> {
    if phase == P::Cruising { Ok(expected) } else { Err("the robot is at top speed") }
}

/// An axis that does not follow: nothing shows at rest, and little in the last part of a motion.
fn not_following(_: Wire, phase: FaultPhase) -> Result<Expected, &'static str> {
    Ok(match phase {
        P::Idle => Tolerated,
        P::Braking => Either(NOT_FOLLOWING),
        P::Homing | P::Accelerating | P::Cruising | P::Contact | P::Team => By(NOT_FOLLOWING),
    })
}

/// A switch or an index pulse that only homing reads.
fn in_homing(_: Wire, phase: FaultPhase) -> Result<Expected, &'static str> {
    match phase {
        P::Homing => Ok(By(&[D::TimeOuts, D::LimitSwitches, D::DriveStatus])),
        _ => Err("only homing reads it"),
    }
}

/// A wrong macrostep of the generator.
const fn generated(name: &'static str, flaw: Flaw) -> FaultCase {
    FaultCase { name, origin: Origin::Generator(flaw), expected: in_motion, within: Within::Macrostep, ..USUAL }
}

/// A macrostep that only a motion needs.
fn in_motion(_: Wire, phase: FaultPhase) -> Result<Expected, &'static str> {
    match phase {
        P::Idle | P::Homing => Err("the generator gives no macrostep"),
        P::Accelerating | P::Cruising | P::Braking | P::Contact | P::Team => Ok(By(&[D::SetPoints])),
    }
}

/// The faults, in the order of the table.
pub(super) const CASES: &[FaultCase] = &[
    FaultCase { name: "one answer lost", count: Some(1), lasts: Some(ms(2)), ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Answers])), ..found("answers lost", K::Lost, BOTH, Within::Answers) },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("answers 5 ms late", K::Late, SERIAL, Within::Answers)
    },
    // Not older than the last answer before a gap that the cell tolerates, unless the host closes a loop. The age is found by
    // a SYNC that is left out, once a second at most.
    FaultCase {
        expected: |_, _| Ok(Either(&[D::Answers])),
        ..found("answers 5 ms late", K::Late, CAN, Within::Time(ms(1100)))
    },
    FaultCase {
        adapt: |numbers| numbers.late = ms(40),
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("answers 40 ms late", K::Late, BOTH, Within::Answers)
    },
    in_time("answers 1 ms late, serial", |numbers| numbers.late = ms(1), false),
    late("answers 2 ms late, serial", |numbers| numbers.late = ms(2), false),
    late("answers 11 ms late, serial", |numbers| numbers.late = ms(11), false),
    in_time("answers of all drives 1 ms late, serial", |numbers| numbers.late = ms(1), true),
    late("answers of all drives 4 ms late, serial", |numbers| numbers.late = ms(4), true),
    late("answers of all drives 40 ms late, serial", |numbers| numbers.late = ms(40), true),
    FaultCase { name: "answers twice", origin: Origin::Emulated(K::Duplicated), wires: CAN, ..USUAL },
    FaultCase {
        expected: |_, _| Ok(Either(&[D::Answers])),
        ..found("bytes twice", K::Duplicated, SERIAL, Within::Time(ms(1000)))
    },
    FaultCase {
        name: "one frame corrupted",
        origin: Origin::Emulated(K::Corrupted),
        wires: CAN,
        count: Some(1),
        ..USUAL
    },
    FaultCase { expected: |_, _| Ok(By(&[D::Answers])), ..found("frames corrupted", K::Corrupted, CAN, Within::Cut) },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("bits inverted", K::Corrupted, SERIAL, Within::Time(ms(200)))
    },
    FaultCase { name: "answers reordered", origin: Origin::Emulated(K::Reordered), wires: CAN, ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Port])), ..found("bus-off", K::BusOff, CAN, Within::Cut) },
    FaultCase { name: "error-passive", origin: Origin::Emulated(K::ErrorPassive), wires: CAN, ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Port])), ..found("interface down", K::InterfaceDown, CAN, Within::Cut) },
    FaultCase {
        lasts: Some(ms(50)),
        expected: |_, _| Ok(By(&[D::Port])),
        ..found("interface down for 50 ms", K::InterfaceDown, CAN, Within::Cut)
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Port])),
        ..found("interface removed", K::InterfaceRemoved, CAN, Within::Cut)
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Sending])),
        ..found("transmit queue full", K::QueueFull, CAN, Within::Cut)
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers, D::Port, D::Sending])),
        ..found("no acknowledge", K::NoAcknowledge, CAN, Within::Cut)
    },
    FaultCase {
        lasts: Some(ms(100)),
        expected: |_, _| Ok(By(&[D::Answers, D::Port, D::Sending])),
        ..found("no acknowledge for 100 ms", K::NoAcknowledge, CAN, Within::Cut)
    },
    FaultCase {
        name: "host frames held for 8 ms",
        origin: Origin::Emulated(K::HostHeld),
        wires: CAN,
        lasts: Some(ms(8)),
        ..USUAL
    },
    held("host frames held for 30 ms", 30),
    held("host frames held for 100 ms", 100),
    held("host frames held for 200 ms", 200),
    held("host frames held for 290 ms", 290),
    held("host frames held for 400 ms", 400),
    held("host frames held for 1 s", 1_000),
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("telegrams torn", K::Torn, SERIAL, Within::Time(ms(200)))
    },
    FaultCase { name: "garbage on the line", origin: Origin::Emulated(K::Garbage), wires: SERIAL, ..USUAL },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("wrong baud rate", K::WrongBaud, SERIAL, Within::Answers)
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Port])),
        ..found("hang-up of a line", K::HangUp, SERIAL, Within::Time(ms(6)))
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::OtherController])),
        ..found("second master on the bus", K::SecondMaster, CAN, Within::Time(ms(8)))
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("second master on the line", K::SecondMaster, SERIAL, Within::Time(ms(300)))
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers, D::NodeState, D::DriveStatus, D::Plausibility])),
        ..found("reset of a drive", K::NodeReset, BOTH, Within::Answers)
    },
    FaultCase {
        lasts: Some(ms(200)),
        expected: |_, _| Ok(By(&[D::Answers, D::NodeState, D::DriveStatus, D::Plausibility])),
        ..found("power cycle of a drive", K::PowerCycle, BOTH, Within::Answers)
    },
    FaultCase { expected: |_, _| Ok(By(&[D::Answers])), ..found("drive unplugged", K::Unplugged, BOTH, Within::Cut) },
    FaultCase {
        expected: |_, _| Ok(By(&[D::NodeState, D::Plausibility])),
        ..found("duplicate node-ID", K::DuplicateNode, CAN, Within::Time(ms(10)))
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Heartbeat])),
        ..found("heartbeat silent", K::HeartbeatSilent, CAN, Within::Heartbeat)
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::DriveStatus])),
        ..found("forged EMCY", K::ForgedEmergency, CAN, Within::Time(ms(10)))
    },
    FaultCase {
        expected: |_, phase| {
            Ok(match phase {
                // The requests ask for different objects, also at rest.
                P::Idle | P::Homing => By(&[D::Frozen]),
                P::Braking => Either(&[D::Frozen, D::FollowingError]),
                P::Accelerating | P::Cruising | P::Contact | P::Team => By(&[D::Frozen, D::FollowingError]),
            })
        },
        // Four answers with the same objects are a fault.
        ..found("answers stay the same", K::AnswersFrozen, SERIAL, Within::Time(ms(60)))
    },
    FaultCase {
        // In NFv2, an old answer names its request: every second answer is in time. A motor at rest shows no old answer.
        expected: |wire, phase| {
            Ok(match (wire, phase) {
                (HiMoxa, P::Accelerating | P::Cruising | P::Contact | P::Team) => By(&[D::Frozen]),
                (HiMoxa, _) => Either(&[D::Frozen]),
                (Nfv2 | Can, _) => Tolerated,
            })
        },
        in_soak: false,
        ..found("every second answer old", K::AnswersOld, SERIAL, Within::Window)
    },
    FaultCase {
        // At rest, only the number of late answers shows in the older protocol.
        expected: |wire, phase| Ok(if resting(wire, phase) { Either(&[D::Answers]) } else { By(&[D::Answers]) }),
        in_soak: false,
        ..found("answers reversed in pairs", K::AnswersReversed, SERIAL, Within::Window)
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        in_soak: false,
        ..found("answers garbled", K::AnswersGarbled, SERIAL, Within::Time(ms(200)))
    },
    FaultCase {
        // In the older protocol, two motors that rest at the same count have the same answers.
        expected: |wire, phase| Ok(if resting(wire, phase) { Either(&[D::Answers]) } else { By(&[D::Answers]) }),
        in_soak: false,
        ..found("answers of two axes swapped", K::AnswersSwapped, SERIAL, Within::Window)
    },
    FaultCase { expected: not_following, ..found("axis blocked", K::Blocked, BOTH, Within::Error) },
    FaultCase { expected: not_following, ..found("encoder frozen", K::EncoderFrozen, BOTH, Within::Lost) },
    FaultCase {
        adapt: |numbers| numbers.increments = 4000,
        expected: |_, _| Ok(By(&[D::Plausibility, D::DriveStatus])),
        ..found("encoder jumps by a turn", K::EncoderJump, BOTH, Within::Answers)
    },
    jump("encoder jumps by half the smallest step, at rest", 0.5, false),
    jump("encoder jumps by the smallest step, at rest", 1.0, false),
    jump("encoder jumps by 1.5 smallest steps, at rest", 1.5, false),
    jump("encoder jumps by ten smallest steps, at rest", 10.0, false),
    jump("encoder jumps by half the smallest step, at top speed", 0.5, true),
    jump("encoder jumps by the smallest step, at top speed", 1.0, true),
    jump("encoder jumps by 1.5 smallest steps, at top speed", 1.5, true),
    jump("encoder jumps by ten smallest steps, at top speed", 10.0, true),
    FaultCase { expected: not_following, ..found("encoder inverted", K::EncoderInverted, BOTH, Within::Lost) },
    FaultCase {
        observed_for: Duration::from_secs(40),
        expected: in_homing,
        ..found("home switch dead", K::HomeSwitchDead, BOTH, Within::Time(Duration::from_secs(40)))
    },
    FaultCase {
        observed_for: Duration::from_secs(40),
        expected: in_homing,
        ..found("index missing", K::IndexMissing, BOTH, Within::Time(Duration::from_secs(40)))
    },
    FaultCase { name: "limit switches dead", origin: Origin::Emulated(K::LimitSwitchesDead), ..USUAL },
    FaultCase {
        expected: |wire, phase| {
            Ok(match (wire, phase) {
                (Can, P::Homing) => return Err("the search turns round at the switch"),
                (Can, _) => By(&[D::DriveStatus]),
                // The axis rests on the switch, or moves away from it.
                (Nfv2 | HiMoxa, _) => Either(&[D::LimitSwitches]),
            })
        },
        ..found("limit switch closed", K::LimitSwitchClosed, BOTH, Within::Time(ms(10)))
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::DriveStatus])),
        ..found("over-current", K::OverCurrent, BOTH, Within::Time(ms(10)))
    },
    FaultCase {
        expected: |_, _| Ok(By(&[D::DriveStatus])),
        ..found("over-temperature", K::OverTemperature, BOTH, Within::Time(ms(10)))
    },
    FaultCase {
        // The search may be so slow that the supply suffices.
        expected: |wire, phase| if phase == P::Homing { Ok(Either(NOT_FOLLOWING)) } else { not_following(wire, phase) },
        ..found("supply sags", K::SaggingSupply, BOTH, Within::Slowed)
    },
    FaultCase {
        disables: true,
        observed_for: ms(3000),
        // Friction or the balance of the arm may hold all axes.
        expected: |_, _| Ok(Either(&[D::Brake])),
        ..found("brake does not hold", K::BrakeSlips, BOTH, Within::Fall)
    },
    FaultCase {
        expected: |_, phase| {
            // A motor at rest under load runs away, and one without load does not.
            Ok(if phase == P::Idle { Either(NOT_FOLLOWING) } else { By(NOT_FOLLOWING) })
        },
        ..found("motor phases swapped", K::SwappedPhases, BOTH, Within::Lost)
    },
    FaultCase { expected: not_following, ..found("collision", K::Collision, BOTH, Within::Error) },
    FaultCase { name: "tolerated number of deadlines missed", origin: Origin::Deadlines(Missed::Tolerated), ..USUAL },
    FaultCase {
        name: "too many deadlines missed",
        origin: Origin::Deadlines(Missed::TooMany),
        expected: |_, _| Ok(By(&[D::Deadlines])),
        within: Within::Deadlines,
        ..USUAL
    },
    FaultCase {
        name: "each third deadline missed",
        origin: Origin::Deadlines(Missed::Third),
        observed_for: Duration::from_secs(6),
        expected: |_, phase| match phase {
            P::Idle | P::Homing => Ok(By(&[D::Deadlines])),
            _ => Err("the motion ends before the share is judged"),
        },
        within: Within::Share,
        ..USUAL
    },
    FaultCase {
        name: "emergency stop",
        origin: Origin::EmergencyStop,
        expected: |_, _| Ok(By(&[D::EmergencyStop])),
        within: Within::Contact,
        ..USUAL
    },
    generated("set-point not a number", Flaw::NotANumber),
    generated("set-point beyond a position limit", Flaw::Position),
    generated("set-point beyond the greatest velocity", Flaw::Velocity),
    generated("set-point beyond the greatest acceleration", Flaw::Acceleration),
    generated("no macrostep in time", Flaw::Absent),
];

/// Answers of drives on CAN that begin to come late by a constant time. The age is found by a SYNC that is left out, once a
/// second at most. It is a fault above one period where the host closes a loop, and above the tolerated number elsewhere.
const fn late_on_can(name: &'static str, adapt: fn(&mut FaultNumbers), all_axes: bool) -> FaultCase {
    FaultCase {
        wires: CAN,
        expected: |_, _| Ok(Either(&[D::Answers])),
        within: Within::Time(ms(1100)),
        ..late(name, adapt, all_axes)
    }
}

/// Cases of one kind, from literal numbers.
macro_rules! grid {
    ($make:ident, $front:literal, $back:literal: $($number:literal),*) => {
        [$($make(concat!($front, $number, $back), $number)),*]
    };
}

macro_rules! late_grid {
    ($name:ident, $make:ident, $front:literal, $all:literal: $($number:literal),*) => {
        const $name: &[FaultCase] =
            &[$($make(concat!($front, $number, " ms late"), |numbers| numbers.late = ms($number), $all)),*];
    };
}

late_grid!(LATE, late, "grid: answers ", false:
    2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33,
    34, 35, 36, 37, 38, 39, 40);
late_grid!(ALL_LATE, late, "grid: answers of all drives ", true:
    2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33,
    34, 35, 36, 37, 38, 39, 40);
late_grid!(LATE_ON_CAN, late_on_can, "grid: answers on CAN ", false:
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 16, 18, 20, 25, 30, 40);
late_grid!(ALL_LATE_ON_CAN, late_on_can, "grid: answers on CAN of all drives ", true:
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 16, 18, 20, 25, 30, 40);
const HELD_SHORTLY: &[FaultCase] = &grid!(held_shortly, "grid: host frames held for ", " ms": 10);
const HELD: &[FaultCase] = &grid!(held, "grid: host frames held for ", " ms":
    15, 20, 25, 35, 40, 50, 60, 70, 80, 90, 110, 120, 150, 180, 220, 250, 280, 300, 310, 320, 350, 500, 600, 700, 800, 900);

/// Dense grids of delays. The table has some of their rows.
pub(super) const GRIDS: [&[FaultCase]; 6] = [LATE, ALL_LATE, LATE_ON_CAN, ALL_LATE_ON_CAN, HELD_SHORTLY, HELD];

impl FaultCase {
    /// The numbers of the fault.
    pub(super) fn numbers(&self) -> FaultNumbers {
        let mut numbers = FaultNumbers { count: self.count, ..FaultNumbers::default() };
        (self.adapt)(&mut numbers);
        numbers
    }
}
