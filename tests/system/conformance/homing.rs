//! Claims about homing mode: start, end, bits, methods, speeds and offsets.

use std::f64::consts::TAU;

use hil::AxisConfig;

use super::drive::{HM, PP, Power::OperationEnabled};
use super::rig::{Deviation, Rig, START, TURN, Verdict, ensure, switched_axis};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "hm-bits",
        "",
        ("Statusword, bits 10, 12, 13", &[0x6041]),
        "000 in progress, attained with target reached at the end",
        bits,
    ),
    CIA_402_2.row(
        "hm-not-started",
        "",
        ("Statusword, bits 10, 12, 13", &[0x6041]),
        "before the start nothing is attained, and nothing moves",
        not_started,
    ),
    CIA_402_2.row(
        "hm-edge",
        "",
        ("Homing operation start", &[0x6040]),
        "bit 4 that stays set does not start again",
        edge,
    ),
    CIA_402_2.row(
        "hm-interrupted",
        "",
        ("Homing operation start", &[0x6040]),
        "bit 4 cleared ends the search without a result",
        interrupted,
    ),
    CIA_402_2.row(
        "hm-halt",
        "",
        ("Halt", &[0x6040]),
        "bit 8 stops the axis with bit 10 alone; without bit 8 the search goes on",
        halt,
    ),
    CIA_402_2.row(
        "hm-37",
        "",
        ("Homing method 37", &[0x6098, 0x6064]),
        "the present position becomes home, and nothing moves",
        method_37,
    ),
    CIA_402_2.row(
        "hm-1-2",
        "",
        ("Homing methods 1 and 2", &[0x6098]),
        "a limit switch, then the first index off the switch",
        methods_1_and_2,
    ),
    CIA_402_2.row(
        "hm-7-11",
        "",
        ("Homing methods 7 and 11", &[0x6098]),
        "the home switch, then the first index off its edge",
        methods_7_and_11,
    ),
    CIA_402_2.row(
        "hm-17-18",
        "",
        ("Homing methods 17 and 18", &[0x6098]),
        "the edge of a limit switch",
        methods_17_and_18,
    ),
    CIA_402_2.row(
        "hm-23-27",
        "",
        ("Homing methods 23 and 27", &[0x6098]),
        "the edge of the home switch",
        methods_23_and_27,
    ),
    CIA_402_2.row(
        "hm-33-34",
        "",
        ("Homing methods 33 and 34", &[0x6098]),
        "the next index in negative, in positive direction",
        methods_33_and_34,
    ),
    CIA_402_2.row(
        "hm-unknown",
        "",
        ("Homing method", &[0x6098]),
        "a reserved method is refused, or its start is a homing error",
        unknown_method,
    ),
    CIA_402_2.row(
        "hm-speeds",
        "",
        ("Homing speeds", &[0x6099]),
        "sub-index 1 is the speed towards the switch, sub-index 2 that of the edge",
        speeds,
    ),
    CIA_402_2.row(
        "hm-acceleration",
        "",
        ("Homing acceleration", &[0x609A]),
        "is the slope up to the search speed",
        acceleration,
    ),
    CIA_402_2.row(
        "hm-offset",
        "",
        ("Home offset", &[0x607C]),
        "the zero position is the home position plus the home offset",
        offset,
    ),
    CIA_402_2.row("hm-again", "", ("Homing operation start", &[0x6040]), "a second start homes anew", again),
    CIA_402_2.row(
        "hm-not-enabled",
        "",
        ("Homing operation start", &[0x6040]),
        "outside operation enabled nothing starts",
        not_enabled,
    ),
];

const MASK: u32 = 0x3400;

const ATTAINED: u32 = 0x1400;

/// Search speed towards a switch and onto its edge, rpm.
const SEARCH: i64 = 240;

const ZERO: i64 = 30;

/// Angle of one count, rad.
const COUNT: f64 = TAU / TURN as f64;

/// Distance in 2 ms at the speed [`ZERO`], rad. The drive samples its switches every millisecond.
const REACTION: f64 = ZERO as f64 / 60.0 * TAU * 2e-3;

/// Angle of an index pulse of the rig's axis: 1 rad above the start; one pulse per revolution.
const INDEX: f64 = START + 1.0;

fn begin(rig: &mut Rig, axis: AxisConfig, method: i64) -> Verdict {
    rig.boot_on(axis);
    rig.write(0x6065, 0, 0xFFFF_FFFF, 4)?;
    rig.write(0x6098, 0, method, 1)?;
    rig.write(0x6099, 1, SEARCH, 4)?;
    rig.write(0x6099, 2, ZERO, 4)?;
    rig.write(0x609A, 0, 20_000, 4)?;
    rig.enable(HM)
}

