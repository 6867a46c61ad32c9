//! Bytes of both service protocols.

use super::{Dialect, ServiceError};
use crate::epos2::{ANSWER, Acknowledge, Answer, Malformed, Request, Telegram, body_length};
use crate::epos4::Deframer;

/// Maximum number of data words of an answer that is understood.
const ANSWER_WORDS: usize = 4;

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one in each client, and it is made anew for each telegram")]
pub(super) enum Wire {
    Epos2(Exchange),
    Epos4(Deframer),
}

impl Wire {
    pub(super) fn new(dialect: Dialect) -> Self {
        match dialect {
            Dialect::Epos2 => Self::Epos2(Exchange::new(Request::Nmt { node: 0, command: 0 })),
            Dialect::Epos4 => Self::Epos4(Deframer::new()),
        }
    }
}

/// One request to an EPOS2, from the opcode on the wire to the answer.
#[derive(Clone, Debug)]
pub(super) struct Exchange {
    request: Request,
    stage: Stage,
    body: [u8; body_length(ANSWER_WORDS)],
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    Ready,
    End,
    Opcode,
    /// Number of bytes received after the opcode of the answer.
    Body(usize),
}

/// Meaning of a byte from an EPOS2.
#[derive(Clone, Copy, Debug)]
pub(super) enum Seen {
    Nothing,
    /// The device is ready for the rest of this telegram.
    Ready(Telegram),
    Offered,
    /// The device has accepted a request that is not answered.
    Sent,
    Answer(Answer),
    /// The answer was damaged, and the device must be told.
    Damaged,
    Failed(ServiceError),
}

impl Exchange {
    pub(super) fn new(request: Request) -> Self {
        Self { request, stage: Stage::Ready, body: [0; _] }
    }

    pub(super) fn take(&mut self, byte: u8) -> Seen {
        match self.stage {
            Stage::Ready | Stage::End => match (Acknowledge::from_byte(byte), self.stage) {
                (Some(Acknowledge::Okay), Stage::Ready) => {
                    self.stage = Stage::End;
                    Seen::Ready(self.request.encode())
                }
                (Some(Acknowledge::Okay), _) if self.request.is_answered() => {
                    self.stage = Stage::Opcode;
                    Seen::Nothing
                }
                (Some(Acknowledge::Okay), _) => Seen::Sent,
                (Some(Acknowledge::Failed), _) => Seen::Failed(ServiceError::NotAcknowledged),
                (None, _) => Seen::Failed(ServiceError::Damaged),
            },
            Stage::Opcode if byte == ANSWER => {
                self.stage = Stage::Body(0);
                Seen::Offered
            }
            Stage::Opcode => Seen::Failed(ServiceError::Damaged),
            Stage::Body(count) => {
                self.body[count] = byte;
                let words = usize::from(self.body[0]) + 1;
                match count + 1 {
                    // No answer is this long. The length is damaged, so the end of the answer is unknown.
                    1 if words > ANSWER_WORDS => Seen::Failed(ServiceError::Damaged),
                    count if count < body_length(words) => {
                        self.stage = Stage::Body(count);
                        Seen::Nothing
                    }
                    count => match Answer::decode(&self.body[..count]) {
                        Ok(answer) => Seen::Answer(answer),
                        Err(Malformed::Damaged) => Seen::Damaged,
                        Err(Malformed::Unknown { .. }) => Seen::Failed(ServiceError::Unexpected),
                    },
                }
            }
        }
    }
}
