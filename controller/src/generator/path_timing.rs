//! Time-optimal timing of a joint path within limits of velocity and acceleration, by reachability analysis (TOPP-RA).

use servo::MAX_AXES;
use thiserror::Error;

use super::{Axes, AxesState, MotionLimits, is_limit};
use crate::path::{JointPath, JointPoint};

/// Number of segments of the first grid on the whole path.
const SEGMENTS: f64 = 100.0;
/// Least number of segments of the first grid between two knots.
const PART_SEGMENTS: f64 = 8.0;
/// Accepted excess over a limit between two nodes of the grid: 0.1 %, less the error of interpolated velocities.
const EXCESS: f64 = 0.9e-3;
/// A segment that leaves this share of all limits unused at some point is halved, if it lasts longer than `RESOLUTION`.
/// Such segments are near the ends of the path, and where acceleration turns into braking.
const IDLE: f64 = 0.03;
/// Duration of a segment, relative to the whole duration, below which an idle segment is not halved.
const RESOLUTION: f64 = 2e-3;
/// Largest number of grids after the first one.
const GRIDS: u32 = 16;
/// Bound of x where the path has no other bound.
const UNBOUNDED: f64 = 1e30;
/// Coefficient of u below which a limit concerns x alone.
const VANISHING: f64 = 1e-100;
/// Rounding error of a limit, relative to its terms.
const ROUNDING: f64 = 1e-12;
/// Largest number of strips of a stage: two per axis, and the controllable set of the next node.
const MOST_STRIPS: usize = 2 * MAX_AXES + 1;
/// Largest number of steps to the end of an interval: each step uses another pair of strips.
const MOST_PAIRS: usize = MOST_STRIPS * MOST_STRIPS;

/// Reasons why a joint path has no timing within limits. Places are values of the path parameter s.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum TimingError {
    #[error("axis {axis}: limit of velocity or acceleration is not positive and finite")]
    Limit { axis: u8 },
    #[error("speed {speed} at an end of the path is negative or not a finite number")]
    EndSpeed { speed: f64 },
    #[error("node {node} of the grid: nodes ascend from 0 to the length of the path, {length}")]
    Grid { node: usize, length: f64 },
    #[error("at {s:.6} of {length:.6} of the path: no speed keeps the limits and leads to the end speed: reduce it")]
    Infeasible { s: f64, length: f64 },
    #[error("start speed {speed:.6}: the limits and the end speed permit {least:.6} to {most:.6}")]
    StartSpeed { speed: f64, least: f64, most: f64 },
    #[error("at {s:.6} of {length:.6} of the path: the path stands still: add nodes to the grid")]
    Standstill { s: f64, length: f64 },
    /// The way-points are so uneven that the finest grid does not resolve the path.
    #[error("at {s:.6} of {length:.6} of the path: {times:.4} times a limit between two nodes: smooth the path there")]
    Unresolved { s: f64, length: f64, times: f64 },
}

/// Speeds ds/dt at both ends of a path. The default is rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EndSpeeds {
    /// At the start.
    pub start: f64,
    /// At the end.
    pub end: f64,
}

/// Time-optimal path parameter s(t) of a [`JointPath`] within limits of joint velocity and acceleration.
///
/// The method is TOPP-RA (Pham and Pham, IEEE Transactions on Robotics 34, 2018). On a grid of s, let x = ṡ² and u =
/// s̈, with u constant between two nodes. The limits are then linear: x ≤ (v / |q′|)² and |q′ u + q″ x| ≤ a for each
/// joint. The limits of acceleration hold at both ends of each segment (interpolation scheme).
///
/// A backward pass computes the controllable set of each node: the interval of x from which the end speed can be
/// reached. A forward pass takes the greatest u that leads into the controllable set of the next node. Each pass solves
/// linear programs of two variables, exactly.
///
/// The motion is the fastest on its grid. Jerk is not limited.
#[derive(Clone, Debug)]
pub struct PathTiming {
    path: JointPath,
    nodes: Vec<Node>,
}

