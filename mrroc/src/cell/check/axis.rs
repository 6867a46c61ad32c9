//! What one axis of a cell must satisfy, on a CAN bus or on a serial line.

use super::{Checked, Path, Problem, in_range, positive};
use crate::cell::{
    Axis, AxisController, Bus, Cell, Control, Drive, DriveControl, Emulator, Law, Loop, Plant,
    Protocol, Serial,
};
use controller::robot::Limits;

/// What an axis hangs on.
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

/// `model` is what the model says of the motor: the axis may narrow it.
pub(super) fn check(path: &Path, axis: &Axis, place: Place<'_>, model: Limits) -> Checked {
    let node = match place {
        Place::Bus(_) => (1.0, 127.0, "between 1 and 127"),
        Place::Serial(_) => (0.0, 253.0, "between 0 and 253"),
    };
    let (low, high, range) = node;
    in_range(&path.then("node"), f64::from(axis.node), low, high, range)?;
    positive(&path.then("max_velocity"), axis.max_velocity)?;
    positive(&path.then("max_acceleration"), axis.max_acceleration)?;
    positive(&path.then("following_error"), axis.following_error)?;
    let given = [
        ("min_position", axis.min_position),
        ("max_position", axis.max_position),
    ];
    for (key, value) in given {
        let Some(value) = value else { continue };
        if !(model.low..=model.high).contains(&value) {
            let Limits { low, high } = model;
            return Err((path.then(key), Problem::BeyondModel { value, low, high }));
        }
    }
    let low = axis.min_position.unwrap_or(model.low);
    let high = axis.max_position.unwrap_or(model.high);
    if low >= high {
        return Err(if axis.min_position.is_some() {
            (path.then("min_position"), Problem::UpsideDown { low, high })
        } else {
            (path.then("max_position"), Problem::BelowLow { low, high })
        });
    }
    let refused =
        |key: &'static str, why: &str| Err((path.then(key), Problem::Refused(why.into())));
    match (place, &axis.drive, &axis.controller) {
        (Place::Bus(_), Some(drive), None) => {
            check_drive(&path.then("drive"), drive, axis.max_velocity)?;
        }
        (Place::Serial(serial), None, Some(controller)) => {
            check_controller(&path.then("controller"), controller, serial, axis)?;
        }
        (Place::Bus(_), None, _) => {
            return refused("drive", "is missing: an axis on a CAN bus has a drive");
        }
        (Place::Bus(_), _, Some(_)) => {
            return refused(
                "controller",
                "is for an axis on a serial line, not on a CAN bus",
            );
        }
        (Place::Serial(_), _, None) => {
            return refused(
                "controller",
                "is missing: an axis on a serial line has an axis controller",
            );
        }
        (Place::Serial(_), Some(_), _) => {
            return refused("drive", "is for an axis on a CAN bus, not on a serial line");
        }
    }
    check_emulator(&path.then("emulator"), &axis.emulator)?;
    check_homing(&path.then("homing"), axis, place)
}

fn check_emulator(path: &Path, emulator: &Emulator) -> Checked {
    if let Some(counts) = emulator.counts_per_revolution {
        check_counts(path, counts)?;
    }
    let Some(torque) = emulator.rated_torque else {
        return Ok(());
    };
    // Object 0x6076 of an EPOS4 holds 32 bits of µN·m.
    let range = "between 0.000001 and 4294 (N·m)";
    in_range(&path.then("rated_torque"), torque, 1e-6, 4294.0, range)
}

fn check_drive(drive: &Path, given: &Drive, max_velocity: f64) -> Checked {
    check_counts(drive, given.counts_per_revolution)?;
    positive(&drive.then("rated_torque"), given.rated_torque)?;
    check_drive_loop(&drive.then("loop"), given, max_velocity)?;
    for (number, parameter) in given.parameter.iter().enumerate() {
        if !matches!(parameter.bytes, 1 | 2 | 4) {
            let value = f64::from(parameter.bytes);
            return Err((
                drive.then("parameter").then(number).then("bytes"),
                Problem::OutOfRange {
                    value,
                    range: "1, 2 or 4",
                },
            ));
        }
    }
    Ok(())
}

fn check_counts(path: &Path, counts: u32) -> Checked {
    in_range(
        &path.then("counts_per_revolution"),
        f64::from(counts),
        4.0,
        1e7,
        "between 4 and 10000000 (quadrature counts)",
    )
}

