//! The corpus of every fuzz target, the example files of the tree, and seeded variations of both.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::fs;
use std::path::{Path, PathBuf};

use mrroc_fuzz_targets::TARGETS;

/// Inputs of a target beside its corpus, by the folder and the end of their names.
const EXAMPLES: [(&str, &str, &str); 5] = [
    ("cell", "cells", "toml"),
    ("scenario", "cells/scenarios", "toml"),
    ("eds", "cells", "eds"),
    ("eds", "tests", "dcf"),
    ("urdf", "cells", "urdf"),
];

/// Variations of each target. The costs of one input differ by a factor of a thousand.
fn variations(target: &str) -> u32 {
    match target {
        "can_bus" | "recording" => 100,
        "axis_controllers" | "serial_sensors" | "can_devices" | "scenario" | "cell" | "eds" => 300,
        _ => 1_000,
    }
}

/// Longest input of a variation, bytes.
const LONGEST: usize = 4096;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().to_owned()
}

/// The files of a folder, in the order of their names.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).filter(|path| path.is_file()).collect();
    files.sort();
    files
}

fn inputs(target: &str) -> Vec<Vec<u8>> {
    let mut paths = files(&root().join("fuzz/corpus").join(target));
    for (_, folder, end) in EXAMPLES.into_iter().filter(|(of, ..)| *of == target) {
        let examples = files(&root().join(folder));
        paths.extend(examples.into_iter().filter(|path| path.extension().is_some_and(|found| found == end)));
    }
    paths.into_iter().map(|path| fs::read(path).unwrap()).collect()
}

/// A generator of random numbers (xorshift64*).
struct Draw(u64);

impl Draw {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) as usize % bound.max(1)
    }

    /// Bytes that no input has, or an input with a few changes.
    fn vary(&mut self, inputs: &[Vec<u8>]) -> Vec<u8> {
        if inputs.is_empty() || self.below(4) == 0 {
            let length = self.below(512);
            return (0..length).map(|_| self.below(256) as u8).collect();
        }
        let mut bytes = inputs[self.below(inputs.len())].clone();
        for _ in 0..=self.below(8) {
            let place = self.below(bytes.len() + 1);
            match self.below(5) {
                0 if place < bytes.len() => bytes[place] = self.below(256) as u8,
                1 if place < bytes.len() => bytes[place] ^= 1 << self.below(8),
                2 => bytes.insert(place, self.below(256) as u8),
                3 => _ = bytes.drain(place..(place + self.below(16)).min(bytes.len())),
                _ => {
                    let other = &inputs[self.below(inputs.len())];
                    let from = self.below(other.len() + 1);
                    let part = other[from..(from + self.below(64)).min(other.len())].to_vec();
                    bytes.splice(place..place, part);
                }
            }
        }
        bytes.truncate(LONGEST);
        bytes
    }
}

/// Prints the input of a target that panics.
struct Shown<'a>(&'a str, &'a [u8]);

impl Drop for Shown<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let bytes: Vec<String> = self.1.iter().map(|byte| format!("{byte:02x}")).collect();
            eprintln!("{} panics with the bytes {}", self.0, bytes.concat());
        }
    }
}

#[test]
fn no_target_panics() {
    let seed = 20_261_123;
    for (name, run) in TARGETS {
        let inputs = inputs(name);
        let mut draw = Draw(seed);
        let varied: Vec<_> = (0..variations(name)).map(|_| draw.vary(&inputs)).collect();
        for bytes in inputs.iter().chain(&varied) {
            let shown = Shown(name, bytes);
            run(bytes);
            drop(shown);
        }
    }
}

#[test]
fn every_target_has_a_program_and_a_corpus() {
    let programs = files(&root().join("fuzz/fuzz_targets"));
    let programs: Vec<_> = programs.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
    assert_eq!(programs, TARGETS.map(|(name, _)| name));
    for (name, _) in TARGETS {
        assert!(!inputs(name).is_empty(), "{name}");
    }
    let sizes = TARGETS.map(|(name, _)| files(&root().join("fuzz/corpus").join(name)));
    let total: u64 = sizes.iter().flatten().map(|path| fs::metadata(path).unwrap().len()).sum();
    assert!(total < 200_000, "{total} bytes: minimise the corpus");
}
