//! Claims about profile position mode: the handshake, targets, profiles, limits and windows.

use super::drive::{HM, PP, Power::OperationEnabled, Power::SwitchedOn, counts_per_second};
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
        "pp-velocity",
        "",
        ("Profile velocity", &[0x6081]),
        "is the speed of the motion, and is not exceeded",
        profile_velocity,
    ),
    CIA_402_2.row(
        "pp-max-velocity",
        "",
        ("Max profile velocity", &[0x607F]),
        "limits 0x6081",
        max_profile_velocity,
    ),
    CIA_402_2.row(
        "pp-max-motor-speed",
        "",
        ("Max motor speed", &[0x6080]),
        "limits 0x6081",
        max_motor_speed,
    ),
    CIA_402_2.row(
        "pp-acceleration",
        "",
        ("Profile acceleration", &[0x6083]),
        "is the slope up to the profile velocity",
        acceleration,
    ),
    CIA_402_2.row(
        "pp-deceleration",
        "",
        ("Profile deceleration", &[0x6084]),
        "is the slope down to the target",
        deceleration,
    ),
    CIA_402_2.row(
        "pp-max-acceleration",
        "",
        ("Max acceleration", &[0x60C5]),
        "limits 0x6083",
        max_acceleration,
    ),
    CIA_402_2.row(
        "pp-demand",
        "",
        ("Position demand value", &[0x6062]),
        "runs from the start to the target without a jump",
        demand,
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
    CIA_402_2.row(
        "pp-software-limits",
        "",
        ("Software position limit", &[0x607D]),
        "a homed axis does not move beyond the limits; both 0 is no limit",
        software_limits,
    ),
    CIA_402_2.row(
        "pp-velocity-actual",
        "",
        ("Velocity actual value", &[0x606C, 0x606B]),
        "actual and demand velocity are those of the motion, with its sign",
        velocity_actual,
    ),
    CIA_402_2.row(
        "pp-kept-parameters",
        "",
        ("Set-point", &[0x6081]),
        "a profile velocity written in motion does not change the motion under way",
        kept_parameters,
    ),
];

/// A target that is not far off: 2.5 turns.
const TARGET: i32 = 10_000;

fn begin(rig: &mut Rig) -> Verdict {
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
    ensure!(
        highest < 5 * TARGET - 1_000,
        "{highest} was passed on the way back"
    );
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
    ensure!(
        (highest - 3 * TARGET).abs() < 20,
        "the first target is {}, the axis came to {highest}",
        3 * TARGET
    );
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

/// Greatest speed of a motion over 20 turns, rpm.
fn greatest_speed(rig: &mut Rig) -> Result<i32, Deviation> {
    let target = rig.position()? + 80_000;
    rig.set_point(target, 0)?;
    let mut greatest = 0;
    for _ in 0..1_500 {
        greatest = greatest.max(rig.velocity()?);
        if rig.statusword()? & 0x0400 != 0 {
            rig.expect_position(target, 30)?;
            return Ok(greatest);
        }
    }
    Err(Deviation("no target reached".to_owned()))
}

fn expect_speed(rig: &mut Rig, speed: i32) -> Verdict {
    let found = greatest_speed(rig)?;
    ensure!(
        (found - speed).abs() <= speed / 50 + 20,
        "greatest speed {found} rpm, expected {speed}"
    );
    Ok(())
}

fn profile_velocity(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    for speed in [1_500, 3_000] {
        rig.write(0x6081, 0, i64::from(speed), 4)?;
        expect_speed(rig, speed)?;
    }
    Ok(())
}

fn max_profile_velocity(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x607F, 0, 1_200, 4)?;
    expect_speed(rig, 1_200)
}

fn max_motor_speed(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x6080, 0, 1_400, 4)?;
    expect_speed(rig, 1_400)
}

/// Time in which the demand velocity rises from 500 rpm to 2500 rpm, ms.
fn rise_time(rig: &mut Rig) -> Result<f64, Deviation> {
    let target = rig.position()? + 200_000;
    rig.set_point(target, 0)?;
    let mut begin = None;
    for _ in 0..3_000 {
        let velocity = rig.velocity()?;
        if velocity >= 500 && begin.is_none() {
            begin = Some(rig.now());
        }
        if let Some(begin) = begin
            && velocity >= 2_500
        {
            return Ok(rig.now().since(begin).as_secs_f64() * 1e3);
        }
    }
    Err(Deviation("no 2500 rpm".to_owned()))
}

fn expect_rise(rig: &mut Rig, millis: f64) -> Verdict {
    let found = rise_time(rig)?;
    ensure!(
        (found - millis).abs() <= millis / 10.0 + 4.0,
        "from 500 to 2500 rpm in {found:.0} ms, expected {millis}"
    );
    Ok(())
}

fn acceleration(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x6083, 0, 10_000, 4)?;
    expect_rise(rig, 200.0)
}

