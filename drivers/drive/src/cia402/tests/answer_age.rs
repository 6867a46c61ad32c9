//! Answers that come late by periods, at the end of bring-up and in operation.

use std::time::Duration;

use super::bench::*;
use crate::WarningCause;
use crate::cia402::*;

/// Cycles of a test in operation.
const CYCLES: u64 = 700;

fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// A bench of node 2 and 3 with these latencies in bring-up.
fn bench(mode: CyclicMode, latencies: [Option<Duration>; 2]) -> Bench {
    let axes = [2, 3].map(|raw| AxisConfig { mode, ..axis_config(raw) });
    let mut bench = Bench::new(group_config(), &axes);
    bench.latencies = latencies.to_vec();
    bench
}

/// The warnings of late answers: node, periods and latency.
fn late(bench: &Bench) -> Vec<(u8, u32, Duration)> {
    let late = |cause| match cause {
        WarningCause::Late { periods, latency } => Some((periods, latency)),
        WarningCause::Emergency { .. }
        | WarningCause::Surplus
        | WarningCause::Reported
        | WarningCause::Limited
        | WarningCause::SoftwareLimits { .. }
        | WarningCause::NoErrorBehaviour
        | WarningCause::Compared { .. } => None,
    };
    let warnings = bench.group.warnings().iter();
    warnings.filter_map(|it| late(it.cause).map(|(periods, latency)| (it.node, periods, latency))).collect()
}

#[test]
fn bring_up_measures_the_latency_of_a_sync_that_stands_alone() {
    // The group tolerates two missing answers: three periods of 2 ms.
    let table = [
        (CyclicMode::Csp, Some(ms(1)), Ok(vec![])),
        (CyclicMode::Csp, Some(ms(2)), Ok(vec![])),
        (CyclicMode::Csp, Some(ms(3)), Ok(vec![(3, 1, ms(3))])),
        (CyclicMode::Csp, Some(ms(5)), Ok(vec![(3, 2, ms(5))])),
        (CyclicMode::Csp, Some(ms(11)), Err(BringUpError::Late { node: 3, latency: ms(11), most: ms(6) })),
        (CyclicMode::CspWithTorque, Some(ms(5)), Ok(vec![(3, 2, ms(5))])),
        (CyclicMode::Csv, Some(ms(2)), Ok(vec![])),
        (CyclicMode::Csv, Some(ms(3)), Err(BringUpError::Late { node: 3, latency: ms(3), most: ms(2) })),
        (CyclicMode::Cst, Some(ms(5)), Err(BringUpError::Late { node: 3, latency: ms(5), most: ms(2) })),
        (CyclicMode::Csp, None, Err(BringUpError::NoAnswer { node: 3, waited: ms(100) })),
    ];
    for (mode, latency, expected) in table {
        let mut bench = bench(mode, [Some(ms(1)), latency]);
        let result = bench.bring_up();
        assert_eq!(result.map(|()| late(&bench)), expected, "{mode:?} {latency:?}");
    }
}

/// Runs two enabled drives, with a latency of node 3 from cycle 50 to cycle `until`. Answers that were not sent because of a
/// SYNC that was left out are left out too. Returns the cycles whose SYNC was left out.
fn operate(bench: &mut Bench, latency: Duration, until: u64) -> Vec<u64> {
    bench.enable();
    let (mut left_out, mut delayed) = (vec![], vec![]);
    for cycle in 0..CYCLES {
        let sync = bench.now;
        let (stand, late) = ([AxisCommand::Stand; 2], (50..until).contains(&cycle));
        let answered = left_out.last() != Some(&cycle.wrapping_sub(1));
        let node_3 = frame(&answer(3, 0x0737, 1_000));
        let due = sync + PERIOD / 2 + if late { latency } else { Duration::ZERO };
        delayed.extend(answered.then_some(Received { frame: node_3, at: due }));
        // The answers that are due before the next read.
        let ready = delayed.iter().take_while(|it| it.at <= sync + PERIOD).count();
        bench.bus.0.lock().unwrap().inbox.extend(delayed.drain(..ready));
        let answers: Vec<_> = answered.then(|| answer(2, 0x0737, 1_000)).into_iter().collect();
        let sent = bench.cycle(&answers, &stand);
        if !sent.iter().any(|frame| frame.starts_with("080#")) {
            assert!(!sent.iter().any(|frame| frame.starts_with("20")), "{sent:?}");
            left_out.push(cycle);
        }
    }
    left_out
}

#[test]
fn a_lag_that_begins_in_operation_is_proven_and_told() {
    for (delay, periods) in [(0, 0), (2, 1), (4, 2)] {
        let mut bench = bench(CyclicMode::Csp, [Some(ms(1)); 2]);
        assert_eq!(bench.bring_up(), Ok(()));
        let left_out = operate(&mut bench, ms(delay), CYCLES);
        assert_eq!(left_out.len(), usize::from(periods > 0), "{delay} ms: {left_out:?}");
        let expected = if periods == 0 { vec![] } else { vec![(3, periods, ms(delay + 1))] };
        assert_eq!(late(&bench), expected, "{delay} ms");
        assert_eq!(bench.states.iter().map(|state| state.lag).collect::<Vec<_>>(), [0, periods]);
        assert_eq!(bench.states.iter().map(|state| state.fault).collect::<Vec<_>>(), [None; 2]);
        let sampled = bench.now - (periods + 1) * PERIOD;
        assert_eq!(bench.states[1].sampled, sampled, "{delay} ms");
    }
}

#[test]
fn a_lag_that_begins_in_operation_is_a_fault_where_the_host_closes_the_loop() {
    for mode in [CyclicMode::Csv, CyclicMode::Cst] {
        let mut bench = bench(mode, [Some(ms(1)); 2]);
        assert_eq!(bench.bring_up(), Ok(()));
        operate(&mut bench, ms(4), CYCLES);
        let fault = Fault::Late { node: 3, periods: 2, latency: ms(5), most: ms(2) };
        assert_eq!(bench.states.iter().map(|state| state.fault).collect::<Vec<_>>(), [None, Some(fault)]);
    }
}

#[test]
fn the_end_of_a_lag_is_noticed() {
    let mut bench = bench(CyclicMode::Csp, [Some(ms(1)); 2]);
    assert_eq!(bench.bring_up(), Ok(()));
    let left_out = operate(&mut bench, ms(4), 100);
    assert_eq!(bench.states[1].lag, 0);
    // At most one SYNC a second.
    assert!(left_out.windows(2).all(|pair| pair[1] - pair[0] >= 500), "{left_out:?}");
    assert_eq!(left_out.len(), 2);
}

#[test]
fn surplus_answers_are_counted() {
    let mut bench = Bench::up(&[2]);
    bench.enable();
    for cycle in 0..100 {
        let one = answer(2, 0x0737, 1_000);
        let answers = if cycle < 40 { vec![one.clone(), one] } else { vec![one] };
        bench.cycle(&answers, &[AxisCommand::Stand]);
    }
    let surplus = bench.group.warnings().iter().map(|it| (it.node, it.cause, it.count)).collect::<Vec<_>>();
    assert_eq!(surplus, [(2, WarningCause::Surplus, 40)]);
    assert_eq!(bench.states[0].fault, None);
}
