//! Detectors of faults, and the removal of a detector, which makes its rows red.

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use clap::ValueEnum;
use drive::axis_controller::AxisControllerFault;
use drive::{
    AxisCommand, AxisState, BringUpError, DriveGroup, EmergencyStop, Fault, GroupCounters, Switches, Warnings,
};
use servo::{FrozenWatch, PositionLoop, ServoConfig, StopCause};

/// Detectors of the controller. Each stop has one cause, and each cause belongs to one detector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Detector {
    /// Answers of a drive that are missing, damaged or late.
    Answers,
    /// The heartbeat of a drive, object 0x1017.
    Heartbeat,
    /// Status of a drive: a fault that the drive found by itself, reported in its statusword, its EMCY or its answer.
    DriveStatus,
    /// State of a node: boot-up, NMT state, lost reference, lost power, mode of operation.
    NodeState,
    /// Positions that the motor cannot have reached.
    Plausibility,
    /// Answers or measured positions that stay the same while the set-points change.
    Frozen,
    /// Distance between commanded and measured position, and the bound of the velocity in a stop.
    FollowingError,
    /// Greatest velocity under a loop of the host.
    Runaway,
    /// Brakes that do not hold after an orderly power-off.
    Brake,
    /// Limit switches.
    LimitSwitches,
    /// Errors of the port or the line of the host.
    Port,
    /// Set-points, SYNCs and heartbeats that the port does not take.
    Sending,
    /// Signs of another controller on the bus.
    OtherController,
    /// Time-outs of enabling and homing, and the longest distances of a search.
    TimeOuts,
    /// Deadlines of the host that were missed, in a row or too often.
    Deadlines,
    /// The contact of the emergency stop.
    EmergencyStop,
    /// Checks of macrosteps and set-points. Nothing else protects the motors, so the servo cannot do without these checks.
    #[value(skip)]
    SetPoints,
}

impl Detector {
    /// Name in tables and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Answers => "answers",
            Self::Heartbeat => "heartbeat",
            Self::DriveStatus => "drive status",
            Self::NodeState => "node state",
            Self::Plausibility => "plausibility",
            Self::Frozen => "frozen answers",
            Self::FollowingError => "following error",
            Self::Runaway => "runaway",
            Self::Brake => "brake",
            Self::LimitSwitches => "limit switches",
            Self::Port => "port",
            Self::Sending => "sending",
            Self::OtherController => "other controller",
            Self::TimeOuts => "time-outs",
            Self::Deadlines => "deadlines",
            Self::EmergencyStop => "emergency stop",
            Self::SetPoints => "set-points",
        }
    }

    /// The detector that found the cause of a stop. `None` for causes without a fault of this robot, and for force laws.
    pub fn of(cause: &StopCause) -> Option<Self> {
        Some(match cause {
            StopCause::Drive(fault) => Self::of_drive(fault)?,
            StopCause::FollowingError { .. } | StopCause::NotBraking { .. } => Self::FollowingError,
            StopCause::Frozen { .. } => Self::Frozen,
            StopCause::BrakeSlips { .. } => Self::Brake,
            StopCause::Runaway { .. } | StopCause::Oscillates(_) => Self::Runaway,
            StopCause::LimitSwitch { .. } => Self::LimitSwitches,
            StopCause::NotReady { .. } | StopCause::HomingFailed | StopCause::NoReference(_) => Self::TimeOuts,
            StopCause::Overrun { .. } | StopCause::Overloaded { .. } => Self::Deadlines,
            StopCause::EmergencyStop { .. } => Self::EmergencyStop,
            StopCause::PositionLimit { .. }
            | StopCause::NoRoomToStop { .. }
            | StopCause::VelocityLimit { .. }
            | StopCause::AccelerationLimit { .. }
            | StopCause::NotFinite
            | StopCause::Malformed { .. }
            | StopCause::UnequalSteps { .. }
            | StopCause::OutOfSequence { .. }
            | StopCause::NotAMember { .. }
            | StopCause::LawDisplacement { .. }
            | StopCause::LawSpeed { .. }
            | StopCause::LawLeft { .. }
            | StopCause::NoLaw { .. }
            | StopCause::NotHomed
            | StopCause::Starved { .. } => Self::SetPoints,
            // The origin of the stop is another robot, or the end of the motion as intended.
            StopCause::Partner { .. } | StopCause::Touched => return None,
            // No robot of the table has a force law.
            StopCause::Law(_) => return None,
        })
    }

    fn of_drive(fault: &Fault) -> Option<Self> {
        Some(match fault {
            Fault::Drive { .. } => Self::DriveStatus,
            Fault::Silent { .. } => Self::Answers,
            Fault::HeartbeatLost { .. } => Self::Heartbeat,
            Fault::LeftOperational { .. }
            | Fault::NotBack { .. }
            | Fault::PowerLost { .. }
            | Fault::ModeChanged { .. }
            | Fault::Stuck { .. } => Self::NodeState,
            Fault::NoSearch { .. } => Self::TimeOuts,
            Fault::Implausible { .. } | Fault::NotAtZero { .. } => Self::Plausibility,
            Fault::NotSent { .. }
            | Fault::NotAcknowledged { .. }
            | Fault::HeartbeatNotSent { .. }
            | Fault::HostLate { .. } => Self::Sending,
            Fault::OtherController { .. } => Self::OtherController,
            Fault::Port(_) | Fault::BusOff => Self::Port,
            Fault::AxisController { fault, .. } => return Self::of_axis_controller(*fault),
            _ => return None,
        })
    }

    fn of_axis_controller(fault: AxisControllerFault) -> Option<Self> {
        use AxisControllerFault as F;
        Some(match fault {
            F::Silent { .. } | F::Delayed { .. } | F::Late { .. } => Self::Answers,
            F::NotSent { .. } => Self::Sending,
            F::Line(_) => Self::Port,
            F::Jumped { .. } => Self::Plausibility,
            F::Frozen { .. } | F::Repeated { .. } => Self::Frozen,
            F::Restarted | F::KeepsReference { .. } | F::NotIndexed { .. } => Self::NodeState,
            F::PowerStage | F::Overcurrent | F::Error => Self::DriveStatus,
            // The origin of the stop is another axis of the cabinet.
            F::Cabinet { .. } | F::Refused(_) => return None,
        })
    }

    /// Removes the detector from the configuration of a servo, if it is there.
    pub(super) fn remove_from(self, config: &mut ServoConfig) {
        if self == Self::TimeOuts {
            config.effectors.iter_mut().for_each(|effector| effector.homing_timeout = NEVER);
        }
        let axes = config.effectors.iter_mut().flat_map(|effector| &mut effector.axes);
        match self {
            Self::TimeOuts => axes.filter_map(|axis| axis.homing.as_mut()).for_each(|homing| {
                for leg in [&mut homing.search, &mut homing.zero] {
                    (leg.timeout, leg.distance) = (NEVER, 1e6);
                }
            }),
            // The window of deadlines whose share is judged is a multiple of this number.
            Self::Deadlines => config.max_missed_in_row = u32::MAX,
            Self::Brake => axes.for_each(|axis| axis.brake_watch = false),
            Self::Frozen => axes.for_each(|axis| axis.frozen = FrozenWatch::Off),
            Self::FollowingError => axes.for_each(|axis| axis.following_error = 1e9),
            Self::Runaway => axes.for_each(|axis| {
                if let PositionLoop::Host(host) = &mut axis.position_loop {
                    host.runaway_velocity = 1e9;
                }
            }),
            _ => {}
        }
    }
}

