//! System tests in virtual time that need hooks of the library: the feature `test-hooks`, which no program has.

#![expect(clippy::unwrap_used, reason = "in a test it is a verdict")]

use controller::coordination::Disturbance;
use controller::executor::DisturbedMessage;
use kit::held_bar::{REACTION, check_stop, faulted};
use kit::steps::lines;

/// Macrostep in the first leg of the course at its greatest speed.
const STEP: u64 = 40;

/// Macrostep of the cell, s.
const MACROSTEP: f64 = 0.020;

/// Longest time from a disturbed message to the stop of the bar, s: a macrostep, the deadline of the exchange, which is
/// one servo period, and the reaction.
const DETECTION: f64 = MACROSTEP + 0.002 + REACTION;

/// A message that arrives after the deadline of its step, while the arms brake.
const LATE: Disturbance = Disturbance::Late(std::time::Duration::from_millis(30));

/// Time at which a message of the last motion was sent, s.
fn sent_at(steps: &str, message: &DisturbedMessage) -> f64 {
    let (agent, event) = match (message.answer, message.member) {
        (false, _) => ("coordinator", "exchange"),
        (true, 0) => ("left", "answer-coordinator"),
        (true, _) => ("right", "answer-coordinator"),
    };
    let of_message = lines(steps).filter(|it| (it.agent, it.event, it.macrostep) == (agent, event, message.step));
    of_message.last().unwrap().time_s
}

#[test]
fn a_lost_late_doubled_or_swapped_message_stops_both_arms_and_does_not_tear_the_bar() {
    let (answer, order) = ((1, true), (0, false));
    let cases = [
        (answer, Disturbance::Lost, "left: step 40: the order of step 41 did not come within 4ms"),
        (answer, LATE, "left: step 40: the order of step 41 did not come within 4ms"),
        (
            answer,
            Disturbance::Doubled,
            "step 41, link to member 1: a message of step 40 came in place of that of step 41",
        ),
        (
            answer,
            Disturbance::Swapped,
            "step 40, link to member 1: a message of step 41 came in place of that of step 40",
        ),
        (order, Disturbance::Lost, "left: step 39: the order of step 40 did not come within 4ms"),
        (order, LATE, "left: step 39: the order of step 40 did not come within 4ms"),
        (order, Disturbance::Doubled, "left: step 40: a message of step 40 came in place of that of step 41"),
        (order, Disturbance::Swapped, "left: step 39: a message of step 41 came in place of that of step 40"),
    ];
    for ((member, answer), disturbance, cause) in cases {
        let message = DisturbedMessage { member, answer, step: STEP, disturbance };
        let what = format!("{} {disturbance:?}", if answer { "answer" } else { "order" });
        let run = faulted(move |team| team.disturb(message), |_| ());
        let delay = check_stop(&what, &run) - sent_at(&run.steps, &message);
        println!("  the stop began {:.1} ms after the message", 1e3 * delay);
        // An order waits in the queue for its step. Its double is found in place of the next order.
        let doubled_order = !answer && disturbance == Disturbance::Doubled;
        let detection = DETECTION + if doubled_order { MACROSTEP } else { 0.0 };
        assert!((0.0..detection).contains(&delay), "{what}: {delay} s");
        let causes: Vec<_> = run.report.faults.iter().map(ToString::to_string).collect();
        assert!(causes.len() == 1 && causes[0].contains(cause), "{what}: {causes:?}");
    }
}
