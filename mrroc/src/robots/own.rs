//! Robots of other crates: their keys in cell files, their kinematics and their emulation.

use std::any::TypeId;
use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};

use controller::robot::{Mass, MotorRating, Motors, ParameterError, Robot, RobotParameters};
use hil::plant::{LinkBody, LinkPoses, LinkageBodies, NominalJoint};
use hil::{AxisConfig, MechanismConfig};
use serde::de::DeserializeOwned;
use serde::{Serialize, Serializer};
use toml::de::DeValue;

use super::examination::examine_links;
use super::{Model, Parameters, Pose, examine};
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
/// Every value is read by serde: `#[serde(deny_unknown_fields)]` refuses a misspelt key. The emulated robot has one
/// motor per axis. All numbers of these motors are nominal. The motors move the [links](Self::emulated_links) of the
/// robot; without links, each motor moves a load of its own.
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

    /// The links that the emulated motors move, at most 16. [`place_links`](Self::place_links) gives their poses, from
    /// which the emulator computes inertia, weight, Coriolis and centrifugal torques of all motors. Gravity acts
    /// against [`RobotParameters::up`].
    fn emulated_links(&self) -> Vec<EmulatedLink> {
        Vec::new()
    }

    /// Writes poses in the base frame: the pose of each link, then the pose of the flange. The motors are at these
    /// angles, rad, counted as in [`Robot::home`]. Returns false if the links cannot take such a pose.
    ///
    /// The emulator uses this function alone. Write it without the functions of [`Robot`], so that an error in either
    /// of them is detected. The flange is compared with [`Robot::forward`] when a cell is read. The function is called
    /// many times per millisecond, so it must not allocate.
    fn place_links(&self, _motors: &[f64], _poses: &mut [Pose]) -> bool {
        false
    }
}

/// A link of an emulated robot.
pub type EmulatedLink = LinkBody;

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
        AxisConfig::nominal(&self.demand(&*robot, number)).map_err(|error| format!("joint {number}: {error}"))
    }

    /// Requirements of a joint on its motor, whose angle is 0 at home.
    fn demand(&self, robot: &dyn Robot, number: usize) -> NominalJoint {
        let (home, limits) = (robot.home()[number], robot.motor_limits()[number]);
        let EmulatedJoint { ratio, inertia, velocity, effort } = self.0.joint(number);
        let is_finite = limits.low.is_finite() && limits.high.is_finite();
        let travel = is_finite.then_some((limits.low - home, limits.high - home));
        NominalJoint { ratio, inertia, velocity, effort, home: 0.0, travel }
    }

    /// The links that the motors move; `None` where each motor moves a load of its own.
    pub(super) fn mechanism(&self) -> Result<Option<MechanismConfig>, String> {
        let links = self.0.emulated_links();
        if links.is_empty() {
            return Ok(None);
        }
        let robot = self.0.robot().map_err(|error| error.to_string())?;
        let joints: Vec<_> = (0..self.0.axes()).map(|number| self.demand(&*robot, number)).collect();
        let ratios: Vec<_> = joints.iter().map(|joint| joint.ratio).collect();
        let rotors: Vec<_> = joints.iter().map(NominalJoint::rotor_inertia).collect();
        let poses = Arc::new(Placed { numbers: Arc::clone(&self.0), home: robot.home() });
        let bodies = LinkageBodies::new(poses, &links, self.0.up(), &ratios, &rotors);
        bodies.map(|bodies| Some(MechanismConfig::Linkage(Arc::new(bodies)))).map_err(|error| error.to_string())
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
        examine(&*robot)?;
        if self.mechanism()?.is_none() {
            return Ok(());
        }
        let mut poses = vec![Pose::identity(); self.0.emulated_links().len() + 1];
        examine_links(&*robot, |motors| self.0.place_links(motors, &mut poses).then(|| poses.last().copied()).flatten())
    }
}

/// Poses of the links of a robot, from the angles of its motors from home.
#[derive(Debug)]
struct Placed {
    numbers: Arc<dyn Numbers>,
    home: Motors,
}

impl LinkPoses for Placed {
    fn place(&self, motors: &[f64], poses: &mut [Pose]) -> bool {
        let mut angles = self.home;
        angles.iter_mut().zip(motors).for_each(|(angle, motor)| *angle += motor);
        self.numbers.place_links(&angles, poses)
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
    fn emulated_links(&self) -> Vec<EmulatedLink>;
    fn place_links(&self, motors: &[f64], poses: &mut [Pose]) -> bool;
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

    fn emulated_links(&self) -> Vec<EmulatedLink> {
        OwnRobot::emulated_links(self)
    }

    fn place_links(&self, motors: &[f64], poses: &mut [Pose]) -> bool {
        OwnRobot::place_links(self, motors, poses)
    }

    fn table(&self) -> Result<toml::Value, toml::ser::Error> {
        toml::Value::try_from(self)
    }
}

#[cfg(test)]
mod tests;
