//! Service data transfers per second, beside an implementation by other hands: python-canopen.
//!
//! `cargo bench -p mrroc-tests --bench peers` prints one line per comparison and then one JSON object. The
//! Python packages are those that `tests/run` puts into `target/peers`.

#![expect(clippy::unwrap_used, reason = "in a benchmark it is a verdict")]

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use can::timing::Bitrate;
use can::{Instant, Port, Received, clock};
use canopen::NodeId;
use canopen::objects::DEVICE_TYPE;
use canopen::sdo::Client;
use canopen::sync::Sync;
use hil::{AxisConfig, Epos4, Epos4Config, Irp6Axis, World};

const NODE: NodeId = NodeId::new(1).unwrap();

/// How long each side is measured.
const MEASURED: Duration = Duration::from_secs(2);

/// The client and an emulated drive on the virtual bus, in virtual time: uploads per second of the wall clock.
fn ours_on_the_virtual_bus() -> f64 {
    const STEP: Duration = Duration::from_micros(100);
    let mut world = World::new();
    let bus = world.add_bus(Bitrate::KBPS_1000);
    let mut port = world.host_port(bus, 16);
    let drive = Epos4Config::new(NODE, AxisConfig::irp6(Irp6Axis::ALL[0]));
    world.add_device(bus, Box::new(Epos4::new(drive)));
    let mut now = Instant::ZERO + Duration::from_secs(1);
    world.advance(now);
    let mut received = [nothing(); 16];
    port.receive(now, &mut received).unwrap();

    let mut client = Client::new(NODE, Duration::from_secs(1), 0);
    let mut upload = || {
        client.upload(DEVICE_TYPE, now).unwrap();
        let request = client.poll_transmit(now).unwrap();
        assert_eq!(port.send(now, &[request]), Ok(1));
        loop {
            now += STEP;
            world.advance(now);
            let count = port.receive(now, &mut received).unwrap();
            for received in &received[..count] {
                client.handle(&received.frame, now);
            }
            if let Some(result) = client.poll() {
                return assert_eq!(result.unwrap().number(), Ok(0x0002_0192_u32));
            }
        }
    };
    rate(&mut upload)
}

fn nothing() -> Received {
    Received {
        frame: Sync::default().encode(),
        at: Instant::ZERO,
    }
}

/// How often a second `once` can be done.
fn rate(once: &mut dyn FnMut()) -> f64 {
    const AT_A_TIME: u32 = 100;
    let mut measured = Duration::ZERO;
    let mut count = 0;
    (0..AT_A_TIME).for_each(|_| once());
    let begin = clock::now();
    while measured < MEASURED {
        (0..AT_A_TIME).for_each(|_| once());
        count += AT_A_TIME;
        measured = clock::now().since(begin);
    }
    f64::from(count) / measured.as_secs_f64()
}

/// What python-canopen makes of it, with these arguments of `speed.py`.
fn theirs(arguments: &[&str]) -> f64 {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let output = Command::new(root.join("target/peers/bin/python"))
        .args(["-B", "tests/peers/speed.py", "--seconds"])
        .arg(MEASURED.as_secs().to_string())
        .args(arguments)
        .current_dir(root)
        .output()
        .expect("`tests/run` makes target/peers");
    assert!(output.status.success(), "{output:?}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    found["uploads_per_second"].as_f64().unwrap()
}

fn main() {
    let (ours, theirs) = (ours_on_the_virtual_bus(), theirs(&[]));
    println!("{ours:.0} {theirs:.0} {:.1}", ours / theirs);
}
