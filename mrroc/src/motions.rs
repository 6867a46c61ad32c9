//! Motions of one robot of a cell, within the limits of its axes.

use std::fmt::Display;
use std::path::Path;

use anyhow::{Context, anyhow};
use controller::generator::{
    ConstantVelocity, EffectorImage, Generator, Includes, MotionLimits, Newsmooth, Selected, Selection,
    SelectionMemory, TimeOptimal,
};
use controller::robot::{Arm, Space};
use controller::trajectory_file::{JointConvention, TrajectoryError, TrajectoryFile};

use crate::cell::{CellFile, printable, smooth_pose};
use crate::inputs::Inputs;
use crate::streams;

/// Greatest size of a trajectory file, bytes: several times what its greatest number of poses needs.
const LARGEST_TRAJECTORY: usize = 64 << 20;

/// A pose or a velocity has another number of joints than the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} given, and the robot has {axes}", can::counted_as(*.given, "joint is", "joints are"))]
pub struct PoseSize {
    /// Number of joints that are given.
    pub given: usize,
    /// Number of joints of the robot.
    pub axes: usize,
}

/// Makes generators for one robot of a cell.
#[derive(Clone, Debug)]
pub struct Motions {
    arm: Arm,
    limits: MotionLimits,
    motor_limits: MotionLimits,
    inputs: Inputs,
}

impl Motions {
    /// Motions of robot `robot`.
    pub(crate) fn of(file: &CellFile, robot: usize) -> Self {
        let arm = file.arms[robot].clone();
        let limits = file.cell.robot[robot].motion_limits(&arm);
        let motor_limits = file.cell.robot[robot].motor_limits();
        Self { arm, limits, motor_limits, inputs: file.inputs().clone() }
    }

    /// Kinematics, drive train and tool of the robot.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Limits of the joints that the motors permit, rad or m and s.
    pub fn limits(&self) -> MotionLimits {
        self.limits
    }

    /// A synchronised trapezoid through joint positions, rad (m for a linear joint).
    ///
    /// `share` is the fraction of the limits of velocity and acceleration to use, above 0 and at most 1.
    pub fn joints<const AXES: usize>(&self, share: f64, poses: &[[f64; AXES]]) -> anyhow::Result<Newsmooth> {
        self.check_axes(AXES)?;
        let poses = poses.iter().map(|pose| smooth_pose(pose, share, share)).collect();
        let motion = Newsmooth::new(Space::Joint, self.arm.axes(), self.limits, poses);
        motion.context("the joint motion cannot be planned")
    }

    /// A time-optimal motion from rest to rest along the cubic spline from the present position through joint
    /// positions, rad (m for a linear joint), within the limits of velocity and acceleration.
    ///
    /// Between way-points the spline may leave the range that the way-points span. The rehearsal refuses a path that
    /// leaves the range of a joint.
    pub fn time_optimal<const AXES: usize>(&self, way_points: &[[f64; AXES]]) -> anyhow::Result<TimeOptimal> {
        self.check_axes(AXES)?;
        let way_points = way_points.iter().map(|point| smooth_pose(point, 1.0, 1.0).position).collect();
        let motion = TimeOptimal::through(Space::Joint, self.arm.axes(), self.limits, way_points);
        motion.context("the time-optimal motion cannot be planned")
    }

    /// A motion of the joints that reaches a constant velocity, rad/s (m/s for a linear joint), and brakes.
    /// [`lasting`](ConstantVelocity::lasting) and [`over`](ConstantVelocity::over) hold the velocity,
    /// [`ending_in_motion`](ConstantVelocity::ending_in_motion) leaves the braking to the next generator.
    pub fn constant_velocity<const AXES: usize>(&self, velocity: &[f64; AXES]) -> anyhow::Result<ConstantVelocity> {
        self.check_axes(AXES)?;
        let velocity = smooth_pose(velocity, 1.0, 1.0).position;
        let motion = ConstantVelocity::new(self.arm.clone(), self.limits, velocity);
        motion.context("the motion at constant velocity cannot be planned")
    }

    /// A [`Selection`] of two generators by a function of memory and images. A change of the generator is permitted
    /// within the limits of the joints.
    pub fn selection<A, B, S>(&self, first: A, second: B, select: S) -> anyhow::Result<Selection<A, B, S>>
    where
        A: Generator<Every: Includes<EffectorImage>>,
        B: Generator<First = A::First, Every = A::Every, Out = A::Out>,
        S: Fn(&SelectionMemory<A::Memory, B::Memory>, &A::Every) -> Selected + Send + Sync + 'static,
    {
        let selection = Selection::between(self.arm.clone(), self.limits, first, second, select);
        selection.context("the selection cannot be planned")
    }

