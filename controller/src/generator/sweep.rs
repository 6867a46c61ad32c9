//! The fastest speed along a path within bounds and couplings, by a pass in each direction.

use std::collections::VecDeque;

use super::cells::{Cells, Coupling, TOLERANCE};

/// Bounds of the speed between nodes, each with the cell whose couplings hold there.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    pub(super) nodes: Vec<f64>,
    pub(super) bounds: Vec<f64>,
    pub(super) cells: Vec<usize>,
}

/// A part of the path with a constant acceleration in the forward pass.
struct Part {
    from: f64,
    to: f64,
    /// Squares of the speed at both ends.
    squares: [f64; 2],
    cell: usize,
}

impl Grid {
    pub(super) fn of(cells: &Cells) -> Self {
        Self { nodes: cells.nodes.clone(), bounds: cells.bounds.clone(), cells: (0..cells.bounds.len()).collect() }
    }

    /// The greatest squares of the speed, from rest to rest, at places between which the acceleration is constant. All
    /// nodes are among these places.
    pub(super) fn fastest(&self, acceleration: f64, couplings: &[Coupling]) -> (Vec<f64>, Vec<f64>) {
        let reach = |square: f64, length: f64, cell: usize| {
            // The acceleration is the one permitted at the faster end. A lower speed permits a greater acceleration.
            couplings.iter().fold(square + 2.0 * acceleration * length, |reached, coupling| {
                let (slope, bend) = (coupling.slopes[cell], coupling.bends[cell]);
                reached.min((slope * square + 2.0 * length) / (slope + 2.0 * length * bend))
            })
        };
        let mut parts = Vec::with_capacity(2 * self.bounds.len());
        let mut square = 0.0_f64;
        for (index, (&bound, &cell)) in self.bounds.iter().zip(&self.cells).enumerate() {
            let (from, to, most) = (self.nodes[index], self.nodes[index + 1], bound * bound);
            let begin = square.min(most);
            let end = reach(begin, to - from, cell);
            square = end.min(most);
            let share = (most - begin) / (end - begin);
            if end > most && share > TOLERANCE && share < 1.0 - TOLERANCE {
                let place = from + share * (to - from);
                parts.push(Part { from, to: place, squares: [begin, most], cell });
                parts.push(Part { from: place, to, squares: [most, most], cell });
            } else {
                parts.push(Part { from, to, squares: [begin, square], cell });
            }
        }

        let mut nodes = Vec::with_capacity(2 * parts.len() + 1);
        let mut squares = Vec::with_capacity(2 * parts.len() + 1);
        nodes.push(self.nodes[self.nodes.len() - 1]);
        squares.push(0.0);
        let mut square = 0.0_f64;
        for Part { from, to, squares: [begin, end], cell } in parts.into_iter().rev() {
            let reached = reach(square, to - from, cell);
            if reached >= begin && square < end {
                let share = (reached - begin) / ((end - begin) + (reached - square));
                if share > TOLERANCE && share < 1.0 - TOLERANCE {
                    nodes.push(from + share * (to - from));
                    squares.push(begin + share * (end - begin));
                }
            }
            square = begin.min(reached);
            nodes.push(from);
            squares.push(square);
        }
        nodes.reverse();
        squares.reverse();
        (nodes, squares)
    }

    /// Extends the bound of each part to both sides, over the distance that the bound as a speed covers in `window`.
    ///
    /// Points that are passed less than `window` before or after a part then have a speed of at most the bound of the
    /// part. The moving average keeps this bound. A local minimum of the speed lasts for at least two windows: braking
    /// and acceleration never occur in the same window.
    pub(super) fn widen_dips(&mut self, window: f64) {
        let count = self.bounds.len();
        let last = self.nodes[count];
        let mut cuts = Vec::new();
        for (cell, &bound) in self.bounds.iter().enumerate() {
            let (low, high) = (self.nodes[cell] - bound * window, self.nodes[cell + 1] + bound * window);
            // No cut is needed where a neighbour with an equal or lower bound reaches at least as far.
            let covers = |next: usize| self.bounds[next] <= bound;
            let ahead =
                cell + 1 < count && covers(cell + 1) && self.nodes[cell + 2] + self.bounds[cell + 1] * window >= high;
            let behind = cell > 0 && covers(cell - 1) && self.nodes[cell - 1] - self.bounds[cell - 1] * window <= low;
            cuts.extend((high < last && !ahead).then_some(high));
            cuts.extend((low > 0.0 && !behind).then_some(low));
        }
        cuts.sort_by(f64::total_cmp);
        self.cut(&cuts);
        let reached = swept(&self.nodes, &self.bounds, window, TOLERANCE * last);
        let mirrored: Vec<f64> = self.nodes.iter().rev().map(|node| last - node).collect();
        self.bounds.reverse();
        let mut back = swept(&mirrored, &self.bounds, window, TOLERANCE * last);
        back.reverse();
        self.bounds = reached.into_iter().zip(back).map(|(ahead, behind)| ahead.min(behind)).collect();
    }

