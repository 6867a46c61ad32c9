//! Devices on pseudo-terminals, in step with the wall clock: waits for bytes and for the devices' time.

use std::io;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use can::{Instant, clock};
use hil::{Pty, pty};

/// Longest time between two looks at whether somebody pressed Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// Bytes taken from a line at a time; more wait in it.
const CHUNK: usize = 4096;

/// What is behind some serial lines, numbered from 0, as a function of (state, bytes, now).
///
/// Its time line begins at [`Instant::ZERO`], and `now` never decreases.
pub(crate) trait Lines {
    /// Takes what the host wrote on a line.
    fn handle_bytes(&mut self, line: usize, bytes: &[u8], now: Instant);

    /// What a line has for the host, or the front of it.
    fn bytes(&self, line: usize) -> &[u8];

    /// Takes off the first `count` of those bytes, which the host has been sent.
    fn consume(&mut self, line: usize, count: usize);

    /// When something happens next unless bytes come, if anything does.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Lets time pass to `now`.
    fn advance(&mut self, now: Instant);
}

/// Lets `lines` live on `ptys`, one each, until `stop`.
pub(crate) fn serve(lines: &mut impl Lines, ptys: &mut [Pty], stop: &AtomicBool) -> io::Result<()> {
    let start = clock::now();
    let mut full = vec![false; ptys.len()];
    let mut buffer = [0; CHUNK];
    let mut passed = Instant::ZERO;
    while !stop.load(Ordering::Relaxed) {
        let due = lines.poll_timeout().unwrap_or(Instant::FAR_FUTURE);
        let wake = start + due.since(Instant::ZERO);
        let ends = ptys.iter().zip(&full);
        let ends = ends.map(|(pty, &full)| (pty.as_fd(), full));
        pty::wait(ends, wake.min(clock::now() + LOOK))?;
        // A pseudo-terminal does not tell when its bytes came. If this program slept too long, they are
        // taken for older than what falls due in between: what a device watches is its host's silence and
        // not this program's.
        let now = Instant::ZERO + clock::now().since(start);
        passed = passed.max(now.min(due - Duration::from_nanos(1)));
        for (line, pty) in ptys.iter_mut().enumerate() {
            let count = pty.read(&mut buffer)?;
            if count > 0 {
                lines.handle_bytes(line, &buffer[..count], passed);
            }
        }
        passed = passed.max(now);
        lines.advance(passed);
        for (line, (pty, full)) in ptys.iter_mut().zip(&mut full).enumerate() {
            *full = false;
            while !lines.bytes(line).is_empty() && !*full {
                let count = pty.write(lines.bytes(line))?;
                lines.consume(line, count);
                *full = count == 0;
            }
        }
    }
    Ok(())
}
