//! Table of the paths and values that `--fix` can set. A change outside the table is neither made nor put back.
//!
//! The record of changes is a file. Without the table, a forged record could name any path of the host and any text.

use servo::thread::{LIMITS, Limit};
use thiserror::Error;

use super::fix::{Knob, shown, timing};
use super::record::Change;
use super::tree::cpu_list;

/// Longest name of an interface or a tty, bytes (`IFNAMSIZ` less its end).
const LONGEST_NAME: usize = 15;

/// The values that a knob accepts.
#[derive(Clone, Copy)]
enum Takes {
    /// An integer of this range.
    Integer(i64, i64),
    Governor,
    Cpus,
    /// The file of limits: any text, to which lines are appended.
    Limits,
    BitTiming,
    UpOrDown,
}

/// The files of the kernel that `--fix` sets. A `%` stands for a number, a `*` for the name of an interface or tty.
const FILES: [(&str, Takes); 6] = [
    ("/proc/sys/kernel/sched_rt_runtime_us", Takes::Integer(-1, i32::MAX as i64)),
    ("/sys/devices/system/cpu/cpu%/cpufreq/scaling_governor", Takes::Governor),
    ("/sys/devices/system/cpu/cpu%/cpuidle/state%/disable", Takes::Integer(0, 1)),
    ("/proc/irq/%/smp_affinity_list", Takes::Cpus),
    ("/sys/class/net/*/tx_queue_len", Takes::Integer(0, u32::MAX as i64)),
    ("/sys/bus/usb-serial/devices/*/latency_timer", Takes::Integer(0, 255)),
];

/// Reason why `--fix` cannot have made a change.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub(super) enum Inadmissible {
    /// A path or interface that is not in the table.
    #[error("--fix does not set {0}")]
    Knob(Knob),
    /// A value before the change that the knob never has.
    #[error("--fix cannot have found {} in {knob}", shown(before.as_deref()))]
    Before { knob: Knob, before: Option<String> },
    #[error("--fix does not set {knob} to {}", shown(Some(after)))]
    After { knob: Knob, after: String },
}

impl Change {
    /// Refuses a change that `--fix` cannot have made.
    pub(super) fn check(&self) -> Result<(), Inadmissible> {
        let (knob, before) = (self.knob.clone(), self.before.clone());
        let Some(takes) = knob.takes() else {
            return Err(Inadmissible::Knob(knob));
        };
        let value = before.as_deref();
        if !value.map_or(takes.may_be_absent(), |value| takes.admits(value)) {
            return Err(Inadmissible::Before { knob, before });
        }
        let after = self.after.clone();
        let admitted = match takes {
            Takes::Limits => is_granted(value.unwrap_or_default(), &after),
            _ => takes.admits(&after),
        };
        match admitted {
            true => Ok(()),
            false => Err(Inadmissible::After { knob, after }),
        }
    }
}

impl Knob {
    /// The values that `--fix` sets in this knob; `None` if `--fix` does not set the knob.
    fn takes(&self) -> Option<Takes> {
        let card = |interface: &str, takes| is_name(interface).then_some(takes);
        match self {
            Self::Kernel(path) => FILES.iter().find(|(pattern, _)| matches(pattern, path)).map(|(_, takes)| *takes),
            Self::File(path) => (path == LIMITS).then_some(Takes::Limits),
            Self::BitTiming(interface) => card(interface, Takes::BitTiming),
            Self::RestartMs(interface) => card(interface, Takes::Integer(0, u32::MAX as i64)),
            Self::State(interface) => card(interface, Takes::UpOrDown),
        }
    }
}

impl Takes {
    /// Whether the knob may have had no value before.
    fn may_be_absent(self) -> bool {
        matches!(self, Self::Limits | Self::BitTiming)
    }

