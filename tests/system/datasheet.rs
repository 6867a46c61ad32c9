//! `mrroc datasheet`: the pages and figures of `docs/robots` equal its output.

use ::mrroc::cell::Model;
use kit::mrroc::{mrroc, root};
use kit::refusals::refused;

#[test]
fn the_pages_and_figures_of_the_robots_are_what_the_parameters_give() {
    for name in Model::ALL.map(Model::name) {
        for (ending, words) in [("md", vec![]), ("svg", vec!["--figure"])] {
            let words: Vec<_> = ["datasheet", "--robot", name].into_iter().chain(words).collect();
            let output = mrroc(&words);
            assert_eq!(output.status.code(), Some(0), "{output:?}");
            let path = root().join(format!("docs/robots/{name}.{ending}"));
            let kept = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            assert!(
                kept == output.stdout,
                "{} is out of date: write there what `mrroc {}` prints",
                path.display(),
                words.join(" ")
            );
            assert!(!kept.contains("NaN") && !kept.contains("inf,"), "{name}");
            let of_fractions = "are fractions of 1.5 rad/s and 7 rad/s² (1.5 m/s and 7 m/s² of a linear joint)";
            assert_eq!(kept.contains(of_fractions), ending == "md", "{name}");
            let (told, _) = kept.split_once("## Loop").unwrap_or((&kept, ""));
            let rows = told.lines().filter(|line| line.starts_with("| "));
            for row in rows.filter(|row| !row.ends_with("| source |")) {
                let cells: Vec<_> = row.trim_matches('|').split('|').map(str::trim).collect();
                let [.., tag, source] = cells[..] else {
                    panic!("{name}: {row}");
                };
                assert!(["public code", "derived", "nominal"].contains(&tag), "{name}: {row}");
                assert!(!source.is_empty(), "{name}: {row}");
            }
        }
    }
}

#[test]
fn a_data_sheet_of_nothing_is_refused() {
    refused(&mrroc(["datasheet", "--robot", "nosuch"]), &["only irb6"]);
}
