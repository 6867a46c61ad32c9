//! A port that counts calls, keeps the offered frames, and can be told to refuse frames.

use std::sync::{Arc, Mutex, MutexGuard};

use can::{ControllerState, Counters, Frame, Instant, Port, PortError, Received};

/// Observations since the last look of the test, and the behaviour of the port.
pub(crate) struct Watch {
    pub(crate) sends: u32,
    pub(crate) receives: u32,
    /// Frames of the last [`Port::send`] that the port below accepted. The next field holds the offered frames.
    pub(crate) taken: Vec<Frame>,
    pub(crate) offered: Vec<Frame>,
    /// Number of frames that the port accepts at a time. The port refuses the rest.
    pub(crate) room: usize,
    /// Frames of another node, delivered with the next [`Port::send`].
    pub(crate) foreign: Vec<Frame>,
    /// State of the controller that the port reports in place of the state of the port below.
    pub(crate) state: Option<ControllerState>,
}

impl Watch {
    /// Clears all counters.
    pub(crate) fn forget(&mut self) {
        (self.sends, self.receives) = (0, 0);
    }
}

/// The test's end of a [`Watched`] port.
#[derive(Clone)]
pub(crate) struct Watcher(Arc<Mutex<Watch>>);

impl Watcher {
    /// A port that accepts every frame, and the handle to it. Its lists hold a batch without allocating.
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

    /// Wraps another port.
    pub(crate) fn wrap(&self, port: impl Port + 'static) -> Box<dyn Port> {
        Box::new(Watched { port, watch: self.clone() })
    }

    /// Locks the observations.
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
        let taken = self.port.send(now, &frames[..frames.len().min(watch.room)])?;
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

    fn bound_unsent(&mut self, most: usize) -> Result<(), PortError> {
        self.port.bound_unsent(most)
    }

    fn counters(&self) -> Counters {
        self.port.counters()
    }

    fn state(&self) -> ControllerState {
        self.watch.lock().state.unwrap_or(self.port.state())
    }
}
