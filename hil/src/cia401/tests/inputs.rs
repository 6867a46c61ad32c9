//! Inputs: edges at their time, polarity, filter, interrupt masks, light gates.

use super::*;
use crate::scene::STEP;
use crate::{AxisConfig, Epos4, Epos4Config, Irp6Axis, Scene};

#[test]
fn an_edge_is_a_pdo_at_the_time_of_the_edge() {
    let mut bench = Bench::operational(config());
    bench.edge(1_500, 3, true);
    bench.edge(2_500, 3, false);
    let begun = bench.now;
    let heard = bench.run_micros(5_000);
    let sent: Vec<_> =
        heard.iter().map(|received| (received.frame.to_string(), received.at.since(begun).as_micros())).collect();
    // A frame with one byte takes 55 to 65 bits of 1 µs.
    assert_eq!(sent.len(), 2, "{sent:?}");
    assert!(sent[0].0 == "185#08" && (1_550..1_570).contains(&sent[0].1), "{sent:?}");
    assert!(sent[1].0 == "185#00" && (2_550..2_570).contains(&sent[1].1), "{sent:?}");
}

#[test]
fn edges_of_the_configuration_occur_before_and_after_the_boot() {
    let edge = |millis, index, level| InputEdge { at: Instant::ZERO + Duration::from_millis(millis), index, level };
    // Not in the order of their times.
    let edges = vec![edge(100, 1, true), edge(10, 0, true), edge(20, 7, true), edge(30, 7, false)];
    let mut bench = Bench::booted(DigitalIoConfig { edges, ..config() });
    assert_eq!(bench.say("000#0105"), ["185#01"]);
    assert_eq!(bench.run(100), ["185#03"]);
    assert_eq!(bench.module().inputs(), 3);
}

#[test]
fn an_edge_of_an_absent_input_is_refused() {
    let refused = DigitalIoError::NoInput { index: 8, inputs: 8 };
    let mut module = DigitalIo::new(config()).unwrap();
    assert_eq!(module.set_input(Instant::ZERO, 8, true), Err(refused));
    let edges = vec![InputEdge { at: Instant::ZERO, index: 8, level: true }];
    assert_eq!(DigitalIo::new(DigitalIoConfig { edges, ..config() }).err(), Some(refused));
    let wide = DigitalIo::new(DigitalIoConfig { input_bytes: 9, ..config() });
    assert_eq!(wide.err(), Some(DigitalIoError::TooManyBytes { bytes: 9 }));
}

#[test]
fn polarity_inverts_an_input() {
    let mut bench = Bench::operational(config());
    bench.edge(0, 0, true);
    assert_eq!(bench.run(1), ["185#01"]);
    bench.send(&format!("605#{}", download("026001", 0x81, 1)));
    assert_eq!(bench.run(5), ["185#80", "585#6002600100000000"]);
    bench.edge(0, 0, false);
    assert_eq!(bench.run(1), ["185#81"]);
    assert_eq!(bench.read("006001"), 0x81);
}

#[test]
fn a_filtered_input_needs_its_level_for_the_filter_time() {
    let mut bench = Bench::booted(DigitalIoConfig { filter_time: Duration::from_millis(3), ..config() });
    bench.write("036001", 0x01, 1);
    assert_eq!(bench.say("000#0105"), ["185#00"]);
    // Input 0 bounces twice and then stays. Input 1 has no filter.
    for (micros, index, level) in
        [(0, 0, true), (2_900, 0, false), (3_000, 0, true), (5_900, 0, false), (6_000, 0, true), (6_000, 1, true)]
    {
        bench.edge(micros, index, level);
    }
    let begun = bench.now;
    let heard = bench.run_micros(20_000);
    let frames: Vec<_> = heard.iter().map(|received| received.frame.to_string()).collect();
    assert_eq!(frames, ["185#02", "185#03"]);
    let at = heard[1].at.since(begun).as_micros();
    assert!((9_050..9_070).contains(&at), "{at} µs");
}

#[test]
fn a_filter_that_is_switched_off_lets_a_waiting_level_pass() {
    let mut bench = Bench::booted(DigitalIoConfig { filter_time: Duration::from_secs(1), ..config() });
    bench.write("036001", 0xFF, 1);
    bench.edge(0, 2, true);
    bench.run(10);
    assert_eq!(bench.read("006001"), 0);
    bench.write("036001", 0, 1);
    assert_eq!(bench.read("006001"), 4);
}

