//! What `mrroc check` and `mrroc run --bench lockstep` say of a cell, and whether the two agree.

use std::fmt;
use std::panic::resume_unwind;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use crate::mrroc::{Directory, Output, Running};

/// Address space of a child process, KiB: nothing grows beyond 200 MB.
const MEMORY: u32 = 200_000;

/// What `mrroc check` and `mrroc run` agree on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Ready, and run to the end.
    Ready,
    /// Refused by both, in these words behind the path of the file.
    Refused(String),
}

/// How the two disagree on a cell, or how either ends otherwise than it should.
#[derive(Debug)]
pub(super) struct Disagreement(String);

impl Disagreement {
    fn of(what: &str, checked: &Output, run: &Output) -> Self {
        let said = |it: &Output| format!("{}: {}", it.status, it.stderr.trim());
        let (checked, faults, run) = (said(checked), faults(run), said(run));
        Self(format!("{what}; check {checked}; run {run} {faults}"))
    }
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The faults that the report of a run names.
fn faults(run: &Output) -> String {
    let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap_or_default();
    report["faults"].to_string()
}

/// Asks both about a cell.
pub(super) fn judge(cell: &str) -> Result<Verdict, Disagreement> {
    let directory = Directory::new();
    let path = directory.write("cell.toml", cell);
    let checked = ask(&path, &["check"]);
    let run = ask(&path, &["run", "--bench=lockstep", "--json"]);
    let what = match (checked.status.code(), run.status.code()) {
        (Some(0), Some(0)) => return Ok(Verdict::Ready),
        (Some(2), Some(2)) if checked.stderr != run.stderr => "refused by both, in different words",
        (Some(2), Some(2)) => match place(&checked.stderr, &path) {
            Some(place) => return Ok(Verdict::Refused(place.to_owned())),
            None => "refused without a line of the file",
        },
        (Some(0), Some(1)) => "called ready, and ended by a fault",
        (Some(0), Some(2)) => "called ready, and refused by run",
        (Some(2), Some(0 | 1)) => "refused by check alone",
        _ => "an end that is none",
    };
    Err(Disagreement::of(what, &checked, &run))
}

/// Runs `mrroc` on a cell within bounds of time and memory.
fn ask(path: &Path, arguments: &[&str]) -> Output {
    let arguments = arguments.iter().map(AsRef::as_ref);
    Running::within(MEMORY, arguments.chain([path.as_os_str()])).output()
}

/// The refusal behind the path, if it is one line and begins with the number of a line.
fn place<'a>(stderr: &'a str, path: &Path) -> Option<&'a str> {
    let place = stderr.strip_prefix(&format!("mrroc: {}:", path.display()))?;
    let place = place.strip_suffix('\n')?;
    let (line, problem) = place.split_once(": ")?;
    let line: usize = line.parse().ok()?;
    (line > 0 && !problem.is_empty() && !place.contains('\n')).then_some(place)
}

/// The verdicts on `count` cells, in their order, asked for by as many threads as there are processors. Panics if the two
/// disagree on any, with what they say of each and the text of the first.
#[track_caller]
pub(super) fn judge_all(count: u64, cell: impl Fn(u64) -> String + Sync) -> Vec<Verdict> {
    let verdicts = Mutex::new(Vec::new());
    let next = AtomicU64::new(0);
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return;
            }
            let text = cell(number);
            let verdict = judge(&text).map_err(|disagreement| (disagreement, text));
            let mut verdicts = verdicts.lock().expect("no thread panics with it");
            verdicts.push((number, verdict));
        }
    };
    let workers = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        for thread in threads {
            if let Err(panic) = thread.join() {
                resume_unwind(panic);
            }
        }
    });
    let mut verdicts = verdicts.into_inner().expect("every thread has ended");
    verdicts.sort_by_key(|(number, _)| *number);
    let mut agreed = Vec::new();
    let mut disagreed = Vec::new();
    for (number, verdict) in verdicts {
        match verdict {
            Ok(verdict) => agreed.push(verdict),
            Err((disagreement, text)) => disagreed.push((number, disagreement, text)),
        }
    }
    if let Some((number, _, text)) = disagreed.first() {
        let lines = disagreed
            .iter()
            .map(|(number, it, _)| format!("case {number}: {it}\n"));
        let lines: String = lines.collect();
        let wrong = disagreed.len();
        panic!("{wrong} of {count} cells:\n{lines}\nthe cell of case {number}:\n{text}");
    }
    agreed
}
