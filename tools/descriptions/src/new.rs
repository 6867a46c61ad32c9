//! `mrroc new`: a cell file for a robot that is described in URDF.
//!
//! What the description knows is taken from it. Everything else is invented so that the emulated arm can move, and the file
//! says of each such number that it is nominal.

mod questions;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::Args;
use controller::robot::LinkKind;
use mrroc::cell::{DescribedJoint, DescribedRobot, read_urdf};
use mrroc::report::counted;

use questions::{Order, Package};

/// Velocity of a nominal motor at the greatest velocity of its joint, rad/s.
const MOTOR: f64 = 300.0;

/// Nominal velocity of a joint where the description has none, rad/s and m/s.
const VELOCITY: (f64, f64) = (1.0, 0.25);

/// Nominal time from rest to the greatest velocity, s.
const RISE: f64 = 0.5;

/// Nominal range to either side of zero of a joint that must have limits and has none in its description, rad and m.
const RANGE: (f64, f64) = (3.0, 0.5);

/// Axes on one bus: the budget of a bus of 1 Mbit/s at a period of 2 ms.
const AXES_OF_A_BUS: usize = 6;

/// Which cell file to write, and from which description.
#[derive(Args)]
pub struct Options {
    /// The cell file to write. A file that exists is kept. On a terminal, the command asks for what is absent.
    cell: Option<PathBuf>,
    /// The robot description in URDF. `xacro FILE.xacro > FILE.urdf` writes out a xacro file.
    #[arg(long)]
    urdf: Option<PathBuf>,
    /// Folder of a package, for a description `package://NAME/FILE`. May be given several times.
    #[arg(long, value_name = "NAME=DIR")]
    package: Vec<Package>,
    /// The base link; the root of the description where absent.
    #[arg(long)]
    base: Option<String>,
    /// The flange link; the only end of the description where absent.
    #[arg(long)]
    flange: Option<String>,
}

/// Writes the cell file, and says what to do next.
pub fn new(options: &Options) -> anyhow::Result<String> {
    let Order { cell: path, urdf, base, flange } = Order::of(options)?;
    let shown = urdf.display();
    let bytes = fs::read(&urdf).with_context(|| shown.to_string())?;
    let description = String::from_utf8(bytes).with_context(|| format!("{shown}: is no UTF-8 text"))?;
    let described = read_urdf(&description, base.as_deref(), flange.as_deref());
    let described = described.map_err(|problem| anyhow::anyhow!("{shown}:{problem}"))?;
    let count = described.joints.len();
    ensure!(
        count <= 8,
        "{shown}: has {count} moving joints between base and flange, at most 8 are possible: choose by --base and --flange"
    );
    let text = cell(&path, &urdf, &described)?;
    let name = path.display();
    let mut file = File::create_new(&path).with_context(|| name.to_string())?;
    file.write_all(text.as_bytes()).with_context(|| name.to_string())?;
    let mut said =
        format!("{name}: {} from {:?} to {:?} of {shown}\n", counted(count, "joint"), described.base, described.flange);
    if !described.left_out.is_empty() {
        let _ = writeln!(said, "left out, since they are beside this way: {}", described.left_out.join(", "));
    }
    let _ = writeln!(said, "next: mrroc check {name}, then mrroc run {name} --bench lockstep");
    Ok(said)
}

/// The path of the description as seen from the folder of the cell file.
fn relative(cell: &Path, urdf: &Path) -> anyhow::Result<String> {
    let folder = cell.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = folder.canonicalize().with_context(|| folder.display().to_string())?;
    let urdf = urdf.canonicalize().with_context(|| urdf.display().to_string())?;
    let common = folder.components().zip(urdf.components()).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n(Path::new(".."), folder.components().count() - common);
    let path: PathBuf = up.chain(urdf.components().skip(common).map(|part| Path::new(part.as_os_str()))).collect();
    let text = path.to_str().with_context(|| format!("{}: is no UTF-8 name", path.display()))?;
    Ok(text.to_owned())
}

