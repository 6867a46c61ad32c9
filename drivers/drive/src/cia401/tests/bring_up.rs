//! Bring-up of an I/O node, frame by frame.

use std::time::Duration;

use canopen::Object;

use super::bench::*;

/// Writes to the node, in order. Each write is read back before the next, unless the node lacks the object.
const TOLD: &[&str] = &[
    // The node produces its heartbeat, watches the host's, and stops when it hears none.
    "605#2B171000D0070000",
    "605#2316100170177F00",
    "605#2F29100102000000",
    // Every change of an input sends; no input is inverted or filtered.
    "605#2F05600001000000",
    "605#2F03600100000000",
    "605#2F02600100000000",
    "605#2F066001FF000000",
    "605#2F07600100000000",
    "605#2F08600100000000",
    "605#2F03600200000000",
    "605#2F02600200000000",
    "605#2F066002FF000000",
    "605#2F07600200000000",
    "605#2F08600200000000",
    // Outputs are not inverted, follow the host, and have an error state.
    "605#2F02620100000000",
    "605#2F086201FF000000",
    "605#2F0662010B000000",
    "605#2F07620101000000",
    // RPDO 2 to 4 off; RPDO 1: one block of outputs, at once, without a deadline.
    "605#2301140105030080",
    "605#2302140105040080",
    "605#2303140105050080",
    "605#2300140105020080",
    "605#2F00160000000000",
    "605#2300160108010062",
    "605#2F00160001000000",
    "605#2F001402FF000000",
    "605#2B00140500000000",
    "605#2300140105020000",
    // TPDO 2 to 4 off; TPDO 1: two blocks of inputs, on change, at least 1 ms and at most 50 ms apart.
    "605#23011801850200C0",
    "605#23021801850300C0",
    "605#23031801850400C0",
    "605#23001801850100C0",
    "605#2F001A0000000000",
    "605#23001A0108010060",
    "605#23001A0208020060",
    "605#2F001A0002000000",
    "605#2F001802FF000000",
    "605#2B0018030A000000",
    "605#2B00180532000000",
    "605#2300180185010040",
];

/// Objects of [`TOLD`] that the node lacks, as in its frames.
const LACKING: [&str; 7] = ["086201", "011401", "021401", "031401", "011801", "021801", "031801"];

#[test]
fn an_io_node_is_asked_and_told_this_frame_by_frame() {
    let mut bench = down(group_config(), io_config(IO));
    assert_eq!(bench.bring_up(), Ok(()));
    // Device type, vendor, product, numbers of blocks.
    let asked = ["001000", "181001", "181002", "006000", "006200"];
    let mut expected: Vec<String> = asked.iter().map(|object| format!("605#40{object}00000000")).collect();
    for told in TOLD {
        expected.push((*told).to_owned());
        if !LACKING.contains(&&told[6..12]) {
            expected.push(format!("605#40{}00000000", &told[6..12]));
        }
    }
    let sent = sent(&bench);
    let to_node: Vec<_> = sent.iter().filter(|frame| frame.starts_with("605#")).cloned().collect();
    assert_eq!(to_node, expected);
    assert_eq!(sent[..2], ["000#8202", "000#8205"]);
    assert_eq!(sent[sent.len() - 3..], ["000#0102", "000#0105", "080#"]);
}

/// The writes to the node during bring-up.
fn told(io: IoConfig) -> Vec<String> {
    let mut bench = down(group_config(), io);
    assert_eq!(bench.bring_up(), Ok(()));
    sent(&bench).into_iter().filter(|frame| frame.starts_with("605#2")).collect()
}

#[test]
fn filters_are_written_and_the_error_value_is_the_level_at_the_terminal() {
    let io = IoConfig {
        filtered_inputs: 0b10_0000_0001,
        inverted_inputs: 0b1111,
        // Output 0 is on in the error state and low at the terminal, output 1 is off and high.
        inverted_outputs: 0b0011,
        ..io_config(IO)
    };
    let told = told(io);
    let expected = ["605#2F03600101000000", "605#2F03600202000000", "605#2F07620102000000", "605#2F02600100000000"];
    for write in expected {
        assert!(told.iter().any(|frame| frame == write), "{write}: {told:?}");
    }
}

