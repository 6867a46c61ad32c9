//! Refusals of `mrroc`: one line that names the problem, its place and its cause; exit status 2; no motion.

use crate::mrroc::Output;

/// Asserts one line on stderr that contains each of `needles`, nothing on stdout, and exit status 2.
pub fn refused(run: &Output, needles: &[&str]) {
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    assert_eq!(run.stdout, "", "{run:?}");
    assert_eq!(run.stderr.lines().count(), 1, "{run:?}");
    assert!(run.stderr.starts_with("mrroc: "), "{run:?}");
    for needle in needles {
        assert!(run.stderr.contains(needle), "{needle:?} is not in {run:?}");
    }
}
