use can::Instant;
use canopen::cia402::{HomingMethod, ModeOfOperation, PowerState, Statusword, SupportedModes};
use canopen::objects::*;
use canopen::sdo::{AbortCode, Client, Expedited, SdoError, Transfer, Write};
use canopen::{NodeId, Object, nmt};

use super::axis::Learnt;
use super::config::{AxisConfig, ConfigError, GroupConfig, Parameter};
use super::process_data;
use crate::{BringUpError, Increments};

/// How often a node may boot before it counts as not booting.
const BOOTS: u8 = 3;

/// Device profile of a drive, in the low half of object 0x1000.
const PROFILE_402: u32 = 402;
/// Object 0x6007: a broken connection makes the drive brake by a quick stop.
const ABORT_CONNECTION_BY_QUICK_STOP: i16 = 3;
/// Object 0x605A: a quick stop brakes on its ramp, and the drive then holds the axis.
const QUICK_STOP_RAMP_AND_HOLD: i16 = 6;

/// Brings one node from whatever state it is in to configured, and then to operational.
///
/// ```text
///          boot-up, or 0x1000 answered        last step            all nodes are        heartbeat 0x05
///   Booting ───────────────► Configuring ─────────────► Configured ─────────► Starting ────────► Operational
///      ▲                          │ boot-up                  │
///      └◄─────────────────────────┴──────────────────────────┘
/// ```
#[derive(Clone, Debug)]
pub(super) struct NodeBringUp {
    node: NodeId,
    group: GroupConfig,
    program: Vec<Step>,
    phase: Phase,
    boots: u8,
    learnt: Learnt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Reset was ordered at `since`; its boot-up is awaited, or an answer to object 0x1000.
    Booting {
        since: Instant,
        booted: bool,
        asked: bool,
    },
    /// `asked`: the request of the step is under way since `since`.
    Configuring {
        step: usize,
        reading_back: bool,
        asked: bool,
        since: Instant,
    },
    Configured,
    Starting {
        since: Instant,
    },
    Operational,
}

/// What one node is asked, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Object 0x1018 must say this.
    Identity(Object, u32),
    /// Object 0x6502 must have these modes.
    Modes([ModeOfOperation; 2]),
    /// Write, and read back.
    Set(Write),
    /// Write, and read back; a drive without the object has no other value either.
    SetIfPresent(Write),
    /// Object 0x6061 must come to show this mode.
    Shown(ModeOfOperation),
    /// Object 0x6041.
    Statusword,
    /// Object 0x6064.
    Position,
    /// Object 0x603F, which counts if the drive is in fault.
    ErrorCode,
}

impl Step {
    fn object(&self) -> Object {
        match self {
            Self::Identity(object, _) => *object,
            Self::Modes(_) => SUPPORTED_MODES,
            Self::Set(write) | Self::SetIfPresent(write) => write.object,
            Self::Shown(_) => MODE_OF_OPERATION_DISPLAY,
            Self::Statusword => STATUSWORD,
            Self::Position => POSITION_ACTUAL,
            Self::ErrorCode => ERROR_CODE,
        }
    }

    fn write(&self) -> Option<Write> {
        match self {
            Self::Set(write) | Self::SetIfPresent(write) => Some(*write),
            Self::Identity(..)
            | Self::Modes(_)
            | Self::Shown(_)
            | Self::Statusword
            | Self::Position
            | Self::ErrorCode => None,
        }
    }
}

impl Parameter {
    fn write(&self) -> Option<Write> {
        let data = Expedited::new(self.value.to_le_bytes().get(..usize::from(self.size))?)?;
        Some(Write {
            object: Object::new(self.index, self.subindex),
            data,
        })
    }
}

