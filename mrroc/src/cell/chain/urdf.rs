//! A serial chain out of a robot description in URDF: the joints on the way from a base link to a flange link.
//!
//! Fixed joints on the way are folded into their neighbours, with the masses of their links. Everything beside the way
//! is left out and listed. Meshes are not read.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};

use controller::robot::LinkKind;

use super::body::Body;

/// The chain of a description.
#[derive(Clone, Debug)]
pub struct DescribedRobot {
    /// The moving joints from base to flange.
    pub joints: Vec<DescribedJoint>,
    /// The flange in the frame of the last moving joint.
    pub link_from_flange: Isometry3<f64>,
    /// The base link.
    pub base: String,
    /// The flange link.
    pub flange: String,
    /// Moving joints beside the way from base to flange. They are left out.
    pub left_out: Vec<String>,
}

/// One moving joint of a description, and the link that it moves.
#[derive(Clone, Debug)]
pub struct DescribedJoint {
    /// Its name.
    pub name: String,
    /// Kind of motion.
    pub kind: LinkKind,
    /// Frame of the joint in the frame of the previous moving joint or of the base, with the joint at zero.
    pub parent_from_joint: Isometry3<f64>,
    /// Axis of the motion in the frame of the joint.
    pub axis: [f64; 3],
    /// Lower and upper limit, rad or m.
    pub limits: Option<(f64, f64)>,
    /// Greatest velocity, rad/s or m/s; `None` where the file says nothing or 0.
    pub velocity: Option<f64>,
    /// Greatest effort, N·m or N; `None` where the file says nothing or 0.
    pub effort: Option<f64>,
    /// The moved links; `None` where none of them has a mass.
    pub body: Option<Body>,
}

/// A joint of the file, of any kind.
struct FileJoint<'a> {
    node: Node<'a, 'a>,
    name: &'a str,
    kind: &'a str,
    parent: &'a str,
    child: &'a str,
}

/// Greatest number of a description, in its units: products of two stay finite.
const MOST: f64 = 1e9;

/// What is wrong, after the line of the file.
type Refused = String;

/// Reads the chain from `base`, by default the root, to `flange`, by default the only end of the tree. An error is the line
/// of the file and the problem, as `LINE: PROBLEM`.
pub fn read(text: &str, base: Option<&str>, flange: Option<&str>) -> Result<DescribedRobot, Refused> {
    let document = Document::parse(text).map_err(|error| format!("{}: is no XML: {error}", error.pos().row))?;
    let robot = document.root_element();
    let at = |node: Node<'_, '_>, problem: String| format!("{}: {problem}", line(node));
    if let Some(macro_) = document.descendants().find(|node| is_xacro(*node)) {
        let problem = "is a xacro file: write it out by `xacro FILE.xacro > FILE.urdf` and name that file".to_owned();
        return Err(at(macro_, problem));
    }
    if robot.tag_name().name() != "robot" {
        let problem = format!("begins with <{}>, a URDF file with <robot>", robot.tag_name().name());
        return Err(at(robot, problem));
    }
    let links = links(robot)?;
    let joints = joints(robot, &links)?;
    let root = base.map_or_else(|| root(robot, &links, &joints), |base| Ok(base.to_owned()))?;
    let end = flange.map_or_else(|| end(robot, &links, &joints, &root), |flange| Ok(flange.to_owned()))?;
    for (what, name) in [("base", &root), ("flange", &end)] {
        if !links.iter().any(|(link, _)| link == name) {
            let all: Vec<_> = links.iter().map(|(link, _)| *link).collect();
            return Err(at(robot, format!("has no link {name:?} for the {what}; there are {}", all.join(", "))));
        }
    }
    let way = way(&joints, &root, &end).map_err(|problem| at(robot, problem))?;
    let on_the_way = |joint: &FileJoint<'_>| way.iter().any(|it| it.name == joint.name);
    let beside = joints.iter().filter(|joint| joint.kind != "fixed" && !on_the_way(joint));
    let left_out = beside.map(|joint| joint.name.to_owned()).collect();

    let mut chain: Vec<DescribedJoint> = Vec::new();
    // From the frame of the last moving joint, or of the base, to the link that the way has come to.
    let mut frame = Isometry3::identity();
    for joint in way {
        let parent_from_child = frame * origin(joint.node)?;
        let link = links.iter().find(|(name, _)| *name == joint.child).expect("joints name links of the file").1;
        let body = inertial(link)?;
        let kind = match joint.kind {
            "fixed" => {
                frame = parent_from_child;
                // What is fixed to the base does not move.
                if let (Some(last), Some(body)) = (chain.last_mut(), body) {
                    let placed = body.placed(&frame);
                    last.body = Some(last.body.map_or(placed, |last| last.and(&placed)));
                }
                continue;
            }
            "revolute" => LinkKind::Revolute,
            "continuous" => LinkKind::Continuous,
            "prismatic" => LinkKind::Prismatic,
            other => {
                let problem =
                    format!("joint {:?} is {other}: revolute, continuous, prismatic and fixed are known", joint.name);
                return Err(at(joint.node, problem));
            }
        };
        if let Some(mimic) = child(joint.node, "mimic") {
            let problem = format!(
                "joint {:?} between base and flange follows another joint (mimic): end the chain before it, and make a gripper \
                 a robot of its own",
                joint.name
            );
            return Err(at(mimic, problem));
        }
        let axis = child(joint.node, "axis").map(|axis| triple(axis, "xyz")).transpose()?.flatten();
        let limit = child(joint.node, "limit");
        let known = |key| -> Result<Option<f64>, Refused> {
            Ok(limit.map(|limit| number(limit, key)).transpose()?.flatten().filter(|value| *value > 0.0))
        };
        chain.push(DescribedJoint {
            name: joint.name.to_owned(),
            kind,
            parent_from_joint: parent_from_child,
            axis: axis.unwrap_or([1.0, 0.0, 0.0]),
            limits: match limit {
                Some(limit) if kind != LinkKind::Continuous => {
                    Some((number(limit, "lower")?.unwrap_or(0.0), number(limit, "upper")?.unwrap_or(0.0)))
                }
                _ => None,
            },
            velocity: known("velocity")?,
            effort: known("effort")?,
            body,
        });
        frame = Isometry3::identity();
    }
    if chain.is_empty() {
        return Err(at(robot, format!("has no moving joint between {root:?} and {end:?}")));
    }
    Ok(DescribedRobot { joints: chain, link_from_flange: frame, base: root, flange: end, left_out })
}

