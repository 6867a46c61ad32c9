//! Drives without some of the objects that the monitoring of the mode of operation needs.

use super::bench::*;
use crate::{Power, WarningCause};
use canopen::Object;

const NOT_MAPPABLE: u32 = 0x0604_0041;
const READ_ONLY: u32 = 0x0601_0002;

/// Brings up and enables a drive that differs from an EPOS4 by `change`.
fn enabled(change: impl FnOnce(&mut Store)) -> Bench {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    change(&mut bench.stores[0]);
    assert_eq!(bench.bring_up(), Ok(()));
    bench.enable();
    assert_eq!(bench.states[0].power, Power::On);
    bench
}

/// Object 0x1801:01; `None` if the drive has no TPDO 2.
fn identifier(bench: &Bench) -> Option<u32> {
    let bytes = bench.stores[0].objects.get(&(0x1801, 1))?;
    Some(u32::from_le_bytes(bytes[..].try_into().unwrap()))
}

#[test]
fn a_drive_without_inhibit_times_and_event_timers_is_brought_up_and_watched() {
    let bench = enabled(|store| {
        store.objects.retain(|(index, subindex), _| !matches!((index, subindex), (0x1400..=0x19FF, 3 | 5)));
    });
    assert_eq!(identifier(&bench), Some(0x4000_0282));
}

#[test]
fn a_drive_that_cannot_map_its_mode_is_brought_up_without_the_watch() {
    for code in [NOT_MAPPABLE, READ_ONLY] {
        let bench = enabled(|store| _ = store.aborts.insert((0x1A01, 1), code));
        // Switched off.
        assert_eq!(identifier(&bench), Some(0xC000_0282), "{code:#x}");
    }
    let bench = enabled(|store| {
        store.objects.retain(|(index, _), _| !matches!(index, 0x1801 | 0x1A01));
    });
    assert_eq!(identifier(&bench), None);
}

#[test]
fn a_drive_that_cannot_map_its_answer_is_refused() {
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.stores[0].aborts.insert((0x1A00, 1), NOT_MAPPABLE);
    let error = bench.bring_up().unwrap_err();
    let object = Object::new(0x1A00, 1);
    assert!(matches!(error, BringUpError::WriteRefused { node: 2, object: refused, code: NOT_MAPPABLE, .. }
        if refused == object));
}

/// The mode is checked by object 0x6061.
#[test]
fn a_drive_that_does_not_list_its_modes_is_brought_up() {
    enabled(|store| _ = store.objects.remove(&(0x6502, 0)));
    let mut bench = Bench::new(group_config(), &[axis_config(2)]);
    bench.stores[0].objects.remove(&(0x6502, 0));
    bench.stores[0].shows_modes = false;
    let error = bench.bring_up().unwrap_err();
    let shown = Object::new(0x6061, 0);
    assert!(matches!(error, BringUpError::ReadBack { node: 2, object, written: 8, found: 1 } if object == shown));
}

#[test]
fn a_drive_that_cannot_be_told_how_to_lose_its_host_is_named() {
    let causes = |bench: &Bench| bench.group.warnings().iter().map(|it| (it.node, it.cause)).collect::<Vec<_>>();
    assert_eq!(causes(&enabled(|_| {})), []);
    let bench = enabled(|store| _ = store.objects.remove(&(0x1029, 1)));
    assert_eq!(causes(&bench), [(2, WarningCause::NoErrorBehaviour)]);
    let said = bench.group.warnings().iter().next().unwrap().to_string();
    assert!(said.starts_with("node 2: no object 0x1029:01, "), "{said}");
}
