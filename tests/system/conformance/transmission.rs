//! Claims about the transmission of PDOs: events, timers, lengths and deadlines.

use super::pdo::{Pdo, reacts, rpdo, tpdo};
use super::rig::{EMCY, Mark, RPDO, Rig, Verdict, ensure};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "tpdo-event",
        "7.2.2.3",
        ("TPDO of types 254 and 255", &[0x1800]),
        "is sent when a mapped object changes, and not otherwise",
        event_driven,
    ),
    CIA_301.row(
        "tpdo-event-timer",
        "7.5.2.37",
        ("Event timer", &[0x1801]),
        "sends the TPDO at its period, within 1 ms",
        event_timer,
    ),
    CIA_301.row(
        "tpdo-event-timer-off",
        "7.5.2.37",
        ("Event timer", &[0x1801]),
        "0 ends the event timer",
        event_timer_off,
    ),
    CIA_301.row(
        "tpdo-inhibit",
        "7.5.2.37",
        ("Inhibit time", &[0x1800]),
        "two events are that far apart, and the last state is sent in the end",
        inhibit,
    ),
    CIA_301.row(
        "tpdo-inhibit-over-timer",
        "7.5.2.37",
        ("Inhibit time", &[0x1801]),
        "is kept where the event timer is shorter",
        inhibit_over_timer,
    ),
    CIA_301.row(
        "tpdo-inhibit-sync",
        "7.5.2.37",
        ("Inhibit time", &[0x1801]),
        "does not hold synchronous TPDOs back",
        inhibit_and_sync,
    ),
    CIA_301.row(
        "rpdo-immediate",
        "7.2.2.2",
        ("RPDO of types 254 and 255", &[0x1400]),
        "takes effect on reception",
        immediate,
    ),
    CIA_301.row(
        "rpdo-too-short",
        "7.5.2.36",
        ("RPDO length", &[0x1602]),
        "a frame with too few bytes is not processed, and is EMCY 8210",
        too_few_bytes,
    ),
    CIA_301.row(
        "rpdo-too-long",
        "7.5.2.36",
        ("RPDO length", &[0x1602]),
        "of a frame with too many bytes the first are processed",
        too_many_bytes,
    ),
    CIA_301.row(
        "rpdo-deadline",
        "7.5.2.35",
        ("Event timer of an RPDO", &[0x1402]),
        "an RPDO that stays away after its first is EMCY 8250",
        deadline,
    ),
    CIA_301.row(
        "rpdo-deadline-first",
        "7.5.2.35",
        ("Event timer of an RPDO", &[0x1402]),
        "does not run before the first reception",
        deadline_waits,
    ),
    CIA_301.row(
        "rpdo-deadline-configured",
        "7.5.2.35",
        ("Event timer of an RPDO", &[0x1402]),
        "starts with the next reception after it is configured",
        deadline_configured,
    ),
    CIA_301.row(
        "rpdo-deadlines",
        "7.5.2.35",
        ("Event timer of an RPDO", &[0x1402, 0x1403]),
        "each RPDO has its own deadline and its own error",
        own_deadlines,
    ),
    CIA_301.row(
        "pdo-undisturbed",
        "7.5.2.35",
        ("Communication parameters", &[0x1403]),
        "a write to one PDO in operational disturbs no other PDO",
        undisturbed,
    ),
];

fn event_driven(rig: &mut Rig) -> Verdict {
    for kind in [254, 255] {
        rig.nmt(0x80);
        rig.write(0x6040, 0, 0, 2)?;
        tpdo(1).destroy(rig)?;
        tpdo(1).set_type(rig, kind)?;
        tpdo(1).create(rig)?;
        rig.nmt(0x01);
        rig.pass(50);
        let mark = rig.mark();
        rig.pass(300);
        let idle = tpdo(1).sent(rig, mark);
        ensure!(idle.is_empty(), "type {kind}: {} TPDOs without an event", idle.len());
        let mark = rig.mark();
        rig.write(0x6040, 0, 0x06, 2)?;
        rig.pass(50);
        let sent = tpdo(1).sent(rig, mark);
        let word = rig.upload(0x6041, 0)?;
        ensure!(
            sent.last() == Some(&word) && sent.len() == 1,
            "type {kind}: {sent:02X?}, the statusword is {word:02X?}"
        );
    }
    Ok(())
}

/// Milliseconds between frames of a TPDO.
fn gaps(rig: &Rig, mark: Mark, pdo: Pdo) -> Vec<f64> {
    let heard = rig.heard(mark, pdo.id);
    heard.windows(2).map(|pair| pair[1].at.since(pair[0].at).as_secs_f64() * 1e3).collect()
}

