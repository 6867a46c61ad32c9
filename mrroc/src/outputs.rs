//! Output files of a command. An output must not be an input or another output, also of another process. An existing
//! file is replaced only with `--force`.

use std::fmt::Display;
use std::fs::{self, File, Metadata, TryLockError};
use std::io::{self, ErrorKind, IsTerminal};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::unistd::geteuid;

use crate::cell::CellFile;
use crate::input::{Identity, identity};

/// The option of a command that writes files.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "command-line", derive(clap::Args))]
pub struct Replacement {
    /// Replace existing files. Without this option, an existing file is an error.
    #[cfg_attr(feature = "command-line", arg(long))]
    pub force: bool,
}

/// What a measurement gave. After a measurement or a motion, a failure is no refusal.
#[must_use = "failures have to be told"]
pub struct Measured<R> {
    /// `None` if the measurement was broken off.
    pub report: Option<R>,
    /// False if the measurement ended before its time.
    pub complete: bool,
    /// Failure of the measurement.
    pub failure: Option<anyhow::Error>,
    /// Writes the files of the measurement, which may block. The report is told before.
    pub write: Box<dyn FnOnce() -> anyhow::Result<()>>,
}

/// The output files of a command. Before [`Self::begin`], no existing file has changed, and new files are removed on
/// drop.
pub struct Outputs {
    replacement: Replacement,
    /// Files that must not be used as outputs.
    known: Vec<(&'static str, Identity)>,
    opened: Vec<Opened>,
    /// Directories that were made, the outer ones first.
    made: Vec<PathBuf>,
}

struct Opened {
    what: String,
    path: PathBuf,
    identity: Identity,
    file: File,
    made: bool,
}

impl Outputs {
    /// Outputs that protect the files of standard input, standard output and standard error.
    pub fn new(replacement: Replacement) -> Self {
        let (stdin, stdout, stderr) = (io::stdin(), io::stdout(), io::stderr());
        let standard = [
            ("standard input", stdin.as_fd()),
            ("standard output", stdout.as_fd()),
            ("standard error", stderr.as_fd()),
        ];
        let known = standard.into_iter().filter_map(|(what, end)| {
            let found = end.try_clone_to_owned().map(File::from).and_then(|file| file.metadata()).ok()?;
            // All writers of a pipe, a terminal or a device share one end.
            found.is_file().then(|| (what, identity(&found)))
        });
        Self { replacement, known: known.collect(), opened: Vec::new(), made: Vec::new() }
    }

    /// Protects the files that `cell` was read from, and those that a run of the cell has read.
    pub fn reads(&mut self, cell: &CellFile) {
        self.known.extend(cell.inputs().identities());
    }

    /// Opens the output file of the option `what`.
    pub fn open(&mut self, what: impl Display, path: &Path) -> anyhow::Result<File> {
        self.open_as(what.to_string(), path).with_context(|| format!("{what}: {}", path.display()))
    }

    /// Opens an optional output file.
    pub fn open_if(&mut self, what: &str, path: Option<&Path>) -> anyhow::Result<Option<File>> {
        path.map(|path| self.open(what, path)).transpose()
    }

    /// Opens the output `name` of the option `what` in a directory, which is made where it is not there yet.
    pub fn open_in(&mut self, what: impl Display, directory: &Path, name: &str) -> anyhow::Result<File> {
        let missing: Vec<_> =
            directory.ancestors().take_while(|it| !it.as_os_str().is_empty() && !it.exists()).collect();
        let made = fs::create_dir_all(directory);
        self.made.extend(missing.into_iter().rev().map(Path::to_owned));
        made.with_context(|| format!("{what}: {} cannot be made", directory.display()))?;
        self.open(what, &directory.join(name))
    }

    fn open_as(&mut self, what: String, path: &Path) -> anyhow::Result<File> {
        let (file, made) = self.file(path)?;
        let found = file.metadata()?;
        let opened = Opened {
            what,
            // A link to a missing file creates that file. The path of an open descriptor may not resolve.
            path: path.canonicalize().unwrap_or_else(|_| path.to_owned()),
            identity: identity(&found),
            file: file.try_clone()?,
            made,
        };
        if let Some((what, _)) = self.known.iter().find(|(_, identity)| *identity == opened.identity) {
            bail!("{what} is the same file: name another");
        }
        // A device such as /dev/null keeps writers apart; a pipe or a terminal mixes their bytes.
        let mixes = !found.file_type().is_char_device() || file.is_terminal();
        if let Some(other) = self.opened.iter().find(|other| mixes && other.identity == opened.identity) {
            bail!("{} has the same file: name two", other.what);
        }
        if found.is_file() && !made && !self.replacement.force {
            bail!("the file is there already: name another, or let --force replace it");
        }
        if found.is_file() {
            lock(&file)?;
        }
        self.opened.push(opened);
        Ok(file)
    }

