//! Questions and their answers.

use std::sync::mpsc::sync_channel;
use std::task::Poll;
use std::thread;
use std::time::Duration;

use can::Instant;

use super::*;
use crate::sensor::VirtualSensor;

/// Longest wait for a thread of a test.
const PATIENCE: Duration = Duration::from_secs(30);

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

fn at(milliseconds: u64) -> Instant {
    Instant::ZERO + ms(milliseconds)
}

fn asked() -> (Asking, OperatorLink, OperatorPanel) {
    let (link, panel) = OperatorLink::new(8);
    (Asking::new(&link, Question::new("Next motion?", ["yes", "no"]).within(ms(100))), link, panel)
}

fn texts(panel: &OperatorPanel) -> Vec<String> {
    panel.texts.try_iter().collect()
}

#[test]
fn a_line_that_is_no_choice_is_refused_and_the_question_stays_open() {
    let (mut asking, _link, panel) = asked();
    panel.lines.send("perhaps".to_owned()).unwrap();
    assert_eq!(asking.poll(at(0)), Poll::Pending);
    assert_eq!(texts(&panel), ["Next motion? [yes/no]", "\"perhaps\" is no answer; answers are yes, no"]);
    panel.lines.send(" YES ".to_owned()).unwrap();
    assert_eq!(asking.poll(at(1)), Poll::Ready(Ok("yes".to_owned())));
    drop(asking);
    assert!(texts(&panel).is_empty(), "an answered question is not withdrawn");
}

#[test]
fn a_deadline_ends_a_question_without_an_answer() {
    let (mut asking, _link, _panel) = asked();
    // The deadline counts from the poll that shows the question.
    assert_eq!(asking.poll(at(500)), Poll::Pending);
    assert_eq!(asking.poll(at(600)), Poll::Pending);
    let limit = ms(100);
    assert_eq!(asking.poll(at(601)), Poll::Ready(Err(OperatorError::Late { limit })));
}

#[test]
fn a_line_that_comes_after_its_question_does_not_answer_the_next_one() {
    let (mut asking, link, panel) = asked();
    assert_eq!(asking.poll(at(0)), Poll::Pending);
    assert!(asking.poll(at(101)).is_ready());
    panel.lines.send("yes".to_owned()).unwrap();
    let mut next = Asking::new(&link, Question::new("Drives off?", ["yes", "no"]));
    assert_eq!(next.poll(at(200)), Poll::Pending);
    panel.lines.send("no".to_owned()).unwrap();
    assert_eq!(next.poll(at(300)), Poll::Ready(Ok("no".to_owned())));
    assert!(texts(&panel).contains(&"\"yes\" came too late for the question before".to_owned()));
}

/// A question of `link` without choices.
fn name(link: &OperatorLink) -> Asking {
    Asking::new(link, Question::open("Name?"))
}

fn say(panel: &OperatorPanel, lines: &[&str]) {
    lines.iter().for_each(|line| panel.lines.try_send((*line).to_owned()).unwrap());
}

#[test]
fn one_line_per_unanswered_question_is_late_and_the_lines_behind_it_are_answers() {
    // A question ends by its deadline, or is withdrawn.
    for deadline in [true, false] {
        let (mut asking, link, panel) = asked();
        assert_eq!(asking.poll(at(0)), Poll::Pending);
        assert!(!deadline || asking.poll(at(101)).is_ready());
        drop(asking);
        say(&panel, &["yes", "anna", "bert"]);
        assert_eq!(name(&link).poll(at(200)), Poll::Ready(Ok("anna".to_owned())));
        // The question before was answered.
        assert_eq!(name(&link).poll(at(201)), Poll::Ready(Ok("bert".to_owned())));
        let late = texts(&panel).into_iter().filter(|text| text.contains("too late")).collect::<Vec<_>>();
        assert_eq!(late, ["\"yes\" came too late for the question before"]);
    }
}

#[test]
fn a_question_that_was_not_shown_makes_no_line_late() {
    let (mut asking, link, panel) = asked();
    assert_eq!(asking.poll(at(0)), Poll::Pending);
    let mut second = name(&link);
    assert_eq!(second.poll(at(0)), Poll::Pending);
    drop(second);
    say(&panel, &["yes"]);
    assert_eq!(asking.poll(at(1)), Poll::Ready(Ok("yes".to_owned())));
    say(&panel, &["anna"]);
    assert_eq!(name(&link).poll(at(2)), Poll::Ready(Ok("anna".to_owned())));
}

