//! Names of network interfaces.

use std::fmt;

/// The name of a network interface, as Linux limits it: 1 to 15 bytes.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct InterfaceName {
    bytes: [u8; 15],
    len: u8,
}

impl InterfaceName {
    /// `None` for a name that the kernel refuses. A name has 1 to 15 bytes, is not `.` or `..`, and has no slash, colon or
    /// white space. Control characters are refused as well, since logs and terminals act on them.
    pub fn new(name: &str) -> Option<Self> {
        let forbidden = |c: char| matches!(c, '/' | ':') || c.is_control() || c.is_whitespace();
        if matches!(name, "" | "." | "..") || name.contains(forbidden) {
            return None;
        }
        let mut bytes = [0; 15];
        bytes.get_mut(..name.len())?.copy_from_slice(name.as_bytes());
        Some(Self { bytes, len: name.len() as u8 })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        str::from_utf8(&self.bytes[..usize::from(self.len)]).expect("copied from a str")
    }
}

impl fmt::Display for InterfaceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for InterfaceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_what_the_kernel_takes_for_one_and_a_log_can_show() {
        for name in ["can0", "vcan-1", "a.b", "a=b", "fifteen-bytes-1"] {
            assert_eq!(InterfaceName::new(name).unwrap().as_str(), name);
        }
        let bad =
            ["", ".", "..", "a b", "a/b", "can0:1", "a\tb", "a\0b", "a\nb", "\u{1b}[m", "\u{9b}m", "sixteen-bytes-16"];
        for name in bad {
            assert_eq!(InterfaceName::new(name), None, "{name:?}");
        }
    }
}
