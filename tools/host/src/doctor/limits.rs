//! Limits of the user of this process: scheduling priority and locked memory.

use mrroc::cell::{Policy, Realtime, Scheduler};
use servo::thread::{Denial, Grant, LIMITS, Limit};

use super::finding::{Finding, Verdict};
use super::fix::{Fix, Knob};
use super::kernel;
use super::tree::{Access, Tree, field};

const OF: &str = "limits";

/// Capabilities by their bit (`linux/capability.h`).
const CAP_DAC_OVERRIDE: u32 = 1;
const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;

/// Upper bound for the memory that a run locks, bytes: twice the 280 MB measured with one robot of six axes.
const LOCKED: u64 = 512 << 20;

/// User, groups and capabilities of this process.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Identity {
    uid: u32,
    /// Groups, the effective group first.
    groups: Vec<u32>,
    /// The effective capabilities.
    capabilities: u64,
}

impl Identity {
    pub(super) fn of(tree: &Tree) -> Self {
        Self::parse(&tree.text("/proc/self/status").unwrap_or_default())
    }

    fn parse(status: &str) -> Self {
        let words =
            |name| field(status, name).unwrap_or_default().split_whitespace().filter_map(|word| word.parse().ok());
        let effective = |name| words(name).nth(1);
        let capabilities = field(status, "CapEff").unwrap_or_default();
        Self {
            // The uid of the user "nobody", if the kernel does not report the uid.
            uid: effective("Uid").unwrap_or(65_534),
            groups: effective("Gid").into_iter().chain(words("Groups")).collect(),
            capabilities: u64::from_str_radix(capabilities, 16).unwrap_or(0),
        }
    }

    pub(super) fn is_root(&self) -> bool {
        self.uid == 0
    }

    fn can(&self, capability: u32) -> bool {
        self.capabilities >> capability & 1 == 1
    }

    /// Whether all permissions in `wanted` are granted, such as 0o6 for reading and writing. Access control lists are
    /// ignored.
    pub(super) fn may(&self, wanted: u32, access: Access) -> bool {
        let granted = if access.uid == self.uid {
            access.mode >> 6
        } else if self.groups.contains(&access.gid) {
            access.mode >> 3
        } else {
            access.mode
        };
        self.can(CAP_DAC_OVERRIDE) || granted & wanted == wanted
    }
}

/// Findings for a servo thread that runs under `realtime`. `tried` is the result of starting such a thread.
pub(super) fn findings(tree: &Tree, realtime: &Realtime, tried: Result<(), Denial>) -> Vec<Finding> {
    let identity = Identity::of(tree);
    let limits = tree.text("/proc/self/limits").unwrap_or_default();
    let beyond_limits = matches!(tried, Err(Denial::Deadline { .. } | Denial::FifoInGroup { .. }));
    let in_group = tried.is_err() && kernel::lacks_run_time(tree, false);
    let mut findings = vec![scheduling(&limits, &identity, realtime, tried)];
    if realtime.lock_memory {
        findings.push(memory(&limits, &identity, realtime.policy));
    }
    let denied = findings.iter_mut().skip(usize::from(beyond_limits)).filter(|finding| finding.mend.is_some());
    let fix = granting(tree, realtime);
    for finding in denied {
        match &fix {
            Some(fix) => finding.fixes = vec![fix.clone()],
            None => {
                let why = "to this user, who is not in it or was logged in before: `usermod -aG realtime USER`, then log \
                           in again";
                finding.mend = Some(format!("{LIMITS} grants it to group realtime and not {why}"));
            }
        }
    }
    if in_group
        && !beyond_limits
        && let Some(mend) = &mut findings[0].mend
    {
        *mend = format!(
            "see first the row \"real-time group scheduling\": in this control group, no limit and no capability grants it. \
             Then: {mend}"
        );
    }
    findings
}

