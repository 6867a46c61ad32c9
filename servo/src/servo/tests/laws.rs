//! Cycle laws: displacements, their bounds, and the end of a motion under a law.

use super::*;
use crate::{CycleLaw, LawBound, LawError, LawFault, LawInput, LawOutput, LawParameters, ServoFault};

/// The bounds of every axis.
const BOUND: LawBound = LawBound { displacement: 5.0, speed: 50.0 };

/// What a law saw in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen {
    first: bool,
    planned: f64,
    displacement: f64,
    commanded: f64,
    measured: f64,
    rate: f64,
    macrostep: u64,
}

/// A law whose output is a function of the number of its calls since the beginning, and of its first parameter.
pub(super) struct Scripted {
    output: fn(u32, f64) -> LawOutput,
    calls: u32,
    began: bool,
    seen: Arc<Mutex<Vec<Seen>>>,
}

impl Scripted {
    fn new(output: fn(u32, f64) -> LawOutput) -> (Box<Self>, Arc<Mutex<Vec<Seen>>>) {
        let seen = Arc::default();
        (Box::new(Self { output, calls: 0, began: false, seen: Arc::clone(&seen) }), seen)
    }

    pub(super) fn law(output: fn(u32, f64) -> LawOutput) -> Box<Self> {
        Self::new(output).0
    }
}

impl CycleLaw for Scripted {
    fn check(&self, parameters: &LawParameters) -> Result<(), LawFault> {
        let value = parameters.0[0];
        if value < 0.0 { Err(LawFault::Parameter { index: 0, value }) } else { Ok(()) }
    }

    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {
        (self.calls, self.began) = (0, true);
    }

    fn shift(&mut self, input: &LawInput<'_>, parameters: &LawParameters) -> LawOutput {
        self.calls += 1;
        let axis = &input.axes[0];
        self.seen.lock().unwrap().push(Seen {
            first: std::mem::take(&mut self.began),
            planned: axis.planned.position,
            displacement: axis.displacement,
            commanded: axis.commanded,
            measured: axis.position,
            rate: input.rate,
            macrostep: input.macrostep,
        });
        assert!((input.period, input.periods) == (DT, 1));
        (self.output)(self.calls, parameters.0[0])
    }
}

/// The same displacement of all motors, rad.
pub(super) fn all(displacement: f64) -> LawOutput {
    LawOutput::Displacement([displacement; MAX_AXES])
}

/// A displacement that grows at up to 0.8 rad/s, within an acceleration of 80 rad/s².
fn drift(call: u32, _: f64) -> LawOutput {
    let ramp = f64::from(call.min(10));
    all(8e-5 * 0.5 * ramp * ramp + 8e-4 * (f64::from(call) - ramp))
}

pub(super) fn with_law(macrostep: Macrostep, parameter: f64) -> Macrostep {
    let mut parameters = LawParameters::default();
    parameters.0[0] = parameter;
    Macrostep { law: Some(parameters), ..macrostep }
}

fn rig(axes: usize, law: Box<dyn CycleLaw>) -> Rig {
    let mut rig = Rig::new(axes);
    rig.servo.install_law(0, law, &[BOUND; MAX_AXES][..axes]).unwrap();
    rig.stand()
}

