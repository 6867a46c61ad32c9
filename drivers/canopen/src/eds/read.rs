//! Reads an electronic data sheet.

use std::collections::BTreeMap;

use super::ini::{self, Section, Text};
use super::value::number;
use super::{
    Access, BAUD_RATES, Commissioning, DataType, DeviceInfo, Eds, EdsCause, EdsError, Entry, FileInfo, MAX_VARIABLES,
    ObjectType, Parameter, ParameterValue, Value, Variable,
};
use crate::NodeId;

/// What the name of a section says.
enum Kind {
    Object(u16),
    Sub(u16, u8),
    /// `[1003Name]`: names of a compact array (CiA 306-1 §6.6.3.4).
    Names(u16),
    /// `[1003Value]`: parameter values of a compact array (CiA 306-1 §7.3.4.3).
    Values(u16),
    Other,
}

fn kind(section: &Section<'_>) -> Result<Kind, EdsError> {
    let name = section.name;
    let error = EdsCause::NotAnObject.at(section.line);
    let index = name.get(..4).and_then(hex);
    let Some(index) = index.and_then(|index| u16::try_from(index).ok()) else {
        // `[60400]` is meant as an object and `[FileInfo]` is not.
        return if name.starts_with(|first: char| first.is_ascii_digit()) { Err(error) } else { Ok(Kind::Other) };
    };
    let rest = name[4..].to_ascii_lowercase();
    match rest.as_str() {
        "" => Ok(Kind::Object(index)),
        "name" => Ok(Kind::Names(index)),
        "value" => Ok(Kind::Values(index)),
        "denotation" | "objectlinks" => Ok(Kind::Other),
        rest => {
            let Some(digits) = rest.strip_prefix("sub") else {
                // `[Feedback]` is a vendor's own, although its first letters are digits.
                return name.starts_with(|first: char| first.is_ascii_alphabetic()).then_some(Kind::Other).ok_or(error);
            };
            let subindex = hex(digits).and_then(|subindex| u8::try_from(subindex).ok());
            Ok(Kind::Sub(index, subindex.ok_or(error)?))
        }
    }
}

/// Hex digits alone, without a sign.
fn hex(digits: &str) -> Option<u32> {
    let all = !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    all.then(|| u32::from_str_radix(digits, 16).ok())?
}

pub(super) fn read(text: &str) -> Result<Eds, EdsError> {
    let sections = ini::sections(text)?;
    let mut eds = Eds::default();
    let mut compact = BTreeMap::new();
    let (mut subs, mut lists) = (Vec::new(), Vec::new());
    let mut variables = 0;
    for section in &sections {
        match kind(section)? {
            Kind::Object(index) => {
                let (entry, count) = entry(section)?;
                if let Some(count) = count {
                    compact.insert(index, count);
                }
                variables += entry.variables.len();
                eds.objects.insert(index, entry);
            }
            // Known once all objects are.
            Kind::Sub(index, subindex) => subs.push((index, subindex, section)),
            Kind::Names(_) | Kind::Values(_) => {}
            Kind::Other => match section.name.to_ascii_lowercase().as_str() {
                "fileinfo" => eds.file = file_info(section),
                "deviceinfo" => eds.device = device_info(section)?,
                "devicecomissioning" | "devicecommissioning" => {
                    eds.commissioning = Some(commissioning(section)?);
                }
                "comments" => eds.comments = comments(section),
                "dummyusage" => eds.dummies = dummies(section)?,
                "mandatoryobjects" | "optionalobjects" | "manufacturerobjects" => {
                    lists.push(section);
                }
                _ => {}
            },
        }
        if variables + subs.len() > MAX_VARIABLES {
            return Err(EdsCause::TooMany.at(section.line));
        }
    }
    for (index, subindex, section) in subs {
        let line = section.line;
        let orphan = EdsCause::Orphan { index }.at(line);
        let entry = eds.objects.get_mut(&index).ok_or(orphan)?;
        if !entry.object_type.has_subindices() || compact.contains_key(&index) {
            return Err(orphan);
        }
        let variable = variable(section)?;
        // `[1018sub01]` beside `[1018sub1]`.
        if entry.variables.insert(subindex, variable).is_some() {
            return Err(EdsCause::NotAnObject.at(line));
        }
    }
    for section in &sections {
        match kind(section)? {
            Kind::Object(index) if !compact.contains_key(&index) => {
                sub_number(section, &eds.objects[&index])?;
            }
            Kind::Names(index) => {
                for (subindex, text) in compact_lines(section, index, &compact)? {
                    text.text.clone_into(&mut compact_variable(&mut eds, index, subindex).name);
                }
            }
            Kind::Values(index) => {
                for (subindex, text) in compact_lines(section, index, &compact)? {
                    let variable = compact_variable(&mut eds, index, subindex);
                    variable.parameter = Some(parameter(variable, text)?);
                }
            }
            Kind::Object(_) | Kind::Sub(..) | Kind::Other => {}
        }
    }
    for list in lists {
        for (line, index) in listed(list)? {
            if !eds.objects.contains_key(&index) {
                return Err(EdsCause::Undescribed { index }.at(line));
            }
        }
    }
    Ok(eds)
}

