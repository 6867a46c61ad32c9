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
    /// A finding with verdict [`Verdict::Ok`]; [`warning`](Self::warning) and [`not_usable`](Self::not_usable) change
    /// the verdict.
    pub(super) fn new(
        of: &str,
        what: &'static str,
        read: impl Into<String>,
        why: &'static str,
    ) -> Self {
        Self {
            of: of.to_owned(),
            what,
            read: read.into(),
            verdict: Verdict::Ok,
            why,
            mend: None,
            fixes: Vec::new(),
        }
    }

    /// Adds the changes that `--fix` makes.
    pub(super) fn fixed_by(self, fixes: impl IntoIterator<Item = Fix>) -> Self {
        Self {
            fixes: fixes.into_iter().collect(),
            ..self
        }
    }

    /// Changes the verdict to a warning.
    pub(super) fn warning(self, mend: impl Into<String>) -> Self {
        self.judged(Verdict::Warning, mend)
    }

    /// Changes the verdict to not usable.
    pub(super) fn not_usable(self, mend: impl Into<String>) -> Self {
        self.judged(Verdict::NotUsable, mend)
    }

    /// Changes the verdict to `verdict`, which is not [`Verdict::Ok`].
    pub(super) fn judged(self, verdict: Verdict, mend: impl Into<String>) -> Self {
        let mend = Some(mend.into());
        Self {
            verdict,
            mend,
            ..self
        }
    }
}
