//! What `mrroc check` and `mrroc run --bench lockstep` say of a cell, and whether the two agree.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex};
use std::thread;

use crate::configuration;
use crate::mrroc::{Directory, Output, Running};

/// Address space of a child process, KiB: nothing grows beyond 200 MB.
const MEMORY: u32 = 200_000;

/// The device configuration file beside each cell.
pub(super) const DCF: &str = "motor.dcf";

/// What `mrroc check` and `mrroc run` agree on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Ready, and run to the end.
    Ready,
    /// Refused by both, in these words behind the path of the file.
    Refused(String),
}

/// How the two disagree on a cell, or how either ends otherwise than it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Called ready by check, and ended by a fault.
    Faulted,
    /// Called ready by check, and refused by run.
    RefusedByRun,
    /// Refused by check alone.
    RefusedByCheck,
    /// Refused by both in different words.
    Worded,
    /// Refused without a line of the file or in several lines.
    Placeless,
    /// Ended by a panic or a signal, which an allocation beyond the bound of memory is too.
    Broken,
    /// Not ended by its deadline.
    Hung,
}

/// A disagreement with what the two said.
#[derive(Debug)]
pub(super) struct Disagreement {
    pub(super) kind: Kind,
    pub(super) said: String,
}

impl fmt::Display for Disagreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {}", self.kind, self.said)
    }
}

/// Asks both about a cell.
pub(super) fn judge(cell: &str) -> Result<Verdict, Disagreement> {
    let directory = Directory::new();
    // Profile velocity, 0 to 50,000 rpm.
    let (dcf, _) = configuration::dcf(&[("6081", "ParameterValue=1000")]);
    directory.write(DCF, &dcf);
    let path = directory.write("cell.toml", cell);
    let asked = ask(&path, &["check"]).and_then(|checked| {
        let run = ask(&path, &["run", "--bench=lockstep", "--json"])?;
        Ok((checked, run))
    });
    let (checked, run) = asked.map_err(|said| Disagreement {
        kind: Kind::Hung,
        said,
    })?;
    let panicked = |it: &Output| it.stderr.contains("panicked at");
    let kind = match (checked.status.code(), run.status.code()) {
        _ if panicked(&checked) || panicked(&run) => Kind::Broken,
        (Some(0), Some(0)) => return Ok(Verdict::Ready),
        (Some(2), Some(2)) if checked.stderr != run.stderr => Kind::Worded,
        (Some(2), Some(2)) => match place(&checked.stderr, &path) {
            Some(place) => return Ok(Verdict::Refused(place.to_owned())),
            None => Kind::Placeless,
        },
        (Some(0), Some(1)) => Kind::Faulted,
        (Some(0), Some(2)) => Kind::RefusedByRun,
        (Some(2), Some(0 | 1)) => Kind::RefusedByCheck,
        _ => Kind::Broken,
    };
    let said = |it: &Output| format!("{}: {:.2000}", it.status, it.stderr.trim());
    let said = format!(
        "check {}; run {} {}",
        said(&checked),
        said(&run),
        faults(&run)
    );
    Err(Disagreement { kind, said })
}

/// The faults that the report of a run names.
fn faults(run: &Output) -> String {
    let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap_or_default();
    report["faults"].to_string()
}

/// Runs `mrroc` on a cell within bounds of time and memory; what it was asked if it does not end.
fn ask(path: &Path, arguments: &[&str]) -> Result<Output, String> {
    let _turn = Turn::take();
    let running = arguments
        .iter()
        .map(AsRef::as_ref)
        .chain([path.as_os_str()]);
    let running = Running::within(MEMORY, running);
    // Its panic at the deadline does not know the cell.
    let output = catch_unwind(AssertUnwindSafe(|| running.output()));
    output.map_err(|_| format!("mrroc {} does not end", arguments.join(" ")))
}

/// The refusal behind the path, if it is one line and begins with the number of a line.
fn place<'a>(stderr: &'a str, path: &Path) -> Option<&'a str> {
    let place = stderr.strip_prefix(&format!("mrroc: {}:", path.display()))?;
    let place = place.strip_suffix('\n')?;
    let (line, problem) = place.split_once(": ")?;
    let line: usize = line.parse().ok()?;
    (line > 0 && !problem.is_empty() && !place.contains('\n')).then_some(place)
}

/// The turn of a child process: all tests together have as many as there are processors.
struct Turn;

static TURNS: Mutex<usize> = Mutex::new(0);
static GIVEN_BACK: Condvar = Condvar::new();

impl Turn {
    fn take() -> Self {
        let taken = TURNS.lock().expect("no thread panics with it");
        let full = |taken: &mut usize| *taken >= processors();
        let mut taken = GIVEN_BACK
            .wait_while(taken, full)
            .expect("no thread panics with it");
        *taken += 1;
        Self
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        *TURNS.lock().expect("no thread panics with it") -= 1;
        GIVEN_BACK.notify_one();
    }
}

fn processors() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// A cell, and what is odd about it.
pub(super) struct Case {
    pub(super) cell: String,
    pub(super) what: String,
}

impl From<String> for Case {
    fn from(cell: String) -> Self {
        let what = String::new();
        Self { cell, what }
    }
}

/// The verdicts on cells `0..count`, in their order. Panics as [`judge_but`].
#[track_caller]
pub(super) fn judge_all(count: u64, cell: impl Fn(u64) -> String + Sync) -> Vec<Verdict> {
    judge_but(
        count,
        |number| cell(number).into(),
        |_, _| false,
        |cell| cell,
    )
}

/// The same without the disagreements that `allowed` knows: cases whose reason is written down.
///
/// Panics after the last case if the two disagree on any other. The message has the number and the words of each such
/// case, and the text of the first cell, which `shrink` shortens.
#[track_caller]
pub(super) fn judge_but(
    count: u64,
    case: impl Fn(u64) -> Case + Sync,
    allowed: impl Fn(u64, &Disagreement) -> bool + Sync,
    shrink: impl Fn(String) -> String,
) -> Vec<Verdict> {
    let judged = Mutex::new(Vec::new());
    let next = AtomicU64::new(0);
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return;
            }
            let case = case(number);
            let verdict = judge(&case.cell);
            if let Err(disagreement) = &verdict {
                // A long hunt is looked at before its end.
                println!("case {number}: {} {disagreement}", case.what);
            }
            judged
                .lock()
                .expect("no thread panics with it")
                .push((number, verdict));
        }
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..processors()).map(|_| scope.spawn(work)).collect();
        for thread in threads {
            if let Err(panic) = thread.join() {
                resume_unwind(panic);
            }
        }
    });
    let mut judged = judged.into_inner().expect("every thread has ended");
    judged.sort_by_key(|(number, _)| *number);
    let mut verdicts = Vec::new();
    let mut disagreed = Vec::new();
    for (number, verdict) in judged {
        match verdict {
            Ok(verdict) => verdicts.push(verdict),
            Err(disagreement) if allowed(number, &disagreement) => {}
            Err(disagreement) => disagreed.push((number, disagreement)),
        }
    }
    if let Some((first, _)) = disagreed.first() {
        let line = |(number, it): &(u64, Disagreement)| {
            let what = case(*number).what.replace('\n', "\\n");
            format!("case {number}: {what} {it}\n")
        };
        let (lines, wrong): (String, _) = (disagreed.iter().map(line).collect(), disagreed.len());
        let cell = shrink(case(*first).cell);
        panic!("{wrong} of {count} cells:\n{lines}the cell of case {first}:\n{cell}");
    }
    verdicts
}
