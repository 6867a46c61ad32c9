//! Reads an electronic data sheet.

use std::collections::{BTreeMap, BTreeSet};

use super::ini::{self, Kind, Section, Text, kind};
use super::value::number;
use super::{
    Access, BAUD_RATES, Commissioning, DataType, DeviceInfo, Eds, EdsCause, EdsError, Entry, FileInfo, Flaw,
    MAX_VARIABLES, ObjectType, Parameter, ParameterValue, Part, Value, Variable,
};
use crate::{NodeId, Object};

/// Keys of a variable whose second value is judged where the first is read.
const JUDGED: [&str; 10] = [
    "ParameterName",
    "ObjectType",
    "CompactSubObj",
    "DataType",
    "AccessType",
    "ObjFlags",
    "DefaultValue",
    "LowLimit",
    "HighLimit",
    "ParameterValue",
];

/// The same keys of `[DeviceInfo]` and `[DeviceComissioning]`.
const JUDGED_OF_DEVICE: [&str; 5] = ["VendorNumber", "ProductNumber", "RevisionNumber", "NodeID", "Baudrate"];

/// Reads the file. A file without a section of an object is refused if any of its lines is wrong.
pub(super) fn read(text: &str) -> Result<Eds, EdsError> {
    let (sections, before) = ini::sections(text)?;
    let mut reader = Reader::default();
    for error in before {
        reader.note(Part::Nothing, error);
    }
    let mut described = Vec::new();
    for section in &sections {
        match kind(section) {
            Ok(kind) => described.push((kind, section)),
            // A heading that cannot be read has its error already.
            Err(_) if section.name.is_empty() => {}
            Err(error) => reader.flaw(Part::Nothing, error, section.states()),
        }
    }
    reader.sections(&described)?;
    for section in &sections {
        reader.odd_lines(section);
    }
    let Reader { mut eds, .. } = reader;
    eds.flaws.sort_by_key(|flaw| flaw.error.line);
    match eds.flaws.first() {
        Some(first) if eds.objects.is_empty() => Err(first.error),
        _ => Ok(eds),
    }
}

/// What was read so far.
#[derive(Default)]
struct Reader {
    eds: Eds,
    /// Number of sub-indices of compact arrays, by index.
    compact: BTreeMap<u16, u8>,
    /// Objects whose section is there and cannot be read.
    unread: BTreeSet<u16>,
}

impl Reader {
    fn flaw(&mut self, part: Part, error: EdsError, stated: bool) {
        self.eds.flaws.push(Flaw { error, part, stated });
    }

    /// An error on which no stated value depends.
    fn note(&mut self, part: Part, error: EdsError) {
        self.flaw(part, error, false);
    }

