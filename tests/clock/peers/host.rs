//! Host on a bus with an independent node: SDO client and NMT master with the waits of the console's commands.

use std::collections::VecDeque;
use std::time::Duration;

use can::{Frame, Instant, Port, Received, SocketCanOptions, SocketCanPort, clock};
use canopen::heartbeat::Heartbeat;
use canopen::nmt::{Command, NmtState};
use canopen::sdo::{AbortCode, Write};
use canopen::sync::Sync;
use canopen::{NodeId, Object};
use master::sdo::{Client, SdoCause, SdoError, StartError};

/// Upper bound for the duration of every step.
pub(super) const PATIENCE: Duration = Duration::from_secs(30);

/// The longest object that is transferred, bytes.
const CAPACITY: usize = 1024;

/// Number of stored frames.
const REMEMBERED: usize = 4096;

/// Number of frames that a failure message shows.
const LAST: usize = 24;

/// The host's connection to the bus.
pub(super) struct Host {
    port: SocketCanPort,
    pub(super) node: NodeId,
    client: Client,
    /// Received frames that were not examined yet, the latest at the end.
    frames: VecDeque<Frame>,
    /// The states that the node showed and nobody looked at, the last at the end.
    states: VecDeque<NmtState>,
    /// The last frames in words, for whoever looks into a failure.
    last: VecDeque<String>,
}

impl Drop for Host {
    fn drop(&mut self) {
        if std::thread::panicking() {
            println!("last frames of node {}:", self.node);
            for line in &self.last {
                println!("{line}");
            }
        }
    }
}

impl Host {
    pub(super) fn new(interface: &str, node: NodeId) -> Self {
        let port = SocketCanPort::open(interface, &SocketCanOptions::default());
        Self {
            port: port.unwrap(),
            node,
            client: Client::with_capacity(node, Duration::from_secs(3), 0, CAPACITY),
            frames: VecDeque::new(),
            states: VecDeque::new(),
            last: VecDeque::new(),
        }
    }

    /// Receives frames until `done` returns a value. Panics at the deadline.
    fn until<T>(&mut self, what: &str, mut done: impl FnMut(&mut Self) -> Option<T>) -> T {
        let end = clock::now() + PATIENCE;
        loop {
            if let Some(it) = done(self) {
                return it;
            }
            assert!(clock::now() < end, "waited too long: {what}");
            while let Some(frame) = self.client.poll_transmit(clock::now()) {
                self.send(&frame);
            }
            let look = clock::now() + Duration::from_millis(20);
            self.port.wait_readable(look).unwrap();
            for Received { frame, .. } in self.receive() {
                let heartbeat = Heartbeat::decode(&frame).filter(|it| it.node == self.node);
                self.states.extend(heartbeat.map(|it| it.state));
                self.client.handle(&frame, clock::now());
                self.note("<-", &frame);
                self.frames.push_back(frame);
            }
            let past = self.frames.len().saturating_sub(REMEMBERED);
            self.frames.drain(..past);
            self.client.handle_timeout(clock::now());
        }
    }

    fn receive(&mut self) -> Vec<Received> {
        let nothing = Received { frame: Sync::default().encode(), at: Instant::ZERO };
        let mut received = [nothing; 32];
        let count = self.port.receive(clock::now(), &mut received).unwrap();
        received[..count].to_vec()
    }

    fn note(&mut self, arrow: &str, frame: &Frame) {
        if self.last.len() == LAST {
            self.last.pop_front();
        }
        self.last.push_back(format!("{arrow} {frame}"));
    }

    pub(super) fn send(&mut self, frame: &Frame) {
        self.note("->", frame);
        assert_eq!(self.port.send(clock::now(), &[*frame]), Ok(1));
    }

    /// Discards all frames received so far.
    pub(super) fn forget(&mut self) {
        while self.receive().len() == 32 {}
        self.states.clear();
        self.frames.clear();
    }

    /// Waits for a frame for which `found` returns a value, and discards earlier frames.
    pub(super) fn frame<T>(&mut self, what: &str, found: impl Fn(&Frame) -> Option<T>) -> T {
        self.until(what, |host| std::iter::from_fn(|| host.frames.pop_front()).find_map(|frame| found(&frame)))
    }

    pub(super) fn command(&mut self, command: Command) {
        self.states.clear();
        self.send(&command.to(self.node).encode());
    }

    /// Waits for a heartbeat or boot-up of the node with this state, and forgets those before.
    pub(super) fn hears(&mut self, state: NmtState) {
        self.until(&format!("{state}"), |host| std::iter::from_fn(|| host.states.pop_front()).find(|it| *it == state));
    }

    pub(super) fn transfer(
        &mut self,
        begin: impl FnOnce(&mut Client, Instant) -> Result<(), StartError>,
    ) -> Result<Vec<u8>, SdoError> {
        begin(&mut self.client, clock::now()).unwrap();
        self.until("a transfer", |host| {
            let result = host.client.poll()?;
            Some(result.map(|transfer| transfer.data.to_vec()))
        })
    }

    pub(super) fn upload(&mut self, object: Object) -> Result<Vec<u8>, SdoError> {
        self.transfer(|client, now| client.upload(object, now))
    }

    /// Uploads after a reset of the node. durand opens its SDO server some time after the boot-up message, and loses
    /// requests until then.
    pub(super) fn upload_after_reset(&mut self, object: Object) -> Result<Vec<u8>, SdoError> {
        let lost = |result: &Result<_, _>| matches!(result, Err(SdoError { cause: SdoCause::TimedOut { .. }, .. }));
        let first = self.upload(object);
        if lost(&first) { self.upload(object) } else { first }
    }

    pub(super) fn download(&mut self, object: Object, data: &[u8]) -> Result<(), SdoError> {
        self.transfer(|client, now| client.download(object, data, now)).map(|_| ())
    }

    pub(super) fn block_upload(&mut self, object: Object) -> Result<Vec<u8>, SdoError> {
        self.transfer(|client, now| client.block_upload(object, now))
    }

    pub(super) fn block_download(&mut self, object: Object, data: &[u8]) -> Result<(), SdoError> {
        self.transfer(|client, now| client.block_download(object, data, now)).map(|_| ())
    }

    pub(super) fn writes(&mut self, writes: impl IntoIterator<Item = Write>) {
        for Write { object, data } in writes {
            assert_eq!(self.download(object, data.data()), Ok(()), "{object}");
            let read = self.upload(object);
            assert_eq!(read.as_deref(), Ok(data.data()), "{object}");
        }
    }

    pub(super) fn refuses(&mut self, object: Object, data: &[u8], code: AbortCode) {
        let refused = self.download(object, data);
        assert_eq!(refused, Err(SdoCause::Aborted { code }.of(object)));
    }

    pub(super) fn hides(&mut self, object: Object, code: AbortCode) {
        let refused = self.upload(object);
        assert_eq!(refused, Err(SdoCause::Aborted { code }.of(object)));
    }
}
