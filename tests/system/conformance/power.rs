//! Claims about the power states of CiA 402: the transitions, the words, faults, and modes of operation.

use super::drive::{
    CSP, CST, CSV, HM, PP, PV,
    Power::{self, Fault, OperationEnabled, QuickStopActive, ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn},
};
use super::rig::{Deviation, EMCY, RPDO, Rig, TPDO, Verdict, ensure, hex};
use super::{CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_402_2.row(
        "fsa-0-1",
        "",
        ("Transitions 0 and 1", &[0x6041]),
        "after power-on the drive reaches switch on disabled by itself",
        to_switch_on_disabled,
    ),
    CIA_402_2.row(
        "fsa-2",
        "",
        ("Transition 2", &[0x6040, 0x6041]),
        "shutdown leads from switch on disabled to ready to switch on",
        transition_2,
    ),
    CIA_402_2.row(
        "fsa-3",
        "",
        ("Transition 3", &[0x6040, 0x6041]),
        "switch on leads from ready to switch on to switched on",
        transition_3,
    ),
    CIA_402_2.row(
        "fsa-4",
        "",
        ("Transition 4", &[0x6040, 0x6041]),
        "enable operation leads from switched on to operation enabled",
        transition_4,
    ),
    CIA_402_2.row(
        "fsa-5",
        "",
        ("Transition 5", &[0x6040, 0x6041]),
        "disable operation leads from operation enabled to switched on",
        transition_5,
    ),
    CIA_402_2.row(
        "fsa-6",
        "",
        ("Transition 6", &[0x6040, 0x6041]),
        "shutdown leads from switched on to ready to switch on",
        transition_6,
    ),
    CIA_402_2.row(
        "fsa-7",
        "",
        ("Transition 7", &[0x6040, 0x6041]),
        "disable voltage and quick stop lead from ready to switch on to switch on disabled",
        transition_7,
    ),
    CIA_402_2.row(
        "fsa-8",
        "",
        ("Transition 8", &[0x6040, 0x6041]),
        "shutdown leads from operation enabled to ready to switch on",
        transition_8,
    ),
    CIA_402_2.row(
        "fsa-9",
        "",
        ("Transition 9", &[0x6040, 0x6041]),
        "disable voltage leads from operation enabled to switch on disabled",
        transition_9,
    ),
    CIA_402_2.row(
        "fsa-10",
        "",
        ("Transition 10", &[0x6040, 0x6041]),
        "disable voltage and quick stop lead from switched on to switch on disabled",
        transition_10,
    ),
    CIA_402_2.row(
        "fsa-11",
        "",
        ("Transition 11", &[0x6040, 0x6041]),
        "quick stop leads from operation enabled to quick stop active",
        transition_11,
    ),
    CIA_402_2.row(
        "fsa-12",
        "",
        ("Transition 12", &[0x6040, 0x6041]),
        "disable voltage leads from quick stop active to switch on disabled",
        transition_12,
    ),
    CIA_402_2.row(
        "fsa-13-14",
        "",
        ("Transitions 13 and 14", &[0x6041]),
        "a fault leads from every state to fault",
        transitions_13_and_14,
    ),
    CIA_402_2.row(
        "fsa-15",
        "",
        ("Transition 15", &[0x6040, 0x6041]),
        "a rising edge of bit 7 leads from fault to switch on disabled",
        transition_15,
    ),
    CIA_402_2.row(
        "fsa-15-edge",
        "",
        ("Transition 15", &[0x6040]),
        "bit 7 that stands at 1 since before the fault does not reset",
        reset_needs_an_edge,
    ),
    CIA_402_2.row(
        "fsa-16",
        "",
        ("Transition 16", &[0x6040, 0x6041]),
        "enable operation leads from quick stop active back to operation enabled",
        transition_16,
    ),
    CIA_402_2.row(
        "fsa-3-4",
        "",
        ("Transitions 3 and 4", &[0x6040]),
        "switch on with bit 3 leads to switched on or further to operation enabled",
        switch_on_and_enable,
    ),
    CIA_402_2.row(
        "fsa-no-others",
        "",
        ("Commands", &[0x6040, 0x6041]),
        "a command without a transition in a state leaves the state",
        no_other_transitions,
    ),
    CIA_402_2.row(
        "fsa-fault-commands",
        "",
        ("Commands", &[0x6040]),
        "in fault no command but the reset has an effect",
        fault_ignores_commands,
    ),
    CIA_402_2.row(
        "fsa-pdo",
        "",
        ("Commands", &[0x6040, 0x6041]),
        "the controlword by RPDO and the statusword by TPDO walk through the states",
        by_pdo,
    ),
    CIA_402_2.row(
        "status-voltage",
        "",
        ("Statusword, bit 4", &[0x6041]),
        "voltage enabled stands in operation enabled",
        voltage_enabled,
    ),
    CIA_402_2.row(
        "status-remote",
        "",
        ("Statusword, bit 9", &[0x6041]),
        "remote stands where the controlword is obeyed in operational",
        remote,
    ),
    CIA_402_2.row(
        "status-no-warning",
        "",
        ("Statusword, bit 7", &[0x6041]),
        "no warning stands in a sound drive in any state",
        no_warning,
    ),
    CIA_402_2.row(
        "fault-code",
        "",
        ("Error code", &[0x603F]),
        "a following error is code 8611 in 0x603F, EMCY and history",
        fault_code,
    ),
    CIA_402_2.row(
        "fault-reset-emcy",
        "",
        ("Fault reset", &[0x603F, 0x1001]),
        "the reset is EMCY 0000, and the error register is 0",
        reset_emcy,
    ),
    CIA_402_2.row(
        "fault-persists",
        "",
        ("Fault reset", &[0x6041]),
        "a fault whose cause stands comes back after its reset",
        cause_stands,
    ),
    CIA_402_2.row(
        "fault-reset-communication",
        "",
        ("Fault", &[0x603F, 0x1001]),
        "a fault outlives a reset of the communication, with its error register and code",
        fault_over_reset_communication,
    ),
    CIA_402_2.row(
        "fault-reset-node",
        "",
        ("Fault", &[0x603F, 0x1001]),
        "after a reset of the node state, error register and code agree",
        fault_over_reset_node,
    ),
    CIA_402_2.row(
        "mode-display",
        "",
        ("Modes of operation", &[0x6060, 0x6061]),
        "each supported mode is taken and shown",
        mode_display,
    ),
    CIA_402_2.row(
        "mode-supported",
        "",
        ("Modes of operation", &[0x6060, 0x6502]),
        "a mode whose bit is 0 in 0x6502 is refused or not shown",
        mode_unsupported,
    ),
    CIA_402_2.row(
        "mode-enabled",
        "",
        ("Modes of operation", &[0x6060, 0x6061]),
        "the mode of an enabled axis at rest can be changed",
        mode_while_enabled,
    ),
    CIA_402_2.row(
        "mode-no-motion",
        "",
        ("Modes of operation", &[0x6060]),
        "a change of mode in an axis at rest moves nothing",
        mode_without_motion,
    ),
];

