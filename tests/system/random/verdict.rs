//! Comparison of `mrroc check` and `mrroc run --bench lockstep` for a cell.

use std::fmt;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex};
use std::thread;

use kit::mrroc::{Directory, Output, Running, example};

use crate::configuration;

/// Address space of a child process, KiB: no command needs more than 200 MB.
const MEMORY: u32 = 200_000;

/// The device configuration file beside each cell.
pub(super) const DCF: &str = "motor.dcf";

/// A robot description beside every cell: that of the Puma 560.
pub(super) const URDF: &str = "arm.urdf";

/// Common result of `mrroc check` and `mrroc run`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// The cell is ready, and runs to the end.
    Ready,
    /// Both commands refuse the cell with this text after the path of the file.
    Refused(String),
}

/// Kind of disagreement, or of an abnormal end of either command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Accepted by check, and ended by a fault in run.
    Faulted,
    /// Accepted by check, and refused by run.
    RefusedByRun,
    /// Refused by check only.
    RefusedByCheck,
    /// Refused by both with different texts.
    Worded,
    /// Refused without a line number of the file, or in several lines.
    Placeless,
    /// Ended by a panic or a signal. An allocation beyond the memory limit also ends in a signal.
    Broken,
    /// Not ended by the deadline.
    Hung,
}

/// A disagreement with the outputs of both commands.
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

/// Runs both commands on a cell.
pub(super) fn judge(cell: &str) -> Result<Verdict, Disagreement> {
    let directory = Directory::new();
    // Profile velocity, 0 to 50,000 rpm.
    let (dcf, _) = configuration::dcf(&[("6081", "ParameterValue=1000")]);
    directory.write(DCF, &dcf);
    let urdf = fs::read_to_string(example("puma560").with_extension("urdf")).expect("the description is in the tree");
    directory.write(URDF, &urdf);
    let path = directory.write("cell.toml", cell);
    let asked = ask(&path, &["check"]).and_then(|checked| {
        let run = ask(&path, &["run", "--bench=lockstep", "--json"])?;
        Ok((checked, run))
    });
    let (checked, run) = asked.map_err(|said| Disagreement { kind: Kind::Hung, said })?;
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
    let said = format!("check {}; run {} {}", said(&checked), said(&run), faults(&run));
    Err(Disagreement { kind, said })
}

/// The faults in the report of a run.
fn faults(run: &Output) -> String {
    let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap_or_default();
    report["faults"].to_string()
}

/// Runs `mrroc` on a cell within limits of time and memory. The error names the arguments if the command does not end.
fn ask(path: &Path, arguments: &[&str]) -> Result<Output, String> {
    let _turn = Turn::take();
    let running = arguments.iter().map(AsRef::as_ref).chain([path.as_os_str()]);
    let running = Running::within(MEMORY, running);
    // The panic at the deadline does not name the cell.
    let output = catch_unwind(AssertUnwindSafe(|| running.output()));
    output.map_err(|_| format!("mrroc {} does not end", arguments.join(" ")))
}

/// The refusal after the path, if it is one line that starts with a line number.
fn place<'a>(stderr: &'a str, path: &Path) -> Option<&'a str> {
    let place = stderr.strip_prefix(&format!("mrroc: {}:", path.display()))?;
    let place = place.strip_suffix('\n')?;
    let (line, problem) = place.split_once(": ")?;
    let line: usize = line.parse().ok()?;
    (line > 0 && !problem.is_empty() && !place.contains('\n')).then_some(place)
}

/// Permission to run a child process. All tests together have as many permissions as there are processors.
struct Turn;

static TURNS: Mutex<usize> = Mutex::new(0);

static GIVEN_BACK: Condvar = Condvar::new();

impl Turn {
    fn take() -> Self {
        let taken = TURNS.lock().expect("no thread panics with it");
        let full = |taken: &mut usize| *taken >= processors();
        let mut taken = GIVEN_BACK.wait_while(taken, full).expect("no thread panics with it");
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

/// The results of `work` on `0..count` in order, by as many threads as there are processors.
fn by_threads<R: Send>(count: u64, work: impl Fn(u64) -> R + Sync) -> Vec<R> {
    let done = Mutex::new(Vec::new());
    let next = AtomicU64::new(0);
    let worker = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return;
            }
            let result = work(number);
            done.lock().expect("no thread panics with it").push((number, result));
        }
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..processors()).map(|_| scope.spawn(worker)).collect();
        for thread in threads {
            if let Err(panic) = thread.join() {
                resume_unwind(panic);
            }
        }
    });
    let mut done = done.into_inner().expect("every thread has ended");
    done.sort_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

/// As [`by_threads`], for work in this process: it takes the turn of a child process.
pub(super) fn in_turns<R: Send>(count: u64, work: impl Fn(u64) -> R + Sync) -> Vec<R> {
    by_threads(count, |number| {
        let _turn = Turn::take();
        work(number)
    })
}

/// A cell and its peculiarity.
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

/// The verdicts on cells `0..count` in order. Panics as [`judge_but`].
#[track_caller]
pub(super) fn judge_all(count: u64, cell: impl Fn(u64) -> String + Sync) -> Vec<Verdict> {
    judge_but(count, |number| cell(number).into(), |_, _| false, |cell| cell)
}

/// The verdicts on cells `0..count`, without the disagreements for which `allowed` gives a reason.
///
/// Panics after the last case if there is any other disagreement. The message contains the number and the outputs of
/// each such case, and the text of the first cell, shortened by `shrink`.
#[track_caller]
pub(super) fn judge_but(
    count: u64,
    case: impl Fn(u64) -> Case + Sync,
    allowed: impl Fn(u64, &Disagreement) -> bool + Sync,
    shrink: impl Fn(String) -> String,
) -> Vec<Verdict> {
    let judged = by_threads(count, |number| {
        let case = case(number);
        let verdict = judge(&case.cell);
        if let Err(disagreement) = &verdict {
            // Results of a long run are inspected before its end.
            println!("case {number}: {} {disagreement}", case.what);
        }
        verdict
    });
    let mut verdicts = Vec::new();
    let mut disagreed = Vec::new();
    for (number, verdict) in (0..).zip(judged) {
        match verdict {
            Ok(verdict) => verdicts.push(verdict),
            Err(disagreement) if allowed(number, &disagreement) => {}
            Err(disagreement) => disagreed.push((number, disagreement)),
        }
    }
    if let Some((first, _)) = disagreed.first() {
        let line = |(number, it): &(u64, Disagreement)| {
            let Case { what, cell } = case(*number);
            let kept = std::env::temp_dir().join(format!("mrroc-case-{number}.toml"));
            let kept = fs::write(&kept, cell).map_or_else(|error| error.to_string(), |()| kept.display().to_string());
            format!("case {number}: {} {it}; the cell: {kept}\n", what.replace('\n', "\\n"))
        };
        let (lines, wrong): (String, _) = (disagreed.iter().map(line).collect(), disagreed.len());
        let cell = shrink(case(*first).cell);
        panic!("{wrong} of {count} cells:\n{lines}the cell of case {first}:\n{cell}");
    }
    verdicts
}
