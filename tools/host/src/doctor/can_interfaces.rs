//! CAN interfaces of a cell: their presence, their settings compared with the cell file, and the state of their bus.

use can::OpenError;

use super::finding::{Finding, Verdict};
use super::fix::{Fix, Knob};
use super::link::Link;
use super::tree::{Tree, cpu_list, cpu_ranges};
use mrroc::report::counted;

const NET: &str = "/sys/class/net";

/// `ARPHRD_CAN` of `linux/if_arp.h`, the type of CAN interfaces.
const CAN: i64 = 280;

/// Requirements on one interface.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    /// Name in findings: the bus of the cell and the interface.
    pub of: String,
    pub interface: String,
    /// Bit rate, kbit/s; `None` without a cell file.
    pub bitrate_kbps: Option<u32>,
    /// Maximum number of frames that one cycle queues for the bus.
    pub send_queue: usize,
    /// CPU to which the cell pins the servo thread, if any.
    pub servo_cpu: Option<usize>,
}

/// Names of the CAN interfaces of this host.
pub(super) fn present(tree: &Tree) -> Vec<String> {
    let mut names = tree.names(NET);
    names.retain(|name| tree.number(&format!("{NET}/{name}/type")) == Some(CAN));
    names
}

/// Findings about one interface. `opened` is the result of opening a socket on the interface, `link` the data from
/// netlink.
pub(super) fn findings(
    tree: &Tree,
    wanted: &Wanted,
    opened: Result<(), OpenError>,
    link: Option<&Link>,
) -> Vec<Finding> {
    let name = wanted.interface.as_str();
    let driver = tree.resolved_name(&format!("{NET}/{name}/device/driver"));
    let kind = link.map(|link| &*link.info.kind).filter(|kind| !kind.is_empty());
    let presence = Finding::new(
        &wanted.of,
        "interface",
        match (&driver, kind) {
            (Some(driver), _) => format!("present, driver {driver}"),
            (None, Some(kind)) => format!("present, {kind} without a device"),
            (None, None) => "present, without a device".to_owned(),
        },
        "only this interface connects to the drives of the bus",
    );
    let wrong = |read: &str, mend: String| {
        let absent = Finding { read: read.to_owned(), ..presence.clone() };
        vec![absent.judged(Verdict::NotUsable, mend)]
    };
    let up = match opened {
        Ok(()) => true,
        Err(OpenError::Down(_)) => false,
        Err(OpenError::NoCan(_)) => {
            return wrong(
                "this kernel has no CAN",
                "modprobe can-raw; where there is no such module, a kernel with CAN such as Debian's, or `mrroc vm uml`"
                    .to_owned(),
            );
        }
        Err(OpenError::Absent(_)) => {
            let present = present(tree);
            let others = if present.is_empty() {
                "there is none".to_owned()
            } else {
                format!("there are {}", present.join(", "))
            };
            return wrong(
                &format!("not there; {others}"),
                "plug the card in, load its driver, read dmesg; or correct bus.interface in the cell".to_owned(),
            );
        }
        Err(error) => return wrong(&error.to_string(), "bus.interface in the cell".to_owned()),
    };
    let bitrate = u64::from(wanted.bitrate_kbps.unwrap_or(1000)) * 1000;
    let virtual_bus = match kind {
        Some(kind) => kind != "can",
        None => driver.is_none(),
    };
    // The bit timing can be changed only while the interface is down.
    let set = |settings: &str| {
        format!("ip link set {name} down; ip link set {name} type can {settings}; ip link set {name} up")
    };

    let mut findings = vec![presence];
    findings.extend(frame_order(tree, &wanted.of, driver.as_deref()));
    let fix_up = Knob::State(name.to_owned()).to("up");
    let (mend, fixes) = if virtual_bus {
        (format!("ip link set {name} up"), vec![fix_up])
    } else {
        let rate = match wanted.bitrate_kbps {
            Some(kbps) => kbps.checked_mul(1000),
            None => link.and_then(Link::bitrate),
        };
        let fixes = rate.map_or(Vec::new(), |rate| vec![fix_timing(name, rate, None), fix_up]);
        (set(&format!("bitrate {bitrate} restart-ms 100")), fixes)
    };
    let read = if up { "yes" } else { "no" };
    let state = Finding::new(&wanted.of, "up", read, "an interface that is down sends nothing");
    findings.push(state.judged(Verdict::NotUsable.when(!up), mend).fixed_by(fixes));
    match link {
        _ if virtual_bus => {}
        None => findings.push(
            Finding::new(
                &wanted.of,
                "bit rate",
                "unknown: there is no command ip, or it failed",
                "`ip` reads bit rate, error counters and restart time",
            )
            .judged(Verdict::Warning, "apt-get install iproute2"),
        ),
        Some(link) => {
            findings.extend(bit_timing(wanted, link, set));
            findings.extend(errors(&wanted.of, up, link));
            if driver.is_some() {
                findings.push(restart(wanted, link, set));
            }
        }
    }
    findings.extend(queue(tree, wanted, link, virtual_bus));
    findings.extend(interrupt(tree, wanted));
    findings
}

