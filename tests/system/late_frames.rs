//! Frames that all come late by the same time, from the start or beginning in motion, in virtual time.

use std::task::Poll;
use std::time::Duration;

use can::{Instant, StandardId};
use drive::{BringUpError, Fault, Warning, WarningCause};
use hil::{BusId, FrameFault, Frames, WorldFault};
use kit::cell::{Rig, Setup, ends_on_bus};
use servo::{Phase, StopCause};

use crate::host_closed;

/// Period of the cells.
const PERIOD: Duration = Duration::from_millis(2);

fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

fn late(bus: BusId, frames: Frames, late: Duration) -> WorldFault {
    WorldFault::Frames { bus, frames, fault: FrameFault::Late(late), probability: 1.0, count: None, seed: 1 }
}

/// Periods and latency of the warnings of late answers, by node.
fn lags<'a>(warnings: impl Iterator<Item = &'a Warning>) -> Vec<(u8, u32, Duration)> {
    let lag = |it: &Warning| match it.cause {
        WarningCause::Late { periods, latency } => Some((it.node, periods, latency)),
        WarningCause::Emergency { .. }
        | WarningCause::Surplus
        | WarningCause::Reported
        | WarningCause::Limited
        | WarningCause::SoftwareLimits { .. }
        | WarningCause::NoErrorBehaviour
        | WarningCause::Compared { .. } => None,
    };
    warnings.filter_map(lag).collect()
}

/// TPDO 1 of these nodes, each late by `delay`.
fn answers(bus: BusId, nodes: &[u8], delay: Duration) -> Vec<WorldFault> {
    let tpdo = |node: &u8| StandardId::new(0x180 + u16::from(*node)).unwrap();
    nodes.iter().map(|node| late(bus, Frames::Id(tpdo(node)), delay)).collect()
}

/// Brings up the drives of a cell under faults from the start. Returns the lags that bring-up warns of.
fn brought_up(
    setup: Setup,
    faults: impl Fn(BusId) -> Vec<WorldFault>,
) -> Result<Vec<(u8, u32, Duration)>, BringUpError> {
    let (mut group, mut world, period, bus) = ends_on_bus(setup);
    for fault in faults(bus) {
        world.begin_fault(&fault, Instant::ZERO);
    }
    let mut now = Instant::ZERO;
    loop {
        if let Poll::Ready(result) = group.bring_up(now) {
            return result.map(|()| lags(group.warnings().iter()));
        }
        now += period;
        world.advance(now);
    }
}

/// Nodes and periods; asserts that the latencies agree with the periods.
fn periods(lags: &[(u8, u32, Duration)]) -> Vec<(u8, u32)> {
    for (node, periods, latency) in lags {
        assert!(*latency > *periods * PERIOD && *latency <= (*periods + 1) * PERIOD, "node {node}: {latency:?}");
    }
    lags.iter().map(|(node, periods, _)| (*node, *periods)).collect()
}

#[test]
fn a_constant_delay_from_the_start_is_measured() {
    assert_eq!(brought_up(Setup::of("irb6"), |_| vec![]), Ok(vec![]));
    // The answers come within a period, so a delay of 5 ms makes them late by two or three.
    let all = brought_up(Setup::of("irb6"), |bus| answers(bus, &[1, 2, 3, 4, 5], ms(5))).unwrap();
    assert_eq!(all.len(), 5);
    assert!(periods(&all).iter().all(|(_, periods)| [2, 3].contains(periods)), "{all:?}");
    let one = brought_up(Setup::of("irb6"), |bus| answers(bus, &[3], ms(4))).unwrap();
    assert_eq!(periods(&one), [(3, 2)]);
    let host = brought_up(Setup::of("irb6"), |bus| vec![late(bus, Frames::FromHost, ms(5))]).unwrap();
    assert_eq!(host.len(), 5);
    // The cell tolerates five missing answers.
    for delay in [ms(13), ms(40)] {
        let result = brought_up(Setup::of("irb6"), |bus| answers(bus, &[2], delay));
        let Err(BringUpError::Late { node: 2, latency, most }) = result else { panic!("{delay:?}: {result:?}") };
        assert_eq!(most, 6 * PERIOD);
        assert!(latency > delay && latency < delay + PERIOD, "{latency:?}");
    }
}

/// Moves all axes under faults that begin in motion, and waits for the end of the motion and of two seconds.
fn move_under(rig: &mut Rig, faults: &[WorldFault]) -> Option<StopCause> {
    rig.home();
    let mut motion = rig.in_motion();
    for fault in faults {
        rig.world.begin_fault(fault, rig.now);
    }
    let end = rig.now + ms(3_000);
    while rig.now < end && rig.servo.fault(0).is_none() {
        rig.feed(&mut motion);
        rig.cycle();
    }
    rig.servo.fault(0).map(|fault| fault.cause)
}

