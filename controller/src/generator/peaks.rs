//! Short local maxima of the speed along a path.

use super::cells::TOLERANCE;

/// Number of halvings to the level of a peak.
const HALVINGS: u32 = 60;

/// Lowers each local maximum of the speed until its duration is `window`. Acceleration and braking then never occur in the
/// same window.
pub(super) fn flatten_peaks(nodes: &mut Vec<f64>, squares: &mut Vec<f64>, window: f64) {
    let mut node = 1;
    while node < squares.len() - 1 {
        if squares[node] <= squares[node - 1] {
            node += 1;
            continue;
        }
        let mut peak = Peak::around(node, squares);
        let Some(level) = peak.lower(nodes, squares, window) else {
            node = peak.high + 1;
            continue;
        };
        if !peak.is_peak(squares, level) {
            squares[peak.low..=peak.high].fill(level);
            node = peak.high + 1;
            continue;
        }
        let [begin, end] = peak.ends(nodes, squares, level);
        if peak.low == peak.high {
            nodes.insert(peak.high + 1, end);
            squares.insert(peak.high + 1, level);
            peak.high += 1;
        }
        (nodes[peak.low], nodes[peak.high]) = (begin, end);
        squares[peak.low..=peak.high].fill(level);
        node = peak.high + 1;
    }
}

/// A local maximum of the speed: the nodes `low` to `high`.
struct Peak {
    low: usize,
    high: usize,
}

impl Peak {
    /// A node and its neighbours with the same square of the speed.
    fn around(node: usize, squares: &[f64]) -> Self {
        let mut peak = Self { low: node, high: node };
        peak.widen(squares, squares[node]);
        peak
    }

    /// Adds the neighbours with this square.
    fn widen(&mut self, squares: &[f64], level: f64) {
        while self.low > 0 && squares[self.low - 1] == level {
            self.low -= 1;
        }
        while self.high + 1 < squares.len() && squares[self.high + 1] == level {
            self.high += 1;
        }
    }

    /// Whether both neighbours have a smaller square than `level`.
    fn is_peak(&self, squares: &[f64], level: f64) -> bool {
        let lower = |node: Option<&f64>| node.is_some_and(|square| *square < level);
        self.low > 0 && lower(squares.get(self.low - 1)) && lower(squares.get(self.high + 1))
    }

    /// The level at which the peak lasts for `window`. `None` if the peak need not be lowered.
    fn lower(&mut self, nodes: &[f64], squares: &[f64], window: f64) -> Option<f64> {
        let enough = window * (1.0 - TOLERANCE / 10.0);
        let mut level = squares[self.high];
        if !self.is_peak(squares, level) || self.lasts(nodes, squares, level) >= enough {
            return None;
        }
        loop {
            let next = squares[self.low - 1].max(squares[self.high + 1]);
            let found = if next > 0.0 { self.lasts(nodes, squares, next) } else { f64::INFINITY };
            if found > window * (1.0 + TOLERANCE) {
                return Some(self.level(nodes, squares, window, [next, level]));
            }
            level = next;
            if found >= enough {
                return Some(level);
            }
            self.widen(squares, level);
            if !self.is_peak(squares, level) {
                return Some(level);
            }
        }
    }

    /// The greatest level between two at which the peak lasts for `window`.
    fn level(&self, nodes: &[f64], squares: &[f64], window: f64, [mut low, mut high]: [f64; 2]) -> f64 {
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(low, high);
            if self.lasts(nodes, squares, middle) >= window { low = middle } else { high = middle }
        }
        low
    }

    /// Duration of the peak at a level, s.
    fn lasts(&self, nodes: &[f64], squares: &[f64], level: f64) -> f64 {
        let [begin, end] = self.ends(nodes, squares, level);
        (end - begin) / level.sqrt()
    }

    /// Where the profile crosses a level before and after the peak.
    fn ends(&self, nodes: &[f64], squares: &[f64], level: f64) -> [f64; 2] {
        let crossing = |inside: usize, outside: usize| {
            let share = (level - squares[outside]) / (squares[inside] - squares[outside]);
            if share < 1.0 { nodes[outside] + share * (nodes[inside] - nodes[outside]) } else { nodes[inside] }
        };
        [crossing(self.low, self.low - 1), crossing(self.high, self.high + 1)]
    }
}
