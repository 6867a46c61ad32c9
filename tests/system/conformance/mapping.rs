//! Claims about PDO mapping: what can be mapped, the re-mapping procedure, and the order of the bytes.

use canopen::eds::Access;

use super::objects::sheet;
use super::pdo::{Pdo, SECOND, rpdo, tpdo};
use super::rig::{Rig, TPDO, Verdict, ensure, hex};
use super::{CIA_301, CIA_402_3, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "map-data-sheet",
        "7.5.2.38",
        ("Every entry of the data sheet", &[]),
        "is mappable into TPDOs and RPDOs exactly where the data sheet says so",
        as_the_data_sheet_says,
    ),
    CIA_301.row(
        "map-eight",
        "7.5.2.38",
        ("TPDO mapping", &[0x1A00]),
        "eight objects of 8 bits fill a frame",
        map_eight,
    ),
    CIA_402_3.row(
        "pdo-default-mapping",
        "",
        ("PDO mapping", &[0x1600, 0x1601, 0x1602, 0x1603, 0x1A00, 0x1A01, 0x1A02, 0x1A03]),
        "the generic mapping of drives: words, modes, positions, velocities",
        default_mapping,
    ),
    CIA_301.row(
        "map-tpdo",
        "7.5.2.38",
        ("TPDO mapping", &[0x1A00, 0x1A01, 0x1A02, 0x1A03]),
        "after the re-mapping procedure a frame carries the objects in order, little-endian",
        map_tpdo,
    ),
    CIA_301.row(
        "map-rpdo",
        "7.5.2.36",
        ("RPDO mapping", &[0x1600, 0x1601, 0x1602, 0x1603]),
        "after the re-mapping procedure a frame is written to the objects in order",
        map_rpdo,
    ),
    CIA_301.row(
        "map-dummy",
        "7.5.2.36",
        ("RPDO mapping", &[0x1601]),
        "dummy entries 0x0002 to 0x0007 skip bytes of the frame",
        dummies,
    ),
    CIA_301.row(
        "map-valid-pdo",
        "7.5.2.38",
        ("PDO mapping", &[0x1600, 0x1A00]),
        "the mapping of a valid PDO cannot be changed",
        map_valid,
    ),
    CIA_301.row(
        "map-count-first",
        "7.5.2.38",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "entries cannot be changed while sub-index 0 is not 0",
        count_first,
    ),
    CIA_301.row(
        "map-no-object",
        "7.5.2.38",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "an absent object is refused with 06020000 or 06040041",
        map_no_object,
    ),
    CIA_301.row(
        "map-unmappable",
        "7.5.2.38",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "an object that is not mappable is refused with 06040041",
        unmappable,
    ),
    CIA_301.row(
        "map-direction",
        "7.5.2.36",
        ("PDO mapping", &[0x1601]),
        "a read-only object cannot be mapped into an RPDO",
        direction,
    ),
    CIA_301.row(
        "map-width",
        "7.5.2.38",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "a width that is not the object's is refused",
        width,
    ),
    CIA_301.row(
        "map-too-long",
        "7.5.2.38",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "more than 64 bits are refused with 06040042",
        too_long,
    ),
    CIA_301.row(
        "pdo-count-too-high",
        "7.5.2.38",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "a count above the mapped entries is refused",
        count_too_high,
    ),
    CIA_301.row(
        "map-reset",
        "7.3.2.2.1",
        ("PDO mapping", &[0x1601, 0x1A01]),
        "a reset of the communication brings the default mapping back",
        mapping_reset,
    ),
];

fn default_mapping(rig: &mut Rig) -> Verdict {
    let received: [&[u32]; 4] =
        [&[0x6040_0010], &[0x6040_0010, 0x6060_0008], &[0x6040_0010, 0x607A_0020], &[0x6040_0010, 0x60FF_0020]];
    let sent: [&[u32]; 4] =
        [&[0x6041_0010], &[0x6041_0010, 0x6061_0008], &[0x6041_0010, 0x6064_0020], &[0x6041_0010, 0x606C_0020]];
    for number in 1..=4_u16 {
        let at = usize::from(number) - 1;
        for (pdo, entries) in [(rpdo(number), received[at]), (tpdo(number), sent[at])] {
            rig.expect(pdo.mapping, 0, entries.len() as u32)?;
            for (subindex, &entry) in (1..).zip(entries) {
                rig.expect(pdo.mapping, subindex, entry)?;
            }
        }
    }
    Ok(())
}

