//! Objects in the memory of a drive that determine how an axis brakes, when the axis stops by itself, and in which
//! direction the axis turns.

use super::bench::*;
use crate::cia402::program::{MAXON, program};
use crate::cia402::reserved::{BRAKING, DELAY, SENSE, SILENCE};
use crate::cia402::*;
use canopen::Object;

/// Object, stored value that bring-up must not leave, and the driver's value. The quick stop of `axis_config` brakes
/// with 6000 rpm/s.
const STORED: [(u16, u8, &[u8], &[u8]); 14] = [
    (0x1029, 1, &[1], &[0]),
    (0x1400, 5, &[1, 0], &[0x70, 0x17]),
    (0x1801, 5, &[1, 0], &[0, 0]),
    (0x605B, 0, &[0, 0], &[1, 0]),
    (0x605C, 0, &[0, 0], &[1, 0]),
    (0x605D, 0, &[2, 0], &[1, 0]),
    (0x605E, 0, &[2, 0], &[0, 0]),
    (0x6066, 0, &[0xFF, 0xFF], &[0, 0]),
    (0x607B, 1, &[1, 0, 0, 0], &[0; 4]),
    (0x607B, 2, &[1, 0, 0, 0], &[0; 4]),
    (0x607E, 0, &[0xC0], &[0]),
    (0x6084, 0, &[1, 0, 0, 0], &[0x70, 0x17, 0, 0]),
    (0x6086, 0, &[3, 0], &[0, 0]),
    (0x60C6, 0, &[1, 0, 0, 0], &[0x70, 0x17, 0, 0]),
];

#[test]
fn stored_objects_of_braking_silence_and_sense_get_the_values_of_the_driver() {
    for (index, subindex, stored, expected) in STORED {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        bench.stores[0].put(index, subindex, stored);
        assert_eq!(bench.bring_up(), Ok(()), "{index:#06x}");
        let found = &bench.stores[0].objects[&(index, subindex)];
        assert_eq!(found, expected, "{index:#06x}");
    }
}

#[test]
fn a_drive_that_does_not_take_them_is_refused() {
    for (index, subindex, stored, _) in STORED {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        bench.stores[0].put(index, subindex, stored);
        bench.stores[0].forgetful = Some((index, subindex));
        let error = bench.bring_up().unwrap_err();
        let expected = Object::new(index, subindex);
        assert!(matches!(error, BringUpError::ReadBack { object, .. } if object == expected), "{error}");
    }
}

#[test]
fn an_object_that_cannot_be_written_is_compared() {
    for (stored, result) in [
        (0_u16, Ok(())),
        (65_535, Err(BringUpError::ReadBack { node: 2, object: Object::new(0x6066, 0), written: 0, found: 65_535 })),
    ] {
        let mut bench = Bench::new(group_config(), &[axis_config(2)]);
        bench.stores[0].put(0x6066, 0, &stored.to_le_bytes());
        bench.stores[0].read_only.push((0x6066, 0));
        assert_eq!(bench.bring_up(), result);
    }
}

#[test]
fn limits_of_acceleration_are_raised_to_the_ramps_and_never_lowered() {
    for index in [0x60C5, 0x60C6] {
        for (stored, left) in [(0, 6_000), (5_999, 6_000), (6_000, 6_000), (u32::MAX, u32::MAX)] {
            let mut bench = Bench::new(group_config(), &[axis_config(2)]);
            bench.stores[0].put(index, 0, &u32::to_le_bytes(stored));
            assert_eq!(bench.bring_up(), Ok(()));
            let found = &bench.stores[0].objects[&(index, 0)];
            assert_eq!(found, &u32::to_le_bytes(left), "{index:#06x} {stored}");
        }
    }
}

#[test]
fn every_reserved_object_of_braking_silence_and_sense_is_part_of_bring_up() {
    // Jerk limits act in profiles with limited jerk alone, which 0x6086 = 0 excludes.
    let without_effect = [0x60A3, 0x60A4];
    let program = program(&group_config(), &axis_config(2)).unwrap();
    let mut of_group = 0;
    for index in (0x1000..=0x67FF).filter(|index| !without_effect.contains(index)) {
        let why = reserved(MAXON, index, 0).map(|found| found.why);
        if why.is_some_and(|why| [BRAKING, DELAY, SENSE, SILENCE].contains(&why)) {
            let mut objects = program.iter().map(|step| step.object().index);
            assert!(objects.any(|found| found == index), "{index:#06x}");
            of_group += 1;
        }
    }
    assert!(of_group >= 14, "{of_group}");
}
