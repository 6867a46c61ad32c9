//! Tests of whole cells: parsing, refusals, and the resulting configurations.

mod bounds;
mod camera;
mod conveyor;
mod device_configuration;
mod emergency_contact;
mod families;
mod force;
mod io;
mod lines;
mod names;
mod ranging;
mod scene;
mod shape;
mod times;
mod workpiece;

use super::*;
use controller::robot::Limits;

const IRB6: &str = include_str!("../../../cells/irb6.toml");
const IRP6: &str = include_str!("../../../cells/irp6.toml");
const TRACK: &str = include_str!("../../../cells/irp6-track.toml");
const RNT: &str = include_str!("../../../cells/rnt.toml");
const POLYCRANK: &str = include_str!("../../../cells/polycrank.toml");
const LAB: &str = include_str!("../../../cells/lab.toml");
const SERIAL: &str = include_str!("../../../cells/irb6-serial.toml");

/// The line, counted from 1, of the first occurrence of `needle`.
fn line_of(text: &str, needle: &str) -> usize {
    text[..text.find(needle).expect("the needle is in the text")].matches('\n').count() + 1
}

#[test]
fn parameters_of_a_task_are_read_or_refused_with_line_and_key() {
    #[derive(Debug, Default, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Parameters {
        parts: u8,
        #[serde(default)]
        places: Vec<[f64; 2]>,
    }
    let (cell, _) = IRB6.split_once("[task]").unwrap();
    let first = cell.matches('\n').count() + 1;
    let read = |table: &str| {
        let text = format!("{cell}{table}");
        Cell::parse(&text).unwrap();
        read::parameters::<Parameters>(&text, &[])
    };
    let full = read("[task]\nparts = 3\nplaces = [[0.5, 1], [0.25, -0.5]]");
    assert_eq!(full, Ok(Parameters { parts: 3, places: vec![[0.5, 1.0], [0.25, -0.5]] }));
    for (table, line, key, problem) in [
        ("", 1, "task.parts", "is missing"),
        ("[task]", first, "task.parts", "is missing"),
        ("[task]\nparts = 300", first + 1, "task.parts", "is 300, must be a whole number from 0 to 255"),
        ("[task]\nparts = 3\nplaces = [[1, 2], [3]]", first + 2, "task.places[1]", "has 1 element, must have 2"),
        ("[task]\npart = 3", first + 1, "task.part", "is an unknown key, must be \"parts\" or \"places\""),
    ] {
        let expected = CellError { line, key: key.to_owned(), problem: problem.to_owned() };
        assert_eq!(read(table), Err(expected), "{table}");
    }
}

#[test]
fn parameters_of_a_named_task_are_its_own_table_or_those_of_the_file() {
    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Parts {
        parts: u8,
    }
    let (cell, _) = IRB6.split_once("[task]").unwrap();
    let read = |table: &str, names: &[&str]| {
        let text = format!("{cell}{table}");
        Cell::parse(&text).unwrap();
        read::parameters::<Parts>(&text, names).map(|it| it.parts).map_err(|it| format!("{}: {}", it.key, it.problem))
    };
    let both = "[task]\nparts = 1\n[task.teach]\nparts = 2\n";
    assert_eq!(read(both, &[]), Ok(1));
    assert_eq!(read(both, &["teach"]), Ok(2));
    assert_eq!(read(both, &["replay", "teach"]), Ok(2));
    assert_eq!(read("[task]\nparts = 3\n", &["teach"]), Ok(3));
    for (table, problem) in [
        ("[task]\nattempts = 4\n", "task.attempts: is an unknown key, must be \"parts\"; or give the table task.teach"),
        ("", "task.parts: is missing; or give the table task.teach"),
        ("[task.teach]\npart = 2\n", "task.teach.part: is an unknown key, must be \"parts\""),
    ] {
        assert_eq!(read(table, &["teach"]), Err(problem.to_owned()));
    }
}

#[test]
fn the_task_teach_finds_its_parameters_in_the_first_cell() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
    let file = CellFile::read(&path).unwrap();
    let program = crate::tasks::CarriedTask::Teach.program();
    let rehearsed = crate::rehearsal::rehearse(&file, &program);
    let said = rehearsed.err().map(|error| format!("{error:#}")).unwrap_or_default();
    assert!(said.contains("--operator"), "{said}");
}

