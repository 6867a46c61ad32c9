//! Claims about SDO block transfers, whose data are a text and a domain of the emulator.

use super::rig::{Deviation, Rig, SDO_ANSWER, SDO_REQUEST, Verdict, aborted, ensure, hex, multiplexer, request};
use super::sdo::upload_segments;
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "blk-upload",
        "7.2.4.3.12",
        ("SDO block upload", &[]),
        "a text comes in one sub-block with its size",
        upload_whole,
    ),
    CIA_301.row(
        "blk-upload-small",
        "7.2.4.3.14",
        ("SDO block upload sub-block", &[]),
        "with a block size of 1, 3 and 4 the text comes in several sub-blocks",
        upload_in_sub_blocks,
    ),
    CIA_301.row(
        "blk-upload-repeat",
        "7.2.4.3.14",
        ("SDO block upload sub-block", &[]),
        "segments behind the acknowledged one are sent again",
        upload_repeated,
    ),
    CIA_301.row(
        "blk-upload-size-changed",
        "7.2.4.3.14",
        ("SDO block upload sub-block", &[]),
        "the client may change the block size with each acknowledgement",
        upload_changed_size,
    ),
    CIA_301.row(
        "blk-upload-crc",
        "7.2.4.3.15",
        ("SDO block upload end", &[]),
        "the end carries the CRC where both sides can, and the unused bytes",
        upload_crc,
    ),
    CIA_301.row(
        "blk-upload-no-crc",
        "7.2.4.3.15",
        ("SDO block upload end", &[]),
        "a client without CRC gets its data as well",
        upload_without_crc,
    ),
    CIA_301.row(
        "blk-upload-bad-size",
        "7.2.4.3.13",
        ("SDO block upload initiate", &[]),
        "a block size of 0 or above 127 is refused with 05040002",
        upload_bad_size,
    ),
    CIA_301.row(
        "blk-upload-no-object",
        "7.2.4.3.13",
        ("SDO block upload initiate", &[]),
        "an absent object is refused with 06020000, an absent sub-index with 06090011",
        upload_no_object,
    ),
    CIA_301.row(
        "blk-upload-switch",
        "7.2.4.3.13",
        ("SDO block upload initiate", &[]),
        "a protocol switch threshold of 0 forbids the change to a normal upload",
        upload_no_switch,
    ),
    CIA_301.row(
        "blk-upload-abort",
        "7.2.4.3.17",
        ("SDO abort transfer", &[]),
        "an abort of the client ends a block upload",
        upload_abort,
    ),
    CIA_301.row(
        "blk-download",
        "7.2.4.3.8",
        ("SDO block download", &[]),
        "1000 bytes are taken in sub-blocks and read back",
        download_long,
    ),
    CIA_301.row(
        "blk-download-short",
        "7.2.4.3.8",
        ("SDO block download", &[]),
        "1, 6, 7 and 8 bytes are taken in one sub-block",
        download_short,
    ),
    CIA_301.row(
        "blk-download-lost",
        "7.2.4.3.10",
        ("SDO block download sub-block", &[]),
        "after a lost segment the last good one is acknowledged, and the rest is sent again",
        download_lost_segment,
    ),
    CIA_301.row(
        "blk-download-crc",
        "7.2.4.3.11",
        ("SDO block download end", &[]),
        "a wrong CRC is refused with 05040004",
        download_bad_crc,
    ),
    CIA_301.row(
        "blk-download-no-crc",
        "7.2.4.3.11",
        ("SDO block download end", &[]),
        "a client without CRC may leave the field at 0",
        download_without_crc,
    ),
    CIA_301.row(
        "blk-download-read-only",
        "7.2.4.3.9",
        ("SDO block download initiate", &[]),
        "a read-only object is refused with 06010002",
        download_read_only,
    ),
    CIA_301.row(
        "blk-download-size",
        "7.2.4.3.11",
        ("SDO block download end", &[]),
        "fewer bytes than announced are refused with 06070010 or 06070013",
        download_wrong_size,
    ),
    CIA_301.row(
        "blk-download-number",
        "7.2.4.3.8",
        ("SDO block download", &[]),
        "a number is taken by blocks too",
        download_number,
    ),
];

const TEXT: (u16, u8) = (0x2FF0, 1);

const DOMAIN: (u16, u8) = (0x2FF0, 2);

/// CRC of a block transfer: polynomial 0x1021, initial value 0 (CiA 301 §7.2.4.3.16).
pub(super) fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc: u16, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| {
            let shifted = crc << 1;
            if crc & 0x8000 != 0 { shifted ^ 0x1021 } else { shifted }
        })
    })
}

/// A block upload under way.
struct Upload {
    bytes: Vec<u8>,
    size: Option<usize>,
    server_crc: bool,
}

