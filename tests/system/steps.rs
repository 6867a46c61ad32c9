//! The file of the steps of generators, and repeated runs of the examples.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::process::Command;

use serde_json::Value;

use crate::mrroc::{Directory, example, example_program};

/// The examples, with their cells.
const EXAMPLES: [(&str, &str); 7] = [
    ("carry_bar", "two-irb6"),
    ("feedback", "irb6"),
    ("first_program", "irb6"),
    ("own_generator", "irb6"),
    ("replan", "irb6"),
    ("retry", "irb6"),
    ("until_touch", "irb6-touch"),
];

/// The steps, the record and the figures of an example in lockstep.
fn run(program: &str, cell: &str) -> (String, String, Value) {
    let directory = Directory::new();
    let [steps, record] = ["steps.csv", "axes.csv"].map(|name| directory.path(name));
    let mut command = Command::new(example_program(program));
    command.arg(example(cell)).args(["--bench", "lockstep", "--json", "--steps"]).arg(&steps);
    let output = command.arg("--record").arg(&record).output().unwrap();
    assert!(output.status.success(), "{program}: {output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let [steps, record] = [steps, record].map(|path| fs::read_to_string(path).unwrap());
    (steps, record, report["figures"].clone())
}

/// The images that the steps of each generator read, by generator and class.
fn images(steps: &str) -> BTreeMap<(&str, u8), BTreeSet<&str>> {
    let mut images = BTreeMap::<_, BTreeSet<_>>::new();
    for line in steps.lines().skip(1) {
        // The name of a generator is in quotes, and may have commas.
        let [before, generator, after] = line.splitn(3, '"').collect::<Vec<_>>()[..] else { panic!("{line}") };
        assert_eq!(before.split(',').count(), 4, "{line}");
        let [_, class, _, event, ..] = after.split(',').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let read = images.entry((generator, class.parse().unwrap())).or_default();
        if event.starts_with("read-") {
            read.insert(event);
        }
    }
    images
}

#[test]
fn every_example_reads_the_images_of_its_class_and_repeats_bit_for_bit_in_lockstep() {
    let mut classes = BTreeSet::new();
    for (program, cell) in EXAMPLES {
        let (one, two) = (run(program, cell), run(program, cell));
        assert!(one == two, "{program} differs from run to run");
        for ((generator, class), read) in images(&one.0) {
            let declared = [("read-effector", 1), ("read-sensor", 2), ("read-order", 4)];
            let declared = declared.into_iter().filter_map(|(image, bit)| (class & bit != 0).then_some(image));
            assert_eq!(read, declared.collect(), "{program}: {generator}, class {class}");
            classes.insert(class);
        }
    }
    assert_eq!(classes, BTreeSet::from([0, 1, 2, 5]), "classes of the examples");
}

#[test]
fn two_arms_carry_a_bar_within_the_bounds() {
    let (_, _, figures) = run("carry_bar", "two-irb6");
    let figure = |name: &str| figures[name].as_f64().unwrap();
    assert!(figure("object_path_rms_mm") < 0.5, "{figures}");
    assert!(figure("grip_distance_max_mm") < 0.2, "{figures}");
    assert_eq!(figure("start_skew_cycles_max"), 0.0, "{figures}");
}
