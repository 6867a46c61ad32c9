//! Random programs from random start positions, on the robots of the example cells.

use ::mrroc::cell::{Cell, EmulatedPayload, Instruction, JointGenerator, Joints, LineInstruction, Robot};
use controller::generator::Axes;
use controller::robot::Arm;
use controller::robot::Limits;
use kit::mrroc::{shorten, text};

use super::verdict::judge;
use kit::draw::Draw;

/// The example cells with one robot, and their relative frequency.
const CELLS: [(&str, usize); 7] = [
    ("irb6", 4),
    ("irp6", 4),
    ("irp6-track", 2),
    ("rnt", 2),
    ("polycrank", 2),
    ("irb6-serial", 2),
    ("irb6-hi-moxa", 1),
];

/// A cell with random programs for its robot, or for the first two robots of the laboratory.
pub(super) fn cell(draw: &mut Draw) -> String {
    let total = CELLS.iter().map(|(_, weight)| weight).sum();
    let mut number = draw.below(total);
    let drawn = CELLS.iter().find(|(_, weight)| {
        let found = number < *weight;
        number = number.saturating_sub(*weight);
        found
    });
    let (name, _) = drawn.expect("the number is below the sum of the weights");
    let mut cell = Cell::parse(&text(name)).expect("the example cells are sound");
    shorten(&mut cell);
    cell.seed = draw.number() >> 32;
    cell.macrostep = 1 + draw.below(20) as u16;
    for robot in &mut cell.robot {
        let arm = robot.arm().expect("the example cells are sound");
        for axis in &mut robot.axis {
            let start = axis.emulator.start.expect("a shortened cell has starts");
            axis.emulator.start = Some(start + draw.within(-10.0, 15.0));
            axis.homing.zero_velocity = draw.within(0.5, 6.0);
            axis.max_acceleration *= draw.within(0.5, 1.5);
            if axis.drive.as_ref().is_some_and(|drive| drive.r#loop.is_none()) {
                axis.max_velocity *= draw.within(0.5, 1.0);
            }
        }
        robot.program = program(draw, &arm);
        if robot.axis.len() > 1 && draw.one_in(3) {
            robot.emulated_payload = payloads(draw);
        }
    }
    toml::to_string(&cell).expect("a cell is TOML")
}

/// Payloads that the nominal motors can hold.
fn payloads(draw: &mut Draw) -> Vec<EmulatedPayload> {
    let mut payload = |_| EmulatedPayload {
        at_s: draw.within(0.0, 15.0),
        mass: draw.within(0.0, 4.0),
        centre: [0.0; 3].map(|_| draw.within(-0.1, 0.1)),
    };
    (0..2).map(&mut payload).collect()
}

fn program(draw: &mut Draw, arm: &Arm) -> Vec<Instruction> {
    let home = arm.joints(&arm.robot().home().padded());
    let mut here = home.expect("home is a posture of the arm");
    let count = 1 + draw.below(4);
    let mut instruction = |_| {
        if draw.one_in(3) { line(draw, arm, &mut here) } else { joints(draw, arm, &mut here) }
    };
    (0..count).map(&mut instruction).collect()
}

/// A motion through postures near `here`, some of them at a limit of a joint. `here` becomes the last posture.
fn joints(draw: &mut Draw, arm: &Arm, here: &mut Axes) -> Instruction {
    let count = 1 + draw.below(3);
    let poses = (0..count).map(|_| {
        *here = near(draw, arm, here, 16);
        here[..arm.axes()].to_vec()
    });
    let poses = poses.collect();
    let jerk_limited = draw.one_in(2);
    Instruction::Joints(Joints {
        poses,
        generator: if jerk_limited { JointGenerator::JerkLimited } else { JointGenerator::Newsmooth },
        velocity: draw.within(0.3, 1.0),
        acceleration: draw.within(0.1, 1.0),
        duration: (jerk_limited && draw.one_in(3)).then(|| draw.within(0.05, 6.0)),
    })
}

/// A posture near `here`. One joint or motor in `limit` is at a limit of its range.
fn near(draw: &mut Draw, arm: &Arm, here: &Axes, limit: usize) -> Axes {
    let mut there = *here;
    for joint in 0..arm.axes() {
        let mut moved = there;
        let Limits { low, high } = arm.robot().joint_limits()[joint];
        let span = f64::min(0.3, 0.1 * (high - low));
        match draw.below(limit) {
            0 if high - low < 10.0 => moved[joint] = if draw.one_in(2) { low } else { high },
            1 if high - low < 10.0 => {
                let Limits { low, high } = arm.robot().motor_limits()[joint];
                let mut motors = arm.motors(&there).expect("a posture within the limits");
                motors[joint] = if draw.one_in(2) { low } else { high };
                moved = arm.joints(&motors).unwrap_or(moved);
            }
            2 => {}
            _ => moved[joint] = (moved[joint] + draw.within(-span, span)).clamp(low, high),
        }
        if arm.motors(&moved).is_ok() {
            there = moved;
        }
    }
    there
}

/// A line to the position of a posture near `here`.
fn line(draw: &mut Draw, arm: &Arm, here: &mut Axes) -> Instruction {
    let mut there = near(draw, arm, here, usize::MAX);
    if arm.axes() == 5 && !draw.one_in(4) {
        // A target in the plane of the arm with the same pitch is within the capability of five axes.
        (there[0], there[3]) = (here[0], here[3]);
    }
    let pose = arm.forward(&there).expect("a posture has a pose");
    let turned = draw.one_in(2);
    let kept = |pose: &controller::generator::Pose| {
        let q = pose.rotation.quaternion();
        [q.w, q.i, q.j, q.k]
    };
    *here = there;
    Instruction::Line(LineInstruction {
        position: pose.translation.vector.into(),
        quaternion: turned.then(|| kept(&pose)),
        velocity: draw.within(0.05, 0.5),
        acceleration: draw.within(0.2, 2.0),
        constant_speed: false,
    })
}

/// Removes the instructions and payloads of a cell that are not necessary for the disagreement.
pub(super) fn shrunk(mut cell: String) -> String {
    let fewer: [fn(&mut Robot, usize) -> bool; 2] = [
        |robot, index| index < robot.program.len() && drop_at(&mut robot.program, index),
        |robot, index| index < robot.emulated_payload.len() && drop_at(&mut robot.emulated_payload, index),
    ];
    for drop in fewer {
        let mut index = 0;
        while let Ok(mut parsed) = Cell::parse(&cell)
            && drop(&mut parsed.robot[0], index)
        {
            let shorter = toml::to_string(&parsed).expect("a cell is TOML");
            if judge(&shorter).is_err() {
                cell = shorter;
            } else {
                index += 1;
            }
        }
    }
    cell
}

fn drop_at<T>(list: &mut Vec<T>, index: usize) -> bool {
    list.remove(index);
    true
}