    /// Opens a file, and returns whether the file was created. A link to a missing file counts as existing, and
    /// opening it creates the file.
    fn file(&self, path: &Path) -> anyhow::Result<(File, bool)> {
        let mut options = File::options();
        // A FIFO without a reader, or a line without a carrier, would be waited for, and no signal would end that.
        options.write(true).custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
        match options.clone().create_new(true).open(path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            made => return Ok((made?, true)),
        }
        let is_shared = refuse_planted(path)?;
        if is_shared {
            options.custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY | libc::O_NOFOLLOW);
        }
        let mut made = false;
        match fs::metadata(path) {
            Ok(found) if found.file_type().is_block_device() => bail!("a disk is no file to write"),
            Err(error) if error.kind() == ErrorKind::NotFound && !self.replacement.force => {
                bail!("the name is that of a link which leads nowhere: name another, or let --force follow it")
            }
            Err(error) if error.kind() == ErrorKind::NotFound => made = true,
            _ => {}
        }
        match options.create(made).open(path) {
            Err(error) if error.raw_os_error() == Some(libc::ENXIO) => {
                bail!("the file is a FIFO that no program reads, or a device that is not there: start the reader first")
            }
            Err(error) if is_shared && error.raw_os_error() == Some(libc::ELOOP) => {
                bail!("the name is that of a link, in a directory where other users can change it: name another")
            }
            opened => {
                let file = opened?;
                wait_for_room(&file)?;
                Ok((file, made))
            }
        }
    }

    /// Starts the command: files are kept from now on, and files replaced by --force are emptied.
    pub fn begin(mut self) -> anyhow::Result<()> {
        for opened in &self.opened {
            let is_file = opened.file.metadata().is_ok_and(|found| found.is_file());
            let emptied = if is_file { opened.file.set_len(0) } else { Ok(()) };
            emptied.with_context(|| format!("{}: {}", opened.what, opened.path.display()))?;
        }
        self.opened.clear();
        self.made.clear();
        Ok(())
    }
}

impl Drop for Outputs {
    fn drop(&mut self) {
        for opened in self.opened.iter().filter(|opened| opened.made) {
            if fs::symlink_metadata(&opened.path).is_ok_and(|there| identity(&there) == opened.identity) {
                // The refusal is reported; an error of the removal is ignored.
                let _ = fs::remove_file(&opened.path);
            }
        }
        // A directory with files of others stays.
        self.made.iter().rev().for_each(|directory| _ = fs::remove_dir(directory));
    }
}

/// Removes the output `path` if it is still the regular file `file`. Returns whether the file was removed.
pub fn remove(path: &Path, file: &File) -> bool {
    let same =
        |there: &Metadata| file.metadata().is_ok_and(|file| file.is_file() && identity(&file) == identity(there));
    fs::symlink_metadata(path).is_ok_and(|there| same(&there)) && fs::remove_file(path).is_ok()
}

/// Refuses what another user may have planted under the name of an output: a link of another user, and a file of another
/// user in a directory where all users can write. Root counts as no other user. Returns whether other users can replace
/// what is under this name, so that no link must be followed.
fn refuse_planted(path: &Path) -> anyhow::Result<bool> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (Ok(found), Ok(directory)) = (fs::symlink_metadata(path), fs::metadata(parent)) else {
        // Opening the file reports the error.
        return Ok(false);
    };
    let is_foreign = |owner: u32| owner != 0 && owner != geteuid().as_raw();
    let is_open = directory.mode() & 0o002 != 0;
    if is_foreign(found.uid()) && (found.is_symlink() || is_open) {
        let what = if found.is_symlink() { "link" } else { "file" };
        bail!("the name is that of a {what} of another user: name another");
    }
    let is_sticky = directory.mode() & 0o1000 != 0;
    Ok(is_foreign(directory.uid()) || (is_open && !is_sticky))
}

