//! What an examination says: one value for each thing that was read.

use serde::Serialize;

use super::fix::Fix;

/// Whether a cell can run on what was found. The worst of all findings is the command's exit status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Verdict {
    /// As it should be.
    Ok,
    /// It runs, and cycles may be late or faults heal slowly.
    Warning,
    /// It does not run.
    NotUsable,
}

/// One reading of the host and its consequence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Finding {
    /// What was examined: a room of the host, an interface or a line.
    pub(crate) of: String,
    /// Which property of it.
    pub(crate) what: &'static str,
    /// What was read.
    pub(crate) read: String,
    pub(crate) verdict: Verdict,
    /// Why it matters.
    pub(crate) why: &'static str,
    /// The command or the file that mends it; none where there is nothing to mend.
    pub(crate) mend: Option<String>,
    /// What `--fix` sets, in this order; nothing where only a person can mend it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) fixes: Vec<Fix>,
}

impl Finding {
    /// A property that is as it should be, until [`warning`](Self::warning) or [`not_usable`](Self::not_usable).
    pub(crate) fn new(
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

    /// What `--fix` does about it.
    pub(crate) fn fixed_by(self, fixes: impl IntoIterator<Item = Fix>) -> Self {
        Self {
            fixes: fixes.into_iter().collect(),
            ..self
        }
    }

    /// A warning instead.
    pub(crate) fn warning(self, mend: impl Into<String>) -> Self {
        self.judged(Verdict::Warning, mend)
    }

    /// Not usable instead.
    pub(crate) fn not_usable(self, mend: impl Into<String>) -> Self {
        self.judged(Verdict::NotUsable, mend)
    }

    /// `verdict`, which is not [`Verdict::Ok`], instead.
    pub(crate) fn judged(self, verdict: Verdict, mend: impl Into<String>) -> Self {
        let mend = Some(mend.into());
        Self {
            verdict,
            mend,
            ..self
        }
    }
}
