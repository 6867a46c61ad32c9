//! The object dictionary: lines of the configuration, data sheet, storage, EMCY.

use canopen::eds::{Access, DataType, Eds};

use super::*;

#[test]
fn a_module_has_the_objects_of_its_lines() {
    // Bytes of inputs and outputs, device type, and answers to uploads of 0x6000:00 and 0x6200:00.
    let absent = |object: &str| format!("80{object}00000206");
    for (inputs, outputs, device_type) in [(1, 1, 0x0003_0191), (8, 0, 0x0001_0191), (0, 8, 0x0002_0191)] {
        let config = DigitalIoConfig { input_bytes: inputs, output_bytes: outputs, ..config() };
        let mut bench = Bench::booted(config);
        assert_eq!(bench.read("001000"), device_type);
        for (object, count) in [("006000", inputs), ("006200", outputs)] {
            let answer = bench.ask(&format!("40{object}00000000"));
            let expected = if count > 0 { format!("4F{object}{count:02X}000000") } else { absent(object) };
            assert_eq!(answer, expected);
        }
    }
    let mut bench = Bench::booted(config());
    assert_eq!(bench.ask("4000600200000000"), "8000600211000906");
}

#[test]
fn defaults_are_those_of_cia_401() {
    let mut bench = Bench::booted(config());
    for (object, value) in [
        ("026001", 0),
        ("036001", 0),
        ("056000", 1),
        ("066001", 0xFF),
        ("076001", 0),
        ("086001", 0),
        ("006201", 0),
        ("026201", 0),
        ("066201", 0xFF),
        ("076201", 0),
        ("086201", 0xFF),
        ("001401", 0x205),
        ("001402", 255),
        ("001601", 0x6200_0108),
        ("001801", 0x4000_0185),
        ("001802", 255),
        ("001A01", 0x6000_0108),
        ("141000", 0x85),
        ("181002", 0x401),
    ] {
        assert_eq!(bench.read(object), value, "{object}");
    }
}

#[test]
fn the_module_is_what_its_data_sheet_says() {
    let config = DigitalIoConfig { input_bytes: 8, output_bytes: 8, ..config() };
    let sheet = DigitalIo::eds(&config);
    let mut bench = Bench::booted(config.clone());
    let mut defaults = 0;
    for (object, variable) in sheet.variables() {
        assert!(!variable.name.starts_with("Object "), "{object}");
        let [low, high] = object.index.to_le_bytes();
        let address = format!("{low:02X}{high:02X}{:02X}", object.subindex);
        let answer = bench.ask(&format!("40{address}00000000"));
        if variable.data_type == DataType::VisibleString {
            assert!(answer.starts_with('4'), "{object}: {answer}");
            continue;
        }
        let size = variable.data_type.size().unwrap();
        if object.index == 0x1003 && object.subindex > 0 {
            assert_eq!(answer, format!("80{address}24000008"), "no error yet");
        } else if let Some(default) = &variable.default {
            let bytes = default.encode(variable.data_type, config.node.unwrap()).unwrap();
            let bytes: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
            assert_eq!(answer[8..8 + 2 * size], bytes, "{object}");
            defaults += 1;
        }
    }
    assert!(defaults > 150, "{defaults}");
    for (object, variable) in sheet.variables() {
        let Some(size) = variable.data_type.size() else {
            continue;
        };
        let [low, high] = object.index.to_le_bytes();
        let address = format!("{low:02X}{high:02X}{:02X}", object.subindex);
        let refused = bench.ask(&download(&address, 0xFFFF_FFFF, size));
        let read_only = refused == format!("80{address}02000106");
        assert_eq!(read_only, variable.access == Access::ReadOnly, "{object}: {refused}");
    }
}

#[test]
fn the_data_sheet_reads_back_whole() {
    let sheet = DigitalIo::eds(&DigitalIoConfig { input_bytes: 8, output_bytes: 8, ..config() });
    assert_eq!(Eds::read(sheet.to_string().as_bytes()), Ok(sheet));
}

