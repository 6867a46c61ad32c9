//! The last edges of all inputs of an I/O node, each with its time: a bounded queue for any number of readers.

use can::{Instant, counted_as};

/// Number of edges that an image holds.
pub const EDGES: usize = 32;

/// Words of a history: the number of edges, and two words per edge.
pub(super) const WORDS: usize = 1 + 2 * EDGES;

/// Position of the level in the word of an edge. The number of the input is in the bits above.
const LEVEL: u32 = 57;

/// A change of the level of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Number of the input, from 0.
    pub input: u8,
    /// Logical level after the edge.
    pub level: bool,
    /// Receive time of the frame that showed the level first.
    pub at: Instant,
    /// Receive time of the previous frame with inputs, which still showed the other level.
    pub previous: Instant,
}

/// The last [`EDGES`] edges of a node, in the order of their frames. Edges of one frame are in the order of the inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct History {
    /// Edges since the end of bring-up.
    pub(super) count: u64,
    /// Edge *n*, counted from 0, is at the index *n* modulo [`EDGES`].
    pub(super) last: [Edge; EDGES],
}

impl History {
    pub(super) const EMPTY: Self = {
        let zero = Instant::ZERO;
        Self { count: 0, last: [Edge { input: 0, level: false, at: zero, previous: zero }; EDGES] }
    };

    pub(super) fn push(&mut self, edge: Edge) {
        self.last[(self.count % EDGES as u64) as usize] = edge;
        self.count += 1;
    }

    /// The edges from edge `seen` on. See [`InputImage::edges_since`](super::InputImage::edges_since).
    pub(super) fn since(&self, seen: u64) -> Result<impl Iterator<Item = Edge> + '_, EdgesLost> {
        // A new bring-up counts from zero.
        let first = if seen > self.count { 0 } else { seen };
        let kept = self.count.saturating_sub(EDGES as u64);
        if first < kept {
            return Err(EdgesLost { count: kept - first });
        }
        Ok((first..self.count).map(|number| self.last[(number % EDGES as u64) as usize]))
    }

    /// The times take 57 bits: four years since the start of the host.
    pub(super) fn write(&self, words: &mut [u64]) {
        words[0] = self.count;
        for (words, edge) in words[1..].chunks_exact_mut(2).zip(&self.last) {
            let time = edge.at.as_nanos() & ((1 << LEVEL) - 1);
            words[0] = time | u64::from(edge.level) << LEVEL | u64::from(edge.input) << (LEVEL + 1);
            words[1] = edge.previous.as_nanos();
        }
    }

    pub(super) fn read(words: &[u64]) -> Self {
        let mut history = Self { count: words[0], ..Self::EMPTY };
        for (words, edge) in words[1..].chunks_exact(2).zip(&mut history.last) {
            *edge = Edge {
                input: (words[0] >> (LEVEL + 1)) as u8,
                level: words[0] >> LEVEL & 1 == 1,
                at: Instant::from_nanos(words[0] & ((1 << LEVEL) - 1)),
                previous: Instant::from_nanos(words[1]),
            };
        }
        history
    }
}

/// A reader came too late for some edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} lost at the node: read the inputs before {EDGES} further edges",
    counted_as(*.count, "edge was", "edges were")
)]
pub struct EdgesLost {
    /// Number of the edges lost.
    pub count: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(number: u64) -> Edge {
        let at = Instant::from_nanos(1_000_000 * number + 123_456_789);
        Edge { input: (number % 64) as u8, level: number % 2 == 1, at, previous: Instant::from_nanos(number) }
    }

    #[test]
    fn a_reader_gets_each_edge_once_and_learns_how_many_were_lost() {
        let mut history = History::EMPTY;
        let mut seen = 0;
        for number in 0..100 {
            history.push(edge(number));
            if number % 7 == 0 {
                let new: Vec<_> = history.since(seen).unwrap().collect();
                assert_eq!(new, (seen..=number).map(edge).collect::<Vec<_>>());
                seen = history.count;
            }
        }
        assert_eq!(history.since(100).unwrap().count(), 0);
        assert_eq!(history.since(68).unwrap().count(), EDGES);
        assert_eq!(history.since(60).err(), Some(EdgesLost { count: 8 }));
        // The image of a later bring-up has fewer edges.
        let mut anew = History::EMPTY;
        anew.push(edge(3));
        assert_eq!(anew.since(100).unwrap().collect::<Vec<_>>(), [edge(3)]);
    }

    #[test]
    fn a_history_is_read_as_it_was_written() {
        let mut history = History::EMPTY;
        (0..70).for_each(|number| history.push(edge(number)));
        let mut words = [0; WORDS];
        history.write(&mut words);
        assert_eq!(History::read(&words), history);
    }
}
