//! Tests of the identification on loops whose response is known by calculation.

use std::f64::consts::TAU;

use super::*;

const DT: f64 = 0.002;
const LENGTH: usize = 1000;

/// A loop of `gain / s` over a delay of `delay` samples, excited at the input of its plant. Returns the output of the
/// law and the input of the plant.
fn integrator(gain: f64, delay: usize, excitation: &[f64], periods: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut position, mut past) = (0.0, vec![0.0; delay + 1]);
    let (mut input, mut output) = (Vec::new(), Vec::new());
    for at in 0..LENGTH * (periods + 1) {
        let law = -gain * past[delay];
        let sent = law + excitation[at % LENGTH];
        position += sent * DT;
        past.rotate_right(1);
        past[0] = position;
        if at >= LENGTH {
            input.push(sent);
            output.push(-law);
        }
    }
    (input, output)
}

#[test]
fn an_integrator_with_a_delay_is_measured_as_it_is_calculated() {
    let lines = lines(LENGTH, DT, [2.0, 120.0], 40);
    for excite in [multisine, chirp] {
        let excitation = excite(LENGTH, &lines, 1.0);
        for (gain, delay) in [(60.0, 0), (60.0, 2), (30.0, 5)] {
            let (input, output) = integrator(gain, delay, &excitation, 3);
            let points = respond(&input, &output, LENGTH, &lines, DT, Response::Open);
            let found = margin(&points).unwrap();
            // gain DT z / (z - 1) over one more than `delay`: |z - 1| = 2 sin(w DT / 2).
            let w = 2.0 / DT * (gain * DT / 2.0).asin();
            let phase = TAU / 4.0 - w * DT * (0.5 + delay as f64);
            assert!((found.crossover * TAU / w - 1.0).abs() < 0.02, "{found:?}, {w}");
            assert!((found.phase - phase).abs() < 0.03, "{found:?}, {phase}");
            assert!(points.iter().all(|it| it.coherence > 0.99), "{points:?}");
        }
    }
}

/// A drive that controls the velocity of a unit inertia to zero with `gain`, 1/s, and a loop period of `tenths` tenths
/// of a millisecond. Returns the added torque, and the torque that the drive reports at the end of each cycle.
fn drive(gain: f64, tenths: usize, excitation: &[f64], periods: usize) -> (Vec<f64>, Vec<f64>) {
    const TENTH: f64 = 1e-4;
    let (mut velocity, mut torque) = (0.0, 0.0);
    let (mut input, mut output) = (Vec::new(), Vec::new());
    for at in 0..LENGTH * (periods + 1) {
        let added = excitation[at % LENGTH];
        for tenth in 0..(DT / TENTH).round() as usize {
            if tenth % tenths == 0 {
                torque = added - gain * velocity;
            }
            velocity += torque * TENTH;
        }
        if at >= LENGTH {
            input.push(added);
            output.push(torque);
        }
    }
    (input, output)
}

#[test]
fn the_loop_of_a_drive_is_that_of_its_own_period_not_of_the_bus() {
    let lines = lines(LENGTH, DT, [2.0, 120.0], 40);
    let excitation = multisine(LENGTH, &lines, 1.0);
    for (crossover, tenths) in [(45.0, 1), (45.0, 4), (45.0, 10), (20.0, 10)] {
        let period = 1e-4 * tenths as f64;
        let (added, shown) = drive(TAU * crossover, tenths, &excitation, 3);
        let taken: Vec<_> = added.iter().zip(&shown).map(|(all, left)| all - left).collect();
        let [taken, left] = [taken, shown].map(|output| respond(&added, &output, LENGTH, &lines, DT, Response::Closed));
        let points = response::opened(&taken, &left, DT, period);
        let found = margin(&points).unwrap();
        let phase = TAU / 4.0 - TAU * crossover * period / 2.0;
        assert!((found.crossover / crossover - 1.0).abs() < 0.02, "{found:?}");
        // The images of a held torque that the loop passes fold back: 0.04 rad at 45 Hz.
        assert!((found.phase - phase).abs() < 0.05, "{found:?}, {phase}");
        assert!(points.iter().all(|it| it.coherence > 0.99), "{points:?}");
    }
}

