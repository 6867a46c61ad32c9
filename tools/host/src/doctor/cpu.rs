//! Processors: clock frequency, idle states, and other users of the CPU of the servo thread.

use std::collections::BTreeSet;

use mrroc::cell::{Policy, Realtime};
use mrroc::report::counted;
use servo::thread::Denial;

use super::finding::{Finding, Verdict};
use super::fix::Knob;
use super::limits::{Identity, denied};
use super::tree::{Tree, cpu_list, field};

const OF: &str = "cpu";
const CPUS: &str = "/sys/devices/system/cpu";

/// Error code for a file without access permission (errno(3)).
const EACCES: i32 = 13;

/// Longest exit latency of an idle state that a cycle of 1 ms tolerates, µs.
const BEARABLE_US: i64 = 20;

/// Findings for a servo thread that runs under `realtime`.
pub(super) fn findings(tree: &Tree, realtime: &Realtime) -> Vec<Finding> {
    let online = cpu_list(&tree.text(&format!("{CPUS}/online")).unwrap_or_default());
    let isolated = cpu_list(&tree.text(&format!("{CPUS}/isolated")).unwrap_or_default());
    let status = tree.text("/proc/self/status").unwrap_or_default();
    let allowed = cpu_list(field(&status, "Cpus_allowed_list").unwrap_or_default());
    let writable = tree.access("/dev/cpu_dma_latency").map(|access| Identity::of(tree).may(0o2, access));
    vec![
        governors(tree, &online),
        idle_states(&enabled(tree, &online)),
        cpu_latency(writable, realtime.policy),
        placement(realtime, &online, &isolated, &allowed),
    ]
}

fn governors(tree: &Tree, online: &BTreeSet<usize>) -> Finding {
    let files = online.iter().map(|cpu| format!("{CPUS}/cpu{cpu}/cpufreq/scaling_governor"));
    let files: Vec<_> = files.filter_map(|file| Some((tree.text(&file)?, file))).collect();
    let named: BTreeSet<_> = files.iter().map(|(governor, _)| governor.as_str()).collect();
    let named: Vec<_> = named.into_iter().collect();
    let slow = files.iter().filter(|(governor, _)| governor != "performance");
    let fixes: Vec<_> = slow.map(|(_, file)| Knob::Kernel(file.clone()).to("performance")).collect();
    Finding::new(
        OF,
        "governor",
        if named.is_empty() { "none: the kernel does not change the clock".to_owned() } else { named.join(", ") },
        "a processor that slowed down while it waited steps the next cycle at a fraction of its speed",
    )
    .judged(Verdict::Warning.when(!fixes.is_empty()), "cpupower frequency-set -g performance")
    .fixed_by(fixes)
}

/// An enabled idle state: its exit latency, µs, its name and its directory.
type IdleState = (i64, String, String);

fn enabled(tree: &Tree, online: &BTreeSet<usize>) -> Vec<IdleState> {
    let directories = online.iter().flat_map(|cpu| {
        let directory = format!("{CPUS}/cpu{cpu}/cpuidle");
        tree.names(&directory).into_iter().map(move |state| format!("{directory}/{state}"))
    });
    let enabled = directories.filter_map(|directory| {
        let disabled = tree.number(&format!("{directory}/disable"))? != 0;
        let latency = tree.number(&format!("{directory}/latency"))?;
        let name = tree.text(&format!("{directory}/name"))?;
        (!disabled).then_some((latency, name, directory))
    });
    enabled.collect()
}

/// Finding about `/dev/cpu_dma_latency`, which a servo thread holds open. `writable` says whether this user may write
/// the file. `None` means that the file does not exist, and that there are no deep idle states to avoid.
fn cpu_latency(writable: Option<bool>, policy: Policy) -> Finding {
    let read = match writable {
        None => "no /dev/cpu_dma_latency",
        Some(false) => "/dev/cpu_dma_latency is not this user's to write",
        Some(true) => "/dev/cpu_dma_latency is writable",
    };
    let why = "while a servo thread runs it keeps all processors from idle states that take time to leave";
    let mend = Denial::CpuLatency { errno: EACCES }.to_string();
    Finding::new(OF, "CPU latency", read, why).judged(denied(policy).when(writable == Some(false)), mend)
}

