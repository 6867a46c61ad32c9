//! Claims about profile position mode: the handshake, targets and windows.

use super::drive::{PP, Power::OperationEnabled, Power::SwitchedOn};
use super::rig::{Deviation, Rig, Verdict, ensure};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "pp-acknowledge",
        "",
        ("Set-point handshake", &[0x6040, 0x6041]),
        "bit 12 rises with bit 4 and falls after bit 4",
        acknowledge,
    ),
    CIA_402_2.row(
        "pp-absolute",
        "",
        ("Target position", &[0x607A, 0x6064]),
        "the axis moves to an absolute target",
        absolute,
    ),
    CIA_402_2.row(
        "pp-relative",
        "",
        ("Target position", &[0x607A]),
        "with bit 6 the target counts from the last one",
        relative,
    ),
    CIA_402_2.row(
        "pp-edge",
        "",
        ("Set-point handshake", &[0x6040]),
        "a new target without a rising edge of bit 4 moves nothing",
        edge,
    ),
    CIA_402_2.row(
        "pp-immediately",
        "",
        ("Change set immediately", &[0x6040]),
        "with bit 5 a new set-point replaces the one under way",
        immediately,
    ),
    CIA_402_2.row(
        "pp-afterwards",
        "",
        ("Change set immediately", &[0x6040]),
        "without bit 5 a new set-point waits for the end of the one under way",
        afterwards,
    ),
    CIA_402_2.row(
        "pp-not-enabled",
        "",
        ("Set-point handshake", &[0x6040]),
        "outside operation enabled no set-point is acknowledged",
        not_enabled,
    ),
    CIA_402_2.row(
        "pp-reached",
        "",
        ("Statusword, bit 10", &[0x6041]),
        "target reached falls with a new set-point and rises at its target",
        reached,
    ),
    CIA_402_2.row(
        "pp-halt",
        "",
        ("Halt", &[0x6040, 0x605D]),
        "the axis stops with bit 10 set, and goes on to its target afterwards",
        halt,
    ),
    CIA_402_2.row(
        "pp-following-error",
        "",
        ("Following error actual value", &[0x60F4, 0x6062, 0x6064]),
        "is the difference of demand and actual position",
        following_error,
    ),
    CIA_402_2.row(
        "pp-following-window",
        "",
        ("Following error window", &[0x6065, 0x6066]),
        "an error beyond the window is a fault, with a window of 0xFFFFFFFF none is",
        following_window,
    ),
    CIA_402_2.row(
        "pp-position-window",
        "",
        ("Position window", &[0x6067, 0x6068]),
        "target reached rises when the axis was in the window for the window time",
        position_window,
    ),
];

/// A target at a short distance: 2.5 revolutions.
pub(super) const TARGET: i32 = 10_000;

pub(super) fn begin(rig: &mut Rig) -> Verdict {
    // "Target reached" means that the position is in the window, not only that the profile has ended.
    rig.write(0x6067, 0, 10, 4)?;
    rig.write(0x6081, 0, 3_000, 4)?;
    rig.write(0x6083, 0, 30_000, 4)?;
    rig.write(0x6084, 0, 30_000, 4)?;
    rig.enable(PP)
}

fn acknowledge(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.expect_bits((0x1000, 0), "before a set-point")?;
    for target in [TARGET, 0, TARGET] {
        rig.write(0x607A, 0, i64::from(target), 4)?;
        rig.control(0x1F)?;
        rig.expect_bits((0x1000, 0x1000), "with bit 4 set")?;
        rig.pass(50);
        rig.expect_bits((0x1000, 0x1000), "while bit 4 is set")?;
        rig.control(0x0F)?;
        rig.expect_bits((0x1000, 0), "after bit 4 was cleared")?;
        rig.reach(1_000)?;
    }
    Ok(())
}

