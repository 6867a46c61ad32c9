//! The device configuration file (DCF of CiA 306) of an axis, checked against the cell.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use canopen::dcf::{self, Download};
use canopen::objects::{PRODUCT_CODE, REVISION, VENDOR_ID};
use canopen::{NodeId, Object, eds::Eds};
use drive::cia402::{Setting, reserved};
use master::sdo::CAPACITY;

use super::{CellFile, Path};
use crate::input;

/// Greatest number of values written to a drive before operation. Each value takes two exchanges of some milliseconds.
const MOST_WRITES: usize = 4096;

/// Content of a device configuration file, and the drive it is for.
#[derive(Clone)]
pub struct DeviceConfiguration {
    pub path: PathBuf,
    pub product: Option<u32>,
    pub revision: Option<u32>,
    pub download: Download,
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
        let at_line = |(line, problem): (u32, String)| anyhow!("{shown}:{line}: {problem}");
        let what = "a device configuration file of the cell";
        let bytes = file.inputs().read_of_cell(what, &path, input::SHEET);
        let bytes = bytes.map_err(|error| file.refuse(&key, format_args!("{shown}: {error}")))?;
        let dcf = Eds::read(&bytes).map_err(|error| anyhow!("{shown}:{error}"))?;

        let place = dcf.commissioning.as_ref();
        let node = place.and_then(|place| place.node);
        if let Some(node) = node.filter(|node| node.raw() != axis.node) {
            return refuse(format!("is of node {node}, the axis of node {}", axis.node));
        }
        let bus = file.cell.bus.iter().find(|bus| bus.name == axis.bus);
        let bitrate = bus.expect("a parsed cell has the bus").bitrate_kbps;
        let rate = place.and_then(|place| place.baud_rate).map(u32::from);
        if let Some(rate) = rate.filter(|rate| *rate != bitrate) {
            return refuse(format!("is for {rate} kbit/s, the bus has {bitrate}"));
        }
        let identity = [(VENDOR_ID, Some(drive.vendor)), (PRODUCT_CODE, drive.product), (REVISION, drive.revision)];
        for (object, expected) in identity {
            let stated = dcf.identity(object.subindex);
            if let (Some(stated), Some(expected)) = (stated, expected)
                && stated != expected
            {
                let name = object.name().unwrap_or("identity");
                return refuse(format!("is of {name} {stated:#010x} ({object}), the cell says {expected:#010x}"));
            }
        }

        let node = NodeId::new(axis.node).context("a parsed cell has valid node-IDs")?;
        let download = dcf::download(&dcf, node).map_err(|error| anyhow!("{shown}:{error}"))?;
        if download.writes.is_empty() {
            return refuse("asks for no write: it has no ParameterValue".to_owned());
        }
        check_reserved(&download, drive.vendor).map_err(at_line)?;
        if download.writes.len() > MOST_WRITES {
            let writes = download.writes.len();
            return refuse(format!("asks for {writes} writes, more than the {MOST_WRITES} that a drive may be given"));
        }
        for write in &download.writes {
            let (line, object, size) = (write.line, write.object, write.data.len());
            if size > CAPACITY {
                let problem = format!("{object} takes {size} bytes, at most {CAPACITY} are transferred");
                return Err(at_line((line, problem)));
            }
        }
        check_scale(&download, drive.counts_per_revolution).map_err(at_line)?;
        Ok(Some(Self {
            product: dcf.identity(PRODUCT_CODE.subindex),
            revision: dcf.identity(REVISION.subindex),
            path,
            download,
        }))
    }

    /// The writes, for the drive group.
    pub fn settings(&self) -> Vec<Setting> {
        let setting = |write: &dcf::ObjectWrite| Setting {
            object: write.object,
            data: write.data.clone(),
            readable: write.readable,
        };
        self.download.writes.iter().map(setting).collect()
    }
}

/// Refuses values for objects that belong to the driver. The error gives the first such line and its object, and the
/// other lines.
fn check_reserved(download: &Download, vendor: u32) -> Result<(), (u32, String)> {
    // One line of a PDO causes several writes, of which the map keeps the first.
    let found = download.writes.iter().rev().filter_map(|write| {
        let Object { index, subindex } = write.object;
        Some((write.line, reserved(vendor, index, subindex)?))
    });
    let mut found = found.collect::<BTreeMap<_, _>>().into_iter();
    let Some((line, first)) = found.next() else {
        return Ok(());
    };
    let mut problem = format!("{first}; remove its ParameterValue, or set bit 0 of its ObjFlags to keep it as a note");
    let others: Vec<_> = found.map(|(line, _)| line.to_string()).collect();
    if !others.is_empty() {
        let (count, lines) = (others.len(), others.join(", "));
        problem += &format!("; the same holds for {count} further lines: {lines}");
    }
    Err((line, problem))
}

/// Checks that a written scale counts at the motor shaft, like the cell. The scale is given by the gear ratio (0x6091)
/// and the feed constant (0x6092), or by the encoder (0x608F) where no feed constant is written. Each object is a
/// ratio of its sub-indices 1 and 2. The error gives the line and the problem.
fn check_scale(download: &Download, counts: u32) -> Result<(), (u32, String)> {
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
            return Err((line, format!("{index:#06x} sets {ratio} {what}, the cell says {expected}")));
        }
    }
    Ok(())
}
