//! Claims about EMCY: the frame, the error register and the history of errors.

use super::rig::{Deviation, EMCY, Mark, NODE, RPDO, Rig, Verdict, ensure, hex, request};
use super::{CIA_301, CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "emcy-frame",
        "7.2.7",
        ("EMCY", &[0x1014]),
        "0x80 + node-ID, 8 bytes: code, error register, five bytes of the manufacturer",
        frame,
    ),
    CIA_301.row("emcy-once", "7.2.7", ("EMCY", &[]), "is sent once for each error that occurs", once),
    CIA_301.row("emcy-reset", "7.2.7", ("EMCY", &[0x1001]), "code 0000 tells the end of the last error", reset),
    CIA_301.row(
        "emcy-register",
        "7.5.2.2",
        ("Error register", &[0x1001]),
        "bits 0 and 4 stand while an error of communication does",
        register,
    ),
    CIA_301.row(
        "emcy-remaining",
        "7.2.7",
        ("EMCY", &[0x1001]),
        "with one of two errors ended the register still shows the other",
        remaining,
    ),
    CIA_301.row(
        "emcy-history-empty",
        "7.5.2.4",
        ("Pre-defined error field", &[0x1003]),
        "without errors sub-index 0 is 0 and sub-index 1 is refused with 08000024 or 08000000",
        history_empty,
    ),
    CIA_301.row(
        "emcy-history",
        "7.5.2.4",
        ("Pre-defined error field", &[0x1003]),
        "the newest error stands in sub-index 1, its code in the lower word",
        history,
    ),
    CIA_301.row(
        "emcy-history-order",
        "7.5.2.4",
        ("Pre-defined error field", &[0x1003]),
        "older errors move up, and the oldest goes when the field is full",
        history_order,
    ),
    CIA_301.row(
        "emcy-history-clear",
        "7.5.2.4",
        ("Pre-defined error field", &[0x1003]),
        "0 written to sub-index 0 deletes the history",
        history_clear,
    ),
    CIA_301.row(
        "emcy-history-write",
        "7.5.2.4",
        ("Pre-defined error field", &[0x1003]),
        "other values are refused with 06090030 or 06090031, entries with 06010002",
        history_write,
    ),
    CIA_301.row(
        "emcy-history-stays",
        "7.5.2.4",
        ("Pre-defined error field", &[0x1003]),
        "the end of an error leaves its entry, and is no entry",
        history_stays,
    ),
    CIA_402_2.row(
        "emcy-error-code",
        "",
        ("Error code", &[0x603F]),
        "the code of the last error is that of the EMCY",
        error_code,
    ),
];

const PRODUCER: u8 = 0x7E;

/// Configures a drive that reports the loss of node 0x7E after 20 ms and takes no other action.
fn indifferent(rig: &mut Rig) -> Verdict {
    rig.write(0x6007, 0, 0, 2)?;
    rig.write(0x1029, 1, 1, 1)?;
    rig.write(0x1016, 1, i64::from(PRODUCER) << 16 | 20, 4)?;
    rig.nmt(0x01);
    Ok(())
}

fn beat(rig: &mut Rig) {
    rig.send(0x700 + u16::from(PRODUCER), &[0x05]);
    rig.pass(5);
}

/// Causes the loss of a heartbeat: code 8130.
fn lose(rig: &mut Rig) {
    beat(rig);
    rig.pass(40);
}

fn sent(rig: &Rig, mark: Mark) -> Vec<Vec<u8>> {
    rig.heard(mark, EMCY).into_iter().map(|heard| heard.data).collect()
}

fn frame(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    let mark = rig.mark();
    lose(rig);
    let register = rig.read(0x1001, 0)?;
    let sent = sent(rig, mark);
    let [frame] = &sent[..] else {
        return Err(Deviation(format!("{} EMCY", sent.len())));
    };
    ensure!(
        frame.len() == 8 && frame[..2] == [0x30, 0x81] && u32::from(frame[2]) == register,
        "{}, error register {register:#04x}",
        hex(frame)
    );
    rig.expect(0x1014, 0, 0x80 + u32::from(NODE))
}

