//! Claims about the object dictionary: entries, types, access, defaults and constant objects.

use canopen::eds::{Access, DataType, Eds, Variable};
use canopen::{NodeId, Object};
use kit::mrroc::root;

use super::rig::{Deviation, NODE, Rig, Verdict, aborted, download_request, ensure, hex, request};
use super::{CIA_301, CIA_402_2, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "od-upload",
        "7.4",
        ("Every entry of the data sheet", &[]),
        "an upload returns a value of the declared length",
        uploads,
    ),
    CIA_301.row(
        "od-default",
        "7.4",
        ("Every entry of the data sheet", &[]),
        "a fresh drive has the declared default",
        defaults,
    ),
    CIA_301.row("od-read-only", "7.4", ("Every ro entry", &[]), "a download is refused with 06010002", read_only),
    CIA_301.row(
        "od-writable",
        "7.4",
        ("Every rw entry outside PDOs", &[]),
        "a download of the present value is taken",
        writable,
    ),
    CIA_301.row(
        "od-too-long",
        "7.2.4.3.17",
        ("Every rw entry", &[]),
        "a download of one byte too many is refused with 06070010 or 06070012",
        too_long,
    ),
    CIA_301.row(
        "od-too-short",
        "7.2.4.3.17",
        ("Every rw entry", &[]),
        "a download of one byte too few is refused with 06070010 or 06070013",
        too_short,
    ),
    CIA_301.row(
        "od-limits",
        "7.2.4.3.17",
        ("Every entry with limits", &[]),
        "a value beyond the declared limits is refused with 06090030 to 06090032",
        limits,
    ),
    CIA_301.row(
        "od-no-object",
        "7.2.4.3.17",
        ("Absent objects", &[]),
        "upload and download are refused with 06020000",
        no_object,
    ),
    CIA_301.row(
        "od-no-subindex",
        "7.2.4.3.17",
        ("Absent sub-indices", &[]),
        "upload and download are refused with 06090011",
        no_subindex,
    ),
    CIA_301.row(
        "od-highest-subindex",
        "7.4",
        ("Every array and record", &[]),
        "sub-index 0 is the highest sub-index of the data sheet",
        highest_subindex,
    ),
    CIA_301.row(
        "od-device-type",
        "7.5.2.1",
        ("Device type", &[0x1000]),
        "the lower word is 402, the upper one a servo drive, and the object is constant",
        device_type,
    ),
    CIA_301.row(
        "od-error-register",
        "7.5.2.2",
        ("Error register", &[0x1001]),
        "0 in a drive without errors, and read-only",
        error_register,
    ),
    CIA_301.row("od-sync-cob-id", "7.5.2.5", ("COB-ID SYNC", &[0x1005]), "0x80, no producer, constant", sync_cob_id),
    CIA_301.row(
        "od-device-name",
        "7.5.2.8",
        ("Manufacturer device name", &[0x1008]),
        "a constant visible string",
        device_name,
    ),
    CIA_301.row(
        "od-emcy-cob-id",
        "7.5.2.17",
        ("COB-ID EMCY", &[0x1014]),
        "0x80 + node-ID, valid, constant",
        emcy_cob_id,
    ),
    CIA_301.row(
        "od-identity",
        "7.5.2.21",
        ("Identity object", &[0x1018]),
        "four constant entries, the vendor-ID among them",
        identity,
    ),
    CIA_301.row(
        "od-sdo-server",
        "7.5.2.33",
        ("SDO server parameter", &[0x1200]),
        "0x600 and 0x580 + node-ID, constant",
        sdo_server,
    ),
    CIA_402_2.row(
        "od-supported-modes",
        "",
        ("Supported drive modes", &[0x6502]),
        "pp, pv, hm, csp, csv, cst and no further mode; constant",
        supported_modes,
    ),
    CIA_402_2.row(
        "od-units",
        "",
        ("SI units", &[0x60A8, 0x60A9, 0x60AA]),
        "increments, revolutions per minute, revolutions per minute and second",
        units,
    ),
    CIA_402_2.row("od-profile-type", "", ("Motion profile type", &[0x6086]), "the linear ramp alone", profile_type),
];

