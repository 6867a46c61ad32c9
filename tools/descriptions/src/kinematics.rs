//! `mrroc kinematics`: forward kinematics, inverse kinematics, Jacobian and limits of a robot.
//!
//! Forward kinematics accepts positions beyond the limits, since measured positions can lie there. `motors` is then
//! null, and a note names the exceeded limit. Inverse kinematics returns only positions within the limits.

mod answers;
mod convert;
mod machine;
mod singular;

use anyhow::{Context as _, bail};
use clap::{ArgGroup, Args, Subcommand};

pub use answers::Answer;
pub use convert::Conversion;
pub use machine::{Machine, Which};

/// The robot, and the format of the answer.
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
    /// Forward kinematics: the pose of the flange for given joints or motors.
    ///
    /// Position, m, and rotation are those of the flange in the base frame. They are also printed for positions beyond
    /// a limit, and `motors` is then null. For the RNT, the first three values of `motors` are leg lengths, m, in
    /// options and answer. `motor_angles` contains all six motors in rad. `links` contains the joint positions in the
    /// description of `mrroc urdf`.
    #[command(group(ArgGroup::new("positions").required(true).args(["joints", "motors"])))]
    Fk {
        /// The robot, and the format of the answer.
        #[command(flatten)]
        common: Common,
        /// Joint positions, rad (m for a linear one), separated by commas.
        #[arg(long, allow_hyphen_values = true)]
        joints: Option<String>,
        /// Motor positions, rad, separated by commas.
        #[arg(long, allow_hyphen_values = true)]
        motors: Option<String>,
    },
    /// Inverse kinematics: all joint positions within the limits for a pose of the flange, the nearest to --near first.
    Ik {
        /// The robot, and the format of the answer.
        #[command(flatten)]
        common: Common,
        /// Origin of the flange in the base frame, m: x,y,z.
        #[arg(long, allow_hyphen_values = true)]
        position: String,
        /// Orientation of the flange in the base frame: w,x,y,z. The norm may deviate from 1 by 1 %, for example by
        /// rounding.
        #[arg(long, allow_hyphen_values = true)]
        quaternion: String,
        /// Present joint positions of the robot. [default: the home position]
        #[arg(long, allow_hyphen_values = true)]
        near: Option<String>,
    },
    /// Jacobian: velocity of the flange per unit of joint velocity, in the base frame. Three rows are in m/s, three in
    /// rad/s.
    Jacobian {
        /// The robot, and the format of the answer.
        #[command(flatten)]
        common: Common,
        /// Joint positions, rad (m for a linear one), separated by commas.
        #[arg(long, allow_hyphen_values = true)]
        joints: String,
    },
    /// Convert a trajectory file of MRROC++ into a JOINT file of positions, which `run --task replay` executes.
    ///
    /// Reads files of the tool, of joints and of motors. Positions of the tool need the tool for which the file was
    /// made: the default tool of MRROC++ is --tool 0,0,0.25 for the IRp-6, with the base at the shoulder. Of several
    /// solutions of the inverse kinematics, the nearest to the previous pose is taken.
    Convert(Conversion),
    /// Ranges of joints and motors; null if unlimited.
    Limits {
        /// The robot, and the format of the answer.
        #[command(flatten)]
        common: Common,
    },
}

impl Question {
    fn common(&self) -> &Common {
        let (Self::Fk { common, .. }
        | Self::Ik { common, .. }
        | Self::Jacobian { common, .. }
        | Self::Limits { common }
        | Self::Convert(Conversion { common, .. })) = self;
        common
    }

    /// Whether the answer is printed as one JSON object.
    pub fn json(&self) -> bool {
        self.common().json
    }
}

/// Computes the answer to a question about a robot.
pub fn kinematics(question: &Question) -> anyhow::Result<Answer> {
    let machine = &Machine::find(&question.common().machine)?;
    match question {
        Question::Fk { joints, motors, .. } => {
            let joints = match (joints, motors) {
                (Some(joints), _) => machine.vector("--joints", joints)?,
                (None, Some(motors)) => machine.joints_from_motors(motors)?,
                (None, None) => bail!("neither --joints nor --motors is given"),
            };
            Answer::forward(machine, &joints)
        }
        Question::Ik { position, quaternion, near, .. } => {
            let pose = machine::pose(position, quaternion)?;
            let near = match near {
                Some(near) => machine.vector("--near", near)?,
                None => (machine.robot).joints_from_motors(&machine.robot.home())?,
            };
            let solutions = machine.robot.inverse(&pose, &near);
            let solutions = solutions.with_context(|| format!("{}: no joints for this pose", machine.name))?;
            Ok(Answer::inverse(machine, &solutions, &near))
        }
        Question::Jacobian { joints, .. } => Answer::jacobian(machine, &machine.vector("--joints", joints)?),
        Question::Limits { .. } => Ok(Answer::limits(machine)),
        Question::Convert(conversion) => Ok(Answer::converted(machine, &convert::convert(machine, conversion)?)),
    }
}
