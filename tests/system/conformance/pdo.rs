//! Claims about PDOs: COB-IDs, mapping, events, timers and lengths.

use super::rig::{Deviation, EMCY, Mark, RPDO, Rig, TPDO, Verdict, ensure, hex, request};
use super::{CIA_301, CIA_402_3, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "pdo-default-cob-ids",
        "7.3.3",
        (
            "Pre-defined connection set",
            &[
                0x1400, 0x1401, 0x1402, 0x1403, 0x1800, 0x1801, 0x1802, 0x1803,
            ],
        ),
        "the PDOs have the COB-IDs of the node-ID; the first of each kind is valid",
        default_cob_ids,
    ),
    CIA_402_3.row(
        "pdo-default-mapping",
        "",
        (
            "PDO mapping",
            &[
                0x1600, 0x1601, 0x1602, 0x1603, 0x1A00, 0x1A01, 0x1A02, 0x1A03,
            ],
        ),
        "the generic mapping of drives: words, modes, positions, velocities",
        default_mapping,
    ),
    CIA_301.row(
        "pdo-cob-id-disable",
        "7.5.2.37",
        ("COB-ID of a PDO", &[0x1400, 0x1800]),
        "bit 31 ends a PDO, and clearing it creates the PDO again",
        disable,
    ),
    CIA_301.row(
        "pdo-cob-id-moved",
        "7.5.2.37",
        ("COB-ID of a PDO", &[0x1400, 0x1800]),
        "a PDO works under another COB-ID, and no longer under the old one",
        moved,
    ),
    CIA_301.row(
        "pdo-cob-id-live",
        "7.5.2.37",
        ("COB-ID of a PDO", &[0x1400, 0x1800]),
        "bits 0 to 29 of a valid PDO cannot be changed",
        live_cob_id,
    ),
    CIA_301.row(
        "pdo-cob-id-29-bit",
        "7.5.2.37",
        ("COB-ID of a PDO", &[0x1401, 0x1801]),
        "bit 29 is refused with 06090030",
        extended_cob_id,
    ),
    CIA_301.row(
        "pdo-cob-id-high-bits",
        "7.5.2.37",
        ("COB-ID of a PDO", &[0x1401, 0x1801]),
        "bits 11 to 28 of an 11-bit identifier are refused with 06090030",
        high_bits,
    ),
    CIA_301.row(
        "pdo-cob-id-restricted",
        "7.3.5",
        ("Restricted CAN-IDs", &[0x1401, 0x1801]),
        "identifiers of NMT, SDO, error control and LSS are refused with 06090030",
        restricted,
    ),
    CIA_301.row(
        "pdo-no-rtr",
        "7.5.2.37",
        ("COB-ID of a TPDO", &[0x1800]),
        "with bit 30 set a remote frame is not answered",
        no_rtr,
    ),
    CIA_301.row(
        "pdo-reserved-subindices",
        "7.5.2.37",
        ("PDO communication parameter", &[0x1400, 0x1800]),
        "reserved sub-indices are refused with 06090011",
        reserved_subindices,
    ),
    CIA_301.row(
        "pdo-inhibit-live",
        "7.5.2.37",
        ("Inhibit time", &[0x1800]),
        "cannot be changed while the TPDO is valid",
        live_inhibit,
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

/// A PDO of either kind.
#[derive(Clone, Copy)]
struct Pdo {
    communication: u16,
    mapping: u16,
    id: u16,
}

fn tpdo(number: u16) -> Pdo {
    Pdo {
        communication: 0x1800 + number - 1,
        mapping: 0x1A00 + number - 1,
        id: TPDO[usize::from(number) - 1],
    }
}

fn rpdo(number: u16) -> Pdo {
    Pdo {
        communication: 0x1400 + number - 1,
        mapping: 0x1600 + number - 1,
        id: RPDO[usize::from(number) - 1],
    }
}

impl Pdo {
    /// COB-ID with bit 30 of TPDOs, for which the drive answers no remote frames.
    fn word(self) -> i64 {
        let rtr = if self.communication >= 0x1800 {
            0x4000_0000
        } else {
            0
        };
        rtr | i64::from(self.id)
    }

    fn destroy(self, rig: &mut Rig) -> Verdict {
        rig.write(self.communication, 1, 0x8000_0000 | self.word(), 4)
    }

    fn create(self, rig: &mut Rig) -> Verdict {
        rig.write(self.communication, 1, self.word(), 4)
    }

    fn set_type(self, rig: &mut Rig, kind: i64) -> Verdict {
        rig.write(self.communication, 2, kind, 1)
    }

    /// The re-mapping procedure.
    fn map(self, rig: &mut Rig, entries: &[u32]) -> Verdict {
        self.destroy(rig)?;
        rig.write(self.mapping, 0, 0, 1)?;
        for (subindex, &entry) in (1..).zip(entries) {
            rig.write(self.mapping, subindex, i64::from(entry), 4)?;
        }
        rig.write(self.mapping, 0, entries.len() as i64, 1)?;
        self.create(rig)
    }

    /// Destroyed, and ready for new entries.
    fn open(self, rig: &mut Rig) -> Verdict {
        self.destroy(rig)?;
        rig.write(self.mapping, 0, 0, 1)
    }

    fn sent(self, rig: &Rig, mark: Mark) -> Vec<Vec<u8>> {
        rig.heard(mark, self.id)
            .into_iter()
            .map(|heard| heard.data)
            .collect()
    }
}

const SECOND: [fn(u16) -> Pdo; 2] = [rpdo, tpdo];

fn default_cob_ids(rig: &mut Rig) -> Verdict {
    for number in 1..=4 {
        for pdo in [rpdo(number), tpdo(number)] {
            let word = rig.read(pdo.communication, 1)?;
            ensure!(
                word & 0x3FFF_FFFF == u32::from(pdo.id),
                "{:#06x}:01 is {word:#010x}",
                pdo.communication
            );
            ensure!(
                (word >> 31 == 0) == (number == 1),
                "{:#06x}:01 is {word:#010x}",
                pdo.communication
            );
        }
    }
    Ok(())
}

fn default_mapping(rig: &mut Rig) -> Verdict {
    let received: [&[u32]; 4] = [
        &[0x6040_0010],
        &[0x6040_0010, 0x6060_0008],
        &[0x6040_0010, 0x607A_0020],
        &[0x6040_0010, 0x60FF_0020],
    ];
    let sent: [&[u32]; 4] = [
        &[0x6041_0010],
        &[0x6041_0010, 0x6061_0008],
        &[0x6041_0010, 0x6064_0020],
        &[0x6041_0010, 0x606C_0020],
    ];
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

/// Whether RPDO1 under `id` writes the controlword.
fn reacts(rig: &mut Rig, id: u16) -> Result<bool, Deviation> {
    rig.write(0x6040, 0, 0, 2)?;
    rig.pass(5);
    rig.send(id, &[0x06, 0x00]);
    rig.pass(5);
    Ok(rig.read(0x6041, 0)? & 0x6F == 0x21)
}

/// Whether the statusword's change is sent under `id`.
fn reports(rig: &mut Rig, id: u16) -> Result<bool, Deviation> {
    rig.write(0x6040, 0, 0, 2)?;
    rig.pass(20);
    let mark = rig.mark();
    rig.write(0x6040, 0, 0x06, 2)?;
    rig.pass(20);
    Ok(!rig.heard(mark, id).is_empty())
}

fn disable(rig: &mut Rig) -> Verdict {
    rig.nmt(0x01);
    for works in [true, false, true] {
        for pdo in [rpdo(1), tpdo(1)] {
            if works {
                pdo.create(rig)?
            } else {
                pdo.destroy(rig)?
            }
        }
        let found = (reacts(rig, RPDO[0])?, reports(rig, TPDO[0])?);
        ensure!(
            found == (works, works),
            "(RPDO1, TPDO1) work: {found:?}, expected {works}"
        );
    }
    Ok(())
}

fn moved(rig: &mut Rig) -> Verdict {
    rig.nmt(0x01);
    for mut pdo in [rpdo(1), tpdo(1)] {
        pdo.destroy(rig)?;
        pdo.id += 0x20;
        pdo.destroy(rig)?;
        pdo.create(rig)?;
    }
    let found = (reacts(rig, RPDO[0])?, reports(rig, TPDO[0])?);
    ensure!(found == (false, false), "the old COB-IDs work: {found:?}");
    let found = (reacts(rig, RPDO[0] + 0x20)?, reports(rig, TPDO[0] + 0x20)?);
    ensure!(found == (true, true), "the new COB-IDs work: {found:?}");
    Ok(())
}

fn live_cob_id(rig: &mut Rig) -> Verdict {
    for pdo in [rpdo(1), tpdo(1)] {
        rig.refuse((pdo.communication, 1), pdo.word() + 0x20, 4, &[])?;
        rig.expect(pdo.communication, 1, pdo.word() as u32)?;
        // The same word is no change.
        pdo.create(rig)?;
    }
    Ok(())
}

fn refuse_words(rig: &mut Rig, words: impl Fn(Pdo) -> Vec<i64>) -> Verdict {
    for pdo in SECOND.map(|kind| kind(2)) {
        let before = rig.read(pdo.communication, 1)?;
        for word in words(pdo) {
            for validity in [0, 0x8000_0000] {
                rig.refuse((pdo.communication, 1), word | validity, 4, &[0x0609_0030])?;
            }
        }
        rig.expect(pdo.communication, 1, before)?;
    }
    Ok(())
}

fn extended_cob_id(rig: &mut Rig) -> Verdict {
    refuse_words(rig, |pdo| vec![pdo.word() | 0x2000_0000])
}

fn high_bits(rig: &mut Rig) -> Verdict {
    refuse_words(rig, |pdo| {
        (11..=28).map(|bit| pdo.word() | 1 << bit).collect()
    })
}

fn restricted(rig: &mut Rig) -> Verdict {
    let ids = [
        0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x77F,
        0x780, 0x7E4, 0x7E5, 0x7FF,
    ];
    for pdo in SECOND.map(|kind| kind(2)) {
        let rtr = pdo.word() & 0x4000_0000;
        for id in ids {
            rig.refuse((pdo.communication, 1), rtr | id, 4, &[0x0609_0030])?;
        }
    }
    Ok(())
}

fn no_rtr(rig: &mut Rig) -> Verdict {
    rig.nmt(0x01);
    rig.pass(20);
    let mark = rig.mark();
    rig.send_remote(TPDO[0], 2);
    rig.pass(20);
    let heard = rig.all_heard(mark);
    ensure!(heard.is_empty(), "answer to a remote frame: {heard:?}");
    Ok(())
}

fn reserved_subindices(rig: &mut Rig) -> Verdict {
    for index in [
        0x1400, 0x1401, 0x1402, 0x1403, 0x1800, 0x1801, 0x1802, 0x1803,
    ] {
        let answer = rig.transfer(request(0x40, index, 4, [0; 4]))?;
        ensure!(
            answer == request(0x80, index, 4, [0x11, 0x00, 0x09, 0x06]),
            "{index:#06x}:04: {}",
            hex(&answer)
        );
        rig.refuse((index, 4), 0, 1, &[0x0609_0011])?;
    }
    Ok(())
}

fn live_inhibit(rig: &mut Rig) -> Verdict {
    rig.refuse((0x1800, 3), 100, 2, &[])?;
    rig.expect(0x1800, 3, 10)?;
    tpdo(1).destroy(rig)?;
    rig.write(0x1800, 3, 100, 2)
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
        ensure!(
            sent == [expected.clone()],
            "{sent:02X?}, expected {expected:02X?}"
        );
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
        rig.send(
            pdo.id,
            &[0x10 + number as u8, 0x00, 0x78, 0x56, 0x34, 0x12, mode],
        );
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
        pdo.map(rig, &[entry, 0x6071_0010])?;
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

/// Entries that are refused with one of these codes, at the latest with the count.
fn refuse_entries(
    rig: &mut Rig,
    kinds: &[fn(u16) -> Pdo],
    entries: &[u32],
    codes: &[u32],
) -> Verdict {
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
    refuse_entries(
        rig,
        &SECOND,
        &[
            0x1017_0010,
            0x1018_0120,
            0x6502_0020,
            0x605A_0010,
            0x1A00_0008,
        ],
        &[0x0604_0041],
    )
}

fn direction(rig: &mut Rig) -> Verdict {
    refuse_entries(
        rig,
        &[rpdo],
        &[0x6041_0010, 0x6064_0020, 0x6061_0008, 0x1001_0008],
        &[0x0604_0041, 0x0601_0002],
    )
}

fn width(rig: &mut Rig) -> Verdict {
    for (kind, object, right) in [
        (SECOND[0], 0x6040, 16),
        (SECOND[0], 0x607A, 32),
        (SECOND[1], 0x6041, 16),
        (SECOND[1], 0x6064, 32),
    ] {
        let pdo = kind(2);
        pdo.open(rig)?;
        for bits in [0, 8, 15, 16, 24, 32, 64]
            .into_iter()
            .filter(|&bits| bits != right)
        {
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
        let short = if pdo.mapping < 0x1A00 {
            0x6040_0010
        } else {
            0x6041_0010
        };
        let mut refused = false;
        for (subindex, entry) in (1..).zip([long, short, long]) {
            let answer = rig.download(pdo.mapping, subindex, i64::from(entry), 4)?;
            if answer[0] == 0x80 {
                ensure!(
                    subindex == 3 && answer[4..] == [0x42, 0x00, 0x04, 0x06],
                    "{}",
                    hex(&answer)
                );
                refused = true;
            }
        }
        if !refused {
            rig.refuse((pdo.mapping, 0), 3, 1, &[0x0604_0042])?;
        }
        rig.expect(pdo.mapping, 0, 0)?;
        // The first two fit.
        rig.write(pdo.mapping, 0, 2, 1)?;
    }
    Ok(())
}

fn count_too_high(rig: &mut Rig) -> Verdict {
    for pdo in SECOND.map(|kind| kind(2)) {
        pdo.open(rig)?;
        for subindex in 1..=8 {
            rig.write(pdo.mapping, subindex, 0, 4)?;
        }
        rig.refuse(
            (pdo.mapping, 0),
            1,
            1,
            &[0x0602_0000, 0x0604_0041, 0x0604_0042, 0x0609_0030],
        )?;
        for count in [9, 64, 65, 255] {
            rig.refuse(
                (pdo.mapping, 0),
                count,
                1,
                &[0x0604_0042, 0x0609_0030, 0x0609_0031],
            )?;
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
        ensure!(
            idle.is_empty(),
            "type {kind}: {} TPDOs without an event",
            idle.len()
        );
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
    heard
        .windows(2)
        .map(|pair| pair[1].at.since(pair[0].at).as_secs_f64() * 1e3)
        .collect()
}

/// TPDO2, which carries statusword and mode, with its timers.
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
    ensure!(
        gaps.len() >= 3 && gaps.iter().all(|&gap| gap >= 39.9),
        "{gaps:.1?} ms apart at an inhibit time of 40 ms"
    );
    let last = tpdo(2).sent(rig, mark).pop().unwrap_or_default();
    let word = rig.upload(0x6041, 0)?;
    ensure!(
        last.starts_with(&word),
        "{last:02X?} sent last, the statusword is {word:02X?}"
    );
    Ok(())
}

fn inhibit_over_timer(rig: &mut Rig) -> Verdict {
    timed(rig, 255, 500, 10)?;
    let mark = rig.mark();
    rig.pass(600);
    let gaps = gaps(rig, mark, tpdo(2));
    ensure!(
        gaps.len() >= 5 && gaps.iter().all(|&gap| gap >= 49.9),
        "{gaps:.1?} ms apart at an inhibit time of 50 ms"
    );
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
    rig.heard(mark, EMCY)
        .iter()
        .map(|heard| u16::from_le_bytes([heard.data[0], heard.data[1]]))
        .collect()
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
    ensure!(
        codes(rig, mark) == [0x8210],
        "EMCY {:04X?}",
        codes(rig, mark)
    );
    rig.expect(0x607A, 0, 5)?;
    let word = rig.read(0x6041, 0)?;
    ensure!(
        word & 0x6F != 0x21,
        "the controlword of a short RPDO was processed"
    );
    Ok(())
}

fn too_many_bytes(rig: &mut Rig) -> Verdict {
    rpdo(3).create(rig)?;
    rig.nmt(0x01);
    rig.send(RPDO[2], &[0x06, 0x00, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66]);
    rig.pass(10);
    rig.expect(0x607A, 0, 0x4433_2211)
}

/// RPDO3 and RPDO4 with deadlines, in a drive that takes no other action.
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
    ensure!(
        codes(rig, mark).is_empty(),
        "EMCY {:04X?} while the RPDO comes in time",
        codes(rig, mark)
    );
    rig.pass(40);
    ensure!(
        codes(rig, mark) == [0x8250],
        "EMCY {:04X?}",
        codes(rig, mark)
    );
    Ok(())
}

fn deadline_waits(rig: &mut Rig) -> Verdict {
    with_deadlines(rig, 30, 30)?;
    let mark = rig.mark();
    rig.pass(300);
    ensure!(
        codes(rig, mark).is_empty(),
        "EMCY {:04X?}",
        codes(rig, mark)
    );
    Ok(())
}

fn own_deadlines(rig: &mut Rig) -> Verdict {
    with_deadlines(rig, 30, 60)?;
    let mark = rig.mark();
    rig.send(RPDO[2], &COMMAND);
    rig.send(RPDO[3], &COMMAND);
    rig.pass(45);
    ensure!(
        codes(rig, mark) == [0x8250],
        "EMCY {:04X?} after the first deadline",
        codes(rig, mark)
    );
    rig.pass(40);
    ensure!(
        codes(rig, mark) == [0x8250, 0x8250],
        "EMCY {:04X?} after both deadlines",
        codes(rig, mark)
    );
    // RPDO3 comes back; RPDO4 is still missing.
    rig.send(RPDO[2], &COMMAND);
    rig.pass(5);
    ensure!(
        rig.read(0x1001, 0)? & 0x10 != 0,
        "the error of RPDO4 ended with RPDO3"
    );
    rig.send(RPDO[2], &COMMAND);
    rig.send(RPDO[3], &COMMAND);
    rig.pass(5);
    rig.expect(0x1001, 0, 0)
}

fn undisturbed(rig: &mut Rig) -> Verdict {
    // RPDO3 holds data for the next SYNC, TPDO3 counts SYNCs, TPDO2 runs its timer, RPDO4 has its type written.
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
