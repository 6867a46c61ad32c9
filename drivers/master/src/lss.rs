//! LSS master (CiA 305).

use std::fmt;
use std::time::Duration;

use can::{Frame, Instant};
use thiserror::Error;

use canopen::NodeId;
use canopen::lss::{Identity, Mode, Outcome, Part, Request, Response, UNCONFIGURED};
use scan::{Next, Scan};

mod scan;

/// Greatest number of answers to one inquiry, until two in a row agree.
const MOST_ANSWERS: u32 = 4;

/// Gives nodes their node-IDs, one service at a time.
///
/// The deadline of each answer is `timeout` after its request. No request is repeated; a service that timed out may be
/// started again. Answers to other requests are ignored.
///
/// The answers have no numbers, so that a late answer to an earlier request may look like the answer to the present
/// request. Each inquiry is therefore repeated until two answers in a row agree. A fastscan waits for late answers
/// wherever a late answer would give a wrong identity or hide a slave.
///
/// A node without a node-ID gets one in four steps. [`Service::Fastscan`] finds the node and puts it into configuration
/// mode. [`Service::ConfigureNodeId`] and [`Service::Store`] follow. After a switch to [`Mode::Waiting`] the node boots
/// with its node-ID. All slaves in configuration mode obey at the same time: only one slave may be in this mode.
#[derive(Clone, Debug, Default)]
pub struct Master {
    state: ServiceState,
    timeout: Duration,
    request: Option<Request>,
    started: Instant,
    deadline: Instant,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ServiceState {
    #[default]
    Idle,
    Busy(Progress),
    Finished(Result<Answer, LssError>),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Progress {
    service: Service,
    /// Of `InquireIdentity`, the number asked for; of `SwitchSelective`, the number sent last.
    part: Part,
    /// Of `InquireIdentity`, the numbers answered before `part`.
    identity: Identity,
    /// For inquiries: the last answer to the present request, and the number of its answers.
    last: Option<Response>,
    answers: u32,
    /// Of fastscans, the question asked.
    scan: Scan,
    /// For fastscans: whether the scan waits for late answers, after a question that was not answered in time.
    listening: bool,
    /// Of `IdentifyUnconfigured`, whether the first question of a fastscan was asked as well.
    scanning: bool,
    /// Whether any slave answered a question to all slaves.
    heard: bool,
}

/// A service of the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    /// Put all slaves into a mode. Not answered: done when it is sent.
    SwitchGlobal(Mode),
    /// Put the one slave of this identity into configuration mode.
    SwitchSelective(Identity),
    /// Give the slave in configuration mode a node-ID; none takes it away.
    ConfigureNodeId(Option<NodeId>),
    /// Have the slave in configuration mode keep its node-ID over power-off. May take it a second.
    Store,
    /// Ask the slave in configuration mode who it is.
    InquireIdentity,
    /// Ask it for its node-ID.
    InquireNodeId,
    /// Ask whether any slave has no node-ID. Takes `timeout`, and as long again if none answers: slaves that know only
    /// fastscan answer its first question.
    IdentifyUnconfigured,
    /// Find the identity of a slave without a node-ID, the smallest if there are several, and put that slave into
    /// configuration mode. The service takes up to 139 times `timeout`: slaves with the same answer may answer at
    /// different times, and only silence means no. `timeout` may be as short as the answer time of the slowest slave,
    /// about 10 ms.
    ///
    /// Slaves in configuration mode should be silent. One that answers every question, as CANopenNode's does, fails the
    /// scan with [`LssError::Untrue`]; [`Service::FastscanAbove`] avoids it.
    Fastscan,
    /// Find the smallest identity above this one in the same way. If all slaves are in [`Mode::Waiting`], the slaves
    /// found before are passed over. The service takes up to 280 times `timeout`.
    FastscanAbove(Identity),
}

/// Result of a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// It is done.
    Done,
    /// To [`Service::InquireIdentity`].
    Identity(Identity),
    /// To [`Service::InquireNodeId`]; `None` if the slave has none.
    NodeId(Option<NodeId>),
    /// To [`Service::IdentifyUnconfigured`]: whether there is any.
    Unconfigured(bool),
    /// To [`Service::Fastscan`] and [`Service::FastscanAbove`]; `None` if there is no such slave without a node-ID.
    Found(Option<Identity>),
}

/// Reason that a service was not started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{service} is under way, or its result was not taken")]
pub struct Busy {
    /// What is under way; what was asked for if a result waits.
    pub service: Service,
}

