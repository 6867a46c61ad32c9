//! The files a run writes: frames as a candump log, axes and steps as CSV.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Write};

use anyhow::Context;
use can::{Instant, Traced, candump};
use controller::ecp::{StepRecord, StepRecords};
use drive::AxisCommand;
use drive::device::{DeviceSample, DeviceValue, count_of, names_of};
use servo::Record;

use crate::bench::interfaces::Interface;
use crate::cell::{CellFile, Device};
use crate::frame_order::FrameOrder;
use crate::row_file::{FileName, IncompleteFile, RowFile};

/// A candump log of every frame that passed the ports of a run, in the order of time.
pub(crate) struct FrameLog {
    names: Vec<can::InterfaceName>,
    order: FrameOrder,
    rows: RowFile,
}

impl FrameLog {
    pub(crate) fn new(name: FileName, file: File, names: Vec<can::InterfaceName>) -> io::Result<Self> {
        Ok(Self { names, order: FrameOrder::default(), rows: RowFile::new(name, file, "")? })
    }

    /// Takes a frame of bus `bus`.
    pub(crate) fn write(&mut self, bus: usize, traced: &Traced) {
        self.order.push(bus, *traced);
    }

    /// Writes the frames that are due. To be called when the frames of all buses were taken.
    pub(crate) fn flush(&mut self) {
        while let Some((bus, traced)) = self.order.next() {
            self.row(bus, traced);
        }
        self.rows.flush();
    }

    fn row(&mut self, bus: usize, Traced { at, frame, .. }: Traced) {
        let entry = candump::Entry { at, interface: self.names[bus], frame, direction: None };
        self.rows.row(at, |row| write!(row, "{entry}"));
    }

    /// Writes the rest. `dropped`: further frames that found no room.
    pub(crate) fn finish(mut self, dropped: u64) -> Option<IncompleteFile> {
        while let Some((bus, traced)) = self.order.rest() {
            self.row(bus, traced);
        }
        self.rows.finish(dropped)
    }
}

/// Names of the interfaces of a run in candump logs.
pub(crate) fn log_names(interfaces: &[Interface]) -> anyhow::Result<Vec<can::InterfaceName>> {
    let name = |(bus, interface): (usize, &Interface)| {
        let name = interface.log_name(bus);
        can::InterfaceName::new(&name).with_context(|| format!("{name:?} is no interface name"))
    };
    interfaces.iter().enumerate().map(name).collect()
}

/// A CSV file of every axis in every cycle.
pub(crate) struct AxisLog {
    names: Vec<Vec<String>>,
    /// Whether each robot has a force law. The file has a column of displacements if one of them has.
    laws: Vec<bool>,
    devices: Vec<DeviceColumns>,
    rows: RowFile,
}

/// The columns of a device of another crate: the numbers of its last sample, empty where not measured.
struct DeviceColumns {
    count: usize,
    /// Samples after the last row, in the order of their times.
    coming: VecDeque<(Instant, Option<DeviceSample>)>,
    last: Option<DeviceSample>,
}

impl AxisLog {
    pub(crate) fn new(name: FileName, sink: File, file: &CellFile) -> io::Result<Self> {
        let laws: Vec<_> = file.cell.robot.iter().map(|robot| robot.force_law.is_some()).collect();
        let displacement = if laws.contains(&true) { ",displacement_rad" } else { "" };
        let head = format!(
            "cycle,time_s,axis,phase,command,commanded_rad,measured_rad,counts,\
             velocity_rad_per_s,torque_nm,homing,dt_s{displacement}{}\n",
            file.cell.device.iter().map(head_of).collect::<String>()
        );
        let columns = |device: &Device| DeviceColumns {
            count: count_of(device.own.values()),
            coming: VecDeque::new(),
            last: None,
        };
        let devices = file.cell.device.iter().map(columns).collect();
        let robots = file.cell.robot.iter().enumerate();
        let names =
            robots.map(|(robot, value)| (0..value.axis.len()).map(|axis| file.axis_name(robot, axis)).collect());
        Ok(Self { names: names.collect(), laws, devices, rows: RowFile::new(name, sink, &head)? })
    }

    /// Takes a sample of device `device`; `None`: its last sample is not valid any more.
    pub(crate) fn sample(&mut self, device: usize, at: Instant, sample: Option<DeviceSample>) {
        self.devices[device].coming.push_back((at, sample));
    }

    pub(crate) fn write(&mut self, record: &Record) {
        for columns in &mut self.devices {
            while columns.coming.front().is_some_and(|(at, _)| *at <= record.at) {
                columns.last = columns.coming.pop_front().and_then(|(_, sample)| sample);
            }
        }
        let devices = &self.devices;
        let names = &self.names[usize::from(record.effector)];
        let (law, any_law) = (self.laws[usize::from(record.effector)], self.laws.contains(&true));
        for (axis, name) in record.axis.iter().zip(names) {
            let seconds = record.at.as_nanos() as f64 / 1e9;
            self.rows.row(record.at, |row| {
                write!(
                    row,
                    "{},{seconds:.9},{name},{:?},{},{},{},{},{},{},{:?},{:.9}",
                    record.cycle,
                    record.phase,
                    word(axis.command),
                    axis.commanded,
                    axis.measured,
                    axis.increments.0,
                    axis.velocity,
                    axis.torque,
                    axis.homing,
                    record.dt.as_secs_f64(),
                )?;
                match law {
                    true => write!(row, ",{}", axis.displacement)?,
                    false if any_law => write!(row, ",")?,
                    false => {}
                }
                devices.iter().try_for_each(|columns| columns.write(row))
            });
        }
    }

