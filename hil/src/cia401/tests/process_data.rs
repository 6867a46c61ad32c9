//! PDOs of the module: transmission types, inhibit time, event timer, mappings in bytes.

use super::*;

/// Lets input 0 rise and fall, sends six SYNCs, and returns the TPDOs after each step.
fn at_syncs(kind: u32) -> Vec<Vec<String>> {
    let mut bench = Bench::booted(config());
    bench.configure_tpdo(kind, 0, 0);
    bench.say("000#0105");
    let mut heard = vec![bench.say("080#"), bench.say("080#")];
    bench.edge(0, 0, true);
    heard.extend([bench.run(5), bench.say("080#"), bench.say("080#"), bench.say("080#"), bench.say("080#")]);
    heard
}

#[test]
fn a_tpdo_follows_sync_as_its_transmission_type_says() {
    let (low, high) = ("185#00", "185#01");
    let table: [(u32, [&[&str]; 7]); 6] = [
        // Acyclic: at the first SYNC, and at the SYNC after a change.
        (0, [&[low], &[], &[], &[high], &[], &[], &[]]),
        (1, [&[low], &[low], &[], &[high], &[high], &[high], &[high]]),
        (2, [&[], &[low], &[], &[], &[high], &[], &[high]]),
        (240, [&[], &[], &[], &[], &[], &[], &[]]),
        // Event-driven: the first transmission follows the start.
        (254, [&[], &[], &[high], &[], &[], &[], &[]]),
        (255, [&[], &[], &[high], &[], &[], &[], &[]]),
    ];
    for (kind, expected) in table {
        assert_eq!(at_syncs(kind), expected, "type {kind}");
    }
}

#[test]
fn an_acyclic_tpdo_keeps_to_the_interrupt_masks() {
    let mut bench = Bench::booted(config());
    bench.configure_tpdo(0, 0, 0);
    bench.write("066001", 0x02, 1);
    bench.say("000#0105");
    assert_eq!(bench.say("080#"), ["185#00"]);
    bench.edge(0, 0, true);
    assert_eq!(bench.say("080#"), [""; 0]);
    bench.edge(0, 1, true);
    assert_eq!(bench.say("080#"), ["185#03"]);
}

#[test]
fn the_reserved_transmission_types_are_refused() {
    let mut bench = Bench::booted(config());
    for kind in [241, 253] {
        assert_eq!(bench.ask(&download("001802", kind, 1)), "8000180230000906", "type {kind}");
    }
}

#[test]
fn the_inhibit_time_holds_changes_back_and_loses_none() {
    let mut bench = Bench::booted(config());
    // 10 ms.
    bench.configure_tpdo(255, 100, 0);
    bench.say("000#0105");
    bench.run(20);
    // A falling edge inside the inhibit time of its rising edge.
    bench.edge(0, 0, true);
    bench.edge(1_000, 0, false);
    let heard = bench.run_micros(30_000);
    let frames: Vec<_> = heard.iter().map(|received| received.frame.to_string()).collect();
    assert_eq!(frames, ["185#01", "185#00"]);
    let apart = heard[1].at.since(heard[0].at).as_micros();
    assert!((9_980..=10_020).contains(&apart), "{apart} µs");
    // A pulse that is over before the end of the inhibit time.
    bench.edge(0, 1, true);
    bench.edge(1_000, 0, true);
    bench.edge(2_000, 0, false);
    assert_eq!(bench.run(30), ["185#02", "185#02"]);
}

#[test]
fn the_event_timer_sends_without_a_change() {
    let mut bench = Bench::booted(config());
    bench.configure_tpdo(255, 0, 10);
    bench.send("000#0105");
    let sent = bench.run(101);
    assert_eq!(sent, ["185#00"; 11]);
}

#[test]
fn a_mapping_takes_single_bytes_in_any_order() {
    let mut bench = Bench::booted(DigitalIoConfig { input_bytes: 8, ..config() });
    // The default mapping has all bytes.
    assert_eq!(bench.read("001A00"), 8);
    bench.write("001801", 0xC000_0185, 4);
    // TPDO 2 under an identifier of its own choice: bytes 8 and 2.
    bench.write("011A00", 0, 1);
    bench.write("011A01", 0x6000_0808, 4);
    bench.write("011A02", 0x6000_0208, 4);
    bench.write("011A00", 2, 1);
    bench.write("011801", 0x4000_0321, 4);
    assert_eq!(bench.say("000#0105"), ["321#0000"]);
    for (index, frame) in [(63, Some("321#8000")), (0, None), (9, Some("321#8002"))] {
        bench.edge(0, index, true);
        assert_eq!(bench.run(5), Vec::from_iter(frame), "input {index}");
    }
    // Outputs and parameters cannot be sent, and an absent byte cannot be mapped.
    bench.say("000#8005");
    for (entry, abort) in [(0x6200_0108, "41000406"), (0x6006_0108, "41000406"), (0x6000_0908, "00000206")] {
        assert_eq!(bench.ask(&download("021A01", entry, 4)), format!("80021A01{abort}"), "{entry:#x}");
    }
}