fn start(rig: &mut Rig) -> Verdict {
    rig.write(0x6040, 0, 0x1F, 2)
}

fn attain(rig: &mut Rig) -> Verdict {
    rig.wait_bits((MASK, ATTAINED), 10_000, "homing attained")
}

/// The motor angle of position 0, rad.
fn zero_angle(rig: &mut Rig) -> Result<f64, Deviation> {
    rig.pass(100);
    let position = rig.position()?;
    Ok(rig.angle() - f64::from(position) * COUNT)
}

fn expect_zero(rig: &mut Rig, angle: f64, tolerance: f64, what: &str) -> Verdict {
    let found = zero_angle(rig)?;
    ensure!(
        (found - angle).abs() <= tolerance,
        "{what}: zero lies at {found:.4} rad, expected {angle:.4} within {tolerance:.4}"
    );
    Ok(())
}

/// Runs a homing method from the start angle to its end.
fn home(rig: &mut Rig, axis: AxisConfig, method: i64, zero: f64, tolerance: f64) -> Verdict {
    begin(rig, axis, method)?;
    start(rig)?;
    attain(rig)?;
    expect_zero(rig, zero, tolerance, &format!("method {method}"))?;
    rig.expect_power(OperationEnabled, "homing")
}

/// The next index pulse above or below an angle.
fn index_after(angle: f64, upwards: bool) -> f64 {
    let turns = (angle - INDEX) / TAU;
    INDEX + TAU * if upwards { turns.ceil() } else { turns.floor() }
}

fn bits(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 17)?;
    start(rig)?;
    rig.pass(20);
    rig.expect_bits((MASK, 0), "in progress")?;
    rig.pass(100);
    rig.expect_bits((MASK, 0), "in progress")?;
    attain(rig)?;
    rig.pass(100);
    rig.expect_bits((MASK, ATTAINED), "at the end")?;
    rig.expect_velocity(0, 5)
}

fn not_started(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 17)?;
    let position = rig.position()?;
    rig.pass(100);
    rig.expect_bits((0x3000, 0), "before the start")?;
    rig.expect_position(position, 3)
}

fn edge(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 34)?;
    start(rig)?;
    attain(rig)?;
    rig.pass(20);
    let angle = rig.angle();
    rig.control(0x1F)?;
    rig.pass(300);
    ensure!((rig.angle() - angle).abs() < 0.05, "the axis moved from {angle:.3} to {:.3} rad", rig.angle());
    Ok(())
}

fn interrupted(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 17)?;
    start(rig)?;
    rig.pass(100);
    rig.control(0x0F)?;
    rig.pass(200);
    rig.expect_bits((0x3000, 0), "after bit 4 was cleared")?;
    rig.expect_velocity(0, 10)?;
    let angle = rig.angle();
    ensure!(angle > START - 9.0, "the search went on to {angle:.2} rad");
    Ok(())
}

fn halt(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 17)?;
    start(rig)?;
    rig.pass(100);
    rig.control(0x11F)?;
    rig.pass(200);
    rig.expect_bits((MASK, 0x0400), "after the halt")?;
    rig.expect_velocity(0, 10)?;
    rig.control(0x1F)?;
    attain(rig)?;
    expect_zero(rig, START - 10.0, REACTION, "after a halt")
}

fn method_37(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 37)?;
    // Away from position 0.
    rig.set_mode(PP)?;
    rig.set_point(3_000, 0)?;
    rig.reach(1_000)?;
    rig.pass(200);
    rig.set_mode(HM)?;
    let angle = rig.angle();
    start(rig)?;
    attain(rig)?;
    rig.expect_position(0, 3)?;
    ensure!((rig.angle() - angle).abs() < 0.01, "the axis moved by {:.3} rad", rig.angle() - angle);
    Ok(())
}

fn methods_1_and_2(rig: &mut Rig) -> Verdict {
    let axis = switched_axis();
    home(rig, axis, 1, index_after(START - 10.0, true), 2.0 * COUNT)?;
    home(rig, axis, 2, index_after(START + 10.0, false), 2.0 * COUNT)
}

/// A drive whose home switch is closed from 4 rad above the start upwards, or from 4 rad below the start downwards.
fn home_switch(above: bool) -> AxisConfig {
    let axis = switched_axis();
    let mut switch = axis.home_switch.expect("the axis has a home switch");
    (switch.from, switch.to) = if above { (START + 4.0, START + 30.0) } else { (START - 30.0, START - 4.0) };
    AxisConfig { home_switch: Some(switch), ..axis }
}

