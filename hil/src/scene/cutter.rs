//! Tools that cut workpieces, and their forces.
//!
//! A cutting tool is a cylinder with a flat end. While its spindle turns, the tool removes the material above its end.
//! The cutting force acts at the centre of the end, against the velocity along the upper face of the workpiece. Its
//! magnitude is F = K_c·b·h + K_e·b for a cut of width b and depth h. Width and depth are the width and depth of the
//! material that is actually removed: each removed cell needs the work K_c · volume + K_e · area. A cell is removed in
//! one step. To avoid a jump of the force, the work is spread over the travel: the remaining work decreases to 1/e over
//! two cell widths.
//!
//! A thrust acts on the end of a tool that cuts downward. The thrust is K_e times the diameter, times the share of the
//! end that cuts.
//!
//! The spindle supplies the power of the cut. Cutting force and thrust act against the velocity, and therefore never
//! add energy to a mechanism. Below [`SLOW`], both decrease in proportion to the velocity and are zero at rest.
//!
//! A tool does not cut if its spindle is at rest, or if the tool leans by more than [`MOST_LEANING`]. The tool then
//! rests on the material under its end by spring, damper and friction. Material beside the end does not push the tool
//! sideways.
//!
//! Left out: forces across the feed, the torque of the spindle, cuts by the side of a leaning tool, and undercuts.

use nalgebra::{Isometry3, Vector3};

use super::arm::Arm;
use super::motion::Moving;
use super::surface::Material;
use super::workpiece::{End, HeightField, MOST_CELLS, Removed, WorkpieceConfig, WorkpieceProbe};
use super::{RobotId, STEP_SECONDS, Scene, SceneError, finite, passive};
use crate::OutputProbe;

/// Velocity below which the cutting force decreases, m/s.
const SLOW: f64 = 1e-3;

/// Greatest ratio of cutting force to velocity, N·s/m. Forces of more than this value times [`SLOW`] decrease from a
/// higher velocity on.
const STEEPEST: f64 = 5e4;

/// Greatest angle between the axis of a tool that cuts and the normal of the workpiece, rad.
const MOST_LEANING: f64 = 0.2;

/// Travel over which the remaining work of a removed cell decreases to 1/e, cell widths.
const SPREAD: f64 = 2.0;

/// A cutting tool of a robot: a cylinder with a flat end.
///
/// While the spindle turns, the tool removes the material above its end. The cutting force K_c · b · h + K_e · b acts
/// on the tool, with width b and depth h of the material that is actually removed. The force acts against the velocity,
/// and never adds energy. Below 1 mm/s the force decreases in proportion to the velocity. Without the spindle, or at
/// more than 0.2 rad to the normal of the workpiece, the tool rests on the material and removes nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutterConfig {
    /// Place of the end in the flange frame of [`Mechanism::set_payload`](crate::Mechanism::set_payload): origin at the
    /// centre of the end, z along the axis out of the tool.
    pub pose: Isometry3<f64>,
    /// Diameter, m.
    pub diameter: f64,
    /// Level of the output at which the spindle turns.
    pub turning_at: bool,
}

/// All workpieces and cutting tools of a scene.
#[derive(Default)]
pub(super) struct Cutting {
    workpieces: Vec<Workpiece>,
    cutters: Vec<Cutter>,
    cuts: Vec<Cut>,
}

struct Workpiece {
    config: WorkpieceConfig,
    place: Moving,
    field: WorkpieceProbe,
}

struct Cutter {
    arm: usize,
    config: CutterConfig,
    spindle: Option<OutputProbe>,
}

impl Cutter {
    fn is_turning(&self) -> bool {
        self.spindle.as_ref().is_none_or(|output| output.level() == self.config.turning_at)
    }
}

/// A tool at a workpiece.
#[derive(Clone, Copy, Debug)]
struct Cut {
    cutter: usize,
    workpiece: usize,
    /// The end of the tool at the last step; `None` before the first step.
    before: Option<End>,
    /// Work that the side of the tool has not yet done, J.
    pending: f64,
    /// Height of the material on which the tool rests, m.
    support: Option<f64>,
    bristle: Vector3<f64>,
}