#[test]
fn a_law_displaces_the_path_and_the_effector_stands_at_the_sum() {
    let (law, seen) = Scripted::new(drift);
    let mut rig = rig(2, law);
    for number in 1..=3 {
        rig.order(Order::Move(with_law(macrostep(number, 10, 0.005 * number as f64, 0.0), 0.0)));
    }
    rig.run(15);
    let snapshot = rig.link.latest.read();
    let LawOutput::Displacement([displaced, ..]) = drift(15, 0.0) else { unreachable!() };
    assert_eq!(snapshot.displacement, [displaced, displaced, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let planned = snapshot.commanded[0] - displaced;
    assert!((0.005..0.01).contains(&planned), "{planned}");
    let step = snapshot.commanded_velocity[0] - 0.8;
    assert!((0.0..1.5).contains(&step), "the velocity contains that of the displacement: {step}");
    rig.run_until(Phase::Standing);
    assert_eq!(rig.cause(), None);

    let positions = rig.positions(0);
    keeps_limits(&positions).unwrap();
    let seen = seen.lock().unwrap().clone();
    assert_eq!(seen.len(), 30, "the law runs in each cycle of the three macrosteps");
    assert_eq!(seen.iter().filter(|it| it.first).count(), 1);
    assert_eq!(seen.iter().map(|it| it.macrostep).collect::<Vec<_>>()[8..12], [1, 1, 2, 2]);
    for (at, pair) in seen.windows(2).enumerate() {
        assert_eq!(pair[1].commanded, positions[at], "{at}");
        assert_eq!(pair[1].commanded, pair[0].planned + pair[1].displacement, "{at}");
    }
    assert_eq!(seen[29].planned, 0.015, "the path is not displaced");
    // 0.8 rad/s are within the acceleration limit of one period, so the effector stands at once.
    let LawOutput::Displacement([end, ..]) = drift(30, 0.0) else { unreachable!() };
    assert_eq!(*positions.last().unwrap(), 0.015 + end);
    let snapshot = rig.link.latest.read();
    assert_eq!((snapshot.commanded[0], snapshot.commanded_velocity[0]), (0.015 + end, 0.0));
    assert_eq!(snapshot.displacement, [0.0; MAX_AXES]);

    // The next motion begins there, with or without a law, and a new motion begins the law anew.
    rig.order(Order::Move(macrostep(4, 20, 0.015 + end + 0.01, 0.0)));
    rig.run_until(Phase::Moving);
    rig.run_until(Phase::Standing);
    rig.order(Order::Move(with_law(macrostep(5, 20, 0.015 + end, 0.0), 0.0)));
    rig.run(25);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, None));
    keeps_limits(&rig.positions(0)).unwrap();
}

#[test]
fn a_law_begins_in_motion_behind_a_macrostep_without_one_and_cannot_end_in_motion() {
    for (second, expected) in [(true, None), (false, Some(StopCause::LawLeft { number: 6 }))] {
        let mut rig = rig(1, Scripted::law(drift));
        let (position, velocity) = rig.accelerate(500.0, 3, 1);
        let next = |number: u64| macrostep(number, 10, position + velocity * 0.01 * (number - 4) as f64, velocity);
        rig.order(Order::Move(with_law(next(5), 0.0)));
        let sixth = next(6);
        rig.order(Order::Move(if second { with_law(sixth, 0.0) } else { sixth }));
        rig.run(55);
        let phase = if second { Phase::Moving } else { Phase::Stopping };
        assert_eq!((rig.phase(), rig.cause()), (phase, expected), "{second}");
        rig.run(100);
        keeps_limits(&rig.positions(0)).unwrap();
    }
    // At rest between two macrosteps that follow each other without a stand, the position would jump too.
    let mut rig = rig(1, Scripted::law(drift));
    rig.order(Order::Move(with_law(macrostep(1, 10, 0.0, 0.0), 0.0)));
    rig.order(Order::Move(macrostep(2, 10, 0.0, 0.0)));
    rig.run(12);
    assert_eq!(rig.cause(), Some(StopCause::LawLeft { number: 2 }));
}

#[test]
fn a_law_that_still_moves_at_the_end_of_the_motion_is_braked_to_a_stand() {
    // 20 rad/s at the end: 20 periods at 1000 rad/s².
    let fast = |call: u32, _: f64| all(0.5 * 500.0 * (f64::from(call) * DT).powi(2));
    let mut rig = rig(1, Scripted::law(fast));
    rig.order(Order::Move(with_law(macrostep(1, 40, 0.0, 0.0), 0.0)));
    rig.run(41);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Stopping, None));
    rig.run_until(Phase::Standing);
    assert_eq!(rig.cause(), None);
    let positions = rig.positions(0);
    keeps_limits(&positions).unwrap();
    let stop = positions.last().unwrap() - positions[39];
    assert!((stop - 0.5 * 20.0 * 0.019).abs() < 0.006, "{stop}");
    // The next motion needs no acknowledgement.
    let at = *positions.last().unwrap();
    rig.order(Order::Move(macrostep(2, 10, at, 0.0)));
    rig.run(3);
    assert_eq!(rig.phase(), Phase::Moving);
}

