//! Scenario files: the faults of an emulated cell, in TOML.
//!
//! A scenario has a seed and a list of faults. Each fault has a time or an event, a place, a kind and a duration. The
//! emulators apply the faults on their side of the wire. The same scenario gives the same faults in each run in
//! lockstep. Places are those of a cell file; [`Scenario::resolve`] refuses unknown names with file, line and key.

mod check;
mod kind;
mod run;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::StandardId;
use hil::{DriveId, Frames, WorldFault};
use serde::{Deserialize, Serialize};

use crate::bench::drive_ids::DriveIds;
use crate::cell::{self, CellError, CellFile, LARGEST};
use crate::input;
pub use kind::{FaultKind, FaultNumbers, FaultPlace};
pub use run::{ScenarioProbe, ScenarioRun};

/// A scenario file.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScenarioText {
    /// Seed of all random values.
    #[serde(default = "one")]
    pub seed: u64,
    /// The faults.
    #[serde(default)]
    pub fault: Vec<FaultText>,
}

/// One fault. Its beginning is `at`, `cycle` or `when`, or `when` from `at` on. A place is an axis, or a bus, with `node`
/// or `frame` for a part of its frames.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FaultText {
    /// Time of the beginning, s since the emulated devices were switched on.
    pub at: Option<f64>,
    /// Event of the beginning: motion of the robot of `axis`, or of all robots with a drive on `bus`. With `at`, the fault
    /// begins the first time that the event is the case at this time or later.
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
    /// The axis: ROBOT.AXIS, or the name of an axis that is unique in the cell.
    pub axis: Option<String>,
    /// Duration, s; without end where absent.
    pub duration: Option<f64>,
    /// Greatest number of damaged frames or telegrams; without limit where absent.
    pub count: Option<u32>,
    /// Probability that the fault damages a frame or telegram; 1 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().probability)))]
    pub probability: Option<f64>,
    /// Seed of the fault; the seed of the file plus the number of the fault where absent.
    pub seed: Option<u64>,
    /// Delay of `late`, ms; 5 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().late.as_secs_f64() * 1e3)))]
    pub late_ms: Option<f64>,
    /// Increments of `encoder-jump`; 20000 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().increments)))]
    pub increments: Option<i32>,
    /// Share of the supply voltage of `sagging-supply`, 0 to less than 1; 0.05 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().share)))]
    pub share: Option<f64>,
    /// Distance of `collision`, rad of the motor; 1 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().distance)))]
    pub distance: Option<f64>,
    /// Stiffness of `collision`, N·m/rad at the motor; 20 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().stiffness)))]
    pub stiffness: Option<f64>,
    /// Error code of `forged-emergency`; 0x3210 where absent.
    #[cfg_attr(feature = "schema", schemars(extend("default" = FaultNumbers::default().code)))]
    pub code: Option<u16>,
}

/// Events of motion, as the emulated plants show them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    /// An event at or after a time since power-on.
    When(MotionEvent, Duration),
}

/// A scenario file that was read.
#[derive(Clone, Debug)]
pub struct Scenario {
    origin: Origin,
    text: String,
    scenario: ScenarioText,
}

/// Origin of a scenario, for messages.
#[derive(Clone, Debug)]
enum Origin {
    File(PathBuf),
    /// A line that was typed.
    Line(String),
}

