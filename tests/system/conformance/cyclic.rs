//! Claims about the cyclic synchronous modes: position, velocity and torque.

use super::drive::{CSP, CST, CSV, HM, Power::Fault, Power::OperationEnabled};
use super::power::following_error;
use super::rig::{Deviation, RPDO, Rig, TPDO, TURN, Verdict, ensure};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "csp-follows",
        "",
        ("Target position", &[0x607A, 0x6064]),
        "the axis follows positions that come by RPDO with each SYNC",
        csp_follows,
    ),
    CIA_402_2.row("csp-demand", "", ("Position demand value", &[0x6062]), "is the target position", csp_demand),
    CIA_402_2.row("csp-offset", "", ("Position offset", &[0x60B0]), "is added to the target position", csp_offset),
    CIA_402_2.row(
        "csp-velocity-offset",
        "",
        ("Velocity offset", &[0x60B1]),
        "is fed forward and leaves no lasting position error",
        csp_velocity_offset,
    ),
    CIA_402_2.row(
        "csp-follows-bit",
        "",
        ("Statusword, bit 12", &[0x6041]),
        "stands while the drive follows the command, and not before it is enabled",
        csp_bit,
    ),
    CIA_402_2.row(
        "csp-following-error",
        "",
        ("Following error window", &[0x6065, 0x603F]),
        "a jump beyond the window is fault 8611",
        csp_following_error,
    ),
    CIA_402_2.row(
        "csp-window-off",
        "",
        ("Following error window", &[0x6065]),
        "with a window of 0xFFFFFFFF a jump is no fault",
        csp_window_off,
    ),
    CIA_402_2.row(
        "csp-software-limits",
        "",
        ("Software position limit", &[0x607D]),
        "a homed axis does not move beyond the limits",
        csp_limits,
    ),
    CIA_402_2.row(
        "csp-period",
        "",
        ("Interpolation time period", &[0x60C2]),
        "value and index state the period; a motion between SYNCs has no steps",
        csp_period,
    ),
    CIA_402_2.row(
        "csv-follows",
        "",
        ("Target velocity", &[0x60FF, 0x606C]),
        "the axis follows velocities without a profile",
        csv_follows,
    ),
    CIA_402_2.row("csv-offset", "", ("Velocity offset", &[0x60B1]), "is added to the target velocity", csv_offset),
    CIA_402_2.row(
        "csv-bit",
        "",
        ("Statusword, bit 12", &[0x6041]),
        "stands while the drive follows the command",
        csv_bit,
    ),
    CIA_402_2.row("csv-limit", "", ("Max motor speed", &[0x6080]), "limits the target velocity", csv_limit),
    CIA_402_2.row(
        "cst-follows",
        "",
        ("Target torque", &[0x6071, 0x6076, 0x6077]),
        "a torque in thousandths of 0x6076 accelerates the inertia, and is shown in 0x6077",
        cst_follows,
    ),
    CIA_402_2.row("cst-offset", "", ("Torque offset", &[0x60B2]), "is added to the target torque", cst_offset),
    CIA_402_2.row(
        "cst-bit",
        "",
        ("Statusword, bit 12", &[0x6041]),
        "stands while the drive follows the command",
        cst_bit,
    ),
];

/// Moment of inertia of the rig's axis, kg·m².
const INERTIA: f64 = 1.5e-4;

/// RPDO3 carries controlword and `target`, TPDO3 statusword and `actual`; both at each SYNC of 2 ms.
fn exchange(rig: &mut Rig, target: u32, actual: u32) -> Verdict {
    for (communication, mapping, id, entries) in [
        (0x1402, 0x1602, i64::from(RPDO[2]), [0x6040_0010, target]),
        (0x1802, 0x1A02, 0x4000_0000 | i64::from(TPDO[2]), [0x6041_0010, actual]),
    ] {
        rig.write(communication, 1, 0x8000_0000 | id, 4)?;
        rig.write(mapping, 0, 0, 1)?;
        rig.write(mapping, 1, i64::from(entries[0]), 4)?;
        rig.write(mapping, 2, i64::from(entries[1]), 4)?;
        rig.write(mapping, 0, 2, 1)?;
        rig.write(communication, 2, 1, 1)?;
        rig.write(communication, 1, id, 4)?;
    }
    rig.write(0x60C2, 1, 2, 1)?;
    rig.write(0x60C2, 2, -3, 1)?;
    Ok(())
}

/// One cycle: SYNC, then the set-point for the next cycle. Returns the actual value of this SYNC.
fn cycle(rig: &mut Rig, target: i32) -> Result<i32, Deviation> {
    let mark = rig.mark();
    rig.send(0x080, &[]);
    let [a, b, c, d] = target.to_le_bytes();
    rig.send(RPDO[2], &[0x0F, 0x00, a, b, c, d]);
    rig.pass(2);
    let answers = rig.heard(mark, TPDO[2]);
    ensure!(answers.len() == 1, "{} answers to one SYNC", answers.len());
    let data = &answers[0].data;
    Ok(i32::from_le_bytes([data[2], data[3], data[4], data[5]]))
}

