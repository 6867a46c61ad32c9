//! Claims about the communication parameters of PDOs.

use super::rig::{Deviation, Mark, RPDO, Rig, TPDO, Verdict, ensure, hex, request};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "pdo-default-cob-ids",
        "7.3.3",
        ("Pre-defined connection set", &[0x1400, 0x1401, 0x1402, 0x1403, 0x1800, 0x1801, 0x1802, 0x1803]),
        "the PDOs have the COB-IDs of the node-ID; the first of each kind is valid",
        default_cob_ids,
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
];

/// A PDO of either direction.
#[derive(Clone, Copy)]
pub(super) struct Pdo {
    pub(super) communication: u16,
    pub(super) mapping: u16,
    pub(super) id: u16,
}

pub(super) fn tpdo(number: u16) -> Pdo {
    Pdo { communication: 0x1800 + number - 1, mapping: 0x1A00 + number - 1, id: TPDO[usize::from(number) - 1] }
}

pub(super) fn rpdo(number: u16) -> Pdo {
    Pdo { communication: 0x1400 + number - 1, mapping: 0x1600 + number - 1, id: RPDO[usize::from(number) - 1] }
}

impl Pdo {
    /// COB-ID, with bit 30 set for TPDOs, because the drive answers no remote frames.
    pub(super) fn word(self) -> i64 {
        let rtr = if self.communication >= 0x1800 { 0x4000_0000 } else { 0 };
        rtr | i64::from(self.id)
    }

    pub(super) fn destroy(self, rig: &mut Rig) -> Verdict {
        rig.write(self.communication, 1, 0x8000_0000 | self.word(), 4)
    }

    pub(super) fn create(self, rig: &mut Rig) -> Verdict {
        rig.write(self.communication, 1, self.word(), 4)
    }

    pub(super) fn set_type(self, rig: &mut Rig, kind: i64) -> Verdict {
        rig.write(self.communication, 2, kind, 1)
    }

    /// The re-mapping procedure.
    pub(super) fn map(self, rig: &mut Rig, entries: &[u32]) -> Verdict {
        self.destroy(rig)?;
        rig.write(self.mapping, 0, 0, 1)?;
        for (subindex, &entry) in (1..).zip(entries) {
            rig.write(self.mapping, subindex, i64::from(entry), 4)?;
        }
        rig.write(self.mapping, 0, entries.len() as i64, 1)?;
        self.create(rig)
    }

    /// Destroys the PDO, so that entries can be written.
    pub(super) fn open(self, rig: &mut Rig) -> Verdict {
        self.destroy(rig)?;
        rig.write(self.mapping, 0, 0, 1)
    }

    pub(super) fn sent(self, rig: &Rig, mark: Mark) -> Vec<Vec<u8>> {
        rig.heard(mark, self.id).into_iter().map(|heard| heard.data).collect()
    }
}

pub(super) const SECOND: [fn(u16) -> Pdo; 2] = [rpdo, tpdo];

fn default_cob_ids(rig: &mut Rig) -> Verdict {
    for number in 1..=4 {
        for pdo in [rpdo(number), tpdo(number)] {
            let word = rig.read(pdo.communication, 1)?;
            ensure!(word & 0x3FFF_FFFF == u32::from(pdo.id), "{:#06x}:01 is {word:#010x}", pdo.communication);
            ensure!((word >> 31 == 0) == (number == 1), "{:#06x}:01 is {word:#010x}", pdo.communication);
        }
    }
    Ok(())
}

/// Whether RPDO1 under `id` writes the controlword.
pub(super) fn reacts(rig: &mut Rig, id: u16) -> Result<bool, Deviation> {
    rig.write(0x6040, 0, 0, 2)?;
    rig.pass(5);
    rig.send(id, &[0x06, 0x00]);
    rig.pass(5);
    Ok(rig.read(0x6041, 0)? & 0x6F == 0x21)
}

/// Whether a change of the statusword is sent under `id`.
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
                pdo.create(rig)?;
            } else {
                pdo.destroy(rig)?;
            }
        }
        let found = (reacts(rig, RPDO[0])?, reports(rig, TPDO[0])?);
        ensure!(found == (works, works), "(RPDO1, TPDO1) work: {found:?}, expected {works}");
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
        // Writing the same word is not a change.
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
    refuse_words(rig, |pdo| (11..=28).map(|bit| pdo.word() | 1 << bit).collect())
}

fn restricted(rig: &mut Rig) -> Verdict {
    let ids = [
        0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x77F, 0x780, 0x7E4, 0x7E5,
        0x7FF,
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
    ensure!(reports(rig, TPDO[0])?, "TPDO1 does not work at all");
    Ok(())
}

fn reserved_subindices(rig: &mut Rig) -> Verdict {
    for index in [0x1400, 0x1401, 0x1402, 0x1403, 0x1800, 0x1801, 0x1802, 0x1803] {
        let answer = rig.transfer(request(0x40, index, 4, [0; 4]))?;
        ensure!(answer == request(0x80, index, 4, [0x11, 0x00, 0x09, 0x06]), "{index:#06x}:04: {}", hex(&answer));
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
