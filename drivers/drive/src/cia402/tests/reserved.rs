//! Objects reserved for the driver, and the refusal of a cell or a device configuration file that writes such an
//! object.

use super::bench::*;
use crate::bus::Step;
use crate::cia402::program::{MAXON, program};
use crate::cia402::*;
use canopen::Object;

const MODES: [CyclicMode; 4] = [CyclicMode::Csp, CyclicMode::CspWithTorque, CyclicMode::Csv, CyclicMode::Cst];

#[test]
fn everything_that_bring_up_writes_is_reserved() {
    for mode in MODES {
        let mut axis = axis_config(2);
        axis.mode = mode;
        axis.configuration.clear();
        let program = program(&group_config(), &axis).unwrap();
        let write = |step: &Step| match *step {
            Step::Set(write, _) => Some(write),
            _ => None,
        };
        let writes: Vec<_> = program.iter().filter_map(write).collect();
        assert!(writes.len() > 30);
        for write in writes {
            let object = write.object;
            let found = reserved(MAXON, object.index, object.subindex);
            assert!(found.is_some(), "{mode:?}: {object}");
        }
    }
}

#[test]
fn what_undoes_or_commands_is_reserved_and_tuning_is_not() {
    let reserved_ones = [
        (0x1005, 0),
        (0x1010, 1),
        (0x1012, 0),
        (0x1011, 4),
        (0x1014, 0),
        (0x1016, 2),
        (0x1200, 1),
        (0x140F, 1),
        (0x1A3F, 0),
        (0x1F80, 0),
        (0x605B, 0),
        (0x605C, 0),
        (0x605D, 0),
        (0x605E, 0),
        (0x6066, 0),
        (0x6071, 0),
        (0x607A, 0),
        (0x607B, 1),
        (0x607B, 2),
        (0x607E, 0),
        (0x6084, 0),
        (0x60A9, 0),
        (0x60C5, 0),
        (0x60C6, 0),
        // Bit 0 sets the brake.
        (0x60FE, 1),
        (0x60FE, 2),
        (0x60FF, 0),
        // The same object of a second axis behind the node-ID.
        (0x6840, 0),
        (0x7007, 0),
        (0x9885, 0),
    ];
    for (index, subindex) in reserved_ones {
        let found = reserved(0x1234, index, subindex);
        assert!(found.is_some(), "{index:#06x}:{subindex:02x}");
    }
    let tuning = [
        (0x1003, 0),
        (0x1015, 0),
        (0x2FF0, 2),
        (0x3000, 1),
        (0x3001, 1),
        (0x30B2, 0),
        (0x6067, 0),
        (0x6072, 0),
        (0x6073, 0),
        (0x6076, 0),
        (0x607D, 1),
        (0x607F, 0),
        (0x6080, 0),
        (0x6081, 0),
        (0x6083, 0),
        (0x608F, 1),
        (0x6091, 1),
        (0x6092, 1),
        (0x60E0, 0),
        (0x6410, 1),
    ];
    for (index, subindex) in tuning {
        assert_eq!(reserved(MAXON, index, subindex), None);
    }
    // Bit 0 of 0x3000:04 is the polarity of the axis.
    for (index, subindex) in [(0x2000, 0), (0x2001, 0), (0x3000, 4), (0x30B0, 0), (0x30B1, 0)] {
        let found = reserved(MAXON, index, subindex);
        assert!(found.is_some(), "{index:#06x}:{subindex:02x}");
        assert_eq!(reserved(0x1234, index, subindex), None);
    }
    let text = "0x6885:00 belongs to the driver: the cell's max_acceleration sets it";
    assert_eq!(reserved(MAXON, 0x6885, 0).unwrap().to_string(), text);
    let text = "0x6040:00 (controlword) belongs to the driver: it commands the drive";
    assert_eq!(reserved(MAXON, 0x6040, 0).unwrap().to_string(), text);
}

#[test]
fn reserved_objects_are_refused_before_a_frame() {
    for (index, subindex) in [(0x1016, 1), (0x6007, 0), (0x6040, 0), (0x60C2, 1), (0x1A02, 1)] {
        let axis = AxisConfig { configuration: vec![setting(index, subindex, &[0; 4])], ..axis_config(2) };
        let error = ConfigError::Setting {
            node: 2,
            object: Object::new(index, subindex),
            why: reserved(MAXON, index, subindex).unwrap().why,
        };
        let group = CanBus::new(BusEnd::default(), group_config(), &[axis]);
        assert_eq!(group.map(|_| ()), Err(error));
    }
}

/// Writing a vendor's object may change other objects.
#[test]
fn what_a_setting_changes_elsewhere_is_set_and_read_back_afterwards() {
    let (trigger, changed) = ((0x2101, 0), [(0x6007, 0), (0x1016, 1), (0x6085, 0)]);
    let mut axis = axis_config(2);
    axis.configuration.push(setting(trigger.0, trigger.1, &[7]));
    let mut untouched = Bench::new(group_config(), &[axis_config(2)]);
    assert_eq!(untouched.bring_up(), Ok(()));
    for object in changed {
        let mut bench = Bench::new(group_config(), std::slice::from_ref(&axis));
        bench.stores[0].put(trigger.0, trigger.1, &[0]);
        bench.stores[0].clears = Some((trigger, object));
        assert_eq!(bench.bring_up(), Ok(()));
        let expected = &untouched.stores[0].objects[&object];
        assert_eq!(&bench.stores[0].objects[&object], expected, "{object:04x?}");
    }
}
