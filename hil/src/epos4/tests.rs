use super::*;
use crate::{DeviceId, Irp6Axis, World};
use can::timing::Bitrate;
use can::{Port, Received, StandardId, VirtualPort};

/// A host alone with node 2 on a bus of 1 Mbit/s.
struct Bench {
    world: World,
    port: VirtualPort,
    device: DeviceId,
    now: Instant,
}

fn parse(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let bytes: Vec<u8> = (0..data.len() / 2)
        .map(|at| u8::from_str_radix(&data[2 * at..2 * at + 2], 16).unwrap())
        .collect();
    Frame::new(
        StandardId::new(u16::from_str_radix(id, 16).unwrap()).unwrap(),
        &bytes,
    )
    .unwrap()
}

fn config() -> Epos4Config {
    let axis = AxisConfig::wut(Irp6Axis::ALL[0]);
    Epos4Config::new(NodeId::new(2).unwrap(), axis)
}

impl Bench {
    /// Powered on a moment ago; the boot-up frame is on its way.
    fn new(config: Epos4Config) -> Self {
        let mut world = World::new();
        let bus = world.add_bus(Bitrate::KBPS_1000);
        let port = world.host_port(bus, 256);
        let device = world.add_device(bus, Box::new(Epos4::new(config)));
        Self {
            world,
            port,
            device,
            now: Instant::ZERO,
        }
    }

    /// Booted, the boot-up frame read.
    fn booted(config: Epos4Config) -> Self {
        let mut bench = Self::new(config);
        assert_eq!(bench.run(60), ["702#00"]);
        bench
    }

    /// Lets time pass and returns what the device said.
    fn run(&mut self, millis: u64) -> Vec<String> {
        self.run_micros(millis * 1000)
            .into_iter()
            .map(|received| received.frame.to_string())
            .collect()
    }

    fn run_micros(&mut self, micros: u64) -> Vec<Received> {
        self.now += Duration::from_micros(micros);
        self.world.advance(self.now);
        let mut into = [Received {
            frame: parse("000#"),
            at: Instant::ZERO,
        }; 256];
        let count = self.port.receive(self.now, &mut into).unwrap();
        into[..count].to_vec()
    }

    /// Says something and returns what the device answers within 5 ms.
    fn say(&mut self, text: &str) -> Vec<String> {
        self.port.send(self.now, &[parse(text)]).unwrap();
        self.run(5)
    }

    /// An SDO request and its answer, payloads only.
    fn ask(&mut self, request: &str) -> String {
        let answers = self.say(&format!("602#{request}"));
        let answer = answers
            .iter()
            .find_map(|answer| answer.strip_prefix("582#"));
        answer.unwrap_or("nothing").to_owned()
    }

    /// Writes an object whose address and bytes are given as on the wire.
    fn write(&mut self, object: &str, value: i64, bytes: usize) {
        let specifier = 0x23 | (4 - bytes as u8) << 2;
        let data: String = value.to_le_bytes()[..4]
            .iter()
            .enumerate()
            .map(|(at, byte)| format!("{:02X}", if at < bytes { *byte } else { 0 }))
            .collect();
        let answer = self.ask(&format!("{specifier:02X}{object}{data}"));
        assert_eq!(answer, format!("60{object}00000000"), "writing {object}");
    }

    fn read(&mut self, object: &str) -> i32 {
        let answer = self.ask(&format!("40{object}00000000"));
        assert!(answer.starts_with('4'), "{object}: {answer}");
        let byte = |at: usize| u8::from_str_radix(&answer[8 + 2 * at..10 + 2 * at], 16).unwrap();
        i32::from_le_bytes([byte(0), byte(1), byte(2), byte(3)])
    }

    fn statusword(&mut self) -> u16 {
        self.read("416000") as u16
    }

    /// Brings the drive to operation enabled in a mode.
    fn enable(&mut self, mode: i8) {
        self.write("606000", i64::from(mode), 1);
        for word in [0x06, 0x07, 0x0F] {
            self.write("406000", word, 2);
        }
        assert_eq!(self.statusword() & 0x6F, 0x27);
    }

    /// Follows `target` in CSP for `cycles` of 2 ms with RPDO3 and SYNC; returns the answers.
    fn follow(&mut self, cycles: u32, mut target: impl FnMut(u32) -> i32) -> Vec<String> {
        let mut heard = Vec::new();
        for cycle in 0..cycles {
            let bytes: String = target(cycle)
                .to_le_bytes()
                .iter()
                .map(|byte| format!("{byte:02X}"))
                .collect();
            let batch = [parse("080#"), parse(&format!("402#0F00{bytes}"))];
            self.port.send(self.now, &batch).unwrap();
            heard.extend(self.run(2));
        }
        heard
    }

