//! Data sheets as they are found: every trait of the format, every refusal at its line, and bytes that are none.

use mrroc_canopen::dcf;
use mrroc_canopen::eds::{Access, DataType, Eds, EdsCause, EdsError, MAX_SECTIONS, ObjectType, ParameterValue, Value};
use mrroc_canopen::{NodeId, Object};
use proptest::prelude::*;

/// A small sheet with all that the format has.
const SHEET: &str = "\
; a comment
[FileInfo]
FileName=small.dcf
EDSVersion=4.0
CreatedBy=

[DeviceInfo]
VendorName=Example
VendorNumber=0x000000FB
ProductNumber=1632632832
RevisionNumber=0
BaudRate_125=0
BaudRate_1000=1
Granularity=010 ; octal
LSS_Supported=1
NrOfRXPDO=4

[ToolInfos]
ToolVersion=3
[M1ModuleInfo]
ProductName=passed over

[DeviceComissioning]
NodeID=0x05
NodeName=elbow
Baudrate=0
LSS_SerialNumber=0x29001321

[Comments]
Lines=2
Line1=first
Line2=second

[DummyUsage]
Dummy0005=1

[MandatoryObjects]
SupportedObjects=3
1=0x1000
2=4120
[OptionalObjects]
SupportedObjects=0

[1000]
parametername=Device type
datatype=0x7
ACCESSTYPE=RO
DefaultValue=0x00020192
PDOMapping=0

[1003]
ParameterName=Error
ObjectType=0x8
DataType=7
AccessType=ro
CompactSubObj=3
DefaultValue=0

[1003Name]
NrOfEntries=2
2=Older error
3=
[1016]
ParameterName=Consumer
ObjectType=8
DataType=7
AccessType=rw
CompactSubObj=2
[1016Value]
NrOfEntries=2
1=0x7F012C
2=
[1018]
ParameterName=Identity
ObjectType=9
SubNumber=3
[1018sub0]
ParameterName=Highest
DataType=5
AccessType=const
DefaultValue=4
[1018SUB1]
ParameterName=Vendor
DataType=7
AccessType=ro
ObjFlags=1
ParameterValue=0xFB
[1018sub4]
ParameterName=Serial
DataType=7
AccessType=ro
ObjFlags=3
[1018subFF]
DataType=7
AccessType=ro
[1400]
ParameterName=COB
DataType=7
AccessType=rw
DefaultValue=$NODEID+0x200
[1F50]
ObjectType=2
[607d]
ParameterName=Limit
DataType=4
AccessType=rww
LowLimit=0x80000000
HighLimit=
DefaultValue=
PDOMapping=1
ParameterValue=-5
";

fn object(index: u16, subindex: u8) -> Object {
    Object::new(index, subindex)
}

/// The sheet with the first `good` replaced, and the line, from 1, where that stands.
fn spoilt(good: &str, bad: &str) -> (String, u32) {
    let at = SHEET.find(good).unwrap_or_else(|| panic!("no {good:?}"));
    let line = SHEET[..at].matches('\n').count() as u32 + 1;
    (SHEET.replacen(good, bad, 1), line)
}

/// The line, from 1, that an error names.
fn line_of(error: &EdsError) -> u32 {
    let text = error.to_string();
    let (line, _) = text.split_once(": ").expect("an error begins with its line");
    line.parse().expect("an error begins with its line")
}

/// A sheet of which lines and flaws are forgotten, to compare what two sheets say.
fn without_lines(mut eds: Eds) -> Eds {
    eds.flaws.clear();
    let entries = eds.objects.values_mut();
    for variable in entries.flat_map(|entry| entry.variables.values_mut()) {
        if let Some(parameter) = &mut variable.parameter {
            parameter.line = 0;
        }
    }
    eds
}