fn max_acceleration(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x60C5, 0, 20_000, 4)?;
    expect_rise(rig, 100.0)
}

fn deceleration(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x6084, 0, 10_000, 4)?;
    rig.set_point(80_000, 0)?;
    rig.pass(200);
    let mut begin = None;
    for _ in 0..1_500 {
        let velocity = rig.velocity()?;
        if velocity <= 2_500 && begin.is_none() {
            begin = Some(rig.now());
        }
        if let Some(begin) = begin
            && velocity <= 500
        {
            let found = rig.now().since(begin).as_secs_f64() * 1e3;
            ensure!(
                (found - 200.0).abs() <= 24.0,
                "from 2500 to 500 rpm in {found:.0} ms, expected 200"
            );
            return Ok(());
        }
    }
    Err(Deviation("no deceleration".to_owned()))
}

fn demand(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    let mut last = rig.read_signed(0x6062, 0)?;
    let mut at = rig.now();
    rig.set_point(TARGET, 0)?;
    for _ in 0..300 {
        let demand = rig.read_signed(0x6062, 0)?;
        let span = rig.now().since(at).as_secs_f64() + 2e-3;
        let most = counts_per_second(3_000.0) * span + 2.0;
        ensure!(
            f64::from((demand - last).abs()) <= most,
            "the demand jumps from {last} to {demand}"
        );
        (last, at) = (demand, rig.now());
    }
    ensure!(
        last == TARGET,
        "the demand ends at {last}, expected {TARGET}"
    );
    Ok(())
}

fn following_error(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.write(0x6065, 0, 0xFFFF_FFFF, 4)?;
    // The three values in one TPDO do not fit, so at constant speed: twice the same error within the resolution of one answer.
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
        ensure!(
            positions.len() == 1 && errors.len() == 1,
            "no TPDOs after SYNC"
        );
        let number = |bytes: &[u8]| i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let (demand, actual) = (number(&positions[0].data), number(&positions[0].data[4..]));
        let error = number(&errors[0].data);
        ensure!(
            (demand - actual - error).abs() <= 1,
            "demand {demand}, actual {actual}, following error {error}"
        );
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
    for window_time in [20, 100] {
        rig.write(0x6068, 0, window_time, 2)?;
        let target = if rig.position()? > TARGET / 2 {
            0
        } else {
            TARGET
        };
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

fn software_limits(rig: &mut Rig) -> Verdict {
    // Homed where the axis stands.
    rig.write(0x6098, 0, 37, 1)?;
    rig.enable(HM)?;
    rig.control(0x1F)?;
    rig.wait_bits((0x1400, 0x1400), 200, "homing attained")?;
    rig.control(0x0F)?;
    begin(rig)?;
    rig.set_point(TARGET, 0)?;
    rig.reach(1_000)?;
    rig.write(0x607D, 1, -3_000, 4)?;
    rig.write(0x607D, 2, 12_000, 4)?;
    for (target, limit) in [(50_000, 12_000), (-50_000, -3_000)] {
        rig.write(0x607A, 0, target, 4)?;
        rig.control(0x1F)?;
        rig.control(0x0F)?;
        for _ in 0..400 {
            let position = rig.position()?;
            ensure!(
                (-3_030..=12_030).contains(&position),
                "position {position} beyond the limit {limit}"
            );
        }
        // A drive may also refuse such a target by a fault.
        let fault = rig.statusword()? & 0x08 != 0;
        if fault {
            rig.control(0x00)?;
            rig.control(0x80)?;
            begin(rig)?;
        }
    }
    rig.write(0x607D, 1, 0, 4)?;
    rig.write(0x607D, 2, 0, 4)?;
    rig.set_point(20_000, 0)?;
    rig.reach(1_000)?;
    rig.expect_position(20_000, 20)
}

fn velocity_actual(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    for (target, speed) in [(80_000, 3_000), (0, -3_000)] {
        rig.set_point(target, 0)?;
        rig.pass(200);
        rig.expect_velocity(speed, 40)?;
        let demand = rig.read_signed(0x606B, 0)?;
        ensure!(
            (demand - speed).abs() <= 40,
            "demand velocity {demand} rpm, expected {speed}"
        );
        let first = (rig.position()?, rig.now());
        rig.pass(50);
        let second = (rig.position()?, rig.now());
        let measured = f64::from(second.0 - first.0) / second.1.since(first.1).as_secs_f64();
        let expected = counts_per_second(f64::from(speed));
        ensure!(
            (measured - expected).abs() <= 0.03 * expected.abs(),
            "{measured:.0} counts/s at {speed} rpm"
        );
        rig.reach(2_000)?;
    }
    Ok(())
}

fn kept_parameters(rig: &mut Rig) -> Verdict {
    begin(rig)?;
    rig.set_point(150_000, 0)?;
    rig.pass(200);
    rig.write(0x6081, 0, 1_000, 4)?;
    rig.pass(100);
    rig.expect_velocity(3_000, 40)
}
