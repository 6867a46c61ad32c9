//! Changes that `--fix` makes, and their record.

use std::fs;

use super::super::mend::undo;
use super::super::tests::Fake;
use super::*;

const RUNTIME: &str = "proc/sys/kernel/sched_rt_runtime_us";
const LIMITS: &str = "etc/security/limits.d/mrroc.conf";
const FIRST: &str = "sys/class/net/can0/tx_queue_len";
const LAST: &str = "sys/class/net/can1/tx_queue_len";
const RECORD: &str = "var/undo.json";

fn runtime(after: &str) -> Fix {
    Knob::Kernel(format!("/{RUNTIME}")).to(after)
}

fn limits(after: &str) -> Fix {
    Knob::File(format!("/{LIMITS}")).to(after)
}

/// Opens the record, and retries while its lock is held. A process that another test starts inherits the lock until it
/// executes its own program.
fn record(fake: &Fake) -> Record {
    let mut tries = (0..100_000).map(|_| Record::open(&fake.path(RECORD)));
    let open = tries.find(|record| {
        std::thread::yield_now();
        record.is_ok()
    });
    open.expect("nobody else has it").unwrap()
}

fn applied(fake: &Fake, fixes: &[Fix]) {
    let mut record = record(fake);
    for fix in fixes {
        apply(&fake.tree(), fix, &mut record).unwrap();
    }
}

/// Number of changes that could not be undone.
fn undone(fake: &Fake) -> usize {
    undo(&fake.tree(), &mut record(fake)).unwrap()
}

#[test]
fn what_was_set_is_put_back_byte_for_byte() {
    let own = "# ours\n\n@realtime - nice -5 \n";
    let table = [None, Some(own), Some("")];
    for before in table {
        let mut files = vec![(RUNTIME, "400000\n")];
        files.extend(before.map(|text| (LIMITS, text)));
        let fake = Fake::new(&files);
        let granted = |priority| {
            let text = before.unwrap_or_default();
            limits(&format!("{text}@realtime - rtprio {priority}\n"))
        };
        let again = format!("{}@realtime - memlock unlimited\n", granted(80).after);
        applied(&fake, &[runtime("950000"), granted(80), limits(&again)]);
        assert_eq!(fake.text(LIMITS), Some(again));
        assert_eq!(fake.text(RUNTIME).unwrap().trim(), "950000");
        assert_eq!(undone(&fake), 0);
        assert_eq!(fake.text(LIMITS).as_deref(), before);
        assert_eq!(fake.text(RUNTIME).unwrap().trim(), "400000");
        assert_eq!(fake.text(RECORD), None, "an empty record is gone");
    }
}

#[test]
fn what_stands_where_it_should_is_not_touched_or_recorded() {
    let fake = Fake::new(&[(RUNTIME, "950000\n")]);
    let done = apply(&fake.tree(), &runtime("950000"), &mut record(&fake));
    assert_eq!(done.unwrap(), None);
    assert_eq!(fake.text(RUNTIME).as_deref(), Some("950000\n"));
    assert_eq!(fake.text(RECORD), None);
}

#[test]
fn a_change_that_cannot_be_recorded_is_not_made() {
    let fake = Fake::new(&[(RUNTIME, "400000\n")]);
    let mut record = record(&fake);
    // A directory occupies the path of the new record.
    fs::create_dir(fake.path("var/undo.json.new")).unwrap();
    let refused = apply(&fake.tree(), &runtime("950000"), &mut record);
    assert!(refused.unwrap_err().to_string().contains("undo.json"));
    assert_eq!(fake.text(RUNTIME).as_deref(), Some("400000\n"));
}

#[test]
fn a_crash_before_or_behind_a_change_leaves_what_undo_needs() {
    let fake = Fake::new(&[(RUNTIME, "400000\n")]);
    let change = Change { knob: runtime("").knob, before: Some("400000".into()), after: "950000".into() };
    for (reached, left) in [("400000\n", 0), ("950000", 0), ("700000", 1)] {
        record(&fake).push(change.clone()).unwrap();
        fake.write(RUNTIME, reached);
        assert_eq!(undone(&fake), left, "{reached}");
    }
    // A value that another process set is kept, and the record with the original value is kept too.
    assert_eq!(fake.text(RUNTIME).as_deref(), Some("700000"));
    assert_eq!(record(&fake).changes(), [change]);
}

#[test]
fn what_is_put_back_is_forgotten_at_once_and_what_is_not_stays() {
    let fake = Fake::new(&[(RUNTIME, "1"), (FIRST, "1"), (LAST, "1")]);
    let knob = |path: &str| Knob::Kernel(format!("/{path}")).to("2");
    applied(&fake, &[knob(FIRST), runtime("2"), knob(LAST)]);
    fake.write(RUNTIME, "3");
    assert_eq!(undone(&fake), 1);
    let read = [FIRST, RUNTIME, LAST].map(|path| fake.text(path).unwrap());
    assert_eq!(read, ["1", "3", "1"]);
    assert_eq!(record(&fake).changes().len(), 1);
    fake.write(RUNTIME, "2");
    assert_eq!(undone(&fake), 0);
    assert_eq!(fake.text(RUNTIME).as_deref(), Some("1"));
}

#[test]
fn a_knob_that_cannot_be_turned_says_why_and_leaves_no_record() {
    let fake = Fake::new(&[("sys/kernel/file", "1")]);
    fake.link("sys/outside", "../../../../../../etc/hostname");
    let table = [
        (Knob::Kernel("/sys/none".into()), "/sys/none is not there"),
        (Knob::Kernel("/sys/outside".into()), "/sys/outside"),
        (Knob::Kernel("/sys/kernel".into()), "/sys/kernel"),
        (Knob::BitTiming("can0".into()), "no interfaces"),
        (Knob::RestartMs("can0".into()), "no interfaces"),
        (Knob::State("can0".into()), "no interfaces"),
    ];
    for (knob, why) in table {
        let any = |_: &Change| Ok(());
        let refused = turn(&fake.tree(), &knob.to("2"), &mut record(&fake), any).unwrap_err();
        assert!(format!("{refused:#}").contains(why), "{refused:#}");
        assert_eq!(fake.text(RECORD), None);
    }
}

