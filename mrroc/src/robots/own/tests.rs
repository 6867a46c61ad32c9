//! A robot of another crate, from its keys to its emulation.

use controller::robot::{ConveyorParameters, Jacobian, Joints, KinematicsError, Limits, Motors, Pose, Solutions};
use hil::Mechanism;
use serde::Deserialize;

use super::*;
use crate::cell::Cell;

/// A sledge of one axis along x.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
struct Sledge {
    /// Motor angle per displacement, rad/m.
    ratio: f64,
    /// Factor by which the Jacobian is wrong.
    wrong: f64,
    /// Mass of the emulated sledge, kg.
    mass: f64,
    /// Displacement by which the emulated flange is wrong, m.
    beside: f64,
    /// Displacement beyond which the emulated sledge has no place, m.
    reach: f64,
}

impl Default for Sledge {
    fn default() -> Self {
        Self { ratio: 100.0, wrong: 1.0, mass: 0.0, beside: 0.0, reach: 2.0 }
    }
}

const RANGE: [Limits; 1] = [Limits { low: -1.0, high: 1.0 }];
const MOTOR: [Limits; 1] = [Limits { low: -100.0, high: 100.0 }];

impl Robot for Sledge {
    fn joint_limits(&self) -> &[Limits] {
        &RANGE
    }
    fn motor_limits(&self) -> &[Limits] {
        &MOTOR
    }
    fn home(&self) -> Motors {
        Motors::from([0.0])
    }
    fn forward(&self, joints: &Joints) -> Result<Pose, KinematicsError> {
        Ok(Pose::translation(joints[0], 0.0, 0.0))
    }
    fn inverse(&self, pose: &Pose, _near: &Joints) -> Result<Solutions, KinematicsError> {
        Ok(Joints::from([pose.translation.x]).into())
    }
    fn motors_from_joints(&self, joints: &Joints) -> Result<Motors, KinematicsError> {
        Ok(Motors::from([joints[0] * self.ratio]))
    }
    fn joints_from_motors(&self, motors: &Motors) -> Result<Joints, KinematicsError> {
        Ok(Joints::from([motors[0] / self.ratio]))
    }
    fn jacobian(&self, _joints: &Joints) -> Result<Jacobian, KinematicsError> {
        let mut jacobian = Jacobian::zeros();
        jacobian[(0, 0)] = self.wrong;
        Ok(jacobian)
    }
}

impl RobotParameters for Sledge {
    fn axes(&self) -> usize {
        1
    }
    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        match self.ratio {
            0.0 => Err(ParameterError::NoRatio { name: "ratio" }),
            _ => Ok(Arc::new(self.clone())),
        }
    }
}

impl OwnRobot for Sledge {
    const MODEL: &'static str = "sledge";

    fn joint(&self, _axis: usize) -> EmulatedJoint {
        EmulatedJoint { ratio: self.ratio, inertia: 2.0, velocity: 1.0, effort: 20.0 }
    }

    fn is_linear(&self, _axis: usize) -> bool {
        true
    }

    fn emulated_links(&self) -> Vec<EmulatedLink> {
        let link = EmulatedLink { mass: self.mass, ..EmulatedLink::default() };
        if self.mass == 0.0 { Vec::new() } else { vec![link] }
    }

    fn place_links(&self, motors: &[f64], poses: &mut [Pose]) -> bool {
        let at = motors[0] / self.ratio;
        poses[0] = Pose::translation(at, 0.0, 0.0);
        poses[1] = Pose::translation(at + self.beside, 0.0, 0.0);
        at.abs() < self.reach
    }
}

/// The text of a cell with one sledge, whose numbers are `parameters`.
fn cell(parameters: &str) -> String {
    format!(
        "name = \"sledge\"\nperiod_us = 2000\nmacrostep = 10\nrealtime = {{ policy = \"best-effort\", priority = 80 }}\n\
         bus = [{{ name = \"can0\", interface = \"can0\" }}]\n[[robot]]\nname = \"sledge\"\nmodel = \"sledge\"\n\
         {parameters}\n[[robot.axis]]\nname = \"x\"\nbus = \"can0\"\nnode = 1\n\
         drive = {{ vendor = 0xFB, counts_per_revolution = 4096, rated_torque = 0.5 }}\nmax_velocity = 90.0\n\
         max_acceleration = 300.0\nfollowing_error = 2.0\n\
         homing = {{ method = 37, search_velocity = 5.0, zero_velocity = 1.0, acceleration = 100.0 }}\n"
    )
}

