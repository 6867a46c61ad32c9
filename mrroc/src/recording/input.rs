//! Bytes of a recording in the order of the file, with what its end needs.

use std::io::{self, BufReader, Read};

/// Bytes at the start of a record that are kept: the head of a chunk with the name of its compression.
const START: usize = 128;

/// Last bytes that are kept: the end of an MCAP file.
const LAST: usize = 8;

/// Bytes that are read from the file at once.
const BLOCK: usize = 1 << 16;

/// A file under way. The bytes of a record are kept by the caller, except for the first ones.
pub(super) struct Input {
    source: BufReader<Box<dyn Read>>,
    /// Bytes so far.
    length: usize,
    /// Bytes up to the last one that is not zero.
    data: usize,
    /// The last bytes.
    last: [u8; LAST],
    /// The first bytes of the record under way.
    start: Vec<u8>,
}

impl Input {
    pub(super) fn new(source: Box<dyn Read>) -> Self {
        let source = BufReader::with_capacity(BLOCK, source);
        Self { source, length: 0, data: 0, last: [0; LAST], start: Vec::with_capacity(START) }
    }

    /// Fills `room` as far as the file reaches. Returns the number of bytes.
    pub(super) fn fill(&mut self, room: &mut [u8]) -> io::Result<usize> {
        let mut filled = 0;
        while filled < room.len() {
            match self.source.read(&mut room[filled..]) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.took(&room[..filled]);
        Ok(filled)
    }

    fn took(&mut self, bytes: &[u8]) {
        if let Some(length) = without_zeros(bytes) {
            self.data = self.length + length;
        }
        let new = bytes.len().min(LAST);
        self.last.rotate_left(new);
        self.last[LAST - new..].copy_from_slice(&bytes[bytes.len() - new..]);
        self.start.extend(bytes.iter().take(START - self.start.len()));
        self.length += bytes.len();
    }

    /// A record begins behind the bytes so far.
    pub(super) fn begin_record(&mut self) {
        self.start.clear();
    }

    /// Reads the rest of the file, and keeps none of it.
    pub(super) fn skip_rest(&mut self) -> io::Result<()> {
        let mut block = vec![0; BLOCK];
        while self.fill(&mut block)? > 0 {}
        Ok(())
    }

    /// Number of the bytes so far.
    pub(super) fn length(&self) -> usize {
        self.length
    }

    /// Number of the bytes up to the last one that is not zero.
    pub(super) fn data(&self) -> usize {
        self.data
    }

    /// The first bytes of the record under way.
    pub(super) fn start_of_record(&self) -> &[u8] {
        &self.start
    }

    /// Whether the bytes so far end with `end`.
    pub(super) fn ends_with(&self, end: &[u8]) -> bool {
        self.length >= end.len() && self.last.ends_with(end)
    }
}

/// Length of `bytes` up to the last one that is not zero. Long holes of a file are passed block by block.
fn without_zeros(bytes: &[u8]) -> Option<usize> {
    let mut length = bytes.len();
    for block in bytes.rchunks(1024) {
        length -= block.len();
        if block.iter().fold(0, |all, byte| all | byte) != 0 {
            return block.iter().rposition(|&byte| byte != 0).map(|last| length + last + 1);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_bytes_and_data_are_those_of_the_whole_file() {
        assert_eq!(without_zeros(&[&[0; 9][..], &[1], &[0; 5000]].concat()), Some(10));
        assert_eq!(without_zeros(&[0; 3000]), None);
        let bytes: Vec<u8> = (1..=20).chain([0, 0, 0]).collect();
        for step in 1..bytes.len() {
            let mut input = Input::new(Box::new(io::Cursor::new(bytes.clone())));
            let mut room = vec![0; step];
            while input.fill(&mut room).unwrap() > 0 {}
            assert_eq!((input.length(), input.data()), (23, 20), "{step}");
            assert_eq!(input.start_of_record(), bytes, "{step}");
            assert!(input.ends_with(&[16, 17, 18, 19, 20, 0, 0, 0]) && !input.ends_with(&[1, 0, 0, 0]), "{step}");
        }
    }
}
