//! Bus time: how many bits a frame takes on the wire, and how long they last.
//!
//! Every count of bits includes the intermission of three recessive bits that precedes the next
//! frame, so the counts of back-to-back frames add up to the bus's load. A receiver has a frame
//! [`INTERMISSION`] bits earlier. Durations are exact: a [`Bitrate`] has a whole number of
//! nanoseconds a bit, and sums of frames never drift.
//!
//! [`worst_case_bits`] budgets a bus; [`bits_on_wire`] counts the stuff bits that a given frame
//! really has. Arbitration, error frames and overload frames are left to the bus model. The frame
//! format is that of ISO 11898-1, classic frames only.

use std::time::Duration;

use crc::{CRC_15_CAN, Crc, Table};

use crate::{Frame, Id};

/// Recessive bits between two frames, part of every count of bits here.
pub const INTERMISSION: u32 = 3;

/// CRC delimiter, acknowledge slot, acknowledge delimiter, end of frame and intermission: the bits
/// behind the CRC, which are never stuffed.
const TAIL: u32 = 1 + 1 + 1 + 7 + INTERMISSION;
const CRC: u32 = 15;

/// A bit rate whose bit time is a whole number of nanoseconds, from 10 kbit/s to 1 Mbit/s.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Bitrate {
    kbps: u32,
}

impl Bitrate {
    /// 125 kbit/s.
    pub const KBPS_125: Self = Self { kbps: 125 };
    /// 500 kbit/s.
    pub const KBPS_500: Self = Self { kbps: 500 };
    /// 1 Mbit/s, the fastest that classic CAN has.
    pub const KBPS_1000: Self = Self { kbps: 1000 };

    /// `None` outside 10 to 1000 kbit/s, and for rates such as 83 kbit/s whose bit time is not a
    /// whole number of nanoseconds.
    pub const fn from_kbps(kbps: u32) -> Option<Self> {
        if kbps >= 10 && kbps <= 1000 && 1_000_000 % kbps == 0 { Some(Self { kbps }) } else { None }
    }

    /// The rate, kbit/s.
    pub const fn kbps(self) -> u32 {
        self.kbps
    }

    /// How long `bits` last.
    pub const fn duration(self, bits: u32) -> Duration {
        Duration::from_nanos(bits as u64 * (1_000_000 / self.kbps) as u64)
    }
}

/// The two formats of a classic frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// 11-bit identifier.
    Standard,
    /// 29-bit identifier.
    Extended,
}

impl Format {
    /// Bits from start of frame to the end of the CRC without payload: those that are stuffed.
    const fn stuffable(self) -> u32 {
        match self {
            // Start, identifier, RTR, IDE, r0, length code.
            Self::Standard => 1 + 11 + 1 + 1 + 1 + 4 + CRC,
            // Start, identifier, SRR, IDE, identifier, RTR, r1, r0, length code.
            Self::Extended => 1 + 11 + 1 + 1 + 18 + 1 + 1 + 1 + 4 + CRC,
        }
    }
}

/// Bits of a data frame of `len` bytes with the greatest possible number of stuff bits: one after the first five bits
/// and one after every four more.
pub const fn worst_case_bits(format: Format, len: u8) -> u32 {
    let stuffed = format.stuffable() + 8 * len as u32;
    stuffed + TAIL + (stuffed - 1) / 4
}

/// Bits that `frame` takes on the wire, stuff bits counted from its content and its CRC.
///
/// Zero for an error frame: it is the kernel's report and was never on the wire. Some 20 table
/// look-ups, tens of nanoseconds.
pub fn bits_on_wire(frame: &Frame) -> u32 {
    let Some(id) = frame.id() else { return 0 };
    let remote = u128::from(frame.is_remote());
    // The dominant start bit is a zero, and so costs nothing to prepend.
    let (header, bits) = match id {
        Id::Standard(id) => (u128::from(id.raw()) << 3 | remote << 2, 15),
        Id::Extended(id) => {
            let id = u128::from(id.raw());
            let (base, extension) = (id >> 18, id & 0x3_FFFF);
            (base << 23 | 0b11 << 21 | extension << 3 | remote << 2, 35)
        }
    };
    let mut content = header << 4 | u128::from(frame.len_code());
    let mut bits = bits + 4;
    for &byte in frame.data() {
        content = content << 8 | u128::from(byte);
        bits += 8;
    }
    let stuffable = content << CRC | u128::from(crc15(content));
    bits += CRC;
    bits + stuff_bits(stuffable, bits) + TAIL
}