/// Enables CSP at the present position, with cyclic exchange.
fn cyclic_position(rig: &mut Rig) -> Result<i32, Deviation> {
    exchange(rig, 0x607A_0020, 0x6064_0020)?;
    let position = rig.position()?;
    rig.write(0x607A, 0, i64::from(position), 4)?;
    rig.enable(CSP)?;
    rig.nmt(0x01);
    Ok(position)
}

fn csp_follows(rig: &mut Rig) -> Verdict {
    let start = cyclic_position(rig)?;
    // Half a cosine of 20000 counts in 0.5 s: 62832 counts/s, 942 rpm at most.
    let wave = |cycle: i32| {
        let phase = (f64::from(cycle.clamp(0, 250)) / 250.0) * std::f64::consts::PI;
        start + (10_000.0 * (1.0 - phase.cos())) as i32
    };
    for at in 0..300 {
        let actual = cycle(rig, wave(at))?;
        let (early, late) = (wave(at - 12), wave(at));
        ensure!(
            (early - 60..=late + 60).contains(&actual),
            "position {actual} in cycle {at}, set-points {early} to {late}"
        );
    }
    rig.expect_position(start + 20_000, 3)
}

fn csp_demand(rig: &mut Rig) -> Verdict {
    let start = cyclic_position(rig)?;
    for step in 0..50 {
        cycle(rig, start + 10 * step)?;
    }
    for _ in 0..10 {
        cycle(rig, start + 490)?;
    }
    let demand = rig.read_signed(0x6062, 0)?;
    ensure!(demand == start + 490, "demand {demand}, target {}", start + 490);
    Ok(())
}

fn csp_offset(rig: &mut Rig) -> Verdict {
    let start = cyclic_position(rig)?;
    for step in 0..=100 {
        rig.write(0x60B0, 0, 5 * step, 4)?;
        cycle(rig, start)?;
    }
    for _ in 0..30 {
        cycle(rig, start)?;
    }
    rig.expect_position(start + 500, 3)?;
    let demand = rig.read_signed(0x6062, 0)?;
    ensure!(demand == start + 500, "demand {demand}, expected {}", start + 500);
    Ok(())
}

fn csp_velocity_offset(rig: &mut Rig) -> Verdict {
    let start = cyclic_position(rig)?;
    rig.write(0x60B1, 0, 50, 4)?;
    for _ in 0..200 {
        cycle(rig, start)?;
    }
    rig.write(0x60B1, 0, 0, 4)?;
    for _ in 0..100 {
        cycle(rig, start)?;
    }
    rig.expect_power(OperationEnabled, "a velocity offset")?;
    rig.expect_position(start, 3)
}

fn bit_12(rig: &mut Rig, mode: i64) -> Verdict {
    rig.set_mode(mode)?;
    let position = rig.position()?;
    rig.write(0x607A, 0, i64::from(position), 4)?;
    rig.expect_bits((0x1000, 0), "in switch on disabled")?;
    rig.enable(mode)?;
    rig.pass(20);
    rig.expect_bits((0x1000, 0x1000), "in operation enabled")?;
    rig.control(0x07)?;
    rig.expect_bits((0x1000, 0), "in switched on")
}

fn csp_bit(rig: &mut Rig) -> Verdict {
    bit_12(rig, CSP)
}

fn csp_following_error(rig: &mut Rig) -> Verdict {
    following_error(rig)?;
    rig.expect(0x603F, 0, 0x8611)
}

fn csp_window_off(rig: &mut Rig) -> Verdict {
    let start = cyclic_position(rig)?;
    rig.write(0x6065, 0, 0xFFFF_FFFF, 4)?;
    for _ in 0..300 {
        cycle(rig, start + 20_000)?;
    }
    rig.expect_power(OperationEnabled, "a jump without a window")?;
    rig.expect_position(start + 20_000, 5)
}

fn csp_limits(rig: &mut Rig) -> Verdict {
    rig.write(0x6098, 0, 37, 1)?;
    rig.enable(HM)?;
    rig.control(0x1F)?;
    rig.wait_bits((0x1400, 0x1400), 200, "homing attained")?;
    rig.control(0x00)?;
    rig.write(0x607D, 1, -500, 4)?;
    rig.write(0x607D, 2, 800, 4)?;
    let start = cyclic_position(rig)?;
    for (direction, limit) in [(1, 800), (-1, -500)] {
        let mut target = rig.position()?;
        for _ in 0..100 {
            target += 20 * direction;
            let actual = cycle(rig, target)?;
            ensure!((-630..=930).contains(&actual), "position {actual} beyond the limit {limit}");
        }
        // A drive may also react to such a target with a fault.
        if rig.power()? == Fault {
            return Ok(());
        }
        for step in 0..100 {
            cycle(rig, target + (start - target) * (step + 1) / 100)?;
        }
    }
    Ok(())
}

