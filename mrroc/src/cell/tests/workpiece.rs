//! Tests of the keys of workpieces and cutting tools.

use super::*;
use hil::scene::WorkpieceConfig;

const MILLING: &str = include_str!("../../../../cells/irb6-milling.toml");

#[test]
fn a_workpiece_is_of_fibreboard_where_nothing_else_is_given() {
    let cell = Cell::parse(MILLING).unwrap();
    let scene = cell.scene.as_ref().unwrap();
    let config = scene.workpiece[0].config();
    assert_eq!(config.cells(), [800, 1200]);
    assert_eq!((config.cell, config.specific_force, config.edge_force), (1e-4, 25e6, 2e3));
    assert_eq!(config.specific_force, WorkpieceConfig::FIBREBOARD_SPECIFIC_FORCE);
    assert_eq!(scene.cutter[0].spindle, None);
}

#[test]
fn a_workpiece_or_a_tool_that_cannot_be_is_refused_with_line_key_and_reason() {
    let second = "[[scene.cutter]]\nrobot = \"irb6\"\ndiameter = 0.003\n\n[[scene.cutter]]";
    let workpiece = &MILLING[MILLING.find("[[scene.workpiece]]").unwrap()..MILLING.find("[[scene.cutter]]").unwrap()];
    let size = "size = [0.08, 0.12, 0.005]";
    let cases = [
        (size, "size = [0.0, 0.12, 0.005]", "scene.workpiece[0].size[0]: is 0, must be between 0.0001 and 10 (m)"),
        (size, "size = [0.08, 0.12, 0.0]", "scene.workpiece[0].size[2]: is 0, must be between"),
        (size, "size = [0.08, 0.12, nan]", "scene.workpiece[0].size[2]: must be a finite number"),
        (
            size,
            "size = [1.0, 1.0, 0.005]\ncell_width = 1e-4",
            "scene.workpiece[0].cell_width: gives 10000 by 10000 cells, may give 4000000: use wider cells or a smaller size",
        ),
        (size, "size = [0.08, 0.12, 0.005]\ncell_width = 0.0", "scene.workpiece[0].cell_width: is 0, must be between"),
        (
            size,
            "size = [0.08, 0.12, 0.005]\nspecific_force = -1.0",
            "scene.workpiece[0].specific_force: is -1, must be between",
        ),
        (
            size,
            "size = [0.08, 0.12, 0.005]\nedge_force = -1.0",
            "scene.workpiece[0].edge_force: is -1, must be between",
        ),
        (size, "size = [0.08, 0.12, 0.005]\nstiffness = 0.0", "scene.workpiece[0].stiffness: is 0, must be between"),
        (
            "[[scene.cutter]]\nrobot = \"irb6\"",
            "[[scene.cutter]]\nrobot = \"arm\"",
            "scene.cutter[0].robot: no robot is called \"arm\", only irb6",
        ),
        (
            "[[scene.cutter]]\nrobot = \"irb6\"\ndiameter = 0.002",
            "[[scene.cutter]]\nrobot = \"irb6\"\ndiameter = 0.0",
            "scene.cutter[0].diameter: is 0, must be between",
        ),
        (
            "[[scene.cutter]]\n",
            "[[scene.cutter]]\nspindle = \"motor\"\n",
            "scene.cutter[0].spindle: no digital output is called \"motor\": add it as [[io.output]]",
        ),
        ("[[scene.cutter]]", second, "scene.cutter[1].robot: robot \"irb6\" is used twice"),
        (workpiece, "", "must have at least one"),
    ];
    for (good, bad, expected) in cases {
        assert!(MILLING.contains(good), "{good:?} is not in the cell");
        let error = Cell::parse(&MILLING.replacen(good, bad, 1)).unwrap_err();
        assert!(error.to_string().contains(expected), "{bad:?}: {error}");
        if !bad.is_empty() {
            let within = line_of(MILLING, good)..=line_of(MILLING, good) + bad.matches('\n').count() + 1;
            assert!(within.contains(&error.line), "{bad:?}: {error}");
        }
    }
    // Without a workpiece but with a plane, there is nothing to cut.
    let plane = "[[scene.plane]]\nheight = 0.5\nstiffness = 1e4\ndamping = 0.0\n\n";
    let error = Cell::parse(&MILLING.replacen(workpiece, plane, 1)).unwrap_err().to_string();
    assert!(error.contains("scene.cutter: has nothing to cut: add the workpiece as [[scene.workpiece]]"), "{error}");
}
