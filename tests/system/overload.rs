//! Blocked and overloaded axes: the faults of runs, and the warnings and refusals of `check`.

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{CellFile, EmulatedBlock, EmulatedPayload, EmulatedPlane, EmulatedScene, Instruction, Law};
use ::mrroc::check::CheckReport;
use ::mrroc::run::{Requests, RunOptions, run};
use ::mrroc::tasks::CarriedTask;
use kit::mrroc::{Directory, example, root};

fn cell(name: &str, change: impl FnOnce(&mut CellFile)) -> CellFile {
    let mut file = CellFile::read(example(name)).unwrap();
    change(&mut file);
    file
}

fn check(file: &CellFile) -> Result<CheckReport, String> {
    ::mrroc::check(file, &CarriedTask::Programs.program()).map_err(|error| error.to_string())
}

/// The first fault of a run, with what to check.
fn fault_of(file: &CellFile, scenario: Option<&str>) -> Result<String, String> {
    let directory = Directory::new();
    let scenario = scenario.map(|scenario| directory.write("scenario.toml", scenario));
    let options = RunOptions { scenario, ..RunOptions::on(BenchKind::Lockstep) };
    let program = CarriedTask::Programs.program();
    let report = run(file, &options, &Requests::default(), &program, &mut |_| {}).map_err(|error| error.to_string())?;
    let fault = report.faults.first();
    Ok(fault.map_or(String::new(), |fault| format!("{}: {}", fault.what, fault.check.unwrap_or_default())))
}

/// A payload that hangs on the robot from the beginning.
fn carrying(name: &str, mass: f64) -> CellFile {
    let payload = EmulatedPayload { at_s: 0.0, mass, centre: [0.0, 0.0, 0.1] };
    cell(name, |file| file.cell.robot[0].emulated_payload = vec![payload])
}

fn scene(planes: Vec<EmulatedPlane>, blocks: Vec<EmulatedBlock>) -> Option<EmulatedScene> {
    Some(EmulatedScene { robot: Some("irb6".to_owned()), plane: planes, block: blocks, ..EmulatedScene::default() })
}

/// A wall across the path of the IRb-6: x is at most 0.8 m.
fn wall(stiffness: f64) -> EmulatedPlane {
    EmulatedPlane { normal: [-1.0, 0.0, 0.0], height: -0.8, stiffness, damping: 100.0, friction: 0.0 }
}

#[test]
fn a_blocked_axis_is_not_sent_to_the_encoder_alone() {
    for (name, axis) in
        [("irb6", "lower-arm"), ("irb6-serial", "lower-arm"), ("irb6-hi-moxa", "lower-arm"), ("rnt", "leg-1")]
    {
        let scenario = format!("[[fault]]\nat = 0.5\nwhen = \"cruising\"\nkind = \"blocked\"\naxis = \"{axis}\"\n");
        let found = fault_of(&cell(name, |_| {}), Some(&scenario)).unwrap();
        // The torque of a slow search rises for longer than the position is watched.
        let blocked =
            found.starts_with("blocked or overloaded: torque ") && found.contains("free the axis, check brake");
        let stands = found.starts_with("measured position stands still") && found.contains("look for an obstacle");
        assert!(blocked || stands, "{name}: {found}");
    }
}

#[test]
fn an_axis_that_cannot_carry_its_payload_is_overloaded() {
    for name in ["irb6", "irp6"] {
        let found = fault_of(&carrying(name, 30.0), None).unwrap();
        assert!(found.starts_with("blocked or overloaded: torque "), "{name}: {found}");
    }
    // An axis that falls moves as one with swapped phases does.
    let found = fault_of(&carrying("rnt", 1000.0), None).unwrap();
    assert!(found.starts_with("following error ") && found.contains("a high load"), "{found}");
}

#[test]
fn check_warns_of_an_overload_by_nominal_limits_and_refuses_one_by_given_limits() {
    for (name, mass, axis) in [("irb6", 30.0, "upper-arm"), ("irp6", 30.0, "upper-arm"), ("rnt", 1000.0, "leg-1")] {
        let warnings = check(&carrying(name, mass)).unwrap().warnings;
        let named =
            |warning: &String| warning.contains(&format!("axis {axis} needs ")) && warning.contains("nominal drive");
        assert!(warnings.iter().any(named), "{name}: {warnings:?}");
    }
    // A limit of the cell file: of an axis controller, or of a drive with max_torque.
    let mut given = carrying("irb6", 60.0);
    for axis in &mut given.cell.robot[0].axis {
        axis.drive.as_mut().unwrap().max_torque = Some(1.5);
    }
    for file in [given, carrying("irb6-serial", 60.0), carrying("irb6-hi-moxa", 1000.0)] {
        let refusal = check(&file).unwrap_err();
        assert!(refusal.contains("robot[0].emulated_payload[0].mass: robot irb6: axis "), "{refusal}");
        assert!(refusal.contains("the limit of the cell file is "), "{refusal}");
        assert_eq!(fault_of(&file, None).unwrap_err(), refusal);
    }
    // A payload that comes later hangs on the robot for a part of the task.
    let mut later = carrying("irb6-serial", 60.0);
    later.cell.robot[0].emulated_payload[0].at_s = 1000.0;
    assert!(!check(&later).unwrap().warnings.is_empty());
}

