//! Claims about storing parameters and restoring defaults.

use super::rig::{EMCY, Rig, Verdict, aborted, ensure, hex};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "store-capability",
        "7.5.2.13",
        ("Store parameters", &[0x1010]),
        "sub-index 1 reads 1: the drive saves on command, not by itself",
        store_capability,
    ),
    CIA_301.row(
        "store-save",
        "7.5.2.13",
        ("Store parameters", &[0x1010]),
        "values of both areas survive a reset of the node after the signature save",
        save,
    ),
    CIA_301.row(
        "store-unsaved",
        "7.5.2.13",
        ("Store parameters", &[0x1010]),
        "values that were not saved are gone after a reset of the node",
        unsaved,
    ),
    CIA_301.row(
        "store-later",
        "7.5.2.13",
        ("Store parameters", &[0x1010]),
        "a change after the save is not stored",
        changed_later,
    ),
    CIA_301.row(
        "store-wrong-signature",
        "7.5.2.13",
        ("Store parameters", &[0x1010]),
        "a wrong signature is refused with 0800002x and stores nothing",
        store_wrong,
    ),
    CIA_301.row(
        "store-communication",
        "7.3.2.2.1",
        ("Store parameters", &[0x1010]),
        "a reset of the communication brings stored communication parameters back",
        store_communication,
    ),
    CIA_301.row(
        "store-pdo",
        "7.5.2.13",
        ("Store parameters", &[0x1010, 0x1400, 0x1A01]),
        "stored COB-IDs and mappings work after a reset",
        store_pdo,
    ),
    CIA_301.row(
        "store-no-history",
        "7.5.2.13",
        ("Store parameters", &[0x1003, 0x1010]),
        "the history of errors is no parameter and is not stored",
        store_no_history,
    ),
    CIA_301.row(
        "restore-capability",
        "7.5.2.14",
        ("Restore default parameters", &[0x1011]),
        "sub-index 1 reads 1: the drive restores defaults",
        restore_capability,
    ),
    CIA_301.row(
        "restore-load",
        "7.5.2.14",
        ("Restore default parameters", &[0x1011]),
        "after the signature load a reset of the node brings the defaults, not the stored values",
        load,
    ),
    CIA_301.row(
        "restore-pending",
        "7.5.2.14",
        ("Restore default parameters", &[0x1011]),
        "before the reset the present values stay",
        load_waits,
    ),
    CIA_301.row(
        "restore-wrong-signature",
        "7.5.2.14",
        ("Restore default parameters", &[0x1011]),
        "a wrong signature is refused with 0800002x and restores nothing",
        load_wrong,
    ),
];

const SAVE: i64 = 0x6576_6173;

const LOAD: i64 = 0x6461_6F6C;

/// 0800 0020 to 0800 0022.
const REFUSALS: &[u32] = &[0x0800_0020, 0x0800_0021, 0x0800_0022];

/// A value of each area, and their defaults.
const HEARTBEAT_TIME: u32 = 1500;

const PROFILE_VELOCITY: u32 = 4321;

const DEFAULTS: (u32, u32) = (0, 1000);

fn change(rig: &mut Rig) -> Verdict {
    rig.write(0x1017, 0, i64::from(HEARTBEAT_TIME), 2)?;
    rig.write(0x6081, 0, i64::from(PROFILE_VELOCITY), 4)
}

fn expect(rig: &mut Rig, (heartbeat, velocity): (u32, u32)) -> Verdict {
    rig.expect(0x1017, 0, heartbeat)?;
    rig.expect(0x6081, 0, velocity)
}

fn store_capability(rig: &mut Rig) -> Verdict {
    rig.expect(0x1010, 1, 1)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    rig.expect(0x1010, 1, 1)
}

fn save(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    for _ in 0..2 {
        rig.reset(0x81);
        expect(rig, (HEARTBEAT_TIME, PROFILE_VELOCITY))?;
    }
    Ok(())
}

fn unsaved(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.reset(0x81);
    expect(rig, DEFAULTS)
}