/// All that a drive is asked and told before it is started.
fn program(group: &GroupConfig, axis: &AxisConfig) -> Result<Vec<Step>, ConfigError> {
    let units = axis.drive_units()?;
    let (period, exponent) = group.interpolation_period()?;
    let (heartbeat, lost) = group.heartbeat_times()?;
    let consumer = u32::from(group.host_node.raw()) << 16 | u32::from(lost);
    let mode = axis.mode.of_operation();
    let identity = [
        (VENDOR_ID, Some(axis.identity.vendor)),
        (PRODUCT_CODE, axis.identity.product),
        (REVISION, axis.identity.revision),
    ];

    let mut steps: Vec<Step> = identity
        .into_iter()
        .filter_map(|(object, expected)| Some(Step::Identity(object, expected?)))
        .collect();
    steps.push(Step::Modes([mode, ModeOfOperation::Homing]));
    steps.extend(
        [
            // A drive that a controller before us left enabled.
            Write::new(CONTROLWORD, 0_u16),
            Write::new(PRODUCER_HEARTBEAT, heartbeat),
            Write::new(CONSUMER_HEARTBEAT_1, consumer),
            Write::new(ABORT_CONNECTION_OPTION, ABORT_CONNECTION_BY_QUICK_STOP),
            Write::new(QUICK_STOP_OPTION, QUICK_STOP_RAMP_AND_HOLD),
            Write::new(QUICK_STOP_DECELERATION, units.quick_stop_deceleration),
            Write::new(INTERPOLATION_PERIOD_VALUE, period),
            Write::new(INTERPOLATION_PERIOD_INDEX, exponent),
            Write::new(FOLLOWING_ERROR_WINDOW, units.following_error),
            Write::new(HOMING_METHOD, HomingMethod(axis.homing.method).0),
            Write::new(HOMING_SWITCH_SPEED, units.search_speed),
            Write::new(HOMING_ZERO_SPEED, units.zero_speed),
            Write::new(HOMING_ACCELERATION, units.homing_acceleration),
        ]
        .map(Step::Set),
    );
    // EPOS4 has objects of its own for this, EPOS2 and CiA 402 have 0x607C.
    steps.push(Step::SetIfPresent(Write::new(HOME_OFFSET, 0_i32)));
    steps.extend(
        axis.parameters
            .iter()
            .filter_map(Parameter::write)
            .map(Step::Set),
    );
    steps.extend(process_data::mapping_writes(axis.node, axis.mode).map(Step::Set));
    steps.push(Step::Set(Write::new(MODE_OF_OPERATION, mode.raw())));
    steps.extend([
        Step::Shown(mode),
        Step::Statusword,
        Step::Position,
        Step::ErrorCode,
    ]);
    Ok(steps)
}

impl NodeBringUp {
    pub(super) fn new(group: &GroupConfig, axis: &AxisConfig) -> Result<Self, ConfigError> {
        Ok(Self {
            node: axis.node,
            group: *group,
            program: program(group, axis)?,
            phase: Phase::Operational,
            boots: 0,
            learnt: Learnt::default(),
        })
    }

    /// Begins anew; the caller sends the reset.
    pub(super) fn reset(&mut self, now: Instant) {
        self.phase = Phase::Booting {
            since: now,
            booted: false,
            asked: false,
        };
        self.boots = 0;
        self.learnt = Learnt::default();
    }

    /// Begins the start; the caller sends the command.
    pub(super) fn start(&mut self, now: Instant) {
        self.phase = Phase::Starting { since: now };
    }

    pub(super) fn configured(&self) -> bool {
        self.phase == Phase::Configured
    }

    pub(super) fn operational(&self) -> bool {
        self.phase == Phase::Operational
    }

    pub(super) fn learnt(&self) -> Learnt {
        self.learnt
    }

