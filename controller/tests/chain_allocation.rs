//! No call of a chain allocates, whatever the chain and the pose.

use mrroc_controller::robot::{Chain, ChainParameters, Joints, Robot};

use crate::counting;
use crate::random::Random;

/// Joints as (position of the frame, rotation about its x axis in quarters of a turn, kind).
type Row = ([f64; 3], i8, &'static str);

/// A chain of these joints, whose axes are the z axes.
fn chain(rows: &[Row]) -> Chain {
    let joint = |(number, (position, quarters, kind)): (usize, &Row)| {
        let (sin, cos) = (f64::from(*quarters) * std::f64::consts::FRAC_PI_4).sin_cos();
        let limits = if *kind == "continuous" { "" } else { "limits = { low = -2.5, high = 2.5 }" };
        format!(
            "[[joints]]\nname = 'j{number}'\nkind = '{kind}'\naxis = [0, 0, 1]\nratio = 100\n{limits}\n\
             parent_from_joint = {{ position = {position:?}, quaternion = [{cos:?}, {sin:?}, 0, 0] }}\n"
        )
    };
    let joints: Vec<String> = rows.iter().enumerate().map(joint).collect();
    let text = format!("link_from_flange = {{ position = [0.05, 0.02, 0.1] }}\n{}", joints.concat());
    let parameters: ChainParameters = toml::from_str(&text).expect("the rows are a description");
    Chain::new(&parameters).expect("the rows are an arm")
}

#[test]
fn no_call_of_a_chain_allocates() {
    let turn = |position, quarters| (position, quarters, "revolute");
    let redundant = [
        turn([0.0, 0.0, 0.3], 0),
        turn([0.0; 3], -1),
        turn([0.0, -0.3, 0.0], 1),
        turn([0.08, 0.0, 0.0], 1),
        turn([-0.08, 0.38, 0.0], -1),
        ([0.0; 3], 1, "continuous"),
        turn([0.09, 0.0, 0.0], 1),
    ];
    let parallel = [
        turn([0.0, 0.0, 0.1], 0),
        turn([0.0, 0.1, 0.0], 1),
        turn([0.42, 0.0, 0.0], 0),
        turn([0.39, 0.0, 0.0], 0),
        turn([0.0, 0.0, 0.1], 1),
        turn([0.0, 0.0, 0.1], -1),
    ];
    let wrist = [
        turn([0.0, 0.0, 0.4], 0),
        turn([0.1, 0.0, 0.0], -1),
        turn([0.4, 0.0, 0.0], 0),
        turn([0.0, 0.3, 0.0], -1),
        turn([0.0; 3], 1),
        turn([0.0; 3], -1),
    ];
    let sliding = [([0.0; 3], 0, "prismatic"), ([0.0; 3], 1, "prismatic"), turn([0.1, 0.2, 0.3], 1)];
    for rows in [&redundant[..], &parallel, &parallel[..5], &wrist, &sliding] {
        let chain = chain(rows);
        let mut random = Random(1);
        let mut any = || {
            Joints::new(&vec![0.0; rows.len()]).map(|mut joints| {
                joints.iter_mut().for_each(|joint| *joint = random.within(-2.5, 2.5));
                joints
            })
        };
        for _ in 0..20 {
            let (joints, near) = (any().expect("few axes"), any().expect("few axes"));
            let pose = chain.forward(&joints).unwrap();
            let mut bent = pose;
            bent.translation.vector *= 0.9;
            let mut far = pose;
            far.translation.vector *= 90.0;
            let before = counting::allocations();
            chain.inverse(&pose, &near).unwrap();
            let _ = chain.inverse(&bent, &near);
            chain.inverse(&far, &near).unwrap_err();
            chain.jacobian(&joints).unwrap();
            chain.singularity(&joints).unwrap();
            let motors = chain.motors_from_joints(&joints).unwrap();
            chain.joints_from_motors(&motors).unwrap();
            assert_eq!(counting::allocations(), before, "{rows:?}");
        }
    }
}