fn to_switch_on_disabled(rig: &mut Rig) -> Verdict {
    rig.expect_power(SwitchOnDisabled, "power-on")
}

/// Checks one transition, caused by each of these commands.
fn transition(rig: &mut Rig, from: Power, commands: &[u16], to: Power) -> Verdict {
    for &command in commands {
        rig.bring(from)?;
        rig.control(command)?;
        rig.expect_power(to, &format!("{from:?} and {command:#04x}"))?;
        rig.control(0x00)?;
    }
    Ok(())
}

fn transition_2(rig: &mut Rig) -> Verdict {
    transition(rig, SwitchOnDisabled, &[0x06, 0x0E, 0x16], ReadyToSwitchOn)
}

fn transition_3(rig: &mut Rig) -> Verdict {
    transition(rig, ReadyToSwitchOn, &[0x07], SwitchedOn)
}

fn transition_4(rig: &mut Rig) -> Verdict {
    transition(rig, SwitchedOn, &[0x0F], OperationEnabled)
}

fn transition_5(rig: &mut Rig) -> Verdict {
    transition(rig, OperationEnabled, &[0x07], SwitchedOn)
}

fn transition_6(rig: &mut Rig) -> Verdict {
    transition(rig, SwitchedOn, &[0x06, 0x0E], ReadyToSwitchOn)
}

fn transition_7(rig: &mut Rig) -> Verdict {
    transition(rig, ReadyToSwitchOn, &[0x00, 0x0D, 0x02, 0x0B], SwitchOnDisabled)
}

fn transition_8(rig: &mut Rig) -> Verdict {
    transition(rig, OperationEnabled, &[0x06, 0x0E], ReadyToSwitchOn)
}

fn transition_9(rig: &mut Rig) -> Verdict {
    transition(rig, OperationEnabled, &[0x00, 0x0D], SwitchOnDisabled)
}

fn transition_10(rig: &mut Rig) -> Verdict {
    transition(rig, SwitchedOn, &[0x00, 0x0D, 0x02, 0x0B], SwitchOnDisabled)
}

fn transition_11(rig: &mut Rig) -> Verdict {
    transition(rig, OperationEnabled, &[0x02, 0x0B], QuickStopActive)
}

fn transition_12(rig: &mut Rig) -> Verdict {
    transition(rig, QuickStopActive, &[0x00, 0x0D], SwitchOnDisabled)
}

