//! Writes an electronic data sheet.

use std::fmt::{self, Display, Formatter};

use super::ini::uncommented;
use super::{
    Access, BAUD_RATES, Commissioning, DeviceInfo, Eds, Entry, FileInfo, ObjectType, ParameterValue, Variable,
};

/// The file, without empty values, which some readers refuse. Texts are reduced to what a line can hold: control
/// characters become blanks, and a comment character ends the text.
impl Display for Eds {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.file.write(f)?;
        writeln!(f)?;
        self.device.write(f)?;
        if let Some(commissioning) = &self.commissioning {
            writeln!(f)?;
            commissioning.write(f)?;
        }
        writeln!(f)?;
        section(f, "DummyUsage")?;
        for (dummy, number) in self.dummies.iter().zip(1..) {
            flag(f, format_args!("Dummy{number:04}"), *dummy)?;
        }
        writeln!(f)?;
        section(f, "Comments")?;
        key(f, "Lines", self.comments.len())?;
        for (line, number) in self.comments.iter().zip(1..) {
            text(f, format_args!("Line{number}"), line)?;
        }
        for name in ["MandatoryObjects", "OptionalObjects", "ManufacturerObjects"] {
            let indices = || {
                let indices = self.objects.keys();
                indices.filter(|index| list_of(**index) == name)
            };
            writeln!(f)?;
            section(f, name)?;
            key(f, "SupportedObjects", indices().count())?;
            for (index, number) in indices().zip(1..) {
                key(f, number, format_args!("{index:#06x}"))?;
            }
        }
        self.objects.iter().try_for_each(|(&index, entry)| entry.write(f, index))
    }
}

/// The list that an object belongs to (CiA 306-1 §6.6.3.1).
fn list_of(index: u16) -> &'static str {
    match index {
        0x1000 | 0x1001 | 0x1018 => "MandatoryObjects",
        0x2000..=0x5FFF => "ManufacturerObjects",
        _ => "OptionalObjects",
    }
}

fn section(f: &mut Formatter<'_>, name: impl Display) -> fmt::Result {
    writeln!(f, "[{name}]")
}

fn key(f: &mut Formatter<'_>, key: impl Display, value: impl Display) -> fmt::Result {
    writeln!(f, "{key}={value}")
}

fn flag(f: &mut Formatter<'_>, name: impl Display, set: bool) -> fmt::Result {
    key(f, name, u8::from(set))
}

fn number(f: &mut Formatter<'_>, name: &str, value: Option<u32>) -> fmt::Result {
    value.map_or(Ok(()), |value| key(f, name, format_args!("{value:#010x}")))
}

fn text(f: &mut Formatter<'_>, name: impl Display, value: &str) -> fmt::Result {
    match line(value).as_str() {
        "" => Ok(()),
        value => key(f, name, value),
    }
}

/// What of a text a line can hold.
fn line(text: &str) -> String {
    let text = text.replace(char::is_control, " ");
    uncommented(&text).to_owned()
}

impl FileInfo {
    fn write(&self, f: &mut Formatter<'_>) -> fmt::Result {
        section(f, "FileInfo")?;
        text(f, "FileName", &self.file_name)?;
        text(f, "FileVersion", &self.file_version)?;
        text(f, "FileRevision", &self.file_revision)?;
        text(f, "EDSVersion", &self.eds_version)?;
        text(f, "Description", &self.description)?;
        text(f, "CreationTime", &self.creation_time)?;
        text(f, "CreationDate", &self.creation_date)?;
        text(f, "CreatedBy", &self.created_by)
    }
}

