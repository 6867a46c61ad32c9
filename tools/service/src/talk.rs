//! Holding a conversation on a bus by the clock.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::{Frame, Instant, Port, PortError, Received, clock};
use canopen::sync::Sync;

use mrroc::bench::bus_port::BusPort;

/// Longest time between two looks at whether somebody pressed Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// How soon a frame that the port did not take is offered again.
const AGAIN: Duration = Duration::from_micros(200);

/// How long a frame may take from the port onto the bus: an adapter that is closed forgets what it has not sent.
const SENDING: Duration = Duration::from_millis(20);

/// How long the last frame of a conversation that is broken off is offered to the port.
const LAST: Duration = Duration::from_millis(200);

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

    /// What has to be sent yet if it is broken off, so that no node is left in a state that it was only put into for this.
    fn break_off(&self) -> Option<Frame> {
        None
    }
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
    // When the last frame was sent, unless one came since.
    let mut under_way = None;
    while !stop.load(Ordering::Relaxed) {
        let now = clock::now();
        conversation.handle_timeout(now);
        while let Some(frame) = untaken.take().or_else(|| conversation.poll_transmit(now)) {
            if port.send(now, &[frame])? == 0 {
                untaken = Some(frame);
                break;
            }
            under_way = Some(now);
        }
        let Some(due) = conversation.poll_timeout() else {
            clock::sleep_until(under_way.map_or(now, |sent| sent + SENDING));
            return Ok(Ended::Over);
        };
        let again = untaken.map_or(LOOK, |_| AGAIN);
        port.wait_readable(due.min(now + again))?;
        let count = port.receive(clock::now(), &mut received)?;
        under_way = under_way.filter(|_| count == 0);
        for Received { frame, at } in &received[..count] {
            conversation.handle(frame, *at);
        }
    }
    if let Some(frame) = conversation.break_off() {
        let until = clock::now() + LAST;
        while port.send(clock::now(), &[frame])? == 0 && clock::now() < until {
            clock::sleep_until(clock::now() + AGAIN);
        }
        clock::sleep_until(clock::now() + SENDING);
    }
    Ok(Ended::Interrupted)
}
