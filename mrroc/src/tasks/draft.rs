//! A file that grows with what a person records, and gets its name when it is complete.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context;

/// Greatest number in the name of a draft.
const LAST: u32 = 99;

/// A file under way, in a file of its own beside its later name: NAME.part, or NAME.part-2 and so on where a file of an
/// earlier run has the name. No file that exists is opened or replaced.
pub(super) struct Draft {
    path: PathBuf,
    place: Option<PathBuf>,
}

impl Draft {
    /// A draft of the file `path`, without contents.
    pub(super) fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), place: None }
    }

    /// Path of the contents, if there are some.
    pub(super) fn place(&self) -> Option<&Path> {
        self.place.as_deref()
    }

    /// Replaces the contents as a whole. After a failure, the contents are those before.
    pub(super) fn save(&mut self, text: &str) -> anyhow::Result<()> {
        let (new, mut file) = self.new_file().with_context(|| format!("{}: no draft", self.path.display()))?;
        let written = file.write_all(text.as_bytes()).and_then(|()| match &self.place {
            Some(place) => fs::rename(&new, place),
            None => Ok(()),
        });
        if written.is_err() {
            // The error of writing is reported, not that of the removal.
            let _ = fs::remove_file(&new);
        }
        written.with_context(|| format!("{} cannot be written", new.display()))?;
        self.place.get_or_insert(new);
        Ok(())
    }

    /// Gives the contents their name. An existing file is an error, or is replaced as a whole. After a failure, the
    /// contents stay where they are.
    pub(super) fn complete(&mut self, replace: bool) -> anyhow::Result<()> {
        let place = self.place.as_ref().context("the draft has no contents")?;
        let named = File::open(place).and_then(|file| file.sync_all()).and_then(|()| match replace {
            true => fs::rename(place, &self.path),
            // A link is refused where a file is there already, unlike a rename.
            false => fs::hard_link(place, &self.path),
        });
        named.with_context(|| format!("{}: the contents are in {}", self.path.display(), place.display()))?;
        if !replace {
            // The file has its name; a second name does no harm.
            let _ = fs::remove_file(place);
        }
        self.place = None;
        Ok(())
    }

    /// A new file beside the later name.
    fn new_file(&self) -> io::Result<(PathBuf, File)> {
        let name = self.path.file_name().ok_or(ErrorKind::InvalidFilename)?;
        for number in 1..=LAST {
            let mut name = OsString::from(name);
            name.push(if number == 1 { ".part".to_owned() } else { format!(".part-{number}") });
            let place = self.path.with_file_name(name);
            match File::create_new(&place) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                made => return Ok((place, made?)),
            }
        }
        Err(io::Error::new(ErrorKind::AlreadyExists, "all names of drafts are in use: remove old ones"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(directory: &Path) -> Vec<String> {
        let entries = fs::read_dir(directory).unwrap();
        let mut names: Vec<_> = entries.map(|it| it.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_only_if_asked_and_no_part_of_it_is_left() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("poses.trj");
        let write = |text: &str, replace: bool| {
            let mut draft = Draft::of(&path);
            draft.save("earlier").unwrap();
            draft.save(text).unwrap();
            draft.complete(replace).map_err(|error| (draft.place().unwrap().to_owned(), error))
        };
        write("one", false).unwrap();
        let (place, error) = write("two", false).unwrap_err();
        assert!(format!("{error:#}").contains("the contents are in"), "{error:#}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "one");
        assert_eq!(fs::read_to_string(&place).unwrap(), "two", "what was recorded stays");
        fs::remove_file(place).unwrap();
        write("three", true).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "three");
        assert_eq!(files(directory.path()), ["poses.trj"]);
    }

    #[test]
    fn a_draft_of_an_earlier_run_is_kept() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("poses.trj");
        fs::write(directory.path().join("poses.trj.part"), "earlier").unwrap();
        let mut draft = Draft::of(&path);
        draft.save("one").unwrap();
        draft.save("two").unwrap();
        assert_eq!(files(directory.path()), ["poses.trj.part", "poses.trj.part-2"]);
        draft.complete(false).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "two");
        assert_eq!(fs::read_to_string(directory.path().join("poses.trj.part")).unwrap(), "earlier");
    }

    #[test]
    fn contents_that_cannot_be_written_leave_those_before() {
        let directory = tempfile::tempdir().unwrap();
        let mut draft = Draft::of(&directory.path().join("poses.trj"));
        draft.save("one").unwrap();
        let place = draft.place().unwrap().to_owned();
        // Every name of a further file is in use.
        for number in 2..=LAST {
            fs::write(directory.path().join(format!("poses.trj.part-{number}")), "").unwrap();
        }
        assert!(draft.save("two").is_err());
        assert_eq!(fs::read_to_string(place).unwrap(), "one");
    }
}
