//! Electronic data sheets: EDS and DCF files (CiA 306-1).
//!
//! An EDS lists the objects of a kind of device (CiA 306-1 §6). A DCF (§7) is the EDS of one device with the values for
//! that device (`ParameterValue`) and its place on the network (`DeviceComissioning`, the standard's spelling).
//! [`Eds::read`] reads and checks the bytes of both. `Display` of [`Eds`] writes a file that this reader and other
//! readers understand. [`crate::dcf`] makes a download of a DCF.
//!
//! The reader understands:
//! - any case of names and keys;
//! - `\n` and `\r\n`, UTF-8 and ISO 8859-1;
//! - comments behind `;`;
//! - empty values, which count as absent keys;
//! - `$NODEID` (CiA 306-1 §6.3);
//! - `CompactSubObj` with its `[1003Name]` (§6.6.3.4) and `[1003Value]` (§7.3.4.3);
//! - objects that no list mentions.
//!
//! Data sheets of vendors have lines that are not as the standard has them. Such a line is a [`Flaw`]: the file is read,
//! and only the [`Part`] that depends on the line is absent. The user of that part refuses it. A value that a DCF states
//! must be right: [`crate::dcf::download`] refuses the flaws on which a stated value depends. A file that describes no
//! object, with a flaw, is refused.
//!
//! The reader ignores sections of tools and modules (§8), denotations, object links, and the keys that no field here
//! has, since no object depends on them.

mod error;
mod ini;
mod read;
mod strip;
mod value;
mod write;

use std::collections::BTreeMap;

use crate::{NodeId, Object};

pub use error::{EdsCause, EdsError, Flaw, FlawedLines, Part};
pub use ini::line_of;
pub use strip::{Stripped, strip};
pub use value::Value;

/// The most variables that a file may describe; a device has some thousands.
pub const MAX_VARIABLES: usize = 100_000;

/// Most sections of a file: one for each of so many variables, and more for what is no variable.
pub const MAX_SECTIONS: usize = 110_000;

/// One EDS or DCF.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Eds {
    /// Section `[FileInfo]` (CiA 306-1 §6.4).
    pub file: FileInfo,
    /// Section `[DeviceInfo]` (CiA 306-1 §6.5).
    pub device: DeviceInfo,
    /// Section `[DeviceComissioning]` of a DCF (CiA 306-1 §7.3.5).
    pub commissioning: Option<Commissioning>,
    /// Section `[Comments]`, line by line (CiA 306-1 §6.6.5).
    pub comments: Vec<String>,
    /// Section `[DummyUsage]`: whether objects 0x0001 to 0x0007 can be mapped as fillers (CiA 306-1 §6.6.2).
    pub dummies: [bool; 7],
    /// The objects by index.
    pub objects: BTreeMap<u16, Entry>,
    /// Lines of the file that are not as the standard has them, ascending.
    pub flaws: Vec<Flaw>,
}

/// Section `[FileInfo]`, as it stands there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the keys of the section")]
pub struct FileInfo {
    pub file_name: String,
    pub file_version: String,
    pub file_revision: String,
    pub eds_version: String,
    pub description: String,
    pub creation_time: String,
    pub creation_date: String,
    pub created_by: String,
}

/// Section `[DeviceInfo]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Name of the vendor.
    pub vendor_name: String,
    /// Vendor-ID, object 0x1018:01.
    pub vendor_number: Option<u32>,
    /// Name of the product.
    pub product_name: String,
    /// Product code, object 0x1018:02.
    pub product_number: Option<u32>,
    /// Revision number, object 0x1018:03.
    pub revision_number: Option<u32>,
    /// Order code.
    pub order_code: String,
    /// Bit rates it can, kbit/s, of those in [`BAUD_RATES`].
    pub baud_rates: Vec<u16>,
    /// Whether it can be a simple boot-up master.
    pub simple_boot_up_master: bool,
    /// Whether it can be a simple boot-up slave.
    pub simple_boot_up_slave: bool,
    /// Least bits of a PDO mapping entry; 0 if mappings are fixed.
    pub granularity: u8,
    /// Whether it creates objects at run time (CiA 302).
    pub dynamic_channels: bool,
    /// Whether it knows multiplexed PDOs.
    pub group_messaging: bool,
    /// How many RPDOs it has.
    pub rpdos: u16,
    /// How many TPDOs it has.
    pub tpdos: u16,
    /// Whether it knows layer setting services (CiA 305).
    pub lss: bool,
}

/// The bit rates that `[DeviceInfo]` has keys for, kbit/s.
pub const BAUD_RATES: [u16; 8] = [10, 20, 50, 125, 250, 500, 800, 1000];

/// Section `[DeviceComissioning]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Commissioning {
    /// Its node-ID.
    pub node: Option<NodeId>,
    /// Bit rate of its bus, kbit/s; `None` if 0.
    pub baud_rate: Option<u16>,
    /// Number of its network.
    pub net_number: Option<u32>,
    /// Whether it is the manager of its network.
    pub manager: bool,
    /// Serial number, object 0x1018:04; `None` if 0.
    pub serial_number: Option<u32>,
}

