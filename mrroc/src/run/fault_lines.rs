//! Every fault as the line of a report: unique, with its place, with what to check next, and short.

use std::collections::BTreeSet;
use std::fmt::Display;

use canopen::Object;
use canopen::cia402::ModeOfOperation;
use drive::EmergencyStop;
use drive::axis_controller::AxisControllerFault;
use drive::bus::Sign;
use drive::cia401::IoFault;
use drive::device::DeviceFault;
use drive::ultrasonic::UltrasonicFault;
use drive::wrench::{WrenchAxis, WrenchFault};
use drive::{BringUpError, Fault, Refusal};
use serial::LineError;
use servo::{HomingFailure, LawFault, Oscillation, ServoFault, StopCause};

use super::descriptions::{describe_fault, of_guardian, of_power, of_servo_hang, of_servo_thread};
use super::*;
use crate::guardian::GuardianFault;
use crate::tasks::tests::two_arms;

const OSCILLATION: Oscillation = Oscillation { frequency: 123.4, amplitude: 123.4567, at_rest: false };
const WAITED: Duration = Duration::from_micros(150_250);

/// Phrases of which each line has one: they say what a person does next.
const NEXT: [&str; 24] = [
    "check ",
    "see ",
    "read ",
    "look for ",
    "correct ",
    "report this",
    "set the interface",
    "plug ",
    "end the other",
    "release ",
    "home ",
    "move ",
    "let it cool",
    "open it anew",
    "open the line anew",
    "restart",
    "unload ",
    "free the tool",
    "free the axis",
    "zero the sensor",
    "bring the bus up",
    "switch it off",
    "switch the cabinet off",
    "search slower",
];

/// Faults of a drive on CAN, and errors of its class: one per variant.
fn of_drives() -> Vec<Fault> {
    let (node, waited) = (3, WAITED);
    let faults = vec![
        Fault::Drive { node, code: 0 },
        Fault::Drive { node, code: 0x0042 },
        Fault::Drive { node, code: 0x2310 },
        Fault::Drive { node, code: 0x2999 },
        Fault::Drive { node, code: 0x3210 },
        Fault::Drive { node, code: 0x4310 },
        Fault::Drive { node, code: 0x7305 },
        Fault::Drive { node, code: 0x7121 },
        Fault::Drive { node, code: 0x8130 },
        Fault::Drive { node, code: 0x8250 },
        Fault::Drive { node, code: 0x8611 },
        Fault::Drive { node, code: 0xA123 },
        Fault::Drive { node, code: 0x2320 },
        Fault::Drive { node, code: 0xFF01 },
        Fault::Drive { node, code: 0xFF0B },
        Fault::Silent { node, cycles: 4 },
        Fault::Late { node, periods: 3, latency: WAITED, most: WAITED },
        Fault::NotSent { node, cycles: 4 },
        Fault::NotAcknowledged { cycles: 4 },
        Fault::HeartbeatLost { node, waited },
        Fault::HostLate { node, waited },
        Fault::HeartbeatNotSent { waited },
        Fault::LeftOperational { node },
        Fault::NotBack { error: BringUpError::NeverBooted { node, waited } },
        Fault::PowerLost { node, statusword: 0x0240 },
        Fault::Implausible { node, moved: -123_456, most: 12_345, within: WAITED },
        Fault::NoSearch { node, waited },
        Fault::NotAtZero { node, counter: -123_456, most: 12_345 },
        Fault::ModeChanged {
            node,
            expected: ModeOfOperation::CyclicSynchronousPosition,
            found: ModeOfOperation::ProfilePosition,
        },
        Fault::Stuck { node, statusword: 0x0231, waited },
        Fault::Aborted { node, object: Object::new(0x6040, 0), code: 0x0504_0000 },
        Fault::Refused { node, refusal: Refusal::WrongKind },
        Fault::Refused { node, refusal: Refusal::NotOn },
        Fault::Refused { node, refusal: Refusal::OutOfRange },
        Fault::OtherController { sign: Sign::Sync },
        Fault::OtherController { sign: Sign::Heartbeat { node: 127 } },
        Fault::OtherController { sign: Sign::Setpoint { node } },
        Fault::Port(can::PortError::Down),
        Fault::Port(can::PortError::Gone),
        Fault::Port(can::PortError::Os(105)),
        Fault::BusOff,
    ];
    let of_line = of_axis_controllers().into_iter().map(|fault| Fault::AxisController { line: 2, fault });
    for fault in &faults {
        // A new variant needs a row above.
        match fault {
            Fault::Drive { .. }
            | Fault::Silent { .. }
            | Fault::Late { .. }
            | Fault::NotSent { .. }
            | Fault::NotAcknowledged { .. }
            | Fault::HeartbeatLost { .. }
            | Fault::HostLate { .. }
            | Fault::HeartbeatNotSent { .. }
            | Fault::LeftOperational { .. }
            | Fault::NotBack { .. }
            | Fault::PowerLost { .. }
            | Fault::Implausible { .. }
            | Fault::NoSearch { .. }
            | Fault::NotAtZero { .. }
            | Fault::ModeChanged { .. }
            | Fault::Stuck { .. }
            | Fault::Aborted { .. }
            | Fault::Refused { .. }
            | Fault::OtherController { .. }
            | Fault::Port(_)
            | Fault::BusOff
            | Fault::AxisController { .. } => {}
        }
    }
    faults.into_iter().chain(of_line).collect()
}

