//! When SYNC and the answers to it were on the wire: the bus's own view of the cycle.
//!
//! [`WireTiming`] is handed every frame of one bus with the time of its last bit, and tells how far SYNCs are apart and
//! how long after its SYNC each synchronous TPDO came. What lies between the host's clock and the bus (thread, kernel,
//! driver, queue, arbitration) is in these times, as a node sees it. It owns no port, no clock and no histogram, and
//! nothing allocates after it was made.
//!
//! A SYNC is judged when the next one comes, so the last of a recording is not judged at all.

use std::time::Duration;

use can::{Frame, Instant, StandardId};

use crate::sync::Sync;

/// A time between two frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants document their fields")]
pub enum Sample {
    /// From one SYNC to the next.
    SyncToSync(Duration),
    /// From a SYNC to the TPDO that answered it: `index` is that of the identifier given to [`WireTiming::new`].
    SyncToAnswer { index: usize, after: Duration },
}

/// How the SYNCs that were judged were answered under one identifier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AnswerCounts {
    /// SYNCs answered before the next one, or recognisably late.
    pub answered: u64,
    /// SYNCs not answered.
    pub unanswered: u64,
    /// Of those answered, behind the next SYNC.
    pub late: u64,
    /// Answers beyond one per SYNC.
    pub surplus: u64,
}

/// One bus. See the [module](self).
///
/// Frames do not say which SYNC they answer. A late answer is recognised only if the next answer comes between the
/// same two SYNCs. The first answer is then the late one, and its time counts from the SYNC before. An answer that is
/// always late by a whole cycle looks like a quick one.
#[derive(Clone, Debug)]
pub struct WireTiming {
    last_sync: Option<Instant>,
    answers: Box<[Answers]>,
}

/// What came under one identifier since the last SYNC.
#[derive(Clone, Debug)]
struct Answers {
    id: StandardId,
    first: Option<Instant>,
    second: Option<Instant>,
    more: u64,
    /// The SYNC before the last, if it was not answered.
    owed: Option<Instant>,
    counts: AnswerCounts,
}

impl WireTiming {
    /// For the synchronous TPDOs sent under `answers`, each of them after every SYNC.
    pub fn new(answers: impl IntoIterator<Item = StandardId>) -> Self {
        let answers = answers.into_iter().map(|id| Answers {
            id,
            first: None,
            second: None,
            more: 0,
            owed: None,
            counts: AnswerCounts::default(),
        });
        Self { last_sync: None, answers: answers.collect() }
    }

    /// Takes a frame of the bus with its time, in the order of the bus. At each SYNC `sample` receives the distance
    /// to the SYNC before and the answers to that SYNC. Other frames, and answers before the first SYNC, are passed
    /// over.
    pub fn observe(&mut self, at: Instant, frame: &Frame, mut sample: impl FnMut(Sample)) {
        if Sync::decode(frame).is_some() {
            if let Some(last) = self.last_sync.replace(at) {
                sample(Sample::SyncToSync(at.since(last)));
                for (index, answers) in self.answers.iter_mut().enumerate() {
                    answers.judge(last, |after| sample(Sample::SyncToAnswer { index, after }));
                }
            }
            return;
        }
        let Some(id) = frame.standard_data_id().filter(|_| self.last_sync.is_some()) else {
            return;
        };
        if let Some(answers) = self.answers.iter_mut().find(|answers| answers.id == id) {
            match (answers.first, answers.second) {
                (None, _) => answers.first = Some(at),
                (Some(_), None) => answers.second = Some(at),
                (Some(_), Some(_)) => answers.more += 1,
            }
        }
    }

    /// What follows is another recording of the same bus: the last SYNC of the one before is not judged.
    pub fn pause(&mut self) {
        self.last_sync = None;
        for answers in &mut self.answers {
            (answers.first, answers.second, answers.owed) = (None, None, None);
            answers.more = 0;
        }
    }

    /// How SYNCs were answered under each identifier, in the order given.
    pub fn counts(&self) -> impl Iterator<Item = AnswerCounts> {
        self.answers.iter().map(|answers| answers.counts)
    }
}

