//! Claims about NMT: boot-up, states, commands, and the services available in each state.

use super::rig::{Deviation, EMCY, HEARTBEAT, NODE, RPDO, Rig, SDO_ANSWER, TPDO, Verdict, ensure, hex, request, unit};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "nmt-boot-up",
        "7.2.8.3.3",
        ("Boot-up", &[]),
        "after power-on the first frame is the boot-up message, one byte 00",
        boot_up,
    ),
    CIA_301.row(
        "nmt-pre-operational",
        "7.3.2.2.1",
        ("NMT state machine", &[]),
        "the drive enters pre-operational by itself after the boot-up",
        pre_operational,
    ),
    CIA_301.row("nmt-start", "7.2.8.3.1", ("Start remote node", &[]), "leads from every state to operational", start),
    CIA_301.row("nmt-stop", "7.2.8.3.1", ("Stop remote node", &[]), "leads from every state to stopped", stop),
    CIA_301.row(
        "nmt-enter-pre-operational",
        "7.2.8.3.1",
        ("Enter pre-operational", &[]),
        "leads from every state to pre-operational",
        enter_pre_operational,
    ),
    CIA_301.row(
        "nmt-reset-node",
        "7.2.8.3.1",
        ("Reset node", &[]),
        "leads from every state over a boot-up to pre-operational",
        reset_node,
    ),
    CIA_301.row(
        "nmt-reset-communication",
        "7.2.8.3.1",
        ("Reset communication", &[]),
        "leads from every state over a boot-up to pre-operational",
        reset_communication,
    ),
    CIA_301.row(
        "nmt-broadcast",
        "7.2.8.3.1",
        ("Node control", &[]),
        "node-ID 0 addresses the drive too, with all five commands",
        broadcast,
    ),
    CIA_301.row(
        "nmt-other-node",
        "7.2.8.3.1",
        ("Node control", &[]),
        "a command to another node changes nothing",
        other_node,
    ),
    CIA_301.row(
        "nmt-unknown-command",
        "7.2.8.3.1",
        ("Node control", &[]),
        "an unknown command specifier changes nothing",
        unknown_command,
    ),
    CIA_301.row(
        "nmt-malformed",
        "7.2.8.3.1",
        ("Node control", &[]),
        "a frame of fewer than two bytes, a remote frame and a 29-bit identifier change nothing",
        malformed,
    ),
    CIA_301.row(
        "nmt-no-answer",
        "7.2.8.2",
        ("Node control", &[]),
        "start, stop and enter pre-operational are unconfirmed: no frame but PDOs answers",
        no_answer,
    ),
    CIA_301.row(
        "nmt-sdo-states",
        "Table 37",
        ("SDO", &[]),
        "works in pre-operational and operational, not in stopped",
        sdo_states,
    ),
    CIA_301.row("nmt-pdo-states", "Table 37", ("PDO", &[]), "TPDOs and RPDOs work in operational alone", pdo_states),
    CIA_301.row("nmt-sync-states", "Table 37", ("SYNC", &[]), "SYNC triggers PDOs in operational alone", sync_states),
    CIA_301.row(
        "nmt-emcy-states",
        "Table 37",
        ("EMCY", &[]),
        "works in pre-operational and operational, not in stopped",
        emcy_states,
    ),
    CIA_301.row(
        "nmt-error-control-states",
        "Table 37",
        ("Error control", &[]),
        "heartbeats go on in pre-operational, operational and stopped",
        error_control_states,
    ),
    CIA_301.row(
        "nmt-reset-communication-area",
        "7.3.2.2.1",
        ("Reset communication", &[0x1017, 0x1800]),
        "0x1000 to 0x1FFF return to power-on values, the application area stays",
        communication_area,
    ),
    CIA_301.row(
        "nmt-reset-node-area",
        "7.3.2.2.1",
        ("Reset node", &[0x1017, 0x6081]),
        "the application area and the communication area return to power-on values",
        application_area,
    ),
    CIA_301.row(
        "nmt-silent-restart",
        "7.3.2.2.1",
        ("NMT initialisation", &[]),
        "between a reset and its boot-up the drive neither sends nor answers",
        silent_restart,
    ),
];

const PRE_OPERATIONAL: u8 = 0x7F;

const OPERATIONAL: u8 = 0x05;

const STOPPED: u8 = 0x04;

/// NMT commands and the states that they lead to.
const STATES: [(u8, u8); 3] = [(0x80, PRE_OPERATIONAL), (0x01, OPERATIONAL), (0x02, STOPPED)];

/// Enables a heartbeat of 10 ms, which shows the state.
fn show_state(rig: &mut Rig) -> Verdict {
    rig.write(0x1017, 0, 10, 2)
}

fn expect_state(rig: &mut Rig, state: u8, after: &str) -> Verdict {
    let found = rig.nmt_state()?;
    ensure!(found == state, "NMT state {found:#04x} after {after}, expected {state:#04x}");
    Ok(())
}

