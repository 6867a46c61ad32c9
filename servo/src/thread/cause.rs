//! Causes of late cycles.

use std::time::Duration;

use super::Awake;

/// Cause of a late cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// The servo's own computing: regulators, set-points, and statistics after SYNC.
    OwnStep,
    /// Reading from a bus, or writing to one.
    Bus,
    /// Work of the caller between cycles: on an emulated bench, the emulators of the whole cell.
    BetweenCycles,
    /// A page of the process was not in memory.
    PageFault,
    /// Another thread was given the CPU.
    Preempted,
    /// The kernel or the hypervisor woke the thread later than requested.
    LateWakeUp,
    /// According to the kernel, the thread had the CPU while time passed between two reads of the clock: an interrupt,
    /// or the hypervisor.
    Host,
}

impl Cause {
    /// All causes, ordered from the servo's own work to the host.
    pub const ALL: [Self; 7] =
        [Self::OwnStep, Self::Bus, Self::BetweenCycles, Self::PageFault, Self::Preempted, Self::LateWakeUp, Self::Host];

    /// Name of the cause.
    pub fn name(self) -> &'static str {
        match self {
            Self::OwnStep => "own step",
            Self::Bus => "bus",
            Self::BetweenCycles => "between cycles",
            Self::PageFault => "page fault",
            Self::Preempted => "preempted",
            Self::LateWakeUp => "late wake-up",
            Self::Host => "host",
        }
    }

    /// The cause of a cycle that was `late`, from the times of its parts and the kernel's counts.
    ///
    /// A pause by the hypervisor during a part of the cycle cannot be distinguished from the work of that part.
    pub fn of_cycle(late: Duration, spent: &Spent, counted: Usage) -> Self {
        // A cause must explain at least half of the lateness.
        let preempted = match counted.delay {
            Some(delay) => delay >= late / 2,
            None => counted.switches > 0,
        };
        let places = [
            (spent.own, Self::OwnStep),
            (spent.bus, Self::Bus),
            (spent.between, Self::BetweenCycles),
            (spent.wake_up, Self::LateWakeUp),
            (spent.gap, Self::Host),
        ];
        match places.into_iter().max_by_key(|(time, _)| *time) {
            _ if preempted => Self::Preempted,
            Some((time, cause)) if time >= late / 2 => match cause {
                Self::LateWakeUp => cause,
                _ if counted.faults > 0 => Self::PageFault,
                _ => cause,
            },
            _ => Self::Host,
        }
    }
}

/// Use of the time from the previous SYNC to the SYNC of this cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// Time of computing.
    pub own: Duration,
    /// Time of reading from buses and writing to them.
    pub bus: Duration,
    /// Time of the caller's work between cycles.
    pub between: Duration,
    /// Time from the requested wake-up until the thread ran.
    pub wake_up: Duration,
    /// Longest time between two reads of the clock during a spin.
    pub gap: Duration,
}

impl Spent {
    /// The times up to the end of a wait. The times `before` the wait count only if they left no time to sleep.
    pub fn waiting(awake: &Awake, before: Self) -> Self {
        let (gap, slept) = (awake.gap, awake.wake_up_latency());
        Self { gap, ..slept.map_or(before, |wake_up| Self { wake_up, ..Self::default() }) }
    }
}

/// Counts of the kernel for one thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Page faults, with and without reading from a disk.
    pub faults: u64,
    /// Number of times that another thread took the CPU.
    pub switches: u64,
    /// Time during which the thread was ready but another thread ran; `None` where the kernel does not report it.
    pub delay: Option<Duration>,
}

impl Usage {
    /// Counts of the calling thread since its start: one system call.
    #[expect(unsafe_code, reason = "getrusage has no safe wrapper among our dependencies")]
    pub fn of_this_thread() -> Self {
        // SAFETY: a rusage consists of plain numbers, and the call fills `usage`.
        let usage = unsafe {
            let mut usage: libc::rusage = std::mem::zeroed();
            libc::getrusage(libc::RUSAGE_THREAD, &raw mut usage);
            usage
        };
        Self { faults: (usage.ru_minflt + usage.ru_majflt) as u64, switches: usage.ru_nivcsw as u64, delay: None }
    }

    /// Counts since `earlier`.
    pub fn since(self, earlier: Self) -> Self {
        Self {
            faults: self.faults.saturating_sub(earlier.faults),
            switches: self.switches.saturating_sub(earlier.switches),
            delay: self.delay.zip(earlier.delay).map(|(delay, earlier)| delay.saturating_sub(earlier)),
        }
    }
}

#[cfg(test)]
mod tests {
    use can::Instant;

    use super::*;