/// Reason that a service failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum LssError {
    #[error(
        "no slave answered {service} for {waited:?}; is the one meant on the bus, and alone in configuration mode?"
    )]
    TimedOut { service: Service, waited: Duration },
    #[error(
        "the slave refused {service}: error {}, vendor code {}",
        outcome.error,
        outcome.specific
    )]
    Refused { service: Service, outcome: Outcome },
    #[error("the slave says that its node-ID is {node_id}")]
    NodeId { node_id: u8 },
    #[error("no slave has the {part} {number:#010x} that the scan found; try a longer time-out")]
    Vanished { part: Part, number: u32 },
    #[error(
        "the answers to {service} differ each time: put one slave alone into configuration mode, or try a longer time-out"
    )]
    Disagree { service: Service },
    #[error("a slave answered a question of the fastscan after the time-out; try a longer time-out")]
    Late,
    #[error(
        "a slave answers every question of a fastscan, so that no other slave can be found: take it off the bus, or give it a node-ID"
    )]
    Untrue,
}

impl fmt::Display for Service {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SwitchGlobal(_) => "switch mode global",
            Self::SwitchSelective(_) => "switch mode selective",
            Self::ConfigureNodeId(_) => "configure node-ID",
            Self::Store => "store configuration",
            Self::InquireIdentity => "inquire identity",
            Self::InquireNodeId => "inquire node-ID",
            Self::IdentifyUnconfigured => "identify non-configured",
            Self::Fastscan | Self::FastscanAbove(_) => "fastscan",
        })
    }
}

impl Master {
    /// Starts a service.
    pub fn start(&mut self, service: Service, timeout: Duration, now: Instant) -> Result<(), Busy> {
        match self.state {
            ServiceState::Idle => {}
            ServiceState::Busy(Progress { service, .. }) => return Err(Busy { service }),
            ServiceState::Finished(_) => return Err(Busy { service }),
        }
        let scan = match service {
            Service::FastscanAbove(identity) => Scan::above(identity),
            _ => Scan::new(),
        };
        self.state = ServiceState::Busy(Progress {
            service,
            part: Part::Vendor,
            identity: Identity::default(),
            last: None,
            answers: 0,
            scan,
            listening: false,
            scanning: false,
            heard: false,
        });
        self.timeout = timeout;
        self.started = now;
        let request = match service {
            Service::SwitchGlobal(mode) => Request::SwitchGlobal(mode),
            Service::SwitchSelective(identity) => select(identity, Part::Vendor),
            Service::ConfigureNodeId(node) => {
                Request::ConfigureNodeId { node_id: node.map_or(UNCONFIGURED, NodeId::raw) }
            }
            Service::Store => Request::Store,
            Service::InquireIdentity => Request::Inquire(Part::Vendor),
            Service::InquireNodeId => Request::InquireNodeId,
            Service::IdentifyUnconfigured => Request::IdentifyUnconfigured,
            Service::Fastscan | Service::FastscanAbove(_) => Request::Fastscan(scan.question()),
        };
        self.ask(request, now);
        Ok(())
    }

    /// Takes a frame from the bus.
    pub fn handle(&mut self, frame: &Frame, now: Instant) {
        let (Some(response), None) = (Response::decode(frame), self.request) else {
            return;
        };
        let ServiceState::Busy(progress) = &mut self.state else {
            return;
        };
        let service = progress.service;
        if let Some(request) = progress.asked_again(&response) {
            return match request {
                Ok(request) => self.ask(request, now),
                Err(error) => self.state = ServiceState::Finished(Err(error)),
            };
        }
        let result = match (service, response) {
            (Service::SwitchSelective(_), Response::Selected) => Ok(Answer::Done),
            (Service::ConfigureNodeId(_), Response::NodeIdConfigured(outcome))
            | (Service::Store, Response::Stored(outcome)) => {
                if outcome.error == Outcome::SUCCESS {
                    Ok(Answer::Done)
                } else {
                    Err(LssError::Refused { service, outcome })
                }
            }
            (Service::InquireIdentity, Response::Inquired { part: told, value }) if told == progress.part => {
                *progress.identity.get_mut(told) = value;
                if let Some(next) = told.next() {
                    progress.part = next;
                    (progress.last, progress.answers) = (None, 0);
                    return self.ask(Request::Inquire(next), now);
                }
                Ok(Answer::Identity(progress.identity))
            }
            (Service::InquireNodeId, Response::NodeId { node_id }) => match (node_id, NodeId::new(node_id)) {
                (UNCONFIGURED, _) => Ok(Answer::NodeId(None)),
                (_, Some(node)) => Ok(Answer::NodeId(Some(node))),
                (_, None) => Err(LssError::NodeId { node_id }),
            },
            (Service::IdentifyUnconfigured, Response::Unconfigured)
            | (Service::IdentifyUnconfigured | Service::Fastscan | Service::FastscanAbove(_), Response::Identified) => {
                progress.heard = true;
                return;
            }
            _ => return,
        };
        self.state = ServiceState::Finished(result);
    }