fn absolute(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    for target in [TARGET, -TARGET, 0] {
        rig.set_point(target, 0)?;
        rig.reach(1_000)?;
        rig.pass(50);
        rig.expect_position(target, 5)?;
    }
    Ok(())
}

fn relative(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.set_point(TARGET, 0)?;
    rig.reach(1_000)?;
    for expected in [TARGET + 2_000, TARGET + 4_000] {
        rig.set_point(2_000, 0x40)?;
        rig.reach(1_000)?;
        rig.pass(50);
        rig.expect_position(expected, 5)?;
    }
    Ok(())
}

fn edge(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    let start = rig.position()?;
    rig.write(0x607A, 0, i64::from(TARGET), 4)?;
    rig.control(0x0F)?;
    rig.pass(100);
    rig.expect_position(start, 3)?;
    rig.control(0x1F)?;
    rig.reach(1_000)?;
    rig.write(0x607A, 0, 0, 4)?;
    rig.control(0x1F)?;
    rig.pass(200);
    rig.expect_position(TARGET, 5)
}

/// Highest position until target reached.
fn highest(rig: &mut Rig, millis: u64) -> Result<i32, Deviation> {
    let begin = rig.now();
    let mut highest = i32::MIN;
    loop {
        highest = highest.max(rig.position()?);
        let done = rig.statusword()? & 0x0400 != 0;
        if done && rig.velocity()? == 0 {
            return Ok(highest);
        }
        let waited = rig.now().since(begin).as_millis() as u64;
        ensure!(waited < millis, "no target reached after {waited} ms");
        rig.pass(2);
    }
}

fn immediately(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.set_point(5 * TARGET, 0)?;
    rig.pass(100);
    rig.set_point(-TARGET, 0x20)?;
    let highest = highest(rig, 2_000)?;
    ensure!(highest < 5 * TARGET - 1_000, "{highest} was passed on the way back");
    rig.expect_position(-TARGET, 10)
}

fn afterwards(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.set_point(3 * TARGET, 0)?;
    rig.pass(50);
    rig.write(0x607A, 0, 0, 4)?;
    rig.control(0x1F)?;
    rig.control(0x0F)?;
    let mut highest = 0;
    for _ in 0..700 {
        highest = highest.max(rig.position()?);
        rig.pass(2);
    }
    ensure!((highest - 3 * TARGET).abs() < 20, "the first target is {}, the axis came to {highest}", 3 * TARGET);
    rig.expect_position(0, 10)
}

fn not_enabled(rig: &mut Rig) -> Verdict {
    rig.set_mode(PP)?;
    rig.bring(SwitchedOn)?;
    rig.write(0x607A, 0, i64::from(TARGET), 4)?;
    rig.control(0x17)?;
    rig.expect_power(SwitchedOn, "0x17")?;
    rig.expect_bits((0x1000, 0), "in switched on")?;
    let start = rig.position()?;
    rig.control(0x07)?;
    rig.control(0x0F)?;
    rig.pass(100);
    rig.expect_position(start, 5)
}

fn reached(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    for target in [TARGET, 0] {
        rig.set_point(target, 0)?;
        rig.expect_bits((0x0400, 0), "right after a set-point")?;
        rig.pass(50);
        rig.expect_bits((0x0400, 0), "in motion")?;
        rig.reach(1_000)?;
        rig.expect_position(target, 20)?;
        rig.pass(100);
        rig.expect_bits((0x0400, 0x0400), "at the target")?;
    }
    Ok(())
}

fn halt(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.set_point(5 * TARGET, 0)?;
    rig.pass(100);
    rig.control(0x10F)?;
    rig.pass(200);
    rig.expect_velocity(0, 10)?;
    rig.expect_bits((0x0400, 0x0400), "after the halt")?;
    rig.expect_power(OperationEnabled, "the halt")?;
    let at = rig.position()?;
    ensure!(at < 4 * TARGET, "halted at {at}");
    rig.control(0x0F)?;
    rig.pass(20);
    rig.expect_bits((0x0400, 0), "on the way again")?;
    rig.reach(1_000)?;
    rig.expect_position(5 * TARGET, 20)
}

