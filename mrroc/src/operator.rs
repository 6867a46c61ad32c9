//! The operator's console: lines of standard input, and texts on standard error.
//!
//! Threads of the console read, format and write. A run does not wait for these threads, except for a short time at its
//! end, until the last texts are shown. No thread blocks in a queue of the run, because the controller would have to
//! wake the thread.

use std::io::{BufRead, BufReader, Read as _, stdin};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, bail};
use controller::sensor::{OperatorLink, OperatorPanel};

use crate::bench::BenchKind;
use crate::run::{Background, Requests, SMALL_STACK, crew};
use crate::streams;

/// Lines that wait for a question. Standard input is read on when there is room again.
const LINES: usize = 64;

/// Texts that wait to be shown without an operator. A run in virtual time may tell much in a short time.
const TEXTS: usize = 1024;

/// Greatest length of a line, bytes. A longer line is ignored with a message.
const LONGEST: u64 = 1000;

/// Greatest number of lines of a run in virtual time.
const MOST_LINES: usize = 10_000;

/// Longest wait for the last texts, and time between two looks at a stop request.
const WAIT: Duration = Duration::from_millis(500);

/// Time between two polls of the queues of a run.
const LOOK: Duration = Duration::from_millis(10);

const NO_THREAD: &str = "no thread for the operator's console can be made";

/// Threads that read the operator's lines and show texts to the operator.
pub(crate) struct Console {
    pub(crate) link: OperatorLink,
    /// Passes lines on to a run, at fixed intervals.
    _lines: Option<Background<()>>,
    texts: Background<()>,
}

/// Lines on their way from a thread that reads to the queue of a run.
struct Feed {
    /// A line for which the queue of the run had no room.
    waiting: Option<String>,
    /// The lines that were read, and the queue of the run; `None` after the end of the input, or of the run.
    queues: Option<(Receiver<String>, SyncSender<String>)>,
}

impl Feed {
    /// Passes lines on while the queue has room. Closes the queue behind the last line.
    fn pass(&mut self) {
        while let Some((read, lines)) = &self.queues {
            let line = match self.waiting.take().map_or_else(|| read.try_recv(), Ok) {
                Ok(line) => line,
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) => {
                    self.queues = None;
                    return;
                }
            };
            match lines.try_send(line) {
                Ok(()) => {}
                Err(TrySendError::Full(line)) => {
                    self.waiting = Some(line);
                    return;
                }
                Err(TrySendError::Disconnected(_)) => self.queues = None,
            }
        }
    }
}

impl Console {
    /// A console of this process. `show` shows one text.
    ///
    /// In lockstep, virtual time does not wait for an operator. Standard input is then read to its end first, so that
    /// two runs with the same input are the same.
    pub(crate) fn start(
        bench: BenchKind,
        requests: &Requests,
        show: impl FnMut(&str) + Send + 'static,
    ) -> anyhow::Result<Self> {
        Self::reading(BufReader::new(stdin()), bench, requests, show)
    }

    /// The same, with the lines of `input`.
    pub(crate) fn reading(
        input: impl BufRead + Send + 'static,
        bench: BenchKind,
        requests: &Requests,
        show: impl FnMut(&str) + Send + 'static,
    ) -> anyhow::Result<Self> {
        // A panic of a thread of the console must end the run.
        let _member = requests.crew.join();
        let (sender, read) = sync_channel(LINES);
        spawn("operator input", move || read_lines(input, &sender))?;
        let (link, texts, lines) = if bench == BenchKind::Lockstep {
            let all = all_lines(&read, requests)?;
            // Each line has at most one question and two messages.
            let (link, OperatorPanel { lines, texts }) = OperatorLink::new(3 * all.len() + LINES);
            all.into_iter().try_for_each(|line| lines.try_send(line)).context("the queue has room for all lines")?;
            (link, texts, None)
        } else {
            let (link, OperatorPanel { lines, texts }) = OperatorLink::new(LINES);
            let feed = Feed { waiting: None, queues: Some((read, lines)) };
            (link, texts, Some(background("operator lines", feed, Feed::pass)?))
        };
        let texts = background("operator output", (texts, show), |(texts, show)| {
            texts.try_iter().for_each(|text| show(&text));
        })?;
        Ok(Self { link, _lines: lines, texts })
    }

    /// A console that shows texts, and reads no lines.
    pub(crate) fn of_texts(requests: &Requests, show: impl FnMut(&str) + Send + 'static) -> anyhow::Result<Self> {
        let _member = requests.crew.join();
        let (link, OperatorPanel { lines: _, texts }) = OperatorLink::new(TEXTS);
        let texts = background("operator output", (texts, show), |(texts, show)| {
            texts.try_iter().for_each(|text| show(&text));
        })?;
        Ok(Self { link, _lines: None, texts })
    }

    /// Waits until the last texts are shown, at most [`WAIT`].
    pub(crate) fn finish(self) {
        // The texts of a blocked terminal are not waited for.
        let _ = self.texts.finish(WAIT);
    }
}

