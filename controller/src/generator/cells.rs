//! Cells of a path: bounds of the speed, and limits that couple the speed with the tangential acceleration.
//!
//! The cells follow from the geometry of the path alone. If a limit rises, each bound rises or stays.

use super::demands::Demands;
use super::feed::FeedLimits;
use crate::path::Path;

/// Number of cells of equal length into which a path is divided. Sharp curves divide the cells further.
const CELLS: u32 = 2_000;
/// Largest change of direction in a cell of a B-spline, rad.
const CELL_TURN: f64 = 0.05;
/// Smallest length of a cell, relative to the path, and relative tolerance of times.
pub(super) const TOLERANCE: f64 = 1e-9;

/// A limit of the form slope · |acceleration| + bend · speed² ≤ 1, with the greatest coefficients of each cell.
#[derive(Clone, Debug)]
pub(super) struct Coupling {
    pub(super) slopes: Vec<f64>,
    pub(super) bends: Vec<f64>,
}

/// Greatest value.
fn greatest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

/// Division of a path into cells.
#[derive(Clone, Debug)]
pub(super) struct Cells {
    /// Arc lengths between the cells, from 0 to the length of the path.
    pub(super) nodes: Vec<f64>,
    /// Bound of the speed in each cell, m/s.
    pub(super) bounds: Vec<f64>,
    /// Limits that can bind beside the bounds.
    pub(super) couplings: Vec<Coupling>,
    /// Greatest tangential acceleration on the whole path, m/s².
    pub(super) acceleration: f64,
}

impl Cells {
    /// The cells of a path within the limits of the tool.
    pub(super) fn of(path: &Path, limits: &FeedLimits) -> Self {
        let nodes = nodes(path);
        let turns: Vec<[f64; 2]> = nodes.windows(2).map(|cell| path.max_turning(cell[0], cell[1])).collect();
        let bound = |(cell, [rate, _]): (&[f64], &[f64; 2])| {
            let curvature = path.curve().max_curvature(cell[0], cell[1]);
            limits
                .max_velocity
                .min((limits.max_normal_acceleration / curvature).sqrt())
                .min(limits.max_angular_velocity / rate)
        };
        let bounds = nodes.windows(2).zip(&turns).map(bound).collect();
        let turning = |order: usize| turns.iter().map(|turn| turn[order] / limits.max_angular_acceleration).collect();
        let couplings = vec![Coupling { slopes: turning(0), bends: turning(1) }];
        Self { nodes, bounds, couplings, acceleration: limits.max_acceleration }.bounded()
    }

    /// These cells with the limits of the joints added. `None` if the joints limit nothing.
    pub(super) fn within(&self, joints: &Demands) -> Option<Self> {
        let mut cells = self.clone();
        joints.couple(&mut cells);
        let cells = cells.bounded();
        let same = cells.bounds == self.bounds
            && cells.acceleration == self.acceleration
            && cells.couplings.len() == self.couplings.len();
        (!same).then_some(cells)
    }

    /// Bounds speed and acceleration by the couplings, and removes couplings that then bind nowhere.
    fn bounded(mut self) -> Self {
        let slope = |cell: usize| self.couplings.iter().map(|coupling| coupling.slopes[cell]).fold(0.0, f64::max);
        let least = (0..self.bounds.len()).map(slope).fold(f64::INFINITY, f64::min);
        self.acceleration = self.acceleration.min(1.0 / least);
        for coupling in &self.couplings {
            for (bound, bend) in self.bounds.iter_mut().zip(&coupling.bends) {
                *bound = bound.min(1.0 / bend.sqrt());
            }
        }
        let (square, acceleration) = (greatest(&self.bounds).powi(2), self.acceleration);
        self.couplings.retain(|Coupling { slopes, bends }| {
            greatest(slopes) * acceleration + greatest(bends) * square > 1.0 + TOLERANCE
        });
        self
    }

    /// Whether the path has no couplings and the same bound everywhere, like a straight line.
    pub(super) fn are_uniform(&self) -> bool {
        self.couplings.is_empty() && self.bounds.iter().all(|bound| *bound == self.bounds[0])
    }

    /// The greatest bound of the speed.
    pub(super) fn cruise(&self) -> f64 {
        greatest(&self.bounds)
    }

    /// Coarser cells for a search: each one replaces `together` cells.
    pub(super) fn coarse(&self, together: usize) -> Self {
        let last = self.bounds.len();
        let nodes = self.nodes[..last].iter().step_by(together).copied().chain([self.nodes[last]]).collect();
        let least = |bounds: &[f64]| bounds.iter().copied().fold(f64::INFINITY, f64::min);
        let most = |values: &[f64]| values.chunks(together).map(greatest).collect();
        let coarse = |coupling: &Coupling| Coupling { slopes: most(&coupling.slopes), bends: most(&coupling.bends) };
        Self {
            nodes,
            bounds: self.bounds.chunks(together).map(least).collect(),
            couplings: self.couplings.iter().map(coarse).collect(),
            ..*self
        }
    }
}

fn nodes(path: &Path) -> Vec<f64> {
    let length = path.length();
    let mut nodes: Vec<f64> = (0..=CELLS).map(|node| f64::from(node) / f64::from(CELLS) * length).collect();
    nodes.extend(path.divisions(CELL_TURN).into_iter().filter(|&division| division > 0.0 && division < length));
    nodes.sort_by(f64::total_cmp);
    nodes.dedup_by(|later, earlier| *later - *earlier < TOLERANCE * length);
    let last = nodes.len() - 1;
    nodes[last] = length;
    nodes
}