/// The data sheet with the claims.
pub(super) fn sheet() -> Eds {
    let sheet = std::fs::read(root().join("cells/epos4-emulated.eds")).expect("the data sheet is there");
    Eds::read(&sheet).expect("the data sheet is readable")
}

/// Entries with a fixed length, and the length in bytes.
fn sized(sheet: &Eds) -> impl Iterator<Item = (Object, &Variable, usize)> {
    sheet.variables().filter_map(|(object, variable)| Some((object, variable, variable.data_type.size()?)))
}

fn is_pdo_parameter(index: u16) -> bool {
    (0x1400..0x1C00).contains(&index)
}

/// Entries of 0x1003 above the present count have no data.
fn is_empty_history(object: Object) -> bool {
    object.index == 0x1003 && object.subindex > 0
}

fn uploads(rig: &mut Rig) -> Verdict {
    for (object, variable) in sheet().variables() {
        let (index, subindex) = (object.index, object.subindex);
        if is_empty_history(object) {
            continue;
        }
        match variable.data_type.size() {
            Some(size) => {
                let value = rig.upload(index, subindex)?;
                ensure!(value.len() == size, "{index:#06x}:{subindex:02x} has {} bytes, expected {size}", value.len());
            }
            None => {
                let answer = rig.transfer(request(0x40, index, subindex, [0; 4]))?;
                ensure!(answer[0] >> 5 == 2, "{index:#06x}:{subindex:02x}: {}", hex(&answer));
                // Ends the segmented upload.
                rig.send(0x600 + u16::from(NODE), &request(0x80, index, subindex, [0, 0, 4, 5]));
                rig.pass(2);
            }
        }
    }
    Ok(())
}

fn defaults(rig: &mut Rig) -> Verdict {
    let node = NodeId::new(NODE).expect("a node-ID");
    let mut compared = 0;
    for (object, variable, _) in sized(&sheet()) {
        let Some(default) = &variable.default else {
            continue;
        };
        // Data of motor and encoder differ between the axis of the sheet and the axis of the rig.
        if is_empty_history(object) || (0x3000..0x3002).contains(&object.index) {
            continue;
        }
        let expected = default
            .encode(variable.data_type, node)
            .ok_or_else(|| Deviation(format!("{object}: the default does not fit its type")))?;
        let found = rig.upload(object.index, object.subindex)?;
        ensure!(found == expected, "{object} is {}, expected {}", hex(&found), hex(&expected));
        compared += 1;
    }
    ensure!(compared > 150, "{compared} defaults compared");
    Ok(())
}

fn read_only(rig: &mut Rig) -> Verdict {
    for (object, variable, size) in sized(&sheet()) {
        if matches!(variable.access, Access::ReadOnly | Access::Const) {
            rig.refuse((object.index, object.subindex), 0, size, &[0x0601_0002])?;
        }
    }
    Ok(())
}

fn writable(rig: &mut Rig) -> Verdict {
    for (object, variable, size) in sized(&sheet()) {
        let commands = matches!(object.index, 0x1003 | 0x1010 | 0x1011);
        if matches!(variable.access, Access::ReadOnly | Access::Const) || commands || is_pdo_parameter(object.index) {
            continue;
        }
        let value = rig.read(object.index, object.subindex)?;
        rig.write(object.index, object.subindex, i64::from(value), size)?;
    }
    Ok(())
}

