//! Faults and errors of a run, with the names of the cell.

use controller::ecp::EcpError;
use controller::executor::InstructionError;
use controller::sensor::ForceTorque;
use drive::cia401::IoLink;
use drive::device::DeviceLink;
use drive::ultrasonic::UltrasonicLink;
use drive::{EmergencyStop, Fault};
use servo::thread::Panicked;
use servo::{Servo, ServoFault, StopCategory, StopCause};

use super::crew::time_of;
use super::watch::ServoHang;
use crate::cell::CellFile;
use crate::guardian::{DRIVES_STOPPED, GuardianFault};
use crate::report::{ErrorPlace, FaultReport};

/// The error of an instruction, with the names of the cell.
pub(super) fn describe(file: &CellFile, error: &InstructionError) -> FaultReport {
    let robot = error.robot;
    let fault = match error.cause {
        EcpError::Servo(fault) => describe_fault(file, robot, &fault),
        cause => FaultReport::of_robot(file, robot, None, file.cell.robot[robot].naming_axes(cause)),
    };
    let servo = matches!(error.cause, EcpError::Servo(_));
    FaultReport {
        place: Some(ErrorPlace::of(error)),
        latched: servo.then_some((robot, error.cycle)),
        number: Some(error.cycle),
        time_s: Some(time_of(file, error.cycle)),
        ..fault
    }
}

/// A fault of the servo, with the names of the cell.
pub(super) fn describe_fault(file: &CellFile, robot: usize, fault: &ServoFault) -> FaultReport {
    let axis = fault.axis.map(usize::from);
    // Some faults concern the bus and all axes on it.
    let of_bus = match fault.cause {
        StopCause::Drive(
            cause @ (Fault::Port(_)
            | Fault::NotAcknowledged { .. }
            | Fault::OtherController { .. }
            | Fault::HeartbeatNotSent { .. }
            | Fault::BusOff),
        ) => Some(cause.to_string()),
        _ => None,
    };
    if let Some((what, axis)) = of_bus.zip(axis) {
        let bus = &file.cell.robot[robot].axis[axis].bus;
        let of_bus =
            FaultReport::of_robot(file, robot, None, format!("bus {bus}: {}", what.trim_start_matches("bus: ")));
        return FaultReport { stop_category: Some(fault.category), check: fault.cause.remedy(), ..of_bus };
    }
    let what = match fault.cause {
        StopCause::EmergencyStop { group, contact } => emergency_stop(file, group, &contact),
        cause => cause.to_string(),
    };
    let of_axis = FaultReport::of_robot(file, robot, axis, what);
    FaultReport { stop_category: Some(fault.category), check: fault.cause.remedy(), ..of_axis }
}

/// An emergency stop by a contact of drive group `group`, with the names of the I/O node and its input, or of the axis.
fn emergency_stop(file: &CellFile, group: u8, contact: &EmergencyStop) -> String {
    let bus = file.cell.groups().nth(group.into());
    let nodes = file.cell.io.iter().filter(|io| bus == Some(&*io.bus) && io.node == contact.node);
    let mut inputs = nodes.flat_map(|io| io.input.iter().map(move |input| (io, input)));
    if let Some((io, input)) = inputs.find(|(_, input)| input.line == contact.input && input.emergency_stop) {
        return format!("input {} of I/O node {}: {contact}", input.name, io.name);
    }
    let is_contact = |&(robot, axis): &(usize, usize)| {
        let axis = &file.cell.robot[robot].axis[axis];
        let input = axis.drive.as_ref().and_then(|drive| drive.emergency_stop.as_ref()).map(|stop| stop.input);
        axis.node == contact.node && input == Some(contact.input)
    };
    let drive = file.cell.axes_on(group.into()).find(is_contact);
    drive.map_or(contact.to_string(), |(robot, axis)| format!("{}: {contact}", file.axis_name(robot, axis)))
}

/// The latched faults of the I/O nodes of a cell. The axes do not stop by such a fault.
pub(super) fn io_faults(file: &CellFile, links: &[IoLink]) -> impl Iterator<Item = FaultReport> {
    let nodes = file.cell.io.iter().zip(links);
    let faults = nodes.filter_map(|(io, link)| Some((io, link.inputs.read().fault?)));
    faults.map(|(io, fault)| FaultReport::of_run(format!("I/O node {}: {fault}", io.name)).checked_by(fault.remedy()))
}

/// The latched faults of the force sensors of a cell. The axes do not stop by such a fault.
pub(super) fn force_faults(file: &CellFile, sensors: &[ForceTorque]) -> impl Iterator<Item = FaultReport> {
    let sensors = file.cell.force_sensor.iter().zip(sensors);
    let faults = sensors.filter_map(|(given, sensor)| Some((given, sensor.link().read().fault?)));
    faults.map(|(given, fault)| {
        FaultReport::of_run(format!("force sensor {}: {fault}", given.name)).checked_by(fault.remedy())
    })
}

