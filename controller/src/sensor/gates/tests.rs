//! Velocity, place and errors by edges.

use super::*;

/// Delay from the beam to the frame.
const DELAY: Duration = Duration::from_micros(600);
const WAIT: Duration = Duration::from_micros(400);
const INHIBIT: Duration = Duration::from_millis(1);

fn config(places: &[f64], travel: Travel) -> LightGatesConfig {
    let gates = (0..).zip(places).map(|(input, place)| GateLine { input: 3 + input, place: *place }).collect();
    LightGatesConfig { gates, travel, min_speed: 0.02, max_speed: 1.0, delay: DELAY, wait: WAIT, inhibit_time: INHIBIT }
}

fn at(seconds: f64) -> Instant {
    Instant::ZERO + Duration::from_secs_f64(seconds)
}

/// An edge at gate `gate`, `seconds` after the start, whose frame waits half of the longest time.
fn edge(gate: u8, level: bool, seconds: f64) -> Edge {
    let at = at(seconds) + DELAY + WAIT / 2;
    Edge { input: 3 + gate, level, at, previous: at - Duration::from_millis(50) }
}

/// The edges of an object of 80 mm whose front is at gate 0 at `start`, at gates 400 mm apart.
fn object(start: f64, velocity: f64) -> [Edge; 4] {
    let [reach, pass] = [0.4, 0.08].map(|way| way / velocity);
    [
        edge(0, true, start),
        edge(0, false, start + pass),
        edge(1, true, start + reach),
        edge(1, false, start + reach + pass),
    ]
}

fn track(travel: Travel) -> Track {
    Track::new(&config(&[0.1, 0.5], travel)).unwrap()
}

fn close(found: f64, expected: f64) -> bool {
    (found - expected).abs() < 1e-6
}

#[test]
fn an_object_has_velocity_place_and_length() {
    let mut track = track(Travel::Forward);
    let edges = object(2.0, 0.16);
    edges[..2].iter().for_each(|edge| track.edge(edge));
    assert_eq!((track.last, track.count), (Ok(None), 0));
    track.edge(&edges[2]);
    let passage = track.last.unwrap().unwrap();
    assert_eq!((passage.number, passage.front, passage.length), (1, 0.5, None));
    assert!(close(passage.velocity, 0.16), "{passage:?}");
    track.edge(&edges[3]);
    let passage = track.last.unwrap().unwrap();
    assert_eq!((passage.number, track.count), (1, 1));
    assert!(close(passage.length.unwrap(), 0.08) && close(passage.centre_at(at(4.5)).unwrap(), 0.46), "{passage:?}");
    // One second after the gate, and half a second before.
    assert!(close(passage.front_at(at(5.5)), 0.66) && close(passage.front_at(at(4.0)), 0.42), "{passage:?}");
    for place in [0.3, 0.66] {
        assert!(close(passage.front_at(passage.reaches(place)), place));
    }
    // Errors of 0.2 ms at both gates, 2.5 s apart.
    assert!((passage.velocity_bound / 0.16 - 0.4e-3 / 2.5).abs() < 1e-6, "{passage:?}");
    assert!(close(passage.place_bound(at(4.5)), 0.16 * 0.2e-3) && passage.place_bound(at(5.5)) > passage.front_bound);
}

#[test]
fn objects_that_follow_each_other_are_told_apart() {
    let mut track = track(Travel::Forward);
    let mut edges: Vec<_> = [(1.0, 0.16), (2.0, 0.18), (2.8, 0.17)].iter().flat_map(|&(at, v)| object(at, v)).collect();
    edges.sort_by_key(|edge| edge.at);
    let mut velocities = Vec::new();
    for edge in &edges {
        track.edge(edge);
        if let Some(passage) = track.last.unwrap().filter(|passage| passage.length.is_some()) {
            velocities.push((passage.number, (passage.velocity * 100.0).round()));
        }
    }
    velocities.dedup();
    assert_eq!(velocities, [(1, 16.0), (2, 18.0), (3, 17.0)]);
    assert!(track.objects.iter().all(Option::is_none));
}

#[test]
fn direction_is_the_order_of_the_gates() {
    for travel in [Travel::Backward, Travel::Either] {
        let mut track = track(travel);
        for (edge, gate) in object(1.0, 0.2).iter().zip([1, 1, 0, 0]) {
            track.edge(&Edge { input: 3 + gate, ..*edge });
        }
        let passage = track.last.unwrap().unwrap();
        assert!(close(passage.velocity, -0.2) && close(passage.front, 0.1), "{passage:?}");
        assert!(close(passage.front_at(at(4.0)), -0.1) && close(passage.centre_at(at(3.0)).unwrap(), 0.14));
    }
}