/// Starts a block upload. Returns the answer to the initiate request.
fn initiate_upload(
    rig: &mut Rig,
    (index, subindex): (u16, u8),
    client_crc: bool,
    size: u8,
    threshold: u8,
) -> Result<[u8; 8], Deviation> {
    rig.transfer(request(0xA0 | u8::from(client_crc) << 2, index, subindex, [size, threshold, 0, 0]))
}

fn begin_upload(rig: &mut Rig, address: (u16, u8), client_crc: bool, size: u8) -> Result<Upload, Deviation> {
    let answer = initiate_upload(rig, address, client_crc, size, 0)?;
    ensure!(
        answer[0] & 0xF9 == 0xC0 && answer[1..4] == multiplexer(address.0, address.1),
        "initiate of a block upload: {}",
        hex(&answer)
    );
    let announced = u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]]) as usize;
    Ok(Upload { bytes: Vec::new(), size: (answer[0] & 2 != 0).then_some(announced), server_crc: answer[0] & 4 != 0 })
}

/// Sends a request, and collects the segments of the sub-block that follows.
fn sub_block(rig: &mut Rig, go: [u8; 8]) -> Vec<Vec<u8>> {
    let mark = rig.mark();
    rig.send(SDO_REQUEST, &go);
    rig.pass(60);
    rig.heard(mark, SDO_ANSWER).into_iter().map(|heard| heard.data).collect()
}

const GO: [u8; 8] = [0xA3, 0, 0, 0, 0, 0, 0, 0];

fn acknowledge(sequence: u8, size: u8) -> [u8; 8] {
    [0xA2, sequence, size, 0, 0, 0, 0, 0]
}

/// Uploads all sub-blocks, each acknowledged completely. Returns the end frame, which is not answered yet.
fn collect(
    rig: &mut Rig,
    upload: &mut Upload,
    mut size: u8,
    next_size: impl Fn(u8) -> u8,
) -> Result<Vec<u8>, Deviation> {
    let mut segments = sub_block(rig, GO);
    for _ in 0..200 {
        ensure!(
            !segments.is_empty() && segments.len() <= usize::from(size),
            "{} segments in a sub-block of {size}",
            segments.len()
        );
        for (at, segment) in segments.iter().enumerate() {
            ensure!(usize::from(segment[0] & 0x7F) == at + 1, "sequence number {:02X} at {at}", segment[0]);
            upload.bytes.extend(&segment[1..]);
        }
        let count = segments.len() as u8;
        let last = segments.last().is_some_and(|segment| segment[0] & 0x80 != 0);
        ensure!(last || count == size, "{count} segments in a sub-block of {size}, which is not the last");
        size = next_size(size);
        segments = sub_block(rig, acknowledge(count, size));
        if last {
            let [end] = &segments[..] else {
                return Err(Deviation(format!("{} frames at the end", segments.len())));
            };
            ensure!(end[0] & 0xE3 == 0xC1, "end of a block upload: {}", hex(end));
            let unused = usize::from(end[0] >> 2 & 7);
            upload.bytes.truncate(upload.bytes.len() - unused);
            return Ok(end.clone());
        }
    }
    Err(Deviation("no last segment".to_owned()))
}

/// Ends a block upload; the server does not answer.
fn end_upload(rig: &mut Rig) -> Verdict {
    let mark = rig.mark();
    rig.send(SDO_REQUEST, &[0xA1, 0, 0, 0, 0, 0, 0, 0]);
    rig.pass(10);
    ensure!(rig.heard(mark, SDO_ANSWER).is_empty(), "an answer to the end of a block upload");
    Ok(())
}

fn whole_upload(rig: &mut Rig, address: (u16, u8), client_crc: bool, size: u8) -> Result<Upload, Deviation> {
    let mut upload = begin_upload(rig, address, client_crc, size)?;
    let end = collect(rig, &mut upload, size, |size| size)?;
    if client_crc && upload.server_crc {
        let sent = u16::from_le_bytes([end[1], end[2]]);
        ensure!(sent == crc(&upload.bytes), "CRC {sent:#06x}, expected {:#06x}", crc(&upload.bytes));
    }
    end_upload(rig)?;
    Ok(upload)
}

fn expect_text(rig: &mut Rig, upload: &Upload) -> Verdict {
    let text = upload_segments(rig, TEXT)?;
    ensure!(upload.bytes == text, "{} by blocks, {} by segments", hex(&upload.bytes), hex(&text));
    let size = upload.size;
    ensure!(size.is_none_or(|size| size == text.len()), "{size:?} bytes announced, {} sent", text.len());
    Ok(())
}

fn upload_whole(rig: &mut Rig) -> Verdict {
    let upload = whole_upload(rig, TEXT, true, 127)?;
    expect_text(rig, &upload)
}

