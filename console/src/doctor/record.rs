//! The undo record: every change that `--fix` makes, on the disk before it is made, the oldest first.
//!
//! Undoing means to write and delete files by the words of another file, as root as a rule. A record counts only if this
//! user alone can have written it, and only with changes that `--fix` makes ([`Change::is_admissible`]).

use std::fs::{self, File, Metadata};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use serde::{Deserialize, Serialize};

use super::fix::Knob;
use super::tree;

/// The longest record that is read, bytes: thousands of changes.
const LONGEST: u64 = 1 << 20;

/// Who may read a record and who may write it.
const MODE: u32 = 0o600;

/// What was set, and what it was before; none for a file that was not there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Change {
    pub(crate) knob: Knob,
    pub(crate) before: Option<String>,
    pub(crate) after: String,
}

/// A record that nobody else writes to while it is open.
pub(crate) struct Record {
    path: PathBuf,
    changes: Vec<Change>,
    _lock: File,
}

impl Record {
    /// Opens the record at `path`, empty where there is none, and makes its directory.
    pub(crate) fn open(path: &Path) -> anyhow::Result<Self> {
        let shown = || path.display().to_string();
        let path = std::path::absolute(path).with_context(shown)?;
        let directory = path.parent().context("a record is a file")?;
        fs::create_dir_all(directory).with_context(shown)?;
        Self::existing(&path)
    }

    /// Opens the record at `path`, empty where there is none, in a directory that is there.
    pub(crate) fn existing(path: &Path) -> anyhow::Result<Self> {
        let shown = || path.display().to_string();
        let path = std::path::absolute(path).with_context(shown)?;
        let directory = path.parent().context("a record is a file")?;
        let lock = File::open(directory).with_context(shown)?;
        if lock.try_lock().is_err() {
            bail!("{}: another doctor is at work with it", shown());
        }
        let changes = match read(&path).with_context(shown)? {
            None => Vec::new(),
            Some(text) => changes(&text).with_context(shown)?,
        };
        Ok(Self {
            path,
            changes,
            _lock: lock,
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// Adds a change that is about to be made.
    pub(crate) fn push(&mut self, change: Change) -> anyhow::Result<()> {
        self.changes.push(change);
        self.store()
    }

    /// The last change came out otherwise.
    pub(crate) fn amend(&mut self, after: String) -> anyhow::Result<()> {
        if let Some(last) = self.changes.last_mut() {
            last.after = after;
        }
        self.store()
    }

    /// Forgets the last change.
    pub(crate) fn pop(&mut self) -> anyhow::Result<()> {
        self.remove(self.changes.len() - 1)
    }

    /// Forgets the change at `index`.
    pub(crate) fn remove(&mut self, index: usize) -> anyhow::Result<()> {
        self.changes.remove(index);
        self.store()
    }

    fn store(&self) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(&self.changes)?;
        let text = (!self.changes.is_empty()).then_some(text.as_str());
        tree::replace(&self.path, text, MODE)
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }
}

/// The text of a record; none where there is none. Neither a link nor a device is opened.
fn read(path: &Path) -> anyhow::Result<Option<String>> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        found => ensure!(
            found?.is_file(),
            "no plain file, and so no record of changes"
        ),
    }
    let file = File::open(path)?;
    let status = fs::read_to_string("/proc/self/status")?;
    let user = effective_user(&status).context("/proc/self/status does not tell who we are")?;
    // Of the file that was opened, whatever has its name by now.
    check(&file.metadata()?, user)?;
    let mut text = String::new();
    file.take(LONGEST + 1).read_to_string(&mut text)?;
    ensure!(text.len() as u64 <= LONGEST, TOO_LONG);
    Ok(Some(text))
}

const TOO_LONG: &str = "too long for a record of changes";

/// The effective user-ID in a `/proc/PID/status`.
fn effective_user(status: &str) -> Option<u32> {
    tree::field(status, "Uid")?
        .split_whitespace()
        .nth(1)?
        .parse()
        .ok()
}

/// Refuses a file that somebody else than `user` may have written, and what is no plain file.
fn check(file: &Metadata, user: u32) -> anyhow::Result<()> {
    ensure!(file.is_file(), "no plain file, and so no record of changes");
    ensure!(
        file.uid() == user,
        "belongs to user {}, and this is user {user}: nobody is to change the host by a record of somebody else",
        file.uid()
    );
    ensure!(
        file.mode() & 0o022 == 0,
        "others than its owner can write it: `chmod go-w` it if its changes are right"
    );
    ensure!(file.len() <= LONGEST, TOO_LONG);
    Ok(())
}

/// The changes of a record.
fn changes(text: &str) -> anyhow::Result<Vec<Change>> {
    let changes: Vec<Change> = serde_json::from_str(text).context("no record of changes")?;
    for (number, change) in (1..).zip(&changes) {
        ensure!(
            change.is_admissible(),
            "no record of changes that --fix makes: {} in change {number}",
            change.knob
        );
    }
    Ok(changes)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};
    use std::process::Command;

    use super::super::tests::Fake;
    use super::*;

    fn refusal(path: &Path) -> String {
        let refused = Record::existing(path).err();
        format!("{:#}", refused.expect("it is refused"))
    }

    #[test]
    fn only_a_plain_file_of_bounded_length_is_read() {
        let fake = Fake::new(&[("record.json", "[]"), ("directory/file", "")]);
        assert!(Record::existing(&fake.path("record.json")).is_ok());
        symlink("record.json", fake.path("link")).unwrap();
        let fifo = Command::new("mkfifo").arg(fake.path("fifo")).status();
        assert!(fifo.unwrap().success());
        fake.write("long", &" ".repeat(LONGEST as usize + 1));
        for (name, why) in [
            ("link", "no plain file"),
            ("fifo", "no plain file"),
            ("directory", "no plain file"),
            ("long", "too long"),
        ] {
            let refusal = refusal(&fake.path(name));
            assert!(refusal.contains(why), "{refusal}");
        }
        for device in ["/dev/zero", "/dev/tty"] {
            assert!(Record::existing(Path::new(device)).is_err(), "{device}");
        }
    }

    #[test]
    fn only_what_this_user_alone_can_have_written_is_read() {
        let fake = Fake::new(&[("record.json", "[]")]);
        let path = fake.path("record.json");
        let metadata = fs::metadata(&path).unwrap();
        let me = metadata.uid();
        assert!(check(&metadata, me).is_ok());
        let refused = check(&metadata, me + 1).unwrap_err().to_string();
        assert!(
            refused.contains(&format!("belongs to user {me}")),
            "{refused}"
        );
        for mode in [0o620, 0o602, 0o666] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            assert!(refusal(&path).contains("can write it"), "{mode:o}");
        }
        assert_eq!(effective_user("Name:\tx\nUid:\t1000\t0\t0\t0\n"), Some(0));
    }

    #[test]
    fn a_record_is_for_its_owner_alone_and_no_link_is_followed_to_it() {
        let fake = Fake::new(&[("victim", "precious")]);
        let path = fake.path("record.json");
        symlink("victim", fake.path("record.json.new")).unwrap();
        let mut record = Record::open(&path).unwrap();
        let knob = Knob::Kernel("/proc/sys/kernel/sched_rt_runtime_us".into());
        let (before, after) = (Some("0".into()), "950000".into());
        let change = Change {
            knob,
            before,
            after,
        };
        record.push(change.clone()).unwrap();
        assert_eq!(fake.text("victim").as_deref(), Some("precious"));
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, MODE);
        drop(record);
        let read = Record::existing(&path).unwrap();
        assert_eq!(read.changes(), [change]);
    }
}
