//! Robots that touch surfaces and hold bodies. The test advances the motors, without drives.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::OutputProbe;
use crate::plant::{AxisConfig, Demand, FrictionConfig, Irp6Axis, Mechanism, MechanismConfig, PlantAxis, PlantConfig};
use crate::scene::{
    BodyConfig, GripConfig, GripperConfig, Holder, Material, RobotId, Scene, SceneError, SensorConfig, SensorProbe,
    Shape, TipConfig, WallConfig,
};

const METAL: Material = Material { stiffness: 1e5, damping: 300.0, friction: 0.0 };
const G: f64 = 9.81;

/// A robot without friction, and a demand for each motor.
pub(super) struct Robot {
    pub(super) mechanism: Mechanism,
    base: Isometry3<f64>,
    axes: Vec<PlantAxis>,
    demands: Vec<Demand>,
}

impl Robot {
    /// An IRb-6 at these motor angles from home, rad. Each motor holds its position.
    pub(super) fn irb6(motors: [f64; 5]) -> Self {
        let axes = Irp6Axis::ALL.iter().zip(motors);
        let axes = axes.map(|(axis, start_angle)| AxisConfig { start_angle, ..AxisConfig::irp6(*axis).with_home(0.0) });
        Self::new(MechanismConfig::Irb6, Isometry3::identity(), axes)
    }

    /// An RNT that hangs with its wrist straight. Each motor holds its position.
    fn rnt() -> Self {
        let config = MechanismConfig::Rnt { home_lengths: [AxisConfig::RNT_HOME_LENGTH; 3] };
        let hanging = UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
        let base = Isometry3::from_parts(Translation3::new(0.0, 0.0, 2.0), hanging);
        Self::new(config, base, (0..).map_while(AxisConfig::rnt))
    }

    fn new(config: MechanismConfig, base: Isometry3<f64>, axes: impl Iterator<Item = AxisConfig>) -> Self {
        let mechanism = Mechanism::new(config);
        let axes = axes.enumerate().map(|(number, mut config)| {
            let PlantConfig::Physical(plant) = &mut config.plant else { unreachable!("the presets are physical") };
            plant.friction = FrictionConfig::NONE;
            plant.viscous = 0.0;
            plant.torque_ripple = 0.0;
            plant.end_stops = None;
            config.edge_jitter = 0.0;
            config.brake = 0.0;
            let mount = mechanism.mount(number, 0.0);
            PlantAxis::mounted(&config, 1, mount.as_ref())
        });
        let axes: Vec<_> = axes.collect();
        let demands = vec![Demand::Position { counts: 0.5, velocity: 0.0 }; axes.len()];
        Self { mechanism, base, axes, demands }
    }

    fn advance(&mut self) {
        for (axis, demand) in self.axes.iter_mut().zip(&self.demands) {
            axis.advance(1, *demand);
        }
    }
}

/// Means over some steps of the torques of a robot's motors, of the wrench on a sensor, and of the height of the
/// flange. The angle of a motor without friction oscillates by one count.
fn means(scene: &mut Scene, robot: &mut Robot, id: RobotId, probe: &SensorProbe) -> (Vec<f64>, [f64; 6], f64) {
    const STEPS: u32 = 10_000;
    let mut sums = (vec![0.0; 5], [0.0; 6], 0.0);
    for _ in 0..STEPS {
        run(scene, &mut [robot], 1);
        for (sum, axis) in sums.0.iter_mut().zip(&robot.axes) {
            *sum += axis.feedback().torque / f64::from(STEPS);
        }
        for (sum, value) in sums.1.iter_mut().zip(probe.last()) {
            *sum += value / f64::from(STEPS);
        }
        sums.2 += scene.flange(id).translation.z / f64::from(STEPS);
    }
    sums
}

/// Motor angles with the gripper straight down, on an upright lower and a level upper arm.
const DOWN: [f64; 5] = [0.0, 0.0, 0.0, -128.0 * FRAC_PI_2, -128.0 * FRAC_PI_2];