#[test]
fn a_sheet_says_what_the_device_is() {
    for text in [SHEET.to_owned(), SHEET.replace('\n', "\r\n")] {
        let eds = Eds::read(text.as_bytes()).unwrap();
        assert_eq!(eds.file.file_name, "small.dcf");
        assert_eq!(eds.file.created_by, "");
        assert_eq!(eds.device.vendor_number, Some(0xFB));
        assert_eq!(eds.device.baud_rates, [1000]);
        assert_eq!((eds.device.granularity, eds.device.rpdos), (8, 4));
        assert!(eds.device.lss && !eds.device.simple_boot_up_slave);
        assert_eq!(eds.comments, ["first", "second"]);
        assert_eq!(eds.dummies, [false, false, false, false, true, false, false]);
        let place = eds.commissioning.as_ref().unwrap();
        assert_eq!(place.node, NodeId::new(5));
        assert_eq!(place.baud_rate, None, "0 is no bit rate");
        assert_eq!(place.serial_number, Some(0x2900_1321));
        let identity = [1, 2, 3, 4].map(|subindex| eds.identity(subindex));
        assert_eq!(identity, [Some(0xFB), Some(0x6150_0000), None, None]);
    }
}

#[test]
fn a_sheet_says_what_objects_there_are() {
    let eds = Eds::read(SHEET.as_bytes()).unwrap();
    let device_type = eds.variable(object(0x1000, 0)).unwrap();
    assert_eq!(device_type.name, "Device type");
    assert_eq!(device_type.data_type, DataType::Unsigned32);
    assert_eq!(device_type.access, Access::ReadOnly);
    assert_eq!(device_type.default, Some(Value::number(0x0002_0192)));

    let names = [0, 1, 2, 3].map(|subindex| {
        let variable = eds.variable(object(0x1003, subindex)).unwrap();
        variable.name.as_str()
    });
    assert_eq!(names, ["Number of entries", "Error1", "Older error", "Error3"]);
    assert_eq!(eds.objects[&0x1003].object_type, ObjectType::Array);
    assert_eq!(eds.variable(object(0x1003, 4)), None);

    let consumer = eds.variable(object(0x1016, 1)).unwrap();
    let line = SHEET.lines().position(|line| line == "1=0x7F012C").unwrap() + 1;
    let parameter = consumer.parameter.as_ref().unwrap();
    assert_eq!(parameter.line as usize, line);
    assert_eq!(parameter.value, ParameterValue::Value(Value::number(0x007F_012C)));
    assert_eq!(eds.variable(object(0x1016, 2)).unwrap().parameter, None);

    let serial = eds.variable(object(0x1018, 4)).unwrap();
    assert!(serial.refuses_download && serial.refuses_scan);
    let cob_id = eds.variable(object(0x1400, 0)).unwrap();
    let node = NodeId::new(5).unwrap();
    assert_eq!(cob_id.default.as_ref().unwrap().integer(node), Some(0x205));
    let domain = eds.variable(object(0x1F50, 0)).unwrap();
    assert_eq!((domain.data_type, domain.name.as_str()), (DataType::Domain, "1F50"));
    let limit = eds.variable(object(0x607D, 0)).unwrap();
    assert_eq!(limit.low, Some(Value::number(i32::MIN.into())));
    assert_eq!((&limit.high, &limit.default), (&None, &None));
    assert!(limit.pdo_mapping && limit.access == Access::ReadWriteOutput);
    assert_eq!(eds.variables().count(), 15);
}

#[test]
fn letters_beyond_ascii_are_iso_8859_1_or_utf_8() {
    let name = |bytes: &[u8]| Eds::read(bytes).map(|eds| eds.device.vendor_name);
    let sheet: &[u8] = b"[DeviceInfo]\nVendorName=Stra\xDFe\n";
    assert_eq!(name(sheet).unwrap(), "Straße");
    assert_eq!(name("\u{FEFF}[DeviceInfo]\nVendorName=Straße".as_bytes()).unwrap(), "Straße");
}

#[test]
fn what_is_written_reads_the_same() {
    let eds = Eds::read(SHEET.as_bytes()).unwrap();
    let text = eds.to_string();
    for line in text.lines() {
        assert!(!line.ends_with('='), "{line:?} is refused by other readers");
    }
    let again = Eds::read(text.as_bytes()).unwrap();
    assert_eq!(without_lines(again), without_lines(eds));
}

