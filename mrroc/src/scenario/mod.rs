//! Scenario files: the faults of an emulated cell, in TOML.
//!
//! A scenario has a seed and a list of faults. Each fault has a time or an event, a place, a kind and a duration. The
//! emulators apply the faults on their side of the wire. The same scenario gives the same faults in each run in
//! lockstep. Places are those of a cell file; [`Scenario::resolve`] refuses unknown names with file, line and key.

mod kind;
mod run;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::StandardId;
use hil::{DriveId, Frames, WorldFault};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bench::drive_ids::DriveIds;
use crate::cell::{self, CellError, CellFile, LARGEST};
use crate::input;
pub use kind::{FaultKind, FaultNumbers, FaultPlace};
pub use run::ScenarioRun;

/// A scenario file.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenarioText {
    /// Seed of all random values.
    #[serde(default = "one")]
    pub seed: u64,
    /// The faults.
    #[serde(default)]
    pub fault: Vec<FaultText>,
}

/// One fault. Exactly one of `at`, `when` and `cycle` gives its time. A place is an axis, or a bus, with `node` or
/// `frame` for a part of its frames.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FaultText {
    /// Time of the beginning, s since the emulated devices were switched on.
    pub at: Option<f64>,
    /// Event of the beginning: motion of the robot of `axis`, or of all robots with a drive on `bus`.
    pub when: Option<MotionEvent>,
    /// Time of the beginning in servo periods since the emulated devices were switched on.
    pub cycle: Option<u32>,
    /// The kind.
    pub kind: FaultKind,
    /// Name of the bus.
    pub bus: Option<String>,
    /// Node-ID on the bus.
    pub node: Option<u8>,
    /// COB-ID on the bus.
    pub frame: Option<u16>,
    /// The axis: ROBOT/AXIS, or the name of an axis that is unique in the cell.
    pub axis: Option<String>,
    /// Duration, s; without end where absent.
    pub duration: Option<f64>,
    /// Greatest number of damaged frames.
    pub count: Option<u32>,
    /// Probability that the fault damages a frame or telegram; 1 where absent.
    pub probability: Option<f64>,
    /// Seed of the fault; the seed of the file plus the number of the fault where absent.
    pub seed: Option<u64>,
    /// Delay of `late`, ms.
    pub late_ms: Option<f64>,
    /// Increments of `encoder-jump`.
    pub increments: Option<i32>,
    /// Share of the supply voltage of `sagging-supply`, 0 to 1.
    pub share: Option<f64>,
    /// Distance of `collision`, rad of the motor.
    pub distance: Option<f64>,
    /// Stiffness of `collision`, N·m/rad at the motor.
    pub stiffness: Option<f64>,
    /// Error code of `forged-emergency`.
    pub code: Option<u16>,
}

/// Events of motion, as the emulated plants show them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionEvent {
    /// All motors have been at rest for 100 ms.
    Idle,
    /// A motor moves.
    Moving,
    /// The fastest motor becomes faster.
    Accelerating,
    /// The fastest motor moves at constant speed.
    Cruising,
    /// The fastest motor becomes slower.
    Braking,
}

/// Time of the beginning of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultTime {
    /// Time since power-on.
    At(Duration),
    /// Servo periods since power-on.
    Cycle(u32),
    /// An event.
    When(MotionEvent),
}

/// A scenario file that was read.
#[derive(Clone, Debug)]
pub struct Scenario {
    path: PathBuf,
    text: String,
    scenario: ScenarioText,
}

/// A fault with its place in a world.
pub struct PlacedFault {
    /// Time of the beginning.
    pub time: FaultTime,
    /// Duration; `None` without end.
    pub duration: Option<Duration>,
    /// The faults of the world.
    pub faults: Vec<WorldFault>,
    /// The drives whose motion an event concerns, with their greatest velocities, rad/s.
    pub watched: Vec<(DriveId, f64)>,
}