#[test]
fn a_drift_stays_out_of_the_lines() {
    let lines = lines(LENGTH, DT, [2.0, 120.0], 40);
    let excitation = multisine(LENGTH, &lines, 1.0);
    let (mut input, mut output) = integrator(60.0, 2, &excitation, 3);
    let plain = respond(&input, &output, LENGTH, &lines, DT, Response::Open);
    for (at, (x, y)) in input.iter_mut().zip(&mut output).enumerate() {
        *x += 1e-4 * at as f64;
        *y -= 1e-4 * at as f64;
    }
    let drifting = respond(&input, &output, LENGTH, &lines, DT, Response::Open);
    let (plain, drifting) = (margin(&plain).unwrap(), margin(&drifting).unwrap());
    assert!((plain.crossover / drifting.crossover - 1.0).abs() < 0.01);
    assert!((plain.phase - drifting.phase).abs() < 0.02);
}

#[test]
fn lines_differ_and_are_within_their_range() {
    for (range, count) in [([1.0, 100.0], 200), ([2.0, 120.0], 40), ([2.0, 400.0], 10)] {
        let lines = lines(LENGTH, DT, range, count);
        assert!(lines.len() > 5, "{lines:?}");
        assert!(lines.windows(2).all(|pair| pair[1] > pair[0]), "{lines:?}");
        assert!(lines[0] >= 2 && *lines.last().unwrap() < LENGTH / 2, "{lines:?}");
        assert!(*lines.last().unwrap() as f64 / (LENGTH as f64 * DT) <= range[1] + 0.3);
    }
}

#[test]
fn sequences_have_the_amplitude_they_are_asked_for() {
    let lines = lines(LENGTH, DT, [2.0, 120.0], 40);
    for excite in [multisine, chirp] {
        let values = excite(LENGTH, &lines, 0.3);
        let most = values.iter().fold(0.0, |most: f64, it| most.max(it.abs()));
        assert!((most - 0.3).abs() < 1e-12 && values.len() == LENGTH);
    }
}

#[test]
fn noise_in_one_period_and_not_in_the_next_costs_coherence() {
    let lines = lines(LENGTH, DT, [2.0, 120.0], 40);
    let excitation = multisine(LENGTH, &lines, 1.0);
    let (input, mut output) = integrator(60.0, 2, &excitation, 4);
    for (at, value) in output.iter_mut().enumerate() {
        // A line of the spectrum with a different phase in every period.
        let angle = TAU * lines[30] as f64 * at as f64 / LENGTH as f64;
        *value += (angle + (at / LENGTH) as f64 * 1.7).cos();
    }
    let points = respond(&input, &output, LENGTH, &lines, DT, Response::Open);
    assert!(points[30].coherence < 0.5, "{:?}", points[30]);
    assert!(points[20].coherence > 0.95, "{:?}", points[20]);
}

#[test]
fn a_run_is_a_trapezoid_that_ends_where_it_says() {
    for velocity in [0.0, 15.0, -7.0] {
        let run = Run {
            axis: 1,
            start: [0.5; crate::MAX_AXES],
            velocity,
            acceleration: 100.0,
            excitation: vec![1.0; LENGTH],
            periods: 3,
            steps: 10,
            dt: DT,
            drive_period: 0.0,
        };
        let all: Vec<_> = (1..).map_while(|number| run.macrostep(number)).collect();
        assert_eq!(all.len() as u64, run.macrosteps());
        let last = all.last().unwrap();
        assert_eq!(last.velocity[1], 0.0);
        assert!((last.position[1] - 0.5 - run.travel()).abs() < 1e-9);
        assert_eq!(last.position[0], 0.5);
        for number in run.excitation().macrosteps {
            assert_eq!(all[number as usize - 1].velocity[1], velocity);
        }
    }
}