/// The CRC of `content`, first bit highest. The register starts at zero, so leading zeros leave no trace.
fn crc15(content: u128) -> u16 {
    // Sixteen tables: the look-ups of the sixteen bytes do not wait for each other.
    static TABLE: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_15_CAN);
    TABLE.checksum(&content.to_be_bytes())
}

/// How many stuff bits the last `bits` of `content` need, the rest being zero.
fn stuff_bits(content: u128, bits: u32) -> u32 {
    // Alternating bits fill up the first byte. They need no stuff bits, and the last is a one. The start bit
    // therefore begins a new run.
    let padded = content | 0x5555_5555_5555_5555_5555_5555_5555_5555 << bits;
    let mut run = Run { ones: true, len: 1 }.index();
    let mut count = 0;
    for &byte in bytes(&padded.to_be_bytes(), bits) {
        let (stuffed, next) = STUFFING[run][usize::from(byte)];
        count += u32::from(stuffed);
        run = usize::from(next);
    }
    count
}

/// The bytes of a big-endian number that hold its last `bits`.
fn bytes(content: &[u8; 16], bits: u32) -> &[u8] {
    &content[16 - bits.div_ceil(8) as usize..]
}

/// What the stuffing rule remembers between bits: the last bit sent, and how many equal ones ended
/// with it, 1 to 4. The fifth calls for a stuff bit, which begins a run of its own.
#[derive(Clone, Copy)]
struct Run {
    ones: bool,
    len: u8,
}

impl Run {
    const fn index(self) -> usize {
        (self.len as usize - 1) << 1 | self.ones as usize
    }

    const fn from_index(index: usize) -> Self {
        Self { ones: index & 1 == 1, len: (index >> 1) as u8 + 1 }
    }
}

