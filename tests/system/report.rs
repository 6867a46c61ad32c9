//! How far tools were from their commanded paths, and the page that `mrroc run --out` writes.

use std::fs;
use std::path::Path;

use kit::mrroc::{Directory, Output, example, mrroc, root};
use roxmltree::{Document, ParsingOptions};
use serde_json::Value;

/// A lockstep run of an example cell with `words`.
fn lockstep(cell: &str, words: &[&str]) -> Output {
    let cell = example(cell);
    let run = ["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref()];
    let words = words.iter().map(|word| word.as_ref());
    let run = mrroc(run.into_iter().chain(words));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    run
}

/// The page of a lockstep run of an example cell.
fn page(cell: &str) -> String {
    let directory = Directory::new();
    let out = directory.path("out");
    lockstep(cell, &[&format!("--out={}", out.display())]);
    fs::read_to_string(out.join("report.html")).expect("the page is there")
}

fn parse(page: &str) -> Document<'_> {
    let options = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
    Document::parse_with_options(page, options).expect("the page is well formed")
}

#[test]
fn the_report_begins_with_the_tool_path_error_of_each_robot() {
    let run = lockstep("irb6", &[]);
    let first = run.stdout.lines().next().unwrap();
    assert!(first.starts_with("irb6  tool 0.0"), "{first}");
    assert!(first.contains(" mm rms, 0.") && first.ends_with("° peak"), "{first}");
    let report = lockstep("lab", &["--json"]).json();
    let robots = report["robots"].as_array().unwrap();
    assert_eq!(report["lost_records"], 0);
    for robot in robots {
        let number = |error: &str, size: &str| robot[error][size].as_f64();
        let peak = number("position_mm", "peak").unwrap();
        let rms = number("position_mm", "rms").unwrap();
        assert!(0.0 < rms && rms < peak && peak < 5.0, "{robot}");
        assert!(robot["cycles"].as_u64() > Some(500), "{robot}");
        assert_eq!(robot["unsolved"], 0, "{robot}");
        let is_tool = robot["subject"] == "tool";
        assert_eq!(robot["orientation_deg"] != Value::Null, is_tool, "{robot}");
    }
    let joints = robots.iter().filter(|robot| robot["subject"] == "joint");
    assert_eq!(joints.count(), 2, "gripper and conveyor");
}

#[test]
fn the_page_of_a_run_is_one_file_that_loads_nothing() {
    let page = page("irb6");
    for reference in ["http:", "https:", "src=", "href=", "<link", "<script", "url(", "@import", "<!ENTITY"] {
        assert!(!page.contains(reference), "{reference}");
    }
    assert!(!page.contains("NaN"));
    let read = parse(&page);
    let named = |name: &'static str| {
        let nodes = read.descendants();
        nodes.filter(move |node| node.has_tag_name(name))
    };
    let cells: Vec<_> = named("td").filter_map(|cell| cell.text()).collect();
    for text in ["irb6", "tool", "column", "wrist-roll", "bus", "arm"] {
        assert!(cells.contains(&text), "{text}: {cells:?}");
    }
    // Virtual time has no delays.
    assert!(!cells.contains(&"wake-up"), "{cells:?}");
    let title = |svg: roxmltree::Node| {
        let title = svg.first_element_child().filter(|it| it.has_tag_name("title"));
        title.and_then(|title| title.text()).map(str::to_owned)
    };
    let titles: Vec<_> = named("svg").map(title).collect();
    let expected = [
        "irb6: tool path and its error",
        "irb6: joint position, degrees",
        "irb6: joint error, degrees",
        "Last answer after SYNC",
    ];
    assert_eq!(titles, expected.map(|title| Some(title.to_owned())));
    assert!(named("svg").all(|svg| svg.attribute("role") == Some("img")));
}

/// The figure of README is the plot of the tool in the page of the example cell.
#[test]
fn the_figure_of_the_example_run_is_what_the_run_draws() {
    let page = page("irb6");
    let (_, figure) = page.split_once("<svg").unwrap();
    let (figure, _) = figure.split_once("</svg>").unwrap();
    let drawn = format!("<svg xmlns=\"http://www.w3.org/2000/svg\"{figure}</svg>\n");
    parse(&drawn);
    let kept = root().join("docs/run.svg");
    if fs::read_to_string(&kept).is_ok_and(|kept| kept == drawn) {
        return;
    }
    let new = root().join("target/run.svg");
    let written = fs::write(&new, drawn);
    written.unwrap_or_else(|error| panic!("{}: {error}", new.display()));
    let [new, kept] = [&new, &kept].map(|path: &std::path::PathBuf| Path::display(path));
    panic!("docs/run.svg is out of date: cp {new} {kept}");
}

#[test]
fn errors_of_a_bus_are_counted_and_told() {
    let directory = Directory::new();
    let scenario = "[[fault]]\nwhen = \"cruising\"\nkind = \"bus-off\"\nbus = \"arm\"\n";
    let scenario = directory.write("scenario.toml", scenario);
    let cell = example("irb6");
    let run = |json: &[&str]| {
        let words = ["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref(), "--scenario".as_ref()];
        let run = mrroc(words.into_iter().chain([scenario.as_os_str()]).chain(json.iter().map(|word| word.as_ref())));
        assert_eq!(run.status.code(), Some(1), "{run:?}");
        run
    };
    let told = run(&[]);
    let warning = "\nwarning: bus arm: 1 error frame, error passive 0 times, bus off 1 time: check bit rate";
    assert!(told.stdout.contains(warning), "{told:?}");
    let report = run(&["--json"]).json();
    let (bus, told) = (&report["buses"][0], &report["warnings"][0]);
    let what = told["what"].as_str().unwrap();
    assert!(what.starts_with("1 error frame, error passive 0 times, bus off 1 time: check"), "{told}");
    assert_eq!((&told["bus"], &told["node"]), (&"arm".into(), &().into()), "{told}");
    assert_eq!((&bus["errors"], &bus["error_passive"], &bus["bus_off"]), (&1.into(), &0.into(), &1.into()));
    assert_eq!(lockstep("irb6", &["--json"]).json()["buses"][0]["errors"], 0);
}