/// What a joint of the cell file gets, and what of it is invented.
struct Numbers {
    axis: String,
    limits: Option<(f64, f64)>,
    invented_limits: bool,
    velocity: f64,
    invented_velocity: bool,
    effort: f64,
    invented_effort: bool,
    /// Motor angle per joint position, rad/rad or rad/m.
    ratio: f64,
    home: f64,
}

impl Numbers {
    /// `behind`: mass that the joint moves, kg, and its greatest distance from the joint, m.
    fn of(joint: &DescribedJoint, axis: String, (mass, reach): (f64, f64)) -> Self {
        let is_linear = joint.kind == LinkKind::Prismatic;
        let of = |(turning, sliding): (f64, f64)| if is_linear { sliding } else { turning };
        let given = joint.limits.filter(|(low, high)| low < high);
        let limits = (joint.kind != LinkKind::Continuous).then(|| given.unwrap_or((-of(RANGE), of(RANGE))));
        let velocity = joint.velocity.unwrap_or(of(VELOCITY));
        // Of the weight in the worst pose, and of the acceleration of the mass at its greatest distance.
        let load = match is_linear {
            true => mass * (9.81 + velocity / RISE),
            false => mass * reach * (9.81 + reach * velocity / RISE),
        };
        let home = match limits {
            Some((low, high)) if low >= 0.0 || high <= 0.0 => rounded(0.5 * (low + high)),
            _ => 0.0,
        };
        Self {
            axis,
            limits,
            invented_limits: limits.is_some() && given.is_none(),
            velocity,
            invented_velocity: joint.velocity.is_none(),
            effort: joint.effort.unwrap_or(rounded(2.0 * load).max(10.0)),
            invented_effort: joint.effort.is_none(),
            ratio: rounded(MOTOR / velocity),
            home,
        }
    }
}

/// A number with two significant digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

/// A number of TOML with at most six digits behind the point.
fn toml(value: f64) -> String {
    format!("{:?}", (value * 1e6).round() / 1e6)
}

fn nominal(is_invented: bool) -> &'static str {
    if is_invented { " # nominal: not in the description" } else { "" }
}

/// Names for the axes: those of the joints, in the letters that a cell file permits.
fn names(joints: &[DescribedJoint]) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let name = |(number, joint): (usize, &DescribedJoint)| {
        let permitted = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' };
        let name: String = joint.name.chars().map(permitted).take(60).collect();
        let name = name.trim_start_matches(['-', '_']).to_owned();
        let name = if name.is_empty() || taken.contains(&name) { format!("q{}", number + 1) } else { name };
        taken.insert(name.clone());
        name
    };
    joints.iter().enumerate().map(name).collect()
}

/// Mass moved by each joint, kg, and its greatest distance from the joint, m.
fn behind(described: &DescribedRobot) -> Vec<(f64, f64)> {
    let mut sums = Vec::new();
    let (mut mass, mut reach) = (0.0, described.link_from_flange.translation.vector.norm());
    for joint in described.joints.iter().rev() {
        mass += joint.body.map_or(0.0, |body| body.mass);
        reach = f64::max(reach, joint.body.map_or(0.0, |body| body.centre.norm()));
        sums.push((mass, reach));
        reach += joint.parent_from_joint.translation.vector.norm();
    }
    sums.reverse();
    sums
}

