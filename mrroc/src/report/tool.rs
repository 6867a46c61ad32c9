//! How far the tool of each robot was from its commanded path.
//!
//! Each record of the servo has the measured position of every motor and the command that the position answers. The
//! kinematics turns both into the pose of the tool. Cycles count in which the robot moves by set-points or stands with
//! power and a reference; homing does not count.

use can::Instant;
use controller::generator::{Axes, Pose};
use controller::robot::{Arm, KinematicsError, LinkKind};
use drive::device::DeviceSample;
use serde::Serialize;
use servo::{Record, TrackingError};

use super::curves::{Curve, Path};
use super::devices::DeviceReport;
use super::last_cycles::{LastCycles, Recorded};
use crate::cell::CellFile;

/// What the error of a robot is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// The tool, in the base frame.
    Tool,
    /// The joint of a device of one axis.
    Joint,
}

impl Subject {
    /// What reports call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tool => "tool",
            Self::Joint => "joint",
        }
    }
}

/// Size of an error over the cycles that count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Deviation {
    /// Root mean square.
    pub rms: f64,
    /// Greatest absolute value.
    pub peak: f64,
}

/// One robot of the report: how far it was from its commanded path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotReport {
    /// The robot's name.
    pub name: String,
    /// What the errors are of.
    pub subject: Subject,
    /// Cycles that count: the robot moved by set-points, or stood with power and a reference.
    pub cycles: u64,
    /// Cycles that would count, if the kinematics had an answer for the measured or the commanded motor positions.
    pub unsolved: u64,
    /// Distance of the measured from the commanded position, mm; null without a cycle that counts.
    pub position_mm: Option<Deviation>,
    /// Angle between the measured and the commanded orientation, degrees; null for a device whose joint is linear.
    pub orientation_deg: Option<Deviation>,
}

impl Deviation {
    /// `None` without a cycle that counts.
    fn of(error: &TrackingError) -> Option<Self> {
        (error.samples > 0).then(|| Self { rms: error.rms(), peak: error.peak })
    }
}

/// The robots of a run, followed record by record.
pub(crate) struct Tracks {
    pub(crate) robots: Vec<Track>,
    /// The devices of other crates.
    pub(crate) devices: Vec<DeviceReport>,
    /// When the first cycle was.
    first: Option<Instant>,
    /// Names of the axes of each robot.
    axes: Vec<Vec<String>>,
}

impl Tracks {
    /// All robots of a cell. Curves are kept for plots if `plotted`.
    pub(crate) fn new(file: &CellFile, plotted: bool) -> Self {
        let robots = file.cell.robot.iter().zip(&file.arms);
        let track = |(robot, arm): (&crate::cell::Robot, &Arm)| {
            // A gripper and a conveyor have one axis and carry no tool.
            let subject = if robot.numbers().axes() > 1 { Subject::Tool } else { Subject::Joint };
            Track::new(&robot.name, arm.clone(), subject, plotted)
        };
        let axes = |(number, robot): (usize, &crate::cell::Robot)| {
            (0..robot.axis.len()).map(|axis| file.axis_name(number, axis)).collect()
        };
        let axes = file.cell.robot.iter().enumerate().map(axes).collect();
        Self { robots: robots.map(track).collect(), devices: DeviceReport::all(file), first: None, axes }
    }

    pub(crate) fn observe(&mut self, record: &Record) {
        let first = *self.first.get_or_insert(record.at);
        if let Some(track) = self.robots.get_mut(usize::from(record.effector)) {
            let time = record.at.since(first).as_secs_f64();
            track.recorded.observe(record, time);
            track.observe(record, time);
        }
    }

    /// Takes a sample of device `device`; `None`: the device has a fault.
    pub(crate) fn sample(&mut self, device: usize, sample: Option<&DeviceSample>) {
        if let (Some(report), Some(sample)) = (self.devices.get_mut(device), sample) {
            report.observe(sample);
        }
    }

    /// The last cycles up to the fault that stopped robot `robot` in cycle `cycle`.
    pub(crate) fn up_to_fault(&self, robot: usize, cycle: u64) -> Option<LastCycles> {
        let cycles = self.robots[robot].recorded.up_to_fault(cycle)?.to_vec();
        Some(LastCycles { axes: self.axes[robot].clone(), cycles })
    }

    /// Names of the robots that began to stop in cycle `cycle`, or in the cycle after.
    pub(crate) fn stopped_in(&self, cycle: u64) -> Vec<String> {
        let stopped = self.robots.iter().filter(|track| track.recorded.stopped_in(cycle));
        stopped.map(|track| track.name.clone()).collect()
    }

