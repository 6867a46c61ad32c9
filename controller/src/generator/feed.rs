//! Feed profile: arc length of a path over time.

use std::time::Duration;

use super::{GeneratorError, is_limit};
use crate::path::Path;

/// Number of cells of equal length into which a path is divided, at least and at most.
const CELLS: (f64, f64) = (2_000.0, 20_000.0);
/// Number of these cells in the acceleration from rest to the feed.
const RAMP_CELLS: f64 = 8.0;
/// Largest change of direction in a cell of a B-spline, rad.
const CELL_TURN: f64 = 0.05;
/// Smallest length of a cell, relative to the path, and relative tolerance of times.
const TOLERANCE: f64 = 1e-9;

/// Limits of the tool on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedLimits {
    /// Feed: speed along the path, m/s.
    pub max_velocity: f64,
    /// Tangential acceleration, m/s².
    pub max_acceleration: f64,
    /// Tangential jerk, m/s³.
    pub max_jerk: f64,
    /// Normal acceleration, m/s²: curvature times the square of the speed.
    pub max_normal_acceleration: f64,
    /// Angular velocity, rad/s.
    pub max_angular_velocity: f64,
    /// Angular acceleration, rad/s².
    pub max_angular_acceleration: f64,
}

impl FeedLimits {
    pub(super) fn check(&self) -> Result<(), GeneratorError> {
        let Self { max_velocity, max_acceleration, max_jerk, .. } = *self;
        let Self { max_normal_acceleration, max_angular_velocity, max_angular_acceleration, .. } = *self;
        let linear = [max_velocity, max_acceleration, max_jerk, max_normal_acceleration];
        let sound = linear.into_iter().chain([max_angular_velocity, max_angular_acceleration]).all(is_limit);
        if sound { Ok(()) } else { Err(GeneratorError::PathLimit) }
    }

    /// The limits of the same motion in `times` the time.
    pub(super) fn slowed(&self, times: f64) -> Self {
        Self {
            max_velocity: self.max_velocity / times,
            max_acceleration: self.max_acceleration / times.powi(2),
            max_jerk: self.max_jerk / times.powi(3),
            max_normal_acceleration: self.max_normal_acceleration / times.powi(2),
            max_angular_velocity: self.max_angular_velocity / times,
            max_angular_acceleration: self.max_angular_acceleration / times.powi(2),
        }
    }
}

/// Progress along a path at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeedState {
    /// Arc length, m.
    pub distance: f64,
    /// Path speed, m/s.
    pub velocity: f64,
    /// Tangential acceleration, m/s².
    pub acceleration: f64,
    /// Tangential jerk, m/s³.
    pub jerk: f64,
}

/// Feed profile of a path, from rest to rest.
///
/// The path is divided into 2000 cells or more. Curvature, and rotation of the tool per length (rate of turn), limit the
/// speed in each cell. A forward and a backward pass limit the tangential acceleration to A. A moving average over the time
/// T = A / (jerk limit) then limits the jerk.
///
/// Guaranteed at every time, apart from rounding:
/// - The speed is at most the feed.
/// - The tangential acceleration is continuous and at most A. A is the least of the tangential limit, the angular limit
///   divided by the rate of turn, and the acceleration reachable within the jerk limit. The tangential jerk is at most its
///   limit.
/// - The normal acceleration is at most its limit on lines and arcs. On a B-spline, the excess is below 0.1 %.
/// - Angular velocity and angular acceleration are at most their limits. Where the rate of turn changes along the path,
///   the excess is below 0.1 %. On such a path, half of the angular acceleration is reserved for this change.
/// - The profile ends exactly at the end of the path.
///
/// In a section of constant curvature, the speed is exactly the bound. Before a lower bound, the tool slows down from a
/// distance of up to twice the speed times T. Where the curvature varies, the speed is below the bound, by the change of the
/// bound over this distance. Where neither curvature nor rate of turn limits the motion, [`along`](Self::along) gives the
/// time-optimal profile from rest to rest.
///
/// Planning allocates. Evaluation is two binary searches.
#[derive(Clone, Debug)]
pub struct Feed {
    /// Sections of constant acceleration, before the moving average. The last one is the standstill at the end.
    sections: Vec<Section>,
    /// Length of the moving average, s.
    window: f64,
}

#[derive(Clone, Copy, Debug)]
struct Section {
    /// Start of the section, s.
    time: f64,
    /// Integral of the distance over time up to the start, m·s.
    integral: f64,
    distance: f64,
    velocity: f64,
    acceleration: f64,
}

impl Section {
    /// Integral of the distance, distance, velocity and acceleration at a time of the section.
    fn at(&self, time: f64) -> [f64; 4] {
        let Self { integral, distance, velocity, acceleration, .. } = *self;
        let t = time - self.time;
        [
            integral + t * (distance + t * (velocity / 2.0 + t * acceleration / 6.0)),
            distance + t * (velocity + t * acceleration / 2.0),
            velocity + t * acceleration,
            acceleration,
        ]
    }
}

