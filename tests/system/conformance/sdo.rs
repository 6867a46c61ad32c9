//! Claims about the SDO server: expedited and segmented transfers, aborts, and frames that are not requests.

use super::rig::{
    Deviation, NODE, Rig, SDO_ANSWER, SDO_REQUEST, Verdict, aborted, download_request, ensure, hex, multiplexer,
    request,
};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "sdo-upload-expedited",
        "7.2.4.3.6",
        ("SDO upload initiate", &[]),
        "values of 1, 2 and 4 bytes come expedited with their size",
        upload_expedited,
    ),
    CIA_301.row(
        "sdo-upload-segmented",
        "7.2.4.3.7",
        ("SDO upload segment", &[]),
        "a text comes in segments of 7 bytes with toggle, size and last-segment flag",
        upload_segmented,
    ),
    CIA_301.row(
        "sdo-upload-short",
        "7.2.4.3.7",
        ("SDO upload segment", &[0x1008]),
        "a text of 5 bytes comes in one segment that names its unused bytes",
        upload_one_segment,
    ),
    CIA_301.row(
        "sdo-download-expedited",
        "7.2.4.3.3",
        ("SDO download initiate", &[]),
        "values of 1, 2 and 4 bytes are taken expedited with their size",
        download_expedited,
    ),
    CIA_301.row(
        "sdo-download-unsized",
        "7.2.4.3.3",
        ("SDO download initiate", &[]),
        "an expedited download without a size is taken in the length of the entry",
        download_unsized,
    ),
    CIA_301.row(
        "sdo-download-unused",
        "7.2.4.3.3",
        ("SDO download initiate", &[]),
        "unused bytes of an expedited download are ignored",
        download_unused_bytes,
    ),
    CIA_301.row(
        "sdo-download-segmented",
        "7.2.4.3.4",
        ("SDO download segment", &[]),
        "20 bytes are taken in three segments and read back",
        download_segmented,
    ),
    CIA_301.row(
        "sdo-download-segmented-number",
        "7.2.4.3.4",
        ("SDO download segment", &[]),
        "a number is taken in one segment too",
        download_segmented_number,
    ),
    CIA_301.row(
        "sdo-download-segmented-unsized",
        "7.2.4.3.3",
        ("SDO download initiate", &[]),
        "a segmented download need not announce its size",
        download_segmented_unsized,
    ),
    CIA_301.row(
        "sdo-late-effect",
        "7.2.4.3.4",
        ("SDO download segment", &[]),
        "a segmented download takes effect with its last segment, not before",
        effect_at_the_end,
    ),
    CIA_301.row(
        "sdo-toggle-upload",
        "7.2.4.3.7",
        ("SDO upload segment", &[]),
        "a toggle bit that does not alternate is refused with 05030000",
        toggle_upload,
    ),
    CIA_301.row(
        "sdo-toggle-download",
        "7.2.4.3.4",
        ("SDO download segment", &[]),
        "a toggle bit that does not alternate is refused with 05030000",
        toggle_download,
    ),
    CIA_301.row(
        "sdo-toggle-restart",
        "7.2.4.3.7",
        ("SDO upload segment", &[]),
        "the toggle bit begins with 0 in each transfer",
        toggle_restart,
    ),
    CIA_301.row(
        "sdo-excess",
        "7.2.4.3.4",
        ("SDO download segment", &[]),
        "more bytes than announced are refused with 06070010 or 06070012",
        excess,
    ),
    CIA_301.row(
        "sdo-shortfall",
        "7.2.4.3.4",
        ("SDO download segment", &[]),
        "fewer bytes than announced are refused with 06070010 or 06070013",
        shortfall,
    ),
    CIA_301.row(
        "sdo-unknown-command",
        "7.2.4.3.17",
        ("SDO abort transfer", &[]),
        "an unknown command specifier is refused with 05040001",
        unknown_command,
    ),
    CIA_301.row(
        "sdo-stray-segment",
        "7.2.4.3.17",
        ("SDO abort transfer", &[]),
        "a segment without a transfer is refused with 05040001",
        stray_segment,
    ),
    CIA_301.row(
        "sdo-client-abort",
        "7.2.4.3.17",
        ("SDO abort transfer", &[]),
        "an abort of the client ends the transfer and is not answered",
        client_abort,
    ),
    CIA_301.row(
        "sdo-new-transfer",
        "7.2.4.3.3",
        ("SDO download initiate", &[]),
        "a new request in the middle of a transfer is served",
        new_transfer,
    ),
    CIA_301.row(
        "sdo-refused-unchanged",
        "7.2.4.3.17",
        ("SDO abort transfer", &[]),
        "a refused download leaves the value as it was",
        refused_unchanged,
    ),
    CIA_301.row(
        "sdo-answer-frame",
        "7.2.4.3",
        ("SDO protocols", &[0x1200]),
        "every answer has 8 bytes and 0x580 + node-ID; a request has one answer",
        answer_frame,
    ),
    CIA_301.row(
        "sdo-short-request",
        "7.2.4.3",
        ("SDO protocols", &[]),
        "a request of fewer than 8 bytes writes nothing",
        short_request,
    ),
    CIA_301.row(
        "sdo-other-node",
        "7.2.4.3",
        ("SDO protocols", &[]),
        "requests to other nodes, remote frames and 29-bit identifiers are not answered",
        other_node,
    ),
];

