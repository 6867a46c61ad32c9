//! `mrroc kinematics convert`: a trajectory file of MRROC++ as JOINT file of positions.

use std::path::PathBuf;

use anyhow::{Context as _, anyhow};
use clap::Args;
use controller::robot::Joint;
use controller::trajectory_file::{Coordinates, JointConvention, TrajectoryError, TrajectoryFile};
use mrroc::tasks::convention;
use mrroc::{input, streams};

use super::{Common, Machine, machine, singular};

/// Greatest size of a trajectory file, bytes.
const LARGEST: usize = 64 << 20;

/// Options of the conversion.
#[derive(Args)]
pub struct Conversion {
    /// The robot, and the format of the answer.
    #[command(flatten)]
    pub(super) common: Common,
    /// The trajectory file.
    file: PathBuf,
    /// Meaning of the joints of upper arm and wrist pitch in a JOINT file of IRp-6 or IRb-6 that does not tell it.
    #[arg(long, value_name = "CONVENTION", value_parser = convention())]
    joints: Option<JointConvention>,
    /// Joint positions at the beginning of the motion. [default: the home position]
    #[arg(long, allow_hyphen_values = true)]
    near: Option<String>,
    /// Place of the tool in the frame of the flange, m: x,y,z. [default: that of the cell; without --cell, the flange]
    #[arg(long, allow_hyphen_values = true)]
    tool: Option<String>,
}

/// Reads and converts the file.
pub(super) fn convert(machine: &Machine, options: &Conversion) -> anyhow::Result<TrajectoryFile> {
    let place = options.file.display().to_string();
    let bytes = input::read(&options.file, LARGEST).with_context(|| place.clone())?;
    let text = str::from_utf8(&bytes).with_context(|| format!("{place}: must be text"))?;
    let tool = options.tool.as_deref().map(|tool| machine::exactly("--tool", tool, "x,y,z")).transpose()?;
    let arm = machine.arm(tool);
    let near = options.near.as_deref().map(|near| machine.vector::<Joint>("--near", near)).transpose()?;
    let start = match near {
        Some(near) => near.padded(),
        None => arm.joints(&arm.robot().home().padded())?,
    };
    let (file, notes) = TrajectoryFile::read(text, arm.axes()).map_err(|error| anyhow!("{place}:{error}"))?;
    for note in notes {
        streams::warn(format_args!("mrroc: {place}: {note}"));
    }
    let is_tool = matches!(file.coordinates(), Coordinates::XyzEulerZyz | Coordinates::XyzAngleAxis);
    if is_tool {
        streams::warn(format_args!(
            "mrroc: {place}: the tool moves from pose to pose by a motion of the joints; each joint has the least \
             fraction of its row"
        ));
    }
    let converted = file.to_joints(&arm, options.joints, &start).map_err(|error| match error {
        TrajectoryError::TwoReadings(_) => anyhow!("{error}: give --joints"),
        error => error.into(),
    });
    let converted = converted.with_context(|| place.clone())?;
    if is_tool {
        let mut before = arm.given(&start);
        for (pose, number) in converted.poses().iter().zip(1..) {
            let joints = arm.given(&pose.position);
            let near = if number == 1 { "--near" } else { "the pose before" };
            if let Some(note) = singular::note(arm.robot(), &joints, &before, near) {
                streams::warn(format_args!("mrroc: {place}: pose {number} is {note}"));
            }
            before = joints;
        }
    }
    Ok(converted)
}
