//! The host's files below a root, `/` but in tests, and the notations that several of them share. This is the rim:
//! everything else in the examination works on what it returned.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The files of a host.
pub(crate) struct Tree {
    root: PathBuf,
}

/// Who owns a file, and who may do what with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Access {
    pub(crate) mode: u32,
    pub(crate) uid: u32,
    pub(crate) gid: u32,
}

impl Tree {
    pub(crate) fn new(root: impl Into<PathBuf>) -> Self {
        let root = root.into();
        // Links are followed and must end below it.
        let root = root.canonicalize().unwrap_or(root);
        Self { root }
    }

    fn at(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// The text of a file, without the white space around it; none for one that cannot be read.
    pub(crate) fn text(&self, path: &str) -> Option<String> {
        let text = fs::read_to_string(self.at(path)).ok()?;
        Some(text.trim().to_owned())
    }

    /// The number in a file.
    pub(crate) fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.parse().ok()
    }

    /// The names in a directory, sorted; none in one that is not there.
    pub(crate) fn names(&self, path: &str) -> Vec<String> {
        let entries = fs::read_dir(self.at(path)).into_iter().flatten().flatten();
        let mut names: Vec<_> = entries
            .filter_map(|entry| entry.file_name().into_string().ok())
            .collect();
        names.sort();
        names
    }

    /// Where a path leads when every link is followed, from the root.
    pub(crate) fn resolved(&self, path: &str) -> Option<PathBuf> {
        let path = self.at(path).canonicalize().ok()?;
        let below = path.strip_prefix(&self.root).ok()?;
        Some(Path::new("/").join(below))
    }

    /// The last part of [`resolved`](Self::resolved).
    pub(crate) fn resolved_name(&self, path: &str) -> Option<String> {
        let path = self.resolved(path)?;
        Some(path.file_name()?.to_str()?.to_owned())
    }

    pub(crate) fn access(&self, path: &str) -> Option<Access> {
        let metadata = fs::metadata(self.at(path)).ok()?;
        Some(Access {
            mode: metadata.mode(),
            uid: metadata.uid(),
            gid: metadata.gid(),
        })
    }

    /// What the running kernel was built with, where it tells.
    pub(crate) fn kernel_config(&self) -> Option<String> {
        let release = self.text("/proc/sys/kernel/osrelease")?;
        self.text(&format!("/boot/config-{release}")).or_else(|| {
            let packed = self.at("/proc/config.gz");
            output_of(Command::new("gzip").arg("-dc").arg(packed))
        })
    }
}

/// What a program prints within two seconds; none where it is not installed, fails or takes longer.
pub(crate) fn output_of(program: &Command) -> Option<String> {
    let mut bounded = Command::new("timeout");
    bounded.args(["--kill-after=1", "2"]);
    bounded.arg(program.get_program()).args(program.get_args());
    let output = bounded.output().ok()?;
    let printed = String::from_utf8(output.stdout).ok()?;
    output.status.success().then_some(printed)
}

/// The numbers of a list such as `0-3,6`, as the kernel writes sets of CPUs. What is no number is left out.
pub(crate) fn cpu_list(text: &str) -> BTreeSet<usize> {
    let ranges = text.trim().split(',').filter_map(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        Some(first.trim().parse().ok()?..=last.trim().parse().ok()?)
    });
    ranges.flatten().collect()
}

/// The value behind `name` and a colon, as in `/proc/self/status`.
pub(crate) fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == name).then_some(value.trim())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_of_cpus_are_read_as_the_kernel_writes_them() {
        let table: [(&str, &[usize]); 6] = [
            ("", &[]),
            ("0\n", &[0]),
            ("0-3,6", &[0, 1, 2, 3, 6]),
            ("2-3,8-9\n", &[2, 3, 8, 9]),
            ("(null)", &[]),
            ("5-", &[]),
        ];
        for (text, cpus) in table {
            assert!(cpu_list(text).iter().eq(cpus), "{text:?}");
        }
    }

    #[test]
    fn a_program_that_fails_hangs_or_is_not_there_tells_nothing() {
        let mut echo = Command::new("echo");
        assert_eq!(output_of(echo.arg("told")).as_deref(), Some("told\n"));
        let mut sleep = Command::new("sleep");
        for program in [
            &mut Command::new("false"),
            &mut Command::new("no-such-program"),
            sleep.arg("60"),
        ] {
            assert_eq!(output_of(program), None, "{program:?}");
        }
    }

    #[test]
    fn a_field_is_found_by_its_whole_name() {
        let status = "CapInh:\t00\nCpus_allowed:\t3\nCpus_allowed_list:\t0-1\n";
        assert_eq!(field(status, "Cpus_allowed_list"), Some("0-1"));
        assert_eq!(field(status, "Cpus"), None);
    }
}
