//! Devices of other crates: their keys in cell files, their drivers and their emulation.
//!
//! A program implements [`OwnDevice`] and registers the kind ([`register`], `Extension::device`). A cell of the program
//! can then have such devices as `[[device]]`, each on a serial line. Every command and every bench knows the kind. A
//! task reads a device by its name: [`Cell::device`](crate::tasks::Cell::device).
//!
//! Read [`drive::device`] for time-outs and faults, which are the same for all kinds.

mod kind;
#[cfg(test)]
pub(crate) mod tests;

use std::fmt;

pub use can::Instant;
pub use drive::device::{DeviceValue, LineConfig, LineDriver, MOST_QUERY, MOST_VALUES, Reception};
pub use hil::{Answer, LineEmulator, Surroundings};
use serde::Serialize;
use serde::de::DeserializeOwned;
pub use serial::{Settings, StopBits};

pub use crate::robots::Keys;
pub(crate) use kind::{OwnKind, check};
pub use kind::{OwnSettings, register};

/// A kind of device that a program adds. The fields of the type are the keys of the kind in cell files, beside the keys
/// of every device:
///
/// ```toml
/// [[device]]
/// name = "range"
/// kind = "acme-range"
/// line = "/dev/serial/by-id/usb-range"
/// reach = 4.0
/// ```
///
/// Every value is read by serde: `#[serde(deny_unknown_fields)]` refuses a misspelt key, `#[serde(default)]` permits a
/// missing one. No field may have the name of a key that every device has.
///
/// Methods with a default may be added to this trait; every other change is announced in the change log.
pub trait OwnDevice: fmt::Debug + Serialize + DeserializeOwned + Keys + Send + Sync {
    /// Name of the kind in cell files.
    const KIND: &'static str;

    /// The values of a sample. Tasks, recordings, columns and reports use this declaration.
    const VALUES: &'static [DeviceValue];

    /// The host's end of the protocol.
    type Driver: LineDriver;

    /// The device's end of the protocol.
    type Emulator: LineEmulator;

    /// The line and its telegrams.
    fn line(&self) -> LineConfig;

    /// A driver that has received nothing yet.
    fn driver(&self) -> Self::Driver;

    /// An emulated device, switched on at [`Instant::ZERO`].
    fn emulator(&self) -> Self::Emulator;

    /// Refuses invalid numbers. The message follows the place in the cell file.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    /// Numbers of every sample in a rehearsal, which has no surroundings. By default, the middle of each range.
    fn rehearsed(&self) -> Vec<f64> {
        let middle = |value: &DeviceValue| std::iter::repeat_n(0.5 * (value.range[0] + value.range[1]), value.count);
        Self::VALUES.iter().flat_map(middle).collect()
    }
}
