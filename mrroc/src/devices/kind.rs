//! The registered kinds of devices.

use std::any::{TypeId, type_name};
use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};

use drive::DriveGroup;
use drive::device::{
    DeviceConfig, DeviceConfigError, DeviceOnLine, DeviceValue, LineConfig, OpenedDevice, RehearsedDevice,
};
use hil::{EmulatedOnLine, LineDevice, Surroundings};
use serial::Line;
use toml::de::DeValue;

use super::OwnDevice;
use crate::bench::emulated_sensors::Unplugged;
use crate::cell::{CellError, DEVICE_KEYS, DeviceKeys, Path, one_of, quoted, read_entries};

/// Makes a kind of device known to every cell file that this process reads from now on.
///
/// # Panics
///
/// If another kind has the name, or, with the feature `schema`, if the kind has a key that every device has.
pub fn register<T: OwnDevice>() {
    let mut kinds = KINDS.write().unwrap_or_else(PoisonError::into_inner);
    let taken = kinds.iter().find(|kind| kind.name == T::KIND);
    if taken.is_some_and(|kind| kind.id == TypeId::of::<T>()) {
        return;
    }
    assert!(taken.is_none(), "two kinds of devices are called {:?}", T::KIND);
    #[cfg(feature = "schema")]
    if let Some(own) = schemars::schema_for!(T).get("properties").and_then(serde_json::Value::as_object) {
        let shared = DEVICE_KEYS.iter().find(|key| own.contains_key(**key));
        assert!(shared.is_none(), "the kind {:?} has the key {shared:?}, which every device has", T::KIND);
    }
    // A kind stays known until the process ends.
    kinds.push(Box::leak(Box::new(Kind::of::<T>())));
}

static KINDS: RwLock<Vec<&'static Kind>> = RwLock::new(Vec::new());

/// A registered kind.
struct Kind {
    name: &'static str,
    id: TypeId,
    read: fn(toml::Value) -> Result<OwnSettings, toml::de::Error>,
    /// Reads the own keys of an element of a cell file, for an error with its key and line.
    check: fn(&str, &DeValue<'_>, &Path) -> Result<(), CellError>,
    #[cfg(feature = "schema")]
    schema: fn() -> schemars::Schema,
}

impl Kind {
    fn of<T: OwnDevice>() -> Self {
        Self {
            name: T::KIND,
            id: TypeId::of::<T>(),
            read: |value| Ok(OwnSettings(Arc::new(value.try_into::<T>()?))),
            check: |text, document, path| {
                let own = |key: &str| !DEVICE_KEYS.contains(&key);
                read_entries::<T>(text, document, path, own).map(drop)
            },
            #[cfg(feature = "schema")]
            schema: || schemars::schema_for!(T),
        }
    }
}

/// The crate that has a type.
fn crate_of<T>() -> &'static str {
    type_name::<T>().split("::").next().unwrap_or_default()
}

/// A registered kind of device.
#[derive(Clone, Copy)]
pub(crate) struct OwnKind(&'static Kind);

impl OwnKind {
    /// The kind called `name`, or a refusal that lists the known kinds.
    pub(crate) fn named(name: &str) -> Result<Self, String> {
        let kinds = Self::all();
        kinds.iter().find(|kind| kind.name() == name).copied().ok_or_else(|| {
            let names: Vec<_> = kinds.iter().map(|kind| kind.name()).collect();
            let known = match names.len() {
                0 => "and this program knows no kind of device".to_owned(),
                _ => format!("must be {}", one_of(&names)),
            };
            format!("is {}, {known}; a kind of another program is known to that program alone", quoted(name))
        })
    }

    /// The registered kinds, in the order of their registration.
    pub(crate) fn all() -> Vec<Self> {
        KINDS.read().unwrap_or_else(PoisonError::into_inner).iter().copied().map(Self).collect()
    }

    pub(crate) fn name(self) -> &'static str {
        self.0.name
    }

    /// The own keys of a device of this kind.
    pub(crate) fn read(self, own: toml::Table) -> Result<OwnSettings, toml::de::Error> {
        (self.0.read)(toml::Value::Table(own))
    }

    /// JSON schema of the own keys.
    #[cfg(feature = "schema")]
    pub(crate) fn schema(self) -> schemars::Schema {
        (self.0.schema)()
    }
}