    /// Cyclic exchange by SYNC: RPDO3 {6040, 607A}, TPDO3 {6041, 6064}; operational and enabled.
    fn cyclic(&mut self) {
        self.write("001401", 0x8000_0202, 4);
        self.write("001801", 0xC000_0182, 4);
        self.write("021402", 1, 1);
        self.write("021401", 0x0000_0402, 4);
        self.write("021802", 1, 1);
        self.write("021803", 0, 2);
        self.write("021801", 0x4000_0382, 4);
        self.write("C26001", 2, 1);
        self.enable(8);
        assert_eq!(self.say("000#0102"), [""; 0]);
    }
}

#[test]
fn an_enabled_epos_says_what_a_real_one_said() {
    let mut bench = Bench::booted(Epos4Config {
        vendor_bits: 1 << 8,
        ..config()
    });
    assert_eq!(bench.say("000#0102"), ["182#4007"]);
    assert_eq!(bench.say("202#0600"), ["182#2107"]);
    assert_eq!(bench.say("202#0700"), ["182#2307"]);
    assert_eq!(bench.say("202#0F00"), ["182#3707"]);
    assert_eq!(bench.say("602#4041600000000000"), ["582#4B41600037070000"]);
}

#[test]
fn the_table_ascends_and_every_default_is_within_its_limits() {
    use super::table::{Kind, TABLE};
    for pair in TABLE.windows(2) {
        assert!(pair[0].object < pair[1].object, "{}", pair[1].object);
    }
    for entry in &TABLE {
        let number = entry.kind.number(entry.default);
        assert!(
            (entry.min..=entry.max).contains(&number),
            "{}",
            entry.object
        );
        let bytes = entry.default.to_le_bytes();
        if !matches!(entry.kind, Kind::Text(_)) {
            let size = entry.kind.size();
            let mut kept = [0; 4];
            kept[..size].copy_from_slice(&bytes[..size]);
            assert_eq!(entry.kind.decode(kept), entry.default, "{}", entry.object);
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
        // No object, no sub-index, read only, too long, too short, too high.
        ("4000500000000000", "8000500000000206"),
        ("4018100900000000", "8018100911000906"),
        ("2B41600001000000", "8041600002000106"),
        ("2340600001000000", "8040600012000706"),
        ("2F40600001000000", "8040600013000706"),
        ("2F29100103000000", "8029100131000906"),
        ("2B5A6000FFFF0000", "805A600032000906"),
        // Modes and methods that EPOS4 lacks, a unit that is no speed.
        ("2F60600007000000", "8060600030000906"),
        ("2F98600005000000", "8098600030000906"),
        ("23A9600000000000", "80A9600030000906"),
        // An empty history; only 0 clears it; a wrong password to store.
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
        // The PDO exists: neither its count nor its entries nor its identifier may change.
        ("2F00160000000000", "8000160022000008"),
        ("2300160108006060", "8000160122000008"),
        ("2300140122020000", "8000140130000906"),
        ("2B00180300000000", "8000180322000008"),
        // Off; but entries are locked while the count is not 0.
        ("2300140102020080", "6000140100000000"),
        ("2300160108006060", "8000160103000106"),
        ("2F00160000000000", "6000160000000000"),
        // Not mappable to receive, wrong size, no such object, statusword.
        ("2300160110004160", "8000160141000406"),
        ("2300160120004060", "8000160141000406"),
        ("2300160110000050", "8000160100000206"),
        // Three objects of 32 bits are too many, two with a word are too many as well.
        ("2300160120007A60", "6000160100000000"),
        ("230016022000FF60", "6000160200000000"),
        ("2300160310004060", "6000160300000000"),
        ("2F00160003000000", "8000160042000406"),
        ("2F00160009000000", "8000160031000906"),
        ("2F00160002000000", "6000160000000000"),
        // Reserved identifiers do not become PDOs.
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
    // Booting: deaf.
    assert_eq!(bench.say("602#4041600000000000"), [""; 0]);
    assert_eq!(bench.run(60), ["702#00"]);
    let status = "602#4041600000000000";
    assert_eq!(bench.say(status).len(), 1);
    // PDOs only in operational.
    assert_eq!(bench.say("202#0600"), [""; 0]);
    assert_eq!(bench.say("000#0102"), ["182#4006"]);
    assert_eq!(bench.say("202#0600"), ["182#2106"]);
    // Stopped: SDO is dead; commands for others and nonsense are ignored.
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
    // What was saved survives, until the factory values are loaded.
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
fn heartbeats_come_at_their_period_and_say_the_state() {
    let mut bench = Bench::booted(config());
    bench.write("171000", 10, 2);
    assert_eq!(bench.run(30), ["702#7F"; 3]);
    bench.say("000#0202");
    assert_eq!(bench.run(20), ["702#04"; 2]);
}

#[test]
fn answers_take_their_delay() {
    let mut bench = Bench::booted(Epos4Config {
        answer_delay: Duration::from_micros(700),
        ..config()
    });
    let begun = bench.now;
    bench
        .port
        .send(bench.now, &[parse("602#4041600000000000")])
        .unwrap();
    let answer = bench.run_micros(2000)[0];
    // 120 bits of request, the delay, then the answer itself.
    let spent = answer.at.since(begun).as_micros();
    assert!((925..=955).contains(&spent), "{spent}");
}

#[test]
fn a_set_point_takes_effect_at_the_sync_after_it() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    bench.follow(3, |_| start);
    // Demand 0x6062 while two set-points arrive before one SYNC: the second wins, at SYNC.
    let set = |target: i32| {
        let bytes: String = target
            .to_le_bytes()
            .iter()
            .map(|b| format!("{b:02X}"))
            .collect();
        parse(&format!("402#0F00{bytes}"))
    };
    bench
        .port
        .send(bench.now, &[set(start + 400), set(start + 20)])
        .unwrap();
    bench.run(2);
    assert_eq!(bench.read("626000"), start);
    bench.port.send(bench.now, &[parse("080#")]).unwrap();
    bench.run(5);
    assert_eq!(bench.read("626000"), start + 20);
}

#[test]
fn cyclic_positions_are_followed_and_answered_at_every_sync() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    let heard = bench.follow(500, |cycle| start + 4 * cycle as i32);
    assert_eq!(heard.len(), 500);
    assert!(
        heard.iter().all(|frame| frame.starts_with("382#")),
        "{heard:?}"
    );
    // Operation enabled, remote, and following (bit 12).
    assert!(
        heard.last().unwrap().starts_with("382#3712"),
        "{:?}",
        heard.last()
    );
    let reached = bench.read("646000");
    let expected = start + 4 * 499;
    assert!((reached - expected).abs() < 20, "{reached} {expected}");
}

#[test]
fn a_jump_of_the_set_point_is_a_following_error() {
    let mut bench = Bench::booted(config());
    bench.cyclic();
    let start = bench.read("646000");
    bench.follow(5, |_| start);
    let heard = bench.follow(50, |_| start + 100_000);
    // EMCY: 0x8611, generic and vendor bits; it is said once.
    let emergencies: Vec<_> = heard.iter().filter(|f| f.starts_with("082#")).collect();
    assert_eq!(emergencies, ["082#1186810000000000"]);
    bench.follow(500, |_| start);
    assert_eq!(bench.statusword() & 0x6F, 0x08);
    assert_eq!(bench.read("3F6000"), 0x8611);
    assert_eq!(bench.ask("4003100100000000"), "4303100111860000");
    // Bit 7 must rise; a standing enable does not clear the fault.
    bench.write("406000", 0x0F, 2);
    assert_eq!(bench.statusword() & 0x6F, 0x08);
    let answers = bench.say("602#2B40600080000000");
    assert!(
        answers.contains(&"082#0000000000000000".to_owned()),
        "{answers:?}"
    );
    assert_eq!(bench.statusword() & 0x4F, 0x40);
    assert_eq!(bench.read("011000"), 0);
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
    // Nothing more is said to it. It was moving at 5000 counts/s.
    let heard = bench.run(100);
    assert_eq!(heard, ["082#3081110000000000"]);
    let stood = bench.read("646000");
    assert_eq!(bench.statusword() & 0x6F, 0x07, "quick stop active");
    bench.run(500);
    assert_eq!(bench.read("646000"), stood);
    // Heard again, the error is gone; the drive is pre-operational and waits.
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
    // A short one is not processed and says so; a complete one ends both.
    assert_eq!(bench.say("402#0F00"), ["082#1082110000000000"]);
    let heard = bench.follow(1, |_| start);
    assert!(
        heard.contains(&"082#0000000000000000".to_owned()),
        "{heard:?}"
    );
}

#[test]
fn a_missing_sync_is_held_or_a_fault_as_configured() {
    for (sync_loss, silent) in [
        (SyncLoss::Hold, true),
        (SyncLoss::Fault { periods: 3 }, false),
    ] {
        let mut bench = Bench::booted(Epos4Config {
            sync_loss,
            ..config()
        });
        bench.cyclic();
        let start = bench.read("646000");
        bench.follow(5, |_| start);
        assert_eq!(bench.run(30).is_empty(), silent, "{sync_loss:?}");
    }
}

#[test]
fn profile_position_acknowledges_a_set_point_and_reaches_it() {
    let mut bench = Bench::booted(config());
    bench.enable(1);
    let start = bench.read("646000");
    bench.write("7A6000", i64::from(start + 3000), 4);
    bench.write("406000", 0x1F, 2);
    let word = bench.statusword();
    assert_eq!(
        word & 0x1400,
        0x1000,
        "acknowledged, not reached: {word:#06x}"
    );
    // Another set-point waits behind it, and is acknowledged until there is room again.
    bench.write("406000", 0x0F, 2);
    assert_eq!(bench.statusword() & 0x1000, 0);
    bench.write("7A6000", 1000, 4);
    bench.write("406000", 0x5F, 2);
    bench.write("406000", 0x4F, 2);
    assert_eq!(bench.statusword() & 0x1000, 0x1000);
    bench.run(1000);
    assert_eq!(bench.statusword() & 0x1400, 0x0400);
    let reached = bench.read("646000");
    assert!((reached - start - 4000).abs() <= 5, "{}", reached - start);
}

#[test]
fn profile_velocity_reaches_its_target_and_halts() {
    let mut bench = Bench::booted(config());
    bench.enable(3);
    bench.write("FF6000", -100, 4);
    bench.run(500);
    assert_eq!(bench.statusword() & 0x1400, 0x0400);
    assert!((bench.read("6C6000") + 100).abs() <= 3);
    bench.write("406000", 0x010F, 2);
    bench.run(500);
    assert_eq!(bench.statusword() & 0x1400, 0x1400);
    assert!(bench.read("6C6000").abs() <= 1);
}

#[test]
fn cyclic_velocity_and_torque_go_straight_to_their_loops() {
    let mut bench = Bench::booted(config());
    bench.enable(9);
    assert_eq!(bench.statusword() & 0x1000, 0x1000, "follows");
    bench.write("FF6000", 150, 4);
    bench.write("B16000", -50, 4);
    bench.run(300);
    assert!((bench.read("6C6000") - 100).abs() <= 3);
    bench.write("606000", 10, 1);
    bench.write("716000", -50, 2);
    bench.write("B26000", 30, 2);
    bench.run(5);
    assert_eq!(bench.read("776000") as i16, -20);
    bench.run(100);
    assert!(bench.read("6C6000") < 100);
}

#[test]
fn bits_of_the_cyclic_modes_are_shown_or_not_as_configured() {
    let mut bench = Bench::booted(Epos4Config {
        cyclic_status: CyclicStatus::Silent,
        ..config()
    });
    bench.enable(8);
    assert_eq!(bench.statusword() & 0x1400, 0);
}

#[test]
fn a_cyclic_drive_enabled_without_a_set_point_jumps_to_its_old_one() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 37, 1);
    bench.write("B03000", 50_000, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    bench.write("406000", 0x06, 2);
    bench.enable(8);
    bench.say("000#0102");
    let heard = bench.say("080#");
    assert_eq!(heard.first().unwrap(), "082#1186810000000000");
}

