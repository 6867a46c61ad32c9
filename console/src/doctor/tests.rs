//! Small trees of files in place of a host.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

use super::tree::Tree;

/// A tree of files that goes with the test.
pub(super) struct Fake(PathBuf);

impl Fake {
    /// Files by their path and their text.
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("mrroc-doctor-{}-{number}", std::process::id());
        let fake = Self(std::env::temp_dir().join(name));
        fs::create_dir(&fake.0).unwrap();
        for (path, text) in files {
            fs::write(fake.ready(path), text).unwrap();
        }
        fake
    }

    /// A symbolic link, `target` seen from where it lies.
    pub(super) fn link(&self, path: &str, target: &str) {
        symlink(target, self.ready(path)).unwrap();
    }

    pub(super) fn tree(&self) -> Tree {
        Tree::new(&self.0)
    }

    fn ready(&self, path: &str) -> PathBuf {
        let path = self.0.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