/// One index of the dictionary.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub object_type: ObjectType,
    /// What can be read and written, by sub-index; of a plain variable sub-index 0.
    pub variables: BTreeMap<u8, Variable>,
}

/// Something with a value.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// Its type.
    pub data_type: DataType,
    /// Who may do what with it.
    pub access: Access,
    /// Its value after a reset to factory settings, if that is known.
    pub default: Option<Value>,
    /// Its least value.
    pub low: Option<Value>,
    /// Its greatest value.
    pub high: Option<Value>,
    /// Whether PDOs can carry it.
    pub pdo_mapping: bool,
    /// Whether a download leaves it out (`ObjFlags`, bit 0; CiA 306-1 §6.6.3.3).
    pub refuses_download: bool,
    /// Whether a scan leaves it out (`ObjFlags`, bit 1; CiA 306-1 §6.6.3.3).
    pub refuses_scan: bool,
    /// What it is to be given.
    pub parameter: Option<Parameter>,
}

/// What a DCF states of a variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The value.
    pub value: ParameterValue,
    /// The line that states it, from 1.
    pub line: u32,
}

/// How a DCF states a value.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterValue {
    /// Here (`ParameterValue`).
    Value(Value),
    /// By the name of a file whose contents are the value (`DownloadFile`; CiA 306-1 table 10).
    File(String),
}

/// The shape of an object (CiA 301 §7.4.3, CiA 306-1 §6.6.3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ObjectType {
    /// No data.
    Null = 0,
    /// A large block of data.
    Domain = 2,
    /// The definition of a data type.
    TypeDefinition = 5,
    /// The definition of a record type.
    RecordDefinition = 6,
    /// One value.
    Variable = 7,
    /// Values of one type.
    Array = 8,
    /// Values of different types.
    Record = 9,
}

impl ObjectType {
    const ALL: [Self; 7] = [
        Self::Null,
        Self::Domain,
        Self::TypeDefinition,
        Self::RecordDefinition,
        Self::Variable,
        Self::Array,
        Self::Record,
    ];

    /// Whether it has sub-indices.
    pub const fn has_subindices(self) -> bool {
        matches!(self, Self::Array | Self::Record | Self::RecordDefinition)
    }
}

/// Who may do what with a variable (CiA 306-1 §6.6.3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Read only.
    ReadOnly,
    /// Write only.
    WriteOnly,
    /// Read and write.
    ReadWrite,
    /// Read and write; TPDOs can carry it.
    ReadWriteInput,
    /// Read and write; RPDOs can carry it.
    ReadWriteOutput,
    /// Read only, and it never changes.
    Const,
}

impl Access {
    const ALL: [(Self, &str); 6] = [
        (Self::ReadOnly, "ro"),
        (Self::WriteOnly, "wo"),
        (Self::ReadWrite, "rw"),
        (Self::ReadWriteInput, "rwr"),
        (Self::ReadWriteOutput, "rww"),
        (Self::Const, "const"),
    ];

    /// Whether it can be written.
    pub const fn writable(self) -> bool {
        !matches!(self, Self::ReadOnly | Self::Const)
    }

    /// Whether it can be read.
    pub const fn readable(self) -> bool {
        !matches!(self, Self::WriteOnly)
    }
}

