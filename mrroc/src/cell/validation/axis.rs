//! Checks of one axis, on a CAN bus or on a serial line.

use std::f64::consts::{PI, TAU};
use std::time::Duration;

use canopen::Object;
use drive::cia402::{Reserved, reserved};

use super::{Checked, buses, homing, io, no_effect, position_loop, refused, within};
use crate::cell::{
    Axis, AxisController, Bus, Cell, Control, Drive, Figure, Parameter, Path, Plant, Protocol, Range, Serial,
};
use controller::robot::Limits;

/// Least limit of the following error, encoder counts: a working loop has an error of some counts.
const LEAST_ERROR: f64 = 10.0;

/// Greatest velocity and acceleration of any motor, rad/s and rad/s². The fastest spindle motors turn at 10⁴ rad/s. A
/// velocity in counts per second, given by mistake, is mostly greater.
const FASTEST: (f64, f64) = (1e4, 1e7);

/// Longest time of a stop from the greatest velocity, s.
const LONGEST_STOP: f64 = 60.0;

/// Greatest rated torque and torque constant, N·m and N·m/A. Object 0x6076 of an EPOS4 holds 32 bits of µN·m.
const STRONGEST: f64 = 4294.0;

/// Greatest initial distance of an emulated axis without ends from home, rad. The distance determines the duration of
/// its search for the home switch.
const FARTHEST_START: f64 = 1000.0;

/// Why an address has no effect with the older protocol.
const NO_ADDRESSES: &str = "with protocol = \"hi-moxa\", which has no addresses";

