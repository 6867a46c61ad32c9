//! `mrroc urdf`: a robot in the Unified Robot Description Format, generated from its kinematic parameters.
//!
//! The links are those of `base_from_flange`. Each is drawn as a rod and a drum, which are its collision shape as well.
//! Masses are the nominal ones of the model, or those of the cell. Velocities and efforts follow from the motors.
//!
//! The description of a robot of a cell has the name of the robot before the names of its links and joints, so that
//! the descriptions of several robots have no name in common.
//!
//! A robot of a cell with a scene stands on the link `world`, the frame of the cell in metres with z upward. The planes,
//! blocks, conveyors, objects, bars, workpieces and light gates of the scene are boxes fixed to this link.

mod dynamics;
mod scene;
#[cfg(test)]
mod tests;

use std::fmt::{self, Write as _};

use anyhow::{Context as _, ensure};
use controller::robot::{Link, LinkKind};
use mrroc::cell::{CellFile, EmulatedScene, Parameters};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::kinematics::{Machine, Which};
use dynamics::{JointRating, inertial};

/// Radius of the rod between two joints, m.
const ROD: f64 = 0.03;
/// Mass of a link without one of its own, kg: simulators refuse a moving link without a mass.
const LEAST: f64 = 0.01;
/// Radius and length of the drum at a joint, m.
const DRUM: (f64, f64) = (0.045, 0.09);

/// The description of a robot.
pub fn urdf(which: &Which) -> anyhow::Result<String> {
    let machine = Machine::find(which)?;
    let links = machine.robot.links();
    ensure!(!links.is_empty(), "{}: no serial arm, and no description of one", machine.name);
    let around = surroundings(which)?;
    let ratings = dynamics::ratings(&machine, &links)?;
    let mut text = String::new();
    write(&mut text, &machine, (&links[..], &ratings[..]), around.as_ref())
        .context("the description cannot be written")?;
    Ok(text)
}

/// The scene of the robot's cell and the base of the robot in its frame; `None` without a cell or a scene.
fn surroundings(which: &Which) -> anyhow::Result<Option<(EmulatedScene, Isometry3<f64>)>> {
    let Some(path) = &which.cell else {
        return Ok(None);
    };
    let cell = CellFile::read(path)?.cell;
    let robot = cell.robot.iter().find(|robot| robot.name == which.robot);
    let base = robot.map(|robot| robot.cell_from_base());
    Ok(cell.scene.clone().zip(base))
}

fn write(
    text: &mut String,
    machine: &Machine,
    (links, ratings): (&[Link], &[JointRating]),
    around: Option<&(EmulatedScene, Isometry3<f64>)>,
) -> fmt::Result {
    writeln!(text, "<?xml version=\"1.0\"?>")?;
    writeln!(text, "<!-- Metres, radians, kilograms. {}", machine.source)?;
    writeln!(text, "     Masses are nominal unless the cell states them; a link without a mass has {LEAST} kg.")?;
    writeln!(text, "     Inertia is that of a solid cylinder of the drawn size. Shapes are rods and drums. -->")?;
    if let Some(caution) = machine.caution {
        writeln!(text, "<!-- Mind: {caution}. -->")?;
    }
    let prefix = &machine.prefix;
    if let Some(legs) = machine.leg_ends() {
        writeln!(
            text,
            "<!-- The serial equivalent: the motors of alpha, beta and rho are three legs, which URDF cannot close:"
        )?;
        for [base, platform] in legs {
            let [from, to] = [base, platform].map(|point| triple(&point));
            writeln!(text, "     from {from} on {prefix}base_link to {to} on {prefix}rho_link")?;
        }
        writeln!(text, "-->")?;
    }
    writeln!(text, "<robot name=\"{}\">", escaped(&machine.name))?;
    match (around, &machine.parameters) {
        (Some((scene, world_from_base)), _) => scene::write(text, prefix, scene, world_from_base)?,
        (None, Parameters::Polycrank(_)) => mounting(text, prefix)?,
        (None, _) => {}
    }
    let rods = links.first().map(|link| rod(&link.parent_from_link.translation.vector));
    body(text, &format!("{prefix}base_link"), &[rods.flatten()], None)?;
    for (number, link) in links.iter().enumerate() {
        let onwards = links.get(number + 1).map(|next| rod(&next.parent_from_link.translation.vector));
        let parts = [Some(drum(link)), onwards.flatten(), slide(link)];
        let mass = machine.masses.get(number).map(|mass| inertial(mass, parts.iter().flatten()));
        body(text, &format!("{prefix}{}_link", link.name), &parts, mass)?;
    }
    let load = (machine.load.mass > 0.0).then(|| inertial(&machine.load, std::iter::empty()));
    body(text, &format!("{prefix}flange"), &[], load)?;
    let mut parent = format!("{prefix}base_link");
    for (link, rating) in links.iter().zip(ratings) {
        joint(text, (link, rating), prefix, &parent)?;
        parent = format!("{prefix}{}_link", link.name);
    }
    writeln!(text, "  <joint name=\"{prefix}flange_joint\" type=\"fixed\">")?;
    let link_from_flange = machine.robot.link_from_flange();
    if link_from_flange != Isometry3::identity() {
        writeln!(text, "    {}", origin(&link_from_flange))?;
    }
    writeln!(text, "    <parent link=\"{parent}\"/>\n    <child link=\"{prefix}flange\"/>\n  </joint>\n</robot>")
}

