//! A groove that the IRb-6 cuts, by the truth of the emulated workpiece.

use std::fs;
use std::process::Command;

use kit::mrroc::{Directory, example, example_program};
use serde_json::Value;

/// The picture of a workpiece: columns, rows, and grey values from the row with the greatest y.
fn picture(bytes: &[u8]) -> (usize, usize, Vec<u16>) {
    let mut rest = bytes;
    let mut words = Vec::new();
    while words.len() < 4 {
        let end = rest.iter().position(|byte| *byte == b'\n').unwrap();
        let line = std::str::from_utf8(&rest[..end]).unwrap();
        if !line.starts_with('#') {
            words.extend(line.split(' ').map(str::to_owned));
        }
        rest = &rest[end + 1..];
    }
    assert_eq!((words[0].as_str(), words[3].as_str()), ("P5", "65535"));
    let [columns, rows] = [1, 2].map(|word: usize| words[word].parse().unwrap());
    let grey: Vec<_> = rest.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
    assert_eq!(grey.len(), columns * rows);
    (columns, rows, grey)
}

#[test]
fn the_groove_in_the_board_is_that_which_the_controller_measures() {
    let directory = Directory::new();
    let carved = directory.path("carved");
    let mut command = Command::new(example_program("cut_groove"));
    command.arg(example("irb6-milling")).args(["--bench", "lockstep", "--json", "--carved"]).arg(&carved);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let figure = |name: &str| report["figures"][name].as_f64().unwrap();
    println!("{}", report["figures"]);
    // K_c · b · h + K_e · b, with the depth that the tool has reached, N.
    let expected = 25.0 * 2.0 * figure("depth_mm") + 2.0 * 2.0;
    assert!((figure("cutting_force_n") - expected).abs() < 0.05 * expected, "{expected} N: {report}");
    assert!(figure("depth_error_mm") < 0.05, "{report}");

    let (columns, rows, grey) = picture(&fs::read(carved.join("board.pgm")).unwrap());
    assert_eq!((columns, rows), (800, 1200));
    // 5 mm of thickness over 65535 levels; 0.1 mm per pixel.
    let depth = |column: usize, row: usize| (65535.0 - f64::from(grey[row * columns + column])) * 5.0 / 65535.0;
    // The middle half of the groove.
    let (mut sum, mut count, mut widths) = (0.0, 0.0, Vec::new());
    for row in 500..700 {
        let cut: Vec<_> = (0..columns).map(|column| depth(column, row)).filter(|depth| *depth > 0.0).collect();
        widths.push(0.1 * cut.len() as f64);
        sum += cut.iter().sum::<f64>();
        count += cut.len() as f64;
    }
    let (mean, width) = (sum / count, widths.iter().sum::<f64>() / widths.len() as f64);
    println!("truth: depth {mean:.4} mm, width {width:.3} mm");
    assert!((mean - figure("depth_mm")).abs() < 0.02, "{mean} mm: {report}");
    assert!((width - figure("width_mm")).abs() < 0.15, "{width} mm: {report}");
    assert!(widths.iter().all(|width| (1.8..=2.3).contains(width)), "{widths:?}");
    // Ends of the groove: half a diameter beyond 20 mm on both sides.
    let length = (0..rows).filter(|row| (0..columns).any(|column| depth(column, *row) > 0.0)).count();
    assert!((0.1 * length as f64 - 42.0).abs() < 0.3, "{length} rows");
}