fn check_controller(
    path: &Path,
    controller: &AxisController,
    serial: &Serial,
    axis: &Axis,
) -> Checked {
    check_counts(path, controller.counts_per_revolution)?;
    positive(&path.then("torque_constant"), controller.torque_constant)?;
    // The telegrams hold 16 bits of milliamperes.
    in_range(
        &path.then("max_current"),
        controller.max_current,
        1e-3,
        32.767,
        "between 0.001 and 32.767 (A)",
    )?;
    let most = match controller.control {
        // More is refused while it moves: the axis would stop by a fault where it needs its torque most.
        Control::Current => (
            controller.max_current * controller.torque_constant * (1.0 + 1e-9),
            "above 0 and at most max_current * torque_constant (N·m)",
        ),
        Control::Pwm => (1.0, "above 0 and at most 1 (of the full pulse width)"),
    };
    let given = &controller.r#loop;
    if let Law::Proportional(_) = given.law {
        let why =
            "is for a drive that closes the velocity loop, as no axis controller does: use cascade";
        let law = path.then("loop").then("law").then("proportional");
        return Err((law, Problem::Refused(why.into())));
    }
    check_loop(&path.then("loop"), given, most, axis.max_velocity)?;
    let plausible = [
        (
            "plausible_velocity",
            controller.plausible_velocity,
            axis.max_velocity,
        ),
        (
            "plausible_acceleration",
            controller.plausible_acceleration,
            axis.max_acceleration,
        ),
    ];
    for (key, given, least) in plausible {
        let value = given.unwrap_or(least);
        let range = "at least what the axis is allowed to do";
        in_range(&path.then(key), value, least, f64::MAX, range)?;
    }
    let refused =
        |key: &'static str, why: &str| Err((path.then(key), Problem::Refused(why.into())));
    match (controller.control, serial.protocol, axis.emulator.plant) {
        (Control::Current, Protocol::HiMoxa, _) => refused(
            "control",
            "is current, which the older protocol's axis controllers do not follow: use pwm",
        ),
        (Control::Pwm, _, Plant::Wut) => refused(
            "control",
            "is pwm, which the emulator's plant wut cannot follow, having no voltage: use the \
             physical one",
        ),
        _ => Ok(()),
    }
}

fn check_drive_loop(path: &Path, drive: &Drive, max_velocity: f64) -> Checked {
    let refused = |path: Path, why: &str| Err((path, Problem::Refused(why.into())));
    let (given, most) = match (drive.control, &drive.r#loop) {
        (DriveControl::Position, None) => return Ok(()),
        (DriveControl::Position, Some(_)) => {
            let why = "is for control = \"velocity\" or \"torque\": by position the drive closes the loop";
            return refused(path.clone(), why);
        }
        (_, None) => {
            let why = "is missing: by velocity or torque the host closes the loop";
            return refused(path.clone(), why);
        }
        (DriveControl::Velocity, Some(given)) => {
            if given.feed_forward.weight.is_some_and(|weight| weight > 0.0) {
                let why = "is a torque: by velocity the drive's own loop holds the weight";
                return refused(path.then("feed_forward").then("weight"), why);
            }
            // A loop at its limit is not to look like one that runs away.
            let runaway = given.runaway_velocity.unwrap_or(1.2 * max_velocity);
            let range = "above 0 and at most runaway_velocity (rad/s of the motor)";
            (given, (runaway, range))
        }
        (DriveControl::Torque, Some(given)) => {
            if let Law::Proportional(_) = given.law {
                let why =
                    "is for control = \"velocity\": by torque nothing would damp it, use cascade";
                return refused(path.then("law").then("proportional"), why);
            }
            // Object 0x6071 holds 16 bits of thousandths.
            let range = "above 0 and at most 32 * rated_torque (N·m)";
            (given, (32.0 * drive.rated_torque, range))
        }
    };
    check_loop(path, given, most, max_velocity)
}

