//! Data sheet of a robot: its parameters with unit, tag and source, and its position loops.

use std::fmt::Write as _;

use controller::robot::RobotParameters as _;
use mrroc::cell::{JOINT_LIMITS, Model, PLANNED};

use crate::kinematics::Machine;
use crate::robots::{Description, described};

/// Tag of a parameter, which says where its value comes from.
#[derive(Clone, Copy)]
pub(crate) enum Tag {
    /// Value from the published source code that is named.
    PublicCode(&'static str),
    /// Value calculated from published values in the way that is named.
    Derived(&'static str),
    /// Plausible value, to be replaced by a measurement.
    Nominal,
    /// Value from the cell file that differs from every preset.
    CellFile,
    /// Value from the program that registers the robot.
    Program,
}

pub(crate) const WUT: &str = "ptroja/mrrocpp, src/robot/irp6p_m";
pub(crate) const WUT_TRACK: &str = "ptroja/mrrocpp, src/robot/irp6ot_m";

/// One row of a table. `cells` are separated by `|`. The last two cells, tag and source, come from `tag`.
pub(crate) struct Row {
    pub(crate) cells: String,
    pub(crate) tag: Tag,
}

/// One row of the loop table: axes, position loop, crossover frequency in Hz, phase margin in degrees.
pub(crate) type Loop = [&'static str; 4];

/// Text for a position loop that a CiA 402 drive closes.
pub(crate) const BY_DRIVE: &str = "by the drive (CSP): emulated with a velocity loop at 45 Hz and a position loop at a fifth of it; cut open at the torque";

/// The data sheet in Markdown.
pub(crate) fn sheet(machine: &Machine) -> String {
    let described_as = described(&machine.parameters);
    // Built-in parameters of robots of the same kind.
    let mut presets: Vec<_> = Model::all().into_iter().map(Model::parameters).collect();
    presets.retain(|preset| preset.name() == machine.parameters.name());
    let presets: Vec<_> = presets.iter().map(described).collect();
    let (name, about) = (&machine.name, described_as.about);
    let of_cell = if presets.is_empty() { " --cell CELL" } else { "" };
    let mut page = format!("# {name}\n\n{about}\n\n");
    if let Some(caution) = described_as.caution {
        let _ = write!(page, "**Mind:** {caution}.\n\n");
    }
    let _ = write!(
        page,
        "![{name}]({name}.svg)\n\n## {}\n\n\
         | parameter | meaning | value | unit | tag | source |\n|---|---|--:|---|---|---|\n",
        described_as.title
    );
    lines(&mut page, &described_as, &presets, |of| &of.lengths);
    if !described_as.drives.is_empty() {
        page.push_str(
            "## Axes\n\nRanges and homes in rad, of what slides in m; the motor's in rad. Both ranges hold at once.\n\n\
             | joint | parameter | motor and joint | at home | joint range | motor range | tag | source |\n\
             |---|---|---|---|---|---|---|---|\n",
        );
        lines(&mut page, &described_as, &presets, |of| &of.drives);
    }
    joint_motions(&mut page);
    links(&mut page, machine);
    if !described_as.loops.is_empty() {
        // The values in the table are copied from results of `mrroc identify`.
        let _ = write!(
            page,
            "## Loop\n\nEmulated with nominal motors, at 10 rad/s of the motor and a period of 2 ms; as \
             `mrroc identify {}` measures it.\n\n\
             | axes | position loop | crossover, Hz | phase margin |\n|---|---|---|---|\n",
            described_as.example
        );
        for cells in described_as.loops {
            let _ = writeln!(page, "| {} |", cells.join(" | "));
        }
    }
    let _ = write!(
        page,
        "\n## Tags\n\n\
         - *public code*: read in the published source that is named.\n\
         - *derived*: follows from such numbers by arithmetic.\n\
         - *nominal*: a plausible figure, to be replaced by measurement.\n\n\
         `mrroc datasheet --robot {name}{of_cell}` prints this page, with `--figure` its figure.\n"
    );
    page
}

/// Adds the velocity and acceleration of which joint motions use fractions.
fn joint_motions(page: &mut String) {
    let ((velocity, acceleration, _), (of_velocity, of_acceleration)) = (JOINT_LIMITS, PLANNED);
    let _ = write!(
        page,
        "## Joint motions\n\nVelocity and acceleration of joint motions are fractions of {velocity} rad/s and {acceleration} \
         rad/s² ({velocity} m/s and {acceleration} m/s² of a linear joint), whatever the limits of the cell. They are less \
         where a motor would exceed {:.0} % of its `max_velocity` or {:.0} % of its `max_acceleration` in the cell \
         file.\n\n",
        100.0 * of_velocity,
        100.0 * of_acceleration
    );
}

/// Adds the table of links and motors, from which descriptions compute inertia, velocities and efforts. A row that
/// differs from that of the model is tagged as set in the cell file.
fn links(page: &mut String, machine: &Machine) {
    let links = machine.robot.links();
    if links.is_empty() {
        return;
    }
    page.push_str(
        "## Links and motors\n\nNumbers of `mrroc urdf` and of the weight of the arm. Centres of mass are in the frame of \
         the link.\n\n\
         | link | mass, kg | centre, m | motor velocity, rad/s | motor torque, N·m | tag | source |\n\
         |---|--:|---|--:|--:|---|---|\n",
    );
    let (masses, motors) = mrroc::each_robot!(&machine.parameters, it => (it.masses(), it.motors()));
    for (number, link) in links.iter().enumerate() {
        let (mass, motor) = (machine.masses.get(number), machine.motors.get(number));
        let (Some(of_link), Some(of_motor)) = (mass, motor) else {
            continue;
        };
        let [x, y, z] = of_link.centre;
        let is_of_model = mass == masses.get(number) && motor == motors.get(number);
        let tag = if is_of_model { Tag::Nominal } else { Tag::CellFile };
        let _ = writeln!(
            page,
            "| {} | {} | {x}, {y}, {z} | {} | {} | {} |",
            link.name,
            of_link.mass,
            of_motor.velocity,
            of_motor.torque,
            tag.cells()
        );
    }
    page.push('\n');
}

impl Tag {
    /// The last two cells of a row: tag and source.
    fn cells(self) -> String {
        match self {
            Self::PublicCode(source) => format!("public code | {source}"),
            Self::Derived(how) => format!("derived | {how}"),
            Self::Nominal => "nominal | none published".into(),
            Self::CellFile => "cell file | set there".into(),
            Self::Program => "program | that of the robot".into(),
        }
    }
}

/// Adds the rows of one table. A row that no preset contains is tagged as set in the cell file.
fn lines<'a>(
    page: &mut String,
    machine: &'a Description,
    presets: &'a [Description],
    table: fn(&'a Description) -> &'a Vec<Row>,
) {
    for (number, Row { cells, tag }) in table(machine).iter().enumerate() {
        let known = presets.iter().any(|preset| table(preset)[number].cells == *cells);
        let tag = if known { *tag } else { Tag::CellFile };
        let _ = writeln!(page, "| {cells} | {} |", tag.cells());
    }
    page.push('\n');
}

/// A row whose value is a number.
pub(crate) fn row(name: &str, meaning: &str, value: f64, unit: &str, tag: Tag) -> Row {
    Row { cells: format!("`{name}` | {meaning} | {value} | {unit}"), tag }
}
