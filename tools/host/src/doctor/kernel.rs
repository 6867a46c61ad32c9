//! Kernel: preemption of running threads, and limits on the run time of real-time threads.

use super::finding::{Finding, Verdict};
use super::fix::Knob;
use super::tree::Tree;

const OF: &str = "kernel";

const RUNTIME: &str = "/proc/sys/kernel/sched_rt_runtime_us";

/// Findings for a servo with period `period_us`, which is `None` without a cell file. `fifo` says whether SCHED_FIFO
/// was granted.
pub(super) fn findings(tree: &Tree, period_us: Option<u32>, fifo: bool) -> Vec<Finding> {
    let config = tree.kernel_config();
    let config = config.as_deref();
    let version = tree.text("/proc/version").unwrap_or_default();
    let realtime = tree.text("/sys/kernel/realtime").as_deref() == Some("1");
    let mut findings = vec![preemption(&version, realtime), timers(config, period_us)];
    findings.extend(throttling(tree.number(RUNTIME), tree.number("/proc/sys/kernel/sched_rt_period_us")));
    findings.push(Group::of(tree, fifo).finding(config));
    findings
}

/// Whether the control group of this process has no real-time run time, as far as the host tells.
pub(super) fn lacks_run_time(tree: &Tree, fifo: bool) -> bool {
    Group::of(tree, fifo).lacks_run_time(tree.kernel_config().as_deref())
}

fn preemption(version: &str, realtime: bool) -> Finding {
    let model = version.split_whitespace().find(|word| word.starts_with("PREEMPT")).unwrap_or("no preemption");
    let release = version.split_whitespace().nth(2).unwrap_or("unknown");
    Finding::new(
        OF,
        "preemption",
        format!("{release}, {model}"),
        "only PREEMPT_RT lets the servo thread interrupt the kernel itself; without it drivers and disk writes delay \
         a cycle by milliseconds now and then",
    )
    .judged(
        Verdict::Warning.when(!realtime && model != "PREEMPT_RT"),
        "apt-get install linux-image-rt-amd64, then boot it",
    )
}

/// Value of an option in the configuration of the kernel; `None` if the option is not set.
fn option<'a>(config: &'a str, name: &str) -> Option<&'a str> {
    config.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='))
}

fn timers(config: Option<&str>, period_us: Option<u32>) -> Finding {
    let why = "without high-resolution timers a sleep ends at a tick, 1/HZ apart; with them HZ rounds time-outs of \
               sockets only";
    let finding = |read| Finding::new(OF, "timers", read, why);
    let Some(config) = config else {
        return finding("the kernel does not tell its configuration".to_owned())
            .judged(Verdict::Warning, "read HZ and HIGH_RES_TIMERS where the kernel was built");
    };
    let hz: Option<u32> = option(config, "CONFIG_HZ").and_then(|hz| hz.parse().ok());
    let fine = option(config, "CONFIG_HIGH_RES_TIMERS") == Some("y");
    let resolution = if fine { "high" } else { "tick" };
    let told = hz.map_or("unknown".to_owned(), |hz| hz.to_string());
    let tick_us = hz.filter(|&hz| hz > 0).map(|hz| 1_000_000 / hz);
    let mend = "boot a kernel with CONFIG_HIGH_RES_TIMERS=y, as Debian's are; remove highres=off from its command line";
    let verdict = match (fine, tick_us, period_us) {
        (true, ..) => Verdict::Ok,
        (false, Some(tick), Some(period)) if tick <= period / 10 => Verdict::Warning,
        (false, _, Some(_)) => Verdict::NotUsable,
        (false, _, None) => Verdict::Warning,
    };
    finding(format!("HZ {told}, {resolution} resolution")).judged(verdict, mend)
}

fn throttling(runtime_us: Option<i64>, period_us: Option<i64>) -> Option<Finding> {
    let (runtime, period) = (runtime_us?, period_us?);
    let finding = Finding::new(
        OF,
        "real-time throttling",
        format!("{runtime} of {period} µs"),
        "real-time threads are stopped for the rest of each such time once they have used their share; a servo that \
         waits between its cycles stays far below the usual 95 %",
    );
    let usual = period / 100 * 95;
    let mend = format!("sysctl -w kernel.sched_rt_runtime_us={usual}");
    let fix = Knob::Kernel(RUNTIME.to_owned()).to(usual.to_string());
    let verdict = match runtime {
        0 => Verdict::NotUsable,
        1.. => Verdict::Warning.when(runtime.saturating_mul(10) < period.saturating_mul(9)),
        _ => Verdict::Ok,
    };
    Some(finding.judged(verdict, mend).fixed_by([fix]))
}