fn following_error(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x6065, 0, 0xFFFF_FFFF, 4)?;
    // The three values do not fit in one TPDO. The check therefore runs at constant speed and expects the same error
    // twice within the resolution of one answer.
    rig.write(0x1801, 1, 0xC000_0282, 4)?;
    rig.write(0x1A01, 0, 0, 1)?;
    rig.write(0x1A01, 1, 0x6062_0020, 4)?;
    rig.write(0x1A01, 2, 0x6064_0020, 4)?;
    rig.write(0x1A01, 0, 2, 1)?;
    rig.write(0x1802, 1, 0xC000_0382, 4)?;
    rig.write(0x1A02, 0, 0, 1)?;
    rig.write(0x1A02, 1, 0x60F4_0020, 4)?;
    rig.write(0x1A02, 0, 1, 1)?;
    for (index, id) in [(0x1801, 0x282), (0x1802, 0x382)] {
        rig.write(index, 2, 1, 1)?;
        rig.write(index, 1, 0x4000_0000 | id, 4)?;
    }
    rig.nmt(0x01);
    rig.set_point(TARGET, 0)?;
    let mut greatest = 0;
    for _ in 0..60 {
        let mark = rig.mark();
        rig.send(0x080, &[]);
        rig.pass(5);
        let (positions, errors) = (rig.heard(mark, 0x282), rig.heard(mark, 0x382));
        ensure!(positions.len() == 1 && errors.len() == 1, "no TPDOs after SYNC");
        let number = |bytes: &[u8]| i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let (demand, actual) = (number(&positions[0].data), number(&positions[0].data[4..]));
        let error = number(&errors[0].data);
        ensure!((demand - actual - error).abs() <= 1, "demand {demand}, actual {actual}, following error {error}");
        greatest = greatest.max(error.abs());
    }
    ensure!(greatest > 1, "no following error in motion");
    Ok(())
}

fn following_window(rig: &mut Rig) -> Verdict {
    rig.expect(0x6066, 0, 0)?;
    begin(rig)?;
    rig.write(0x6065, 0, 0xFFFF_FFFF, 4)?;
    rig.set_point(TARGET, 0)?;
    rig.reach(1_000)?;
    rig.expect_power(OperationEnabled, "a motion without a window")?;
    rig.write(0x6065, 0, 1, 4)?;
    rig.write(0x6083, 0, 100_000, 4)?;
    rig.write(0x607A, 0, 0, 4)?;
    rig.control(0x1F)?;
    rig.pass(300);
    rig.expect(0x603F, 0, 0x8611)
}

fn position_window(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x6067, 0, 20, 4)?;
    // The speed is so low that the following error is always within the window.
    rig.write(0x6081, 0, 300, 4)?;
    for window_time in [20, 100] {
        rig.write(0x6068, 0, window_time, 2)?;
        let target = if rig.position()? > TARGET / 2 { 0 } else { TARGET };
        rig.set_point(target, 0)?;
        let mut inside = None;
        loop {
            let near = (rig.position()? - target).abs() <= 20;
            let reached = rig.statusword()? & 0x0400 != 0;
            if !near {
                ensure!(!reached, "target reached outside the window");
                inside = None;
            } else if inside.is_none() {
                inside = Some(rig.now());
            }
            let waited = inside.map_or(0.0, |inside| rig.now().since(inside).as_secs_f64() * 1e3);
            if reached {
                let expected = window_time as f64;
                ensure!(
                    (expected - 4.0..=expected + 10.0).contains(&waited),
                    "target reached after {waited:.0} ms in the window, expected {expected}"
                );
                break;
            }
            ensure!(waited < 1_000.0, "no target reached");
        }
    }
    Ok(())
}
