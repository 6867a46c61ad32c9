//! Outputs: SDO and RPDO, polarity, filter mask, error values, supply.

use super::*;

/// The host's heartbeat, node 127, and its supervision within 100 ms.
const HEARTBEAT: &str = "77F#05";

fn supervised() -> Bench {
    let mut bench = Bench::booted(config());
    bench.write("161001", 127 << 16 | 100, 4);
    bench.say(HEARTBEAT);
    bench
}

#[test]
fn an_output_follows_sdo_and_rpdo() {
    let mut bench = Bench::booted(config());
    bench.write("006201", 0x81, 1);
    assert_eq!(bench.outputs(), 0x81);
    // An RPDO has no effect before operational.
    bench.say("205#FF");
    assert_eq!(bench.outputs(), 0x81);
    bench.say("000#0105");
    bench.say("205#FE");
    assert_eq!(bench.outputs(), 0xFE);
    assert_eq!(bench.read("006201"), 0xFE);
}

#[test]
fn an_output_has_the_time_of_its_change() {
    let mut bench = Bench::operational(config());
    assert_eq!(bench.module().output(0), OutputState::default());
    bench.send("205#01");
    let sent = bench.now;
    bench.run(5);
    let OutputState { level, changed_at } = bench.module().output(0);
    let after = changed_at.unwrap().since(sent).as_micros();
    // The frame ends after 55 to 66 bits of 1 µs.
    assert!(level && (50..70).contains(&after), "{after} µs");
    // The same value again is no change.
    bench.say("205#03");
    assert_eq!(bench.module().output(0).changed_at, changed_at);
    assert!(bench.module().output(1).changed_at > changed_at);
    assert_eq!(bench.module().output(200), OutputState::default());
}

#[test]
fn a_probe_shows_the_level_at_the_terminal_of_its_output() {
    let mut module = DigitalIo::new(config()).unwrap();
    let (probe, absent) = (OutputProbe::default(), OutputProbe::default());
    module.connect(1, &probe);
    module.connect(60, &absent);
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let port = world.host_port(bus, 256);
    let device = world.add_device(bus, Box::new(module));
    let mut bench = Bench { world, bus, port, device, now: Instant::ZERO };
    bench.run(60);
    bench.say("000#0105");
    for (command, level) in [("205#02", true), ("205#03", true), ("205#01", false), ("205#02", true)] {
        bench.say(command);
        assert_eq!((probe.level(), absent.level()), (level, false), "{command}");
    }
    // A reset of the node switches the outputs off.
    bench.say("000#8105");
    assert!(!probe.level());
}

#[test]
fn a_synchronous_rpdo_waits_for_sync() {
    let mut bench = Bench::booted(config());
    bench.write("001402", 1, 1);
    bench.say("000#0105");
    bench.say("205#01");
    bench.say("205#02");
    assert_eq!(bench.outputs(), 0);
    bench.say("080#");
    assert_eq!(bench.outputs(), 2);
}

#[test]
fn polarity_and_filter_mask_shape_the_outputs() {
    let mut bench = Bench::booted(config());
    bench.write("026201", 0x0F, 1);
    assert_eq!(bench.outputs(), 0x0F);
    bench.write("006201", 0x11, 1);
    assert_eq!(bench.outputs(), 0x1E);
    // The upper half keeps its level from now on.
    bench.write("086201", 0x0F, 1);
    bench.write("006201", 0xF2, 1);
    assert_eq!(bench.outputs(), 0x1D);
    bench.write("086201", 0xFF, 1);
    assert_eq!(bench.outputs(), 0xFD);
}

