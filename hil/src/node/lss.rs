//! The LSS slave, which assigns the node-ID of a unit.
//!
//! ```text
//!             switch global, or the fourth number of switch selective, or the end of a fastscan
//!   waiting ──────────────────────────────────────────────────────────────────────────────────► configuration
//!           ◄──────────────────────────────────────────────────────────────────────────────────
//!             switch global, or any reset
//! ```
//!
//! A configured node-ID is pending until the communication is reset. A unit without a node-ID takes the pending
//! node-ID on its way back to waiting (CiA 305). A stored node-ID outlives a reset of the node. The table of bit
//! rates is EPOS4's: 20 kbit/s to 1 Mbit/s, 10 kbit/s refused. A configured bit rate is answered with success but not
//! stored. Activating the bit rate has no effect: the unit stays at the bit rate of the bus.

use canopen::NodeId;
use canopen::lss::{BitRate, Bound, CIA_TABLE, FASTSCAN_RESET, Fastscan, Mode, Outcome, Part, Response, UNCONFIGURED};
pub(crate) use canopen::lss::{Identity, Request};

/// State of the slave, without the node-ID in use.
#[derive(Clone, Debug)]
pub(crate) struct Lss {
    identity: Identity,
    mode: Mode,
    /// The node-ID after the next reset of the communication.
    pub(crate) pending: Option<NodeId>,
    /// The node-ID after the next reset of the node.
    stored: Option<NodeId>,
    /// Number of matching identity numbers in the present switch selective, in their order.
    selected: u8,
    /// Number of matching bounds in the present identify, in their order.
    identified: u8,
    /// Identity number that the fastscan examines.
    scanned: u8,
    /// Whether a unit without a node-ID was assigned a node-ID and has gone back to waiting. The unit must then start
    /// with the pending node-ID.
    pub(crate) given: bool,
}

impl Lss {
    pub(crate) fn new(node: Option<NodeId>, identity: Identity) -> Self {
        Self {
            identity,
            mode: Mode::Waiting,
            pending: node,
            stored: node,
            selected: 0,
            identified: 0,
            scanned: 0,
            given: false,
        }
    }

    /// Handles a reset of the communication.
    pub(crate) fn wait(&mut self) {
        *self = Self { pending: self.pending, stored: self.stored, ..Self::new(None, self.identity) };
    }

    /// Handles a reset of the node: unstored settings are lost.
    pub(crate) fn restart(&mut self) {
        self.pending = self.stored;
    }

    /// Handles a request, and returns the answer of this unit, if any. `active` is the unit's node-ID in use.
    pub(crate) fn handle(&mut self, request: Request, active: Option<NodeId>) -> Option<Response> {
        let configures = self.mode == Mode::Configuration;
        match request {
            Request::SwitchGlobal(mode) => {
                self.given = configures && mode == Mode::Waiting && self.pending.is_some();
                self.mode = mode;
                self.selected = 0;
                None
            }
            Request::SwitchSelective { part, value } if !configures => {
                let agrees = self.identity.get(part) == value;
                self.selected = in_order(self.selected, part.index(), agrees);
                (self.selected == Part::ALL.len() as u8).then(|| {
                    self.mode = Mode::Configuration;
                    self.selected = 0;
                    Response::Selected
                })
            }
            Request::Identify { bound, value } => {
                let own = &self.identity;
                let holds = match bound {
                    Bound::Vendor => own.vendor == value,
                    Bound::Product => own.product == value,
                    Bound::RevisionLow => own.revision >= value,
                    Bound::RevisionHigh => own.revision <= value,
                    Bound::SerialLow => own.serial >= value,
                    Bound::SerialHigh => own.serial <= value,
                };
                self.identified = in_order(self.identified, bound as u8, holds);
                (self.identified == Bound::ALL.len() as u8).then_some(Response::Identified)
            }
            Request::IdentifyUnconfigured => {
                (active.is_none() && self.pending.is_none()).then_some(Response::Unconfigured)
            }
            Request::Fastscan(question) => {
                let asked = !configures && active.is_none() && self.pending.is_none();
                (asked && self.scan(question)).then_some(Response::Identified)
            }
            Request::ConfigureNodeId { node_id } if configures => {
                let node = NodeId::new(node_id);
                let known = node.is_some() || node_id == UNCONFIGURED;
                if known {
                    self.pending = node;
                }
                Some(Response::NodeIdConfigured(outcome(known)))
            }
            Request::ConfigureBitTiming { table, index } if configures => {
                let rate = BitRate::from_index(index).filter(|_| table == CIA_TABLE);
                let known = rate.is_some_and(|rate| rate != BitRate::Kbps(10));
                Some(Response::BitTimingConfigured(outcome(known)))
            }
            Request::Store if configures => {
                self.stored = self.pending;
                Some(Response::Stored(outcome(true)))
            }
            Request::Inquire(part) if configures => Some(Response::Inquired { part, value: self.identity.get(part) }),
            Request::InquireNodeId if configures => {
                Some(Response::NodeId { node_id: active.map_or(UNCONFIGURED, NodeId::raw) })
            }
            Request::SwitchSelective { .. }
            | Request::ConfigureNodeId { .. }
            | Request::ConfigureBitTiming { .. }
            | Request::ActivateBitTiming { .. }
            | Request::Store
            | Request::Inquire(_)
            | Request::InquireNodeId => None,
        }
    }

    /// Whether the unit still matches the fastscan.
    fn scan(&mut self, asked: Fastscan) -> bool {
        let Fastscan { bit, sub, next, .. } = asked;
        if bit == FASTSCAN_RESET {
            self.scanned = 0;
            return true;
        }
        let part = Part::ALL.get(usize::from(sub)).copied();
        let Some(part) = part.filter(|_| sub == self.scanned && bit < 32) else {
            return false;
        };
        let agrees = (self.identity.get(part) ^ asked.number) >> bit == 0;
        if agrees && bit == 0 {
            if next < sub {
                self.mode = Mode::Configuration;
            }
            self.scanned = next;
        }
        agrees
    }
}

/// Number of steps completed in order after step `step`. `taken` is the number before that step.
fn in_order(taken: u8, step: u8, succeeds: bool) -> u8 {
    if succeeds && (step == taken || step == 0) { step + 1 } else { 0 }
}

fn outcome(success: bool) -> Outcome {
    let error = if success { Outcome::SUCCESS } else { Outcome::OUT_OF_RANGE };
    Outcome { error, specific: 0 }
}
