//! Claims about LSS: the two states, switching between them, and configuration.

use hil::Epos4Config;

use super::rig::{Deviation, Mark, NODE, Rig, SDO_ANSWER, Verdict, ensure, hex, request, unit};
use super::{CIA_305, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_305.row(
        "lss-global",
        "6.3.2",
        ("Switch state global", &[]),
        "leads to configuration and back to waiting, without an answer",
        global,
    ),
    CIA_305.row(
        "lss-selective",
        "6.3.3",
        ("Switch state selective", &[0x1018]),
        "the four numbers of the drive lead to configuration, answered by 44",
        selective,
    ),
    CIA_305.row(
        "lss-selective-other",
        "6.3.3",
        ("Switch state selective", &[0x1018]),
        "with one number of another device there is no answer",
        selective_other,
    ),
    CIA_305.row(
        "lss-selective-order",
        "6.3.3",
        ("Switch state selective", &[]),
        "numbers out of order, or with one left out, select no device",
        selective_order,
    ),
    CIA_305.row(
        "lss-waiting",
        "",
        ("LSS waiting", &[]),
        "configuration and inquiry are not answered in waiting, and change nothing",
        waiting,
    ),
    CIA_305.row(
        "lss-nmt-states",
        "",
        ("LSS states", &[]),
        "LSS works in pre-operational, operational and stopped",
        nmt_states,
    ),
    CIA_305.row(
        "lss-node-id",
        "6.4.2",
        ("Configure node-ID", &[]),
        "a node-ID from 1 to 127 and 255 is taken with error 0, others are refused with error 1",
        node_id,
    ),
    CIA_305.row(
        "lss-node-id-pending",
        "6.4.2",
        ("Configure node-ID", &[]),
        "a new node-ID takes effect with a reset of the communication, not before",
        node_id_pending,
    ),
    CIA_305.row(
        "lss-node-id-cob-ids",
        "6.4.2",
        ("Configure node-ID", &[0x1014, 0x1200, 0x1400, 0x1800]),
        "COB-IDs that depend on the node-ID follow",
        node_id_cob_ids,
    ),
    CIA_305.row(
        "lss-node-id-255",
        "6.4.2",
        ("Configure node-ID", &[]),
        "255 leaves the drive without a node-ID after a reset of the communication",
        node_id_255,
    ),
    CIA_305.row(
        "lss-node-id-unstored",
        "6.4.5",
        ("Configure node-ID", &[]),
        "a node-ID that was not stored is gone after a reset of the node",
        node_id_unstored,
    ),
    CIA_305.row(
        "lss-store",
        "6.4.5",
        ("Store configuration", &[]),
        "is answered with error 0, and the node-ID survives a reset of the node",
        store,
    ),
    CIA_305.row(
        "lss-bit-timing",
        "6.4.3",
        ("Configure bit timing parameters", &[]),
        "the bit rates of the data sheet are taken, others and other tables refused with error 1",
        bit_timing,
    ),
    CIA_305.row(
        "lss-unconfigured-silent",
        "",
        ("Drive without a node-ID", &[]),
        "sends no boot-up and answers neither NMT nor SDO",
        unconfigured_silent,
    ),
    CIA_305.row(
        "lss-unconfigured-start",
        "6.4.2",
        ("Drive without a node-ID", &[]),
        "boots under its new node-ID when it returns to waiting",
        unconfigured_start,
    ),
    CIA_305.row(
        "lss-frames",
        "",
        ("LSS protocols", &[]),
        "answers have 8 bytes under 0x7E4; unknown command specifiers are not answered",
        frames,
    ),
];

const REQUEST: u16 = 0x7E5;

const ANSWER: u16 = 0x7E4;

/// Sends a request of 8 bytes and returns the answers.
pub(super) fn ask(rig: &mut Rig, bytes: &[u8]) -> Vec<Vec<u8>> {
    let mark = rig.mark();
    let mut frame = [0; 8];
    frame[..bytes.len()].copy_from_slice(bytes);
    rig.send(REQUEST, &frame);
    rig.pass(5);
    answers(rig, mark)
}

