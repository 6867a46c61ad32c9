//! First steps that a planner computes while the effector stands.

use std::sync::{Arc, Mutex};

use super::*;

/// Holds plans until the test computes them.
#[derive(Clone, Default)]
pub(super) struct Held(Arc<Mutex<VecDeque<Plan>>>, Arc<Mutex<VecDeque<Plan>>>);

impl Planner for Held {
    fn begin(&mut self, plan: Plan) {
        self.0.lock().unwrap().push_back(plan);
    }

    fn finished(&mut self) -> Option<Plan> {
        self.1.lock().unwrap().pop_front()
    }
}

impl Held {
    /// Computes the oldest plan.
    pub(super) fn compute(&self) {
        let mut plan = self.0.lock().unwrap().pop_front().unwrap();
        plan.compute();
        self.1.lock().unwrap().push_back(plan);
    }

    /// Computes all plans that wait.
    pub(super) fn compute_all(&self) {
        while !self.0.lock().unwrap().is_empty() {
            self.compute();
        }
    }

    pub(super) fn on(bench: &mut Bench) -> Self {
        let held = Self::default();
        bench.ecp.plan_with(Box::new(held.clone()));
        held
    }
}

#[test]
fn the_effector_stands_while_its_motion_is_planned_and_then_moves_as_if_planned_at_once() {
    let mut at_once = Bench::ready();
    assert_eq!(at_once.run(Task::new().run(to(0.5, 0.0, 0.0))), finished(1));
    let mut bench = Bench::ready();
    let held = Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0))).unwrap();
    let mut period = 0;
    let events = bench.go_on(|bench| {
        period += 1;
        if period == 500 {
            assert_eq!((bench.ecp.status().phase, bench.servo.moves().count()), (Phase::Standing, 0));
            held.compute();
        }
    });
    assert_eq!(events, finished(1));
    assert!(bench.servo.moves().eq(at_once.servo.moves()));
}

#[test]
fn a_plan_that_takes_too_long_ends_the_instruction_and_its_late_result_is_dropped() {
    let mut bench = Bench::ready();
    let held = Held::on(&mut bench);
    let waited = CONFIG.planning + PERIOD;
    assert_eq!(bench.run(Task::new().run(to(0.5, 0.0, 0.0))), failed(EcpError::Unplanned { waited }));
    bench.ecp.execute(Task::new().run(to(0.0, 0.25, 0.0))).unwrap();
    let mut period = 0;
    let events = bench.go_on(|_| {
        period += 1;
        // The result of the first plan comes while the second one is computed.
        if period == 10 || period == 20 {
            held.compute();
        }
    });
    assert_eq!(events, finished(1));
    assert_eq!(bench.servo.report.snapshot.commanded[0], 0.0);
    assert!(bench.servo.report.snapshot.commanded[1] > 20.0);
}

#[test]
fn a_stop_while_a_motion_is_planned_ends_the_task_and_nothing_moves() {
    let mut bench = Bench::ready();
    let held = Held::on(&mut bench);
    bench.ecp.execute(Task::new().run(to(0.5, 0.0, 0.0)).run(to(0.0, 0.0, 0.0))).unwrap();
    let mut period = 0;
    let events = bench.go_on(|bench| {
        period += 1;
        match period {
            10 => bench.ecp.stop(),
            11 => held.compute(),
            _ => {}
        }
    });
    assert_eq!(events, failed(EcpError::Stopped));
    assert_eq!(bench.servo.moves().count(), 0);
}

#[test]
fn a_panic_in_a_first_step_is_an_error_of_its_generator() {
    struct Panics;
    impl Generator for Panics {
        type First = ();
        type Every = ();
        type Out = ();
        type Memory = ();
        fn first_step(&mut self, (): &(), _: Duration) -> Result<Next<()>, GeneratorError> {
            panic!("as the test asks");
        }
        fn terminal(&self, (): &(), (): &()) -> bool {
            true
        }
        fn next_step(&self, (): &(), (): &()) -> Result<Next<()>, GeneratorError> {
            Ok(Next::remember(()))
        }
    }
    let mut bench = Bench::ready();
    let error = EcpError::Generator { step: 0, error: GeneratorError::Panicked };
    assert_eq!(bench.run(Task::new().run(Panics)), failed(error));
}

#[test]
fn each_process_sends_its_barrier_together_with_its_first_macrosteps() {
    let mut benches = [Bench::ready(), Bench::ready()];
    let meetings = Meetings::new([vec![0, 1]]);
    let held = benches.each_mut().map(Held::on);
    for bench in &mut benches {
        bench.ecp.execute(Task::new().meet(0).run(to(0.1, 0.0, 0.0))).unwrap();
    }
    let mut sent = [None; 2];
    // Longer than a servo may be silent in motion.
    let periods = (3 * CONFIG.silence).as_millis() / PERIOD.as_millis();
    for period in 0..periods {
        match period {
            50 => held[0].compute(),
            _ if period == periods - 10 => held[1].compute(),
            _ => {}
        }
        let now = benches[0].now;
        for bench in &mut benches {
            while let Some(event) = bench.ecp.poll(now) {
                assert_eq!(event.outcome, Ok(()));
            }
        }
        let [one, other] = benches;
        let mut ecps = [one.ecp, other.ecp];
        meetings.poll(&mut ecps);
        let [first, second] = ecps;
        benches = [Bench { ecp: first, ..one }, Bench { ecp: second, ..other }];
        for (bench, sent) in benches.iter_mut().zip(&mut sent) {
            bench.now += PERIOD;
            let orders = bench.servo.orders.slots();
            if orders > 0 {
                sent.get_or_insert((period, orders));
                // The effector waits at the barrier.
                bench.servo.report.snapshot.waiting = true;
                bench.servo.publish();
            }
        }
    }
    let chunk = 1 + usize::from(CONFIG.macrosteps_ahead);
    assert_eq!(sent, [Some((50, chunk)), Some((periods - 10, chunk))]);
    for bench in &mut benches {
        assert_eq!(bench.servo.orders.pop(), Ok(Order::Meet { members: 0b11 }));
    }
}

#[test]
fn the_first_next_step_reads_the_state_after_the_planning() {
    let mut bench = Bench::ready();
    let held = Held::on(&mut bench);
    let (sender, seen) = std::sync::mpsc::channel();
    bench.ecp.execute(Task::new().run(images::Look(sender))).unwrap();
    let mut period = 0;
    bench.go_on(|_| {
        period += 1;
        if period == 500 {
            held.compute();
        }
    });
    let seen: Vec<_> = seen.iter().collect();
    assert!(seen[1].read_at.since(seen[0].read_at) >= 499 * PERIOD, "{:?} {:?}", seen[0].read_at, seen[1].read_at);
}