fn methods_7_and_11(rig: &mut Rig) -> Verdict {
    home(rig, home_switch(true), 7, index_after(START + 4.0, false), 2.0 * COUNT)?;
    home(rig, home_switch(false), 11, index_after(START - 4.0, true), 2.0 * COUNT)
}

fn methods_17_and_18(rig: &mut Rig) -> Verdict {
    let axis = switched_axis();
    home(rig, axis, 17, START - 10.0, REACTION)?;
    home(rig, axis, 18, START + 10.0, REACTION)
}

fn methods_23_and_27(rig: &mut Rig) -> Verdict {
    home(rig, home_switch(true), 23, START + 4.0, REACTION)?;
    home(rig, home_switch(false), 27, START - 4.0, REACTION)
}

fn methods_33_and_34(rig: &mut Rig) -> Verdict {
    let axis = switched_axis();
    home(rig, axis, 33, index_after(START, false), 2.0 * COUNT)?;
    home(rig, axis, 34, index_after(START, true), 2.0 * COUNT)
}

fn unknown_method(rig: &mut Rig) -> Verdict {
    for method in [15, 16, 31, 32, 36, 38, 100, -100] {
        begin(rig, switched_axis(), 37)?;
        let answer = rig.download(0x6098, 0, method, 1)?;
        if answer[0] == 0x80 {
            continue;
        }
        start(rig)?;
        rig.pass(100);
        let word = rig.statusword()?;
        ensure!(word & 0x1000 == 0 && word & 0x2000 != 0, "method {method}: statusword {word:#06x}");
    }
    Ok(())
}

/// Mean speed over `millis` milliseconds, rpm.
fn mean_speed(rig: &mut Rig, millis: u64) -> f64 {
    let (angle, begin) = (rig.angle(), rig.now());
    rig.pass(millis);
    let span = rig.now().since(begin).as_secs_f64();
    (rig.angle() - angle) / span / TAU * 60.0
}

fn speeds(rig: &mut Rig) -> Verdict {
    // The speed is so low that the axis is off the switch for at least 100 ms.
    begin(rig, switched_axis(), 1)?;
    start(rig)?;
    rig.pass(100);
    let search = mean_speed(rig, 100);
    ensure!(
        (search + SEARCH as f64).abs() <= SEARCH as f64 / 20.0,
        "{search:.0} rpm towards the negative switch, expected {}",
        -SEARCH
    );
    // Past the switch and its reversal.
    while rig.angle() > START - 10.0 {
        rig.pass(1);
    }
    rig.pass(200);
    let zero = mean_speed(rig, 100);
    ensure!((zero - ZERO as f64).abs() <= ZERO as f64 / 20.0, "{zero:.1} rpm off the switch, expected {ZERO}");
    Ok(())
}

fn acceleration(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 17)?;
    rig.write(0x609A, 0, 1_000, 4)?;
    start(rig)?;
    let begin = rig.now();
    for _ in 0..500 {
        let velocity = rig.velocity()?;
        if i64::from(velocity.abs()) >= SEARCH * 9 / 10 {
            let found = rig.now().since(begin).as_secs_f64() * 1e3;
            // 216 rpm at 1000 rpm/s.
            ensure!((found - 216.0).abs() <= 30.0, "{found:.0} ms to 216 rpm, expected 216");
            return Ok(());
        }
    }
    Err(Deviation("the search speed was not reached".to_owned()))
}

fn offset(rig: &mut Rig) -> Verdict {
    home(rig, switched_axis(), 34, index_after(START, true), 2.0 * COUNT)?;
    begin(rig, switched_axis(), 34)?;
    rig.write(0x607C, 0, 1_000, 4)?;
    start(rig)?;
    attain(rig)?;
    let zero = index_after(START, true) + 1_000.0 * COUNT;
    expect_zero(rig, zero, 2.0 * COUNT, "0x607c = 1000")
}

fn again(rig: &mut Rig) -> Verdict {
    home(rig, switched_axis(), 34, index_after(START, true), 2.0 * COUNT)?;
    rig.control(0x0F)?;
    rig.write(0x6098, 0, 33, 1)?;
    start(rig)?;
    rig.pass(5);
    rig.expect_bits((MASK, 0), "after the second start")?;
    attain(rig)?;
    rig.pass(50);
    let angle = rig.angle();
    expect_zero(rig, index_after(angle, true).min(index_after(angle + 0.5, false)), 2.0 * COUNT, "the second homing")
}

fn not_enabled(rig: &mut Rig) -> Verdict {
    begin(rig, switched_axis(), 34)?;
    rig.control(0x07)?;
    let position = rig.position()?;
    rig.control(0x17)?;
    rig.pass(200);
    rig.expect_bits((0x1000, 0), "in switched on")?;
    rig.expect_position(position, 3)
}