#[test]
fn more_gates_fit_one_velocity() {
    let mut track = Track::new(&config(&[0.0, 0.1, 0.25, 0.4], Travel::Forward)).unwrap();
    for (gate, place) in [(0, 0.0), (1, 0.1), (2, 0.25), (3, 0.4)] {
        track.edge(&edge(gate, true, 1.0 + place / 0.1));
        track.edge(&edge(gate, false, 1.0 + (place + 0.05) / 0.1));
    }
    let passage = track.last.unwrap().unwrap();
    assert!(close(passage.velocity, 0.1) && close(passage.length.unwrap(), 0.05), "{passage:?}");
}

#[test]
fn a_frame_within_the_inhibit_time_has_a_wider_interval() {
    let track = track(Travel::Forward);
    let usual = edge(0, true, 1.0);
    assert_eq!(track.mark(&usual), Mark { at: at(1.0), width: WAIT });
    let soon = Edge { previous: usual.at - Duration::from_micros(1_200), ..usual };
    let mark = track.mark(&soon);
    assert_eq!((mark.width, mark.at), (Duration::from_micros(1_600), at(1.0) + WAIT / 2 - Duration::from_micros(800)));
    let later = Edge { previous: usual.at - Duration::from_micros(1_401), ..usual };
    assert_eq!(track.mark(&later).width, WAIT);
}

/// The errors are greatest at the ends of the intervals.
#[test]
fn errors_are_within_their_bounds_whatever_the_frames_wait() {
    for (velocity, waits) in
        [0.05, 0.16, 0.5].into_iter().flat_map(|velocity| (0..16).map(move |waits| (velocity, waits)))
    {
        let mut track = track(Travel::Forward);
        for (number, edge) in object(1.0, velocity).iter().enumerate() {
            let wait = if waits >> number & 1 == 1 { WAIT } else { Duration::ZERO };
            track.edge(&Edge { at: edge.at - WAIT / 2 + wait, ..*edge });
        }
        let passage = track.last.unwrap().unwrap();
        let rounding = 1e-6;
        assert!((passage.velocity - velocity).abs() <= passage.velocity_bound + rounding, "{waits}: {passage:?}");
        for later in [0.0, 0.7, 5.0] {
            let (time, place) = (at(1.0 + 0.4 / velocity + later), 0.5 + velocity * later);
            let error = (passage.front_at(time) - place).abs();
            assert!(error <= passage.place_bound(time) + rounding, "{waits}: {error} m, {passage:?}");
        }
        // The bounds are not idle: equal waits shift the place by the half, and opposite waits change the velocity.
        if waits == 0b1111 {
            let error = (passage.front_at(at(1.0 + 0.4 / velocity)) - 0.5).abs();
            assert!(error > 0.99 * passage.front_bound, "{error} m");
        }
        if waits == 0b1100 {
            let error = (passage.velocity - velocity).abs();
            assert!(error > 0.9 * passage.velocity_bound, "{error} m/s");
        }
    }
}

/// The outcome after these edges of gate, level and time, watched until `until`.
fn outcome(travel: Travel, edges: &[(u8, bool, f64)], until: f64) -> Result<Option<Passage>, GateError> {
    let mut track = track(travel);
    for &(gate, level, seconds) in edges {
        track.edge(&edge(gate, level, seconds));
        track.watch(at(seconds));
    }
    track.watch(at(until));
    track.last
}

#[test]
fn an_error_names_the_gate_and_the_time() {
    use Travel::{Backward, Either, Forward};
    let ms = Duration::from_millis;
    let rounded = |error| match error {
        GateError::TooSlow { gate, waited } => GateError::TooSlow { gate, waited: ms(waited.as_millis() as u64) },
        GateError::TooFast { gate, after } => GateError::TooFast { gate, after: ms(after.as_millis() as u64) },
        GateError::Unlike { first, last } => {
            let [first, last] = [first, last].map(|time| ms(time.as_millis() as u64));
            GateError::Unlike { first, last }
        }
        error => error,
    };
    let missing = GateError::Missing { gate: 0, reached: 1 };
    // At 0.02 m/s, the way between the gates takes 20 s.
    let slow = |gate| GateError::TooSlow { gate, waited: ms(20_998) };
    let table: [(Travel, &[_], f64, GateError); 8] = [
        (Forward, &[(1, true, 1.0)], 1.0, missing),
        (Backward, &[(0, true, 1.0)], 1.0, GateError::Missing { gate: 1, reached: 0 }),
        (Forward, &[(0, true, 1.0), (0, false, 1.5)], 22.0, slow(1)),
        (Either, &[(1, true, 1.0), (1, false, 1.5)], 22.0, slow(0)),
        (Forward, &[(0, true, 1.0), (1, true, 1.3)], 1.3, GateError::TooFast { gate: 1, after: ms(300) }),
        // Only the frames of these gates are in the right order, not the edges of the light.
        (Forward, &[(0, true, 1.0), (1, true, 1.0)], 1.0, GateError::TooFast { gate: 1, after: ms(0) }),
        // The second object has no edge at the first gate, and its edges at the second gate count for the first one.
        (
            Forward,
            &[(0, true, 1.0), (0, false, 1.5), (1, true, 9.0), (1, false, 9.2)],
            9.2,
            GateError::Unlike { first: ms(500), last: ms(200) },
        ),
        (Forward, &[(0, true, 1.0); MAX_OBJECTS + 1], 1.0, GateError::TooMany),
    ];
    for (number, (travel, edges, until, expected)) in table.into_iter().enumerate() {
        let found = outcome(travel, edges, until).unwrap_err();
        assert_eq!(rounded(found), expected, "case {number}: {found}");
    }
    assert_eq!(outcome(Forward, &[(0, true, 1.0), (0, false, 1.5)], 20.9), Ok(None));
    // The back of an object that was in a beam at the beginning.
    assert_eq!(outcome(Forward, &[(1, false, 1.0), (0, false, 1.5)], 9.0), Ok(None));
}