fn line(node: Node<'_, '_>) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

fn is_xacro(node: Node<'_, '_>) -> bool {
    const XACRO: [&str; 2] = ["http://www.ros.org/wiki/xacro", "http://ros.org/wiki/xacro"];
    node.is_element() && node.tag_name().namespace().is_some_and(|space| XACRO.contains(&space))
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|child| child.has_tag_name(name))
}

/// The links with their names, each once.
fn links<'a>(robot: Node<'a, 'a>) -> Result<Vec<(&'a str, Node<'a, 'a>)>, Refused> {
    let mut links: Vec<(&str, Node<'_, '_>)> = Vec::new();
    for link in robot.children().filter(|node| node.has_tag_name("link")) {
        let name = attribute(link, "name")?;
        if links.iter().any(|(other, _)| *other == name) {
            return Err(format!("{}: link {name:?} is described twice", line(link)));
        }
        links.push((name, link));
    }
    Ok(links)
}

fn joints<'a>(robot: Node<'a, 'a>, links: &[(&str, Node<'a, 'a>)]) -> Result<Vec<FileJoint<'a>>, Refused> {
    let mut joints: Vec<FileJoint<'_>> = Vec::new();
    for node in robot.children().filter(|node| node.has_tag_name("joint")) {
        let name = attribute(node, "name")?;
        let end = |which: &str| -> Result<&'a str, Refused> {
            let end = child(node, which).ok_or_else(|| format!("{}: joint {name:?} has no <{which}>", line(node)))?;
            let link = attribute(end, "link")?;
            if !links.iter().any(|(known, _)| *known == link) {
                return Err(format!("{}: joint {name:?} names link {link:?}, which the file does not have", line(end)));
            }
            Ok(link)
        };
        let joint =
            FileJoint { node, name, kind: attribute(node, "type")?, parent: end("parent")?, child: end("child")? };
        if joints.iter().any(|other| other.name == name) {
            return Err(format!("{}: joint {name:?} is described twice", line(node)));
        }
        if let Some(other) = joints.iter().find(|other| other.child == joint.child) {
            let problem = format!("link {:?} is the child of the joints {:?} and {name:?}", joint.child, other.name);
            return Err(format!("{}: {problem}: a URDF is a tree", line(node)));
        }
        joints.push(joint);
    }
    Ok(joints)
}

