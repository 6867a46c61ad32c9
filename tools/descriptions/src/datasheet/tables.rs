//! Data sheet of a robot: its parameters with unit, tag and source.

use std::fmt::Write as _;
use std::mem::discriminant;

use mrroc::cell::{Model, Parameters};

use super::drives::Drive;
use super::loops;
use crate::kinematics::Machine;
use crate::robots::described;

/// Source of a number.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Tag {
    /// Read in published source.
    PublicCode(&'static str),
    /// Derived from published numbers.
    Derived(&'static str),
    /// Plausible value, to be replaced by a measurement.
    Nominal,
    /// A number from the cell file that differs from the default.
    CellFile,
}

pub(crate) const WUT: &str = "ptroja/mrrocpp, src/robot/irp6p_m";
pub(crate) const WUT_TRACK: &str = "ptroja/mrrocpp, src/robot/irp6ot_m";

/// One parameter, with its name in a cell file.
pub(crate) struct Row {
    pub(crate) name: String,
    pub(crate) meaning: &'static str,
    pub(crate) value: String,
    pub(crate) unit: &'static str,
    pub(crate) tag: Tag,
}

/// The data sheet in Markdown.
pub(crate) fn sheet(machine: &Machine) -> String {
    let mut page = String::new();
    let _ = write!(
        page,
        "# {}\n\n{}\n\n",
        machine.name,
        described(&machine.parameters).about()
    );
    if let Some(caution) = machine.caution {
        let _ = write!(page, "**Mind:** {caution}.\n\n");
    }
    let _ = write!(page, "![{0}]({0}.svg)\n\n", machine.name);
    geometry(&mut page, machine);
    drives(&mut page, machine);
    loops::section(&mut page, &machine.parameters);
    footer(&mut page, &machine.name);
    page
}

/// Meaning of the tags, and how the page is generated.
fn footer(page: &mut String, name: &str) {
    let _ = write!(
        page,
        "## Tags\n\n\
         - *public code*: read in the published source that is named.\n\
         - *derived*: follows from such numbers by arithmetic.\n\
         - *nominal*: a plausible figure, to be replaced by measurement.\n\n\
         `mrroc datasheet --robot {name}` prints this page, with `--figure` its figure.\n"
    );
}

impl Tag {
    /// Two cells of a table.
    fn cells(self) -> String {
        match self {
            Self::PublicCode(source) => format!("public code | {source}"),
            Self::Derived(how) => format!("derived | {how}"),
            Self::Nominal => "nominal | none published".into(),
            Self::CellFile => "cell file | set there".into(),
        }
    }
}

fn geometry(page: &mut String, machine: &Machine) {
    let presets: Vec<_> = presets(&machine.parameters)
        .map(|preset| described(&preset).lengths())
        .collect();
    let title = described(&machine.parameters).title();
    let _ = write!(
        page,
        "## {title}\n\n| parameter | meaning | value | unit | tag | source |\n|---|---|--:|---|---|---|\n"
    );
    for (number, row) in described(&machine.parameters)
        .lengths()
        .into_iter()
        .enumerate()
    {
        let known = presets
            .iter()
            .any(|preset| preset[number].value == row.value);
        let tag = if known { row.tag } else { Tag::CellFile };
        let Row {
            name,
            meaning,
            value,
            unit,
            ..
        } = row;
        let _ = writeln!(
            page,
            "| `{name}` | {meaning} | {value} | {unit} | {} |",
            tag.cells()
        );
    }
    page.push('\n');
}

fn drives(page: &mut String, machine: &Machine) {
    let drives = described(&machine.parameters).drives();
    if drives.is_empty() {
        return;
    }
    let presets: Vec<_> = presets(&machine.parameters)
        .map(|preset| described(&preset).drives())
        .collect();
    page.push_str(
        "## Axes\n\nRanges and homes in rad, of what slides in m; the motor's in rad. Both ranges hold at once.\n\n\
         | joint | parameter | motor and joint | at home | joint range | motor range | tag | source |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for (number, drive) in drives.into_iter().enumerate() {
        let known = presets
            .iter()
            .any(|preset| preset[number].numbers() == drive.numbers());
        let tag = if known { drive.tag } else { Tag::CellFile };
        let Drive {
            joint,
            name,
            transmission,
            home,
            joints,
            motors,
            ..
        } = drive;
        let _ = writeln!(
            page,
            "| {joint} | `{name}` | {transmission} | {home} | {joints} | {motors} | {} |",
            tag.cells()
        );
    }
    page.push('\n');
}

/// The project's own numbers of that kind.
fn presets(parameters: &Parameters) -> impl Iterator<Item = Parameters> {
    let kind = discriminant(parameters);
    let all = Model::ALL.into_iter().map(Model::parameters);
    all.filter(move |preset| discriminant(preset) == kind)
}

/// A row whose value is a number.
pub(crate) fn row(
    name: &str,
    meaning: &'static str,
    value: f64,
    unit: &'static str,
    tag: Tag,
) -> Row {
    Row {
        name: name.into(),
        meaning,
        value: value.to_string(),
        unit,
        tag,
    }
}
