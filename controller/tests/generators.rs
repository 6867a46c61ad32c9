//! Generators that the compiler refuses, with its messages (`tests/refused/*.stderr`).
//!
//! `rustc` compiles each file alone, with the library that this executable was built with. The messages are those of
//! the present compiler. `REFUSED=overwrite cargo test -p mrroc-controller --test main generators` writes the messages
//! again: read each one as a user would.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The newest build of the library beside this executable. Cargo has just built the library if it was older than its
/// sources.
fn library() -> PathBuf {
    let executable = std::env::current_exe().expect("the system knows its path");
    let folder = executable.parent().expect("an executable is in a folder");
    let built = fs::read_dir(folder).expect("the folder is readable").map(|entry| entry.expect("readable"));
    let is_library = |name: &str| name.starts_with("libmrroc_controller-") && name.ends_with(".rlib");
    let libraries = built.filter(|entry| entry.file_name().to_str().is_some_and(is_library));
    let newest = libraries.max_by_key(|entry| entry.metadata().and_then(|data| data.modified()).expect("a file"));
    newest.expect("Cargo puts the library beside its tests").path()
}

/// The root of the workspace, from which Cargo has compiled the library. The compiler finds the sources of the library
/// there.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the controller is inside the workspace")
}

/// The messages of the compiler for this file, or nothing if the file compiles.
fn refusal(library: &Path, file: &Path) -> Option<String> {
    let compiler = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let mut library_of_file = std::ffi::OsString::from("mrroc_controller=");
    library_of_file.push(library);
    let output = Command::new(compiler)
        .current_dir(root())
        .args(["--edition", "2024", "--emit", "metadata", "--out-dir", env!("CARGO_TARGET_TMPDIR"), "--extern"])
        .arg(library_of_file)
        .args(["-L".as_ref(), library.parent().expect("the library is in a folder").as_os_str()])
        .arg(Path::new("controller").join(file))
        .output()
        .expect("the compiler starts");
    let messages = String::from_utf8(output.stderr).expect("messages are text");
    (!output.status.success()).then(|| steady(&messages))
}

/// The messages without the numbers of lines of the library, which change with the library, and without the count of
/// the errors.
fn steady(messages: &str) -> String {
    let messages = messages.split("error: aborting due to").next().unwrap_or_default();
    let mut lines = Vec::new();
    for message in messages.trim_end().split("\n\n") {
        // The numbers of lines are right-aligned in a margin as wide as the greatest number.
        let margin = message.lines().find_map(|line| line.find("--> ")).unwrap_or(0);
        let mut is_own = true;
        for line in message.lines() {
            let (number, rest) = line.split_at_checked(margin).unwrap_or((line, ""));
            if margin == 0 || !number.chars().all(|character| character == ' ' || character.is_ascii_digit()) {
                lines.push(line.to_owned());
                continue;
            }
            let mut rest = rest.to_owned();
            if let Some((_, place)) = rest.strip_prefix("--> ").and_then(|path| path.rsplit_once("controller/")) {
                is_own = place.starts_with("tests/");
                let file = place.split(':').next().unwrap_or(place);
                rest = format!("--> {}", if is_own { place } else { file });
            }
            let number = if is_own { number.trim() } else { "" };
            lines.push(format!("{number:>2}{rest}").trim_end().to_owned());
        }
        lines.push(String::new());
    }
    lines.pop();
    lines.join("\n") + "\n"
}

#[test]
fn generators_that_read_more_than_they_declare_do_not_compile() {
    let library = library();
    let folder = Path::new("tests/refused");
    let listed = fs::read_dir(folder).expect("the folder is there").map(|entry| entry.expect("readable").path());
    let mut files: Vec<PathBuf> = listed.filter(|path| path.extension().is_some_and(|name| name == "rs")).collect();
    files.sort();
    assert_eq!(files.len(), 11);
    for file in files {
        let refused = refusal(&library, &file).unwrap_or_else(|| panic!("{} compiles", file.display()));
        let expected = file.with_extension("stderr");
        if std::env::var_os("REFUSED").is_some_and(|value| value == "overwrite") {
            fs::write(&expected, &refused).expect("the folder is writable");
        }
        let expected = fs::read_to_string(expected).unwrap_or_default();
        assert_eq!(refused, expected, "{}:\n{refused}", file.display());
    }
}
