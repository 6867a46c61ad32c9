//! Cuts by tools that are moved along given paths, and by a robot.

use std::f64::consts::TAU;

use super::*;

const BOARD: WorkpieceConfig = WorkpieceConfig {
    pose: Isometry3 {
        rotation: nalgebra::Unit::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
        translation: nalgebra::Translation3::new(0.0, 0.0, 0.0),
    },
    size: [0.04, 0.02, 0.005],
    cell: 1e-4,
    specific_force: WorkpieceConfig::FIBREBOARD_SPECIFIC_FORCE,
    edge_force: WorkpieceConfig::FIBREBOARD_EDGE_FORCE,
    material: Material { stiffness: 1e5, damping: 300.0, friction: 0.3 },
};

/// A tool that is moved without a robot.
struct Moved {
    cut: Cut,
    field: HeightField,
    radius: f64,
    at: Vector3<f64>,
    /// Work of the force on the tool, by the force at the middle of each step, J.
    work: f64,
    force: Vector3<f64>,
}

impl Moved {
    fn new(diameter: f64, at: [f64; 3]) -> Self {
        let field = HeightField::new(&BOARD);
        let (radius, force) = (0.5 * diameter, Vector3::zeros());
        Self { cut: Cut::new(0, 0), field, radius, at: at.into(), work: 0.0, force }
    }

    /// Moves by one step of 100 µs at this velocity, m/s.
    fn step(&mut self, velocity: Vector3<f64>, turning: bool) -> Vector3<f64> {
        let way = velocity * STEP_SECONDS;
        self.at += way;
        let end = End { centre: self.at, normal: Vector3::z(), radius: self.radius };
        let force = self.cut.step(&BOARD, &mut self.field, &end, &velocity, turning);
        self.work += 0.5 * (self.force + force).dot(&way);
        self.force = force;
        force
    }

    /// Moves to a point at a speed, m/s. Returns the mean of the force along the way, N.
    fn go(&mut self, to: [f64; 3], speed: f64, turning: bool) -> Vector3<f64> {
        let way = Vector3::from(to) - self.at;
        let steps = (way.norm() / speed / STEP_SECONDS).ceil();
        let velocity = way / (steps * STEP_SECONDS);
        let mut sum = Vector3::zeros();
        for _ in 0..steps as u32 {
            sum += self.step(velocity, turning);
        }
        sum / steps
    }
}

/// Cells of a field that are lower than the upper face: column, row, height.
fn cut_cells(field: &HeightField) -> impl Iterator<Item = ([f64; 2], f64)> {
    let [columns, rows] = field.cells();
    let all = (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row)));
    all.map(|(column, row)| (field.centre(column, row), field.height(column, row)))
}

#[test]
fn a_groove_has_the_cross_section_of_the_path_of_the_tool() {
    let mut tool = Moved::new(3e-3, [-0.01, 0.002, 1e-3]);
    tool.go([-0.01, 0.002, -0.5e-3], 5e-3, true);
    let end = [0.01, 0.002, -0.5e-3];
    tool.go(end, 0.02, true);
    tool.go([0.01, 0.002, 1e-3], 0.02, true);
    let mut cells = 0;
    for ([x, y], height) in cut_cells(&tool.field) {
        let away = (x - x.clamp(-0.01, 0.01)).hypot(y - 0.002);
        if away < 1.5e-3 - 1e-6 {
            assert!((height + 0.5e-3).abs() < 1e-12, "{x} {y}: {height}");
            cells += 1;
        } else if away > 1.5e-3 + 1e-6 {
            assert_eq!(height, 0.0, "{x} {y}");
        }
    }
    // 20 mm of groove and a disc.
    let area = 0.02 * 3e-3 + std::f64::consts::PI * 1.5e-3_f64.powi(2);
    assert!((f64::from(cells) * 1e-8 - area).abs() < 0.01 * area, "{cells} cells for {area} m²");
    assert!((tool.field.removed() - 0.5e-3 * area).abs() < 0.01 * 0.5e-3 * area, "{} m³", tool.field.removed());
}