#[test]
fn example_cells_parse_and_their_programs_can_be_built() {
    for text in [IRB6, IRP6, TRACK, RNT, POLYCRANK, LAB] {
        let cell = Cell::parse(text).unwrap();
        for (number, robot) in cell.robot.iter().enumerate() {
            let arm = robot.arm().unwrap();
            let task = cell.task(number, &arm).unwrap();
            let last = robot.program.len().checked_sub(1);
            assert_eq!(robot.instruction_of(task.len() - 2), last, "{}", cell.name);
            assert_eq!(robot.instruction_of(task.len() - 1), None, "{}", cell.name);
        }
    }
}

#[test]
fn a_refusal_names_line_key_and_reason() {
    let cases: [(&str, &str, &str, &str); 37] = [
        (
            "node = 1",
            "emulator = { counts_per_revolution = 3 }\nnode = 1",
            "robot[0].axis[0].emulator.counts_per_revolution",
            "between 4 and 10000000",
        ),
        (
            "node = 1",
            "emulator = { rated_torque = 0.0 }\nnode = 1",
            "robot[0].axis[0].emulator.rated_torque",
            "between 1e-6 and 4294",
        ),
        ("method = 11", "method = 12", "robot[0].axis[0].homing.method", "must be 37, 34,"),
        (
            "rated_torque = 0.42 }",
            "rated_torque = 0.42, max_torque = 0.4 }",
            "robot[0].axis[0].drive.max_torque",
            "rated_torque at the least",
        ),
        (
            "search_velocity = 15.0",
            "search_velocity = 1500.0",
            "robot[0].axis[0].homing.search_velocity",
            "is 1500, must be between 0.7667 and 250 (rad/s of the motor",
        ),
        ("period_us = 2000", "period_us = 0", "period_us", "must be between 1000 and 100000 (µs)"),
        ("period_us = 2000", "period_us = 2500", "period_us", "must be a multiple of 1000"),
        (
            "period_us = 2000",
            "period_us = \"fast\"",
            "period_us",
            "is \"fast\", must be a whole number from 0 to 4294967295",
        ),
        ("period_us = 2000", "period_us = = 1", "", "extra `=`"),
        (
            "period_us = 2000",
            "priod_us = 2000",
            "priod_us",
            "is an unknown key, must be \"name\", \"period_us\", \"macrostep\"",
        ),
        ("macrostep = 10", "macrostep = 0", "macrostep", "must be between 1 and 1000"),
        ("priority = 80", "priority = 100", "realtime.priority", "must be between 1 and 99"),
        ("priority = 80", "spin_share = 0.6\npriority = 80", "realtime.spin_share", "must be between 0 and 0.5"),
        (
            "priority = 80",
            "margin_us = 401\npriority = 80",
            "realtime.margin_us",
            "is 401, must be between 0 and 400 (µs, spin_share of the period)",
        ),
        (
            "priority = 80",
            "cpu = 0\nscheduler = \"deadline\"",
            "realtime.cpu",
            "must be left out with scheduler = \"deadline\"",
        ),
        (
            "priority = 80",
            "wait = \"spin\"\npriority = 80",
            "realtime.wait",
            "is \"spin\", must be \"plain\" or \"hybrid\"",
        ),
        ("bitrate_kbps = 1000", "bitrate_kbps = 83", "bus[0].bitrate_kbps", "bit time of whole nanoseconds"),
        ("model = \"irb6\"", "model = \"irp6\"", "robot[0].axis", "has 5 axes, must have 6"),
        ("bus = \"arm\"", "bus = \"leg\"", "robot[0].axis[0].bus", "no bus is called \"leg\""),
        ("node = 2", "node = 1", "robot[0].axis[1].node", "used twice, first by robot[0].axis[0]"),
        ("node = 2", "node = 127", "robot[0].axis[1].node", "used twice, first by the host"),
        ("node = 2", "node = 128", "robot[0].axis[1].node", "must be between 1 and 127"),
        ("max_velocity = 250.0", "max_velocity = nan", "robot[0].axis[0].max_velocity", "must be a finite number"),
        (
            "max_velocity = 250.0",
            "max_velocity = -1.0",
            "robot[0].axis[0].max_velocity",
            "is -1, must be between 0.7667 and 10000 (rad/s of the motor",
        ),
        (
            "max_velocity = 250.0",
            "min_position = 5.0\nmax_position = -5.0\nmax_velocity = 1.0",
            "robot[0].axis[0].min_position",
            "is 5, not below the upper limit -5",
        ),
        (
            "max_velocity = 250.0",
            "min_position = 450.0\nmax_velocity = 1.0",
            "robot[0].axis[0].min_position",
            "is 450, not below the upper limit 450",
        ),
        (
            "max_velocity = 250.0",
            "max_position = -469.0\nmax_velocity = 1.0",
            "robot[0].axis[0].max_position",
            "is -469, must not be below the home position -15.9, where the motor stands after homing",
        ),
        (
            "max_velocity = 250.0",
            "min_position = 449.0\nmax_velocity = 1.0",
            "robot[0].axis[0].min_position",
            "is 449, must not be above the home position -15.9, where the motor stands after homing",
        ),
        (
            "max_velocity = 250.0",
            "max_position = -470.0\nmax_velocity = 1.0",
            "robot[0].axis[0].max_position",
            "is -470, not above the lower limit -470",
        ),
        (
            "max_velocity = 250.0",
            "min_position = -470.1\nmax_velocity = 1.0",
            "robot[0].axis[0].min_position",
            "is -470.1, must lie within the model's limits -470 and 450",
        ),
        (
            "max_velocity = 250.0",
            "min_position = 500.0\nmax_velocity = 1.0",
            "robot[0].axis[0].min_position",
            "is 500, must lie within the model's limits -470 and 450",
        ),
        (
            "max_velocity = 250.0",
            "max_position = 450.1\nmax_velocity = 1.0",
            "robot[0].axis[0].max_position",
            "is 450.1, must lie within the model's limits -470 and 450",
        ),
        (
            "max_velocity = 250.0",
            "max_position = -500.0\nmax_velocity = 1.0",
            "robot[0].axis[0].max_position",
            "is -500, must lie within the model's limits -470 and 450",
        ),
        (
            "name = \"lower-arm\"",
            "name = \"column\"",
            "robot[0].axis[1].name",
            "axis \"column\" is used twice, first by robot[0].axis[0]",
        ),
        ("[[0.4, ", "[[inf, ", "robot[0].program[0].joints.poses[0][0]", "must be a finite number"),
        ("[[0.4, ", "[[", "robot[0].program[0].joints.poses[0]", "has 4 joint values, must have 5"),
        (
            "velocity = 0.2",
            "velocity = 0.0",
            "robot[0].program[1].line.velocity",
            "is 0, must be between 0.0001 and 100 (m/s)",
        ),
    ];
    for (good, bad, key, reason) in cases {
        let text = IRB6.replacen(good, bad, 1);
        let error = Cell::parse(&text).unwrap_err();
        let shown = error.to_string();
        assert!(shown.contains(reason), "{bad}: {shown}");
        assert_eq!(error.key, key, "{bad}");
        // A list is located at its first element; any other value is located at the replacement.
        let place = if key.ends_with(".axis") { "[[robot.axis]]" } else { good };
        assert_eq!(error.line, line_of(IRB6, place), "{bad}: {shown}");
        assert!(!shown.contains('\n'), "{bad}: {shown}");
    }
}

