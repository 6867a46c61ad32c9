//! NMT, SDO, PDO, heartbeats and EMCY from the host's view.

use super::*;

#[test]
fn an_enabled_epos_says_what_a_real_one_said() {
    let mut bench = Bench::booted(Epos4Config { vendor_bits: 1 << 8, ..config() });
    assert_eq!(bench.say("000#0102"), ["182#4007"]);
    assert_eq!(bench.say("202#0600"), ["182#2107"]);
    assert_eq!(bench.say("202#0700"), ["182#2307"]);
    assert_eq!(bench.say("202#0F00"), ["182#3707"]);
    assert_eq!(bench.say("602#4041600000000000"), ["582#4B41600037070000"]);
}

#[test]
fn the_table_ascends_and_every_default_is_within_its_limits() {
    use crate::epos4::table::TABLE;
    use canopen::eds::DataType;
    for pair in TABLE.windows(2) {
        assert!(pair[0].object < pair[1].object, "{}", pair[1].object);
    }
    for entry in &TABLE {
        let number = entry.number(entry.default);
        assert!((entry.min..=entry.max).contains(&number), "{}", entry.object);
        let bytes = entry.default.to_le_bytes();
        if entry.data_type != DataType::VisibleString {
            let size = entry.size();
            let mut kept = [0; 4];
            kept[..size].copy_from_slice(&bytes[..size]);
            assert_eq!(entry.decode(kept), entry.default, "{}", entry.object);
        }
    }
}

#[test]
fn factory_values_are_those_of_an_epos4() {
    let mut bench = Bench::booted(config());
    let table = [
        ("4000100000000000", "4300100092010200"),
        ("4001100000000000", "4F01100000000000"),
        ("4005100000000000", "4305100080000000"),
        ("4008100000000000", "4108100005000000"),
        ("4014100000000000", "4314100082000000"),
        ("4017100000000000", "4B17100000000000"),
        ("4018100100000000", "43181001FB000000"),
        ("4000140100000000", "4300140102020000"),
        ("4001140100000000", "4301140102030080"),
        ("4000140200000000", "4F001402FF000000"),
        ("4000180100000000", "4300180182010040"),
        ("4003180100000000", "43031801820400C0"),
        ("4000180300000000", "4B0018030A000000"),
        ("4002160000000000", "4F02160002000000"),
        ("4002160200000000", "4302160220007A60"),
        ("4065600000000000", "43656000D0070000"),
        ("405A600000000000", "4B5A600006000000"),
        ("4007600000000000", "4B07600003000000"),
        ("4098600000000000", "4F98600007000000"),
        ("40C2600200000000", "4FC26002FD000000"),
        ("4002650000000000", "43026500A5030000"),
    ];
    for (request, answer) in table {
        assert_eq!(bench.ask(request), answer, "{request}");
    }
}

#[test]
fn refused_requests_name_their_abort_code() {
    let mut bench = Bench::booted(config());
    let table = [
        // No object, no sub-index, read only, too long, too short, too high, too low.
        ("4000500000000000", "8000500000000206"),
        ("4018100900000000", "8018100911000906"),
        ("2B41600001000000", "8041600002000106"),
        ("2340600001000000", "8040600010000706"),
        ("2F40600001000000", "8040600013000706"),
        ("2F29100103000000", "8029100130000906"),
        ("2B5A6000FFFF0000", "805A600030000906"),
        // Modes and methods that EPOS4 lacks, and a unit that is not a unit of speed.
        ("2F60600007000000", "8060600030000906"),
        ("2F98600005000000", "8098600030000906"),
        ("23A9600000000000", "80A9600030000906"),
        // An empty history; a value other than 0 does not clear the history; a wrong password for storing.
        ("4003100100000000", "8003100124000008"),
        ("2F03100001000000", "8003100030000906"),
        ("2310100101000000", "8010100120000008"),
    ];
    for (request, answer) in table {
        assert_eq!(bench.ask(request), answer, "{request}");
    }
    assert_eq!(bench.ask("2310100173617665"), "6010100100000000");
}