fn csp_period(rig: &mut Rig) -> Verdict {
    let start = cyclic_position(rig)?;
    rig.expect(0x60C2, 1, 2)?;
    ensure!(rig.read_signed(0x60C2, 2)? == -3, "0x60C2:02 is not -3");
    // 20 counts a cycle: 10 counts each millisecond.
    for step in 0..100 {
        cycle(rig, start + 20 * step)?;
    }
    let mut positions = Vec::new();
    for step in 100..150 {
        rig.send(0x080, &[]);
        let [a, b, c, d] = (start + 20 * step).to_le_bytes();
        rig.send(RPDO[2], &[0x0F, 0x00, a, b, c, d]);
        for _ in 0..2 {
            rig.pass(1);
            positions.push(rig.angle());
        }
    }
    let count = std::f64::consts::TAU / f64::from(TURN);
    for pair in positions.windows(2) {
        let step = (pair[1] - pair[0]) / count;
        ensure!((step - 10.0).abs() <= 3.0, "{step:.1} counts in 1 ms, expected 10");
    }
    Ok(())
}

fn csv_follows(rig: &mut Rig) -> Verdict {
    exchange(rig, 0x60FF_0020, 0x606C_0020)?;
    rig.enable(CSV)?;
    rig.nmt(0x01);
    // A profile acceleration that CSV must not use.
    rig.write(0x6083, 0, 10, 4)?;
    for speed in [1_000, -1_500, 0] {
        let mut actual = 0;
        for _ in 0..100 {
            actual = cycle(rig, speed)?;
        }
        ensure!((actual - speed).abs() <= 20, "velocity {actual} rpm, expected {speed}");
    }
    Ok(())
}

fn csv_offset(rig: &mut Rig) -> Verdict {
    rig.write(0x60FF, 0, 1_000, 4)?;
    rig.enable(CSV)?;
    rig.pass(200);
    rig.expect_velocity(1_000, 20)?;
    rig.write(0x60B1, 0, 500, 4)?;
    rig.pass(200);
    rig.expect_velocity(1_500, 20)?;
    rig.write(0x60B1, 0, -2_000, 4)?;
    rig.pass(200);
    rig.expect_velocity(-1_000, 20)
}

fn csv_bit(rig: &mut Rig) -> Verdict {
    bit_12(rig, CSV)
}

fn csv_limit(rig: &mut Rig) -> Verdict {
    rig.write(0x6080, 0, 1_200, 4)?;
    rig.enable(CSV)?;
    for (speed, expected) in [(3_000, 1_200), (-3_000, -1_200)] {
        rig.write(0x60FF, 0, speed, 4)?;
        rig.pass(300);
        rig.expect_velocity(expected, 20)?;
    }
    Ok(())
}

/// Acceleration over 60 ms, rad/s².
fn measured_acceleration(rig: &mut Rig) -> Result<f64, Deviation> {
    let first = (rig.velocity()?, rig.now());
    rig.pass(60);
    let second = (rig.velocity()?, rig.now());
    let span = second.1.since(first.1).as_secs_f64();
    Ok(f64::from(second.0 - first.0) / 60.0 * std::f64::consts::TAU / span)
}

/// Expects the acceleration that a torque in thousandths of 0x6076 produces.
fn expect_torque(rig: &mut Rig, thousandths: i32) -> Verdict {
    let rated = f64::from(rig.read(0x6076, 0)?) * 1e-6;
    rig.pass(10);
    let expected = f64::from(thousandths) / 1000.0 * rated / INERTIA;
    let found = measured_acceleration(rig)?;
    ensure!((found - expected).abs() <= 0.05 * expected.abs() + 5.0, "{found:.0} rad/s², expected {expected:.0}");
    let shown = rig.read_signed(0x6077, 0)?;
    ensure!((shown - thousandths).abs() <= 2, "torque {shown} is shown, expected {thousandths}");
    Ok(())
}

fn cst_follows(rig: &mut Rig) -> Verdict {
    rig.enable(CST)?;
    for torque in [20, -40, 0] {
        rig.write(0x6071, 0, i64::from(torque), 2)?;
        expect_torque(rig, torque)?;
    }
    Ok(())
}

fn cst_offset(rig: &mut Rig) -> Verdict {
    rig.write(0x6071, 0, 20, 2)?;
    rig.enable(CST)?;
    rig.write(0x60B2, 0, 15, 2)?;
    expect_torque(rig, 35)?;
    rig.write(0x60B2, 0, -50, 2)?;
    expect_torque(rig, -30)
}

fn cst_bit(rig: &mut Rig) -> Verdict {
    bit_12(rig, CST)
}
