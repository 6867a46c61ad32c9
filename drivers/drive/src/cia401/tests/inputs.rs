//! Inputs: levels, edges and their times.

use std::time::Duration;

use can::Instant;

use super::bench::*;

fn input(bench: &Bench, number: u8) -> Input {
    image(bench).input(number).unwrap()
}

#[test]
fn an_edge_has_the_time_at_which_its_frame_was_received() {
    let mut bench = up();
    cycle(&mut bench, &[]);
    // The first inputs were 0x0201: no edges, but levels.
    for (number, level) in [(0, true), (1, false), (9, true)] {
        assert_eq!(input(&bench, number), Input { level, edges: 0, last_edge: None });
    }
    cycle(&mut bench, &["185#0302"]);
    let received = bench.now - PERIOD / 2;
    assert_eq!(input(&bench, 1), Input { level: true, edges: 1, last_edge: Some(received) });
    assert_eq!(input(&bench, 0), Input { level: true, edges: 0, last_edge: None });
    assert_eq!((image(&bench).received, image(&bench).at), (received, bench.now));
    // The life sign is no edge.
    cycle(&mut bench, &["185#0302"]);
    assert_eq!(input(&bench, 1).last_edge, Some(received));
    assert_eq!(image(&bench).received, bench.now - PERIOD / 2);
}

#[test]
fn every_frame_of_a_cycle_counts_with_its_own_time() {
    let mut bench = up();
    let frames = [("185#0200", 1_500), ("185#0302", 700), ("185#0202", 100)];
    for (text, before) in frames {
        let at = bench.now + PERIOD - Duration::from_micros(before);
        bench.bus.0.lock().unwrap().inbox.push_back(Received { frame: frame(text), at });
    }
    cycle(&mut bench, &[]);
    let ago = |micros| Some(bench.now - Duration::from_micros(micros));
    assert_eq!(input(&bench, 0), Input { level: false, edges: 3, last_edge: ago(100) });
    assert_eq!(input(&bench, 1), Input { level: true, edges: 1, last_edge: ago(1_500) });
    assert_eq!(input(&bench, 9), Input { level: true, edges: 2, last_edge: ago(700) });
}

#[test]
fn edges_of_all_inputs_are_kept_in_their_order_with_the_frame_before() {
    let mut bench = up();
    cycle(&mut bench, &[]);
    let before = image(&bench).received;
    let frames = [("185#0200", 1_500), ("185#0302", 700), ("185#0202", 100)];
    for (text, ago) in frames {
        let at = bench.now + PERIOD - Duration::from_micros(ago);
        bench.bus.0.lock().unwrap().inbox.push_back(Received { frame: frame(text), at });
    }
    cycle(&mut bench, &[]);
    let ago = |micros| bench.now - Duration::from_micros(micros);
    let edge = |input, level, at, previous| Edge { input, level, at, previous };
    let expected = [
        edge(0, false, ago(1_500), before),
        edge(1, true, ago(1_500), before),
        edge(9, false, ago(1_500), before),
        edge(0, true, ago(700), ago(1_500)),
        edge(9, true, ago(700), ago(1_500)),
        edge(0, false, ago(100), ago(700)),
    ];
    let image = image(&bench);
    assert_eq!(image.edges_since(0).unwrap().collect::<Vec<_>>(), expected);
    assert_eq!(image.edges_since(4).unwrap().collect::<Vec<_>>(), expected[4..]);
    assert_eq!((image.edge_count(), image.edges_since(6).unwrap().count()), (6, 0));
}

#[test]
fn inputs_beyond_the_configured_ones_are_no_inputs() {
    let mut bench = up();
    cycle(&mut bench, &["185#FFFF"]);
    assert!(image(&bench).input(9).is_some());
    assert_eq!(image(&bench).input(10), None);
}