/// A node of the grid, and the segment from there to the next node.
#[derive(Clone, Copy, Debug)]
struct Node {
    /// Time from the start of the path, s.
    time: f64,
    s: f64,
    /// ds/dt.
    speed: f64,
    /// d²s/dt² of the segment.
    acceleration: f64,
}

impl PathTiming {
    /// The timing on a grid whose segments are halved until the limits are exceeded by 0.1 % at most between nodes, and
    /// are used to 97 % in all segments longer than 0.2 % of the duration. `limits.max_jerk` is ignored.
    pub fn optimal(path: JointPath, limits: &MotionLimits, speeds: EndSpeeds) -> Result<Self, TimingError> {
        let mut timing = Self { nodes: solved(&path, limits, speeds, &first_grid(&path))?, path };
        for _ in 0..GRIDS {
            let grid = timing.finer_grid(limits);
            if grid.len() == timing.nodes.len() {
                return Ok(timing);
            }
            timing.nodes = solved(&timing.path, limits, speeds, &grid)?;
        }
        let segments = timing.nodes.windows(2).map(|pair| (pair[0].s, timing.use_of_limits(pair, limits)[0]));
        let length = timing.path.length();
        match segments.max_by(|one, other| one.1.total_cmp(&other.1)) {
            Some((s, times)) if times > 1.0 + EXCESS => Err(TimingError::Unresolved { s, length, times }),
            Some(_) | None => Ok(timing),
        }
    }

    /// The timing on a given grid of s, which ascends from 0 to the length of the path. `limits.max_jerk` is ignored.
    pub fn on_grid(
        path: JointPath,
        limits: &MotionLimits,
        speeds: EndSpeeds,
        grid: &[f64],
    ) -> Result<Self, TimingError> {
        let length = path.length();
        let last = grid.len().saturating_sub(1);
        let sound = |node: usize| match node {
            0 => grid.first() == Some(&0.0) && last > 0,
            _ => grid[node] > grid[node - 1] && (grid[node] < length) == (node < last) && grid[node] <= length,
        };
        if let Some(node) = (0..=last).find(|node| !sound(*node)) {
            return Err(TimingError::Grid { node, length });
        }
        Ok(Self { nodes: solved(&path, limits, speeds, grid)?, path })
    }

