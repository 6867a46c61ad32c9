//! Samples of the devices of other crates in a report.

use std::fmt;

use drive::device::{DeviceSample, names_of};
use serde::Serialize;

use crate::cell::{CellFile, Device};

/// One device: the samples of the run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceReport {
    /// Name of the device.
    pub name: String,
    /// Kind of the device.
    pub kind: &'static str,
    /// Number of valid samples.
    pub samples: u64,
    /// The declared values in their order.
    pub values: Vec<ValueReport>,
}

/// One number of the samples of a device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ValueReport {
    /// Name of the value.
    pub name: String,
    /// Unit of the value.
    pub unit: &'static str,
    /// Number of samples in which the value was measured.
    pub measured: u64,
    /// Least, greatest and last measured number; null if the value was never measured.
    pub least: Option<f64>,
    /// See `least`.
    pub greatest: Option<f64>,
    /// See `least`.
    pub last: Option<f64>,
}

impl DeviceReport {
    /// The devices of a cell before their first samples.
    pub(super) fn all(file: &CellFile) -> Vec<Self> {
        let value = |(name, declared): (String, &drive::device::DeviceValue)| ValueReport {
            name,
            unit: declared.unit,
            measured: 0,
            least: None,
            greatest: None,
            last: None,
        };
        let report = |device: &Device| Self {
            name: device.keys.name.clone(),
            kind: device.own.kind(),
            samples: 0,
            values: names_of(device.own.values()).map(value).collect(),
        };
        file.cell.device.iter().map(report).collect()
    }

    /// Takes a sample.
    pub(super) fn observe(&mut self, sample: &DeviceSample) {
        self.samples += 1;
        let measured = self.values.iter_mut().zip(sample.values).filter(|(_, number)| !number.is_nan());
        for (value, number) in measured {
            value.measured += 1;
            value.least = Some(value.least.map_or(number, |least| least.min(number)));
            value.greatest = Some(value.greatest.map_or(number, |greatest| greatest.max(number)));
            value.last = Some(number);
        }
    }
}

/// `device range (acme-range): 812 samples; distance 0.2130 to 0.4120 m, at last 0.3000 m`
impl fmt::Display for DeviceReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "device {} ({}): {}", self.name, self.kind, super::counted(self.samples, "sample"))?;
        for ValueReport { name, unit, least, greatest, last, .. } in &self.values {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            match (least, greatest, last) {
                (Some(least), Some(greatest), Some(last)) => {
                    write!(f, "; {name} {least:.4} to {greatest:.4}{unit}, at last {last:.4}{unit}")?;
                }
                _ => write!(f, "; {name} was not measured")?,
            }
        }
        Ok(())
    }
}