/// Configures TPDO2, which carries statusword and mode, with its timers.
fn timed(rig: &mut Rig, kind: i64, inhibit: i64, event_timer: i64) -> Verdict {
    rig.nmt(0x80);
    tpdo(2).destroy(rig)?;
    tpdo(2).set_type(rig, kind)?;
    rig.write(0x1801, 3, inhibit, 2)?;
    rig.write(0x1801, 5, event_timer, 2)?;
    tpdo(2).create(rig)?;
    rig.nmt(0x01);
    rig.pass(10);
    Ok(())
}

fn event_timer(rig: &mut Rig) -> Verdict {
    for millis in [5, 20, 70] {
        timed(rig, 255, 0, millis)?;
        let mark = rig.mark();
        rig.pass(500);
        let gaps = gaps(rig, mark, tpdo(2));
        ensure!(
            gaps.len() >= 5 && gaps.iter().all(|gap| (gap - millis as f64).abs() <= 1.0),
            "{gaps:.1?} ms apart, expected {millis}"
        );
    }
    Ok(())
}

fn event_timer_off(rig: &mut Rig) -> Verdict {
    timed(rig, 255, 0, 10)?;
    rig.write(0x1801, 5, 0, 2)?;
    rig.pass(20);
    let mark = rig.mark();
    rig.pass(200);
    let sent = tpdo(2).sent(rig, mark);
    ensure!(sent.is_empty(), "{} TPDOs with event timer 0", sent.len());
    Ok(())
}

fn inhibit(rig: &mut Rig) -> Verdict {
    // 40 ms, while the statusword changes every 10 ms.
    timed(rig, 255, 400, 0)?;
    let mark = rig.mark();
    for round in 0..20 {
        rig.write(0x6040, 0, if round % 2 == 0 { 0x06 } else { 0x00 }, 2)?;
        rig.pass(10);
    }
    rig.write(0x6040, 0, 0x06, 2)?;
    rig.pass(100);
    let gaps = gaps(rig, mark, tpdo(2));
    ensure!(gaps.len() >= 3 && gaps.iter().all(|&gap| gap >= 39.9), "{gaps:.1?} ms apart at an inhibit time of 40 ms");
    let last = tpdo(2).sent(rig, mark).pop().unwrap_or_default();
    let word = rig.upload(0x6041, 0)?;
    ensure!(last.starts_with(&word), "{last:02X?} sent last, the statusword is {word:02X?}");
    Ok(())
}

fn inhibit_over_timer(rig: &mut Rig) -> Verdict {
    timed(rig, 255, 500, 10)?;
    let mark = rig.mark();
    rig.pass(600);
    let gaps = gaps(rig, mark, tpdo(2));
    ensure!(gaps.len() >= 5 && gaps.iter().all(|&gap| gap >= 49.9), "{gaps:.1?} ms apart at an inhibit time of 50 ms");
    Ok(())
}

fn inhibit_and_sync(rig: &mut Rig) -> Verdict {
    timed(rig, 1, 1000, 0)?;
    let mark = rig.mark();
    for _ in 0..10 {
        rig.send(0x080, &[]);
        rig.pass(5);
    }
    let sent = tpdo(2).sent(rig, mark).len();
    ensure!(sent == 10, "{sent} TPDOs after 10 SYNCs");
    Ok(())
}

fn immediate(rig: &mut Rig) -> Verdict {
    for kind in [254, 255] {
        rpdo(1).destroy(rig)?;
        rpdo(1).set_type(rig, kind)?;
        rpdo(1).create(rig)?;
        rig.nmt(0x01);
        ensure!(reacts(rig, RPDO[0])?, "type {kind}: no effect");
    }
    Ok(())
}

/// EMCY codes since `mark`.
fn codes(rig: &Rig, mark: Mark) -> Vec<u16> {
    rig.heard(mark, EMCY).iter().map(|heard| u16::from_le_bytes([heard.data[0], heard.data[1]])).collect()
}

fn too_few_bytes(rig: &mut Rig) -> Verdict {
    rig.write(0x6007, 0, 0, 2)?;
    rig.write(0x1029, 1, 1, 1)?;
    rpdo(3).create(rig)?;
    rig.nmt(0x01);
    rig.write(0x607A, 0, 5, 4)?;
    let mark = rig.mark();
    rig.send(RPDO[2], &[0x06, 0x00, 0x11, 0x22, 0x33]);
    rig.pass(10);
    ensure!(codes(rig, mark) == [0x8210], "EMCY {:04X?}", codes(rig, mark));
    rig.expect(0x607A, 0, 5)?;
    let word = rig.read(0x6041, 0)?;
    ensure!(word & 0x6F != 0x21, "the controlword of a short RPDO was processed");
    Ok(())
}

fn too_many_bytes(rig: &mut Rig) -> Verdict {
    rpdo(3).create(rig)?;
    rig.nmt(0x01);
    rig.send(RPDO[2], &[0x06, 0x00, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66]);
    rig.pass(10);
    rig.expect(0x607A, 0, 0x4433_2211)
}