/// Appends the lines that a cell needs to the file of limits; `None` if the file grants the limits already.
fn granting(tree: &Tree, realtime: &Realtime) -> Option<Fix> {
    let mut text = tree.whole(LIMITS).ok().flatten().unwrap_or_default();
    let limits = [Limit::Priority(realtime.priority), Limit::LockedMemory];
    let missing = limits.map(|limit| limit.to_string()).into_iter().filter(|line| !grants(&text, line));
    let missing: String = missing.map(|line| line + "\n").collect();
    if !text.is_empty() && !text.ends_with('\n') {
        text.push('\n');
    }
    (!missing.is_empty()).then(|| Knob::File(LIMITS.to_owned()).to(text + &missing))
}

/// Whether the file of limits `text` grants at least as much as `line`. The last line with the same domain, type and
/// item counts.
fn grants(text: &str, line: &str) -> bool {
    let (what, value) = line.rsplit_once(' ').unwrap_or((line, ""));
    let mut present = text.lines().rev().filter_map(|present| {
        let present = present.split('#').next().unwrap_or_default();
        let words: Vec<_> = present.split_whitespace().collect();
        let (value, present) = words.split_last()?;
        (present.join(" ") == what).then(|| amount(value))
    });
    present.next().flatten() >= amount(value)
}

/// Value of a limit; the greatest number if there is no limit.
fn amount(value: &str) -> Option<u64> {
    match value {
        "unlimited" | "infinity" | "-1" => Some(u64::MAX),
        number => number.parse().ok(),
    }
}

/// Soft limit in a line of `/proc/self/limits`.
fn soft_limit(limits: &str, name: &str) -> Option<u64> {
    amount(limits.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?)
}

fn told(limit: Option<u64>) -> String {
    match limit {
        None => "unknown".to_owned(),
        Some(u64::MAX) => "unlimited".to_owned(),
        Some(limit) => limit.to_string(),
    }
}

/// Verdict for a cell of this policy if the host denies real-time scheduling.
pub(super) fn denied(policy: Policy) -> Verdict {
    match policy {
        Policy::Require => Verdict::NotUsable,
        Policy::BestEffort => Verdict::Warning,
    }
}

fn scheduling(limits: &str, identity: &Identity, realtime: &Realtime, tried: Result<(), Denial>) -> Finding {
    let asked = match realtime.scheduler {
        Scheduler::Fifo => format!("SCHED_FIFO {}", realtime.priority),
        Scheduler::Deadline => "SCHED_DEADLINE".to_owned(),
    };
    let limit = told(soft_limit(limits, "Max realtime priority"));
    let capability = if identity.can(CAP_SYS_NICE) { ", CAP_SYS_NICE" } else { "" };
    let answer = if tried.is_ok() { "granted" } else { "denied" };
    let finding = Finding::new(
        OF,
        "rtprio",
        format!("{asked} {answer}; limit {limit}{capability}"),
        "under SCHED_OTHER every other program may delay a cycle, by tens of milliseconds on a busy host",
    );
    match tried {
        Ok(()) => finding,
        Err(denial @ Denial::FifoInGroup { .. }) => finding.judged(denied(realtime.policy), denial.to_string()),
        Err(denial) => finding.judged(denied(realtime.policy), format!("{denial}; in a container --cap-add SYS_NICE")),
    }
}

fn memory(limits: &str, identity: &Identity, policy: Policy) -> Finding {
    let limit = soft_limit(limits, "Max locked memory");
    let free = identity.can(CAP_IPC_LOCK);
    let capability = if free { ", CAP_IPC_LOCK" } else { "" };
    let finding = Finding::new(
        OF,
        "memlock",
        format!("{}{capability}", told(limit)),
        "memory that is not locked may be swapped out, and a page fault in a cycle takes milliseconds; locking counts \
         every page, stacks of later threads too",
    );
    let enough = free || limit.is_some_and(|limit| limit >= LOCKED);
    finding.judged(denied(policy).when(!enough), Grant(Limit::LockedMemory).to_string())
}

#[cfg(test)]
mod tests {
    use super::super::tests::Fake;
    use super::*;

    const OF_PROCESS: &str = "Limit                     Soft Limit           Hard Limit           Units     
Max locked memory         8388608              8388608              bytes     
Max realtime priority     0                    0                    
Max realtime timeout      unlimited            unlimited            us        ";

    fn identity(capabilities: u64) -> Identity {
        Identity { uid: 1000, groups: vec![1000, 20], capabilities }
    }

