//! Links with messages that are lost, late, doubled or swapped, and the coordinator's flow chart.

use std::any::Any;
use std::task::Poll;
use std::time::Duration;

use can::Instant;

use super::*;
use crate::ecp::{AtOnce, Planning, StepEvent, StepRecords, step_log};
use crate::generator::{GeneratorError, Received, Sample, SensorReading, Tell, V};
use crate::sensor::{Sensors, Shell, VirtualSensor};

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
    assert_eq!(member.poll(0, at(0), 1.0), Ok(Turn::Waiting));
    assert!(coordinator.order(at(10), 7));
    assert_eq!(member.poll(0, at(12), 1.0), Ok(Turn::Ready));
    let sample = Sample { at: at(10), age: Duration::from_millis(2), value: 7 };
    assert_eq!(received(&member), Received::New(sample));
    assert!(member.answer(&8_u32 as &dyn Any, at(12)));
    assert!(!member.answer(&8.0_f64 as &dyn Any, at(12)), "an answer of another type");
    assert_eq!(coordinator.answer(), Ok(Some((0, Sample { at: at(12), age: Duration::ZERO, value: 8 }))));
    assert_eq!(member.poll(1, at(20), 1.0), Ok(Turn::Waiting));
    assert!(coordinator.end_motion(at(21)));
    assert_eq!(member.poll(1, at(22), 1.0), Ok(Turn::EndMotion));
}

#[test]
fn a_late_order_stops_the_member_or_lets_it_hold_its_last_order() {
    for late in [Late::Stop, Late::Hold] {
        let (mut coordinator, mut member) = link::<u32, u32>(blocking(late));
        coordinator.order(at(0), 1);
        assert_eq!(member.poll(0, at(0), 1.0), Ok(Turn::Ready));
        assert_eq!(member.poll(1, at(20), 1.0), Ok(Turn::Waiting));
        assert_eq!(member.poll(1, at(60), 1.0), Ok(Turn::Waiting));
        let ended = member.poll(1, at(61), 1.0);
        if late == Late::Stop {
            assert_eq!(ended, Err(LinkError::Late { step: 1, waited: Duration::from_millis(41) }));
            continue;
        }
        assert_eq!(ended, Ok(Turn::Ready));
        assert!(matches!(received(&member), Received::Old(Sample { value: 1, .. })));
        // The late order is dropped, and the next one is in time.
        coordinator.order(at(70), 2);
        coordinator.order(at(80), 3);
        assert_eq!(member.poll(2, at(81), 1.0), Ok(Turn::Ready));
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
        let turns = [0, 1, 2].map(|step| member.poll(step, at(1), 1.0));
        assert_eq!(turns.into_iter().find_map(Result::err), Some(expected), "{disturbance:?}: {turns:?}");
    }
}

#[test]
fn a_link_that_does_not_wait_gives_the_latest_order_as_none_old_or_new() {
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut coordinator, mut member) = link::<u32, u32>(config);
    assert_eq!(member.poll(1, at(0), 1.0), Ok(Turn::Ready));
    assert_eq!(received(&member), Received::None);
    coordinator.order(at(1), 4);
    coordinator.order(at(2), 5);
    assert_eq!(member.poll(2, at(3), 1.0), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::New(Sample { value: 5, .. })));
    assert_eq!(member.poll(3, at(4), 1.0), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::Old(Sample { value: 5, .. })));
}

#[test]
fn a_decision_that_no_step_has_read_is_new_for_the_first_step_that_reads_it() {
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut coordinator, mut member) = link::<u32, u32>(config);
    coordinator.order(at(0), 7);
    // Steps that read no orders, at the end of one motion and at the begin of the next.
    assert_eq!(member.poll(9, at(1), 1.0), Ok(Turn::Ready));
    member.begin();
    assert_eq!(member.poll(0, at(2), 1.0), Ok(Turn::Ready));
    assert_eq!(member.poll(1, at(3), 1.0), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::New(Sample { value: 7, .. })));
    assert_eq!(member.poll(2, at(4), 1.0), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::Old(Sample { value: 7, .. })));
    member.begin();
    assert_eq!(received(&member), Received::None);
}

#[test]
fn a_link_that_does_not_wait_keeps_the_latest_answer() {
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut coordinator, mut member) = link::<u32, u32>(config);
    for step in 0..10_u64 {
        assert_eq!(member.poll(step, at(step), 1.0), Ok(Turn::Ready));
        assert!(member.answer(&(step as u32) as &dyn Any, at(step)));
    }
    assert!(matches!(coordinator.answer(), Ok(Some((9, Sample { value: 9, .. })))));
    assert_eq!(coordinator.answer(), Ok(None));
}