/// The floor under a base whose z axis is horizontal. The x axis of the base points up, and its z axis lies along the y
/// axis of the floor. The height is from published code. The direction of axis 1 is a choice of this description and
/// only shifts the zero of joint 1.
fn mounting(text: &mut String, prefix: &str) -> fmt::Result {
    const HEIGHT: f64 = 0.925;
    let floor_from_base = Matrix3::new(
        0.0, 1.0, 0.0, //
        0.0, 0.0, 1.0, //
        1.0, 0.0, 0.0,
    );
    let rotation = Rotation3::from_matrix_unchecked(floor_from_base);
    let floor_from_base =
        Isometry3::from_parts(Translation3::new(0.0, 0.0, HEIGHT), UnitQuaternion::from_rotation_matrix(&rotation));
    body(text, &format!("{prefix}floor"), &[], None)?;
    writeln!(text, "  <!-- Axis 1 is level, along y of the floor; base_link is the frame of base_from_flange. -->")?;
    writeln!(text, "  <joint name=\"{prefix}mounting\" type=\"fixed\">")?;
    writeln!(
        text,
        "    <parent link=\"{prefix}floor\"/>\n    <child link=\"{prefix}base_link\"/>\n    {}\n  </joint>",
        origin(&floor_from_base)
    )
}

fn joint(text: &mut String, (link, rating): (&Link, &JointRating), prefix: &str, parent: &str) -> fmt::Result {
    let kind = match link.kind {
        LinkKind::Revolute => "revolute",
        LinkKind::Continuous => "continuous",
        LinkKind::Prismatic => "prismatic",
    };
    let name = &link.name;
    let terms = link.coupling.iter().enumerate().filter(|(_, factor)| **factor != 0.0);
    let terms: Vec<_> = terms.map(|(axis, factor)| format!("{factor:+} x joint {axis}")).collect();
    if terms.len() > 1 {
        writeln!(text, "  <!-- {name} is {} of the robot's joints. -->", terms.join(" "))?;
    }
    writeln!(
        text,
        "  <joint name=\"{prefix}{name}\" type=\"{kind}\">\n    \
             <parent link=\"{parent}\"/>\n    <child link=\"{prefix}{name}_link\"/>\n    \
             {}\n    <axis xyz=\"{}\"/>",
        origin(&link.parent_from_link),
        triple(&link.axis)
    )?;
    let range = match link.kind {
        LinkKind::Continuous => String::new(),
        _ => format!("lower=\"{}\" upper=\"{}\" ", link.limits.low, link.limits.high),
    };
    let JointRating { effort, velocity } = rating;
    writeln!(text, "    <limit {range}effort=\"{effort:.6}\" velocity=\"{velocity:.6}\"/>")?;
    writeln!(text, "  </joint>")
}

/// A cylinder along the z axis of its own frame, which is given in the frame of the link.
struct Cylinder {
    link_from_cylinder: Isometry3<f64>,
    radius: f64,
    length: f64,
}

