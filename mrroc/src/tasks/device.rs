//! A device of another crate, as a task sees it.

use std::task::Poll;
use std::time::Duration;

use can::Instant;
use controller::executor::Agents;
use drive::device::{DeviceFault, DeviceLink, DeviceSample, DeviceValue};
use thiserror::Error;

use super::TaskError;
use crate::cell;

/// Lost samples, beside the tolerated ones, before a wait ends: the fault of the driver comes first.
const PATIENCE: u32 = 2;

/// A device of a kind that the program has added.
#[derive(Clone)]
pub struct Device {
    name: Box<str>,
    kind: &'static str,
    values: &'static [DeviceValue],
    link: DeviceLink,
    agents: Agents,
    period: Duration,
    longest: Duration,
}

/// Why a device gives no reading.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the messages document variants and fields")]
pub enum DeviceReadError {
    #[error("{0}")]
    Fault(DeviceFault),
    #[error("no sample in {waited:.1?}: check the device")]
    NoSample { waited: Duration },
    #[error("{value} is not measured")]
    NotMeasured { value: &'static str },
    #[error("no value is called {value:?}, only {known}")]
    UnknownValue { value: String, known: String },
}

/// A sample of a device with its greatest age at the reading.
#[derive(Clone, Debug)]
pub struct DeviceReading {
    device: Box<str>,
    values: &'static [DeviceValue],
    sample: DeviceSample,
    age: Duration,
}

impl Device {
    pub(super) fn new(given: &cell::Device, link: DeviceLink, agents: Agents, period: Duration) -> Self {
        let line = given.own.line();
        let each = line.sample_time(period).max(line.loss_time(period));
        Self {
            name: given.keys.name.as_str().into(),
            kind: given.own.kind(),
            values: given.own.values(),
            link,
            agents,
            period,
            longest: each * (given.keys.tolerated_missing + PATIENCE),
        }
    }

    /// Name of the device in the cell file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Kind of the device.
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// The declared values of a sample.
    pub fn values(&self) -> &'static [DeviceValue] {
        self.values
    }

    /// The last sample. Fails during a fault, and before the first sample.
    pub fn latest(&self) -> Result<DeviceReading, TaskError> {
        let state = self.link.read();
        match (state.fault, state.measured()) {
            (Some(fault), _) => Err(self.error(DeviceReadError::Fault(fault))),
            (None, None) => Err(self.error(DeviceReadError::NoSample { waited: Duration::ZERO })),
            (None, Some(sample)) => Ok(DeviceReading {
                device: self.name.clone(),
                values: self.values,
                sample: *sample,
                age: sample.age(state.at),
            }),
        }
    }

    /// Waits for a sample that is measured after the call. Fails if the device has a fault, or if no such sample
    /// arrives in the time of the tolerated missing samples and two more. The fault of a silent device comes first.
    pub async fn read(&self) -> Result<DeviceReading, TaskError> {
        let called = self.now().await;
        let mut waited = Duration::ZERO;
        loop {
            let state = self.link.read();
            if state.fault.is_some() || (state.sample.number > 0 && state.sample.not_before >= called) {
                return self.latest();
            }
            if waited >= self.longest {
                return Err(self.error(DeviceReadError::NoSample { waited }));
            }
            self.agents.sleep(self.period).await;
            waited += self.period;
        }
    }

    /// The fault of the device in the last servo cycle.
    pub fn fault(&self) -> Option<DeviceFault> {
        self.link.read().fault
    }

    /// Requests a reset of the fault of the device, and does not wait. The fault ends with the next valid sample.
    pub fn reset_fault(&self) {
        self.link.reset_fault();
    }

    fn error(&self, error: DeviceReadError) -> TaskError {
        TaskError::Device { name: self.name.clone(), error: Box::new(error) }
    }

    /// Time of the last servo cycle.
    async fn now(&self) -> Instant {
        self.agents.until(|now, _| Poll::Ready(now)).await
    }
}

impl DeviceReading {
    /// The number called `value`; the first one if the value has several. Fails if the device did not measure the
    /// number.
    pub fn value(&self, value: &str) -> Result<f64, TaskError> {
        let (declared, numbers) = self.find(value)?;
        match numbers.first() {
            Some(number) if !number.is_nan() => Ok(*number),
            _ => Err(self.error(DeviceReadError::NotMeasured { value: declared.name })),
        }
    }

    /// The numbers called `value`. NaN: not measured.
    pub fn numbers(&self, value: &str) -> Result<&[f64], TaskError> {
        Ok(self.find(value)?.1)
    }

    /// Greatest age of the measurement at the reading.
    pub fn age(&self) -> Duration {
        self.age
    }

    /// Number and times of the sample.
    pub fn sample(&self) -> &DeviceSample {
        &self.sample
    }

    fn find(&self, wanted: &str) -> Result<(&'static DeviceValue, &[f64]), TaskError> {
        let mut first = 0;
        for value in self.values {
            if value.name == wanted {
                return Ok((value, self.sample.values.get(first..first + value.count).unwrap_or_default()));
            }
            first += value.count;
        }
        let known: Vec<_> = self.values.iter().map(|value| value.name).collect();
        Err(self.error(DeviceReadError::UnknownValue { value: wanted.to_owned(), known: known.join(", ") }))
    }

    fn error(&self, error: DeviceReadError) -> TaskError {
        TaskError::Device { name: self.device.clone(), error: Box::new(error) }
    }
}
