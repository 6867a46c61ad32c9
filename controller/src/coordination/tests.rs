//! Links with messages that are lost, late, doubled or swapped, and the coordinator's flow chart.

use std::any::Any;
use std::task::Poll;
use std::time::Duration;

use can::Instant;

use super::*;
use crate::generator::{GeneratorError, Received, Sample};

const DEADLINE: Duration = Duration::from_millis(40);

fn at(millis: u64) -> Instant {
    Instant::ZERO + Duration::from_millis(millis)
}

const fn blocking(late: Late) -> LinkConfig {
    LinkConfig { blocking: true, deadline: DEADLINE, late }
}

fn received(member: &MemberEnd<u32, u32>) -> Received<u32> {
    *member.order().downcast_ref::<Received<u32>>().unwrap()
}

#[test]
fn a_blocking_step_waits_for_the_order_of_its_number() {
    let (mut coordinator, mut member) = link::<u32, u32>(blocking(Late::Stop));
    assert_eq!(member.poll(0, at(0)), Ok(Turn::Waiting));
    assert!(coordinator.order(at(10), 7));
    assert_eq!(member.poll(0, at(12)), Ok(Turn::Ready));
    let sample = Sample { at: at(10), age: Duration::from_millis(2), value: 7 };
    assert_eq!(received(&member), Received::New(sample));
    assert!(member.answer(&8_u32 as &dyn Any, at(12)));
    assert!(!member.answer(&8.0_f64 as &dyn Any, at(12)), "an answer of another type");
    assert_eq!(coordinator.answer(), Ok(Some((0, Sample { at: at(12), age: Duration::ZERO, value: 8 }))));
    assert_eq!(member.poll(1, at(20)), Ok(Turn::Waiting));
    assert!(coordinator.end_motion(at(21)));
    assert_eq!(member.poll(1, at(22)), Ok(Turn::EndMotion));
}

#[test]
fn a_late_order_stops_the_member_or_lets_it_hold_its_last_order() {
    for late in [Late::Stop, Late::Hold] {
        let (mut coordinator, mut member) = link::<u32, u32>(blocking(late));
        coordinator.order(at(0), 1);
        assert_eq!(member.poll(0, at(0)), Ok(Turn::Ready));
        assert_eq!(member.poll(1, at(20)), Ok(Turn::Waiting));
        assert_eq!(member.poll(1, at(60)), Ok(Turn::Waiting));
        let ended = member.poll(1, at(61));
        if late == Late::Stop {
            assert_eq!(ended, Err(LinkError::Late { step: 1, waited: Duration::from_millis(41) }));
            continue;
        }
        assert_eq!(ended, Ok(Turn::Ready));
        assert!(matches!(received(&member), Received::Old(Sample { value: 1, .. })));
        // The late order is dropped, and the next one is in time.
        coordinator.order(at(70), 2);
        coordinator.order(at(80), 3);
        assert_eq!(member.poll(2, at(81)), Ok(Turn::Ready));
        assert!(matches!(received(&member), Received::New(Sample { value: 3, .. })));
    }
}

#[test]
fn a_message_of_another_step_is_an_error() {
    for (disturbance, expected) in [
        (Disturbance::Lost, LinkError::WrongStep { expected: 1, received: 2 }),
        (Disturbance::Doubled, LinkError::WrongStep { expected: 2, received: 1 }),
        (Disturbance::Swapped, LinkError::WrongStep { expected: 1, received: 2 }),
    ] {
        let (mut coordinator, mut member) = link::<u32, u32>(blocking(Late::Stop));
        coordinator.disturb(1, disturbance);
        for order in 0..3 {
            coordinator.order(at(0), order);
        }
        let turns = [0, 1, 2].map(|step| member.poll(step, at(1)));
        assert_eq!(turns.into_iter().find_map(Result::err), Some(expected), "{disturbance:?}: {turns:?}");
    }
}

#[test]
fn a_link_that_does_not_wait_gives_the_latest_order_as_none_old_or_new() {
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut coordinator, mut member) = link::<u32, u32>(config);
    assert_eq!(member.poll(1, at(0)), Ok(Turn::Ready));
    assert_eq!(received(&member), Received::None);
    coordinator.order(at(1), 4);
    coordinator.order(at(2), 5);
    assert_eq!(member.poll(2, at(3)), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::New(Sample { value: 5, .. })));
    assert_eq!(member.poll(3, at(4)), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::Old(Sample { value: 5, .. })));
}

/// Counts to three, and gives each member the sum of all answers.
struct Sum;

impl Coordinator<2> for Sum {
    type Order = u32;
    type Answer = u32;
    type Memory = u32;

