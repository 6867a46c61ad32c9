//! Finding: the result of one check of the host.

use serde::Serialize;

use super::fix::Fix;

/// Whether a cell can run under a finding. The worst verdict of all findings is the exit status of the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Verdict {
    /// No change needed.
    Ok,
    /// A cell runs, but cycles may be late, or recovery from faults may take long.
    Warning,
    /// A cell does not run.
    NotUsable,
}

impl Verdict {
    /// This verdict if the property is `wrong`, otherwise [`Ok`](Self::Ok).
    pub(super) fn when(self, wrong: bool) -> Self {
        if wrong { self } else { Self::Ok }
    }
}

/// One property of the host and its consequence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Finding {
    /// Examined subject: a part of the host, an interface or a line.
    pub of: String,
    /// Examined property of the subject.
    pub what: &'static str,
    /// Value of the property.
    pub read: String,
    pub verdict: Verdict,
    /// Consequence for a cell.
    pub why: &'static str,
    /// The command or the file that corrects the property; `None` if no correction is needed.
    pub mend: Option<String>,
    /// Changes that `--fix` makes, in this order. Empty if a person has to make the correction.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fixes: Vec<Fix>,
}

impl Finding {
    /// A finding with verdict [`Verdict::Ok`]; [`judged`](Self::judged) changes the verdict.
    pub(super) fn new(of: &str, what: &'static str, read: impl Into<String>, why: &'static str) -> Self {
        Self { of: of.to_owned(), what, read: read.into(), verdict: Verdict::Ok, why, mend: None, fixes: Vec::new() }
    }

    /// Sets the verdict, and the correction that any verdict but [`Verdict::Ok`] asks for.
    pub(super) fn judged(mut self, verdict: Verdict, mend: impl Into<String>) -> Self {
        self.verdict = verdict;
        self.mend = (verdict != Verdict::Ok).then(|| mend.into());
        self
    }

    /// Adds the changes that `--fix` makes if a correction is needed.
    pub(super) fn fixed_by(mut self, fixes: impl IntoIterator<Item = Fix>) -> Self {
        if self.verdict != Verdict::Ok {
            self.fixes.extend(fixes);
        }
        self
    }
}