fn idle_states(enabled: &[IdleState]) -> Finding {
    let (latency, read) = match enabled.iter().max_by_key(|(latency, ..)| latency) {
        None => (0, "none".to_owned()),
        Some((latency, name, _)) => (*latency, format!("down to {name}, {latency} µs to leave")),
    };
    let deep = enabled.iter().filter(|(latency, ..)| *latency > BEARABLE_US);
    let fixes = deep.map(|(.., directory)| Knob::Kernel(format!("{directory}/disable")).to("1"));
    Finding::new(
        OF,
        "idle states",
        read,
        "a processor that sleeps deeply wakes late for the next cycle, by as much as the state takes to leave",
    )
    .judged(
        Verdict::Warning.when(latency > BEARABLE_US),
        format!(
            "cpupower idle-set -D {BEARABLE_US}; or processor.max_cstate=1 intel_idle.max_cstate=1 on the kernel's \
             command line"
        ),
    )
    .fixed_by(fixes)
}

fn placement(
    realtime: &Realtime,
    online: &BTreeSet<usize>,
    isolated: &BTreeSet<usize>,
    allowed: &BTreeSet<usize>,
) -> Finding {
    let list = |cpus: &BTreeSet<usize>| match &*cpus.iter().map(usize::to_string).collect::<Vec<_>>() {
        [] => "none".to_owned(),
        cpus => cpus.join(","),
    };
    let pinned = realtime.cpu;
    let servo = pinned.map_or("not pinned".to_owned(), |cpu| format!("on CPU {cpu}"));
    let finding = Finding::new(
        OF,
        "isolated CPUs",
        format!("online {}, isolated {}, servo thread {servo}", list(online), list(isolated)),
        "on an isolated CPU nothing but the servo thread runs; on any other it waits for the kernel's own work",
    );
    let (verdict, mend) = match pinned {
        Some(cpu) if !online.contains(&cpu) || !allowed.contains(&cpu) => {
            (denied(realtime.policy), format!("realtime.cpu in the cell: one of {}", list(allowed)))
        }
        Some(cpu) if !isolated.contains(&cpu) => {
            (Verdict::Warning, format!("isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu} on the kernel's command line"))
        }
        None if !isolated.is_empty() => (
            Verdict::Warning,
            format!("realtime.cpu in the cell: one of {}, which nobody uses otherwise", list(isolated)),
        ),
        None if online.len() < 2 => {
            (Verdict::Warning, "a second processor: everything else shares the servo's".to_owned())
        }
        _ => return finding,
    };
    finding.judged(verdict, mend)
}

/// Time that a hypervisor took from the processors of this virtual machine between two readings of `/proc/stat`.
pub(super) fn steal(cpuinfo: &str, before: &str, after: &str) -> Finding {
    let flags = field(cpuinfo, "flags").unwrap_or_default();
    let virtual_machine = flags.split_whitespace().any(|flag| flag == "hypervisor");
    let stolen = stolen_ticks(after).saturating_sub(stolen_ticks(before));
    let host = if virtual_machine { "virtual machine" } else { "no hypervisor" };
    Finding::new(
        OF,
        "steal time",
        format!(
            "{host}, {} of 10 ms stolen while this looked, {} since the boot",
            counted(stolen, "tick"),
            stolen_ticks(after)
        ),
        "a hypervisor stops the whole machine whenever it likes, and no setting inside can prevent that",
    )
    .judged(
        Verdict::Warning.when(virtual_machine || stolen > 0),
        "run arms from a real machine; here only emulated ones",
    )
}