#[test]
fn parameters_are_stored_and_outputs_are_not() {
    let mut bench = Bench::booted(config());
    for (object, value) in [("066201", 0x12), ("026001", 0x34), ("006201", 0x56)] {
        bench.write(object, value, 1);
    }
    bench.write("101001", 0x6576_6173, 4);
    bench.say("000#8105");
    bench.run(60);
    for (object, value) in [("066201", 0x12), ("026001", 0x34), ("006201", 0)] {
        assert_eq!(bench.read(object), value, "{object}");
    }
    bench.write("111001", 0x6461_6F6C, 4);
    bench.say("000#8105");
    bench.run(60);
    assert_eq!(bench.read("066201"), 0xFF);
}

#[test]
fn the_inhibit_time_of_emcy_delays_the_next_emcy() {
    let mut bench = Bench::booted(DigitalIoConfig { output_bytes: 2, ..config() });
    // 20 ms.
    bench.write("151000", 200, 2);
    bench.say("000#0105");
    bench.send("205#FF");
    bench.send("205#0000");
    let heard = bench.run_micros(50_000);
    let frames: Vec<_> = heard.iter().map(|received| received.frame.to_string()).collect();
    assert_eq!(frames, ["085#1082110000000000", "085#0000000000000000"]);
    let apart = heard[1].at.since(heard[0].at).as_micros();
    assert!((19_980..=20_020).contains(&apart), "{apart} µs");
}

#[test]
fn a_storm_of_arbitrary_frames_leaves_a_module_that_a_reset_revives() {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let objects: Vec<_> = DigitalIo::eds(&config()).variables().map(|(object, _)| object).collect();
    let mut bench = Bench::booted(config());
    let ids = [0x000, 0x080, 0x205, 0x305, 0x605, 0x605, 0x605, 0x77F];
    for round in 0..20_000 {
        let id = ids[random() as usize % ids.len()];
        let mut data = random().to_le_bytes();
        if id == 0x000 && random() % 8 < 6 {
            data = [1, 5, 0, 0, 0, 0, 0, 0];
        }
        if id == 0x605 && random() % 8 < 7 {
            let object = objects[random() as usize % objects.len()];
            data[1..3].copy_from_slice(&object.index.to_le_bytes());
            data[3] = object.subindex;
            data[0] = [0x23, 0x27, 0x2B, 0x2F, 0x40, 0x60, 0x21][random() as usize % 7];
        }
        let length = if id == 0x000 { 2 } else { random() as usize % 9 };
        bench.port.send(bench.now, &[Frame::new(StandardId::new(id).unwrap(), &data[..length]).unwrap()]).unwrap();
        bench.edge(random() % 1_000, (random() % 8) as u8, random() % 2 == 0);
        let heard = bench.run_micros(300 + random() % 3_000);
        assert!(heard.len() < 200, "round {round}");
    }
    for command in ["000#8005", "000#8105"] {
        bench.say(command);
    }
    bench.run(60);
    bench.write("111001", 0x6461_6F6C, 4);
    bench.say("000#8105");
    bench.run(60);
    assert_eq!(bench.read("001000"), 0x0003_0191);
    assert_eq!(bench.read("066201"), 0xFF);
}

#[test]
fn a_module_without_node_id_takes_one_by_lss() {
    let mut bench = Bench::new(DigitalIoConfig { node: None, ..config() });
    assert_eq!(bench.run(100), [""; 0]);
    bench.say("7E5#0401000000000000");
    assert_eq!(bench.say("7E5#1105000000000000"), ["7E4#1100000000000000"]);
    bench.say("7E5#0400000000000000");
    assert_eq!(bench.run(60), ["705#00"]);
    assert_eq!(bench.say("000#0105"), ["185#00"]);
}