    fn admits(self, value: &str) -> bool {
        match self {
            Self::Integer(least, most) => value.parse().is_ok_and(|number| (least..=most).contains(&number)),
            Self::Governor => {
                let word = |byte: u8| byte.is_ascii_lowercase() || byte == b'_';
                (1..=LONGEST_NAME).contains(&value.len()) && value.bytes().all(word)
            }
            Self::Cpus => {
                let list = |byte: u8| byte.is_ascii_digit() || matches!(byte, b',' | b'-');
                value.bytes().all(list) && !cpu_list(value).is_empty()
            }
            Self::Limits => true,
            Self::BitTiming => timing(value).is_some_and(|(bitrate, _)| (1..=1_000_000).contains(&bitrate)),
            Self::UpOrDown => matches!(value, "up" | "down"),
        }
    }
}

/// Whether a path matches a pattern, component by component.
fn matches(pattern: &str, path: &str) -> bool {
    let (mut parts, mut given) = (pattern.split('/'), path.split('/'));
    loop {
        return match (parts.next(), given.next()) {
            (None, None) => true,
            (Some("*"), Some(name)) if is_name(name) => continue,
            (Some(part), Some(given)) if is_numbered(part, given) => continue,
            _ => false,
        };
    }
}

/// Whether a component of a path matches `pattern`, whose `%` stands for a number.
fn is_numbered(pattern: &str, part: &str) -> bool {
    match pattern.strip_suffix('%') {
        None => pattern != "*" && pattern == part,
        Some(name) => part.strip_prefix(name).is_some_and(|number| {
            (1..=LONGEST_NAME).contains(&number.len()) && number.bytes().all(|byte| byte.is_ascii_digit())
        }),
    }
}

/// Whether an interface or a tty may have this name. Path separators and control characters of a terminal are refused.
fn is_name(name: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-+@".contains(&byte);
    (1..=LONGEST_NAME).contains(&name.len()) && name.bytes().all(plain) && !matches!(name, "." | "..")
}