fn unsigned<T: TryFrom<i128>>(value: Text<'_>, high: i128) -> Result<T, EdsError> {
    let Text { line, text } = value;
    let found = number(text).ok_or(EdsCause::Number.at(line))?;
    let range = EdsCause::Range { low: 0, high }.at(line);
    let found = (0..=high).contains(&found).then_some(found).ok_or(range)?;
    T::try_from(found).map_err(|_| range)
}

impl Section<'_> {
    fn text(&self, key: &str) -> String {
        self.get(key).map_or_else(String::new, |value| value.text.to_owned())
    }

    /// The name of an object; its address where it has none.
    fn parameter_name(&self) -> String {
        let name = self.get("ParameterName");
        name.map_or(self.name, |name| name.text).to_owned()
    }

    fn number<T: TryFrom<i128>>(&self, key: &str, high: i128) -> Result<Option<T>, EdsError> {
        self.get(key).map(|value| unsigned(value, high)).transpose()
    }

    fn flag(&self, key: &str) -> Result<bool, EdsError> {
        Ok(self.number::<u32>(key, u32::MAX.into())?.unwrap_or(0) != 0)
    }

    /// Checks that the count at `key` equals the number of entries.
    fn count(&self, key: &'static str, found: usize) -> Result<(), EdsError> {
        let Some(value) = self.get(key) else {
            return Ok(());
        };
        let said: i128 = unsigned(value, u32::MAX.into())?;
        if said == found as i128 { Ok(()) } else { Err(EdsCause::Count { key, said, found }.at(value.line)) }
    }
}

/// An object of its own section, and how many sub-indices it has if `CompactSubObj` says that.
fn entry(section: &Section<'_>) -> Result<(Entry, Option<u8>), EdsError> {
    let object_type = match section.get("ObjectType") {
        None => ObjectType::Variable,
        Some(value) => {
            let found: i128 = unsigned(value, u32::MAX.into())?;
            let known = ObjectType::ALL.into_iter().find(|kind| *kind as i128 == found);
            let line = value.line;
            known.ok_or(EdsCause::ObjectType { found }.at(line))?
        }
    };
    let mut entry = Entry { name: section.parameter_name(), object_type, variables: BTreeMap::new() };
    let compact = section.number::<u8>("CompactSubObj", 254)?;
    let compact = compact.filter(|&count| count > 0);
    if let (Some(count), Some(value)) = (compact, section.get("CompactSubObj")) {
        if !object_type.has_subindices() {
            let (line, found) = (value.line, object_type as i128);
            return Err(EdsCause::ObjectType { found }.at(line));
        }
        if section.flag("SubNumber")? {
            section.count("SubNumber", usize::from(count) + 1)?;
        }
        let each = variable(section)?;
        entry.variables.insert(0, count_variable(count));
        for subindex in 1..=count {
            let mut variable = each.clone();
            variable.name = format!("{}{subindex}", entry.name);
            entry.variables.insert(subindex, variable);
        }
        return Ok((entry, Some(count)));
    }
    if matches!(object_type, ObjectType::Variable | ObjectType::Domain) {
        entry.variables.insert(0, variable(section)?);
    }
    Ok((entry, None))
}