#[test]
fn a_law_that_panics_brakes_the_effector_in_category_1_and_is_not_called_again() {
    let (law, seen) = Scripted::new(|call, _| if call < 57 { all(0.0) } else { panic!("as the test asks") });
    let mut rig = rig(1, law);
    for macrostep in constant_speed(20) {
        rig.order(Order::Move(with_law(macrostep, 0.0)));
    }
    rig.run(57);
    let panicked = StopCause::Law(LawFault::Panicked);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Stopping, Some(panicked)));
    let positions = rig.positions(0);
    let step = |at: usize| positions[at] - positions[at - 1];
    assert!((step(56) / step(55) - 0.95).abs() < 1e-9, "{} {}", step(56), step(55));
    rig.run(100);
    keeps_limits(&rig.positions(0)).unwrap();
    assert_eq!((rig.phase(), rig.servo.is_off()), (Phase::Faulted, true));
    assert_eq!(rig.servo.fault(0).map(|fault| fault.category), Some(crate::StopCategory::One));
    let calls = seen.lock().unwrap().len();
    rig.order(Order::ResetFault);
    rig.run(2);
    rig.order(Order::Enable);
    rig.run_until(Phase::Standing);
    let at = *rig.positions(0).last().unwrap();
    rig.order(Order::Move(with_law(macrostep(21, 10, at, 0.0), 0.0)));
    rig.run(3);
    assert_eq!((rig.cause(), seen.lock().unwrap().len()), (Some(panicked), calls));
}

#[test]
fn a_touch_brakes_in_its_cycle_and_refuses_motion_until_it_is_acknowledged() {
    let mut rig = rig(1, Scripted::law(|call, _| if call < 57 { all(0.0) } else { LawOutput::Touched }));
    for macrostep in constant_speed(20) {
        rig.order(Order::Move(with_law(macrostep, 0.0)));
    }
    rig.run(57);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Stopping, Some(StopCause::Touched)));
    let positions = rig.positions(0);
    let step = |at: usize| positions[at] - positions[at - 1];
    // 20 rad/s at 1000 rad/s²: each period takes a twentieth of the speed away, from the cycle of the touch on.
    assert!((step(56) / step(55) - 0.95).abs() < 1e-9, "{} {}", step(56), step(55));
    rig.run(100);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Standing, Some(StopCause::Touched)));
    keeps_limits(&rig.positions(0)).unwrap();
    let report = rig.reports().last().copied().unwrap();
    assert_eq!(report.fault, Some(ServoFault::new(None, StopCause::Touched)));
    assert_eq!(rig.servo.counters().refused_orders, 14, "the macrosteps behind the touch are dropped");
    let at = *rig.positions(0).last().unwrap();
    rig.order(Order::Stop);
    rig.order(Order::Move(macrostep(21, 10, at, 0.0)));
    rig.run(3);
    assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
}

/// Macrosteps of 10 periods from zero: 500 rad/s² in the first four, then 20 rad/s.
fn constant_speed(count: u64) -> Vec<Macrostep> {
    let (mut position, mut velocity) = (0.0, 0.0);
    let next = |number| {
        let a = if number <= 4 { 500.0 } else { 0.0 };
        position += velocity * 10.0 * DT + 0.5 * a * (10.0 * DT).powi(2);
        velocity += a * 10.0 * DT;
        macrostep(number, 10, position, velocity)
    };
    (1..=count).map(next).collect()
}