    /// The path.
    pub fn path(&self) -> &JointPath {
        &self.path
    }

    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.nodes[self.nodes.len() - 1].time
    }

    /// Path parameter and its speed ds/dt at each node of the grid.
    pub fn profile(&self) -> impl Iterator<Item = (f64, f64)> {
        self.nodes.iter().map(|node| (node.s, node.speed))
    }

    /// Path parameter s, ds/dt and d²s/dt², `time` s after the start. Times before the start and after the end give the
    /// values at the ends.
    pub fn parameter(&self, time: f64) -> [f64; 3] {
        let after = self.nodes.partition_point(|node| node.time <= time).clamp(1, self.nodes.len() - 1);
        let (node, next) = (&self.nodes[after - 1], &self.nodes[after]);
        if time >= next.time {
            return [next.s, next.speed, node.acceleration];
        }
        let t = time.max(node.time) - node.time;
        let s = node.s + t * (node.speed + t * node.acceleration / 2.0);
        [s.clamp(node.s, next.s), (node.speed + t * node.acceleration).max(0.0), node.acceleration]
    }

    /// State of the joints `time` s after the start. Where the acceleration jumps, the state has the value after the jump.
    pub fn at(&self, time: f64) -> AxesState {
        let [s, speed, acceleration] = self.parameter(time);
        moving(&self.path.at(s), speed, acceleration)
    }

    /// Largest velocity or acceleration of a joint relative to its limit: the greatest value in a segment, and the
    /// least of its values inside.
    ///
    /// Between knots q′ and the acceleration are parabolas of s, and three points determine each.
    fn use_of_limits(&self, segment: &[Node], limits: &MotionLimits) -> [f64; 2] {
        let [from, to] = [segment[0], segment[1]];
        let square = |share: f64| from.speed.powi(2) * (1.0 - share) + to.speed.powi(2) * share;
        let points = [0.0, 0.5, 1.0].map(|share| {
            let point = self.path.at(from.s + (to.s - from.s) * share);
            (point.first, point.second, square(share))
        });
        let shares: [f64; 9] = std::array::from_fn(|eighths| eighths as f64 / 8.0);
        let speeds = shares.map(|share| square(share).sqrt());
        let (mut greatest, mut inside) = (0.0_f64, [0.0_f64; 9]);
        for axis in 0..self.path.axes() {
            let (velocity, acceleration) = (limits.max_velocity[axis], limits.max_acceleration[axis]);
            let rates = points.map(|(first, ..)| first[axis] / velocity);
            let pushes = points.map(|(first, second, x)| first[axis] * from.acceleration + second[axis] * x);
            let pushes = pushes.map(|push| push / acceleration);
            let velocities: [f64; 9] = std::array::from_fn(|at| speeds[at] * parabola(rates, shares[at]));
            let fastest = [0, 2, 4, 6].map(|at| peak([velocities[at], velocities[at + 1], velocities[at + 2]]));
            greatest = fastest.into_iter().fold(greatest.max(peak(pushes)), f64::max);
            for at in 0..9 {
                inside[at] = inside[at].max(velocities[at].abs()).max(parabola(pushes, shares[at]).abs());
            }
        }
        [greatest, inside[2].min(inside[4]).min(inside[6])]
    }

    /// The grid with all segments halved that exceed a limit, or are long and reach none.
    fn finer_grid(&self, limits: &MotionLimits) -> Vec<f64> {
        let long = RESOLUTION * self.duration();
        let mut grid = vec![0.0];
        for segment in self.nodes.windows(2) {
            let [used, inside] = self.use_of_limits(segment, limits);
            let unused = inside < 1.0 - IDLE && segment[1].time - segment[0].time > long;
            if used > 1.0 + EXCESS || unused {
                grid.push(f64::midpoint(segment[0].s, segment[1].s));
            }
            grid.push(segment[1].s);
        }
        grid
    }
}

/// State of the joints at a point that is passed with this speed and acceleration of s.
fn moving(point: &JointPoint, speed: f64, acceleration: f64) -> AxesState {
    let by = |axis: usize| point.first[axis] * acceleration + point.second[axis] * speed * speed;
    let velocity = point.first.map(|first| first * speed);
    AxesState::new(point.position, velocity).accelerating(std::array::from_fn(by))
}

/// First and second coefficient of a parabola on the unit interval, from its values at 0, 1/2 and 1.
fn coefficients([start, middle, end]: [f64; 3]) -> [f64; 2] {
    [4.0 * middle - 3.0 * start - end, 2.0 * (start - 2.0 * middle + end)]
}

/// Value of a parabola.
fn parabola(values: [f64; 3], at: f64) -> f64 {
    let [slope, curvature] = coefficients(values);
    values[0] + at * (slope + at * curvature)
}

/// Largest absolute value of a parabola.
fn peak(values: [f64; 3]) -> f64 {
    let [slope, curvature] = coefficients(values);
    let vertex = (-slope / (2.0 * curvature)).clamp(0.0, 1.0);
    let vertex = if vertex.is_finite() { parabola(values, vertex) } else { values[1] };
    values[0].abs().max(vertex.abs()).max(values[2].abs())
}

/// A grid with a node at each knot.
fn first_grid(path: &JointPath) -> Vec<f64> {
    let mut grid = vec![0.0];
    for pair in path.knots().windows(2) {
        let part = pair[1] - pair[0];
        let segments = (SEGMENTS * part / path.length()).max(PART_SEGMENTS).ceil();
        grid.extend((1..segments as u32).map(|node| pair[0] + part * f64::from(node) / segments));
        grid.push(pair[1]);
    }
    grid
}

