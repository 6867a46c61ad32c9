//! Class 7, effector, sensor and orders: two arms take a bar from a table and carry it, and yield to the force between
//! them.
//!
//! The bases of the arms are not exactly where the cell file says. Two stiff arms on one bar then strain the bar. The
//! arms carry the bar three times along the same course: without regulation of the internal force, with regulation by the
//! coordinator in each macrostep, and with regulation by the force law of each arm in each servo period.
//!
//! ```sh
//! cargo run --release --example hold_bar -- --bench lockstep
//! ```

use std::cell::Cell as Shared;
use std::f64::consts::PI;

use mrroc::carry::{Carry, Grips, Hold, ObjectLimits, ObjectPath, Regulation};
use mrroc::prelude::*;
use nalgebra::UnitQuaternion;

/// Distance of each grip from the middle of the bar, m.
const GRIP: f64 = 0.4;

/// Speed, m/s, and acceleration, m/s², of the bar.
pub(crate) const LIMITS: ObjectLimits = ObjectLimits { velocity: 0.1, acceleration: 0.4, radius: GRIP };

/// Middle of the bar on the table: x, y, z, m, and yaw, rad, in the frame of the cell.
const TABLE: [f64; 4] = [1.1, 0.0, 0.8, 0.0];

/// The middle of the bar above the table.
const ABOVE: [f64; 4] = [1.1, 0.0, 0.86, 0.0];

/// Course of the bar.
pub(crate) const COURSE: [[f64; 4]; 5] =
    [ABOVE, [1.1, 0.12, 0.86, 0.0], [1.16, 0.0, 0.88, 0.1], [1.1, -0.12, 0.86, 0.0], ABOVE];

/// Internal force that stops both arms, N.
const LIMIT: f64 = 80.0;

/// Greatest age of a sample of a force sensor.
const STALE: Duration = Duration::from_millis(20);

/// Joints near those of vertical tools above the table, rad.
const BENT: [f64; 8] = [0.0, -1.571, 0.0, 1.571, 0.0, 0.0, 0.0, 0.0];

/// Figures of one carriage, by the measured positions and forces of both arms in each servo period.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Figures {
    samples: u32,
    squares: [f64; 2],
    peak: f64,
    begun: Option<[u64; 2]>,
    skew: u32,
    most_skew: u32,
}

impl Figures {
    fn take(&mut self, grips: &Grips, path: &ObjectPath, images: [EffectorImage; 2], forces: [Wrench; 2]) {
        let [left, right] = images.map(|image| image.measured.pose);
        let away = path.distance(&grips.object([&left, &right]).translation.vector);
        let internal = grips.internal([left.rotation * forces[0].force, right.rotation * forces[1].force]).norm();
        self.squares[0] += away * away;
        self.squares[1] += internal * internal;
        self.peak = self.peak.max(internal);
        self.samples += 1;
        let macrosteps = images.map(|image| image.macrostep);
        let begun = self.begun.get_or_insert(macrosteps);
        let together = macrosteps[0] - begun[0] == macrosteps[1] - begun[1];
        self.skew = if together { 0 } else { self.skew + 1 };
        self.most_skew = self.most_skew.max(self.skew);
    }

    fn rms(&self) -> [f64; 2] {
        self.squares.map(|sum| (sum / f64::from(self.samples.max(1))).sqrt())
    }
}

/// Two arms with their wrists and grippers.
pub(crate) struct Arms {
    robots: [Robot; 2],
    wrists: [ForceSensor; 2],
    jaws: [OutputLine; 2],
    grips: Grips,
}

impl Arms {
    /// The arms of the cell, with tools that point down.
    pub(crate) fn of(cell: &Cell) -> Result<Self, TaskError> {
        let robots = cell.robots(["left", "right"])?;
        let down =
            |x: f64, yaw: f64| Pose::from_parts([x, 0.0, 0.0].into(), UnitQuaternion::from_euler_angles(PI, 0.0, yaw));
        let grips = Grips {
            cell_from_base: robots.each_ref().map(Robot::cell_from_base),
            object_from_tool: [down(-GRIP, 0.0), down(GRIP, PI)],
        };
        let wrists = [cell.force_sensor("left-wrist")?, cell.force_sensor("right-wrist")?];
        Ok(Self { robots, wrists, jaws: [cell.output("left-gripper")?, cell.output("right-gripper")?], grips })
    }