#[test]
fn texts_that_a_line_cannot_hold_do_not_break_the_file() {
    let mut eds = Eds::read(SHEET.as_bytes()).unwrap();
    eds.device.vendor_name = "two\r\n[lines] ; of text".into();
    eds.device.product_name = " ; nothing".into();
    for name in [" ", "; nothing", "\n"] {
        let device_type = eds.objects.get_mut(&0x1000).unwrap();
        device_type.variables.get_mut(&0).unwrap().name = name.into();
        let text = eds.to_string();
        assert!(text.contains("[1000]\nParameterName=1000\n"), "{text}");
        let again = Eds::read(text.as_bytes()).unwrap();
        assert_eq!(again.device.vendor_name, "two  [lines]");
        assert_eq!(again.device.product_name, "");
    }
}

/// What stands in the sheet, what stands there instead, by how many lines the error stands below, and the error at line 0.
type Case = (&'static str, &'static str, u32, fn(u32) -> EdsError);

const REFUSALS: &[Case] = &[
    ("VendorName=Example", "VendorName", 0, |line| EdsCause::Line.at(line)),
    ("[DeviceInfo]", "[DeviceInfo", 0, |line| EdsCause::Line.at(line)),
    ("; a comment", "a=1", 0, |line| EdsCause::NoSection.at(line)),
    ("[ToolInfos]", "[fileinfo]", 0, |line| EdsCause::DuplicateSection { first: 2 }.at(line)),
    ("ParameterName=Identity", "ObjectType=9", 1, |line| EdsCause::DuplicateKey { first: line - 1 }.at(line)),
    ("[1018SUB1]", "[1018sub100]", 0, |line| EdsCause::NotAnObject.at(line)),
    ("[1018SUB1]", "[1018x1]", 0, |line| EdsCause::NotAnObject.at(line)),
    ("[1018SUB1]", "[1018sub]", 0, |line| EdsCause::NotAnObject.at(line)),
    ("[1018SUB1]", "[1018sub00]", 0, |line| EdsCause::DuplicateSection { first: line - 5 }.at(line)),
    ("[607d]", "[0x607D]", 0, |line| EdsCause::NotAnObject.at(line)),
    ("[607d]", "[60700]", 0, |line| EdsCause::NotAnObject.at(line)),
    ("[607d]", "[1000sub1]", 0, |line| EdsCause::Orphan { index: 0x1000 }.at(line)),
    ("[607d]", "[2000sub1]", 0, |line| EdsCause::Orphan { index: 0x2000 }.at(line)),
    ("[607d]", "[1003sub1]", 0, |line| EdsCause::Orphan { index: 0x1003 }.at(line)),
    ("[1003Name]", "[1018Name]", 0, |line| EdsCause::Orphan { index: 0x1018 }.at(line)),
    ("ParameterName=Limit\nDataType=4", "ParameterName=Limit", 0, |line| {
        EdsCause::Missing { key: "DataType" }.at(line - 1)
    }),
    ("AccessType=rww", "AccessType=", 0, |line| EdsCause::Missing { key: "AccessType" }.at(line - 3)),
    ("2=4120", "2=0x6060", 0, |line| EdsCause::Undescribed { index: 0x6060 }.at(line)),
    ("SubNumber=3", "SubNumber=4", 0, |line| EdsCause::Count { key: "SubNumber", said: 4, found: 3 }.at(line)),
    ("CompactSubObj=3", "CompactSubObj=3\nSubNumber=3", 1, |line| {
        EdsCause::Count { key: "SubNumber", said: 3, found: 4 }.at(line)
    }),
    ("NrOfEntries=2\n2=Older", "NrOfEntries=3\n2=Older", 0, |line| {
        EdsCause::Count { key: "NrOfEntries", said: 3, found: 2 }.at(line)
    }),
    ("2=Older error", "4=Older error", 0, |line| EdsCause::Range { low: 1, high: 3 }.at(line)),
    ("Granularity=010", "Granularity=eight", 0, |line| EdsCause::Number.at(line)),
    ("2=4120", "2=beyond", 0, |line| EdsCause::Number.at(line)),
    ("2=4120", "2=0x11018", 0, |line| EdsCause::Range { low: 0, high: 0xFFFF }.at(line)),
    ("NodeID=0x05", "NodeID=128", 0, |line| EdsCause::Range { low: 1, high: 127 }.at(line)),
    ("NodeID=0x05", "NodeID=0x105", 0, |line| EdsCause::Range { low: 0, high: 255 }.at(line)),
    ("NodeID=0x05", "NodeID=0", 0, |line| EdsCause::Range { low: 1, high: 127 }.at(line)),
    ("DefaultValue=0x00020192", "DefaultValue=0x100020192", 0, |line| {
        EdsCause::Range { low: 0, high: 0xFFFF_FFFF }.at(line)
    }),
    ("ParameterValue=0xFB", "ParameterValue=251 or so", 0, |line| EdsCause::Number.at(line)),
    ("HighLimit=", "HighLimit=-6", 3, |line| EdsCause::Limits { low: -0x8000_0000, high: -6 }.at(line)),
    ("AccessType=rww", "AccessType=writable", 0, |line| EdsCause::Access.at(line)),
    ("ObjectType=9", "ObjectType=3", 0, |line| EdsCause::ObjectType { found: 3 }.at(line)),
    ("ObjectType=0x8", "ObjectType=0x7", 3, |line| EdsCause::ObjectType { found: 7 }.at(line)),
];

