//! Chains from descriptions in URDF and from tables of joints.

use controller::robot::{Chain, Joints, Robot as _};

use super::*;

/// An arm of two joints with a fixed tool, a gripper beside it, and a base that is fixed to the world.
const ARM: &str = r#"<?xml version="1.0"?>
<robot name="arm">
  <link name="world"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 0.5"/></joint>
  <link name="base"><inertial><mass value="40"/></inertial></link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.25" rpy="0 0 1.5707963267948966"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" velocity="3" effort="0"/>
  </joint>
  <link name="upper">
    <inertial><origin xyz="0 0 0.2"/><mass value="4"/><inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/></joint>
  <link name="lower"/>
  <joint name="mount" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0 0 0.3"/></joint>
  <link name="hand"><inertial><origin xyz="0 0 0.1"/><mass value="2"/></inertial></link>
  <joint name="tool" type="fixed"><parent link="hand"/><child link="tool0"/><origin xyz="0.1 0 0"/></joint>
  <link name="tool0"/>
  <joint name="finger" type="prismatic">
    <parent link="hand"/><child link="finger"/><limit lower="0" upper="0.1"/><mimic joint="elbow"/>
  </joint>
  <link name="finger"/>
</robot>"#;

fn joint(name: &str) -> JointSettings {
    let text = format!("name = {name:?}\nratio = 100.0");
    toml::from_str(&text).unwrap()
}

fn settings(text: &str) -> ChainSettings {
    toml::from_str(text).unwrap()
}

fn resolved(settings: &ChainSettings, urdf: &str) -> Result<ChainParameters, String> {
    let path = Path::to("chain");
    let numbers = settings.resolve(&path, &mut |_| Ok(urdf.to_owned()));
    numbers.map_err(|(path, problem)| format!("{path}: {problem}"))
}

fn of_arm() -> ChainSettings {
    ChainSettings {
        urdf: Some("arm.urdf".into()),
        flange: Some("tool0".into()),
        joint: vec![joint("shoulder"), joint("elbow")],
        ..ChainSettings::default()
    }
}

#[test]
fn a_description_gives_its_joints_and_folds_what_is_fixed() {
    let chain = resolved(&of_arm(), ARM).unwrap();
    let [shoulder, elbow] = &chain.joints[..] else { panic!("two joints: {chain:?}") };
    assert_eq!((&*shoulder.name, shoulder.velocity, shoulder.effort), ("shoulder", Some(3.0), None));
    assert_eq!(shoulder.limits, Limits { low: -1.0, high: 2.0 });
    assert!((shoulder.parent_from_joint.translation.vector - Vector3::new(0.0, 0.0, 0.75)).norm() < 1e-12);
    assert_eq!((elbow.axis, elbow.kind), ([1.0, 0.0, 0.0], LinkKind::Continuous), "URDF's axis where absent is x");
    let hand = elbow.body.unwrap();
    assert_eq!((hand.mass, hand.centre), (2.0, [0.0, 0.0, 0.4]), "the hand is fixed to the elbow");
    assert!((chain.link_from_flange.translation.vector - Vector3::new(0.1, 0.0, 0.3)).norm() < 1e-12);
    let arm = Chain::new(&chain).unwrap();
    let pose = arm.forward(&Joints::new(&[0.0, 0.0]).unwrap()).unwrap();
    let expected = Vector3::new(0.0, 0.1, 0.5 + 0.25 + 0.4 + 0.3);
    assert!((pose.translation.vector - expected).norm() < 1e-12, "{pose}");
}

#[test]
fn joints_beside_the_way_are_left_out_and_listed() {
    let described = read_urdf(ARM, None, Some("tool0")).unwrap();
    assert_eq!(described.left_out, ["finger"]);
    assert_eq!((&*described.base, &*described.flange), ("world", "tool0"));
}

#[test]
fn both_bodies_have_the_inertia_of_their_union() {
    let at = |z| Body { mass: 1.0, centre: Vector3::new(0.0, 0.0, z), inertia: nalgebra::Matrix3::zeros() };
    let both = at(0.0).and(&at(2.0));
    assert_eq!((both.mass, both.centre.z), (2.0, 1.0));
    assert_eq!(both.components(), [2.0, 2.0, 0.0, 0.0, 0.0, 0.0], "two points at a distance of 1 m from the centre");
}