fn run(scene: &mut Scene, robots: &mut [&mut Robot], steps: u32) {
    for _ in 0..steps {
        for robot in robots.iter_mut() {
            robot.advance();
        }
        scene.step();
    }
    assert_eq!(scene.unsolved(), 0);
}

/// A scene in which a robot points a tip of radius 5 mm down at a floor, `above` m over it.
fn over_floor(robot: &Robot, above: f64) -> (Scene, RobotId) {
    let mut scene = Scene::new();
    let id = scene.add_robot(&robot.mechanism, &robot.base).unwrap();
    scene.add_tip(id, &TipConfig { centre: [0.0, 0.0, 0.2], radius: 5e-3 }).unwrap();
    let tip = scene.flange(id) * nalgebra::Point3::new(0.0, 0.0, 0.2);
    let pose = Isometry3::translation(0.0, 0.0, tip.z - 5e-3 - above);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material: METAL }).unwrap();
    (scene, id)
}

#[test]
fn flange_of_a_robot_in_the_scene_is_on_its_base() {
    let robot = Robot::irb6(DOWN);
    let mut scene = Scene::new();
    let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, FRAC_PI_2);
    let base = Isometry3::from_parts(Translation3::new(1.0, 2.0, 0.7), turn);
    let id = scene.add_robot(&robot.mechanism, &base).unwrap();
    let flange = scene.flange(id);
    // Upper arm 0.67 m ahead, which is along y of the world; flange 0.095 m below the pitch axis.
    let expected = Vector3::new(1.0, 2.67, 0.7 + 0.455 - 0.095);
    assert!((flange.translation.vector - expected).norm() < 1e-12, "{flange}");
    assert!((flange.rotation * Vector3::z() + Vector3::z()).norm() < 1e-12, "{flange}");
}

#[test]
fn tip_held_in_a_floor_is_pushed_by_its_spring_and_motors_feel_the_force() {
    let mut robot = Robot::irb6(DOWN);
    let (mut scene, id) = over_floor(&robot, 0.01);
    let mut probe = scene.add_sensor(id, &sensor(0.0)).unwrap();
    run(&mut scene, &mut [&mut robot], 5_000);
    assert_eq!(probe.last(), [0.0; 6], "nothing is touched");
    let (free, ..) = means(&mut scene, &mut robot, id, &probe);
    drop(scene);

    // The same pose, with the floor 1 mm above the lowest point of the tip.
    let mut robot = Robot::irb6(DOWN);
    let (mut scene, id) = over_floor(&robot, -1e-3);
    probe = scene.add_sensor(id, &sensor(0.0)).unwrap();
    let start = scene.flange(id).translation.z;
    run(&mut scene, &mut [&mut robot], 20_000);
    let (loaded, [x, y, z, tx, ty, tz], height) = means(&mut scene, &mut robot, id, &probe);
    let force = 1e5 * (1e-3 - (height - start));
    assert!((90.0..101.0).contains(&force), "{force} N");
    // The sensor's z axis points down, and the floor pushes up.
    assert!((z + force).abs() < 0.1 && x.abs() < 0.1 && y.abs() < 1e-6, "{x} {y} {z} N of {force}");
    assert!(tx.abs() < 1e-6 && ty.abs() < 0.1 && tz.abs() < 1e-6, "{tx} {ty} {tz}");
    // By hand: the upper arm's screw gears 175.1:1 and lowers the tip 0.67 m ahead when the motor turns forwards.
    let (more, expected) = (loaded[2] - free[2], force * 0.67 / 175.126);
    assert!((more - expected).abs() < 5e-3 * expected.abs(), "{more} N·m for {expected}");
}

fn sensor(mass: f64) -> SensorConfig {
    SensorConfig { pose: Isometry3::identity(), mass, centre: [0.0, 0.0, 0.1], inertia: [0.0; 3] }
}

