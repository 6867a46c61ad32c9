//! Claims about SYNC: transmission times of synchronous PDOs, and the time at which received data take effect.

use super::rig::{Deviation, Mark, RPDO, Rig, TPDO, Verdict, ensure, hex};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "sync-every",
        "7.5.2.37",
        ("TPDO of type 1", &[0x1005, 0x1801]),
        "is sent once after every SYNC, and without SYNC never",
        every,
    ),
    CIA_301.row(
        "sync-every-nth",
        "7.5.2.37",
        ("TPDO of types 2 to 240", &[0x1801]),
        "is sent after every n-th SYNC",
        every_nth,
    ),
    CIA_301.row(
        "sync-acyclic",
        "7.5.2.37",
        ("TPDO of type 0", &[0x1801]),
        "is sent after the SYNC that follows an event, and only then",
        acyclic,
    ),
    CIA_301.row(
        "sync-no-event",
        "7.5.2.37",
        ("TPDO of type 1", &[0x1801]),
        "an event or its event timer sends no synchronous TPDO",
        no_event,
    ),
    CIA_301.row(
        "sync-rpdo-waits",
        "7.2.2.2",
        ("RPDO of types 0 to 240", &[0x1400]),
        "takes effect with the SYNC after its reception, whatever its type",
        rpdo_waits,
    ),
    CIA_301.row(
        "sync-rpdo-latest",
        "7.2.2.2",
        ("RPDO of type 1", &[0x1402]),
        "of two received before a SYNC the later one takes effect",
        rpdo_latest,
    ),
    CIA_301.row(
        "sync-rpdo-once",
        "7.2.2.2",
        ("RPDO of type 1", &[0x1402]),
        "data take effect once: a later SYNC does not write them again",
        rpdo_once,
    ),
    CIA_301.row(
        "sync-rpdo-forgotten",
        "7.3.2.2.3",
        ("RPDO of type 1", &[0x1402]),
        "data that wait for a SYNC are gone when the drive leaves operational",
        rpdo_forgotten,
    ),
    CIA_301.row(
        "sync-all-tpdos",
        "7.2.5",
        ("SYNC", &[0x1800, 0x1801, 0x1802, 0x1803]),
        "one SYNC triggers all four TPDOs",
        all_tpdos,
    ),
    CIA_301.row(
        "sync-other-frames",
        "7.2.5",
        ("SYNC", &[0x1005]),
        "a remote frame and a 29-bit identifier 0x80 are no SYNC",
        other_frames,
    ),
    CIA_301.row(
        "sync-reserved-tpdo-types",
        "7.5.2.37",
        ("Transmission type", &[0x1800, 0x1801, 0x1802, 0x1803]),
        "types 241 to 251 are refused with 06090030",
        reserved_tpdo_types,
    ),
    CIA_301.row(
        "sync-rtr-types",
        "7.5.2.37",
        ("Transmission type", &[0x1801]),
        "types 252 and 253 are refused with 06090030, or answer remote frames",
        rtr_types,
    ),
    CIA_301.row(
        "sync-reserved-rpdo-types",
        "7.5.2.35",
        ("Transmission type", &[0x1400, 0x1401, 0x1402, 0x1403]),
        "types 241 to 253 are refused with 06090030",
        reserved_rpdo_types,
    ),
    CIA_301.row(
        "sync-types",
        "7.5.2.37",
        ("Transmission type", &[0x1401, 0x1801]),
        "types 0, 1, 240, 254 and 255 are taken and read back",
        types,
    ),
];

/// Enables TPDO `number` (from 1) with a transmission type.
fn transmit(rig: &mut Rig, number: usize, kind: i64) -> Verdict {
    let index = 0x1800 + number as u16 - 1;
    let id = i64::from(TPDO[number - 1]);
    rig.write(index, 1, 0xC000_0000 | id, 4)?;
    rig.write(index, 2, kind, 1)?;
    rig.write(index, 3, 0, 2)?;
    rig.write(index, 1, 0x4000_0000 | id, 4)
}