    /// Takes a heartbeat or boot-up; `sdo` starts anew with a node that booted.
    pub(super) fn heard(&mut self, state: nmt::State, sdo: &mut Client, now: Instant) {
        match (self.phase, state) {
            (Phase::Starting { .. }, nmt::State::Operational) => self.phase = Phase::Operational,
            (Phase::Booting { since, .. }, nmt::State::Initialising) => {
                *sdo = self.client();
                self.phase = Phase::Booting {
                    since,
                    booted: true,
                    asked: false,
                };
            }
            (Phase::Configuring { .. } | Phase::Configured, nmt::State::Initialising) => {
                *sdo = self.client();
                self.boots += 1;
                self.phase = Phase::Booting {
                    since: now,
                    booted: true,
                    asked: false,
                };
            }
            _ => {}
        }
    }

    pub(super) fn client(&self) -> Client {
        Client::new(self.node, self.group.sdo_timeout, self.group.sdo_retries)
    }

    /// Moves on: takes the answer to the last request and makes the next one.
    pub(super) fn advance(&mut self, sdo: &mut Client, now: Instant) -> Result<(), BringUpError> {
        let node = self.node.raw();
        sdo.handle_timeout(now);
        match self.phase {
            Phase::Booting {
                since,
                booted,
                asked,
            } => {
                let waited = now.since(since);
                if waited > self.group.boot_timeout || self.boots > BOOTS {
                    return Err(BringUpError::NeverBooted { node, waited });
                }
                if let Some(result) = sdo.poll() {
                    match result.and_then(|transfer| transfer.number::<u32>()) {
                        Ok(device_type) if device_type & 0xFFFF == PROFILE_402 => {
                            self.phase = Phase::Configuring {
                                step: 0,
                                reading_back: false,
                                asked: false,
                                since: now,
                            };
                            return self.advance(sdo, now);
                        }
                        Ok(device_type) => {
                            return Err(BringUpError::NotADrive { node, device_type });
                        }
                        // It may still boot; the boot time-out decides.
                        Err(_) => {
                            self.phase = Phase::Booting {
                                since,
                                booted,
                                asked: false,
                            }
                        }
                    }
                } else if !asked && (booted || waited >= self.group.sdo_timeout) {
                    self.phase = Phase::Booting {
                        since,
                        booted,
                        asked: true,
                    };
                    begin(sdo, DEVICE_TYPE, None, now);
                }
                Ok(())
            }
            Phase::Configuring {
                step,
                reading_back,
                asked,
                since,
            } => {
                let Some(current) = self.program.get(step).copied() else {
                    self.phase = Phase::Configured;
                    return Ok(());
                };
                if !asked {
                    let write = current.write().filter(|_| !reading_back);
                    begin(sdo, current.object(), write, now);
                    self.phase = Phase::Configuring {
                        step,
                        reading_back,
                        asked: true,
                        since,
                    };
                    return Ok(());
                }
                let Some(result) = sdo.poll() else {
                    return Ok(());
                };
                let next = self.judge(current, reading_back, result, now.since(since))?;
                self.phase = match next {
                    Next::ReadBack => Phase::Configuring {
                        step,
                        reading_back: true,
                        asked: false,
                        since,
                    },
                    Next::Again => Phase::Configuring {
                        step,
                        reading_back,
                        asked: false,
                        since,
                    },
                    Next::Step => Phase::Configuring {
                        step: step + 1,
                        reading_back: false,
                        asked: false,
                        since: now,
                    },
                };
                self.advance(sdo, now)
            }
            Phase::Starting { since } => {
                let waited = now.since(since);
                // The heartbeat that says so may be a period away.
                if waited > self.group.boot_timeout + self.group.heartbeat_period {
                    return Err(BringUpError::NotOperational { node, waited });
                }
                Ok(())
            }
            Phase::Configured | Phase::Operational => Ok(()),
        }
    }

