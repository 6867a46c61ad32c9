//! Claims about profile velocity mode, units of velocity, and inputs and outputs.

use hil::AxisConfig;

use super::drive::{PV, Power::OperationEnabled, counts_per_second};
use super::rig::{Deviation, Rig, START, Verdict, ensure, switched_axis};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "pv-target",
        "",
        ("Target velocity", &[0x60FF, 0x606C]),
        "the axis turns at the target velocity, either way",
        target,
    ),
    CIA_402_2.row(
        "pv-at-once",
        "",
        ("Target velocity", &[0x60FF]),
        "a new target takes effect without a handshake",
        at_once,
    ),
    CIA_402_2.row(
        "pv-reached",
        "",
        ("Statusword, bit 10", &[0x6041]),
        "target reached falls during a ramp and rises at its end",
        reached,
    ),
    CIA_402_2.row(
        "pv-speed-zero",
        "",
        ("Statusword, bit 12", &[0x6041]),
        "speed stands at rest, and not in motion",
        speed_zero,
    ),
    CIA_402_2.row(
        "pv-rest-steady",
        "",
        ("Statusword, bit 12", &[0x6041]),
        "the bits do not change while the axis rests",
        steady_at_rest,
    ),
    CIA_402_2.row(
        "pv-acceleration",
        "",
        ("Profile acceleration", &[0x6083]),
        "is the slope of a rising speed, either way",
        acceleration,
    ),
    CIA_402_2.row(
        "pv-deceleration",
        "",
        ("Profile deceleration", &[0x6084]),
        "is the slope of a falling speed",
        deceleration,
    ),
    CIA_402_2.row("pv-demand", "", ("Velocity demand value", &[0x606B]), "is the ramp that the axis follows", demand),
    CIA_402_2.row(
        "pv-max-velocity",
        "",
        ("Max profile velocity", &[0x607F]),
        "limits the target velocity",
        max_profile_velocity,
    ),
    CIA_402_2.row(
        "pv-max-motor-speed",
        "",
        ("Max motor speed", &[0x6080]),
        "limits the target velocity",
        max_motor_speed,
    ),
    CIA_402_2.row("pv-max-acceleration", "", ("Max acceleration", &[0x60C5]), "limits 0x6083", max_acceleration),
    CIA_402_2.row(
        "pv-halt",
        "",
        ("Halt", &[0x6040]),
        "the axis stops with bit 10 and speeds up again without halt",
        halt,
    ),
    CIA_402_2.row(
        "pv-units",
        "",
        ("SI unit velocity", &[0x60A9]),
        "thousandths of rpm scale target and actual velocity",
        units,
    ),
    CIA_402_2.row(
        "inputs-limits",
        "",
        ("Digital inputs", &[0x60FD]),
        "bits 0, 1 and 2 are the negative limit, positive limit and home switches",
        inputs,
    ),
    CIA_402_2.row(
        "outputs",
        "",
        ("Digital outputs", &[0x60FE]),
        "physical outputs and bit mask are read back, and mappable into an RPDO",
        outputs,
    ),
    CIA_402_2.row(
        "torque-rated",
        "",
        ("Motor rated torque", &[0x6076]),
        "is the unit of torques, and not 0",
        rated_torque,
    ),
];

fn target(rig: &mut Rig) -> Verdict {
    rig.write(0x6083, 0, 30_000, 4)?;
    rig.write(0x6084, 0, 30_000, 4)?;
    rig.enable(PV)?;
    for speed in [1_000, -2_500, 4_000, 0] {
        rig.write(0x60FF, 0, i64::from(speed), 4)?;
        rig.pass(400);
        rig.expect_velocity(speed, 15)?;
        let first = (rig.position()?, rig.now());
        rig.pass(50);
        let second = (rig.position()?, rig.now());
        let measured = f64::from(second.0 - first.0) / second.1.since(first.1).as_secs_f64();
        let expected = counts_per_second(f64::from(speed));
        ensure!((measured - expected).abs() <= 0.03 * expected.abs() + 50.0, "{measured:.0} counts/s at {speed} rpm");
    }
    Ok(())
}

fn at_once(rig: &mut Rig) -> Verdict {
    rig.spin(1_000)?;
    rig.write(0x60FF, 0, 2_000, 4)?;
    rig.pass(150);
    rig.expect_velocity(2_000, 20)
}

