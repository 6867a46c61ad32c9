//! Download of device configuration files.

use can::Frame;
use canopen::Object;

use super::bench::*;
use crate::cia402::*;
use crate::{BringUpError, WarningCause};

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

/// The warnings of the bench.
fn warnings(bench: &Bench) -> Vec<WarningCause> {
    bench.group.warnings().iter().map(|warning| warning.cause).collect()
}

#[test]
fn a_default_is_written_where_the_drive_holds_another_value() {
    let default = |value: u8| Setting { purpose: Purpose::WriteIfDifferent, ..setting(0x2101, 0, &[value]) };
    for (value, written) in [(0, false), (7, true)] {
        let mut bench = bench(vec![default(value)]);
        assert_eq!(bench.bring_up(), Ok(()));
        assert_eq!(bench.stores[0].objects[&(0x2101, 0)], [value]);
        assert_eq!(position(&bench, "602#2F0121").is_some(), written);
        assert!(position(&bench, "602#400121") < Some(usize::MAX));
    }
    // A value that cannot be read is written, and the write decides.
    let mut absent = bench(vec![default(7)]);
    absent.stores[0].objects.remove(&(0x2101, 0));
    let (object, code) = (Object::new(0x2101, 0), 0x0602_0000);
    assert_eq!(absent.bring_up(), Err(BringUpError::WriteRefused { node: 2, object, written: 7, code }));
}

#[test]
fn a_value_that_can_only_be_read_is_compared_and_never_written() {
    let compare = |index, data: &[u8]| Setting { purpose: Purpose::Compare, ..setting(index, 0, data) };
    // An object that belongs to the driver may be compared.
    let settings = vec![compare(0x1000, &[0x92, 1, 2, 0]), compare(0x2101, &[7]), compare(0x2FFF, &[1])];
    let mut differs = bench(settings);
    assert_eq!(differs.bring_up(), Ok(()));
    let first = Object::new(0x2101, 0);
    assert_eq!(warnings(&differs), [WarningCause::Compared { values: 3, different: 2, first }]);
    assert_eq!(position(&differs, "602#2F0121"), None);
    // The comparison is repeated at each bring-up.
    assert_eq!(differs.bring_up(), Ok(()));
    assert_eq!(warnings(&differs), [WarningCause::Compared { values: 3, different: 2, first }]);
    let mut agrees = bench(vec![compare(0x2101, &[0])]);
    assert_eq!(agrees.bring_up(), Ok(()));
    assert_eq!(warnings(&agrees), []);
}

#[test]
fn a_refused_write_shows_the_value() {
    let mut refusing = bench(vec![setting(0x2101, 0, &[7])]);
    refusing.stores[0].aborts.insert((0x2101, 0), 0x0609_0030);
    let error = refusing.bring_up().unwrap_err();
    assert!(error.to_string().starts_with("node 2: 0x2101:00 refused 0x7: "), "{error}");
}

#[test]
fn software_limits_within_the_positions_of_the_cell_are_a_warning() {
    let tau = std::f64::consts::TAU;
    // Counts of the drive: 2000 per turn, so from -2000 to 4000.
    let told = |limits: Option<[i32; 2]>, counts: i32| {
        let scale = crate::Scale::new(counts, 0.0).unwrap();
        let axis = AxisConfig { position_range: Some((-tau, 2.0 * tau)), scale, ..axis_config(2) };
        let mut bench = Bench::new(group_config(), &[axis]);
        for (subindex, limit) in (1..).zip(limits.into_iter().flatten()) {
            bench.stores[0].put(0x607D, subindex, &limit.to_le_bytes());
        }
        assert_eq!(bench.bring_up(), Ok(()));
        warnings(&bench)
    };
    let warning = |low, high, least, most| vec![WarningCause::SoftwareLimits { low, high, least, most }];
    assert_eq!(told(None, 2000), []);
    assert_eq!(told(Some([-2000, 4000]), 2000), []);
    assert_eq!(told(Some([i32::MIN, i32::MAX]), 2000), []);
    // Switched off.
    assert_eq!(told(Some([0, 0]), 2000), []);
    assert_eq!(told(Some([-1999, 4000]), 2000), warning(-1999, 4000, -2000, 4000));
    assert_eq!(told(Some([-2000, 3999]), 2000), warning(-2000, 3999, -2000, 4000));
    // A counter that falls.
    assert_eq!(told(Some([-4000, 2000]), -2000), []);
    assert_eq!(told(Some([-2000, 4000]), -2000), warning(-2000, 4000, -4000, 2000));
}
