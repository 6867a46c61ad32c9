//! Holding a conversation on a bus by the clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::{Frame, Instant, Port, PortError, Received, clock};
use canopen::sync::Sync;

use crate::bus_port::BusPort;

/// Longest time between two looks at whether somebody pressed Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// How soon a frame that the port did not take is offered again.
const AGAIN: Duration = Duration::from_micros(200);

/// Frames taken from the port at once.
const BATCH: usize = 256;

/// What a command says on a bus and makes of the answers.
pub(super) trait Conversation {
    /// Takes a frame that came at `now`.
    fn handle(&mut self, frame: &Frame, now: Instant);

    /// The next frame to send, if any.
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame>;

    /// When it next wants [`handle_timeout`](Conversation::handle_timeout); `None` once it is over.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Notices what is overdue at `now`.
    fn handle_timeout(&mut self, now: Instant);
}

/// How a conversation ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// By itself.
    Over,
    /// By Ctrl-C.
    Interrupted,
}

/// Holds `conversation` until it is over, whose deadlines bound it, or `stop` is set.
pub(super) fn hold(
    port: &mut BusPort,
    conversation: &mut impl Conversation,
    stop: &AtomicBool,
) -> Result<Ended, PortError> {
    let mut received = [Received {
        frame: Sync::default().encode(),
        at: Instant::ZERO,
    }; BATCH];
    let mut untaken = None;
    while !stop.load(Ordering::Relaxed) {
        let now = clock::now();
        conversation.handle_timeout(now);
        while let Some(frame) = untaken.take().or_else(|| conversation.poll_transmit(now)) {
            if port.send(now, &[frame])? == 0 {
                untaken = Some(frame);
                break;
            }
        }
        let Some(due) = conversation.poll_timeout() else {
            return Ok(Ended::Over);
        };
        let again = untaken.map_or(LOOK, |_| AGAIN);
        port.wait_readable(due.min(now + again))?;
        let count = port.receive(clock::now(), &mut received)?;
        for Received { frame, at } in &received[..count] {
            conversation.handle(frame, *at);
        }
    }
    Ok(Ended::Interrupted)
}