#[test]
fn commands_brake_on_the_ramp_of_their_option() {
    // Controlword, option and its value, how long the way to a stand takes from 100 rpm.
    let cases: [(i64, &str, i64, u64); 4] = [
        // Disable operation and shutdown on 0x6084, 500 rpm/s.
        (0x07, "5C6000", 1, 200),
        (0x06, "5B6000", 1, 200),
        // Quick stop on 0x6084, and on 0x6085, 1000 rpm/s.
        (0x0B, "5A6000", 5, 200),
        (0x0B, "5A6000", 2, 100),
    ];
    for (word, option, value, millis) in cases {
        let mut bench = Bench::booted(config());
        bench.write(option, value, 2);
        bench.write("846000", 500, 4);
        bench.write("856000", 1000, 4);
        bench.enable(3);
        bench.write("FF6000", 100, 4);
        bench.run(300);
        bench.write("406000", word, 2);
        bench.run(millis / 2 - 5);
        let halfway = bench.read("6B6000");
        assert!((40..=60).contains(&halfway), "{option} {value}: {halfway}");
        bench.run(millis / 2 + 10);
        let state = bench.statusword() & 0x6F;
        let expected = match (word, value) {
            (0x07, _) => 0x23,
            (0x06, _) => 0x21,
            (_, 5) => 0x07,
            _ => 0x40,
        };
        assert_eq!(state, expected, "{option} {value}");
        assert!(bench.read("6C6000").abs() <= 5);
    }
}