    #[test]
    fn who_asks_is_read_from_the_status() {
        let status = "Name:\tmrroc\nUid:\t0\t1000\t0\t0\nGid:\t0\t1000\t0\t0\nGroups:\t20 \nCapEff:\t0000000000804000";
        let parsed = Identity::parse(status);
        assert_eq!(parsed, identity(1 << CAP_SYS_NICE | 1 << CAP_IPC_LOCK));
        assert_eq!(Identity::parse("").uid, 65_534);
    }

    #[test]
    fn the_first_class_that_fits_decides_about_a_file() {
        let access = |mode, uid, gid| Access { mode, uid, gid };
        let table = [
            (0, access(0o20_660, 0, 20), true),
            (0, access(0o20_600, 0, 20), false),
            (0, access(0o20_660, 0, 5), false),
            (0, access(0o20_666, 0, 5), true),
            (0, access(0o20_640, 0, 20), false),
            // The permissions of others do not apply to the owner.
            (0, access(0o20_066, 1000, 5), false),
            (1 << CAP_DAC_OVERRIDE, access(0o20_600, 0, 0), true),
        ];
        for (capabilities, access, may) in table {
            assert_eq!(identity(capabilities).may(0o6, access), may, "{access:?}");
        }
    }

    #[test]
    fn what_is_denied_stops_a_cell_that_requires_it() {
        let realtime = |policy| Realtime { policy, ..Realtime::default() };
        let denial = Denial::Fifo { priority: 80, errno: 1 };
        let table = [
            (Policy::BestEffort, 0, Err(denial), [Verdict::Warning; 2]),
            (Policy::Require, 0, Err(denial), [Verdict::NotUsable; 2]),
            (Policy::Require, u64::MAX, Ok(()), [Verdict::Ok; 2]),
            (Policy::Require, 1 << CAP_IPC_LOCK, Err(denial), [Verdict::NotUsable, Verdict::Ok]),
        ];
        for (policy, capabilities, tried, verdicts) in table {
            let identity = identity(capabilities);
            let found = [
                scheduling(OF_PROCESS, &identity, &realtime(policy), tried).verdict,
                memory(OF_PROCESS, &identity, policy).verdict,
            ];
            assert_eq!(found, verdicts, "{policy:?} {capabilities:x}");
        }
    }

    #[test]
    fn the_file_of_limits_keeps_what_others_wrote() {
        let path = LIMITS.trim_start_matches('/');
        let ours = "@realtime - rtprio 80\n@realtime - memlock unlimited\n";
        let table = [
            (None, ours.to_owned()),
            (Some("# lab\n@realtime - nice -20"), format!("# lab\n@realtime - nice -20\n{ours}")),
            // A later line would lower the limit.
            (Some("@realtime - rtprio 99\n"), "@realtime - rtprio 99\n@realtime - memlock unlimited\n".to_owned()),
            (
                Some("@realtime - rtprio 99\n@realtime - memlock unlimited\n@realtime - rtprio 79\n"),
                "@realtime - rtprio 99\n@realtime - memlock unlimited\n@realtime - rtprio 79\n@realtime - rtprio 80\n"
                    .to_owned(),
            ),
            (Some("# @realtime - rtprio 99"), format!("# @realtime - rtprio 99\n{ours}")),
        ];
        for (before, after) in table {
            let files: Vec<_> = before.map(|text| (path, text)).into_iter().collect();
            let denial = Denial::Fifo { priority: 80, errno: 1 };
            let found = findings(&Fake::new(&files).tree(), &Realtime::default(), Err(denial));
            assert!(found[0].mend.as_ref().unwrap().starts_with(&denial.to_string()));
            for finding in found {
                let fix = Knob::File(LIMITS.to_owned()).to(after.as_str());
                assert_eq!(finding.fixes, [fix], "{before:?}");
            }
        }
    }

