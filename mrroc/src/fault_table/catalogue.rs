//! Faults of the table: kind, wires and phases in which each fault has a meaning, and the expected detectors.

use std::time::Duration;

use servo::MAX_AXES;

use super::detector::Detector;
use super::phase::FaultPhase;
use crate::cell::CellFile;
use crate::scenario::{FaultKind, FaultNumbers};

/// Wire of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wire {
    Can,
    Serial,
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

/// Declared time from a fault to its detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Within {
    /// The missing answers that the cell tolerates, and four periods.
    Answers,
    /// The same. The wire is cut, so a drive on CAN stops by itself after three heartbeats of the host.
    Cut,
    /// Four periods of the heartbeat.
    Heartbeat,
    /// The following error grows to its limit.
    Error,
    /// The same. Until then, the loop of the drive accelerates the motor.
    Lost,
    /// The same, and the motor loses at least a fifth of its speed. In homing, it moves on along its search until then.
    Slowed,
    /// The arm falls within the watch of the brakes, and its motor catches it.
    Fall,
    /// This time.
    Time(Duration),
}

/// A fault of the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaultCase {
    /// Name in the table.
    pub(super) name: &'static str,
    pub(super) kind: FaultKind,
    /// The fault strikes all axes of the robot, which is switched off by an order at the same time.
    pub(super) disables: bool,
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
use Wire::{Can, Serial};

const BOTH: &[Wire] = &[Can, Serial];
const CAN: &[Wire] = &[Can];
const SERIAL: &[Wire] = &[Serial];

/// Detectors of an axis that does not follow. Drives on CAN have a following error of their own.
const NOT_FOLLOWING: &[Detector] = &[D::FollowingError, D::DriveStatus, D::Runaway, D::Frozen, D::Plausibility];