#[test]
fn what_is_wrong_with_a_description_is_said_with_its_line() {
    for (good, bad, said) in [
        ("type=\"continuous\"", "type=\"floating\"", "joint \"elbow\" is floating"),
        ("xyz=\"0 0 0.4\"", "xyz=\"0 0 nan\"", "14: xyz=\"nan\" is no number between -1e9 and 1e9"),
        ("xyz=\"0 0 0.4\"", "xyz=\"0 0.4\"", "14: xyz has 2 numbers, must have three"),
        ("<child link=\"lower\"/>", "<child link=\"lowest\"/>", "names link \"lowest\""),
        ("<child link=\"lower\"/>", "<child link=\"upper\"/>", "is the child of the joints \"shoulder\" and \"elbow\""),
        ("<child link=\"lower\"/>", "", "joint \"elbow\" has no <child>"),
        ("name=\"elbow\" type", "type", "has no attribute name"),
        ("<link name=\"lower\"/>", "<link name=\"upper\"/>", "link \"upper\" is described twice"),
        ("<limit lower=\"-1\" upper=\"2\" velocity=\"3\" effort=\"0\"/>", "", "gives joint \"shoulder\" no limits"),
        (
            "<robot name=\"arm\">",
            "<robot name=\"arm\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><xacro:a/>",
            "xacro FILE",
        ),
        ("<mass value=\"4\"/>", "<mass value=\"-4\"/>", "a mass of -4 kg is below zero"),
        ("</robot>", "", "is no XML"),
        ("\"0 0 0.25\" rpy", "\"0 0 0.25\" rpy=\"1\" rpy", "is no XML"),
    ] {
        assert!(ARM.contains(good), "{good}");
        let found = resolved(&of_arm(), &ARM.replacen(good, bad, 1));
        let found = found.expect_err(bad);
        assert!(found.contains(said), "{bad}: {found}");
    }
    let found = ChainSettings { flange: Some("nosuch".into()), ..of_arm() };
    assert!(
        resolved(&found, ARM).unwrap_err().contains("has no link \"nosuch\" for the flange; there are world, base")
    );
    let found = ChainSettings { flange: None, ..of_arm() };
    assert!(resolved(&found, ARM).unwrap_err().contains("several links could be the flange (tool0, finger)"));
    let found = ChainSettings { flange: Some("finger".into()), ..of_arm() };
    assert!(resolved(&found, ARM).unwrap_err().contains("follows another joint (mimic)"));
    let found = ChainSettings { base: Some("tool0".into()), flange: Some("upper".into()), ..of_arm() };
    assert!(resolved(&found, ARM).unwrap_err().contains("has no way from \"tool0\" to \"upper\""));
}

#[test]
fn keys_without_effect_and_missing_keys_are_refused() {
    let joints = "[[joint]]\nname = \"a\"\nkind = \"revolute\"\nlimits = { low = -1.0, high = 1.0 }\n";
    for (text, said) in [
        ("base = \"x\"".to_owned(), "chain.base: has no effect without urdf"),
        (String::new(), "chain.joint: has no joints"),
        (joints.to_owned(), "chain.joint[0].ratio: is missing"),
        (format!("{joints}ratio = 1.0\nlead = 1.0"), "chain.joint[0].lead: is given beside ratio"),
        (format!("{joints}lead = 0.01"), "chain.joint[0].lead: is of a linear joint"),
        (
            format!("{joints}ratio = 1.0\ndh = {{ a = 1.0 }}\naxis = [0.0, 0.0, 1.0]"),
            "chain.joint[0].axis: has no effect beside dh",
        ),
        (
            format!("motors_from_joints = [[1.0]]\n{joints}ratio = 1.0"),
            "chain.joint[0].ratio: has no effect beside motors",
        ),
        (joints.replace("kind = \"revolute\"\n", "ratio = 1.0\n"), "chain.joint[0].kind: is missing"),
        (joints.replace("limits = { low = -1.0, high = 1.0 }", "ratio = 1.0"), "chain.joint[0].limits: is missing"),
    ] {
        let found = resolved(&settings(&text), ARM).expect_err(&text);
        assert!(found.starts_with(said), "{text}: {found}");
    }
    let found = ChainSettings { joint: vec![joint("shoulder")], ..of_arm() };
    assert!(resolved(&found, ARM).unwrap_err().contains("chain.joint: has no joint \"elbow\", whose ratio is unknown"));
    let found = ChainSettings { joint: vec![joint("wrist")], ..of_arm() };
    assert!(resolved(&found, ARM).unwrap_err().contains("must be a joint of arm.urdf: shoulder, elbow"));
}

/// The Puma 560 in both conventions of Denavit and Hartenberg (Corke and Armstrong-Hélouvry 1994).
#[test]
fn both_conventions_describe_one_arm() {
    let quarter = std::f64::consts::FRAC_PI_2;
    let standard = [
        (0.0, quarter, 0.0),
        (0.4318, 0.0, 0.0),
        (0.0203, -quarter, 0.15005),
        (0.0, quarter, 0.4318),
        (0.0, -quarter, 0.0),
        (0.0, 0.0, 0.0),
    ];
    let chain = |convention: &str, rows: &[(f64, f64, f64)]| {
        let rows = rows.iter().enumerate().map(|(number, (a, alpha, d))| {
            format!(
                "[[joint]]\nname = \"q{number}\"\nkind = \"continuous\"\nratio = 50.0\ndh = {{ a = {a:?}, alpha = {alpha:?}, d = {d:?} }}\n"
            )
        });
        let text = format!("convention = {convention:?}\n{}", rows.collect::<String>());
        Chain::new(&resolved(&settings(&text), "").unwrap()).unwrap()
    };
    // The modified convention has a and α of the joint before.
    let before = [(0.0, 0.0)].into_iter().chain(standard.iter().map(|(a, alpha, _)| (*a, *alpha)));
    let modified: Vec<_> = before.zip(&standard).map(|((a, alpha), (.., d))| (a, alpha, *d)).collect();
    let (standard, modified) = (chain("standard", &standard), chain("modified", &modified));
    let joints = Joints::new(&[0.3, -0.7, 0.9, -0.2, 0.6, 1.1]).unwrap();
    let [standard, modified] = [standard, modified].map(|arm| arm.forward(&joints).unwrap());
    assert!((standard.translation.vector - modified.translation.vector).norm() < 1e-12, "{standard} {modified}");
    assert!(standard.rotation.angle_to(&modified.rotation) < 1e-7);
}