/// Runs for `steps` steps from `above` m over a floor, and compares with a run with a free body out of the robot's
/// reach, and with a run without queries. A free body makes the scene compute the flange in each step.
fn compare_with_the_flange_of_each_step(steps: usize, above: f64, robot: impl Fn() -> Robot) {
    let follow = |with_body: bool, is_watched: bool| {
        let mut robot = robot();
        let (mut scene, id) = over_floor(&robot, above);
        let probe = scene.add_sensor(id, &sensor(0.7)).unwrap();
        let cube = BodyConfig {
            mass: 1.0,
            half: [0.05; 3],
            material: METAL,
            pose: Isometry3::translation(50.0, 0.0, 20.0),
            velocity: [0.0; 3],
            spin: [0.0; 3],
        };
        if with_body {
            scene.add_body(&cube).unwrap();
        }
        let (mut moved, mut seen, mut far, mut touched) = (Vec::new(), Vec::new(), 0, 0);
        for step in 0..steps {
            run(&mut scene, &mut [&mut robot], 1);
            far += usize::from(scene.arms[id.0].is_far());
            touched += usize::from(scene.arms[id.0].wrench.force.norm() > 0.0);
            moved.push(robot.axes.iter().map(|axis| axis.angle().to_bits()).collect::<Vec<_>>());
            if is_watched {
                let flange = scene.flange(id).to_homogeneous().map(f64::to_bits);
                // A sensor may be read seldom.
                seen.push((flange, (step % 20 < 2).then(|| probe.last().map(f64::to_bits))));
            }
        }
        (moved, seen, far, touched)
    };
    let (moved, seen, far, touched) = follow(false, true);
    assert!(far > steps / 10 && touched > steps / 100, "{far} steps far, {touched} steps in contact");
    let (computed, as_computed, never, _) = follow(true, true);
    assert_eq!(never, 0);
    let (unwatched, ..) = follow(false, false);
    for step in 0..steps {
        assert!(moved[step] == computed[step] && seen[step] == as_computed[step], "step {step}");
        assert!(moved[step] == unwatched[step], "step {step} without an observer");
    }
}

#[test]
fn robot_far_from_all_surfaces_moves_and_measures_as_if_the_flange_were_computed_in_each_step() {
    compare_with_the_flange_of_each_step(6_000, 0.1, || {
        let mut robot = Robot::irb6(DOWN);
        // The column turns, and the upper arm falls on the floor.
        robot.demands[0] = Demand::Torque(0.02);
        robot.demands[2] = Demand::Torque(0.0);
        robot
    });
}

#[test]
fn platform_far_from_all_surfaces_moves_and_measures_as_if_the_flange_were_computed_in_each_step() {
    compare_with_the_flange_of_each_step(6_000, 0.03, || {
        let mut robot = Robot::rnt();
        // The legs pull the platform down on the floor, and incline the platform. The wrist turns.
        for (leg, torque) in [0.05, 0.1, 0.2].into_iter().enumerate() {
            robot.demands[leg] = Demand::Torque(torque);
        }
        robot.demands[4] = Demand::Torque(5e-4);
        robot
    });
}

#[test]
fn surface_that_is_added_near_a_robot_is_felt_in_the_next_step() {
    let mut robot = Robot::irb6(DOWN);
    let (mut scene, id) = over_floor(&robot, 0.5);
    run(&mut scene, &mut [&mut robot], 10);
    assert!(scene.arms[id.0].is_far());
    let tip = scene.flange(id) * nalgebra::Point3::new(0.0, 0.0, 0.2);
    let pose = Isometry3::translation(0.0, 0.0, tip.z - 5e-3 + 1e-4);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material: METAL }).unwrap();
    run(&mut scene, &mut [&mut robot], 1);
    assert!(scene.arms[id.0].wrench.force.z > 5.0, "{}", scene.arms[id.0].wrench.force);
}