fn upload_in_sub_blocks(rig: &mut Rig) -> Verdict {
    for size in [1, 3, 4] {
        let upload = whole_upload(rig, TEXT, true, size)?;
        expect_text(rig, &upload)?;
    }
    Ok(())
}

fn upload_repeated(rig: &mut Rig) -> Verdict {
    let mut upload = begin_upload(rig, TEXT, true, 4)?;
    let first = sub_block(rig, GO);
    ensure!(first.len() == 4, "{} segments of 4", first.len());
    // Acknowledges only the first two segments.
    let second = sub_block(rig, acknowledge(2, 4));
    ensure!(
        second.len() == 4 && second[0][0] == 1 && second[0][1..] == first[2][1..] && second[1][1..] == first[3][1..],
        "segments 3 and 4 were not sent again: {second:?}"
    );
    // Acknowledges no segment of the next sub-block.
    let third = sub_block(rig, acknowledge(0, 4));
    ensure!(third == second, "an unacknowledged sub-block was not sent again: {third:?}");
    for segment in first[..2].iter().chain(&third) {
        upload.bytes.extend(&segment[1..]);
    }
    let text = upload_segments(rig, TEXT)?;
    ensure!(text.starts_with(&upload.bytes), "{} does not begin the text", hex(&upload.bytes));
    Ok(())
}

fn upload_changed_size(rig: &mut Rig) -> Verdict {
    let mut upload = begin_upload(rig, TEXT, true, 1)?;
    collect(rig, &mut upload, 1, |size| size + 1)?;
    end_upload(rig)?;
    expect_text(rig, &upload)
}

fn upload_crc(rig: &mut Rig) -> Verdict {
    let upload = whole_upload(rig, TEXT, true, 20)?;
    ensure!(upload.server_crc, "the server has no CRC");
    expect_text(rig, &upload)
}

fn upload_without_crc(rig: &mut Rig) -> Verdict {
    let upload = whole_upload(rig, TEXT, false, 20)?;
    expect_text(rig, &upload)
}

fn upload_bad_size(rig: &mut Rig) -> Verdict {
    for size in [0, 128, 255] {
        let answer = initiate_upload(rig, TEXT, true, size, 0)?;
        aborted(&answer, TEXT, &[0x0504_0002], &format!("block size {size}"))?;
    }
    begin_upload(rig, TEXT, true, 4)?;
    sub_block(rig, GO);
    let answer = rig.transfer(acknowledge(4, 0))?;
    aborted(&answer, TEXT, &[0x0504_0002], "block size 0 in an acknowledgement")
}

fn upload_no_object(rig: &mut Rig) -> Verdict {
    for (address, code) in [((0x2001, 0), 0x0602_0000), ((0x1018, 5), 0x0609_0011)] {
        let answer = initiate_upload(rig, address, true, 10, 0)?;
        aborted(&answer, address, &[code], "block upload")?;
    }
    Ok(())
}

fn upload_no_switch(rig: &mut Rig) -> Verdict {
    let upload = whole_upload(rig, (0x1000, 0), true, 10)?;
    ensure!(upload.bytes == [0x92, 0x01, 0x02, 0x00], "{}", hex(&upload.bytes));
    // The protocol switch threshold exceeds the size of the object, so the server may answer with an ordinary upload.
    let answer = initiate_upload(rig, (0x1000, 0), true, 10, 100)?;
    let normal = answer == request(0x43, 0x1000, 0, [0x92, 0x01, 0x02, 0x00]);
    ensure!(normal || answer[0] & 0xF9 == 0xC0, "{}", hex(&answer));
    Ok(())
}

fn upload_abort(rig: &mut Rig) -> Verdict {
    begin_upload(rig, TEXT, true, 2)?;
    sub_block(rig, GO);
    let mark = rig.mark();
    rig.send(SDO_REQUEST, &request(0x80, TEXT.0, TEXT.1, [0, 0, 0, 8]));
    rig.pass(30);
    ensure!(rig.heard(mark, SDO_ANSWER).is_empty(), "an abort was answered");
    let upload = whole_upload(rig, TEXT, true, 127)?;
    expect_text(rig, &upload)
}

/// Deviations of a block download from a correct one.
#[derive(Clone, Copy, Default)]
struct Download {
    /// Announced size in place of the true one.
    size: Option<u32>,
    without_crc: bool,
    wrong_crc: bool,
    /// A segment of the first sub-block that is left out once.
    lost: Option<usize>,
}