/// A visible string of the emulator that is longer than one segment.
const TEXT: (u16, u8) = (0x2FF0, 1);

/// A domain of the emulator, which accepts any bytes.
const DOMAIN: (u16, u8) = (0x2FF0, 2);

/// Makes a segmented upload and returns the bytes.
pub(super) fn upload_segments(rig: &mut Rig, (index, subindex): (u16, u8)) -> Result<Vec<u8>, Deviation> {
    let answer = rig.transfer(request(0x40, index, subindex, [0; 4]))?;
    ensure!(
        answer[0] == 0x41 && answer[1..4] == multiplexer(index, subindex),
        "initiate of a segmented upload: {}",
        hex(&answer)
    );
    let size = u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]]) as usize;
    let mut bytes = Vec::new();
    for round in 0..1000 {
        let toggle = (round as u8 & 1) << 4;
        let segment = rig.transfer([0x60 | toggle, 0, 0, 0, 0, 0, 0, 0])?;
        ensure!(segment[0] & 0xF0 == toggle, "segment {round}: {}", hex(&segment));
        let unused = usize::from(segment[0] >> 1 & 7);
        bytes.extend(&segment[1..8 - unused]);
        if segment[0] & 1 == 1 {
            ensure!(bytes.len() == size, "{} bytes in segments, {size} announced", bytes.len());
            return Ok(bytes);
        }
        ensure!(unused == 0, "unused bytes in segment {round}, which is not the last");
    }
    Err(Deviation("no last segment".to_owned()))
}

/// The segments of a download, each with its command byte.
fn segments(bytes: &[u8]) -> Vec<[u8; 8]> {
    let count = bytes.len().div_ceil(7);
    bytes
        .chunks(7)
        .enumerate()
        .map(|(at, chunk)| {
            let mut segment = [0; 8];
            let last = u8::from(at + 1 == count);
            segment[0] = (at as u8 & 1) << 4 | (7 - chunk.len() as u8) << 1 | last;
            segment[1..=chunk.len()].copy_from_slice(chunk);
            segment
        })
        .collect()
}

fn download_segments(rig: &mut Rig, (index, subindex): (u16, u8), bytes: &[u8], sized: bool) -> Verdict {
    let size = if sized { bytes.len() as u32 } else { 0 };
    let answer = rig.transfer(request(0x20 | u8::from(sized), index, subindex, size.to_le_bytes()))?;
    ensure!(answer == request(0x60, index, subindex, [0; 4]), "initiate: {}", hex(&answer));
    for (at, segment) in segments(bytes).into_iter().enumerate() {
        let answer = rig.transfer(segment)?;
        let expected = [0x20 | (at as u8 & 1) << 4, 0, 0, 0, 0, 0, 0, 0];
        ensure!(answer == expected, "segment {at}: {}", hex(&answer));
    }
    Ok(())
}

fn pattern(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at * 37 + 11) as u8).collect()
}

fn upload_expedited(rig: &mut Rig) -> Verdict {
    for (index, subindex, answer) in [
        (0x1001, 0, "4F0110000"),
        (0x1017, 0, "4B1710000"),
        (0x1000, 0, "4300100092010200"),
        (0x1018, 1, "43181001FB000000"),
    ] {
        let found = rig.transfer(request(0x40, index, subindex, [0; 4]))?;
        ensure!(hex(&found).starts_with(answer), "{index:#06x}: {}, expected {answer}", hex(&found));
    }
    Ok(())
}

fn upload_segmented(rig: &mut Rig) -> Verdict {
    let bytes = upload_segments(rig, TEXT)?;
    ensure!(bytes.len() > 14 && bytes.iter().all(|byte| (0x20..0x7F).contains(byte)), "{}", hex(&bytes));
    Ok(())
}

fn upload_one_segment(rig: &mut Rig) -> Verdict {
    let bytes = upload_segments(rig, (0x1008, 0))?;
    ensure!(bytes == b"EPOS4", "{}", hex(&bytes));
    Ok(())
}

