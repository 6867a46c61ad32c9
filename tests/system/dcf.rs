//! `mrroc dcf strip`: a file of a vendor's tool becomes one that a cell accepts.

use std::fs;

use kit::mrroc::{Directory, mrroc, root};
use kit::refusals::refused;

use crate::configuration::{cell, dcf};

#[test]
fn a_stripped_file_is_accepted_by_the_cell_and_names_each_line_that_is_gone() {
    let directory = Directory::new();
    let (text, _) = dcf(&[
        ("6007", "ParameterValue=0"),
        ("6067", "ParameterValue=0x100000000"),
        ("6068", "DownloadFile=window.bin"),
        ("1600sub2", "ParameterValue=0x607A0020"),
        // Kept: a default, a read-only value, and a sound value.
        ("607Dsub1", "ParameterValue=-2000000000"),
        ("6041", "ParameterValue=0x0637"),
        ("6080", "ParameterValue=50000"),
    ]);
    let before = cell(&directory, &text, |_| {});
    refused(&mrroc(["check".as_ref(), before.as_os_str()]), &["`mrroc dcf strip`"]);
    let (input, output) = (directory.write("tool.dcf", &text), directory.path("stripped.dcf"));
    let words = |json: bool| {
        let words = ["dcf".as_ref(), "strip".as_ref(), input.as_os_str(), output.as_os_str()];
        words.into_iter().chain(json.then_some("--json".as_ref()))
    };
    let stripped = mrroc(words(false));
    assert_eq!((stripped.status.code(), stripped.stderr.as_str()), (Some(0), ""), "{stripped:?}");
    let told = "4 lines are left out, 2 of them of objects that belong to the driver";
    assert!(stripped.stdout.contains(told), "{stripped:?}");
    assert!(stripped.stdout.contains(": out of range; 0 to 4294967295 fit"), "{stripped:?}");
    // An existing file stays.
    refused(&mrroc(words(true)), &["stripped.dcf: the file is there already"]);

    let written = fs::read_to_string(&output).unwrap();
    assert_eq!(written.lines().count(), text.lines().count());
    let changed = written.lines().zip(text.lines()).filter(|(after, before)| after != before);
    for (after, before) in changed.clone() {
        assert!(after.starts_with(&format!("; {before} ; left out: ")), "{after}");
    }
    assert_eq!(changed.count(), 4);
    let after = cell(&directory, &written, |_| {});
    let check = mrroc(["check".as_ref(), after.as_os_str()]);
    assert_eq!(check.status.code(), Some(0), "{check:?}");
    assert!(check.stdout.contains("1 read-only value is compared"), "{check:?}");
    for value in ["ParameterValue=-2000000000\n", "ParameterValue=50000\n", "ParameterValue=0x0637\n"] {
        assert!(written.contains(value), "{value}");
    }
}

#[test]
fn each_file_of_the_corpus_is_accepted_when_it_is_stripped() {
    let directory = Directory::new();
    let corpus = root().join("drivers/canopen/tests/sheets");
    let files = fs::read_dir(corpus).unwrap().map(|file| file.unwrap().path());
    let files: Vec<_> = files.filter(|file| file.extension().is_some_and(|end| end == "dcf")).collect();
    assert!(files.len() >= 7, "{files:?}");
    for (number, file) in files.iter().enumerate() {
        let output = directory.path(&format!("stripped-{number}.dcf"));
        let stripped =
            mrroc(["dcf".as_ref(), "strip".as_ref(), file.as_os_str(), output.as_os_str(), "--json".as_ref()]);
        assert_eq!(stripped.status.code(), Some(0), "{stripped:?}");
        let report = stripped.json();
        let refused = !report["left_out"].as_array().unwrap().is_empty();
        let check = |text: &str| {
            let cell = cell(&directory, text, |_| {});
            mrroc(["check".as_ref(), cell.as_os_str()])
        };
        let original = check(&fs::read_to_string(file).unwrap());
        assert_eq!(original.status.success(), !refused, "{file:?}: {original:?}");
        let accepted = check(&fs::read_to_string(&output).unwrap());
        let nothing_left = report["values"] == 0;
        assert_eq!(accepted.status.success(), !nothing_left, "{file:?}: {accepted:?}");
    }
}

#[test]
fn a_file_that_is_none_is_refused_and_nothing_is_written() {
    let directory = Directory::new();
    let (input, output) = (directory.write("none.dcf", "no file\n"), directory.path("out.dcf"));
    let words = ["dcf".as_ref(), "strip".as_ref(), input.as_os_str(), output.as_os_str()];
    refused(&mrroc(words), &["none.dcf:1: neither a [section] nor key=value"]);
    assert!(!output.exists());
}
