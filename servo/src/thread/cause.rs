//! Causes of late cycles.

use std::time::Duration;

use super::Awake;

/// Who took the time of a late cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// Its own computing: regulators, set-points, and the figures it keeps once SYNC has left.
    OwnStep,
    /// Reading from a bus, or writing to one.
    Bus,
    /// What the caller has the thread do between cycles: on an emulated bench, the emulators of the whole cell.
    BetweenCycles,
    /// A page of the process was not in memory.
    PageFault,
    /// Another thread was given the CPU.
    Preempted,
    /// The kernel or the hypervisor woke the thread later than it asked for.
    LateWakeUp,
    /// The thread had the CPU by the kernel's account, and time passed between two reads of the clock: an
    /// interrupt, or the hypervisor.
    Host,
}

impl Cause {
    /// All, the least of a host's faults first.
    pub const ALL: [Self; 7] = [
        Self::OwnStep,
        Self::Bus,
        Self::BetweenCycles,
        Self::PageFault,
        Self::Preempted,
        Self::LateWakeUp,
        Self::Host,
    ];

    /// Its name.
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

    /// Who made a cycle `late` that `spent` its time so, by what the kernel counted meanwhile.
    ///
    /// A hypervisor that stops the computer inside the step, or between cycles, cannot be told from what is done there.
    pub fn of_cycle(late: Duration, spent: &Spent, counted: Usage) -> Self {
        // What took less than half of the time is not what took it.
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
        let longest = places.into_iter().max_by_key(|(time, _)| *time);
        match longest {
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

/// Where a cycle's time went, from the SYNC before to its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// In computing.
    pub own: Duration,
    /// In reading from buses and writing to them.
    pub bus: Duration,
    /// In what the caller does between cycles.
    pub between: Duration,
    /// From when the thread asked to be woken to when it ran.
    pub wake_up: Duration,
    /// Between two reads of the clock while it spun, the longest.
    pub gap: Duration,
}

impl Spent {
    /// Up to the end of a wait. What was spent before it counts if it left no time to sleep.
    pub fn waiting(awake: &Awake, before: Self) -> Self {
        let (gap, slept) = (awake.gap, awake.wake_up_latency());
        let of_wait = |wake_up| Self {
            wake_up,
            ..Self::default()
        };
        Self {
            gap,
            ..slept.map_or(before, of_wait)
        }
    }
}

/// What the kernel counted for one thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Page faults, with and without reading from a disk.
    pub faults: u64,
    /// Times that the CPU was taken from it for another thread.
    pub switches: u64,
    /// Time that it could have run while another thread did; `None` where the kernel does not say.
    pub delay: Option<Duration>,
}

impl Usage {
    /// Of the calling thread, since it began: one system call.
    #[expect(
        unsafe_code,
        reason = "getrusage has no safe wrapper among our dependencies"
    )]
    pub fn of_this_thread() -> Self {
        // SAFETY: a rusage is plain numbers, and `usage` is one for the call to fill.
        let usage = unsafe {
            let mut usage: libc::rusage = std::mem::zeroed();
            libc::getrusage(libc::RUSAGE_THREAD, &raw mut usage);
            usage
        };
        Self {
            faults: (usage.ru_minflt + usage.ru_majflt) as u64,
            switches: usage.ru_nivcsw as u64,
            delay: None,
        }
    }

    /// What was counted since `earlier`.
    pub fn since(self, earlier: Self) -> Self {
        Self {
            faults: self.faults.saturating_sub(earlier.faults),
            switches: self.switches.saturating_sub(earlier.switches),
            delay: self
                .delay
                .zip(earlier.delay)
                .map(|(delay, earlier)| delay.saturating_sub(earlier)),
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
        let [fault, switch] = [(1, 0), (0, 1)].map(|(faults, switches)| Usage {
            faults,
            switches,
            delay: None,
        });
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
            let awake = Awake {
                asked_at,
                wake_up,
                woken,
                at: woken + micros(gap),
                gap: micros(gap),
            };
            let before = Spent {
                own: micros(worked),
                ..Spent::default()
            };
            let spent = Spent::waiting(&awake, before);
            let found = Cause::of_cycle(micros(late), &spent, counted);
            assert_eq!(
                found, expected,
                "{late} {worked} {left} {latency} {gap} {counted:?}"
            );
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
            let spent = Spent {
                own,
                bus,
                between,
                wake_up,
                gap,
            };
            let delay = delay.map(micros);
            let counted = Usage {
                faults,
                switches,
                delay,
            };
            let found = Cause::of_cycle(micros(400), &spent, counted);
            assert_eq!(found, expected, "{spent:?} {counted:?}");
        }
    }

    #[test]
    fn a_touched_page_is_counted_as_a_fault() {
        let before = Usage::of_this_thread();
        let pages = 64 * 4096;
        // Fresh pages of the system's: too many for the allocator to have had.
        let mut memory = vec![0u8; 64 * pages];
        memory.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
        std::hint::black_box(&memory);
        assert!(Usage::of_this_thread().since(before).faults > 0);
    }
}