    #[test]
    fn who_is_granted_it_by_the_packages_file_is_told_of_the_group() {
        let path = LIMITS.trim_start_matches('/');
        let packaged = include_str!("../../../../packaging/limits.conf");
        let denial = Denial::Fifo { priority: 80, errno: 1 };
        let exact = "@realtime  -  rtprio\t80 # ours\n@realtime - memlock -1\n";
        for text in [packaged, exact] {
            let tree = Fake::new(&[(path, text)]);
            for finding in findings(&tree.tree(), &Realtime::default(), Err(denial)) {
                assert_eq!(finding.fixes, [], "{text}");
                let mend = finding.mend.unwrap();
                assert!(mend.contains("`usermod -aG realtime USER`, then log in again"), "{mend}");
            }
        }
    }

    #[test]
    fn no_limit_is_offered_in_a_group_without_real_time_run_time() {
        const VERSION_1: &[(&str, &str)] = &[
            ("proc/self/cgroup", "4:cpu,cpuacct:/lab\n0::/"),
            ("sys/fs/cgroup/cpu,cpuacct/lab/cpu.rt_runtime_us", "0"),
        ];
        const VERSION_2: &[(&str, &str)] = &[
            ("proc/self/cgroup", "0::/user.slice"),
            ("proc/sys/kernel/osrelease", "6.1.0"),
            ("boot/config-6.1.0", "CONFIG_RT_GROUP_SCHED=y"),
        ];
        const ROOT_GROUP: &[(&str, &str)] = &[("proc/self/cgroup", "0::/")];
        let permitted = Denial::FifoInGroup { priority: 80 };
        let not_permitted = Denial::Fifo { priority: 80, errno: 1 };
        for files in [VERSION_1, VERSION_2] {
            let found = findings(&Fake::new(files).tree(), &Realtime::default(), Err(permitted));
            let mend = found[0].mend.as_ref().unwrap();
            assert!(mend.contains("real-time group scheduling"), "{mend}");
            for useless in ["setcap", "usermod", "rtprio", "cap-add"] {
                assert!(!mend.contains(useless), "{mend}");
            }
            assert_eq!(found[0].fixes, []);
            assert_eq!(found[1].fixes.len(), 1);
            // Without the limit, both are needed, and the group comes first.
            let found = findings(&Fake::new(files).tree(), &Realtime::default(), Err(not_permitted));
            let mend = found[0].mend.as_ref().unwrap();
            assert!(mend.starts_with("see first the row \"real-time group scheduling\""), "{mend}");
            assert_eq!(found[0].fixes.len(), 1);
            assert!(findings(&Fake::new(files).tree(), &Realtime::default(), Ok(()))[0].mend.is_none());
        }
        let found = findings(&Fake::new(ROOT_GROUP).tree(), &Realtime::default(), Err(not_permitted));
        assert!(found[0].mend.as_ref().unwrap().starts_with(&not_permitted.to_string()));
    }

    #[test]
    fn no_limit_is_offered_for_a_denied_deadline() {
        let realtime = Realtime { scheduler: Scheduler::Deadline, ..Realtime::default() };
        let denial = Denial::Deadline {
            runtime: std::time::Duration::from_micros(900),
            period: std::time::Duration::from_millis(1),
            errno: 1,
        };
        let found = findings(&Fake::new(&[]).tree(), &realtime, Err(denial));
        assert!(found[0].read.starts_with("SCHED_DEADLINE denied"));
        assert!(found[0].mend.as_ref().unwrap().contains("setcap cap_sys_nice+ep"));
        assert_eq!(found[0].fixes, []);
        assert_eq!(found[1].fixes.len(), 1);
    }

    #[test]
    fn limits_are_told_as_they_are_set() {
        assert_eq!(soft_limit(OF_PROCESS, "Max locked memory"), Some(8_388_608));
        assert_eq!(soft_limit(OF_PROCESS, "Max realtime priority"), Some(0));
        assert_eq!(soft_limit(OF_PROCESS, "Max realtime timeout"), Some(u64::MAX));
        assert_eq!(soft_limit(OF_PROCESS, "Max open files"), None);
        for (limit, verdict) in
            [("unlimited", Verdict::Ok), ("1073741824", Verdict::Ok), ("67108864", Verdict::NotUsable)]
        {
            let limits = OF_PROCESS.replace("8388608", limit);
            let finding = memory(&limits, &identity(0), Policy::Require);
            assert_eq!((finding.verdict, &*finding.read), (verdict, limit));
        }
    }
}
