//! The device configuration file (DCF of CiA 306) of an axis, checked against the cell.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use canopen::dcf::{self, Download, ObjectWrite};
use canopen::eds::{self, Eds, FlawedLines};
use canopen::objects::{PRODUCT_CODE, REVISION, VENDOR_ID};
use canopen::{NodeId, Object};
use drive::cia402::{Purpose, Reserved, Setting, reserved, reserved_by_any};
use master::sdo::CAPACITY;

use super::{CellFile, Path, printable};
use crate::input;
use can::counted;

/// Greatest number of values written to a drive, or compared, before operation. Each value takes two exchanges of some
/// milliseconds.
const MOST_VALUES: usize = 4096;

/// Content of a device configuration file, and the drive it is for.
#[derive(Clone)]
pub struct DeviceConfiguration {
    pub path: PathBuf,
    pub product: Option<u32>,
    pub revision: Option<u32>,
    pub download: Download,
    /// Lines that are not as CiA 306 has them. No value depends on them.
    pub flaws: Vec<FlawedLines>,
}

impl DeviceConfiguration {
    /// Reads the file of an axis, if the cell names one.
    pub fn read(file: &CellFile, robot: usize, axis: usize) -> anyhow::Result<Option<Self>> {
        let key = Path::axis(robot, axis).then("drive").then("dcf");
        let axis = &file.cell.robot[robot].axis[axis];
        let Some((drive, name)) = axis.drive.as_ref().and_then(|drive| Some((drive, drive.dcf.as_ref()?))) else {
            return Ok(None);
        };
        let path = file.path.parent().unwrap_or(&file.path).join(name);
        let shown = path.display();
        let refuse = |problem: String| Err(file.refuse(&key, format_args!("{shown} {problem}")));
        let what = "a device configuration file of the cell";
        let bytes = file.inputs().read_of_cell(what, &path, input::SHEET);
        let bytes = bytes.map_err(|error| file.refuse(&key, format_args!("{shown}: {error}")))?;
        let dcf = Eds::read(&bytes).map_err(|error| anyhow!("{shown}:{error}"))?;

        let node = NodeId::new(axis.node).context("a parsed cell has valid node-IDs")?;
        let Checked { download, lines } = Checked::of(&dcf, node, Some(drive.vendor));
        let bus = file.cell.bus.iter().find(|bus| bus.name == axis.bus);
        let expected = Expected {
            node,
            bitrate_kbps: bus.expect("a parsed cell has the bus").bitrate_kbps,
            identity: [(VENDOR_ID, Some(drive.vendor)), (PRODUCT_CODE, drive.product), (REVISION, drive.revision)],
            counts_per_revolution: drive.counts_per_revolution,
        };
        let contradictions = expected.contradictions(&bytes, &dcf, &download);
        match refusal(&lines, &contradictions, &Checked::without_cell(&dcf).lines) {
            None => {}
            Some(refusal) if contradictions.is_empty() => return Err(anyhow!("{shown}:{refusal}")),
            Some(refusal) => return Err(file.refuse(&key, format_args!("{shown}:{refusal}"))),
        }
        if download.writes.is_empty() && download.compared.is_empty() {
            return refuse("asks for no write: it has no ParameterValue".to_owned());
        }
        let values = download.writes.len() + download.compared.len();
        if values > MOST_VALUES {
            return refuse(format!("has {values} values, more than the {MOST_VALUES} that a drive may be given"));
        }
        Ok(Some(Self {
            product: dcf.identity(PRODUCT_CODE.subindex),
            revision: dcf.identity(REVISION.subindex),
            path,
            download,
            flaws: dcf.flawed_lines(),
        }))
    }

    /// The values, for the drive group. The comparisons come first: a write may change a value that can only be read.
    pub fn settings(&self) -> Vec<Setting> {
        let setting = |write: &ObjectWrite, purpose| Setting {
            object: write.object,
            data: write.data.clone(),
            readable: write.readable,
            purpose,
        };
        let written = |write: &ObjectWrite| match write.is_default && write.readable {
            true => setting(write, Purpose::WriteIfDifferent),
            false => setting(write, Purpose::Write),
        };
        let compared = self.download.compared.iter().map(|write| setting(write, Purpose::Compare));
        compared.chain(self.download.writes.iter().map(written)).collect()
    }

    /// The flaws of the file, each kind in one line.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let shown = printable(&self.path.display().to_string());
        self.flaws.iter().map(move |flaws| format!("{shown}:{flaws}; no value depends on it"))
    }
}

