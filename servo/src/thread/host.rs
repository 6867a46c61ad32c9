//! Real-time settings of the host that a thread requests, and the requests that the host denied.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::hint;
use std::io::{self, Write};
use std::time::Duration;

use thiserror::Error;
use thread_priority::{
    DeadlineFlags, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use super::realtime::{Realtime, Scheduler};
use super::wait::BUSY_SHARE;

/// Bytes of the stack touched before the first cycle.
const PREFAULTED: usize = 128 * 1024;

/// Keeps all CPUs out of idle states with an exit latency, as long as the value exists.
#[derive(Debug)]
pub struct CpuLatency(#[expect(dead_code, reason = "the request lasts as long as the file is open")] File);

impl CpuLatency {
    /// Requests a latency of 0 µs from the kernel's power management; usually granted to root only.
    pub fn hold() -> io::Result<Self> {
        let mut file = OpenOptions::new().write(true).open("/dev/cpu_dma_latency")?;
        file.write_all(&0i32.to_ne_bytes())?;
        Ok(Self(file))
    }

    /// The same for a running servo. A kernel without the file has no such idle states.
    pub(super) fn demand() -> Result<Option<Self>, Denial> {
        match Self::hold() {
            Ok(held) => Ok(Some(held)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(Denial::CpuLatency { errno: error.raw_os_error().unwrap_or(0) }),
        }
    }
}

/// The file for the lines that grant a [`Limit`].
pub const LIMITS: &str = "/etc/security/limits.d/mrroc.conf";

/// A line of [`LIMITS`], which grants a limit to the members of group realtime (limits.conf(5)). `Display` writes the
/// line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Limit {
    /// SCHED_FIFO up to this priority.
    #[error("@realtime - rtprio {0}")]
    Priority(u8),
    /// Locking all memory.
    #[error("@realtime - memlock unlimited")]
    LockedMemory,
}

/// The program of the package. The units of the package grant no capability, and therefore could not start a program
/// with a capability.
const PACKAGED: &str = "/usr/bin/mrroc";

/// Instructions for granting a [`Limit`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grant(pub Limit);

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let capability = match self.0 {
            Limit::Priority(_) => "cap_sys_nice",
            Limit::LockedMemory => "cap_ipc_lock",
        };
        write!(
            f,
            "grant it with the line `{}` in {LIMITS}, the user in group realtime and a new login, or, for a \
             program of your own and never for the packaged {PACKAGED}, with `setcap {capability}+ep`",
            self.0
        )
    }
}

/// Instructions for granting SCHED_DEADLINE, where `.0` is the kernel's error (sched(7), sched_setattr(2)).
struct DeadlineGrant(i32);

impl fmt::Display for DeadlineGrant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            libc::EPERM => {
                "no line of limits grants it: CAP_SYS_NICE does, in a unit by AmbientCapabilities= and \
                 CapabilityBoundingSet=, on a program of your own and never on the packaged /usr/bin/mrroc by \
                 `setcap cap_sys_nice+ep`; with all CPUs in its affinity, so without `taskset`"
            }
            libc::EBUSY => "other deadline threads have reserved the time of the CPUs; end one of them",
            libc::EINVAL => "the period must be within /proc/sys/kernel/sched_deadline_period_min_us and _max_us",
            _ => "the kernel must have it, and a seccomp filter must not deny sched_setattr",
        })
    }
}

/// A request denied by the host, with instructions for granting it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "every field is in the message")]
pub enum Denial {
    /// SCHED_FIFO; `EINVAL` for a priority that does not exist.
    #[error(
        "SCHED_FIFO priority {priority} was denied (errno {errno}); {}",
        Grant(Limit::Priority(*priority))
    )]
    Fifo { priority: u8, errno: i32 },
    /// SCHED_FIFO with `EPERM`, although limits and capabilities of the process permit this priority.
    #[error(
        "SCHED_FIFO priority {priority} was denied (errno 1), although limits or capabilities of this process permit it: \
         neither helps in a control group without real-time run time (CONFIG_RT_GROUP_SCHED), nor does a capability of a \
         user namespace; row \"real-time group scheduling\" of `mrroc doctor` says how to leave the group"
    )]
    FifoInGroup { priority: u8 },
    /// SCHED_DEADLINE; `EPERM` without CAP_SYS_NICE or with less than all CPUs, `EBUSY` if other deadline threads leave
    /// too little time.
    #[error(
        "SCHED_DEADLINE with {runtime:?} of each {period:?} was denied (errno {errno}); {}",
        DeadlineGrant(*errno)
    )]
    Deadline { runtime: Duration, period: Duration, errno: i32 },
    /// `mlockall`.
    #[error("locking memory was denied (errno {errno}); {}", Grant(Limit::LockedMemory))]
    LockMemory { errno: i32 },
    /// `sched_setaffinity`.
    #[error(
        "CPU {cpu} was denied (errno {errno}); /sys/devices/system/cpu/online and the cgroup's \
         cpuset.cpus list the ones there are"
    )]
    Cpu { cpu: usize, errno: i32 },
    /// `prctl(PR_SET_TIMERSLACK)`.
    #[error("a timer slack of 1 ns was denied (errno {errno}); no privilege is needed, so a seccomp filter denies it")]
    TimerSlack { errno: i32 },
    /// `/dev/cpu_dma_latency`.
    #[error(
        "a CPU latency of 0 µs was denied (errno {errno}); grant it with the udev rule \
         `KERNEL==\"cpu_dma_latency\", GROUP=\"realtime\", MODE=\"0660\"` in /etc/udev/rules.d/99-realtime.rules"
    )]
    CpuLatency { errno: i32 },
}

