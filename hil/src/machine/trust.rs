//! Trusted directories: no other user of the host can change their content or their path.

use std::fs::{self, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};

/// Maximum number of links on a path.
const LINKS: u32 = 40;

/// Permission bits: write permission of other users; the sticky bit, which lets only owners rename and remove
/// entries.
const OTHERS_WRITE: u32 = 0o002;
const STICKY: u32 = 0o1000;

/// The superuser.
const ROOT: u32 = 0;

/// Reasons why a path is not trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Distrust {
    /// A directory or link of the path belongs to this other user.
    Foreign(u32),
    /// Any user can change a directory of the path.
    Shared,
    /// The path cannot be examined.
    Unknown(io::ErrorKind),
}

impl From<io::Error> for Distrust {
    fn from(error: io::Error) -> Self {
        Self::Unknown(error.kind())
    }
}

/// Resolves `path`, which is absolute and exists. Fails if anybody but `user` and the superuser can change the
/// result.
pub(super) fn resolve(path: &Path, user: u32) -> Result<PathBuf, Distrust> {
    let mut links = LINKS;
    resolve_within(path, user, &mut links)
}

fn resolve_within(path: &Path, user: u32, links: &mut u32) -> Result<PathBuf, Distrust> {
    let mut reached = PathBuf::from("/");
    let_pass(&fs::symlink_metadata(&reached)?, user)?;
    for component in path.components() {
        match component {
            Component::Normal(name) => {
                let next = reached.join(name);
                let found = fs::symlink_metadata(&next)?;
                let_pass(&found, user)?;
                if found.is_symlink() {
                    *links = links.checked_sub(1).ok_or_else(endless)?;
                    let target = reached.join(fs::read_link(&next)?);
                    reached = resolve_within(&target, user, links)?;
                } else {
                    reached = next;
                }
            }
            Component::ParentDir => _ = reached.pop(),
            Component::Prefix(_) | Component::RootDir | Component::CurDir => {}
        }
    }
    Ok(reached)
}

/// Error of a path with too many links.
fn endless() -> io::Error {
    io::Error::from_raw_os_error(libc::ELOOP)
}

/// Checks that only `user` and the superuser can replace a directory or link of a path.
fn let_pass(found: &Metadata, user: u32) -> Result<(), Distrust> {
    passes(found.uid(), found.mode(), found.is_dir(), user)
}

fn passes(owner: u32, mode: u32, is_directory: bool, user: u32) -> Result<(), Distrust> {
    if owner != user && owner != ROOT {
        return Err(Distrust::Foreign(owner));
    }
    let shared = is_directory && mode & OTHERS_WRITE != 0 && mode & STICKY == 0;
    if shared {
        Err(Distrust::Shared)
    } else {
        Ok(())
    }
}

/// Resolves `directory`, made first if missing. Fails if anybody but `user` can write to the directory.
pub(super) fn own(directory: &Path, user: u32) -> Result<PathBuf, Distrust> {
    let directory = std::path::absolute(directory)?;
    let there = |place: &&Path| fs::symlink_metadata(place).is_ok();
    let there = directory.ancestors().find(there).unwrap_or(Path::new("/"));
    let rest = directory.strip_prefix(there).expect("an ancestor of it");
    let directory = resolve(there, user)?.join(rest);
    fs::create_dir_all(&directory)?;
    let found = fs::metadata(&directory)?;
    // Directories of the superuser do not belong to the user, and any user can add entries to a sticky directory.
    if found.uid() != user {
        return Err(Distrust::Foreign(found.uid()));
    }
    if found.mode() & OTHERS_WRITE != 0 {
        return Err(Distrust::Shared);
    }
    Ok(directory.canonicalize()?)
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn others_neither_own_a_way_nor_write_to_it() {
        const USER: u32 = 1000;
        for (owner, mode, is_directory, expected) in [
            (USER, 0o700, true, Ok(())),
            (ROOT, 0o755, true, Ok(())),
            (USER, 0o775, true, Ok(())),
            (ROOT, 0o1777, true, Ok(())),
            // The mode of a link has no meaning.
            (USER, 0o777, false, Ok(())),
            (1001, 0o755, true, Err(Distrust::Foreign(1001))),
            (1001, 0o777, false, Err(Distrust::Foreign(1001))),
            (USER, 0o777, true, Err(Distrust::Shared)),
            (ROOT, 0o757, true, Err(Distrust::Shared)),
        ] {
            let found = passes(owner, mode, is_directory, USER);
            assert_eq!(found, expected, "{owner} {mode:o}");
        }
    }

    #[test]
    fn a_path_is_followed_over_the_users_own_links_and_made() {
        let top = tempfile::tempdir().unwrap();
        let top = top.path().canonicalize().unwrap();
        let user = fs::metadata(&top).unwrap().uid();
        fs::create_dir(top.join("there")).unwrap();
        symlink("there", top.join("link")).unwrap();
        symlink("loop", top.join("loop")).unwrap();
        assert_eq!(resolve(&top.join("link"), user), Ok(top.join("there")));
        let made = own(&top.join("link/a/b"), user);
        assert_eq!(made, Ok(top.join("there/a/b")));
        assert_eq!(resolve(&top.join("loop"), user), Err(endless().into()));

        fs::set_permissions(top.join("there"), Permissions::from_mode(0o1777)).unwrap();
        assert_eq!(own(&top.join("link"), user), Err(Distrust::Shared));
        assert_eq!(own(&top.join("link/c"), user), Ok(top.join("there/c")));
        assert_eq!(
            own(&top.join("link/c"), user + 1),
            Err(Distrust::Foreign(user))
        );
    }
}