impl DeviceInfo {
    fn write(&self, f: &mut Formatter<'_>) -> fmt::Result {
        section(f, "DeviceInfo")?;
        text(f, "VendorName", &self.vendor_name)?;
        number(f, "VendorNumber", self.vendor_number)?;
        text(f, "ProductName", &self.product_name)?;
        number(f, "ProductNumber", self.product_number)?;
        number(f, "RevisionNumber", self.revision_number)?;
        text(f, "OrderCode", &self.order_code)?;
        for rate in BAUD_RATES {
            let can = self.baud_rates.contains(&rate);
            flag(f, format_args!("BaudRate_{rate}"), can)?;
        }
        flag(f, "SimpleBootUpMaster", self.simple_boot_up_master)?;
        flag(f, "SimpleBootUpSlave", self.simple_boot_up_slave)?;
        key(f, "Granularity", self.granularity)?;
        flag(f, "DynamicChannelsSupported", self.dynamic_channels)?;
        flag(f, "GroupMessaging", self.group_messaging)?;
        key(f, "NrOfRXPDO", self.rpdos)?;
        key(f, "NrOfTXPDO", self.tpdos)?;
        flag(f, "LSS_Supported", self.lss)
    }
}

impl Commissioning {
    fn write(&self, f: &mut Formatter<'_>) -> fmt::Result {
        section(f, "DeviceComissioning")?;
        if let Some(node) = self.node {
            key(f, "NodeID", node)?;
        }
        if let Some(rate) = self.baud_rate {
            key(f, "Baudrate", rate)?;
        }
        if let Some(net) = self.net_number {
            key(f, "NetNumber", net)?;
        }
        flag(f, "CANopenManager", self.manager)?;
        number(f, "LSS_SerialNumber", self.serial_number)
    }
}

impl Entry {
    fn write(&self, f: &mut Formatter<'_>, index: u16) -> fmt::Result {
        writeln!(f)?;
        let address = format!("{index:04X}");
        section(f, &address)?;
        match (self.object_type, self.variables.get(&0)) {
            (ObjectType::Variable | ObjectType::Domain, Some(variable)) => {
                return variable.write(f, &address, self.object_type);
            }
            _ => head(f, &self.name, &address, self.object_type)?,
        }
        if !self.object_type.has_subindices() {
            return Ok(());
        }
        let counted = self.variables.keys().filter(|&&subindex| subindex != 0xFF);
        key(f, "SubNumber", counted.count())?;
        for (subindex, variable) in &self.variables {
            writeln!(f)?;
            let address = format!("{index:04X}sub{subindex:X}");
            section(f, &address)?;
            variable.write(f, &address, ObjectType::Variable)?;
        }
        Ok(())
    }
}

/// Every reader wants a name: one that has none is called by its address.
fn head(f: &mut Formatter<'_>, name: &str, address: &str, object_type: ObjectType) -> fmt::Result {
    let name = line(name);
    let name = if name.is_empty() { address } else { &name };
    key(f, "ParameterName", name)?;
    key(f, "ObjectType", format_args!("{:#x}", object_type as u8))
}

impl Variable {
    fn write(&self, f: &mut Formatter<'_>, address: &str, object_type: ObjectType) -> fmt::Result {
        head(f, &self.name, address, object_type)?;
        let code = self.data_type.code();
        key(f, "DataType", format_args!("{code:#06x}"))?;
        key(f, "AccessType", self.access.name())?;
        let values = [("DefaultValue", &self.default), ("LowLimit", &self.low), ("HighLimit", &self.high)];
        for (name, value) in values {
            if let Some(value) = value {
                text(f, name, &value.to_string())?;
            }
        }
        flag(f, "PDOMapping", self.pdo_mapping)?;
        let flags = u8::from(self.refuses_download) | u8::from(self.refuses_scan) << 1;
        if flags != 0 {
            key(f, "ObjFlags", flags)?;
        }
        match self.parameter.as_ref().map(|parameter| &parameter.value) {
            None => Ok(()),
            Some(ParameterValue::Value(value)) => text(f, "ParameterValue", &value.to_string()),
            Some(ParameterValue::File(file)) => text(f, "DownloadFile", file),
        }
    }
}

impl Access {
    fn name(self) -> &'static str {
        let known = Self::ALL.into_iter().find(|(access, _)| *access == self);
        known.expect("all are in the table").1
    }
}