    /// The motion of a [trajectory file](controller::trajectory_file) of MRROC++, a synchronised trapezoid through
    /// its poses. Its fractions apply to the limits of the joints or the motors of this robot. Refuses a file of a
    /// robot with another number of axes, poses of the tool, and a JOINT file of IRp-6 or IRb-6 that does not tell the
    /// [convention](JointConvention) of its joints: see [`trajectory_in`](Self::trajectory_in). A run and its
    /// rehearsals read the file once: the file that was rehearsed is the one that is executed. Standard error tells
    /// what of the file is ignored.
    pub fn trajectory(&self, path: impl AsRef<Path>) -> anyhow::Result<Newsmooth> {
        self.trajectory_of(path.as_ref(), None, &"call Motions::trajectory_in")
    }

    /// As [`trajectory`](Self::trajectory), with the convention of the joints of a JOINT file. Refuses a file that
    /// tells the other convention.
    pub fn trajectory_in(&self, path: impl AsRef<Path>, joints: JointConvention) -> anyhow::Result<Newsmooth> {
        self.trajectory_of(path.as_ref(), Some(joints), &"")
    }

    /// As [`trajectory`](Self::trajectory). `remedy` says where the convention of the joints can be set.
    pub(crate) fn trajectory_of(
        &self,
        path: &Path,
        joints: Option<JointConvention>,
        remedy: &dyn Display,
    ) -> anyhow::Result<Newsmooth> {
        let place = path.display();
        let bytes = self.inputs.read("a trajectory file of the task", path, LARGEST_TRAJECTORY);
        let bytes = bytes.with_context(|| place.to_string())?;
        let text = std::str::from_utf8(&bytes).with_context(|| format!("{place}: must be text"))?;
        let read = TrajectoryFile::read(text, self.arm.axes());
        let (file, notes) = read.map_err(|error| anyhow!("{place}:{error}"))?;
        if self.inputs.is_first_use(path) {
            let place = printable(&place.to_string());
            notes.iter().for_each(|note| streams::warn(format_args!("mrroc: {place}: {note}")));
        }
        let file = file.for_arm(&self.arm, joints).map_err(|error| match error {
            TrajectoryError::TwoReadings(_) => anyhow!("{error}: {remedy}"),
            error => error.into(),
        });
        let file = file.with_context(|| place.to_string())?;
        let motion = file.motion_of(self.arm.axes(), self.limits, self.motor_limits);
        motion.with_context(|| place.to_string())
    }

    fn check_axes(&self, given: usize) -> anyhow::Result<()> {
        let axes = self.arm.axes();
        if given == axes { Ok(()) } else { Err(PoseSize { given, axes }.into()) }
    }
}

#[cfg(test)]
mod tests {
    //! Motions of an emulated IRb-6 in lockstep, and refusals.

    use std::fs;
    use std::time::Duration;

    use super::*;
    use crate::prelude::{
        BenchKind, Cell, JerkLimited, JogCommand, JogReading, Outcome, RunOutcome, Space, Task, V, Wait, WeightedSum,
        WithImages, join,
    };
    use crate::tasks::tests::two_arms;

    /// Runs a task on two IRb-6 to its end.
    #[track_caller]
    fn completes(task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static) {
        let report = crate::run(&two_arms(), BenchKind::Lockstep, task).unwrap();
        assert_eq!(report.outcome, RunOutcome::Completed, "{report}");
    }

    fn motions() -> Motions {
        Motions::of(&two_arms(), 0)
    }