    /// Adds nodes at these ascending places, unless a node is very near.
    fn cut(&mut self, places: &[f64]) {
        let least = TOLERANCE * self.nodes[self.nodes.len() - 1];
        let mut places = places.iter().copied().peekable();
        let mut cut = Self {
            nodes: Vec::with_capacity(self.nodes.len() + places.len()),
            bounds: Vec::with_capacity(self.bounds.len() + places.len()),
            cells: Vec::with_capacity(self.bounds.len() + places.len()),
        };
        cut.nodes.push(self.nodes[0]);
        for (part, &bound) in self.bounds.iter().enumerate() {
            let end = self.nodes[part + 1];
            let mut begin = self.nodes[part];
            let mut add = |node: f64| {
                cut.nodes.push(node);
                cut.bounds.push(bound);
                cut.cells.push(self.cells[part]);
            };
            while let Some(place) = places.next_if(|place| *place < end) {
                if place - begin >= least && end - place >= least {
                    add(place);
                    begin = place;
                }
            }
            add(end);
        }
        *self = cut;
    }
}

/// The least bound in each cell: the bound of the cell itself, or of an earlier cell that reaches into the cell.
fn swept(nodes: &[f64], bounds: &[f64], window: f64, least: f64) -> Vec<f64> {
    // Bounds and the ends of their reach, both ascending.
    let mut reaching: VecDeque<(f64, f64)> = VecDeque::new();
    let mut swept = Vec::with_capacity(bounds.len());
    for (cell, &bound) in bounds.iter().enumerate() {
        while reaching.front().is_some_and(|(_, end)| *end <= nodes[cell] + least) {
            reaching.pop_front();
        }
        swept.push(reaching.front().map_or(bound, |(lowest, _)| lowest.min(bound)));
        let end = nodes[cell + 1] + bound * window;
        let at = reaching.partition_point(|(other, _)| *other <= bound);
        if at > 0 && reaching[at - 1].1 >= end {
            continue;
        }
        while at < reaching.len() && reaching[at].1 <= end {
            reaching.remove(at);
        }
        reaching.insert(at, (bound, end));
    }
    swept
}

/// Greatest coefficients of each cell and of all cells within `window` before and behind the cell. `times` are the
/// times at the nodes between the cells.
pub(super) fn widened(couplings: &[Coupling], times: &[f64], window: f64) -> Vec<Coupling> {
    let count = times.len() - 1;
    let mut spans = Vec::with_capacity(count);
    let (mut first, mut behind) = (0, 0);
    for cell in 0..count {
        while times[first + 1] < times[cell] - window {
            first += 1;
        }
        while behind < count && times[behind] <= times[cell + 1] + window {
            behind += 1;
        }
        spans.push((first, behind));
    }
    let most = |values: &[f64]| {
        // Candidates for the greatest value: cells in the order of descending values.
        let mut candidates: VecDeque<usize> = VecDeque::new();
        let mut taken = 0;
        let mut most = Vec::with_capacity(count);
        for &(first, behind) in &spans {
            while taken < behind {
                while candidates.back().is_some_and(|last| values[*last] <= values[taken]) {
                    candidates.pop_back();
                }
                candidates.push_back(taken);
                taken += 1;
            }
            while candidates.front().is_some_and(|next| *next < first) {
                candidates.pop_front();
            }
            most.push(candidates.front().map_or(0.0, |next| values[*next]));
        }
        most
    };
    couplings.iter().map(|coupling| Coupling { slopes: most(&coupling.slopes), bends: most(&coupling.bends) }).collect()
}
