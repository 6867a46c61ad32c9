//! Asking many nodes at once, each one question after the other.

use std::time::Duration;

use can::{Frame, Instant};
use canopen::{NodeId, Object};
use master::sdo::{self, SdoError};

use super::talk::Conversation;

/// Nodes that are asked at the same time: their answers keep a bus of 1 Mbit/s busy for 9 ms.
const AT_ONCE: usize = 64;

/// How often a question is put again to a node that does not answer.
const RETRIES: u8 = 1;

/// What one node is asked, where the next question may hang on the answers before.
pub(super) trait Questions {
    /// The next object to read; `None` once all is known.
    fn next(&self) -> Option<Object>;

    /// Takes the answer to it. A node that does not answer times out.
    fn answer(&mut self, answer: Result<&[u8], SdoError>);
}

/// Many nodes and what each of them is asked.
pub(super) struct Survey<Q> {
    nodes: Vec<Asked<Q>>,
}

struct Asked<Q> {
    client: sdo::Client,
    questions: Q,
    asking: bool,
}

impl<Q: Questions> Survey<Q> {
    /// Asks `nodes`, each of which has `timeout` for every answer.
    pub(super) fn new(nodes: impl Iterator<Item = (NodeId, Q)>, timeout: Duration) -> Self {
        let asked = |(node, questions)| Asked {
            client: sdo::Client::new(node, timeout, RETRIES),
            questions,
            asking: false,
        };
        Self {
            nodes: nodes.map(asked).collect(),
        }
    }

    /// What became of the questions, node by node.
    pub(super) fn into_answers(self) -> impl Iterator<Item = (NodeId, Q)> {
        self.nodes
            .into_iter()
            .map(|asked| (asked.client.node(), asked.questions))
    }

    /// What is known of the nodes so far.
    pub(super) fn questions(&mut self) -> impl Iterator<Item = (NodeId, &mut Q)> {
        self.nodes
            .iter_mut()
            .map(|asked| (asked.client.node(), &mut asked.questions))
    }

    /// The same, to look at only.
    pub(super) fn nodes_seen(&self) -> impl Iterator<Item = &Q> {
        self.nodes.iter().map(|asked| &asked.questions)
    }

    fn ask_next(&mut self, now: Instant) {
        let free = AT_ONCE - self.nodes.iter().filter(|asked| asked.asking).count();
        let idle = self.nodes.iter_mut().filter(|asked| !asked.asking);
        for asked in idle
            .filter(|asked| asked.questions.next().is_some())
            .take(free)
        {
            asked.ask(now);
        }
    }
}

impl<Q: Questions> Asked<Q> {
    fn ask(&mut self, now: Instant) {
        if let Some(object) = self.questions.next() {
            let started = self.client.upload(object, now);
            started.expect("the result of the transfer before was taken");
            self.asking = true;
        }
    }

    /// Takes a result, and asks on at once: one node after the other is done with, none is half asked for long.
    fn take_result(&mut self, now: Instant) {
        let Some(result) = self.client.poll() else {
            return;
        };
        self.questions.answer(result.map(|transfer| transfer.data));
        self.asking = false;
        self.ask(now);
    }
}

impl<Q: Questions> Conversation for Survey<Q> {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        for asked in &mut self.nodes {
            asked.client.handle(frame, now);
            asked.take_result(now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.nodes
            .iter_mut()
            .find_map(|asked| asked.client.poll_transmit(now))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let timeouts = self
            .nodes
            .iter()
            .filter_map(|asked| asked.client.poll_timeout());
        timeouts.min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        for asked in &mut self.nodes {
            asked.client.handle_timeout(now);
            asked.take_result(now);
        }
        self.ask_next(now);
    }
}