    #[test]
    fn a_time_optimal_motion_ends_at_its_last_way_point() {
        completes(async |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            let points = [[0.3, -1.7, 0.1, 0.2, 0.3], [0.5, -1.6, 0.0, 0.4, 0.1], [0.2, -1.5, 0.05, 0.3, -0.4]];
            robot.enable().await?;
            robot.home().await?;
            let motion = robot.motions().time_optimal(&points)?;
            robot.execute(motion).await?;
            let reached = robot.image().unwrap().commanded.joints.position;
            for (reached, asked) in reached.iter().zip(points[2]) {
                assert!((reached - asked).abs() < 1e-6, "{reached} for {asked}");
            }
            Ok(())
        });
    }

    #[test]
    fn a_motion_at_constant_velocity_is_chained_and_combined_with_other_motions() {
        completes(async |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            robot.enable().await?;
            robot.home().await?;
            let motions = robot.motions();
            let start = robot.image()?.commanded.joints.position;
            let turning = motions.constant_velocity(&[0.1, 0.0, 0.0, 0.0, 0.0])?.over(0.1)?;
            let mut target = start;
            target[0] += 0.3;
            let rest = JerkLimited::new(Space::Joint, 5, motions.limits(), &[target])?;
            robot.perform(Task::new().run(turning.clone().ending_in_motion()).run(rest)).await?;
            let reached = robot.image()?.commanded.joints.position;
            assert!((reached[0] - target[0]).abs() < 1e-6, "{reached:?}");

            let (jog, mut operator) = robot.jog(Duration::from_millis(200))?;
            let wait = WithImages::of(Wait { duration: Duration::from_secs(1) });
            let select = |_: &SelectionMemory<_, _>, (e, _): &(EffectorImage, V<JogReading>)| {
                if e.commanded.pose.translation.z < 1.5 { Selected::First } else { Selected::Second }
            };
            let operated = async { Ok(operator.command(JogCommand::End)?) };
            join(robot.execute(motions.selection(jog, wait, select)?), operated).await?;

            let back = motions.constant_velocity(&[-0.1, 0.0, 0.0, 0.0, 0.0])?.lasting(Duration::from_secs(1));
            let sum = WeightedSum::new(Space::Joint, back, turning, 0.25)?;
            robot.execute(sum).await?;
            // Three quarters of the way back, and a quarter of the same way on.
            let by = robot.image()?.commanded.joints.position[0] - target[0];
            assert!((-0.075..-0.05).contains(&by), "{by}");
            Ok(())
        });
    }

    #[test]
    fn a_trajectory_file_that_is_replaced_after_its_rehearsal_is_not_executed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("poses.trj");
        let pose = |column: f64| {
            format!("JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n{column} -1.5 0 0 0\njoints = inclination\n")
        };
        fs::write(&path, pose(0.3)).unwrap();
        completes(async move |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            let motion = robot.motions().trajectory(&path)?;
            // The first rehearsal replaces the file.
            fs::write(path.with_extension("new"), pose(-0.3)).unwrap();
            fs::rename(path.with_extension("new"), &path).unwrap();
            robot.enable().await?;
            robot.home().await?;
            robot.execute(motion).await?;
            let reached = robot.image()?.commanded.joints.position[0];
            assert!((reached - 0.3).abs() < 1e-6, "{reached}");
            Ok(())
        });
    }

    #[test]
    fn a_motion_at_constant_velocity_out_of_range_is_refused_in_its_first_step() {
        completes(async |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            robot.enable().await?;
            robot.home().await?;
            let motion = robot.motions().constant_velocity(&[0.1, 0.0, 0.0, 0.0, 0.0])?.over(20.0)?;
            let refused = robot.execute(motion).await.unwrap_err();
            assert_eq!(refused.instruction().unwrap().step, Some(0), "{refused}");
            assert!(refused.to_string().contains("of the path"), "{refused}");
            Ok(())
        });
    }

    #[test]
    fn a_trajectory_file_moves_the_joints_to_its_last_pose_and_the_motors_by_its_displacements() {
        let directory = tempfile::tempdir().unwrap();
        let fractions = "0.5 0.5 0.5 0.5 0.5\n0.2 0.2 0.2 0.2 0.2\n";
        let (joints, motors) = (directory.path().join("joints.trj"), directory.path().join("motors.trj"));
        let poses = format!("JOINT\n1\nABSOLUTE\n{fractions}0.2 -1.6 0.05 0.1 0.2\njoints = inclination\n");
        fs::write(&joints, poses).unwrap();
        fs::write(&motors, format!("MOTOR\n1\nRELATIVE\n{fractions}5 0 0 0 0\n")).unwrap();
        completes(async move |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            robot.enable().await?;
            robot.home().await?;
            let motion = robot.motions().trajectory(&joints)?;
            robot.execute(motion).await?;
            let before = robot.image().unwrap().commanded;
            for (reached, asked) in before.joints.position.iter().zip([0.2, -1.6, 0.05, 0.1, 0.2]) {
                assert!((reached - asked).abs() < 1e-6, "{reached} for {asked}");
            }
            let motion = robot.motions().trajectory(&motors)?;
            robot.execute(motion).await?;
            let by = robot.image().unwrap().commanded.motors.position[0] - before.motors.position[0];
            assert!((by - 5.0).abs() < 1e-6, "{by}");
            Ok(())
        });
    }

    #[test]
    fn an_operator_jogs_a_joint_and_ends_the_motion() {
        completes(async |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            robot.enable().await?;
            robot.home().await?;
            let (jog, mut operator) = robot.jog(Duration::from_millis(200))?;
            let operated = async {
                for _ in 0..20 {
                    operator.command(JogCommand::Joints([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))?;
                    cell.sleep(Duration::from_millis(100)).await;
                }
                operator.command(JogCommand::End)?;
                Ok(())
            };
            join(robot.execute(jog), operated).await?;
            let column = robot.image().unwrap().commanded.joints.position[0];
            assert!((column - 0.2).abs() < 0.02, "{column}");
            Ok(())
        });
    }

    #[test]
    fn a_trajectory_file_that_cannot_be_executed_is_refused_with_its_path_and_line() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("poses.trj");
        let refused = |bytes: &[u8]| {
            fs::write(&path, bytes).unwrap();
            let refusal = format!("{:#}", motions().trajectory(&path).unwrap_err());
            refusal.strip_prefix(&path.display().to_string()).expect("it begins with the path").to_owned()
        };
        let six = refused(b"JOINT\n1\nABSOLUTE\n1 1 1 1 1 1\n1 1 1 1 1 1\n0 0 0 0 0 0\n");
        assert_eq!(six, ": poses have 6 columns, and the robot has 5 axes: the file belongs to another robot");
        assert_eq!(refused(b"JOINT\n1\nABSOLUTE\n1 2\n"), ":4: column 2: the fraction 2 must be above 0 and at most 1");
        assert!(refused(b"\xff\n").starts_with(": must be text"));
        fs::remove_file(&path).unwrap();
        assert!(motions().trajectory(&path).is_err());
    }

    #[test]
    fn a_joint_file_that_cannot_tell_its_joints_is_refused_with_both_readings_and_their_tool_poses() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("poses.trj");
        fs::write(&path, "JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n0.3 -1.2 0.1 0.2 0\n").unwrap();
        let refusal = format!("{:#}", motions().trajectory(&path).unwrap_err());
        for part in ["joints = \"inclination\"", "joints = \"relative\"", "pose 1", "-1.2000 0.1000 0.2000", "tool at"]
        {
            assert!(refusal.contains(part), "{part}: {refusal}");
        }
        motions().trajectory_in(&path, JointConvention::Relative).unwrap();
        motions().trajectory_in(&path, JointConvention::Inclination).unwrap();
        // Upright, with a level upper arm and a level wrist, both readings are the same.
        let upright = format!("JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n0.3 {} 0 0 0\n", -std::f64::consts::FRAC_PI_2);
        fs::write(&path, upright).unwrap();
        motions().trajectory(&path).unwrap();
    }

    #[test]
    fn a_file_of_relative_joints_moves_to_the_inclinations_that_they_are() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("poses.trj");
        // th2 = -1.6, th3 = 0.05, th4 = 0.1.
        let relative = [0.2, -1.6, 0.05 + 1.6 - std::f64::consts::FRAC_PI_2, 0.05, 0.2];
        let row = relative.map(|joint| joint.to_string()).join(" ");
        fs::write(&path, format!("JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n{row}\n")).unwrap();
        completes(async move |cell: &mut Cell| {
            let mut robot = cell.robot("left")?;
            robot.enable().await?;
            robot.home().await?;
            let motion = robot.motions().trajectory_in(&path, JointConvention::Relative)?;
            robot.execute(motion).await?;
            let reached = robot.image()?.commanded.joints.position;
            for (reached, asked) in reached.iter().zip([0.2, -1.6, 0.05, 0.1, 0.2]) {
                assert!((reached - asked).abs() < 1e-6, "{reached} for {asked}");
            }
            Ok(())
        });
    }

    #[test]
    fn poses_and_velocities_with_another_number_of_joints_are_refused() {
        let refusal = "2 joints are given, and the robot has 5";
        assert_eq!(motions().constant_velocity(&[0.0, 0.0]).unwrap_err().to_string(), refusal);
        assert_eq!(motions().time_optimal(&[[0.0, 0.0]]).unwrap_err().to_string(), refusal);
        assert_eq!(motions().joints(0.5, &[[0.0, 0.0]]).unwrap_err().to_string(), refusal);
    }
}
