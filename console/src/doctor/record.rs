//! The undo record: every change that `--fix` makes, on the disk before it is made, the oldest first.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};

use super::fix::Knob;
use super::tree;
use crate::input::{self, InputError};

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
        let lock = File::open(directory).with_context(shown)?;
        if lock.try_lock().is_err() {
            bail!("{}: another doctor is at work with it", shown());
        }
        let changes = match input::read(&path, input::RECORD) {
            Err(InputError::Os(error)) if error.kind() == ErrorKind::NotFound => Vec::new(),
            bytes => {
                let bytes = bytes.with_context(shown)?;
                serde_json::from_slice(&bytes)
                    .with_context(|| format!("{}: no record of changes", shown()))?
            }
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
        tree::replace(&self.path, text)
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }
}
