//! The cycles around those with the greatest lateness, as a file for <https://ui.perfetto.dev> or chrome://tracing.
//!
//! The format is trace-event JSON. Each spike is a separate process with one track for the thread and one for
//! deadlines. All spikes are shifted in time to align their late deadlines, so that common features are visible. The
//! labels of the process give the true time of the spike.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::time::Duration;

use can::Instant;
use serde_json::{Value, json};
use servo::thread::{Spike, Stamps};

use crate::{report::microseconds, run::Background};

/// Longest wait for writing the file, limited because the disk of a host may block.
const WRITE_WAIT: Duration = Duration::from_secs(2);

/// Tracks of a spike.
const THREAD: u32 = 1;
const DEADLINES: u32 = 2;

/// Writes the `spikes` of a thread of that name to a file that was opened before the run. A file that blocks is not
/// waited for.
pub fn write(file: File, thread: &'static str, spikes: Vec<Spike>) -> io::Result<()> {
    let write = move |mut file: BufWriter<File>| {
        serde_json::to_writer(&mut file, &trace(thread, &spikes))?;
        file.flush()
    };
    let file = BufWriter::new(file);
    let writing = Background::start("spikes", WRITE_WAIT, file, |_| {}, write);
    let late = || io::Error::new(io::ErrorKind::TimedOut, "the file was too slow");
    writing?.finish(WRITE_WAIT).unwrap_or_else(|| Err(late()))
}

fn trace(thread: &str, spikes: &[Spike]) -> Value {
    // Longest time from the first cycle of a spike to its late deadline.
    let before = spikes.iter().filter_map(|spike| Some(anchor(spike)?.since(spike.cycles.first()?.begun)));
    let before = before.max().unwrap_or_default();
    let events = (1..).zip(spikes).filter_map(|(process, spike)| {
        let anchor = anchor(spike)?;
        Some(events(process, thread, spike, anchor, before))
    });
    json!({"displayTimeUnit": "ns", "traceEvents": events.flatten().collect::<Vec<_>>()})
}

/// The late deadline of a spike.
fn anchor(spike: &Spike) -> Option<Instant> {
    spike.cycles.iter().find(|one| one.cycle == spike.cycle).or(spike.cycles.first()).map(|one| one.deadline)
}

fn events(process: u32, thread: &str, spike: &Spike, anchor: Instant, before: Duration) -> Vec<Value> {
    // `before` makes the earliest time of any spike zero or later.
    let at = |time: Instant| (before + time.since(anchor)).saturating_sub(anchor.since(time));
    let (what, due) = match spike.late {
        Some(late) => {
            let (by, cause) = (microseconds(late.late), late.cause.name());
            let due = late.due.as_secs_f64();
            (
                format!("spike {process}: {by:.0} µs late, {cause}, cycle {}", spike.cycle),
                format!("due {due:.6} s after the first deadline, "),
            )
        }
        None => (format!("on request: cycle {}", spike.cycle), String::new()),
    };
    let nanos = anchor.as_nanos();
    let monotonic = format!("{}.{:09}", nanos / 1_000_000_000, nanos % 1_000_000_000);
    let label = format!("{due}CLOCK_MONOTONIC {monotonic} s");
    let named = |what: &str, track: u32, key: &str, value: Value| json!({"ph": "M", "name": what, "pid": process, "tid": track, "args": {key: value}});
    let mut events = vec![
        named("process_name", 0, "name", what.into()),
        named("process_labels", 0, "labels", label.into()),
        named("process_sort_index", 0, "sort_index", process.into()),
        named("thread_name", THREAD, "name", thread.into()),
        named("thread_name", DEADLINES, "name", "deadlines".into()),
    ];
    let instant = |name: String, time| {
        json!({
            "ph": "i", "s": "t", "name": name, "cat": "deadline",
            "pid": process, "tid": DEADLINES, "ts": micros(at(time)),
        })
    };
    let slice = |name: &str, category: &str, from: Instant, to: Instant, args: Value| {
        json!({
            "ph": "X", "name": name, "cat": category, "pid": process, "tid": THREAD,
            "ts": micros(at(from)), "dur": micros(to.since(from)), "args": args,
        })
    };
    for (index, cycle) in spike.cycles.iter().enumerate() {
        let [called, end] = spike.cycles.get(index + 1).map_or([cycle.done; 2], |next| [next.called, next.begun]);
        let name = format!("cycle {}", cycle.cycle);
        events.push(slice(&name, "cycle", cycle.begun, end, details(cycle)));
        let mut from = cycle.begun;
        let slack = [("slack", called), ("between cycles", end)];
        for (name, to) in cycle.phases().into_iter().chain(slack) {
            if from < to {
                events.push(slice(name, "phase", from, to, json!({})));
                from = to;
            }
        }
        events.push(instant("deadline".to_owned(), cycle.deadline));
        if let Some(late) = cycle.late {
            let by = microseconds(late.late);
            events.push(instant(format!("late by {by:.0} µs: {}", late.cause.name()), cycle.sending));
        }
    }
    events
}