impl Feed {
    /// The profile of a path.
    pub fn along(path: &Path, limits: &FeedLimits) -> Result<Self, GeneratorError> {
        Self::plan(path, limits, None)
    }

    /// The profile of a path, with a duration that is a multiple of `step`. For this, the moving average is longer by less
    /// than one step. The feed does not change.
    pub fn in_steps(path: &Path, limits: &FeedLimits, step: Duration) -> Result<Self, GeneratorError> {
        if step.is_zero() {
            return Err(GeneratorError::NoMacrostep);
        }
        Self::plan(path, limits, Some(step.as_secs_f64()))
    }

    fn plan(path: &Path, limits: &FeedLimits, step: Option<f64>) -> Result<Self, GeneratorError> {
        limits.check()?;
        let mut cells = Cells::of(path, limits);
        let length = path.length();
        let cruise = cells.bounds.iter().copied().fold(0.0, f64::max);
        let jerk = limits.max_jerk;
        let (turning, varies) = path.turning_rate();
        let acceleration = limits
            .max_acceleration
            .min(limits.max_angular_acceleration * angular_share(varies) / turning)
            .min((cruise * jerk).sqrt())
            .min((jerk * jerk * length / 2.0).cbrt());
        let shortest = acceleration / jerk;
        // Rounding errors must not make a section shorter than the moving average.
        let longest = (shortest + step.unwrap_or(0.0)) * (1.0 + TOLERANCE);

        // Ends of the ramps if curvature does not limit the speed.
        let top =
            (acceleration * (longest * longest + 4.0 * length / acceleration).sqrt() - acceleration * longest) / 2.0;
        let ramp = top.min(cruise).powi(2) / (2.0 * acceleration);
        cells.split(ramp);
        cells.split(length - ramp);

        cells.widen_dips(longest);
        let mut squares = cells.squares(acceleration);
        flatten_peaks(&cells.nodes, &mut squares, longest);
        let sections = sections(&cells.nodes, &squares);
        let end = sections[sections.len() - 1].time;
        if !end.is_finite() {
            return Err(GeneratorError::NoProfile);
        }
        let window = match step {
            None => shortest,
            Some(step) => ((end + shortest) / step - TOLERANCE).ceil() * step - end,
        };
        Ok(Self { sections, window })
    }

    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.end().time + self.window
    }

    fn end(&self) -> &Section {
        &self.sections[self.sections.len() - 1]
    }

    /// State `time` s after the start. Times before the start and after the end give the states at the ends.
    pub fn at(&self, time: f64) -> FeedState {
        if time >= self.duration() {
            return FeedState { distance: self.end().distance, ..FeedState::default() };
        }
        let (now, before) = (self.before_average(time), self.before_average(time - self.window));
        let mean = |derivative: usize| (now[derivative] - before[derivative]) / self.window;
        FeedState {
            distance: mean(0).clamp(0.0, self.end().distance),
            velocity: mean(1),
            acceleration: mean(2),
            jerk: mean(3),
        }
    }

    fn before_average(&self, time: f64) -> [f64; 4] {
        match self.sections.partition_point(|section| section.time <= time) {
            0 => [0.0; 4],
            after => self.sections[after - 1].at(time),
        }
    }
}

/// Share of the angular acceleration that is left for the tangential acceleration, and for changes of the rate of turn.
fn angular_share(varies: bool) -> f64 {
    if varies { 0.5 } else { 1.0 }
}

/// Division of a path into cells, with a bound of the speed in each.
struct Cells {
    /// Arc lengths between the cells, from 0 to the length of the path.
    nodes: Vec<f64>,
    /// Bound of the speed in each cell, m/s.
    bounds: Vec<f64>,
}

impl Cells {
    fn of(path: &Path, limits: &FeedLimits) -> Self {
        let length = path.length();
        let ramp = limits.max_velocity.powi(2) / (2.0 * limits.max_acceleration);
        let count = (RAMP_CELLS * length / ramp).clamp(CELLS.0, CELLS.1).ceil();
        let mut nodes: Vec<f64> = (0..=count as u32).map(|node| f64::from(node) / count * length).collect();
        nodes.extend(path.divisions(CELL_TURN).into_iter().filter(|&division| division > 0.0 && division < length));
        nodes.sort_by(f64::total_cmp);
        nodes.dedup_by(|later, earlier| *later - *earlier < TOLERANCE * length);
        let last = nodes.len() - 1;
        nodes[last] = length;

        let (_, varies) = path.turning_rate();
        let bound = |cell: &[f64]| {
            let curvature = path.curve().max_curvature(cell[0], cell[1]);
            let [rate, change] = path.max_turning(cell[0], cell[1]);
            limits
                .max_velocity
                .min((limits.max_normal_acceleration / curvature).sqrt())
                .min(limits.max_angular_velocity / rate)
                .min((limits.max_angular_acceleration * angular_share(varies) / change).sqrt())
        };
        let bounds = nodes.windows(2).map(bound).collect();
        Self { nodes, bounds }
    }