#[test]
fn an_error_sets_outputs_to_the_error_value_until_the_next_write() {
    type Failure = fn(&mut Bench);
    let failures: [(&str, Failure); 4] = [
        ("lost heartbeat", |bench| {
            assert_eq!(bench.run(200), ["085#3081110000000000"]);
        }),
        ("NMT stop", |bench| {
            bench.say("000#0205");
        }),
        ("reset communication", |bench| {
            bench.say("000#8205");
            bench.run(60);
        }),
        ("overdue RPDO", |bench| {
            bench.write("001405", 10, 2);
            bench.say("205#33");
            assert_eq!(bench.run(20), ["085#5082110000000000"]);
        }),
    ];
    for (name, failure) in failures {
        let mut bench = supervised();
        bench.write("066201", 0xF0, 1);
        bench.write("076201", 0xAA, 1);
        bench.say("000#0105");
        bench.say("205#33");
        assert_eq!(bench.outputs(), 0x33, "{name}");
        bench.say(HEARTBEAT);
        failure(&mut bench);
        // Bits 4 to 7 have their error value, bits 0 to 3 keep their level.
        assert_eq!(bench.outputs(), 0xA3, "{name}");
        // The end of the error and a changed polarity alone change nothing.
        bench.say(HEARTBEAT);
        bench.say("000#0105");
        bench.write("026201", 0x01, 1);
        assert_eq!(bench.outputs(), 0xA3, "{name}");
        bench.say("205#33");
        assert_eq!(bench.outputs(), 0x32, "{name}");
    }
}

#[test]
fn heartbeats_in_time_leave_the_outputs() {
    let mut bench = supervised();
    bench.write("006201", 0xFF, 1);
    for _ in 0..10 {
        bench.say(HEARTBEAT);
        bench.run(80);
    }
    assert_eq!(bench.outputs(), 0xFF);
}

#[test]
fn the_error_behaviour_chooses_the_state_after_a_lost_heartbeat() {
    for (behaviour, state) in [(0, "7F"), (1, "05"), (2, "04")] {
        let mut bench = supervised();
        bench.write("291001", behaviour, 1);
        bench.write("006201", 0xFF, 1);
        bench.say("000#0105");
        bench.write("171000", 50, 2);
        bench.say(HEARTBEAT);
        let heard = bench.run(300);
        assert_eq!(heard.last(), Some(&format!("705#{state}")), "{behaviour}");
        assert_eq!(bench.outputs(), 0, "{behaviour}");
    }
}

#[test]
fn an_rpdo_with_too_few_bytes_leaves_the_outputs() {
    let mut bench = Bench::booted(DigitalIoConfig { output_bytes: 2, ..config() });
    bench.say("000#0105");
    bench.say("205#1234");
    assert_eq!(bench.outputs(), 0x3412);
    assert_eq!(bench.say("205#FF"), ["085#1082110000000000"]);
    assert_eq!(bench.outputs(), 0x3412);
}

#[test]
fn a_reset_of_the_node_switches_the_outputs_off() {
    let mut bench = Bench::booted(config());
    bench.write("076201", 0xFF, 1);
    bench.write("006201", 0xFF, 1);
    bench.say("000#8105");
    assert_eq!(bench.outputs(), 0);
    assert_eq!(bench.run(60), ["705#00"]);
    assert_eq!(bench.outputs(), 0);
    assert_eq!(bench.read("076201"), 0);
}

#[test]
fn a_module_without_supply_is_silent_and_its_outputs_are_low() {
    let mut bench = Bench::booted(config());
    bench.write("076201", 0xFF, 1);
    bench.write("101001", 0x6576_6173, 4);
    bench.write("171000", 10, 2);
    bench.say("000#0105");
    bench.say("205#FF");
    let now = bench.now;
    bench.world.change(bench.device, now, |module: &mut DigitalIo| module.set_power(false, now)).unwrap();
    assert_eq!(bench.outputs(), 0);
    bench.edge(0, 0, true);
    bench.send("000#0105");
    assert_eq!(bench.run(100), [""; 0]);
    let now = bench.now;
    bench.world.change(bench.device, now, |module: &mut DigitalIo| module.set_power(true, now)).unwrap();
    assert_eq!(bench.run(60), ["705#00"]);
    // A stored value is kept, and the terminal has changed meanwhile.
    assert_eq!(bench.read("076201"), 0xFF);
    assert_eq!(bench.read("006001"), 1);
}