/// The only link that no joint moves.
fn root(robot: Node<'_, '_>, links: &[(&str, Node<'_, '_>)], joints: &[FileJoint<'_>]) -> Result<String, Refused> {
    let roots = links.iter().filter(|(link, _)| !joints.iter().any(|joint| joint.child == *link));
    let roots: Vec<_> = roots.map(|(link, _)| *link).collect();
    match roots[..] {
        [root] => Ok(root.to_owned()),
        [] => Err(format!("{}: no link is the base: every link is the child of a joint", line(robot))),
        _ => Err(format!(
            "{}: several links could be the base ({}): choose one by `base`",
            line(robot),
            roots.join(", ")
        )),
    }
}

/// The only end of the tree beyond `base`.
fn end(
    robot: Node<'_, '_>,
    links: &[(&str, Node<'_, '_>)],
    joints: &[FileJoint<'_>],
    base: &str,
) -> Result<String, Refused> {
    let is_beyond = |link: &str| way(joints, base, link).is_ok();
    let is_end = |link: &str| !joints.iter().any(|joint| joint.parent == link);
    let ends: Vec<_> = links.iter().map(|(link, _)| *link).filter(|link| is_end(link) && is_beyond(link)).collect();
    match ends[..] {
        [end] => Ok(end.to_owned()),
        [] => Err(format!("{}: has no link beyond {base:?}", line(robot))),
        _ => {
            let problem = format!("several links could be the flange ({}): choose one by `flange`", ends.join(", "));
            Err(format!("{}: {problem}", line(robot)))
        }
    }
}

/// The joints from the link `base` to the link `flange`, in this order.
fn way<'a, 'b>(joints: &'b [FileJoint<'a>], base: &str, flange: &str) -> Result<Vec<&'b FileJoint<'a>>, String> {
    let mut way: Vec<&FileJoint<'_>> = Vec::new();
    let mut link = flange;
    while link != base {
        let joint = joints.iter().find(|joint| joint.child == link);
        let joint = joint.filter(|joint| !way.iter().any(|it| it.name == joint.name));
        let Some(joint) = joint else {
            return Err(format!("has no way from {base:?} to {flange:?}: it ends at {link:?}"));
        };
        way.push(joint);
        link = joint.parent;
    }
    way.reverse();
    Ok(way)
}

/// Mass, centre and inertia of a link, in the frame of the link.
fn inertial(link: Node<'_, '_>) -> Result<Option<Body>, Refused> {
    let Some(inertial) = child(link, "inertial") else {
        return Ok(None);
    };
    let mass = child(inertial, "mass").map(|mass| number(mass, "value")).transpose()?.flatten().unwrap_or(0.0);
    if mass < 0.0 {
        return Err(format!("{}: a mass of {mass} kg is below zero", line(inertial)));
    }
    if mass == 0.0 {
        return Ok(None);
    }
    let place = origin(inertial)?;
    let mut inertia = Matrix3::zeros();
    if let Some(given) = child(inertial, "inertia") {
        let of = |key| Ok::<_, Refused>(number(given, key)?.unwrap_or(0.0));
        let (xx, yy, zz, xy, xz, yz) = (of("ixx")?, of("iyy")?, of("izz")?, of("ixy")?, of("ixz")?, of("iyz")?);
        inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    }
    Ok(Some(Body { mass, centre: Vector3::zeros(), inertia }.placed(&place)))
}

/// The `<origin>` of an element; none where absent.
fn origin(node: Node<'_, '_>) -> Result<Isometry3<f64>, Refused> {
    let Some(origin) = child(node, "origin") else {
        return Ok(Isometry3::identity());
    };
    let [x, y, z] = triple(origin, "xyz")?.unwrap_or_default();
    let [roll, pitch, yaw] = triple(origin, "rpy")?.unwrap_or_default();
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

fn attribute<'a>(node: Node<'a, 'a>, name: &str) -> Result<&'a str, Refused> {
    let missing = || format!("{}: <{}> has no attribute {name}", line(node), node.tag_name().name());
    node.attribute(name).ok_or_else(missing)
}

fn number(node: Node<'_, '_>, name: &str) -> Result<Option<f64>, Refused> {
    node.attribute(name).map(|text| finite(node, name, text)).transpose()
}

fn triple(node: Node<'_, '_>, name: &str) -> Result<Option<[f64; 3]>, Refused> {
    let Some(text) = node.attribute(name) else {
        return Ok(None);
    };
    let numbers: Vec<f64> = text.split_whitespace().map(|text| finite(node, name, text)).collect::<Result<_, _>>()?;
    let count = numbers.len();
    let three =
        numbers.try_into().map_err(|_| format!("{}: {name} has {count} numbers, must have three", line(node)))?;
    Ok(Some(three))
}

fn finite(node: Node<'_, '_>, name: &str, text: &str) -> Result<f64, Refused> {
    let number = text.trim().parse().ok().filter(|number: &f64| number.abs() <= MOST);
    number.ok_or_else(|| format!("{}: {name}={text:?} is no number between -1e9 and 1e9", line(node)))
}
