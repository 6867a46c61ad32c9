//! Download of device configuration files.

use can::Frame;
use canopen::Object;

use super::bench::*;
use crate::BringUpError;
use crate::cia402::*;

fn configured(settings: Vec<Setting>) -> AxisConfig {
    let axis = axis_config(2);
    AxisConfig { configuration: [settings, axis.configuration].concat(), ..axis }
}

fn bench(settings: Vec<Setting>) -> Bench {
    let mut bench = Bench::new(group_config(), &[configured(settings)]);
    bench.stores[0].put(0x2100, 0, &[0; 12]);
    bench.stores[0].put(0x2101, 0, &[0]);
    bench.stores[0].put(0x2102, 0, &[0; 8]);
    bench
}

/// Number of frames sent before the first that begins with `prefix`.
fn position(bench: &Bench, prefix: &str) -> Option<usize> {
    let bus = bench.bus.0.lock().unwrap();
    let mut sent = bus.sent.iter().map(Frame::to_string);
    sent.position(|frame| frame.starts_with(prefix))
}

#[test]
fn settings_of_any_length_are_written_and_read_back() {
    let text = b"elbow motor!";
    let long = [1, 2, 3, 4, 5, 6, 7, 8];
    let mut bench = bench(vec![setting(0x2100, 0, text), setting(0x2101, 0, &[7]), setting(0x2102, 0, &long)]);
    assert_eq!(bench.bring_up(), Ok(()));
    let objects = &bench.stores[0].objects;
    assert_eq!(objects[&(0x2100, 0)], text);
    assert_eq!(objects[&(0x2101, 0)], [7]);
    assert_eq!(objects[&(0x2102, 0)], long);
    for read_back in ["602#400021", "602#400121", "602#400221"] {
        assert!(position(&bench, read_back).is_some(), "{read_back}");
    }
}

#[test]
fn settings_come_first_in_their_order_then_what_the_group_sets_itself() {
    let mut bench = bench(vec![setting(0x3001, 1, &[1, 0, 0, 0])]);
    assert_eq!(bench.bring_up(), Ok(()));
    // Voltage off, two settings of the same object, then the heartbeat.
    let order = ["602#2B406000", "602#2301300101000000", "602#23013001D0070000", "602#2B171000D007"];
    let order = order.map(|frame| position(&bench, frame).unwrap());
    assert!(order.is_sorted(), "{order:?}");
    assert_eq!(bench.stores[0].objects[&(0x3001, 1)], [0xD0, 0x07, 0, 0]);
}

#[test]
fn an_object_that_cannot_be_read_is_not_read_back() {
    let mut bench = bench(vec![Setting { readable: false, ..setting(0x2101, 0, &[7]) }]);
    assert_eq!(bench.bring_up(), Ok(()));
    assert!(position(&bench, "602#2F0121").is_some());
    assert_eq!(position(&bench, "602#400121"), None);
}

#[test]
fn a_drive_that_forgets_a_setting_does_not_come_up() {
    let mut forgetful = bench(vec![setting(0x2101, 0, &[7])]);
    forgetful.stores[0].forgetful = Some((0x2101, 0));
    let error = BringUpError::ReadBack { node: 2, object: Object::new(0x2101, 0), written: 7, found: 0 };
    assert_eq!(forgetful.bring_up(), Err(error));

    let mut forgetful = bench(vec![setting(0x2102, 0, &[0, 0, 3, 4, 5])]);
    forgetful.stores[0].forgetful = Some((0x2102, 0));
    let error = BringUpError::ReadBackBytes { node: 2, object: Object::new(0x2102, 0), written: 5, found: 8, same: 2 };
    assert_eq!(forgetful.bring_up(), Err(error));
}

#[test]
fn settings_that_must_not_or_cannot_be_written_are_refused_before_a_frame() {
    let table = [
        (setting(0x6040, 0, &[0x0F, 0]), "it commands the drive"),
        (setting(0x2100, 0, &[0; 257]), "1 to 256 bytes are transferred"),
        (setting(0x2100, 0, &[]), "1 to 256 bytes are transferred"),
    ];
    for (setting, why) in table {
        let error = ConfigError::Setting { node: 2, object: setting.object, why };
        let group = CanBus::new(BusEnd::default(), group_config(), &[configured(vec![setting])]);
        assert_eq!(group.map(|_| ()), Err(error));
    }
}
