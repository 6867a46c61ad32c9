//! The `main` of a robot program: arguments, signals, progress and the printed report.

use std::io::{IsTerminal as _, stderr};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, Parser};
use indicatif::{ProgressBar, ProgressStyle};
use servo::Phase;
use signal_hook::{consts::SIGUSR1, flag};

use crate::cell::CellFile;
use crate::operator::Console;
use crate::report::RunOutcome;
use crate::run::{Progress, Requests, RunOptions, run};
use crate::signals::Motion;
use crate::tasks::{Cell, Outcome, Program};
use crate::{signals, streams};

/// Options of a robot program except its cell: the options of `mrroc run`.
#[derive(Args, Debug)]
pub struct ProgramOptions {
    /// The bench and the files.
    #[command(flatten)]
    pub run: RunOptions,
    /// Print one JSON object at the end.
    #[arg(long)]
    pub json: bool,
    /// Answer questions of the task by lines of standard input. The questions appear on standard error. With --bench
    /// lockstep, standard input is read to its end before the run.
    #[arg(long)]
    pub operator: bool,
}

/// Arguments of a robot program.
#[derive(Parser)]
struct Arguments {
    /// The cell file to use in place of the program's own.
    cell: Option<PathBuf>,
    #[command(flatten)]
    options: ProgramOptions,
}

/// The `main` of a robot program: reads the arguments, rehearses and runs `task`, prints the report.
///
/// The arguments are those of `mrroc run`. `cell` is the default cell file. Moves hardware with `--bench card`. The
/// exit status is 0 after the end of the task, 1 after a fault, a requested stop or if a file of the run is incomplete, and
/// 2 if the program was refused before any motion.
pub fn program(cell: &str, task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static) -> ExitCode {
    let Arguments { cell: given, options } = Arguments::parse();
    let cell = given.unwrap_or_else(|| cell.into());
    CellFile::read(&cell).and_then(|file| run_program(&file, &options, &Program::of(task))).unwrap_or_else(|refusal| {
        streams::refuse(&refusal);
        ExitCode::from(2)
    })
}

/// Runs `program` with a progress bar and prints the report. Signals that end a process first brake the robots.
pub fn run_program(file: &CellFile, options: &ProgramOptions, program: &Program) -> anyhow::Result<ExitCode> {
    signals::block_signals_of_writes()?;
    let requests = Requests::default();
    let flags = [
        &requests.spikes,
        #[cfg(feature = "recording")]
        &requests.flight.0,
    ];
    for request in flags {
        flag::register(SIGUSR1, Arc::clone(request)).context("SIGUSR1 cannot be caught")?;
    }
    let (asked, motion) = (requests.clone(), Motion::on(options.run.bench));
    signals::on_ending_of_motion(motion.clone(), move |_| asked.stop())?;
    let mut bar = Bar::new(file, !options.json)?;
    let shown = bar.bar.clone();
    let show = move |text: &str| shown.suspend(|| streams::warn(format_args!("mrroc: {text}")));
    let (console, program) = if options.operator {
        let console = Console::start(options.run.bench, &requests, show)?;
        let program = program.clone().with_operator(console.link.clone());
        (console, program)
    } else {
        let console = Console::of_texts(&requests, show)?;
        let program = program.clone().with_texts(console.link.clone());
        (console, program)
    };
    let report = run(file, &options.run, &requests, &program, &mut |news| bar.show(news));
    motion.is_over();
    bar.bar.finish_and_clear();
    drop(program);
    console.finish();
    let report = report?;
    let lost = match streams::answered(&report, options.json) {
        Ok(true) => None,
        Ok(false) => Some(streams::CLOSED.to_owned()),
        // A refusal is too late, because everything has moved.
        Err(error) => Some(format!("{error:#}")),
    };
    if let Some(why) = lost {
        streams::warn(format_args!(
            "mrroc: the report cannot be printed: {why}. The run ended: {}. --out keeps a report in a directory",
            report.outcome
        ));
        return Ok(ExitCode::from(1));
    }
    Ok(ExitCode::from(match report.outcome {
        RunOutcome::Completed => u8::from(!report.incomplete_files.is_empty()),
        RunOutcome::Faulted | RunOutcome::Stopped => 1,
    }))
}

/// The bar, whose spinner and time move while an instruction is under way.
const BAR: &str = "{spinner} {elapsed:>4} [{bar:30}] {pos}/{len} {msg}";

/// Time between two pictures of the bar.
const TICK: Duration = Duration::from_millis(250);

struct Bar {
    bar: ProgressBar,
    names: Vec<String>,
    phases: Vec<Phase>,
}

impl Bar {
    /// A bar for all instructions of all robots, or no bar.
    fn new(file: &CellFile, shown: bool) -> anyhow::Result<Self> {
        let bar = if shown { ProgressBar::new(0) } else { ProgressBar::hidden() };
        let style = ProgressStyle::with_template(BAR)?;
        bar.set_style(style.progress_chars("=> "));
        if shown && stderr().is_terminal() {
            // Homing is one instruction of many seconds.
            bar.enable_steady_tick(TICK);
        }
        let names = file.cell.robot.iter().map(|robot| robot.name.clone());
        Ok(Self { bar, names: names.collect(), phases: vec![Phase::Off; file.cell.robot.len()] })
    }

    /// Shows the progress of a robot.
    fn show(&mut self, news: Progress) {
        self.bar.set_length(news.expected);
        self.bar.inc(news.ended);
        self.phases[news.robot] = news.phase;
        let robots = self.names.iter().zip(&self.phases);
        let message: Vec<_> = robots.map(|(name, phase)| format!("{name}: {phase:?}")).collect();
        self.bar.set_message(message.join(", "));
    }
}
