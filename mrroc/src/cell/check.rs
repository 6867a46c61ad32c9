//! What a cell file must satisfy beyond its shape.

use std::fmt;

use thiserror::Error;

mod axis;
mod meetings;
mod weight;

use super::locate::{self, Path};
use super::{Cell, Instruction, JointGenerator, Plant, Realtime, Robot, Scheduler};
use axis::Place;

/// A refused cell file: where and why, in one line.
#[derive(Clone, Debug, PartialEq)]
pub struct CellError {
    /// The line, from 1.
    pub line: usize,
    /// The dotted key, empty where the text is not TOML.
    pub key: String,
    /// What is wrong.
    pub problem: Problem,
}

impl CellError {
    /// The error of a value that is in its shape but cannot be used, found by somebody else.
    pub fn at(text: &str, path: &Path, problem: impl fmt::Display) -> Self {
        Self {
            line: locate::line_of(text, path),
            key: path.to_string(),
            problem: Problem::Refused(problem.to_string()),
        }
    }
}

impl fmt::Display for CellError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.line)?;
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        self.problem.fmt(f)
    }
}

impl std::error::Error for CellError {}

/// What can be wrong with a cell file.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Problem {
    /// Not TOML, a key that does not exist, or a value of the wrong type.
    #[error("{0}")]
    Shape(String),
    /// NaN or infinity.
    #[error("must be a finite number")]
    NotFinite,
    /// A CPU for a thread under SCHED_DEADLINE.
    #[error(
        "must be left out with scheduler = \"deadline\", which the kernel grants only to a thread that may run on all CPUs"
    )]
    PinnedDeadline,
    /// A number outside its range.
    #[error("is {value}, must be {range}")]
    OutOfRange {
        /// The number.
        value: f64,
        /// The range in words.
        range: &'static str,
    },
    /// Limits upside down.
    #[error("is {low}, not below the upper limit {high}")]
    UpsideDown {
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// An upper limit below the lower one that the model has.
    #[error("is {high}, not above the lower limit {low}")]
    BelowLow {
        /// The lower limit.
        low: f64,
        /// The upper limit.
        high: f64,
    },
    /// A limit outside those that the model has.
    #[error("is {value}, must lie within the model's limits {low} and {high}")]
    BeyondModel {
        /// The limit.
        value: f64,
        /// The model's lower limit.
        low: f64,
        /// The model's upper limit.
        high: f64,
    },
    /// A second use of something that must be unique.
    #[error("{what} is used twice, first by {first}")]
    Twice {
        /// What is used twice.
        what: String,
        /// The key that used it first.
        first: String,
    },
    /// A name that nothing bears.
    #[error("no {kind} is called {name:?}")]
    Unknown {
        /// What was looked for.
        kind: &'static str,
        /// The name.
        name: String,
    },
    /// A wrong number of things.
    #[error("has {found} {what}, must have {expected}")]
    Count {
        /// How many there are.
        found: usize,
        /// How many there must be.
        expected: usize,
        /// Of what.
        what: &'static str,
    },
    /// Something that another part of the program refused.
    #[error("{0}")]
    Refused(String),
}

pub(super) fn parse(text: &str) -> Result<Cell, CellError> {
    let cell: Cell = toml::from_str(text).map_err(|error| CellError {
        line: error
            .span()
            .map_or(1, |span| locate::line_at(text, span.start)),
        key: String::new(),
        problem: Problem::Shape(error.message().lines().collect::<Vec<_>>().join(", ")),
    })?;
    if let Some((key, line)) = locate::first_not_finite(text) {
        return Err(CellError {
            line,
            key,
            problem: Problem::NotFinite,
        });
    }
    check(&cell).map_err(|(path, problem)| CellError {
        line: locate::line_of(text, &path),
        key: path.to_string(),
        problem,
    })?;
    Ok(cell)
}

type Checked = Result<(), (Path, Problem)>;

