//! The wall clock of the rim: where a run's time line is `CLOCK_MONOTONIC`, this reads it.
//!
//! Only loops that wait, and ports that turn the kernel's time stamps into instants, call it; logic
//! takes `now` as an argument.

use crate::Instant;

/// What `CLOCK_MONOTONIC` shows.
pub fn now() -> Instant {
    Instant::from_nanos(nanos(libc::CLOCK_MONOTONIC))
}

/// By how many nanoseconds `CLOCK_REALTIME` is ahead of `CLOCK_MONOTONIC`.
///
/// Changes whenever somebody sets the clock; ask anew for each batch of time stamps.
pub(crate) fn realtime_offset() -> u64 {
    nanos(libc::CLOCK_REALTIME).saturating_sub(nanos(libc::CLOCK_MONOTONIC))
}

#[expect(
    clippy::disallowed_methods,
    unsafe_code,
    reason = "the rim's one place to read clocks"
)]
fn nanos(clock: libc::clockid_t) -> u64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a valid timespec for the call to fill.
    let result = unsafe { libc::clock_gettime(clock, &mut time) };
    assert_eq!(result, 0, "both clocks exist on every Linux");
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
    }
}