#[test]
fn each_wrong_output_or_parameter_is_a_fault_with_its_cause() {
    const FAULT: LawFault = LawFault::Silent { age: 0.004, limit: 0.002 };
    type Case = (fn(u32, f64) -> LawOutput, f64, &'static str);
    let cases: [Case; 9] = [
        (|_, _| all(f64::NAN), 0.0, "NotFinite"),
        (|_, _| all(f64::INFINITY), 0.0, "NotFinite"),
        (|_, _| all(1e300), 0.0, "LawDisplacement"),
        (|_, _| all(1.0), 0.0, "LawSpeed"),
        (|_, _| all(0.02), 0.0, "AccelerationLimit"),
        (|_, _| LawOutput::Fault(FAULT), 0.0, "Law(Silent"),
        (|_, _| LawOutput::Fault(LawFault::Saturated { channel: 2 }), 0.0, "Law(Saturated"),
        (|_, _| all(0.0), -1.0, "Law(Parameter"),
        (|_, _| all(0.0), f64::NAN, "NotFinite"),
    ];
    for (number, (output, parameter, expected)) in cases.into_iter().enumerate() {
        let mut rig = rig(2, Scripted::law(output));
        rig.order(Order::Move(with_law(macrostep(1, 10, 0.0, 0.0), parameter)));
        rig.run(150);
        let cause = format!("{:?}", rig.cause().unwrap());
        assert!(cause.starts_with(expected), "case {number}: {cause} instead of {expected}");
        assert_eq!(rig.phase(), Phase::Faulted, "case {number}");
        assert!(rig.positions(0).iter().all(|&at| at == 0.0), "case {number}: nothing is sent");
    }
    let mut rig = Rig::standing(1);
    rig.order(Order::Move(with_law(macrostep(7, 10, 0.0, 0.0), 0.0)));
    rig.run(2);
    assert_eq!(rig.cause(), Some(StopCause::NoLaw { number: 7 }));
}

#[test]
fn a_law_is_installed_once_with_bounds_for_each_axis_before_the_cycles() {
    let law = || Scripted::law(drift);
    let mut servo = Rig::new(2).servo;
    let cases = [
        (vec![], "a law without limits: 0 bounds for 2 axes; give displacement and speed of each motor"),
        (vec![BOUND], "a law without limits: 1 bounds for 2 axes; give displacement and speed of each motor"),
        (
            vec![BOUND, LawBound { displacement: f64::INFINITY, ..BOUND }],
            "the bound of axis 1 is inf rad, it must be between 0 and 1000 rad",
        ),
        (
            vec![LawBound { speed: 101.0, ..BOUND }, BOUND],
            "the bound of axis 0 is 101 rad/s, it must be between 0 and 100 rad/s",
        ),
        (
            vec![LawBound { displacement: f64::NAN, ..BOUND }, BOUND],
            "the bound of axis 0 is NaN rad, it must be between 0 and 1000 rad",
        ),
    ];
    for (bounds, expected) in cases {
        let error = servo.install_law(0, law(), &bounds).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
    assert_eq!(servo.install_law(1, law(), &[BOUND; 2]), Err(LawError::NoSuchEffector { effector: 1 }));
    assert_eq!(servo.install_law(0, law(), &[BOUND; 2]), Ok(()));
    assert_eq!(servo.install_law(0, law(), &[BOUND; 2]), Err(LawError::Installed { effector: 0 }));
    servo.step(Instant::ZERO);
    assert_eq!(servo.install_law(0, law(), &[BOUND; 2]), Err(LawError::Running));
}

#[test]
fn a_pause_stops_the_path_and_not_the_law() {
    let (law, seen) = Scripted::new(drift);
    let mut rig = rig(1, law);
    for macrostep in constant_speed(60) {
        rig.order(Order::Move(with_law(macrostep, 0.0)));
    }
    rig.run(45);
    rig.servo.speed_override().pause();
    rig.run(2000);
    let seen = seen.lock().unwrap().clone();
    let (last, before) = (seen[seen.len() - 1], seen[seen.len() - 101]);
    assert_eq!((seen.len(), rig.phase(), rig.cause()), (2045, Phase::Moving, None));
    assert_eq!((last.rate, last.planned), (0.0, before.planned));
    assert!((last.displacement - before.displacement - 0.08).abs() < 1e-9, "0.8 rad/s for 100 cycles");
    keeps_limits(&rig.positions(0)).unwrap();
}

/// A law that moves at 0.8 rad/s times the rate of motion time.
struct Paced(f64);

impl CycleLaw for Paced {
    fn check(&self, _: &LawParameters) -> Result<(), LawFault> {
        Ok(())
    }
    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {
        self.0 = 0.0;
    }
    fn shift(&mut self, input: &LawInput<'_>, _: &LawParameters) -> LawOutput {
        self.0 = (self.0 + 10.0 * DT).min(0.8 * input.rate);
        all(input.axes[0].displacement + self.0 * DT)
    }
}

#[test]
fn a_law_that_reads_the_rate_is_slowed_like_the_path_and_stands_in_a_pause() {
    let displaced = |override_of: fn(&Servo)| {
        let mut rig = rig(1, Box::new(Paced(0.0)));
        for macrostep in constant_speed(60) {
            rig.order(Order::Move(with_law(macrostep, 0.0)));
        }
        override_of(&rig.servo);
        rig.run(2000);
        let before = rig.link.latest.read();
        rig.run(100);
        let after = rig.link.latest.read();
        assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None), "rate {}", after.rate);
        keeps_limits(&rig.positions(0)).unwrap();
        (after.rate, after.displacement[0] - before.displacement[0])
    };
    let slow = |servo: &Servo| servo.speed_override().set(0.02).unwrap();
    let (rate, way) = displaced(slow);
    assert!(rate == 0.02 && (way - 0.02 * 0.08).abs() < 1e-9, "0.016 rad/s for 100 cycles: {way}");
    assert_eq!(displaced(|servo| servo.speed_override().pause()), (0.0, 0.0));
}