fn check(cell: &Cell) -> Checked {
    let top = Path::default();
    in_range(
        &top.then("period_us"),
        f64::from(cell.period_us),
        1000.0,
        1_000_000.0,
        "between 1000 and 1000000 (µs)",
    )?;
    if !cell.period_us.is_multiple_of(1000) {
        let range = "a multiple of 1000 (µs), the drives' unit of the interpolation period";
        return Err((
            top.then("period_us"),
            Problem::OutOfRange {
                value: f64::from(cell.period_us),
                range,
            },
        ));
    }
    in_range(
        &top.then("macrostep"),
        f64::from(cell.macrostep),
        1.0,
        1000.0,
        "between 1 and 1000 (periods)",
    )?;
    in_range(
        &top.then("max_missed_in_row"),
        f64::from(cell.max_missed_in_row),
        1.0,
        1e6,
        "at least 1",
    )?;
    let priority = top.then("realtime").then("priority");
    in_range(
        &priority,
        f64::from(cell.realtime.priority),
        1.0,
        99.0,
        "between 1 and 99",
    )?;
    check_scheduler(cell)?;
    check_wait(cell)?;
    check_buses(cell)?;
    check_serial(cell)?;
    in_range(
        &top.then("meeting_timeout_s"),
        f64::from(cell.meeting_timeout_s),
        1.0,
        86_400.0,
        "between 1 and 86400 (s)",
    )?;
    check_robots(cell)?;
    meetings::check(cell)
}

fn check_scheduler(cell: &Cell) -> Checked {
    let Realtime { scheduler, cpu, .. } = cell.realtime;
    match (scheduler, cpu) {
        (Scheduler::Deadline, Some(_)) => Err((
            Path::default().then("realtime").then("cpu"),
            Problem::PinnedDeadline,
        )),
        _ => Ok(()),
    }
}

fn check_wait(cell: &Cell) -> Checked {
    let path = Path::default().then("realtime");
    let share = cell.realtime.spin_share;
    let key = path.then("spin_share");
    in_range(&key, share, 0.0, 0.5, "between 0 and 0.5 (of a core)")?;
    in_range(
        &path.then("margin_us"),
        f64::from(cell.realtime.margin_us.unwrap_or(0)),
        0.0,
        share * f64::from(cell.period_us),
        "at most spin_share of the period (µs)",
    )
}

fn check_buses(cell: &Cell) -> Checked {
    let buses = Path::default().then("bus");
    at_least_one(
        &buses,
        cell.bus.len() + cell.serial.len(),
        "buses, and no serial lines either",
    )?;
    for (index, bus) in cell.bus.iter().enumerate() {
        let path = buses.then(index);
        if let Some(first) = cell.bus[..index]
            .iter()
            .position(|other| other.name == bus.name)
        {
            return Err((
                path.then("name"),
                twice(format!("bus {:?}", bus.name), &buses.then(first)),
            ));
        }
        if let Some(first) = cell.bus[..index]
            .iter()
            .position(|other| other.interface == bus.interface)
        {
            return Err((
                path.then("interface"),
                twice(format!("interface {:?}", bus.interface), &buses.then(first)),
            ));
        }
        if can::timing::Bitrate::from_kbps(bus.bitrate_kbps).is_none() {
            let range = "10 to 1000 kbit/s with a bit time of whole nanoseconds";
            return Err((
                path.then("bitrate_kbps"),
                Problem::OutOfRange {
                    value: f64::from(bus.bitrate_kbps),
                    range,
                },
            ));
        }
        in_range(
            &path.then("host_node"),
            f64::from(bus.host_node),
            1.0,
            127.0,
            "between 1 and 127",
        )?;
        in_range(
            &path.then("heartbeat_ms"),
            f64::from(bus.heartbeat_ms),
            1.0,
            10_000.0,
            "between 1 and 10000 (ms)",
        )?;
        in_range(
            &path.then("tolerated_missing"),
            f64::from(bus.tolerated_missing),
            0.0,
            1000.0,
            "at most 1000 (cycles)",
        )?;
        in_range(
            &path.then("sdo_timeout_ms"),
            f64::from(bus.sdo_timeout_ms),
            1.0,
            60_000.0,
            "between 1 and 60000 (ms)",
        )?;
        in_range(
            &path.then("boot_timeout_ms"),
            f64::from(bus.boot_timeout_ms),
            1.0,
            60_000.0,
            "between 1 and 60000 (ms)",
        )?;
    }
    Ok(())
}

