//! Kinds of faults, and the faults of the emulated world that each stands for.

use std::time::Duration;

use can::{Frame, StandardId};
use hil::{
    BusId, DeviceFault, DriveId, FrameFault, Frames, HostFault, LineFaults, PlantFault, Stuck, WireFaults, WorldFault,
};
use serde::{Deserialize, Serialize};

/// The kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// Frames, or the bytes of answers, do not arrive.
    Lost,
    /// Frames or bytes arrive later by `late_ms`.
    Late,
    /// Frames or bytes arrive twice.
    Duplicated,
    /// A CAN frame has a CRC error: an error frame follows, and the controller of the sender repeats the frame. On a serial
    /// line, single bits are inverted.
    Corrupted,
    /// A frame arrives after the next frame.
    Reordered,
    /// The controller of the host leaves the bus.
    BusOff,
    /// The controller of the host is error passive.
    ErrorPassive,
    /// The interface of the host is down.
    InterfaceDown,
    /// The interface of the host is removed for ever.
    InterfaceRemoved,
    /// The transmit queue of the host takes nothing.
    QueueFull,
    /// No node acknowledges the frames of the host, which receives nothing.
    NoAcknowledge,
    /// The adapter of the host holds the frames of the host, and sends them at the end of the fault. On a serial line, the
    /// adapter holds telegrams for the drive.
    HostHeld,
    /// The rest of a telegram is lost.
    Torn,
    /// Bytes of nobody arrive before an answer.
    Garbage,
    /// The ends of a line have different baud rates.
    WrongBaud,
    /// The host's end of a line is gone for ever.
    HangUp,
    /// A second master is on the bus or line.
    SecondMaster,
    /// A node resets itself.
    NodeReset,
    /// A drive loses its supply.
    PowerCycle,
    /// A drive is cut off its bus or line.
    Unplugged,
    /// A second node has the node-ID of a drive.
    DuplicateNode,
    /// A drive on a serial line repeats its last answer.
    AnswersFrozen,
    /// Every second answer of a drive on a serial line is the answer before it again.
    AnswersOld,
    /// Every second answer of a drive on a serial line is sent after the next one.
    AnswersReversed,
    /// The answers of a drive on a serial line have wrong contents, with a right checksum if the telegram has one.
    AnswersGarbled,
    /// The answers of a drive on a serial line reach the host as those of the next axis of the robot, and the reverse.
    AnswersSwapped,
    /// The heartbeats of a node do not arrive.
    HeartbeatSilent,
    /// A forged EMCY with `code`.
    ForgedEmergency,
    /// The shaft is blocked.
    Blocked,
    /// The counter of the encoder does not change.
    EncoderFrozen,
    /// The counter of the encoder jumps by `increments`.
    EncoderJump,
    /// The encoder counts backwards.
    EncoderInverted,
    /// The home switch never closes.
    HomeSwitchDead,
    /// The limit switches never close.
    LimitSwitchesDead,
    /// The upper limit switch is closed.
    LimitSwitchClosed,
    /// The encoder has no index pulse.
    IndexMissing,
    /// The power stage trips by over-current.
    OverCurrent,
    /// The power stage trips by over-temperature.
    OverTemperature,
    /// The supply has the share `share` of its voltage.
    SaggingSupply,
    /// The brake does not hold.
    BrakeSlips,
    /// Two phases of the motor are swapped.
    SwappedPhases,
    /// A surface appears before the axis: a buffer `distance` rad before the motor, with `stiffness` N·m/rad.
    Collision,
}