fn download_expedited(rig: &mut Rig) -> Verdict {
    for (index, subindex, value, bytes) in
        [(0x60C2, 1, 7, 1), (0x1017, 0, 0x1234, 2), (0x6081, 0, 0x1234, 4), (0x607A, 0, -7, 4)]
    {
        rig.write(index, subindex, value, bytes)?;
        let found = rig.upload(index, subindex)?;
        ensure!(found == value.to_le_bytes()[..bytes], "{index:#06x} is {}", hex(&found));
    }
    Ok(())
}

fn download_unsized(rig: &mut Rig) -> Verdict {
    for (index, subindex, value) in [(0x60C2, 1, 9), (0x1017, 0, 0x0123), (0x6081, 0, 0x0001_2345_u32)] {
        let answer = rig.transfer(request(0x22, index, subindex, value.to_le_bytes()))?;
        ensure!(answer == request(0x60, index, subindex, [0; 4]), "{index:#06x}: {}", hex(&answer));
        rig.expect(index, subindex, value)?;
    }
    Ok(())
}

fn download_unused_bytes(rig: &mut Rig) -> Verdict {
    let answer = rig.transfer(request(0x2B, 0x1017, 0, [0x64, 0x00, 0xDE, 0xAD]))?;
    ensure!(answer[0] == 0x60, "{}", hex(&answer));
    rig.expect(0x1017, 0, 100)
}

fn download_segmented(rig: &mut Rig) -> Verdict {
    for length in [20, 14, 8, 100] {
        let bytes = pattern(length);
        download_segments(rig, DOMAIN, &bytes, true)?;
        let found = upload_segments(rig, DOMAIN)?;
        ensure!(found == bytes, "{} read back, expected {}", hex(&found), hex(&bytes));
    }
    Ok(())
}

fn download_segmented_number(rig: &mut Rig) -> Verdict {
    download_segments(rig, (0x6081, 0), &0x0102_0304_u32.to_le_bytes(), true)?;
    rig.expect(0x6081, 0, 0x0102_0304)
}

fn download_segmented_unsized(rig: &mut Rig) -> Verdict {
    let bytes = pattern(17);
    download_segments(rig, DOMAIN, &bytes, false)?;
    let found = upload_segments(rig, DOMAIN)?;
    ensure!(found == bytes, "{} read back", hex(&found));
    download_segments(rig, (0x6081, 0), &77_u32.to_le_bytes(), false)?;
    rig.expect(0x6081, 0, 77)
}

fn effect_at_the_end(rig: &mut Rig) -> Verdict {
    download_segments(rig, DOMAIN, b"as it was before", true)?;
    let (index, subindex) = DOMAIN;
    rig.transfer(request(0x21, index, subindex, [20, 0, 0, 0]))?;
    rig.transfer([0x00, 1, 2, 3, 4, 5, 6, 7])?;
    rig.send(SDO_REQUEST, &request(0x80, index, subindex, [0, 0, 0, 8]));
    rig.pass(5);
    let found = upload_segments(rig, DOMAIN)?;
    ensure!(found == b"as it was before", "{} after an aborted download", hex(&found));
    Ok(())
}

fn toggle_upload(rig: &mut Rig) -> Verdict {
    let (index, subindex) = TEXT;
    for repeated in [[0x70].as_slice(), &[0x60, 0x60]] {
        rig.transfer(request(0x40, index, subindex, [0; 4]))?;
        let mut answer = [0; 8];
        for &command in repeated {
            answer = rig.transfer([command, 0, 0, 0, 0, 0, 0, 0])?;
        }
        aborted(&answer, TEXT, &[0x0503_0000], "repeated toggle")?;
        // The transfer has ended.
        let answer = rig.transfer([0x70, 0, 0, 0, 0, 0, 0, 0])?;
        ensure!(answer[0] == 0x80, "the transfer goes on after its abort: {}", hex(&answer));
    }
    Ok(())
}

fn toggle_download(rig: &mut Rig) -> Verdict {
    let (index, subindex) = DOMAIN;
    for repeated in [[0x10].as_slice(), &[0x00, 0x00]] {
        rig.transfer(request(0x21, index, subindex, [20, 0, 0, 0]))?;
        let mut answer = [0; 8];
        for &command in repeated {
            answer = rig.transfer([command, 1, 2, 3, 4, 5, 6, 7])?;
        }
        aborted(&answer, DOMAIN, &[0x0503_0000], "repeated toggle")?;
    }
    Ok(())
}

fn toggle_restart(rig: &mut Rig) -> Verdict {
    let (index, subindex) = TEXT;
    rig.transfer(request(0x40, index, subindex, [0; 4]))?;
    rig.transfer([0x60, 0, 0, 0, 0, 0, 0, 0])?;
    // The transfer was interrupted at a point at which toggle bit 1 would be next.
    upload_segments(rig, TEXT).map(drop)
}