#[test]
fn a_motor_that_cannot_accelerate_its_load_is_a_warning() {
    // Motors with ten times their acceleration, in motions at full speed.
    let fast = |file: &mut CellFile| {
        let robot = &mut file.cell.robot[0];
        robot.axis.iter_mut().for_each(|axis| axis.max_acceleration *= 10.0);
        for instruction in &mut robot.program {
            if let Instruction::Joints(motion) = instruction {
                (motion.velocity, motion.acceleration) = (1.0, 1.0);
            }
        }
    };
    let rnt = cell("rnt", fast);
    let warnings = check(&rnt).unwrap().warnings;
    let accelerates = |warning: &String| warning.contains("axis leg-") && warning.contains(" inertia ");
    assert!(warnings.iter().any(accelerates), "{warnings:?}");
    let found = fault_of(&rnt, None).unwrap();
    assert!(found.starts_with("blocked or overloaded: torque "), "{found}");
}

#[test]
fn a_body_in_the_path_of_the_tip_is_found_before_the_run() {
    let in_path = |name: &str, scene: Option<EmulatedScene>| check(&cell(name, |file| file.cell.scene = scene));
    let block =
        EmulatedBlock { centre: [0.85, 0.0, 0.85], size: [0.1; 3], stiffness: 1e6, damping: 0.0, friction: 0.0 };
    for (what, scene) in [("plane", scene(vec![wall(1e6)], vec![])), ("block", scene(vec![], vec![block]))] {
        let warnings = in_path("irb6", scene.clone()).unwrap().warnings;
        assert!(warnings.iter().any(|it| it.contains(&format!("contact with scene.{what}[0]"))), "{warnings:?}");
        let refusal = in_path("irb6-serial", scene).unwrap_err();
        assert!(refusal.contains(&format!("scene.{what}[0]: robot irb6: axis ")), "{refusal}");
    }
    // A soft body yields, and a wall beyond the path is not touched.
    let far = EmulatedPlane { height: -1.5, ..wall(1e6) };
    for plane in [wall(10.0), far] {
        assert_eq!(in_path("irb6-serial", scene(vec![plane], vec![])).unwrap().warnings, [""; 0]);
    }
}

#[test]
fn check_warns_of_axes_that_lag_behind_by_late_set_points_or_by_their_weight() {
    // SYNC behind foreign frames: the set-points of drives that interpolate stand until SYNC comes.
    let loaded = |following_error: f64| {
        cell("irb6", |file| {
            file.cell.bus[0].emulated_load = 0.4;
            file.cell.robot[0].axis.iter_mut().for_each(|axis| axis.following_error = following_error);
        })
    };
    let file = loaded(0.2);
    let warnings = check(&file).unwrap().warnings;
    let named = |warning: &String| {
        warning.starts_with("robot irb6: axis wrist-roll may have a following error of ")
            && warning.contains("following_error is 0.20 rad")
    };
    assert!(warnings.iter().any(named), "{warnings:?}");
    let found = fault_of(&file, None).unwrap();
    assert!(found.contains("0x8611"), "{found}");
    assert_eq!(check(&loaded(2.0)).unwrap().warnings, [""; 0]);
    // A loop that is stable, and too soft for the weight of the upper arm.
    let soft = cell("irb6-serial", |file| {
        let controller = file.cell.robot[0].axis[2].controller.as_mut().unwrap();
        let Law::Cascade(law) = &mut controller.r#loop.law else { panic!("a cascade") };
        law.velocity_gain *= 0.16;
    });
    let warnings = check(&soft).unwrap().warnings;
    let named = |warning: &String| {
        warning.starts_with("robot irb6: axis upper-arm ") && warning.contains(" a weight and a friction of ")
    };
    assert!(warnings.iter().any(named) && warnings.len() == 1, "{warnings:?}");
    let found = fault_of(&soft, None).unwrap();
    assert!(found.starts_with("following error "), "{found}");
}

#[test]
fn no_example_cell_overloads_an_axis() {
    let cells = std::fs::read_dir(root().join("cells")).unwrap().map(|entry| entry.unwrap().path());
    let cells: Vec<_> = cells.filter(|path| path.extension().is_some_and(|it| it == "toml")).collect();
    assert!(cells.len() > 20);
    for path in cells {
        let report = check(&CellFile::read(&path).unwrap()).unwrap();
        assert_eq!(report.warnings, [""; 0], "{}", path.display());
    }
}
