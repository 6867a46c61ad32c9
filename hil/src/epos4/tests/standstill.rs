//! Silence at standstill: unsolicited frames of a standing drive, and bit 12 of profile velocity mode.

use super::*;

/// Each kind of axis, by its name.
fn axes() -> Vec<(String, AxisConfig)> {
    let mut axes: Vec<_> = Irp6Axis::ALL.map(|which| (format!("{which:?}"), AxisConfig::irp6(which))).to_vec();
    axes.extend(Irp6Axis::ALL.map(|which| (format!("WUT {which:?}"), AxisConfig::wut(which))));
    let track = AxisConfig::irp6_track(0).unwrap();
    axes.push(("track".into(), track));
    axes.extend((0..6).map(|number| (format!("RNT {number}"), AxisConfig::rnt(number).unwrap())));
    axes.extend((0..7).map(|number| {
        let axis = AxisConfig::polycrank(number).unwrap();
        (format!("Polycrank {number}"), axis)
    }));
    axes.push(("gripper".into(), AxisConfig::gripper()));
    axes.push(("conveyor".into(), AxisConfig::conveyor()));
    axes
}

/// A device that sends statusword, position and velocity whenever one of them changes.
fn talkative(axis: AxisConfig) -> Bench {
    let mut bench = Bench::booted(Epos4Config { axis, ..Epos4Config::new(NodeId::new(2).unwrap(), axis) });
    bench.write("021801", 0x4000_0382, 4);
    bench.write("031801", 0x4000_0482, 4);
    bench
}

#[test]
fn a_drive_without_power_is_silent_at_rest() {
    for (name, axis) in axes() {
        // The angle at which the counter begins, and either edge of that count.
        let count = std::f64::consts::TAU / f64::from(axis.counts_per_revolution);
        let edge = (axis.start_angle / count).floor() * count;
        for start_angle in [axis.start_angle, edge, edge + count] {
            for mode in [1, 3, 6, 8, 9, 10] {
                let mut bench = talkative(AxisConfig { start_angle, ..axis });
                bench.write("606000", mode, 1);
                assert_eq!(bench.say("000#0102").len(), 3);
                let heard = bench.run(1000);
                assert_eq!(heard, [""; 0], "{name} at {start_angle}, mode {mode}");
            }
        }
    }
}

#[test]
fn an_enabled_drive_is_quiet_at_rest() {
    for (name, axis) in axes() {
        for mode in [1, 3, 8, 9] {
            let mut bench = talkative(axis);
            bench.enable(mode);
            bench.say("000#0102");
            bench.run(1000);
            let heard = bench.run(1000);
            assert_eq!(heard, [""; 0], "{name}, mode {mode}");
        }
    }
}

#[test]
fn standstill_has_a_window_and_a_time() {
    let mut bench = Bench::booted(config());
    let table = [("E03000", 3), ("E03001", 30), ("E03002", 2), ("E03003", 1000)];
    for (object, factory) in table {
        assert_eq!(bench.read(object), factory, "{object}");
    }
    bench.write("E03001", 50, 4);
    bench.write("E03002", 100, 2);
    bench.write("836000", 1000, 4);
    bench.write("846000", 1000, 4);
    bench.enable(3);
    assert_eq!(bench.statusword() & 0x1000, 0x1000, "stands");
    let stands = |bench: &mut Bench| bench.statusword() & 0x1000 != 0;
    // Within the window the axis counts as standing, for any time.
    bench.write("FF6000", 40, 4);
    bench.run(500);
    assert!(stands(&mut bench), "40 rpm");
    // Standstill ends when the velocity has been beyond the window for the time, and not before.
    bench.write("FF6000", 60, 4);
    bench.run(80);
    assert!(stands(&mut bench), "60 rpm for less than 100 ms");
    bench.run(80);
    assert!(!stands(&mut bench), "60 rpm for 100 ms");
    // Standstill begins when the velocity has been within the window for the time, and not before.
    bench.write("FF6000", 40, 4);
    bench.run(80);
    assert!(!stands(&mut bench), "40 rpm for less than 100 ms");
    bench.run(80);
    assert!(stands(&mut bench), "40 rpm for 100 ms");
}

#[test]
fn an_axis_that_was_told_to_stand_is_taken_to_stand_after_the_time_out() {
    let mut bench = Bench::booted(config());
    // No speed is below zero.
    bench.write("E03001", 0, 4);
    bench.write("E03002", 10_000, 2);
    bench.write("E03003", 200, 2);
    bench.enable(3);
    bench.write("FF6000", 100, 4);
    bench.run(11_000);
    assert_eq!(bench.statusword() & 0x1000, 0, "moves");
    bench.write("FF6000", 0, 4);
    bench.run(100);
    assert_eq!(bench.statusword() & 0x1000, 0, "within the time-out");
    bench.run(200);
    assert_eq!(bench.statusword() & 0x1000, 0x1000, "after the time-out");
}
