//! Configurations that are refused before the first frame, and the bus load of a sensor.

use can::schedule::Sender;

use super::bench::*;
use crate::bus::traffic;

fn refusal(change: impl FnOnce(&mut WrenchNodeConfig)) -> Option<ConfigError> {
    let mut config = sensor_config();
    change(&mut config);
    check(&group_config(), &[axis_config(DRIVE)], &[], &[config]).err()
}

fn quantity(change: impl FnOnce(&mut WrenchNodeConfig)) -> NodeQuantity {
    match refusal(change) {
        Some(ConfigError::Node { node: SENSOR, quantity }) => quantity,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_configuration_of_the_tests_is_accepted() {
    assert_eq!(refusal(|_| ()), None);
    assert_eq!(refusal(|config| config.trigger = Trigger::Sync { every: 240 }), None);
    assert_eq!(refusal(|config| config.trigger = Trigger::EventTimer(Duration::from_millis(65_535))), None);
}

#[test]
fn triggers_that_a_node_cannot_hold_are_refused() {
    for trigger in [
        Trigger::Sync { every: 0 },
        Trigger::Sync { every: 241 },
        Trigger::EventTimer(Duration::ZERO),
        Trigger::EventTimer(Duration::from_micros(1_500)),
        Trigger::EventTimer(Duration::from_millis(65_536)),
    ] {
        assert_eq!(quantity(|config| config.trigger = trigger), NodeQuantity::Trigger, "{trigger:?}");
    }
}

#[test]
fn every_component_must_be_in_one_field() {
    use WrenchAxis::{Fx, Tz};
    let missing = quantity(|config| _ = config.pdos[0].fields.remove(0));
    assert_eq!(missing, NodeQuantity::Component(Fx));
    let twice = quantity(|config| config.pdos[1].fields[3].content = Content::I16(Tz));
    assert_eq!(twice, NodeQuantity::Component(Tz));
    assert_eq!(quantity(|config| config.pdos.clear()), NodeQuantity::Pdos);
    assert_eq!(quantity(|config| config.pdos[1].number = PdoNumber::One), NodeQuantity::Pdos);
    for content in [
        Content::Counter { bytes: 0 },
        Content::Counter { bytes: 5 },
        Content::Status { bytes: 5, errors: 0 },
        Content::Ignored { bytes: 9 },
        Content::Ignored { bytes: 0 },
    ] {
        let refused = quantity(|config| config.pdos[0].fields[4].content = content);
        assert_eq!(refused, NodeQuantity::Field, "{content:?}");
    }
    let counters = quantity(|config| config.pdos[0].fields[4].content = Content::Counter { bytes: 1 });
    assert_eq!(counters, NodeQuantity::Counter);
    let long = quantity(|config| config.pdos[0].fields[4].content = Content::Ignored { bytes: 2 });
    assert!(matches!(long, NodeQuantity::Mapping(_)), "{long:?}");
    assert_eq!(
        ConfigError::Node { node: SENSOR, quantity: missing }.to_string(),
        "node 9: Fx must be in one field of one PDO"
    );
}

#[test]
fn identifiers_of_other_frames_are_refused() {
    // NMT, SYNC, EMCY, TIME, SDO, heartbeat, restricted; an answer and a set-point of the drive; a set-point of the
    // sensor; the second PDO's.
    for id in [0x000, 0x080, 0x089, 0x100, 0x589, 0x609, 0x709, 0x6E1, 0x182, 0x282, 0x202, 0x209, 0x289] {
        let refused = refusal(|config| config.pdos[0].cob_id = StandardId::new(id).unwrap());
        assert_eq!(refused, Some(ConfigError::CobId { node: SENSOR, cob_id: id }), "{id:#x}");
    }
    // Another PDO of the sensor, one of a node that is not on the bus, and one outside the connection set.
    for id in [0x389, 0x1AA, 0x2AA, 0x680] {
        assert_eq!(refusal(|config| config.pdos[0].cob_id = StandardId::new(id).unwrap()), None, "{id:#x}");
    }
}

#[test]
fn a_node_id_that_occurs_twice_and_objects_of_communication_are_refused() {
    for raw in [DRIVE, 127] {
        let refused = refusal(|config| config.node = node(raw));
        assert_eq!(refused, Some(ConfigError::Bus(cia402::ConfigError::DuplicateNode(raw))));
    }
    let twice = [sensor_config(), sensor_config()];
    let refused = check(&group_config(), &[], &[], &twice);
    assert_eq!(refused, Err(ConfigError::Bus(cia402::ConfigError::DuplicateNode(SENSOR))));
    for index in [0x1005, 0x1017, 0x1800, 0x1A00] {
        let refused = refusal(|config| config.configuration.push(setting(index, 1, &[0])));
        assert!(matches!(refused, Some(ConfigError::Bus(cia402::ConfigError::Setting { .. }))), "{index:#x}");
    }
    assert_eq!(refusal(|config| config.sensor.zero = ZeroMethod::Device), Some(ConfigError::NoBias));
}

#[test]
fn the_bus_load_of_a_sensor_is_that_of_its_samples_and_its_heartbeat() {
    let group = group_config();
    let frames = |config: WrenchNodeConfig| {
        let frames = traffic(&group, &[], &[], &[config]);
        frames.iter().map(|frame| (frame.cob_id.raw(), frame.bytes, frame.period, frame.cyclic)).collect::<Vec<_>>()
    };
    let (sync, host) = ((0x080, 0, PERIOD, true), (0x77F, 1, group.heartbeat_period, false));
    let heartbeat = (0x709, 1, group.heartbeat_period, false);
    let sampled = [sync, host, (0x189, 8, PERIOD, true), (0x289, 7, PERIOD, true), heartbeat];
    assert_eq!(frames(sensor_config()), sampled);
    let fifth = WrenchNodeConfig { trigger: Trigger::Sync { every: 5 }, ..sensor_config() };
    let sampled = [sync, host, (0x189, 8, 5 * PERIOD, true), (0x289, 7, 5 * PERIOD, true), heartbeat];
    assert_eq!(frames(fifth), sampled);
    // A sensor with an event timer needs no SYNC.
    let millisecond = Duration::from_millis(1);
    let sampled = [host, (0x189, 8, millisecond, false), (0x289, 7, millisecond, false), heartbeat];
    assert_eq!(frames(timed(1)), sampled);
}

#[test]
fn the_samples_of_a_bus_are_sent_by_the_sensor_at_any_identifier() {
    let mut config = sensor_config();
    config.pdos[1].cob_id = StandardId::new(0x6A0).unwrap();
    let frames = traffic(&group_config(), &[axis_config(DRIVE)], &[], &[config]);
    let senders: Vec<_> =
        frames.iter().filter(|frame| frame.what == "wrench").map(|frame| (frame.cob_id.raw(), frame.sender)).collect();
    assert_eq!(senders, [(0x189, Sender::Node(SENSOR)), (0x6A0, Sender::Node(SENSOR))]);
    assert_eq!(frames.iter().filter(|frame| frame.what == "SYNC").count(), 1);
}