    /// The next frame to send, if any.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        let request = self.request.take()?;
        self.deadline = now + self.timeout;
        if let ServiceState::Busy(progress) = &mut self.state {
            match progress.service {
                Service::SwitchGlobal(_) => self.state = ServiceState::Finished(Ok(Answer::Done)),
                Service::SwitchSelective(identity) => {
                    if let Some(next) = progress.part.next() {
                        progress.part = next;
                        self.request = Some(select(identity, next));
                    }
                }
                _ => {}
            }
        }
        Some(request.encode())
    }

    /// When an answer is due, or the time is over that all have to answer.
    pub fn poll_timeout(&self) -> Option<Instant> {
        matches!(self.state, ServiceState::Busy(_)).then_some(self.deadline)
    }

    /// Goes on or gives up if it is time at `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        let ServiceState::Busy(progress) = &mut self.state else {
            return;
        };
        if now < self.deadline {
            return;
        }
        let (service, sent) = (progress.service, self.request.is_none());
        let result = match service {
            Service::IdentifyUnconfigured if sent && !progress.heard && !progress.scanning => {
                progress.scanning = true;
                let question = progress.scan.question();
                return self.ask(Request::Fastscan(question), now);
            }
            Service::IdentifyUnconfigured if sent => Ok(Answer::Unconfigured(progress.heard)),
            Service::Fastscan | Service::FastscanAbove(_) if sent && progress.listening && progress.heard => {
                Err(LssError::Late)
            }
            Service::Fastscan | Service::FastscanAbove(_)
                if sent && !progress.listening && !progress.heard && progress.scan.is_misled_by_late_answers() =>
            {
                progress.listening = true;
                self.deadline = now + self.timeout;
                return;
            }
            Service::Fastscan | Service::FastscanAbove(_) if sent => {
                progress.listening = false;
                match progress.scan.answered(std::mem::take(&mut progress.heard)) {
                    Next::Ask(question) => return self.ask(Request::Fastscan(question), now),
                    Next::Found(identity) => Ok(Answer::Found(identity)),
                    Next::Vanished { part, number } => Err(LssError::Vanished { part, number }),
                    Next::Untrue => Err(LssError::Untrue),
                }
            }
            _ => Err(LssError::TimedOut { service, waited: now.since(self.started) }),
        };
        self.request = None;
        self.state = ServiceState::Finished(result);
    }

    /// What came of the service, once; then the next may be started.
    pub fn poll(&mut self) -> Option<Result<Answer, LssError>> {
        let ServiceState::Finished(result) = self.state else {
            return None;
        };
        self.state = ServiceState::Idle;
        Some(result)
    }

    fn ask(&mut self, request: Request, now: Instant) {
        self.request = Some(request);
        self.deadline = now + self.timeout;
    }
}

impl Progress {
    /// The request of an inquiry that is repeated after this answer. `None` for an answer that agrees with the last
    /// answer, or that belongs to another inquiry.
    fn asked_again(&mut self, response: &Response) -> Option<Result<Request, LssError>> {
        let request = match (self.service, response) {
            (Service::InquireIdentity, Response::Inquired { part, .. }) if *part == self.part => {
                Request::Inquire(*part)
            }
            (Service::InquireNodeId, Response::NodeId { .. }) => Request::InquireNodeId,
            _ => return None,
        };
        self.answers += 1;
        if self.last.replace(*response) == Some(*response) {
            return None;
        }
        let service = self.service;
        Some(if self.answers < MOST_ANSWERS { Ok(request) } else { Err(LssError::Disagree { service }) })
    }
}

fn select(identity: Identity, part: Part) -> Request {
    Request::SwitchSelective { part, value: identity.get(part) }
}

#[cfg(test)]
mod tests;