/// The text of the cell file.
fn cell(path: &Path, urdf: &Path, described: &DescribedRobot) -> anyhow::Result<String> {
    let names = names(&described.joints);
    let joints = described.joints.iter().zip(names).zip(behind(described));
    let numbers: Vec<_> = joints.map(|((joint, name), behind)| Numbers::of(joint, name, behind)).collect();
    let count = numbers.len();
    let buses = count.div_ceil(AXES_OF_A_BUS);
    let of_a_bus = count.div_ceil(buses);
    let stem: String = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("arm").chars().take(60).collect();
    let is_name = stem.starts_with(|c: char| c.is_ascii_alphanumeric())
        && stem.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'));
    let name = if is_name { &stem } else { "arm" };

    let mut text = format!(
        "# A robot from a description in URDF, with CiA 402 drives on CAN.\n\
         # Geometry, limits, masses and efforts are those of the description. Every other number is nominal: it lets the\n\
         # emulated arm move, and is to be replaced by that of the machine before metal moves. The nominal numbers are the\n\
         # ratios, the drives with their torques and counts, accelerations, following errors, homing, the buses, and what a\n\
         # comment beside it calls nominal.\n\n\
         name = {name:?}\nperiod_us = 2000\nmacrostep = 10\n\n\
         [realtime]\npolicy = \"best-effort\"\npriority = 80\n\n"
    );
    for bus in 0..buses {
        let _ = write!(text, "[[bus]]\nname = \"can{bus}\"\nbitrate_kbps = 1000\ninterface = \"can{bus}\"\n\n");
    }
    let _ = write!(
        text,
        "[[robot]]\nname = \"arm\"\n\n[robot.chain]\nurdf = {:?}\nbase = {:?}\nflange = {:?}\n\n",
        relative(path, urdf)?,
        described.base,
        described.flange
    );
    for (it, joint) in numbers.iter().zip(&described.joints) {
        let unit = if joint.kind == LinkKind::Prismatic { "m" } else { "rad" };
        let _ = writeln!(text, "[[robot.chain.joint]]\nname = {:?}", joint.name);
        let _ = writeln!(text, "ratio = {} # nominal: rad of the motor per {unit}", toml(it.ratio));
        if let Some((low, high)) = it.limits.filter(|_| it.invented_limits) {
            let _ = writeln!(text, "limits = {{ low = {}, high = {} }}{}", toml(low), toml(high), nominal(true));
        }
        for (key, value, invented) in
            [("velocity", it.velocity, it.invented_velocity), ("effort", it.effort, it.invented_effort)]
        {
            if invented {
                let _ = writeln!(text, "{key} = {}{}", toml(value), nominal(true));
            }
        }
        if it.home != 0.0 {
            let _ =
                writeln!(text, "joint_at_home = {} # nominal: where homing leaves the joint, {unit}", toml(it.home));
        }
        text.push('\n');
    }
    for (number, it) in numbers.iter().enumerate() {
        let (bus, node) = (number / of_a_bus, number % of_a_bus + 1);
        let torque = it.effort / it.ratio;
        let velocity = it.velocity * it.ratio;
        let _ = write!(
            text,
            "[[robot.axis]]\nname = {:?}\nbus = \"can{bus}\"\nnode = {node}\n\
             drive = {{ vendor = 0xFB, counts_per_revolution = 4000, rated_torque = {}, max_torque = {} }}\n\
             max_velocity = {}\nmax_acceleration = {}\nfollowing_error = 2.0\n\
             # The axis counts from where it stands when its power comes on.\n\
             homing = {{ method = 37, search_velocity = 15.0, zero_velocity = 3.5, acceleration = 150.0 }}\n\
             emulator = {{ start = 0.0 }}\n\n",
            it.axis,
            toml(0.5 * torque),
            toml(torque),
            toml(velocity),
            toml(velocity / RISE)
        );
    }
    let poses = [0.1, -0.1, 0.0].map(|share| {
        let pose: Vec<_> = numbers.iter().map(|it| toml(beside_home(it, share))).collect();
        format!("[{}]", pose.join(", "))
    });
    let _ = write!(
        text,
        "# A first program: each joint a little to either side, and back.\n[[robot.program]]\n\
         joints = {{ poses = [{}], velocity = 0.3, acceleration = 0.3 }}\n",
        poses.join(", ")
    );
    Ok(text)
}

/// A position beside home, by a share of the room on that side.
fn beside_home(it: &Numbers, share: f64) -> f64 {
    let (low, high) = it.limits.unwrap_or((-3.0, 3.0));
    let room = if share < 0.0 { it.home - low } else { high - it.home };
    it.home + share * room
}