#[test]
fn remapping_out_of_order_is_refused() {
    let mut bench = Bench::booted(config());
    let steps = [
        // The PDO is switched on: its count, its entries and its identifier cannot change.
        ("2F00160000000000", "8000160022000008"),
        ("2300160108006060", "8000160122000008"),
        ("2300140122020000", "8000140130000906"),
        ("2B00180300000000", "8000180322000008"),
        // The PDO is switched off, but its entries are locked while the count is not 0.
        ("2300140102020080", "6000140100000000"),
        ("2300160108006060", "8000160103000106"),
        ("2F00160000000000", "6000160000000000"),
        // An object that cannot be mapped to an RPDO, a wrong size, an unknown object, the statusword.
        ("2300160110004160", "8000160141000406"),
        ("2300160120004060", "8000160141000406"),
        ("2300160110000050", "8000160100000206"),
        // Three objects of 32 bits are too many. Two such objects and a word are also too many.
        ("2300160120007A60", "6000160100000000"),
        ("230016022000FF60", "6000160200000000"),
        ("2300160310004060", "6000160300000000"),
        ("2F00160003000000", "8000160042000406"),
        ("2F00160009000000", "8000160042000406"),
        ("2F00160002000000", "6000160000000000"),
        // Reserved identifiers are refused for PDOs.
        ("2300140180050000", "6000140100000000"),
        ("2300140180050080", "6000140100000000"),
        ("2300140181050000", "8000140130000906"),
        ("2300140102020000", "6000140100000000"),
        ("2F00140201000000", "6000140200000000"),
        // Types 241 to 251 are reserved, remote requests are not supported.
        ("2F001402FC000000", "8000140230000906"),
    ];
    for (step, (request, answer)) in steps.into_iter().enumerate() {
        assert_eq!(bench.ask(request), answer, "step {step}: {request}");
    }
}

#[test]
fn services_answer_only_in_their_nmt_states() {
    let mut bench = Bench::new(config());
    // A booting device ignores requests.
    assert_eq!(bench.say("602#4041600000000000"), [""; 0]);
    assert_eq!(bench.run(60), ["702#00"]);
    let status = "602#4041600000000000";
    assert_eq!(bench.say(status).len(), 1);
    // PDOs work only in operational.
    assert_eq!(bench.say("202#0600"), [""; 0]);
    assert_eq!(bench.say("000#0102"), ["182#4006"]);
    assert_eq!(bench.say("202#0600"), ["182#2106"]);
    // In stopped, SDO does not work. Commands to other nodes and invalid commands are ignored.
    assert_eq!(bench.say("000#0202"), [""; 0]);
    assert_eq!(bench.say(status), [""; 0]);
    assert_eq!(bench.say("202#0700"), [""; 0]);
    for ignored in ["000#0103", "000#0702", "000#01", "000#010200"] {
        bench.say(ignored);
        assert_eq!(bench.say(status), [""; 0], "{ignored}");
    }
    assert_eq!(bench.say("000#8000"), [""; 0]);
    assert_eq!(bench.say(status).len(), 1);
}

#[test]
fn resets_bring_back_their_part_of_the_dictionary() {
    let mut bench = Bench::booted(config());
    bench.write("656000", 77, 4);
    bench.write("171000", 500, 2);
    bench.say("000#8202");
    assert_eq!(bench.run(60), ["702#00"]);
    assert_eq!(bench.read("171000"), 0);
    assert_eq!(bench.read("656000"), 77);
    bench.say("000#8102");
    assert_eq!(bench.run(60), ["702#00"]);
    assert_eq!(bench.read("656000"), 2000);
    // Stored values survive until the factory values are loaded.
    bench.write("656000", 77, 4);
    bench.write("101001", 0x6576_6173, 4);
    bench.write("656000", 78, 4);
    bench.say("000#8102");
    bench.run(60);
    assert_eq!(bench.read("656000"), 77);
    bench.write("111001", 0x6461_6F6C, 4);
    assert_eq!(bench.read("656000"), 77);
    bench.say("000#8102");
    bench.run(60);
    assert_eq!(bench.read("656000"), 2000);
}

#[test]
fn answers_take_their_delay() {
    let mut bench = Bench::booted(Epos4Config { answer_delay: Duration::from_micros(700), ..config() });
    let begun = bench.now;
    bench.port.send(bench.now, &[parse("602#4041600000000000")]).unwrap();
    let answer = bench.run_micros(2000)[0];
    // 120 bits of the request, the delay, and the answer.
    let spent = answer.at.since(begun).as_micros();
    assert!((925..=955).contains(&spent), "{spent}");
}

