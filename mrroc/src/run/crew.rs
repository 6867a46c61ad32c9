//! The threads of a run, and their panics.
//!
//! A thread of a run is a member of its crew. The panic hook notes the thread and the message of each panic of a member. A
//! member that unwinds ends the run: the servo brakes all robots and switches them off (category 1). A panic that a
//! member catches, such as that of a task or a generator, is handled by the member; its message is added to the fault.
//!
//! Threads that [`Background`](super::Background) and other rooms of this crate start are members if their starter is one.

use std::any::Any;
use std::cell::RefCell;
use std::panic::PanicHookInfo;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;

use servo::{StopCategory, StopRequest};

use crate::cell::CellFile;
use crate::report::FaultReport;

/// Greatest number of panics that are noted.
const MOST: usize = 16;

/// The threads of a run.
#[derive(Clone, Debug, Default)]
pub(crate) struct Crew(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    panics: Mutex<Vec<Panic>>,
    /// A member has unwound.
    unwound: AtomicBool,
    stop: Mutex<Option<StopRequest>>,
    /// Number of completed servo cycles.
    cycles: AtomicU64,
    /// The member that panics at its next [`point`].
    #[cfg(test)]
    planted: Mutex<Option<&'static str>>,
}

/// One panic of a member.
#[derive(Clone, Debug)]
struct Panic {
    thread: String,
    message: String,
    /// Number of completed servo cycles.
    cycles: u64,
    /// The panic ended the thread.
    fatal: bool,
}

thread_local! {
    static CREW: RefCell<Option<Crew>> = const { RefCell::new(None) };
}

/// Notes the panic of a member, before the hook of the process.
fn install_hook() {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if let Some(crew) = current() {
                crew.note(info);
            }
            before(info);
        }));
    });
}

/// The crew of the calling thread, if the thread is a member of one.
pub(crate) fn current() -> Option<Crew> {
    // A thread that ends has no crew any more.
    CREW.try_with(|crew| crew.try_borrow().ok().and_then(|crew| crew.clone())).ok().flatten()
}

/// Makes the calling thread a member of `crew`, if there is one, until the result is dropped.
pub(crate) fn join(crew: Option<Crew>) -> Option<Member> {
    crew.map(|crew| crew.join())
}

/// Makes the calling thread a member for its whole life. The thread catches its panics.
pub(super) fn attach(crew: &Crew) {
    CREW.set(Some(crew.clone()));
}

/// A place where a test can plant a panic of member `name`.
#[cfg(test)]
pub(crate) fn point(name: &str) {
    let Some(crew) = current() else {
        return;
    };
    let mut planted = lock(&crew.0.planted);
    if planted.is_some_and(|planted| planted == name) {
        *planted = None;
        drop(planted);
        panic!("{name} as the test asks");
    }
}

/// A place where a test can plant a panic of a member.
#[cfg(not(test))]
pub(crate) const fn point(_: &str) {}

/// Message of a panic.
pub(crate) fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or("without a text".to_owned())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Crew {
    /// Makes the calling thread a member until the result is dropped.
    pub(crate) fn join(&self) -> Member {
        install_hook();
        Member { crew: self.clone(), before: CREW.replace(Some(self.clone())) }
    }

    /// Lets a member that unwinds stop the robots.
    pub(super) fn stop_through(&self, stop: StopRequest) {
        *lock(&self.0.stop) = Some(stop);
    }

    /// Whether a member has unwound.
    pub(super) fn has_unwound(&self) -> bool {
        self.0.unwound.load(Ordering::Relaxed)
    }

    /// Counts a completed servo cycle.
    pub(super) fn cycle(&self) {
        self.0.cycles.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of completed servo cycles.
    pub(super) fn cycles(&self) -> u64 {
        self.0.cycles.load(Ordering::Relaxed)
    }

    #[cfg(test)]
    #[cfg(feature = "command-line")]
    pub(super) fn plant(&self, member: &'static str) {
        *lock(&self.0.planted) = Some(member);
    }

    fn note(&self, info: &PanicHookInfo<'_>) {
        let thread = std::thread::current().name().unwrap_or("without a name").to_owned();
        let place = info.location().map_or(String::new(), |place| format!(" ({}:{})", place.file(), place.line()));
        let message = message(info.payload()) + &place;
        let mut panics = lock(&self.0.panics);
        if panics.len() < MOST {
            panics.push(Panic { thread, message, cycles: self.cycles(), fatal: false });
        }
    }

    /// Adds the messages of caught panics to the faults `caught`, and returns the faults of members that unwound.
    pub(super) fn faults<'a>(
        &self,
        file: &CellFile,
        caught: impl Iterator<Item = &'a mut FaultReport>,
    ) -> Vec<FaultReport> {
        let mut panics = std::mem::take(&mut *lock(&self.0.panics));
        for fault in caught.filter(|fault| fault.what.ends_with("panicked")) {
            if let Some(first) = panics.iter().position(|panic| !panic.fatal) {
                let Panic { thread, message, .. } = panics.remove(first);
                fault.what += &format!(" in thread {thread}: {message}");
            }
        }
        let fatal = panics.into_iter().filter(|panic| panic.fatal);
        fatal.map(|panic| Self::fault(file, &panic)).collect()
    }

    fn fault(file: &CellFile, panic: &Panic) -> FaultReport {
        let fault = FaultReport::of_run(format_args!("thread {} panicked: {}", panic.thread, panic.message));
        let number = panic.cycles.checked_sub(1);
        FaultReport {
            stop_category: Some(StopCategory::One),
            stopped: file.cell.robot.iter().map(|robot| robot.name.clone()).collect(),
            number,
            time_s: number.map(|number| time_of(file, number)),
            ..fault.checked_by("report this as a defect of the program")
        }
    }
}

/// Nominal time of servo cycle `number` since the first one, s.
pub(super) fn time_of(file: &CellFile, number: u64) -> f64 {
    Duration::as_secs_f64(&file.cell.period()) * number as f64
}

/// Membership of a thread.
#[derive(Debug)]
pub(crate) struct Member {
    crew: Crew,
    before: Option<Crew>,
}

impl Drop for Member {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let shared = &self.crew.0;
            let thread = std::thread::current();
            let mut panics = lock(&shared.panics);
            let last = panics.iter_mut().rev().find(|panic| Some(panic.thread.as_str()) == thread.name());
            last.into_iter().for_each(|panic| panic.fatal = true);
            drop(panics);
            shared.unwound.store(true, Ordering::Relaxed);
            lock(&shared.stop).iter().for_each(StopRequest::request);
        }
        // A thread that ends has no crew any more.
        let _ = CREW.try_with(|crew| crew.replace(self.before.take()));
    }
}