/// Control group of this process under the CPU controller of cgroup version 1.
fn cpu_group(groups: &str) -> Option<&str> {
    groups.lines().find_map(|line| {
        let mut parts = line.splitn(3, ':');
        let controllers = parts.nth(1)?;
        let group = parts.next()?;
        controllers.split(',').any(|controller| controller == "cpu").then_some(group)
    })
}

/// Control group of this process, as far as it decides about SCHED_FIFO.
#[derive(Default)]
struct Group {
    /// Group under the CPU controller of cgroup version 1.
    group: Option<String>,
    /// File of its real-time run time, and the run time, µs.
    runtime: Option<(String, i64)>,
    /// Group of cgroup version 2 of a process that was denied SCHED_FIFO. Version 2 grants real-time run time to its root
    /// group only.
    unified: Option<String>,
}

impl Group {
    fn of(tree: &Tree, fifo: bool) -> Self {
        let groups = tree.text("/proc/self/cgroup").unwrap_or_default();
        let group = cpu_group(&groups);
        let runtime = group.and_then(|group| {
            let files = ["cpu", "cpu,cpuacct", "cpuacct,cpu"].map(|controller| {
                format!("/sys/fs/cgroup/{controller}{}/cpu.rt_runtime_us", group.trim_end_matches('/'))
            });
            files.into_iter().find_map(|file| tree.number(&file).map(|runtime| (file, runtime)))
        });
        // The single hierarchy of cgroup version 2 has number 0 and no controllers.
        let unified = groups.lines().find_map(|line| line.strip_prefix("0::"));
        let unified = unified.filter(|&group| group != "/" && !fifo);
        Self { group: group.map(str::to_owned), runtime, unified: unified.map(str::to_owned) }
    }

    /// The group of version 2 without real-time run time, in a kernel that groups real-time threads.
    fn unified(&self, config: Option<&str>) -> Option<&str> {
        self.unified.as_deref().filter(|_| is_built(config) && self.group.is_none())
    }

    fn lacks_run_time(&self, config: Option<&str>) -> bool {
        matches!(self.runtime, Some((_, 0))) || self.unified(config).is_some()
    }

    fn finding(&self, config: Option<&str>) -> Finding {
        let unified = self.unified(config);
        let read = match (is_built(config), self.group.as_deref().or(unified), &self.runtime) {
            (_, Some(group), Some((_, runtime))) => format!("group {group} has {runtime} µs"),
            (true, Some(group), None) => format!("built in, group {group}"),
            (true, None, None) => "built in, no group of the CPU controller".to_owned(),
            _ => "not in use".to_owned(),
        };
        let finding = Finding::new(
            OF,
            "real-time group scheduling",
            read,
            "a control group without real-time run time is denied SCHED_FIFO, whatever the limits say",
        );
        if unified.is_some() {
            return finding.judged(
                Verdict::Warning,
                "echo $$ > /sys/fs/cgroup/cgroup.procs before the start, as root; or a kernel without \
                 CONFIG_RT_GROUP_SCHED, as Debian's are",
            );
        }
        let Some((file, 0)) = &self.runtime else {
            return finding;
        };
        let mend = format!("echo 800000 > {file}, its parents first; or start from the root group");
        finding.judged(Verdict::NotUsable, mend)
    }
}

/// Whether the kernel groups real-time threads.
fn is_built(config: Option<&str>) -> bool {
    config.and_then(|config| option(config, "CONFIG_RT_GROUP_SCHED")) == Some("y")
}

#[cfg(test)]
mod tests {
    use super::super::finding::Verdict::{self, NotUsable, Ok, Warning};
    use super::*;

    const RT: &str = "Linux version 6.1.0-56-rt-amd64 (debian-kernel@lists.debian.org) #1 SMP PREEMPT_RT Debian";

