//! Refusals of `mrroc emulate --slcan`.

use std::fs;

use kit::mrroc::{Directory, example, mrroc};

#[test]
fn a_link_that_cannot_be_made_is_refused_before_anything_runs() {
    let directory = Directory::new();
    let file = directory.write("can0", "precious");
    let cell = example("irb6");
    let emulate = |options: &[&str]| {
        let cell = cell.to_str().unwrap();
        mrroc([&["emulate", cell], options].concat())
    };
    let taken = file.to_str().unwrap();
    let cases: [(&[&str], &str); 4] = [
        (&["--slcan", taken], "no symbolic link"),
        (&["--slcan", "leg=/tmp/can0"], "no bus \"leg\""),
        (&["--slcan", "/tmp/a", "--can", "can0"], "already elsewhere"),
        (&["--slcan", "/tmp/a", "--slcan", "arm=/tmp/b"], "already elsewhere"),
    ];
    for (options, word) in cases {
        let output = emulate(options);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(output.stderr.contains(word), "{output:?}");
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
}