#[test]
fn settings_of_the_cell_come_first_and_touch_nothing_of_the_driver() {
    let with = |index, subindex| {
        let configuration = vec![setting(index, subindex, &[7])];
        IoConfig { configuration, ..io_config(IO) }
    };
    let mut bench = down(group_config(), with(0x2100, 3));
    bench.stores[1].put(0x2100, 3, &[0]);
    assert_eq!(bench.bring_up(), Ok(()));
    let writes = sent(&bench);
    let mut writes = writes.iter().filter(|frame| frame.starts_with("605#2"));
    assert_eq!(writes.next().map(String::as_str), Some("605#2F00210307000000"));
    for (index, subindex) in [(0x1016, 1), (0x1400, 5), (0x6003, 1), (0x6200, 1), (0x6220, 1)] {
        let refused =
            CanBus::with_io(BusEnd::default(), group_config(), &[axis_config(DRIVE)], &[with(index, subindex)]);
        let refused = refused.err();
        let object = Object::new(index, subindex);
        let of_setting =
            matches!(refused, Some(ConfigError::Setting { node: IO, object: found, .. }) if found == object);
        assert!(of_setting, "{refused:?}");
    }
}

#[test]
fn a_node_without_the_wanted_filter_or_with_an_rpdo_deadline_that_stays_is_refused() {
    let filter = Object::new(0x6003, 1);
    let filtered = IoConfig { filtered_inputs: 1, ..io_config(IO) };
    let mut bench = down(group_config(), filtered);
    bench.stores[1].objects.remove(&(0x6003, 1));
    assert_eq!(
        bench.bring_up(),
        Err(BringUpError::WriteRefused { node: IO, object: filter, written: 1, code: 0x0602_0000 })
    );
    // Without a filtered input the node needs no filter, and no deadline either.
    let mut bench = down(group_config(), io_config(IO));
    for object in [(0x6003, 1), (0x6003, 2), (0x1400, 5)] {
        bench.stores[1].objects.remove(&object);
    }
    assert_eq!(bench.bring_up(), Ok(()));
    let mut bench = down(group_config(), io_config(IO));
    bench.stores[1].forgetful = Some((0x1400, 5));
    let object = Object::new(0x1400, 5);
    assert_eq!(bench.bring_up(), Err(BringUpError::ReadBack { node: IO, object, written: 0, found: 7 }));
}

#[test]
fn a_node_without_outputs_or_inputs_is_told_nothing_of_them() {
    for (io, told, untold) in [
        (IoConfig { outputs: 0, error_mode: 0, error_value: 0, ..io_config(IO) }, "605#23001A01", "605#23001601"),
        (IoConfig { inputs: 0, ..io_config(IO) }, "605#23001601", "605#23001A01"),
    ] {
        let mut bench = down(group_config(), io);
        // The other PDO 1 is switched off.
        assert_eq!(bench.bring_up(), Ok(()));
        let sent = sent(&bench);
        assert!(sent.iter().any(|frame| frame.starts_with(told)), "{told}");
        assert!(!sent.iter().any(|frame| frame.starts_with(untold)), "{untold}");
    }
}

#[test]
fn a_node_that_is_not_what_the_cell_says_is_refused() {
    let object = Object::new;
    type Change = fn(&mut Store);
    let table: [(Change, BringUpError); 8] = [
        (
            |store| store.put(0x1000, 0, &[0x92, 0x01, 0x02, 0x00]),
            BringUpError::NotAnIoNode { node: IO, device_type: 0x0002_0192 },
        ),
        (
            |store| store.put(0x1018, 2, &[8, 0, 0, 0]),
            BringUpError::WrongIdentity { node: IO, subindex: 2, expected: 7, found: 8 },
        ),
        (
            |store| store.put(0x6000, 0, &[1]),
            BringUpError::TooFewBlocks { node: IO, object: object(0x6000, 0), found: 1, needed: 2 },
        ),
        (
            |store| _ = store.objects.remove(&(0x6200, 0)),
            BringUpError::Aborted { node: IO, object: object(0x6200, 0), code: 0x0602_0000 },
        ),
        // Without an error state the outputs would stay when the host is silent.
        (
            |store| _ = store.objects.remove(&(0x6206, 1)),
            BringUpError::WriteRefused { node: IO, object: object(0x6206, 1), written: 0b1011, code: 0x0602_0000 },
        ),
        (
            |store| _ = store.objects.remove(&(0x1029, 1)),
            BringUpError::WriteRefused { node: IO, object: object(0x1029, 1), written: 2, code: 0x0602_0000 },
        ),
        (
            |store| store.forgetful = Some((0x6207, 1)),
            BringUpError::ReadBack { node: IO, object: object(0x6207, 1), written: 1, found: 0 },
        ),
        (
            |store| store.forgetful = Some((0x1800, 3)),
            BringUpError::ReadBack { node: IO, object: object(0x1800, 3), written: 10, found: 0 },
        ),
    ];
    for (change, error) in table {
        let mut bench = down(group_config(), io_config(IO));
        change(&mut bench.stores[1]);
        assert_eq!(bench.bring_up(), Err(error), "{error}");
        assert_eq!(error.node(), Some(IO));
        assert_eq!(image(&bench).fault, Some(IoFault::NotStarted { node: IO }));
        // The drive is not started without the I/O node.
        assert!(!sent(&bench).iter().any(|frame| frame.starts_with("000#01")), "{error}");
    }
    let error = BringUpError::TooFewBlocks { node: IO, object: object(0x6000, 0), found: 1, needed: 2 };
    assert_eq!(error.to_string(), "node 5: 0x6000:00 is 1 blocks of eight channels, 2 are needed");
}