fn boot_up(rig: &mut Rig) -> Verdict {
    rig.power_on(unit());
    let mark = rig.mark();
    rig.pass(100);
    let heard = rig.all_heard(mark);
    ensure!(heard == [format!("{HEARTBEAT:03X}#00")], "{heard:?}");
    Ok(())
}

fn pre_operational(rig: &mut Rig) -> Verdict {
    show_state(rig)?;
    expect_state(rig, PRE_OPERATIONAL, "boot-up")
}

fn leads_from_every_state(rig: &mut Rig, command: u8, state: u8) -> Verdict {
    show_state(rig)?;
    for (from, _) in STATES {
        rig.nmt(from);
        rig.nmt(command);
        expect_state(rig, state, &format!("{from:02X} and {command:02X}"))?;
    }
    Ok(())
}

fn start(rig: &mut Rig) -> Verdict {
    leads_from_every_state(rig, 0x01, OPERATIONAL)
}

fn stop(rig: &mut Rig) -> Verdict {
    leads_from_every_state(rig, 0x02, STOPPED)
}

fn enter_pre_operational(rig: &mut Rig) -> Verdict {
    leads_from_every_state(rig, 0x80, PRE_OPERATIONAL)
}

fn resets_from_every_state(rig: &mut Rig, command: u8) -> Verdict {
    for (from, _) in STATES {
        rig.nmt(from);
        let mark = rig.mark();
        rig.reset(command);
        let heard: Vec<_> = rig.heard(mark, HEARTBEAT).into_iter().map(|heard| heard.data).collect();
        ensure!(heard == [[0x00]], "after {from:02X} and {command:02X}: {heard:?}");
        show_state(rig)?;
        expect_state(rig, PRE_OPERATIONAL, "the reset")?;
    }
    Ok(())
}

fn reset_node(rig: &mut Rig) -> Verdict {
    resets_from_every_state(rig, 0x81)
}

fn reset_communication(rig: &mut Rig) -> Verdict {
    resets_from_every_state(rig, 0x82)
}

fn broadcast(rig: &mut Rig) -> Verdict {
    show_state(rig)?;
    for (command, state) in STATES {
        rig.send(0x000, &[command, 0]);
        rig.pass(5);
        expect_state(rig, state, &format!("{command:02X} to all"))?;
    }
    for command in [0x81, 0x82] {
        let mark = rig.mark();
        rig.send(0x000, &[command, 0]);
        rig.pass(80);
        let heard = rig.heard(mark, HEARTBEAT);
        ensure!(heard.iter().any(|heard| heard.data == [0]), "no boot-up after {command:02X} to all");
    }
    Ok(())
}

fn other_node(rig: &mut Rig) -> Verdict {
    show_state(rig)?;
    for command in [0x01, 0x02, 0x81, 0x82] {
        for node in [NODE - 1, NODE + 1, 127, 128 + NODE, 255] {
            rig.send(0x000, &[command, node]);
            rig.pass(2);
        }
        expect_state(rig, PRE_OPERATIONAL, "commands to other nodes")?;
    }
    Ok(())
}

fn unknown_command(rig: &mut Rig) -> Verdict {
    show_state(rig)?;
    for command in [0x00, 0x03, 0x04, 0x05, 0x7F, 0x83, 0xFF] {
        rig.send(0x000, &[command, NODE]);
        rig.pass(2);
    }
    expect_state(rig, PRE_OPERATIONAL, "unknown commands")
}

fn malformed(rig: &mut Rig) -> Verdict {
    show_state(rig)?;
    rig.send(0x000, &[]);
    rig.send(0x000, &[0x01]);
    rig.send_remote(0x000, 2);
    rig.send_extended(0x000, &[0x01, NODE]);
    rig.pass(5);
    expect_state(rig, PRE_OPERATIONAL, "malformed commands")
}

fn no_answer(rig: &mut Rig) -> Verdict {
    for (command, _) in STATES {
        let mark = rig.mark();
        rig.nmt(command);
        let answers: Vec<_> = rig
            .all_heard(mark)
            .into_iter()
            .filter(|text| !TPDO.iter().any(|id| text.starts_with(&format!("{id:03X}#"))))
            .collect();
        ensure!(answers.is_empty(), "answers to {command:02X}: {answers:?}");
    }
    rig.nmt(0x80);
    show_state(rig)?;
    expect_state(rig, PRE_OPERATIONAL, "the commands")
}

fn sdo_states(rig: &mut Rig) -> Verdict {
    let upload = request(0x40, 0x1000, 0, [0; 4]);
    for (command, state) in STATES {
        rig.nmt(command);
        let answered = rig.ask(upload).is_some();
        ensure!(answered == (state != STOPPED), "answered in state {state:#04x}: {answered}");
    }
    // A request that arrives in the state stopped is not answered later.
    let mark = rig.mark();
    rig.nmt(0x80);
    rig.pass(20);
    let late = rig.heard(mark, SDO_ANSWER);
    ensure!(late.is_empty(), "late answer {}", hex(&late[0].data));
    Ok(())
}