/// Runs a block download and returns the answer to its end.
fn block_download(
    rig: &mut Rig,
    (index, subindex): (u16, u8),
    bytes: &[u8],
    how: Download,
) -> Result<[u8; 8], Deviation> {
    let size = how.size.unwrap_or(bytes.len() as u32);
    let command = 0xC2 | u8::from(!how.without_crc) << 2;
    let answer = rig.transfer(request(command, index, subindex, size.to_le_bytes()))?;
    ensure!(
        answer[0] & 0xFB == 0xA0 && answer[1..4] == multiplexer(index, subindex),
        "initiate of a block download: {}",
        hex(&answer)
    );
    let mut block = usize::from(answer[4]);
    let chunks: Vec<_> = bytes.chunks(7).collect();
    let mut sent = 0;
    let mut lost = how.lost;
    while sent < chunks.len() {
        ensure!((1..=127).contains(&block), "block size {block}");
        let count = block.min(chunks.len() - sent);
        let mark = rig.mark();
        for at in 0..count {
            let last = sent + at + 1 == chunks.len();
            let mut segment = [0; 8];
            segment[0] = (at + 1) as u8 | u8::from(last) << 7;
            segment[1..=chunks[sent + at].len()].copy_from_slice(chunks[sent + at]);
            if lost == Some(at) {
                continue;
            }
            rig.send(SDO_REQUEST, &segment);
            rig.pass(1);
        }
        let answer = rig.answer_after(mark).ok_or_else(|| Deviation(format!("no answer to a sub-block of {count}")))?;
        ensure!(answer[0] == 0xA2, "answer to a sub-block: {}", hex(&answer));
        let good = lost.take().unwrap_or(count);
        ensure!(usize::from(answer[1]) == good, "segment {} acknowledged, expected {good}", answer[1]);
        sent += good;
        block = usize::from(answer[2]);
    }
    let unused = (7 - bytes.len() % 7) % 7;
    let sum = crc(bytes) ^ u16::from(how.wrong_crc);
    let [low, high] = if how.without_crc { [0, 0] } else { sum.to_le_bytes() };
    rig.transfer([0xC1 | (unused as u8) << 2, low, high, 0, 0, 0, 0, 0])
}

fn pattern(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at * 29 + 3) as u8).collect()
}

fn expect_downloaded(rig: &mut Rig, bytes: &[u8], how: Download) -> Verdict {
    let answer = block_download(rig, DOMAIN, bytes, how)?;
    ensure!(answer[0] == 0xA1, "end of {} bytes: {}", bytes.len(), hex(&answer));
    let upload = whole_upload(rig, DOMAIN, true, 127)?;
    ensure!(upload.bytes == bytes, "{} of {} bytes read back", upload.bytes.len(), bytes.len());
    Ok(())
}

fn download_long(rig: &mut Rig) -> Verdict {
    expect_downloaded(rig, &pattern(1000), Download::default())
}

fn download_short(rig: &mut Rig) -> Verdict {
    for length in [1, 6, 7, 8] {
        expect_downloaded(rig, &pattern(length), Download::default())?;
    }
    Ok(())
}

fn download_lost_segment(rig: &mut Rig) -> Verdict {
    // The first, a middle and the last but one of 20 segments are lost.
    for lost in [0, 7, 18] {
        let how = Download { lost: Some(lost), ..Download::default() };
        expect_downloaded(rig, &pattern(140), how)?;
    }
    Ok(())
}

fn download_bad_crc(rig: &mut Rig) -> Verdict {
    expect_downloaded(rig, &pattern(20), Download::default())?;
    let how = Download { wrong_crc: true, ..Download::default() };
    let answer = block_download(rig, DOMAIN, &pattern(30), how)?;
    aborted(&answer, DOMAIN, &[0x0504_0004], "a wrong CRC")?;
    let upload = whole_upload(rig, DOMAIN, true, 127)?;
    ensure!(upload.bytes == pattern(20), "the refused data were taken");
    Ok(())
}

fn download_without_crc(rig: &mut Rig) -> Verdict {
    let how = Download { without_crc: true, ..Download::default() };
    expect_downloaded(rig, &pattern(50), how)
}

fn download_read_only(rig: &mut Rig) -> Verdict {
    let answer = rig.transfer(request(0xC6, 0x1008, 0, [5, 0, 0, 0]))?;
    aborted(&answer, (0x1008, 0), &[0x0601_0002], "block download to a constant")
}

fn download_wrong_size(rig: &mut Rig) -> Verdict {
    let how = Download { size: Some(40), ..Download::default() };
    let answer = block_download(rig, DOMAIN, &pattern(30), how)?;
    aborted(&answer, DOMAIN, &[0x0607_0010, 0x0607_0013], "30 bytes after 40 were announced")
}

fn download_number(rig: &mut Rig) -> Verdict {
    let answer = block_download(rig, (0x6081, 0), &0x0001_2345_u32.to_le_bytes(), Download::default())?;
    ensure!(answer[0] == 0xA1, "{}", hex(&answer));
    rig.expect(0x6081, 0, 0x0001_2345)
}
