//! A port that counts how it is used, keeps what it was offered, and can be told to refuse.

use std::sync::{Arc, Mutex, MutexGuard};

use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received};

/// What was seen since the test last looked, and what the port is to do.
pub(crate) struct Watch {
    pub(crate) sends: u32,
    pub(crate) receives: u32,
    /// Frames of the last [`Port::send`] that the port below took, and those that it was offered.
    pub(crate) taken: Vec<Frame>,
    pub(crate) offered: Vec<Frame>,
    /// Frames that the port takes at a time; the rest it refuses.
    pub(crate) room: usize,
    /// Frames of somebody else on the bus, sent with the next [`Port::send`].
    pub(crate) foreign: Vec<Frame>,
    /// What the port says of its controller, if not what the port below does.
    pub(crate) state: Option<ControllerState>,
}

impl Watch {
    /// Begins to count anew.
    pub(crate) fn forget(&mut self) {
        (self.sends, self.receives) = (0, 0);
    }
}

/// The test's end of a [`Watched`] port.
#[derive(Clone)]
pub(crate) struct Watcher(Arc<Mutex<Watch>>);

impl Watcher {
    /// A port that takes everything, and the handle to it. Its lists hold a batch without allocating.
    pub(crate) fn new() -> Self {
        Self(Arc::new(Mutex::new(Watch {
            sends: 0,
            receives: 0,
            taken: Vec::with_capacity(64),
            offered: Vec::with_capacity(64),
            room: usize::MAX,
            foreign: Vec::new(),
            state: None,
        })))
    }

    /// Puts the port before another.
    pub(crate) fn wrap(&self, port: impl Port + 'static) -> Box<dyn Port> {
        Box::new(Watched {
            port,
            watch: self.clone(),
        })
    }

    /// Looks.
    pub(crate) fn lock(&self) -> MutexGuard<'_, Watch> {
        self.0.lock().expect("no test panics while it looks")
    }
}

struct Watched<P> {
    port: P,
    watch: Watcher,
}

impl<P: Port> Port for Watched<P> {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Result<usize, PortError> {
        let mut watch = self.watch.lock();
        for frame in watch.foreign.drain(..) {
            self.port.send(now, &[frame])?;
        }
        let taken = self
            .port
            .send(now, &frames[..frames.len().min(watch.room)])?;
        watch.sends += 1;
        watch.taken.clear();
        watch.taken.extend(&frames[..taken]);
        watch.offered.clear();
        watch.offered.extend(frames);
        Ok(taken)
    }

    fn receive(&mut self, now: Instant, into: &mut [Received]) -> Result<usize, PortError> {
        self.watch.lock().receives += 1;
        self.port.receive(now, into)
    }

    fn counters(&self) -> Counters {
        self.port.counters()
    }

    fn state(&self) -> ControllerState {
        self.watch.lock().state.unwrap_or(self.port.state())
    }
}