    /// A path of the bar. Refuses a path that an arm cannot follow.
    pub(crate) fn path(&self, places: &[[f64; 4]]) -> Result<ObjectPath, TaskError> {
        let path = ObjectPath::through(places, &LIMITS)?;
        let [left, right] = self.robots.each_ref().map(Robot::motions);
        self.grips.check(&path, [left.arm(), right.arm()], [BENT; 2])?;
        Ok(path)
    }

    /// Homes both arms, takes the bar from the table and lifts it.
    pub(crate) async fn take(&mut self, cell: &Cell) -> Outcome {
        let (approach, lift) = (self.path(&[ABOVE, TABLE])?, self.path(&[TABLE, ABOVE])?);
        let start = |member: usize| -> Result<Task, TaskError> {
            let motions = self.robots[member].motions();
            let pose = self.grips.tool(member, &approach.at(0.0)).pose;
            let [a, b, c, d, e, ..] = motions.arm().inverse(&pose, &BENT)?;
            Ok(Task::new().enable().home().run(motions.joints(0.3, &[[a, b, c, d, e]])?))
        };
        let starts = [start(0)?, start(1)?];
        let [left, right] = &mut self.robots;
        let [one, other] = starts;
        join(left.perform(one), right.perform(other)).await?;
        cell.sleep(Duration::from_millis(300)).await;
        join(self.wrists[0].zero(), self.wrists[1].zero()).await?;
        for (robot, wrist) in self.robots.iter_mut().zip(&self.wrists) {
            robot.sense(wrist.sensor(), Shell::NonInteractive, 1)?;
        }
        self.carry(cell, &approach, Regulation::None, |_| ()).await?;
        self.jaws.iter().for_each(|jaws| jaws.set(true));
        cell.sleep(Duration::from_millis(200)).await;
        self.carry(cell, &lift, Regulation::CYCLE, |_| ()).await?;
        Ok(())
    }

    /// Carries the bar along a path. `prepare` may change the team before the motion.
    pub(crate) async fn carry(
        &mut self,
        cell: &Cell,
        path: &ObjectPath,
        regulation: Regulation,
        prepare: impl FnOnce(&mut Team<2>),
    ) -> Result<Figures, TaskError> {
        let Self { robots: [left, right], wrists, grips, .. } = self;
        let eyes = [left.observer(), right.observer()];
        let (mut figures, ended) = (Figures::default(), Shared::new(false));
        let motion = async {
            let mut team = cell.team([left, right]);
            prepare(&mut team);
            let carry = Carry::new(*grips, path.clone(), regulation, LIMIT);
            let outcome = team.execute(carry, [Hold::new(STALE); 2]).await;
            ended.set(true);
            outcome
        };
        let watch = async {
            while !ended.get() {
                if let (Ok(left), Ok(right)) = (wrists[0].in_tool(), wrists[1].in_tool()) {
                    figures.take(grips, path, [eyes[0].image()?, eyes[1].image()?], [left, right]);
                }
                cell.sleep(cell.file().cell.period()).await;
            }
            Outcome::Ok(())
        };
        join(motion, watch).await?;
        Ok(figures)
    }

    /// Switches the drives off.
    pub(crate) async fn disable(&mut self) -> Outcome {
        let [left, right] = &mut self.robots;
        join(left.disable(), right.disable()).await
    }
}

/// Takes the bar and carries it three times.
pub(crate) async fn hold(cell: &mut Cell) -> Outcome {
    let mut arms = Arms::of(cell)?;
    // A path out of reach is refused before the first motion.
    let course = arms.path(&COURSE)?;
    arms.take(cell).await?;
    let stiff = arms.carry(cell, &course, Regulation::None, |_| ()).await?;
    let slow = arms.carry(cell, &course, Regulation::MACROSTEP, |_| ()).await?;
    let regulated = arms.carry(cell, &course, Regulation::CYCLE, |_| ()).await?;
    let [path, force] = regulated.rms();
    cell.figure("object_path_rms_mm", 1e3 * path);
    cell.figure("internal_force_rms_n", force);
    cell.figure("internal_force_peak_n", regulated.peak);
    let skews = [&stiff, &slow, &regulated].map(|figures| figures.most_skew);
    cell.figure("start_skew_cycles_max", f64::from(skews.into_iter().max().unwrap_or(0)));
    cell.figure("macrostep_internal_force_rms_n", slow.rms()[1]);
    cell.figure("macrostep_internal_force_peak_n", slow.peak);
    cell.figure("unregulated_internal_force_rms_n", stiff.rms()[1]);
    cell.figure("unregulated_internal_force_peak_n", stiff.peak);
    arms.disable().await
}

fn main() -> ExitCode {
    mrroc::program("cells/two-irb6-bar.toml", hold)
}