#[test]
fn enabling_again_ends_the_braking() {
    let mut bench = Bench::booted(config());
    bench.write("846000", 500, 4);
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    bench.run(300);
    bench.write("406000", 0x07, 2);
    bench.run(50);
    bench.write("406000", 0x0F, 2);
    bench.run(300);
    assert_eq!(bench.statusword() & 0x6F, 0x27);
    assert!((bench.read("6C6000") - 100).abs() <= 3);
}

#[test]
fn silence_is_answered_as_the_abort_connection_option_says() {
    // Option, error register of the EMCY, state afterwards.
    for (option, state) in [(0, 0x27), (1, 0x08), (2, 0x40), (3, 0x07)] {
        let mut bench = Bench::booted(config());
        bench.write("076000", option, 2);
        bench.write("161001", 127 << 16 | 20, 4);
        bench.enable(1);
        // Never heard, never missed.
        assert_eq!(bench.run(100), [""; 0]);
        bench.say("77F#05");
        assert_eq!(bench.run(100), ["082#3081110000000000"]);
        let found = bench.statusword() & 0x6F;
        assert_eq!(found, state, "0x6007 = {option}");
    }
}

#[test]
fn stopping_or_resetting_a_node_in_motion_stops_its_axis() {
    for (command, state) in [("000#0202", 0x07), ("000#8102", 0x40), ("000#8202", 0x07)] {
        let mut bench = Bench::booted(config());
        bench.enable(3);
        bench.write("FF6000", 100, 4);
        bench.run(200);
        bench.say(command);
        bench.run(1000);
        bench.say("000#8002");
        assert!(bench.read("6C6000").abs() <= 1, "{command}");
        assert_eq!(bench.statusword() & 0x6F, state, "{command}");
    }
}