fn map_tpdo(rig: &mut Rig) -> Verdict {
    rig.write(0x6081, 0, 0, 4)?;
    for number in 1..=4 {
        let pdo = tpdo(number);
        pdo.destroy(rig)?;
        pdo.set_type(rig, 1)?;
        // Position, modes, statusword, error register: 4 + 1 + 2 + 1 bytes.
        pdo.map(rig, &[0x6064_0020, 0x6061_0008, 0x6041_0010, 0x1001_0008])?;
        rig.nmt(0x01);
        let mark = rig.mark();
        rig.send(0x080, &[]);
        rig.pass(5);
        let mut expected = rig.upload(0x6064, 0)?;
        for (index, subindex) in [(0x6061, 0), (0x6041, 0), (0x1001, 0)] {
            expected.extend(rig.upload(index, subindex)?);
        }
        let sent = pdo.sent(rig, mark);
        ensure!(sent == [expected.clone()], "{sent:02X?}, expected {expected:02X?}");
        rig.nmt(0x80);
    }
    Ok(())
}

fn map_rpdo(rig: &mut Rig) -> Verdict {
    for number in 1..=4 {
        let pdo = rpdo(number);
        pdo.map(rig, &[0x6071_0010, 0x60FF_0020, 0x6060_0008])?;
        rig.nmt(0x01);
        let mode = if number % 2 == 0 { 3 } else { 8 };
        rig.send(pdo.id, &[0x10 + number as u8, 0x00, 0x78, 0x56, 0x34, 0x12, mode]);
        rig.pass(5);
        rig.expect(0x6071, 0, 0x10 + u32::from(number))?;
        rig.expect(0x60FF, 0, 0x1234_5678)?;
        rig.expect(0x6060, 0, u32::from(mode))?;
        rig.nmt(0x80);
        pdo.destroy(rig)?;
    }
    Ok(())
}

fn dummies(rig: &mut Rig) -> Verdict {
    let pdo = rpdo(2);
    // 8, 16 and 8 bits without an object, then a target velocity.
    pdo.map(rig, &[0x0005_0008, 0x0006_0010, 0x0002_0008, 0x60FF_0020])?;
    rig.nmt(0x01);
    rig.send(pdo.id, &[0xAA, 0xBB, 0xCC, 0xDD, 0x78, 0x56, 0x34, 0x12]);
    rig.pass(5);
    rig.expect(0x60FF, 0, 0x1234_5678)?;
    for entry in [0x0003_0010, 0x0004_0020, 0x0007_0020] {
        rig.nmt(0x80);
        pdo.map(rig, &[entry, 0x6071_0010])?;
        rig.nmt(0x01);
        let skipped = (entry & 0xFF) / 8;
        let mut frame = vec![0xFF; skipped as usize];
        frame.extend([0x10 + skipped as u8, 0x00]);
        rig.send(pdo.id, &frame);
        rig.pass(5);
        rig.expect(0x6071, 0, 0x10 + skipped)?;
    }
    Ok(())
}

fn map_valid(rig: &mut Rig) -> Verdict {
    for pdo in [rpdo(1), tpdo(1)] {
        rig.refuse((pdo.mapping, 0), 0, 1, &[])?;
        rig.refuse((pdo.mapping, 1), 0x6060_0008, 4, &[])?;
        rig.expect(pdo.mapping, 0, 1)?;
    }
    Ok(())
}

fn count_first(rig: &mut Rig) -> Verdict {
    for pdo in SECOND.map(|kind| kind(2)) {
        let before = rig.read(pdo.mapping, 1)?;
        rig.refuse((pdo.mapping, 1), 0x6060_0008, 4, &[])?;
        rig.expect(pdo.mapping, 1, before)?;
    }
    Ok(())
}

/// Expects that entries are refused with one of these codes, at the latest when the count is written.
fn refuse_entries(rig: &mut Rig, kinds: &[fn(u16) -> Pdo], entries: &[u32], codes: &[u32]) -> Verdict {
    for pdo in kinds.iter().map(|kind| kind(2)) {
        pdo.open(rig)?;
        for &entry in entries {
            rig.refuse((pdo.mapping, 1), i64::from(entry), 4, codes)?;
        }
    }
    Ok(())
}

fn map_no_object(rig: &mut Rig) -> Verdict {
    refuse_entries(
        rig,
        &SECOND,
        &[0x2001_0010, 0x6042_0010, 0x6041_0110, 0xFFFF_FF20],
        &[0x0602_0000, 0x0604_0041, 0x0609_0011],
    )
}

fn unmappable(rig: &mut Rig) -> Verdict {
    refuse_entries(rig, &SECOND, &[0x1017_0010, 0x1018_0120, 0x6502_0020, 0x605A_0010, 0x1A00_0008], &[0x0604_0041])
}

fn direction(rig: &mut Rig) -> Verdict {
    refuse_entries(rig, &[rpdo], &[0x6041_0010, 0x6064_0020, 0x6061_0008, 0x1001_0008], &[0x0604_0041, 0x0601_0002])
}

