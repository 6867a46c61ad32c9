//! The emulated surroundings of the robots of a cell.

use std::f64::consts::PI;

use hil::scene::{
    BodyConfig, BodyProbe, CutterConfig, GripProbe, GripperConfig, Material, RobotId, SensorConfig, SensorProbe, Shape,
    TipConfig, WallConfig, WorkpieceProbe,
};
use hil::{Mechanism, Scene};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::bench::plants::EmulatedCell;
use crate::cell::{EmulatedBar, EmulatedBlock, EmulatedPlane, Robot};

/// The scene of a cell, and what its devices measure.
pub struct EmulatedSurroundings {
    /// The scene; `None` for a cell without force sensors and without surroundings.
    pub scene: Option<Scene>,
    /// The wrench on each force sensor.
    pub sensors: Vec<SensorProbe>,
    /// The true state of bars and grippers.
    pub truth: SceneTruth,
}

/// True places of all bars, and true wrenches of all grippers, for recordings and tests. No controller reads this state.
#[derive(Clone, Debug, Default)]
pub struct SceneTruth {
    /// The bars, in the order of the cell file.
    pub bars: Vec<BodyProbe>,
    /// The grippers, in the order of the cell file.
    pub grips: Vec<GripProbe>,
    /// The workpieces, in the order of the cell file.
    pub workpieces: Vec<WorkpieceProbe>,
}

impl EmulatedCell<'_> {
    /// The scene of the cell in the frame of the cell: the robots that have force sensors, tips, grippers or cutting
    /// tools, the planes, blocks, bars and workpieces. The axes must be mounted already. The tools of two
    /// robots have no contact with each other.
    pub fn surroundings(&self) -> EmulatedSurroundings {
        let cell = &self.file.cell;
        let around = cell.scene.clone().unwrap_or_default();
        let mut scene = Scene::new();
        let mut sensors: Vec<_> = cell.force_sensor.iter().map(|_| SensorProbe::default()).collect();
        let mut grips = vec![GripProbe::default(); around.gripper.len()];
        let mut count = 0;
        for plane in &around.plane {
            scene.add_wall(&wall(plane)).expect(SOUND);
        }
        for block in &around.block {
            scene.add_wall(&block_wall(block)).expect(SOUND);
        }
        self.add_conveyors(&mut scene, &around);
        let bars = around.bar.iter().map(|bar| scene.add_body(&body(bar)).expect(SOUND));
        let bars: Vec<_> = bars.collect();
        let workpieces = around.workpiece.iter().map(|it| scene.add_workpiece(&it.config()).expect(SOUND)).collect();
        for (number, robot) in cell.robot.iter().enumerate() {
            let own: Vec<_> = (0..sensors.len()).filter(|sensor| cell.robot_of_sensor(*sensor) == number).collect();
            let tip = around.tips().find(|(name, _)| *name == robot.name).map(|(_, radius)| radius);
            let gripper = around.gripper.iter().position(|gripper| gripper.robot == robot.name);
            let cutter = around.cutter.iter().position(|cutter| cutter.robot == robot.name);
            let carries = cell.device.iter().any(|device| device.keys.robot.as_ref() == Some(&robot.name));
            if own.is_empty() && tip.is_none() && gripper.is_none() && cutter.is_none() && !carries {
                continue;
            }
            let Some(mechanism) = self.mechanisms[number].as_ref() else {
                continue;
            };
            count += 1;
            let (id, flange) = add_robot(&mut scene, mechanism, robot);
            if carries {
                self.flanges.borrow_mut()[number] = Some((scene.watch_flange(id), flange.inverse()));
            }
            for sensor in own {
                let given = &cell.force_sensor[sensor];
                let config = SensorConfig {
                    pose: flange.inverse() * given.flange_from_sensor(),
                    mass: given.tool.mass,
                    centre: given.tool.centre,
                    inertia: given.tool_inertia,
                };
                sensors[sensor] = scene.add_sensor(id, &config).expect(SOUND);
            }
            let tool = flange.inverse() * Translation3::from(robot.tool);
            if let Some(radius) = tip {
                let centre = tool.translation.vector.into();
                scene.add_tip(id, &TipConfig { centre, radius }).expect(SOUND);
            }
            if around.robot.as_ref() == Some(&robot.name) {
                for (probe, input) in around.touch_probe.iter().zip(&self.touches) {
                    scene.add_touch(id, probe.force, !probe.closed_at_rest, input).expect(SOUND);
                }
            }
            if let Some(number) = gripper {
                let gripper = &around.gripper[number];
                let closed_at = !self.file.cell.inverts(&gripper.output);
                let config = GripperConfig { grip: gripper.grip(), pose: tool, reach: gripper.reach, closed_at };
                grips[number] = scene.add_gripper(id, &config, &self.valves[number]).expect(SOUND);
            }
            if let Some(number) = cutter {
                let cutter = &around.cutter[number];
                let turning_at = !cutter.spindle.as_ref().is_some_and(|output| self.file.cell.inverts(output));
                let config = CutterConfig { pose: tool, diameter: cutter.diameter, turning_at };
                let spindle = cutter.spindle.as_ref().map(|_| &self.spindles[number]);
                scene.add_cutter(id, &config, spindle).expect(SOUND);
            }
        }
        let bars = bars.into_iter().map(|bar| scene.watch(bar)).collect();
        let moving = !around.bar.is_empty() || !around.conveyor.is_empty();
        let sees = !(cell.ultrasonic.is_empty() && cell.camera.is_empty() && cell.device.is_empty());
        let needed = count > 0 || moving || sees;
        let truth = SceneTruth { bars, grips, workpieces };
        EmulatedSurroundings { scene: needed.then_some(scene), sensors, truth }
    }
}

