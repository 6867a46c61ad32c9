//! Random programs and altered cells. A cell that `mrroc check` calls ready runs to its end in lockstep. A cell that
//! `mrroc check` refuses is refused by `mrroc run` with the same text. Neither command panics, hangs or takes more than
//! 200 MB.
//!
//! Serial lines behind USB adapters are not stopped.
//!
//! The cases of a seed are always the same. `MRROC_RANDOM_SEED` sets the seed; the default is 1. `MRROC_RANDOM_TIMES`
//! multiplies the number of cases. Its default 1 takes about a minute on two processors. A value of 48 applies every
//! operator to every key of every cell. Each disagreement is printed at once with its case. At the end, the test fails
//! and prints one cell.

use kit::draw::Draw;
use mutations::Mutations;
use verdict::{Disagreement, Verdict, judge_but};

mod cells;

mod chains;

mod exceptions;

mod grids;

mod homed;

mod latency;

mod mutations;

mod numbers;

mod operators;

mod programs;

mod variants;

mod verdict;

/// Number of random programs in a default run.
const PROGRAMS: u64 = 100;

/// Number of alterations of each key in a default run, each with another operator or in another cell.
const ROUNDS: u64 = 1;

/// Number in an environment variable, or `usual` if the variable is not set.
fn variable(name: &str, usual: u64) -> u64 {
    let Ok(given) = std::env::var(name) else {
        return usual;
    };
    given.parse().unwrap_or_else(|error| panic!("{name}={given}: {error}"))
}

/// Seed of the cases, and the multiple of their default number.
fn extent() -> (u64, u64) {
    let extent = (variable("MRROC_RANDOM_SEED", 1), variable("MRROC_RANDOM_TIMES", 1));
    println!("seed {}, {} times the usual cases", extent.0, extent.1);
    extent
}

#[test]
fn a_random_program_is_run_to_its_end_or_refused() {
    let (seed, times) = extent();
    let case = |number| programs::cell(&mut Draw::of(seed, number)).into();
    let verdicts = judge_but(PROGRAMS * times, case, |_, _| false, programs::shrunk);
    let ready = verdicts.iter().filter(|it| **it == Verdict::Ready).count();
    let all = verdicts.len();
    assert!(ready > all / 4, "{ready} of {all} cells are ready");
}

#[test]
fn a_cell_altered_in_one_line_is_run_to_its_end_or_refused() {
    let (seed, times) = extent();
    let mutations = Mutations::of(seed);
    let sound = |number| mutations.cells()[number as usize].clone().into();
    let cells = mutations.cells().len();
    let verdicts = judge_but(cells as u64, sound, |_, _| false, |cell| cell);
    assert_eq!(verdicts, vec![Verdict::Ready; cells]);
    let count = mutations.keys() as u64 * ROUNDS * times;
    println!("{count} of {} alterations", mutations.complete());
    let case = |number| mutations.case(seed, number);
    let allowed = |number, disagreement: &Disagreement| {
        let reason = exceptions::reason(mutations.key(number), disagreement);
        if let Some(reason) = reason {
            println!("case {number}: {} {disagreement}: {reason}", case(number).what);
        }
        reason.is_some()
    };
    let verdicts = judge_but(count, case, allowed, |cell| cell);
    let ready = verdicts.iter().filter(|it| **it == Verdict::Ready).count();
    assert!(ready > verdicts.len() / 20, "{ready} of {} cells are ready", verdicts.len());
}