    fn judge(
        &mut self,
        step: Step,
        reading_back: bool,
        result: Result<Transfer<'_>, SdoError>,
        waited: std::time::Duration,
    ) -> Result<Next, BringUpError> {
        let node = self.node.raw();
        if let (
            Step::SetIfPresent(_),
            Err(SdoError::Aborted {
                code: AbortCode::NO_OBJECT,
                ..
            }),
        ) = (step, result)
        {
            return Ok(Next::Step);
        }
        let transfer = result.map_err(|error| error_of(self.node, error))?;
        let error = |error| error_of(self.node, error);
        match step {
            Step::Identity(object, expected) => {
                let found = transfer.number().map_err(error)?;
                if found != expected {
                    let subindex = object.subindex;
                    return Err(BringUpError::WrongIdentity {
                        node,
                        subindex,
                        expected,
                        found,
                    });
                }
            }
            Step::Modes(modes) => {
                let supported = transfer.number().map_err(error)?;
                let lacking = modes
                    .into_iter()
                    .find(|&mode| !SupportedModes(supported).contains(mode));
                if let Some(mode) = lacking {
                    return Err(BringUpError::ModeUnsupported {
                        node,
                        mode: mode.raw(),
                        supported,
                    });
                }
            }
            Step::Set(_) | Step::SetIfPresent(_) if !reading_back => return Ok(Next::ReadBack),
            Step::Set(write) | Step::SetIfPresent(write) => {
                // A drive that does not give sizes fills up to four bytes.
                let wrote = write.data.data();
                if !transfer.data.starts_with(wrote) || transfer.data.len() > 4 {
                    let Object { index, subindex } = write.object;
                    let (written, found) = (number(wrote), number(transfer.data));
                    return Err(BringUpError::ReadBack {
                        node,
                        index,
                        subindex,
                        written,
                        found,
                    });
                }
            }
            Step::Shown(mode) => {
                let found = transfer.number::<i8>().map_err(error)?;
                if found != mode.raw() {
                    if waited <= self.group.transition_timeout {
                        return Ok(Next::Again);
                    }
                    let Object { index, subindex } = MODE_OF_OPERATION_DISPLAY;
                    let (written, found) = (mode.raw() as u8, found as u8);
                    let (written, found) = (u32::from(written), u32::from(found));
                    return Err(BringUpError::ReadBack {
                        node,
                        index,
                        subindex,
                        written,
                        found,
                    });
                }
            }
            Step::Statusword => {
                self.learnt.statusword = Statusword(transfer.number().map_err(error)?);
            }
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

enum Next {
    ReadBack,
    Again,
    Step,
}

/// Starts a transfer with a client that is idle: it was just made, or its last result was taken.
pub(super) fn begin(sdo: &mut Client, object: Object, write: Option<Write>, now: Instant) {
    let started = match write {
        Some(write) => sdo.write(write, now),
        None => sdo.upload(object, now),
    };
    started.expect("the client is idle and four bytes fit it");
}

/// The abort code that says why, whichever side ended the transfer.
pub(super) fn abort_code(error: SdoError) -> (Object, AbortCode) {
    match error {
        SdoError::Aborted { object, code } => (object, code),
        SdoError::TimedOut { object, .. } => (object, AbortCode::TIME_OUT),
        SdoError::Toggle { object } => (object, AbortCode::TOGGLE),
        SdoError::Specifier { object, .. } => (object, AbortCode::COMMAND_SPECIFIER),
        SdoError::EmptySegment { object } => (object, AbortCode::GENERAL),
        SdoError::TooLarge { object, .. } => (object, AbortCode::OUT_OF_MEMORY),
        SdoError::Length { object, .. } => (object, AbortCode::LENGTH_MISMATCH),
    }
}

fn error_of(node: NodeId, error: SdoError) -> BringUpError {
    let (Object { index, subindex }, AbortCode(code)) = abort_code(error);
    let node = node.raw();
    match error {
        SdoError::TimedOut { waited, .. } => BringUpError::TimedOut {
            node,
            index,
            subindex,
            waited,
        },
        _ => BringUpError::Aborted {
            node,
            index,
            subindex,
            code,
        },
    }
}

/// Up to four bytes as a number.
pub(super) fn number(data: &[u8]) -> u32 {
    data.iter()
        .take(4)
        .rev()
        .fold(0, |number, &byte| number << 8 | u32::from(byte))
}