impl FaultKind {
    /// The kinds, each once.
    pub const ALL: [Self; 42] = [
        Self::Lost,
        Self::Late,
        Self::Duplicated,
        Self::Corrupted,
        Self::Reordered,
        Self::BusOff,
        Self::ErrorPassive,
        Self::InterfaceDown,
        Self::InterfaceRemoved,
        Self::QueueFull,
        Self::NoAcknowledge,
        Self::HostHeld,
        Self::Torn,
        Self::Garbage,
        Self::WrongBaud,
        Self::HangUp,
        Self::SecondMaster,
        Self::NodeReset,
        Self::PowerCycle,
        Self::Unplugged,
        Self::DuplicateNode,
        Self::AnswersFrozen,
        Self::AnswersOld,
        Self::AnswersReversed,
        Self::AnswersGarbled,
        Self::AnswersSwapped,
        Self::HeartbeatSilent,
        Self::ForgedEmergency,
        Self::Blocked,
        Self::EncoderFrozen,
        Self::EncoderJump,
        Self::EncoderInverted,
        Self::HomeSwitchDead,
        Self::LimitSwitchesDead,
        Self::LimitSwitchClosed,
        Self::IndexMissing,
        Self::OverCurrent,
        Self::OverTemperature,
        Self::SaggingSupply,
        Self::BrakeSlips,
        Self::SwappedPhases,
        Self::Collision,
    ];
}

/// Place of a fault in the emulated world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultPlace {
    /// A bus, or a part of its frames. `drive` is the drive of the node, if the node is a drive.
    Bus {
        /// The bus.
        bus: BusId,
        /// Frames that a fault of frames concerns.
        frames: Frames,
        /// The node.
        node: Option<u8>,
        /// The drive of the node.
        drive: Option<DriveId>,
        /// Time between two SYNCs.
        period: Duration,
    },
    /// A serial line, with the axis controller at its end.
    Line {
        /// The axis controller.
        drive: DriveId,
        /// That of the next axis of the robot, if it is on a line too.
        next: Option<DriveId>,
    },
}

/// Numbers of a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultNumbers {
    /// Probability that the fault damages a frame or telegram.
    pub probability: f64,
    /// Greatest number of damaged frames.
    pub count: Option<u32>,
    /// Seed of random values.
    pub seed: u64,
    /// Delay of [`FaultKind::Late`].
    pub late: Duration,
    /// Increments of [`FaultKind::EncoderJump`].
    pub increments: i32,
    /// Share of the voltage of [`FaultKind::SaggingSupply`].
    pub share: f64,
    /// Distance of [`FaultKind::Collision`], rad of the motor.
    pub distance: f64,
    /// Stiffness of [`FaultKind::Collision`], N·m/rad at the motor.
    pub stiffness: f64,
    /// Code of [`FaultKind::ForgedEmergency`].
    pub code: u16,
}

impl Default for FaultNumbers {
    fn default() -> Self {
        Self {
            probability: 1.0,
            count: None,
            seed: 1,
            late: Duration::from_millis(5),
            increments: 20_000,
            share: 0.05,
            distance: 1.0,
            stiffness: 20.0,
            code: 0x3210,
        }
    }
}

impl FaultKind {
    /// Name of the kind in scenario files and tables.
    pub fn name(self) -> String {
        // The names of serde are those of the files.
        serde_json::to_value(self).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
    }

    /// Whether the kind uses this key of a scenario at one of its places. Every kind uses the keys that are not listed.
    pub(super) fn uses(self, key: &str) -> bool {
        let of_frames = matches!(self, Self::Lost | Self::Late | Self::Duplicated | Self::Corrupted | Self::Reordered);
        let counts = of_frames || matches!(self, Self::HeartbeatSilent | Self::Torn);
        let of_host = matches!(
            self,
            Self::BusOff
                | Self::ErrorPassive
                | Self::InterfaceDown
                | Self::InterfaceRemoved
                | Self::QueueFull
                | Self::NoAcknowledge
                | Self::HostHeld
        );
        let once = matches!(
            self,
            Self::InterfaceRemoved
                | Self::HangUp
                | Self::Garbage
                | Self::NodeReset
                | Self::EncoderJump
                | Self::ForgedEmergency
        );
        match key {
            "frame" => of_frames,
            "count" | "probability" => counts,
            "seed" => counts || matches!(self, Self::WrongBaud | Self::SecondMaster),
            "duration" => !once,
            "node" => !of_host && self != Self::SecondMaster,
            "late_ms" => self == Self::Late,
            "increments" => self == Self::EncoderJump,
            "share" => self == Self::SaggingSupply,
            "distance" | "stiffness" => self == Self::Collision,
            "code" => self == Self::ForgedEmergency,
            _ => true,
        }
    }