    pub(crate) fn reports(&self) -> Vec<RobotReport> {
        self.robots.iter().map(Track::report).collect()
    }
}

pub(crate) struct Track {
    pub(crate) name: String,
    pub(crate) subject: Subject,
    arm: Arm,
    /// Whether each joint slides.
    pub(crate) linear: Vec<bool>,
    unsolved: u64,
    position: TrackingError,
    orientation: TrackingError,
    pub(crate) curves: Option<Curves>,
    recorded: Recorded,
}

/// What is plotted of a robot: joints in degrees or mm, the tool in mm.
#[derive(Debug, Default)]
pub(crate) struct Curves {
    /// Measured position of each joint, and its error.
    pub(crate) joints: Vec<[Curve; 2]>,
    pub(crate) position: Curve,
    pub(crate) orientation: Curve,
    pub(crate) commanded: Path,
    pub(crate) measured: Path,
}

/// A commanded or measured position of the whole robot.
struct Place {
    joints: Axes,
    tool: Pose,
}

impl Track {
    fn new(name: &str, arm: Arm, subject: Subject, plotted: bool) -> Self {
        let joints = 0..arm.axes();
        let curves = || Curves { joints: joints.clone().map(|_| Default::default()).collect(), ..Curves::default() };
        Self {
            name: name.to_owned(),
            subject,
            curves: plotted.then(curves),
            linear: joints.map(|joint| is_linear(&arm, joint)).collect(),
            arm,
            unsolved: 0,
            position: TrackingError::default(),
            orientation: TrackingError::default(),
            recorded: Recorded::default(),
        }
    }

    fn observe(&mut self, record: &Record, time: f64) {
        let (mut expected, mut measured) = (Axes::default(), Axes::default());
        let used = record.axis.iter().take(usize::from(record.axes));
        for (axis, (expected, measured)) in used.zip(expected.iter_mut().zip(&mut measured)) {
            let Some(command) = axis.expected else {
                return;
            };
            (*expected, *measured) = (command, axis.measured);
        }
        let places = (self.place(&expected), self.place(&measured));
        let (Ok(commanded), Ok(measured)) = places else {
            self.unsolved += 1;
            return;
        };
        // mm per m of a linear joint, degrees per rad of another.
        let slides = |joint| self.linear.get(joint) == Some(&true);
        let units: Axes = std::array::from_fn(|joint| if slides(joint) { 1e3 } else { 1f64.to_degrees() });
        let [position, orientation] = match self.subject {
            Subject::Tool => {
                let apart = commanded.tool.translation.vector - measured.tool.translation.vector;
                let turned = commanded.tool.rotation.angle_to(&measured.tool.rotation);
                [1e3 * apart.norm(), turned.to_degrees()]
            }
            Subject::Joint => {
                let error = units[0] * (measured.joints[0] - commanded.joints[0]);
                if self.linear[0] { [error, 0.0] } else { [0.0, error] }
            }
        };
        self.position.record(position);
        self.orientation.record(orientation);
        if let Some(curves) = &mut self.curves {
            curves.position.push(time, position);
            curves.orientation.push(time, orientation);
            for (joint, [positions, errors]) in curves.joints.iter_mut().enumerate() {
                let [asked, found] = [&commanded, &measured].map(|it| units[joint] * it.joints[joint]);
                positions.push(time, found);
                errors.push(time, found - asked);
            }
            let millimetres = |place: &Place| place.tool.translation.vector.scale(1e3).into();
            curves.commanded.push(millimetres(&commanded));
            curves.measured.push(millimetres(&measured));
        }
    }

    fn place(&self, motors: &Axes) -> Result<Place, KinematicsError> {
        let joints = self.arm.joints(motors)?;
        let tool = self.arm.forward(&joints)?;
        Ok(Place { joints, tool })
    }

    fn report(&self) -> RobotReport {
        let slides = self.linear.first() == Some(&true);
        let [position, orientation] = [&self.position, &self.orientation].map(Deviation::of);
        let is_tool = self.subject == Subject::Tool;
        RobotReport {
            name: self.name.clone(),
            subject: self.subject,
            cycles: self.position.samples,
            unsolved: self.unsolved,
            position_mm: position.filter(|_| is_tool || slides),
            orientation_deg: orientation.filter(|_| is_tool || !slides),
        }
    }
}

/// Whether a joint slides. A device of one axis, which has no links, does.
fn is_linear(arm: &Arm, joint: usize) -> bool {
    let links = arm.robot().links();
    let mut moved = links.iter().filter(|link| link.coupling[joint] != 0.0);
    links.is_empty() || moved.any(|link| link.kind == LinkKind::Prismatic)
}