#[test]
fn what_the_kernel_makes_another_value_of_is_told_and_put_back() {
    let fake = Fake::new(&[(RUNTIME, "400000\n")]);
    // The value is read without the trailing space.
    let any = |_: &Change| Ok(());
    let refused = turn(&fake.tree(), &runtime(" 950000"), &mut record(&fake), any);
    assert_eq!(refused.unwrap_err().to_string(), "it reads 950000");
    assert_eq!(undone(&fake), 0);
    assert_eq!(fake.text(RUNTIME).as_deref(), Some("400000"));
}

#[test]
fn a_record_that_is_none_or_in_use_is_refused() {
    let fake = Fake::new(&[]);
    let held = record(&fake);
    let refused = Record::open(&fake.path(RECORD)).err().unwrap();
    assert!(refused.to_string().contains("another doctor"), "{refused}");
    drop(held);
    for text in ["", "{}", "[{\"knob\":{\"reactor\":\"1\"}}]", "\u{0}"] {
        fake.write(RECORD, text);
        let refused = Record::open(&fake.path(RECORD)).err().unwrap();
        assert!(format!("{refused:#}").contains("no record"), "{refused:#}");
    }
}

#[test]
fn a_record_that_names_anything_a_fix_does_not_set_changes_nothing() {
    let victim = "etc/passwd";
    let kernel = |path: &str| format!("{{\"kernel\":\"{path}\"}}");
    let file = |path: &str| format!("{{\"file\":\"{path}\"}}");
    for knob in [
        kernel("/etc/passwd"),
        kernel("/sys/class/net/../../../etc/passwd"),
        file("/etc/passwd"),
        file("/etc/security/limits.d/../../passwd"),
    ] {
        for before in ["null", "\"evil\""] {
            let fake = Fake::new(&[(victim, "root\n"), (RUNTIME, "950000\n")]);
            let harmless =
                format!("{{\"knob\":{},\"before\":\"400000\",\"after\":\"950000\"}}", kernel(&format!("/{RUNTIME}")));
            let evil = format!("{{\"knob\":{knob},\"before\":{before},\"after\":\"root\\n\"}}");
            fake.write(RECORD, &format!("[{harmless},{evil}]"));
            let refused = Record::existing(&fake.path(RECORD)).err();
            let refused = format!("{:#}", refused.expect("it is refused"));
            assert!(refused.contains("does not set"), "{refused}");
            assert_eq!(fake.text(victim).as_deref(), Some("root\n"));
            assert_eq!(fake.text(RUNTIME).as_deref(), Some("950000\n"));
        }
    }
}

#[test]
fn a_fix_that_could_not_be_put_back_is_not_made() {
    let queue = "sys/class/net/can\u{1b}[2J/tx_queue_len";
    let fake = Fake::new(&[(queue, "10\n")]);
    let fix = Knob::Kernel(format!("/{queue}")).to("128");
    let refused = apply(&fake.tree(), &fix, &mut record(&fake)).unwrap_err();
    assert!(refused.to_string().contains("put back"), "{refused}");
    assert_eq!(fake.text(queue).as_deref(), Some("10\n"));
    assert_eq!(fake.text(RECORD), None);
}

#[test]
fn a_bit_rate_stands_where_its_sample_point_is_near() {
    let knob = Knob::BitTiming("can0".into());
    let table = [
        (Some("500000"), Some("500000 0.875"), true),
        (Some("500000 0.875"), Some("500000 0.866"), true),
        (Some("500000 0.875"), Some("500000 0.750"), false),
        (Some("500000 0.000"), Some("500000 0.750"), true),
        (Some("1000000"), Some("500000 0.875"), false),
        (Some("1000000"), None, false),
        (None, Some("500000 0.875"), false),
        (None, None, true),
        (Some("fast"), Some("faster"), false),
    ];
    for (wanted, found, stands) in table {
        assert_eq!(knob.stands_at(wanted, found), stands, "{wanted:?} {found:?}");
    }
}

#[test]
fn no_interface_is_touched_that_somebody_receives_on() {
    let head = "receive list 'rx_fil':\n";
    let columns = "  device   can_id   can_mask  function  userdata   matches  ident\n";
    let receiver = |device| format!("{columns}   {device}      201    c00007ff  00000000  00000000         7  raw\n");
    let table = [
        (String::new(), false),
        (format!("{head}  (any: no entry)\n  (can0: no entry)\n"), false),
        (format!("{head}{}", receiver("can0")), true),
        (format!("{head}{}", receiver("can01")), false),
        (format!("{head}{}", receiver("any")), true),
    ];
    for (list, heard) in table {
        let all = format!("{head}  (any: no entry)\n");
        let fake = Fake::new(&[
            ("proc/net/can/rcvlist_all", &all),
            ("proc/net/can/rcvlist_sff", &list),
            ("proc/net/can/stats", "can0 1 frames\n"),
        ]);
        assert_eq!(is_heard(&fake.tree(), "can0"), heard, "{list}");
        for knob in [Knob::BitTiming, Knob::RestartMs, Knob::State] {
            let written = knob("can0".into()).write(&fake.tree(), Some("100"));
            let why = written.unwrap_err().to_string();
            assert_eq!(why.contains("somebody receives on can0"), heard, "{why}");
        }
    }
}
