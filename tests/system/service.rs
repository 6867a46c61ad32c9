//! Refusals of the service commands.

use kit::mrroc::{Directory, mrroc};

#[test]
fn an_interface_that_is_not_there_is_refused_in_one_line() {
    let cases: [(&[&str], &str); 4] = [
        (&["scan", "--can", "nosuch0"], "nosuch0"),
        (&["monitor", "--can", "nosuch0"], "nosuch0"),
        (&["nmt", "stop", "all", "--can", "nosuch0"], "nosuch0"),
        (&["sdo", "read", "1", "0x1000", "--can", "a/b"], "interface name"),
    ];
    for (words, needle) in cases {
        let output = mrroc(words);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert_eq!(output.stderr.lines().count(), 1, "{output:?}");
        assert!(output.stderr.contains(needle), "{output:?}");
    }
}

#[test]
fn a_candump_log_is_shown_without_a_bus() {
    let directory = Directory::new();
    let log = directory.write("colleague.log", "(1795242630.500000)  can7 000#0105\n> quoted\n");
    let shown = mrroc(["monitor".as_ref(), "--from".as_ref(), log.as_os_str()]);
    assert_eq!(shown.status.code(), Some(0), "{shown:?}");
    assert_eq!(shown.stdout, "    0.000000  can7    000#0105              start, node 5\n");
    let [frames, skipped] = shown.stderr.lines().collect::<Vec<_>>()[..] else { panic!("{shown:?}") };
    assert!(frames.ends_with("colleague.log: 1 frame in 2 lines"), "{shown:?}");
    assert!(skipped.contains("1 line skipped, the first is line 2"), "{shown:?}");
    let empty = directory.write("empty.log", "no frame\n");
    let refused = mrroc(["monitor".as_ref(), "--from".as_ref(), empty.as_os_str()]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert!(refused.stderr.contains("no line is a frame"), "{refused:?}");
}
