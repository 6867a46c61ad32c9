//! Trusted directories: no other user of the host can change their content or their path.

use std::fs::{self, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};

/// Maximum number of links on a path.
const LINKS: u32 = 40;

/// Permission bits: the group writes; others write; only its owner can rename or remove an entry.
const GROUP_WRITES: u32 = 0o020;
const OTHERS_WRITE: u32 = 0o002;
const STICKY: u32 = 0o1000;
const ROOT: u32 = 0;

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

/// Resolves an absolute, existing `path`. Fails if anybody but `user` and the superuser can change the result.
pub(super) fn resolve(path: &Path, user: u32) -> Result<PathBuf, Distrust> {
    resolve_within(path, user, &mut { LINKS })
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
                    *links = links.checked_sub(1).ok_or_else(|| io::Error::from_raw_os_error(libc::ELOOP))?;
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

/// Checks that only `user` and the superuser can replace a directory or link of a path.
fn let_pass(found: &Metadata, user: u32) -> Result<(), Distrust> {
    passes(found.uid(), mode_of_others(found, user), found.is_dir(), user)
}

/// The mode, without the write permission of a group that has no other user.
fn mode_of_others(found: &Metadata, user: u32) -> u32 {
    let mode = found.mode();
    let asked = mode & GROUP_WRITES != 0;
    let read = |path| fs::read_to_string(path).unwrap_or_default();
    if asked && is_private(found.gid(), user, &read("/etc/passwd"), &read("/etc/group")) {
        mode & !GROUP_WRITES
    } else {
        mode
    }
}

/// Whether `user` alone is in the group `gid`, by passwd(5) and group(5). A group of another source counts as shared.
fn is_private(gid: u32, user: u32, passwd: &str, group: &str) -> bool {
    let fields = |line: &'_ str| line.split(':').map(str::to_owned).collect::<Vec<_>>();
    let number = |fields: &[String], at: usize| fields.get(at)?.parse::<u32>().ok();
    let users: Vec<_> = passwd.lines().map(fields).collect();
    let of_user = users.iter().find(|fields| number(fields, 2) == Some(user));
    let mut groups = group.lines().map(fields);
    let of_group = groups.find(|fields| number(fields, 2) == Some(gid));
    let (Some(of_user), Some(of_group)) = (of_user, of_group) else {
        return false;
    };
    let name = &of_user[0];
    let mut members = of_group.iter().skip(3).flat_map(|list| list.split(','));
    let mut primary = users.iter().filter(|fields| number(fields, 3) == Some(gid));
    members.all(|member| member.is_empty() || member == name) && primary.all(|fields| number(fields, 2) == Some(user))
}

fn passes(owner: u32, mode: u32, is_directory: bool, user: u32) -> Result<(), Distrust> {
    if owner != user && owner != ROOT {
        return Err(Distrust::Foreign(owner));
    }
    let writable = mode & (GROUP_WRITES | OTHERS_WRITE) != 0;
    if is_directory && writable && mode & STICKY == 0 { Err(Distrust::Shared) } else { Ok(()) }
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
    if mode_of_others(&found, user) & (GROUP_WRITES | OTHERS_WRITE) != 0 {
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
            (ROOT, 0o1777, true, Ok(())),
            (ROOT, 0o1775, true, Ok(())),
            // The mode of a link says nothing.
            (USER, 0o777, false, Ok(())),
            (1001, 0o755, true, Err(Distrust::Foreign(1001))),
            (1001, 0o777, false, Err(Distrust::Foreign(1001))),
            (USER, 0o777, true, Err(Distrust::Shared)),
            // A group has other users.
            (USER, 0o775, true, Err(Distrust::Shared)),
            (ROOT, 0o775, true, Err(Distrust::Shared)),
            (ROOT, 0o757, true, Err(Distrust::Shared)),
        ] {
            let found = passes(owner, mode, is_directory, USER);
            assert_eq!(found, expected, "{owner} {mode:o}");
        }
    }

    #[test]
    fn a_group_is_private_where_the_user_alone_is_in_it() {
        let passwd = "root:x:0:0::/root:/bin/sh\nann:x:1000:1000::/home/ann:/bin/sh\n\
                      bob:x:1001:1001::/home/bob:/bin/sh\ncy:x:1002:1003::/home/cy:/bin/sh\n";
        let group = "root:x:0:\nann:x:1000:\nbob:x:1001:ann\nstaff:x:50:ann,bob\nown:x:51:ann\nlab:x:1003:ann\n";
        for (gid, user, expected) in [
            (1000, 1000, true),
            (51, 1000, true),
            // Another user is in the group, as a member or by the primary group.
            (1001, 1001, false),
            (50, 1000, false),
            (1003, 1000, false),
            (1000, 1001, false),
            // Groups and users that these files do not know.
            (77, 1000, false),
            (1000, 77, false),
        ] {
            assert_eq!(is_private(gid, user, passwd, group), expected, "{gid} {user}");
        }
        assert!(!is_private(1000, 1000, "", ""));
    }

    #[test]
    fn a_directory_that_its_group_can_write_to_is_not_the_users_own() {
        let top = tempfile::tempdir().unwrap();
        let top = top.path().canonicalize().unwrap();
        let found = fs::metadata(&top).unwrap();
        let read = |path| fs::read_to_string(path).unwrap_or_default();
        let (passwd, group) = (read("/etc/passwd"), read("/etc/group"));
        let private = is_private(found.gid(), found.uid(), &passwd, &group);
        fs::create_dir(top.join("there")).unwrap();
        fs::set_permissions(top.join("there"), Permissions::from_mode(0o775)).unwrap();
        let expected = if private { Ok(top.join("there")) } else { Err(Distrust::Shared) };
        assert_eq!(own(&top.join("there"), found.uid()), expected);
        assert_eq!(resolve(&top.join("there"), found.uid()), expected);
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
        assert_eq!(resolve(&top.join("loop"), user), Err(io::Error::from_raw_os_error(libc::ELOOP).into()));

        fs::set_permissions(top.join("there"), Permissions::from_mode(0o1777)).unwrap();
        assert_eq!(own(&top.join("link"), user), Err(Distrust::Shared));
        assert_eq!(own(&top.join("link/c"), user), Ok(top.join("there/c")));
        assert_eq!(own(&top.join("link/c"), user + 1), Err(Distrust::Foreign(user)));
    }
}
