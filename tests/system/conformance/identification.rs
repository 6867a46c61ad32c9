//! Claims about LSS inquiry, identification and fastscan.

use super::lss::{ask, expect, expect_silence, numbered, numbers, to_configuration, unconfigured};
use super::rig::{NODE, Rig, Verdict, ensure};
use super::{CIA_305, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_305.row(
        "lss-identity",
        "6.5.2",
        ("Inquire identity", &[0x1018]),
        "5A to 5D return the four numbers of 0x1018",
        identity,
    ),
    CIA_305.row(
        "lss-inquire-node-id",
        "6.5.3",
        ("Inquire node-ID", &[]),
        "5E returns the active node-ID, 255 in a drive without one",
        inquire_node_id,
    ),
    CIA_305.row(
        "lss-identify",
        "6.6.2",
        ("Identify remote slave", &[0x1018]),
        "numbers and ranges that contain the drive are answered by 4F, in both states",
        identify,
    ),
    CIA_305.row(
        "lss-identify-other",
        "6.6.2",
        ("Identify remote slave", &[0x1018]),
        "numbers and ranges without the drive are not answered",
        identify_other,
    ),
    CIA_305.row(
        "lss-identify-unconfigured",
        "6.6.4",
        ("Identify non-configured remote slave", &[]),
        "a drive without a node-ID answers 50, one with a node-ID does not",
        identify_unconfigured,
    ),
    CIA_305.row(
        "lss-fastscan",
        "6.7",
        ("Fastscan", &[0x1018]),
        "finds the four numbers bit by bit, and leads to configuration",
        fastscan,
    ),
    CIA_305.row(
        "lss-fastscan-configured",
        "6.7",
        ("Fastscan", &[]),
        "a drive with a node-ID does not take part",
        fastscan_configured,
    ),
    CIA_305.row(
        "lss-fastscan-state",
        "",
        ("Fastscan", &[]),
        "a drive in configuration does not take part",
        fastscan_state,
    ),
];

fn identity(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    for ((command, number), subindex) in (0x5A..).zip(numbers()).zip(1..) {
        expect(rig, &[command], &numbered(command, number))?;
        rig.expect(0x1018, subindex, number)?;
    }
    Ok(())
}

fn inquire_node_id(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    expect(rig, &[0x5E], &[0x5E, NODE])?;
    unconfigured(rig);
    to_configuration(rig)?;
    expect(rig, &[0x5E], &[0x5E, 0xFF])
}

/// Vendor-ID, product code, and ranges of revision and serial numbers.
fn identify_range(rig: &mut Rig, numbers: [u32; 6]) -> Vec<Vec<u8>> {
    (0x46..=0x4B).zip(numbers).flat_map(|(command, number)| ask(rig, &numbered(command, number))).collect()
}

fn identify(rig: &mut Rig) -> Verdict {
    let [vendor, product, revision, serial] = numbers();
    for _ in 0..2 {
        for ranges in [
            [revision, revision, serial, serial],
            [0, u32::MAX, 0, u32::MAX],
            [revision - 1, revision, serial, serial + 1],
        ] {
            let [a, b, c, d] = ranges;
            let answers = identify_range(rig, [vendor, product, a, b, c, d]);
            ensure!(answers == [[0x4F, 0, 0, 0, 0, 0, 0, 0]], "ranges {ranges:#x?}: {answers:02X?}");
        }
        to_configuration(rig)?;
    }
    Ok(())
}

fn identify_other(rig: &mut Rig) -> Verdict {
    let [vendor, product, revision, serial] = numbers();
    for numbers in [
        [vendor + 1, product, 0, u32::MAX, 0, u32::MAX],
        [vendor, product + 1, 0, u32::MAX, 0, u32::MAX],
        [vendor, product, revision + 1, u32::MAX, 0, u32::MAX],
        [vendor, product, 0, revision - 1, 0, u32::MAX],
        [vendor, product, 0, u32::MAX, serial + 1, u32::MAX],
        [vendor, product, 0, u32::MAX, 0, serial - 1],
    ] {
        let answers = identify_range(rig, numbers);
        ensure!(answers.is_empty(), "{numbers:#x?}: {answers:02X?}");
    }
    let answers = identify_range(rig, [vendor, product, 0, u32::MAX, 0, u32::MAX]);
    ensure!(answers.len() == 1, "the drive does not answer at all");
    Ok(())
}

fn identify_unconfigured(rig: &mut Rig) -> Verdict {
    expect_silence(rig, &[0x4C])?;
    unconfigured(rig);
    expect(rig, &[0x4C], &[0x50])?;
    to_configuration(rig)?;
    expect(rig, &[0x4C], &[0x50])
}

/// ID number, bit to check, sub-index, next sub-index.
fn scan(rig: &mut Rig, number: u32, bit: u8, sub: u8, next: u8) -> bool {
    let [a, b, c, d] = number.to_le_bytes();
    ask(rig, &[0x51, a, b, c, d, bit, sub, next]) == [[0x4F, 0, 0, 0, 0, 0, 0, 0]]
}

fn fastscan(rig: &mut Rig) -> Verdict {
    unconfigured(rig);
    ensure!(scan(rig, 0, 0x80, 0, 0), "no answer to the begin of the scan");
    for (sub, expected) in (0..4).zip(numbers()) {
        let mut number = 0;
        for bit in (0..32).rev() {
            // No answer: the bit is 1.
            if !scan(rig, number, bit, sub, sub) {
                number |= 1 << bit;
            }
        }
        ensure!(number == expected, "number {sub} is {number:#x}, expected {expected:#x}");
        let next = (sub + 1) % 4;
        ensure!(!scan(rig, number ^ 1, 0, sub, next), "number {sub} was confirmed with a wrong bit");
        ensure!(scan(rig, number, 0, sub, next), "number {sub} was not confirmed");
        ensure!(!scan(rig, number, 0, sub, sub), "the drive did not go on from number {sub}");
    }
    expect(rig, &[0x5E], &[0x5E, 0xFF])
}

fn fastscan_configured(rig: &mut Rig) -> Verdict {
    ensure!(!scan(rig, 0, 0x80, 0, 0), "an answer");
    to_configuration(rig)?;
    expect(rig, &[0x5E], &[0x5E, NODE])
}

fn fastscan_state(rig: &mut Rig) -> Verdict {
    unconfigured(rig);
    to_configuration(rig)?;
    ensure!(!scan(rig, 0, 0x80, 0, 0), "an answer in configuration");
    expect(rig, &[0x5E], &[0x5E, 0xFF])
}