/// Details shown when a cycle is selected.
fn details(cycle: &Stamps) -> Value {
    let late = cycle.sending.since(cycle.deadline);
    json!({
        "cycle": cycle.cycle,
        "sync_late_us": microseconds(late),
        "wake_up_latency_us": cycle.awake.wake_up_latency().map(microseconds),
        "longest_gap_us": microseconds(cycle.awake.gap),
        "cause": cycle.late.map(|late| late.cause.name()),
    })
}

/// Time in µs, increased by an eighth of a nanosecond. A reader that truncates to nanoseconds, such as Perfetto, then
/// gets the exact value despite decimal rounding. With a nanosecond less, a phase would end after its cycle.
fn micros(time: Duration) -> f64 {
    (time.as_nanos() as f64 + 0.125) / 1e3
}

#[cfg(test)]
mod tests {
    use servo::thread::{Awake, Cause, LateCycle};

    use super::*;

    #[test]
    fn a_reader_that_cuts_off_has_every_nanosecond_again() {
        for nanos in (0..200_000_000).step_by(997).chain(0..100_000) {
            let text = json!(micros(Duration::from_nanos(nanos))).to_string();
            let read: Value = serde_json::from_str(&text).unwrap();
            assert_eq!((read.as_f64().unwrap() * 1e3) as u64, nanos, "{text}");
        }
    }

    #[test]
    fn a_full_disk_is_an_error_with_its_reason() {
        let full = File::options().write(true).open("/dev/full").unwrap();
        assert_eq!(write(full, "servo", Vec::new()).unwrap_err().kind(), io::ErrorKind::StorageFull);
    }

    /// A cycle of 1 ms whose phases take some µs each. `late` is its lateness, µs.
    fn cycle(number: u64, late: u64) -> Stamps {
        let at = |micros: u64| Instant::from_nanos((1000 * (number + 1) + micros) * 1000 + 7);
        let awake = Awake {
            asked_at: at(400),
            wake_up: at(900),
            woken: at(900 + late),
            at: at(950 + late),
            gap: Duration::from_micros(1),
        };
        Stamps {
            cycle: number,
            deadline: at(1000),
            called: at(380),
            begun: at(400),
            awake,
            reading: at(950 + late),
            read: at(960 + late),
            computed: at(975 + late),
            written: at(980 + late),
            sending: at(1000 + late),
            done: at(1010 + late),
            late: (late > 0).then(|| LateCycle {
                cycle: number,
                due: Duration::from_millis(number),
                late: Duration::from_micros(late),
                cause: Cause::Preempted,
            }),
        }
    }

    fn spike(first: u64, late: u64, micros: u64) -> Spike {
        let cycles: Vec<_> =
            (first..late + 3).map(|number| cycle(number, if number == late { micros } else { 0 })).collect();
        Spike { late: cycles[(late - first) as usize].late, cycle: late, cycles }
    }

    #[test]
    fn spikes_lie_below_each_other_with_their_phases_in_their_cycles() {
        let document = trace("servo", &[spike(5, 8, 312), spike(40, 50, 33)]);
        let events = document["traceEvents"].as_array().unwrap();
        let of = |process: u32, kind: &str| {
            let events = events.iter();
            let events = events.filter(move |event| event["pid"] == process);
            let kind = kind.to_owned();
            events.filter(move |event| event["ph"] == *kind)
        };
        let nanos = |value: &Value| (value.as_f64().unwrap() * 1e3) as u64;
        for (process, cycles) in [(1, 6), (2, 13)] {
            let slices: Vec<_> = of(process, "X").collect();
            let whole: Vec<_> = slices.iter().filter(|one| one["cat"] == "cycle").collect();
            assert_eq!(whole.len(), cycles);
            for cycle in whole {
                let (from, lasts) = (nanos(&cycle["ts"]), nanos(&cycle["dur"]));
                let mut end = from;
                for phase in slices.iter().filter(|one| one["cat"] == "phase") {
                    if (from..from + lasts).contains(&nanos(&phase["ts"])) {
                        assert_eq!(nanos(&phase["ts"]), end, "{cycle} {phase}");
                        end += nanos(&phase["dur"]);
                    }
                }
                assert_eq!(end, from + lasts, "{cycle}");
            }
        }
        let late = |process| {
            let mut all = of(process, "i").filter(|one| one["name"] != "deadline");
            let one = all.next().unwrap();
            assert_eq!(all.next(), None);
            (one["name"].as_str().unwrap(), nanos(&one["ts"]))
        };
        let [(first, at), (second, then)] = [late(1), late(2)];
        assert_eq!([first, second], ["late by 312 µs: preempted", "late by 33 µs: preempted"]);
        // The two due times coincide.
        assert_eq!(at - 312_000, then - 33_000);
        let name = of(1, "M").find(|one| one["name"] == "process_name");
        assert_eq!(name.unwrap()["args"]["name"], "spike 1: 312 µs late, preempted, cycle 8");
    }
}