impl Cut {
    fn new(cutter: usize, workpiece: usize) -> Self {
        Self { cutter, workpiece, before: None, pending: 0.0, support: None, bristle: Vector3::zeros() }
    }

    /// Moves the tool to `end`, where its velocity is `velocity`, m/s. Returns the force on the tool, N. All vectors
    /// are in the frame of the workpiece.
    fn step(
        &mut self,
        config: &WorkpieceConfig,
        field: &mut HeightField,
        end: &End,
        velocity: &Vector3<f64>,
        turning: bool,
    ) -> Vector3<f64> {
        let before = self.before.replace(*end).unwrap_or(*end);
        if turning && end.normal.z >= MOST_LEANING.cos() {
            let removed = field.cut(end, &before);
            (self.support, self.bristle) = (None, Vector3::zeros());
            return self.cutting_force(config, &removed, end, &before, velocity);
        }
        self.pending = 0.0;
        self.contact_force(config, field, end, &before, velocity)
    }

    fn cutting_force(
        &mut self,
        config: &WorkpieceConfig,
        removed: &Removed,
        end: &End,
        before: &End,
        velocity: &Vector3<f64>,
    ) -> Vector3<f64> {
        let spread = SPREAD * config.cell;
        let way = (end.centre - before.centre).xy().norm() / spread;
        self.pending += config.specific_force * removed.volume + config.edge_force * removed.edge;
        // The work that is done on the way of this step, per length.
        let force = self.pending / spread * if way > 0.0 { -(-way).exp_m1() / way } else { 1.0 };
        self.pending *= (-way).exp();
        let (side, down) = (Vector3::new(velocity.x, velocity.y, 0.0), velocity.z.min(0.0));
        let thrust = config.edge_force * 2.0 * end.radius * removed.from_above;
        against(force, &side) + against(thrust, &Vector3::new(0.0, 0.0, down))
    }

    fn contact_force(
        &mut self,
        config: &WorkpieceConfig,
        field: &HeightField,
        end: &End,
        before: &End,
        velocity: &Vector3<f64>,
    ) -> Vector3<f64> {
        // Higher material came beside the tool, and not under the end. Without this ceiling, a sideways motion into such
        // material would stretch the spring without work.
        let ceiling = self.support.map_or(before.centre.z, |support| support.max(before.centre.z));
        self.support = if end.centre.z < ceiling.max(0.0) { field.support(end, ceiling) } else { None };
        let gap = self.support.map_or(0.0, |support| end.centre.z - support);
        if gap >= 0.0 {
            self.bristle = Vector3::zeros();
            return Vector3::zeros();
        }
        let rate = Vector3::new(velocity.x, velocity.y, 0.0);
        let size = config.material.normal([gap; 2], velocity.z);
        let (drag, bristle) = config.material.drag(size, self.bristle + rate * STEP_SECONDS, Vector3::zeros(), rate);
        self.bristle = bristle;
        drag + Vector3::new(0.0, 0.0, size)
    }

    fn energy(&self, material: &Material) -> f64 {
        let gap = self.before.zip(self.support).map_or(0.0, |(end, support)| end.centre.z - support);
        material.energy(gap) + 0.5 * material.stiffness * self.bristle.norm_squared()
    }
}

/// A force of magnitude `force`, N, against a velocity, m/s.
fn against(force: f64, velocity: &Vector3<f64>) -> Vector3<f64> {
    velocity * (-force / velocity.norm().max(SLOW).max(force / STEEPEST))
}

