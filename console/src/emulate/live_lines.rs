//! Lines of standard input for `mrroc emulate --live`, of bounded length and of any bytes.

use std::io::{BufRead, Read, Result};

/// Greatest length of a line, bytes.
const LONGEST: usize = 1024;

/// The lines of an input. Bytes that are no UTF-8 are replaced. A line that is too long is cut, and ends with "…", which
/// no fault contains.
pub(super) struct LiveLines<R> {
    input: R,
    /// The rest of a line that is too long follows.
    cut: bool,
}

impl<R: BufRead> LiveLines<R> {
    pub(super) fn new(input: R) -> Self {
        Self { input, cut: false }
    }

    /// The next line without its end; `None` at the end of the input.
    pub(super) fn next_line(&mut self) -> Result<Option<String>> {
        if self.cut {
            self.cut = false;
            self.skip_line()?;
        }
        let mut bytes = Vec::new();
        self.input.by_ref().take(LONGEST as u64).read_until(b'\n', &mut bytes)?;
        if bytes.is_empty() {
            return Ok(None);
        }
        self.cut = bytes.len() == LONGEST && !bytes.ends_with(b"\n");
        let mut line = String::from_utf8_lossy(&bytes).trim_end_matches(['\r', '\n']).to_owned();
        if self.cut {
            line.push('…');
        }
        Ok(Some(line))
    }

    fn skip_line(&mut self) -> Result<()> {
        loop {
            let buffer = self.input.fill_buf()?;
            let end = buffer.iter().position(|byte| *byte == b'\n');
            let (length, over) = (end.map_or(buffer.len(), |end| end + 1), end.is_some() || buffer.is_empty());
            self.input.consume(length);
            if over {
                return Ok(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(bytes: &[u8]) -> Vec<String> {
        let mut lines = LiveLines::new(bytes);
        std::iter::from_fn(|| lines.next_line().unwrap()).collect()
    }

    #[test]
    fn a_line_of_any_bytes_is_read_and_the_next_line_follows() {
        assert_eq!(lines(b"lost a=b\r\n\xFF\xFEx\n\nlast"), ["lost a=b", "\u{FFFD}\u{FFFD}x", "", "last"]);
        assert_eq!(lines(b""), Vec::<String>::new());
    }

    #[test]
    fn a_line_that_is_too_long_is_cut_and_its_rest_is_skipped() {
        let mut bytes = vec![b'x'; LONGEST];
        bytes.push(b'\n');
        bytes.extend_from_slice(b"lost\n");
        assert_eq!(lines(&bytes), [format!("{}…", "x".repeat(LONGEST)), "lost".to_owned()]);
        // An endless line takes no memory.
        let endless = std::io::BufReader::new(std::io::repeat(b'y').take(1 << 24));
        let mut lines = LiveLines::new(endless);
        assert_eq!(lines.next_line().unwrap().map(|line| line.chars().count()), Some(LONGEST + 1));
        assert_eq!(lines.next_line().unwrap(), None);
    }
}