/// Sub-index 0 of a compact array.
fn count_variable(count: u8) -> Variable {
    Variable {
        name: "Number of entries".into(),
        data_type: DataType::Unsigned8,
        access: Access::ReadOnly,
        default: Some(Value::number(count.into())),
        low: None,
        high: None,
        pdo_mapping: false,
        refuses_download: false,
        refuses_scan: false,
        parameter: None,
    }
}

/// The variable that a section describes. A domain need not say its type and access (CiA 306-1 table 7).
fn variable(section: &Section<'_>) -> Result<Variable, EdsError> {
    let domain = section.number("ObjectType", u32::MAX.into())? == Some(ObjectType::Domain as u32);
    let missing = |key| EdsCause::Missing { key }.at(section.line);
    let data_type = match section.number("DataType", u16::MAX.into())? {
        Some(code) => DataType::from_code(code),
        None if domain => DataType::Domain,
        None => return Err(missing("DataType")),
    };
    let access = match section.get("AccessType") {
        Some(Text { line, text }) => Access::ALL
            .into_iter()
            .find(|(_, name)| name.eq_ignore_ascii_case(text))
            .map(|(access, _)| access)
            .ok_or(EdsCause::Access.at(line))?,
        None if domain => Access::ReadWrite,
        None => return Err(missing("AccessType")),
    };
    let value = |key| {
        let given = section.get(key);
        given.map(|text| Value::parse(data_type, text)).transpose()
    };
    let flags = section.number::<u32>("ObjFlags", u32::MAX.into())?;
    let flags = flags.unwrap_or(0);
    let mut variable = Variable {
        name: section.parameter_name(),
        data_type,
        access,
        default: value("DefaultValue")?,
        low: value("LowLimit")?,
        high: value("HighLimit")?,
        pdo_mapping: section.flag("PDOMapping")?,
        refuses_download: flags & 1 != 0,
        refuses_scan: flags & 2 != 0,
        parameter: None,
    };
    variable.parameter = match (section.get("ParameterValue"), section.get("DownloadFile")) {
        (Some(text), _) => Some(parameter(&variable, text)?),
        (None, Some(Text { line, text })) => Some(Parameter { value: ParameterValue::File(text.to_owned()), line }),
        (None, None) => None,
    };
    Ok(variable)
}

/// A parameter value within the limits of its variable.
fn parameter(variable: &Variable, text: Text<'_>) -> Result<Parameter, EdsError> {
    let line = text.line;
    let value = Value::parse(variable.data_type, text)?;
    // As many added node-IDs as may be: the lowest and the highest must both be within.
    let nodes = [NodeId::MIN, NodeId::MAX];
    if let Some((least, most)) = variable.data_type.range() {
        let limit = |limit: &Option<Value>, node, open| {
            let limit = limit.as_ref().and_then(|limit| limit.integer(node));
            limit.unwrap_or(open)
        };
        for node in nodes {
            let (low, high) = (limit(&variable.low, node, least), limit(&variable.high, node, most));
            if value.integer(node).is_some_and(|value| value < low || value > high) {
                return Err(EdsCause::Limits { low, high }.at(line));
            }
        }
    }
    let value = ParameterValue::Value(value);
    Ok(Parameter { value, line })
}

/// Whether `SubNumber` counts the sub-indices; 0xFF, which says what type the object has, does not count (CiA 306-1
/// §6.6.3.2).
fn sub_number(section: &Section<'_>, entry: &Entry) -> Result<(), EdsError> {
    let described = entry.variables.keys().filter(|&&subindex| subindex != 0xFF);
    let has_subindices = entry.object_type.has_subindices();
    section.count("SubNumber", if has_subindices { described.count() } else { 0 })
}

/// The numbered lines of `[1003Name]` or `[1003Value]` that are not empty, by sub-index.
fn compact_lines<'a>(
    section: &Section<'a>,
    index: u16,
    compact: &BTreeMap<u16, u8>,
) -> Result<Vec<(u8, Text<'a>)>, EdsError> {
    let line = section.line;
    let count = *compact.get(&index).ok_or(EdsCause::Orphan { index }.at(line))?;
    let lines: Vec<_> = section.numbered().collect();
    section.count("NrOfEntries", lines.len())?;
    let subindex = |(subindex, text): (u32, Text<'a>)| {
        let known = u8::try_from(subindex).ok();
        let known = known.filter(|subindex| (1..=count).contains(subindex));
        let range = EdsCause::Range { low: 1, high: count.into() }.at(text.line);
        Ok((known.ok_or(range)?, text))
    };
    let mut lines: Vec<_> = lines.into_iter().map(subindex).collect::<Result<_, _>>()?;
    lines.retain(|(_, text)| !text.text.is_empty());
    Ok(lines)
}