#[test]
fn a_limit_switch_is_a_fault_from_which_one_can_drive_away() {
    let mut axis = AxisConfig::wut(Irp6Axis::ALL[0]);
    axis.positive_limit = Some(crate::plant::Switch {
        from: axis.start_angle + 3.0,
        to: f64::INFINITY,
        bounce: 0,
    });
    let mut bench = Bench::booted(Epos4Config {
        axis,
        ..Epos4Config::new(NodeId::new(2).unwrap(), axis)
    });
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    assert_eq!(bench.run(1000), ["082#818A810000000000"]);
    assert_eq!(bench.statusword() & 0x6F, 0x08);
    assert_eq!(bench.read("FD6000"), 0b10);
    bench.write("FF6000", -100, 4);
    bench.say("602#2B40600080000000");
    bench.enable(3);
    assert_eq!(bench.run(1000), [""; 0]);
    assert_eq!(bench.read("FD6000"), 0);
}

#[test]
fn transmission_types_decide_when_a_pdo_is_sent() {
    let mut bench = Bench::booted(config());
    // Every second SYNC.
    bench.write("001802", 2, 1);
    bench.say("000#0102");
    let heard: Vec<usize> = (0..4).map(|_| bench.say("080#").len()).collect();
    assert_eq!(heard, [0, 1, 0, 1]);
    // At a SYNC after a change.
    bench.say("000#8002");
    bench.write("001802", 0, 1);
    bench.say("000#0102");
    assert_eq!(bench.say("080#"), ["182#4006"]);
    assert_eq!(bench.say("080#"), [""; 0]);
    bench.say("202#0600");
    assert_eq!(bench.say("080#"), ["182#2106"]);
    // On a change or when the event timer expires.
    bench.say("000#8002");
    bench.write("001802", 255, 1);
    bench.write("001805", 10, 2);
    assert_eq!(bench.say("000#0102").len(), 1);
    assert_eq!(bench.run(50).len(), 5);
}

#[test]
fn other_nodes_frames_change_nothing() {
    let mut bench = Bench::booted(config());
    bench.say("000#0102");
    for frame in [
        "203#0600",
        "603#4041600000000000",
        "183#4006",
        "000#0203",
        "703#05",
    ] {
        assert_eq!(bench.say(frame), [""; 0], "{frame}");
    }
    assert_eq!(bench.statusword(), 0x0640);
}

