//! Data sheets with one flaw each, in the folder `sheets`: every file is read, and only what is wrong is absent.

use std::fs;
use std::path::Path;

use mrroc_canopen::dcf::{self, Download};
use mrroc_canopen::eds::{self, DataType, Eds, Value};
use mrroc_canopen::{NodeId, Object};
use proptest::prelude::*;

/// A file of the folder, all its flaws, and the objects that it does not describe for them.
type Case = (&'static str, &'static [&'static str], &'static [(u16, u8)]);

const GAIN: (u16, u8) = (0x3100, 0);

const CASES: &[Case] = &[
    ("sound.eds", &[], &[]),
    ("limit-beyond-type.eds", &["52: out of range; 0 to 255 fit"], &[]),
    ("sub-number-small.eds", &["57: SubNumber says 2 and 3 are there; correct it"], &[]),
    ("sub-number-large.eds", &["57: SubNumber says 4 and 3 are there; correct it"], &[]),
    (
        "listed-not-described.eds",
        &["21: object 0x3102 is listed and not described; add its section or take it from the list"],
        &[(0x3102, 0)],
    ),
    (
        "described-not-listed.eds",
        &["53: object 0x3101 is described and not listed; add it to the list of its kind"],
        &[],
    ),
    (
        "sub-index-alone.eds",
        &[
            "53: a sub-index, and [3101] is not there as an array or record without CompactSubObj; mend its ObjectType or \
           remove this section; the same kind in 2 further lines: 59, 65",
        ],
        &[(0x3101, 0), (0x3101, 1), (0x3101, 2)],
    ),
    ("node-id-0.eds", &["11: out of range; 1 to 127 fit"], &[]),
    ("node-id-255.eds", &["11: out of range; 1 to 127 fit"], &[]),
    ("boolean-default-16.eds", &["50: out of range; 0 to 1 fit"], &[]),
    ("boolean-default-3.eds", &["50: out of range; 0 to 1 fit"], &[]),
    (
        "c-suffixes.eds",
        &["50: not a plain number; leave out suffixes as in 0x10UL and 0.5f and comments behind `#`, and \
                          write $NODEID; the same kind in 2 further lines: 51, 52"],
        &[],
    ),
    (
        "float-suffixes.eds",
        &["50: not a plain number; leave out suffixes as in 0x10UL and 0.5f and comments behind `#`, \
                              and write $NODEID; the same kind in 2 further lines: 51, 52"],
        &[],
    ),
    (
        "my-node-id.eds",
        &["50: not a plain number; leave out suffixes as in 0x10UL and 0.5f and comments behind `#`, and \
                          write $NODEID"],
        &[],
    ),
    ("compact-255.eds", &["59: out of range; 0 to 254 fit"], &[]),
    (
        "hash-comments.eds",
        &[
            "6: a comment begins with `;`, not with `#`; change its first character",
            "51: not a plain number; leave out suffixes as in 0x10UL and 0.5f and comments behind `#`, and write $NODEID",
        ],
        &[],
    ),
    ("duplicate-section.eds", &["54: this section stands on line 45 already; merge the two"], &[]),
    (
        "duplicate-section-differs.eds",
        &[
            "54: this section stands on line 45 already; merge the two",
            "55: this key stands on line 46 already; remove one of the two",
        ],
        &[GAIN],
    ),
    ("duplicate-key.eds", &["53: this key stands on line 51 already; remove one of the two"], &[]),
    ("duplicate-key-differs.eds", &["53: this key stands on line 52 already; remove one of the two"], &[]),
    ("line-without-key.eds", &["53: neither a [section] nor key=value nor a comment behind `;`"], &[]),
    (
        "heading-not-closed.eds",
        &[
            "19: object 0x3100 is listed and not described; add its section or take it from the list",
            "45: neither a [section] nor key=value nor a comment behind `;`",
        ],
        &[GAIN],
    ),
    ("type-missing.eds", &["45: the section lacks DataType; add it"], &[GAIN]),
];

fn bytes(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/sheets");
    fs::read(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn read(name: &str) -> Eds {
    Eds::read(&bytes(name)).unwrap_or_else(|error| panic!("{name}:{error}"))
}

#[test]
fn a_flaw_does_not_refuse_the_file_and_all_flaws_are_told_at_once() {
    for &(name, _, _) in CASES {
        read(name);
    }
    for &(name, flaws, absent) in CASES {
        let eds = read(name);
        let told: Vec<_> = eds.flawed_lines().iter().map(ToString::to_string).collect();
        assert_eq!(told, flaws, "{name}");
        for object in [(0x1000, 0), (0x1017, 0), (0x6064, 0), GAIN, (0x3101, 0), (0x3101, 1), (0x3101, 2), (0x3102, 0)]
        {
            let described = eds.variable(Object::new(object.0, object.1));
            assert_eq!(described.is_some(), !absent.contains(&object) && object.0 != 0x3102, "{name}: {object:?}");
            // A heading that cannot be read is the object's by the list.
            assert_eq!(eds.flaw_of(Object::new(object.0, object.1)).is_some(), absent.contains(&object), "{name}");
        }
    }
    let files = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/sheets")).unwrap();
    let files: Vec<_> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    assert!(files.iter().all(|file| file.ends_with(".dcf") || CASES.iter().any(|case| case.0 == file)), "{files:?}");
}

#[test]
fn numbers_in_another_spelling_are_the_numbers_that_are_meant() {
    let gain = |name| read(name).variable(Object::new(0x3100, 0)).unwrap().clone();
    let values = |name| {
        let gain = gain(name);
        [gain.default, gain.low, gain.high]
    };
    let number = |value| Some(Value::number(value));
    assert_eq!(values("c-suffixes.eds"), [number(10), number(0), number(255)]);
    assert_eq!(values("float-suffixes.eds"), [0.0, -1.5, 2.0].map(|value| Some(Value::Real(value))));
    assert_eq!(values("my-node-id.eds")[0], Some(Value::Integer { value: 0x200, plus_node: true }));
    assert_eq!(values("hash-comments.eds")[0], number(10));
}

#[test]
fn what_has_no_certain_meaning_is_absent() {
    let variable = |name: &str, index, subindex| read(name).variable(Object::new(index, subindex)).unwrap().clone();
    assert_eq!(variable("boolean-default-16.eds", 0x3100, 0).default, None);
    assert_eq!(variable("limit-beyond-type.eds", 0x3100, 0).high, None);
    assert_eq!(variable("duplicate-key-differs.eds", 0x3100, 0).high, None);
    assert_eq!(variable("duplicate-key.eds", 0x3100, 0).low, Some(Value::number(0)));
    assert_eq!(variable("compact-255.eds", 0x3101, 254).data_type, DataType::Unsigned32);
    for name in ["node-id-0.eds", "node-id-255.eds"] {
        let place = read(name).commissioning.unwrap();
        assert_eq!((place.node, place.baud_rate), (None, Some(1000)), "{name}");
    }
    // A write is not compared with a limit that is not known.
    let limits = |name| read(name).flaw_of_limits(Object::new(0x3100, 0)).is_some();
    for name in ["limit-beyond-type.eds", "duplicate-key-differs.eds", "line-without-key.eds"] {
        assert!(limits(name), "{name}");
    }
    for name in ["sound.eds", "c-suffixes.eds", "boolean-default-3.eds", "sub-number-small.eds"] {
        assert!(!limits(name), "{name}");
    }
}

/// Writes, writes of defaults, compared values and values left out.
fn counts(download: &Download) -> [usize; 4] {
    [download.writes.len(), download.defaults(), download.compared.len(), download.left_out]
}

/// A device configuration file of the folder, what its download has, and all reasons why it is refused.
type Configuration = (&'static str, [usize; 4], &'static [&'static str]);

const CONFIGURATIONS: &[Configuration] = &[
    ("read-only.dcf", [1, 0, 2, 0], &[]),
    ("defaults.dcf", [3, 2, 0, 0], &[]),
    // Objects that belong to a driver are the driver's to refuse.
    ("safety-set-up.dcf", [4, 0, 0, 0], &[]),
    ("no-vendor.dcf", [3, 0, 0, 0], &[]),
    // The COB-ID off, no entries, one entry, their count, and the COB-ID.
    ("mapping-beyond-count.dcf", [6, 0, 0, 2], &[]),
    (
        "no-layout.dcf",
        [0, 0, 0, 0],
        &[
            "46: 0x3100:00 is to be written from a file, which is not supported; remove its DownloadFile",
            "66: 0x3101:01 has data type 0x0040, whose values cannot be written; remove its ParameterValue",
        ],
    ),
    (
        "flawed-values.dcf",
        [2, 0, 0, 0],
        &[
            "46: the parameter value is beyond the object's limits 0 to 200",
            "67: this key stands on line 66 already; remove one of the two",
            "79: out of range; 0 to 255 fit",
        ],
    ),
    ("flaws-elsewhere.dcf", [1, 0, 0, 0], &[]),
];

/// The download of a file, or what could be downloaded, and the reasons against the rest.
fn downloaded(dcf: &Eds) -> (Download, Vec<String>) {
    match dcf::download(dcf, NodeId::MIN) {
        Ok(download) => (download, Vec::new()),
        Err(refusal) => (refusal.rest, refusal.errors.iter().map(ToString::to_string).collect()),
    }
}

#[test]
fn a_configuration_is_refused_for_all_its_reasons_at_once_and_for_nothing_that_is_not_used() {
    for &(name, expected, reasons) in CONFIGURATIONS {
        let (download, errors) = downloaded(&read(name));
        assert_eq!(errors, reasons, "{name}");
        assert_eq!(counts(&download), expected, "{name}");
    }
}

#[test]
fn a_stripped_configuration_is_accepted_and_keeps_its_other_lines() {
    for &(name, [writes, defaults, compared, _], reasons) in CONFIGURATIONS {
        let text = bytes(name);
        let mut refused = std::collections::BTreeMap::new();
        for reason in reasons {
            let (line, reason) = reason.split_once(": ").unwrap();
            refused.insert(line.parse().unwrap(), reason.to_owned());
        }
        let stripped = eds::strip(&text, &refused);
        assert_eq!(stripped.lines.is_empty(), reasons.is_empty(), "{name}");
        let (download, errors) = downloaded(&Eds::read(&stripped.bytes).unwrap());
        assert_eq!(errors, [""; 0], "{name}");
        let kept = [download.writes.len(), download.defaults(), download.compared.len()];
        // A value goes with its flawed limit, and both values of an object that has two.
        let gone = if name == "flawed-values.dcf" { 2 } else { 0 };
        assert_eq!(kept, [writes - gone, defaults, compared], "{name}");
        let (before, after) = (String::from_utf8(text).unwrap(), String::from_utf8(stripped.bytes).unwrap());
        for (at, (before, after)) in (1..).zip(before.lines().zip(after.lines())) {
            let left_out = after.starts_with(&format!("; {before} ; left out: "));
            assert!(if stripped.lines.contains(&at) { left_out } else { before == after }, "{name}:{at}: {after}");
        }
    }
}

#[test]
fn a_configuration_without_a_vendor_has_the_download_of_the_same_file_with_one() {
    for &(name, ..) in CONFIGURATIONS {
        let text = String::from_utf8(bytes(name)).unwrap();
        let anonymous: String =
            text.lines().filter(|line| !line.starts_with("VendorNumber")).map(|line| line.to_owned() + "\n").collect();
        let named = anonymous.replacen("[DeviceInfo]\n", "[DeviceInfo]\nVendorNumber=0x000000FB\n", 1);
        let [anonymous, named] = [anonymous, named].map(|text| Eds::read(text.as_bytes()).unwrap());
        assert_eq!((anonymous.device.vendor_number, named.device.vendor_number), (None, Some(0xFB)), "{name}");
        let [(without, reasons), (with, others)] = [&anonymous, &named].map(downloaded);
        assert_eq!(counts(&without), counts(&with), "{name}");
        assert_eq!(reasons.len(), others.len(), "{name}: {reasons:?}, {others:?}");
    }
}

/// Change of one place of a file.
#[derive(Clone, Debug)]
enum Mutation {
    Delete,
    Double,
    Exchange(usize),
    Insert(String),
    Replace(String),
    /// Another character at this place of the line.
    Character(usize, char),
    /// The line ends at this place.
    Break(usize),
}

fn mutation() -> impl Strategy<Value = Mutation> {
    let lines = [
        "",
        "x",
        "# x",
        "[",
        "]",
        "[1000",
        "[1017]",
        "[3101sub1]",
        "[31011]",
        "[DeviceInfo]",
        "=",
        "ParameterName=Speed",
        "DataType=0x0007",
        "DataType=x",
        "AccessType=rw",
        "ObjectType=0x8",
        "ObjectType=99",
        "SubNumber=200",
        "CompactSubObj=255",
        "LowLimit=0x100000000",
        "HighLimit=1LL",
        "DefaultValue=$MY_NODE_ID+1",
        "ParameterValue=1",
        "NrOfEntries=1",
        "1=0x9999",
        "NodeID=0",
    ];
    let line = prop::sample::select(lines.to_vec()).prop_map(str::to_owned).boxed();
    prop_oneof![
        Just(Mutation::Delete),
        Just(Mutation::Double),
        (0..200_usize).prop_map(Mutation::Exchange),
        line.clone().prop_map(Mutation::Insert),
        line.prop_map(Mutation::Replace),
        (0..40_usize, prop::sample::select("0123456789abcdefx[]=;#$ \\\u{e4}".chars().collect::<Vec<_>>()))
            .prop_map(|(at, character)| Mutation::Character(at, character)),
        (0..40_usize).prop_map(Mutation::Break),
    ]
}

fn mutated(text: &str, at: usize, mutation: &Mutation) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let at = at % lines.len();
    match mutation {
        Mutation::Delete => _ = lines.remove(at),
        Mutation::Double => lines.insert(at, lines[at].clone()),
        Mutation::Exchange(other) => {
            let other = other % lines.len();
            lines.swap(at, other);
        }
        Mutation::Insert(line) => lines.insert(at, line.clone()),
        Mutation::Replace(line) => lines[at].clone_from(line),
        Mutation::Character(place, character) => {
            let mut line: Vec<char> = lines[at].chars().collect();
            let place = place % line.len().max(1);
            if place < line.len() {
                line[place] = *character;
            }
            lines[at] = line.into_iter().collect();
        }
        Mutation::Break(place) => {
            let (before, after) = lines[at].split_at(place % (lines[at].len() + 1));
            let (before, after) = (before.to_owned(), after.to_owned());
            lines[at] = after;
            lines.insert(at, before);
        }
    }
    lines.join("\n")
}

/// The texts of the sections that describe a variable, in all places.
fn description(text: &str, object: Object) -> Vec<String> {
    let of_entry = format!("[{:04x}]", object.index);
    let of_variable = format!("[{:04x}sub{:x}]", object.index, object.subindex);
    let mut found: Vec<String> = Vec::new();
    let mut inside = false;
    for line in text.lines() {
        if line.starts_with('[') {
            let name = line.to_ascii_lowercase();
            inside = name == of_variable || name == of_entry;
            if inside {
                found.push(String::new());
            }
        }
        if let Some(section) = found.last_mut().filter(|_| inside && !line.is_empty()) {
            *section += line;
            section.push('\n');
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// `mrroc sdo --eds` needs name, type, access and limits of one object.
    #[test]
    fn whatever_is_wrong_elsewhere_an_untouched_object_is_described(
        changes in prop::collection::vec((0..200_usize, mutation()), 1..4),
    ) {
        let sound = String::from_utf8(bytes("sound.eds")).unwrap();
        let text = changes.iter().fold(sound.clone(), |text, (at, change)| mutated(&text, *at, change));
        let original = Eds::read(sound.as_bytes()).unwrap();
        let eds = Eds::read(text.as_bytes());
        for (object, variable) in original.variables() {
            if description(&text, object) != description(&sound, object) {
                continue;
            }
            let eds = eds.as_ref().map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
            prop_assert_eq!(eds.variable(object), Some(variable), "{}\n{}", object, text);
            prop_assert_eq!(&eds.objects[&object.index].name, &original.objects[&object.index].name);
            prop_assert_eq!(eds.flaw_of_limits(object), None, "{}\n{}", object, text);
        }
    }

    /// `mrroc dcf strip` converts every readable file, also one without a vendor, to a file that is accepted.
    #[test]
    fn whatever_a_configuration_becomes_its_stripped_file_is_accepted(
        file in 0..CONFIGURATIONS.len(),
        changes in prop::collection::vec((0..200_usize, mutation()), 1..4),
    ) {
        let sound = String::from_utf8(bytes(CONFIGURATIONS[file].0)).unwrap();
        let text = changes.iter().fold(sound, |text, (at, change)| mutated(&text, *at, change));
        let Ok(mut dcf) = Eds::read(text.as_bytes()) else {
            return Ok(());
        };
        let mut stripped = text.clone().into_bytes();
        // A refusal may appear after another refused line is gone.
        for pass in 0.. {
            let (_, errors) = downloaded(&dcf);
            if errors.is_empty() {
                break;
            }
            prop_assert!(pass < 16, "{errors:?}\n{text}");
            let refused = errors.iter().filter_map(|error| {
                let (line, reason) = error.split_once(": ")?;
                Some((line.parse().ok()?, reason.to_owned()))
            });
            stripped = eds::strip(&stripped, &refused.collect()).bytes;
            dcf = Eds::read(&stripped).map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
        }
    }
}
