//! Drives whose scale and rated torque agree or disagree with the cell.

use super::bench::*;
use crate::cia402::*;

#[test]
fn a_drive_that_scales_as_the_cell_or_does_not_say_comes_up_and_another_is_refused() {
    // The cell: 2000 counts per revolution at the motor shaft, 0.1 N·m.
    type Says = &'static [(u16, u8, u32)];
    let maxon = |says: Says| (0xFB, says);
    let another = |says: Says| (0x1234, says);
    let table = [
        (maxon(&[]), None),
        (maxon(&[(0x608F, 1, 2_000), (0x608F, 2, 1)]), None),
        (maxon(&[(0x608F, 1, 6_000), (0x608F, 2, 3)]), None),
        (maxon(&[(0x608F, 1, 2_000)]), None),
        (maxon(&[(0x6091, 1, 7), (0x6091, 2, 7)]), None),
        (maxon(&[(0x6092, 1, 2_000), (0x6092, 2, 1)]), None),
        // An encoder finer than the position units, with a feed constant that agrees with the cell.
        (maxon(&[(0x608F, 1, 524_288), (0x608F, 2, 1), (0x6092, 1, 4_000), (0x6092, 2, 2)]), None),
        (maxon(&[(0x608F, 1, 2_000), (0x6092, 1, 360)]), Some((0x6092, "is 360 position units"))),
        (maxon(&[(0x608F, 1, 524_288)]), Some((0x608F, "is 524288 "))),
        (maxon(&[(0x3000, 5, 2_000)]), None),
        (maxon(&[(0x6076, 0, 100_000)]), None),
        (maxon(&[(0x6076, 0, 101_000)]), None),
        (another(&[(0x6076, 0, 100)]), None),
        // Objects for the main sensor and a rated torque in µN·m exist in maxon's drives only.
        (another(&[(0x3000, 5, 1), (0x6076, 0, 101)]), None),
        (
            maxon(&[(0x608F, 1, 4_000), (0x608F, 2, 1)]),
            Some((0x608F, "0x608f:01 is 4000 encoder increments per motor revolution, the cell says 2000")),
        ),
        (maxon(&[(0x608F, 1, 2_000), (0x608F, 2, 2)]), Some((0x608F, "is 2000/2 "))),
        (maxon(&[(0x608F, 1, 0), (0x608F, 2, 0)]), Some((0x608F, "is 0/0 "))),
        (maxon(&[(0x608F, 1, 500)]), Some((0x608F, "is 500 "))),
        (
            maxon(&[(0x6091, 1, 26), (0x6091, 2, 1)]),
            Some((0x6091, "0x6091:01 is 26 motor revolutions per shaft revolution, the cell says 1: set 1/1")),
        ),
        (maxon(&[(0x6092, 1, 360), (0x6092, 2, 1)]), Some((0x6092, "is 360 position units per shaft revolution"))),
        (maxon(&[(0x3000, 5, 2_048)]), Some((0x3000, "0x3000:05 is 2048 quadrature counts"))),
        (
            maxon(&[(0x6076, 0, 101_001)]),
            Some((0x6076, "101001 µN·m of rated torque, the cell says 100000: correct drive.rated_torque")),
        ),
        (maxon(&[(0x6076, 0, 100)]), Some((0x6076, "is 100 µN·m"))),
        (another(&[(0x6076, 0, 100_000)]), Some((0x6076, "100000 mN·m of rated torque, the cell says 100:"))),
    ];
    for mode in [CyclicMode::Csp, CyclicMode::CspWithTorque, CyclicMode::Csv, CyclicMode::Cst] {
        for ((vendor, says), refusal) in table {
            let mut axis = axis_config(2);
            axis.mode = mode;
            axis.identity.vendor = vendor;
            let mut bench = Bench::new(group_config(), &[axis]);
            bench.stores[0].put(0x1018, 1, &vendor.to_le_bytes());
            for &(index, subindex, value) in says {
                bench.stores[0].put(index, subindex, &value.to_le_bytes());
            }
            match (bench.bring_up(), refusal) {
                (Ok(()), None) => {}
                (Err(error @ BringUpError::WrongScale { object, .. }), Some((of, needle))) => {
                    assert_eq!((error.node(), object.index), (Some(2), of), "{says:x?}");
                    assert!(error.to_string().contains(needle), "{error}");
                    // The only controlword removed the voltage, and the node was not started.
                    let sent = sent(&bench);
                    let words = sent.iter().filter(|frame| frame.contains("#2B4060"));
                    assert!(words.eq(["602#2B40600000000000"]), "{sent:?}");
                    assert!(!sent.iter().any(|frame| frame == "000#0102"));
                }
                (brought, _) => panic!("{vendor:#x} {says:x?}: {brought:?}"),
            }
        }
    }
}