/// The bus or bundle of an axis.
#[derive(Clone, Copy)]
pub(super) enum Place<'a> {
    Bus(&'a Bus),
    Serial(&'a Serial),
}

impl<'a> Place<'a> {
    /// The bus or the bundle of lines called `name`.
    pub(super) fn of(cell: &'a Cell, name: &str) -> Option<Self> {
        let bus = cell.bus.iter().find(|bus| bus.name == name).map(Self::Bus);
        let serial = || cell.serial.iter().find(|serial| serial.name == name);
        bus.or_else(|| serial().map(Self::Serial))
    }
}

/// Checks an axis. `model` holds the limits of the motor from the model, which the axis may narrow. `home` is its home
/// position, rad.
pub(super) fn check(path: &Path, period: Duration, axis: &Axis, place: Place<'_>, model: Limits, home: f64) -> Checked {
    let (family, node) = match place {
        Place::Bus(_) => ("drive", Range::new(1.0, 127.0, "")),
        Place::Serial(_) => ("controller", Range::new(0.0, 253.0, "")),
    };
    let family = path.then(family);
    within(path, "node", axis.node, node)?;
    if let Place::Serial(serial) = place {
        let given = serial.protocol == Protocol::HiMoxa && axis.node != 0;
        no_effect(path, "node", given, NO_ADDRESSES)?;
    }
    check_family(path, axis, place)?;
    let of = "rad/s of the motor; the least crosses the travel in 20 min";
    within(path, "max_velocity", axis.max_velocity, Range::new(homing::slowest(model), FASTEST.0, of))?;
    let of = "rad/s² of the motor; the least brakes from max_velocity in 60 s";
    let range = Range::new(axis.max_velocity / LONGEST_STOP, FASTEST.1, of);
    within(path, "max_acceleration", axis.max_acceleration, range)?;
    check_counts(&family, axis.counts_per_revolution())?;
    check_positions(path, axis, model, home)?;
    let count = TAU / f64::from(axis.counts_per_revolution());
    let least = LEAST_ERROR * count;
    let most = (model.high - model.low).min(f64::from(u32::MAX) * count);
    let error = Range::new(least, most.max(least), "rad of the motor: 10 counts to all of its travel");
    within(path, "following_error", axis.following_error, error)?;
    match place {
        Place::Bus(_) => check_drive(&family, period, axis.cia402(), axis),
        Place::Serial(serial) => check_controller(&family, period, axis.axis_controller(), serial, axis),
    }?;
    check_emulator(&path.then("emulator"), axis, place, model, home)?;
    homing::check(&path.then("homing"), axis, place, period, model, home)
}

/// Positions lie within those of the model and fit a 32-bit counter.
fn check_positions(path: &Path, axis: &Axis, model: Limits, home: f64) -> Checked {
    let given = [("min_position", axis.min_position), ("max_position", axis.max_position)];
    for (key, value) in given {
        let Some(value) = value else { continue };
        if !(model.low..=model.high).contains(&value) {
            let [value, low, high] = [value, model.low, model.high].map(Figure);
            return refused(path, key, format!("is {value}, must lie within the model's limits {low} and {high}"));
        }
    }
    let low = axis.min_position.unwrap_or(model.low);
    let high = axis.max_position.unwrap_or(model.high);
    if low >= high {
        let [low, high] = [low, high].map(Figure);
        let (key, why) = match axis.min_position {
            Some(_) => ("min_position", format!("is {low}, not below the upper limit {high}")),
            None => ("max_position", format!("is {high}, not above the lower limit {low}")),
        };
        return refused(path, key, why);
    }
    let beyond = match home {
        _ if home < low => Some(("min_position", low, "above")),
        _ if home > high => Some(("max_position", high, "below")),
        _ => None,
    };
    if let Some((key, limit, side)) = beyond {
        let [limit, home] = [limit, home].map(Figure);
        let why =
            format!("is {limit}, must not be {side} the home position {home}, where the motor stands after homing");
        return refused(path, key, why);
    }
    let scale = axis.scale(home);
    for (key, value) in [("min_position", low), ("max_position", high)] {
        if scale.increments(value).is_none() {
            let counts = axis.counts_per_revolution();
            let reach = f64::from(i32::MAX) * TAU / f64::from(counts);
            let why = format!(
                "is {value} rad, more than the {reach:.0} rad from home that a counter of 32 bits reaches at {counts} \
                 counts per revolution: narrow it"
            );
            return refused(path, key, why);
        }
    }
    Ok(())
}

/// An axis on a CAN bus has a drive, and an axis on a serial line has an axis controller.
fn check_family(path: &Path, axis: &Axis, place: Place<'_>) -> Checked {
    let (key, why) = match (place, &axis.drive, &axis.controller) {
        (Place::Bus(_), Some(_), None) | (Place::Serial(_), None, Some(_)) => return Ok(()),
        (Place::Bus(_), None, _) => ("drive", "is missing: an axis on a CAN bus has a drive"),
        (Place::Bus(_), _, Some(_)) => ("controller", "is for an axis on a serial line, not on a CAN bus"),
        (Place::Serial(_), _, None) => ("controller", "is missing: an axis on a serial line has an axis controller"),
        (Place::Serial(_), Some(_), _) => ("drive", "is for an axis on a CAN bus, not on a serial line"),
    };
    refused(path, key, why)
}

fn check_emulator(path: &Path, axis: &Axis, place: Place<'_>, model: Limits, home: f64) -> Checked {
    let emulator = &axis.emulator;
    let counts = emulator.counts_per_revolution;
    let of_drives = [
        ("vendor", emulator.vendor.is_some()),
        ("revision", emulator.revision.is_some()),
        ("counts_per_revolution", counts.is_some()),
        ("rated_torque", emulator.rated_torque.is_some()),
        ("trips_at_s", emulator.trips_at_s.is_some()),
    ];
    within(path, "trips_at_s", emulator.trips_at_s.unwrap_or(0.0), Range::new(0.0, 1e6, "s"))?;
    match place {
        Place::Bus(_) => {
            let because = "on a CAN bus: it is of serial lines";
            no_effect(path, "address", emulator.address.is_some(), because)?;
            no_effect(path, "protocol", emulator.protocol.is_some(), because)?;
        }
        Place::Serial(serial) => {
            for (key, given) in of_drives {
                no_effect(path, key, given, "on a serial line: it is of drives on CAN")?;
            }
            let spoken = emulator.protocol.unwrap_or(serial.protocol);
            let given = emulator.address.is_some() && spoken == Protocol::HiMoxa;
            no_effect(path, "address", given, NO_ADDRESSES)?;
        }
    }
    within(path, "setpoint_filter_s", emulator.setpoint_filter_s, Range::new(0.0, 1.0, "s"))?;
    if let Some(share) = emulator.dry_friction {
        within(path, "dry_friction", share, Range::new(0.0, 10.0, ""))?;
    }
    if let Some(start) = emulator.start {
        let range = if homing::is_endless(model) {
            Range::new(home - FARTHEST_START, home + FARTHEST_START, "rad of the motor: 1000 rad from home")
        } else {
            // The emulated limit switches are beyond the travel.
            Range::new(model.low - PI, model.high + PI, "rad of the motor: its travel and half a turn beyond")
        };
        within(path, "start", start, range)?;
    }
    if let Some(counts) = counts {
        check_counts(path, counts)?;
    }
    match emulator.rated_torque {
        Some(rated) => within(path, "rated_torque", rated, Range::new(1e-6, STRONGEST, "N·m")),
        None => Ok(()),
    }
}

fn check_drive(path: &Path, period: Duration, drive: &Drive, axis: &Axis) -> Checked {
    // The unit of object 0x6076 is 1 mN·m, for maxon's drives 1 µN·m.
    within(path, "rated_torque", drive.rated_torque, Range::new(1e-3, STRONGEST, "N·m"))?;
    let most = drive.max_torque.unwrap_or(drive.rated_torque);
    within(path, "max_torque", most, Range::new(drive.rated_torque, STRONGEST, "N·m; rated_torque at the least"))?;
    let acceleration = Range::new(axis.max_acceleration, 1e9, "rad/s²; max_acceleration at the least");
    let given = drive.plausible_acceleration.unwrap_or(axis.max_acceleration);
    within(path, "plausible_acceleration", given, acceleration)?;
    if let Some(dcf) = &drive.dcf {
        buses::text(path, "dcf", dcf)?;
    }
    if let Some(contact) = &drive.emergency_stop {
        let path = path.then("emergency_stop");
        within(
            &path,
            "input",
            contact.input,
            Range::new(3.0, 31.0, "a bit of 0x60FD; 0 to 2 are limit and home switches"),
        )?;
        io::check_edges(&path, "emulated_edges_s", &contact.emulated_edges_s)?;
    }
    position_loop::check_drive(path, period, drive, axis)?;
    check_parameters(path, &drive.parameter, |object| reserved(drive.vendor, object.index, object.subindex))
}

/// Checks the parameters of the device at `path`. None of their objects may be `reserved` for the driver.
pub(super) fn check_parameters(
    path: &Path,
    parameters: &[Parameter],
    reserved: impl Fn(Object) -> Option<Reserved>,
) -> Checked {
    for (number, parameter) in parameters.iter().enumerate() {
        let path = path.then("parameter").then(number);
        if let Some(found) = reserved(Object::new(parameter.index, parameter.subindex)) {
            return refused(&path, "index", found.to_string());
        }
        if !matches!(parameter.bytes, 1 | 2 | 4) {
            return refused(&path, "bytes", format!("is {}, must be 1, 2 or 4", parameter.bytes));
        }
        // As an unsigned number, or as the two's complement of a signed number.
        let unused = 32 - 8 * u32::from(parameter.bytes);
        let value = parameter.value;
        let extended = ((value << unused) as i32 >> unused) as u32;
        if value << unused >> unused != value && extended != value {
            return refused(&path, "value", format!("is {value:#x}, more than {} bytes hold", parameter.bytes));
        }
    }
    Ok(())
}

fn check_counts(path: &Path, counts: u32) -> Checked {
    within(path, "counts_per_revolution", counts, Range::new(4.0, 1e7, "quadrature counts"))
}

fn check_controller(
    path: &Path,
    period: Duration,
    controller: &AxisController,
    serial: &Serial,
    axis: &Axis,
) -> Checked {
    buses::text(path, "line", &controller.line)?;
    within(path, "torque_constant", controller.torque_constant, Range::new(1e-4, STRONGEST, "N·m/A"))?;
    // The telegrams hold 16 bits of milliamperes.
    within(path, "max_current", controller.max_current, Range::new(1e-3, 32.767, "A"))?;
    position_loop::check(path, period, axis)?;
    let velocity = Range::new(axis.max_velocity, 1e9, "rad/s; max_velocity at the least");
    let given = controller.plausible_velocity.unwrap_or(axis.max_velocity);
    within(path, "plausible_velocity", given, velocity)?;
    let acceleration = Range::new(axis.max_acceleration, 1e9, "rad/s²; max_acceleration at the least");
    let given = controller.plausible_acceleration.unwrap_or(axis.max_acceleration);
    within(path, "plausible_acceleration", given, acceleration)?;
    let why = match (controller.control, serial.protocol, axis.emulator.plant) {
        (Control::Current, Protocol::HiMoxa, _) => {
            "is current, which the older protocol's axis controllers do not follow: use pwm"
        }
        (Control::Pwm, _, Plant::Wut) => {
            "is pwm, which the emulator's plant wut cannot follow, having no voltage: use the physical one"
        }
        _ => return Ok(()),
    };
    refused(path, "control", why)
}
