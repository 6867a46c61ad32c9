//! Ttys of a cell: presence, permissions, persistent names and latency.

use super::finding::{Finding, Verdict};
use super::fix::Knob;
use super::limits::Identity;
use super::tree::Tree;

/// One tty of a cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Wanted {
    /// Name in findings: the tty and the device at its other end.
    pub of: String,
    pub path: String,
}

/// Findings about one tty. The tty is not opened, because opening a tty raises its control lines.
pub(super) fn findings(tree: &Tree, wanted: &Wanted) -> Vec<Finding> {
    let of = wanted.of.as_str();
    let why = "the axis controller or adapter behind it is reached through it and no other";
    let presence = |read: String| Finding::new(of, "tty", read, why);
    let Some(name) = tree.resolved_name(&wanted.path) else {
        let others = persistent(tree);
        let others = if others.is_empty() {
            "/dev/serial/by-id lists none".to_owned()
        } else {
            format!("there are {}", others.join(", "))
        };
        return vec![presence(format!("not there; {others}")).judged(
            Verdict::NotUsable,
            "plug it in, load the card's driver and look into dmesg; or the line's path in the cell",
        )];
    };
    let class = format!("/sys/class/tty/{name}");
    let driver = tree.resolved_name(&format!("{class}/device/driver"));
    let present = driver.map_or(name.clone(), |driver| format!("{name}, driver {driver}"));
    // Drivers of serial ports create ttys for ports that the machine does not have: PORT_UNKNOWN of linux/serial.h.
    if tree.number(&format!("{class}/type")) == Some(0) {
        let mend = "the line's path in the cell: a tty that has a port";
        return vec![presence(format!("{present}, no port behind it")).judged(Verdict::NotUsable, mend)];
    }
    let mut findings = vec![presence(present)];
    findings.extend(permission(tree, wanted));
    findings.extend(naming(tree, wanted, &name));
    findings.extend(flag(tree, of, &name));
    findings.extend(latency(tree, of, &name));
    findings
}

/// Finding about the low-latency flag of a serial port driver (`ASYNC_LOW_LATENCY` of linux/tty_flags.h). A run sets
/// the flag whenever it opens the tty, and needs no privilege for it.
fn flag(tree: &Tree, of: &str, name: &str) -> Option<Finding> {
    const LOW_LATENCY: u32 = 1 << 13;
    let flags = tree.text(&format!("/sys/class/tty/{name}/flags"))?;
    let flags = u32::from_str_radix(flags.strip_prefix("0x")?, 16).ok()?;
    let read = if flags & LOW_LATENCY != 0 { "set" } else { "not set yet; opening the line sets it" };
    let why = "without it a driver may gather bytes before it hands them over";
    Some(Finding::new(of, "low latency", read, why))
}

fn permission(tree: &Tree, wanted: &Wanted) -> Option<Finding> {
    let granted = Identity::of(tree).may(0o6, tree.access(&wanted.path)?);
    let read = if granted { "granted" } else { "denied" };
    let finding = Finding::new(&wanted.of, "permission", read, "it is opened for reading and writing");
    Some(finding.judged(Verdict::NotUsable.when(!granted), "usermod -aG dialout USER, then a new login"))
}

/// Persistent names of the USB adapters, which do not depend on the order of plugging.
fn persistent(tree: &Tree) -> Vec<String> {
    tree.names("/dev/serial/by-id").into_iter().map(|name| format!("/dev/serial/by-id/{name}")).collect()
}

/// Finding about the name of a tty. Only ttys of USB adapters are numbered in the order of plugging.
fn naming(tree: &Tree, wanted: &Wanted, name: &str) -> Option<Finding> {
    if !name.starts_with("ttyUSB") && !name.starts_with("ttyACM") {
        return None;
    }
    let finding = Finding::new(
        &wanted.of,
        "name",
        wanted.path.as_str(),
        "ttys of USB adapters are numbered as they are plugged in: after a restart another axis may answer under it",
    );
    // A symbolic link, made by udev or by the user, follows the adapter.
    if wanted.path != format!("/dev/{name}") {
        return Some(finding);
    }
    let lasting = persistent(tree).into_iter().find(|path| tree.resolved_name(path).as_deref() == Some(name));
    let mend = match lasting {
        Some(path) => format!("the line's path in the cell: {path}"),
        None => "a udev rule that gives it a name by its serial number or its place".to_owned(),
    };
    Some(finding.judged(Verdict::Warning, mend))
}

