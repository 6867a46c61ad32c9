//! Runs the programs of a cell file, and prints the number of servo cycles: `cycles CELL BENCH CSV TRACE`. The library has no
//! features, so a compiler with a sanitizer builds few packages.

use mrroc::bench::BenchKind;
use mrroc::cell::CellFile;
use mrroc::report::RunOutcome;
use mrroc::run::{Requests, RunOptions, run};
use mrroc::tasks::CarriedTask;

fn main() -> Result<(), mrroc::Error> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [cell, bench, record, trace] = &words[..] else { panic!("CELL BENCH CSV TRACE, not {words:?}") };
    let bench = match bench.as_str() {
        "lockstep" => BenchKind::Lockstep,
        "emulated" => BenchKind::Emulated,
        other => panic!("no bench of this process: {other}"),
    };
    let file = CellFile::read(cell)?;
    // Only cells with a CAN bus have a trace.
    let trace = (!file.cell.bus.is_empty()).then(|| trace.into());
    let options = RunOptions { record: Some(record.into()), trace, ..RunOptions::on(bench) };
    let program = CarriedTask::default().program();
    let report = run(&file, &options, &Requests::default(), &program, &mut |_| {})?;
    assert_eq!(report.outcome, RunOutcome::Completed, "{:?}", report.faults);
    println!("{} cycles", report.cycle.cycles);
    Ok(())
}