/// The time-optimal nodes on a grid.
fn solved(path: &JointPath, limits: &MotionLimits, speeds: EndSpeeds, grid: &[f64]) -> Result<Vec<Node>, TimingError> {
    let (axes, length) = (path.axes(), path.length());
    for axis in 0..axes {
        if !is_limit(limits.max_velocity[axis]) || !is_limit(limits.max_acceleration[axis]) {
            return Err(TimingError::Limit { axis: axis as u8 });
        }
    }
    if let Some(speed) = [speeds.start, speeds.end].into_iter().find(|speed| !(*speed >= 0.0 && speed.is_finite())) {
        return Err(TimingError::EndSpeed { speed });
    }
    let rows: Vec<Row> = grid.iter().map(|s| Row::of(&path.at(*s), limits, axes)).collect();
    let last = grid.len() - 1;
    let stage = |node: usize, reach: [f64; 2]| {
        Stage::between([&rows[node], &rows[node + 1]], axes, grid[node + 1] - grid[node], reach)
    };

    let end = speeds.end.powi(2);
    if end > rows[last].most * (1.0 + ROUNDING) {
        return Err(TimingError::Infeasible { s: length, length });
    }
    let mut sets = vec![[end; 2]; grid.len()];
    for node in (0..last).rev() {
        let set = stage(node, sets[node + 1]).interval();
        sets[node] = set.ok_or(TimingError::Infeasible { s: grid[node], length })?;
    }

    let start = speeds.start.powi(2);
    let [least, most] = sets[0];
    if start < least * (1.0 - ROUNDING) || start > most * (1.0 + ROUNDING) {
        let [least, most] = [least.sqrt(), most.sqrt()];
        return Err(TimingError::StartSpeed { speed: speeds.start, least, most });
    }
    let (mut x, mut time) = (start.min(most).max(least), 0.0);
    let mut nodes = Vec::with_capacity(grid.len());
    for node in 0..last {
        let step = grid[node + 1] - grid[node];
        let u = stage(node, sets[node + 1]).greatest_u(x);
        let [least, most] = sets[node + 1];
        let next = (x + 2.0 * step * u).min(most).max(least);
        let both = x.sqrt() + next.sqrt();
        if both <= 0.0 {
            return Err(TimingError::Standstill { s: grid[node], length });
        }
        nodes.push(Node { time, s: grid[node], speed: x.sqrt(), acceleration: (next - x) / (2.0 * step) });
        time += 2.0 * step / both;
        x = next;
    }
    nodes.push(Node { time, s: grid[last], speed: x.sqrt(), acceleration: 0.0 });
    Ok(nodes)
}

/// Limits at one node.
#[derive(Clone, Copy)]
struct Row {
    /// q′ and q″, divided by the limits of acceleration.
    first: Axes,
    second: Axes,
    /// Greatest x by the limits of velocity.
    most: f64,
}

impl Row {
    fn of(point: &JointPoint, limits: &MotionLimits, axes: usize) -> Self {
        let mut row = Self { first: Axes::default(), second: Axes::default(), most: UNBOUNDED };
        for axis in 0..axes {
            row.first[axis] = point.first[axis] / limits.max_acceleration[axis];
            row.second[axis] = point.second[axis] / limits.max_acceleration[axis];
            row.most = row.most.min((limits.max_velocity[axis] / point.first[axis]).powi(2));
        }
        row
    }
}

/// A strip of the plane of u and x: low ≤ u + slope · x ≤ high.
#[derive(Clone, Copy, Default)]
struct Strip {
    slope: f64,
    low: f64,
    high: f64,
}

/// A bound of u at one x: u = at_zero − slope · x.
#[derive(Clone, Copy)]
struct Edge {
    u: f64,
    at_zero: f64,
    slope: f64,
}

/// The permitted u and x of one segment: the intersection of strips with 0 ≤ x ≤ `most`.
struct Stage {
    strips: [Strip; MOST_STRIPS],
    count: usize,
    most: f64,
}

