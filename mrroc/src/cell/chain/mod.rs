//! The key `chain` of a robot: any serial arm, from a robot description in URDF or from a table of joints.

mod body;
#[cfg(test)]
mod tests;
mod urdf;

use controller::robot::{ChainJoint, ChainParameters, Limits, LinkBody, LinkKind, Pose};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{Cell, Path, quoted};

pub use body::Body;
pub use urdf::{DescribedJoint, DescribedRobot, read as read_urdf};

/// A serial arm of 1 to 8 joints, for `model = "chain"`: from a description in URDF, or from the table `joint` alone.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ChainSettings {
    /// File with a robot description in URDF, relative to the cell file. Its fixed joints are folded; joints beside the way
    /// from `base` to `flange` are left out; a limit of 0 for velocity or effort means unknown; meshes are not read.
    pub urdf: Option<String>,
    /// Link of the description that is the base; the root where absent.
    pub base: Option<String>,
    /// Link of the description that is the flange; the only end of the tree where absent.
    pub flange: Option<String>,
    /// Meaning of the keys `dh`.
    pub convention: Convention,
    /// The joints from base to flange. With a description: what it does not know of each of its joints, and what is to differ.
    pub joint: Vec<JointSettings>,
    /// The flange in the frame of the last joint, in place of that of the description.
    pub link_from_flange: Option<Frame>,
    /// Direction against gravity in the base frame, of any length.
    pub up: Option<[f64; 3]>,
    /// Motor positions per joint position, row by row, rad/rad (rad/m for a linear joint): belts and differential wrists. The
    /// keys `ratio` and `lead` have no effect beside it.
    pub motors_from_joints: Option<Vec<Vec<f64>>>,
    /// Direction in the flange frame about which the tool may turn freely, of any length, for example that of a pen.
    pub free_axis: Option<[f64; 3]>,
    /// The numbers of the chain, once its description was read.
    #[serde(skip)]
    pub(super) numbers: Option<ChainParameters>,
}

/// One joint of a chain, and the link that it moves.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointSettings {
    /// Name of the joint, which is that of the description.
    pub name: String,
    /// Kind of motion; that of the description where absent.
    pub kind: Option<LinkKind>,
    /// Frame of the joint in the frame of the previous one, with the joint at zero: `origin` of URDF.
    pub origin: Option<Frame>,
    /// Frame of the joint by Denavit and Hartenberg, in place of `origin` and `axis`.
    pub dh: Option<DenavitHartenberg>,
    /// Axis of rotation or translation in the frame of the joint, of any length; that of the description, or z, where absent.
    pub axis: Option<[f64; 3]>,
    /// Range of the joint, rad, or m of a linear joint.
    pub limits: Option<Limits>,
    /// Greatest velocity, rad/s, or m/s of a linear joint.
    pub velocity: Option<f64>,
    /// Greatest effort, N·m, or N of a linear joint.
    pub effort: Option<f64>,
    /// Motor angle per joint angle, or per metre of a linear joint, rad/m; negative if they turn in opposite directions.
    pub ratio: Option<f64>,
    /// Travel of a linear joint per turn of its motor, m, in place of `ratio`.
    pub lead: Option<f64>,
    /// Joint position at home, rad or m: where homing leaves the axis. 0 where absent.
    pub joint_at_home: Option<f64>,
    /// Motor position at home, rad. 0 where absent.
    pub motor_at_home: Option<f64>,
    /// Mass of the moved link with its inertia, in place of that of the description.
    pub body: Option<LinkBody>,
}

/// A frame in another one: translation, then the rotations about the fixed axes x, y and z, as in URDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct Frame {
    /// Translation, m.
    pub xyz: [f64; 3],
    /// Roll, pitch and yaw, rad.
    pub rpy: [f64; 3],
}

/// Parameters of one joint by Denavit and Hartenberg.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DenavitHartenberg {
    /// Length along x, m.
    pub a: f64,
    /// Twist about x, rad.
    pub alpha: f64,
    /// Offset along z, m; of a linear joint, its part that does not move.
    pub d: f64,
    /// Angle about z, rad; of a revolute joint, its part that does not move.
    pub theta: f64,
}

/// The two conventions of Denavit and Hartenberg.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Convention {
    /// θ and d about the axis of the joint, then a and α: frame i stands on axis i+1.
    #[default]
    Standard,
    /// a and α first, then θ and d about the axis of the joint (Craig): frame i stands on axis i.
    Modified,
}

