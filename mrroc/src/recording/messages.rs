//! The messages of a recording.
//!
//! Times are nanoseconds of the run, from the same zero as the times in the candump log. All values of axes are those of
//! the motor shafts.

use std::time::Duration;

use can::candump::Direction;
use can::{ControllerState, Frame, Instant, PortError, TraceEntry, TraceEvent, Traced};
use drive::{AxisCommand, Setpoint};
use serial::{LineEntry, LineError, LineEvent};
use servo::{LAW_PARAMETERS, LawParameters, MAX_AXES, Macrostep, Order, Record, ServoFault};

use super::schema::messages;
use crate::cell::CellFile;

messages! {
    /// A call of the servo. The messages of a cycle follow its call.
    Call {
        /// `bring_up`: a poll of the bring-up; `cycle`: set-points were found; `sent`: the batches were sent; `cut`: the
        /// power was switched off without braking.
        kind = 1: [string] String,
        /// Number of the cycle.
        cycle = 2: [uint64] u64,
        /// Deadlines missed since the last cycle.
        missed = 3: [uint32] u32,
        /// Whether a stop was requested.
        stop = 4: [bool] bool,
        /// Requested rate of motion time, 0 to 1.
        rate = 5: [double] f64,
    }

    /// An order of the controller to one robot, in the cycle that found it.
    RobotOrder {
        /// Name of the order, for example `Move`.
        order = 1: [string] String,
        /// Robots of a barrier, robot n by bit n.
        members = 2: [uint32] u32,
        /// Number of the macrostep.
        number = 3: [uint64] u64,
        /// Periods of the macrostep.
        steps = 4: [uint32] u32,
        /// Periods after which the servo reports.
        report_at = 5: [uint32] u32,
        /// Positions at the end, rad.
        position = 6: [double, repeated] Vec<f64>,
        /// Velocities at the end, rad/s.
        velocity = 7: [double, repeated] Vec<f64>,
        /// Accelerations at the end, rad/s²; empty where the servo finds them.
        acceleration = 8: [double, repeated] Vec<f64>,
        /// Feed-forward torques at the end, N·m.
        torque = 9: [double, repeated] Vec<f64>,
        /// Parameters of the cycle law; empty without a law.
        law = 10: [double, repeated] Vec<f64>,
        /// Index of the robot in the cell.
        robot = 11: [uint32] u32,
        /// Whether the macrostep continues the path of the motion before, from which the law has displaced the robot.
        continues_law = 12: [bool] bool,
    }

    /// A change of the fault of a robot.
    RobotFault {
        /// Name of the robot.
        robot = 1: [string] String,
        /// The axis, if one is concerned.
        axis = 2: [string] String,
        /// The cause in words; empty after a reset.
        cause = 3: [string] String,
    }

    /// A value that a driver or a law took from another thread: outputs, requests for a zero or a reset, weights.
    Word {
        /// Index of the word.
        index = 1: [uint32] u32,
        /// The value.
        value = 2: [uint64] u64,
    }

    /// Punctuality of a cycle.
    Timing {
        /// Time from the deadline to the sending of the batches, ns.
        late_ns = 1: [uint64] u64,
        /// Duration of the cycle without waiting, ns.
        step_ns = 2: [uint64] u64,
    }

    /// One cycle of one robot.
    RobotCycle {
        /// Number of the cycle, from 0.
        cycle = 1: [uint64] u64,
        /// Time since the last SYNC, ns.
        dt_ns = 2: [uint64] u64,
        /// Phase of the robot.
        phase = 3: [string] String,
        /// Whether the robot has a fault.
        faulted = 4: [bool] bool,
        /// The axes.
        axis = 5: [message, repeated] Vec<AxisCycle>,
    }

    /// One cycle of one axis.
    AxisCycle {
        /// Commanded position, rad.
        commanded = 1: [double] f64,
        /// Part of the commanded position by a cycle law, rad.
        displacement = 2: [double] f64,
        /// Command to the drive.
        command = 3: [string] String,
        /// Set-point of the command in the unit of the mode of the drive.
        set_point = 4: [double] f64,
        /// Torque added to the set-point, N·m.
        set_point_torque = 5: [double] f64,
        /// Excitation of an identification.
        excitation = 6: [double] f64,
        /// Measured position, rad.
        measured = 7: [double] f64,
        /// Commanded position that the measured position answers, rad.
        expected = 8: [double, optional] Option<f64>,
        /// Counter of the drive.
        increments = 9: [sint32] i32,
        /// Measured velocity, rad/s.
        velocity = 10: [double] f64,
        /// Measured torque, N·m.
        torque = 11: [double] f64,
        /// State of homing.
        homing = 12: [string] String,
    }

    /// A frame on a CAN bus, or another result of its port.
    BusEvent {
        /// `received`, `sent`, `refused`, `failed` or `condition`.
        kind = 1: [string] String,
        /// Whether a call for sending gave the result.
        sending = 2: [bool] bool,
        /// Time of the frame, ns. The time of the message is that of the call.
        at_ns = 3: [uint64] u64,
        /// Identifier with the flags of SocketCAN.
        id = 4: [uint32] u32,
        /// Data; zeros of the same length for a remote frame.
        data = 5: [bytes = "vec"] Vec<u8>,
        /// Number of refused frames.
        count = 6: [uint32] u32,
        /// Error of the operating system; -1 for an interface that is down, -2 for one that was removed.
        error = 7: [sint32] i32,
        /// Fault confinement state: 0 active, 1 warning, 2 passive, 3 bus-off.
        state = 8: [uint32] u32,
        /// Received frames lost before they were read.
        dropped = 9: [uint64] u64,
        /// Error frames.
        errors = 10: [uint64] u64,
    }

    /// Bytes on a serial line, or another result of the line.
    LineData {
        /// `bytes`, `refused`, `failed` or `dropped`.
        kind = 1: [string] String,
        /// Whether a call for sending gave the result.
        sending = 2: [bool] bool,
        /// The bytes, at most 48.
        data = 3: [bytes = "vec"] Vec<u8>,
        /// Number of refused bytes.
        count = 4: [uint32] u32,
        /// Error of the operating system; -2 for a line that is gone.
        error = 5: [sint32] i32,
        /// Bytes lost before they were read.
        dropped = 6: [uint64] u64,
    }

    /// Number of entries that found no room since the start. A recording with losses cannot be replayed.
    Lost {
        /// The number.
        entries = 1: [uint64] u64,
    }
}

