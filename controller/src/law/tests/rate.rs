//! Directions of a law under a speed override and in a pause.

use super::*;

/// Rates of motion time: a pause, 25 %, and no override.
const RATES: [f64; 3] = [0.0, 0.25, 1.0];

/// Downward velocity of the approach of each direction, m/s.
const APPROACH: f64 = 0.05;

/// The directions that approach downward at `APPROACH`, and then press with 10 N if they yield.
fn approaches() -> [Direction; 3] {
    let compliance = Compliance::LINEAR;
    [
        Direction::Unguarded { velocity: -APPROACH },
        Direction::Guarded { velocity: -APPROACH, compliance },
        Direction::Contact { force: -10.0, compliance },
    ]
}

/// The directions that only yield.
fn yields() -> [Direction; 3] {
    let compliance = Compliance::LINEAR;
    [
        Direction::Guarded { velocity: 0.0, compliance },
        Direction::Contact { force: 0.0, compliance },
        Direction::Admittance { stiffness: 500.0, compliance },
    ]
}

fn along_z(direction: Direction) -> ForceTask {
    let mut task = ForceTask { axes: TaskAxes::Base, ..ForceTask::default() };
    task.directions[2] = direction;
    task
}

fn height(rig: &Rig) -> f64 {
    rig.tool().translation.z
}

fn free(_: &Pose) -> Vector3<f64> {
    Vector3::zeros()
}

/// Runs for `seconds`.
fn run(rig: &mut Rig, task: &ForceTask, environment: &dyn Fn(&Pose) -> Vector3<f64>, seconds: f64) {
    (0..(seconds / T).round() as u32).for_each(|_| assert_eq!(rig.cycle(task, environment), None));
}

#[test]
fn the_approach_of_every_direction_is_slowed_by_the_rate_and_stands_in_a_pause() {
    for direction in approaches() {
        for rate in RATES {
            let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
            rig.rate = rate;
            let start = height(&rig);
            let (mut last, mut fastest) = (start, 0.0_f64);
            for _ in 0..500 {
                run(&mut rig, &along_z(direction), &free, T);
                fastest = fastest.max((last - height(&rig)) / T);
                last = height(&rig);
            }
            println!("{direction:?} at {rate}: {fastest:.5} m/s, {:.5} m", start - last);
            assert!(fastest <= rate * APPROACH * 1.001 + 1e-9, "{direction:?} at {rate}: {fastest} m/s");
            assert!(fastest >= rate * APPROACH * 0.99, "{direction:?} at {rate}: {fastest} m/s");
        }
    }
}

#[test]
fn an_approach_covers_the_same_way_in_the_same_motion_time_at_every_rate() {
    for direction in approaches() {
        let way = |rate: f64| {
            let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
            rig.rate = rate;
            let start = height(&rig);
            run(&mut rig, &along_z(direction), &free, 0.5 / rate);
            start - height(&rig)
        };
        // The inertia takes its time constant of 0.1 s at every rate.
        let lag = if matches!(direction, Direction::Unguarded { .. }) { 0.0 } else { 0.1 * APPROACH };
        for rate in [0.25, 0.5] {
            assert!((way(rate) - way(1.0)).abs() <= lag + 1e-5, "{direction:?}: {} {}", way(rate), way(1.0));
        }
    }
}

#[test]
fn a_pause_in_an_approach_brakes_within_the_acceleration_limits_and_resumes() {
    let limits = ForceLimits { acceleration: [40.0; MAX_AXES], ..WIDE };
    for direction in approaches() {
        let mut rig = Rig::new(irp6(), &START, 0.0, 0, limits);
        let mut last = [rig.commanded; 2];
        let mut heights = Vec::new();
        for cycle in 0..1500 {
            // The rate steps, faster than any servo changes it.
            rig.rate = if (500..1000).contains(&cycle) { 0.0 } else { 1.0 };
            assert_eq!(rig.cycle(&along_z(direction), &free), None);
            for (axis, c) in rig.commanded.into_iter().enumerate() {
                let [a, b] = last.map(|positions| positions[axis]);
                assert!(((c - 2.0 * b + a) / (T * T)).abs() <= 40.0 + 1e-6, "{direction:?}, axis {axis}, {cycle}");
            }
            last = [last[1], rig.commanded];
            heights.push(height(&rig));
        }
        let speed = |cycle: usize| (heights[cycle - 1] - heights[cycle]) / T;
        assert!((speed(499) - APPROACH).abs() < 1e-4, "{direction:?}: {}", speed(499));
        assert!(speed(999).abs() < 1e-4 && heights[700] - heights[999] < 1e-3, "{direction:?}: {}", speed(999));
        assert!((speed(1499) - APPROACH).abs() < 2e-4, "{direction:?}: {}", speed(1499));
    }
}

