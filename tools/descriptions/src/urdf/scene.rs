//! The scene of a cell in the description of a robot: surfaces and bodies as boxes, fixed to the frame of the cell.

use std::fmt::{self, Write as _};

use mrroc::cell::EmulatedScene;
use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};

use super::origin;

/// Length and width of the box that stands for a plane, and its thickness, m.
const PLANE: (f64, f64) = (4.0, 0.01);

/// Thickness of a conveyor, m.
const CONVEYOR: f64 = 0.1;

/// Width and height of the box that stands for the beam of a light gate, m.
const BEAM: f64 = 0.004;

/// Colour of surfaces at rest, of conveyors, of bodies, of workpieces, and of the beams of light gates, as red, green,
/// blue and opacity.
const SURFACE: (&str, &str) = ("surface", "0.75 0.8 0.7 0.6");
const BELT: (&str, &str) = ("belt", "0.25 0.25 0.3 1");
const BODY: (&str, &str) = ("body", "0.85 0.5 0.2 1");
const WORKPIECE: (&str, &str) = ("workpiece", "0.8 0.65 0.45 1");
const LIGHT: (&str, &str) = ("light", "0.9 0.1 0.1 0.5");

/// A box of the scene.
struct Shape {
    name: String,
    /// Frame of the box in the frame of the cell. The origin is the centre.
    world_from_box: Isometry3<f64>,
    /// Lengths of the edges, m.
    size: [f64; 3],
    colour: (&'static str, &'static str),
}

/// Writes the link `world`, the frame of the cell with z upward, the fixed joint from this link to `base_link`, and one
/// link with a fixed joint for each plane, block, conveyor, object, bar, workpiece and beam of a light gate. Bodies that
/// move stand where they begin.
///
/// The joint of the base and `base_link` have the prefix of the robot. Beams of light do not collide.
pub(super) fn write(
    text: &mut String,
    prefix: &str,
    scene: &EmulatedScene,
    world_from_base: &Isometry3<f64>,
) -> fmt::Result {
    writeln!(text, "  <!-- The scene of the cell. Planes without end are drawn {} m long and wide. -->", PLANE.0)?;
    writeln!(text, "  <link name=\"world\"/>")?;
    fixed(text, &format!("{prefix}base"), &format!("{prefix}base_link"), world_from_base)?;
    for Shape { name, world_from_box, size: [x, y, z], colour } in shapes(scene) {
        let shape = format!("<geometry><box size=\"{x} {y} {z}\"/></geometry>");
        let (named, rgba) = colour;
        writeln!(
            text,
            "  <link name=\"{name}\">\n    <visual>\n      {shape}\n      \
                 <material name=\"{named}\"><color rgba=\"{rgba}\"/></material>\n    </visual>"
        )?;
        if colour != LIGHT {
            writeln!(text, "    <collision>\n      {shape}\n    </collision>")?;
        }
        writeln!(text, "  </link>")?;
        fixed(text, &name, &name, &world_from_box)?;
    }
    Ok(())
}

/// A fixed joint from `world` to `child`.
fn fixed(text: &mut String, name: &str, child: &str, world_from_child: &Isometry3<f64>) -> fmt::Result {
    writeln!(
        text,
        "  <joint name=\"{name}_place\" type=\"fixed\">\n    \
             <parent link=\"world\"/>\n    <child link=\"{child}\"/>\n    {}\n  </joint>",
        origin(world_from_child)
    )
}

fn shapes(scene: &EmulatedScene) -> Vec<Shape> {
    let shape = |name: String, world_from_box, size, colour| Shape { name, world_from_box, size, colour };
    let planes = scene.plane.iter().enumerate().map(|(number, plane)| {
        let normal = Vector3::from(plane.normal).normalize();
        let facing = turned(&Vector3::z_axis(), &Vector3::x_axis(), &normal);
        // The solid is behind the plane.
        let centre = normal * (plane.height - PLANE.1 / 2.0);
        let pose = Isometry3::from_parts(centre.into(), facing);
        shape(format!("plane_{number}"), pose, [PLANE.0, PLANE.0, PLANE.1], SURFACE)
    });
    let blocks = scene.block.iter().enumerate().map(|(number, block)| {
        let [x, y, z] = block.centre;
        shape(format!("block_{number}"), Isometry3::translation(x, y, z), block.size, SURFACE)
    });
    let conveyors = scene.conveyor.iter().enumerate().map(|(number, conveyor)| {
        let pose = conveyor.frame() * Isometry3::translation(0.0, 0.0, -CONVEYOR / 2.0);
        let [length, width] = conveyor.size;
        shape(format!("conveyor_{number}"), pose, [length, width, CONVEYOR], BELT)
    });
    let objects = scene.object.iter().enumerate().map(|(number, object)| {
        let frame = scene.conveyor[object.conveyor].frame();
        let pose = frame * Isometry3::translation(object.along, object.across, object.size[2] / 2.0);
        shape(format!("object_{number}"), pose, object.size, BODY)
    });
    let bars = scene.bar.iter().enumerate().map(|(number, bar)| {
        shape(format!("bar_{number}"), bar.place.pose(), [bar.length, bar.width, bar.width], BODY)
    });
    let workpieces = scene.workpiece.iter().enumerate().map(|(number, workpiece)| {
        // The place is the centre of the upper face.
        let pose = workpiece.place.pose() * Isometry3::translation(0.0, 0.0, -workpiece.size[2] / 2.0);
        shape(format!("workpiece_{number}"), pose, workpiece.size, WORKPIECE)
    });
    let gates = scene.gate.iter().enumerate().map(|(number, gate)| {
        let (from, to) = (Vector3::from(gate.from), Vector3::from(gate.to));
        let along = turned(&Vector3::x_axis(), &Vector3::z_axis(), &(to - from));
        let pose = Isometry3::from_parts(((from + to) / 2.0).into(), along);
        shape(format!("gate_{number}"), pose, [(to - from).norm(), BEAM, BEAM], LIGHT)
    });
    planes.chain(blocks).chain(conveyors).chain(objects).chain(bars).chain(workpieces).chain(gates).collect()
}

/// The shortest rotation of `axis` to a direction. For the opposite direction, a half turn about `across`, which is
/// perpendicular to `axis`.
fn turned(axis: &Unit<Vector3<f64>>, across: &Unit<Vector3<f64>>, direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    let turn = UnitQuaternion::rotation_between(axis, direction);
    turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(across, std::f64::consts::PI))
}
