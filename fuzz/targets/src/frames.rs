//! Arbitrary frames, most of them with identifiers and first bytes that a CANopen node looks at.

use arbitrary::{Arbitrary, Result, Unstructured};
use can::{Frame, Instant, Received};
use canopen::NodeId;

/// The nodes of all benches.
pub(crate) const DRIVE: NodeId = NodeId::new(1).unwrap();
pub(crate) const MODULE: NodeId = NodeId::new(40).unwrap();
pub(crate) const SENSOR: NodeId = NodeId::new(50).unwrap();

/// A received frame without content, to fill buffers.
pub(crate) fn empty() -> Received {
    Received { frame: Frame::from_raw(0, 0, [0; 8]).unwrap(), at: Instant::ZERO }
}

/// Any frame at all.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AnyFrame(pub(crate) Frame);

impl<'a> Arbitrary<'a> for AnyFrame {
    fn arbitrary(input: &mut Unstructured<'a>) -> Result<Self> {
        let node = *input.choose(&[DRIVE, MODULE, SENSOR])?;
        let raw = u32::from(node.raw());
        let id = match input.int_in_range(0..=15_u8)? {
            0 => 0x000,
            1 => 0x080,
            2 => 0x080 + raw,
            3 => 0x180 + raw,
            4 => 0x280 + raw,
            5 => 0x200 + 0x100 * input.int_in_range(0..=3)? + raw,
            6..=7 => 0x580 + raw,
            8..=10 => 0x600 + raw,
            11 => 0x700 + raw,
            12 => 0x7E4 + u32::from(bool::arbitrary(input)?),
            13 => input.int_in_range(0..=0x7FF)?,
            // With error frames, remote frames and extended identifiers.
            _ => u32::arbitrary(input)?,
        };
        let mut data = <[u8; 8]>::arbitrary(input)?;
        match id & 0x780 {
            0x000 => data = [*input.choose(&[1, 2, 0x80, 0x81, 0x82])?, data[1] & 0x3F, 0, 0, 0, 0, 0, 0],
            0x580 | 0x600 if id < 0x800 && data[0] & 1 == 0 => {
                let object = *input.choose(&OBJECTS)?;
                [data[1], data[2]] = object.to_le_bytes();
                data[3] &= 0x07;
            }
            _ => {}
        }
        let length = if u8::arbitrary(input)? < 200 { 8 } else { input.int_in_range(0..=8)? };
        Ok(Self(Frame::from_raw(id, length, data).unwrap()))
    }
}

/// Objects whose values change the behaviour of a node.
const OBJECTS: [u16; 40] = [
    0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1008, 0x1010, 0x1011, 0x1014, 0x1016, 0x1017, 0x1018, 0x1400, 0x1401,
    0x1600, 0x1800, 0x1801, 0x1A00, 0x1A01, 0x2000, 0x2004, 0x3000, 0x6000, 0x6003, 0x6007, 0x6040, 0x6041, 0x6060,
    0x6064, 0x6065, 0x606C, 0x607A, 0x607D, 0x6081, 0x6098, 0x60A8, 0x60C2, 0x6200, 0x6206, 0x6502,
];
