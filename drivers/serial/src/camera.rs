//! Frames of a network camera: grey pictures on a byte stream (TCP).
//!
//! This project defines the protocol. The camera listens, and the host connects. The camera sends one greeting, and then
//! one picture per period. The host sends nothing. Every frame is a header of [`HEADER`] bytes, followed by the pixels.
//! Numbers have the high byte first:
//!
//! | offset | type | content |
//! |---|---|---|
//! | 0 | 4 bytes | `MRCF` |
//! | 4 | u8 | version of the protocol, 1 |
//! | 5 | u8 | kind: 0 greeting (no pixels follow), 1 picture |
//! | 6 | u16 | 0 |
//! | 8 | u32 | sequence number of the picture, from 0; 0 in a greeting |
//! | 12 | u16 | width, pixels |
//! | 14 | u16 | height, pixels |
//! | 16 | u64 | middle of the exposure, ns since the camera was switched on; 0 in a greeting |
//! | 24 | u32 | duration of the exposure, ns |
//! | 28 | u32 | period of the pictures, ns |
//! | 32 | u32 | CRC-32 of the pixels |
//! | 36 | u32 | CRC-32 of bytes 0 … 35 |
//! | 40 | bytes | one byte per pixel, rows from the top, each row from the left; 0 is black |
//!
//! The CRC-32 is that of Ethernet and ZIP (CRC-32/ISO-HDLC). The header has a CRC of its own, so that a receiver knows the
//! number of pixels before the pixels arrive. This module has only the layout.

use crc::{CRC_32_ISO_HDLC, Crc};

/// First bytes of a frame.
pub const MAGIC: [u8; 4] = *b"MRCF";

/// Version of the protocol.
pub const VERSION: u8 = 1;

/// Bytes of a header.
pub const HEADER: usize = 40;

/// Greatest number of columns, and of rows.
pub const MAX_SIDE: u16 = 1024;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Kinds of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// First frame of a connection, without pixels.
    Greeting,
    /// A picture.
    Picture,
}

/// Header of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// Kind of the frame.
    pub kind: FrameKind,
    /// Sequence number of the picture.
    pub sequence: u32,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Middle of the exposure, ns since the camera was switched on.
    pub exposed_ns: u64,
    /// Duration of the exposure, ns.
    pub exposure_ns: u32,
    /// Period of the pictures, ns.
    pub period_ns: u32,
    /// CRC-32 of the pixels.
    pub pixels_crc: u32,
}

impl FrameHeader {
    /// Number of pixels after this header.
    pub fn pixels(&self) -> usize {
        match self.kind {
            FrameKind::Greeting => 0,
            FrameKind::Picture => usize::from(self.width) * usize::from(self.height),
        }
    }

    /// The bytes of this header.
    pub fn encode(&self) -> [u8; HEADER] {
        let mut bytes = [0; HEADER];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4] = VERSION;
        bytes[5] = match self.kind {
            FrameKind::Greeting => 0,
            FrameKind::Picture => 1,
        };
        bytes[8..12].copy_from_slice(&self.sequence.to_be_bytes());
        bytes[12..14].copy_from_slice(&self.width.to_be_bytes());
        bytes[14..16].copy_from_slice(&self.height.to_be_bytes());
        bytes[16..24].copy_from_slice(&self.exposed_ns.to_be_bytes());
        bytes[24..28].copy_from_slice(&self.exposure_ns.to_be_bytes());
        bytes[28..32].copy_from_slice(&self.period_ns.to_be_bytes());
        bytes[32..36].copy_from_slice(&self.pixels_crc.to_be_bytes());
        let crc = CRC.checksum(&bytes[..36]);
        bytes[36..].copy_from_slice(&crc.to_be_bytes());
        bytes
    }

    /// The header in these bytes; `None` if they are no header of this protocol, or if the CRC or the size is wrong.
    pub fn decode(bytes: &[u8; HEADER]) -> Option<Self> {
        let u16_at = |at: usize| u16::from_be_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if bytes[..4] != MAGIC || bytes[4] != VERSION || u32_at(36) != CRC.checksum(&bytes[..36]) {
            return None;
        }
        let kind = match bytes[5] {
            0 => FrameKind::Greeting,
            1 => FrameKind::Picture,
            _ => return None,
        };
        let header = Self {
            kind,
            sequence: u32_at(8),
            width: u16_at(12),
            height: u16_at(14),
            exposed_ns: (u64::from(u32_at(16)) << 32) | u64::from(u32_at(20)),
            exposure_ns: u32_at(24),
            period_ns: u32_at(28),
            pixels_crc: u32_at(32),
        };
        let sides = 1..=MAX_SIDE;
        (sides.contains(&header.width) && sides.contains(&header.height)).then_some(header)
    }
}

/// CRC-32 of pixels.
pub fn checksum(pixels: &[u8]) -> u32 {
    CRC.checksum(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PICTURE: FrameHeader = FrameHeader {
        kind: FrameKind::Picture,
        sequence: 0x0102_0304,
        width: 160,
        height: 120,
        exposed_ns: 0x1122_3344_5566_7788,
        exposure_ns: 5_000_000,
        period_ns: 100_000_000,
        pixels_crc: 0xCBF4_3926,
    };

    #[test]
    fn header_has_its_fields_at_their_offsets() {
        // The check value of CRC-32/ISO-HDLC.
        assert_eq!(checksum(b"123456789"), 0xCBF4_3926);
        let bytes = PICTURE.encode();
        assert_eq!(
            bytes[..36],
            [
                0x4D, 0x52, 0x43, 0x46, 0x01, 0x01, 0x00, 0x00, 0x01, 0x02, 0x03, 0x04, 0x00, 0xA0, 0x00, 0x78, 0x11,
                0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88, 0x00, 0x4C, 0x4B, 0x40, 0x05, 0xF5, 0xE1, 0x00, 0xCB, 0xF4,
                0x39, 0x26,
            ]
        );
        assert_eq!(FrameHeader::decode(&bytes), Some(PICTURE));
        assert_eq!(PICTURE.pixels(), 19_200);
        assert_eq!(FrameHeader { kind: FrameKind::Greeting, ..PICTURE }.pixels(), 0);
    }

    #[test]
    fn every_changed_bit_of_a_header_is_refused() {
        let bytes = PICTURE.encode();
        for bit in 0..8 * HEADER {
            let mut changed = bytes;
            changed[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(FrameHeader::decode(&changed), None, "bit {bit}");
        }
    }

    #[test]
    fn impossible_sizes_are_refused() {
        for (width, height) in [(0, 120), (160, 0), (MAX_SIDE + 1, 1), (1, u16::MAX)] {
            let bytes = FrameHeader { width, height, ..PICTURE }.encode();
            assert_eq!(FrameHeader::decode(&bytes), None, "{width} × {height}");
        }
    }
}