/// Code of an interface that is down.
const DOWN: i32 = -1;

/// Code of an interface or a line that was removed.
const GONE: i32 = -2;

impl Timing {
    pub(super) fn of(late: Duration, step: Duration) -> Self {
        let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        Self { late_ns: nanos(late), step_ns: nanos(step) }
    }
}

impl RobotFault {
    pub(super) fn of(file: &CellFile, robot: usize, fault: Option<ServoFault>) -> Self {
        let axis = fault.and_then(|fault| fault.axis);
        Self {
            robot: file.cell.robot[robot].name.clone(),
            axis: axis.map_or_else(String::new, |axis| file.axis_name(robot, axis.into())),
            cause: fault.map_or_else(String::new, |fault| fault.cause.to_string()),
        }
    }
}

impl RobotOrder {
    pub(super) fn of(robot: u8, order: &Order) -> Self {
        let empty = Self { robot: robot.into(), ..Self::default() };
        let named = |name: &str| Self { order: name.to_owned(), ..empty.clone() };
        match order {
            Order::Enable => named("Enable"),
            Order::Home => named("Home"),
            Order::Untie => named("Untie"),
            Order::Stop => named("Stop"),
            Order::Disable => named("Disable"),
            Order::ResetFault => named("ResetFault"),
            Order::Meet { members } => Self { members: *members, ..named("Meet") },
            Order::Tie { members } => Self { members: *members, ..named("Tie") },
            Order::Move(macrostep) => Self {
                number: macrostep.number,
                steps: macrostep.steps.into(),
                report_at: macrostep.report_at.into(),
                position: macrostep.position.to_vec(),
                velocity: macrostep.velocity.to_vec(),
                acceleration: macrostep.acceleration.map_or_else(Vec::new, |it| it.to_vec()),
                torque: macrostep.torque.to_vec(),
                law: macrostep.law.map_or_else(Vec::new, |law| law.0.to_vec()),
                continues_law: macrostep.continues_law,
                ..named("Move")
            },
        }
    }

