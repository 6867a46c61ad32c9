//! Sequences of SDO requests to many nodes in parallel.

use std::collections::BTreeMap;
use std::time::Duration;

use can::{Frame, Instant};
use canopen::{NodeId, Object};
use master::sdo::{self, SdoCause};

use super::talk::Conversation;

/// Number of nodes that are queried at the same time. Their answers occupy a bus of 1 Mbit/s for 9 ms.
const AT_ONCE: usize = 64;

/// Number of repetitions of a request to a node that does not answer.
const RETRIES: u8 = 1;

/// Requests to one node. The next request may depend on earlier answers.
pub(super) trait Questions {
    /// The next object to read; `None` after the last.
    fn next(&self) -> Option<Object>;

    /// Processes the answer to the last request. A node that does not answer yields a time-out.
    fn answer(&mut self, answer: Result<&[u8], SdoCause>);
}

/// Many nodes and the requests to each of them.
pub(super) struct Survey<Q> {
    pub(super) nodes: BTreeMap<NodeId, Asked<Q>>,
}

pub(super) struct Asked<Q> {
    client: sdo::Client,
    /// Present knowledge about the node.
    pub(super) questions: Q,
    asking: bool,
}

impl<Q: Questions> Survey<Q> {
    /// Queries `nodes`. Each node has `timeout` for every answer.
    pub(super) fn new(nodes: impl Iterator<Item = (NodeId, Q)>, timeout: Duration) -> Self {
        let client = |node| sdo::Client::new(node, timeout, RETRIES);
        let asked = |(node, questions)| (node, Asked { client: client(node), questions, asking: false });
        Self { nodes: nodes.map(asked).collect() }
    }

    /// Results of the requests, node by node.
    pub(super) fn into_answers(self) -> impl Iterator<Item = (NodeId, Q)> {
        self.nodes.into_iter().map(|(node, asked)| (node, asked.questions))
    }

    fn ask_next(&mut self, now: Instant) {
        let free = AT_ONCE - self.nodes.values().filter(|asked| asked.asking).count();
        let idle = self.nodes.values_mut().filter(|asked| !asked.asking);
        let asked = idle.filter(|asked| asked.questions.next().is_some());
        asked.take(free).for_each(|asked| asked.ask(now));
    }
}

impl<Q: Questions> Asked<Q> {
    fn ask(&mut self, now: Instant) {
        if let Some(object) = self.questions.next() {
            self.client.upload(object, now).expect("the result of the transfer before was taken");
            self.asking = true;
        }
    }

    /// Processes a result and makes the next request to the same node at once. Nodes are thus completed one after the
    /// other.
    fn take_result(&mut self, now: Instant) {
        let Some(result) = self.client.poll() else {
            return;
        };
        let answer = result.map(|transfer| transfer.data);
        self.questions.answer(answer.map_err(|error| error.cause));
        self.asking = false;
        self.ask(now);
    }
}

impl<Q: Questions> Conversation for Survey<Q> {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        for asked in self.nodes.values_mut() {
            asked.client.handle(frame, now);
            asked.take_result(now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.nodes.values_mut().find_map(|asked| asked.client.poll_transmit(now))
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.nodes.values().filter_map(|asked| asked.client.poll_timeout()).min()
    }

    fn handle_timeout(&mut self, now: Instant) {
        for asked in self.nodes.values_mut() {
            asked.client.handle_timeout(now);
            asked.take_result(now);
        }
        self.ask_next(now);
    }
}
