//! Refusals of the service commands.

use kit::mrroc::mrroc;

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