fn answers(rig: &Rig, mark: Mark) -> Vec<Vec<u8>> {
    rig.heard(mark, ANSWER).into_iter().map(|heard| heard.data).collect()
}

/// Expects one answer that begins with these bytes and is filled with zeros.
pub(super) fn expect(rig: &mut Rig, bytes: &[u8], answer: &[u8]) -> Verdict {
    let answers = ask(rig, bytes);
    let mut expected = [0; 8];
    expected[..answer.len()].copy_from_slice(answer);
    ensure!(answers == [expected], "{}: {answers:02X?}, expected {}", hex(bytes), hex(&expected));
    Ok(())
}

pub(super) fn expect_silence(rig: &mut Rig, bytes: &[u8]) -> Verdict {
    let answers = ask(rig, bytes);
    ensure!(answers.is_empty(), "{}: {answers:02X?}, expected silence", hex(bytes));
    Ok(())
}

pub(super) fn to_configuration(rig: &mut Rig) -> Verdict {
    expect_silence(rig, &[0x04, 0x01])
}

fn to_waiting(rig: &mut Rig) -> Verdict {
    expect_silence(rig, &[0x04, 0x00])
}

/// Command specifier and number.
pub(super) fn numbered(command: u8, number: u32) -> [u8; 5] {
    let [a, b, c, d] = number.to_le_bytes();
    [command, a, b, c, d]
}

/// Vendor-ID, product code, revision number, serial number.
pub(super) fn numbers() -> [u32; 4] {
    let Epos4Config { vendor, product, revision, serial, .. } = unit();
    [vendor, product, revision, serial]
}

/// A drive without a node-ID, switched on 100 ms ago.
pub(super) fn unconfigured(rig: &mut Rig) {
    rig.power_on(Epos4Config { node: None, ..unit() });
    rig.pass(100);
}

fn in_configuration(rig: &mut Rig) -> bool {
    !ask(rig, &[0x5E]).is_empty()
}

/// Whether the boot-up message of a node was received after `mark`.
fn booted(rig: &Rig, mark: Mark, node: u8) -> bool {
    rig.heard(mark, 0x700 + u16::from(node)).iter().any(|heard| heard.data == [0])
}

/// Uploads the device type from a node, and returns whether the node answers.
fn answers_as(rig: &mut Rig, node: u8) -> bool {
    let mark = rig.mark();
    rig.send(0x600 + u16::from(node), &request(0x40, 0x1000, 0, [0; 4]));
    rig.pass(10);
    !rig.heard(mark, 0x580 + u16::from(node)).is_empty()
}

fn global(rig: &mut Rig) -> Verdict {
    ensure!(!in_configuration(rig), "in configuration after power-on");
    for _ in 0..2 {
        to_configuration(rig)?;
        ensure!(in_configuration(rig), "in waiting after 04 01");
        to_waiting(rig)?;
        ensure!(!in_configuration(rig), "in configuration after 04 00");
    }
    to_configuration(rig)?;
    rig.reset(0x82);
    ensure!(!in_configuration(rig), "in configuration after a reset of the communication");
    Ok(())
}

fn select(rig: &mut Rig, numbers: [u32; 4], commands: [u8; 4]) -> Vec<Vec<u8>> {
    commands.into_iter().zip(numbers).flat_map(|(command, number)| ask(rig, &numbered(command, number))).collect()
}

const SELECT: [u8; 4] = [0x40, 0x41, 0x42, 0x43];

fn selective(rig: &mut Rig) -> Verdict {
    let answers = select(rig, numbers(), SELECT);
    ensure!(answers == [[0x44, 0, 0, 0, 0, 0, 0, 0]], "{answers:02X?}");
    ensure!(in_configuration(rig), "in waiting after 44");
    Ok(())
}

fn selective_other(rig: &mut Rig) -> Verdict {
    for at in 0..4 {
        let mut other = numbers();
        other[at] ^= 0x0100;
        let answers = select(rig, other, SELECT);
        ensure!(answers.is_empty() && !in_configuration(rig), "number {at} of another device: {answers:02X?}");
    }
    selective(rig)
}