fn reached(rig: &mut Rig) -> Verdict {
    rig.write(0x6083, 0, 10_000, 4)?;
    rig.write(0x6084, 0, 10_000, 4)?;
    rig.enable(PV)?;
    for speed in [3_000, 0] {
        rig.write(0x60FF, 0, speed, 4)?;
        rig.pass(50);
        rig.expect_bits((0x0400, 0), "on the ramp")?;
        rig.pass(150);
        rig.expect_bits((0x0400, 0), "on the ramp")?;
        rig.pass(250);
        rig.expect_bits((0x0400, 0x0400), "after the ramp")?;
    }
    Ok(())
}

fn speed_zero(rig: &mut Rig) -> Verdict {
    rig.write(0x60FF, 0, 0, 4)?;
    rig.enable(PV)?;
    rig.pass(20);
    rig.expect_bits((0x1000, 0x1000), "at rest")?;
    for speed in [1_000, -1_000] {
        rig.write(0x60FF, 0, speed, 4)?;
        rig.pass(250);
        rig.expect_bits((0x1000, 0), "at 1000 rpm")?;
        rig.write(0x60FF, 0, 0, 4)?;
        rig.pass(300);
        rig.expect_bits((0x1000, 0x1000), "at rest again")?;
    }
    Ok(())
}

/// Configures a motor with friction and gravity, and an encoder that jitters at rest.
fn steady_at_rest(rig: &mut Rig) -> Verdict {
    use hil::Irp6Axis;
    for axis in
        [AxisConfig::irp6(Irp6Axis::Column), AxisConfig::irp6(Irp6Axis::UpperArm), AxisConfig::wut(Irp6Axis::Column)]
    {
        rig.boot_on(axis);
        rig.write(0x60FF, 0, 0, 4)?;
        rig.enable(PV)?;
        rig.pass(300);
        let first = rig.statusword()?;
        ensure!(first & 0x1400 == 0x1400, "statusword {first:#06x} at rest");
        for _ in 0..500 {
            let word = rig.statusword()?;
            ensure!(word == first, "statusword {word:#06x} at rest, before {first:#06x}");
        }
    }
    Ok(())
}

/// Time between two speeds, rpm, during the change from one target to another, ms.
fn ramp(rig: &mut Rig, speed: i32, (from, to): (i32, i32)) -> Result<f64, Deviation> {
    rig.write(0x60FF, 0, i64::from(speed), 4)?;
    let passed = |velocity: i32, mark: i32| {
        if to > from { velocity >= mark } else { velocity <= mark }
    };
    let mut begin = None;
    for _ in 0..2_000 {
        let velocity = rig.velocity()?;
        if passed(velocity, from) && begin.is_none() {
            begin = Some(rig.now());
        }
        if let Some(begin) = begin
            && passed(velocity, to)
        {
            return Ok(rig.now().since(begin).as_secs_f64() * 1e3);
        }
    }
    Err(Deviation(format!("no {to} rpm on the way to {speed} rpm")))
}

fn expect_ramp(rig: &mut Rig, speed: i32, span: (i32, i32), millis: f64) -> Verdict {
    let found = ramp(rig, speed, span)?;
    ensure!(
        (found - millis).abs() <= millis / 10.0 + 4.0,
        "from {} to {} rpm in {found:.0} ms, expected {millis}",
        span.0,
        span.1
    );
    rig.pass(200);
    Ok(())
}

fn acceleration(rig: &mut Rig) -> Verdict {
    rig.write(0x6083, 0, 10_000, 4)?;
    rig.write(0x6084, 0, 40_000, 4)?;
    rig.enable(PV)?;
    expect_ramp(rig, 3_000, (500, 2_500), 200.0)?;
    rig.write(0x60FF, 0, 0, 4)?;
    rig.pass(200);
    expect_ramp(rig, -3_000, (-500, -2_500), 200.0)
}

fn deceleration(rig: &mut Rig) -> Verdict {
    rig.write(0x6083, 0, 40_000, 4)?;
    rig.write(0x6084, 0, 10_000, 4)?;
    rig.write(0x60FF, 0, 3_000, 4)?;
    rig.enable(PV)?;
    rig.pass(200);
    expect_ramp(rig, 0, (2_500, 500), 200.0)
}

fn max_acceleration(rig: &mut Rig) -> Verdict {
    rig.write(0x6083, 0, 100_000, 4)?;
    rig.write(0x60C5, 0, 10_000, 4)?;
    rig.enable(PV)?;
    expect_ramp(rig, 3_000, (500, 2_500), 200.0)
}

