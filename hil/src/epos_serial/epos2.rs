//! Exchanges of the emulated RS-232 port of an EPOS2.

use can::Instant;
use canopen::sdo::AbortCode;
use serial::epos2::{ANSWER, Acknowledge, Answer, MAX_WORDS, Malformed, Request, Telegram, body_length};

use super::{Protocol, Service};

/// The protocol of an EPOS2's port.
///
/// ```text
/// Idle --opcode, O--> Body --whole, O--> Answering --O--> Ending --any--> Idle
///                      |  damaged, F        | other
///                      +--> Idle            +--> Idle          pause: --> Idle
/// ```
///
/// An NMT command leads from Body straight to Idle.
pub(super) struct Exchange {
    state: TelegramState,
    body: [u8; body_length(MAX_WORDS)],
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

impl Protocol for Exchange {
    fn reset(&mut self) {
        self.state = TelegramState::Idle;
    }

    fn receive(&mut self, byte: u8, service: &mut Service, now: Instant) {
        self.state = self.take(byte, service, now);
    }
}

impl Exchange {
    pub(super) fn new() -> Self {
        Self { state: TelegramState::Idle, body: [0; body_length(MAX_WORDS)] }
    }

    fn take(&mut self, byte: u8, service: &mut Service, now: Instant) -> TelegramState {
        match self.state {
            TelegramState::Idle => {
                service.send(&[Acknowledge::Okay.byte()], now);
                TelegramState::Body { opcode: byte, count: 0 }
            }
            TelegramState::Body { opcode, count } => {
                self.body[count] = byte;
                let count = count + 1;
                if count < body_length(usize::from(self.body[0]) + 1) {
                    TelegramState::Body { opcode, count }
                } else {
                    self.finish(opcode, count, service, now)
                }
            }
            TelegramState::Answering(telegram) => {
                if Acknowledge::from_byte(byte) == Some(Acknowledge::Okay) {
                    service.send(telegram.body(), now);
                    TelegramState::Ending
                } else {
                    TelegramState::Idle
                }
            }
            TelegramState::Ending => TelegramState::Idle,
        }
    }

    fn finish(&self, opcode: u8, count: usize, service: &mut Service, now: Instant) -> TelegramState {
        let request = Request::decode(opcode, &self.body[..count]);
        if request == Err(Malformed::Damaged) {
            service.send(&[Acknowledge::Failed.byte()], now);
            return TelegramState::Idle;
        }
        let answer = match request {
            Ok(request) => {
                let done = obey(request, service, now);
                let answer = done.unwrap_or_else(|code| Answer::Refused(code.0));
                request.is_answered().then(|| answer.encode(&request))
            }
            Err(_) => {
                let shape = Request::Nmt { node: 0, command: 0 };
                Some(Answer::Refused(AbortCode::MAXON_ILLEGAL_COMMAND.0).encode(&shape))
            }
        };
        let Some(answer) = answer else {
            service.send(&[Acknowledge::Okay.byte()], now);
            return TelegramState::Idle;
        };
        service.send(&[Acknowledge::Okay.byte(), ANSWER], now);
        TelegramState::Answering(answer)
    }
}

fn obey(request: Request, service: &mut Service, now: Instant) -> Result<Answer, AbortCode> {
    Ok(match request {
        Request::Read(address) => Answer::Value(service.epos.read_value(address, now)?),
        Request::Write(address, value) => {
            service.epos.write_value(address, value, now)?;
            Answer::Done
        }
        Request::Nmt { node, command } => {
            service.epos.command_nmt(command, node, now)?;
            Answer::Done
        }
    })
}