#[test]
fn torque_limited_arm_presses_with_the_force_of_its_torque() {
    let mut robot = Robot::irb6(DOWN);
    let (mut scene, id) = over_floor(&robot, 1e-4);
    let probe = scene.add_sensor(id, &sensor(0.0)).unwrap();
    run(&mut scene, &mut [&mut robot], 1_000);
    // The upper arm's motor balances its weight and presses with 0.1 N·m. The other motors hold.
    let weight = robot.mechanism.load(2).torque;
    robot.demands[2] = Demand::Torque(-weight + 0.1);
    run(&mut scene, &mut [&mut robot], 50_000);
    let force = -probe.last()[2];
    let expected = 0.1 * 175.126 / 0.67;
    assert!((force - expected).abs() < 0.01 * expected, "{force} N for {expected}");
}

/// Energy bound of the impact: the spring stores at most the kinetic energy of the effective mass.
#[test]
fn coasting_arm_hits_a_wall_with_the_force_of_its_effective_mass() {
    for stiffness in [1e4, 1e5, 1e6] {
        let mut robot = Robot::irb6(DOWN);
        let mut scene = Scene::new();
        let id = scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
        let centre = [0.0, 0.0, 0.2];
        scene.add_tip(id, &TipConfig { centre, radius: 5e-3 }).unwrap();
        let probe = scene.add_sensor(id, &sensor(0.0)).unwrap();
        // The wall stands across the way of the tip, 5 mm ahead.
        let turn = UnitQuaternion::from_euler_angles(FRAC_PI_2, 0.0, 0.0);
        let pose = Isometry3::from_parts(Translation3::new(0.0, 0.01, 0.0), turn);
        let material = Material { stiffness, damping: 0.0, friction: 0.0 };
        scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose, material }).unwrap();
        let mass = robot.mechanism.effective_mass(centre, [0.0, 1.0, 0.0]);
        assert!((20.0..40.0).contains(&mass), "{mass} kg");

        robot.demands = (0..5).map(|axis| Demand::Torque(-robot.mechanism.load(axis).torque)).collect();
        let (mut speed, mut peak, mut back) = (0.0, 0.0_f64, 0.0);
        let mut before = 0.0;
        for _ in 0..20_000 {
            let fast = speed >= 0.1 || peak > 0.0;
            robot.demands[0] = Demand::Torque(if fast { 0.0 } else { -0.5 });
            run(&mut scene, &mut [&mut robot], 1);
            let [x, y, z, ..] = probe.last();
            let force = (x * x + y * y + z * z).sqrt();
            let tip = scene.flange(id).translation.y;
            let velocity = (tip - before) / 1e-4;
            before = tip;
            match (force > 0.0, peak > 0.0) {
                (false, false) => speed = velocity,
                (true, _) => peak = peak.max(force),
                (false, true) => {
                    back = velocity;
                    break;
                }
            }
        }
        let bound = speed * (stiffness * mass).sqrt();
        assert!((0.98..1.005).contains(&(peak / bound)), "{stiffness} N/m: {peak} N of {bound} at {speed} m/s");
        assert!((back + speed).abs() < 0.01 * speed, "{stiffness} N/m: {speed} m/s, back at {back}");
    }
}