/// The values of a device configuration file, and the lines that no drive may be given.
pub struct Checked {
    /// The values that a drive may be given.
    pub download: Download,
    /// Why the others are refused, by line.
    pub lines: BTreeMap<u32, Refused>,
}

/// Why a line of a device configuration file is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refused {
    /// Its object belongs to the driver.
    Reserved(Reserved),
    /// Another reason, in words.
    Other(String),
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reserved(reserved) => reserved.fmt(f),
            Self::Other(problem) => f.write_str(problem),
        }
    }
}

impl Checked {
    /// Checks the values of `dcf` for the drive that the file names.
    pub fn without_cell(dcf: &Eds) -> Self {
        let node = dcf.commissioning.as_ref().and_then(|place| place.node).unwrap_or(NodeId::MIN);
        Self::of(dcf, node, dcf.identity(VENDOR_ID.subindex))
    }

    /// Checks the values of `dcf` for a drive of `vendor` with the node-ID `node`, in all its lines. If the vendor is
    /// not known, the reserved objects of all vendors are refused.
    fn of(dcf: &Eds, node: NodeId, vendor: Option<u32>) -> Self {
        let (mut download, errors) = match dcf::download(dcf, node) {
            Ok(download) => (download, Vec::new()),
            Err(refusal) => (refusal.rest, refusal.errors),
        };
        let read = download.compared.len();
        download.compared.retain(|read| read.data.len() <= CAPACITY);
        download.left_out += read - download.compared.len();
        let mut lines = BTreeMap::new();
        for error in errors {
            let problem = error.to_string();
            let (_, problem) = problem.split_once(": ").unwrap_or(("", &problem));
            lines.entry(error.line()).or_insert(Refused::Other(problem.to_owned()));
        }
        for write in download.writes.iter().filter(|write| write.data.len() > CAPACITY) {
            let (object, size) = (write.object, write.data.len());
            let problem = format!("{object} takes {size} bytes, at most {CAPACITY} are transferred");
            lines.entry(write.line).or_insert(Refused::Other(problem));
        }
        for &(line, Object { index, subindex }) in &download.lines {
            let found = match vendor {
                Some(vendor) => reserved(vendor, index, subindex),
                None => reserved_by_any(index, subindex),
            };
            if let Some(reserved) = found {
                lines.insert(line, Refused::Reserved(reserved));
            }
        }
        Self { download, lines }
    }
}

/// Refused lines with the same reason.
struct Group {
    /// The first line, if the file has one.
    line: Option<u32>,
    reason: String,
    /// The reason, with the object of the first line.
    told: String,
    /// The other lines.
    further: Vec<u32>,
}

/// All refused lines and contradictions as one text that begins with a line; `None` if there is none. Lines with the
/// same reason are told once. `removable` are the lines that `mrroc dcf strip` removes.
fn refusal(
    lines: &BTreeMap<u32, Refused>,
    contradictions: &[Contradiction],
    removable: &BTreeMap<u32, Refused>,
) -> Option<String> {
    let mut groups: Vec<Group> = Vec::new();
    for (line, refused) in lines {
        let reason = match refused {
            Refused::Reserved(reserved) => reserved.why,
            Refused::Other(problem) => problem,
        };
        match groups.iter_mut().find(|group| group.reason == reason) {
            Some(group) => group.further.push(*line),
            None => {
                let (reason, told) = (reason.to_owned(), refused.to_string());
                groups.push(Group { line: Some(*line), reason, told, further: Vec::new() });
            }
        }
    }
    groups.extend(contradictions.iter().map(|Contradiction { line, problem }| {
        let (reason, told) = (problem.clone(), problem.clone());
        Group { line: *line, reason, told, further: Vec::new() }
    }));
    groups.sort_by_key(|group| group.line.unwrap_or(u32::MAX));
    let joined = |lines: &[u32]| lines.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
    let tell = |Group { line, told, further, .. }: &Group| {
        let place = line.map_or(String::new(), |line| format!("{line}: "));
        let others = match further.as_slice() {
            [] => String::new(),
            lines => format!("; the same holds for {}: {}", counted(lines.len(), "further line"), joined(lines)),
        };
        format!("{place}{told}{others}")
    };
    let mut told: Vec<_> = groups.iter().map(tell).collect();
    match lines.values().filter(|refused| matches!(refused, Refused::Reserved(_))).count() {
        0 => {}
        1 if groups.len() == 1 => {
            told.push("remove its ParameterValue, or set bit 0 of its ObjFlags to keep it as a note".to_owned());
        }
        _ => told.push(
            "remove the ParameterValue of each object that belongs to the driver, or set bit 0 of its ObjFlags to keep \
             it as a note"
                .to_owned(),
        ),
    }
    let (removed, mut kept): (Vec<u32>, Vec<u32>) = lines.keys().partition(|line| removable.contains_key(line));
    if removed.len() > 1 {
        let mut advice = "`mrroc dcf strip` writes the file without these lines".to_owned();
        kept.extend(contradictions.iter().filter_map(|contradiction| contradiction.line));
        kept.sort_unstable();
        if !kept.is_empty() {
            advice += &format!(", except {}: correct the file or the cell there", joined(&kept));
        }
        told.push(advice);
    }
    (!told.is_empty()).then(|| told.join("; "))
}