fn check_serial(cell: &Cell) -> Checked {
    let bundles = Path::default().then("serial");
    for (index, bundle) in cell.serial.iter().enumerate() {
        let path = bundles.then(index);
        let buses = cell.bus.iter().map(|bus| &bus.name).enumerate();
        let buses = buses.map(|(number, name)| (Path::default().then("bus").then(number), name));
        let before = cell.serial[..index].iter().map(|other| &other.name);
        let before = before
            .enumerate()
            .map(|(number, name)| (bundles.then(number), name));
        if let Some((first, _)) = buses.chain(before).find(|(_, name)| **name == bundle.name) {
            let what = format!("bus {:?}", bundle.name);
            return Err((path.then("name"), twice(what, &first)));
        }
        let ranges = [
            (
                "baud",
                bundle.baud,
                (9_600.0, 4e6),
                "between 9600 and 4000000",
            ),
            (
                "tolerated_missing",
                bundle.tolerated_missing,
                (1.0, 10.0),
                "between 1 and 10 (cycles)",
            ),
            (
                "answer_timeout_ms",
                bundle.answer_timeout_ms,
                (1.0, 1000.0),
                "between 1 and 1000 (ms)",
            ),
            (
                "emulated_latency_ms",
                bundle.emulated_latency_ms.unwrap_or(1),
                (1.0, 255.0),
                "between 1 and 255 (ms)",
            ),
        ];
        for (key, value, (low, high), range) in ranges {
            in_range(&path.then(key), f64::from(value), low, high, range)?;
        }
    }
    Ok(())
}

fn check_robots(cell: &Cell) -> Checked {
    let robots = Path::default().then("robot");
    at_least_one(&robots, cell.robot.len(), "robots")?;
    let mut taken: Vec<(String, Path)> = Vec::new();
    for (index, robot) in cell.robot.iter().enumerate() {
        let path = robots.then(index);
        if let Some(first) = cell.robot[..index]
            .iter()
            .position(|other| other.name == robot.name)
        {
            return Err((
                path.then("name"),
                twice(format!("robot {:?}", robot.name), &robots.then(first)),
            ));
        }
        let kinematics = robot
            .kinematics()
            .map_err(|error| (path.then("parameters"), Problem::Refused(error.to_string())))?;
        let expected = robot.model.axes();
        if kinematics.axes() != expected {
            let problem = Problem::Count {
                found: kinematics.axes(),
                expected,
                what: "axes",
            };
            return Err((path.then("parameters"), problem));
        }
        if robot.axis.len() != expected {
            return Err((
                path.then("axis"),
                Problem::Count {
                    found: robot.axis.len(),
                    expected,
                    what: "axes",
                },
            ));
        }
        let axes = path.then("axis");
        for (number, axis) in robot.axis.iter().enumerate() {
            let path = axes.then(number);
            if let Some(first) = robot.axis[..number]
                .iter()
                .position(|other| other.name == axis.name)
            {
                return Err((
                    path.then("name"),
                    twice(format!("axis {:?}", axis.name), &axes.then(first)),
                ));
            }
            let Some(place) = Place::of(cell, &axis.bus) else {
                return Err((
                    path.then("bus"),
                    Problem::Unknown {
                        kind: "bus",
                        name: axis.bus.clone(),
                    },
                ));
            };
            axis::check(&path, axis, place, kinematics.motor_limits()[number])?;
            if axis.emulator.plant == Plant::Wut && !robot.model.is_on_pedestal() {
                let why = "is wut, which is known of the robots on pedestals only: use physical";
                let path = path.then("emulator").then("plant");
                return Err((path, Problem::Refused(why.into())));
            }
            let unique = match place {
                Place::Bus(bus) if axis.node == bus.host_node => {
                    let what = format!("node {} of bus {:?}", axis.node, bus.name);
                    return Err((
                        path.then("node"),
                        Problem::Twice {
                            what,
                            first: "the host".into(),
                        },
                    ));
                }
                Place::Bus(bus) => ("node", format!("node {} of bus {:?}", axis.node, bus.name)),
                Place::Serial(_) => {
                    let line = axis.controller.as_ref().map_or("", |it| it.line.as_str());
                    ("controller", format!("line {line:?}"))
                }
            };
            let (key, what) = unique;
            if let Some((_, first)) = taken.iter().find(|(other, _)| *other == what) {
                return Err((path.then(key), twice(what, first)));
            }
            taken.push((what, path));
        }
        weight::check(&path, robot, &*kinematics)?;
        check_program(&path.then("program"), robot)?;
        check_payloads(&path.then("emulated_payload"), robot)?;
    }
    Ok(())
}

