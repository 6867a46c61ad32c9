//! Results of SDO transfers.

use super::{SdoCause, SdoError};
use canopen::Object;

/// A transfer that succeeded: what was read, or what was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer<'a> {
    /// The object.
    pub object: Object,
    /// Its data.
    pub data: &'a [u8],
    /// Whether `data` are the object's, and not just the four bytes of an expedited frame.
    pub(super) exact: bool,
}

impl Transfer<'_> {
    /// The data as a number of the object's type.
    ///
    /// Lengths must agree. From a server that does not give sizes the first bytes of four are taken.
    pub fn number<T: Number>(&self) -> Result<T, SdoError> {
        let longer = !self.exact && self.data.len() > T::BYTES;
        let data = if longer { &self.data[..T::BYTES] } else { self.data };
        let (expected, found) = (T::BYTES, data.len());
        T::from_le(data).ok_or(SdoCause::Length { expected, found }.of(self.object))
    }

    /// Whether what was read back is `wrote`. A server that does not give sizes fills up to four bytes.
    pub fn agrees_with(&self, wrote: &[u8]) -> bool {
        let filled_up = !self.exact && !wrote.is_empty() && self.data.starts_with(wrote);
        self.data == wrote || filled_up
    }
}

/// The integers that objects are read as.
pub trait Number: Sized {
    /// Its size.
    const BYTES: usize;
    /// `None` unless there are as many bytes as it has.
    fn from_le(data: &[u8]) -> Option<Self>;
}

macro_rules! number {
    ($($number:ty),*) => {
        $(impl Number for $number {
            const BYTES: usize = size_of::<Self>();
            fn from_le(data: &[u8]) -> Option<Self> {
                Some(Self::from_le_bytes(data.try_into().ok()?))
            }
        })*
    };
}
number!(u8, u16, u32, u64, i8, i16, i32, i64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fills_up_the_answer_of_a_server_without_sizes_is_no_difference() {
        let table: [(&[u8], &[u8], bool, bool); 9] = [
            (&[0x96, 0x00], &[0x96, 0x00], true, true),
            (&[0x96, 0x00], &[0x96, 0x00, 0xAA, 0x55], false, true),
            (&[0x96, 0x00], &[0x96, 0x00, 0xAA, 0x55], true, false),
            (&[0x96, 0x00], &[0x96, 0x00, 0x00, 0x00], true, false),
            (&[0x96, 0x00], &[0x97, 0x00, 0x00, 0x00], false, false),
            (&[0x96, 0x00], &[0x96], true, false),
            (&[0; 5], &[0; 4], false, false),
            (&[], &[], true, true),
            (&[], &[0, 0, 0, 0], false, false),
        ];
        for (wrote, data, exact, agrees) in table {
            let object = Object::new(0x1017, 0);
            let read = Transfer { object, data, exact };
            assert_eq!(read.agrees_with(wrote), agrees, "{wrote:?} {read:?}");
        }
    }
}