#[test]
fn a_registered_robot_has_its_own_keys_and_others_are_refused_in_their_line() {
    register::<Sledge>();
    register::<Sledge>();
    let robot = |parameters: &str| Cell::parse(&cell(parameters)).map(|cell| cell.robot[0].clone());
    let usual = robot("").unwrap();
    assert_eq!((usual.numbers().name(), usual.numbers().axes()), ("sledge", 1));
    let given = robot("parameters = { sledge = { ratio = -50.0 } }").unwrap();
    assert_eq!(given.kinematics().unwrap().motors_from_joints(&[0.1].into()).unwrap()[0], -5.0);
    assert!(given.numbers().is_linear(0));
    let refused = |parameters: &str| robot(parameters).unwrap_err().to_string();
    assert_eq!(
        refused("parameters = { sledge = { ratoi = 1.0 } }"),
        "9: robot[0].parameters.sledge.ratoi: is an unknown key, must be \"ratio\", \"wrong\", \"mass\", \"beside\" or \"reach\""
    );
    assert_eq!(
        refused("parameters = { sledge = { ratio = nan } }"),
        "9: robot[0].parameters.sledge.ratio: must be a finite number"
    );
    assert_eq!(
        refused("parameters = { sledge = { ratio = 0.0 } }"),
        "9: robot[0].parameters: ratio has a ratio of zero"
    );
    assert_eq!(
        refused("parameters = { gripper = { square = 1.0 } }").split(" is ").next(),
        Some("9: robot[0].parameters.gripper.linear:")
    );
    let other = cell("").replace("model = \"sledge\"", "model = \"sleigh\"");
    let other = Cell::parse(&other).unwrap_err().to_string();
    assert!(other.starts_with("8: robot[0].model: is \"sleigh\", must be \"irb6\", "), "{other}");
    assert!(other.ends_with("or \"sledge\"; a model of another program is known to that program alone"), "{other}");
}

#[test]
fn kinematics_that_contradict_each_other_are_refused() {
    register::<Sledge>();
    let refused = Cell::parse(&cell("parameters = { sledge = { wrong = 1.001 } }")).unwrap_err().to_string();
    assert!(
        refused.starts_with("9: robot[0].parameters: jacobian at the joints [0.0] has 1.001000 in row 0, column 0"),
        "{refused}"
    );
    let unmoved = Cell::parse(&cell("parameters = { sledge = { ratio = inf } }")).unwrap_err().to_string();
    assert!(unmoved.contains("must be a finite number"), "{unmoved}");
}

#[test]
fn links_that_contradict_the_kinematics_are_refused() {
    register::<Sledge>();
    let refused = |numbers: &str| {
        let parameters = format!("parameters = {{ sledge = {{ {numbers} }} }}");
        Cell::parse(&cell(&parameters)).map(drop).unwrap_err().to_string()
    };
    let beside = refused("mass = 2.0, beside = 0.01");
    assert!(beside.contains("place_links has the flange 0.010000 m and 0.000000 rad from that of forward"), "{beside}");
    let short = refused("mass = 2.0, reach = 0.5");
    assert!(short.contains("place_links has no pose of the links at the joints"), "{short}");
    let light = refused("mass = -2.0");
    assert!(light.ends_with("link 1: the mass is -2 kg, it must be 0 or above"), "{light}");
    let nowhere = refused("mass = 2.0, reach = 0.0");
    assert!(nowhere.ends_with("the links have no pose with all motors at home"), "{nowhere}");
}

#[test]
fn links_are_emulated_with_the_mass_of_the_robot() {
    register::<Sledge>();
    let numbers = |parameters: &str| Cell::parse(&cell(parameters)).unwrap().robot[0].numbers().clone();
    assert_eq!(numbers("").mechanism(), None);
    let heavy = numbers("parameters = { sledge = { mass = 2.0 } }");
    let mechanism = Mechanism::new(heavy.mechanism().unwrap());
    let joint = NominalJoint { ratio: 100.0, inertia: 2.0, velocity: 1.0, effort: 20.0, home: 0.0, travel: None };
    let expected = joint.rotor_inertia() + 2.0 / (100.0 * 100.0);
    assert!((mechanism.load(0).inertia / expected - 1.0).abs() < 1e-9, "{} kg·m²", mechanism.load(0).inertia);
}

#[test]
fn a_cell_is_written_and_read_again() {
    register::<Sledge>();
    let parsed = Cell::parse(&cell("parameters = { sledge = { ratio = 60.0 } }")).unwrap();
    let again = Cell::parse(&toml::to_string(&parsed).unwrap()).unwrap();
    assert_eq!(again.robot[0].model.map(Model::name), Some("sledge"));
    assert_eq!(again.robot[0].kinematics().unwrap().motors_from_joints(&[0.1].into()).unwrap()[0], 6.0);
}

#[cfg(feature = "schema")]
#[test]
fn the_schema_has_the_keys_of_a_registered_robot() {
    register::<Sledge>();
    let schema = Cell::schema();
    let schema = schema.as_value();
    let last = |name: &str| schema["$defs"][name]["oneOf"].as_array().unwrap().last().unwrap().clone();
    assert_eq!(last("Model")["const"], "sledge");
    let keys = &last("Parameters")["properties"]["sledge"]["properties"];
    assert_eq!(keys["ratio"]["description"], "Motor angle per displacement, rad/m.");
}

#[test]
#[should_panic(expected = "two robots are called \"conveyor\"")]
fn a_built_in_robot_is_not_replaced() {
    #[derive(Clone, Debug, Default, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    struct Belt;
    impl RobotParameters for Belt {
        fn axes(&self) -> usize {
            1
        }
        fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
            ConveyorParameters::belt().robot()
        }
    }
    impl OwnRobot for Belt {
        const MODEL: &'static str = "conveyor";

        fn joint(&self, _axis: usize) -> EmulatedJoint {
            unreachable!("never registered")
        }
    }
    register::<Belt>();
}
