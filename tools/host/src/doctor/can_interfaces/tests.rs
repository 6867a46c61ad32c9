//! Findings about CAN interfaces.

use can::InterfaceName;

use super::super::finding::Verdict::{self, NotUsable, Ok as Fine, Warning};
use super::super::tests::Fake;
use super::*;

/// A card in the output of iproute2 6.1, shortened.
const CARD: &str = r#"[{"ifindex":3,"ifname":"can0","flags":["NOARP","UP"],"mtu":16,"qdisc":"pfifo_fast","txqlen":10,
"linkinfo":{"info_kind":"can","info_data":{"state":"ERROR-ACTIVE","berr_counter":{"tx":0,"rx":0},"restart_ms":100,
"bittiming":{"bitrate":1000000,"sample_point":"0.750","tq":125,"sjw":1},"clock":8000000},
"info_xstats":{"restarts":0,"bus_error":0,"arbitration_lost":0,"error_warning":0,"error_passive":0,"bus_off":0}}}]"#;

/// An slcan interface that is down.
const SLCAN: &str = r#"[{"ifname":"can0","qdisc":"noop","txqlen":10,"linkinfo":{"info_kind":"can","info_data":
{"state":"STOPPED","restart_ms":0,"bittiming_bitrate":500000,"bitrate_const":[500000,1000000],"clock":0}}}]"#;

const VCAN: &str = r#"[{"ifname":"can0","qdisc":"noqueue","txqlen":1000,"linkinfo":{"info_kind":"vcan"}}]"#;

/// A host whose can0 is a card on a USB host controller with interrupt 17.
fn host(driver: &str, release: &str, affinity: &str) -> Fake {
    let adapter = "sys/devices/pci0000:00/0000:00:14.0/usb1/1-2/1-2:1.0";
    let fake = Fake::new(&[
        ("sys/class/net/can0/type", "280\n"),
        ("sys/class/net/can0/tx_queue_len", "10\n"),
        ("sys/class/net/eth0/type", "1\n"),
        ("sys/devices/system/cpu/online", "0-3\n"),
        (&format!("sys/bus/usb/drivers/{driver}/bind"), ""),
        (&format!("{adapter}/bInterfaceNumber"), "00"),
        ("sys/devices/pci0000:00/0000:00:14.0/irq", "17\n"),
        ("proc/irq/17/smp_affinity_list", affinity),
        ("proc/sys/kernel/osrelease", release),
    ]);
    fake.link("sys/class/net/can0/device", &format!("../../../../{adapter}"));
    fake.link(&format!("{adapter}/driver"), &format!("../../../../../../bus/usb/drivers/{driver}"));
    fake
}

fn wanted() -> Wanted {
    Wanted {
        of: "bus arm, can0".into(),
        interface: "can0".into(),
        bitrate_kbps: Some(1000),
        send_queue: 9,
        servo_cpu: None,
    }
}

fn name() -> InterfaceName {
    InterfaceName::new("can0").unwrap()
}

/// Findings about a card that `link` describes.
fn found(link: &str) -> Vec<Finding> {
    let opened = Ok(());
    let link = Link::parse(link).unwrap();
    findings(&host("kvaser_usb", "6.1.0", "0-3").tree(), &wanted(), opened, Some(&link))
}

fn of<'a>(findings: &'a [Finding], what: &str) -> &'a Finding {
    let found = findings.iter().find(|finding| finding.what == what);
    found.unwrap_or_else(|| panic!("no {what} in {findings:#?}"))
}

#[test]
fn a_card_as_it_should_be_leaves_nothing_to_mend() {
    let found = found(CARD);
    let expected = [
        ("interface", "present, driver kvaser_usb"),
        ("up", "yes"),
        ("bit rate", "1000 kbit/s, the cell says 1000 kbit/s"),
        ("sample point", "75.0 %"),
        ("bus state", "ERROR-ACTIVE, errors tx 0 rx 0; error-passive 0 times, bus-off 0 times, restarted 0 times"),
        ("restart-ms", "100"),
        ("txqueuelen", "10, pfifo_fast; a cycle queues up to 9"),
        ("interrupt", "17 on CPU 0-3"),
    ];
    let read: Vec<_> = found.iter().map(|found| (found.what, &*found.read)).collect();
    assert_eq!(read, expected);
    assert!(found.iter().all(|found| found.verdict == Fine && found.mend.is_none()));
}