    /// Whether the place must have a drive.
    pub(super) fn is_of_drive(self) -> bool {
        let of_device = matches!(self, Self::NodeReset | Self::PowerCycle | Self::Unplugged);
        of_device || self.is_of_answers() || self.of_plant(&FaultNumbers::default()).is_some()
    }

    /// Whether the kind is a fault of the answers of an axis controller on a serial line.
    fn is_of_answers(self) -> bool {
        matches!(
            self,
            Self::AnswersFrozen
                | Self::AnswersOld
                | Self::AnswersReversed
                | Self::AnswersGarbled
                | Self::AnswersSwapped
        )
    }

    /// The faults of the world, or what is wrong with the place.
    pub fn faults(self, place: &FaultPlace, numbers: &FaultNumbers) -> Result<Vec<WorldFault>, &'static str> {
        if let Some(fault) = self.of_plant(numbers) {
            let drive = place.drive().ok_or("is a fault of an axis: name the axis")?;
            return Ok(vec![WorldFault::Plant { drive, fault }]);
        }
        if self.is_of_answers() && !matches!(place, FaultPlace::Line { .. }) {
            return Err("is a fault of a serial line, and the place is on a bus");
        }
        let device = match self {
            Self::AnswersFrozen => Some(DeviceFault::AnswersFrozen),
            Self::AnswersOld => Some(DeviceFault::AnswersOld),
            Self::AnswersReversed => Some(DeviceFault::AnswersReversed),
            Self::AnswersGarbled => Some(DeviceFault::AnswersGarbled),
            Self::NodeReset => Some(DeviceFault::Reset),
            Self::PowerCycle => Some(DeviceFault::PowerOff),
            Self::Unplugged => Some(DeviceFault::Unplugged),
            _ => None,
        };
        if let Some(fault) = device {
            let drive = place.drive().ok_or("is a fault of a drive: name the axis or the node of a drive")?;
            return Ok(vec![WorldFault::Device { drive, fault }]);
        }
        match *place {
            FaultPlace::Bus { bus, frames, node, period, .. } => self.on_bus(bus, frames, node, period, numbers),
            FaultPlace::Line { drive: DriveId::Line(line), next } if self == Self::AnswersSwapped => match next {
                Some(DriveId::Line(other)) => Ok(vec![WorldFault::SwappedAnswers { lines: [line, other] }]),
                _ => Err("needs a second axis on a serial line"),
            },
            FaultPlace::Line { drive: DriveId::Line(line), .. } => self.on_line(line, numbers),
            FaultPlace::Line { drive: DriveId::Node(_), .. } => {
                Err("is a fault of a serial line, and the drive is on a bus")
            }
        }
    }

    fn of_plant(self, numbers: &FaultNumbers) -> Option<PlantFault> {
        Some(match self {
            Self::Blocked => PlantFault::Blocked,
            Self::EncoderFrozen => PlantFault::EncoderFrozen,
            Self::EncoderJump => PlantFault::EncoderJump(numbers.increments),
            Self::EncoderInverted => PlantFault::EncoderInverted,
            Self::HomeSwitchDead => PlantFault::HomeSwitchDead,
            Self::LimitSwitchesDead => PlantFault::LimitSwitchesDead,
            Self::LimitSwitchClosed => PlantFault::LimitSwitchClosed,
            Self::IndexMissing => PlantFault::IndexMissing,
            Self::OverCurrent => PlantFault::OverCurrent,
            Self::OverTemperature => PlantFault::OverTemperature,
            Self::SaggingSupply => PlantFault::Sagging(numbers.share),
            Self::BrakeSlips => PlantFault::BrakeSlips,
            Self::SwappedPhases => PlantFault::SwappedPhases,
            Self::Collision => PlantFault::Buffer { distance: numbers.distance, stiffness: numbers.stiffness },
            _ => return None,
        })
    }

    fn on_bus(
        self,
        bus: BusId,
        frames: Frames,
        node: Option<u8>,
        period: Duration,
        numbers: &FaultNumbers,
    ) -> Result<Vec<WorldFault>, &'static str> {
        let &FaultNumbers { probability, count, seed, late, .. } = numbers;
        let of_frames = |frames, fault| Ok(vec![WorldFault::Frames { bus, frames, fault, probability, count, seed }]);
        let of_host = |fault| Ok(vec![WorldFault::Host { bus, fault }]);
        let foreign = |id: u16, data: &[u8], every| {
            let id = StandardId::new(id).expect("an identifier of the predefined connection set");
            WorldFault::Foreign { bus, frame: Frame::new(id, data).expect("at most eight bytes"), every }
        };
        let node = || node.map(u16::from).ok_or("needs a node: name the axis or the node");
        match self {
            Self::Lost => of_frames(frames, FrameFault::Lost),
            Self::Late => of_frames(frames, FrameFault::Late(late)),
            Self::Duplicated => of_frames(frames, FrameFault::Duplicated),
            Self::Corrupted => of_frames(frames, FrameFault::Corrupted),
            Self::Reordered => of_frames(frames, FrameFault::Swapped),
            Self::BusOff => of_host(HostFault::BusOff),
            Self::ErrorPassive => of_host(HostFault::ErrorPassive),
            Self::InterfaceDown => of_host(HostFault::Down),
            Self::InterfaceRemoved => of_host(HostFault::Removed),
            Self::QueueFull => of_host(HostFault::QueueFull),
            Self::NoAcknowledge => of_host(HostFault::Unacknowledged),
            Self::HostHeld => of_host(HostFault::Held),
            Self::HeartbeatSilent => {
                let id = StandardId::new(0x700 + node()?).expect("a node-ID has seven bits");
                of_frames(Frames::Id(id), FrameFault::Lost)
            }
            Self::SecondMaster => Ok(vec![foreign(0x080, &[], Some(period))]),
            Self::DuplicateNode => {
                let node = node()?;
                // The boot-up message of the second node, then its first TPDO.
                Ok(vec![foreign(0x700 + node, &[0], None), foreign(0x180 + node, &[0; 8], Some(period))])
            }
            Self::ForgedEmergency => {
                let [low, high] = numbers.code.to_le_bytes();
                Ok(vec![foreign(0x080 + node()?, &[low, high, 0x01, 0, 0, 0, 0, 0], None)])
            }
            _ => Err("is a fault of a serial line, and the place is on a bus"),
        }
    }

    fn on_line(self, line: hil::LineId, numbers: &FaultNumbers) -> Result<Vec<WorldFault>, &'static str> {
        let &FaultNumbers { probability, count, seed, late, .. } = numbers;
        let faults = |to_device, to_host| LineFaults { seed, to_device, to_host, count, ..LineFaults::default() };
        let fault = |faults| Ok(vec![WorldFault::Line { line, faults }]);
        let none = WireFaults::default();
        let both = |wire| fault(faults(wire, wire));
        match self {
            Self::Lost if probability >= 1.0 => fault(faults(none, WireFaults { stuck: Some(Stuck::Silent), ..none })),
            Self::Lost | Self::Torn => both(WireFaults { tear: 0.1 * probability, ..none }),
            Self::Late => fault(LineFaults { late, count, ..LineFaults::default() }),
            Self::HostHeld => fault(LineFaults { held: true, ..LineFaults::default() }),
            Self::Duplicated => both(WireFaults { duplicate: 0.01 * probability, ..none }),
            Self::Corrupted => both(WireFaults { bit_error_rate: 0.01 * probability, ..none }),
            Self::Garbage => {
                Ok(vec![WorldFault::Bytes { line, to_host: true, bytes: (0..24).map(|it| it * 11).collect() }])
            }
            Self::WrongBaud => both(WireFaults { stuck: Some(Stuck::Garbled), ..none }),
            Self::HangUp => Ok(vec![WorldFault::HangUp { line }]),
            // The other program reads the line too, and takes bytes of the answers.
            Self::SecondMaster => fault(faults(none, WireFaults { tear: 0.05, ..none })),
            _ => Err("is a fault of a CAN bus, and the axis is on a serial line"),
        }
    }
}

impl FaultPlace {
    /// The drive at the place.
    pub fn drive(&self) -> Option<DriveId> {
        match *self {
            Self::Bus { drive, .. } => drive,
            Self::Line { drive, .. } => Some(drive),
        }
    }
}