#[test]
fn sensor_measures_weight_and_inertia_of_the_tool() {
    let mut robot = Robot::irb6(DOWN);
    let mut scene = Scene::new();
    let id = scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
    let level = UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
    let upright = SensorConfig { pose: Isometry3::from_parts(Translation3::identity(), level), ..sensor(1.5) };
    // The frame of this sensor points up, 0.1 m away from the mass.
    let upright = scene.add_sensor(id, &SensorConfig { centre: [0.0, 0.02, -0.1], ..upright }).unwrap();
    run(&mut scene, &mut [&mut robot], 3_000);
    let (_, [x, y, z, tx, ty, tz], _) = means(&mut scene, &mut robot, id, &upright);
    let weight = 1.5 * G;
    assert!(x.hypot(y) < 1e-2 && (z + weight).abs() < 1e-2, "{x} {y} {z}");
    assert!((tx + 0.02 * weight).abs() < 1e-2 && ty.abs() < 1e-2 && tz.abs() < 1e-3, "{tx} {ty} {tz}");

    // The column accelerates: tangential and centrifugal inertial forces act on the mass at 0.67 m. Constant torques
    // that balance the weight cause no oscillation by a count.
    robot.demands = (0..5).map(|axis| Demand::Torque(-robot.mechanism.load(axis).torque)).collect();
    robot.demands[0] = Demand::Torque(0.2);
    let mut speeds = Vec::new();
    for _ in 0..1_000 {
        run(&mut scene, &mut [&mut robot], 1);
        let origin = scene.flange(id).translation.vector;
        speeds.push(origin.y.atan2(origin.x));
    }
    let rate = (speeds[999] - speeds[989]) / 1e-3;
    let turning = (speeds[999] - 2.0 * speeds[979] + speeds[959]) / 4e-6;
    let [x, y, z, ..] = upright.last();
    // The mass is 0.02 m off the plane of the arm.
    let (radial, across) = (x.hypot(y), 1.5 * 0.67_f64.hypot(0.02) * rate.powi(2).hypot(turning));
    assert!(across > 2.0 && (radial - across).abs() < 0.03 * across, "{radial} N for {across}");
    assert!((z + weight).abs() < 0.2, "{z}");
}

#[test]
fn bar_held_by_two_arms_is_strained_as_its_springs_say() {
    let mut arms = [Robot::irb6(DOWN), Robot::irb6(DOWN)];
    let mut scene = Scene::new();
    let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, PI);
    let opposite = Isometry3::from_parts(Translation3::new(2.0, 0.0, 0.0), turn);
    let first = scene.add_robot(&arms[0].mechanism, &Isometry3::identity()).unwrap();
    let second = scene.add_robot(&arms[1].mechanism, &opposite).unwrap();
    let tool = Isometry3::translation(0.0, 0.0, 0.2);
    let (left, right) = (scene.flange(first) * tool, scene.flange(second) * tool);
    let span = (right.translation.vector - left.translation.vector).norm();
    assert!((span - 0.66).abs() < 1e-9, "{span}");
    let middle = 0.5 * (left.translation.vector + right.translation.vector);
    let bar = BodyConfig {
        mass: 4.0,
        half: [0.5 * span, 0.02, 0.02],
        material: METAL,
        pose: Isometry3::from_parts(middle.into(), UnitQuaternion::identity()),
        velocity: [0.0; 3],
        spin: [0.0; 3],
    };
    let bar = scene.add_body(&bar).unwrap();
    // The bar is 1 mm shorter than the distance of the grippers.
    let end = |side: f64, grip: &Isometry3<f64>| {
        Isometry3::from_parts(Translation3::new(side * (0.5 * span - 5e-4), 0.0, 0.0), grip.rotation)
    };
    let nominal = GripConfig::NOMINAL;
    let one = scene.hold(&nominal, Holder::Robot(first), &tool, bar, Some(&end(-1.0, &left))).unwrap();
    let two = scene.hold(&nominal, Holder::Robot(second), &tool, bar, Some(&end(1.0, &right))).unwrap();
    let sensors = [first, second].map(|id| scene.add_sensor(id, &sensor(0.0)).unwrap());
    let [a, b] = &mut arms;
    run(&mut scene, &mut [a, b], 30_000);
    // Means over a second, because the angle of a motor without friction oscillates by one count.
    const STEPS: u32 = 10_000;
    let grips = [(first, one, -1.0), (second, two, 1.0)];
    let mut sums = [[Vector3::zeros(); 3]; 2];
    for _ in 0..STEPS {
        run(&mut scene, &mut [a, b], 1);
        for (((robot, grip, side), sensor), [spring, pull, measured]) in grips.iter().zip(&sensors).zip(&mut sums) {
            // Force of the spring from the true places of flange and bar.
            let flange = scene.flange(*robot);
            let held = scene.body(bar).pose * nalgebra::Point3::new(side * (0.5 * span - 5e-4), 0.0, 0.0);
            *spring += 1e5 * ((flange * tool).translation.vector - held.coords) / f64::from(STEPS);
            let [x, y, z, ..] = scene.grip_wrench(*grip);
            *pull += Vector3::new(x, y, z) / f64::from(STEPS);
            let [x, y, z, ..] = sensor.last();
            *measured += flange.rotation * Vector3::new(x, y, z) / f64::from(STEPS);
        }
    }
    for ((_, _, side), [spring, pull, measured]) in grips.into_iter().zip(sums) {
        assert!((pull - spring).norm() < 0.01, "{pull} for {spring}");
        // Half of the weight each, and a pull of up to 0.5 mm.
        assert!((pull.z - 2.0 * G).abs() < 0.1, "{pull}");
        assert!((30.0..50.1).contains(&(side * pull.x)), "{pull}");
        // The sensor measures the opposite force in its own frame.
        assert!((measured + pull).norm() < 1e-6, "{measured} for {pull}");
    }
}