fn once(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    let mark = rig.mark();
    lose(rig);
    rig.pass(2_000);
    ensure!(sent(rig, mark).len() == 1, "{} EMCY", sent(rig, mark).len());
    Ok(())
}

fn reset(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    lose(rig);
    let mark = rig.mark();
    beat(rig);
    let sent = sent(rig, mark);
    ensure!(sent.len() == 1 && sent[0][..3] == [0, 0, 0], "{sent:02X?}");
    rig.expect(0x1001, 0, 0)
}

fn register(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    rig.expect(0x1001, 0, 0)?;
    lose(rig);
    rig.expect(0x1001, 0, 0x11)?;
    beat(rig);
    rig.expect(0x1001, 0, 0)
}

fn remaining(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    rig.write(0x1402, 5, 20, 2)?;
    rig.write(0x1402, 1, i64::from(RPDO[2]), 4)?;
    // RPDO3 is sent only once: code 8250 in addition to 8130.
    rig.send(RPDO[2], &[0; 6]);
    lose(rig);
    let mark = rig.mark();
    beat(rig);
    rig.expect(0x1001, 0, 0x11)?;
    for frame in sent(rig, mark) {
        ensure!(frame[2] == 0x11, "{} while an error remains", hex(&frame));
    }
    Ok(())
}

fn expect_no_entry(rig: &mut Rig, subindex: u8) -> Verdict {
    let answer = rig.transfer(request(0x40, 0x1003, subindex, [0; 4]))?;
    let code = u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]]);
    ensure!(
        answer[0] == 0x80 && matches!(code, 0x0800_0024 | 0x0800_0000),
        "upload of 0x1003:{subindex:02x}: {}",
        hex(&answer)
    );
    Ok(())
}

fn expect_history(rig: &mut Rig, codes: &[u32]) -> Verdict {
    rig.expect(0x1003, 0, codes.len() as u32)?;
    for (subindex, &code) in (1..).zip(codes) {
        let entry = rig.read(0x1003, subindex)?;
        ensure!(entry & 0xFFFF == code, "0x1003:{subindex:02x} is {entry:#x}, expected {code:#x}");
    }
    for subindex in codes.len() as u8 + 1..=5 {
        expect_no_entry(rig, subindex)?;
    }
    Ok(())
}

fn history_empty(rig: &mut Rig) -> Verdict {
    expect_history(rig, &[])
}

fn history(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    lose(rig);
    expect_history(rig, &[0x8130])
}

/// Sends a short RPDO1: code 8210.
fn short_pdo(rig: &mut Rig) {
    rig.send(RPDO[0], &[0x00]);
    rig.pass(5);
}

fn history_order(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    lose(rig);
    short_pdo(rig);
    expect_history(rig, &[0x8210, 0x8130])?;
    rig.send(RPDO[0], &[0x00, 0x00]);
    for _ in 0..3 {
        lose(rig);
    }
    expect_history(rig, &[0x8130, 0x8130, 0x8130, 0x8210, 0x8130])?;
    lose(rig);
    lose(rig);
    expect_history(rig, &[0x8130, 0x8130, 0x8130, 0x8130, 0x8130])
}

fn history_clear(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    lose(rig);
    rig.write(0x1003, 0, 0, 1)?;
    expect_history(rig, &[])?;
    // The error itself remains.
    rig.expect(0x1001, 0, 0x11)
}

fn history_write(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    lose(rig);
    for value in [1, 2, 255] {
        rig.refuse((0x1003, 0), value, 1, &[0x0609_0030, 0x0609_0031])?;
    }
    rig.refuse((0x1003, 1), 0, 4, &[0x0601_0002])?;
    expect_history(rig, &[0x8130])
}

fn history_stays(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    lose(rig);
    beat(rig);
    expect_history(rig, &[0x8130])
}

fn error_code(rig: &mut Rig) -> Verdict {
    rig.expect(0x603F, 0, 0)?;
    indifferent(rig)?;
    lose(rig);
    rig.expect(0x603F, 0, 0x8130)
}