/// Reads the devices in a document, for errors with their keys and lines.
pub(crate) fn check(text: &str, document: &DeValue<'_>) -> Result<(), CellError> {
    let devices = document.get("device").and_then(|devices| devices.get_ref().as_array());
    for (index, device) in devices.into_iter().flatten().enumerate() {
        let path = Path::to("device").then(index);
        if device.get_ref().as_table().is_none() {
            // The value is refused when the whole cell is read next.
            return Ok(());
        }
        read_entries::<DeviceKeys>(text, document, &path, |key| DEVICE_KEYS.contains(&key))?;
        let kind = device.get_ref().get("kind").and_then(|kind| kind.get_ref().as_str()).unwrap_or_default();
        let kind = OwnKind::named(kind).map_err(|problem| CellError::at(text, &path.then("kind"), problem))?;
        (kind.0.check)(text, document, &path).map_err(|mut error| {
            if error.problem.starts_with("is an unknown key") {
                error.problem += &format!("; keys of every device are {}", DEVICE_KEYS.join(", "));
            }
            error
        })?;
    }
    Ok(())
}

/// The own keys of a device.
#[derive(Clone, Debug)]
pub struct OwnSettings(Arc<dyn Keyed>);

impl OwnSettings {
    /// Name of the kind.
    pub fn kind(&self) -> &'static str {
        self.0.kind()
    }

    /// The crate of the kind.
    pub fn of_crate(&self) -> &'static str {
        self.0.of_crate()
    }

    /// The values of a sample.
    pub fn values(&self) -> &'static [DeviceValue] {
        self.0.values()
    }

    /// The line and its telegrams.
    pub fn line(&self) -> LineConfig {
        self.0.line()
    }

    pub(crate) fn check(&self) -> Result<(), String> {
        self.0.check()
    }

    /// The drive group of the device on `line`, and its other ends.
    pub(crate) fn open(
        &self,
        line: Box<dyn Line>,
        config: DeviceConfig,
    ) -> Result<OpenedDevice<Box<dyn DriveGroup>>, DeviceConfigError> {
        self.0.open(line, config)
    }

    /// The emulated device, whose cable breaks at `silent_from_s`, s.
    pub(crate) fn emulated(&self, surroundings: Surroundings, silent_from_s: Option<f64>) -> Box<dyn LineDevice> {
        self.0.emulated(surroundings, silent_from_s)
    }

    /// The device of a rehearsal.
    pub(crate) fn rehearsed(&self, period: std::time::Duration) -> (RehearsedDevice, drive::device::DeviceLink) {
        RehearsedDevice::new(&self.rehearsed_numbers(), self.line().sample_time(period))
    }

    /// The numbers of the sample of a rehearsal.
    pub(crate) fn rehearsed_numbers(&self) -> Vec<f64> {
        self.0.rehearsed()
    }

    pub(crate) fn table(&self) -> Result<toml::Value, toml::ser::Error> {
        self.0.table()
    }
}

/// [`OwnDevice`] without its type.
trait Keyed: fmt::Debug + Send + Sync {
    fn kind(&self) -> &'static str;
    fn of_crate(&self) -> &'static str;
    fn values(&self) -> &'static [DeviceValue];
    fn line(&self) -> LineConfig;
    fn check(&self) -> Result<(), String>;
    fn open(
        &self,
        line: Box<dyn Line>,
        config: DeviceConfig,
    ) -> Result<OpenedDevice<Box<dyn DriveGroup>>, DeviceConfigError>;
    fn emulated(&self, surroundings: Surroundings, silent_from_s: Option<f64>) -> Box<dyn LineDevice>;
    fn rehearsed(&self) -> Vec<f64>;
    fn table(&self) -> Result<toml::Value, toml::ser::Error>;
}

impl<T: OwnDevice> Keyed for T {
    fn kind(&self) -> &'static str {
        T::KIND
    }

    fn of_crate(&self) -> &'static str {
        crate_of::<T>()
    }

    fn values(&self) -> &'static [DeviceValue] {
        T::VALUES
    }

    fn line(&self) -> LineConfig {
        OwnDevice::line(self)
    }

    fn check(&self) -> Result<(), String> {
        OwnDevice::check(self)
    }

    fn open(
        &self,
        line: Box<dyn Line>,
        config: DeviceConfig,
    ) -> Result<OpenedDevice<Box<dyn DriveGroup>>, DeviceConfigError> {
        let (device, link, samples) = DeviceOnLine::new(line, self.driver(), config)?;
        Ok((Box::new(device), link, samples))
    }

    fn emulated(&self, surroundings: Surroundings, silent_from_s: Option<f64>) -> Box<dyn LineDevice> {
        let device = EmulatedOnLine::new(self.emulator(), surroundings);
        match silent_from_s {
            None => Box::new(device),
            Some(at) => Box::new(Unplugged::new(device, at)),
        }
    }

    fn rehearsed(&self) -> Vec<f64> {
        OwnDevice::rehearsed(self)
    }

    fn table(&self) -> Result<toml::Value, toml::ser::Error> {
        toml::Value::try_from(self)
    }
}
