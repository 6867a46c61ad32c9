//! Claims about option codes: the kind of stop, and the state in which the drive ends.

use super::drive::Power::{
    self, Fault, OperationEnabled, QuickStopActive, ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn,
};
use super::rig::{Rig, Verdict, ensure, unit};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "quick-stop-0",
        "",
        ("Quick stop option code", &[0x605A]),
        "0 disables the drive function: the axis coasts in switch on disabled",
        quick_stop_0,
    ),
    CIA_402_2.row(
        "quick-stop-1",
        "",
        ("Quick stop option code", &[0x605A, 0x6084]),
        "1 brakes with 0x6084 and ends in switch on disabled",
        quick_stop_1,
    ),
    CIA_402_2.row(
        "quick-stop-2",
        "",
        ("Quick stop option code", &[0x605A, 0x6085]),
        "2 brakes with 0x6085 and ends in switch on disabled",
        quick_stop_2,
    ),
    CIA_402_2.row(
        "quick-stop-3-4",
        "",
        ("Quick stop option code", &[0x605A]),
        "3 and 4 brake at the limits of current and voltage and end in switch on disabled",
        quick_stop_3_and_4,
    ),
    CIA_402_2.row(
        "quick-stop-5",
        "",
        ("Quick stop option code", &[0x605A, 0x6084]),
        "5 brakes with 0x6084 and stays in quick stop active",
        quick_stop_5,
    ),
    CIA_402_2.row(
        "quick-stop-6",
        "",
        ("Quick stop option code", &[0x605A, 0x6085]),
        "6 brakes with 0x6085 and stays in quick stop active",
        quick_stop_6,
    ),
    CIA_402_2.row(
        "quick-stop-7-8",
        "",
        ("Quick stop option code", &[0x605A]),
        "7 and 8 brake at the limits of current and voltage and stay in quick stop active",
        quick_stop_7_and_8,
    ),
    CIA_402_2.row(
        "quick-stop-active",
        "",
        ("Quick stop option code", &[0x605A]),
        "while the axis brakes the drive is in quick stop active",
        quick_stop_while_braking,
    ),
    CIA_402_2.row(
        "shutdown-option",
        "",
        ("Shutdown option code", &[0x605B]),
        "0 lets the axis coast, 1 brakes with 0x6084; both end in ready to switch on",
        shutdown,
    ),
    CIA_402_2.row(
        "disable-option",
        "",
        ("Disable operation option code", &[0x605C]),
        "0 lets the axis coast, 1 brakes with 0x6084; both end in switched on",
        disable_operation,
    ),
    CIA_402_2.row(
        "disable-voltage",
        "",
        ("Disable voltage", &[0x6040]),
        "the axis coasts whatever the option codes are",
        disable_voltage,
    ),
    CIA_402_2.row(
        "halt-option",
        "",
        ("Halt option code", &[0x605D]),
        "1 brakes with 0x6084, 2 with 0x6085; the drive stays in operation enabled",
        halt,
    ),
    CIA_402_2.row("halt-ends", "", ("Halt", &[0x6040]), "bit 8 cleared lets the motion go on", halt_ends),
    CIA_402_2.row(
        "fault-option",
        "",
        ("Fault reaction option code", &[0x605E]),
        "0 lets the axis coast, 1 brakes with 0x6084, 2 with 0x6085; all end in fault",
        fault_reaction,
    ),
    CIA_402_2.row(
        "abort-0",
        "",
        ("Abort connection option code", &[0x6007]),
        "0: the axis goes on after a lost heartbeat",
        abort_0,
    ),
    CIA_402_2.row(
        "abort-1",
        "",
        ("Abort connection option code", &[0x6007]),
        "1: a lost heartbeat is a fault",
        abort_1,
    ),
    CIA_402_2.row(
        "abort-2",
        "",
        ("Abort connection option code", &[0x6007]),
        "2: a lost heartbeat disables the voltage",
        abort_2,
    ),
    CIA_402_2.row(
        "abort-3",
        "",
        ("Abort connection option code", &[0x6007, 0x605A]),
        "3: a lost heartbeat is a quick stop by 0x605A",
        abort_3,
    ),
    CIA_402_2.row(
        "abort-nmt-stop",
        "",
        ("Abort connection option code", &[0x6007]),
        "the NMT state stopped is such an event too",
        abort_by_nmt_stop,
    ),
];