#[test]
fn a_host_that_falls_silent_is_stopped_by_the_drive_itself() {
    let mut bench = Bench::booted(config());
    bench.write("161001", 127 << 16 | 50, 4);
    bench.cyclic();
    let start = bench.read("646000");
    let beat = |bench: &mut Bench, cycles: u32, from: i32| {
        let mut heard = Vec::new();
        for block in 0..cycles / 5 {
            bench.port.send(bench.now, &[parse("77F#05")]).unwrap();
            heard.extend(bench.follow(5, |cycle| from + 10 * (5 * block + cycle) as i32));
        }
        heard
    };
    let heard = beat(&mut bench, 100, start);
    assert!(heard.iter().all(|frame| frame.starts_with("382#")));
    // The host sends nothing more. The axis was moving at 5000 counts/s.
    let heard = bench.run(100);
    assert_eq!(heard, ["082#3081110000000000"]);
    let stood = bench.read("646000");
    assert_eq!(bench.statusword() & 0x6F, 0x07, "quick stop active");
    bench.run(500);
    assert_eq!(bench.read("646000"), stood);
    // When the heartbeat returns, the error ends. The drive is pre-operational and waits.
    assert_eq!(bench.say("77F#05"), ["082#0000000000000000"]);
}

#[test]
fn a_missing_rpdo_is_a_time_out() {
    let mut bench = Bench::booted(config());
    bench.write("021405", 10, 2);
    bench.cyclic();
    let start = bench.read("646000");
    bench.follow(5, |_| start);
    let heard = bench.run(30);
    assert_eq!(heard, ["082#5082110000000000"]);
    assert_eq!(bench.statusword() & 0x6F, 0x07);
    // An RPDO that is too short is reported and not processed. A complete RPDO ends both errors.
    assert_eq!(bench.say("402#0F00"), ["082#1082110000000000"]);
    let heard = bench.follow(1, |_| start);
    assert!(heard.contains(&"082#0000000000000000".to_owned()), "{heard:?}");
}

#[test]
fn other_nodes_frames_change_nothing() {
    let mut bench = Bench::booted(config());
    bench.say("000#0102");
    for frame in ["203#0600", "603#4041600000000000", "183#4006", "000#0203", "703#05"] {
        assert_eq!(bench.say(frame), [""; 0], "{frame}");
    }
    assert_eq!(bench.statusword(), 0x0640);
}

#[test]
fn a_storm_of_arbitrary_frames_leaves_a_device_that_a_reset_revives() {
    use crate::epos4::table::TABLE;
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut bench = Bench::booted(config());
    let ids = [0x000, 0x080, 0x202, 0x302, 0x402, 0x502, 0x602, 0x602, 0x602, 0x602, 0x77F];
    for round in 0..20_000 {
        let id = ids[random() as usize % ids.len()];
        let mut data = random().to_le_bytes();
        let object = TABLE[random() as usize % TABLE.len()].object;
        match (id, random() % 8) {
            // Mostly the start command, so that PDOs are active.
            (0x000, 0..6) => data = [1, 2, 0, 0, 0, 0, 0, 0],
            (0x602, 0..7) => {
                data[1..3].copy_from_slice(&object.index.to_le_bytes());
                data[3] = object.subindex;
                if random() % 2 == 0 {
                    // Small values, and mappings of existing objects.
                    data[5..].fill(0);
                }
                data[0] = [0x23, 0x27, 0x2B, 0x2F, 0x40, 0x60, 0x21][random() as usize % 7];
            }
            _ => {}
        }
        let length = if random() % 8 == 0 {
            random() as usize % 9
        } else if id == 0x000 {
            2
        } else {
            8
        };
        let frame = Frame::new(StandardId::new(id).unwrap(), &data[..length]).unwrap();
        bench.port.send(bench.now, &[frame]).unwrap();
        let heard = bench.run_micros(300 + random() % 3000);
        assert!(heard.len() < 200, "round {round}");
    }
    bench.write_factory_values();
    assert_eq!(bench.statusword() & 0x4F, 0x40);
    assert_eq!(bench.read("656000"), 2000);
}