#[test]
fn the_force_in_contact_is_the_same_at_every_rate_and_in_a_pause() {
    for direction in &approaches()[1..] {
        let task = along_z(*direction);
        for rate in RATES {
            let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
            // A pause needs a contact to begin with.
            let surface = height(&rig) + if rate == 0.0 { 0.0004 } else { -0.002 };
            rig.rate = rate;
            run(&mut rig, &task, &spring(surface, 1e4, true), 4.0);
            let force = rig.forces[rig.forces.len() - 1].z;
            assert!((force - 10.0).abs() < 0.01, "{direction:?} at {rate}: {force} N");
            // The surface gives way by 2 mm at 5 mm/s, and comes back.
            for (way, from) in [(-0.002, 0.0), (0.002, -0.002)] {
                for cycle in 1..=200 {
                    let surface = surface + from + way * f64::from(cycle) / 200.0;
                    run(&mut rig, &task, &spring(surface, 1e4, true), T);
                    let force = rig.forces[rig.forces.len() - 1].z;
                    assert!((force - 10.0).abs() < 5.0, "{direction:?} at {rate}: {force} N");
                }
                run(&mut rig, &task, &spring(surface + from + way, 1e4, true), 3.0);
                let force = rig.forces[rig.forces.len() - 1].z;
                assert!((force - 10.0).abs() < 0.01, "{direction:?} at {rate}: {force} N");
            }
        }
    }
}

#[test]
fn a_pause_in_contact_changes_no_sample_of_the_force() {
    let forces = |rate: f64| {
        let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
        let environment = spring(height(&rig), 1e4, true);
        run(&mut rig, &press(10.0), &environment, 0.5);
        rig.rate = rate;
        run(&mut rig, &press(10.0), &environment, 1.0);
        rig.forces.iter().map(|force| force.z).collect::<Vec<_>>()
    };
    assert_eq!(forces(0.0), forces(1.0));
}

#[test]
fn no_rate_slows_yielding() {
    let push = |_: &Pose| Vector3::new(0.0, 0.0, 30.0);
    let pull = |_: &Pose| Vector3::new(0.0, 0.0, -30.0);
    let moved = |direction: Direction, environment: &dyn Fn(&Pose) -> Vector3<f64>, rate: f64| {
        let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
        rig.rate = rate;
        let start = height(&rig);
        run(&mut rig, &along_z(direction), environment, 0.5);
        height(&rig) - start
    };
    for rate in [0.0, 0.25] {
        for direction in yields() {
            for environment in [&push as &dyn Fn(&Pose) -> Vector3<f64>, &pull] {
                let [slowed, full] = [rate, 1.0].map(|rate| moved(direction, environment, rate));
                assert_eq!(slowed, full, "{direction:?} at {rate}");
                assert!(full.abs() > 0.02, "{direction:?}: {full} m");
            }
        }
        for direction in &approaches()[1..] {
            let [slowed, full] = [rate, 1.0].map(|rate| moved(*direction, &push, rate));
            // The first sample has no force.
            assert!((slowed - full).abs() < 3e-4 && full > 0.02, "{direction:?} at {rate}: {slowed} m, {full} m");
            // A pull along the approach adds its velocity, and the approach is slowed.
            let [slowed, yielding] = [moved(*direction, &pull, rate), moved(yields()[0], &pull, 1.0)];
            assert!((slowed - (1.0 + rate / 3.0) * yielding).abs() < 1e-3, "{direction:?} at {rate}: {slowed} m");
        }
    }
}

#[test]
fn a_touch_at_a_quarter_of_the_speed_has_a_lower_peak_and_the_same_force() {
    for stiffness in [1e3, 1e4] {
        let [(slow, settled), (fast, _)] = [0.25, 1.0].map(|rate| {
            let mut rig = Rig::new(irp6(), &START, 0.004, 1, WIDE);
            rig.rate = rate;
            let environment = spring(height(&rig) - 0.02, stiffness, true);
            run(&mut rig, &press(10.0), &environment, 5.0);
            let peak = rig.forces.iter().map(|force| force.z).fold(0.0, f64::max);
            (peak, rig.forces[rig.forces.len() - 1].z)
        });
        println!("{stiffness} N/m: peak {slow:.2} N at 25 %, {fast:.2} N at 100 %");
        assert!(slow <= fast && (settled - 10.0).abs() < 0.01, "{stiffness}: {slow} {fast} {settled}");
    }
}

#[test]
fn a_residual_of_the_sensor_does_not_move_an_arm_in_a_pause() {
    // Up to a quarter of the force in which the approach ends.
    for residual in [-2.4, -0.1, 0.0, 0.3, 2.4] {
        let mut rig = Rig::new(irp6(), &START, 0.0, 0, WIDE);
        rig.rate = 0.0;
        let start = height(&rig);
        run(&mut rig, &press(10.0), &|_| Vector3::new(0.0, 0.0, residual), 2.0);
        assert!((height(&rig) - start).abs() < 1e-6, "{residual} N: {} m", height(&rig) - start);
    }
}