/// Clears a fault whose cause was removed.
fn clear(rig: &mut Rig) -> Verdict {
    rig.control(0x00)?;
    rig.control(0x80)?;
    rig.control(0x00)?;
    rig.expect_power(SwitchOnDisabled, "the fault reset")
}

fn transitions_13_and_14(rig: &mut Rig) -> Verdict {
    for from in [SwitchOnDisabled, ReadyToSwitchOn, SwitchedOn, OperationEnabled, QuickStopActive] {
        rig.bring(from)?;
        rig.bring(Fault)?;
        clear(rig)?;
    }
    Ok(())
}

fn transition_15(rig: &mut Rig) -> Verdict {
    for command in [0x80, 0x8F, 0x86] {
        rig.bring(Fault)?;
        rig.control(0x00)?;
        rig.control(command)?;
        rig.expect_power(SwitchOnDisabled, &format!("fault and {command:#04x}"))?;
        rig.control(0x00)?;
    }
    Ok(())
}

fn reset_needs_an_edge(rig: &mut Rig) -> Verdict {
    rig.control(0x80)?;
    rig.bring(Fault)?;
    rig.control(0x80)?;
    rig.expect_power(Fault, "bit 7 without an edge")?;
    rig.pass(100);
    rig.expect_power(Fault, "bit 7 without an edge")?;
    clear(rig)
}

fn transition_16(rig: &mut Rig) -> Verdict {
    for option in [5, 6, 7, 8] {
        rig.write(0x605A, 0, option, 2)?;
        rig.bring(QuickStopActive)?;
        rig.control(0x0F)?;
        rig.expect_power(OperationEnabled, &format!("quick stop with option {option} and 0x0f"))?;
        rig.control(0x00)?;
    }
    Ok(())
}

fn switch_on_and_enable(rig: &mut Rig) -> Verdict {
    rig.bring(ReadyToSwitchOn)?;
    rig.control(0x0F)?;
    let power = rig.power()?;
    ensure!(matches!(power, SwitchedOn | OperationEnabled), "{power:?}");
    rig.control(0x0F)?;
    if power == SwitchedOn {
        rig.control(0x07)?;
        rig.control(0x0F)?;
    }
    rig.expect_power(OperationEnabled, "0x0f")
}

fn no_other_transitions(rig: &mut Rig) -> Verdict {
    for (state, commands) in [
        (SwitchOnDisabled, [0x07, 0x0F, 0x00, 0x02, 0x80].as_slice()),
        (ReadyToSwitchOn, &[0x06, 0x0E]),
        (SwitchedOn, &[0x07]),
        (OperationEnabled, &[0x0F]),
        (QuickStopActive, &[0x02, 0x0B, 0x06, 0x07]),
    ] {
        for &command in commands {
            rig.bring(state)?;
            rig.control(command)?;
            rig.expect_power(state, &format!("{state:?} and {command:#04x}"))?;
            rig.control(0x00)?;
        }
    }
    Ok(())
}

fn fault_ignores_commands(rig: &mut Rig) -> Verdict {
    rig.bring(Fault)?;
    for command in [0x06, 0x07, 0x0F, 0x00, 0x02, 0x1F, 0x10F] {
        rig.control(command)?;
        rig.expect_power(Fault, &format!("{command:#04x}"))?;
    }
    Ok(())
}

fn by_pdo(rig: &mut Rig) -> Verdict {
    rig.nmt(0x01);
    rig.pass(20);
    for (command, power) in [
        (0x06_u16, ReadyToSwitchOn),
        (0x07, SwitchedOn),
        (0x0F, OperationEnabled),
        (0x02, QuickStopActive),
        (0x0F, OperationEnabled),
        (0x07, SwitchedOn),
        (0x06, ReadyToSwitchOn),
        (0x00, SwitchOnDisabled),
    ] {
        let mark = rig.mark();
        rig.send(RPDO[0], &command.to_le_bytes());
        rig.pass(20);
        let last = rig.heard(mark, TPDO[0]).pop();
        let word = last.map(|heard| u32::from(heard.data[0]) | u32::from(heard.data[1]) << 8);
        ensure!(
            word.and_then(Power::decode) == Some(power),
            "TPDO1 {word:#06x?} after {command:#04x}, expected {power:?}"
        );
    }
    Ok(())
}

fn voltage_enabled(rig: &mut Rig) -> Verdict {
    rig.bring(OperationEnabled)?;
    rig.expect_bits((0x10, 0x10), "in operation enabled")
}

fn remote(rig: &mut Rig) -> Verdict {
    rig.nmt(0x01);
    rig.bring(OperationEnabled)?;
    rig.expect_bits((0x0200, 0x0200), "in operational")
}