fn selective_order(rig: &mut Rig) -> Verdict {
    let [vendor, product, revision, serial] = numbers();
    for (commands, numbers) in [
        ([0x41, 0x40, 0x42, 0x43], [product, vendor, revision, serial]),
        ([0x40, 0x42, 0x41, 0x43], [vendor, revision, product, serial]),
        ([0x40, 0x41, 0x41, 0x43], [vendor, product, product, serial]),
        ([0x43, 0x43, 0x43, 0x43], [serial; 4]),
    ] {
        let answers = select(rig, numbers, commands);
        ensure!(answers.is_empty() && !in_configuration(rig), "{}: {answers:02X?}", hex(&commands));
    }
    selective(rig)
}

fn waiting(rig: &mut Rig) -> Verdict {
    let requests: [&[u8]; 9] =
        [&[0x11, 0x05], &[0x13, 0x00, 0x02], &[0x15, 0x01], &[0x17], &[0x5A], &[0x5B], &[0x5C], &[0x5D], &[0x5E]];
    for bytes in requests {
        expect_silence(rig, bytes)?;
    }
    let mark = rig.mark();
    rig.reset(0x82);
    ensure!(booted(rig, mark, NODE), "another node-ID was taken in waiting");
    Ok(())
}

fn nmt_states(rig: &mut Rig) -> Verdict {
    for command in [0x80, 0x01, 0x02] {
        rig.nmt(command);
        to_configuration(rig)?;
        expect(rig, &[0x5E], &[0x5E, NODE])?;
        to_waiting(rig)?;
    }
    Ok(())
}

fn node_id(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    for id in 0..=255 {
        let error = u8::from(!matches!(id, 1..=127 | 255));
        expect(rig, &[0x11, id], &[0x11, error])?;
    }
    Ok(())
}

/// Gives a pending node-ID to the drive, which stays in waiting mode.
fn configure(rig: &mut Rig, id: u8) -> Verdict {
    to_configuration(rig)?;
    expect(rig, &[0x11, id], &[0x11, 0])?;
    to_waiting(rig)
}

fn node_id_pending(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    expect(rig, &[0x11, 9], &[0x11, 0])?;
    expect(rig, &[0x5E], &[0x5E, NODE])?;
    to_waiting(rig)?;
    rig.pass(100);
    ensure!(answers_as(rig, NODE) && !answers_as(rig, 9), "the node-ID took effect at once");
    let mark = rig.mark();
    rig.reset(0x82);
    ensure!(booted(rig, mark, 9) && !booted(rig, mark, NODE), "no boot-up under the new node-ID");
    ensure!(answers_as(rig, 9) && !answers_as(rig, NODE), "SDO under the old node-ID");
    Ok(())
}

fn read_from(rig: &mut Rig, node: u8, index: u16, subindex: u8) -> Result<u32, Deviation> {
    let mark = rig.mark();
    rig.send(0x600 + u16::from(node), &request(0x40, index, subindex, [0; 4]));
    rig.pass(10);
    let answer = rig.heard(mark, 0x580 + u16::from(node)).pop();
    let data = answer.map(|heard| heard.data).unwrap_or_default();
    ensure!(data.len() == 8 && data[0] == 0x43, "upload of {index:#06x} from node {node}: {}", hex(&data));
    Ok(u32::from_le_bytes([data[4], data[5], data[6], data[7]]))
}

fn node_id_cob_ids(rig: &mut Rig) -> Verdict {
    configure(rig, 9)?;
    rig.reset(0x82);
    for (index, subindex, value) in [
        (0x1014, 0, 0x089),
        (0x1200, 1, 0x609),
        (0x1200, 2, 0x589),
        (0x1400, 1, 0x209),
        (0x1401, 1, 0x8000_0309),
        (0x1800, 1, 0x4000_0189),
        (0x1803, 1, 0xC000_0489),
    ] {
        let found = read_from(rig, 9, index, subindex)?;
        ensure!(found == value, "{index:#06x}:{subindex:02x} is {found:#x}, expected {value:#x}");
    }
    let mark = rig.mark();
    rig.send(0x000, &[0x01, 9]);
    rig.pass(10);
    rig.send(0x209, &[0x06, 0x00]);
    rig.pass(20);
    ensure!(!rig.heard(mark, 0x189).is_empty(), "PDOs do not work under the new node-ID");
    Ok(())
}