impl Stage {
    /// The limits at both ends of a segment of length `step`, and an interval of x at its end.
    fn between([row, next]: [&Row; 2], axes: usize, step: f64, reach: [f64; 2]) -> Self {
        let mut stage = Self { strips: [Strip::default(); MOST_STRIPS], count: 0, most: row.most };
        for axis in 0..axes {
            stage.limit(row.first[axis], row.second[axis]);
            // x at the end of the segment is x + 2 step u.
            stage.limit(next.first[axis] + 2.0 * step * next.second[axis], next.second[axis]);
        }
        let [low, high] = reach.map(|x| x / (2.0 * step));
        stage.push(Strip { slope: 1.0 / (2.0 * step), low, high });
        stage
    }

    fn push(&mut self, strip: Strip) {
        self.strips[self.count] = strip;
        self.count += 1;
    }

    /// Adds |by_u u + by_x x| ≤ 1.
    fn limit(&mut self, by_u: f64, by_x: f64) {
        if by_u.abs() < VANISHING {
            self.most = self.most.min(1.0 / by_x.abs());
        } else {
            let half = 1.0 / by_u.abs();
            self.push(Strip { slope: by_x / by_u, low: -half, high: half });
        }
    }

    /// Greatest lower bound and least upper bound of u at `x`.
    fn bounds(&self, x: f64) -> [Edge; 2] {
        let mut low = Edge { u: f64::NEG_INFINITY, at_zero: f64::NEG_INFINITY, slope: 0.0 };
        let mut high = Edge { u: f64::INFINITY, at_zero: f64::INFINITY, slope: 0.0 };
        for Strip { slope, low: below, high: above } in &self.strips[..self.count] {
            let shift = slope * x;
            if below - shift > low.u {
                low = Edge { u: below - shift, at_zero: *below, slope: *slope };
            }
            if above - shift < high.u {
                high = Edge { u: above - shift, at_zero: *above, slope: *slope };
            }
        }
        [low, high]
    }

    /// Least and greatest x with a permitted u; `None` if no x has a permitted u.
    ///
    /// The gap between upper and lower bound is concave in x and linear in pieces. Newton's method therefore ends at
    /// the exact solution: each step goes to the place where the present pair of bounds meets.
    fn interval(&self) -> Option<[f64; 2]> {
        let mut least = 0.0;
        for _ in 0..MOST_PAIRS {
            let pair = self.bounds(least);
            if permits(&pair, least) {
                break;
            }
            let meeting = meeting(&pair);
            if !(meeting > least && meeting <= self.most * (1.0 + ROUNDING)) {
                return None;
            }
            least = meeting.min(self.most);
        }
        let mut greatest = self.most;
        for _ in 0..MOST_PAIRS {
            let pair = self.bounds(greatest);
            if permits(&pair, greatest) {
                break;
            }
            let meeting = meeting(&pair);
            if !(meeting > least && meeting < greatest) {
                greatest = least;
                break;
            }
            greatest = meeting;
        }
        Some([least, greatest])
    }

    /// Greatest permitted u at an x of the controllable set.
    fn greatest_u(&self, x: f64) -> f64 {
        let [low, high] = self.bounds(x);
        // At an end of the set both bounds meet, and rounding may exchange them. The flatter bound is the more
        // accurate.
        if low.u > high.u && low.slope.abs() < high.slope.abs() { low.u } else { high.u }
    }
}

/// Whether a u lies between two bounds, up to rounding.
fn permits([low, high]: &[Edge; 2], x: f64) -> bool {
    let terms = |edge: &Edge| edge.at_zero.abs() + (edge.slope * x).abs();
    low.u - high.u <= ROUNDING * (terms(low) + terms(high))
}

/// The x at which two bounds of u are equal.
fn meeting([low, high]: &[Edge; 2]) -> f64 {
    (low.at_zero - high.at_zero) / (low.slope - high.slope)
}