    #[test]
    fn a_late_wait_is_attributed_by_where_its_time_went() {
        let micros = Duration::from_micros;
        let none = Usage::default();
        let [fault, switch] = [(1, 0), (0, 1)].map(|(faults, switches)| Usage { faults, switches, delay: None });
        // Late by, work before the wait, time left to sleep, wake-up latency, gap; µs.
        let cases = [
            ((90, 5, 800, 290, 0), none, Cause::LateWakeUp),
            ((90, 5, 800, 20, 160), none, Cause::Host),
            ((90, 5, 800, 20, 160), switch, Cause::Preempted),
            ((90, 5, 800, 290, 0), fault, Cause::LateWakeUp),
            ((90, 5, 800, 20, 160), fault, Cause::PageFault),
            ((90, 1090, 0, 0, 0), none, Cause::OwnStep),
            ((90, 1090, 0, 0, 0), switch, Cause::Preempted),
            ((90, 1090, 0, 0, 0), fault, Cause::PageFault),
            ((90, 2, 0, 0, 0), none, Cause::Host),
        ];
        for ((late, worked, left, latency, gap), counted, expected) in cases {
            let asked_at = Instant::from_nanos(1_000_000);
            let wake_up = asked_at + micros(left);
            let woken = wake_up + micros(latency);
            let awake = Awake { asked_at, wake_up, woken, at: woken + micros(gap), gap: micros(gap) };
            let before = Spent { own: micros(worked), ..Spent::default() };
            let spent = Spent::waiting(&awake, before);
            let found = Cause::of_cycle(micros(late), &spent, counted);
            assert_eq!(found, expected, "{late} {worked} {left} {latency} {gap} {counted:?}");
        }
    }

    #[test]
    fn a_late_cycle_is_of_what_took_most_of_it_unless_the_kernel_names_another() {
        let micros = Duration::from_micros;
        // Own, bus, between, wake-up, gap; faults, switches, delay; µs, of a cycle 400 µs late.
        let cases = [
            ((450, 20, 20, 10, 0), (0, 0, Some(0)), Cause::OwnStep),
            ((20, 450, 20, 10, 0), (0, 0, Some(0)), Cause::Bus),
            ((20, 20, 450, 10, 0), (0, 0, Some(0)), Cause::BetweenCycles),
            ((20, 20, 20, 600, 0), (0, 0, Some(0)), Cause::LateWakeUp),
            ((20, 20, 20, 10, 400), (0, 0, Some(0)), Cause::Host),
            ((20, 20, 20, 10, 0), (0, 0, Some(0)), Cause::Host),
            ((450, 20, 20, 10, 0), (9, 0, Some(0)), Cause::PageFault),
            ((20, 450, 20, 10, 0), (9, 0, Some(0)), Cause::PageFault),
            ((20, 20, 450, 10, 0), (9, 0, Some(0)), Cause::PageFault),
            ((20, 20, 20, 600, 0), (9, 0, Some(0)), Cause::LateWakeUp),
            ((20, 20, 20, 10, 0), (9, 0, Some(0)), Cause::Host),
            ((450, 20, 20, 10, 0), (9, 1, Some(390)), Cause::Preempted),
            ((20, 20, 450, 10, 0), (9, 1, Some(390)), Cause::Preempted),
            ((20, 20, 20, 600, 0), (0, 0, Some(590)), Cause::Preempted),
            ((450, 20, 20, 10, 0), (0, 1, Some(90)), Cause::OwnStep),
            ((20, 20, 450, 10, 0), (0, 1, Some(90)), Cause::BetweenCycles),
            ((450, 20, 20, 10, 0), (0, 1, None), Cause::Preempted),
            ((20, 20, 450, 10, 0), (0, 1, None), Cause::Preempted),
        ];
        for ((own, bus, between, wake_up, gap), (faults, switches, delay), expected) in cases {
            let [own, bus, between, wake_up, gap] = [own, bus, between, wake_up, gap].map(micros);
            let spent = Spent { own, bus, between, wake_up, gap };
            let delay = delay.map(micros);
            let counted = Usage { faults, switches, delay };
            let found = Cause::of_cycle(micros(400), &spent, counted);
            assert_eq!(found, expected, "{spent:?} {counted:?}");
        }
    }

    #[test]
    fn a_touched_page_is_counted_as_a_fault() {
        let before = Usage::of_this_thread();
        let pages = 64 * 4096;
        // Fresh pages of the system: too many for the allocator to have had them.
        let mut memory = vec![0u8; 64 * pages];
        memory.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
        std::hint::black_box(&memory);
        assert!(Usage::of_this_thread().since(before).faults > 0);
    }
}