fn node_id_255(rig: &mut Rig) -> Verdict {
    configure(rig, 255)?;
    ensure!(answers_as(rig, NODE), "the node-ID is gone at once");
    let mark = rig.mark();
    rig.reset(0x82);
    let heard = rig.all_heard(mark);
    ensure!(heard.is_empty(), "{heard:?}");
    expect(rig, &[0x4C], &[0x50])
}

fn node_id_unstored(rig: &mut Rig) -> Verdict {
    configure(rig, 9)?;
    rig.reset(0x82);
    let mark = rig.mark();
    rig.send(0x000, &[0x81, 9]);
    rig.pass(80);
    ensure!(booted(rig, mark, NODE) && !booted(rig, mark, 9), "the node-ID was stored unasked");
    Ok(())
}

fn store(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    expect(rig, &[0x11, 9], &[0x11, 0])?;
    expect(rig, &[0x17], &[0x17, 0])?;
    to_waiting(rig)?;
    let mark = rig.mark();
    rig.reset(0x81);
    ensure!(booted(rig, mark, 9), "no boot-up under the stored node-ID");
    let mark = rig.mark();
    rig.send(0x000, &[0x81, 9]);
    rig.pass(80);
    ensure!(booted(rig, mark, 9), "the stored node-ID did not last");
    Ok(())
}

fn bit_timing(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    // Table 0: 1000, 800, 500, 250, 125, reserved, 50, 20, 10 kbit/s, automatic. The data sheet has all bit rates
    // except 10 kbit/s.
    for (index, supported) in
        [(0, true), (1, true), (2, true), (3, true), (4, true), (5, false), (6, true), (7, true), (8, false)]
    {
        let error = u8::from(!supported);
        expect(rig, &[0x13, 0x00, index], &[0x13, error])?;
    }
    for bytes in [[0x13, 0x00, 10], [0x13, 0x00, 255], [0x13, 0x01, 0], [0x13, 0x7F, 0]] {
        expect(rig, &bytes, &[0x13, 1])?;
    }
    Ok(())
}

fn unconfigured_silent(rig: &mut Rig) -> Verdict {
    rig.power_on(Epos4Config { node: None, ..unit() });
    let mark = rig.mark();
    rig.pass(200);
    for command in [0x01, 0x81, 0x82] {
        rig.send(0x000, &[command, 0]);
        rig.pass(80);
    }
    rig.send(0x6FF, &request(0x40, 0x1000, 0, [0; 4]));
    rig.send(0x600, &request(0x40, 0x1000, 0, [0; 4]));
    rig.send(0x080, &[]);
    rig.pass(20);
    let heard = rig.all_heard(mark);
    ensure!(heard.is_empty(), "{heard:?}");
    expect(rig, &[0x4C], &[0x50])
}

fn unconfigured_start(rig: &mut Rig) -> Verdict {
    unconfigured(rig);
    to_configuration(rig)?;
    expect(rig, &[0x11, 9], &[0x11, 0])?;
    let mark = rig.mark();
    to_waiting(rig)?;
    rig.pass(80);
    ensure!(booted(rig, mark, 9), "no boot-up under the new node-ID");
    ensure!(answers_as(rig, 9), "no SDO answer under the new node-ID");
    expect_silence(rig, &[0x4C])
}

fn frames(rig: &mut Rig) -> Verdict {
    to_configuration(rig)?;
    let mark = rig.mark();
    for bytes in [[0x5E, 0], [0x5A, 0], [0x11, 0]] {
        let answers = ask(rig, &bytes);
        ensure!(answers.len() == 1 && answers[0].len() == 8, "{}: {answers:02X?}", hex(&bytes));
    }
    ensure!(rig.heard(mark, SDO_ANSWER).is_empty(), "an SDO answer to LSS");
    for command in [0x00, 0x10, 0x12, 0x44, 0x4F, 0x50, 0x5F, 0xFF] {
        expect_silence(rig, &[command])?;
    }
    Ok(())
}