/// Enables RPDO `number` (from 1) with a transmission type.
fn receive(rig: &mut Rig, number: usize, kind: i64) -> Verdict {
    let index = 0x1400 + number as u16 - 1;
    let id = i64::from(RPDO[number - 1]);
    rig.write(index, 1, 0x8000_0000 | id, 4)?;
    rig.write(index, 2, kind, 1)?;
    rig.write(index, 1, id, 4)
}

fn sync(rig: &mut Rig) {
    rig.send(0x080, &[]);
    rig.pass(4);
}

fn sent(rig: &Rig, mark: Mark, number: usize) -> usize {
    rig.heard(mark, TPDO[number - 1]).len()
}

fn every(rig: &mut Rig) -> Verdict {
    transmit(rig, 2, 1)?;
    rig.nmt(0x01);
    let mark = rig.mark();
    rig.pass(100);
    ensure!(sent(rig, mark, 2) == 0, "a TPDO without SYNC");
    for round in 1..=20 {
        sync(rig);
        let count = sent(rig, mark, 2);
        ensure!(count == round, "{count} TPDOs after {round} SYNCs");
    }
    Ok(())
}

fn every_nth(rig: &mut Rig) -> Verdict {
    for n in [2, 3, 7, 240] {
        rig.nmt(0x80);
        transmit(rig, 2, n)?;
        rig.nmt(0x01);
        let mut at = Vec::new();
        for round in 1..=3 * n {
            let mark = rig.mark();
            sync(rig);
            if sent(rig, mark, 2) > 0 {
                at.push(round);
            }
        }
        let spaced = at.windows(2).all(|pair| pair[1] - pair[0] == n);
        ensure!(spaced && at.len() == 3, "type {n}: sent after SYNC number {at:?}");
    }
    Ok(())
}

/// Causes an event for TPDOs that map the statusword.
fn event(rig: &mut Rig, word: i64) -> Verdict {
    rig.write(0x6040, 0, word, 2)
}

fn acyclic(rig: &mut Rig) -> Verdict {
    transmit(rig, 2, 0)?;
    rig.nmt(0x01);
    // Whether entering operational is an event depends on the device.
    sync(rig);
    sync(rig);
    for word in [0x06, 0x07, 0x06] {
        let mark = rig.mark();
        event(rig, word)?;
        rig.pass(10);
        ensure!(sent(rig, mark, 2) == 0, "sent before the SYNC");
        sync(rig);
        ensure!(sent(rig, mark, 2) == 1, "{} sent after event and SYNC", sent(rig, mark, 2));
        sync(rig);
        sync(rig);
        ensure!(sent(rig, mark, 2) == 1, "{} sent after SYNCs without an event", sent(rig, mark, 2));
    }
    Ok(())
}

fn no_event(rig: &mut Rig) -> Verdict {
    transmit(rig, 2, 1)?;
    rig.write(0x1801, 5, 10, 2)?;
    rig.nmt(0x01);
    let mark = rig.mark();
    event(rig, 0x06)?;
    rig.pass(100);
    ensure!(sent(rig, mark, 2) == 0, "{} sent without SYNC", sent(rig, mark, 2));
    Ok(())
}

fn state(rig: &mut Rig) -> Result<u32, Deviation> {
    Ok(rig.read(0x6041, 0)? & 0x6F)
}

fn rpdo_waits(rig: &mut Rig) -> Verdict {
    for kind in [0, 1, 2, 240] {
        rig.nmt(0x80);
        rig.write(0x6040, 0, 0x00, 2)?;
        receive(rig, 1, kind)?;
        rig.nmt(0x01);
        rig.send(RPDO[0], &[0x06, 0x00]);
        rig.pass(20);
        ensure!(state(rig)? & 0x4F == 0x40, "type {kind}: effect before the SYNC");
        sync(rig);
        ensure!(state(rig)? == 0x21, "type {kind}: no effect after the SYNC");
    }
    Ok(())
}

