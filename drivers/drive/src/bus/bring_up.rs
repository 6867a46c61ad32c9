//! Bring-up of one node: a CiA 402 drive, a CiA 401 I/O node or a force/torque sensor.

use std::time::Duration;

use can::Instant;
use canopen::cia402::{ModeOfOperation, PowerState, Statusword, SupportedModes};
use canopen::objects::{DEVICE_TYPE, MODE_OF_OPERATION_DISPLAY};
use canopen::sdo::{AbortCode, Write};
use canopen::{NodeId, Object, cia401, nmt, number};
use master::sdo::{Client, SdoCause, SdoError, Transfer};

use super::step::{Need, Step};
use crate::cia402::{GroupConfig, Purpose, Setting, is_timer};
use crate::wrench::WrenchError;
use crate::{BringUpError, Increments, WarningCause};

/// Greatest number of boots of a node in one bring-up. A node that boots again has failed to boot.
const BOOTS: u8 = 3;

/// Device profile of a node, in the low half of object 0x1000 (CiA 301 §7.5.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Profile {
    /// CiA 402.
    Drive,
    /// CiA 401.
    Io,
    /// A force/torque sensor, which has no common profile: the expected content of object 0x1000.
    Wrench(Option<u32>),
}

impl Profile {
    fn check(self, node: u8, device_type: u32) -> Result<(), BringUpError> {
        match (self, device_type as u16) {
            (Self::Drive, 402) | (Self::Io, cia401::PROFILE) | (Self::Wrench(None), _) => Ok(()),
            (Self::Drive, _) => Err(BringUpError::NotADrive { node, device_type }),
            (Self::Io, _) => Err(BringUpError::NotAnIoNode { node, device_type }),
            (Self::Wrench(Some(expected)), _) if expected == device_type => Ok(()),
            (Self::Wrench(Some(expected)), _) => {
                let error = WrenchError::OfAnotherType { expected, found: device_type };
                Err(BringUpError::WrenchNode { node, error })
            }
        }
    }

    /// The node neither booted nor answered.
    fn absent(self, node: u8, waited: Duration) -> BringUpError {
        match self {
            Self::Drive | Self::Io => BringUpError::NeverBooted { node, waited },
            Self::Wrench(_) => {
                BringUpError::WrenchNode { node, error: WrenchError::Absent { waited, address: "node-ID" } }
            }
        }
    }
}

/// What bring-up learnt about a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Learnt {
    pub(crate) statusword: Statusword,
    pub(crate) position: Increments,
    /// Object 0x603F.
    pub(crate) error_code: u16,
    /// Object 0x60FD, of a drive with a contact of the emergency stop.
    pub(crate) inputs: u32,
    /// Mode of operation that the drive reported unasked since its start.
    pub(crate) mode_shown: Option<ModeOfOperation>,
    /// Software position limits of the drive that lie within the positions of the cell.
    pub(crate) software_limits: Option<WarningCause>,
    /// Whether the drive lacks object 0x1029:01.
    pub(crate) lacks_error_behaviour: bool,
    /// Comparison of the settings of [`Purpose::Compare`].
    pub(crate) comparison: Comparison,
}

impl Learnt {
    /// Warnings of values in the drive that differ from the cell or from the device configuration file.
    pub(crate) fn warnings(&self) -> impl Iterator<Item = WarningCause> + use<> {
        let Comparison { values, different, first } = self.comparison;
        let compared = first.map(|first| WarningCause::Compared { values, different, first });
        let unknown = self.lacks_error_behaviour.then_some(WarningCause::NoErrorBehaviour);
        compared.into_iter().chain(self.software_limits).chain(unknown)
    }
}

/// Comparison of values that can only be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Comparison {
    /// Number of compared values.
    pub(crate) values: u32,
    /// Number of values that differ, or that cannot be read from the drive.
    pub(crate) different: u32,
    /// The first object that differs.
    pub(crate) first: Option<Object>,
}