fn compact_variable(eds: &mut Eds, index: u16, subindex: u8) -> &mut Variable {
    let entry = eds.objects.get_mut(&index);
    let variable = entry.and_then(|entry| entry.variables.get_mut(&subindex));
    variable.expect("every sub-index of a compact array was made with it")
}

/// The indices of a list of objects (CiA 306-1 §6.6.3.1), each with its line. `SupportedObjects` is their count. Files
/// of vendors that every tool reads are off by one, and nothing depends on the count.
fn listed(section: &Section<'_>) -> Result<Vec<(u32, u16)>, EdsError> {
    let index = |text: Text<'_>| Ok((text.line, unsigned(text, u16::MAX.into())?));
    section.numbered().map(|(_, text)| index(text)).collect()
}

fn file_info(section: &Section<'_>) -> FileInfo {
    FileInfo {
        file_name: section.text("FileName"),
        file_version: section.text("FileVersion"),
        file_revision: section.text("FileRevision"),
        eds_version: section.text("EDSVersion"),
        description: section.text("Description"),
        creation_time: section.text("CreationTime"),
        creation_date: section.text("CreationDate"),
        created_by: section.text("CreatedBy"),
    }
}

fn device_info(section: &Section<'_>) -> Result<DeviceInfo, EdsError> {
    let mut baud_rates = Vec::new();
    for rate in BAUD_RATES {
        if section.flag(&format!("BaudRate_{rate}"))? {
            baud_rates.push(rate);
        }
    }
    let word = |key| section.number(key, u32::MAX.into());
    let count = |key| Ok(section.number(key, u16::MAX.into())?.unwrap_or(0));
    Ok(DeviceInfo {
        vendor_name: section.text("VendorName"),
        vendor_number: word("VendorNumber")?,
        product_name: section.text("ProductName"),
        product_number: word("ProductNumber")?,
        revision_number: word("RevisionNumber")?,
        order_code: section.text("OrderCode"),
        baud_rates,
        simple_boot_up_master: section.flag("SimpleBootUpMaster")?,
        simple_boot_up_slave: section.flag("SimpleBootUpSlave")?,
        granularity: section.number("Granularity", 64)?.unwrap_or(0),
        dynamic_channels: section.flag("DynamicChannelsSupported")?,
        group_messaging: section.flag("GroupMessaging")?,
        rpdos: count("NrOfRXPDO")?,
        tpdos: count("NrOfTXPDO")?,
        lss: section.flag("LSS_Supported")?,
    })
}

fn commissioning(section: &Section<'_>) -> Result<Commissioning, EdsError> {
    let node = section.get("NodeID").map(|value| {
        let node = NodeId::new(unsigned(value, 127)?);
        node.ok_or(EdsCause::Range { low: 1, high: 127 }.at(value.line))
    });
    Ok(Commissioning {
        node: node.transpose()?,
        baud_rate: section.number("Baudrate", u16::MAX.into())?.filter(|rate| *rate != 0),
        net_number: section.number("NetNumber", u32::MAX.into())?,
        manager: section.flag("CANopenManager")?,
        serial_number: section.number("LSS_SerialNumber", u32::MAX.into())?.filter(|number| *number != 0),
    })
}

fn comments(section: &Section<'_>) -> Vec<String> {
    // Sorted by their numbers: the keys are sorted as texts.
    let lines: BTreeMap<u32, &str> = section
        .keys
        .iter()
        .filter_map(|(key, value)| Some((key.strip_prefix("line")?.parse().ok()?, value.text)))
        .collect();
    lines.into_values().map(str::to_owned).collect()
}

fn dummies(section: &Section<'_>) -> Result<[bool; 7], EdsError> {
    let mut dummies = [false; 7];
    for (dummy, number) in dummies.iter_mut().zip(1..) {
        *dummy = section.flag(&format!("Dummy{number:04}"))?;
    }
    Ok(dummies)
}