macro_rules! data_types {
    ($($name:ident = $code:literal, $bytes:expr, $text:literal;)*) => {
        /// The type of a variable: objects 0x0001 to 0x001B (CiA 301 §7.4.7).
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum DataType {
            $(#[doc = $text] $name,)*
            /// Another one, by its code: of a vendor, a profile, or a record.
            Other(u16),
        }

        impl DataType {
            /// The type that a data sheet means by `code`.
            pub const fn from_code(code: u16) -> Self {
                match code {
                    $($code => Self::$name,)*
                    code => Self::Other(code),
                }
            }

            /// The index of its definition.
            pub const fn code(self) -> u16 {
                match self {
                    $(Self::$name => $code,)*
                    Self::Other(code) => code,
                }
            }

            /// Bytes that a value takes; `None` where that varies or is not known.
            pub const fn size(self) -> Option<usize> {
                match self {
                    $(Self::$name => $bytes,)*
                    Self::Other(_) => None,
                }
            }
        }
    };
}

data_types! {
    Boolean = 0x01, Some(1), "BOOLEAN, one byte over SDO.";
    Integer8 = 0x02, Some(1), "INTEGER8.";
    Integer16 = 0x03, Some(2), "INTEGER16.";
    Integer32 = 0x04, Some(4), "INTEGER32.";
    Unsigned8 = 0x05, Some(1), "UNSIGNED8.";
    Unsigned16 = 0x06, Some(2), "UNSIGNED16.";
    Unsigned32 = 0x07, Some(4), "UNSIGNED32.";
    Real32 = 0x08, Some(4), "REAL32.";
    VisibleString = 0x09, None, "VISIBLE_STRING.";
    OctetString = 0x0A, None, "OCTET_STRING.";
    UnicodeString = 0x0B, None, "UNICODE_STRING.";
    TimeOfDay = 0x0C, Some(6), "TIME_OF_DAY.";
    TimeDifference = 0x0D, Some(6), "TIME_DIFFERENCE.";
    Domain = 0x0F, None, "DOMAIN.";
    Integer24 = 0x10, Some(3), "INTEGER24.";
    Real64 = 0x11, Some(8), "REAL64.";
    Integer40 = 0x12, Some(5), "INTEGER40.";
    Integer48 = 0x13, Some(6), "INTEGER48.";
    Integer56 = 0x14, Some(7), "INTEGER56.";
    Integer64 = 0x15, Some(8), "INTEGER64.";
    Unsigned24 = 0x16, Some(3), "UNSIGNED24.";
    Unsigned40 = 0x18, Some(5), "UNSIGNED40.";
    Unsigned48 = 0x19, Some(6), "UNSIGNED48.";
    Unsigned56 = 0x1A, Some(7), "UNSIGNED56.";
    Unsigned64 = 0x1B, Some(8), "UNSIGNED64.";
}

impl DataType {
    /// The least and the greatest number of an integer type or BOOLEAN; `None` of all others.
    pub const fn range(self) -> Option<(i128, i128)> {
        let signed = match self.code() {
            0x01 => return Some((0, 1)),
            0x02..=0x04 | 0x10 | 0x12..=0x15 => true,
            0x05..=0x07 | 0x16..=0x1B => false,
            _ => return None,
        };
        let Some(bytes) = self.size() else {
            return None;
        };
        let span = 1_i128 << (8 * bytes);
        Some(if signed { (-span / 2, span / 2 - 1) } else { (0, span - 1) })
    }
}

impl Eds {
    /// Reads the bytes of an EDS or a DCF, in time proportional to their number (but for the logarithm of a sorted map).
    pub fn read(bytes: &[u8]) -> Result<Self, EdsError> {
        read::read(&ini::decode(bytes))
    }

    /// A variable by its address.
    pub fn variable(&self, object: Object) -> Option<&Variable> {
        let entry = self.objects.get(&object.index)?;
        entry.variables.get(&object.subindex)
    }

    /// The flaw for which `object` is not described.
    pub fn flaw_of(&self, object: Object) -> Option<&Flaw> {
        let of = |part| self.flaws.iter().find(move |flaw| flaw.part == part);
        of(Part::Variable(object)).or_else(|| of(Part::Entry(object.index)))
    }

    /// The flaw of the limits of `object`. A limit in another spelling is certain.
    pub fn flaw_of_limits(&self, object: Object) -> Option<&Flaw> {
        let mut flaws = self.flaws.iter().filter(|flaw| flaw.part == Part::Limits(object));
        flaws.find(|flaw| flaw.error.cause != EdsCause::Spelling)
    }

    /// The flaws by kind, in the order of their first lines.
    pub fn flawed_lines(&self) -> Vec<FlawedLines> {
        FlawedLines::of(self.flaws.iter().map(|flaw| flaw.error))
    }

    /// All variables in ascending order.
    pub fn variables(&self) -> impl Iterator<Item = (Object, &Variable)> {
        self.objects.iter().flat_map(|(&index, entry)| {
            let variables = entry.variables.iter();
            variables.map(move |(&subindex, variable)| (Object::new(index, subindex), variable))
        })
    }

    /// Identity of the device (object 0x1018) by sub-index: 1 vendor, 2 product, 3 revision. The parameter value of
    /// the file comes first, then its default, then `DeviceInfo`. The value 0 states nothing, as in object 0x1F85 of
    /// a master (CiA 302).
    pub fn identity(&self, subindex: u8) -> Option<u32> {
        let device = match subindex {
            1 => self.device.vendor_number,
            2 => self.device.product_number,
            3 => self.device.revision_number,
            _ => None,
        };
        let stated = self.identity_of_object(subindex).map(|(number, _)| number);
        stated.or(device).filter(|&number| number != 0)
    }

    /// The line of `bytes`, from 1, that states what [`Eds::identity`] returns. `bytes` is the text that was read.
    pub fn identity_line(&self, bytes: &[u8], subindex: u8) -> Option<u32> {
        let key = match subindex {
            1 => "VendorNumber",
            2 => "ProductNumber",
            _ => "RevisionNumber",
        };
        match self.identity_of_object(subindex) {
            Some((_, Some(line))) => Some(line),
            Some((_, None)) => {
                let sections = [format!("1018sub{subindex:x}"), "1018".to_owned()];
                sections.iter().find_map(|section| line_of(bytes, section, "DefaultValue"))
            }
            None => line_of(bytes, "DeviceInfo", key),
        }
    }

    /// A sub-index of object 0x1018 that is not 0, and the line of its parameter value; of a default no line.
    fn identity_of_object(&self, subindex: u8) -> Option<(u32, Option<u32>)> {
        let variable = self.variable(Object::new(0x1018, subindex))?;
        let (value, line) = match &variable.parameter {
            Some(Parameter { value: ParameterValue::Value(value), line }) => (value, Some(*line)),
            _ => (variable.default.as_ref()?, None),
        };
        let number = u32::try_from(value.integer(NodeId::MAX)?).ok()?;
        (number != 0).then_some((number, line))
    }
}