#[test]
fn mean_cutting_force_is_that_of_width_and_depth() {
    for (diameter, depth) in [(2e-3, 0.4e-3), (3e-3, 1e-3), (6e-3, 0.2e-3), (3e-3, 0.05e-3)] {
        for speed in [0.005, 0.02, 0.1] {
            // The tool begins in the material, and its pending work reaches the steady state.
            let mut tool = Moved::new(diameter, [-0.015, 0.0, -depth]);
            tool.go([-0.010, 0.0, -depth], speed, true);
            let force = tool.go([0.010, 0.0, -depth], speed, true);
            let expected = 25e6 * diameter * depth + 2e3 * diameter;
            assert!((force.x + expected).abs() < 0.02 * expected, "{diameter} {depth} {speed}: {force} for {expected}");
            assert!(force.yz().norm() < 1e-9, "{force}");
        }
    }
}

#[test]
fn half_a_cut_needs_half_the_force_and_an_old_groove_none() {
    let mut tool = Moved::new(4e-3, [-0.015, 0.0, -5e-4]);
    tool.go([0.015, 0.0, -5e-4], 0.02, true);
    let force = tool.go([-0.015, 0.0, -5e-4], 0.02, true);
    assert!(force.norm() < 0.5, "in the groove: {force}");
    // Back in the air, beside the groove by half of its width.
    tool.go([-0.015, 0.0, 1e-3], 0.02, true);
    tool.go([-0.018, 2e-3, 1e-3], 0.02, true);
    tool.go([-0.018, 2e-3, -5e-4], 0.02, true);
    tool.go([-0.010, 2e-3, -5e-4], 0.02, true);
    let force = tool.go([0.010, 2e-3, -5e-4], 0.02, true);
    let expected = 25e6 * 2e-3 * 5e-4 + 2e3 * 2e-3;
    assert!((force.x + expected).abs() < 0.02 * expected, "{force} for {expected}");
}

#[test]
fn a_tool_that_cuts_downward_feels_the_thrust_of_its_edge() {
    let mut tool = Moved::new(3e-3, [0.0, 0.0, 1e-4]);
    assert_eq!(tool.go([0.0, 0.0, 1e-6], 5e-3, true), Vector3::zeros());
    tool.go([0.0, 0.0, -1e-4], 5e-3, true);
    let force = tool.go([0.0, 0.0, -1e-3], 5e-3, true);
    assert!((force.z - 6.0).abs() < 1e-6 && force.xy().norm() == 0.0, "{force}");
    // At half of the least velocity half of the thrust, and none upward.
    let force = tool.go([0.0, 0.0, -1.1e-3], 0.5 * SLOW, true);
    assert!((force.z - 3.0).abs() < 1e-2, "{force}");
    assert_eq!(tool.go([0.0, 0.0, 1e-3], 5e-3, true), Vector3::zeros());
}

#[test]
fn a_tool_without_spindle_rests_on_the_material_and_cuts_nothing() {
    let mut tool = Moved::new(3e-3, [0.0, 0.0, 1e-4]);
    tool.go([0.0, 0.0, -1e-4], 1e-3, false);
    let force = tool.step(Vector3::zeros(), false);
    assert!((force - Vector3::new(0.0, 0.0, 10.0)).norm() < 1e-6, "{force}");
    // Friction of 0.3 along the surface.
    let force = tool.go([0.005, 0.0, -1e-4], 0.02, false);
    assert!((force.z - 10.0).abs() < 1e-6 && (force.x + 3.0).abs() < 0.1, "{force}");
    assert_eq!(tool.field.removed(), 0.0);
    // With the spindle, the tool sinks in at once and bears nothing.
    let force = tool.step(Vector3::zeros(), true);
    assert_eq!(force, Vector3::zeros());
    assert!(tool.field.removed() > 0.0);
    // There is no material beside the workpiece.
    let mut tool = Moved::new(3e-3, [0.03, 0.0, 1e-4]);
    assert_eq!(tool.go([0.03, 0.0, -1e-3], 5e-3, false), Vector3::zeros());
}

#[test]
fn holes_end_at_the_bottom_of_the_workpiece() {
    let mut tool = Moved::new(3e-3, [0.0, 0.0, 1e-4]);
    tool.go([0.0, 0.0, -0.01], 0.1, true);
    let lowest = cut_cells(&tool.field).map(|(_, height)| height).fold(0.0, f64::min);
    assert_eq!(lowest, -BOARD.size[2]);
    // Without the spindle, a tool in the hole rests on nothing.
    tool.go([0.0, 0.0, 0.01], 0.1, true);
    assert_eq!(tool.go([0.0, 0.0, -0.01], 0.1, false), Vector3::zeros());
}

/// A generator of numbers from −1 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    }
}

