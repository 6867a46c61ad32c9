//! Claims about the profile of profile position mode: velocities, accelerations and limits.

use super::drive::{HM, counts_per_second};
use super::position::{TARGET, begin};
use super::rig::{Deviation, Rig, Verdict, ensure};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "pp-velocity",
        "",
        ("Profile velocity", &[0x6081]),
        "is the speed of the motion, and is not exceeded",
        profile_velocity,
    ),
    CIA_402_2.row("pp-max-velocity", "", ("Max profile velocity", &[0x607F]), "limits 0x6081", max_profile_velocity),
    CIA_402_2.row("pp-max-motor-speed", "", ("Max motor speed", &[0x6080]), "limits 0x6081", max_motor_speed),
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
    CIA_402_2.row("pp-max-acceleration", "", ("Max acceleration", &[0x60C5]), "limits 0x6083", max_acceleration),
    CIA_402_2.row(
        "pp-demand",
        "",
        ("Position demand value", &[0x6062]),
        "runs from the start to the target without a jump",
        demand,
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
];

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
    ensure!((found - speed).abs() <= speed / 50 + 20, "greatest speed {found} rpm, expected {speed}");
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
    ensure!((found - millis).abs() <= millis / 10.0 + 4.0, "from 500 to 2500 rpm in {found:.0} ms, expected {millis}");
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
            ensure!((found - 200.0).abs() <= 24.0, "from 2500 to 500 rpm in {found:.0} ms, expected 200");
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
        ensure!(f64::from((demand - last).abs()) <= most, "the demand jumps from {last} to {demand}");
        (last, at) = (demand, rig.now());
    }
    ensure!(last == TARGET, "the demand ends at {last}, expected {TARGET}");
    Ok(())
}

fn software_limits(rig: &mut Rig) -> Verdict {
    // Homes the axis at its present position.
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
            ensure!((-3_030..=12_030).contains(&position), "position {position} beyond the limit {limit}");
        }
        // A drive may also refuse such a target with a fault.
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
        ensure!((demand - speed).abs() <= 40, "demand velocity {demand} rpm, expected {speed}");
        let first = (rig.position()?, rig.now());
        rig.pass(50);
        let second = (rig.position()?, rig.now());
        let measured = f64::from(second.0 - first.0) / second.1.since(first.1).as_secs_f64();
        let expected = counts_per_second(f64::from(speed));
        ensure!((measured - expected).abs() <= 0.03 * expected.abs(), "{measured:.0} counts/s at {speed} rpm");
        rig.reach(2_000)?;
    }
    Ok(())
}