/// The latched faults of the ultrasonic matrices of a cell. The axes do not stop by such a fault.
pub(super) fn matrix_faults(file: &CellFile, matrices: &[UltrasonicLink]) -> impl Iterator<Item = FaultReport> {
    let matrices = file.cell.ultrasonic.iter().zip(matrices);
    let faults = matrices.filter_map(|(given, link)| Some((given, link.read().fault?)));
    faults.map(|(given, fault)| {
        FaultReport::of_run(format!("ultrasonic matrix {}: {fault}", given.name)).checked_by(fault.remedy())
    })
}

/// The latched faults of the devices of other crates. The axes do not stop by such a fault.
pub(super) fn device_faults(file: &CellFile, links: &[DeviceLink]) -> impl Iterator<Item = FaultReport> {
    let devices = file.cell.device.iter().zip(links);
    let faults = devices.filter_map(|(given, link)| Some((given, link.read().fault?)));
    faults.map(|(given, fault)| FaultReport::of_run(format!("{}: {fault}", given.title())).checked_by(fault.remedy()))
}

/// A panic of the servo thread after `cycles` cycles.
pub(super) fn of_servo_thread(file: &CellFile, panicked: Panicked, cycles: u64) -> FaultReport {
    let (what, category) = match panicked {
        Panicked::Caller => ("what the servo thread calls between its cycles panicked", StopCategory::One),
        Panicked::Cycle => ("the servo cycle panicked", StopCategory::One),
        Panicked::TwoCycles => ("the servo cycle panicked, and panicked again in the stop", StopCategory::Zero),
    };
    let stopped = file.cell.robot.iter().map(|robot| robot.name.clone()).collect();
    let fault = FaultReport::of_run(what).checked_by("report this as a defect of the program");
    let number = cycles.checked_sub(1);
    let time_s = number.map(|number| time_of(file, number));
    FaultReport { stop_category: Some(category), stopped, number, time_s, ..fault }
}

/// What the guardian reports, `time` seconds after the first cycle. All robots stopped.
pub(super) fn of_guardian(file: &CellFile, fault: GuardianFault, time: Option<f64>) -> FaultReport {
    let category = match fault {
        GuardianFault::Stopped { .. } => StopCategory::Zero,
        GuardianFault::Lost { .. } => StopCategory::One,
    };
    let stopped = file.cell.robot.iter().map(|robot| robot.name.clone()).collect();
    FaultReport { stop_category: Some(category), stopped, time_s: time, ..FaultReport::of_run(fault) }
}

/// A hang of the servo thread, which was left behind. With `guarded`, the guardian stopped the drives before.
pub(super) fn of_servo_hang(file: &CellFile, hang: &ServoHang, guarded: bool) -> FaultReport {
    let reaction = if guarded { DRIVES_STOPPED } else { "drives react as to a silent host" };
    let fault = FaultReport::of_run(format_args!("{hang}: {reaction}"));
    let number = hang.cycles.checked_sub(1);
    let stopped = file.cell.robot.iter().map(|robot| robot.name.clone()).filter(|_| guarded).collect();
    FaultReport {
        stop_category: guarded.then_some(StopCategory::Zero),
        stopped,
        number,
        time_s: number.map(|number| time_of(file, number)),
        ..fault.checked_by(hang.remedy())
    }
}

/// The fault of a run at whose end some robots may have power.
pub(super) fn of_power(file: &CellFile) -> FaultReport {
    // The servo reports the power of all robots together.
    let names: Vec<_> = file.cell.robot.iter().map(|robot| robot.name.as_str()).collect();
    let what = "still has power, or did not say otherwise";
    let fault = FaultReport::of_run(what).checked_by("switch the cabinet off before you go near");
    FaultReport { robot: Some(names.join(" or ")), ..fault }
}

/// The fault that the servo latched for each robot, unless the task `received` it, and a fault if some robots still
/// have power.
pub(crate) fn servo_faults(file: &CellFile, servo: &Servo, received: &[bool]) -> Vec<FaultReport> {
    let robots = &file.cell.robot;
    let latched = |robot| {
        let fault = describe_fault(file, robot, &servo.fault(robot)?);
        Some(FaultReport { latched: Some((robot, u64::MAX)), ..fault })
    };
    let unknown = (0..robots.len()).filter(|robot| received.get(*robot) != Some(&true));
    let mut faults: Vec<_> = unknown.filter_map(latched).collect();
    if !servo.is_off() {
        faults.push(of_power(file));
    }
    faults
}
