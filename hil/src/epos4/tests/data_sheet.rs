//! The emulated drive compared with its data sheet.

use canopen::eds::{Access, DataType, Eds};

use super::*;

#[test]
fn the_device_is_what_its_data_sheet_says() {
    let sheet = Epos4::eds(&config());
    let mut bench = Bench::booted(config());
    let mut defaults = 0;
    for (object, variable) in sheet.variables() {
        let [low, high] = object.index.to_le_bytes();
        let address = format!("{low:02X}{high:02X}{:02X}", object.subindex);
        let answer = bench.ask(&format!("40{address}00000000"));
        if matches!(variable.data_type, DataType::VisibleString | DataType::Domain) {
            assert!(answer.starts_with("41"), "{object}: {answer}");
            continue;
        }
        let size = variable.data_type.size().unwrap();
        let specifier = format!("{:02X}", 0x43 | (4 - size) << 2);
        if object.index == 0x1003 && object.subindex > 0 {
            assert_eq!(answer, format!("80{address}24000008"), "no error yet");
        } else {
            assert_eq!(answer[..2], specifier, "{object}: {answer}");
        }
        if let Some(default) = &variable.default
            && answer[..2] == specifier
        {
            let bytes = default.encode(variable.data_type, config().node.unwrap()).unwrap();
            let bytes: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
            assert_eq!(answer[8..8 + 2 * size], bytes, "{object}");
            defaults += 1;
        }
    }
    assert!(defaults > 150, "{defaults}");
    for (object, variable) in sheet.variables() {
        let Some(size) = variable.data_type.size() else {
            continue;
        };
        let [low, high] = object.index.to_le_bytes();
        let address = format!("{low:02X}{high:02X}{:02X}", object.subindex);
        let specifier = 0x23 | (4 - size) << 2;
        let refused = bench.ask(&format!("{specifier:02X}{address}FFFFFFFF"));
        let read_only = refused == format!("80{address}02000106");
        assert_eq!(read_only, variable.access == Access::ReadOnly, "{object}: {refused}");
    }
}

#[test]
fn the_data_sheet_reads_back_whole_and_every_object_has_a_name() {
    let sheet = Epos4::eds(&config());
    assert_eq!(Eds::read(sheet.to_string().as_bytes()), Ok(sheet.clone()));
    for (object, variable) in sheet.variables() {
        assert!(!variable.name.starts_with("Object "), "{object}");
    }
    let identity = [1, 2, 3, 4].map(|subindex| sheet.identity(subindex));
    assert_eq!(identity, [Some(0xFB), Some(0x6150_0000), Some(0x0170_0000), None]);
}

#[test]
fn rpdos_are_filled_by_the_dummies_of_the_data_sheet() {
    let sheet = Epos4::eds(&config());
    let mut bench = Bench::booted(config());
    // The second RPDO is switched off by default. Its count has to be 0 before its mapping can change.
    assert_eq!(bench.ask("2F01160000000000"), "6001160000000000");
    for (index, usable) in (1..).zip(sheet.dummies) {
        let bits = [1, 8, 16, 32, 8, 16, 32][index - 1];
        let answer = bench.ask(&format!("23011601{bits:02X}00{index:02X}00"));
        let taken = answer == "6001160100000000";
        assert_eq!(taken, usable, "dummy {index}: {answer}");
        // The size of a dummy entry must equal the size of its data type.
        let answer = bench.ask(&format!("23011601{:02X}00{index:02X}00", bits + 8));
        assert_eq!(answer, "8001160141000406", "dummy {index}");
    }
    assert_eq!(sheet.dummies, [false, true, true, true, true, true, true]);
}

#[test]
fn what_cannot_be_written_is_refused_before_its_data_come() {
    let mut bench = Bench::booted(config());
    for (request, refusal) in [
        // In segments and by blocks: a read-only object, and an unknown object.
        ("2108100014000000", "8008100002000106"),
        ("C608100014000000", "8008100002000106"),
        ("2100200014000000", "8000200000000206"),
        ("C600200014000000", "8000200000000206"),
    ] {
        assert_eq!(bench.ask(request), refusal, "{request}");
    }
}