#[test]
fn an_object_after_an_error_is_measured() {
    let mut track = track(Travel::Forward);
    track.edge(&edge(1, true, 1.0));
    track.edge(&edge(1, false, 1.5));
    assert!(track.last.is_err());
    object(3.0, 0.2).iter().for_each(|edge| track.edge(edge));
    let passage = track.last.unwrap().unwrap();
    assert!(passage.number == 2 && close(passage.velocity, 0.2), "{passage:?}");
}

#[test]
fn impossible_gates_are_refused() {
    let with = |change: fn(&mut LightGatesConfig)| {
        let mut config = config(&[0.1, 0.5], Travel::Forward);
        change(&mut config);
        Track::new(&config).err().map(|error| error.to_string())
    };
    assert_eq!(with(|_| ()), None);
    type Change = fn(&mut LightGatesConfig);
    let table: [(Change, &str); 6] = [
        (|config| config.gates.truncate(1), "1 gate, must be 2 to 4: a velocity needs two places"),
        (|config| config.gates[1].place = 0.1, "gate 1: its place must be finite and beyond that of the gate before"),
        (
            |config| config.gates[0].place = f64::NAN,
            "gate 0: its place must be finite and beyond that of the gate before",
        ),
        (|config| config.gates[1].input = 3, "gate 1: input 3 already has a gate"),
        (
            |config| config.min_speed = 0.0,
            "speeds from 0 to 1 m/s: the lowest must be above zero and below the greatest, both finite",
        ),
        (
            |config| config.max_speed = f64::INFINITY,
            "speeds from 0.02 to inf m/s: the lowest must be above zero and below the greatest, both finite",
        ),
    ];
    for (change, message) in table {
        assert_eq!(with(change).as_deref(), Some(message));
    }
}

#[test]
fn a_sensor_reads_the_edges_of_its_node_and_its_fault() {
    use drive::cia401::{IoConfig, RehearsedIo};
    use drive::cia402::{Identity, NodeId};

    let io = IoConfig {
        node: NodeId::MIN,
        identity: Identity { vendor: 0, product: None, revision: None },
        inputs: 5,
        outputs: 0,
        inhibit_time: INHIBIT,
        event_timer: Duration::from_millis(100),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        inverted_outputs: 0,
        error_mode: 0,
        error_value: 0,
        configuration: Vec::new(),
    };
    let changes = object(1.0, 0.2).map(|edge| (edge.at, edge.input));
    let (mut node, link) = RehearsedIo::new(&io, changes);
    let mut gates = LightGates::new(link.inputs.clone(), &config(&[0.1, 0.5], Travel::Forward)).unwrap();
    for step in 0..250 {
        node.advance(at(f64::from(step) * 0.02));
        let (heard, reading) = gates.read();
        assert_eq!(heard, at(f64::from(step) * 0.02));
        assert_eq!(reading.passage().unwrap().is_some(), heard >= at(3.0) + DELAY + WAIT / 2);
    }
    let passage = gates.read().1.passage().unwrap().unwrap();
    // A rehearsed node sends a frame in every cycle.
    assert!((passage.velocity - 0.2).abs() < 1e-9 + passage.velocity_bound && passage.length.is_some(), "{passage:?}");
    let mut image = link.inputs.read();
    image.fault = Some(IoFault::BusOff);
    let faulted = gates.take(&image);
    assert_eq!(faulted.passage(), Err(GeneratorError::Gates(GateError::Node(IoFault::BusOff))));
    assert_eq!(faulted.count(), 1);
}