fn excess(rig: &mut Rig) -> Verdict {
    let (index, subindex) = DOMAIN;
    rig.transfer(request(0x21, index, subindex, [8, 0, 0, 0]))?;
    rig.transfer([0x00, 1, 2, 3, 4, 5, 6, 7])?;
    let answer = rig.transfer([0x10 | 1, 1, 2, 3, 4, 5, 6, 7])?;
    aborted(&answer, DOMAIN, &[0x0607_0010, 0x0607_0012], "14 bytes after 8 were announced")
}

fn shortfall(rig: &mut Rig) -> Verdict {
    let (index, subindex) = DOMAIN;
    rig.transfer(request(0x21, index, subindex, [20, 0, 0, 0]))?;
    let answer = rig.transfer([0x01, 1, 2, 3, 4, 5, 6, 7])?;
    aborted(&answer, DOMAIN, &[0x0607_0010, 0x0607_0013], "7 bytes after 20 were announced")
}

fn unknown_command(rig: &mut Rig) -> Verdict {
    let answer = rig.transfer(request(0xE0, 0x1000, 0, [0; 4]))?;
    let code = u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]]);
    ensure!(answer[0] == 0x80 && code == 0x0504_0001, "{}", hex(&answer));
    Ok(())
}

fn stray_segment(rig: &mut Rig) -> Verdict {
    for command in [0x60, 0x70, 0x00, 0x11] {
        let answer = rig.transfer([command, 0, 0, 0, 0, 0, 0, 0])?;
        let code = u32::from_le_bytes([answer[4], answer[5], answer[6], answer[7]]);
        ensure!(answer[0] == 0x80 && code == 0x0504_0001, "{command:02X}: {}", hex(&answer));
    }
    Ok(())
}

fn client_abort(rig: &mut Rig) -> Verdict {
    let (index, subindex) = TEXT;
    rig.transfer(request(0x40, index, subindex, [0; 4]))?;
    let mark = rig.mark();
    rig.send(SDO_REQUEST, &request(0x80, index, subindex, [0, 0, 0, 8]));
    rig.pass(20);
    ensure!(rig.heard(mark, SDO_ANSWER).is_empty(), "an abort was answered");
    let answer = rig.transfer([0x60, 0, 0, 0, 0, 0, 0, 0])?;
    ensure!(answer[0] == 0x80, "the transfer goes on after its abort: {}", hex(&answer));
    upload_segments(rig, TEXT).map(drop)
}

fn new_transfer(rig: &mut Rig) -> Verdict {
    let (index, subindex) = TEXT;
    rig.transfer(request(0x40, index, subindex, [0; 4]))?;
    rig.transfer([0x60, 0, 0, 0, 0, 0, 0, 0])?;
    rig.write(0x6081, 0, 4321, 4)?;
    rig.expect(0x6081, 0, 4321)?;
    let (index, subindex) = DOMAIN;
    rig.transfer(request(0x21, index, subindex, [20, 0, 0, 0]))?;
    upload_segments(rig, TEXT).map(drop)
}

fn refused_unchanged(rig: &mut Rig) -> Verdict {
    rig.write(0x1029, 1, 1, 1)?;
    rig.refuse((0x1029, 1), 3, 1, &[0x0609_0030, 0x0609_0031])?;
    rig.expect(0x1029, 1, 1)
}

fn answer_frame(rig: &mut Rig) -> Verdict {
    for request in
        [request(0x40, 0x1000, 0, [0; 4]), request(0x40, 0x1002, 0, [0; 4]), download_request(0x1017, 0, 0, 2)]
    {
        let mark = rig.mark();
        rig.send(SDO_REQUEST, &request);
        rig.pass(50);
        let all = rig.all_heard(mark);
        let answers = rig.heard(mark, 0x580 + u16::from(NODE));
        ensure!(
            all.len() == 1 && answers.len() == 1 && answers[0].data.len() == 8,
            "answers to {}: {all:?}",
            hex(&request)
        );
    }
    Ok(())
}

fn short_request(rig: &mut Rig) -> Verdict {
    let whole = download_request(0x6081, 0, 4321, 4);
    for length in [0, 1, 4, 7] {
        rig.send(SDO_REQUEST, &whole[..length]);
        rig.pass(20);
    }
    rig.expect(0x6081, 0, 1000)
}

fn other_node(rig: &mut Rig) -> Verdict {
    let upload = request(0x40, 0x1000, 0, [0; 4]);
    let mark = rig.mark();
    for id in [0x600, SDO_REQUEST - 1, SDO_REQUEST + 1, 0x67F, SDO_ANSWER] {
        rig.send(id, &upload);
        rig.pass(5);
    }
    rig.send_extended(u32::from(SDO_REQUEST), &upload);
    rig.send_remote(SDO_REQUEST, 8);
    rig.pass(20);
    let heard = rig.all_heard(mark);
    ensure!(heard.is_empty(), "{heard:?}");
    rig.expect(0x1018, 1, 0xFB)
}