/// Speed of the axis before each stop, rpm.
const SPEED: i32 = 3_000;

/// Decelerations, rpm/s.
const PROFILE: i32 = 10_000;

const QUICK: i32 = 30_000;

/// Times of the two ramps, ms.
const PROFILE_TIME: f64 = 300.0;

const QUICK_TIME: f64 = 100.0;

/// Duration of a stop at the current limit of 20 A, ms: torque 2.1 N·m on an inertia of 1.5e-4 kg·m².
const LIMIT_TIME: f64 = 60.0;

/// Kind of stop.
#[derive(Clone, Copy, PartialEq)]
enum Stop {
    Coasting,
    Profile,
    Quick,
    AtLimits,
}

/// Boots a fresh drive that turns at [`SPEED`] with both ramps set.
fn turning(rig: &mut Rig) -> Verdict {
    rig.boot(unit());
    rig.write(0x6084, 0, i64::from(PROFILE), 4)?;
    rig.write(0x6085, 0, i64::from(QUICK), 4)?;
    rig.spin(SPEED)
}

fn expect_stop(rig: &mut Rig, stop: Stop, why: &str) -> Verdict {
    match stop {
        Stop::Coasting => rig.expect_coasting(SPEED, why),
        Stop::Profile => rig.expect_stop(PROFILE_TIME, why),
        Stop::Quick => rig.expect_stop(QUICK_TIME, why),
        Stop::AtLimits => {
            let found = rig.stop_time(2_000)?;
            ensure!(
                found.is_some_and(|found| found <= LIMIT_TIME),
                "stopped after {found:.0?} ms, expected at most {LIMIT_TIME}: {why}"
            );
            Ok(())
        }
    }
}

/// Gives a command to the turning axis with an option set, and checks the stop.
fn stops(rig: &mut Rig, (option, value): (u16, i64), command: u16, stop: Stop, state: Power) -> Verdict {
    turning(rig)?;
    rig.write(option, 0, value, 2)?;
    rig.write(0x6040, 0, i64::from(command), 2)?;
    let why = format!("{option:#06x} = {value}, controlword {command:#04x}");
    expect_stop(rig, stop, &why)?;
    rig.pass(20);
    rig.expect_power(state, &why)
}

fn quick_stop(rig: &mut Rig, options: &[i64], stop: Stop, state: Power) -> Verdict {
    for &option in options {
        // Bit 3 has no part in the command.
        stops(rig, (0x605A, option), 0x0B, stop, state)?;
    }
    Ok(())
}

fn quick_stop_0(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[0], Stop::Coasting, SwitchOnDisabled)
}

fn quick_stop_1(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[1], Stop::Profile, SwitchOnDisabled)
}

fn quick_stop_2(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[2], Stop::Quick, SwitchOnDisabled)
}

fn quick_stop_3_and_4(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[3, 4], Stop::AtLimits, SwitchOnDisabled)
}

fn quick_stop_5(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[5], Stop::Profile, QuickStopActive)
}

fn quick_stop_6(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[6], Stop::Quick, QuickStopActive)
}

fn quick_stop_7_and_8(rig: &mut Rig) -> Verdict {
    quick_stop(rig, &[7, 8], Stop::AtLimits, QuickStopActive)
}

fn quick_stop_while_braking(rig: &mut Rig) -> Verdict {
    for option in [1, 2, 5, 6] {
        turning(rig)?;
        rig.write(0x605A, 0, option, 2)?;
        rig.control(0x02)?;
        rig.pass(30);
        rig.expect_power(QuickStopActive, &format!("35 ms of braking with option {option}"))?;
        let velocity = rig.velocity()?;
        ensure!(velocity > 500, "{velocity} rpm");
    }
    Ok(())
}

fn shutdown(rig: &mut Rig) -> Verdict {
    stops(rig, (0x605B, 0), 0x06, Stop::Coasting, ReadyToSwitchOn)?;
    stops(rig, (0x605B, 1), 0x06, Stop::Profile, ReadyToSwitchOn)
}