/// Counts to three, and gives each member the sum of all answers.
struct Sum;

impl Coordinator<2> for Sum {
    type Order = u32;
    type Answer = u32;
    type Sensors = ();
    type Out = ();
    type Memory = u32;

    fn first_step(&mut self, (): &(), _: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        Ok(NextOrders::new([0; 2], 0))
    }

    fn terminal(&self, steps: &u32, _: &[Sample<u32>; 2], (): &()) -> bool {
        *steps == 3
    }

    fn next_step(&self, steps: &u32, answers: &[Sample<u32>; 2], (): &()) -> Result<Orders<Self, 2>, GeneratorError> {
        Ok(NextOrders::new([answers[0].value + answers[1].value; 2], steps + 1))
    }
}

const MACROSTEP: Duration = Duration::from_millis(20);

/// A coordinator of two members, and what it works with.
struct Lead<K: Coordinator<2>> {
    conduct: Conduct<'static, K, 2>,
    planning: Planning,
    journal: CoordinatorJournal,
    records: StepRecords,
}

impl<K: Coordinator<2, Order = u32, Answer = u32>> Lead<K> {
    /// With its members.
    fn of_pair(coordinator: K, sensors: Sensors) -> (Self, [MemberEnd<u32, u32>; 2]) {
        let (one, first) = link(blocking(Late::Stop));
        let (other, second) = link(blocking(Late::Stop));
        let sensors = Box::leak(Box::new(sensors));
        let conduct = Conduct::new(coordinator, [one, other], sensors, MACROSTEP, DEADLINE);
        let (log, records) = step_log(1000);
        let mut journal = CoordinatorJournal::default();
        journal.log = Some(log);
        (Self { conduct, planning: Planning::with(Box::new(AtOnce::default())), journal, records }, [first, second])
    }

    /// Begins the motion, which needs no time.
    fn begin(&mut self) {
        let begun = self.on_desk(at(0), 1.0, Conduct::begin);
        assert_eq!(begun, Poll::Ready(Ok(())));
    }

    fn poll(&mut self, now: Instant, rate: f64) -> Poll<Result<(), CoordinatorError>> {
        self.on_desk(now, rate, Conduct::poll)
    }