    pub(crate) fn flush(&mut self) {
        self.rows.flush();
    }

    pub(crate) fn finish(self) -> Option<IncompleteFile> {
        self.rows.finish(0)
    }
}

/// The heads of the columns of a device: `,range.distance_m`.
fn head_of(device: &Device) -> String {
    let column = |(name, value): (String, &DeviceValue)| match value.unit {
        "" => format!(",{}.{name}", device.keys.name),
        unit => format!(",{}.{name}_{}", device.keys.name, word_of_unit(unit)),
    };
    names_of(device.own.values()).map(column).collect()
}

/// A unit in the head of a column: `m/s²` is `m_per_s2`.
fn word_of_unit(unit: &str) -> String {
    let unit = unit.replace('/', "_per_").replace('²', "2").replace('°', "deg");
    unit.chars().filter(|c| c.is_alphanumeric() || *c == '_').collect()
}

impl DeviceColumns {
    fn write(&self, row: &mut Vec<u8>) -> io::Result<()> {
        for number in 0..self.count {
            match self.last.map(|sample| sample.values[number]).filter(|number| !number.is_nan()) {
                Some(number) => write!(row, ",{number}")?,
                None => write!(row, ",")?,
            }
        }
        Ok(())
    }
}

/// A CSV file of every step of every agent: the events of the flow chart, in order. The agents are the robots and the
/// coordinator.
pub(crate) struct StepFile {
    agents: Vec<String>,
    records: Vec<StepRecords>,
    rows: RowFile,
}

impl StepFile {
    pub(crate) fn new(name: FileName, sink: File, file: &CellFile, records: Vec<StepRecords>) -> io::Result<Self> {
        let head = "time_s,agent,instruction,generator,class,macrostep,event,age_s,memory\n";
        let rows = RowFile::new(name, sink, head)?;
        let robots = file.cell.robot.iter().map(|robot| robot.name.clone());
        Ok(Self { agents: robots.chain(["coordinator".to_owned()]).collect(), records, rows })
    }

    /// Writes the steps since the last call.
    pub(crate) fn drain(&mut self) {
        for (records, agent) in self.records.iter_mut().zip(&self.agents) {
            while let Ok(record) = records.queue.pop() {
                let StepRecord { at, motion, generator, class, step, event, age, memory } = record;
                let (seconds, event) = (at.as_nanos() as f64 / 1e9, event.name());
                self.rows.row(at, |row| {
                    write!(row, "{seconds:.9},{agent},{motion},\"{generator}\",{class},{step},{event},")?;
                    if let Some(age) = age {
                        write!(row, "{:.9}", age.as_secs_f64())?;
                    }
                    match memory {
                        Some(memory) => write!(row, ",{memory:016x}"),
                        None => write!(row, ","),
                    }
                });
            }
        }
        self.rows.flush();
    }

    /// Writes the rest.
    pub(crate) fn finish(mut self) -> Option<IncompleteFile> {
        self.drain();
        self.rows.finish(self.records.iter().map(StepRecords::lost).sum())
    }
}

/// What the CSV file calls a command; the set-point of `Follow` stands in a column of its own.
fn word(command: AxisCommand) -> &'static str {
    match command {
        AxisCommand::Off => "Off",
        AxisCommand::ResetFault => "ResetFault",
        AxisCommand::Stand => "Stand",
        AxisCommand::Home => "Home",
        AxisCommand::Follow(_) => "Follow",
        AxisCommand::Seek(_) => "Seek",
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// The first two lines of a recording of a robot of an example cell whose axes are displaced by 0.25 rad.
    fn recorded(cell: &str) -> [String; 2] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells").join(cell);
        let (file, directory) = (CellFile::read(&path).unwrap(), tempfile::tempdir().unwrap());
        let path = directory.path().join("record.csv");
        let name = FileName::new("--record", &path, "rows");
        let mut log = AxisLog::new(name, File::create(&path).unwrap(), &file).unwrap();
        let mut record = Record { axes: 5, ..Record::default() };
        record.axis.iter_mut().for_each(|axis| axis.displacement = 0.25);
        log.write(&record);
        assert_eq!(log.finish(), None);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines = text.lines().map(str::to_owned);
        std::array::from_fn(|_| lines.next().unwrap())
    }

    #[test]
    fn a_recording_has_the_displacement_only_in_a_cell_with_a_force_law() {
        let [head, first] = recorded("irb6-force.toml");
        assert!(head.ends_with(",dt_s,displacement_rad") && first.ends_with(",0.000000000,0.25"), "{head}\n{first}");
        let [head, first] = recorded("irb6-wrist.toml");
        assert!(head.ends_with(",homing,dt_s") && first.ends_with(",0.000000000"), "{head}\n{first}");
    }
}
