//! The files that one run and its rehearsals read. Each file is read once, so that what was rehearsed is what runs, and
//! no output of the run replaces one of these files.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::input::{self, Identity, InputError, identity};

/// A file that was read, or that must not become an output for another reason.
#[derive(Clone, Debug)]
struct Known {
    what: &'static str,
    path: PathBuf,
    identity: Identity,
    /// The file, kept open: a deleted file does not give its identity to a new one.
    _open: Option<Arc<File>>,
    /// The contents, if the file is read through [`Inputs::read`].
    bytes: Option<Arc<[u8]>>,
    /// Whether the file is an input. The other files are targets of the task itself.
    is_input: bool,
    /// Whether the file belongs to the cell file, which several runs have in common.
    is_of_cell: bool,
    /// Whether the contents were used.
    is_used: bool,
}

/// The files of a cell and of a run. Clones share their files.
#[derive(Clone, Debug, Default)]
pub(crate) struct Inputs(Arc<Mutex<Vec<Known>>>);

impl Inputs {
    /// The bytes of the regular file at `path`, at most `limit`. A file that was read before is not read again,
    /// whatever the path leads to by then.
    pub(crate) fn read(&self, what: &'static str, path: &Path, limit: usize) -> Result<Arc<[u8]>, InputError> {
        self.read_as(what, path, limit, false)
    }

    /// As [`read`](Self::read), of a file that belongs to the cell file.
    pub(crate) fn read_of_cell(&self, what: &'static str, path: &Path, limit: usize) -> Result<Arc<[u8]>, InputError> {
        self.read_as(what, path, limit, true)
    }

    fn read_as(
        &self,
        what: &'static str,
        path: &Path,
        limit: usize,
        is_of_cell: bool,
    ) -> Result<Arc<[u8]>, InputError> {
        // The lock is held while the file is read, so that two readers at once have the same bytes.
        let mut known = self.known();
        let mut same = known.iter().filter(|it| it.path == path);
        if let Some(bytes) = same.find_map(|it| it.bytes.clone()) {
            return Ok(bytes);
        }
        let (bytes, file) = input::read_identified(path, limit)?;
        let identity = identity(&file.metadata()?);
        let bytes = Arc::<[u8]>::from(bytes);
        known.push(Known {
            what,
            path: path.to_owned(),
            identity,
            _open: Some(Arc::new(file)),
            bytes: Some(Arc::clone(&bytes)),
            is_input: true,
            is_of_cell,
            is_used: false,
        });
        Ok(bytes)
    }

    /// Whether this is the first call for a file that was read. Rehearsals and run use a file several times, and tell
    /// of it once.
    pub(crate) fn is_first_use(&self, path: &Path) -> bool {
        let mut known = self.known();
        let of_path = known.iter_mut().find(|it| it.path == path && it.bytes.is_some());
        of_path.is_some_and(|it| !std::mem::replace(&mut it.is_used, true))
    }

    /// Keeps an input that was read otherwise from becoming an output.
    pub(crate) fn protect(&self, what: &'static str, path: &Path) {
        self.protect_as(what, path, true);
    }

    /// Keeps a file that the task itself replaces from becoming an output of the run.
    pub(crate) fn protect_target(&self, what: &'static str, path: &Path) {
        self.protect_as(what, path, false);
    }

    fn protect_as(&self, what: &'static str, path: &Path, is_input: bool) {
        // A file that is not there cannot be overwritten.
        let Ok(found) = fs::metadata(path) else { return };
        let identity = identity(&found);
        let mut known = self.known();
        if !known.iter().any(|it| it.what == what && it.identity == identity) {
            let file = input::open_regular(path).ok().map(Arc::new);
            let path = path.to_owned();
            known.push(Known {
                what,
                path,
                identity,
                _open: file,
                bytes: None,
                is_input,
                is_of_cell: false,
                is_used: false,
            });
        }
    }

    /// The bytes of a file that was read.
    #[cfg(feature = "recording")]
    pub(crate) fn bytes(&self, path: &Path) -> Option<Arc<[u8]>> {
        self.known().iter().filter(|it| it.path == path).find_map(|it| it.bytes.clone())
    }

    /// All files, as they were when they were read, and those that the paths lead to now.
    pub(crate) fn identities(&self) -> Vec<(&'static str, Identity)> {
        let known = self.known();
        let now = known.iter().filter_map(|it| Some((it.what, identity(&fs::metadata(&it.path).ok()?))));
        known.iter().map(|it| (it.what, it.identity)).chain(now).collect()
    }

    /// What the file at `path` is, if it is an input.
    pub(crate) fn reads(&self, path: &Path) -> Option<&'static str> {
        let wanted = identity(&fs::metadata(path).ok()?);
        self.known().iter().find(|it| it.is_input && it.identity == wanted).map(|it| it.what)
    }

    /// The files of the cell alone, for another run.
    pub(crate) fn of_cell(&self) -> Self {
        let known = self.known().iter().filter(|it| it.is_of_cell).cloned().collect();
        Self(Arc::new(Mutex::new(known)))
    }

    fn known(&self) -> MutexGuard<'_, Vec<Known>> {
        // A panic of another user leaves whole entries.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_replaced_or_rewritten_keeps_the_bytes_of_its_first_reading() {
        let directory = tempfile::tempdir().unwrap();
        let [path, other] = ["it", "other"].map(|name| directory.path().join(name));
        fs::write(&path, "first").unwrap();
        let inputs = Inputs::default();
        assert_eq!(&*inputs.read("the file", &path, 10).unwrap(), b"first");
        fs::write(&path, "second").unwrap();
        assert_eq!(&*inputs.clone().read("the file", &path, 10).unwrap(), b"first");
        fs::write(&other, "third").unwrap();
        fs::rename(&other, &path).unwrap();
        assert_eq!(&*inputs.read("the file", &path, 10).unwrap(), b"first");
        // Both the file that was read and the one in its place are protected.
        assert_eq!(inputs.identities().iter().map(|(_, it)| it).collect::<std::collections::BTreeSet<_>>().len(), 2);
        assert_eq!(&*inputs.of_cell().read("the file", &path, 10).unwrap(), b"third", "another run reads again");
    }

    #[test]
    fn a_file_is_known_by_every_path_to_it() {
        let directory = tempfile::tempdir().unwrap();
        let [path, link] = ["it", "link"].map(|name| directory.path().join(name));
        fs::write(&path, "text").unwrap();
        fs::hard_link(&path, &link).unwrap();
        let inputs = Inputs::default();
        assert_eq!(inputs.reads(&link), None);
        inputs.read("the file", &path, 10).unwrap();
        assert_eq!(inputs.reads(&link), Some("the file"));
        let target = directory.path().join("target");
        fs::write(&target, "text").unwrap();
        inputs.protect_target("the target", &target);
        inputs.protect_target("the target", &target);
        assert_eq!((inputs.reads(&target), inputs.identities().len()), (None, 4));
    }
}