    /// The order; `None` if the message is none.
    pub(super) fn order(&self) -> Option<Order> {
        let axes = |values: &[f64]| <[f64; MAX_AXES]>::try_from(values).ok();
        Some(match self.order.as_str() {
            "Enable" => Order::Enable,
            "Home" => Order::Home,
            "Untie" => Order::Untie,
            "Stop" => Order::Stop,
            "Disable" => Order::Disable,
            "ResetFault" => Order::ResetFault,
            "Meet" => Order::Meet { members: self.members },
            "Tie" => Order::Tie { members: self.members },
            "Move" => Order::Move(Macrostep {
                number: self.number,
                steps: u16::try_from(self.steps).ok()?,
                report_at: u16::try_from(self.report_at).ok()?,
                position: axes(&self.position)?,
                velocity: axes(&self.velocity)?,
                acceleration: if self.acceleration.is_empty() { None } else { Some(axes(&self.acceleration)?) },
                torque: axes(&self.torque)?,
                law: match self.law.as_slice() {
                    [] => None,
                    law => Some(LawParameters(<[f64; LAW_PARAMETERS]>::try_from(law).ok()?)),
                },
                continues_law: self.continues_law,
            }),
            _ => return None,
        })
    }
}

impl RobotCycle {
    pub(super) fn of(record: &Record) -> Self {
        let axis = |axis: &servo::AxisRecord| {
            let (command, set_point, set_point_torque) = command(axis.command);
            AxisCycle {
                commanded: axis.commanded,
                displacement: axis.displacement,
                command: command.to_owned(),
                set_point,
                set_point_torque,
                excitation: axis.excitation,
                measured: axis.measured,
                expected: axis.expected,
                increments: axis.increments.0,
                velocity: axis.velocity,
                torque: axis.torque,
                homing: format!("{:?}", axis.homing),
            }
        };
        Self {
            cycle: record.cycle,
            dt_ns: u64::try_from(record.dt.as_nanos()).unwrap_or(u64::MAX),
            phase: format!("{:?}", record.phase),
            faulted: record.faulted,
            axis: record.axis[..usize::from(record.axes)].iter().map(axis).collect(),
        }
    }
}

/// Name of a command, its set-point, and the torque beside it.
fn command(command: AxisCommand) -> (&'static str, f64, f64) {
    let (follow, point) = match command {
        AxisCommand::Off => return ("Off", 0.0, 0.0),
        AxisCommand::ResetFault => return ("ResetFault", 0.0, 0.0),
        AxisCommand::Stand => return ("Stand", 0.0, 0.0),
        AxisCommand::Home => return ("Home", 0.0, 0.0),
        AxisCommand::Follow(point) => (true, point),
        AxisCommand::Seek(point) => (false, point),
    };
    let named = |followed, sought| if follow { followed } else { sought };
    match point {
        Setpoint::Position(it) => (named("FollowPosition", "SeekPosition"), it.get(), 0.0),
        Setpoint::PositionWithTorque { position, torque } => {
            (named("FollowPosition", "SeekPosition"), position.get(), torque.get())
        }
        Setpoint::Velocity(it) => (named("FollowVelocity", "SeekVelocity"), it.get(), 0.0),
        Setpoint::Torque(it) => (named("FollowTorque", "SeekTorque"), it.get(), 0.0),
        Setpoint::Duty(it) => (named("FollowDuty", "SeekDuty"), it.get(), 0.0),
    }
}