#[test]
fn a_node_that_never_boots_or_starts_is_refused() {
    let mut bench = down(group_config(), io_config(IO));
    bench.stores[1].boots = false;
    bench.stores[1].mute = Some((0x1000, 0));
    assert!(matches!(bench.bring_up(), Err(BringUpError::NeverBooted { node: IO, .. })));
    let mut bench = down(group_config(), io_config(IO));
    bench.stores[1].starts = false;
    assert!(matches!(bench.bring_up(), Err(BringUpError::NotOperational { node: IO, .. })));
}

#[test]
fn bring_up_ends_when_the_inputs_are_known() {
    let mut bench = down(group_config(), io_config(IO));
    bench.stores[1].sends = None;
    let refused = bench.bring_up();
    assert!(matches!(refused, Err(BringUpError::NoInputs { node: IO, .. })), "{refused:?}");
    // Inputs of another length are no inputs.
    let mut bench = down(group_config(), io_config(IO));
    bench.stores[1].sends = Some(frame("185#01"));
    assert!(matches!(bench.bring_up(), Err(BringUpError::NoInputs { node: IO, .. })));
    let mut bench = down(group_config(), io_config(IO));
    assert_eq!(bench.bring_up(), Ok(()));
    assert!(image(&bench).input(0).unwrap().level);
    assert_eq!(image(&bench).fault, None);
}

#[test]
fn a_node_id_that_occurs_twice_is_refused() {
    let (group, axes) = (group_config(), [axis_config(DRIVE)]);
    for (nodes, twice) in [(vec![IO, IO], IO), (vec![IO, DRIVE], DRIVE), (vec![127], 127)] {
        let io: Vec<_> = nodes.into_iter().map(io_config).collect();
        let refused = CanBus::with_io(BusEnd::default(), group, &axes, &io).err();
        assert_eq!(refused, Some(ConfigError::DuplicateNode(twice)));
    }
}

#[test]
fn quantities_that_a_node_cannot_hold_are_refused() {
    let micros = Duration::from_micros;
    let io = || io_config(IO);
    let table = [
        (IoConfig { inputs: 65, ..io() }, IoQuantity::Channels),
        (IoConfig { outputs: 65, ..io() }, IoQuantity::Channels),
        (IoConfig { inputs: 0, outputs: 0, error_mode: 0, error_value: 0, ..io() }, IoQuantity::Channels),
        (IoConfig { error_mode: 0b1_0000, ..io() }, IoQuantity::OutputMask),
        (IoConfig { error_value: 1 << 63, ..io() }, IoQuantity::OutputMask),
        (IoConfig { inverted_outputs: 0b1_0000, ..io() }, IoQuantity::OutputMask),
        (IoConfig { inverted_inputs: 1 << 10, ..io() }, IoQuantity::InputMask),
        (IoConfig { emergency_inputs: 1 << 10, ..io() }, IoQuantity::InputMask),
        (IoConfig { filtered_inputs: 1 << 63, ..io() }, IoQuantity::InputMask),
        (IoConfig { inhibit_time: micros(0), ..io() }, IoQuantity::InhibitTime),
        (IoConfig { inhibit_time: micros(150), ..io() }, IoQuantity::InhibitTime),
        (IoConfig { inhibit_time: micros(50_100), ..io() }, IoQuantity::InhibitTime),
        (IoConfig { event_timer: micros(0), ..io() }, IoQuantity::EventTimer),
        (IoConfig { event_timer: micros(50_500), ..io() }, IoQuantity::EventTimer),
        (IoConfig { event_timer: Duration::from_secs(66), ..io() }, IoQuantity::EventTimer),
    ];
    for (io, quantity) in table {
        let refused = CanBus::with_io(BusEnd::default(), group_config(), &[axis_config(DRIVE)], &[io]).err();
        assert_eq!(refused, Some(ConfigError::IoOutOfRange { node: IO, quantity }));
    }
    let full = IoConfig { inputs: 64, outputs: 64, error_mode: u64::MAX, error_value: u64::MAX, ..io() };
    assert!(CanBus::with_io(BusEnd::default(), group_config(), &[axis_config(DRIVE)], &[full]).is_ok());
}