#[test]
fn a_loop_that_may_ask_for_more_current_than_the_drive_has_is_refused() {
    // The column: 25 A at 0.105 N·m/A are 2.625 N·m.
    for (good, bad) in [("limit = 2.1 ", "limit = 2.63 "), ("max_current = 25.0", "max_current = 19.9")] {
        let error = Cell::parse(&SERIAL.replacen(good, bad, 1)).unwrap_err();
        assert_eq!(error.line, line_of(SERIAL, good), "{error}");
        let key = "robot[0].axis[0].controller.loop.law.cascade.limit";
        assert_eq!(error.key, key);
        assert!(error.to_string().contains("max_current * torque_constant"));
    }
    assert!(Cell::parse(&SERIAL.replacen("limit = 2.1 ", "limit = 2.625 ", 1)).is_ok());
    assert!(Cell::parse(SERIAL).is_ok());
}

#[test]
fn a_drive_by_velocity_or_torque_has_a_loop_that_suits_it_and_no_other_has_one() {
    let velocity = "{ proportional = { position_gain = 50.0, limit = 280.0 } }";
    let cascade = "{ cascade = { position_gain = 17.0, velocity_gain = 0.04, integral_rate = 7.0, limit = 2.0 } }";
    let over = "{ proportional = { position_gain = 50.0, limit = 301.0 } }";
    let strong = "{ cascade = { position_gain = 17.0, velocity_gain = 0.04, integral_rate = 7.0, limit = 13.5 } }";
    let cases = [
        ("velocity", Some(velocity), ""),
        ("velocity", Some(cascade), ""),
        ("torque", Some(cascade), ""),
        ("position", None, ""),
        ("position", Some(cascade), "loop: is for control"),
        ("velocity", None, "loop: is missing"),
        ("torque", None, "loop: is missing"),
        ("torque", Some(velocity), "loop.law.proportional: is for control = \"velocity\""),
        ("velocity", Some(over), "runaway_velocity at the most"),
        ("torque", Some(strong), "32 * rated_torque at the most"),
    ];
    for (control, law, refusal) in cases {
        let law = law.map_or(String::new(), |law| format!(", loop = {{ law = {law} }}"));
        let drive = format!("rated_torque = 0.42, control = \"{control}\"{law} }}");
        let parsed = Cell::parse(&IRB6.replacen("rated_torque = 0.42 }", &drive, 1));
        match parsed {
            Ok(cell) => {
                assert_eq!(refusal, "", "{drive}");
                let config = cell.robot[0].servo_config(0, 0, 0, Limits { low: -1.0, high: 1.0 });
                let by_host = config.position_loop != servo::PositionLoop::Drive;
                assert_eq!(by_host, control != "position");
                assert_eq!(config.homing, None, "the drive homes it");
            }
            Err(error) => {
                let text = error.to_string();
                assert!(!refusal.is_empty() && text.contains(refusal), "{drive}: {text}");
                assert_eq!(error.line, line_of(IRB6, "rated_torque"), "{text}");
            }
        }
    }
    let of_line = SERIAL.replacen(
        "{ cascade = { position_gain = 25.0, velocity_gain = 0.043, integral_rate = 10.0, limit = 2.1 } }",
        velocity,
        1,
    );
    let text = Cell::parse(&of_line).unwrap_err().to_string();
    assert!(text.contains("proportional: is for a drive that closes"), "{text}");
}