    fn on_desk<T>(
        &mut self,
        now: Instant,
        rate: f64,
        work: impl FnOnce(&mut Conduct<'static, K, 2>, &mut Desk) -> T,
    ) -> T {
        let Self { conduct, planning, journal, .. } = self;
        work(conduct, &mut Desk { now, rate, braking: false, journal, planning, planning_limit: DEADLINE })
    }
}

#[test]
fn a_coordinator_computes_each_step_from_the_answers_of_one_step_and_then_ends_the_motion() {
    let (mut conduct, mut members) = Lead::of_pair(Sum, Sensors::default());
    conduct.begin();
    let mut orders = Vec::new();
    for step in 0..4 {
        assert_eq!(conduct.poll(at(step), 1.0), Poll::Pending);
        for (member, answer) in members.iter_mut().zip([1_u32, 2]) {
            assert_eq!(member.poll(step, at(step), 1.0), Ok(Turn::Ready));
            orders.push(*received(member).younger_than(DEADLINE).unwrap());
            // Not before all answers of the step are there.
            assert_eq!(conduct.poll(at(step), 1.0), Poll::Pending);
            assert!(member.answer(&answer as &dyn Any, at(step)));
        }
    }
    assert_eq!(orders, [0, 0, 3, 3, 3, 3, 3, 3]);
    assert_eq!(conduct.poll(at(4), 1.0), Poll::Ready(Ok(())));
    assert!(members.iter_mut().all(|member| member.poll(4, at(4), 1.0) == Ok(Turn::EndMotion)));
    let mut events = Vec::new();
    while let Ok(record) = conduct.records.queue.pop() {
        events.push((record.step, record.class, record.event));
    }
    use StepEvent::{Commit, Exchange, Functions, Initiate, ReadAnswer, TerminalCondition};
    let first = [Initiate, Functions, Exchange, Commit].map(|event| (0, 0, event));
    let reads = |step| [ReadAnswer, ReadAnswer, TerminalCondition].map(|event| (step, 1, event));
    let gives = |step| [Functions, Exchange, Commit].map(|event| (step, 1, event));
    let mut expected = first.to_vec();
    (1..=3).for_each(|step| expected.extend(reads(step).into_iter().chain(gives(step))));
    expected.extend(reads(4));
    assert_eq!(events, expected);
}

#[test]
fn a_generator_that_replaces_another_takes_the_order_after_the_last_one_and_answers_on() {
    let (mut coordinator, mut member) = link::<u32, u32>(blocking(Late::Stop));
    for order in [10, 11, 12] {
        assert!(coordinator.order(at(order), order as u32));
    }
    for (step, number) in [(0, 0), (1, 1), (0, 2)] {
        if number == 2 {
            member.begin();
        }
        assert_eq!(member.poll(step, at(20), 1.0), Ok(Turn::Ready));
        assert_eq!(*received(&member).younger_than(DEADLINE).unwrap(), 10 + number as u32);
        assert!(member.answer(&0_u32 as &dyn Any, at(20)));
        assert!(matches!(coordinator.answer(), Ok(Some((answered, _))) if answered == number));
    }
    assert_eq!(member.poll(1, at(20), 1.0), Ok(Turn::Waiting));
    assert_eq!(member.poll(1, at(61), 1.0), Err(LinkError::Late { step: 3, waited: Duration::from_millis(41) }));
}

#[test]
fn the_deadline_of_an_order_counts_in_motion_time() {
    let (_coordinator, mut member) = link::<u32, u32>(blocking(Late::Stop));
    assert_eq!(member.poll(0, at(0), 1.0), Ok(Turn::Waiting));
    // 500 ms of a pause, 60 ms at half speed, and 10 ms at full speed.
    assert_eq!(member.poll(0, at(500), 0.0), Ok(Turn::Waiting));
    assert_eq!(member.poll(0, at(560), 0.5), Ok(Turn::Waiting));
    assert_eq!(member.poll(0, at(570), 1.0), Ok(Turn::Waiting));
    let waited = Duration::from_millis(41);
    assert_eq!(member.poll(0, at(571), 1.0), Err(LinkError::Late { step: 0, waited }));
}

#[test]
fn a_member_that_does_not_answer_is_an_error_of_the_coordinator_unless_motion_is_slowed() {
    let (mut conduct, mut members) = Lead::of_pair(Sum, Sensors::default());
    conduct.begin();
    for step in 0..2 {
        assert_eq!(conduct.poll(at(step), 1.0), Poll::Pending);
        for member in &mut members {
            assert_eq!(member.poll(step, at(step), 1.0), Ok(Turn::Ready));
            assert!(step > 0 || member.answer(&1_u32 as &dyn Any, at(step)));
        }
    }
    assert!(members[0].answer(&1_u32 as &dyn Any, at(1)));
    assert_eq!(conduct.poll(at(500), 0.0), Poll::Pending);
    assert_eq!(conduct.poll(at(580), 1.0), Poll::Pending);
    let waited = Duration::from_millis(81);
    let silent = CoordinatorError::Silent { step: 1, member: 1, waited };
    assert_eq!(conduct.poll(at(581), 1.0), Poll::Ready(Err(silent)));
}

#[test]
fn the_end_of_a_motion_and_old_orders_do_not_reach_the_next_motion() {
    let config = LinkConfig { blocking: false, deadline: Duration::ZERO, late: Late::Hold };
    let (mut coordinator, mut member) = link::<u32, u32>(config);
    coordinator.order(at(0), 1);
    coordinator.end_motion(at(1));
    member.begin();
    assert_eq!(member.poll(0, at(2), 1.0), Ok(Turn::EndMotion));
    member.begin();
    assert_eq!(member.poll(0, at(3), 1.0), Ok(Turn::Ready));
    assert_eq!(received(&member), Received::None);
    // Answers of both motions are numbered on.
    for (step, value) in [(0, 5_u32), (1, 6)] {
        assert!(member.answer(&value as &dyn Any, at(4)));
        assert!(matches!(coordinator.answer(), Ok(Some((number, sample))) if number == step && sample.value == value));
        member.begin();
    }
    // An order after the end of a motion is one of the next motion.
    assert!(coordinator.order(at(5), 7));
    assert_eq!(member.poll(0, at(6), 1.0), Ok(Turn::Ready));
    assert!(matches!(received(&member), Received::New(Sample { value: 7, .. })));
}

#[test]
fn an_order_that_finds_no_room_has_no_number_and_a_late_end_of_motion_is_taken() {
    let (mut coordinator, mut member) = link::<u32, u32>(blocking(Late::Hold));
    let sent = (0..5).filter(|order| coordinator.order(at(0), *order)).count();
    assert_eq!(sent, 4);
    for step in 0..4 {
        assert_eq!(member.poll(step, at(0), 1.0), Ok(Turn::Ready));
    }
    assert_eq!(member.poll(4, at(0), 1.0), Ok(Turn::Waiting));
    assert_eq!(member.poll(4, at(50), 1.0), Ok(Turn::Ready), "held");
    assert!(coordinator.end_motion(at(51)));
    assert_eq!(member.poll(5, at(52), 1.0), Ok(Turn::EndMotion));
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Weight(u32);

impl SensorReading for Weight {}

/// Weighs for ten milliseconds once it is asked. The command is the tare.
struct Scale {
    asked: Option<Instant>,
    tare: u32,
    broken: bool,
}

impl VirtualSensor for Scale {
    type Reading = Weight;
    type Command = u32;

    fn configure(&mut self, tare: &u32) {
        self.tare = *tare;
    }

    fn initiate(&mut self, now: Instant) {
        self.asked = Some(now);
    }

    fn poll(&mut self, now: Instant) -> Option<(Instant, Weight)> {
        let asked = self.asked.take_if(|asked| !self.broken && now.since(*asked) >= Duration::from_millis(10))?;
        Some((asked, Weight(asked.as_nanos() as u32 / 1_000_000 + 100 - self.tare)))
    }
}

/// Orders what its sensor weighs, and sets the tare to the last weight.
struct Weigh;

impl Coordinator<2> for Weigh {
    type Order = u32;
    type Answer = u32;
    type Sensors = V<Weight>;
    type Out = Tell<u32>;
    type Memory = ();

    fn first_step(&mut self, v: &V<Weight>, _: Duration) -> Result<Orders<Self, 2>, GeneratorError> {
        self.next_step(&(), &[Sample { at: at(0), age: Duration::ZERO, value: 0 }; 2], v)
    }

    fn terminal(&self, (): &(), _: &[Sample<u32>; 2], _: &V<Weight>) -> bool {
        false
    }

    fn next_step(&self, (): &(), _: &[Sample<u32>; 2], v: &V<Weight>) -> Result<Orders<Self, 2>, GeneratorError> {
        let Weight(weight) = *v.0.younger_than(DEADLINE)?;
        Ok(NextOrders::new([weight; 2], ()).with(Tell(weight)))
    }
}

#[test]
fn a_coordinator_waits_for_its_interactive_sensor_and_tells_it_what_it_found() {
    let mut sensors = Sensors::default();
    sensors.install(Scale { asked: None, tare: 0, broken: false }, Shell::Interactive, 1).unwrap();
    let (mut lead, mut members) = Lead::of_pair(Weigh, sensors);
    let mut orders = Vec::new();
    for step in 0..3 {
        let asked = 10 * step;
        for early in [asked, asked + 9] {
            let polled = lead.on_desk(at(early), 1.0, if step == 0 { Conduct::begin } else { Conduct::poll });
            assert_eq!(polled, Poll::Pending, "step {step} at {early}");
        }
        let polled = lead.on_desk(at(asked + 10), 1.0, if step == 0 { Conduct::begin } else { Conduct::poll });
        assert_eq!(polled, if step == 0 { Poll::Ready(Ok(())) } else { Poll::Pending });
        for member in &mut members {
            assert_eq!(member.poll(step, at(asked + 10), 1.0), Ok(Turn::Ready));
            orders.push(*received(member).younger_than(DEADLINE).unwrap());
            assert!(member.answer(&0_u32 as &dyn Any, at(asked + 10)));
        }
    }
    // At 0, 10 and 20 ms, without the tare of the step before.
    assert_eq!(orders, [100, 100, 10, 10, 110, 110]);
    let mut events = Vec::new();
    while let Ok(record) = lead.records.queue.pop() {
        events.push((record.class, record.event));
    }
    let read = events.iter().filter(|(_, event)| *event == StepEvent::ReadSensor);
    assert_eq!(read.map(|(class, _)| *class).collect::<Vec<_>>(), [2, 3, 3]);
}

#[test]
fn a_sensor_that_never_reads_is_an_error_of_the_coordinator_and_so_is_a_missing_one() {
    let mut sensors = Sensors::default();
    sensors.install(Scale { asked: None, tare: 0, broken: true }, Shell::Interactive, 1).unwrap();
    let (mut lead, _members) = Lead::of_pair(Weigh, sensors);
    assert_eq!(lead.on_desk(at(0), 1.0, Conduct::begin), Poll::Pending);
    let unread = CoordinatorError::Unread { step: 0, waited: Duration::from_millis(81) };
    assert_eq!(lead.on_desk(at(80), 1.0, Conduct::begin), Poll::Pending);
    assert_eq!(lead.on_desk(at(81), 1.0, Conduct::begin), Poll::Ready(Err(unread)));

    let (mut lead, _members) = Lead::of_pair(Weigh, Sensors::default());
    let missing = lead.on_desk(at(0), 1.0, Conduct::begin);
    let Poll::Ready(Err(CoordinatorError::Generator { step: 0, error: GeneratorError::NoSensor { .. } })) = missing
    else {
        panic!("{missing:?}")
    };
}