/// A thread that polls the queues of a run, and once more at the end of the run.
fn background<S: Send + 'static>(
    name: &str,
    state: S,
    look: impl Fn(&mut S) + Copy + Send + 'static,
) -> anyhow::Result<Background<()>> {
    let thread = Background::start(name, LOOK, state, look, move |mut state| look(&mut state));
    thread.context(NO_THREAD)
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> anyhow::Result<()> {
    let crew = crew::current();
    let body = move || {
        let _member = crew::join(crew);
        work();
    };
    let thread = Builder::new().name(name.to_owned()).stack_size(SMALL_STACK).spawn(body);
    thread.context(NO_THREAD)?;
    Ok(())
}

/// All lines up to the end of the input.
fn all_lines(read: &Receiver<String>, requests: &Requests) -> anyhow::Result<Vec<String>> {
    let mut all = Vec::new();
    loop {
        match read.recv_timeout(WAIT) {
            Ok(_) if all.len() == MOST_LINES => bail!("--operator: standard input has more than {MOST_LINES} lines"),
            Ok(line) => all.push(line),
            Err(RecvTimeoutError::Disconnected) => return Ok(all),
            Err(RecvTimeoutError::Timeout) if requests.is_stopped() => bail!("stopped on request"),
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Passes lines on until the end of the input, or until the run takes no more.
fn read_lines(mut input: impl BufRead, lines: &SyncSender<String>) {
    loop {
        crew::point("operator input");
        let mut line = Vec::new();
        let read = (&mut input).take(LONGEST + 1).read_until(b'\n', &mut line);
        let longer = line.len() as u64 > LONGEST && line.last() != Some(&b'\n');
        let skipped = if longer { input.skip_until(b'\n').map(|_| ()) } else { Ok(()) };
        match read.and_then(|read| skipped.map(|()| read)) {
            Ok(0) => return,
            Ok(_) if longer => streams::warn(format_args!("mrroc: a line of more than {LONGEST} bytes is ignored")),
            Ok(_) => {
                let line = String::from_utf8_lossy(&line).trim().to_owned();
                if lines.send(line).is_err() {
                    return;
                }
            }
            Err(error) => return streams::warn(format_args!("mrroc: standard input: {error}")),
        }
    }
}

#[cfg(test)]
mod tests {
    //! Consoles with inputs of a test.

    use std::io::Cursor;

    use super::*;

    fn lines(input: Vec<u8>) -> Vec<String> {
        let (sender, read) = sync_channel(LINES);
        read_lines(Cursor::new(input), &sender);
        drop(sender);
        read.into_iter().collect()
    }

    #[test]
    fn a_line_that_is_too_long_is_ignored_and_the_last_line_needs_no_end() {
        let long = "x".repeat(LONGEST as usize);
        assert_eq!(lines(format!("one\r\n{long}x\n{long}\n two").into_bytes()), ["one", &long, "two"]);
        assert_eq!(lines(b"\xff\n".to_vec()), ["\u{fffd}"]);
    }

    #[test]
    fn an_input_of_too_many_lines_is_refused_before_a_run_in_virtual_time() {
        let input = Cursor::new("yes\n".repeat(MOST_LINES + 1));
        let refused = Console::reading(input, BenchKind::Lockstep, &Requests::default(), |_| {});
        assert!(refused.err().unwrap().to_string().contains("more than 10000 lines"));
    }

    #[test]
    fn lines_beyond_the_room_of_a_run_follow_when_there_is_room_and_the_input_is_closed_behind_them() {
        let (sender, read) = sync_channel(LINES);
        let (lines, taken) = sync_channel(2);
        let mut feed = Feed { waiting: None, queues: Some((read, lines)) };
        feed.pass();
        assert_eq!(taken.try_recv(), Err(TryRecvError::Empty));
        (0..5).for_each(|line: u8| sender.send(line.to_string()).unwrap());
        drop(sender);
        for expected in [&["0", "1"][..], &["2", "3"], &["4"]] {
            feed.pass();
            assert_eq!(taken.try_iter().collect::<Vec<_>>(), expected);
        }
        assert_eq!(taken.try_recv(), Err(TryRecvError::Disconnected));
    }

    #[test]
    fn a_run_that_takes_no_more_lines_ends_the_reading() {
        let (sender, read) = sync_channel(LINES);
        let (lines, taken) = sync_channel(2);
        let mut feed = Feed { waiting: None, queues: Some((read, lines)) };
        drop(taken);
        sender.send("yes".to_owned()).unwrap();
        feed.pass();
        // The thread that reads ends at its next line.
        assert!(sender.send("no".to_owned()).is_err());
    }

    /// An input that never ends.
    struct Endless;

    impl std::io::Read for Endless {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            loop {
                std::thread::park();
            }
        }
    }

    #[test]
    fn a_blocked_input_does_not_hold_up_the_end_of_a_run_and_all_texts_are_shown() {
        let (tell, shown) = sync_channel(LINES);
        let show = move |text: &str| tell.send(text.to_owned()).unwrap();
        let console =
            Console::reading(BufReader::new(Endless), BenchKind::Emulated, &Requests::default(), show).unwrap();
        console.link.show("one");
        console.link.show("two");
        console.finish();
        assert_eq!(shown.into_iter().collect::<Vec<_>>(), ["one", "two"]);
    }

    #[test]
    fn a_stop_request_ends_the_wait_for_the_input_of_a_run_in_virtual_time() {
        let requests = Requests::default();
        requests.stop();
        let refused = Console::reading(BufReader::new(Endless), BenchKind::Lockstep, &requests, |_| {});
        assert_eq!(refused.err().unwrap().to_string(), "stopped on request");
    }
}
