//! Refusals of device configuration files: all reasons at once, grouped, with lines, and an advice that holds.

use std::fs;

use super::{IRB6, line_of};
use crate::cell::CellFile;

const HEAD: &str = "[DeviceInfo]\nVendorName=Example\n";

/// Sections of writable 32-bit objects with their values, and of the records whose sub-indices they are.
fn objects(values: &[(&str, &str)]) -> String {
    let mut text = String::new();
    for (section, value) in values {
        let record = section.split_once("sub").map(|(index, _)| format!("[{index}]\n"));
        if let Some(record) = record.filter(|record| !text.contains(record)) {
            text += &format!("{record}ParameterName=of\nObjectType=9\n");
        }
        text += &format!("[{section}]\nParameterName=of\nObjectType=7\nDataType=7\nAccessType=rw\n");
        text += &format!("ParameterValue={value}\n");
    }
    text
}

/// The line of the value of an object, or of a key of another section.
fn line(dcf: &str, section: &str, key: &str) -> usize {
    let at = dcf.find(&format!("[{section}]\n")).expect("the section is in the file");
    dcf[..at].matches('\n').count() + line_of(&dcf[at..], &format!("\n{key}=")) + 1
}

/// The refusal of the IRb-6's cell whose first axis has this file; empty if the cell is accepted.
fn refusal(dcf: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("motor.dcf"), dcf).unwrap();
    let drive = "drive = { vendor = 0xFB, ";
    let cell = IRB6.replacen(drive, &format!("{drive}product = 0x61500000, dcf = \"motor.dcf\", "), 1);
    let path = folder.path().join("cell.toml");
    fs::write(&path, cell).unwrap();
    CellFile::read(&path).map_or_else(|error| error.to_string(), |_| String::new())
}

/// Asserts that a text contains all of these.
fn contains(text: &str, needles: &[String]) {
    for needle in needles {
        assert!(text.contains(needle), "{needle:?} is not in {text:?}");
    }
}

/// A file that contradicts the cell in place, identity and scale, and the refusals.
fn contradicting() -> (String, [String; 6]) {
    let dcf = "[DeviceInfo]\nVendorNumber=0x1234\nProductNumber=0x1\n[DeviceComissioning]\nBaudrate=500\nNodeID=2\n"
        .to_owned()
        + &objects(&[("6091sub1", "158"), ("6092sub1", "3600"), ("6067", "1")]);
    let told = [
        ("DeviceInfo", "VendorNumber", "the file is of vendor-ID 0x00001234 (0x1018:01), the cell says 0x000000fb"),
        ("DeviceInfo", "ProductNumber", "the file is of product code 0x00000001 (0x1018:02), the cell says 0x61500000"),
        ("DeviceComissioning", "Baudrate", "the file is for 500 kbit/s, the bus has 1000"),
        ("DeviceComissioning", "NodeID", "the file is of node 2, the axis of node 1"),
        ("6091sub1", "ParameterValue", "0x6091 sets 158 motor revolutions per shaft revolution, the cell says 1"),
        ("6092sub1", "ParameterValue", "0x6092 sets 3600 position units per shaft revolution, the cell says 4000"),
    ];
    let told = told.map(|(section, key, problem)| format!("{}: {problem}", line(&dcf, section, key)));
    (dcf, told)
}

#[test]
fn all_that_contradicts_the_cell_is_refused_at_once_with_lines() {
    let (dcf, told) = contradicting();
    let refusal = refusal(&dcf);
    contains(&refusal, &told);
    contains(&refusal, &["robot[0].axis[0].drive.dcf: ".to_owned(), format!("motor.dcf:{}", told.join("; "))]);
    assert!(!refusal.contains("dcf strip"), "{refusal}");
}

#[test]
fn the_identity_is_told_at_the_line_that_states_it() {
    let stated = |section: &str, key: &str| {
        let head = format!("{HEAD}[1018]\nParameterName=identity\nObjectType=9\nSubNumber=1\n");
        let vendor = format!("[{section}]\nParameterName=of\nObjectType=7\nDataType=7\nAccessType=ro\n{key}=0x1234\n");
        let dcf = head + &vendor + &objects(&[("6067", "1")]);
        (line(&dcf, section, key), refusal(&dcf))
    };
    for (section, key) in [("1018sub1", "DefaultValue"), ("1018sub1", "ParameterValue"), ("1018sub01", "DefaultValue")]
    {
        let (line, refusal) = stated(section, key);
        contains(&refusal, &[format!("motor.dcf:{line}: the file is of vendor-ID 0x00001234")]);
    }
}

#[test]
fn the_advice_to_strip_names_the_lines_that_stay() {
    let reserved = [("6007", "0"), ("6065", "1")];
    let advice = "`mrroc dcf strip` writes the file without these lines";
    let alone = refusal(&format!("{HEAD}{}", objects(&reserved)));
    assert!(alone.ends_with(advice), "{alone}");
    // The scale is known to the cell alone.
    let dcf = format!("{HEAD}{}", objects(&[reserved[0], ("6091sub1", "158"), reserved[1]]));
    let mixed = refusal(&dcf);
    let kept = line(&dcf, "6091sub1", "ParameterValue");
    let kept = format!("{advice}, except {kept}: correct the file or the cell there");
    assert!(mixed.ends_with(&kept), "{mixed}");
    // The lines are of maxon, and the file names another vendor.
    let dcf = format!("[DeviceInfo]\nVendorNumber=0x1234\n{}", objects(&[("2000", "1"), reserved[0], reserved[1]]));
    let other = refusal(&dcf);
    let kept =
        format!("{advice}, except 2, {}: correct the file or the cell there", line(&dcf, "2000", "ParameterValue"));
    assert!(other.ends_with(&kept), "{other}");
    let scale = refusal(&format!("{HEAD}{}", objects(&[("6091sub1", "158"), ("6092sub1", "3600")])));
    assert!(scale.contains("0x6091 sets 158") && scale.contains("0x6092 sets 3600"), "{scale}");
    assert!(!scale.contains("dcf strip"), "{scale}");
}

#[test]
fn lines_with_the_same_reason_are_told_once_and_counted_by_reason() {
    let sections = ["1017", "1400sub1", "1400sub2", "1600sub0", "6007", "6065", "1016sub1"];
    // Two lines with one reason of another kind.
    let others = ["6067", "6068"].map(|section| (section, "0x100000000"));
    let values: Vec<_> = sections.iter().map(|section| (*section, "1")).chain(others).collect();
    let dcf = format!("{HEAD}{}", objects(&values));
    let at = |section: &str| line(&dcf, section, "ParameterValue");
    let refusal = refusal(&dcf);
    contains(
        &refusal,
        &[
            format!("{}: 0x1017:00", at("1017")),
            format!("the cell's heartbeat_ms sets it; {}: 0x1400:01", at("1400sub1")),
            format!(
                "the driver maps the process data; the same holds for 2 further lines: {}, {}; {}: 0x6007:00",
                at("1400sub2"),
                at("1600sub0"),
                at("6007")
            ),
            format!(
                "it decides whether the drive stops when its host falls silent; the same holds for 1 further line: {}; \
             {}: 0x6065:00",
                at("1016sub1"),
                at("6065")
            ),
            format!(
                "{}: out of range; 0 to 4294967295 fit; the same holds for 1 further line: {}",
                at("6067"),
                at("6068")
            ),
        ],
    );
    let advice = "remove the ParameterValue of each object that belongs to the driver, or set bit 0 of its ObjFlags";
    assert_eq!(refusal.matches(advice).count(), 1, "{refusal}");
}
