//! Undo record: every change that `--fix` makes, the oldest first. A change is on the disk before it is made.
//!
//! `--undo` writes and deletes files according to a record, usually as root. A record is accepted only if no other user
//! can have written it. Every change in the record must be one that `--fix` can make ([`Change::check`]).

use std::fmt;
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::fix::Knob;
use super::tree;
use mrroc::input::{self, InputError};

/// Permissions of a record: its owner reads and writes it.
const MODE: u32 = 0o600;

/// A knob with its values before and after the change. The value before is `None` if a file did not exist.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Change {
    pub(super) knob: Knob,
    pub(super) before: Option<String>,
    pub(super) after: String,
}

/// An open record, locked against other processes.
pub(super) struct Record {
    path: PathBuf,
    changes: Vec<Change>,
    _lock: File,
}

impl Record {
    /// Opens the record at `path` and creates its directory. A record that does not exist is empty.
    pub(super) fn open(path: &Path) -> anyhow::Result<Self> {
        let shown = || path.display().to_string();
        let path = std::path::absolute(path).with_context(shown)?;
        fs::create_dir_all(path.parent().context("a record is a file")?).with_context(shown)?;
        Self::existing(&path)
    }

    /// Opens the record at `path`, whose directory must exist. A record that does not exist is empty.
    pub(super) fn existing(path: &Path) -> anyhow::Result<Self> {
        let shown = || path.display().to_string();
        let path = std::path::absolute(path).with_context(shown)?;
        let lock = File::open(path.parent().context("a record is a file")?).with_context(shown)?;
        if lock.try_lock().is_err() {
            bail!("{}: another doctor is at work with it", shown());
        }
        Ok(Self { changes: read(&path).with_context(shown)?, path, _lock: lock })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// Adds a change before it is made.
    pub(super) fn push(&mut self, change: Change) -> anyhow::Result<()> {
        self.changes.push(change);
        self.store()
    }

    /// Corrects the value after the last change to the value that the kernel accepted. A value that no record may
    /// contain is left out. `--undo` then finds a value that differs from the recorded one.
    pub(super) fn amend(&mut self, after: String) -> anyhow::Result<()> {
        if let Some(last) = self.changes.last_mut() {
            let set = std::mem::replace(&mut last.after, after);
            if last.check().is_err() {
                last.after = set;
            }
        }
        self.store()
    }

    /// Removes the last change.
    pub(super) fn pop(&mut self) -> anyhow::Result<()> {
        self.remove(self.changes.len() - 1)
    }

    /// Removes the change at `index`.
    pub(super) fn remove(&mut self, index: usize) -> anyhow::Result<()> {
        self.changes.remove(index);
        self.store()
    }

    fn store(&self) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(&self.changes)?;
        let text = (!self.changes.is_empty()).then_some(text.as_str());
        tree::replace(&self.path, text, MODE).with_context(|| format!("{}: cannot be written", self.path.display()))
    }
}

/// Reads the changes of the record at `path`; empty if there is no file. The error names the line of a change that
/// `--fix` cannot have made.
fn read(path: &Path) -> anyhow::Result<Vec<Change>> {
    match input::read_own(path, input::RECORD) {
        Err(InputError::Os(error)) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        bytes => serde_json::from_slice(&bytes?).context("no record of changes"),
    }
}

impl<'de> Deserialize<'de> for Change {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        const FIELDS: &[&str] = &["knob", "before", "after"];
        deserializer.deserialize_struct("Change", FIELDS, AdmissibleChange)
    }
}

/// Deserializer that reads and checks one change. An error refers to the line on which the JSON object of the change
/// ends.
struct AdmissibleChange;

impl<'de> Visitor<'de> for AdmissibleChange {
    type Value = Change;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a change with knob, before and after")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Change, A::Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Raw {
            knob: Knob,
            before: Option<String>,
            after: String,
        }
        let raw = Raw::deserialize(MapAccessDeserializer::new(map))?;
        let change = Change { knob: raw.knob, before: raw.before, after: raw.after };
        change.check().map_err(A::Error::custom)?;
        Ok(change)
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    use super::super::tests::Fake;
    use super::*;

    fn refusal(path: &Path) -> String {
        let refused = Record::existing(path).err();
        format!("{:#}", refused.expect("it is refused"))
    }

    #[test]
    fn a_record_that_others_can_have_written_is_refused() {
        let fake = Fake::new(&[("record.json", "[]"), ("open.json", "[]")]);
        assert!(Record::existing(&fake.path("record.json")).is_ok());
        symlink("record.json", fake.path("link")).unwrap();
        let all = fs::Permissions::from_mode(0o666);
        fs::set_permissions(fake.path("open.json"), all).unwrap();
        for (name, why) in [("link", "symbolic link"), ("open.json", "can be written by others")] {
            let refusal = refusal(&fake.path(name));
            assert!(refusal.contains(why) && refusal.contains(name), "{refusal}");
        }
    }

    /// The record has the form that is written to the disk.
    #[test]
    fn the_line_of_a_change_that_no_fix_makes_is_named() {
        let kernel = |path: &str, before: &str| {
            format!(
                "  {{\n    \"knob\": {{\n      \"kernel\": \"{path}\"\n    }},\n    \"before\": \"{before}\",\n    \
                 \"after\": \"950000\"\n  }}"
            )
        };
        let runtime = "/proc/sys/kernel/sched_rt_runtime_us";
        for (path, before, why) in
            [("/etc/passwd", "0", "--fix does not set /etc/passwd"), (runtime, "all", "--fix cannot have found all")]
        {
            let text =
                format!("[\n{},\n{},\n{}\n]\n", kernel(runtime, "0"), kernel(path, before), kernel(runtime, "0"));
            let fake = Fake::new(&[("record.json", &text)]);
            let refusal = refusal(&fake.path("record.json"));
            // The line on which the object of the change ends.
            assert!(refusal.contains("record.json") && refusal.contains("at line 15 "), "{refusal}");
            assert!(refusal.contains(why), "{refusal}");
        }
    }

    #[test]
    fn a_record_is_for_its_owner_alone_and_no_link_is_followed_to_it() {
        let fake = Fake::new(&[("victim", "precious")]);
        let path = fake.path("record.json");
        symlink("victim", fake.path("record.json.new")).unwrap();
        let mut record = Record::open(&path).unwrap();
        let knob = Knob::Kernel("/proc/sys/kernel/sched_rt_runtime_us".into());
        let (before, after) = (Some("0".into()), "950000".into());
        let change = Change { knob, before, after };
        record.push(change.clone()).unwrap();
        assert_eq!(fake.text("victim").as_deref(), Some("precious"));
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, MODE);
        drop(record);
        let read = Record::existing(&path).unwrap();
        assert_eq!(read.changes(), [change]);
    }
}