/// A fault with its place in a world.
pub struct PlacedFault {
    /// Number, kind and beginning, for reports.
    pub label: String,
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
        Self::of(Origin::File(path.to_owned()), text)
    }

    fn of(origin: Origin, text: &str) -> anyhow::Result<Self> {
        let scenario: ScenarioText = cell::from_text(text).map_err(|error| origin.refuse(&error))?;
        if scenario.fault.is_empty() {
            let problem = "is missing: a scenario has at least one fault";
            return Err(origin.refuse(&CellError::at(text, &cell::Path::to("fault"), problem)));
        }
        let scenario = Self { origin, text: text.to_owned(), scenario };
        for (number, fault) in scenario.scenario.fault.iter().enumerate() {
            fault.check().map_err(|problem| scenario.refuse(number, problem))?;
        }
        Ok(scenario)
    }

    /// The JSON schema of scenario files.
    #[cfg(feature = "schema")]
    pub fn schema() -> schemars::Schema {
        schemars::schema_for!(ScenarioText)
    }

    /// The scenario of one fault that begins at once, in one line: the kind, then KEY=VALUE for each other key of a fault.
    pub fn of_line(line: &str) -> anyhow::Result<Self> {
        let mut words = line.split_whitespace();
        let kind = words.next().context("the kind of the fault is missing")?;
        let origin = Origin::Line(line.trim().to_owned());
        let refuse = |key: &str, problem: String| origin.refuse(&CellError { line: 0, key: key.to_owned(), problem });
        let mut text = format!("[[fault]]\nat = 0.0\nkind = {kind:?}\n");
        for word in words {
            let (key, value) = word.split_once('=').ok_or_else(|| refuse("", format!("{word:?} is not KEY=VALUE")))?;
            if matches!(key, "at" | "cycle" | "when") {
                return Err(refuse(key, "a live fault begins at once and takes no at, cycle or when".to_owned()));
            }
            let number = value.parse::<f64>().is_ok() || value.starts_with("0x");
            text += &if number { format!("{key} = {value}\n") } else { format!("{key} = {value:?}\n") };
        }
        Self::of(origin, &text)
    }

    /// The faults in the world of a cell.
    pub fn resolve(&self, file: &CellFile, ids: &DriveIds) -> anyhow::Result<Vec<PlacedFault>> {
        let faults = self.scenario.fault.iter().enumerate();
        let placed = faults.map(|(number, fault)| {
            let seed = fault.seed.unwrap_or(self.scenario.seed.wrapping_add(number as u64));
            let label = format!("fault[{number}] ({}, {})", fault.kind.name(), fault.beginning());
            fault.place(file, ids, (seed, label)).map_err(|problem| self.refuse(number, problem))
        });
        placed.collect()
    }

    fn refuse(&self, number: usize, (key, problem): Problem) -> anyhow::Error {
        let key = cell::Path::to("fault").then(number).then(key);
        self.origin.refuse(&CellError::at(&self.text, &key, problem))
    }
}

impl Origin {
    /// The message of an error: with file, line and key, or with the typed line and its key.
    fn refuse(&self, error: &CellError) -> anyhow::Error {
        match self {
            Self::File(path) => anyhow!("{}:{error}", path.display()),
            Self::Line(typed) => {
                let key = error.key.strip_prefix("fault[0].").unwrap_or(&error.key);
                let separator = if key.is_empty() { "" } else { ": " };
                anyhow!("{typed:?}: {key}{separator}{}", error.problem)
            }
        }
    }
}

impl FaultText {
    /// The fault in the world of a cell, with its seed and label.
    fn place(&self, file: &CellFile, ids: &DriveIds, (seed, label): (u64, String)) -> Result<PlacedFault, Problem> {
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
        self.check_at(&place)?;
        let faults = self.kind.faults(&place, &numbers).map_err(|problem| ("kind", problem.to_owned()))?;
        let watched = ids.drives.iter().filter(|((robot, _), _)| robots.contains(robot));
        let watched = watched.map(|(&(robot, axis), &drive)| (drive, file.cell.robot[robot].axis[axis].max_velocity));
        let time = match (self.when, self.cycle) {
            (Some(event), _) => FaultTime::When(event, seconds(self.at.unwrap_or(0.0))),
            (None, Some(cycle)) => FaultTime::Cycle(cycle),
            (None, None) => FaultTime::At(seconds(self.at.unwrap_or(0.0))),
        };
        Ok(PlacedFault { label, time, duration: self.duration.map(seconds), faults, watched: watched.collect() })
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
            let there_are =
                if names.is_empty() { "the cell has none".into() } else { format!("there are {}", names.join(", ")) };
            return Err(("bus", format!("no bus is called {name:?}; {there_are}")));
        };
        let axes: Vec<_> = cell.axes_on(index).collect();
        let of_node = |node| axes.iter().find(|&&(robot, axis)| cell.robot[robot].axis[axis].node == node);
        let drive = self.node.and_then(of_node).and_then(|axis| ids.drives.get(axis)).copied();
        if let Some(node) = self.node.filter(|_| drive.is_none() && self.kind.is_of_drive()) {
            let drives = axes.iter().filter(|axis| ids.drives.contains_key(axis));
            let nodes: Vec<_> = drives.map(|&(robot, axis)| cell.robot[robot].axis[axis].node.to_string()).collect();
            return Err(("node", format!("no drive on bus {name} has node {node}; there are {}", nodes.join(", "))));
        }
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
    let axes = &file.cell.robot[robot].axis;
    let axis = &axes[number];
    let next = || Some((number + 1) % axes.len()).filter(|next| *next != number);
    Some(match file.cell.bus.iter().position(|bus| bus.name == axis.bus) {
        None => FaultPlace::Line { drive, next: next().and_then(|next| ids.drives.get(&(robot, next)).copied()) },
        Some(index) => FaultPlace::Bus {
            bus: ids.buses[index],
            frames: Frames::FromNode(axis.node),
            node: Some(axis.node),
            drive: Some(drive),
            period: file.cell.period(),
        },
    })
}
