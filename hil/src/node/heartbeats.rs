//! The heartbeat consumer: monitors the heartbeats of other nodes, object 0x1016.
//!
//! Monitoring by an entry begins with the first heartbeat of its node (CiA 301 §7.5.2.19). CiA 301 does not define
//! the effect of a new time for the same node. Here monitoring continues: the time counts from the last heartbeat, and
//! a lost node stays lost until its next heartbeat.

use std::time::Duration;

use can::Instant;
use canopen::NodeId;

use super::objects::Objects;

/// Number of entries of the object.
pub(crate) const ENTRIES: usize = 2;

/// The node-ID and the time of an entry; `None` for an unused entry.
pub(crate) fn watched(entry: u32) -> Option<(NodeId, Duration)> {
    let within = Duration::from_millis(u64::from(entry & 0xFFFF));
    let node = NodeId::new((entry >> 16) as u8)?;
    (!within.is_zero()).then_some((node, within))
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Consumers([Consumer; ENTRIES]);

#[derive(Clone, Copy, Debug, Default)]
struct Consumer {
    watched: Option<(NodeId, Duration)>,
    /// Time of the node's last heartbeat.
    heard: Option<Instant>,
    lost: bool,
}

impl Consumers {
    /// Applies the object. Returns the entries whose node was lost and is no longer monitored.
    pub(crate) fn read(&mut self, objects: &Objects) -> [bool; ENTRIES] {
        std::array::from_fn(|number| {
            let consumer = &mut self.0[number];
            let watched = watched(objects.consumer(number));
            let same = |node: Option<(NodeId, Duration)>| node.map(|(node, _)| node);
            if same(consumer.watched) == same(watched) {
                consumer.watched = watched;
                return false;
            }
            let ended = consumer.lost;
            *consumer = Consumer { watched, ..Consumer::default() };
            ended
        })
    }

    /// Takes a heartbeat. Returns the entry of a node that was lost until now.
    pub(crate) fn hear(&mut self, node: NodeId, now: Instant) -> Option<usize> {
        let watches = |consumer: &Consumer| consumer.watched.is_some_and(|(of, _)| of == node);
        let number = self.0.iter().position(watches)?;
        let consumer = &mut self.0[number];
        consumer.heard = Some(now);
        std::mem::take(&mut consumer.lost).then_some(number)
    }

    /// Returns an entry whose node is lost from now on. Called until the result is `None`.
    pub(crate) fn expire(&mut self, now: Instant) -> Option<usize> {
        let overdue = |consumer: &Consumer| consumer.deadline().is_some_and(|at| at <= now);
        let number = self.0.iter().position(overdue)?;
        self.0[number].lost = true;
        Some(number)
    }

    pub(crate) fn lost(&self, number: usize) -> bool {
        self.0[number].lost
    }

    /// Time at which the next node counts as lost.
    pub(crate) fn poll_timeout(&self) -> Option<Instant> {
        self.0.iter().filter_map(Consumer::deadline).min()
    }
}

impl Consumer {
    fn deadline(&self) -> Option<Instant> {
        let (_, within) = self.watched.filter(|_| !self.lost)?;
        Some(self.heard? + within)
    }
}