#[test]
fn an_endless_input_of_wrong_lines_holds_up_no_poll_and_no_deadline() {
    let (link, panel) = OperatorLink::new(1000);
    let mut asking = Asking::new(&link, Question::new("Next motion?", ["yes", "no"]).within(ms(100)));
    let wrong = |count| (0..count).for_each(|_| say(&panel, &["perhaps"]));
    wrong(100);
    assert_eq!(asking.poll(at(0)), Poll::Pending);
    let refused = texts(&panel).len() - 1;
    assert!((1..100).contains(&refused), "{refused}");
    wrong(100);
    let limit = ms(100);
    assert_eq!(asking.poll(at(101)), Poll::Ready(Err(OperatorError::Late { limit })));
}

#[test]
fn a_step_waits_for_no_task_that_reads_the_answer_and_no_command_is_lost() {
    let (link, panel) = OperatorLink::new(8);
    let (mut sensor, answer) = Operator::new(&link, Question::open("Name?"));
    say(&panel, &["anna", "bert"]);
    sensor.configure(&OperatorCommand::Ask);
    assert_eq!(sensor.poll(at(1)), Some((at(1), Reaction::Answered(0))));
    // Another thread reads the answer during a step that asks again.
    let (tell, told) = sync_channel(1);
    let held = answer.inquiry();
    thread::spawn(move || {
        sensor.configure(&OperatorCommand::Ask);
        let reading = sensor.poll(at(2));
        tell.send((sensor, reading)).unwrap();
    });
    let (mut sensor, reading) = told.recv_timeout(PATIENCE).expect("the step does not wait");
    assert_eq!(reading, None);
    drop(held);
    assert_eq!(answer.get(), Some(Ok("anna".to_owned())));
    assert_eq!(sensor.poll(at(3)), Some((at(3), Reaction::Answered(0))));
    assert_eq!(answer.get(), Some(Ok("bert".to_owned())));
}

#[test]
fn lines_before_the_end_of_the_input_are_answers_and_then_the_input_is_closed() {
    let (mut asking, link, panel) = asked();
    panel.lines.send("no".to_owned()).unwrap();
    drop(panel);
    assert_eq!(asking.poll(at(0)), Poll::Ready(Ok("no".to_owned())));
    let mut again = Asking::new(&link, Question::open("Name?"));
    assert_eq!(again.poll(at(0)), Poll::Ready(Err(OperatorError::Closed)));
}

#[test]
fn one_question_is_open_at_a_time_and_a_dropped_question_is_withdrawn() {
    let (mut first, link, panel) = asked();
    let mut second = Asking::new(&link, Question::open("Name?"));
    assert_eq!(first.poll(at(0)), Poll::Pending);
    assert_eq!(second.poll(at(0)), Poll::Pending);
    assert_eq!(texts(&panel), ["Next motion? [yes/no]"]);
    drop(first);
    assert_eq!(second.poll(at(1)), Poll::Pending);
    panel.lines.send("a name".to_owned()).unwrap();
    assert_eq!(second.poll(at(2)), Poll::Ready(Ok("a name".to_owned())));
    assert_eq!(texts(&panel), ["Next motion?: the question is withdrawn", "Name?"]);
}

#[test]
fn the_sensor_reads_the_reaction_to_each_question_that_it_is_told_to_ask() {
    let (link, panel) = OperatorLink::new(8);
    let (mut sensor, answer) = Operator::new(&link, Question::new("Next motion?", ["yes", "no"]));
    assert_eq!(sensor.poll(at(0)), None);
    assert!(texts(&panel).is_empty(), "only a command of a generator asks");
    for (line, reaction, now) in [("yes", 0, 1), ("no", 1, 2)] {
        sensor.configure(&OperatorCommand::Ask);
        assert_eq!(sensor.poll(at(now)), None);
        sensor.configure(&OperatorCommand::Wait);
        panel.lines.send(line.to_owned()).unwrap();
        assert_eq!(sensor.poll(at(now)), Some((at(now), Reaction::Answered(reaction))));
        assert_eq!(answer.get(), Some(Ok(line.to_owned())));
    }
    drop(panel.lines);
    sensor.configure(&OperatorCommand::Ask);
    assert_eq!(sensor.poll(at(3)), Some((at(3), Reaction::Closed)));
}

#[test]
fn a_question_of_the_sensor_is_withdrawn_with_the_handle_of_its_answer() {
    let (link, panel) = OperatorLink::new(8);
    let (mut sensor, answer) = Operator::new(&link, Question::open("Name?"));
    sensor.configure(&OperatorCommand::Ask);
    assert_eq!(sensor.poll(at(0)), None);
    drop(answer);
    assert_eq!(texts(&panel), ["Name?", "Name?: the question is withdrawn"]);
    assert!(matches!(Asking::new(&link, Question::open("Next?")).poll(at(0)), Poll::Pending));
}
