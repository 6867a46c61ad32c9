//! The keys of devices of other crates.

use std::time::Duration;

use controller::robot::Pose;
use drive::device::DeviceConfig;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};

use super::{Cell, defaults};
use crate::devices::{OwnKind, OwnSettings};

/// A device on a serial line of its own, whose kind the program adds. The kind has further keys in the same table,
/// which the command `schema` of the program describes.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "Device"))]
#[serde(deny_unknown_fields)]
pub struct DeviceKeys {
    /// Name of the device in tasks and reports, unlike that of any bus, bundle of lines, sensor or axis.
    #[cfg_attr(feature = "schema", schemars(regex(pattern = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")))]
    pub name: String,
    /// Kind of the device.
    pub kind: String,
    /// The tty, `/dev/serial/by-id/…` for one that keeps its name; unused on the benches without hardware.
    pub line: String,
    /// The robot whose flange carries the device; the device stands in the cell where absent.
    pub robot: Option<String>,
    /// Origin of the device in the frame of the flange, or of the cell, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Orientation of the device in the frame of the flange, or of the cell, as w, x, y, z.
    #[serde(default = "upright")]
    pub quaternion: [f64; 4],
    /// Missing samples in a row that are tolerated; one more is a fault of the device.
    #[serde(default = "defaults::count::<3, u32>")]
    pub tolerated_missing: u32,
    /// Time-out of the first sample, ms.
    #[serde(default = "defaults::count::<2_000, u32>")]
    pub boot_timeout_ms: u32,
    /// Settings of the emulated device, on the benches without hardware.
    #[serde(default)]
    pub emulator: DeviceEmulator,
}

/// The keys of every device.
pub(crate) const DEVICE_KEYS: [&str; 9] =
    ["name", "kind", "line", "robot", "position", "quaternion", "tolerated_missing", "boot_timeout_ms", "emulator"];

/// What stands in for a device of another crate on the benches without hardware.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DeviceEmulator {
    /// Whether the device is absent from its line.
    pub absent: bool,
    /// Time at which the cable of the emulated device breaks, s since the emulated devices were switched on; never
    /// where absent.
    pub silent_from_s: Option<f64>,
    /// Standard deviation of the noise that the emulated device adds to what it measures, in the unit of the kind.
    pub noise: f64,
}

fn upright() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

/// A device of another crate: the keys of every device, and those of its kind.
#[derive(Clone, Debug)]
pub struct Device {
    /// The keys of every device.
    pub keys: DeviceKeys,
    /// The keys of the kind.
    pub own: OwnSettings,
}

impl<'de> Deserialize<'de> for Device {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut own = toml::Table::deserialize(deserializer)?;
        let keys: toml::Table =
            DEVICE_KEYS.iter().filter_map(|key| Some(((*key).to_owned(), own.remove(*key)?))).collect();
        let refused = |error: toml::de::Error| de::Error::custom(error.message());
        let keys: DeviceKeys = keys.try_into().map_err(refused)?;
        let kind = OwnKind::named(&keys.kind).map_err(de::Error::custom)?;
        Ok(Self { own: kind.read(own).map_err(refused)?, keys })
    }
}

impl Serialize for Device {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut table = toml::Table::try_from(&self.keys).map_err(ser::Error::custom)?;
        let own = self.own.table().map_err(ser::Error::custom)?;
        table.extend(own.as_table().cloned().unwrap_or_default());
        table.serialize(serializer)
    }
}

impl Device {
    /// Configuration of the driver at the servo period `period`.
    pub fn config(&self, period: Duration) -> DeviceConfig {
        DeviceConfig {
            period,
            line: self.own.line(),
            values: self.own.values(),
            tolerated_missing: self.keys.tolerated_missing,
            boot_timeout: Duration::from_millis(self.keys.boot_timeout_ms.into()),
        }
    }

    /// Frame of the device in the frame of the flange that carries the device, or of the cell.
    pub fn place(&self) -> Pose {
        let [w, x, y, z] = self.keys.quaternion;
        let [px, py, pz] = self.keys.position;
        Pose::from_parts(Translation3::new(px, py, pz), UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
    }

    /// Name and kind in reports: `device range (acme-range)`.
    pub fn title(&self) -> String {
        format!("device {} ({})", self.keys.name, self.own.kind())
    }
}

impl Cell {
    /// The drive group of device `device` in [`groups`](Self::groups).
    pub fn group_of_device(&self, device: usize) -> usize {
        self.group_of_matrix(self.ultrasonic.len()) + device
    }

    /// The device with drive group `group` of [`groups`](Self::groups); `None` for any other group.
    pub fn device_of_group(&self, group: usize) -> Option<&Device> {
        self.device.get(group.checked_sub(self.group_of_device(0))?)
    }

    /// Whether a sensor or a device has a serial line of its own.
    pub fn has_sensor_lines(&self) -> bool {
        self.groups().count() > self.bus.len() + self.serial.len()
    }
}