impl Frame {
    fn pose(&self) -> Pose {
        let [x, y, z] = self.xyz;
        let [roll, pitch, yaw] = self.rpy;
        Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
    }
}

impl DenavitHartenberg {
    /// The part about and along the z axis of the joint.
    fn along_z(&self) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.theta);
        Isometry3::from_parts(Translation3::new(0.0, 0.0, self.d), turn)
    }

    /// The part about and along the x axis.
    fn along_x(&self) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.alpha);
        Isometry3::from_parts(Translation3::new(self.a, 0.0, 0.0), turn)
    }
}

/// A value, or the refused key and why.
type Resolved<T> = Result<T, (Path, String)>;

/// Reads the chains of a cell. Each robot has a model or a chain.
pub(super) fn resolve(cell: &mut Cell, read: &mut dyn FnMut(&str) -> Result<String, String>) -> Resolved<()> {
    for (index, robot) in cell.robot.iter_mut().enumerate() {
        let path = Path::to("robot").then(index);
        let Some(chain) = &mut robot.chain else {
            if robot.model.is_none() {
                let why = "is missing: name a model, or describe the arm by chain".to_owned();
                return Err((path.then("model"), why));
            }
            continue;
        };
        for (key, given) in [("model", robot.model.is_some()), ("parameters", robot.parameters.is_some())] {
            if given {
                return Err((path.then(key), "has no effect beside chain: leave one of them out".to_owned()));
            }
        }
        let path = path.then("chain");
        let numbers = chain.resolve(&path, read)?;
        chain.numbers = Some(numbers);
    }
    Ok(())
}

impl ChainSettings {
    /// The numbers of the chain at `path`. `read` gives the content of a file that the cell names.
    fn resolve(&self, path: &Path, read: &mut dyn FnMut(&str) -> Result<String, String>) -> Resolved<ChainParameters> {
        let joints = path.then("joint");
        let at = |number: usize, key: &'static str, why: String| Err((joints.then(number).then(key), why));
        for (number, joint) in self.joint.iter().enumerate() {
            let beside_dh = [("origin", joint.origin.is_some()), ("axis", joint.axis.is_some())];
            if let Some((key, _)) = beside_dh.into_iter().find(|(_, given)| *given && joint.dh.is_some()) {
                return at(number, key, "has no effect beside dh: leave one of them out".to_owned());
            }
            let of_matrix = [("ratio", joint.ratio), ("lead", joint.lead)];
            if let Some((key, _)) =
                of_matrix.into_iter().find(|(_, it)| it.is_some() && self.motors_from_joints.is_some())
            {
                return at(number, key, "has no effect beside motors_from_joints: leave it out".to_owned());
            }
            if joint.ratio.is_some() && joint.lead.is_some() {
                return at(number, "lead", "is given beside ratio: leave one of them out".to_owned());
            }
            if joint.lead == Some(0.0) {
                return at(number, "lead", "is 0: the motor would not move the joint".to_owned());
            }
        }
        let Some(name) = &self.urdf else {
            return self.alone(path);
        };
        let refused = |problem: String| (path.then("urdf"), format!("{name} {problem}"));
        let text = read(name).map_err(|problem| (path.then("urdf"), format!("{name}: {problem}")))?;
        let described = urdf::read(&text, self.base.as_deref(), self.flange.as_deref())
            .map_err(|problem| (path.then("urdf"), format!("{name}:{problem}")))?;
        for (number, joint) in self.joint.iter().enumerate() {
            if !described.joints.iter().any(|it| it.name == joint.name) {
                let known: Vec<_> = described.joints.iter().map(|it| it.name.as_str()).collect();
                let why = format!("is {}, must be a joint of {name}: {}", quoted(&joint.name), known.join(", "));
                return at(number, "name", why);
            }
            if joint.dh.is_some() {
                return at(number, "dh", "has no effect beside urdf: leave it out, or give origin and axis".to_owned());
            }
        }
        let mut chain = ChainParameters {
            joints: Vec::new(),
            link_from_flange: self.link_from_flange.map_or(described.link_from_flange, |it| it.pose()),
            up: self.up.unwrap_or([0.0, 0.0, 1.0]),
            motors_from_joints: self.motors_from_joints.clone(),
            free_axis: self.free_axis,
        };
        for joint in &described.joints {
            let given = self.joint.iter().position(|it| it.name == joint.name);
            let Some(number) = given else {
                let why = format!("has no joint {}, whose ratio is unknown to {name}: add it", quoted(&joint.name));
                return Err((joints, why));
            };
            let settings = &self.joint[number];
            let kind = settings.kind.unwrap_or(joint.kind);
            let Some(limits) =
                settings.limits.or(joint.limits.map(|(low, high)| Limits { low, high })).or(continuous(kind))
            else {
                return Err(refused(format!("gives joint {} no limits: add limits to it here", quoted(&joint.name))));
            };
            chain.joints.push(ChainJoint {
                name: joint.name.clone(),
                kind,
                parent_from_joint: settings.origin.map_or(joint.parent_from_joint, |it| it.pose()),
                axis: settings.axis.unwrap_or(joint.axis),
                limits,
                velocity: settings.velocity.or(joint.velocity),
                effort: settings.effort.or(joint.effort),
                ratio: self.ratio(&joints.then(number), settings, kind)?,
                joint_at_home: settings.joint_at_home.unwrap_or(0.0),
                motor_at_home: settings.motor_at_home.unwrap_or(0.0),
                body: settings.body.or(joint.body.map(|body| LinkBody {
                    mass: body.mass,
                    centre: body.centre.into(),
                    inertia: body.components(),
                })),
            });
        }
        Ok(chain)
    }