/// Configures RPDO3 and RPDO4 with deadlines, in a drive that takes no other action.
fn with_deadlines(rig: &mut Rig, third: i64, fourth: i64) -> Verdict {
    rig.write(0x6007, 0, 0, 2)?;
    rig.write(0x1029, 1, 1, 1)?;
    rig.write(0x1402, 5, third, 2)?;
    rig.write(0x1403, 5, fourth, 2)?;
    rpdo(3).create(rig)?;
    rpdo(4).create(rig)?;
    rig.nmt(0x01);
    Ok(())
}

const COMMAND: [u8; 6] = [0; 6];

fn deadline(rig: &mut Rig) -> Verdict {
    with_deadlines(rig, 30, 0)?;
    let mark = rig.mark();
    for _ in 0..5 {
        rig.send(RPDO[2], &COMMAND);
        rig.pass(25);
    }
    ensure!(codes(rig, mark).is_empty(), "EMCY {:04X?} while the RPDO comes in time", codes(rig, mark));
    rig.pass(40);
    ensure!(codes(rig, mark) == [0x8250], "EMCY {:04X?}", codes(rig, mark));
    Ok(())
}

fn deadline_waits(rig: &mut Rig) -> Verdict {
    with_deadlines(rig, 30, 30)?;
    let mark = rig.mark();
    rig.pass(300);
    ensure!(codes(rig, mark).is_empty(), "EMCY {:04X?}", codes(rig, mark));
    Ok(())
}

fn deadline_configured(rig: &mut Rig) -> Verdict {
    with_deadlines(rig, 0, 0)?;
    rig.send(RPDO[2], &COMMAND);
    rig.pass(100);
    let mark = rig.mark();
    rig.write(0x1402, 5, 30, 2)?;
    rig.pass(100);
    ensure!(codes(rig, mark).is_empty(), "EMCY {:04X?} for an RPDO of before", codes(rig, mark));
    rig.send(RPDO[2], &COMMAND);
    rig.pass(40);
    ensure!(codes(rig, mark) == [0x8250], "EMCY {:04X?} after the next reception", codes(rig, mark));
    Ok(())
}

fn own_deadlines(rig: &mut Rig) -> Verdict {
    with_deadlines(rig, 30, 60)?;
    let mark = rig.mark();
    rig.send(RPDO[2], &COMMAND);
    rig.send(RPDO[3], &COMMAND);
    rig.pass(45);
    ensure!(codes(rig, mark) == [0x8250], "EMCY {:04X?} after the first deadline", codes(rig, mark));
    rig.pass(40);
    ensure!(codes(rig, mark) == [0x8250, 0x8250], "EMCY {:04X?} after both deadlines", codes(rig, mark));
    // RPDO3 is received again; RPDO4 is still missing.
    rig.send(RPDO[2], &COMMAND);
    rig.pass(5);
    ensure!(rig.read(0x1001, 0)? & 0x10 != 0, "the error of RPDO4 ended with RPDO3");
    rig.send(RPDO[2], &COMMAND);
    rig.send(RPDO[3], &COMMAND);
    rig.pass(5);
    rig.expect(0x1001, 0, 0)
}

fn undisturbed(rig: &mut Rig) -> Verdict {
    // RPDO3 holds data for the next SYNC, TPDO3 counts SYNCs, TPDO2 runs its timer, and the type of RPDO4 is written.
    rpdo(3).destroy(rig)?;
    rpdo(3).set_type(rig, 1)?;
    rpdo(3).create(rig)?;
    tpdo(3).destroy(rig)?;
    tpdo(3).set_type(rig, 3)?;
    tpdo(3).create(rig)?;
    timed(rig, 255, 0, 20)?;
    let mark = rig.mark();
    for _ in 0..2 {
        rig.send(0x080, &[]);
        rig.pass(3);
    }
    rig.send(RPDO[2], &[0, 0, 0x11, 0, 0, 0]);
    rig.pass(1);
    rig.write(0x1403, 2, 1, 1)?;
    rig.send(0x080, &[]);
    rig.pass(3);
    let count = tpdo(3).sent(rig, mark).len();
    ensure!(count == 1, "{count} TPDO3 of type 3 after 3 SYNCs");
    rig.expect(0x607A, 0, 0x11)?;
    for round in 0..40 {
        rig.write(0x1403, 2, 1 + round % 2, 1)?;
        rig.pass(5);
    }
    let gaps = gaps(rig, mark, tpdo(2));
    ensure!(
        gaps.len() >= 8 && gaps.iter().all(|gap| (gap - 20.0).abs() <= 1.0),
        "TPDO2 {gaps:.1?} ms apart, expected 20"
    );
    Ok(())
}
