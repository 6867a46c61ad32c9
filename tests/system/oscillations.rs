//! Loops that oscillate are reported with axis and frequency. Loops of the example cells do not.

use std::fs;
use std::path::Path;

use ::mrroc::cell::{CascadeConfig, Law};
use kit::mrroc::{Directory, mrroc, root};
use serde_json::Value;

fn oscillations(cell: &Path) -> Value {
    let run = mrroc(["run".as_ref(), cell.as_os_str(), "--bench=lockstep".as_ref(), "--json".as_ref()]);
    assert_eq!(run.status.code(), Some(0), "{}: {run:?}", cell.display());
    run.json()["oscillations"].take()
}

/// Without a feed-forward of acceleration, a cell does not state the inertia of the motor, and its gains are not checked
/// against it.
#[test]
fn an_axis_whose_gains_are_too_great_for_its_motor_is_reported_and_its_robot_completes() {
    let directory = Directory::new();
    let too_great: [fn(&mut CascadeConfig); 2] = [|law| law.integral_rate *= 50.0, |law| law.velocity_gain *= 5.0];
    for (change, (frequency, velocity)) in too_great.into_iter().zip([(27.8, 37.0), (60.6, 17.0)]) {
        let cell = directory.cell("irb6-serial", |cell| {
            let controller = cell.robot[0].axis[0].controller.as_mut().unwrap();
            controller.r#loop.feed_forward.acceleration = 0.0;
            let Law::Cascade(law) = &mut controller.r#loop.law else { unreachable!("the law of the example") };
            change(law);
        });
        let found = oscillations(&cell);
        let [column] = &found.as_array().unwrap()[..] else { panic!("{found}") };
        assert_eq!(column["axis"], "column");
        for (key, expected) in [("frequency_hz", frequency), ("velocity_rad_s", velocity)] {
            let ratio = column[key].as_f64().unwrap() / expected;
            assert!((0.9..1.1).contains(&ratio), "{key}: {column}");
        }
    }
}

#[test]
fn no_axis_of_an_example_cell_oscillates() {
    let cells = fs::read_dir(root().join("cells")).unwrap().map(|entry| entry.unwrap().path());
    let cells: Vec<_> = cells.filter(|path| path.extension().is_some_and(|it| it == "toml")).collect();
    assert!(cells.len() > 20, "{cells:?}");
    for cell in cells {
        assert_eq!(oscillations(&cell), Value::Array(Vec::new()), "{}", cell.display());
    }
}
