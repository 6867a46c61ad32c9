//! SDO abort codes (CiA 301 §7.2.4.3.17).

use std::fmt;

/// Reason for the end of an SDO transfer. Any value can arrive. The constants are the codes of CiA 301 and, with
/// `MAXON_`, those of maxon's drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct AbortCode(pub u32);

macro_rules! abort_codes {
    ($($name:ident = $raw:literal, $text:literal;)*) => {
        impl AbortCode {
            $(#[doc = $text] pub const $name: Self = Self($raw);)*

            /// Every code with a name.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// The meaning; "unknown abort code" if the code has no name here.
            pub const fn text(self) -> &'static str {
                match self.0 {
                    $($raw => $text,)*
                    _ => "unknown abort code",
                }
            }
        }
    };
}

abort_codes! {
    TOGGLE = 0x0503_0000, "toggle bit not alternated";
    TIME_OUT = 0x0504_0000, "SDO protocol timed out";
    COMMAND_SPECIFIER = 0x0504_0001, "command specifier not valid or unknown";
    BLOCK_SIZE = 0x0504_0002, "block size not valid";
    SEQUENCE_NUMBER = 0x0504_0003, "sequence number not valid";
    CRC = 0x0504_0004, "CRC error";
    OUT_OF_MEMORY = 0x0504_0005, "out of memory";
    ACCESS = 0x0601_0000, "access to the object not supported";
    WRITE_ONLY = 0x0601_0001, "attempt to read a write-only object";
    READ_ONLY = 0x0601_0002, "attempt to write a read-only object";
    SUBINDEX_LOCKED = 0x0601_0003, "sub-index cannot be written, sub-index 0 must be 0 first";
    NO_OBJECT = 0x0602_0000, "object does not exist";
    NOT_MAPPABLE = 0x0604_0041, "object cannot be mapped to the PDO";
    PDO_LENGTH = 0x0604_0042, "mapped objects would exceed the PDO length";
    PARAMETER_INCOMPATIBLE = 0x0604_0043, "general parameter incompatibility";
    INTERNAL_INCOMPATIBLE = 0x0604_0047, "general internal incompatibility in the device";
    HARDWARE = 0x0606_0000, "access failed due to a hardware error";
    LENGTH_MISMATCH = 0x0607_0010, "data type or length does not match";
    TOO_LONG = 0x0607_0012, "data too long";
    TOO_SHORT = 0x0607_0013, "data too short";
    NO_SUBINDEX = 0x0609_0011, "sub-index does not exist";
    VALUE_RANGE = 0x0609_0030, "value out of range";
    VALUE_TOO_HIGH = 0x0609_0031, "value too high";
    VALUE_TOO_LOW = 0x0609_0032, "value too low";
    MAX_BELOW_MIN = 0x0609_0036, "maximum is less than minimum";
    RESOURCE = 0x060A_0023, "resource not available";
    GENERAL = 0x0800_0000, "general error";
    CANNOT_STORE = 0x0800_0020, "data cannot be transferred or stored";
    LOCAL_CONTROL = 0x0800_0021, "data cannot be transferred or stored because of local control";
    DEVICE_STATE = 0x0800_0022, "data cannot be transferred or stored in the present device state";
    NO_DICTIONARY = 0x0800_0023, "object dictionary generation failed or none is present";
    NO_DATA = 0x0800_0024, "no data available";
    MAXON_NODE_ID = 0x0F00_FFB9, "wrong CAN identifier or node-ID";
    MAXON_NOT_IN_SERVICE_MODE = 0x0F00_FFBC, "device is not in service mode";
    MAXON_PASSWORD = 0x0F00_FFBE, "password is not correct";
    MAXON_ILLEGAL_COMMAND = 0x0F00_FFBF, "command is illegal on RS-232 or USB";
    MAXON_NMT_STATE = 0x0F00_FFC0, "device is in the wrong NMT state";
}

impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#010x} ({})", self.0, self.text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_named_code_has_its_own_text() {
        for (index, code) in AbortCode::ALL.iter().enumerate() {
            assert_ne!(code.text(), "unknown abort code");
            assert!(AbortCode::ALL[..index].iter().all(|other| other.text() != code.text()));
        }
        assert_eq!(AbortCode(0x1234_5678).to_string(), "0x12345678 (unknown abort code)");
        assert_eq!(AbortCode::NO_OBJECT.to_string(), "0x06020000 (object does not exist)");
    }
}