/// Writes values of a wrong length to all writable entries except those whose values are commands.
fn wrong_length(rig: &mut Rig, length: impl Fn(usize) -> usize, codes: &[u32]) -> Verdict {
    for (object, variable, size) in sized(&sheet()) {
        if matches!(variable.access, Access::ReadOnly | Access::Const) {
            continue;
        }
        let address = (object.index, object.subindex);
        let wrong = length(size);
        let before = rig.ask(request(0x40, object.index, object.subindex, [0; 4]));
        if (1..=4).contains(&wrong) {
            rig.refuse(address, 0, wrong, codes)?;
        } else if wrong > 4 {
            let answer = rig.transfer(request(0x21, object.index, object.subindex, [wrong as u8, 0, 0, 0]))?;
            // A server may also detect the excess length in the segments.
            let answer = if answer[0] == 0x60 { rig.transfer([0x05, 0, 0, 0, 0, 0, 0, 0])? } else { answer };
            aborted(&answer, address, codes, &format!("segmented download of {wrong} bytes to {object}"))?;
        }
        let after = rig.ask(request(0x40, object.index, object.subindex, [0; 4]));
        ensure!(before == after, "{object} changed by a refused download");
    }
    Ok(())
}

fn too_long(rig: &mut Rig) -> Verdict {
    wrong_length(rig, |size| size + 1, &[0x0607_0010, 0x0607_0012])
}

fn too_short(rig: &mut Rig) -> Verdict {
    wrong_length(rig, |size| size - 1, &[0x0607_0010, 0x0607_0013])
}

fn limits(rig: &mut Rig) -> Verdict {
    let node = NodeId::new(NODE).expect("a node-ID");
    let mut tried = 0;
    for (object, variable, size) in sized(&sheet()) {
        // Mapping counts are refused while their PDO is valid; the claim `pdo-count-too-high` checks their limit.
        if is_pdo_parameter(object.index) {
            continue;
        }
        let range = 1_i128 << (8 * size);
        let signed = matches!(variable.data_type, DataType::Integer8 | DataType::Integer16 | DataType::Integer32);
        let (least, most) = if signed { (-range / 2, range / 2 - 1) } else { (0, range - 1) };
        let beyond = [(&variable.low, -1, 0x0609_0032), (&variable.high, 1, 0x0609_0031)];
        for (limit, step, code) in beyond {
            let Some(limit) = limit.as_ref().and_then(|limit| limit.integer(node)) else {
                continue;
            };
            let value = limit + step;
            if value < least || value > most {
                continue;
            }
            let value = i64::try_from(value).expect("at most 32 bits");
            rig.refuse((object.index, object.subindex), value, size, &[0x0609_0030, code])?;
            tried += 1;
        }
    }
    ensure!(tried >= 15, "{tried} limits tried");
    Ok(())
}

fn no_object(rig: &mut Rig) -> Verdict {
    for index in
        [0x0000_u16, 0x1002, 0x1007, 0x100C, 0x1012, 0x1019, 0x1404, 0x1804, 0x2001, 0x6001, 0x6042, 0x6502 + 1, 0xFFFF]
    {
        for subindex in [0, 1] {
            let answer = rig.transfer(request(0x40, index, subindex, [0; 4]))?;
            aborted(&answer, (index, subindex), &[0x0602_0000], &format!("upload of {index:#06x}:{subindex:02x}"))?;
            rig.refuse((index, subindex), 0, 1, &[0x0602_0000])?;
        }
    }
    Ok(())
}

fn no_subindex(rig: &mut Rig) -> Verdict {
    for (&index, entry) in &sheet().objects {
        let highest = *entry.variables.keys().last().expect("an object has an entry");
        let absent = (1..=highest).filter(|subindex| !entry.variables.contains_key(subindex));
        for subindex in absent.chain([highest + 1, 0xFE]) {
            let answer = rig.transfer(request(0x40, index, subindex, [0; 4]))?;
            aborted(&answer, (index, subindex), &[0x0609_0011], &format!("upload of {index:#06x}:{subindex:02x}"))?;
            rig.refuse((index, subindex), 0, 1, &[0x0609_0011])?;
        }
    }
    Ok(())
}

fn highest_subindex(rig: &mut Rig) -> Verdict {
    for (&index, entry) in &sheet().objects {
        // 0x1003:00 counts errors, 0x16xx:00 and 0x1Axx:00 count mapped objects.
        let counts = index == 0x1003 || (0x1600..0x1800).contains(&index) || (0x1A00..0x1C00).contains(&index);
        if entry.variables.len() > 1 && !counts {
            let highest = *entry.variables.keys().last().expect("an object has an entry");
            rig.expect(index, 0, u32::from(highest))?;
        }
    }
    Ok(())
}