    /// Adds a node, or moves a very near node to this place.
    fn split(&mut self, at: f64) {
        let last = self.nodes.len() - 1;
        let cell = self.nodes.partition_point(|&node| node <= at).clamp(1, last);
        let nearest = if at - self.nodes[cell - 1] < self.nodes[cell] - at { cell - 1 } else { cell };
        if (at - self.nodes[nearest]).abs() >= TOLERANCE * self.nodes[last] {
            self.nodes.insert(cell, at);
            self.bounds.insert(cell, self.bounds[cell - 1]);
        } else if nearest > 0 && nearest < last {
            self.nodes[nearest] = at;
        }
    }

    /// Extends the bound of each cell to both sides, over the distance that the bound as a speed covers in `window`.
    ///
    /// Points that are passed less than `window` before or after a cell then have a speed of at most the bound of the cell.
    /// The moving average keeps this bound. A local minimum of the speed lasts for at least two windows: braking and
    /// acceleration never occur in the same window.
    fn widen_dips(&mut self, window: f64) {
        let (nodes, bounds) = (&self.nodes, &self.bounds);
        let count = bounds.len();
        let mut widened = bounds.clone();
        for (cell, &bound) in bounds.iter().enumerate() {
            let (low, high) = (nodes[cell] - bound * window, nodes[cell + 1] + bound * window);
            // A neighbour that is not faster, and reaches at least as far, does the rest.
            let covered = |next: usize| bounds[next] <= bound;
            if !(cell + 1 < count && covered(cell + 1) && nodes[cell + 2] + bounds[cell + 1] * window >= high) {
                for next in (cell + 1..count).take_while(|&next| nodes[next] < high) {
                    widened[next] = widened[next].min(bound);
                }
            }
            if !(cell > 0 && covered(cell - 1) && nodes[cell - 1] - bounds[cell - 1] * window <= low) {
                for next in (0..cell).rev().take_while(|&next| nodes[next + 1] > low) {
                    widened[next] = widened[next].min(bound);
                }
            }
        }
        self.bounds = widened;
    }

    /// The largest squares of the speed at the nodes with this acceleration, at rest at both ends.
    fn squares(&self, acceleration: f64) -> Vec<f64> {
        let mut squares = vec![0.0; self.nodes.len()];
        for node in 1..self.bounds.len() {
            let bound = self.bounds[node - 1].min(self.bounds[node]).powi(2);
            let gained = 2.0 * acceleration * (self.nodes[node] - self.nodes[node - 1]);
            squares[node] = bound.min(squares[node - 1] + gained);
        }
        for node in (1..self.bounds.len()).rev() {
            let gained = 2.0 * acceleration * (self.nodes[node + 1] - self.nodes[node]);
            squares[node] = squares[node].min(squares[node + 1] + gained);
        }
        squares
    }
}

/// Lowers each local maximum of the speed until its duration is `window`. Acceleration and braking then never occur in the
/// same window.
fn flatten_peaks(nodes: &[f64], squares: &mut [f64], window: f64) {
    let last = squares.len() - 1;
    let mut node = 1;
    while node < last {
        if squares[node] <= squares[node - 1] {
            node += 1;
            continue;
        }
        let (mut low, mut high, mut level) = (node, node, squares[node]);
        loop {
            while squares[low - 1] == level {
                low -= 1;
            }
            while squares[high + 1] == level {
                high += 1;
            }
            let is_peak = squares[low - 1] < level && squares[high + 1] < level;
            let lasts = (nodes[high] - nodes[low]) / level.sqrt();
            if !is_peak || lasts >= window * (1.0 - TOLERANCE / 10.0) {
                break;
            }
            level = squares[low - 1].max(squares[high + 1]);
            if level == 0.0 {
                break;
            }
        }
        squares[low..=high].fill(level);
        node = high + 1;
    }
}

/// Sections of constant acceleration between the nodes.
fn sections(nodes: &[f64], squares: &[f64]) -> Vec<Section> {
    let mut sections = Vec::with_capacity(nodes.len());
    let (mut time, mut integral) = (0.0, 0.0);
    for cell in 0..nodes.len() - 1 {
        let length = nodes[cell + 1] - nodes[cell];
        let (from, to) = (squares[cell].sqrt(), squares[cell + 1].sqrt());
        let acceleration = (squares[cell + 1] - squares[cell]) / (2.0 * length);
        let section = Section { time, integral, distance: nodes[cell], velocity: from, acceleration };
        sections.push(section);
        time += 2.0 * length / (from + to);
        [integral, ..] = section.at(time);
    }
    sections.push(Section { time, integral, distance: nodes[nodes.len() - 1], velocity: 0.0, acceleration: 0.0 });
    sections
}