/// Finding about the order of frames: one driver is known to deliver frames out of order.
fn frame_order(tree: &Tree, of: &str, driver: Option<&str>) -> Option<Finding> {
    let release = tree.text("/proc/sys/kernel/osrelease").unwrap_or_default();
    if driver != Some("gs_usb") {
        return None;
    }
    let finding = Finding::new(
        of,
        "frame order",
        format!("gs_usb on kernel {release}"),
        "before kernel 6.6 this driver hands frames over in another order than the bus had: an older position may come \
         after a newer one",
    );
    let mut numbers = release.split(['.', '-']).map(str::parse::<u32>);
    let version = (numbers.next(), numbers.next());
    let ordered = matches!(version, (Some(Ok(major)), Some(Ok(minor))) if (major, minor) >= (6, 6));
    Some(finding.judged(Verdict::Warning.when(!ordered), "a kernel of 6.6 or later, such as that of Debian 13"))
}

/// Fix of the bit rate, bit/s, and the sample point, part of the bit time.
fn fix_timing(name: &str, bitrate: u32, point: Option<f64>) -> Fix {
    let point = point.map_or(String::new(), |point| format!(" {point:.3}"));
    Knob::BitTiming(name.to_owned()).to(format!("{bitrate}{point}"))
}

fn bit_timing(wanted: &Wanted, link: &Link, set: impl Fn(&str) -> String) -> Vec<Finding> {
    let (of, name, wanted_kbps) = (&*wanted.of, &*wanted.interface, wanted.bitrate_kbps);
    let bitrate = link.bitrate();
    let told = bitrate.map_or("not set".to_owned(), |rate| format!("{} kbit/s", f64::from(rate) / 1000.0));
    let finding = Finding::new(
        of,
        "bit rate",
        match wanted_kbps {
            Some(wanted) => format!("{told}, the cell says {wanted} kbit/s"),
            None => told,
        },
        "a node at another bit rate destroys every frame on the bus",
    );
    let wanted = wanted_kbps.map(|kbps| kbps.saturating_mul(1000));
    let mend = set(&format!("bitrate {}", wanted.unwrap_or(1_000_000)));
    let agrees = match (bitrate, wanted) {
        (Some(rate), Some(wanted)) => rate == wanted,
        (rate, _) => rate.is_some(),
    };
    let fix = wanted.map(|wanted| fix_timing(name, wanted, None));
    let verdict = Verdict::NotUsable.when(!agrees);
    let mut findings = vec![finding.judged(verdict, mend).fixed_by(fix)];
    if let (Some(rate), Some(point)) = (bitrate, link.sample_point()) {
        let finding = Finding::new(
            of,
            "sample point",
            format!("{:.1} %", point * 100.0),
            "nodes that sample much earlier or later than 87.5 % (CiA 301) disagree about bits on a long bus; \
             75 % is usual at 1 Mbit/s",
        );
        let verdict = Verdict::Warning.when(!(0.70..=0.90).contains(&point));
        let mend = set(&format!("bitrate {rate} sample-point 0.875"));
        // A wrong bit rate is set first. The kernel then chooses the sample point for the new bit rate.
        let fix = agrees.then(|| fix_timing(name, rate, Some(0.875)));
        findings.push(finding.judged(verdict, mend).fixed_by(fix));
    }
    findings
}

fn errors(of: &str, up: bool, link: &Link) -> Option<Finding> {
    let controller = &link.info.controller;
    let state = controller.state.as_deref().filter(|_| up)?;
    let (counters, statistics) = (controller.error_counters, link.info.statistics);
    let told = counters.map(|counters| format!("errors tx {} rx {}", counters.tx, counters.rx));
    let told = told.as_deref().unwrap_or("no error counters");
    let finding = Finding::new(
        of,
        "bus state",
        format!(
            "{state}, {told}; error-passive {}, bus-off {}, restarted {}",
            counted(statistics.error_passive, "time"),
            counted(statistics.bus_off, "time"),
            counted(statistics.restarts, "time")
        ),
        "causes of errors on an idle bus: a missing terminator of 120 Ω, two bit rates, or no other node that \
         acknowledges",
    );
    let cabling = "check cable, terminators and supply of the drives; then `ip link set` down and up";
    let counting = counters.is_some_and(|counters| counters.tx > 0 || counters.rx > 0);
    let verdict = match state {
        "BUS-OFF" | "STOPPED" | "SLEEPING" => Verdict::NotUsable,
        "ERROR-ACTIVE" if !counting && statistics.bus_off == 0 => Verdict::Ok,
        _ => Verdict::Warning,
    };
    Some(finding.judged(verdict, cabling))
}

