//! The wall clock of the rim: where a run's time line is `CLOCK_MONOTONIC`, this reads it.
//!
//! Only loops that wait, and ports that turn the kernel's time stamps into instants, call it; logic
//! takes `now` as an argument.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};

use crate::Instant;

/// What `CLOCK_MONOTONIC` shows.
pub fn now() -> Instant {
    Instant::from_nanos(nanos(libc::CLOCK_MONOTONIC))
}

/// What `CLOCK_BOOTTIME` shows: as [`now`], and the time for which the machine was suspended.
pub fn since_boot() -> Instant {
    Instant::from_nanos(nanos(libc::CLOCK_BOOTTIME))
}

/// Nanoseconds since 1970 in UTC at `instant` of [`now`], as the clock of the host is set at present.
pub fn utc_of(instant: Instant) -> u64 {
    realtime_offset(0).saturating_add(instant.as_nanos())
}

/// Sleeps until `deadline`; returns at once if it has passed. Signals do not shorten it.
#[expect(unsafe_code, reason = "libc has no safe interface to this call")]
pub fn sleep_until(deadline: Instant) {
    let nanos = deadline.as_nanos();
    let time = libc::timespec {
        tv_sec: (nanos / 1_000_000_000) as libc::time_t,
        tv_nsec: (nanos % 1_000_000_000) as libc::c_long,
    };
    // SAFETY: `time` is valid for the call to read, and no remaining time is asked for.
    while unsafe {
        libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &raw const time, std::ptr::null_mut())
    } == libc::EINTR
    {}
}

/// Waits until `end` has something to read or `CLOCK_MONOTONIC` shows `until`, and says which; an error is what the
/// operating system said.
///
/// `true` also when there is an error or a hang-up to read. Signals do not shorten it. Wakes some 50 µs late on an
/// ordinary thread.
pub fn wait_readable(end: BorrowedFd<'_>, until: Instant) -> Result<bool, i32> {
    let end = libc::pollfd { fd: end.as_raw_fd(), events: libc::POLLIN, revents: 0 };
    wait(&mut [end], until)
}

/// Waits until one of `ends` is ready or `CLOCK_MONOTONIC` shows `until`, and returns which. Errors are those of the
/// operating system. The rest is as in [`wait_readable`].
///
/// A descriptor that is closed during the wait is reported by the kernel in `revents`.
#[expect(unsafe_code, reason = "the rim's one place to wait for descriptors")]
pub fn wait(ends: &mut [libc::pollfd], until: Instant) -> Result<bool, i32> {
    let count = ends.len() as libc::nfds_t;
    loop {
        let remaining = until.since(now());
        let timeout = libc::timespec {
            tv_sec: libc::time_t::try_from(remaining.as_secs()).unwrap_or(libc::time_t::MAX),
            tv_nsec: libc::c_long::from(remaining.subsec_nanos() as i32),
        };
        // SAFETY: `count` valid pollfds, a valid timespec, and no signal mask.
        match unsafe { libc::ppoll(ends.as_mut_ptr(), count, &timeout, std::ptr::null()) } {
            0 => return Ok(false),
            1.. => return Ok(true),
            _ => match io::Error::last_os_error().raw_os_error() {
                Some(libc::EINTR) => {}
                errno => return Err(errno.unwrap_or(libc::EIO)),
            },
        }
    }
}

/// By how many nanoseconds `CLOCK_REALTIME` is ahead of `CLOCK_MONOTONIC`, if it was `known` before.
///
/// The offset changes whenever the clock is set: read it for each batch of time stamps. What lies between two
/// readings of clocks, however long, changes nothing: `known` is kept unless the readings refute it.
pub(crate) fn realtime_offset(known: u64) -> u64 {
    let before = nanos(libc::CLOCK_MONOTONIC);
    let realtime = nanos(libc::CLOCK_REALTIME);
    let after = nanos(libc::CLOCK_MONOTONIC);
    let (least, most) = (realtime.saturating_sub(after), realtime.saturating_sub(before));
    known.clamp(least, most)
}

#[expect(unsafe_code, reason = "libc has no safe interface to this call")]
fn nanos(clock: libc::clockid_t) -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid timespec for the call to fill.
    let result = unsafe { libc::clock_gettime(clock, &mut time) };
    assert_eq!(result, 0, "these clocks exist on every Linux");
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_does_not_run_backwards() {
        let first = now();
        assert!(now() >= first);
        assert!(first > Instant::ZERO);
        assert!(since_boot() >= first, "the time of suspensions is added");
    }

    #[test]
    fn utc_of_an_instant_is_that_of_the_host() {
        let host = || std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos() as u64;
        let (before, utc, after) = (host(), utc_of(now()), host());
        assert!(utc.abs_diff(before) <= after - before + 1_000_000, "{before} {utc} {after}");
        assert_eq!(utc_of(Instant::from_nanos(1000)).abs_diff(utc_of(Instant::ZERO) + 1000) / 1_000_000, 0);
    }

    #[test]
    fn the_offset_of_the_clocks_stays_until_it_is_refuted() {
        let offset = realtime_offset(0);
        assert!((0..1000).all(|_| realtime_offset(offset).abs_diff(offset) < 1000));
        assert_eq!(realtime_offset(0).abs_diff(offset) / 1_000_000, 0);
        assert_eq!(realtime_offset(u64::MAX).abs_diff(offset) / 1_000_000, 0);
    }
}