#[test]
fn cuts_and_contacts_on_random_paths_add_no_energy() {
    for seed in 0..24 {
        let mut random = Random(seed);
        let mut tool = Moved::new(1.5e-3 + 1e-3 * random.next(), [0.01 * random.next(), 0.005 * random.next(), 1e-3]);
        let mut turning = true;
        for leg in 0..40 {
            // Some legs switch the spindle, and other legs have a low speed.
            turning ^= leg % 5 == 4;
            let to = [0.01 * random.next(), 0.005 * random.next(), 1e-3 * random.next()];
            let speed = [2e-4, 2e-2, 1e-1][leg % 3];
            let to = if speed < SLOW { (tool.at + 0.002 * (Vector3::from(to) - tool.at)).into() } else { to };
            let way = Vector3::from(to) - tool.at;
            let steps = (way.norm() / speed / STEP_SECONDS).ceil().max(1.0);
            let velocity = way / (steps * STEP_SECONDS);
            for _ in 0..steps as u32 {
                let force = tool.step(velocity, turning);
                if turning {
                    assert!(force.dot(&velocity) <= 0.0, "seed {seed}, leg {leg}: {force} at {velocity}");
                }
            }
            // Up to the error of the integral over a step with a contact.
            let energy = tool.cut.energy(&BOARD.material);
            assert!(tool.work + energy <= 2e-3, "seed {seed}, leg {leg}: {} J, spring {energy} J", tool.work);
        }
        assert!(tool.work < 0.0, "seed {seed}: {} J", tool.work);
    }
}

#[test]
fn a_leaning_tool_cuts_along_its_end_and_not_beyond_its_greatest_angle() {
    for (angle, cuts) in [(0.1_f64, true), (0.3, false)] {
        let mut field = HeightField::new(&BOARD);
        let normal = Vector3::new(angle.sin(), 0.0, angle.cos());
        let mut cut = Cut::new(0, 0);
        for height in [1e-3, -1e-3] {
            let end = End { centre: Vector3::new(0.0, 0.0, height), normal, radius: 2e-3 };
            cut.step(&BOARD, &mut field, &end, &Vector3::zeros(), true);
        }
        let expected = if cuts { angle.cos() * TAU / 2.0 * 4e-6 * 1e-3 } else { 0.0 };
        assert!((field.removed() - expected).abs() <= 0.02 * expected, "{} m³ for {expected}", field.removed());
    }
}

#[test]
fn workpieces_and_tools_that_cannot_be_are_refused() {
    let mut scene = Scene::new();
    let refused = |scene: &mut Scene, config: WorkpieceConfig| scene.add_workpiece(&config).err();
    let edge = |what, value| Some(SceneError::Length { what, value });
    let zero = WorkpieceConfig { size: [0.0, 0.02, 0.005], ..BOARD };
    assert_eq!(refused(&mut scene, zero), edge("an edge of a workpiece", 0.0));
    let thin = WorkpieceConfig { size: [0.04, 0.02, 0.0], ..BOARD };
    assert_eq!(refused(&mut scene, thin), edge("the thickness of a workpiece", 0.0));
    let cell = WorkpieceConfig { cell: 0.0, ..BOARD };
    assert_eq!(refused(&mut scene, cell), edge("a cell of a workpiece", 0.0));
    let large = WorkpieceConfig { size: [1.0, 1.0, 0.005], ..BOARD };
    assert_eq!(refused(&mut scene, large), Some(SceneError::Cells { columns: 10_000, rows: 10_000 }));
    let helping = WorkpieceConfig { edge_force: -1.0, ..BOARD };
    assert_eq!(refused(&mut scene, helping), Some(SceneError::CuttingForce { specific: 25e6, edge: -1.0 }));
    let soft = WorkpieceConfig { material: Material { stiffness: 0.0, ..BOARD.material }, ..BOARD };
    assert!(matches!(refused(&mut scene, soft), Some(SceneError::Surface { .. })));
    let mechanism = crate::Mechanism::new(crate::MechanismConfig::Irb6);
    let robot = scene.add_robot(&mechanism, &Isometry3::identity()).unwrap();
    let tool = CutterConfig { pose: Isometry3::identity(), diameter: 0.0, turning_at: true };
    let refused = scene.add_cutter(robot, &tool, None).err();
    assert_eq!(refused, edge("the diameter of a cutting tool", 0.0));
}