/// Brings one node from any state to configured, and then to operational.
///
/// ```text
///          boot-up, or 0x1000 answered        last step            all nodes are        heartbeat 0x05
///   Booting ───────────────► Configuring ─────────────► Configured ─────────► Starting ────────► Operational
///      ▲                          │ boot-up                  │
///      └◄─────────────────────────┴──────────────────────────┘
/// ```
#[derive(Clone, Debug)]
pub(crate) struct NodeBringUp {
    node: NodeId,
    profile: Profile,
    group: GroupConfig,
    program: Vec<Step>,
    configuration: Vec<Setting>,
    phase: Phase,
    boots: u8,
    pub(crate) learnt: Learnt,
    /// Value of the last agreement's object, kept while its divisor is read.
    value: Option<u32>,
    /// Whether the drive has the object of the last agreement, or its last limit suffices.
    agreed: bool,
    /// Whether the drive cannot send its mode of operation by itself.
    unwatched: bool,
    /// The node is not configured: what bring-up wrote is read back.
    verifies: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// The node was sent the reset at `since`. Its boot-up message or an answer to object 0x1000 is awaited.
    Booting {
        since: Instant,
        booted: bool,
        asked: bool,
    },
    Configuring(Progress),
    Configured,
    /// The node was sent the NMT start at `since`. A node that booted afterwards has lost its configuration, in
    /// whatever state it is.
    Starting {
        since: Instant,
        booted: bool,
    },
    Operational,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Progress {
    step: usize,
    reading_back: bool,
    /// Whether the value of a setting was read that need not be written, and the drive holds another value.
    questioned: bool,
    /// The request of this step is under way.
    asked: bool,
    /// Begin of this step.
    since: Instant,
}

impl Progress {
    fn at(step: usize, now: Instant) -> Self {
        Self { step, reading_back: false, questioned: false, asked: false, since: now }
    }
}

impl NodeBringUp {
    /// `configuration` holds the settings of [`Step::Configure`].
    pub(crate) fn new(
        group: &GroupConfig,
        node: NodeId,
        profile: Profile,
        program: Vec<Step>,
        configuration: Vec<Setting>,
    ) -> Self {
        Self {
            node,
            profile,
            group: *group,
            program,
            configuration,
            phase: Phase::Operational,
            boots: 0,
            learnt: Learnt::default(),
            value: None,
            agreed: false,
            unwatched: false,
            verifies: false,
        }
    }

    pub(crate) fn node(&self) -> NodeId {
        self.node
    }

    /// Restarts bring-up. The caller sends the reset.
    pub(crate) fn reset(&mut self, now: Instant) {
        self.phase = Phase::Booting { since: now, booted: false, asked: false };
        self.boots = 0;
        self.learnt = Learnt::default();
        self.verifies = false;
    }

    /// Begins to read back the configuration of a node that left the state operational and has not booted. A difference is an
    /// error. The torque is removed first.
    pub(crate) fn verify(&mut self, now: Instant) {
        self.phase = Phase::Configuring(Progress::at(0, now));
        self.boots = 0;
        self.learnt = Learnt::default();
        self.verifies = true;
    }

    /// Whether the configuration is read back. A boot ends this: the node is then configured.
    pub(crate) fn verifies(&self) -> bool {
        self.verifies
    }

    /// Starts the change to operational. The caller sends the command.
    pub(crate) fn start(&mut self, now: Instant) {
        self.phase = Phase::Starting { since: now, booted: false };
    }

    pub(crate) fn configured(&self) -> bool {
        self.phase == Phase::Configured
    }

    pub(crate) fn operational(&self) -> bool {
        self.phase == Phase::Operational
    }

    /// Takes the mode of operation that the drive reported unasked. A drive reports none before its start.
    pub(crate) fn shows(&mut self, mode: ModeOfOperation) {
        if matches!(self.phase, Phase::Starting { .. } | Phase::Operational) {
            self.learnt.mode_shown = Some(mode);
        }
    }

    /// Takes a heartbeat or boot-up message. A boot-up resets the client `sdo`.
    pub(crate) fn heard(&mut self, state: nmt::NmtState, sdo: &mut Client, now: Instant) {
        match (self.phase, state) {
            (Phase::Starting { since, .. }, nmt::NmtState::Initialising) => {
                self.phase = Phase::Starting { since, booted: true };
            }
            (Phase::Starting { booted: false, .. }, nmt::NmtState::Operational) => self.phase = Phase::Operational,
            // A node that left operational may have lost its configuration. The boot time-out ends the start.
            (Phase::Operational, state) if state != nmt::NmtState::Operational => {
                self.phase = Phase::Starting { since: now, booted: state == nmt::NmtState::Initialising };
            }
            (Phase::Booting { .. } | Phase::Configuring(_) | Phase::Configured, nmt::NmtState::Initialising) => {
                sdo.reset();
                self.verifies = false;
                let since = if let Phase::Booting { since, .. } = self.phase {
                    since
                } else {
                    self.boots += 1;
                    now
                };
                self.phase = Phase::Booting { since, booted: true, asked: false };
            }
            _ => {}
        }
    }