fn of_axis_controllers() -> Vec<AxisControllerFault> {
    use AxisControllerFault as F;
    let faults = vec![
        F::Silent { cycles: 3 },
        F::Late { missing: 60, cycles: 200 },
        F::Delayed { cycles: 20, periods: 12 },
        F::Repeated { answers: 12 },
        F::NotIndexed { position: -2_000_000 },
        F::NotSent { cycles: 3 },
        F::Line(LineError::Gone),
        F::Line(LineError::Os(5)),
        F::Jumped { from: -2_000_000, to: 2_000_000 },
        F::Frozen { cycles: 12 },
        F::Restarted,
        F::KeepsReference { cycles: 500 },
        F::PowerStage,
        F::Overcurrent,
        F::Error,
        F::Old { answers: 103 },
        F::Reversed { answers: 103 },
        F::Garbled { answers: 103 },
        F::OtherDrive { address: 103 },
        F::Swapped { line: 4 },
        F::Cabinet { line: 4 },
        F::Refused(Refusal::NotOn),
    ];
    for fault in &faults {
        match fault {
            F::Silent { .. }
            | F::Late { .. }
            | F::Delayed { .. }
            | F::Repeated { .. }
            | F::Old { .. }
            | F::Reversed { .. }
            | F::Garbled { .. }
            | F::OtherDrive { .. }
            | F::Swapped { .. }
            | F::NotIndexed { .. }
            | F::NotSent { .. }
            | F::Line(_)
            | F::Jumped { .. }
            | F::Frozen { .. }
            | F::Restarted
            | F::KeepsReference { .. }
            | F::PowerStage
            | F::Overcurrent
            | F::Error
            | F::Cabinet { .. }
            | F::Refused(_) => {}
        }
    }
    faults
}

fn of_sensors() -> Vec<WrenchFault> {
    use WrenchFault as F;
    let (waited, axis) = (WAITED, WrenchAxis::ALL[2]);
    vec![
        F::NotStarted,
        F::Ended,
        F::Silent { cycles: 4 },
        F::Garbage { readings: 9 },
        F::Missing { missing: 30, of: 100 },
        F::Incomplete { samples: 7 },
        F::Saturated { axis, counts: -32_768 },
        F::StillSaturated { axis, counts: -32_768 },
        F::OfAnotherRate { declared: Duration::from_millis(2), found: Duration::from_micros(2_500) },
        F::Status { status: 0x8000_0001 },
        F::Line(LineError::Gone),
        F::HeartbeatLost { waited },
        F::LeftOperational,
        F::HeartbeatNotSent { waited },
        F::OtherController { sign: Sign::Sync },
        F::Port(can::PortError::Down),
        F::BusOff,
    ]
}

/// Causes of stops of one axis.
fn of_axes() -> Vec<StopCause> {
    use StopCause as C;
    let homing = [
        HomingFailure::NoSwitch { distance: 1234.5 },
        HomingFailure::SwitchNotLeft { distance: 12.3 },
        HomingFailure::SwitchPassed,
        HomingFailure::NoIndex { distance: 7.0 },
        HomingFailure::TimedOut { waited: WAITED },
        HomingFailure::LimitSwitch { upper: false },
    ];
    let own = [
        C::FollowingError { error: -123.4567, limit: 12.0 },
        C::Frozen { travel: 123.4567 },
        C::Blocked { torque: -123.45, limit: 12.34, behind: 123.4567, stands: true },
        C::BrakeSlips { travel: -123.4567 },
        C::Runaway { velocity: -1234.5, limit: 300.0 },
        C::Oscillates(OSCILLATION),
        C::NotBraking { velocity: -1234.5, limit: 300.0 },
        C::LimitSwitch { upper: true },
        C::PositionLimit { position: -1234.5678, limit: -1200.0 },
        C::NoRoomToStop { rest: 1234.5678, limit: 1200.0 },
        C::VelocityLimit { velocity: 1234.567, limit: 300.0 },
        C::AccelerationLimit { acceleration: 12_345.67, limit: 3000.0 },
        C::LawDisplacement { displacement: 12.3456, limit: 1.0 },
        C::LawSpeed { velocity: 123.456, limit: 10.0 },
        C::NotHomed,
        C::HomingFailed,
    ];
    of_drives().into_iter().map(C::Drive).chain(own).chain(homing.map(C::NoReference)).collect()
}