#[test]
fn gripper_holds_the_body_that_its_jaws_reach_while_its_output_has_the_level() {
    for closed_at in [true, false] {
        let mut robot = Robot::irb6(DOWN);
        let mut scene = Scene::new();
        let id = scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
        let output = OutputProbe::default();
        output.show(!closed_at);
        let pose = Isometry3::translation(0.0, 0.0, 0.2);
        let config = GripperConfig { grip: GripConfig::NOMINAL, pose, reach: 2e-3, closed_at };
        let probe = scene.add_gripper(id, &config, &output).unwrap();
        let at = scene.flange(id) * nalgebra::Point3::new(0.0, 0.0, 0.2);
        // The jaws are 1 mm above the upper face of one box, and 1 m away from the other.
        let cube = |x: f64, gap: f64| {
            let pose = Isometry3::translation(at.x + x, at.y, at.z - gap - 0.05);
            BodyConfig { mass: 1.0, half: [0.05; 3], material: METAL, pose, velocity: [0.0; 3], spin: [0.0; 3] }
        };
        let cubes = [cube(1.0, 0.0), cube(0.0, 1e-3)].map(|cube| scene.add_body(&cube).unwrap());
        let height = |scene: &Scene, body: usize| scene.body(cubes[body]).pose.translation.z;
        let start = height(&scene, 1);
        run(&mut scene, &mut [&mut robot], 10);
        assert_eq!(probe.last(), None);
        output.show(closed_at);
        run(&mut scene, &mut [&mut robot], 5_000);
        // The held box hangs by its weight, and the other one falls. The motors oscillate by a count.
        const STEPS: u32 = 2_000;
        let mut force = 0.0;
        for _ in 0..STEPS {
            run(&mut scene, &mut [&mut robot], 1);
            let [.., z, _, _, _] = probe.last().unwrap();
            force += z / f64::from(STEPS);
        }
        assert!((force - G).abs() < 0.1 && (height(&scene, 1) - start).abs() < 1e-3, "{force} N");
        assert!(height(&scene, 0) < start - 1.0);
        output.show(!closed_at);
        run(&mut scene, &mut [&mut robot], 5_000);
        assert!(probe.last().is_none() && height(&scene, 1) < start - 1.0);
        // Closed again, the jaws reach nothing.
        output.show(closed_at);
        run(&mut scene, &mut [&mut robot], 10);
        assert_eq!(probe.last(), None);
    }
}