fn warned(rig: &Rig) -> Vec<(u8, u32, Duration)> {
    lags(rig.servo.warnings().flat_map(|warnings| warnings.iter()))
}

#[test]
fn a_constant_delay_that_begins_in_motion_is_told_with_the_true_latency() {
    for delay in [4, 5] {
        let mut rig = Setup::of("irb6").bring_up();
        let faults = answers(rig.bus(), &[1, 2, 3, 4, 5], ms(delay));
        assert_eq!(move_under(&mut rig, &faults), None, "{delay} ms");
        let lags = warned(&rig);
        assert!(lags.len() == 5 && periods(&lags).iter().all(|(_, it)| [2, 3].contains(it)), "{delay} ms: {lags:?}");
        assert!(lags.iter().all(|(.., latency)| *latency > ms(delay) && *latency < ms(delay) + PERIOD), "{lags:?}");
    }
}

#[test]
fn a_constant_delay_of_one_drive_that_begins_in_motion_names_its_node() {
    let mut rig = Setup::of("irb6").bring_up();
    let faults = answers(rig.bus(), &[3], ms(4));
    assert_eq!(move_under(&mut rig, &faults), None);
    assert_eq!(periods(&warned(&rig)), [(3, 2)]);
}

#[test]
fn a_constant_delay_of_the_frames_of_the_host_that_begins_in_motion_is_told() {
    let mut rig = Setup::of("irb6").bring_up();
    let faults = [late(rig.bus(), Frames::FromHost, ms(5))];
    assert_eq!(move_under(&mut rig, &faults), None);
    assert_eq!(warned(&rig).len(), 5);
}

#[test]
fn the_following_error_of_late_answers_is_that_of_answers_in_time() {
    // Greatest following error in the second half of a motion.
    let peak = |delay: Duration| {
        let mut rig = Setup::of("irb6").bring_up();
        let faults = answers(rig.bus(), &[1, 2, 3, 4, 5], delay);
        rig.home();
        let mut motion = rig.in_motion();
        for fault in faults.iter().filter(|_| !delay.is_zero()) {
            rig.world.begin_fault(fault, rig.now);
        }
        // The SYNC that is left out proves the lag within some periods.
        let proven = rig.now + ms(60);
        rig.follow(&mut motion, |rig| rig.now >= proven);
        let mut peak: f64 = 0.0;
        while rig.phase() == Phase::Moving {
            rig.feed(&mut motion);
            rig.cycle();
            let axes = rig.last.axis.iter().take(5);
            let errors = axes.filter_map(|axis| axis.expected.map(|expected| (expected - axis.measured).abs()));
            peak = errors.fold(peak, f64::max);
        }
        peak
    };
    let [sound, late] = [Duration::ZERO, ms(5)].map(peak);
    assert!(late < 1.2 * sound + 0.01, "{late} rad, {sound} rad without a delay");
}

#[test]
fn a_constant_delay_is_refused_or_a_fault_where_the_host_closes_the_loop() {
    for control in host_closed::BY_HOST {
        let setup = || host_closed::irb6(control);
        assert_eq!(brought_up(setup(), |_| vec![]), Ok(vec![]));
        let refused = brought_up(setup(), |bus| answers(bus, &[3], ms(4)));
        assert!(matches!(refused, Err(BringUpError::Late { node: 3, most: PERIOD, .. })), "{control:?}: {refused:?}");
        let mut rig = setup().bring_up();
        let faults = answers(rig.bus(), &[3], ms(4));
        let cause = move_under(&mut rig, &faults);
        let Some(StopCause::Drive(Fault::Late { node: 3, periods: 2, most: PERIOD, .. })) = cause else {
            panic!("{control:?}: {cause:?}")
        };
    }
}

#[test]
fn answers_that_come_twice_are_counted_and_told_with_their_node() {
    let mut rig = Setup::of("irb6").bring_up();
    let frames = Frames::Id(StandardId::new(0x183).unwrap());
    let (fault, count) = (FrameFault::Duplicated, Some(40));
    let twice = WorldFault::Frames { bus: rig.bus(), frames, fault, probability: 1.0, count, seed: 1 };
    assert_eq!(move_under(&mut rig, &[twice]), None);
    let warnings = rig.servo.warnings().flat_map(|warnings| warnings.iter());
    let told: Vec<_> = warnings.map(|it| (it.node, it.cause, it.count)).collect();
    assert_eq!(told, [(3, WarningCause::Surplus, 40)]);
}