    fn sections(&mut self, sections: &[(Kind, &Section<'_>)]) -> Result<(), EdsError> {
        let mut variables = 0;
        for &(kind, section) in sections {
            match kind {
                Kind::Object(index) => {
                    self.object(section, index);
                    variables += self.eds.objects.get(&index).map_or(0, |entry| entry.variables.len());
                }
                // Known once all objects are.
                Kind::Sub(..) => variables += 1,
                Kind::Names(_) | Kind::Values(_) => {}
                Kind::Other => self.other(section),
            }
            if variables > MAX_VARIABLES {
                return Err(EdsCause::TooMany.at(section.line));
            }
        }
        for &(kind, section) in sections {
            if let Kind::Sub(index, subindex) = kind {
                self.subindex(section, Object::new(index, subindex));
            }
        }
        for &(kind, section) in sections {
            match kind {
                Kind::Object(index) if !self.compact.contains_key(&index) => self.sub_number(section, index),
                Kind::Names(index) => self.names(section, index),
                Kind::Values(index) => self.values(section, index),
                Kind::Object(_) | Kind::Sub(..) | Kind::Other => {}
            }
        }
        self.lists(sections);
        Ok(())
    }

    fn object(&mut self, section: &Section<'_>, index: u16) {
        match self.entry(section, index) {
            Ok((entry, count)) => {
                if let Some(count) = count {
                    self.compact.insert(index, count);
                }
                self.eds.objects.insert(index, entry);
            }
            Err(error) => {
                self.unread.insert(index);
                self.flaw(Part::Entry(index), error, section.states());
            }
        }
    }

    fn subindex(&mut self, section: &Section<'_>, object: Object) {
        let index = object.index;
        if self.unread.contains(&index) && !section.states() {
            // The flaw of the object is told.
            return;
        }
        let entry = self.eds.objects.get(&index).filter(|entry| entry.object_type.has_subindices());
        let read = match entry.is_some() && !self.compact.contains_key(&index) {
            true => self.variable(section, object),
            false => Err(EdsCause::Orphan { index }.at(section.line)),
        };
        match (read, self.eds.objects.get_mut(&index)) {
            (Ok(variable), Some(entry)) => {
                entry.variables.insert(object.subindex, variable);
            }
            (Ok(_), None) => {}
            (Err(error), _) => self.flaw(Part::Variable(object), error, section.states()),
        }
    }

    fn other(&mut self, section: &Section<'_>) {
        match section.name.to_ascii_lowercase().as_str() {
            "fileinfo" => self.eds.file = file_info(section),
            "deviceinfo" => self.eds.device = self.device_info(section),
            "devicecomissioning" | "devicecommissioning" => {
                self.eds.commissioning = Some(self.commissioning(section));
            }
            "comments" => self.eds.comments = comments(section),
            "dummyusage" => {
                for (number, at) in (1..).zip(0..self.eds.dummies.len()) {
                    self.eds.dummies[at] = self.flag(section, &format!("Dummy{number:04}"));
                }
            }
            _ => {}
        }
    }

    /// An object of its own section, and how many sub-indices it has if `CompactSubObj` says that.
    fn entry(&mut self, section: &Section<'_>, index: u16) -> Result<(Entry, Option<u8>), EdsError> {
        section.unambiguous(&["ParameterName", "ObjectType", "CompactSubObj"])?;
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
        let compact = section.number::<u8>("CompactSubObj", 255)?;
        if let (Some(count @ 1..), Some(value)) = (compact, section.get("CompactSubObj")) {
            if !object_type.has_subindices() {
                let (line, found) = (value.line, object_type as i128);
                return Err(EdsCause::ObjectType { found }.at(line));
            }
            let most = u8::MAX - 1;
            if count > most {
                // Sub-index 0xFF is the type of the object.
                self.note(Part::Nothing, EdsCause::Range { low: 0, high: most.into() }.at(value.line));
            }
            let count = count.min(most);
            if self.flag(section, "SubNumber")
                && let Err(error) = section.count("SubNumber", usize::from(count) + 1)
            {
                self.note(Part::Nothing, error);
            }
            let each = self.variable(section, Object::new(index, 1))?;
            entry.variables.insert(0, count_variable(count));
            for subindex in 1..=count {
                let mut variable = each.clone();
                variable.name = format!("{}{subindex}", entry.name);
                entry.variables.insert(subindex, variable);
            }
            return Ok((entry, Some(count)));
        }
        if matches!(object_type, ObjectType::Variable | ObjectType::Domain) {
            entry.variables.insert(0, self.variable(section, Object::new(index, 0))?);
        }
        Ok((entry, None))
    }

    /// The variable that a section describes. A domain need not say its type and access (CiA 306-1 table 7).
    fn variable(&mut self, section: &Section<'_>, object: Object) -> Result<Variable, EdsError> {
        section.unambiguous(&["ParameterName", "ObjectType", "DataType", "AccessType", "ObjFlags"])?;
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
        let flags = section.number::<u32>("ObjFlags", u32::MAX.into())?.unwrap_or(0);
        let mut variable = Variable {
            name: section.parameter_name(),
            data_type,
            access,
            default: self.value(section, data_type, "DefaultValue", Part::Default(object)),
            low: self.value(section, data_type, "LowLimit", Part::Limits(object)),
            high: self.value(section, data_type, "HighLimit", Part::Limits(object)),
            pdo_mapping: self.flag(section, "PDOMapping"),
            refuses_download: flags & 1 != 0,
            refuses_scan: flags & 2 != 0,
            parameter: None,
        };
        let stated = ["ParameterValue", "DownloadFile"];
        for error in stated.iter().filter_map(|key| section.second(key)) {
            self.flaw(Part::Nothing, error, true);
        }
        variable.parameter = match stated.map(|key| section.get(key)) {
            [Some(text), _] => self.parameter(&variable, text),
            [None, Some(Text { line, text })] => Some(Parameter { value: ParameterValue::File(text.to_owned()), line }),
            [None, None] => None,
        };
        Ok(variable)
    }

    /// A default or a limit; `None` if the section has none, two, or one without a certain meaning.
    fn value(&mut self, section: &Section<'_>, data_type: DataType, key: &str, part: Part) -> Option<Value> {
        // A stated value must be within its limits.
        let stated = matches!(part, Part::Limits(_)) && section.states();
        if let Some(error) = section.second(key) {
            self.flaw(part, error, stated);
            return None;
        }
        let (value, error) = Value::read(data_type, section.get(key)?);
        if let Some(error) = error {
            self.flaw(part, error, stated && value.is_none());
        }
        value
    }

    /// A parameter value within the limits of its variable.
    fn parameter(&mut self, variable: &Variable, text: Text<'_>) -> Option<Parameter> {
        match parameter(variable, text) {
            Ok(parameter) => Some(parameter),
            Err(error) => {
                self.flaw(Part::Nothing, error, true);
                None
            }
        }
    }

    /// Checks whether `SubNumber` counts the sub-indices; 0xFF, which says what type the object has, does not count (CiA
    /// 306-1 §6.6.3.2).
    fn sub_number(&mut self, section: &Section<'_>, index: u16) {
        let Some(entry) = self.eds.objects.get(&index) else {
            return;
        };
        let described = entry.variables.keys().filter(|&&subindex| subindex != 0xFF);
        let has_subindices = entry.object_type.has_subindices();
        if let Err(error) = section.count("SubNumber", if has_subindices { described.count() } else { 0 }) {
            self.note(Part::Nothing, error);
        }
    }

    fn names(&mut self, section: &Section<'_>, index: u16) {
        for (subindex, text) in self.compact_lines(section, index, false) {
            if let Some(variable) = self.compact_variable(index, subindex) {
                text.text.clone_into(&mut variable.name);
            }
        }
    }

    fn values(&mut self, section: &Section<'_>, index: u16) {
        for (subindex, text) in self.compact_lines(section, index, true) {
            if let Some(variable) = self.compact_variable(index, subindex).cloned() {
                let parameter = self.parameter(&variable, text);
                if let Some(variable) = self.compact_variable(index, subindex) {
                    variable.parameter = parameter;
                }
            }
        }
    }

    fn compact_variable(&mut self, index: u16, subindex: u8) -> Option<&mut Variable> {
        self.eds.objects.get_mut(&index)?.variables.get_mut(&subindex)
    }

    /// The numbered lines of `[1003Name]` or `[1003Value]` that are not empty, by sub-index. The lines of the latter are
    /// `stated`.
    fn compact_lines<'a>(&mut self, section: &Section<'a>, index: u16, stated: bool) -> Vec<(u8, Text<'a>)> {
        let Some(count) = self.compact.get(&index).copied() else {
            self.flaw(Part::Nothing, EdsCause::Orphan { index }.at(section.line), stated);
            return Vec::new();
        };
        let lines: Vec<_> = section.numbered().collect();
        if let Err(error) = section.count("NrOfEntries", lines.len()) {
            self.flaw(Part::Nothing, error, stated);
        }
        let mut known = Vec::new();
        for (subindex, text) in lines {
            match u8::try_from(subindex).ok().filter(|subindex| (1..=count).contains(subindex)) {
                Some(_) if text.text.is_empty() => {}
                Some(subindex) => known.push((subindex, text)),
                None => {
                    let range = EdsCause::Range { low: 1, high: count.into() };
                    self.flaw(Part::Nothing, range.at(text.line), stated);
                }
            }
        }
        known
    }

    /// Compares the lists of objects (CiA 306-1 §6.6.3.1) with the descriptions. `SupportedObjects` is the count of a
    /// list. Files of vendors that every tool reads are off by one, and nothing depends on the count.
    fn lists(&mut self, sections: &[(Kind, &Section<'_>)]) {
        let names = ["mandatoryobjects", "optionalobjects", "manufacturerobjects"];
        let is_list = |section: &Section<'_>| names.contains(&section.name.to_ascii_lowercase().as_str());
        let indices = sections.iter().filter_map(|(kind, section)| match kind {
            Kind::Object(index) => Some((*index, section.line)),
            _ => None,
        });
        let described: BTreeMap<u16, u32> = indices.collect();
        let lists: Vec<_> = sections.iter().filter(|(_, section)| is_list(section)).collect();
        let mut listed = BTreeSet::new();
        for (_, list) in &lists {
            for (_, text) in list.numbered() {
                match unsigned::<u16>(text, u16::MAX.into()) {
                    Ok(index) => {
                        listed.insert(index);
                        if !described.contains_key(&index) {
                            self.note(Part::Entry(index), EdsCause::Undescribed { index }.at(text.line));
                        }
                    }
                    Err(error) => self.note(Part::Nothing, error),
                }
            }
        }
        if !lists.is_empty() {
            for (index, line) in described.into_iter().filter(|(index, _)| !listed.contains(index)) {
                self.note(Part::Nothing, EdsCause::Unlisted { index }.at(line));
            }
        }
    }

    fn flag(&mut self, section: &Section<'_>, key: &str) -> bool {
        self.number::<u32>(section, key, u32::MAX.into(), Part::Nothing).unwrap_or(0) != 0
    }

    /// The number at `key`; `None` if the section has none, two, or none that fits.
    fn number<T: TryFrom<i128>>(&mut self, section: &Section<'_>, key: &str, high: i128, part: Part) -> Option<T> {
        let second = section.second(key).filter(|_| part != Part::Nothing);
        match second.map_or_else(|| section.number(key, high), Err) {
            Ok(number) => number,
            Err(error) => {
                self.note(part, error);
                None
            }
        }
    }

    fn device_info(&mut self, section: &Section<'_>) -> DeviceInfo {
        let baud_rates = BAUD_RATES.into_iter().filter(|rate| self.flag(section, &format!("BaudRate_{rate}")));
        let baud_rates = baud_rates.collect();
        let mut identity = |key| self.number(section, key, u32::MAX.into(), Part::Identity);
        let [vendor_number, product_number, revision_number] =
            ["VendorNumber", "ProductNumber", "RevisionNumber"].map(&mut identity);
        let mut count = |key, high| self.number(section, key, high, Part::Nothing).unwrap_or(0);
        let [rpdos, tpdos] = ["NrOfRXPDO", "NrOfTXPDO"].map(|key| count(key, u16::MAX.into()));
        let granularity = count("Granularity", 64);
        DeviceInfo {
            vendor_name: section.text("VendorName"),
            vendor_number,
            product_name: section.text("ProductName"),
            product_number,
            revision_number,
            order_code: section.text("OrderCode"),
            baud_rates,
            simple_boot_up_master: self.flag(section, "SimpleBootUpMaster"),
            simple_boot_up_slave: self.flag(section, "SimpleBootUpSlave"),
            granularity: granularity as u8,
            dynamic_channels: self.flag(section, "DynamicChannelsSupported"),
            group_messaging: self.flag(section, "GroupMessaging"),
            rpdos,
            tpdos,
            lss: self.flag(section, "LSS_Supported"),
        }
    }

    /// The place on the network. The node-IDs 0 and 0xFF stand for none, as in a drive whose node-ID is not configured
    /// (CiA 305).
    fn commissioning(&mut self, section: &Section<'_>) -> Commissioning {
        let stated: Option<u8> = self.number(section, "NodeID", 255, Part::Place);
        let node = stated.and_then(NodeId::new);
        if let (Some(stated), None, Some(text)) = (stated, node, section.get("NodeID")) {
            let part = if matches!(stated, 0 | 0xFF) { Part::Nothing } else { Part::Place };
            self.note(part, EdsCause::Range { low: 1, high: 127 }.at(text.line));
        }
        let rate: Option<u16> = self.number(section, "Baudrate", u16::MAX.into(), Part::Place);
        let serial: Option<u32> = self.number(section, "LSS_SerialNumber", u32::MAX.into(), Part::Nothing);
        Commissioning {
            node,
            baud_rate: rate.filter(|rate| *rate != 0),
            net_number: self.number(section, "NetNumber", u32::MAX.into(), Part::Nothing),
            manager: self.flag(section, "CANopenManager"),
            serial_number: serial.filter(|number| *number != 0),
        }
    }

    /// Lines that are no sections and no keys, and repetitions. An unreadable line may be a limit of its variable or a
    /// value for the device.
    fn odd_lines(&mut self, section: &Section<'_>) {
        let kind = kind(section);
        let states = section.states();
        let limits = match kind {
            Ok(Kind::Object(index)) => Part::Limits(Object::new(index, 0)),
            Ok(Kind::Sub(index, subindex)) => Part::Limits(Object::new(index, subindex)),
            _ => Part::Nothing,
        };
        let of_object = !matches!(kind, Ok(Kind::Other | Kind::Names(_)));
        for &error in &section.odd {
            match error.cause {
                EdsCause::Line => self.flaw(limits, error, of_object || states),
                EdsCause::DuplicateSection { .. } => self.flaw(Part::Nothing, error, states),
                _ => self.note(Part::Nothing, error),
            }
        }
        // The other keys are judged where they are read.
        let read: &[&str] = match kind {
            Ok(Kind::Object(_) | Kind::Sub(..)) => &JUDGED,
            Ok(Kind::Other) => &JUDGED_OF_DEVICE,
            _ => &[],
        };
        for (key, error) in &section.ambiguous {
            if !read.iter().any(|known| known.eq_ignore_ascii_case(key)) {
                self.flaw(Part::Nothing, *error, matches!(kind, Ok(Kind::Values(_))));
            }
        }
    }
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

    /// Refuses two values of any of the keys.
    fn unambiguous(&self, keys: &[&str]) -> Result<(), EdsError> {
        keys.iter().find_map(|key| self.second(key)).map_or(Ok(()), Err)
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

fn comments(section: &Section<'_>) -> Vec<String> {
    // Sorted by their numbers: the keys are sorted as texts.
    let lines: BTreeMap<u32, &str> = section
        .keys
        .iter()
        .filter_map(|(key, value)| Some((key.strip_prefix("line")?.parse().ok()?, value.text)))
        .collect();
    lines.into_values().map(str::to_owned).collect()
}