/// A link with its parts, which are drawn and collide, and with its text of mass and inertia.
fn body(text: &mut String, name: &str, parts: &[Option<Cylinder>], inertial: Option<String>) -> fmt::Result {
    writeln!(text, "  <link name=\"{name}\">")?;
    text.push_str(&inertial.unwrap_or_default());
    for Cylinder { link_from_cylinder, radius, length } in parts.iter().flatten() {
        let place = origin(link_from_cylinder);
        let shape = format!("<geometry><cylinder radius=\"{radius}\" length=\"{length}\"/></geometry>");
        writeln!(
            text,
            "    <visual>\n      {place}\n      {shape}\n      \
                 <material name=\"grey\"><color rgba=\"0.6 0.6 0.65 1\"/></material>\n    </visual>\n    \
             <collision>\n      {place}\n      {shape}\n    </collision>"
        )?;
    }
    writeln!(text, "  </link>")
}

/// A rod from the origin of a link to `end`; `None` if both coincide.
fn rod(end: &Vector3<f64>) -> Option<Cylinder> {
    let length = end.norm();
    (length > 1e-3).then(|| Cylinder {
        link_from_cylinder: Isometry3::from_parts(Translation3::from(end / 2.0), along(end)),
        radius: ROD,
        length,
    })
}

/// A drum about the axis of a link.
fn drum(link: &Link) -> Cylinder {
    let (radius, length) = DRUM;
    Cylinder { link_from_cylinder: Isometry3::from_parts(Translation3::identity(), along(&link.axis)), radius, length }
}

/// The part of a sliding link that stays inside the previous link at every position.
fn slide(link: &Link) -> Option<Cylinder> {
    (link.kind == LinkKind::Prismatic).then(|| rod(&(link.axis.as_ref() * -link.limits.low)))?
}

/// The smallest rotation of the z axis to `direction`.
fn along(direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

fn origin(pose: &Isometry3<f64>) -> String {
    let rpy = roll_pitch_yaw(&pose.rotation.to_rotation_matrix());
    format!("<origin xyz=\"{}\" rpy=\"{}\"/>", triple(&pose.translation.vector), triple(&rpy))
}

fn triple(vector: &Vector3<f64>) -> String {
    // Adding zero removes the sign of a negative zero.
    let [x, y, z] = [vector.x, vector.y, vector.z].map(|value| value + 0.0);
    format!("{x} {y} {z}")
}

/// Angles about the fixed axes x, y, z of URDF. Yaw is 0 if only its sum with roll is determined. An arc sine of the
/// pitch would lose half the digits near a right angle.
fn roll_pitch_yaw(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let level = rotation[(0, 0)].hypot(rotation[(1, 0)]);
    let pitch = (-rotation[(2, 0)]).atan2(level);
    if level > 1e-9 {
        let roll = rotation[(2, 1)].atan2(rotation[(2, 2)]);
        return Vector3::new(roll, pitch, rotation[(1, 0)].atan2(rotation[(0, 0)]));
    }
    Vector3::new((rotation[(0, 1)] * pitch.signum()).atan2(rotation[(1, 1)]), pitch, 0.0)
}

/// Text of a name for an XML attribute.
fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod geometry_tests {
    //! Rotations and rods.

    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn roll_pitch_and_yaw_are_the_rotation_even_upright() {
        for pitch in [0.0, 0.7, -1.2, FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2 - 1e-7, 1e-8 - FRAC_PI_2] {
            for (roll, yaw) in [(0.0, 0.0), (0.3, -2.0), (-3.0, 1.0), (FRAC_PI_2, FRAC_PI_2)] {
                let rotation = Rotation3::from_euler_angles(roll, pitch, yaw);
                let found = roll_pitch_yaw(&rotation);
                let again = Rotation3::from_euler_angles(found.x, found.y, found.z);
                let apart = (again.matrix() - rotation.matrix()).amax();
                assert!(apart < 1e-15, "{roll} {pitch} {yaw}: {found} {apart}");
            }
        }
    }

    #[test]
    fn a_rod_reaches_from_the_origin_to_its_end() {
        for end in [Vector3::z() * 0.5, Vector3::z() * -0.5, Vector3::new(0.1, -0.2, 0.3)] {
            let rod = rod(&end).expect("it is long enough");
            for (side, expected) in [(-0.5, Vector3::zeros()), (0.5, end)] {
                let tip = rod.link_from_cylinder * nalgebra::Point3::new(0.0, 0.0, side * rod.length);
                assert!((tip.coords - expected).norm() < 1e-15, "{end} {tip}");
            }
        }
    }
}