fn demand(rig: &mut Rig) -> Verdict {
    rig.write(0x6083, 0, 10_000, 4)?;
    rig.enable(PV)?;
    rig.write(0x60FF, 0, 3_000, 4)?;
    let begin = rig.now();
    let mut last = 0;
    for _ in 0..150 {
        let demand = rig.read_signed(0x606B, 0)?;
        let expected = (rig.now().since(begin).as_secs_f64() * 10_000.0).min(3_000.0);
        ensure!(
            (f64::from(demand) - expected).abs() <= 60.0 && demand >= last,
            "demand {demand} rpm, expected {expected:.0}"
        );
        last = demand;
    }
    Ok(())
}

fn limited(rig: &mut Rig, index: u16) -> Verdict {
    rig.write(0x6083, 0, 100_000, 4)?;
    rig.write(index, 0, 1_200, 4)?;
    rig.enable(PV)?;
    for (speed, expected) in [(3_000, 1_200), (-3_000, -1_200)] {
        rig.write(0x60FF, 0, speed, 4)?;
        rig.pass(400);
        rig.expect_velocity(expected, 20)?;
    }
    Ok(())
}

fn max_profile_velocity(rig: &mut Rig) -> Verdict {
    limited(rig, 0x607F)
}

fn max_motor_speed(rig: &mut Rig) -> Verdict {
    limited(rig, 0x6080)
}

fn halt(rig: &mut Rig) -> Verdict {
    rig.spin(2_000)?;
    rig.control(0x10F)?;
    rig.pass(400);
    rig.expect_velocity(0, 10)?;
    rig.expect_bits((0x1400, 0x1400), "after the halt")?;
    rig.expect_power(OperationEnabled, "the halt")?;
    rig.control(0x0F)?;
    rig.pass(200);
    rig.expect_velocity(2_000, 20)
}

fn units(rig: &mut Rig) -> Verdict {
    // Prefix 10^-3. The limits are far away in both units.
    rig.write(0x60A9, 0, 0xFDB4_4700, 4)?;
    rig.write(0x607F, 0, 50_000_000, 4)?;
    rig.write(0x6080, 0, 50_000_000, 4)?;
    rig.write(0x60FF, 0, 1_000_000, 4)?;
    rig.enable(PV)?;
    rig.pass(400);
    let velocity = rig.velocity()?;
    ensure!((velocity - 1_000_000).abs() <= 15_000, "velocity {velocity} thousandths of rpm");
    let first = (rig.position()?, rig.now());
    rig.pass(50);
    let second = (rig.position()?, rig.now());
    let measured = f64::from(second.0 - first.0) / second.1.since(first.1).as_secs_f64();
    ensure!((measured - counts_per_second(1_000.0)).abs() <= 2_000.0, "{measured:.0} counts/s at 1000 rpm");
    Ok(())
}

fn inputs(rig: &mut Rig) -> Verdict {
    for (angle, expected) in [(START, 0b000), (START - 11.0, 0b001), (START + 11.0, 0b010), (START - 5.0, 0b100)] {
        rig.boot_on(AxisConfig { start_angle: angle, ..switched_axis() });
        let inputs = rig.read(0x60FD, 0)?;
        ensure!(inputs & 0b111 == expected, "inputs {inputs:#x} at {angle} rad, expected {expected:#05b}");
    }
    Ok(())
}

fn outputs(rig: &mut Rig) -> Verdict {
    for (subindex, value) in [(2, 0x0003_0000), (1, 0x0001_0000)] {
        rig.write(0x60FE, subindex, value, 4)?;
        rig.expect(0x60FE, subindex, value as u32)?;
    }
    rig.write(0x1601, 0, 0, 1)?;
    rig.write(0x1601, 1, 0x60FE_0120, 4)?;
    rig.write(0x1601, 0, 1, 1)?;
    rig.write(0x1401, 1, 0x302, 4)?;
    rig.nmt(0x01);
    rig.send(0x302, &[0, 0, 2, 0]);
    rig.pass(5);
    rig.expect(0x60FE, 1, 0x0002_0000)
}

fn rated_torque(rig: &mut Rig) -> Verdict {
    let rated = rig.read(0x6076, 0)?;
    ensure!(rated > 0, "0x6076 is 0");
    rig.refuse((0x6076, 0), 1, 4, &[0x0601_0002])
}