#[test]
fn finer_velocity_units_scale_targets_and_answers() {
    let mut bench = Bench::booted(config());
    bench.write("A96000", 0xFDB4_4700, 4);
    bench.write("7F6000", 50_000_000, 4);
    bench.write("806000", 50_000_000, 4);
    bench.enable(3);
    bench.write("FF6000", 100_500, 4);
    bench.run(500);
    assert!((bench.read("6C6000") - 100_500).abs() <= 3_000);
}

#[test]
fn homing_sets_the_counter_and_the_referenced_bit() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 11, 1);
    bench.write("996001", 200, 4);
    bench.write("996002", 60, 4);
    bench.write("B03000", 500, 4);
    bench.enable(6);
    assert_eq!(bench.statusword() & 0xB400, 0x0400, "not started");
    bench.write("406000", 0x1F, 2);
    assert_eq!(bench.statusword() & 0xB400, 0, "in progress");
    bench.run(5000);
    let word = bench.statusword();
    assert_eq!(word & 0xB400, 0x9400, "done: {word:#06x}");
    assert!(
        (bench.read("646000") - 500).abs() <= 2,
        "{}",
        bench.read("646000")
    );
    // Leaving homing keeps the reference; a reset of the node loses it.
    bench.write("606000", 8, 1);
    assert_eq!(bench.statusword() & 0x8000, 0x8000);
    bench.say("000#8102");
    bench.run(60);
    assert_eq!(bench.statusword() & 0x8000, 0);
    assert_eq!(bench.read("646000"), 0);
}

#[test]
fn each_axis_of_an_irp6_is_homed_to_its_index() {
    for which in Irp6Axis::ALL {
        let axis = AxisConfig::irp6(which);
        let mut bench = Bench::booted(Epos4Config {
            axis,
            ..Epos4Config::new(NodeId::new(2).unwrap(), axis)
        });
        bench.write("986000", 11, 1);
        bench.write("996001", 143, 4);
        bench.write("996002", 33, 4);
        bench.enable(6);
        bench.write("406000", 0x1F, 2);
        bench.run(10_000);
        let word = bench.statusword();
        assert_eq!(word & 0xB400, 0x9400, "{which:?}: {word:#06x}");
        let counts = f64::from(bench.read("646000"));
        let device: &Epos4 = bench.world.device(bench.device).unwrap();
        let count = std::f64::consts::TAU / f64::from(axis.counts_per_revolution);
        let angle = (device.axis().angle() - axis.index_angle) / count;
        assert!(
            (counts - angle).abs() <= 1.5,
            "{which:?}: {counts} at {angle}"
        );
        assert!(counts.abs() <= 5.0, "{which:?} rests at {counts}");
    }
}

#[test]
fn homing_in_place_moves_nothing() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 37, 1);
    bench.write("B03000", -1234, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    assert_eq!(bench.statusword() & 0xB400, 0x9400);
    let position = bench.read("646000");
    assert!((position + 1234).abs() <= 1, "{position}");
}

#[test]
fn software_limits_hold_once_the_position_is_referenced() {
    let mut bench = Bench::booted(config());
    bench.write("986000", 37, 1);
    bench.write("7D6001", -1000, 4);
    bench.write("7D6002", 1000, 4);
    bench.enable(6);
    bench.write("406000", 0x1F, 2);
    bench.run(10);
    bench.write("406000", 0x0F, 2);
    bench.write("606000", 1, 1);
    bench.write("7A6000", 1001, 4);
    let answers = bench.say("602#2B4060001F000000");
    assert!(
        answers.contains(&"082#828A810000000000".to_owned()),
        "{answers:?}"
    );
}

#[test]
fn the_same_input_gives_the_same_frames_at_the_same_times() {
    let run = || {
        let mut bench = Bench::booted(config());
        bench.cyclic();
        let start = bench.read("646000");
        let mut all = Vec::new();
        for cycle in 0..500_i32 {
            let bytes: String = (start + cycle * cycle / 50)
                .to_le_bytes()
                .iter()
                .map(|byte| format!("{byte:02X}"))
                .collect();
            let batch = [parse("080#"), parse(&format!("402#0F00{bytes}"))];
            bench.port.send(bench.now, &batch).unwrap();
            all.extend(bench.run_micros(2000));
        }
        all
    };
    let first = run();
    assert_eq!(first.len(), 500);
    assert!(first == run());
}