#[test]
fn what_a_card_lacks_is_found_and_mended_by_a_command() {
    let table = [
        ("\"bitrate\":1000000", "\"bitrate\":500000", "bit rate", NotUsable, "type can bitrate 1000000"),
        ("\"0.750\"", "\"0.500\"", "sample point", Warning, "sample-point 0.875"),
        ("\"0.750\"", "0.95", "sample point", Warning, "bitrate 1000000 sample-point"),
        ("\"restart_ms\":100", "\"restart_ms\":0", "restart-ms", Warning, "restart-ms 100"),
        ("\"tx\":0", "\"tx\":8", "bus state", Warning, "terminators"),
        ("ERROR-ACTIVE", "ERROR-PASSIVE", "bus state", Warning, "terminators"),
        ("ERROR-ACTIVE", "BUS-OFF", "bus state", NotUsable, "terminators"),
        ("\"bus_off\":0", "\"bus_off\":3", "bus state", Warning, "terminators"),
    ];
    for (right, wrong, what, verdict, mend) in table {
        assert!(CARD.contains(right), "{right}");
        let found = found(&CARD.replace(right, wrong));
        for finding in &found {
            let expected = if finding.what == what { verdict } else { Fine };
            assert_eq!(finding.verdict, expected, "{wrong}: {finding:?}");
        }
        let told = of(&found, what).mend.as_deref().unwrap();
        assert!(told.contains(mend), "{told}");
    }
}

#[test]
fn what_a_card_lacks_is_set_knob_by_knob() {
    let knob = || "can0".to_owned();
    let table = [
        (("\"bitrate\":1000000", "\"bitrate\":500000"), "bit rate", Some(Knob::BitTiming(knob()).to("1000000"))),
        (("\"0.750\"", "\"0.500\""), "sample point", Some(Knob::BitTiming(knob()).to("1000000 0.875"))),
        (("\"restart_ms\":100", "\"restart_ms\":0"), "restart-ms", Some(Knob::RestartMs(knob()).to("100"))),
        // No setting repairs an error of the wiring.
        (("ERROR-ACTIVE", "BUS-OFF"), "bus state", None),
    ];
    for ((right, wrong), what, fix) in table {
        let found = found(&CARD.replace(right, wrong));
        assert_eq!(of(&found, what).fixes, Vec::from_iter(fix), "{wrong}");
    }
    let down = Err(OpenError::Down(name()));
    let link = Link::parse(CARD).unwrap();
    let up = Knob::State(knob()).to("up");
    let timing = |rate: &str| Knob::BitTiming(knob()).to(rate);
    // Without a cell file, the intended bit rate of a card without a bit rate is unknown.
    let bare = CARD.replace("\"bitrate\":1000000", "\"bitrate\":0");
    for (bitrate_kbps, link, fixes) in [
        (Some(250), &link, vec![timing("250000"), up.clone()]),
        (None, &link, vec![timing("1000000"), up]),
        (None, &Link::parse(&bare).unwrap(), vec![]),
    ] {
        let wanted = Wanted { bitrate_kbps, ..wanted() };
        let tree = host("kvaser_usb", "6.1.0", "0").tree();
        let found = findings(&tree, &wanted, down, Some(link));
        assert_eq!(of(&found, "up").fixes, fixes, "{bitrate_kbps:?}");
    }
}

#[test]
fn an_interface_that_cannot_be_opened_says_why() {
    let tree = host("kvaser_usb", "6.1.0", "0");
    let table = [
        (OpenError::NoCan(name()), "this kernel has no CAN", "modprobe can-raw"),
        (OpenError::Absent(name()), "not there; there are can0", "dmesg"),
        (OpenError::NotCan(name()), "not a CAN interface", "bus.interface"),
        (OpenError::BadName, "1 to 15 bytes", "bus.interface"),
    ];
    for (error, read, mend) in table {
        let found = findings(&tree.tree(), &wanted(), Err(error), None);
        assert_eq!((found.len(), found[0].verdict), (1, NotUsable));
        assert!(found[0].read.contains(read), "{found:?}");
        assert!(found[0].mend.as_ref().unwrap().contains(mend), "{found:?}");
    }
}