fn width(rig: &mut Rig) -> Verdict {
    for (kind, object, right) in
        [(SECOND[0], 0x6040, 16), (SECOND[0], 0x607A, 32), (SECOND[1], 0x6041, 16), (SECOND[1], 0x6064, 32)]
    {
        let pdo = kind(2);
        pdo.open(rig)?;
        for bits in [0, 8, 15, 16, 24, 32, 64].into_iter().filter(|&bits| bits != right) {
            rig.refuse(
                (pdo.mapping, 1),
                object << 16 | bits,
                4,
                &[0x0604_0041, 0x0604_0042, 0x0607_0010, 0x0609_0030],
            )?;
        }
    }
    Ok(())
}

fn too_long(rig: &mut Rig) -> Verdict {
    for (pdo, long) in [(rpdo(2), 0x607A_0020_u32), (tpdo(2), 0x6064_0020)] {
        pdo.open(rig)?;
        let short = if pdo.mapping < 0x1A00 { 0x6040_0010 } else { 0x6041_0010 };
        let mut refused = false;
        for (subindex, entry) in (1..).zip([long, short, long]) {
            let answer = rig.download(pdo.mapping, subindex, i64::from(entry), 4)?;
            if answer[0] == 0x80 {
                ensure!(subindex == 3 && answer[4..] == [0x42, 0x00, 0x04, 0x06], "{}", hex(&answer));
                refused = true;
            }
        }
        if !refused {
            rig.refuse((pdo.mapping, 0), 3, 1, &[0x0604_0042])?;
        }
        rig.expect(pdo.mapping, 0, 0)?;
        // The first two entries fit.
        rig.write(pdo.mapping, 0, 2, 1)?;
    }
    Ok(())
}

fn count_too_high(rig: &mut Rig) -> Verdict {
    for pdo in SECOND.map(|kind| kind(2)) {
        pdo.open(rig)?;
        // Entries 3 to 8 map nothing.
        rig.refuse((pdo.mapping, 0), 3, 1, &[0x0602_0000, 0x0604_0041, 0x0604_0042, 0x0609_0030])?;
        for count in [9, 64, 65, 255] {
            rig.refuse((pdo.mapping, 0), count, 1, &[0x0604_0042, 0x0609_0030, 0x0609_0031])?;
        }
        rig.expect(pdo.mapping, 0, 0)?;
    }
    Ok(())
}

fn mapping_reset(rig: &mut Rig) -> Verdict {
    tpdo(2).map(rig, &[0x6064_0020])?;
    rpdo(2).map(rig, &[0x607A_0020])?;
    rig.reset(0x82);
    rig.expect(0x1A01, 0, 2)?;
    rig.expect(0x1A01, 1, 0x6041_0010)?;
    rig.expect(0x1601, 1, 0x6040_0010)?;
    rig.expect(0x1801, 1, 0xC000_0000 | u32::from(TPDO[1]))
}

fn as_the_data_sheet_says(rig: &mut Rig) -> Verdict {
    let (received, sent) = (rpdo(2), tpdo(2));
    received.open(rig)?;
    sent.open(rig)?;
    let mut mappable = 0;
    for (object, variable) in sheet().variables() {
        let Some(bytes) = variable.data_type.size() else {
            continue;
        };
        let entry = i64::from(object.index) << 16 | i64::from(object.subindex) << 8;
        let entry = entry | (8 * bytes as i64);
        let writable = matches!(variable.access, Access::ReadWrite | Access::ReadWriteOutput | Access::WriteOnly);
        let readable = !matches!(variable.access, Access::ReadWriteOutput | Access::WriteOnly);
        for (pdo, direction) in [(received, writable), (sent, readable)] {
            let answer = rig.download(pdo.mapping, 1, entry, 4)?;
            let expected = variable.pdo_mapping && direction;
            ensure!(
                (answer[0] == 0x60) == expected,
                "{entry:#010x} into {:#06x}: {}, mappable by the data sheet: {expected}",
                pdo.mapping,
                hex(&answer)
            );
            mappable += u32::from(expected);
        }
    }
    ensure!(mappable >= 30, "{mappable} mappable entries");
    Ok(())
}

fn map_eight(rig: &mut Rig) -> Verdict {
    let pdo = tpdo(1);
    pdo.destroy(rig)?;
    pdo.set_type(rig, 1)?;
    pdo.map(rig, &[0x6061_0008; 8])?;
    rig.write(0x6060, 0, 3, 1)?;
    rig.nmt(0x01);
    let mark = rig.mark();
    rig.send(0x080, &[]);
    rig.pass(5);
    let sent = pdo.sent(rig, mark);
    ensure!(sent == [[3; 8]], "{sent:02X?}");
    Ok(())
}
