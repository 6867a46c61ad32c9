//! Names of network interfaces.

use std::fmt;

/// The name of a network interface, as Linux limits it: 1 to 15 bytes.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct InterfaceName {
    bytes: [u8; 15],
    len: u8,
}

impl InterfaceName {
    /// `None` if `name` is empty, longer than 15 bytes, or has a NUL, a slash or white space in it.
    pub fn new(name: &str) -> Option<Self> {
        let forbidden = |c: char| c == '\0' || c == '/' || c.is_whitespace();
        if name.is_empty() || name.contains(forbidden) {
            return None;
        }
        let mut bytes = [0; 15];
        bytes
            .get_mut(..name.len())?
            .copy_from_slice(name.as_bytes());
        Some(Self {
            bytes,
            len: name.len() as u8,
        })
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