/// Asks the host for the real-time needs of the calling thread, whose cycles take `period`; returns what it denied.
pub fn demand(realtime: &Realtime, period: Duration) -> Vec<Denial> {
    let mut denied = Vec::new();
    denied.extend(set_timer_slack().err());
    denied.extend(realtime.cpu.and_then(|cpu| stay_on(cpu).err()));
    if realtime.lock_memory {
        denied.extend(lock_memory().err());
    }
    prefault_stack();
    let scheduled = match realtime.scheduler {
        Scheduler::Fifo => set_fifo(realtime.priority),
        Scheduler::Deadline => set_deadline(period),
    };
    denied.extend(scheduled.err());
    denied
}

/// Puts the calling thread under SCHED_DEADLINE. The budget of each `period` is the permitted time of work and spin
/// together. Threads and processes started by this thread do not inherit the policy.
pub fn set_deadline(period: Duration) -> Result<(), Denial> {
    let runtime = period.mul_f64(BUSY_SHARE);
    let priority = ThreadPriority::Deadline {
        runtime,
        deadline: period,
        period,
        // Without this flag, the kernel does not let a deadline thread start other threads.
        flags: DeadlineFlags::RESET_ON_FORK,
    };
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Deadline);
    // The crate takes the kernel's thread ID here, where 0 is this thread, and leaves the error in errno.
    set_thread_priority_and_policy(0, priority, policy).map_err(|_| Denial::Deadline {
        runtime,
        period,
        errno: io::Error::last_os_error().raw_os_error().unwrap_or(0),
    })
}

/// Puts the calling thread under SCHED_FIFO at this priority. This function is for threads that the servo needs, such
/// as the controller's, each at a lower priority than the servo.
pub fn set_fifo(priority: u8) -> Result<(), Denial> {
    let denial = |errno| {
        let text = |path| fs::read_to_string(path).unwrap_or_default();
        fifo_denial(priority, errno, &text("/proc/self/limits"), &text("/proc/thread-self/status"))
    };
    let value = ThreadPriorityValue::try_from(priority).map_err(|_| denial(libc::EINVAL))?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let priority = ThreadPriority::Crossplatform(value);
    set_thread_priority_and_policy(thread_native_id(), priority, policy).map_err(|error| {
        denial(match error {
            thread_priority::Error::OS(errno) => errno,
            _ => libc::EINVAL,
        })
    })?;
    reset_on_fork(value.into()).map_err(denial)
}

/// Bit of CAP_SYS_NICE in a set of capabilities (`linux/capability.h`).
const CAP_SYS_NICE: u32 = 23;

/// The denial of SCHED_FIFO to a process with these texts of `/proc/self/limits` and `/proc/self/status`. In a control
/// group without real-time run time, the kernel also denies a priority that limits and capabilities permit (sched(7)).
fn fifo_denial(priority: u8, errno: i32, limits: &str, status: &str) -> Denial {
    let field = |text: &str, name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        line.and_then(|line| line.split_whitespace().next()).map(str::to_owned)
    };
    let is_within = |limit: String| limit == "unlimited" || limit.parse().is_ok_and(|limit: u8| limit >= priority);
    let limit = field(limits, "Max realtime priority").is_some_and(is_within);
    let capabilities = field(status, "CapEff:").and_then(|set| u64::from_str_radix(&set, 16).ok());
    let capability = capabilities.is_some_and(|set| set >> CAP_SYS_NICE & 1 == 1);
    match (limit || capability) && errno == libc::EPERM {
        true => Denial::FifoInGroup { priority },
        false => Denial::Fifo { priority, errno },
    }
}

