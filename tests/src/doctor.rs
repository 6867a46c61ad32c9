//! Examinations of a host and an example cell by `mrroc doctor`.

use ::mrroc::cell::Cell;
use serde_json::Value;

use crate::mrroc::{Directory, Output, mrroc};

/// Examines an example cell that `change` has modified. Returns the output as text and as JSON, which have the same
/// exit status.
pub fn examined(example: &str, change: impl FnOnce(&mut Cell)) -> (Output, Value) {
    let directory = Directory::new();
    let cell = directory.cell(example, change);
    let words = mrroc(["doctor".as_ref(), cell.as_os_str()]);
    let json = mrroc(["doctor".as_ref(), cell.as_os_str(), "--json".as_ref()]);
    assert_eq!(json.stdout.lines().count(), 1, "{json:?}");
    assert_eq!(words.status, json.status, "{words:?} {json:?}");
    let json = json.json();
    check(&words, &json);
    (words, json)
}

/// Checks that apply to every examination.
pub fn check(words: &Output, json: &Value) {
    let findings = json["findings"].as_array().unwrap();
    let is = |verdict| move |finding: &&Value| finding["verdict"] == verdict;
    let count = |verdict| findings.iter().filter(is(verdict)).count();
    let (verdict, status) = match (count("not-usable"), count("warning")) {
        (0, 0) => ("ok", 0),
        (0, _) => ("warning", 1),
        _ => ("not-usable", 2),
    };
    assert_eq!(json["verdict"], verdict);
    assert_eq!(words.status.code(), Some(status), "{words:?}");
    for finding in findings {
        assert!(finding["why"].as_str().unwrap().len() > 20, "{finding}");
        assert!(!finding["read"].as_str().unwrap().is_empty(), "{finding}");
        let mend = finding["mend"].as_str();
        assert_eq!(mend.is_none(), finding["verdict"] == "ok", "{finding}");
        if let Some(mend) = mend {
            assert!(words.stdout.contains(mend), "{finding} {words:?}");
        }
    }
    for (of, what) in [
        ("kernel", "preemption"),
        ("kernel", "timers"),
        ("kernel", "real-time group scheduling"),
        ("limits", "rtprio"),
        ("limits", "memlock"),
        ("cpu", "governor"),
        ("cpu", "idle states"),
        ("cpu", "CPU latency"),
        ("cpu", "isolated CPUs"),
        ("cpu", "steal time"),
    ] {
        let read = &finding(json, of, what)["read"];
        assert!(read.is_string(), "{of}: {what}: {read}");
    }
}

/// The finding about property `what` of subject `of`.
pub fn finding<'a>(json: &'a Value, of: &str, what: &str) -> &'a Value {
    let findings = json["findings"].as_array().unwrap().iter();
    let mut found = findings.filter(|found| found["of"] == of && found["what"] == what);
    let first = found.next();
    assert!(found.next().is_none(), "{of}: {what} comes twice in {json}");
    first.unwrap_or_else(|| panic!("{of}: {what} is not in {json}"))
}
