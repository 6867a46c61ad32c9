//! Data sheets with one flaw each, in the folder `sheets`: every file is read, and only what is wrong is absent.

use std::fs;
use std::path::Path;

use mrroc_canopen::Object;
use mrroc_canopen::eds::{DataType, Eds, Value};

/// A file of the folder, all its flaws, and the objects that it does not describe for them.
type Case = (&'static str, &'static [&'static str], &'static [(u16, u8)]);

const GAIN: (u16, u8) = (0x2000, 0);

const CASES: &[Case] = &[
    ("sound.eds", &[], &[]),
    ("limit-beyond-type.eds", &["52: out of range; 0 to 255 fit"], &[]),
    ("sub-number-small.eds", &["57: SubNumber says 2 and 3 are there; correct it"], &[]),
    ("sub-number-large.eds", &["57: SubNumber says 4 and 3 are there; correct it"], &[]),
    (
        "listed-not-described.eds",
        &["21: object 0x2002 is listed and not described; add its section or take it from the list"],
        &[(0x2002, 0)],
    ),
    (
        "described-not-listed.eds",
        &["53: object 0x2001 is described and not listed; add it to the list of its kind"],
        &[],
    ),
    (
        "sub-index-alone.eds",
        &[
            "53: a sub-index, and [2001] is not there as an array or record without CompactSubObj; mend its ObjectType or \
           remove this section; the same kind in 2 further lines: 59, 65",
        ],
        &[(0x2001, 0), (0x2001, 1), (0x2001, 2)],
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
            "19: object 0x2000 is listed and not described; add its section or take it from the list",
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
        for object in [(0x1000, 0), (0x1017, 0), (0x6064, 0), GAIN, (0x2001, 0), (0x2001, 1), (0x2001, 2), (0x2002, 0)]
        {
            let described = eds.variable(Object::new(object.0, object.1));
            assert_eq!(described.is_some(), !absent.contains(&object) && object.0 != 0x2002, "{name}: {object:?}");
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
    let gain = |name| read(name).variable(Object::new(0x2000, 0)).unwrap().clone();
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
    assert_eq!(variable("boolean-default-16.eds", 0x2000, 0).default, None);
    assert_eq!(variable("limit-beyond-type.eds", 0x2000, 0).high, None);
    assert_eq!(variable("duplicate-key-differs.eds", 0x2000, 0).high, None);
    assert_eq!(variable("duplicate-key.eds", 0x2000, 0).low, Some(Value::number(0)));
    assert_eq!(variable("compact-255.eds", 0x2001, 254).data_type, DataType::Unsigned32);
    for name in ["node-id-0.eds", "node-id-255.eds"] {
        let place = read(name).commissioning.unwrap();
        assert_eq!((place.node, place.baud_rate), (None, Some(1000)), "{name}");
    }
    // A write is not compared with a limit that is not known.
    let limits = |name| read(name).flaw_of_limits(Object::new(0x2000, 0)).is_some();
    for name in ["limit-beyond-type.eds", "duplicate-key-differs.eds", "line-without-key.eds"] {
        assert!(limits(name), "{name}");
    }
    for name in ["sound.eds", "c-suffixes.eds", "boolean-default-3.eds", "sub-number-small.eds"] {
        assert!(!limits(name), "{name}");
    }
}
