//! The messages of the last seconds, in memory that is allocated once.

use std::collections::VecDeque;
use std::time::Duration;

use can::Instant;

/// Header of a message: channel, number and time.
#[derive(Clone, Copy)]
struct Header {
    channel: u16,
    number: u32,
    time: Instant,
    length: usize,
}

/// A ring of encoded messages. The oldest messages give way to new ones, either after a time or for want of room.
pub(super) struct Window {
    span: Duration,
    /// Greatest number of messages, and of their bytes.
    room: (usize, usize),
    headers: VecDeque<Header>,
    bytes: VecDeque<u8>,
    latest: Instant,
    /// Whether the first message of the run is still in the window.
    whole: bool,
}

impl Window {
    /// A window of the last `span`, with room for `messages` messages and `bytes` bytes.
    pub(super) fn new(span: Duration, messages: usize, bytes: usize) -> Self {
        let mut window = Self {
            span,
            room: (messages.max(1), bytes),
            headers: VecDeque::with_capacity(messages.max(1)),
            bytes: VecDeque::with_capacity(bytes),
            latest: Instant::ZERO,
            whole: true,
        };
        // Every page is touched here, so that none is missing when memory is short.
        window.bytes.extend(std::iter::repeat_n(1, bytes));
        window.bytes.clear();
        window
    }

    /// Adds a message. A message that is larger than the whole memory is left out.
    pub(super) fn push(&mut self, channel: u16, time: Instant, number: u32, body: &[u8]) {
        self.latest = self.latest.max(time);
        let (places, room) = self.room;
        if body.len() > room {
            self.whole = false;
            return;
        }
        while let Some(&oldest) = self.headers.front() {
            let old = self.latest.since(oldest.time) > self.span;
            let full = self.bytes.len() + body.len() > room || self.headers.len() == places;
            if !old && !full {
                break;
            }
            self.headers.pop_front();
            self.bytes.drain(..oldest.length);
            self.whole = false;
        }
        self.headers.push_back(Header { channel, number, time, length: body.len() });
        self.bytes.extend(body);
    }

    /// Whether the window has all messages since the start.
    pub(super) fn is_whole(&self) -> bool {
        self.whole
    }

    /// Calls `each` with channel, time, number and body of every message, the oldest first, until `each` fails.
    pub(super) fn try_each<E>(&self, mut each: impl FnMut(u16, Instant, u32, &[u8]) -> Result<(), E>) -> Result<(), E> {
        let mut place = 0;
        let mut body = Vec::new();
        for header in &self.headers {
            body.clear();
            body.extend(self.bytes.range(place..place + header.length));
            place += header.length;
            each(header.channel, header.time, header.number, &body)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(window: &Window) -> Vec<u32> {
        let mut numbers = Vec::new();
        let each = |_, _, number: u32, body: &[u8]| {
            assert!(body.iter().all(|&byte| byte == number as u8));
            numbers.push(number);
            Ok::<_, ()>(())
        };
        window.try_each(each).unwrap();
        numbers
    }

    #[test]
    fn old_messages_give_way_after_the_span_and_for_want_of_room() {
        let mut window = Window::new(Duration::from_secs(2), 10, 100);
        let push = |window: &mut Window, number: u32, seconds: u64, length: usize| {
            let time = Instant::ZERO + Duration::from_secs(seconds);
            window.push(7, time, number, &vec![number as u8; length]);
        };
        (0..3).for_each(|second| push(&mut window, second as u32, second, 30));
        assert!(window.is_whole());
        assert_eq!(numbers(&window), [0, 1, 2]);
        push(&mut window, 3, 3, 30);
        assert_eq!(numbers(&window), [1, 2, 3]);
        assert!(!window.is_whole());
        push(&mut window, 4, 3, 60);
        assert_eq!(numbers(&window), [3, 4]);
        push(&mut window, 5, 3, 101);
        assert_eq!(numbers(&window), [3, 4]);
        (6..30).for_each(|number| push(&mut window, number, 3, 1));
        assert_eq!(numbers(&window), (20..30).collect::<Vec<_>>());
    }
}