/// Whether the file of limits `after` is `before` with appended lines, each of which grants a limit.
fn is_granted(before: &str, after: &str) -> bool {
    let Some(added) = after.strip_prefix(before) else {
        return false;
    };
    let added = match before.is_empty() || before.ends_with('\n') {
        false => added.strip_prefix('\n'),
        true => Some(added),
    };
    let grants = |line: &str| {
        let mut limits = (1..=99).map(Limit::Priority).chain([Limit::LockedMemory]);
        limits.any(|limit| limit.to_string() == line)
    };
    added.is_some_and(|added| added.ends_with('\n') && added.lines().all(grants))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kernel(path: &str) -> Knob {
        Knob::Kernel(path.to_owned())
    }

    #[track_caller]
    fn check(admissible: bool, table: impl IntoIterator<Item = (Knob, Option<&'static str>, &'static str)>) {
        for (knob, before, after) in table {
            let change = Change { knob, before: before.map(str::to_owned), after: after.to_owned() };
            assert_eq!(change.check().is_ok(), admissible, "{change:?}");
        }
    }

    #[test]
    fn what_a_fix_sets_is_admissible() {
        let can0 = || "can0".to_owned();
        let limits = || Knob::File(LIMITS.to_owned());
        check(
            true,
            [
                (kernel("/proc/sys/kernel/sched_rt_runtime_us"), Some("0"), "950000"),
                (kernel("/proc/sys/kernel/sched_rt_runtime_us"), Some("-1"), "950000"),
                (kernel("/sys/devices/system/cpu/cpu11/cpufreq/scaling_governor"), Some("schedutil"), "performance"),
                (kernel("/sys/devices/system/cpu/cpu0/cpuidle/state2/disable"), Some("0"), "1"),
                (kernel("/proc/irq/130/smp_affinity_list"), Some("3"), "0-2,4"),
                (kernel("/sys/class/net/can0/tx_queue_len"), Some("10"), "128"),
                (kernel("/sys/class/net/vcan-arm.1/tx_queue_len"), Some("10"), "128"),
                (kernel("/sys/bus/usb-serial/devices/ttyUSB0/latency_timer"), Some("16"), "1"),
                (limits(), None, "@realtime - rtprio 80\n@realtime - memlock unlimited\n"),
                (limits(), Some("# ours"), "# ours\n@realtime - rtprio 80\n"),
                (limits(), Some("# ours\n"), "# ours\n@realtime - memlock unlimited\n"),
                (Knob::BitTiming(can0()), None, "500000 0.875"),
                (Knob::BitTiming(can0()), Some("125000 0.000"), "1000000"),
                (Knob::RestartMs(can0()), Some("0"), "100"),
                (Knob::State(can0()), Some("down"), "up"),
            ],
        );
    }

    #[test]
    fn other_paths_are_not_admissible() {
        let paths = [
            "",
            "/",
            "/etc/passwd",
            "/proc/sys/kernel/core_pattern",
            "/proc/sys/kernel/sched_rt_runtime_us/..",
            "proc/sys/kernel/sched_rt_runtime_us",
            "//proc/sys/kernel/sched_rt_runtime_us",
            "/sys/class/net/../tx_queue_len",
            "/sys/class/net/can0/../../../etc/tx_queue_len",
            "/sys/class/net//tx_queue_len",
            "/sys/class/net/*/tx_queue_len",
            "/sys/class/net/can0/address",
            "/sys/class/net/can0\u{1b}[2J/tx_queue_len",
            "/sys/devices/system/cpu/cpu/cpufreq/scaling_governor",
            "/sys/devices/system/cpu/cpu%/cpufreq/scaling_governor",
            "/sys/devices/system/cpu/cpu0x/cpufreq/scaling_governor",
            "/sys/devices/system/cpu/cpu0/cpuidle/state1/../disable",
        ];
        check(false, paths.map(|path| (kernel(path), Some("0"), "1")));
        let grant = "@realtime - rtprio 80\n";
        for path in ["/etc/cron.d/mrroc", "/etc/security/limits.d/../../passwd", ""] {
            check(false, [(Knob::File(path.to_owned()), None, grant)]);
        }
        for name in ["", "..", "a/b", "can\u{1b}[2J", "sixteen-letters-x", "a b", "can\u{9b}0"] {
            check(
                false,
                [
                    (Knob::State(name.to_owned()), Some("down"), "up"),
                    (Knob::BitTiming(name.to_owned()), None, "500000"),
                    (Knob::RestartMs(name.to_owned()), Some("0"), "100"),
                ],
            );
        }
    }

    #[test]
    fn other_values_are_not_admissible() {
        let runtime = || kernel("/proc/sys/kernel/sched_rt_runtime_us");
        let governor = || kernel("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
        let irq = || kernel("/proc/irq/1/smp_affinity_list");
        let limits = || Knob::File(LIMITS.to_owned());
        let can0 = || "can0".to_owned();
        check(
            false,
            [
                (runtime(), None, "950000"),
                (runtime(), Some("0"), "-2"),
                (runtime(), Some("0\n1"), "950000"),
                (runtime(), Some("all"), "950000"),
                (governor(), Some("schedutil"), "userspace speed"),
                (governor(), Some(""), "performance"),
                (governor(), Some("\u{1b}c"), "performance"),
                (irq(), Some("0-1;"), "0"),
                (irq(), Some("0"), ","),
                (limits(), None, "root - nproc 1\n"),
                (limits(), Some("# ours\n"), "@realtime - rtprio 80\n"),
                (limits(), Some("# ours\n"), "# ours\n* - rtprio 80\n"),
                (limits(), Some("# ours"), "# ours@realtime - rtprio 80\n"),
                (limits(), Some("# ours\n"), "# ours\n"),
                (limits(), None, "@realtime - rtprio 100\n"),
                (Knob::BitTiming(can0()), None, "500000 1.5"),
                (Knob::BitTiming(can0()), None, "500000 0.5 0.5"),
                (Knob::BitTiming(can0()), Some("fast"), "500000"),
                (Knob::BitTiming(can0()), None, "0"),
                (Knob::RestartMs(can0()), None, "100"),
                (Knob::RestartMs(can0()), Some("0"), "-1"),
                (Knob::State(can0()), Some("sideways"), "up"),
                (Knob::State(can0()), None, "up"),
            ],
        );
    }
}
