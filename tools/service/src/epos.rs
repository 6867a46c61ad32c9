//! The service port of an EPOS2 or EPOS4 on a tty: objects and NMT commands without a bus, by the clock.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::{Instant, clock};
use canopen::Object;
use canopen::nmt::Request;
use canopen::sdo::AbortCode;
use master::sdo::SdoError;
use serial::epos4::Address;
use serial::service::{Client, Config, Dialect, Reply, ServiceError, StartError, TIME_OUT};
use serial::{Line, Settings, StopBits, Tty};

use super::value::Type;

/// Longest time between two looks at whether somebody pressed Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// How soon bytes that the tty did not take are offered again.
const AGAIN: Duration = Duration::from_millis(1);

/// The longest object that is transferred, bytes; the drive has none near it.
const CAPACITY: usize = 1 << 16;

/// An opened service port.
pub(super) struct ServicePort {
    tty: Tty,
    client: Client,
    dialect: Dialect,
}

/// What a request brought, or `None` if Ctrl-C came before.
type Brought = Option<Result<Vec<u8>, SdoError>>;

impl ServicePort {
    /// Opens a tty. `timeout` is how long an answer may take, at least the drive's frame time-out.
    pub(super) fn open(
        dialect: Dialect,
        path: &str,
        baud: u32,
        timeout: Duration,
    ) -> anyhow::Result<Self> {
        let stop_bits = StopBits::One;
        let settings = Settings { baud, stop_bits };
        let config = Config {
            time_out: timeout.max(TIME_OUT),
            capacity: CAPACITY,
            ..Config::new(dialect, settings)
        };
        Ok(Self {
            tty: Tty::open(path, settings)?,
            client: Client::new(config),
            dialect,
        })
    }

    /// Whether anything was ever heard.
    pub(super) fn has_heard(&self) -> bool {
        self.tty.counters().received > 0
    }

    /// Reads an object, or writes `data` into it. Node 0 is the drive on the line.
    ///
    /// Four bytes come of an object of unknown length; `ty` says how many of them it has. What has no length by
    /// its type goes in segments where the drive knows them, and so does what it says is too long.
    pub(super) fn transfer(
        &mut self,
        node: u8,
        object: Object,
        data: Option<&[u8]>,
        ty: Option<Type>,
        stop: &AtomicBool,
    ) -> anyhow::Result<Brought> {
        let Object { index, subindex } = object;
        let address = Address {
            node,
            index,
            subindex,
        };
        if let Some(data) = data {
            return self.ask(object, stop, |client, now| match *data {
                [] => client.write(address, 0, now),
                [a] => client.write(address, a.into(), now),
                [a, b] => client.write(address, u16::from_le_bytes([a, b]).into(), now),
                [a, b, c] => client.write(address, u32::from_le_bytes([a, b, c, 0]), now),
                [a, b, c, d] => client.write(address, u32::from_le_bytes([a, b, c, d]), now),
                _ => client.write_segmented(address, data, now),
            });
        }
        let bytes = ty.map(Type::bytes);
        let segments = self.dialect == Dialect::Epos4;
        let read_segmented =
            |client: &mut Client, now: Instant| client.read_segmented(address, now);
        if matches!(bytes, Some(Some(5..))) || segments && bytes == Some(None) {
            return self.ask(object, stop, read_segmented);
        }
        let read = self.ask(object, stop, |client, now| client.read(address, now))?;
        match read {
            Some(Ok(mut data)) => {
                data.truncate(bytes.flatten().unwrap_or(4));
                Ok(Some(Ok(data)))
            }
            Some(Err(SdoError::Aborted {
                code: AbortCode::TOO_LONG | AbortCode::LENGTH_MISMATCH,
                ..
            })) if segments && bytes.is_none() => self.ask(object, stop, read_segmented),
            other => Ok(other),
        }
    }

    /// Sends an NMT command; `None` if Ctrl-C came before it was accepted.
    pub(super) fn nmt(
        &mut self,
        request: Request,
        stop: &AtomicBool,
    ) -> anyhow::Result<Option<Result<(), SdoError>>> {
        let frame = request.encode();
        let &[command, node] = frame.data() else {
            unreachable!("an NMT command has two bytes")
        };
        // It is no object's; what is refused is the command.
        let nothing = Object::new(0, 0);
        let told = self.ask(nothing, stop, |client, now| client.nmt(node, command, now))?;
        Ok(told.map(|told| told.map(|_| ())))
    }

    /// Makes a request and waits for its end, which its deadlines bound.
    fn ask(
        &mut self,
        object: Object,
        stop: &AtomicBool,
        start: impl FnOnce(&mut Client, Instant) -> Result<(), StartError>,
    ) -> anyhow::Result<Brought> {
        // What came since the last request is no answer to this one.
        self.receive()?;
        start(&mut self.client, clock::now())?;
        while !stop.load(Ordering::Relaxed) {
            let now = clock::now();
            self.client.handle_timeout(now);
            if !self.client.bytes().is_empty() {
                let count = self.tty.write(now, self.client.bytes())?;
                self.client.consume(count, now);
            }
            match self.client.poll() {
                None => {}
                Some(Ok(Reply::Value(value))) => return Ok(Some(Ok(value.to_le_bytes().into()))),
                Some(Ok(Reply::Object(object))) => return Ok(Some(Ok(object.to_owned()))),
                Some(Ok(Reply::Done)) => return Ok(Some(Ok(Vec::new()))),
                Some(Err(ServiceError::Refused(code))) => {
                    let code = AbortCode(code);
                    return Ok(Some(Err(SdoError::Aborted { object, code })));
                }
                Some(Err(ServiceError::TimedOut { waited })) => {
                    return Ok(Some(Err(SdoError::TimedOut { object, waited })));
                }
                Some(Err(other)) => return Err(anyhow!(other)),
            }
            let due = self.client.poll_timeout().context("the request is lost")?;
            let again = if self.client.bytes().is_empty() {
                LOOK
            } else {
                AGAIN
            };
            let until = due.min(now + again);
            clock::wait_readable(self.tty.as_fd(), until).map_err(serial::LineError::Os)?;
            self.receive()?;
        }
        Ok(None)
    }

    /// Hands on what has come.
    fn receive(&mut self) -> anyhow::Result<()> {
        let mut bytes = [0; 1024];
        let count = self.tty.read(clock::now(), &mut bytes)?;
        self.client.handle(&bytes[..count], clock::now());
        Ok(())
    }
}