/// A problem of a fault: key and words.
type Problem = (&'static str, String);

fn one() -> u64 {
    1
}

impl Scenario {
    /// Reads a scenario file. Names of places are checked by [`resolve`](Self::resolve).
    pub fn read(path: impl AsRef<Path>) -> anyhow::Result<Self> {
        let path = path.as_ref();
        let bytes = input::read(path, LARGEST).with_context(|| path.display().to_string())?;
        let text = cell::Cell::text(&bytes).map_err(|error| anyhow!("{}:{error}", path.display()))?;
        Self::parse(path, text)
    }

    /// The scenario of a text. `path` is for messages.
    pub fn parse(path: &Path, text: &str) -> anyhow::Result<Self> {
        let scenario = cell::from_text(text).map_err(|error| anyhow!("{}:{error}", path.display()))?;
        let scenario = Self { path: path.to_owned(), text: text.to_owned(), scenario };
        for (number, fault) in scenario.scenario.fault.iter().enumerate() {
            fault.check().map_err(|problem| scenario.refuse(number, problem))?;
        }
        Ok(scenario)
    }

    /// The JSON schema of scenario files.
    pub fn schema() -> schemars::Schema {
        schemars::schema_for!(ScenarioText)
    }

    /// The scenario of one fault that begins at once, in one line: the kind, then KEY=VALUE for each other key of a fault.
    pub fn of_line(line: &str) -> anyhow::Result<Self> {
        let mut words = line.split_whitespace();
        let kind = words.next().context("the kind of the fault is missing")?;
        let mut text = format!("[[fault]]\nat = 0.0\nkind = {kind:?}\n");
        for word in words {
            let (key, value) = word.split_once('=').with_context(|| format!("{word:?} is not KEY=VALUE"))?;
            let number = value.parse::<f64>().is_ok() || value.starts_with("0x");
            text += &if number { format!("{key} = {value}\n") } else { format!("{key} = {value:?}\n") };
        }
        Self::parse(Path::new("fault"), &text)
    }

    /// The faults in the world of a cell.
    pub fn resolve(&self, file: &CellFile, ids: &DriveIds) -> anyhow::Result<Vec<PlacedFault>> {
        let faults = self.scenario.fault.iter().enumerate();
        let placed = faults.map(|(number, fault)| {
            let seed = fault.seed.unwrap_or(self.scenario.seed.wrapping_add(number as u64));
            fault.place(file, ids, seed).map_err(|problem| self.refuse(number, problem))
        });
        placed.collect()
    }

    fn refuse(&self, number: usize, (key, problem): Problem) -> anyhow::Error {
        let key = cell::Path::to("fault").then(number).then(key);
        anyhow!("{}:{}", self.path.display(), CellError::at(&self.text, &key, problem))
    }
}

impl FaultText {
    /// Checks all that needs no cell.
    fn check(&self) -> Result<(), Problem> {
        let times =
            usize::from(self.at.is_some()) + usize::from(self.when.is_some()) + usize::from(self.cycle.is_some());
        if times != 1 {
            return Err(("at", format!("one of at, when and cycle is needed, and {times} are given")));
        }
        let positive = |value: f64| value.is_finite() && (0.0..=1e6).contains(&value);
        let share = |value: f64| (0.0..=1.0).contains(&value);
        let checks = [
            ("at", self.at, positive as fn(f64) -> bool, "must be 0 to 1000000 s"),
            ("duration", self.duration, positive, "must be 0 to 1000000 s"),
            ("probability", self.probability, share, "must be 0 to 1"),
            ("late_ms", self.late_ms, positive, "must be 0 to 1000000 ms"),
            ("share", self.share, share, "must be 0 to 1"),
            ("distance", self.distance, positive, "must be 0 to 1000000 rad"),
            ("stiffness", self.stiffness, positive, "must be 0 to 1000000 N·m/rad"),
        ];
        for (key, value, sound, problem) in checks {
            if value.is_some_and(|value| !sound(value)) {
                return Err((key, problem.to_owned()));
            }
        }
        if self.axis.is_some() && (self.bus.is_some() || self.node.is_some()) {
            return Err(("axis", "stands for its bus and node, which are not given beside it".to_owned()));
        }
        if self.axis.is_none() && self.bus.is_none() {
            return Err(("kind", "has no place: name an axis or a bus".to_owned()));
        }
        if self.node.is_some() && self.frame.is_some() {
            return Err(("frame", "selects the frames, and node does too: give one of them".to_owned()));
        }
        if self.frame.is_some_and(|id| StandardId::new(id).is_none()) {
            return Err(("frame", "is a COB-ID of 11 bits, 0 to 0x7FF".to_owned()));
        }
        if self.node.is_some_and(|node| !(1..=127).contains(&node)) {
            return Err(("node", "is a node-ID, 1 to 127".to_owned()));
        }
        Ok(())
    }

    fn place(&self, file: &CellFile, ids: &DriveIds, seed: u64) -> Result<PlacedFault, Problem> {
        let seconds = |seconds: f64| Duration::from_secs_f64(seconds);
        let usual = FaultNumbers::default();
        let numbers = FaultNumbers {
            probability: self.probability.unwrap_or(usual.probability),
            count: self.count,
            seed,
            late: self.late_ms.map_or(usual.late, |late| seconds(late * 1e-3)),
            increments: self.increments.unwrap_or(usual.increments),
            share: self.share.unwrap_or(usual.share),
            distance: self.distance.unwrap_or(usual.distance),
            stiffness: self.stiffness.unwrap_or(usual.stiffness),
            code: self.code.unwrap_or(usual.code),
        };
        let (place, robots) = self.find(file, ids)?;
        let faults = self.kind.faults(&place, &numbers).map_err(|problem| ("kind", problem.to_owned()))?;
        let watched = ids.drives.iter().filter(|((robot, _), _)| robots.contains(robot));
        let watched = watched.map(|(&(robot, axis), &drive)| (drive, file.cell.robot[robot].axis[axis].max_velocity));
        let time = match (self.at, self.when, self.cycle) {
            (Some(at), ..) => FaultTime::At(seconds(at)),
            (None, Some(event), _) => FaultTime::When(event),
            (None, None, cycle) => FaultTime::Cycle(cycle.unwrap_or(0)),
        };
        Ok(PlacedFault { time, duration: self.duration.map(seconds), faults, watched: watched.collect() })
    }

    /// The place, and the robots whose motion an event concerns.
    fn find(&self, file: &CellFile, ids: &DriveIds) -> Result<(FaultPlace, Vec<usize>), Problem> {
        let cell = &file.cell;
        let frame = self.frame.and_then(StandardId::new).map(Frames::Id);
        if let Some(name) = &self.axis {
            let axis = file.find_axis(name, false).map_err(|error| ("axis", error.to_string()))?;
            let place = axis_place(file, ids, axis).ok_or_else(|| ("axis", format!("{name} has no emulated drive")))?;
            let place = match (place, frame) {
                (FaultPlace::Bus { bus, node, drive, period, .. }, Some(frames)) => {
                    FaultPlace::Bus { bus, frames, node, drive, period }
                }
                (place, _) => place,
            };
            return Ok((place, vec![axis.0]));
        }
        let name = self.bus.as_deref().unwrap_or_default();
        let Some(index) = cell.bus.iter().position(|bus| bus.name == name) else {
            let names: Vec<_> = cell.bus.iter().map(|bus| bus.name.as_str()).collect();
            return Err(("bus", format!("no bus is called {name:?}; there are {}", names.join(", "))));
        };
        let axes: Vec<_> = cell.axes_on(index).collect();
        let of_node = |node| axes.iter().find(|&&(robot, axis)| cell.robot[robot].axis[axis].node == node);
        let drive = self.node.and_then(of_node).and_then(|axis| ids.drives.get(axis)).copied();
        let frames = frame.or(self.node.map(Frames::FromNode)).unwrap_or(Frames::All);
        let place = FaultPlace::Bus { bus: ids.buses[index], frames, node: self.node, drive, period: cell.period() };
        let mut robots: Vec<_> = axes.iter().map(|(robot, _)| *robot).collect();
        robots.dedup();
        Ok((place, robots))
    }
}

/// Place of the drive of an axis, given as robot and axis number; `None` for an absent drive.
pub fn axis_place(file: &CellFile, ids: &DriveIds, (robot, number): (usize, usize)) -> Option<FaultPlace> {
    let drive = *ids.drives.get(&(robot, number))?;
    let axis = &file.cell.robot[robot].axis[number];
    Some(match file.cell.bus.iter().position(|bus| bus.name == axis.bus) {
        None => FaultPlace::Line(drive),
        Some(index) => FaultPlace::Bus {
            bus: ids.buses[index],
            frames: Frames::FromNode(axis.node),
            node: Some(axis.node),
            drive: Some(drive),
            period: file.cell.period(),
        },
    })
}
