//! The file of the steps of generators, repeated runs of the examples, and the list of the examples.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use kit::mrroc::{example, root};
use kit::steps::{Line, lines, run};

/// The examples with a cell of their own, in the order of the alphabet. An example that is the whole command takes its cell
/// from the command line.
fn examples() -> Vec<(String, String)> {
    let files = fs::read_dir(root().join("examples")).unwrap().map(|file| file.unwrap().path());
    let sources = files.filter(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let with_cell = |path: std::path::PathBuf| {
        let source = fs::read_to_string(&path).unwrap();
        if source.contains("mrroc_console::main(") {
            return None;
        }
        let cell = source.split_once("\"cells/").and_then(|(_, rest)| rest.split_once(".toml\"")).unwrap().0.to_owned();
        Some((path.file_stem().unwrap().to_str().unwrap().to_owned(), cell))
    };
    let mut examples: Vec<_> = sources.filter_map(with_cell).collect();
    examples.sort();
    examples
}

/// The images that the steps of each generator and coordinator read, by agent, generator and class.
fn images(steps: &str) -> BTreeMap<(&str, &str, u8), BTreeSet<&str>> {
    let mut images = BTreeMap::<_, BTreeSet<_>>::new();
    for Line { agent, generator, class, event, .. } in lines(steps) {
        let read = images.entry((agent, generator, class)).or_default();
        if event.starts_with("read-") {
            read.insert(event);
        }
    }
    images
}

/// The class of an example: the highest class of its next steps.
fn class(steps: &str) -> u8 {
    lines(steps).filter(|line| line.macrostep > 0).map(|line| line.class).max().unwrap()
}

#[test]
fn every_example_reads_the_images_of_its_class_and_repeats_bit_for_bit_in_lockstep() {
    let list = fs::read_to_string(root().join("examples/README.md")).unwrap();
    let mut classes = BTreeSet::new();
    for (program, cell) in examples() {
        let cell = example(&cell);
        let (one, two) = (run(&program, &cell), run(&program, &cell));
        assert!(one == two, "{program} differs from run to run");
        for ((agent, generator, class), read) in images(&one.0) {
            // The answers of the members are the effector of a coordinator.
            let effector = if agent == "coordinator" { "read-answer" } else { "read-effector" };
            let declared = [(effector, 1), ("read-sensor", 2), ("read-order", 4)];
            let declared = declared.into_iter().filter_map(|(image, bit)| (class & bit != 0).then_some(image));
            assert_eq!(read, declared.collect(), "{program}: {generator}, class {class}");
        }
        let class = class(&one.0);
        assert!(list.contains(&format!("| [`{program}.rs`]({program}.rs) | {class} |")), "{program}, class {class}");
        classes.insert(class);
    }
    assert_eq!(classes, (0..8).collect(), "classes of the examples");
}

#[test]
fn two_arms_carry_a_bar_within_the_bounds() {
    let (_, _, report) = run("carry_bar", &example("two-irb6"));
    let figures = &report["figures"];
    let figure = |name: &str| figures[name].as_f64().unwrap();
    assert!(figure("object_path_rms_mm") < 0.5, "{figures}");
    assert!(figure("grip_distance_max_mm") < 0.2, "{figures}");
    assert_eq!(figure("start_skew_cycles_max"), 0.0, "{figures}");
}

#[test]
fn the_arm_that_is_free_serves_the_next_station() {
    let (_, _, report) = run("dispatch", &example("two-irb6"));
    let figure = |name: &str| report["figures"][name].as_f64().unwrap();
    let (left, right) = (figure("served_by_left"), figure("served_by_right"));
    assert!(left + right == 8.0 && left > right && right > 0.0, "{left} {right}");
}

/// The emulated light gate changes at 15 s. Filter and inhibit time of its node delay the frame by some milliseconds.
#[test]
fn the_arm_stops_at_the_position_that_it_had_at_the_edge() {
    let (_, record, report) = run("latch_edge", &example("irb6-touch"));
    let rows = record.lines().skip(1).map(|row| row.split(',').collect::<Vec<_>>());
    let column: Vec<_> = rows.filter(|row| row[2] == "column").collect();
    let number = |text: &str| text.parse::<f64>().unwrap();
    let at_edge = column.iter().find(|row| number(row[1]) >= 15.0).unwrap();
    let (position, velocity, end) = (number(at_edge[6]), number(at_edge[8]), number(column.last().unwrap()[5]));
    let delay = (end - position) / velocity;
    assert!((0.0..0.008).contains(&delay), "{delay} s after the edge");
    // The motion went on for more than the tolerance.
    let passed = report["figures"]["passed_by_rad"].as_f64().unwrap();
    assert!(passed > 0.05 * 0.016, "{report}");
}

/// The first generator in the book: type and functions, without the task that uses it.
#[test]
fn the_first_generator_of_the_book_is_shorter_than_40_lines_and_is_that_of_the_example() {
    let source = fs::read_to_string(root().join("examples/own_generator.rs")).unwrap();
    let generator = &source[source.find("struct ").unwrap()..source.find("async fn").unwrap()];
    let book = fs::read_to_string(root().join("book/src/own-generator.md")).unwrap();
    let begin = book.find("## Your first generator").expect("the section");
    assert!(book[begin..].contains(generator.trim_end()), "the book has another generator");
    assert!(generator.lines().count() < 40, "{} lines", generator.lines().count());
}