const USUAL: FaultCase = FaultCase {
    name: "",
    kind: K::Lost,
    disables: false,
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
    FaultCase { name, kind, wires, within, ..USUAL }
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

/// The faults, in the order of the table.
pub(super) const CASES: &[FaultCase] = &[
    FaultCase { name: "one answer lost", count: Some(1), lasts: Some(ms(2)), ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Answers])), ..found("answers lost", K::Lost, BOTH, Within::Answers) },
    // Not older than the last answer before a gap that the cell tolerates.
    FaultCase { name: "answers 5 ms late", kind: K::Late, ..USUAL },
    FaultCase {
        adapt: |numbers| numbers.late = ms(40),
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("answers 40 ms late", K::Late, BOTH, Within::Answers)
    },
    FaultCase { name: "answers twice", kind: K::Duplicated, wires: CAN, ..USUAL },
    FaultCase {
        expected: |_, _| Ok(Either(&[D::Answers])),
        ..found("bytes twice", K::Duplicated, SERIAL, Within::Time(ms(1000)))
    },
    FaultCase { name: "one frame corrupted", kind: K::Corrupted, wires: CAN, count: Some(1), ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Answers])), ..found("frames corrupted", K::Corrupted, CAN, Within::Cut) },
    FaultCase {
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("bits inverted", K::Corrupted, SERIAL, Within::Time(ms(200)))
    },
    FaultCase { name: "answers reordered", kind: K::Reordered, wires: CAN, ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Port])), ..found("bus-off", K::BusOff, CAN, Within::Cut) },
    FaultCase { name: "error-passive", kind: K::ErrorPassive, wires: CAN, ..USUAL },
    FaultCase { expected: |_, _| Ok(By(&[D::Port])), ..found("interface down", K::InterfaceDown, CAN, Within::Cut) },
    FaultCase {
        lasts: Some(ms(50)),
        expected: |_, _| Ok(By(&[D::Port])),
        ..found("interface down for 50 ms", K::InterfaceDown, CAN, Within::Cut)
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
        expected: |_, _| Ok(By(&[D::Answers])),
        ..found("telegrams torn", K::Torn, SERIAL, Within::Time(ms(200)))
    },
    FaultCase { name: "garbage on the line", kind: K::Garbage, wires: SERIAL, ..USUAL },
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
                // The set-points do not change at rest.
                P::Idle => Tolerated,
                P::Homing => By(&[D::Frozen]),
                P::Braking => Either(&[D::Frozen, D::FollowingError]),
                P::Accelerating | P::Cruising | P::Contact | P::Team => By(&[D::Frozen, D::FollowingError]),
            })
        },
        // Equal answers of 25 cycles are a fault.
        ..found("answers stay the same", K::AnswersFrozen, SERIAL, Within::Time(ms(60)))
    },
    FaultCase { expected: not_following, ..found("axis blocked", K::Blocked, BOTH, Within::Error) },
    FaultCase { expected: not_following, ..found("encoder frozen", K::EncoderFrozen, BOTH, Within::Lost) },
    FaultCase {
        adapt: |numbers| numbers.increments = 4000,
        expected: |_, _| Ok(By(&[D::Plausibility, D::DriveStatus])),
        ..found("encoder jumps by a turn", K::EncoderJump, BOTH, Within::Answers)
    },
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
    FaultCase { name: "limit switches dead", kind: K::LimitSwitchesDead, ..USUAL },
    FaultCase {
        expected: |wire, phase| {
            Ok(match (wire, phase) {
                (Can, P::Homing) => return Err("the search turns round at the switch"),
                (Can, _) => By(&[D::DriveStatus]),
                // The axis rests on the switch, or moves away from it.
                (Serial, _) => Either(&[D::LimitSwitches]),
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
];

/// Margin of the bound of the distance for the loops of the drives.
const MARGIN: f64 = 1.1;

/// Acceleration of a motor whose loop is lost, as a multiple of its greatest permitted acceleration. The motor accelerates
/// over its permitted following error, and runs out over this multiple of the error.
const LOST: f64 = 8.0;

/// Bounds of a row: time to the detection, and distance of each motor, rad.
pub(super) struct Bounds {
    pub(super) detection: Duration,
    pub(super) distance: [f64; MAX_AXES],
}

/// Time from the detection of a brake that does not hold to the torque of the motor: a drive on CAN passes three states,
/// each with the answer to its controlword.
const CATCHING: f64 = 0.040;

/// Distance of a motor that falls, rad, until it is caught: the `limit` of the watch, the way until the motor has torque,
/// and the way in which it brakes. Its weight accelerates the motor by at most half of its greatest `acceleration`, rad/s²,
/// because the motor must accelerate upwards as well.
fn fall(limit: f64, acceleration: f64) -> f64 {
    let weight = 0.5 * acceleration;
    let seen = (2.0 * weight * limit).sqrt();
    let caught = seen + weight * CATCHING;
    limit + (seen + caught) / 2.0 * CATCHING + caught * caught / (2.0 * weight)
}

impl FaultCase {
    /// The numbers of the fault.
    pub(super) fn numbers(&self) -> FaultNumbers {
        let mut numbers = FaultNumbers { count: self.count, ..FaultNumbers::default() };
        (self.adapt)(&mut numbers);
        numbers
    }

    /// Declared bounds on robot 0 of a cell whose motors move at `velocity`, rad/s.
    ///
    /// The distance of a motor is the sum of three parts, with a margin. The motor moves on until the detection, and for the
    /// four periods from sample to effect. The stop brakes with the deceleration of the limit. Twice the following error
    /// is added, for the distances between motor and set-point at the strike and at the end.
    ///
    /// The following error itself limits the distance until it finds a fault. The time of such a detection is four times the
    /// time at constant speed to the limit of the error, and to the obstacle of a collision. A motor that a sagging supply
    /// slows has five times this time, because it may keep four fifths of its speed. In homing, it moves on for this time,
    /// less the following error by which it is then late.
    pub(super) fn bounds(&self, file: &CellFile, axis: usize, velocity: &[f64; MAX_AXES], phase: FaultPhase) -> Bounds {
        let cell = &file.cell;
        let robot = &cell.robot[0];
        let name = &robot.axis[axis].bus;
        let bus = cell.bus.iter().find(|bus| bus.name == *name);
        let bundle = cell.serial.iter().find(|serial| serial.name == *name);
        let tolerated = bus.map(|bus| bus.tolerated_missing).or(bundle.map(|it| it.tolerated_missing)).unwrap_or(0);
        let answers = cell.period() * (tolerated + 4);
        let silence = ms(4 * bus.map_or(100, |bus| u64::from(bus.heartbeat_ms)));
        let obstacle = if self.kind == K::Collision { self.numbers().distance } else { 0.0 };
        let error = robot.axis[axis].following_error;
        let at_speed = |way: f64| Duration::from_secs_f64(way / velocity[axis].abs());
        let (detection, blind) = match self.within {
            Within::Answers => (answers, answers),
            Within::Cut => (answers, bus.map_or(answers, |bus| ms(3 * u64::from(bus.heartbeat_ms)))),
            Within::Heartbeat => (silence, silence),
            Within::Error | Within::Lost => (at_speed(4.0 * (obstacle + error)) + ms(50), Duration::ZERO),
            Within::Slowed => {
                let detection = at_speed(5.0 * error) + ms(50);
                (detection, if phase == P::Homing { detection - at_speed(error) } else { Duration::ZERO })
            }
            Within::Time(time) => (time, time),
            Within::Fall => (ms(1500), Duration::ZERO),
        };
        let blind = (blind + 4 * cell.period()).as_secs_f64();
        let distance = |number: usize| {
            let speed = velocity[number].abs();
            let given = robot.axis.get(number)?;
            let braking = speed * speed / (2.0 * given.max_acceleration);
            let lost = if number == axis && self.within == Within::Lost { LOST * given.following_error } else { 0.0 };
            let fall =
                if self.within == Within::Fall { fall(given.following_error, given.max_acceleration) } else { 0.0 };
            Some(MARGIN * (speed * blind + braking + lost + fall + 2.0 * given.following_error))
        };
        Bounds { detection, distance: std::array::from_fn(|number| distance(number).unwrap_or(f64::INFINITY)) }
    }
}