#[test]
fn interrupt_masks_choose_the_edges_that_send() {
    // Objects 0x6005 to 0x6008, and whether a rising and a falling edge of input 0 are sent.
    for (enable, any, rising, falling, sent) in [
        (1, 0xFF, 0x00, 0x00, [true, true]),
        (0, 0xFF, 0xFF, 0xFF, [false, false]),
        (1, 0x00, 0x00, 0x00, [false, false]),
        (1, 0x00, 0x01, 0x00, [true, false]),
        (1, 0x00, 0x00, 0x01, [false, true]),
        (1, 0x00, 0x01, 0x01, [true, true]),
        (1, 0xFE, 0xFE, 0xFE, [false, false]),
        (1, 0x01, 0x02, 0x02, [true, true]),
    ] {
        let mut bench = Bench::booted(config());
        for (object, value) in [("056000", enable), ("066001", any), ("076001", rising), ("086001", falling)] {
            bench.write(object, value, 1);
        }
        assert_eq!(bench.say("000#0105"), ["185#00"]);
        let case = (enable, any, rising, falling);
        for (level, sent) in [(true, sent[0]), (false, sent[1])] {
            bench.edge(0, 0, level);
            let expected: &[&str] = match (sent, level) {
                (false, _) => &[],
                (true, true) => &["185#01"],
                (true, false) => &["185#00"],
            };
            assert_eq!(bench.run(5), expected, "{case:?}, {level}");
            // Object 0x6000 shows the level without an interrupt as well.
            assert_eq!(bench.read("006001"), u32::from(level), "{case:?}");
        }
    }
}

#[test]
fn the_interrupt_enable_is_a_boolean() {
    let mut bench = Bench::booted(config());
    assert_eq!(bench.read("056000"), 1);
    assert_eq!(bench.ask(&download("056000", 2, 1)), "8005600030000906");
    bench.write("056000", 0, 1);
}

#[test]
fn a_light_gate_is_high_while_an_axis_is_inside_its_interval() {
    let axis = AxisConfig::wut(Irp6Axis::ALL[0]);
    let mut drive = Epos4::new(Epos4Config::new(NodeId::new(2).unwrap(), axis));
    // The load turns at half the speed of the motor.
    let gate =
        LightGate { index: 6, probe: drive.probe(), zero_angle: axis.start_angle, ratio: 0.5, interval: 0.5..=1.5 };
    let mut bench = Bench::new(DigitalIoConfig { light_gates: vec![gate], ..config() });
    let device = bench.world.add_device(bench.bus, Box::new(drive));
    bench.run(60);
    // Profile velocity, 60 rpm, at node 2.
    bench.write_node(2, "606000", 3, 1);
    for word in [0x06, 0x07, 0x0F] {
        bench.write_node(2, "406000", word, 2);
    }
    bench.send("000#0105");
    bench.run(5);
    bench.write_node(2, "FF6000", 60, 4);
    let mut sent = Vec::new();
    for _ in 0..1_000 {
        let frames = bench.run(1);
        let drive: &Epos4 = bench.world.device(device).unwrap();
        let load = (drive.axis().angle() - axis.start_angle) * 0.5;
        sent.extend(frames.into_iter().filter(|frame| frame.starts_with("185#")).map(|frame| (frame, load)));
    }
    // 3.1 rad of the load per second: 0.01 rad are three looks.
    assert_eq!(sent.len(), 2, "{sent:?}");
    assert!(sent[0].0 == "185#40" && (0.5..0.51).contains(&sent[0].1), "{sent:?}");
    assert!(sent[1].0 == "185#00" && (1.5..1.51).contains(&sent[1].1), "{sent:?}");
}

#[test]
fn level_of_the_scene_is_a_pdo_at_the_next_step() {
    let probe = InputProbe::default();
    let mut bench = Bench::operational(DigitalIoConfig { probes: vec![(2, probe.clone())], ..config() });
    bench.world.set_scene(Scene::new());
    let mut stamps = Vec::new();
    for level in [true, false] {
        probe.set(level);
        let begun = bench.now;
        let heard = bench.run_micros(1_000);
        stamps.extend(heard.iter().map(|one| (one.frame.to_string(), one.at.since(begun))));
    }
    // The first step follows after 100 µs. A frame with one byte takes 55 to 65 bits of 1 µs.
    let frame = STEP + Duration::from_micros(50)..STEP + Duration::from_micros(70);
    let texts: Vec<_> = stamps.iter().map(|(text, _)| text.as_str()).collect();
    assert_eq!(texts, ["185#04", "185#00"]);
    assert!(stamps.iter().all(|(_, after)| frame.contains(after)), "{stamps:?}");
}

#[test]
fn level_of_the_scene_at_a_module_without_supply_is_that_after_power_on() {
    let probe = InputProbe::default();
    let mut bench = Bench::operational(DigitalIoConfig { probes: vec![(0, probe.clone())], ..config() });
    bench.world.set_scene(Scene::new());
    let now = bench.now;
    let switch = |on| move |module: &mut DigitalIo| module.set_power(on, now);
    bench.world.change(bench.device, now, switch(false)).unwrap();
    for level in [true, false, true] {
        probe.set(level);
        assert_eq!(bench.run(10), Vec::<String>::new());
    }
    let now = bench.now;
    bench.world.change(bench.device, now, move |module: &mut DigitalIo| module.set_power(true, now)).unwrap();
    assert_eq!(bench.run(60), ["705#00"]);
    assert_eq!(bench.say("000#0105"), ["185#01"]);
}

#[test]
fn source_of_an_absent_input_is_refused() {
    let probes = vec![(8, InputProbe::default())];
    let refused = DigitalIo::new(DigitalIoConfig { probes, ..config() }).err();
    assert_eq!(refused, Some(DigitalIoError::NoInput { index: 8, inputs: 8 }));
}
