//! The fastest feed profile: choice of the window of the moving average.
//!
//! The speed before the moving average is the greatest speed within bounds that rise with each limit. A profile with a
//! given window therefore does not become slower if a limit rises, and the shortest duration of all windows does not
//! rise either.

use super::cells::{Cells, Coupling, TOLERANCE};
use super::demands::Demands;
use super::feed::FeedLimits;
use super::peaks::flatten_peaks;
use super::sweep::{Grid, widened};
use crate::path::Path;

/// Least window that is tried, relative to the best window of a path without sections of low speed.
const LEAST: f64 = 1.0 / 32.0;
/// Number of windows of the scan, number of the best windows that are refined, and refinements of each best window.
const SCANNED: usize = 8;
const BASINS: usize = 2;
const REFINEMENTS: u32 = 7;
/// Number of cells that a search merges into one cell.
const TOGETHER: usize = 8;
/// Relative difference of durations that is neglected.
const SAME: f64 = 1e-6;

/// Squares of the speed at places of a path, before the moving average.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    pub(super) nodes: Vec<f64>,
    pub(super) squares: Vec<f64>,
    /// Shortest length of the moving average, s.
    pub(super) window: f64,
}

impl Profile {
    /// Duration of the motion, s.
    fn duration(&self) -> f64 {
        durations(&self.nodes, &self.squares).sum::<f64>() + self.window
    }
}

/// Durations between places, s.
fn durations(nodes: &[f64], squares: &[f64]) -> impl Iterator<Item = f64> {
    let roots = squares.windows(2).map(|pair| pair[0].sqrt() + pair[1].sqrt());
    let lengths = nodes.windows(2).map(|pair| pair[1] - pair[0]);
    lengths.zip(roots).map(|(length, both)| 2.0 * length / both)
}

/// All feed profiles of a path within limits.
pub(super) struct Pacing {
    cells: Cells,
    jerk: f64,
    step: f64,
}

impl Pacing {
    /// The profiles within the limits of the tool.
    pub(super) fn of(path: &Path, limits: &FeedLimits, step: Option<f64>) -> Self {
        Self { cells: Cells::of(path, limits), jerk: limits.max_jerk, step: step.unwrap_or(0.0) }
    }

    /// The profiles within the limits of the joints as well. `None` if the joints limit nothing.
    pub(super) fn within(&self, joints: &Demands) -> Option<Self> {
        Some(Self { cells: self.cells.within(joints)?, ..*self })
    }

    /// The fastest profile.
    pub(super) fn fastest(&self) -> Profile {
        let longest = self.longest();
        let natural = self.profile(longest);
        if self.cells.are_uniform() {
            return natural;
        }
        let coarse = Self { cells: self.cells.coarse(TOGETHER), ..*self };
        let mut best = (natural.duration(), natural);
        let least_gain = (self.step / 2.0).max(SAME * best.0);
        let most = best.0 - least_gain;
        for share in least_ones(LEAST.ln(), |share| coarse.profile(longest * share.exp()).duration()) {
            let profile = self.profile(longest * share.exp());
            let duration = profile.duration();
            if duration < best.0.min(most) {
                best = (duration, profile);
            }
        }
        best.1
    }

    /// The best window if the speed rises from rest to the greatest bound once.
    fn longest(&self) -> f64 {
        let (jerk, nodes) = (self.jerk, &self.cells.nodes);
        let length = nodes[nodes.len() - 1];
        let by_speed = (self.cells.cruise() * jerk).sqrt();
        let by_length = (jerk * jerk * length / 2.0).cbrt();
        self.cells.acceleration.min(by_speed).min(by_length) / jerk
    }

    /// The profile with this window.
    fn profile(&self, window: f64) -> Profile {
        let acceleration = self.jerk * window;
        // Rounding errors must not make a section shorter than the moving average.
        let longest = (window + self.step) * (1.0 + TOLERANCE);
        let mut grid = Grid::of(&self.cells);
        let couplings = self.widened_couplings(&grid, acceleration, longest);
        grid.widen_dips(longest);
        for coupling in &couplings {
            for (bound, cell) in grid.bounds.iter_mut().zip(&grid.cells) {
                *bound = bound.min(1.0 / coupling.bends[*cell].sqrt());
            }
        }
        let (mut nodes, mut squares) = grid.fastest(acceleration, &couplings);
        flatten_peaks(&mut nodes, &mut squares, longest);
        Profile { nodes, squares, window }
    }

    /// The couplings that hold for each point that is passed less than `window` before or after a cell.
    fn widened_couplings(&self, grid: &Grid, acceleration: f64, window: f64) -> Vec<Coupling> {
        if self.cells.couplings.is_empty() {
            return Vec::new();
        }
        // No profile within the widened limits is faster than this one.
        let (nodes, squares) = grid.fastest(acceleration, &self.cells.couplings);
        let mut times = Vec::with_capacity(grid.nodes.len());
        times.push(0.0);
        let mut time = 0.0;
        for (node, duration) in nodes[1..].iter().zip(durations(&nodes, &squares)) {
            time += duration;
            if *node == grid.nodes[times.len()] {
                times.push(time);
            }
        }
        widened(&self.cells.couplings, &times, window)
    }
}

/// Arguments from `least` to 0 of the lowest local minima of a function: a scan, and a golden-section search around each
/// of the lowest minima of the scan.
fn least_ones(least: f64, mut value: impl FnMut(f64) -> f64) -> Vec<f64> {
    let at = |step: usize| least * (1.0 - step as f64 / SCANNED as f64);
    let scanned: Vec<f64> = (0..=SCANNED).map(|step| value(at(step))).collect();
    let beside = |step: usize| [step.saturating_sub(1), (step + 1).min(SCANNED)];
    let mut minima: Vec<usize> =
        (0..=SCANNED).filter(|&step| beside(step).iter().all(|&other| scanned[step] <= scanned[other])).collect();
    minima.sort_by(|one, other| scanned[*one].total_cmp(&scanned[*other]));
    minima.truncate(BASINS);
    minima.into_iter().map(|step| refined(beside(step).map(at), &mut value)).collect()
}

/// Argument of the least value in an interval, by golden-section search.
fn refined([mut low, mut high]: [f64; 2], mut value: impl FnMut(f64) -> f64) -> f64 {
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let [mut left, mut right] = [high - golden * (high - low), low + golden * (high - low)];
    let [mut at_left, mut at_right] = [value(left), value(right)];
    for _ in 0..REFINEMENTS {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - golden * (high - low);
            at_left = value(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + golden * (high - low);
            at_right = value(right);
        }
    }
    if at_left < at_right { left } else { right }
}