/// By run and next byte: stuff bits inserted in it, and the run after it.
const STUFFING: [[(u8, u8); 256]; 8] = {
    let mut table = [[(0, 0); 256]; 8];
    let mut index = 0;
    while index < 8 {
        let mut byte = 0;
        while byte < 256 {
            let mut run = Run::from_index(index);
            let mut stuffed = 0;
            let mut bit = 8;
            while bit > 0 {
                bit -= 1;
                let one = byte >> bit & 1 == 1;
                run.len = if one == run.ones { run.len + 1 } else { 1 };
                run.ones = one;
                if run.len == 5 {
                    stuffed += 1;
                    run = Run { ones: !one, len: 1 };
                }
            }
            table[index][byte] = (stuffed, run.index() as u8);
            byte += 1;
        }
        index += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ExtendedId, StandardId};

    #[test]
    fn frame_lengths_are_those_of_the_format() {
        // Payload, bits with the most stuffing.
        for (len, worst) in [(0, 55), (2, 75), (4, 95), (6, 115), (8, 135)] {
            assert_eq!(worst_case_bits(Format::Standard, len), worst);
        }
        for (len, worst) in [(0, 80), (8, 160)] {
            assert_eq!(worst_case_bits(Format::Extended, len), worst);
        }
    }

    #[test]
    fn a_cycle_of_three_axes_fills_four_fifths_of_a_millisecond() {
        let cycle = |axes| {
            let axis = worst_case_bits(Format::Standard, 6) + worst_case_bits(Format::Standard, 8);
            Bitrate::KBPS_1000.duration(worst_case_bits(Format::Standard, 0) + axes * axis)
        };
        for (axes, micros) in [(1, 305), (2, 555), (3, 805), (6, 1555), (8, 2055)] {
            assert_eq!(cycle(axes), Duration::from_micros(micros));
        }
    }

    #[test]
    fn the_crc_is_the_one_of_the_catalogue() {
        let content = b"123456789".iter().fold(0, |content, &byte| content << 8 | u128::from(byte));
        assert_eq!(crc15(content), 0x059E);
    }

    #[test]
    fn stuff_bits_are_those_on_the_wire() {
        let cases: [(u16, &[u8], u32); 4] = [
            // All 34 bits are zero, CRC included.
            (0x000, &[], 47 + 6),
            (0x080, &[], 51),
            (0x601, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0], 123),
            (0x078, &[0x3C; 8], 131),
        ];
        for (id, data, bits) in cases {
            let frame = Frame::new(StandardId::new(id).unwrap(), data).unwrap();
            assert_eq!(bits_on_wire(&frame), bits, "{frame}");
        }
    }

    #[test]
    fn counted_bits_agree_with_the_rule_applied_bit_by_bit() {
        let mut random = Random(0x9E37_79B9_7F4A_7C15);
        for round in 0..20_000 {
            let frame = random.frame();
            let (format, payload) = (format_of(&frame), frame.data().len() as u8);
            let bits = bits_on_wire(&frame);
            assert_eq!(bits, reference_bits(&frame), "round {round}: {frame}");
            assert!(bits >= format.stuffable() + 8 * u32::from(payload) + TAIL, "{frame}");
            assert!(bits <= worst_case_bits(format, payload), "{frame}");
        }
    }

    #[test]
    fn error_frames_take_no_bus_time() {
        let error = Frame::from_raw(0x2000_0004, 8, [0; 8]).unwrap();
        assert_eq!(bits_on_wire(&error), 0);
    }

    #[test]
    fn only_rates_of_whole_nanoseconds_exist() {
        for (kbps, bit_nanos) in [(10, 100_000), (125, 8000), (800, 1250), (1000, 1000)] {
            let bitrate = Bitrate::from_kbps(kbps).unwrap();
            assert_eq!(bitrate.duration(1), Duration::from_nanos(bit_nanos));
            assert_eq!(bitrate.kbps(), kbps);
        }
        for kbps in [0, 5, 83, 750, 1001, 2000] {
            assert_eq!(Bitrate::from_kbps(kbps), None);
        }
    }

    fn format_of(frame: &Frame) -> Format {
        match frame.id().unwrap() {
            Id::Standard(_) => Format::Standard,
            Id::Extended(_) => Format::Extended,
        }
    }

    /// The frame as a string of bits, with the CRC by long division and the stuff bits inserted one by one.
    fn reference_bits(frame: &Frame) -> u32 {
        let field = |value: u32, width: usize| format!("{value:0width$b}");
        let remote = u32::from(frame.is_remote());
        let mut bits = match frame.id().unwrap() {
            Id::Standard(id) => {
                format!("0{}{remote}00", field(u32::from(id.raw()), 11))
            }
            Id::Extended(id) => {
                let all = field(id.raw(), 29);
                format!("0{}11{}{remote}00", &all[..11], &all[11..])
            }
        };
        bits += &field(u32::from(frame.len_code()), 4);
        for &byte in frame.data() {
            bits += &field(u32::from(byte), 8);
        }
        let mut crc = 0_u32;
        for bit in bits.bytes() {
            let next = u32::from(bit - b'0') ^ (crc >> 14 & 1);
            crc = (crc << 1 & 0x7FFF) ^ if next == 1 { 0x4599 } else { 0 };
        }
        bits += &field(crc, 15);
        let mut sent: Vec<u8> = Vec::new();
        for bit in bits.bytes() {
            sent.push(bit);
            if sent.len() >= 5 && sent[sent.len() - 5..].iter().all(|&last| last == bit) {
                sent.push(if bit == b'0' { b'1' } else { b'0' });
            }
        }
        sent.len() as u32 + 3 + 7 + INTERMISSION
    }

    /// Xorshift, biased towards frames of many equal bits.
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            self.0
        }

        fn frame(&mut self) -> Frame {
            let id: Id = if self.next() & 1 == 0 {
                StandardId::new((self.next() & self.next() & 0x7FF) as u16).unwrap().into()
            } else {
                ExtendedId::new((self.next() & self.next() & 0x1FFF_FFFF) as u32).unwrap().into()
            };
            let len = (self.next() % 9) as usize;
            if self.next().is_multiple_of(8) {
                return Frame::remote(id, len as u8).unwrap();
            }
            let data = (self.next() & self.next() & self.next()).to_be_bytes();
            Frame::new(id, &data[..len]).unwrap()
        }
    }
}
