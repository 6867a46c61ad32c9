//! Splits the byte stream of an slcan adapter into lines.

use super::text::LONGEST;

const BELL: u8 = 0x07;

/// Cuts a stream of bytes into lines, with room for one line of [`LONGEST`] bytes.
///
/// A line with a byte that is no printable ASCII, or longer than any line can be, is dropped as a
/// whole and counted: the stream is in step again behind the next carriage return or bell. A line
/// feed beside a carriage return is passed over, for those who end lines with both. A line that ends
/// with a line feed alone is dropped and counted.
#[derive(Clone, Debug, Default)]
pub struct Splitter {
    line: [u8; LONGEST],
    /// Bytes of the current line, those that found no room included.
    len: usize,
    spoilt: bool,
    /// Whether a line feed stands behind the bytes of the current line.
    fed: bool,
    dropped: u64,
}

/// What stands between two line ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Piece<'a> {
    /// A line without its end; may be empty.
    Line(&'a [u8]),
    /// A bell; whatever stood in front of it without a line's end was dropped.
    Bell,
}

impl Splitter {
    /// Takes the next byte of the stream and returns what it ends.
    pub fn push(&mut self, byte: u8) -> Option<Piece<'_>> {
        match byte {
            b'\r' if self.spoilt => {
                self.drop_line();
                None
            }
            b'\r' => {
                self.fed = false;
                let len = std::mem::take(&mut self.len);
                Some(Piece::Line(&self.line[..len]))
            }
            BELL => {
                if self.len > 0 {
                    self.drop_line();
                }
                Some(Piece::Bell)
            }
            b'\n' => {
                self.fed = self.len > 0;
                None
            }
            _ => {
                if self.fed {
                    self.drop_line();
                }
                match self.line.get_mut(self.len) {
                    Some(place) if byte == b' ' || byte.is_ascii_graphic() => *place = byte,
                    _ => self.spoilt = true,
                }
                self.len = self.len.saturating_add(1);
                None
            }
        }
    }

    /// Lines dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    fn drop_line(&mut self) {
        self.dropped += 1;
        self.len = 0;
        self.spoilt = false;
        self.fed = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pieces of a stream, a bell as `<bell>`, and how many lines were dropped.
    fn split(stream: &[u8]) -> (Vec<String>, u64) {
        let mut splitter = Splitter::default();
        let mut pieces = Vec::new();
        for &byte in stream {
            match splitter.push(byte) {
                Some(Piece::Line(line)) => pieces.push(String::from_utf8(line.to_vec()).unwrap()),
                Some(Piece::Bell) => pieces.push("<bell>".to_owned()),
                None => {}
            }
        }
        (pieces, splitter.dropped())
    }

    #[test]
    fn a_stream_is_cut_at_its_line_ends() {
        let longest = b"T1111222281122334455667788EA5F\r";
        assert_eq!(longest.len(), LONGEST);
        let over_long = [&[b'1'; LONGEST + 1], b"\rO\r".as_slice()].concat();
        let endless = [&[b'1'; 1000], b"\rO\r".as_slice()].concat();
        type Case<'a> = (&'a [u8], &'a [&'a str], u64);
        let cases: [Case; 13] = [
            (b"C\rS8\rO\r", &["C", "S8", "O"], 0),
            (b"C\rS8", &["C"], 0),
            (b"\r\r", &["", ""], 0),
            (b"C\r\nS8\r\n", &["C", "S8"], 0),
            (b"C\n\rS8\n\r", &["C", "S8"], 0),
            (b"t0800\nt0810\nt0820\n", &[], 2),
            (b"t0800\n\nt0810\r", &["t0810"], 1),
            (b"\x07\r\x07", &["<bell>", "", "<bell>"], 0),
            (b"t08\x07O\r", &["<bell>", "O"], 1),
            (b"\xFF\x00t0800\rt0810\r", &["t0810"], 1),
            (longest, &["T1111222281122334455667788EA5F"], 0),
            (&over_long, &["O"], 1),
            (&endless, &["O"], 1),
        ];
        for (stream, pieces, dropped) in cases {
            let found = split(stream);
            assert_eq!(found.0, pieces, "{}", stream.escape_ascii());
            assert_eq!(found.1, dropped);
        }
    }
}
