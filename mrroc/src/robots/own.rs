//! Robots of other crates: their keys in cell files, their kinematics and their emulation.

use std::any::TypeId;
use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};

use controller::robot::{Mass, MotorRating, ParameterError, Robot, RobotParameters};
use hil::AxisConfig;
use hil::plant::NominalJoint;
use serde::de::DeserializeOwned;
use serde::{Serialize, Serializer};
use toml::de::DeValue;

use super::{Model, Parameters, examine};
use crate::cell::{CellError, Path, read_element};

/// A robot that a program adds. Each number of the robot has a key in cell files.
///
/// The cell names the robot by `model`. The table `parameters` replaces the default numbers:
///
/// ```toml
/// model = "five-bar"
/// parameters = { five-bar = { base = 0.2, proximal = 0.25, distal = 0.3 } }
/// ```
///
/// Every value is read by serde: `#[serde(deny_unknown_fields)]` refuses a misspelt key. The emulated robot has one motor
/// per axis, each with a load of its own. All numbers of these motors are nominal.
///
/// Methods with a default may be added to this trait; every other change is announced in the change log.
pub trait OwnRobot: RobotParameters + Default + fmt::Debug + Serialize + DeserializeOwned + Keys + Send + Sync {
    /// Name of the model in cell files.
    const MODEL: &'static str;

    /// Requirements of joint `axis` on its emulated motor.
    fn joint(&self, axis: usize) -> EmulatedJoint;

    /// Whether joint `axis` is linear: its position is in m.
    fn is_linear(&self, _axis: usize) -> bool {
        false
    }
}

/// Requirements of a joint on its emulated motor. The range of the motor is [`Robot::motor_limits`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmulatedJoint {
    /// Motor angle per joint position, rad/rad or rad/m.
    pub ratio: f64,
    /// Greatest inertia of the load at the joint, kg·m² or kg.
    pub inertia: f64,
    /// Greatest velocity of the joint, rad/s or m/s.
    pub velocity: f64,
    /// Greatest effort of the joint, N·m or N.
    pub effort: f64,
}

/// Numbers that the schema of cell files describes.
#[cfg(feature = "schema")]
pub trait Keys: schemars::JsonSchema + 'static {}
#[cfg(feature = "schema")]
impl<T: schemars::JsonSchema + 'static> Keys for T {}

/// Numbers of a robot. With the feature `schema` they have a JSON schema.
#[cfg(not(feature = "schema"))]
pub trait Keys: 'static {}
#[cfg(not(feature = "schema"))]
impl<T: 'static> Keys for T {}

/// Makes a robot known to every cell file that this process reads from now on.
///
/// # Panics
///
/// If another robot has the name.
pub fn register<T: OwnRobot>() {
    let mut kinds = KINDS.write().unwrap_or_else(PoisonError::into_inner);
    let taken = kinds.iter().find(|kind| kind.name == T::MODEL);
    if taken.is_some_and(|kind| kind.id == TypeId::of::<T>()) {
        return;
    }
    let built_in = BUILT_IN.contains(&T::MODEL) || Model::ALL.iter().any(|model| model.name() == T::MODEL);
    assert!(taken.is_none() && !built_in, "two robots are called {:?}", T::MODEL);
    // A robot stays known until the process ends.
    kinds.push(Box::leak(Box::new(Kind::of::<T>())));
}

/// Names of the tables of built-in robots.
pub(super) const BUILT_IN: [&str; 7] = ["irb6", "irp6", "irp6-track", "rnt", "polycrank", "gripper", "conveyor"];

static KINDS: RwLock<Vec<&'static Kind>> = RwLock::new(Vec::new());

/// The registered robots, in the order of their registration.
fn kinds() -> Vec<&'static Kind> {
    KINDS.read().unwrap_or_else(PoisonError::into_inner).clone()
}

/// A registered robot.
struct Kind {
    name: &'static str,
    id: TypeId,
    default: fn() -> OwnParameters,
    read: fn(toml::Value) -> Result<OwnParameters, toml::de::Error>,
    /// Reads an element of a cell file, for an error with its key and line.
    check: fn(&str, &DeValue<'_>, &Path) -> Result<(), CellError>,
    #[cfg(feature = "schema")]
    schema: fn() -> schemars::Schema,
}

impl Kind {
    fn of<T: OwnRobot>() -> Self {
        Self {
            name: T::MODEL,
            id: TypeId::of::<T>(),
            default: || OwnParameters(Arc::new(T::default())),
            read: |value| Ok(OwnParameters(Arc::new(value.try_into::<T>()?))),
            check: |text, document, path| read_element::<T>(text, document, path).map(drop),
            #[cfg(feature = "schema")]
            schema: || schemars::schema_for!(T),
        }
    }
}

/// The model of a registered robot.
#[derive(Clone, Copy)]
pub struct OwnModel(&'static Kind);

impl OwnModel {
    pub(super) fn named(name: &str) -> Option<Self> {
        kinds().into_iter().find(|kind| kind.name == name).map(Self)
    }

    pub(super) fn all() -> Vec<Self> {
        kinds().into_iter().map(Self).collect()
    }

    pub(super) const fn name(self) -> &'static str {
        self.0.name
    }

    pub(super) fn parameters(self) -> OwnParameters {
        (self.0.default)()
    }

    pub(super) fn read(self, value: toml::Value) -> Result<OwnParameters, toml::de::Error> {
        (self.0.read)(value)
    }

    /// JSON schema of its numbers.
    #[cfg(feature = "schema")]
    pub(crate) fn schema(self) -> schemars::Schema {
        (self.0.schema)()
    }
}

impl fmt::Debug for OwnModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl PartialEq for OwnModel {
    fn eq(&self, other: &Self) -> bool {
        self.0.id == other.0.id
    }
}

impl Eq for OwnModel {}

/// Reads the numbers of registered robots in a document, for errors with their keys and lines.
pub(crate) fn check(text: &str, document: &DeValue<'_>) -> Result<(), CellError> {
    let kinds = kinds();
    let robots = document.get("robot").and_then(|robots| robots.get_ref().as_array());
    for (index, robot) in robots.into_iter().flatten().enumerate() {
        let parameters = robot.get_ref().get("parameters").map(|it| it.get_ref());
        for kind in &kinds {
            if parameters.is_some_and(|parameters| parameters.get(kind.name).is_some()) {
                let path = Path::to("robot").then(index).then("parameters").then(kind.name);
                (kind.check)(text, document, &path)?;
            }
        }
    }
    Ok(())
}

/// The numbers of a registered robot.
#[derive(Clone, Debug)]
pub struct OwnParameters(Arc<dyn Numbers>);

impl OwnParameters {
    pub(super) fn model(&self) -> &'static str {
        self.0.model()
    }