impl BusEvent {
    pub(super) fn of(entry: &TraceEntry) -> Self {
        let named = |kind: &str, direction| Self {
            kind: kind.to_owned(),
            sending: direction == Direction::Sent,
            ..Self::default()
        };
        match entry.event {
            TraceEvent::Frame(Traced { at, frame, direction }) => {
                let kind = if direction == Direction::Sent { "sent" } else { "received" };
                let mut data = frame.data().to_vec();
                data.resize(frame.len_code().into(), 0);
                Self { at_ns: at.as_nanos(), id: frame.raw_id(), data, ..named(kind, direction) }
            }
            TraceEvent::Refused { count } => Self { count, ..named("refused", Direction::Sent) },
            TraceEvent::Failed { direction, error } => {
                let error = match error {
                    PortError::Down => DOWN,
                    PortError::Gone => GONE,
                    PortError::Os(errno) => errno,
                };
                Self { error, ..named("failed", direction) }
            }
            TraceEvent::Condition { direction, state, dropped, errors } => {
                Self { state: state as u32, dropped, errors, ..named("condition", direction) }
            }
        }
    }

    /// The result of the port at time `now`; `None` if the message is none.
    pub(super) fn entry(&self, now: Instant) -> Option<TraceEntry> {
        let direction = if self.sending { Direction::Sent } else { Direction::Received };
        let event = match self.kind.as_str() {
            "sent" | "received" => {
                let mut data = [0; 8];
                data.get_mut(..self.data.len())?.copy_from_slice(&self.data);
                let frame = Frame::from_raw(self.id, self.data.len() as u8, data)?;
                TraceEvent::Frame(Traced { at: Instant::from_nanos(self.at_ns), frame, direction })
            }
            "refused" => TraceEvent::Refused { count: self.count },
            "failed" => {
                let error = match self.error {
                    DOWN => PortError::Down,
                    GONE => PortError::Gone,
                    errno => PortError::Os(errno),
                };
                TraceEvent::Failed { direction, error }
            }
            "condition" => {
                let states = [
                    ControllerState::Active,
                    ControllerState::Warning,
                    ControllerState::Passive,
                    ControllerState::BusOff,
                ];
                let state = *states.get(self.state as usize)?;
                TraceEvent::Condition { direction, state, dropped: self.dropped, errors: self.errors }
            }
            _ => return None,
        };
        Some(TraceEntry { now, event })
    }
}

impl LineData {
    pub(super) fn of(entry: &LineEntry) -> Self {
        let named =
            |kind: &str| Self { kind: kind.to_owned(), sending: entry.direction == Direction::Sent, ..Self::default() };
        match entry.event {
            LineEvent::Bytes { .. } => Self { data: entry.event.bytes().to_vec(), ..named("bytes") },
            LineEvent::Refused { count } => Self { count, ..named("refused") },
            LineEvent::Failed { error } => {
                let error = match error {
                    LineError::Gone => GONE,
                    LineError::Os(errno) => errno,
                };
                Self { error, ..named("failed") }
            }
            LineEvent::Dropped { total } => Self { dropped: total, ..named("dropped") },
        }
    }

    /// The result of the line at time `now`; `None` if the message is none.
    pub(super) fn entry(&self, now: Instant) -> Option<LineEntry> {
        let direction = if self.sending { Direction::Sent } else { Direction::Received };
        let event = match self.kind.as_str() {
            "bytes" => LineEvent::of_bytes(&self.data),
            "refused" => LineEvent::Refused { count: self.count },
            "failed" if self.error == GONE => LineEvent::Failed { error: LineError::Gone },
            "failed" => LineEvent::Failed { error: LineError::Os(self.error) },
            "dropped" => LineEvent::Dropped { total: self.dropped },
            _ => return None,
        };
        Some(LineEntry { now, direction, event })
    }
}
