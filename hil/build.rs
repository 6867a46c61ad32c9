//! Builds the library that user-mode Linux loads before the C library, with the C compiler that also links Rust programs.

use std::env;
use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=src/uml-ptrace.c");
    println!("cargo::rerun-if-env-changed=CC");
    let out = env::var_os("OUT_DIR").expect("cargo names the directory");
    let library = Path::new(&out).join("uml-ptrace.so");
    let compiler = env::var_os("CC").unwrap_or_else(|| "cc".into());
    let built = Command::new(&compiler)
        .args(["-O2", "-shared", "-fPIC", "-s", "src/uml-ptrace.c", "-o"])
        .arg(&library)
        .status();
    let built = built.unwrap_or_else(|error| panic!("{}: {error}: install a C compiler", compiler.display()));
    assert!(built.success(), "{} does not build src/uml-ptrace.c", compiler.display());
}