fn check_payloads(path: &Path, robot: &Robot) -> Checked {
    for (number, payload) in robot.emulated_payload.iter().enumerate() {
        let path = path.then(number);
        if robot.model.axes() == 1 {
            let why = "is of a gripper or conveyor, whose emulation carries nothing: leave it out";
            return Err((path, Problem::Refused(why.into())));
        }
        if let Some(axis) = robot.axis.iter().find(|it| it.emulator.plant == Plant::Wut) {
            let name = &axis.name;
            let why =
                format!("would not be felt by axis {name:?}, whose plant is wut: use physical");
            return Err((path, Problem::Refused(why)));
        }
        let at = path.then("at_s");
        in_range(&at, payload.at_s, 0.0, 1e6, "between 0 and 1e6 (s)")?;
        let mass = path.then("mass");
        in_range(&mass, payload.mass, 0.0, 1e3, "between 0 and 1000 (kg)")?;
        for (number, part) in payload.centre.into_iter().enumerate() {
            let centre = path.then("centre").then(number);
            in_range(&centre, part, -10.0, 10.0, "between -10 and 10 (m)")?;
        }
    }
    Ok(())
}

fn check_program(path: &Path, robot: &Robot) -> Checked {
    for (number, instruction) in robot.program.iter().enumerate() {
        let path = path.then(number);
        match instruction {
            Instruction::Joints(joints) => {
                let path = path.then("joints");
                let poses = path.then("poses");
                at_least_one(&poses, joints.poses.len(), "poses")?;
                for (index, pose) in joints.poses.iter().enumerate() {
                    if pose.len() != robot.axis.len() {
                        let problem = Problem::Count {
                            found: pose.len(),
                            expected: robot.axis.len(),
                            what: "joint values",
                        };
                        return Err((poses.then(index), problem));
                    }
                }
                in_range(
                    &path.then("velocity"),
                    joints.velocity,
                    1e-3,
                    1.0,
                    "between 0.001 and 1 (of the greatest)",
                )?;
                in_range(
                    &path.then("acceleration"),
                    joints.acceleration,
                    1e-3,
                    1.0,
                    "between 0.001 and 1 (of the greatest)",
                )?;
                if let Some(duration) = joints.duration {
                    let path = path.then("duration");
                    if joints.generator != JointGenerator::JerkLimited {
                        let why = "is for jerk-limited motions: use generator = \"jerk-limited\"";
                        return Err((path, Problem::Refused(why.into())));
                    }
                    in_range(
                        &path,
                        duration,
                        1e-3,
                        86_400.0,
                        "between 0.001 and 86400 (s)",
                    )?;
                }
            }
            Instruction::Meet(_) => {}
            Instruction::Line(line) => {
                let path = path.then("line");
                positive(&path.then("velocity"), line.velocity)?;
                positive(&path.then("acceleration"), line.acceleration)?;
                if let Some(quaternion) = line.quaternion {
                    let norm = quaternion
                        .iter()
                        .map(|part| part * part)
                        .sum::<f64>()
                        .sqrt();
                    in_range(&path.then("quaternion"), norm, 0.999, 1.001, "of length 1")?;
                }
            }
        }
    }
    Ok(())
}

fn in_range(path: &Path, value: f64, low: f64, high: f64, range: &'static str) -> Checked {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err((path.clone(), Problem::OutOfRange { value, range }))
    }
}

fn positive(path: &Path, value: f64) -> Checked {
    if value > 0.0 {
        Ok(())
    } else {
        Err((
            path.clone(),
            Problem::OutOfRange {
                value,
                range: "above 0",
            },
        ))
    }
}

fn at_least_one(path: &Path, found: usize, what: &'static str) -> Checked {
    if found > 0 {
        Ok(())
    } else {
        Err((
            path.clone(),
            Problem::Count {
                found,
                expected: 1,
                what,
            },
        ))
    }
}

fn twice(what: String, first: &Path) -> Problem {
    Problem::Twice {
        what,
        first: first.to_string(),
    }
}