#[test]
fn what_is_wrong_is_named_at_its_line() {
    let sound = Eds::read(SHEET.as_bytes()).unwrap();
    for &(good, bad, below, error) in REFUSALS {
        let (text, line) = spoilt(good, bad);
        let error = error(line + below);
        let eds = Eds::read(text.as_bytes()).unwrap_or_else(|error| panic!("{bad}: {error}"));
        assert!(eds.flaws.iter().any(|flaw| flaw.error == error), "{bad}: {error}: {:?}", eds.flaws);
        // Beside it, the sheet lists no more than it did. Lines and lists may differ, and what depends on the line.
        let others = eds.flaws.iter().filter(|flaw| !matches!(flaw.error.cause, EdsCause::Unlisted { .. }));
        assert!(others.count() <= 3, "{bad}: {:?}", eds.flaws);
        assert!(sound.flaws.iter().all(|flaw| matches!(flaw.error.cause, EdsCause::Unlisted { .. })));
        assert!((1..=line + below).contains(&line_of(&error)), "{error}");
    }
}

#[test]
fn a_file_that_unfolds_without_end_is_refused() {
    let section = |index: u16| format!("[{index:04X}]\nObjectType=8\nDataType=5\nAccessType=rw\nCompactSubObj=254\n");
    let bomb: String = (0x2000..0x6000).map(section).collect();
    let error = Eds::read(bomb.as_bytes()).unwrap_err();
    assert!(error.cause == EdsCause::TooMany, "{error}");
}

/// Each of these would take hours if a line, a key or a section cost as much as all before it.
#[test]
fn large_files_are_read_in_time() {
    const COUNT: usize = 200_000;
    let keys: String = (0..COUNT).map(|key| format!("{key}=0x1000\n")).collect();
    let sections: String = (0..MAX_SECTIONS).map(|section| format!("[M{section}]\n")).collect();
    let dollars = format!("[1000]\nDataType=7\nAccessType=rw\nDefaultValue={}", "$NODEID+".repeat(COUNT));
    let comments = format!("[Comments]\nLine1={}", "a;".repeat(COUNT));
    assert!(Eds::read(format!("[M1]\n{keys}").as_bytes()).is_ok());
    assert!(Eds::read(sections.as_bytes()).is_ok());
    let dollars = Eds::read(dollars.as_bytes()).unwrap();
    assert_eq!(dollars.flaws.first().map(|flaw| flaw.error), Some(EdsCause::Number.at(4)));
    assert!(Eds::read(comments.as_bytes()).is_ok());
    assert!(Eds::read(&vec![b'['; COUNT]).is_err());
    assert!(Eds::read(&vec![b'\r'; COUNT]).is_ok());
}