/// Time that no row lasts.
const NEVER: Duration = Duration::from_secs(3600);

/// A drive group whose reports of some detectors do not reach the servo.
pub(super) struct Without {
    group: Box<dyn DriveGroup>,
    without: Vec<Detector>,
}

impl Without {
    /// The group itself where all detectors are on.
    pub(super) fn wrap(group: Box<dyn DriveGroup>, without: &[Detector]) -> Box<dyn DriveGroup> {
        if without.is_empty() { group } else { Box::new(Self { group, without: without.to_vec() }) }
    }
}

impl DriveGroup for Without {
    fn axes(&self) -> usize {
        self.group.axes()
    }

    fn delay(&self) -> usize {
        self.group.delay()
    }

    fn bring_up(&mut self, now: Instant) -> Poll<Result<(), BringUpError>> {
        self.group.bring_up(now)
    }

    fn wait(&mut self, now: Instant) {
        self.group.wait(now);
    }

    fn read(&mut self, now: Instant, states: &mut [AxisState]) {
        self.group.read(now, states);
        let mut hidden = false;
        for state in states.iter_mut() {
            if self.without.contains(&Detector::LimitSwitches) {
                state.switches = Switches { home: state.switches.home, ..Switches::default() };
            }
            let detector = state.fault.and_then(|fault| Detector::of_drive(&fault));
            if detector.is_some_and(|detector| self.without.contains(&detector)) {
                state.fault = None;
                hidden = true;
            }
        }
        // The other axes of the cabinet report only the stop of the hidden one.
        let follows = |fault| matches!(fault, Fault::AxisController { fault: AxisControllerFault::Cabinet { .. }, .. });
        for state in states.iter_mut().filter(|_| hidden) {
            state.fault = state.fault.filter(|fault| !follows(*fault));
        }
    }

    fn write(&mut self, now: Instant, commands: &[AxisCommand]) {
        self.group.write(now, commands);
    }

    fn send(&mut self, now: Instant) -> bool {
        self.group.send(now)
    }

    fn doubt_reference(&mut self, axis: usize) {
        self.group.doubt_reference(axis);
    }

    fn emergency_stop(&self) -> Option<EmergencyStop> {
        let hidden = self.without.contains(&Detector::EmergencyStop);
        self.group.emergency_stop().filter(|_| !hidden)
    }

    fn counters(&self) -> GroupCounters {
        self.group.counters()
    }

    fn warnings(&self) -> &Warnings {
        self.group.warnings()
    }
}