    pub(super) fn is_linear(&self, axis: usize) -> bool {
        self.0.is_linear(axis)
    }

    /// The numbers by their keys.
    pub fn table(&self) -> Option<toml::Table> {
        self.0.table().ok()?.as_table().cloned()
    }

    /// Motor, sensors and switches of axis `number`, with its motor at home at 0.
    pub(super) fn plant(&self, number: usize) -> Result<AxisConfig, String> {
        let robot = self.0.robot().map_err(|error| error.to_string())?;
        let (home, limits) = (robot.home()[number], robot.motor_limits()[number]);
        let EmulatedJoint { ratio, inertia, velocity, effort } = self.0.joint(number);
        let is_finite = limits.low.is_finite() && limits.high.is_finite();
        let travel = is_finite.then_some((limits.low - home, limits.high - home));
        let joint = NominalJoint { ratio, inertia, velocity, effort, home: 0.0, travel };
        AxisConfig::nominal(&joint).map_err(|error| format!("joint {number}: {error}"))
    }

    /// Refuses numbers whose robot or emulation has another number of axes, or whose robot breaks its contract.
    pub(super) fn check(&self) -> Result<(), String> {
        let robot = self.0.robot().map_err(|error| error.to_string())?;
        let axes = self.0.axes();
        let lengths = [robot.axes(), robot.joint_limits().len(), robot.motor_limits().len(), robot.home().len()];
        if lengths.iter().any(|length| *length != axes) {
            let model = self.model();
            return Err(format!("{model} states {axes} axes, and its robot has {lengths:?} limits and home positions"));
        }
        (0..axes).try_for_each(|number| self.plant(number).map(drop))?;
        examine(&*robot)
    }
}

impl Serialize for OwnParameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.table().map_err(serde::ser::Error::custom)?.serialize(serializer)
    }
}

impl RobotParameters for OwnParameters {
    fn axes(&self) -> usize {
        self.0.axes()
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        self.0.robot()
    }

    fn with_room_at_home(self, motors: &[f64]) -> Self {
        Self(self.0.with_room_at_home(motors))
    }

    fn masses(&self) -> Vec<Mass> {
        self.0.masses()
    }

    fn motors(&self) -> Vec<MotorRating> {
        self.0.motors()
    }

    fn up(&self) -> [f64; 3] {
        self.0.up()
    }
}

impl From<OwnParameters> for Parameters {
    fn from(own: OwnParameters) -> Self {
        Self::Own(own)
    }
}

/// [`OwnRobot`] without its type.
trait Numbers: fmt::Debug + Send + Sync {
    fn model(&self) -> &'static str;
    fn axes(&self) -> usize;
    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError>;
    fn with_room_at_home(&self, motors: &[f64]) -> Arc<dyn Numbers>;
    fn masses(&self) -> Vec<Mass>;
    fn motors(&self) -> Vec<MotorRating>;
    fn up(&self) -> [f64; 3];
    fn joint(&self, axis: usize) -> EmulatedJoint;
    fn is_linear(&self, axis: usize) -> bool;
    fn table(&self) -> Result<toml::Value, toml::ser::Error>;
}

impl<T: OwnRobot> Numbers for T {
    fn model(&self) -> &'static str {
        T::MODEL
    }

    fn axes(&self) -> usize {
        RobotParameters::axes(self)
    }

    fn robot(&self) -> Result<Arc<dyn Robot>, ParameterError> {
        RobotParameters::robot(self)
    }

    fn with_room_at_home(&self, motors: &[f64]) -> Arc<dyn Numbers> {
        Arc::new(RobotParameters::with_room_at_home(self.clone(), motors))
    }

    fn masses(&self) -> Vec<Mass> {
        RobotParameters::masses(self)
    }

    fn motors(&self) -> Vec<MotorRating> {
        RobotParameters::motors(self)
    }

    fn up(&self) -> [f64; 3] {
        RobotParameters::up(self)
    }

    fn joint(&self, axis: usize) -> EmulatedJoint {
        OwnRobot::joint(self, axis)
    }

    fn is_linear(&self, axis: usize) -> bool {
        OwnRobot::is_linear(self, axis)
    }

    fn table(&self) -> Result<toml::Value, toml::ser::Error> {
        toml::Value::try_from(self)
    }
}

#[cfg(test)]
mod tests {
    use controller::robot::{ConveyorParameters, Jacobian, Joints, KinematicsError, Limits, Motors, Pose, Solutions};
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
    }

    impl Default for Sledge {
        fn default() -> Self {
            Self { ratio: 100.0, wrong: 1.0 }
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
            "9: robot[0].parameters.sledge.ratoi: is an unknown key, must be \"ratio\" or \"wrong\""
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
}