fn restart(wanted: &Wanted, link: &Link, set: impl Fn(&str) -> String) -> Finding {
    let after = link.info.controller.restart_ms;
    let why = "after bus-off the card is silent until a restart; with 0 only a person restarts it";
    Finding::new(&wanted.of, "restart-ms", after.to_string(), why)
        .judged(Verdict::Warning.when(after == 0), set("restart-ms 100"))
        .fixed_by([Knob::RestartMs(wanted.interface.clone()).to("100")])
}

fn queue(tree: &Tree, wanted: &Wanted, link: Option<&Link>, virtual_bus: bool) -> Option<Finding> {
    let name = wanted.interface.as_str();
    let file = format!("{NET}/{name}/tx_queue_len");
    let length = tree.number(&file)?;
    let discipline = link.map_or("", |link| &link.qdisc);
    let told = match discipline {
        "" => length.to_string(),
        discipline => format!("{length}, {discipline}"),
    };
    let finding = Finding::new(
        &wanted.of,
        "txqueuelen",
        format!("{told}; a cycle queues up to {}", wanted.send_queue),
        "a queue that the frames of one cycle fill drops frames; a queue of more than 1000 frames holds stale \
         set-points",
    );
    let unqueued = discipline == "noqueue" || (virtual_bus && discipline.is_empty());
    let needed = i64::try_from(wanted.send_queue).unwrap_or(i64::MAX);
    let fits = unqueued || (length > needed && length <= 1000);
    let long_enough = 128.max(wanted.send_queue + 1);
    let mend = format!("ip link set {name} txqueuelen {long_enough}");
    let fix = Knob::Kernel(file).to(long_enough.to_string());
    Some(finding.judged(Verdict::Warning.when(!fits), mend).fixed_by([fix]))
}

/// Finding about the CPUs that serve the interrupt of the card, or of the USB host controller of the adapter.
fn interrupt(tree: &Tree, wanted: &Wanted) -> Option<Finding> {
    let device = tree.resolved(&format!("{NET}/{}/device", wanted.interface))?;
    let numbers = device.ancestors().find_map(|above| {
        let above = above.to_str()?;
        let mut numbers = tree.names(&format!("{above}/msi_irqs"));
        if numbers.is_empty() {
            let number = tree.text(&format!("{above}/irq"));
            numbers.extend(number.filter(|number| number != "0"));
        }
        (!numbers.is_empty()).then_some(numbers)
    })?;
    let cpus = numbers.iter().filter_map(|number| {
        let directory = format!("/proc/irq/{number}");
        tree.text(&format!("{directory}/effective_affinity_list"))
            .filter(|list| !list.is_empty())
            .or_else(|| tree.text(&format!("{directory}/smp_affinity_list")))
    });
    let cpus: Vec<_> = cpus.collect();
    let finding = Finding::new(
        &wanted.of,
        "interrupt",
        format!("{} on CPU {}", numbers.join(", "), cpus.join(", ")),
        "interrupts on the servo's CPU delay its cycle, unless all listed are pinned to it",
    );
    let delays = wanted.servo_cpu.is_some_and(|servo| {
        let mut lists = cpus.iter().map(|list| cpu_list(list));
        let only = lists.clone().all(|list| list.iter().eq([&servo]));
        !only && lists.any(|list| list.contains(&servo))
    });
    let files: Vec<_> = numbers.iter().map(|number| format!("/proc/irq/{number}/smp_affinity_list")).collect();
    let mut others = cpu_list(&tree.text("/sys/devices/system/cpu/online").unwrap_or_default());
    others.retain(|cpu| Some(*cpu) != wanted.servo_cpu);
    let mend = format!("echo another CPU > {}", files.join(" "));
    let files = files.into_iter().filter(|_| !others.is_empty());
    let fixes = files.map(|file| Knob::Kernel(file).to(cpu_ranges(&others)));
    Some(finding.judged(Verdict::Warning.when(delays), mend).fixed_by(fixes))
}

#[cfg(test)]
mod tests;