#[test]
fn a_stop_under_a_law_brakes_from_the_last_set_points_and_ends_the_law() {
    let (law, seen) = Scripted::new(drift);
    let mut rig = rig(1, law);
    for macrostep in constant_speed(6) {
        rig.order(Order::Move(with_law(macrostep, 0.0)));
    }
    rig.run(57);
    rig.order(Order::Stop);
    rig.run_until(Phase::Standing);
    let positions = rig.positions(0);
    keeps_limits(&positions).unwrap();
    assert_eq!(seen.lock().unwrap().len(), 57);
    // 20.8 rad/s with the speed of the displacement.
    let stop = positions.last().unwrap() - positions[56];
    assert!((stop - 0.5 * 20.8 * 0.020).abs() < 1e-6, "{stop}");
    let snapshot = rig.link.latest.read();
    assert_eq!((snapshot.commanded[0], snapshot.displacement[0]), (*positions.last().unwrap(), 0.0));
}

#[test]
fn a_batch_that_the_bus_refuses_keeps_the_displacement() {
    let run = |refuses| {
        let (law, seen) = Scripted::new(drift);
        let mut rig = rig(1, law);
        for macrostep in constant_speed(6) {
            rig.order(Order::Move(with_law(macrostep, 0.0)));
        }
        rig.run(45);
        rig.world().refuses = refuses;
        rig.run(10);
        assert_eq!((rig.phase(), rig.cause()), (Phase::Moving, None));
        let mut positions = rig.positions(0);
        positions.dedup();
        let calls = seen.lock().unwrap().len();
        (positions, calls)
    };
    let (whole, calls) = run(0);
    let (held, held_calls) = run(2);
    assert_eq!((calls, held_calls), (55, 53), "the law does not run in a repeated cycle");
    assert_eq!(held, whole[..held.len()], "path and displacement go on together");
}

/// One output of a law without any sense.
fn wild(kind: u8, x: f64, call: u32) -> LawOutput {
    let t = f64::from(call) * DT;
    match kind {
        0 => all(f64::NAN),
        1 => all(x * 1e6),
        2 => all(x),
        3 => all(x * 0.02 * f64::from(call)),
        4 => all(4.0 * x * (20.0 * t).sin()),
        5 => all(0.4 * x * (50.0 * t).sin() * (50.0 * t).sin()),
        6 => all(x * 400.0 * t * t),
        7 => LawOutput::Touched,
        _ => LawOutput::Fault(LawFault::NotFinite),
    }
}

/// A law that follows a random script: from each number of calls on, the next kind of output.
struct Wild {
    script: Vec<(u8, f64, u32)>,
    calls: u32,
}

impl CycleLaw for Wild {
    fn check(&self, _: &LawParameters) -> Result<(), LawFault> {
        Ok(())
    }
    fn begin(&mut self, _: &LawInput<'_>, _: &LawParameters) {}
    fn shift(&mut self, _: &LawInput<'_>, _: &LawParameters) -> LawOutput {
        self.calls += 1;
        let mut left = self.calls;
        for &(kind, x, calls) in &self.script {
            if left <= calls {
                return wild(kind, x, self.calls);
            }
            left -= calls;
        }
        all(0.0)
    }
}

proptest! {
    #[test]
    fn no_law_sends_a_set_point_beyond_a_limit(
        script in prop::collection::vec((0..9u8, -1.0..1.0f64, 1..120u32), 1..5),
        most in 0.05..3.0f64, refuses in 0..40usize,
    ) {
        let mut config = scripted::config(2);
        for axis in &mut config.effectors[0].axes {
            (axis.min_position, axis.max_position) = (-most, most);
        }
        let mut rig = Rig::with(&config);
        let bound = LawBound { displacement: (2.0 * most).min(5.0), speed: MAX_VELOCITY };
        rig.servo.install_law(0, Box::new(Wild { script, calls: 0 }), &[bound; 2]).unwrap();
        let mut rig = rig.stand();
        for number in 1..=40 {
            rig.order(Order::Move(with_law(macrostep(number, 10, 0.002 * (number % 5) as f64, 0.0), 0.0)));
        }
        rig.run(refuses);
        rig.world().refuses = 3;
        rig.run(500);
        for axis in 0..2 {
            let positions = rig.positions(axis);
            keeps_limits(&positions)?;
            for (at, position) in positions.iter().enumerate() {
                prop_assert!(position.is_finite() && position.abs() <= most + 1e-7, "{position} at {at}");
            }
        }
    }
}