#[test]
fn an_axis_controller_is_not_left_unheard_for_longer_than_ten_cycles() {
    let cases = [
        ("tolerated_missing", 0, "must be between 1 and 10 (cycles)"),
        ("tolerated_missing", 1, ""),
        ("tolerated_missing", 10, ""),
        ("tolerated_missing", 11, "must be between 1 and 10 (cycles)"),
        ("answer_timeout_ms", 1000, ""),
        ("answer_timeout_ms", 1001, "must be between 1 and 1000 (ms)"),
    ];
    for (key, value, refusal) in cases {
        let line = format!("protocol = \"nfv2\"\n{key} = {value}");
        let parsed = Cell::parse(&SERIAL.replacen("protocol = \"nfv2\"", &line, 1));
        match parsed {
            Ok(_) => assert_eq!(refusal, "", "{key} = {value}"),
            Err(error) => {
                assert_eq!(error.key, format!("serial[0].{key}"));
                let text = error.to_string();
                assert!(!refusal.is_empty() && text.contains(refusal), "{text}");
            }
        }
    }
}

#[test]
fn torque_of_the_example_cell_leaves_a_tenth_to_the_overshoot_of_the_current_loops() {
    let cell = Cell::parse(SERIAL).unwrap();
    for axis in &cell.robot[0].axis {
        let controller = axis.axis_controller();
        let Law::Cascade(law) = controller.r#loop.law else {
            panic!("{}: {:?}", axis.name, controller.r#loop);
        };
        let greatest = controller.max_current * controller.torque_constant;
        if controller.control == Control::Current {
            assert!(law.limit <= 0.9 * greatest, "{}: {}", axis.name, law.limit);
        }
    }
}

#[test]
fn a_pose_that_the_arm_cannot_take_names_its_instruction() {
    let cases = [
        ("[[0.4, -1.8,", "[[0.4, -0.5,", "robot[0].program[0].joints.poses[0]", "axis 1"),
        ("position = [0.85, 0.0, 0.85]", "position = [3.0, 0.0, 0.85]", "robot[0].program[1].line", "out of reach"),
        (
            "position = [0.85, 0.0, 0.85]",
            "position = [0.85, 0.3, 0.85]",
            "robot[0].program[1].line",
            "out of the arm's plane",
        ),
    ];
    for (good, bad, key, reason) in cases {
        let text = IRB6.replacen(good, bad, 1);
        assert_ne!(text, IRB6, "{good}");
        let cell = Cell::parse(&text).unwrap();
        let (found, error) = cell.task(0, &cell.robot[0].arm().unwrap()).unwrap_err();
        assert_eq!(found.to_string(), key, "{bad}: {error}");
        assert!(error.to_string().contains(reason), "{bad}: {error}");
    }
}

#[test]
fn every_motor_stays_within_its_share_when_all_joints_move_at_once() {
    let cell = Cell::parse(IRP6).unwrap();
    let robot = &cell.robot[0];
    let arm = robot.arm().unwrap();
    let limits = robot.motion_limits(&arm);
    let home = arm.joints(&arm.robot().home().padded()).unwrap();
    let before = arm.motors(&home).unwrap();
    let dt = 1e-4;
    let mut joints = home;
    for (joint, limit) in joints.iter_mut().zip(limits.max_velocity).take(arm.axes()) {
        *joint += limit * dt;
    }
    let after = arm.motors(&joints).unwrap();
    for (motor, axis) in robot.axis.iter().enumerate() {
        let velocity = (after[motor] - before[motor]).abs() / dt;
        assert!(velocity <= axis.max_velocity, "motor {motor}: {velocity}");
    }
}