impl Answers {
    /// Judges what came between `sync` and the next one.
    fn judge(&mut self, sync: Instant, mut sample: impl FnMut(Duration)) {
        let counts = &mut self.counts;
        let owed = self.owed.take();
        counts.surplus += std::mem::take(&mut self.more);
        match (self.first.take(), self.second.take(), owed) {
            (None, ..) => {
                counts.unanswered += 1;
                self.owed = Some(sync);
            }
            (Some(late), Some(first), Some(owed)) => {
                sample(late.since(owed));
                sample(first.since(sync));
                counts.unanswered -= 1;
                counts.late += 1;
                counts.answered += 2;
            }
            (Some(first), second, _) => {
                sample(first.since(sync));
                counts.answered += 1;
                counts.surplus += u64::from(second.is_some());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NodeId, cob, parse, pdo::PdoNumber};

    /// What the frames, each at its µs, make of the answers of nodes 1 and 2.
    fn observed(frames: &[(u64, &str)]) -> (Vec<Sample>, Vec<AnswerCounts>) {
        let ids = [1, 2].map(|node| cob::tpdo(PdoNumber::One, NodeId::new(node).unwrap()));
        let mut timing = WireTiming::new(ids);
        let mut samples = Vec::new();
        for &(micros, frame) in frames {
            let at = Instant::from_nanos(micros * 1000);
            timing.observe(at, &parse(frame), |sample| samples.push(sample));
        }
        (samples, timing.counts().collect())
    }

    #[test]
    fn a_pause_is_no_time_between_syncs_and_leaves_none_unanswered() {
        let id = cob::tpdo(PdoNumber::One, NodeId::new(1).unwrap());
        let mut timing = WireTiming::new([id]);
        let mut samples = 0;
        for (micros, frame) in [(0, "080#"), (100, "181#00"), (2000, "080#"), (2100, "181#00")] {
            let at = Instant::from_nanos(micros * 1000);
            timing.observe(at, &parse(frame), |_| samples += 1);
        }
        timing.pause();
        let at = Instant::from_nanos(9_000_000);
        timing.observe(at, &parse("080#"), |_| samples += 1);
        let counts = timing.counts().next().unwrap();
        assert_eq!((samples, counts.answered, counts.unanswered), (2, 1, 0));
    }

    fn check(what: &str, frames: &[(u64, &str)], samples: &[Sample], counts: [[u64; 4]; 2]) {
        let counts =
            counts.map(|[answered, unanswered, late, surplus]| AnswerCounts { answered, unanswered, late, surplus });
        let expected = (samples.to_vec(), counts.to_vec());
        assert_eq!(observed(frames), expected, "{what}");
    }

    fn apart(micros: u64) -> Sample {
        Sample::SyncToSync(Duration::from_micros(micros))
    }

    fn answer(index: usize, micros: u64) -> Sample {
        let after = Duration::from_micros(micros);
        Sample::SyncToAnswer { index, after }
    }

    const SYNC: &str = "080#";
    const ONE: &str = "181#0000";
    const TWO: &str = "182#0000";

    #[test]
    fn each_sync_is_judged_at_the_next() {
        let cycle = [(0, SYNC), (120, ONE), (250, TWO)];
        check("no second SYNC", &cycle, &[], [[0; 4]; 2]);
        check(
            "a cycle, and a late SYNC",
            &[&cycle[..], &[(1040, SYNC)]].concat(),
            &[apart(1040), answer(0, 120), answer(1, 250)],
            [[1, 0, 0, 0]; 2],
        );
        check(
            "a SYNC that counts",
            &[(0, "080#01"), (120, ONE), (130, TWO), (1000, "080#02")],
            &[apart(1000), answer(0, 120), answer(1, 130)],
            [[1, 0, 0, 0]; 2],
        );
        check(
            "a SYNC left out is one long distance, and no node owes an answer for it",
            &[&cycle[..], &[(2000, SYNC)]].concat(),
            &[apart(2000), answer(0, 120), answer(1, 250)],
            [[1, 0, 0, 0]; 2],
        );
    }

    #[test]
    fn an_answer_is_counted_for_one_sync_alone() {
        check(
            "answers before the first SYNC",
            &[(0, ONE), (5, TWO), (10, SYNC), (100, ONE), (1010, SYNC)],
            &[apart(1000), answer(0, 90)],
            [[1, 0, 0, 0], [0, 1, 0, 0]],
        );
        check(
            "duplicates",
            &[(0, SYNC), (100, ONE), (200, ONE), (300, ONE), (400, TWO), (1000, SYNC)],
            &[apart(1000), answer(0, 100), answer(1, 400)],
            [[1, 0, 0, 2], [1, 0, 0, 0]],
        );
        check(
            "two in a row without an answer, then one",
            &[(0, SYNC), (1000, SYNC), (2000, SYNC), (2100, ONE), (3000, SYNC)],
            &[apart(1000), apart(1000), apart(1000), answer(0, 100)],
            [[1, 2, 0, 0], [0, 3, 0, 0]],
        );
        check(
            "the answer of the cycle before behind the next SYNC",
            &[(0, SYNC), (100, TWO), (1000, SYNC), (1050, ONE), (1100, TWO), (1200, ONE), (2000, SYNC)],
            &[apart(1000), answer(1, 100), apart(1000), answer(0, 1050), answer(0, 200), answer(1, 100)],
            [[2, 0, 1, 0], [2, 0, 0, 0]],
        );
        check(
            "a second answer is nobody's once the debt was a cycle ago",
            &[(0, SYNC), (1000, SYNC), (1100, ONE), (2000, SYNC), (2100, ONE), (2200, ONE), (3000, SYNC)],
            &[apart(1000), apart(1000), answer(0, 100), apart(1000), answer(0, 100)],
            [[2, 1, 0, 1], [0, 3, 0, 0]],
        );
    }

    #[test]
    fn frames_of_others_are_passed_over() {
        let mut frames = vec![(0, SYNC), (100, ONE), (110, TWO)];
        frames.extend([(120, "183#00"), (130, "281#00"), (140, "080#0102"), (150, "701#05")]);
        frames.push((1000, SYNC));
        check("others", &frames, &[apart(1000), answer(0, 100), answer(1, 110)], [[1, 0, 0, 0]; 2]);
        let remote = Frame::remote(StandardId::new(0x181).unwrap(), 8).unwrap();
        let mut timing = WireTiming::new([StandardId::new(0x181).unwrap()]);
        for (micros, frame) in [(0, parse(SYNC)), (1, remote), (2, parse(SYNC))] {
            timing.observe(Instant::from_nanos(micros), &frame, |_| {});
        }
        let asked = timing.counts().next().unwrap();
        assert_eq!((asked.answered, asked.unanswered), (0, 1));
    }
}
