//! Class 7, effector, sensor and orders: two arms take a bar from a table and carry it, and yield to the force between
//! them.
//!
//! The bases of the arms are not exactly where the cell file says. Two stiff arms on one bar then strain the bar. The
//! arms first carry the bar without regulation of the internal force, and then with regulation from both wrists.
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
const LIMITS: ObjectLimits = ObjectLimits { velocity: 0.1, acceleration: 0.4, radius: GRIP };

/// Middle of the bar on the table: x, y, z, m, and yaw, rad, in the frame of the cell.
const TABLE: [f64; 4] = [1.1, 0.0, 0.8, 0.0];

/// The middle of the bar above the table.
const ABOVE: [f64; 4] = [1.1, 0.0, 0.86, 0.0];

/// Course of the bar.
const COURSE: [[f64; 4]; 5] =
    [ABOVE, [1.1, 0.12, 0.86, 0.0], [1.16, 0.0, 0.88, 0.1], [1.1, -0.12, 0.86, 0.0], ABOVE];

/// Internal force that stops both arms, N.
const LIMIT: f64 = 80.0;

/// Greatest age of a sample of a force sensor.
const STALE: Duration = Duration::from_millis(20);

/// Joints near those of vertical tools above the table, rad.
const BENT: [f64; 8] = [0.0, -1.571, 0.0, 1.571, 0.0, 0.0, 0.0, 0.0];

/// Figures of one carriage, by the measured positions and forces of both arms in each servo period.
#[derive(Clone, Copy, Debug, Default)]
struct Figures {
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

/// Moves the object of a team along a path, and measures.
async fn carry(
    cell: &Cell,
    grips: &Grips,
    robots: [&mut Robot; 2],
    wrists: &[ForceSensor; 2],
    (path, regulation): (ObjectPath, Regulation),
) -> Result<Figures, TaskError> {
    let [left, right] = robots;
    let eyes = [left.observer(), right.observer()];
    let (mut figures, ended) = (Figures::default(), Shared::new(false));
    let course = path.clone();
    let motion = async {
        let carry = Carry::new(*grips, course, regulation, LIMIT);
        let outcome = cell.team([left, right]).execute(carry, [Hold { stale: STALE }; 2]).await;
        ended.set(true);
        outcome
    };
    let watch = async {
        while !ended.get() {
            if let (Ok(left), Ok(right)) = (wrists[0].in_tool(), wrists[1].in_tool()) {
                figures.take(grips, &path, [eyes[0].image()?, eyes[1].image()?], [left, right]);
            }
            cell.sleep(cell.file().cell.period()).await;
        }
        Outcome::Ok(())
    };
    join(motion, watch).await?;
    Ok(figures)
}

/// Takes the bar and carries it twice.
pub(crate) async fn hold(cell: &mut Cell) -> Outcome {
    let [mut left, mut right] = cell.robots(["left", "right"])?;
    let wrists = [cell.force_sensor("left-wrist")?, cell.force_sensor("right-wrist")?];
    let jaws = [cell.output("left-gripper")?, cell.output("right-gripper")?];
    let down = |x: f64, yaw: f64| {
        Pose::from_parts([x, 0.0, 0.0].into(), UnitQuaternion::from_euler_angles(PI, 0.0, yaw))
    };
    let grips = Grips {
        cell_from_base: [left.cell_from_base(), right.cell_from_base()],
        object_from_tool: [down(-GRIP, 0.0), down(GRIP, PI)],
    };
    // Both paths are checked before the first motion.
    let paths = [vec![ABOVE, TABLE], vec![TABLE, ABOVE], COURSE.to_vec()];
    let [approach, lift, course] = paths.map(|places| ObjectPath::through(&places, &LIMITS));
    let (approach, lift, course) = (approach?, lift?, course?);
    let motions = [left.motions(), right.motions()];
    let arms = [motions[0].arm(), motions[1].arm()];
    for path in [&approach, &lift, &course] {
        grips.check(path, arms, [BENT; 2])?;
    }
    let above = |member: usize| -> Result<Newsmooth, TaskError> {
        let pose = grips.tool(member, &approach.at(0.0)).pose;
        let [a, b, c, d, e, ..] = arms[member].inverse(&pose, &BENT)?;
        Ok(motions[member].joints(0.3, &[[a, b, c, d, e]])?)
    };
    let prepare = || Task::new().enable().home();
    let starts = [prepare().run(above(0)?), prepare().run(above(1)?)];
    let [one, other] = starts;
    join(left.perform(one), right.perform(other)).await?;
    cell.sleep(Duration::from_millis(300)).await;
    join(wrists[0].zero(), wrists[1].zero()).await?;
    left.sense(wrists[0].sensor(), Shell::NonInteractive, 1)?;
    right.sense(wrists[1].sensor(), Shell::NonInteractive, 1)?;

    let none = Regulation::None;
    carry(cell, &grips, [&mut left, &mut right], &wrists, (approach, none)).await?;
    jaws.iter().for_each(|jaws| jaws.set(true));
    cell.sleep(Duration::from_millis(200)).await;
    carry(cell, &grips, [&mut left, &mut right], &wrists, (lift, Regulation::MACROSTEP)).await?;
    let stiff = carry(cell, &grips, [&mut left, &mut right], &wrists, (course.clone(), none)).await?;
    let regulated = carry(cell, &grips, [&mut left, &mut right], &wrists, (course, Regulation::MACROSTEP)).await?;
    let [path, force] = regulated.rms();
    cell.figure("object_path_rms_mm", 1e3 * path);
    cell.figure("internal_force_rms_n", force);
    cell.figure("internal_force_peak_n", regulated.peak);
    cell.figure("start_skew_cycles_max", f64::from(stiff.most_skew.max(regulated.most_skew)));
    cell.figure("unregulated_internal_force_rms_n", stiff.rms()[1]);
    cell.figure("unregulated_internal_force_peak_n", stiff.peak);
    join(left.disable(), right.disable()).await
}

fn main() -> ExitCode {
    mrroc::program("cells/two-irb6-bar.toml", hold)
}