    pub(crate) fn client(&self) -> Client {
        Client::new(self.node, self.group.sdo_timeout, self.group.sdo_retries)
    }

    /// Time-out for the change to operational. The heartbeat that shows this state may be a period away.
    pub(crate) fn start_timeout(&self) -> Duration {
        self.group.boot_timeout + self.group.heartbeat_period
    }

    /// Advances bring-up: takes the answer to the last request and makes the next request.
    pub(crate) fn advance(&mut self, sdo: &mut Client, now: Instant) -> Result<(), BringUpError> {
        let node = self.node.raw();
        sdo.handle_timeout(now);
        match self.phase {
            Phase::Booting { since, booted, ref mut asked } => {
                let waited = now.since(since);
                if waited > self.group.boot_timeout || self.boots > BOOTS {
                    return Err(self.profile.absent(node, waited));
                }
                if let Some(result) = sdo.poll() {
                    match result.and_then(|transfer| transfer.number::<u32>()) {
                        Ok(device_type) => {
                            self.profile.check(node, device_type)?;
                            self.unwatched = false;
                            self.learnt.comparison = Comparison::default();
                            self.phase = Phase::Configuring(Progress::at(0, now));
                            return self.advance(sdo, now);
                        }
                        // The node may still boot; the boot time-out decides.
                        Err(_) => *asked = false,
                    }
                } else if !*asked && (booted || waited >= self.group.sdo_timeout) {
                    *asked = true;
                    begin_transfer(sdo, DEVICE_TYPE, None, now);
                }
                Ok(())
            }
            Phase::Configuring(progress) => {
                let Progress { step, reading_back, asked, since, questioned } = progress;
                let Some(current) = self.program.get(step).copied() else {
                    self.phase = Phase::Configured;
                    return Ok(());
                };
                let left_out = self.agreed && current.instead()
                    || self.unwatched && matches!(current, Step::Set(_, Need::Watch))
                    || self.verifies && self.is_unverifiable(step);
                let reading_back = reading_back || self.verifies && current.persists();
                let progress = Progress { reading_back, ..progress };
                if !asked && left_out {
                    self.phase = Phase::Configuring(Progress::at(step + 1, now));
                    return self.advance(sdo, now);
                }
                if !asked {
                    match (current, reading_back) {
                        (Step::Configure(object, number), false) if self.is_written(number, questioned) => {
                            let data = &self.configuration[number].data;
                            let started = sdo.download(object, data, now);
                            started.expect("the client is idle and the length was checked");
                        }
                        (Step::Set(write, _), false) => {
                            begin_transfer(sdo, write.object, Some(write), now);
                        }
                        _ => begin_transfer(sdo, current.object(), None, now),
                    }
                    self.phase = Phase::Configuring(Progress { asked: true, ..progress });
                    return Ok(());
                }
                let Some(result) = sdo.poll() else {
                    return Ok(());
                };
                let next = match current {
                    Step::Configure(object, number) if !reading_back && !self.is_written(number, questioned) => {
                        self.question(object, number, result)?
                    }
                    _ => self.judge(current, reading_back, result, now.since(since))?,
                };
                self.phase = Phase::Configuring(match next {
                    Next::Write => Progress { questioned: true, asked: false, ..progress },
                    Next::ReadBack => Progress { reading_back: true, asked: false, ..progress },
                    Next::Again => Progress { asked: false, ..progress },
                    Next::Step => Progress::at(step + 1, now),
                });
                self.advance(sdo, now)
            }
            Phase::Starting { since, booted } => {
                let waited = now.since(since);
                if booted || waited > self.start_timeout() {
                    return Err(BringUpError::NotOperational { node, waited });
                }
                Ok(())
            }
            Phase::Configured | Phase::Operational => Ok(()),
        }
    }

    /// Whether reading back the object of a step says nothing: a later step writes the object again, or the object cannot be
    /// read.
    fn is_unverifiable(&self, step: usize) -> bool {
        if let Step::Configure(_, number) = self.program[step]
            && (!self.configuration[number].readable || self.configuration[number].purpose == Purpose::Compare)
        {
            return true;
        }
        let written = self.program[step].written();
        written.is_some() && self.program[step + 1..].iter().any(|later| later.written() == written)
    }