/// Keeps threads and processes started by this thread from inheriting SCHED_FIFO.
#[expect(unsafe_code, reason = "sched_setscheduler has no safe wrapper among our dependencies")]
fn reset_on_fork(priority: u8) -> Result<(), i32> {
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    let param = libc::sched_param { sched_priority: priority.into() };
    // SAFETY: 0 means this thread, and `param` outlives the call. The function of libc may refuse the flag.
    let result = unsafe { libc::syscall(libc::SYS_sched_setscheduler, 0, policy, &raw const param) };
    check(result as libc::c_int)
}

#[expect(unsafe_code, reason = "mlockall has no safe wrapper among our dependencies")]
fn lock_memory() -> Result<(), Denial> {
    // SAFETY: the call changes where pages are kept, not their content.
    let result = unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) };
    check(result).map_err(|errno| Denial::LockMemory { errno })
}

#[expect(unsafe_code, reason = "sched_setaffinity has no safe wrapper among our dependencies")]
fn stay_on(cpu: usize) -> Result<(), Denial> {
    if cpu >= libc::CPU_SETSIZE as usize {
        return Err(Denial::Cpu { cpu, errno: libc::EINVAL });
    }
    // SAFETY: a cpu_set_t consists of plain bits, `cpu` is below its size, and 0 means this thread.
    let result = unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::CPU_SET(cpu, &mut set);
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set)
    };
    check(result).map_err(|errno| Denial::Cpu { cpu, errno })
}

#[expect(unsafe_code, reason = "prctl has no safe wrapper among our dependencies")]
fn set_timer_slack() -> Result<(), Denial> {
    // SAFETY: this operation takes one number and touches no memory.
    let result = unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1 as libc::c_ulong) };
    check(result).map_err(|errno| Denial::TimerSlack { errno })
}

fn check(result: libc::c_int) -> Result<(), i32> {
    if result == 0 {
        return Ok(());
    }
    Err(io::Error::last_os_error().raw_os_error().unwrap_or(0))
}

/// Touches the stack that cycles will use, so that no page fault occurs later.
#[inline(never)]
fn prefault_stack() {
    hint::black_box(&mut [0u8; PREFAULTED]);
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_LIMIT: &str = "Max file locks            unlimited            unlimited            locks     \n\
        Max realtime priority     0                    0                    \n";
    const ROOT: &str = "Name:\tmrroc\nCapPrm:\t000001ffffffffff\nCapEff:\t000001ffffffffff\n";
    const USER: &str = "Name:\tmrroc\nCapPrm:\t0000000000000000\nCapEff:\t0000000000000000\n";

    #[test]
    fn a_limit_is_no_remedy_where_limits_and_capabilities_permit_the_priority_already() {
        let granted = NO_LIMIT.replace("priority     0 ", "priority     80");
        let unlimited = NO_LIMIT.replace("priority     0        ", "priority     unlimited");
        let (priority, eperm) = (80, libc::EPERM);
        let table = [
            (NO_LIMIT, USER, eperm, false),
            (NO_LIMIT, ROOT, eperm, true),
            (granted.as_str(), USER, eperm, true),
            (&unlimited, USER, eperm, true),
            (&granted.replace("80", "79"), USER, eperm, false),
            // A priority that does not exist.
            (NO_LIMIT, ROOT, libc::EINVAL, false),
            ("", "", eperm, false),
        ];
        for (limits, status, errno, in_group) in table {
            let denial = fifo_denial(priority, errno, limits, status);
            let expected = if in_group { Denial::FifoInGroup { priority } } else { Denial::Fifo { priority, errno } };
            assert_eq!(denial, expected, "{limits} {status}");
            let said = denial.to_string();
            assert_eq!(said.contains("real-time group scheduling"), in_group, "{said}");
            assert_eq!(said.contains("setcap") || said.contains("rtprio"), !in_group, "{said}");
        }
    }

    #[test]
    fn no_capability_is_advised_for_the_packaged_program() {
        let (runtime, period) = (Duration::from_micros(900), Duration::from_millis(1));
        for denial in [
            Denial::Fifo { priority: 80, errno: libc::EPERM },
            Denial::LockMemory { errno: libc::ENOMEM },
            Denial::Deadline { runtime, period, errno: libc::EPERM },
        ] {
            let said = denial.to_string();
            assert!(said.contains("never") && said.contains("the packaged /usr/bin/mrroc"), "{said}");
        }
    }
}