    /// The chain of the table of joints.
    fn alone(&self, path: &Path) -> Resolved<ChainParameters> {
        let joints = path.then("joint");
        for (key, given) in [("base", &self.base), ("flange", &self.flange)] {
            if given.is_some() {
                return Err((path.then(key), "has no effect without urdf: leave it out".to_owned()));
            }
        }
        if self.joint.is_empty() {
            return Err((path.then("joint"), "has no joints: name a description by urdf, or add joints".to_owned()));
        }
        let mut chain = ChainParameters {
            joints: Vec::new(),
            link_from_flange: Isometry3::identity(),
            up: self.up.unwrap_or([0.0, 0.0, 1.0]),
            motors_from_joints: self.motors_from_joints.clone(),
            free_axis: self.free_axis,
        };
        // From the frame of the last joint to that in which the next one is given.
        let mut behind = Isometry3::identity();
        for (number, joint) in self.joint.iter().enumerate() {
            let path = joints.then(number);
            let Some(kind) = joint.kind else {
                return Err((path.then("kind"), "is missing: only a description by urdf knows it".to_owned()));
            };
            let Some(limits) = joint.limits.or(continuous(kind)) else {
                return Err((path.then("limits"), "is missing: only a continuous joint has none".to_owned()));
            };
            let (frame, onward) = match (&joint.dh, self.convention) {
                (None, _) => (joint.origin.unwrap_or_default().pose(), Isometry3::identity()),
                // The fixed parts along the axis commute with the motion about and along it.
                (Some(dh), Convention::Standard) => (Isometry3::identity(), dh.along_z() * dh.along_x()),
                (Some(dh), Convention::Modified) => (dh.along_x() * dh.along_z(), Isometry3::identity()),
            };
            chain.joints.push(ChainJoint {
                name: joint.name.clone(),
                kind,
                parent_from_joint: behind * frame,
                axis: joint.axis.unwrap_or([0.0, 0.0, 1.0]),
                limits,
                velocity: joint.velocity,
                effort: joint.effort,
                ratio: self.ratio(&path, joint, kind)?,
                joint_at_home: joint.joint_at_home.unwrap_or(0.0),
                motor_at_home: joint.motor_at_home.unwrap_or(0.0),
                body: joint.body,
            });
            behind = onward;
        }
        chain.link_from_flange = behind * self.link_from_flange.unwrap_or_default().pose();
        Ok(chain)
    }

    fn ratio(&self, joint: &Path, settings: &JointSettings, kind: LinkKind) -> Resolved<f64> {
        if self.motors_from_joints.is_some() {
            return Ok(1.0);
        }
        match (settings.ratio, settings.lead) {
            (Some(ratio), _) => Ok(ratio),
            (None, Some(lead)) if kind == LinkKind::Prismatic => Ok(std::f64::consts::TAU / lead),
            (None, Some(_)) => Err((joint.then("lead"), "is of a linear joint: give a ratio".to_owned())),
            (None, None) => Err((joint.then("ratio"), "is missing: how far the motor turns per joint".to_owned())),
        }
    }
}

/// The limits of a joint that needs none.
fn continuous(kind: LinkKind) -> Option<Limits> {
    (kind == LinkKind::Continuous).then_some(Limits::CONTINUOUS)
}