/// What the cell says of the drive of a device configuration file.
struct Expected {
    node: NodeId,
    bitrate_kbps: u32,
    /// Sub-indices of object 0x1018. `None` is any value.
    identity: [(Object, Option<u32>); 3],
    counts_per_revolution: u32,
}

/// A statement of the file that contradicts the cell.
struct Contradiction {
    /// The line, from 1, if the file has one.
    line: Option<u32>,
    problem: String,
}

impl Expected {
    /// All contradictions of a file, ascending by line.
    fn contradictions(&self, bytes: &[u8], dcf: &Eds, download: &Download) -> Vec<Contradiction> {
        let mut found = Vec::new();
        let place = dcf.commissioning.as_ref();
        let mut of_place = |key: &str, problem: String| {
            let sections = ["DeviceComissioning", "DeviceCommissioning"];
            let line = sections.iter().find_map(|section| eds::line_of(bytes, section, key));
            found.push(Contradiction { line, problem });
        };
        let node = place.and_then(|place| place.node);
        if let Some(node) = node.filter(|node| *node != self.node) {
            of_place("NodeID", format!("the file is of node {node}, the axis of node {}", self.node));
        }
        let rate = place.and_then(|place| place.baud_rate).map(u32::from);
        if let Some(rate) = rate.filter(|rate| *rate != self.bitrate_kbps) {
            of_place("Baudrate", format!("the file is for {rate} kbit/s, the bus has {}", self.bitrate_kbps));
        }
        for (object, expected) in self.identity {
            let stated = dcf.identity(object.subindex);
            if let (Some(stated), Some(expected)) = (stated, expected)
                && stated != expected
            {
                let name = object.name().unwrap_or("identity");
                let problem =
                    format!("the file is of {name} {stated:#010x} ({object}), the cell says {expected:#010x}");
                found.push(Contradiction { line: dcf.identity_line(bytes, object.subindex), problem });
            }
        }
        found.extend(check_scale(download, self.counts_per_revolution));
        found.sort_by_key(|contradiction| contradiction.line.unwrap_or(u32::MAX));
        found
    }
}

/// Checks that a written scale counts at the motor shaft, like the cell. The scale is given by the gear ratio (0x6091)
/// and the feed constant (0x6092), or by the encoder (0x608F) where no feed constant is written. Each object is a
/// ratio of its sub-indices 1 and 2. Returns all contradictions.
fn check_scale(download: &Download, counts: u32) -> Vec<Contradiction> {
    let mut found = Vec::new();
    let ratio = |index: u16| {
        let written = |subindex: u8| {
            let write = download.writes.iter().find(|it| it.object.index == index && it.object.subindex == subindex)?;
            let value = <[u8; 4]>::try_from(write.data.as_slice()).ok()?;
            Some((write.line, u32::from_le_bytes(value)))
        };
        let (line, above) = written(1).or(written(2).map(|(line, _)| (line, 1)))?;
        Some((line, above, written(2).map_or(1, |(_, below)| below)))
    };
    let mut scales = vec![
        (0x6091, "motor revolutions per shaft revolution", 1),
        (0x6092, "position units per shaft revolution", counts),
    ];
    if ratio(0x6092).is_none() {
        scales.push((0x608F, "counts per revolution", counts));
    }
    for (index, what, expected) in scales {
        let Some((line, above, below)) = ratio(index) else {
            continue;
        };
        if u64::from(above) != u64::from(expected) * u64::from(below) {
            let ratio = if below == 1 { above.to_string() } else { format!("{above}/{below}") };
            let problem = format!("{index:#06x} sets {ratio} {what}, the cell says {expected}");
            found.push(Contradiction { line: Some(line), problem });
        }
    }
    found
}