fn changed_later(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    rig.write(0x1017, 0, 700, 2)?;
    rig.write(0x6081, 0, 700, 4)?;
    rig.reset(0x81);
    expect(rig, (HEARTBEAT_TIME, PROFILE_VELOCITY))
}

fn refuse_signatures(rig: &mut Rig, index: u16, right: i64) -> Verdict {
    // Byte order reversed, one bit wrong, the other signature, 0 and 1.
    let reversed = i64::from((right as u32).swap_bytes());
    for value in [reversed, right ^ 1, SAVE + LOAD - right, 0, 1] {
        let answer = rig.download(index, 1, value, 4)?;
        aborted(&answer, (index, 1), REFUSALS, &format!("signature {value:#010x}"))?;
    }
    Ok(())
}

fn store_wrong(rig: &mut Rig) -> Verdict {
    change(rig)?;
    refuse_signatures(rig, 0x1010, SAVE)?;
    rig.reset(0x81);
    expect(rig, DEFAULTS)
}

fn store_communication(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    rig.write(0x1017, 0, 700, 2)?;
    rig.write(0x6081, 0, 700, 4)?;
    rig.reset(0x82);
    expect(rig, (HEARTBEAT_TIME, 700))
}

fn store_pdo(rig: &mut Rig) -> Verdict {
    rig.write(0x1400, 1, 0x8000_0222, 4)?;
    rig.write(0x1400, 1, 0x0000_0222, 4)?;
    rig.write(0x1A01, 0, 0, 1)?;
    rig.write(0x1A01, 1, 0x6064_0020, 4)?;
    rig.write(0x1A01, 0, 1, 1)?;
    rig.write(0x1801, 2, 1, 1)?;
    rig.write(0x1801, 1, 0x4000_02A2, 4)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    rig.reset(0x81);
    rig.expect(0x1400, 1, 0x0000_0222)?;
    rig.nmt(0x01);
    let mark = rig.mark();
    rig.send(0x222, &[0x06, 0x00]);
    rig.send(0x080, &[]);
    rig.pass(10);
    let sent = rig.heard(mark, 0x2A2);
    ensure!(sent.len() == 1 && sent[0].data.len() == 4, "{sent:02X?}");
    let word = rig.read(0x6041, 0)?;
    ensure!(word & 0x6F == 0x21, "statusword {word:#06x} after the stored RPDO");
    Ok(())
}

fn store_no_history(rig: &mut Rig) -> Verdict {
    rig.write(0x6007, 0, 0, 2)?;
    rig.write(0x1029, 1, 1, 1)?;
    rig.write(0x1016, 1, 0x7E << 16 | 20, 4)?;
    let mark = rig.mark();
    rig.send(0x77E, &[0x05]);
    rig.pass(40);
    let sent = rig.heard(mark, EMCY);
    ensure!(sent.len() == 1, "{} EMCY", sent.len());
    rig.expect(0x1003, 0, 1)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    rig.send(0x77E, &[0x05]);
    rig.pass(5);
    rig.write(0x1003, 0, 0, 1)?;
    for command in [0x82, 0x81] {
        rig.reset(command);
        let count = rig.read(0x1003, 0)?;
        ensure!(count == 0, "{count} errors in the history after the reset {}", hex(&[command]));
    }
    Ok(())
}

fn restore_capability(rig: &mut Rig) -> Verdict {
    rig.expect(0x1011, 1, 1)?;
    rig.write(0x1011, 1, LOAD, 4)?;
    rig.expect(0x1011, 1, 1)
}

fn load(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    rig.write(0x1011, 1, LOAD, 4)?;
    for _ in 0..2 {
        rig.reset(0x81);
        expect(rig, DEFAULTS)?;
    }
    Ok(())
}

fn load_waits(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.write(0x1011, 1, LOAD, 4)?;
    expect(rig, (HEARTBEAT_TIME, PROFILE_VELOCITY))
}

fn load_wrong(rig: &mut Rig) -> Verdict {
    change(rig)?;
    rig.write(0x1010, 1, SAVE, 4)?;
    refuse_signatures(rig, 0x1011, LOAD)?;
    rig.reset(0x81);
    expect(rig, (HEARTBEAT_TIME, PROFILE_VELOCITY))
}