#[test]
fn frames_that_are_no_inputs_are_counted_as_unexpected() {
    let mut bench = up();
    // No SYNC requested the first answer.
    cycle(&mut bench, &[]);
    let before = bench.group.counters().unexpected;
    let strange = ["185#", "185#01", "185#010203", "285#0102", "186#0102"];
    cycle(&mut bench, &strange);
    assert_eq!(bench.group.counters().unexpected - before, strange.len() as u64);
    assert_eq!(input(&bench, 1), Input { level: false, edges: 0, last_edge: None });
}

#[test]
fn the_image_tells_its_cycle_and_the_age_of_the_last_frame() {
    let mut bench = up();
    for number in 0..4 {
        cycle(&mut bench, &["705#05"][..usize::from(number == 1)]);
        assert_eq!((image(&bench).cycle, image(&bench).at), (number, bench.now));
    }
    assert_eq!(image(&bench).age(), 2 * PERIOD + PERIOD / 2);
}

#[test]
fn a_new_bring_up_ends_operation_and_counts_edges_anew() {
    let mut bench = up();
    bench.links[0].outputs.set_all(0b1110);
    cycle(&mut bench, &["185#0000"]);
    assert_eq!(input(&bench, 0).edges, 1);
    assert!(bench.group.bring_up(bench.now).is_pending());
    assert_eq!(image(&bench).fault, Some(IoFault::NotStarted { node: IO }));
    assert_eq!(image(&bench).input(0), None);
    assert_eq!(bench.links[0].outputs.levels(), 0b0001);
    assert_eq!(bench.bring_up(), Ok(()));
    assert_eq!(input(&bench, 0), Input { level: true, edges: 0, last_edge: None });
    assert_eq!((image(&bench).cycle, image(&bench).sent), (0, None));
    assert!(image(&bench).received > Instant::ZERO);
}

#[test]
fn an_emcy_of_the_node_is_a_warning_and_an_error_until_the_register_is_clear() {
    let mut bench = up();
    cycle(&mut bench, &["085#1081110000000000"]);
    let error = Some(IoError { code: 0x8110, register: 0x11, at: bench.now - PERIOD / 2 });
    assert_eq!((image(&bench).error, image(&bench).fault), (error, None));
    // Another error has gone.
    cycle(&mut bench, &["085#0000100000000000"]);
    assert_eq!(image(&bench).error, error);
    cycle(&mut bench, &["085#0000000000000000"]);
    assert_eq!(image(&bench).error, None);
    assert!(image(&bench).input(0).is_some());
    let warnings: Vec<_> = bench
        .group
        .warnings()
        .iter()
        .map(|it| (it.node, it.cause.emergency().map(|(code, _)| code), it.count))
        .collect();
    assert_eq!(warnings, [(IO, Some(0x8110), 1)]);
}

#[test]
fn an_emcy_of_an_io_node_has_the_text_of_its_profile_and_not_that_of_a_drive() {
    let mut bench = up();
    cycle(&mut bench, &["085#2023030000000000", "082#2023030000000000", "085#8281810000000000"]);
    let texts: Vec<_> = bench.group.warnings().iter().map(ToString::to_string).collect();
    assert_eq!(
        texts,
        [
            "node 5: EMCY 0x2320 (short circuit at the outputs), error register 0x03",
            "node 2: EMCY 0x2320 (power stage protection), error register 0x03",
            "node 5: EMCY 0x8182 (error of class communication), error register 0x81",
        ]
    );
}

#[test]
fn inverted_inputs_are_inverted_from_the_first_frame_on() {
    // The first inputs are 0x0201.
    let mut bench = up_with(IoConfig { inverted_inputs: 0b11, ..io_config(IO) });
    assert_eq!(input(&bench, 0), Input { level: false, edges: 0, last_edge: None });
    assert_eq!(input(&bench, 1), Input { level: true, edges: 0, last_edge: None });
    cycle(&mut bench, &["185#0002"]);
    assert_eq!((input(&bench, 0).level, input(&bench, 0).edges), (true, 1));
    assert_eq!((input(&bench, 1).level, input(&bench, 1).edges), (true, 0));
}