/// Finding about the latency timer of adapters that collect received bytes before they send them to the host.
fn latency(tree: &Tree, of: &str, name: &str) -> Option<Finding> {
    let file = format!("/sys/bus/usb-serial/devices/{name}/latency_timer");
    let timer = tree.number(&file)?;
    let finding = Finding::new(
        of,
        "latency timer",
        format!("{timer} ms"),
        "the adapter holds an answer back for as long; opening a line asks for low latency, which not every driver \
         grants",
    );
    let mend = format!("echo 1 > {file}; for good ATTR{{latency_timer}}=\"1\" in a rule of /etc/udev/rules.d");
    Some(finding.judged(Verdict::Warning.when(timer > 1), mend).fixed_by([Knob::Kernel(file).to("1")]))
}

#[cfg(test)]
mod tests {
    use super::super::finding::Verdict;
    use super::super::tests::Fake;
    use super::*;

    fn wanted(path: &str) -> Wanted {
        Wanted { of: "line".into(), path: path.into() }
    }

    fn judged(fake: &Fake, path: &str) -> Vec<(&'static str, Verdict)> {
        let findings = findings(&fake.tree(), &wanted(path)).into_iter();
        findings.map(|found| (found.what, found.verdict)).collect()
    }

    /// An FTDI adapter that this user may open.
    fn adapter(latency: &str) -> Fake {
        let fake = Fake::new(&[
            ("dev/ttyUSB3", ""),
            ("sys/bus/usb-serial/devices/ttyUSB3/latency_timer", latency),
            ("sys/bus/usb-serial/drivers/ftdi_sio/bind", ""),
            ("proc/self/status", "CapEff:\t2"),
        ]);
        fake.link("sys/class/tty/ttyUSB3/device/driver", "../../../../bus/usb-serial/drivers/ftdi_sio");
        fake.link("dev/serial/by-id/usb-FTDI_A1-if00", "../../ttyUSB3");
        fake.link("dev/column", "ttyUSB3");
        fake
    }

    #[test]
    fn an_absent_tty_is_not_usable_and_the_others_are_named() {
        let empty = Fake::new(&[]);
        let found = findings(&empty.tree(), &wanted("/dev/ttyMI8"));
        assert_eq!(found[0].verdict, Verdict::NotUsable);
        assert_eq!(found[0].read, "not there; /dev/serial/by-id lists none");
        let found = findings(&adapter("1").tree(), &wanted("/dev/ttyUSB0"));
        assert_eq!(found[0].read, "not there; there are /dev/serial/by-id/usb-FTDI_A1-if00");
    }

    #[test]
    fn an_adapter_should_be_quick_and_called_by_its_lasting_name() {
        use Verdict::{Ok, Warning};
        let (slow, quick) = (adapter("16\n"), adapter("1\n"));
        let by_id = "/dev/serial/by-id/usb-FTDI_A1-if00";
        let table = [
            (&quick, by_id, [Ok, Ok, Ok, Ok]),
            (&quick, "/dev/ttyUSB3", [Ok, Ok, Warning, Ok]),
            (&slow, by_id, [Ok, Ok, Ok, Warning]),
            (&quick, "/dev/column", [Ok, Ok, Ok, Ok]),
        ];
        for (fake, path, verdicts) in table {
            let names = ["tty", "permission", "name", "latency timer"];
            let expected: Vec<_> = names.into_iter().zip(verdicts).collect();
            assert_eq!(judged(fake, path), expected, "{path}");
        }
        let found = findings(&quick.tree(), &wanted("/dev/ttyUSB3"));
        assert_eq!(found[0].read, "ttyUSB3, driver ftdi_sio");
        let mend = found[2].mend.as_deref().unwrap();
        assert!(mend.ends_with(by_id), "{mend}");
    }

    #[test]
    fn a_tty_without_a_port_or_a_permission_is_not_usable() {
        let fake = Fake::new(&[
            ("dev/ttyS1", ""),
            ("sys/class/tty/ttyS1/type", "0\n"),
            ("dev/ttyS0", ""),
            ("sys/class/tty/ttyS0/type", "4\n"),
            ("sys/class/tty/ttyS0/flags", "0x10002040\n"),
            ("proc/self/status", "Uid:\t99999\t99999\t99999\t99999\nCapEff:\t0"),
        ]);
        assert_eq!(judged(&fake, "/dev/ttyS1"), [("tty", Verdict::NotUsable)]);
        assert_eq!(
            judged(&fake, "/dev/ttyS0"),
            [("tty", Verdict::Ok), ("permission", Verdict::NotUsable), ("low latency", Verdict::Ok)]
        );
        for (flags, read) in [("0x2000", Some("set")), ("0x40", Some("not")), ("x", None)] {
            let fake = Fake::new(&[("sys/class/tty/ttyS0/flags", flags)]);
            let found = flag(&fake.tree(), "line", "ttyS0").map(|found| found.read);
            let found = found.as_deref().map(|found| &found[..3]);
            assert_eq!(found, read, "{flags}");
        }
    }
}