#[test]
fn tip_pushes_a_box_away() {
    let mut robot = Robot::irb6(DOWN);
    let mut scene = Scene::new();
    let id = scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
    scene.add_tip(id, &TipConfig { centre: [0.0, 0.0, 0.2], radius: 5e-3 }).unwrap();
    let tip = scene.flange(id) * nalgebra::Point3::new(0.0, 0.0, 0.2);
    scene.set_gravity([0.0, 0.0, -G]).unwrap();
    let pose = Isometry3::translation(tip.x, tip.y + 5e-3 + 0.05 + 1e-3, tip.z);
    let cube = BodyConfig { mass: 1.0, half: [0.05; 3], material: METAL, pose, velocity: [0.0; 3], spin: [0.0; 3] };
    let cube = scene.add_body(&cube).unwrap();
    let floor = Isometry3::translation(0.0, 0.0, tip.z - 0.05);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose: floor, material: METAL }).unwrap();
    // The column turns the tip along y at about 0.1 m/s. Its motor turns backwards.
    robot.demands[0] = Demand::Velocity(-0.1 / 0.67 * 158.0 * 4000.0 / std::f64::consts::TAU);
    run(&mut scene, &mut [&mut robot], 10_000);
    let velocity = scene.body(cube).velocity;
    assert!((0.09..0.25).contains(&velocity.y), "{velocity}");
}

#[test]
fn a_body_that_is_released_around_a_tip_falls_and_gains_no_energy() {
    for late_tip in [false, true] {
        let mut robot = Robot::irb6(DOWN);
        let mut scene = Scene::new();
        let id = scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
        let tip = TipConfig { centre: [0.0, 0.0, 0.2], radius: 5e-3 };
        if !late_tip {
            scene.add_tip(id, &tip).unwrap();
        }
        let at = scene.flange(id) * nalgebra::Point3::new(0.0, 0.0, 0.2);
        // The tip is 10 mm below the upper face and beside the centre.
        let pose = Isometry3::translation(at.x + 0.01, at.y, at.z - 0.04);
        let still = [0.0; 3];
        let cube = BodyConfig { mass: 1.0, half: [0.05; 3], material: METAL, pose, velocity: still, spin: still };
        let cube = scene.add_body(&cube).unwrap();
        let gripper = Isometry3::translation(0.0, 0.0, 0.2);
        let grip = scene.hold(&GripConfig::NOMINAL, Holder::Robot(id), &gripper, cube, None).unwrap();
        if late_tip {
            scene.add_tip(id, &tip).unwrap();
        }
        run(&mut scene, &mut [&mut robot], 1_000);
        let held = scene.energy();
        let spring = 0.5 * (G / 1e5) * G;
        let body = scene.body(cube).pose.translation.z * G;
        assert!((held - body - spring).abs() < 0.02, "{held} J for {body} J");
        scene.release(grip);
        run(&mut scene, &mut [&mut robot], 500);
        // After 50 ms, 12 mm of free fall: the upper face is 2 mm above the centre of the tip.
        let velocity = scene.body(cube).velocity;
        assert!((velocity.z + 0.05 * G).abs() < 0.05 && velocity.xy().norm() < 0.05, "{velocity}");
        assert!(scene.energy() <= held + 1e-3, "{} J after {held} J", scene.energy());
    }
}