/// The eighth number of the first line of `/proc/stat` (proc(5)), in ticks of 10 ms of all processors.
pub fn stolen_ticks(stat: &str) -> u64 {
    let mut words = stat.lines().next().unwrap_or_default().split_whitespace();
    words.nth(8).and_then(|word| word.parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use mrroc::cell::Policy;

    use super::super::finding::Verdict;
    use super::super::tests::Fake;
    use super::*;

    fn host(files: &[(&str, &str)]) -> Vec<Finding> {
        let fake = Fake::new(files);
        findings(&fake.tree(), &Realtime::default())
    }

    #[test]
    fn every_online_cpu_counts() {
        let quiet = "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor";
        let lazy = "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor";
        let online = "sys/devices/system/cpu/online";
        let table: [(&[_], _, _); 4] = [
            (&[(online, "0-1\n")], Verdict::Ok, "none: the kernel does not change the clock"),
            (
                &[(online, "0-1\n"), (quiet, "performance\n"), (lazy, "powersave\n")],
                Verdict::Warning,
                "performance, powersave",
            ),
            (&[(online, "0-1\n"), (quiet, "performance\n"), (lazy, "performance\n")], Verdict::Ok, "performance"),
            (&[(online, "0\n"), (quiet, "performance\n"), (lazy, "powersave\n")], Verdict::Ok, "performance"),
        ];
        for (files, verdict, read) in table {
            let finding = &host(files)[0];
            assert_eq!((finding.verdict, &*finding.read), (verdict, read));
            let fix = Knob::Kernel(format!("/{lazy}")).to("performance");
            let fix = (verdict == Verdict::Warning).then_some(fix);
            assert_eq!(finding.fixes, Vec::from_iter(fix));
        }
    }

    #[test]
    fn a_deep_idle_state_counts_unless_it_is_disabled() {
        let files = |disable| {
            [
                ("sys/devices/system/cpu/online", "0"),
                ("sys/devices/system/cpu/cpu0/cpuidle/state0/name", "POLL"),
                ("sys/devices/system/cpu/cpu0/cpuidle/state0/latency", "0"),
                ("sys/devices/system/cpu/cpu0/cpuidle/state0/disable", "0"),
                ("sys/devices/system/cpu/cpu0/cpuidle/state1/name", "C6"),
                ("sys/devices/system/cpu/cpu0/cpuidle/state1/latency", "133"),
                ("sys/devices/system/cpu/cpu0/cpuidle/state1/disable", disable),
            ]
        };
        let deep = &host(&files("0"))[1];
        assert_eq!(deep.verdict, Verdict::Warning);
        let disable = "/sys/devices/system/cpu/cpu0/cpuidle/state1/disable";
        assert_eq!(deep.fixes, [Knob::Kernel(disable.to_owned()).to("1")]);
        assert_eq!(deep.read, "down to C6, 133 µs to leave");
        assert_eq!(host(&files("1"))[1].verdict, Verdict::Ok);
    }

    #[test]
    fn a_latency_that_may_not_be_held_stops_a_cell_that_requires_it() {
        for (writable, policy, verdict) in [
            (None, Policy::Require, Verdict::Ok),
            (Some(true), Policy::Require, Verdict::Ok),
            (Some(false), Policy::BestEffort, Verdict::Warning),
            (Some(false), Policy::Require, Verdict::NotUsable),
        ] {
            let found = cpu_latency(writable, policy);
            assert_eq!(found.verdict, verdict, "{writable:?} {policy:?}");
            let rule = found.mend.unwrap_or_default();
            let names_rule = rule.contains("udev rule `KERNEL==\"cpu_dma_latency\"");
            assert_eq!(names_rule, verdict != Verdict::Ok, "{rule}");
        }
    }

    #[test]
    fn the_servo_thread_belongs_on_an_isolated_cpu_that_is_there() {
        let table = [
            (None, "0-3", "", Verdict::Ok),
            (None, "0", "", Verdict::Warning),
            (None, "0-3", "3", Verdict::Warning),
            (Some(3), "0-3", "3", Verdict::Ok),
            (Some(2), "0-3", "3", Verdict::Warning),
            (Some(4), "0-3", "3", Verdict::NotUsable),
        ];
        for (cpu, online, isolated, verdict) in table {
            let realtime = Realtime { cpu, policy: Policy::Require, ..Realtime::default() };
            let online = cpu_list(online);
            let finding = placement(&realtime, &online, &cpu_list(isolated), &online);
            assert_eq!(finding.verdict, verdict, "{}", finding.read);
        }
        let realtime = Realtime { cpu: Some(1), ..Realtime::default() };
        let (online, allowed) = (cpu_list("0-1"), cpu_list("0"));
        let finding = placement(&realtime, &online, &online, &allowed);
        assert_eq!(finding.verdict, Verdict::Warning, "not in its cgroup");
        assert!(finding.mend.unwrap().ends_with("one of 0"));
    }

    #[test]
    fn a_machine_that_loses_time_is_told() {
        let stat = |steal| format!("cpu  9 8 7 6 5 4 3 {steal} 0 0\ncpu0 1 1 1 1 1 1 1 77 0 0");
        let table = [
            ("flags\t\t: fpu vme", 4, 4, Verdict::Ok),
            ("flags\t\t: fpu vme", 4, 5, Verdict::Warning),
            ("flags\t\t: fpu hypervisor", 0, 0, Verdict::Warning),
        ];
        for (cpuinfo, before, after, verdict) in table {
            let finding = steal(cpuinfo, &stat(before), &stat(after));
            assert_eq!(finding.verdict, verdict);
            let told = counted(after - before, "tick");
            assert!(finding.read.contains(&told), "{}", finding.read);
        }
    }
}
