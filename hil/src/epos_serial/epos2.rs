//! Emulated RS-232 port of an EPOS2.

use can::Instant;
use canopen::Object;
use canopen::sdo::AbortCode;
use serial::epos2::{
    ANSWER, Acknowledge, Answer, MAX_WORDS, Malformed, Request, Telegram, body_length,
};

use super::{EposSerialConfig, Service};
use crate::outbox::Heard;
use crate::{Epos4, LineDevice};

/// The RS-232 port of an EPOS2.
///
/// ```text
/// Idle --opcode, O--> Body --whole, O--> Answering --O--> Ending --any--> Idle
///                      |  damaged, F        | other
///                      +--> Idle            +--> Idle          pause: --> Idle
/// ```
///
/// An unknown opcode is received to its end and refused with 0x0F00_FFBF. An NMT command leads from Body straight to
/// Idle. While the port has bytes to send, it ignores received bytes.
pub struct Epos2Serial {
    service: Service,
    state: TelegramState,
    body: [u8; body_length(MAX_WORDS)],
    last: Instant,
}

#[derive(Clone, Copy)]
enum TelegramState {
    Idle,
    /// Number of bytes received after this opcode.
    Body {
        opcode: u8,
        count: usize,
    },
    /// The opcode of an answer was sent. The ready acknowledgement is pending.
    Answering(Telegram),
    /// The whole answer was sent. The end acknowledgement is pending.
    Ending,
}

impl Epos2Serial {
    /// A port after power-on, with its device.
    pub fn new(config: EposSerialConfig) -> Self {
        Self {
            state: TelegramState::Idle,
            body: [0; body_length(MAX_WORDS)],
            last: config.epos.power_on,
            service: Service::new(config),
        }
    }

    /// The device.
    pub fn epos(&self) -> &Epos4 {
        &self.service.epos
    }

    /// Receive counters.
    pub fn heard(&self) -> Heard {
        self.service.heard
    }

    fn take(&mut self, byte: u8, now: Instant) -> TelegramState {
        match self.state {
            TelegramState::Idle => {
                self.service.send(&[Acknowledge::Okay.byte()], now);
                TelegramState::Body {
                    opcode: byte,
                    count: 0,
                }
            }
            TelegramState::Body { opcode, count } => {
                self.body[count] = byte;
                let count = count + 1;
                if count < body_length(usize::from(self.body[0]) + 1) {
                    TelegramState::Body { opcode, count }
                } else {
                    self.finish(opcode, count, now)
                }
            }
            TelegramState::Answering(telegram) => {
                if Acknowledge::from_byte(byte) == Some(Acknowledge::Okay) {
                    self.service.send(telegram.body(), now);
                    TelegramState::Ending
                } else {
                    self.service.heard.skipped += 1;
                    TelegramState::Idle
                }
            }
            TelegramState::Ending => TelegramState::Idle,
        }
    }

    /// Processes a complete telegram.
    fn finish(&mut self, opcode: u8, count: usize, now: Instant) -> TelegramState {
        let request = Request::decode(opcode, &self.body[..count]);
        if request == Err(Malformed::Damaged) {
            self.service.heard.damaged += 1;
            self.service.send(&[Acknowledge::Failed.byte()], now);
            return TelegramState::Idle;
        }
        let answer = match request {
            Ok(request) => {
                let done = self.obey(request, now);
                self.count(done.is_ok());
                let answer = done.unwrap_or_else(|code| Answer::Refused(code.0));
                request.is_answered().then(|| answer.encode(&request))
            }
            Err(_) => {
                self.count(false);
                let shape = Request::Nmt {
                    node: 0,
                    command: 0,
                };
                Some(Answer::Refused(AbortCode::MAXON_ILLEGAL_COMMAND.0).encode(&shape))
            }
        };
        let Some(answer) = answer else {
            self.service.send(&[Acknowledge::Okay.byte()], now);
            return TelegramState::Idle;
        };
        self.service.send(&[Acknowledge::Okay.byte(), ANSWER], now);
        TelegramState::Answering(answer)
    }

    fn obey(&mut self, request: Request, now: Instant) -> Result<Answer, AbortCode> {
        match request {
            Request::Read(address) => {
                let object = Object::new(address.index, address.subindex);
                Ok(Answer::Value(self.service.read(
                    address.node,
                    object,
                    now,
                )?))
            }
            Request::Write(address, value) => {
                let object = Object::new(address.index, address.subindex);
                self.service.write(address.node, object, value, now)?;
                Ok(Answer::Done)
            }
            Request::Nmt { node, command } => {
                self.service.epos.command_nmt(command, node, now)?;
                Ok(Answer::Done)
            }
        }
    }

    fn count(&mut self, obeyed: bool) {
        if obeyed {
            self.service.heard.obeyed += 1;
        } else {
            self.service.heard.refused += 1;
        }
    }
}

impl LineDevice for Epos2Serial {
    fn receive(&mut self, byte: u8, now: Instant) {
        self.service.run(now);
        if now.since(self.last) > self.service.config.time_out {
            if let TelegramState::Body { count, .. } = self.state {
                self.service.heard.skipped += count as u64 + 1;
            }
            self.state = TelegramState::Idle;
        }
        self.last = now;
        if !self.service.listens() {
            self.service.heard.skipped += 1;
        } else {
            self.state = self.take(byte, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<u8> {
        self.service.outbox.poll_transmit(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.service.poll_timeout()
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.service.run(now);
    }
}