/// Writes the controlword by RPDO1.
fn command_by_pdo(rig: &mut Rig, word: u16) {
    rig.send(RPDO[0], &word.to_le_bytes());
    rig.pass(5);
}

fn pdo_states(rig: &mut Rig) -> Verdict {
    for (command, state) in STATES {
        rig.nmt(0x80);
        rig.write(0x6040, 0, 0x00, 2)?;
        rig.nmt(command);
        rig.pass(20);
        let mark = rig.mark();
        command_by_pdo(rig, 0x06);
        rig.pass(20);
        let sent = rig.heard(mark, TPDO[0]).len();
        rig.nmt(0x80);
        let ready = rig.read(0x6041, 0)? & 0x6F == 0x21;
        let active = state == OPERATIONAL;
        ensure!(ready == active, "RPDO1 took effect in state {state:#04x}: {ready}");
        ensure!((sent > 0) == active, "{sent} TPDOs in state {state:#04x}");
    }
    Ok(())
}

fn sync_states(rig: &mut Rig) -> Verdict {
    rig.write(0x1801, 2, 1, 1)?;
    rig.write(0x1801, 1, 0x4000_0000 + i64::from(TPDO[1]), 4)?;
    for (command, state) in STATES {
        rig.nmt(command);
        rig.pass(10);
        let mark = rig.mark();
        for _ in 0..3 {
            rig.send(0x080, &[]);
            rig.pass(5);
        }
        let sent = rig.heard(mark, TPDO[1]).len();
        let expected = if state == OPERATIONAL { 3 } else { 0 };
        ensure!(sent == expected, "{sent} answers to 3 SYNCs in state {state:#04x}");
    }
    Ok(())
}

/// Monitors node 0x7E from now on. The node falls silent after one heartbeat.
fn lose_a_producer(rig: &mut Rig) {
    rig.send(0x77E, &[0x05]);
    rig.pass(60);
}

fn emcy_states(rig: &mut Rig) -> Verdict {
    for (command, state) in STATES {
        rig.reset(0x81);
        rig.write(0x6007, 0, 0, 2)?;
        rig.write(0x1029, 1, 1, 1)?;
        rig.write(0x1016, 1, 0x7E << 16 | 30, 4)?;
        rig.nmt(command);
        let mark = rig.mark();
        lose_a_producer(rig);
        let sent = rig.heard(mark, EMCY).len();
        let expected = usize::from(state != STOPPED);
        ensure!(sent == expected, "{sent} EMCY in state {state:#04x}");
    }
    Ok(())
}

fn error_control_states(rig: &mut Rig) -> Verdict {
    show_state(rig)?;
    for (command, state) in STATES {
        rig.nmt(command);
        rig.pass(12);
        let mark = rig.mark();
        rig.pass(100);
        let heard = rig.heard(mark, HEARTBEAT);
        let right = heard.iter().all(|heard| heard.data == [state]);
        ensure!(
            (9..=11).contains(&heard.len()) && right,
            "{} heartbeats in state {state:#04x}: {heard:?}",
            heard.len()
        );
    }
    Ok(())
}

fn change_both_areas(rig: &mut Rig) -> Verdict {
    rig.write(0x1017, 0, 500, 2)?;
    rig.write(0x1800, 5, 77, 2)?;
    rig.write(0x6081, 0, 1234, 4)
}

fn communication_area(rig: &mut Rig) -> Verdict {
    change_both_areas(rig)?;
    rig.reset(0x82);
    rig.expect(0x1017, 0, 0)?;
    rig.expect(0x1800, 5, 0)?;
    rig.expect(0x6081, 0, 1234)
}

fn application_area(rig: &mut Rig) -> Verdict {
    change_both_areas(rig)?;
    rig.reset(0x81);
    rig.expect(0x1017, 0, 0)?;
    rig.expect(0x1800, 5, 0)?;
    rig.expect(0x6081, 0, 1000)
}

fn silent_restart(rig: &mut Rig) -> Verdict {
    for command in [0x81, 0x82] {
        rig.nmt(0x80);
        let mark = rig.mark();
        rig.send(0x000, &[command, NODE]);
        rig.pass(5);
        rig.send(0x600 + u16::from(NODE), &request(0x40, 0x1000, 0, [0; 4]));
        rig.pass(80);
        let heard = rig.all_heard(mark);
        let boot_up = format!("{HEARTBEAT:03X}#00");
        ensure!(heard.first() == Some(&boot_up), "first frame after {command:02X}: {heard:?}");
        if heard.len() > 1 {
            return Err(Deviation(format!("more than the boot-up: {heard:?}")));
        }
    }
    Ok(())
}