    #[test]
    fn only_a_preempt_rt_kernel_is_without_a_warning() {
        let dynamic = "Linux version 6.1.0-56-amd64 (x) #1 SMP PREEMPT_DYNAMIC Debian";
        let table = [
            (RT, false, Ok, "6.1.0-56-rt-amd64, PREEMPT_RT"),
            (dynamic, false, Warning, "6.1.0-56-amd64, PREEMPT_DYNAMIC"),
            ("Linux version 6.1.176 (x) #1", false, Warning, "6.1.176, no preemption"),
            ("Linux version 4.19.0 (x) #1 SMP PREEMPT RT", true, Ok, "4.19.0, PREEMPT"),
            ("", false, Warning, "unknown, no preemption"),
        ];
        for (version, realtime, verdict, read) in table {
            let finding = preemption(version, realtime);
            assert_eq!((finding.verdict, &*finding.read), (verdict, read));
        }
    }

    #[test]
    fn a_kernel_that_sleeps_to_ticks_suits_no_short_period() {
        let fine = "CONFIG_HIGH_RES_TIMERS=y\nCONFIG_HZ_250=y\nCONFIG_HZ=250";
        let coarse = "# CONFIG_HIGH_RES_TIMERS is not set\nCONFIG_HZ=1000";
        let table = [
            (Some(fine), Some(1000), Ok),
            (Some(coarse), Some(2000), NotUsable),
            (Some(coarse), Some(10_000), Warning),
            (Some(coarse), None, Warning),
            (Some(""), Some(1000), NotUsable),
            (None, Some(1000), Warning),
        ];
        for (config, period, verdict) in table {
            assert_eq!(timers(config, period).verdict, verdict, "{config:?} {period:?}");
        }
        assert_eq!(timers(Some(fine), None).read, "HZ 250, high resolution");
    }

    #[test]
    fn a_small_share_for_real_time_threads_is_seen() {
        let table = [
            (Some(950_000), Some(1_000_000), Some(Ok)),
            (Some(-1), Some(1_000_000), Some(Ok)),
            (Some(500_000), Some(1_000_000), Some(Warning)),
            (Some(0), Some(1_000_000), Some(NotUsable)),
            (None, Some(1_000_000), None),
        ];
        for (runtime, period, verdict) in table {
            let found = throttling(runtime, period);
            let fixes = found.iter().flat_map(|finding| &finding.fixes);
            let fix = Knob::Kernel(RUNTIME.to_owned()).to("950000");
            let mendable = verdict.is_some_and(|verdict| verdict != Ok);
            assert!(fixes.eq(mendable.then_some(&fix)), "{runtime:?}");
            assert_eq!(found.map(|finding| finding.verdict), verdict, "{runtime:?}");
        }
    }

    #[test]
    fn a_group_without_real_time_run_time_is_not_usable() {
        let built = Some("CONFIG_RT_GROUP_SCHED=y");
        let table: [(_, _, _, Verdict, &str); 4] = [
            (built, Some("/lab"), Some(0), NotUsable, "group /lab has 0 µs"),
            (built, Some("/"), Some(950_000), Ok, "group / has 950000 µs"),
            (built, None, None, Ok, "built in, no group of the CPU controller"),
            (None, None, None, Ok, "not in use"),
        ];
        for (config, group, runtime, verdict, read) in table {
            let runtime = runtime.map(|runtime| ("/rt".to_owned(), runtime));
            let group = Group { group: group.map(str::to_owned), runtime, unified: None };
            let finding = group.finding(config);
            assert_eq!((finding.verdict, &*finding.read), (verdict, read));
            assert_eq!(group.lacks_run_time(config), verdict != Ok);
        }
        let table = [
            (built, None, Some("/user.slice"), Warning),
            (built, None, None, Ok),
            (built, Some("/"), Some("/user.slice"), Ok),
            (None, None, Some("/user.slice"), Ok),
        ];
        for (config, group, unified, verdict) in table {
            let group = Group { group: group.map(str::to_owned), runtime: None, unified: unified.map(str::to_owned) };
            let finding = group.finding(config);
            assert_eq!(finding.verdict, verdict, "{}", finding.read);
            assert_eq!(group.lacks_run_time(config), verdict != Ok);
        }
        let first = "9:name=systemd:/\n4:cpu,cpuacct:/lab/robot\n0::/user.slice";
        assert_eq!(cpu_group(first), Some("/lab/robot"));
        assert_eq!(cpu_group("2:cpuacct:/\n0::/user.slice"), None);
    }
}