/// Causes of stops of a robot.
fn of_robots() -> Vec<StopCause> {
    use StopCause as C;
    let laws = [
        LawFault::Silent { age: 0.0123, limit: 0.01 },
        LawFault::Saturated { channel: 2 },
        LawFault::NotFinite,
        LawFault::Exceeded { channel: 2, value: -123.45, limit: 100.0 },
        LawFault::NotZeroed,
        LawFault::NoWeight { request: 12 },
        LawFault::Unreachable,
        LawFault::Panicked,
        LawFault::Parameter { index: 3, value: -1.0 },
    ];
    let own = [
        C::NotFinite,
        C::Malformed { number: 123_456 },
        C::UnequalSteps { number: 123_456, steps: 10, other: 20 },
        C::OutOfSequence { number: 123_456, expected: 123_455 },
        C::NotAMember { members: 0b1010_1010 },
        C::Partner { effector: 1 },
        C::Touched,
        C::LawLeft { number: 123_456 },
        C::NoLaw { number: 123_456 },
        C::NotReady { waited: WAITED },
        C::Starved { last: 123_456 },
        C::EmergencyStop { group: 0, contact: EmergencyStop { node: 40, input: 5, known: true } },
        C::EmergencyStop { group: 0, contact: EmergencyStop { node: 40, input: 5, known: false } },
        C::Overrun { missed: 12 },
        C::Overloaded { missed: 1_251, deadlines: 5_001 },
    ];
    let laws = laws.into_iter().chain(of_sensors().into_iter().map(LawFault::Sensor));
    let causes: Vec<_> = own.into_iter().chain(laws.map(C::Law)).collect();
    for cause in causes.iter().chain(&of_axes()) {
        // A new variant needs a row above, or in `of_axes`.
        match cause {
            C::Drive(_)
            | C::FollowingError { .. }
            | C::Frozen { .. }
            | C::Blocked { .. }
            | C::BrakeSlips { .. }
            | C::Runaway { .. }
            | C::Oscillates(_)
            | C::NotBraking { .. }
            | C::LimitSwitch { .. }
            | C::PositionLimit { .. }
            | C::NoRoomToStop { .. }
            | C::VelocityLimit { .. }
            | C::AccelerationLimit { .. }
            | C::NotFinite
            | C::Malformed { .. }
            | C::UnequalSteps { .. }
            | C::OutOfSequence { .. }
            | C::NotAMember { .. }
            | C::Partner { .. }
            | C::Touched
            | C::Law(_)
            | C::LawDisplacement { .. }
            | C::LawSpeed { .. }
            | C::LawLeft { .. }
            | C::NoLaw { .. }
            | C::NotHomed
            | C::NotReady { .. }
            | C::Starved { .. }
            | C::HomingFailed
            | C::NoReference(_)
            | C::EmergencyStop { .. }
            | C::Overrun { .. }
            | C::Overloaded { .. } => {}
        }
    }
    causes
}

fn of_nodes() -> Vec<IoFault> {
    let (node, waited) = (40, WAITED);
    vec![
        IoFault::NotStarted { node },
        IoFault::Ended { node },
        IoFault::InputsSilent { node, waited },
        IoFault::HeartbeatLost { node, waited },
        IoFault::LeftOperational { node },
        IoFault::NotBack { node, waited },
        IoFault::NotConfigured { node, object: Object::new(0x6207, 8) },
        IoFault::OutputsNotSent { node, cycles: 4 },
        IoFault::HeartbeatNotSent { waited },
        IoFault::OtherController { sign: Sign::Sync },
        IoFault::Port(can::PortError::Gone),
        IoFault::BusOff,
    ]
}

fn of_matrices() -> Vec<UltrasonicFault> {
    vec![
        UltrasonicFault::NotStarted,
        UltrasonicFault::Ended,
        UltrasonicFault::Silent { queries: 4 },
        UltrasonicFault::Garbage { readings: 9 },
        UltrasonicFault::Refused { command: 3, reason: 2 },
        UltrasonicFault::Line(LineError::Gone),
    ]
}