fn no_warning(rig: &mut Rig) -> Verdict {
    for power in [SwitchOnDisabled, ReadyToSwitchOn, SwitchedOn, OperationEnabled] {
        rig.bring(power)?;
        rig.expect_bits((0x80, 0), &format!("in {power:?}"))?;
    }
    Ok(())
}

/// Causes a following error: the position demand jumps beyond the window.
pub(super) fn following_error(rig: &mut Rig) -> Verdict {
    rig.write(0x6065, 0, 50, 4)?;
    let position = rig.position()?;
    rig.write(0x607A, 0, i64::from(position), 4)?;
    rig.enable(CSP)?;
    rig.write(0x607A, 0, i64::from(position) + 100_000, 4)?;
    rig.pass(300);
    rig.expect_power(Fault, "a jump of the set-point by 100000 counts")
}

fn fault_code(rig: &mut Rig) -> Verdict {
    let mark = rig.mark();
    following_error(rig)?;
    rig.expect(0x603F, 0, 0x8611)?;
    let sent = rig.heard(mark, EMCY);
    ensure!(sent.len() == 1 && sent[0].data[..2] == [0x11, 0x86], "{sent:02X?}");
    ensure!(sent[0].data[2] & 1 == 1, "error register {:02X}", sent[0].data[2]);
    let entry = rig.read(0x1003, 1)?;
    ensure!(entry & 0xFFFF == 0x8611, "history {entry:#x}");
    Ok(())
}

fn reset_emcy(rig: &mut Rig) -> Verdict {
    following_error(rig)?;
    ensure!(rig.read(0x1001, 0)? & 1 == 1, "error register 0 in fault");
    let mark = rig.mark();
    clear(rig)?;
    let sent = rig.heard(mark, EMCY);
    ensure!(sent.len() == 1 && sent[0].data[..3] == [0, 0, 0], "{sent:02X?}");
    rig.expect(0x1001, 0, 0)
}

fn cause_stands(rig: &mut Rig) -> Verdict {
    rig.bring(Fault)?;
    // The producer is monitored again, sends one heartbeat and is lost again.
    rig.lose_host(5)?;
    rig.control(0x00)?;
    rig.control(0x80)?;
    rig.pass(60);
    rig.expect_power(Fault, "a second loss")
}

/// Power state, error register and error code.
fn error_state(rig: &mut Rig) -> Result<(Power, u32, u32), Deviation> {
    Ok((rig.power()?, rig.read(0x1001, 0)?, rig.read(0x603F, 0)?))
}

fn fault_over_reset_communication(rig: &mut Rig) -> Verdict {
    following_error(rig)?;
    let before = error_state(rig)?;
    rig.reset(0x82);
    let after = error_state(rig)?;
    ensure!(after == before, "{after:02x?} after the reset, {before:02x?} before");
    clear(rig)?;
    rig.expect(0x1001, 0, 0)
}

fn fault_over_reset_node(rig: &mut Rig) -> Verdict {
    following_error(rig)?;
    rig.reset(0x81);
    let (power, register, code) = error_state(rig)?;
    let faulty = power == Fault;
    ensure!(
        faulty == (register != 0) && faulty == (code != 0),
        "{power:?}, error register {register:#04x}, error code {code:#06x}"
    );
    Ok(())
}

const MODES: [i64; 6] = [PP, PV, HM, CSP, CSV, CST];

fn mode_display(rig: &mut Rig) -> Verdict {
    for mode in MODES {
        rig.set_mode(mode)?;
        rig.enable(mode)?;
        rig.control(0x00)?;
    }
    Ok(())
}

fn mode_unsupported(rig: &mut Rig) -> Verdict {
    let supported = rig.read(0x6502, 0)?;
    for mode in 1..=10 {
        rig.set_mode(PV)?;
        let answer = rig.download(0x6060, 0, mode, 1)?;
        rig.pass(5);
        let shown = i64::from(rig.read_signed(0x6061, 0)?);
        let bit = supported >> (mode - 1) & 1 == 1;
        ensure!((shown == mode) == bit, "mode {mode}: {}, mode {shown} is shown", hex(&answer));
    }
    Ok(())
}

fn mode_while_enabled(rig: &mut Rig) -> Verdict {
    rig.enable(PP)?;
    for mode in [PV, HM, PP] {
        rig.set_mode(mode)?;
        rig.expect_power(OperationEnabled, &format!("the change to mode {mode}"))?;
    }
    Ok(())
}

fn mode_without_motion(rig: &mut Rig) -> Verdict {
    rig.enable(PP)?;
    let position = rig.position()?;
    for mode in [PV, HM, PP, PV] {
        rig.set_mode(mode)?;
        rig.pass(100);
        rig.expect_position(position, 3)?;
    }
    Ok(())
}
