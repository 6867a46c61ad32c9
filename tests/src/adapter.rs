//! An slcan adapter on a pseudo-terminal with at most one device behind it, on a bus that takes no time.
//!
//! `mrroc emulate --slcan` has the true bit times of a bus. Here the test controls the adapter, and only the host's end
//! takes time.

use std::io;
use std::os::fd::AsFd;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use can::timing::Bitrate;
use can::{Frame, Instant, clock};
use hil::pty::{self, Interest};
use hil::{Device, Pty, SlcanDevice};

pub struct Adapter {
    pub pty: Pty,
    pub device: SlcanDevice,
    behind: Option<Box<dyn Device>>,
}

impl Adapter {
    pub fn new(behind: Option<Box<dyn Device>>) -> Self {
        Self { pty: Pty::open().unwrap(), device: SlcanDevice::new(Bitrate::KBPS_1000), behind }
    }

    /// Exchanges the device behind the adapter.
    pub fn replace(&mut self, behind: Box<dyn Device>) {
        self.behind = Some(behind);
    }

    /// Serves the host while `body` runs. `body` receives the path of the host's end.
    pub fn served<T>(mut self, body: impl FnOnce(&Path) -> T) -> T {
        /// Stops the service, also if `body` panics.
        struct Done<'a>(&'a AtomicBool);
        impl Drop for Done<'_> {
            fn drop(&mut self) {
                self.0.store(true, Ordering::Relaxed);
            }
        }
        let tty = self.pty.path().to_owned();
        let done = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| self.serve(Duration::MAX, |_| done.load(Ordering::Relaxed)));
            let _done = Done(&done);
            body(&tty)
        })
    }

    /// Serves the host for `time`, or until `done` returns true. Returns whether it did.
    pub fn serve(&mut self, time: Duration, mut done: impl FnMut(&Self) -> bool) -> bool {
        let end = clock::now() + time;
        while !done(self) {
            if clock::now() >= end {
                return false;
            }
            self.turn().unwrap();
        }
        true
    }

    /// Waits for bytes of the host or for a deadline of the device, then transfers all available frames.
    fn turn(&mut self) -> io::Result<()> {
        const LOOK: Duration = Duration::from_millis(20);
        let due = self.behind.as_ref().and_then(|it| it.poll_timeout());
        let look = clock::now() + LOOK;
        let interest = Interest { read: true, write: !self.device.bytes().is_empty() };
        pty::wait([(self.pty.as_fd(), interest)], due.map_or(look, |due| due.min(look)))?;
        let mut bytes = [0; 512];
        let count = self.pty.read(&mut bytes)?;
        let now = clock::now();
        self.device.handle_bytes(&bytes[..count], now);
        self.exchange(now);
        while !self.device.bytes().is_empty() {
            match self.pty.write(self.device.bytes())? {
                0 => break,
                written => self.device.consume(written),
            }
        }
        Ok(())
    }

    fn exchange(&mut self, now: Instant) {
        let Some(behind) = &mut self.behind else {
            // Frames for a bus without other nodes.
            while self.device.poll_transmit(now).is_some() {}
            return;
        };
        while let Some(frame) = self.device.poll_transmit(now) {
            behind.handle(&frame, now);
        }
        while behind.poll_timeout().is_some_and(|due| due <= now) {
            behind.handle_timeout(now);
        }
        while let Some(frame) = behind.poll_transmit(now) {
            self.device.handle(&frame, now);
        }
    }

    /// Delivers a frame from the bus.
    pub fn deliver(&mut self, frame: &Frame) {
        self.device.handle(frame, clock::now());
    }
}