/// Sends controlword and target position by RPDO3.
fn target(rig: &mut Rig, position: i32) {
    let [a, b, c, d] = position.to_le_bytes();
    rig.send(RPDO[2], &[0x00, 0x00, a, b, c, d]);
    rig.pass(2);
}

fn rpdo_latest(rig: &mut Rig) -> Verdict {
    receive(rig, 3, 1)?;
    rig.nmt(0x01);
    target(rig, 111);
    target(rig, 222);
    rig.expect(0x607A, 0, 0)?;
    sync(rig);
    rig.expect(0x607A, 0, 222)
}

fn rpdo_once(rig: &mut Rig) -> Verdict {
    receive(rig, 3, 1)?;
    rig.nmt(0x01);
    target(rig, 111);
    sync(rig);
    rig.expect(0x607A, 0, 111)?;
    rig.write(0x607A, 0, 5, 4)?;
    sync(rig);
    rig.expect(0x607A, 0, 5)
}

fn rpdo_forgotten(rig: &mut Rig) -> Verdict {
    receive(rig, 3, 1)?;
    rig.nmt(0x01);
    target(rig, 111);
    rig.nmt(0x80);
    sync(rig);
    rig.nmt(0x01);
    sync(rig);
    rig.expect(0x607A, 0, 0)
}

fn all_tpdos(rig: &mut Rig) -> Verdict {
    for number in 1..=4 {
        transmit(rig, number, 1)?;
    }
    rig.nmt(0x01);
    rig.pass(10);
    for _ in 0..5 {
        let mark = rig.mark();
        sync(rig);
        let counts = [1, 2, 3, 4].map(|number| sent(rig, mark, number));
        ensure!(counts == [1; 4], "{counts:?} TPDOs after one SYNC");
    }
    Ok(())
}

fn other_frames(rig: &mut Rig) -> Verdict {
    transmit(rig, 2, 1)?;
    rig.nmt(0x01);
    let mark = rig.mark();
    rig.send_remote(0x080, 0);
    rig.send_extended(0x080, &[]);
    rig.pass(10);
    ensure!(sent(rig, mark, 2) == 0, "{} sent", sent(rig, mark, 2));
    Ok(())
}

fn reserved_tpdo_types(rig: &mut Rig) -> Verdict {
    for index in 0x1800..=0x1803 {
        for kind in 241..=251 {
            rig.refuse((index, 2), kind, 1, &[0x0609_0030])?;
        }
        rig.expect(index, 2, 255)?;
    }
    Ok(())
}

fn rtr_types(rig: &mut Rig) -> Verdict {
    let id = i64::from(TPDO[1]);
    for kind in [252, 253] {
        rig.nmt(0x80);
        // Bit 30 clear: remote frames are allowed.
        rig.write(0x1801, 1, 0x8000_0000 | id, 4)?;
        let answer = rig.download(0x1801, 2, kind, 1)?;
        if answer[0] == 0x80 {
            ensure!(answer[4..] == [0x30, 0x00, 0x09, 0x06], "type {kind}: {}", hex(&answer));
            continue;
        }
        rig.write(0x1801, 1, id, 4)?;
        rig.nmt(0x01);
        sync(rig);
        let mark = rig.mark();
        rig.send_remote(TPDO[1], 3);
        rig.pass(5);
        ensure!(sent(rig, mark, 2) == 1, "type {kind}: {} answers to a remote frame", sent(rig, mark, 2));
    }
    Ok(())
}

fn reserved_rpdo_types(rig: &mut Rig) -> Verdict {
    for index in 0x1400..=0x1403 {
        for kind in 241..=253 {
            rig.refuse((index, 2), kind, 1, &[0x0609_0030])?;
        }
        rig.expect(index, 2, 255)?;
    }
    Ok(())
}

fn types(rig: &mut Rig) -> Verdict {
    for index in [0x1401, 0x1801] {
        for kind in [0, 1, 240, 254, 255] {
            rig.write(index, 2, kind, 1)?;
            rig.expect(index, 2, kind as u32)?;
        }
    }
    Ok(())
}