fn disable_operation(rig: &mut Rig) -> Verdict {
    stops(rig, (0x605C, 0), 0x07, Stop::Coasting, SwitchedOn)?;
    stops(rig, (0x605C, 1), 0x07, Stop::Profile, SwitchedOn)
}

fn disable_voltage(rig: &mut Rig) -> Verdict {
    stops(rig, (0x605B, 1), 0x00, Stop::Coasting, SwitchOnDisabled)?;
    stops(rig, (0x605A, 6), 0x00, Stop::Coasting, SwitchOnDisabled)
}

fn halt(rig: &mut Rig) -> Verdict {
    stops(rig, (0x605D, 1), 0x10F, Stop::Profile, OperationEnabled)?;
    rig.expect_bits((0x0400, 0x0400), "after the halt")?;
    stops(rig, (0x605D, 2), 0x10F, Stop::Quick, OperationEnabled)?;
    rig.expect_bits((0x0400, 0x0400), "after the halt")
}

fn halt_ends(rig: &mut Rig) -> Verdict {
    stops(rig, (0x605D, 1), 0x10F, Stop::Profile, OperationEnabled)?;
    rig.control(0x0F)?;
    rig.pass(300);
    rig.expect_velocity(SPEED, 30)
}

/// Causes the loss of a heartbeat 20 ms from now.
fn lose_host(rig: &mut Rig, abort: i64) -> Verdict {
    rig.write(0x6007, 0, abort, 2)?;
    rig.write(0x1029, 1, 1, 1)?;
    rig.lose_host(21)
}

fn fault_reaction(rig: &mut Rig) -> Verdict {
    for (option, stop) in [(0, Stop::Coasting), (1, Stop::Profile), (2, Stop::Quick)] {
        turning(rig)?;
        rig.write(0x605E, 0, option, 2)?;
        lose_host(rig, 1)?;
        let why = format!("0x605e = {option}");
        expect_stop(rig, stop, &why)?;
        rig.pass(20);
        rig.expect_power(Fault, &why)?;
    }
    Ok(())
}

fn abort_0(rig: &mut Rig) -> Verdict {
    turning(rig)?;
    lose_host(rig, 0)?;
    rig.pass(100);
    rig.expect_velocity(SPEED, 30)?;
    rig.expect_power(OperationEnabled, "the loss")
}

fn abort_1(rig: &mut Rig) -> Verdict {
    turning(rig)?;
    lose_host(rig, 1)?;
    expect_stop(rig, Stop::Quick, "0x6007 = 1")?;
    rig.pass(20);
    rig.expect_power(Fault, "the loss")
}

fn abort_2(rig: &mut Rig) -> Verdict {
    turning(rig)?;
    lose_host(rig, 2)?;
    rig.expect_coasting(SPEED, "0x6007 = 2")?;
    rig.expect_power(SwitchOnDisabled, "the loss")
}

fn abort_3(rig: &mut Rig) -> Verdict {
    for (option, stop, state) in
        [(6, Stop::Quick, QuickStopActive), (2, Stop::Quick, SwitchOnDisabled), (1, Stop::Profile, SwitchOnDisabled)]
    {
        turning(rig)?;
        rig.write(0x605A, 0, option, 2)?;
        lose_host(rig, 3)?;
        let why = format!("0x6007 = 3, 0x605a = {option}");
        expect_stop(rig, stop, &why)?;
        rig.pass(20);
        rig.expect_power(state, &why)?;
    }
    Ok(())
}

fn abort_by_nmt_stop(rig: &mut Rig) -> Verdict {
    for (abort, state) in [(0, OperationEnabled), (1, Fault), (2, SwitchOnDisabled), (3, QuickStopActive)] {
        turning(rig)?;
        rig.nmt(0x01);
        rig.write(0x6007, 0, abort, 2)?;
        rig.nmt(0x02);
        rig.pass(400);
        rig.nmt(0x01);
        let why = format!("NMT stop with 0x6007 = {abort}");
        rig.expect_power(state, &why)?;
        match abort {
            0 => rig.expect_velocity(SPEED, 30)?,
            2 => rig.expect_coasting(SPEED, &why)?,
            // The power is switched off at the end of the ramp, and this axis has no friction.
            _ => rig.expect_velocity(0, SPEED / 20)?,
        }
    }
    Ok(())
}
