//! Tests of the keys of conveyors, objects and light gates.

use super::*;

const CONVEYOR: &str = include_str!("../../../../cells/irb6-conveyor.toml");

#[test]
fn a_conveyor_object_or_gate_that_cannot_be_is_refused_with_line_key_and_reason() {
    let cases = [
        (
            "input = \"exit\"\nfrom",
            "input = \"door\"\nfrom",
            "scene.gate[1].input: no input is called \"door\": name one of",
        ),
        (
            "input = \"exit\"\nfrom",
            "input = \"entry\"\nfrom",
            "scene.gate[1].input: the input \"entry\" has a gate already, scene.gate[0]",
        ),
        (
            "line = 0\n",
            "line = 0\nemulated_edges_s = [1.0]\n",
            "scene.gate[0].input: the input \"entry\" has emulated_edges_s",
        ),
        (
            "to = [0.3, 1.4, 0.53]",
            "to = [0.3, 1.0, 0.53]",
            "scene.gate[0].to: is the same point as `from`: a beam has a length",
        ),
        ("to = [0.3, 1.4, 0.53]", "to = [0.3, nan, 0.53]", "scene.gate[0].to[1]: must be a finite number"),
        (
            "to = [0.3, 1.4, 0.53]",
            "to = [0.3, 1.4, 0.53]\nresponse_us = 100",
            "scene.gate[0].response_us: is 100, must be between",
        ),
        ("speed = 0.12", "speed = inf", "scene.conveyor[0].speed: must be a finite number"),
        ("speed = 0.12", "speed = nan", "scene.conveyor[0].speed: must be a finite number"),
        ("speed = 0.12", "speed = 0.12\ndrift = -0.1", "scene.conveyor[0].drift: is -0.1, must be between"),
        (
            "direction = [1.0, 0.0, 0.0]",
            "direction = [1.0, 0.0, 0.1]",
            "scene.conveyor[0].direction: is not horizontal",
        ),
        ("direction = [1.0, 0.0, 0.0]", "direction = [0.0, 0.0, 0.0]", "scene.conveyor[0].direction: has no direction"),
        ("size = [1.2, 0.3]", "size = [1.2, 0.0]", "scene.conveyor[0].size[1]: is 0, must be between"),
        ("mass = 0.5", "mass = 0.0", "scene.object[0].mass: is 0, must be between"),
        (
            "along = -0.5",
            "along = -0.56",
            "scene.object[0].along: the object reaches 0.600 m from the centre, and the surface ends",
        ),
        ("mass = 0.5", "mass = 0.5\nconveyor = 1", "scene.object[0].conveyor: is 1, and the scene has 1 conveyors"),
        ("emulated_load = 0.24", "emulated_load = 0.95", "bus[0].emulated_load: is 0.95, must be between"),
    ];
    for (from, to, problem) in cases {
        assert!(CONVEYOR.contains(from), "{from}");
        let text = CONVEYOR.replacen(from, to, 1);
        let error = Cell::parse(&text).unwrap_err();
        let shown = error.to_string();
        let (line, rest) = shown.split_once(": ").unwrap();
        assert!(rest.starts_with(problem), "{to}: {shown}");
        let first = text.lines().zip(CONVEYOR.lines()).position(|(one, other)| one != other).unwrap();
        let shown: usize = line.parse().unwrap();
        let changed = first + 1..first + 2 + to.matches('\n').count();
        assert!(changed.contains(&shown) || problem.contains("emulated_edges_s"), "line {shown}: {to}");
    }
}

#[test]
fn the_frame_of_a_conveyor_has_its_travel_along_x_and_upward_along_z() {
    let cell = Cell::parse(CONVEYOR).unwrap();
    let mut conveyor = cell.scene.unwrap().conveyor[0];
    conveyor.direction = [0.0, 3.0, 0.0];
    let frame = conveyor.frame();
    for (local, world) in
        [([0.0; 3], [0.5, 1.2, 0.5]), ([1.0, 0.0, 0.0], [0.5, 2.2, 0.5]), ([0.0, 1.0, 0.0], [-0.5, 1.2, 0.5])]
    {
        let found = frame * nalgebra::Point3::from(local);
        assert!((found.coords - nalgebra::Vector3::from(world)).norm() < 1e-12, "{found}");
    }
}