/// `most` is the greatest limit of its output, and the words for it.
fn check_loop(path: &Path, given: &Loop, most: (f64, &'static str), max_velocity: f64) -> Checked {
    let limit = |path: &Path, value| in_range(path, value, f64::MIN_POSITIVE, most.0, most.1);
    let fraction = (0.0, 1.0 - f64::EPSILON, "at least 0 and below 1");
    let not_negative = (0.0, f64::MAX, "at least 0");
    let any = (f64::MIN, f64::MAX, "a number");
    let above = (f64::MIN_POSITIVE, f64::MAX, "above 0");
    let law = path.then("law");
    let numbers = match given.law {
        Law::Incremental(it) => {
            let law = law.then("incremental");
            limit(&law.then("limit"), it.limit)?;
            [
                (law.then("a"), it.a, fraction),
                (law.then("b0"), it.b0, above),
                (law.then("b1"), it.b1, not_negative),
                (law.then("eps"), it.eps, fraction),
                (law.then("gain"), it.gain, above),
            ]
            .to_vec()
        }
        Law::Cascade(it) => {
            let law = law.then("cascade");
            limit(&law.then("limit"), it.limit)?;
            [
                (law.then("position_gain"), it.position_gain, above),
                (law.then("velocity_gain"), it.velocity_gain, above),
                (law.then("integral_rate"), it.integral_rate, not_negative),
            ]
            .to_vec()
        }
        Law::Proportional(it) => {
            let law = law.then("proportional");
            limit(&law.then("limit"), it.limit)?;
            [
                (law.then("position_gain"), it.position_gain, above),
                (law.then("integral_rate"), it.integral_rate, not_negative),
            ]
            .to_vec()
        }
    };
    let forward = path.then("feed_forward");
    let it = given.feed_forward;
    let known = [
        (forward.then("velocity"), it.velocity, not_negative),
        (forward.then("acceleration"), it.acceleration, not_negative),
        (forward.then("coulomb"), it.coulomb, not_negative),
        (
            forward.then("weight"),
            it.weight.unwrap_or(0.0),
            not_negative,
        ),
        (forward.then("constant"), it.constant, any),
    ];
    for (path, value, (low, high, range)) in numbers.into_iter().chain(known) {
        in_range(&path, value, low, high, range)?;
    }
    if let Some(stiction) = it.stiction {
        let range = "at least coulomb";
        in_range(
            &forward.then("stiction"),
            stiction,
            it.coulomb,
            f64::MAX,
            range,
        )?;
        let Some(velocity) = it.stribeck_velocity else {
            let why = "needs the velocity over which it falls: stribeck_velocity";
            return Err((forward.then("stiction"), Problem::Refused(why.into())));
        };
        positive(&forward.then("stribeck_velocity"), velocity)?;
    } else if it.stribeck_velocity.is_some() {
        let why = "is for a friction that is greater at break-away: stiction";
        return Err((
            forward.then("stribeck_velocity"),
            Problem::Refused(why.into()),
        ));
    }
    match given.runaway_velocity {
        Some(value) if value <= max_velocity => {
            let range = "above the axis's max_velocity (rad/s of the motor)";
            Err((
                path.then("runaway_velocity"),
                Problem::OutOfRange { value, range },
            ))
        }
        _ => Ok(()),
    }
}

fn check_homing(homing: &Path, axis: &Axis, place: Place<'_>) -> Checked {
    let method = homing.then("method");
    match (place, axis.homing.method) {
        (Place::Bus(_), Some(given)) if !METHODS.contains(&given) => {
            let value = f64::from(given);
            let range = "37, 34, 33, 27, 23, 18, 17, 11, 7, 2, 1 or -1 to -4";
            return Err((method, Problem::OutOfRange { value, range }));
        }
        (Place::Bus(_), None) => {
            let why = "is missing: a drive homes by one of its methods";
            return Err((method, Problem::Refused(why.into())));
        }
        (Place::Serial(_), Some(_)) => {
            let why = "is a drive's: an axis on a serial line is homed by the host";
            return Err((method, Problem::Refused(why.into())));
        }
        (Place::Bus(_), Some(_)) | (Place::Serial(_), None) => {}
    }
    for (key, value) in [
        ("search_velocity", axis.homing.search_velocity),
        ("zero_velocity", axis.homing.zero_velocity),
    ] {
        let range = "above 0 and at most the axis's max_velocity (rad/s of the motor)";
        in_range(
            &homing.then(key),
            value,
            f64::MIN_POSITIVE,
            axis.max_velocity,
            range,
        )?;
    }
    positive(&homing.then("acceleration"), axis.homing.acceleration)
}

/// The homing methods of an EPOS4.
const METHODS: [i8; 15] = [37, 34, 33, 27, 23, 18, 17, 11, 7, 2, 1, -1, -2, -3, -4];