    fn first_step(&mut self, _: Duration) -> Result<NextOrders<u32, u32, 2>, GeneratorError> {
        Ok(NextOrders { orders: [0; 2], memory: 0 })
    }

    fn terminal(&self, steps: &u32, _: &[Sample<u32>; 2]) -> bool {
        *steps == 3
    }

    fn next_step(&self, steps: &u32, answers: &[Sample<u32>; 2]) -> Result<NextOrders<u32, u32, 2>, GeneratorError> {
        Ok(NextOrders { orders: [answers[0].value + answers[1].value; 2], memory: steps + 1 })
    }
}

const MACROSTEP: Duration = Duration::from_millis(20);

fn pair() -> (Conduct<Sum, 2>, [MemberEnd<u32, u32>; 2]) {
    let (one, first) = link(blocking(Late::Stop));
    let (other, second) = link(blocking(Late::Stop));
    (Conduct::new(Sum, [one, other], MACROSTEP, DEADLINE), [first, second])
}

#[test]
fn a_coordinator_computes_each_step_from_the_answers_of_one_step_and_then_ends_the_motion() {
    let (mut conduct, mut members) = pair();
    let mut orders = Vec::new();
    for step in 0..4 {
        assert_eq!(conduct.poll(at(step), false), Poll::Pending);
        for (member, answer) in members.iter_mut().zip([1_u32, 2]) {
            assert_eq!(member.poll(step, at(step)), Ok(Turn::Ready));
            orders.push(*received(member).younger_than(DEADLINE).unwrap());
            // Not before all answers of the step are there.
            assert_eq!(conduct.poll(at(step), false), Poll::Pending);
            assert!(member.answer(&answer as &dyn Any, at(step)));
        }
    }
    assert_eq!(orders, [0, 0, 3, 3, 3, 3, 3, 3]);
    assert_eq!(conduct.poll(at(4), false), Poll::Ready(Ok(())));
    assert!(members.iter_mut().all(|member| member.poll(4, at(4)) == Ok(Turn::EndMotion)));
}

#[test]
fn a_member_that_does_not_answer_is_an_error_of_the_coordinator_unless_motion_is_slowed() {
    let (mut conduct, mut members) = pair();
    for step in 0..2 {
        assert_eq!(conduct.poll(at(step), false), Poll::Pending);
        for member in &mut members {
            assert_eq!(member.poll(step, at(step)), Ok(Turn::Ready));
            assert!(step > 0 || member.answer(&1_u32 as &dyn Any, at(step)));
        }
    }
    assert!(members[0].answer(&1_u32 as &dyn Any, at(1)));
    assert_eq!(conduct.poll(at(500), true), Poll::Pending);
    assert_eq!(conduct.poll(at(580), false), Poll::Pending);
    let waited = Duration::from_millis(81);
    let silent = CoordinatorError::Silent { step: 1, member: 1, waited };
    assert_eq!(conduct.poll(at(581), false), Poll::Ready(Err(silent)));
}

#[test]
fn the_end_of_a_motion_and_old_orders_do_not_reach_the_next_motion() {
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut coordinator, mut member) = link::<u32, u32>(config);
    coordinator.order(at(0), 1);
    coordinator.end_motion(at(1));
    member.begin();
    assert_eq!(member.poll(0, at(2)), Ok(Turn::EndMotion));
    member.begin();
    assert_eq!(member.poll(0, at(3)), Ok(Turn::Ready));
    assert_eq!(received(&member), Received::None);
    // Answers of both motions are numbered on.
    for (step, value) in [(0, 5_u32), (1, 6)] {
        assert!(member.answer(&value as &dyn Any, at(4)));
        assert!(matches!(coordinator.answer(), Ok(Some((number, sample))) if number == step && sample.value == value));
        member.begin();
    }
}

#[test]
fn an_order_that_finds_no_room_has_no_number_and_a_late_end_of_motion_is_taken() {
    let (mut coordinator, mut member) = link::<u32, u32>(blocking(Late::Hold));
    let sent = (0..5).filter(|order| coordinator.order(at(0), *order)).count();
    assert_eq!(sent, 4);
    for step in 0..4 {
        assert_eq!(member.poll(step, at(0)), Ok(Turn::Ready));
    }
    assert_eq!(member.poll(4, at(0)), Ok(Turn::Waiting));
    assert_eq!(member.poll(4, at(50)), Ok(Turn::Ready), "held");
    assert!(coordinator.end_motion(at(51)));
    assert_eq!(member.poll(5, at(52)), Ok(Turn::EndMotion));
}