/// Lets a write to a full pipe wait, as a write to a file does.
fn wait_for_room(file: &File) -> io::Result<()> {
    let flags = OFlag::from_bits_retain(fcntl(file, FcntlArg::F_GETFL)?);
    fcntl(file, FcntlArg::F_SETFL(flags - OFlag::O_NONBLOCK))?;
    Ok(())
}

/// Keeps other commands from the file until its last descriptor is closed.
fn lock(file: &File) -> anyhow::Result<()> {
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => bail!("another command writes to the file: wait for its end, or name another"),
        // A file system without locks.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::os::unix::fs::{PermissionsExt, lchown, symlink};
    use std::process::Command;
    use std::sync::mpsc;
    use std::thread;
    use std::time::Duration;

    use super::*;

    const KEEP: Replacement = Replacement { force: false };
    const FORCE: Replacement = Replacement { force: true };

    fn refusal(outputs: &mut Outputs, path: &Path) -> String {
        format!("{:#}", outputs.open("--it", path).unwrap_err())
    }

    #[test]
    fn a_file_that_is_there_is_replaced_when_the_command_begins_and_not_before() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("there");
        fs::write(&path, "precious").unwrap();
        assert!(refusal(&mut Outputs::new(KEEP), &path).contains("there already"));
        let mut refused = Outputs::new(FORCE);
        refused.open("--it", &path).unwrap();
        drop(refused);
        assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
        let mut outputs = Outputs::new(FORCE);
        let mut file = outputs.open("--it", &path).unwrap();
        outputs.begin().unwrap();
        file.write_all(b"new").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    }

    #[test]
    fn what_other_users_planted_is_neither_followed_nor_overwritten() {
        const OTHER: u32 = 65_534;
        let directory = tempfile::tempdir().unwrap();
        let [victim, shared, sticky, own] = ["victim", "shared", "sticky", "own"].map(|it| directory.path().join(it));
        fs::write(&victim, "precious").unwrap();
        for (open, mode) in [(&shared, 0o777), (&sticky, 0o1777), (&own, 0o755)] {
            fs::create_dir(open).unwrap();
            fs::set_permissions(open, fs::Permissions::from_mode(mode)).unwrap();
            symlink(&victim, open.join("link")).unwrap();
            fs::write(open.join("file"), "theirs").unwrap();
        }
        // Without a sticky bit, others can plant a link at any moment, also in place of the user's own.
        assert!(refusal(&mut Outputs::new(FORCE), &shared.join("link")).contains("can change it"));
        Outputs::new(FORCE).open("--it", &shared.join("file")).unwrap();
        for open in [&sticky, &own] {
            Outputs::new(FORCE).open("--it", &open.join("link")).unwrap();
        }
        if geteuid().is_root() {
            for name in ["link", "file"] {
                let both = [&shared, &sticky].map(|open| open.join(name));
                for path in both {
                    lchown(&path, Some(OTHER), None).unwrap();
                    assert!(refusal(&mut Outputs::new(FORCE), &path).contains("of another user"), "{path:?}");
                }
            }
            lchown(own.join("link"), Some(OTHER), None).unwrap();
            assert!(refusal(&mut Outputs::new(FORCE), &own.join("link")).contains("of another user"));
            // In a directory of another user, that user can plant a link at any moment.
            lchown(&own, Some(OTHER), None).unwrap();
            lchown(own.join("link"), Some(0), None).unwrap();
            assert!(refusal(&mut Outputs::new(FORCE), &own.join("link")).contains("can change it"));
        }
        assert_eq!(fs::read_to_string(&victim).unwrap(), "precious");
    }

    #[test]
    fn what_a_refused_command_made_is_removed_and_what_was_there_stays() {
        let directory = tempfile::tempdir().unwrap();
        let [made, there] = ["made", "there"].map(|name| directory.path().join(name));
        fs::write(&there, "precious").unwrap();
        let mut outputs = Outputs::new(KEEP);
        outputs.open("--one", &made).unwrap();
        assert!(made.exists());
        refusal(&mut outputs, &there);
        drop(outputs);
        assert!(!made.exists() && there.exists());
    }

    #[test]
    fn a_refused_command_leaves_no_directory_that_it_made() {
        let directory = tempfile::tempdir().unwrap();
        let [outer, inner] = ["outer", "outer/inner"].map(|name| directory.path().join(name));
        let mut outputs = Outputs::new(KEEP);
        outputs.open_in("--out", &inner, "page").unwrap();
        drop(outputs);
        assert!(!outer.exists());
        fs::create_dir(&outer).unwrap();
        let mut outputs = Outputs::new(KEEP);
        outputs.open_in("--out", &inner, "page").unwrap();
        drop(outputs);
        assert!(outer.exists() && !inner.exists());
        let mut outputs = Outputs::new(KEEP);
        outputs.open_in("--out", &inner, "page").unwrap();
        outputs.begin().unwrap();
        assert!(inner.join("page").exists());
    }

    #[test]
    fn one_file_has_one_writer_whatever_paths_lead_to_it() {
        let directory = tempfile::tempdir().unwrap();
        let place = |name: &str| directory.path().join(name);
        symlink(directory.path(), place("here")).unwrap();
        symlink("new", place("link")).unwrap();
        for (first, second) in [("new", "new"), ("new", "here/new"), ("link", "new"), ("here/link", "link")] {
            let mut outputs = Outputs::new(FORCE);
            outputs.open("--one", &place(first)).unwrap();
            let said = refusal(&mut outputs, &place(second));
            assert!(said.contains("--one has the same file"), "{said}");
            drop(outputs);
            let _ = fs::remove_file(place("new"));
        }
        assert!(refusal(&mut Outputs::new(KEEP), &place("link")).contains("leads nowhere"));
    }

    #[test]
    fn a_fifo_without_a_reader_is_refused_at_once() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("fifo");
        let made = Command::new("mkfifo").arg(&path).status();
        assert!(made.unwrap().success());
        let (said, refused) = mpsc::channel();
        let fifo = path.clone();
        thread::spawn(move || said.send(refusal(&mut Outputs::new(FORCE), &fifo)));
        let refused = refused.recv_timeout(Duration::from_secs(60));
        let refused = refused.expect("the FIFO is not waited for");
        assert!(refused.contains("a FIFO that no program reads"), "{refused}");
        // With a reader, a writer waits for room.
        let mut reader = File::options().read(true).write(true).open(&path).unwrap();
        let mut outputs = Outputs::new(KEEP);
        let mut file = outputs.open("--it", &path).unwrap();
        let bytes = vec![b'x'; 1 << 20];
        let length = bytes.len();
        let writer = thread::spawn(move || file.write_all(&bytes));
        let mut read = vec![0; length];
        reader.read_exact(&mut read).unwrap();
        assert!(writer.join().unwrap().is_ok());
        assert!(read.iter().all(|byte| *byte == b'x'));
    }

    #[test]
    fn an_input_is_no_output_even_by_force() {
        let directory = tempfile::tempdir().unwrap();
        let place = |name: &str| directory.path().join(name);
        fs::write(place("cell"), "precious").unwrap();
        symlink("cell", place("link")).unwrap();
        fs::hard_link(place("cell"), place("other")).unwrap();
        for name in ["cell", "link", "other"] {
            let inputs = crate::inputs::Inputs::default();
            inputs.read("the cell file", &place("cell"), 100).unwrap();
            let mut outputs = Outputs::new(FORCE);
            outputs.known.extend(inputs.identities());
            let said = refusal(&mut outputs, &place(name));
            assert!(said.contains("the cell file is the same file"), "{said}");
        }
        assert_eq!(fs::read_to_string(place("cell")).unwrap(), "precious");
    }

    #[test]
    fn a_file_that_another_command_writes_is_refused_even_by_force() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("it");
        let mut first = Outputs::new(KEEP);
        let mut file = first.open("--it", &path).unwrap();
        first.begin().unwrap();
        file.write_all(b"first").unwrap();
        // A second command has its own description of the file, as another process has.
        let said = refusal(&mut Outputs::new(FORCE), &path);
        assert!(said.contains("another command writes to the file"), "{said}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        drop(file);
        Outputs::new(FORCE).open("--it", &path).unwrap();
    }

    #[test]
    fn devices_may_be_named_twice_and_pipes_may_not() {
        let mut outputs = Outputs::new(KEEP);
        for device in ["/dev/null", "/dev/null", "/dev/full"] {
            outputs.open("--it", Path::new(device)).unwrap();
        }
        let (mut pipe, end) = io::pipe().unwrap();
        let path = PathBuf::from(format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&end)));
        let mut file = outputs.open("--it", &path).unwrap();
        assert!(refusal(&mut outputs, &path).contains("--it has the same file"));
        outputs.begin().unwrap();
        file.write_all(b"through").unwrap();
        drop((file, end));
        let mut read = String::new();
        pipe.read_to_string(&mut read).unwrap();
        assert_eq!(read, "through");
    }
}