impl Cutting {
    /// Advances all tools by one step, and adds their forces to the robots.
    pub(super) fn step(&mut self, arms: &mut [Arm]) {
        let Self { workpieces, cutters, cuts } = self;
        for cut in cuts {
            let (workpiece, cutter) = (&workpieces[cut.workpiece], &cutters[cut.cutter]);
            let (place, arm) = (&workpiece.place, &mut arms[cutter.arm]);
            let (pose, flange) = (&cutter.config.pose, &arm.flange);
            let centre = flange.origin + flange.axes * pose.translation.vector;
            let axis = flange.axes * (pose.rotation * Vector3::z());
            let velocity = place.axes.tr_mul(&flange.velocity_at(&centre));
            let end = End {
                centre: place.axes.tr_mul(&(centre - place.origin)),
                normal: -place.axes.tr_mul(&axis),
                radius: 0.5 * cutter.config.diameter,
            };
            let mut field = workpiece.field.lock();
            let force = cut.step(&workpiece.config, &mut field, &end, &velocity, cutter.is_turning());
            arm.push(&centre, &(place.axes * force));
        }
    }

    /// Whether no tool can meet a workpiece.
    pub(super) fn is_empty(&self) -> bool {
        self.cuts.is_empty()
    }

    /// Energy of the springs between tools and workpieces, J.
    pub(super) fn energy(&self) -> f64 {
        self.cuts.iter().map(|cut| cut.energy(&self.workpieces[cut.workpiece].config.material)).sum()
    }
}

impl Scene {
    /// Adds a workpiece, which is uncut. Fails if a dimension is zero, if the height field has more than [`MOST_CELLS`]
    /// cells, if a force is below zero, or if the surface is not passive.
    pub fn add_workpiece(&mut self, config: &WorkpieceConfig) -> Result<WorkpieceProbe, SceneError> {
        passive(&config.material)?;
        finite(&config.pose, "the place of a workpiece")?;
        for (what, value) in [("a cell of a workpiece", config.cell), ("the thickness of a workpiece", config.size[2])]
        {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SceneError::Length { what, value });
            }
        }
        if let Some(value) = config.size.into_iter().find(|value| !(*value > 0.5 * config.cell && value.is_finite())) {
            return Err(SceneError::Length { what: "an edge of a workpiece", value });
        }
        let [columns, rows] = config.cells();
        if columns.saturating_mul(rows) > MOST_CELLS {
            return Err(SceneError::Cells { columns, rows });
        }
        let forces = [config.specific_force, config.edge_force];
        if !forces.iter().all(|force| *force >= 0.0 && force.is_finite()) {
            return Err(SceneError::CuttingForce { specific: forces[0], edge: forces[1] });
        }
        let axes = config.pose.rotation.to_rotation_matrix().into_inner();
        let place = Moving { origin: config.pose.translation.vector, axes, ..Moving::WORLD };
        let field = WorkpieceProbe::new(HeightField::new(config));
        let Cutting { workpieces, cutters, cuts } = &mut self.cutting;
        cuts.extend((0..cutters.len()).map(|cutter| Cut::new(cutter, workpieces.len())));
        workpieces.push(Workpiece { config: *config, place, field: field.clone() });
        Ok(field)
    }

    /// Adds a cutting tool to a robot of this scene. Its spindle turns while the output `spindle` has the level of the
    /// configuration, and always with `None`. Fails if a number is invalid.
    pub fn add_cutter(
        &mut self,
        robot: RobotId,
        config: &CutterConfig,
        spindle: Option<&OutputProbe>,
    ) -> Result<(), SceneError> {
        finite(&config.pose, "the place of a cutting tool")?;
        if !(config.diameter > 0.0 && config.diameter.is_finite()) {
            return Err(SceneError::Length { what: "the diameter of a cutting tool", value: config.diameter });
        }
        let Cutting { workpieces, cutters, cuts } = &mut self.cutting;
        cuts.extend((0..workpieces.len()).map(|workpiece| Cut::new(cutters.len(), workpiece)));
        cutters.push(Cutter { arm: robot.0, config: *config, spindle: spindle.cloned() });
        Ok(())
    }
}

#[cfg(test)]
mod tests;