/// Lines that are nearly right, so that random files come far.
fn line() -> impl Strategy<Value = String> {
    let names = ["1000", "1018", "1018sub0", "1018sub1", "1003", "1003Name", "1003Value", "DeviceInfo", "M1", "10G0"];
    let keys = [
        "ParameterName",
        "DataType",
        "AccessType",
        "ObjectType",
        "SubNumber",
        "CompactSubObj",
        "DefaultValue",
        "ParameterValue",
        "LowLimit",
        "HighLimit",
        "PDOMapping",
        "ObjFlags",
        "NrOfEntries",
        "1",
        "2",
        "NodeID",
    ];
    let values =
        ["", "0", "1", "3", "7", "8", "9", "254", "0xFF", "-1", "rw", "ro", "$NODEID+0x80", "$NODEID", "\u{e4};", " ;"];
    let section = prop::sample::select(names.to_vec()).prop_map(|name| format!("[{name}]"));
    let pair = (prop::sample::select(keys.to_vec()), prop::sample::select(values.to_vec()));
    prop_oneof![
        1 => section,
        4 => pair.prop_map(|(key, value)| format!("{key}={value}")),
        1 => ".{0,12}",
    ]
}

proptest! {
    #[test]
    fn arbitrary_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..512)) {
        let _ = Eds::read(&bytes);
    }

    #[test]
    fn whatever_is_read_is_written_so_that_it_reads_the_same(lines in prop::collection::vec(line(), 0..40)) {
        if let Ok(eds) = Eds::read(lines.join("\n").as_bytes()) {
            let again = Eds::read(eds.to_string().as_bytes());
            prop_assert_eq!(again.as_ref().map(|again| again.flaws.len()), Ok(0), "{}", eds);
            prop_assert_eq!(again.map(without_lines), Ok(without_lines(eds.clone())), "{}", eds);
            let _ = dcf::download(&eds, NodeId::MAX);
        }
    }

    /// One line of a good sheet replaced by another: nearly always still a sheet, or refused with a line of the file.
    #[test]
    fn a_damaged_sheet_is_read_or_refused_at_one_of_its_lines(at in 0..SHEET.lines().count(), other in line()) {
        let mut lines: Vec<&str> = SHEET.lines().collect();
        lines[at] = &other;
        match Eds::read(lines.join("\n").as_bytes()) {
            Ok(eds) => {
                let again = Eds::read(eds.to_string().as_bytes());
                prop_assert_eq!(again.map(without_lines), Ok(without_lines(eds)));
            }
            Err(error) => {
                // A character may be a line end of its own.
                prop_assert!((1..=lines.len() as u32 + 12).contains(&line_of(&error)));
            }
        }
    }
}

#[test]
fn sections_of_a_vendor_may_begin_with_hex_letters() {
    let text = "[Feedback]\nKind=SSI\n[A000]\nParameterName=x\nDataType=5\nAccessType=rw\n";
    let eds = Eds::read(text.as_bytes()).unwrap();
    assert!(eds.objects.keys().eq([&0xA000]));
    for refused in ["[1000back]\n", "[FeedsubX]\n"] {
        assert!(Eds::read(refused.as_bytes()).is_err(), "{refused}");
    }
}

#[test]
fn a_file_of_more_sections_than_any_device_has_is_refused() {
    let sections: String = (0..MAX_SECTIONS + 1).map(|at| format!("[s{at}]\n")).collect();
    let error = Eds::read(sections.as_bytes()).unwrap_err();
    assert_eq!(line_of(&error) as usize, MAX_SECTIONS + 1);
    assert!(error.to_string().contains("more than 110000 sections"), "{error}");
}