#[test]
fn each_instruction_of_a_task_is_of_one_of_the_program() {
    let two_poses = IRB6.replacen("[[-0.5, ", "[[-0.4, -1.6, 0.0, 0.9, 1.0], [-0.5, ", 1);
    let cell = Cell::parse(&two_poses).unwrap();
    let robot = &cell.robot[0];
    let expected = [None, None, Some(0), Some(1), Some(2), Some(2), None, None];
    assert_eq!(std::array::from_fn(|index| robot.instruction_of(index)), expected);
}

#[test]
fn a_model_has_one_name_and_the_axes_of_its_robot() {
    for model in Model::ALL {
        assert_eq!(toml::Value::try_from(model).unwrap().as_str(), Some(model.name()));
        let robot = model.parameters().kinematics().unwrap();
        assert_eq!(robot.axes(), model.parameters().axes(), "{}", model.name());
    }
}

#[test]
fn robots_may_come_to_a_meeting_any_number_of_times() {
    let meet = "[[robot.program]]\nmeet = \"end\"\n";
    let text = LAB.replace(meet, &meet.repeat(300));
    assert!(text.len() > LAB.len() + 6 * 299 * meet.len() - 1);
    let meetings = Cell::parse(&text).unwrap().meetings();
    assert_eq!(meetings.len(), 3);
    assert!(meetings.iter().all(|meeting| meeting.robots == [0, 1, 2, 3, 4, 5]), "{meetings:?}");
}

#[test]
fn meetings_that_cannot_be_held_are_refused_at_their_line() {
    // For the robots irb6, irp6-track, rnt, polycrank, gripper and conveyor: start, middle and end.
    let third = |good: &str, bad: &str, occurrence: usize| {
        let at = LAB.match_indices(good).nth(occurrence).unwrap().0;
        format!("{}{bad}{}", &LAB[..at], &LAB[at + good.len()..])
    };
    let meet = |name: &str| format!("meet = {name:?}");
    let swapped = third(&meet("start"), &meet("tmp"), 2);
    let swapped = swapped
        .match_indices("meet = \"half-way\"")
        .nth(2)
        .map(|(at, it)| format!("{}{}{}", &swapped[..at], meet("start"), &swapped[at + it.len()..]));
    let swapped = swapped.unwrap().replacen("\"tmp\"", "\"half-way\"", 1);
    let many: String = (0..254).map(|name| format!("[[robot.program]]\nmeet = \"{name}\"\n\n")).collect();
    let cases = [
        (
            third(&meet("end"), &meet("END"), 1),
            "robot[1].program[4].meet: no robot but \"irp6-track\" comes to meeting \"END\"",
        ),
        (
            third(&meet("end"), &meet("start"), 5),
            "robot[5].program[4].meet: robot \"conveyor\" comes 2 times to meeting \"start\", robot \"irb6\" 1 time",
        ),
        (
            swapped,
            "robot[0].program[0].meet: meeting \"start\" is never held: robot \"irb6\" waits for robot \"rnt\" there, \
             which waits at \"half-way\"",
        ),
        (
            LAB.replacen("[[robot.program]]", &format!("{many}[[robot.program]]"), 1),
            "robot[0].program[258].meet: is one of 257 meetings of the cell, which may have 256",
        ),
        (
            third("duration = 6.0", "duration = 0.0", 0),
            "robot[0].program[1].joints.duration: is 0, must be between 0.001",
        ),
        // No profile is longer than 7600 s.
        (
            third("duration = 6.0", "duration = 7201.0", 0),
            "robot[0].program[1].joints.duration: is 7201, must be between 0.001 and 7200 (s)",
        ),
        (
            third("generator = \"jerk-limited\", duration", "duration", 0),
            "robot[0].program[1].joints.duration: is for jerk-limited motions",
        ),
    ];
    for (text, refusal) in cases {
        let error = Cell::parse(&text).unwrap_err().to_string();
        assert!(error.contains(refusal), "{error}");
        let key = refusal.split(": ").next().unwrap().rsplit('.').next().unwrap();
        let line: usize = error.split(':').next().unwrap().parse().unwrap();
        assert!(text.lines().nth(line - 1).unwrap().contains(key), "{error}");
    }
}
