//! Service port of an EPOS2 or EPOS4 on a tty: objects and NMT commands without a bus, on the wall clock.

use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::{Instant, clock};
use canopen::Object;
use canopen::nmt::Request;
use canopen::sdo::AbortCode;
use master::sdo::{SdoCause, SdoError};
use serial::epos4::Address;
use serial::service::{Client, Config, Dialect, Reply, ServiceError, StartError, TIME_OUT};
use serial::{Line, Settings, StopBits, Tty};

use super::Interrupted;
use super::talk::LOOK;
use super::value::Type;

/// Time after which bytes that the tty did not accept are offered again.
const AGAIN: Duration = Duration::from_millis(1);

/// Longest object that is transferred, bytes. No object of these drives comes near this length.
const CAPACITY: usize = 1 << 16;

/// An open service port.
pub(super) struct ServicePort {
    tty: Tty,
    client: Client,
    dialect: Dialect,
}

/// Result of a request.
type Brought = Result<Vec<u8>, SdoError>;

impl ServicePort {
    /// Opens a tty. `timeout` limits the time to an answer, and is at least the frame time-out of the drive.
    pub(super) fn open(dialect: Dialect, path: &str, baud: u32, timeout: Duration) -> anyhow::Result<Self> {
        let settings = Settings { baud, stop_bits: StopBits::One };
        let config = Config { time_out: timeout.max(TIME_OUT), capacity: CAPACITY, ..Config::new(dialect, settings) };
        Ok(Self { tty: Tty::open(path, settings)?, client: Client::new(config), dialect })
    }

    /// Whether any byte was received.
    pub(super) fn has_heard(&self) -> bool {
        self.tty.counters().received > 0
    }

    /// Reads an object, or writes `data` into it. Node 0 is the drive on the line.
    ///
    /// An ordinary read returns four bytes, and `ty` says how many of them belong to the object. Segmented transfer
    /// reads an object whose type has no fixed length, if the drive supports segments. The same holds for an object
    /// that the drive reports as too long.
    pub(super) fn transfer(
        &mut self,
        node: u8,
        object: Object,
        data: Option<&[u8]>,
        ty: Option<Type>,
        stop: &AtomicBool,
    ) -> anyhow::Result<Brought> {
        let Object { index, subindex } = object;
        let address = Address { node, index, subindex };
        if let Some(data) = data {
            return self.ask(object, stop, |client, now| {
                if data.len() > 4 {
                    return client.write_segmented(address, data, now);
                }
                let mut value = [0; 4];
                value[..data.len()].copy_from_slice(data);
                client.write(address, u32::from_le_bytes(value), now)
            });
        }
        let bytes = ty.map(Type::bytes);
        let segments = self.dialect == Dialect::Epos4;
        let read_segmented = |client: &mut Client, now: Instant| client.read_segmented(address, now);
        if matches!(bytes, Some(Some(5..))) || segments && bytes == Some(None) {
            return self.ask(object, stop, read_segmented);
        }
        let read = self.ask(object, stop, |client, now| client.read(address, now))?;
        match read {
            Ok(mut data) => {
                data.truncate(bytes.flatten().unwrap_or(4));
                Ok(Ok(data))
            }
            Err(SdoError {
                cause: SdoCause::Aborted { code: AbortCode::TOO_LONG | AbortCode::LENGTH_MISMATCH },
                ..
            }) if segments && bytes.is_none() => self.ask(object, stop, read_segmented),
            other => Ok(other),
        }
    }

    /// Sends an NMT command.
    pub(super) fn nmt(&mut self, request: Request, stop: &AtomicBool) -> anyhow::Result<Result<(), SdoError>> {
        let frame = request.encode();
        let &[command, node] = frame.data() else { unreachable!("an NMT command has two bytes") };
        // An NMT command addresses no object. A refusal concerns the command.
        let nothing = Object::new(0, 0);
        Ok(self.ask(nothing, stop, |client, now| client.nmt(node, command, now))?.map(|_| ()))
    }

    /// Makes a request and waits for its end. The deadlines of the request bound the wait. The error after Ctrl-C is
    /// [`Interrupted`].
    fn ask(
        &mut self,
        object: Object,
        stop: &AtomicBool,
        start: impl FnOnce(&mut Client, Instant) -> Result<(), StartError>,
    ) -> anyhow::Result<Brought> {
        // Bytes that came since the last request are not an answer to this request.
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
                Some(Ok(Reply::Value(value))) => return Ok(Ok(value.to_le_bytes().into())),
                Some(Ok(Reply::Object(object))) => return Ok(Ok(object.to_owned())),
                Some(Ok(Reply::Done)) => return Ok(Ok(Vec::new())),
                Some(Err(ServiceError::Refused(code))) => {
                    return Ok(Err(SdoCause::Aborted { code: AbortCode(code) }.of(object)));
                }
                Some(Err(ServiceError::TimedOut { waited })) => {
                    return Ok(Err(SdoCause::TimedOut { waited }.of(object)));
                }
                Some(Err(other)) => return Err(anyhow!(other)),
            }
            let due = self.client.poll_timeout().context("the request is lost")?;
            let again = if self.client.bytes().is_empty() { LOOK } else { AGAIN };
            clock::wait_readable(self.tty.as_fd(), due.min(now + again)).map_err(serial::LineError::Os)?;
            self.receive()?;
        }
        Err(Interrupted.into())
    }

    /// Passes on the received bytes.
    fn receive(&mut self) -> anyhow::Result<()> {
        let mut bytes = [0; 1024];
        let count = self.tty.read(clock::now(), &mut bytes)?;
        self.client.handle(&bytes[..count], clock::now());
        Ok(())
    }
}