/// Expects a constant: the value is `value`, and no download changes it.
fn constant(rig: &mut Rig, index: u16, subindex: u8, value: u32) -> Verdict {
    rig.expect(index, subindex, value)?;
    rig.refuse((index, subindex), i64::from(value) + 1, 4, &[0x0601_0002])?;
    rig.expect(index, subindex, value)
}

fn device_type(rig: &mut Rig) -> Verdict {
    let value = rig.read(0x1000, 0)?;
    ensure!(value & 0xFFFF == 402, "device profile {}", value & 0xFFFF);
    ensure!(value >> 16 & 0xFF == 0x02, "type {:#04x}, expected a servo drive", value >> 16 & 0xFF);
    constant(rig, 0x1000, 0, value)
}

fn error_register(rig: &mut Rig) -> Verdict {
    rig.expect(0x1001, 0, 0)?;
    rig.refuse((0x1001, 0), 1, 1, &[0x0601_0002])
}

fn sync_cob_id(rig: &mut Rig) -> Verdict {
    constant(rig, 0x1005, 0, 0x80)
}

fn device_name(rig: &mut Rig) -> Verdict {
    let answer = rig.transfer(request(0x40, 0x1008, 0, [0; 4]))?;
    ensure!(answer[..4] == [0x41, 0x08, 0x10, 0], "{}", hex(&answer));
    let size = usize::from(answer[4]);
    let segment = rig.transfer([0x60, 0, 0, 0, 0, 0, 0, 0])?;
    let text = &segment[1..=size.min(7)];
    ensure!(
        size == text.len() && text.iter().all(|&byte| (0x20..0x7F).contains(&byte)),
        "{size} bytes: {}",
        hex(&segment)
    );
    let answer = rig.transfer(download_request(0x1008, 0, 0x4141, 2))?;
    aborted(&answer, (0x1008, 0), &[0x0601_0002], "download of a device name")
}

fn emcy_cob_id(rig: &mut Rig) -> Verdict {
    constant(rig, 0x1014, 0, 0x80 + u32::from(NODE))
}

fn identity(rig: &mut Rig) -> Verdict {
    rig.expect(0x1018, 0, 4)?;
    rig.expect(0x1018, 1, 0x0000_00FB)?;
    for subindex in 1..=4 {
        let value = rig.read(0x1018, subindex)?;
        ensure!(value != 0, "0x1018:{subindex:02x} is 0, a reserved value");
        constant(rig, 0x1018, subindex, value)?;
    }
    Ok(())
}

fn sdo_server(rig: &mut Rig) -> Verdict {
    rig.expect(0x1200, 0, 2)?;
    constant(rig, 0x1200, 1, 0x600 + u32::from(NODE))?;
    constant(rig, 0x1200, 2, 0x580 + u32::from(NODE))
}

fn supported_modes(rig: &mut Rig) -> Verdict {
    // Bits 0 pp, 2 pv, 5 hm, 7 csp, 8 csv, 9 cst.
    constant(rig, 0x6502, 0, 1 | 1 << 2 | 1 << 5 | 1 << 7 | 1 << 8 | 1 << 9)
}

fn units(rig: &mut Rig) -> Verdict {
    // Prefix, numerator, denominator, reserved: 0xB5 increments, 0xB4 revolutions, 0x47 minutes, 0xC0 rpm, 0x03
    // seconds.
    rig.expect(0x60A8, 0, 0x00B5_0000)?;
    rig.expect(0x60A9, 0, 0x00B4_4700)?;
    rig.expect(0x60AA, 0, 0x00C0_0300)
}

fn profile_type(rig: &mut Rig) -> Verdict {
    rig.write(0x6086, 0, 0, 2)?;
    for value in [1, 2, 3, -1] {
        rig.refuse((0x6086, 0), value, 2, &[0x0609_0030, 0x0609_0031, 0x0609_0032])?;
    }
    rig.expect(0x6086, 0, 0)
}
