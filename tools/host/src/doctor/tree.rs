//! Files of the host below a root directory, which is `/` except in tests, and parsers for their common notations. All
//! file access of the examination is in this file.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The files of a host.
pub(super) struct Tree {
    root: PathBuf,
}

/// Owner and permissions of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Access {
    pub mode: u32,
    pub uid: u32,
    pub gid: u32,
}

impl Tree {
    pub(super) fn new(root: impl Into<PathBuf>) -> Self {
        let root = root.into();
        // Links are followed and must end within the tree.
        let root = root.canonicalize().unwrap_or(root);
        Self { root }
    }

    fn at(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// Text of a file without surrounding white space; `None` if the file cannot be read.
    pub(super) fn text(&self, path: &str) -> Option<String> {
        Some(fs::read_to_string(self.at(path)).ok()?.trim().to_owned())
    }

    /// Number in a file.
    pub(super) fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.parse().ok()
    }

    /// Names in a directory, sorted; empty if there is no such directory.
    pub(super) fn names(&self, path: &str) -> Vec<String> {
        let entries = fs::read_dir(self.at(path)).into_iter().flatten().flatten();
        let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    /// Destination of a path after all links, relative to the root of the tree.
    pub(super) fn resolved(&self, path: &str) -> Option<PathBuf> {
        let path = self.at(path).canonicalize().ok()?;
        Some(Path::new("/").join(path.strip_prefix(&self.root).ok()?))
    }

    /// The last part of [`resolved`](Self::resolved).
    pub(super) fn resolved_name(&self, path: &str) -> Option<String> {
        Some(self.resolved(path)?.file_name()?.to_str()?.to_owned())
    }

    pub(super) fn access(&self, path: &str) -> Option<Access> {
        let metadata = fs::metadata(self.at(path)).ok()?;
        Some(Access { mode: metadata.mode(), uid: metadata.uid(), gid: metadata.gid() })
    }

    /// Whether this tree belongs to the running host. Only then may data that is in no file be read from the kernel.
    pub(super) fn is_host(&self) -> bool {
        self.root == Path::new("/")
    }

    /// Full text of a file; `None` if the file does not exist.
    pub(super) fn whole(&self, path: &str) -> io::Result<Option<String>> {
        match fs::read_to_string(self.at(path)) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            text => text.map(Some),
        }
    }

    /// Writes an existing file, such as a file below `/proc` or `/sys`.
    pub(super) fn set(&self, path: &str, text: &str) -> io::Result<()> {
        // A link that leads out of the tree points to a file outside the examined host.
        if self.resolved(path).is_none() {
            return Err(ErrorKind::NotFound.into());
        }
        let mut file = OpenOptions::new().write(true).truncate(true).open(self.at(path))?;
        file.write_all(text.as_bytes())
    }

    /// Replaces a whole file with `text`, or deletes the file if `text` is `None`. After a power failure the file has
    /// either its old or its new content.
    pub(super) fn replace(&self, path: &str, text: Option<&str>) -> io::Result<()> {
        replace(&self.at(path), text, 0o644)
    }

    /// Build configuration of the running kernel, if available.
    pub(super) fn kernel_config(&self) -> Option<String> {
        let release = self.text("/proc/sys/kernel/osrelease")?;
        let packed = || output_of(Command::new("gzip").arg("-dc").arg(self.at("/proc/config.gz")));
        self.text(&format!("/boot/config-{release}")).or_else(packed)
    }
}

/// [`Tree::replace`] for a path outside the tree. A new file gets the permissions `mode`.
pub(super) fn replace(path: &Path, text: Option<&str>, mode: u32) -> io::Result<()> {
    let directory = path.parent().ok_or(ErrorKind::InvalidInput)?;
    if let Some(text) = text {
        fs::create_dir_all(directory)?;
        let mut name = path.file_name().ok_or(ErrorKind::InvalidInput)?.to_owned();
        name.push(".new");
        let new = directory.join(name);
        // Deletes the remainder of a crash. If another user placed a link here, writing would change the destination of
        // the link.
        match fs::remove_file(&new) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&new)?;
        if let Ok(old) = fs::metadata(path) {
            file.set_permissions(old.permissions())?;
        }
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, path)?;
    } else {
        fs::remove_file(path)?;
    }
    File::open(directory)?.sync_all()
}

/// Output of a program; `None` if the program is not installed, fails or takes longer than two seconds.
pub(super) fn output_of(program: &Command) -> Option<String> {
    let mut bounded = Command::new("timeout");
    bounded.args(["--kill-after=1", "2"]);
    bounded.arg(program.get_program()).args(program.get_args());
    let output = bounded.output().ok()?;
    let printed = String::from_utf8(output.stdout).ok()?;
    output.status.success().then_some(printed)
}

/// Maximum number of CPUs for which a kernel is built.
const MOST_CPUS: usize = 8192;

/// Numbers in a list such as `0-3,6`, the notation of the kernel for sets of CPUs. Numbers above the maximum are left
/// out.
pub(super) fn cpu_list(text: &str) -> BTreeSet<usize> {
    let ranges = text.trim().split(',').filter_map(|part| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let last: usize = last.trim().parse().ok()?;
        Some(first.trim().parse().ok()?..=last.min(MOST_CPUS))
    });
    ranges.flatten().collect()
}

/// Text of a set of CPUs in the notation that [`cpu_list`] reads.
pub(super) fn cpu_ranges(cpus: &BTreeSet<usize>) -> String {
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for &cpu in cpus {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == cpu => *last = cpu,
            _ => ranges.push((cpu, cpu)),
        }
    }
    let shown = ranges.into_iter().map(|(first, last)| match last - first {
        0 => first.to_string(),
        _ => format!("{first}-{last}"),
    });
    shown.collect::<Vec<_>>().join(",")
}

/// Value after `name` and a colon, as in `/proc/self/status`.
pub(super) fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
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
            let set = cpu_list(text);
            assert!(set.iter().eq(cpus), "{text:?}");
            assert_eq!(cpu_list(&cpu_ranges(&set)), set);
        }
        assert_eq!(cpu_ranges(&[0, 1, 2, 4, 6, 7].into()), "0-2,4,6-7");
        assert_eq!(cpu_list("0-18446744073709551615").len(), MOST_CPUS + 1);
    }

    #[test]
    fn a_program_that_fails_hangs_or_is_not_there_tells_nothing() {
        let mut echo = Command::new("echo");
        assert_eq!(output_of(echo.arg("told")).as_deref(), Some("told\n"));
        let mut sleep = Command::new("sleep");
        for program in [&mut Command::new("false"), &mut Command::new("no-such-program"), sleep.arg("60")] {
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
