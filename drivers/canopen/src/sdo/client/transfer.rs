use super::SdoError;
use crate::Object;

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
        let data = if longer {
            &self.data[..T::BYTES]
        } else {
            self.data
        };
        T::from_le(data).ok_or(SdoError::Length {
            object: self.object,
            expected: T::BYTES,
            found: data.len(),
        })
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
