//! `mrroc kinematics`: where the flange is for given joints, which joints put it there, and how they move it.
//!
//! Forward answers beyond every limit, as a measured position may be; then `motors` is null and a note says what is
//! passed. Inverse answers only what the robot can be told to do.

mod answers;
mod machine;
mod numbers;

use std::process::ExitCode;

use anyhow::{Context as _, bail};
use clap::{ArgGroup, Args, Subcommand};

pub use machine::{Machine, Which};

use answers::{Forward, Inverse, Ranges, Sensitivity};
use mrroc::streams;

/// The robot, and the form of the answer.
#[derive(Args)]
pub struct Common {
    #[command(flatten)]
    machine: Which,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Questions of `mrroc kinematics`.
#[derive(Subcommand)]
pub enum Question {
    /// Where the flange is for given joints or motors.
    ///
    /// Position and rotation are the flange's in the base frame, m; beyond a limit they are told all the same, and
    /// `motors` is null. Of the RNT the first three of `motors` are the leg lengths, m, here and in the answer;
    /// `motor_angles` has all six in rad. `links` has the positions of the joints in the description of `mrroc urdf`.
    #[command(group(ArgGroup::new("positions").required(true).args(["joints", "motors"])))]
    Fk {
        /// The robot, and the form of the answer.
        #[command(flatten)]
        common: Common,
        /// Joint positions, rad (m for a linear one), separated by commas.
        #[arg(long, allow_hyphen_values = true)]
        joints: Option<String>,
        /// Motor positions, rad, separated by commas.
        #[arg(long, allow_hyphen_values = true)]
        motors: Option<String>,
    },
    /// Which joints put the flange there: every branch within the limits, the nearest to --near first.
    Ik {
        /// The robot, and the form of the answer.
        #[command(flatten)]
        common: Common,
        /// Origin of the flange in the base frame, m: x,y,z.
        #[arg(long, allow_hyphen_values = true)]
        position: String,
        /// Orientation of the flange in the base frame: w,x,y,z. Its norm may be wrong by 1 %, as by rounding.
        #[arg(long, allow_hyphen_values = true)]
        quaternion: String,
        /// The joints where the robot is; those of its home where absent.
        #[arg(long, allow_hyphen_values = true)]
        near: Option<String>,
    },
    /// Velocity of the flange per unit of joint velocity, in the base frame: three rows in m/s, three in rad/s.
    Jacobian {
        /// The robot, and the form of the answer.
        #[command(flatten)]
        common: Common,
        /// Joint positions, rad (m for a linear one), separated by commas.
        #[arg(long, allow_hyphen_values = true)]
        joints: String,
    },
    /// Ranges of joints and motors; null where there is none.
    Limits {
        /// The robot, and the form of the answer.
        #[command(flatten)]
        common: Common,
    },
}

/// Answers one question about a robot.
pub fn kinematics(question: &Question) -> anyhow::Result<ExitCode> {
    match question {
        Question::Fk {
            common,
            joints,
            motors,
        } => {
            let machine = Machine::find(&common.machine)?;
            let joints = match (joints, motors) {
                (Some(joints), _) => machine.joints("--joints", joints)?,
                (None, Some(motors)) => machine.joints_from_motors(motors)?,
                (None, None) => bail!("neither --joints nor --motors is given"),
            };
            streams::answer(&Forward::of(&machine, &joints)?, common.json)
        }
        Question::Ik {
            common,
            position,
            quaternion,
            near,
        } => {
            let machine = Machine::find(&common.machine)?;
            let pose = numbers::pose(position, quaternion)?;
            let near = match near {
                Some(near) => machine.joints("--near", near)?,
                None => machine.home()?,
            };
            let solutions = machine.robot.inverse(&pose, &near);
            let solutions =
                solutions.with_context(|| format!("{}: no joints for this pose", machine.name))?;
            streams::answer(&Inverse::of(&machine, &solutions), common.json)
        }
        Question::Jacobian { common, joints } => {
            let machine = Machine::find(&common.machine)?;
            let joints = machine.joints("--joints", joints)?;
            streams::answer(&Sensitivity::of(&machine, &joints)?, common.json)
        }
        Question::Limits { common } => {
            let machine = Machine::find(&common.machine)?;
            streams::answer(&Ranges::of(&machine), common.json)
        }
    }
}
