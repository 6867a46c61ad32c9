//! Runs a conversation on a bus on the wall clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::{Frame, Instant, Port, PortError, Received, clock};
use canopen::sync::Sync;

use super::Interrupted;
use mrroc::bench::bus_port::BusPort;

/// Longest time between two checks for Ctrl-C.
pub(super) const LOOK: Duration = Duration::from_millis(50);

/// Time after which a frame that the port did not accept is offered again.
const AGAIN: Duration = Duration::from_micros(200);

/// Time that a frame may take from the port onto the bus. An adapter that is closed discards frames that it has not
/// sent.
const SENDING: Duration = Duration::from_millis(20);

/// Longest time for which the last frame of an interrupted conversation is offered to the port.
const LAST: Duration = Duration::from_millis(200);

/// Protocol of a command: the frames that it sends, and its reaction to received frames.
pub(super) trait Conversation {
    /// Processes a frame received at `now`.
    fn handle(&mut self, frame: &Frame, now: Instant);

    /// The next frame to send, if any.
    fn poll_transmit(&mut self, now: Instant) -> Option<Frame>;

    /// Time at which [`handle_timeout`](Conversation::handle_timeout) is due; `None` once the conversation is over.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Processes deadlines that have passed at `now`.
    fn handle_timeout(&mut self, now: Instant);

    /// Last frame of an interrupted conversation, which returns the nodes to their normal state.
    fn break_off(&self) -> Option<Frame> {
        None
    }
}

/// Places for the frames that are read from the port at once.
pub(super) fn batch() -> [Received; 256] {
    [Received { frame: Sync::default().encode(), at: Instant::ZERO }; 256]
}

/// Runs `conversation` until it is over or `stop` is set. The deadlines of the conversation bound its duration.
pub(super) fn hold(
    port: &mut BusPort,
    conversation: &mut impl Conversation,
    stop: &AtomicBool,
) -> Result<Result<(), Interrupted>, PortError> {
    let mut received = batch();
    let mut untaken = None;
    // Time of the last sent frame, or `None` if a frame was received since.
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
            return Ok(Ok(()));
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
    Ok(Err(Interrupted))
}