#[cfg(test)]
mod tests {
    use std::path::Path as FilePath;
    use std::time::Duration;

    use servo::{AxisRecord, MAX_AXES};

    use super::*;

    fn tracks(cell: &str) -> (CellFile, Tracks) {
        let path = FilePath::new(env!("CARGO_MANIFEST_DIR")).join("../cells");
        let file = CellFile::read(path.join(cell)).unwrap();
        let tracks = Tracks::new(&file, true);
        (file, tracks)
    }

    /// A record of a robot whose motors were told `expected`, and are at `measured`.
    fn record(effector: usize, expected: &Axes, measured: &Axes, axes: usize) -> Record {
        let axis = |axis: usize| AxisRecord {
            expected: Some(expected[axis]),
            measured: measured[axis],
            ..AxisRecord::default()
        };
        Record {
            effector: effector as u8,
            axes: axes as u8,
            axis: std::array::from_fn::<_, MAX_AXES, _>(axis),
            ..Record::default()
        }
    }

    #[test]
    fn a_planted_displacement_of_the_tool_is_found_in_mm_and_degrees() {
        let (file, mut tracks) = tracks("irp6.toml");
        let arm = &file.arms[0];
        let near: Axes = arm.joints(&arm.robot().home().padded()).unwrap();
        let commanded = arm.forward(&near).unwrap();
        let motors = arm.robot().home().padded();
        let mut displaced = commanded;
        displaced.translation.vector += nalgebra::Vector3::new(3e-4, 0.0, 4e-4);
        let turn = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.1f64.to_radians());
        displaced.rotation = turn * displaced.rotation;
        let joints = arm.inverse(&displaced, &near).unwrap();
        let moved = arm.motors(&joints).unwrap();
        for measured in [&motors, &moved, &motors, &motors] {
            tracks.observe(&record(0, &motors, measured, arm.axes()));
        }
        let report = &tracks.reports()[0];
        assert_eq!((report.cycles, report.unsolved), (4, 0));
        let (position, orientation) = (report.position_mm.unwrap(), report.orientation_deg.unwrap());
        let close = |found: f64, expected: f64| (found - expected).abs() < 1e-6;
        assert!(close(position.peak, 0.5) && close(position.rms, 0.25), "{position:?}");
        assert!(close(orientation.peak, 0.1), "{orientation:?}");
        assert!(close(orientation.rms, 0.05), "{orientation:?}");
    }

    #[test]
    fn devices_of_one_axis_have_the_error_of_their_joint() {
        let (file, mut tracks) = tracks("lab.toml");
        for (number, robot) in file.cell.robot.iter().enumerate() {
            let arm = &file.arms[number];
            let told = arm.robot().home().padded();
            let mut found = told;
            if robot.name == "conveyor" {
                found[0] +=
                    0.001 * arm.motors(&[1.0; MAX_AXES]).unwrap()[0] - 0.001 * arm.motors(&[0.0; MAX_AXES]).unwrap()[0];
            }
            tracks.observe(&record(number, &told, &found, arm.axes()));
        }
        let reports = tracks.reports();
        let conveyor = reports.iter().find(|it| it.name == "conveyor").unwrap();
        assert_eq!((conveyor.subject, conveyor.orientation_deg), (Subject::Joint, None));
        let peak = conveyor.position_mm.unwrap().peak;
        assert!((peak - 1.0).abs() < 1e-6, "{peak} mm");
        let tools = reports.iter().filter(|it| it.subject == Subject::Tool);
        assert_eq!(tools.clone().count(), reports.len() - 2);
        for tool in tools {
            assert_eq!(tool.position_mm.map(|error| error.peak), Some(0.0), "{tool:?}");
            assert!(tool.orientation_deg.is_some());
        }
    }

    #[test]
    fn cycles_without_a_command_that_the_sample_answers_do_not_count() {
        let (file, mut tracks) = tracks("irb6.toml");
        let motors = file.arms[0].robot().home().padded();
        let mut homing = record(0, &motors, &motors, 5);
        homing.axis[4].expected = None;
        homing.axis[0].measured += 100.0;
        tracks.observe(&homing);
        let report = tracks.reports().remove(0);
        assert_eq!((report.cycles, report.position_mm), (0, None));
        let mut standing = record(0, &motors, &motors, 5);
        standing.at += Duration::from_secs(3);
        tracks.observe(&standing);
        assert_eq!(tracks.reports()[0].cycles, 1);
        let curves = tracks.robots[0].curves.as_ref().unwrap();
        assert_eq!(curves.position.points().next(), Some((3.0, 0.0)));
    }
}
