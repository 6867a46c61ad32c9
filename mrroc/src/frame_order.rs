//! Frames of several buses in the order of their times.

use std::collections::BTreeMap;
use std::time::Duration;

use can::{Instant, Traced};

/// Time for which a frame waits for earlier frames. Frames of one bus come in the order of their times, except after a
/// step of the clock that stamps them: some tens of milliseconds.
const HELD: Duration = Duration::from_millis(200);

/// Frames that wait for frames with earlier times. Each bus has a queue of its own, which is emptied at once, so that
/// the frames of one bus come before those of the next.
#[derive(Debug, Default)]
pub(crate) struct FrameOrder {
    /// By time, and by number among frames of one time.
    held: BTreeMap<(Instant, u64), (usize, Traced)>,
    number: u64,
    /// Latest time of all frames.
    latest: Instant,
    /// Time of the last frame that was taken.
    taken: Instant,
}

impl FrameOrder {
    /// Adds a frame of a bus. A frame that is earlier than the frames already taken gets the time of the last of these:
    /// its clock was set back by more than the time that frames are held.
    pub(crate) fn push(&mut self, bus: usize, traced: Traced) {
        let at = traced.at.max(self.taken);
        self.latest = self.latest.max(at);
        self.number += 1;
        self.held.insert((at, self.number), (bus, Traced { at, ..traced }));
    }

    /// The next frame with its bus, once it was held long enough. To be called when all queues were emptied.
    pub(crate) fn next(&mut self) -> Option<(usize, Traced)> {
        let (at, _) = *self.held.first_key_value()?.0;
        if self.latest.since(at) < HELD { None } else { self.rest() }
    }

    /// The next frame with its bus, at the end of a log.
    pub(crate) fn rest(&mut self) -> Option<(usize, Traced)> {
        let ((at, _), frame) = self.held.pop_first()?;
        self.taken = at;
        Some(frame)
    }
}

#[cfg(test)]
mod tests {
    use can::candump::Direction;
    use can::{Frame, StandardId};

    use super::*;

    /// A frame at this time, ms, with a number.
    fn frame(millis: u64, number: u8) -> Traced {
        let frame = Frame::new(StandardId::new(0x100).unwrap(), &[number]).unwrap();
        Traced { at: Instant::from_nanos(millis * 1_000_000), frame, direction: Direction::Received }
    }

    /// Buses, times in ms and numbers of what comes out.
    fn taken(next: impl FnMut() -> Option<(usize, Traced)>) -> Vec<(usize, u64, u8)> {
        let frames = std::iter::from_fn(next);
        frames.map(|(bus, it)| (bus, it.at.as_nanos() / 1_000_000, it.frame.data()[0])).collect()
    }

    #[test]
    fn frames_of_several_buses_come_out_in_the_order_of_time() {
        let mut order = FrameOrder::default();
        for (bus, frames) in [(0, [(0, 1), (10, 2), (1000, 3)]), (1, [(0, 4), (9, 5), (900, 6)])] {
            for (millis, number) in frames {
                order.push(bus, frame(millis, number));
            }
        }
        assert_eq!(taken(|| order.next()), [(0, 0, 1), (1, 0, 4), (1, 9, 5), (0, 10, 2)]);
        // The frame at 900 ms waits for others.
        order.push(0, frame(850, 7));
        order.push(0, frame(5, 8));
        assert_eq!(taken(|| order.next()), [(0, 10, 8)], "a late frame is not put before those that were taken");
        assert_eq!(taken(|| order.rest()), [(0, 850, 7), (1, 900, 6), (0, 1000, 3)]);
        assert_eq!(taken(|| order.rest()), []);
    }

    #[test]
    fn a_step_of_the_clock_by_40_ms_within_a_bus_leaves_no_step_backwards_in_the_log() {
        let mut order = FrameOrder::default();
        let mut log = Vec::new();
        // Two buses whose frames come every 2 ms. The clock is set back by 40 ms after 1 s, and forward again after 2 s.
        for turn in 0..1500_u64 {
            let steps = 40 * u64::from((500..1000).contains(&turn));
            for bus in [0, 1] {
                order.push(bus, frame(2 * turn + 100 - steps, turn as u8));
            }
            log.extend(taken(|| order.next()));
        }
        log.extend(taken(|| order.rest()));
        assert_eq!(log.len(), 3000);
        assert!(log.is_sorted_by_key(|&(_, millis, _)| millis));
        // The frames keep their own times. Frames of the 40 ms after the step back lie among frames of the 40 ms
        // before.
        let times = log.iter().filter(|(bus, ..)| *bus == 0).map(|&(_, millis, _)| millis);
        let times: Vec<_> = times.collect();
        assert_eq!(times.windows(2).filter(|pair| pair[0] == pair[1]).count(), 20);
        assert!(times.windows(3).all(|times| times[0] < times[2]), "a frame has the time of another one");
    }
}