#[test]
fn an_interface_that_is_down_is_set_as_the_cell_says() {
    let link = Link::parse(SLCAN).unwrap();
    let fake = Fake::new(&[("sys/class/net/can0/tx_queue_len", "10")]);
    let down = Err(OpenError::Down(name()));
    let found = findings(&fake.tree(), &wanted(), down, Some(&link));
    let judged: Vec<_> = found.iter().map(|found| (found.what, found.verdict)).collect();
    // An slcan interface has neither a sample point nor an automatic restart.
    let expected = [("interface", Fine), ("up", NotUsable), ("bit rate", NotUsable), ("txqueuelen", Fine)];
    assert_eq!(judged, expected);
    let rate = &of(&found, "bit rate").read;
    assert_eq!(rate, "500 kbit/s, the cell says 1000 kbit/s");
    let mend = of(&found, "up").mend.as_deref().unwrap();
    assert!(mend.contains("type can bitrate 1000000 restart-ms 100"), "{mend}");
}

#[test]
fn a_virtual_bus_has_neither_bit_rate_nor_queue() {
    let fake = Fake::new(&[("sys/class/net/can0/tx_queue_len", "0")]);
    for link in [Link::parse(VCAN), None] {
        let found = findings(&fake.tree(), &wanted(), Ok(()), link.as_ref());
        let judged: Vec<_> = found.iter().map(|found| (found.what, found.verdict)).collect();
        let expected = [("interface", Fine), ("up", Fine), ("txqueuelen", Fine)];
        assert_eq!(judged, expected, "{link:?}");
        let down = Err(OpenError::Down(name()));
        let found = findings(&fake.tree(), &wanted(), down, link.as_ref());
        assert_eq!(of(&found, "up").mend.as_deref(), Some("ip link set can0 up"));
    }
}

#[test]
fn a_card_without_iproute2_keeps_its_bit_rate_secret() {
    let fake = host("kvaser_usb", "6.1.0", "0");
    let found = findings(&fake.tree(), &wanted(), Ok(()), None);
    let rate = of(&found, "bit rate");
    assert_eq!(rate.verdict, Warning);
    assert_eq!(rate.mend.as_deref(), Some("apt-get install iproute2"));
    assert!(Link::parse("").is_none() && Link::parse("[]").is_none());
}

#[test]
fn gs_usb_mixes_frames_up_before_kernel_6_6() {
    let table: [(&str, &str, Option<Verdict>); 6] = [
        ("gs_usb", "6.1.0-56-rt-amd64", Some(Warning)),
        ("gs_usb", "6.5.13", Some(Warning)),
        ("gs_usb", "6.6.0", Some(Fine)),
        ("gs_usb", "7.0-rc1", Some(Fine)),
        ("gs_usb", "unreadable", Some(Warning)),
        ("kvaser_usb", "6.1.0", None),
    ];
    for (driver, release, verdict) in table {
        let fake = host(driver, release, "0");
        let found = frame_order(&fake.tree(), "can0", Some(driver));
        assert_eq!(found.map(|found| found.verdict), verdict, "{driver} {release}");
    }
}

#[test]
fn a_queue_that_one_cycle_fills_is_too_short() {
    let link = Link::parse(CARD).unwrap();
    for (length, verdict) in [("9", Warning), ("10", Fine), ("1000", Fine), ("65536", Warning)] {
        let fake = Fake::new(&[("sys/class/net/can0/tx_queue_len", length)]);
        let found = queue(&fake.tree(), &wanted(), Some(&link), false).unwrap();
        assert_eq!(found.verdict, verdict, "{length}");
    }
}

#[test]
fn interrupts_of_the_card_stay_off_the_servos_cpu_or_have_it_alone() {
    let table = [(None, "0-3", Fine), (Some(3), "0-3", Warning), (Some(3), "0-2", Fine), (Some(3), "3", Fine)];
    for (servo_cpu, affinity, verdict) in table {
        let wanted = Wanted { servo_cpu, ..wanted() };
        let found = interrupt(&host("kvaser_usb", "6.1.0", affinity).tree(), &wanted).unwrap();
        assert_eq!(found.verdict, verdict, "{servo_cpu:?} {affinity}");
        let irq = Knob::Kernel("/proc/irq/17/smp_affinity_list".to_owned());
        let fix = (verdict == Warning).then(|| irq.to("0-2"));
        assert_eq!(found.fixes, Vec::from_iter(fix));
    }
}

#[test]
fn only_can_interfaces_are_listed() {
    assert_eq!(present(&host("gs_usb", "6.1.0", "0").tree()), ["can0"]);
}