/// Place of the base frame of a robot in the frame of the cell.
pub(super) fn base_of(robot: &Robot) -> Isometry3<f64> {
    robot.base.pose() * robot.emulated_base_error.pose() * robot.numbers().upright_from_base()
}

/// Adds a robot, and returns its flange frame of the cell file in the flange frame of the mechanism.
fn add_robot(scene: &mut Scene, mechanism: &Mechanism, robot: &Robot) -> (RobotId, Isometry3<f64>) {
    let (base, flange) = robot.numbers().mechanism_frames();
    (scene.add_robot(mechanism, &(base_of(robot) * base)).expect(SOUND), flange)
}

/// Surfaces of bars. Tips and corners of other bars touch them.
const STEEL: Material = Material { stiffness: 1e5, damping: 300.0, friction: 0.3 };

fn body(bar: &EmulatedBar) -> BodyConfig {
    BodyConfig {
        mass: bar.mass,
        half: [0.5 * bar.length, 0.5 * bar.width, 0.5 * bar.width],
        material: STEEL,
        pose: bar.place.pose(),
        velocity: [0.0; 3],
        spin: [0.0; 3],
    }
}

fn wall(plane: &EmulatedPlane) -> WallConfig {
    let normal = Vector3::from(plane.normal).normalize();
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &normal);
    let facing = facing.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    let pose = Isometry3::from_parts((normal * plane.height).into(), facing);
    let &EmulatedPlane { stiffness, damping, friction, .. } = plane;
    WallConfig { shape: Shape::HalfSpace, pose, material: Material { stiffness, damping, friction } }
}

fn block_wall(block: &EmulatedBlock) -> WallConfig {
    let &EmulatedBlock { centre, size, stiffness, damping, friction } = block;
    let pose = Isometry3::from_parts(centre.into(), UnitQuaternion::identity());
    let shape = Shape::Box { half: size.map(|edge| edge / 2.0) };
    WallConfig { shape, pose, material: Material { stiffness, damping, friction } }
}

/// Reason why the scene accepts all parts.
pub(super) const SOUND: &str = "a parsed cell has a sound scene";