    /// Whether the step of a setting writes: always, or after `questioned` found another value in the drive.
    fn is_written(&self, number: usize, questioned: bool) -> bool {
        questioned || self.configuration[number].purpose == Purpose::Write
    }

    /// Takes the value of a setting that need not be written. A time-out is an error, and an abort is a difference: the
    /// write then decides.
    fn question(
        &mut self,
        object: Object,
        number: usize,
        result: Result<Transfer<'_>, SdoError>,
    ) -> Result<Next, BringUpError> {
        let setting = &self.configuration[number];
        let agrees = match result {
            Ok(transfer) => transfer.agrees_with(&setting.data),
            Err(SdoError { cause: SdoCause::Aborted { .. }, .. }) => false,
            Err(error) => return Err(error_of(self.node, error)),
        };
        if setting.purpose == Purpose::WriteIfDifferent {
            return Ok(if agrees { Next::Step } else { Next::Write });
        }
        let comparison = &mut self.learnt.comparison;
        comparison.values += 1;
        if !agrees {
            comparison.different += 1;
            comparison.first.get_or_insert(object);
        }
        Ok(Next::Step)
    }

    fn judge(
        &mut self,
        step: Step,
        reading_back: bool,
        result: Result<Transfer<'_>, SdoError>,
        waited: Duration,
    ) -> Result<Next, BringUpError> {
        let node = self.node.raw();
        let abort = match &result {
            Err(SdoError { cause: SdoCause::Aborted { code }, .. }) => Some(*code),
            _ => None,
        };
        let absent = matches!(abort, Some(AbortCode::NO_OBJECT | AbortCode::NO_SUBINDEX));
        let read_only = abort == Some(AbortCode::READ_ONLY);
        let closed = matches!(abort, Some(AbortCode::NOT_MAPPABLE | AbortCode::ACCESS));
        let unmapped = (!reading_back || self.verifies) && (absent || read_only || closed);
        match step {
            Step::Set(write, Need::Watch) if unmapped => {
                // A drive that lacks a timer can map its mode all the same.
                self.unwatched = !is_timer(write.object);
                return Ok(Next::Step);
            }
            Step::Set(write, Need::Optional) if absent => {
                self.learnt.lacks_error_behaviour |= write.object == canopen::objects::ERROR_BEHAVIOUR;
                return Ok(Next::Step);
            }
            Step::Set(_, Need::Optional) if read_only && !reading_back => {
                return Ok(Next::ReadBack);
            }
            Step::AtLeast(..) if absent => {
                self.agreed = true;
                return Ok(Next::Step);
            }
            Step::Modes(_) if absent => return Ok(Next::Step),
            Step::UpperLimit(_) if absent => {
                self.value = None;
                return Ok(Next::Step);
            }
            Step::Value(_) | Step::LowerLimit if absent => {
                self.value = None;
                return Ok(Next::Step);
            }
            Step::Agree(agreement) if absent => {
                // A dividend without a divisor is divided by one.
                let value = self.value.take();
                self.agreed = value.is_some();
                if let Some(value) = value {
                    agreement.check(node, value, 1)?;
                }
                return Ok(Next::Step);
            }
            _ => {}
        }
        let written = match step {
            _ if reading_back => None,
            Step::Set(write, _) => Some(number(write.data.data())),
            Step::Configure(_, setting) => {
                let data = &self.configuration[setting].data;
                (data.len() <= 4).then(|| number(data))
            }
            _ => None,
        };
        let transfer = result.map_err(|error| match (error.cause, written) {
            (SdoCause::Aborted { code: AbortCode(code) }, Some(written)) => {
                BringUpError::WriteRefused { node, object: error.object, written, code }
            }
            _ => error_of(self.node, error),
        })?;
        let error = |error| error_of(self.node, error);
        match step {
            Step::Identity(object, expected) => {
                let found = transfer.number().map_err(error)?;
                if found != expected {
                    let subindex = object.subindex;
                    return Err(BringUpError::WrongIdentity { node, subindex, expected, found });
                }
            }
            Step::Modes(modes) => {
                let supported = transfer.number().map_err(error)?;
                let lacking = modes.into_iter().find(|&mode| !SupportedModes(supported).contains(mode));
                if let Some(mode) = lacking {
                    return Err(BringUpError::ModeUnsupported { node, mode: mode.raw(), supported });
                }
            }
            Step::Blocks(object, needed) => {
                let found = transfer.number().map_err(error)?;
                if found < needed {
                    return Err(BringUpError::TooFewBlocks { node, object, found, needed });
                }
            }
            Step::Value(_) => self.value = Some(transfer.number().map_err(error)?),
            Step::Agree(agreement) => {
                let read = transfer.number().map_err(error)?;
                self.agreed = agreement.divisor.is_none() || self.value.is_some();
                match (agreement.divisor, self.value.take()) {
                    (None, _) => agreement.check(node, read, 1)?,
                    (Some(_), Some(value)) => agreement.check(node, value, read)?,
                    (Some(_), None) => {}
                }
            }
            Step::LowerLimit => self.value = Some(transfer.number().map_err(error)?),
            Step::UpperLimit(cell) => {
                let high = transfer.number::<i32>().map_err(error)?;
                self.learnt.software_limits = self.value.take().and_then(|low| narrower([low as i32, high], cell));
            }
            Step::AtLeast(_, least) => {
                self.agreed = transfer.number::<u32>().map_err(error)? >= least;
            }
            Step::Set(..) if !reading_back => return Ok(Next::ReadBack),
            Step::Configure(_, number) if !reading_back => {
                return Ok(if self.configuration[number].readable { Next::ReadBack } else { Next::Step });
            }
            Step::Configure(object, number) => {
                compare(self.node, object, &self.configuration[number].data, transfer)?;
            }
            Step::Set(write, _) => {
                compare(self.node, write.object, write.data.data(), transfer)?;
            }
            Step::Shown(mode) => {
                let found = transfer.number::<i8>().map_err(error)?;
                if found != mode.raw() {
                    if waited <= self.group.transition_timeout {
                        return Ok(Next::Again);
                    }
                    let [written, found] = [mode.raw(), found].map(|mode| u32::from(mode as u8));
                    return Err(BringUpError::ReadBack { node, object: MODE_OF_OPERATION_DISPLAY, written, found });
                }
            }
            Step::Statusword => {
                self.learnt.statusword = Statusword(transfer.number().map_err(error)?);
            }
            Step::Inputs => self.learnt.inputs = transfer.number().map_err(error)?,
            Step::Position => {
                self.learnt.position = Increments(transfer.number().map_err(error)?);
            }
            Step::ErrorCode => {
                let code = transfer.number().map_err(error)?;
                if self.learnt.statusword.power_state() == PowerState::Fault {
                    self.learnt.error_code = code;
                }
            }
        }
        Ok(Next::Step)
    }
}

/// The warning of software limits that stop a motor within the positions of the cell. A drive whose lower limit is not
/// below its upper limit has no software limits.
fn narrower([low, high]: [i32; 2], cell: [Increments; 2]) -> Option<WarningCause> {
    let [Increments(least), Increments(most)] = cell;
    let narrows = low < high && (least < low || most > high);
    narrows.then_some(WarningCause::SoftwareLimits { low, high, least, most })
}

/// Checks that the node holds the written value.
fn compare(node: NodeId, object: Object, wrote: &[u8], read: Transfer) -> Result<(), BringUpError> {
    let found = read.data;
    let node = node.raw();
    let number_like = (1..=4).contains(&wrote.len()) && found.len() <= 4;
    if read.agrees_with(wrote) {
        Ok(())
    } else if number_like {
        let (written, found) = (number(wrote), number(found));
        Err(BringUpError::ReadBack { node, object, written, found })
    } else {
        let same = wrote.iter().zip(found).take_while(|(a, b)| a == b).count();
        Err(BringUpError::ReadBackBytes { node, object, written: wrote.len(), found: found.len(), same })
    }
}

enum Next {
    Write,
    ReadBack,
    Again,
    Step,
}

/// Starts a transfer with an idle client: a new one, or one whose last result was taken.
pub(crate) fn begin_transfer(sdo: &mut Client, object: Object, write: Option<Write>, now: Instant) {
    let started = match write {
        Some(write) => sdo.write(write, now),
        None => sdo.upload(object, now),
    };
    started.expect("the client is idle and four bytes fit it");
}

fn error_of(node: NodeId, error: SdoError) -> BringUpError {
    let (object, AbortCode(code)) = (error.object, error.cause.abort_code());
    let node = node.raw();
    match error.cause {
        SdoCause::TimedOut { waited } => BringUpError::TimedOut { node, object, waited },
        _ => BringUpError::Aborted { node, object, code },
    }
}