fn of_own_devices() -> Vec<DeviceFault> {
    vec![
        DeviceFault::NotStarted,
        DeviceFault::Ended,
        DeviceFault::Silent { samples: 4 },
        DeviceFault::Garbage { readings: 9 },
        DeviceFault::Refused { code: 3 },
        DeviceFault::Line(LineError::Gone),
    ]
}

/// Every fault with the place that its line must name.
fn all(file: &CellFile) -> Vec<(FaultReport, &'static str)> {
    let of = |axis, cause| describe_fault(file, 0, &ServoFault::new(axis, cause));
    let bus_wide = |cause: &StopCause| {
        matches!(
            cause,
            StopCause::Drive(
                Fault::HeartbeatNotSent { .. }
                    | Fault::NotAcknowledged { .. }
                    | Fault::OtherController { .. }
                    | Fault::Port(_)
                    | Fault::BusOff
            )
        )
    };
    let mut all = Vec::new();
    for cause in of_axes() {
        let place = if bus_wide(&cause) { "left: bus arm: " } else { "left: axis left.column: " };
        all.push((of(Some(0), cause), place));
    }
    all.extend(of_robots().into_iter().map(|cause| (of(None, cause), "left: ")));
    let device = |name: &str, fault: &dyn Display| FaultReport::of_run(format!("{name}: {fault}"));
    all.extend(of_nodes().iter().map(|it| (device("I/O node cell", it).checked_by(it.remedy()), "I/O node cell: ")));
    let sensors = of_sensors();
    all.extend(
        sensors.iter().map(|it| (device("force sensor wrist", it).checked_by(it.remedy()), "force sensor wrist")),
    );
    let matrices = of_matrices();
    all.extend(
        matrices.iter().map(|it| (device("ultrasonic matrix front", it).checked_by(it.remedy()), "matrix front")),
    );
    let own = of_own_devices();
    all.extend(own.iter().map(|it| (device("device range (acme-range)", it).checked_by(it.remedy()), "device range")));
    let silence = WAITED;
    all.push((of_guardian(file, GuardianFault::Stopped { silence }, None), "guardian"));
    all.push((of_guardian(file, GuardianFault::Lost { pid: 1_234_567 }, None), "guardian"));
    let hang = ServoHang { silent: WAITED, cycles: 617_284 };
    all.push((of_servo_hang(file, &hang, true), "thread servo"));
    all.push((of_servo_hang(file, &hang, false), "thread servo"));
    all.push((of_power(file), "left or right: "));
    all.push((of_servo_thread(file, thread::Panicked::Caller, 7), "servo thread"));
    all.push((of_servo_thread(file, thread::Panicked::Cycle, 7), "servo cycle"));
    all.push((of_servo_thread(file, thread::Panicked::TwoCycles, 7), "panicked again"));
    all
}

#[test]
fn every_fault_is_one_line_with_its_place_its_time_the_stop_and_what_to_check() {
    let file = two_arms();
    let all = all(&file);
    let names = vec!["left".to_owned(), "right".to_owned()];
    let (mut lines, mut problems) = (BTreeSet::new(), Vec::new());
    for (fault, place) in &all {
        let stops = fault.stop_category.is_some();
        let stopped = if stops { names.clone() } else { Vec::new() };
        let (time_s, number, check) = (Some(1234.567), Some(617_283), fault.check);
        let what = fault.what.clone();
        let (robot, axis, stop_category) = (fault.robot.clone(), fault.axis.clone(), fault.stop_category);
        let known =
            FaultReport { robot, axis, check, stop_category, stopped, time_s, number, ..FaultReport::of_run(&what) };
        let line = known.to_string();
        let length = line.chars().count();
        let mut wrong = |is_wrong: bool, why: &str| {
            if is_wrong {
                problems.push(format!("{why} ({length} characters): {line}"));
            }
        };
        wrong(!line.contains(place), &format!("no place {place}"));
        wrong(length > 200 || line.contains('\n'), "not one short line");
        wrong(!NEXT.iter().any(|next| line.contains(next)), "nothing to check next");
        wrong(!line.contains("[1234.567 s, cycle 617283"), "no time");
        wrong(line.contains("; category ") != stops, "no stop category");
        for vague in ["no error)", "(unknown)", "errno", "{", "0x0000"] {
            wrong(line.contains(vague), vague);
        }
        wrong(!lines.insert(what), "twice");
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(all.len() > 120, "{}", all.len());
}