#[test]
fn a_tip_that_has_left_a_released_body_touches_the_body_again() {
    let mut robot = Robot::irb6(DOWN);
    let mut scene = Scene::new();
    let id = scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
    scene.add_tip(id, &TipConfig { centre: [0.0, 0.0, 0.2], radius: 5e-3 }).unwrap();
    let at = scene.flange(id) * nalgebra::Point3::new(0.0, 0.0, 0.2);
    let pose = Isometry3::translation(at.x, at.y, at.z - 0.046);
    let still = [0.0; 3];
    let cube = BodyConfig { mass: 1.0, half: [0.05; 3], material: METAL, pose, velocity: still, spin: still };
    let cube = scene.add_body(&cube).unwrap();
    // A springy floor 20 mm below throws the cube back against the tip.
    let springy = Material { stiffness: 1e4, damping: 0.0, friction: 0.0 };
    let floor = Isometry3::translation(0.0, 0.0, at.z - 0.046 - 0.05 - 0.02);
    scene.add_wall(&WallConfig { shape: Shape::HalfSpace, pose: floor, material: springy }).unwrap();
    let gripper = Isometry3::translation(0.0, 0.0, 0.2);
    let grip = scene.hold(&GripConfig::NOMINAL, Holder::Robot(id), &gripper, cube, None).unwrap();
    run(&mut scene, &mut [&mut robot], 10);
    scene.release(grip);
    let mut highest = f64::MIN;
    for _ in 0..3_000 {
        run(&mut scene, &mut [&mut robot], 1);
        let leaving = scene.body(cube).velocity.z > 0.0;
        highest = if leaving { highest.max(scene.body(cube).pose.translation.z) } else { highest };
    }
    // The upper face reaches the lowest point of the tip, 5 mm below the tip, and goes no further than its spring.
    let top = highest + 0.05 - (at.z - 5e-3);
    assert!((-1e-3..1.5e-3).contains(&top), "{top} m");
}

#[test]
fn shaft_of_a_robot_in_a_scene_is_read_without_lag() {
    let robot = Robot::irb6(DOWN);
    let mut scene = Scene::new();
    scene.add_robot(&robot.mechanism, &Isometry3::identity()).unwrap();
    let mut axis = robot.axes.into_iter().next().unwrap();
    let shaft = axis.probe();
    let demand = Demand::Torque(0.5);
    // A drive in a scene begins a chunk of ten sub-steps, and the scene reads between them.
    axis.begin(demand);
    for sub_step in 0..10 {
        let before = shaft.angle();
        axis.sub_step(sub_step, demand);
        assert!(shaft.angle() == axis.angle() && shaft.angle() != before, "sub-step {sub_step}");
    }
}

#[test]
fn robots_that_cannot_be_are_refused() {
    let mut scene = Scene::new();
    let mechanism = Mechanism::new(MechanismConfig::Irb6);
    let leaning = Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_euler_angles(0.1, 0.0, 0.0));
    let Err(SceneError::Leaning { angle }) = scene.add_robot(&mechanism, &leaning) else { panic!("it leans") };
    assert!((angle - 0.1).abs() < 1e-9);
    let id = scene.add_robot(&mechanism, &Isometry3::identity()).unwrap();
    // The robot also refuses a gravity of another direction.
    let Err(SceneError::Leaning { angle }) = scene.set_gravity([0.1 * G, 0.0, -G]) else { panic!("it leans") };
    assert!((angle - 0.1_f64.atan()).abs() < 1e-9);
    assert_eq!(scene.set_gravity([0.0, f64::NAN, 0.0]), Err(SceneError::NotFinite { what: "the gravity" }));
    assert_eq!(scene.set_gravity([0.0, 0.0, -1.62]), Ok(()));
    let mut other = Scene::new();
    assert_eq!(other.add_robot(&mechanism, &Isometry3::identity()), Err(SceneError::Taken));
    let tip = TipConfig { centre: [0.0; 3], radius: -1.0 };
    assert_eq!(scene.add_tip(id, &tip), Err(SceneError::Length { what: "the radius of a tip", value: -1.0 }));
    let sensor = SensorConfig { centre: [f64::NAN; 3], ..sensor(1.0) };
    let refused = scene.add_sensor(id, &sensor).unwrap_err();
    assert_eq!(refused, SceneError::NotFinite { what: "the mass beyond a force sensor" });
    let gripper =
        GripperConfig { grip: GripConfig::NOMINAL, pose: Isometry3::identity(), reach: -1.0, closed_at: true };
    let refused = scene.add_gripper(id, &gripper, &OutputProbe::default()).unwrap_err();
    assert_eq!(refused, SceneError::Length { what: "the reach of a gripper", value: -1.0 });
    // The robot is free again after the end of its scene.
    drop(scene);
    assert!(other.add_robot(&mechanism, &Isometry3::identity()).is_ok());
}
