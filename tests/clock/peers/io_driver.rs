//! This project's driver of digital inputs and outputs on a CiA 401 node of python-canopen, behind an slcan adapter.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{ChildStdout, Stdio};
use std::task::Poll;
use std::time::Duration;

use can::{Frame, Instant, VirtualPeer, VirtualPort, clock, virtual_port};
use canopen::NodeId;
use drive::DriveGroup;
use drive::bus::CanBus;
use drive::cia401::{InputImage, IoConfig, IoFault, IoLink};
use drive::cia402::{GroupConfig, Identity};
use hil::Device;
use kit::adapter::Adapter;
use kit::processors;

use super::{Bus, Script, python};

const NODE: NodeId = NodeId::new(1).unwrap();

/// Period of the cycles. The node in Python needs some milliseconds for an answer.
const PERIOD: Duration = Duration::from_millis(10);

/// Longest wait for a reaction of the node.
const PATIENCE: Duration = Duration::from_secs(20);

/// The host's end of the bus, behind the adapter.
struct HostEnd {
    peer: VirtualPeer,
    /// End of the present cycle.
    until: Option<Instant>,
}

impl Device for HostEnd {
    fn handle(&mut self, frame: &Frame, now: Instant) {
        assert!(self.peer.deliver(can::Received { frame: *frame, at: now }, 0), "the host reads its port");
    }

    fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        self.peer.take_sent().map(|sent| sent.frame)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.until
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.until = self.until.filter(|until| *until > now);
    }
}

/// The driver, and the node in Python.
struct Rig {
    bus: Option<CanBus<VirtualPort>>,
    link: IoLink,
    script: Script,
    output: BufReader<ChildStdout>,
    /// The tty outlives the script.
    adapter: Adapter,
}

fn config() -> (GroupConfig, IoConfig) {
    let group = GroupConfig {
        period: PERIOD,
        tolerated_missing: 10,
        heartbeat_period: Duration::from_millis(500),
        host_node: NodeId::new(127).unwrap(),
        sdo_timeout: Duration::from_secs(5),
        sdo_retries: 2,
        boot_timeout: Duration::from_secs(10),
        transition_timeout: Duration::from_secs(1),
    };
    let io = IoConfig {
        node: NODE,
        identity: Identity { vendor: 0, product: Some(0x401), revision: None },
        inputs: 16,
        outputs: 10,
        inhibit_time: Duration::from_millis(1),
        event_timer: Duration::from_millis(500),
        inverted_inputs: 0,
        emergency_inputs: 0,
        filtered_inputs: 0,
        // Output 9 is inverted. Outputs 0 and 9 take an error value, the others keep their level.
        inverted_outputs: 1 << 9,
        error_mode: 1 << 9 | 1,
        error_value: 1 << 9 | 1,
        configuration: Vec::new(),
    };
    (group, io)
}

impl Rig {
    /// A node that has booted, and the driver before bring-up.
    fn new(python: &Path) -> Self {
        let (port, peer) = virtual_port(256);
        let mut adapter = Adapter::new(Some(Box::new(HostEnd { peer, until: None })));
        let tty = adapter.pty.path().to_owned();
        let mut command = Bus::slcan(&tty).script_with(python, "io_node.py", "cia401-emulated.eds");
        let mut script = Script::start(command.args(["--node", &NODE.raw().to_string()]).stdout(Stdio::piped()));
        let output = BufReader::new(script.0.stdout.take().expect("the output is a pipe"));
        let (group, io) = config();
        let (bus, links) = CanBus::with_io(port, group, &[], &[io]).expect("the configuration is sound");
        // The first frame on the bus is the boot-up of the node.
        assert!(adapter.serve(PATIENCE, |adapter| adapter.device.counts().sent > 0), "the node does not boot");
        Self { bus: Some(bus), link: links[0].clone(), adapter, script, output }
    }

    /// One period of the bus.
    fn pass(&mut self) {
        self.adapter.serve(PERIOD, |_| false);
    }

    fn up(python: &Path) -> Self {
        let mut rig = Self::new(python);
        let end = clock::now() + 2 * PATIENCE;
        loop {
            match rig.bus.as_mut().expect("the driver is there").bring_up(clock::now()) {
                Poll::Ready(result) => break assert_eq!(result, Ok(())),
                Poll::Pending => rig.pass(),
            }
            assert!(clock::now() < end, "bring-up does not end");
        }
        rig
    }

    /// One cycle, and the inputs that it has read.
    fn cycle(&mut self) -> InputImage {
        if let Some(bus) = &mut self.bus {
            bus.read(clock::now(), &mut []);
            bus.write(clock::now(), &[]);
            bus.send(clock::now());
        }
        self.pass();
        self.link.inputs.read()
    }

    /// Runs cycles until the inputs fulfil a condition.
    fn until(&mut self, what: &str, mut condition: impl FnMut(&InputImage) -> bool) -> InputImage {
        let end = clock::now() + PATIENCE;
        loop {
            let image = self.cycle();
            if condition(&image) {
                return image;
            }
            assert!(clock::now() < end, "{what}: {image:?}");
        }
    }

    /// Sends a command to the node, and returns its answer.
    fn command(&mut self, line: &str) -> String {
        let input = self.script.0.stdin.as_mut().expect("the input is open until the end");
        writeln!(input, "{line}").expect("the script reads its input");
        let mut answer = String::new();
        while !answer.ends_with("done\n") {
            let count = self.output.read_line(&mut answer).expect("the output is text");
            assert!(count > 0, "the script ended after {line:?}: {answer}");
        }
        answer.trim_end_matches("done\n").trim_end().to_owned()
    }
}

/// Whether the first inputs have these levels, and no fault hides them.
fn reads(image: &InputImage, levels: u64) -> bool {
    (0..16).all(|number| image.input(number).is_some_and(|input| input.level == (levels >> number & 1 == 1)))
}

#[test]
fn the_driver_runs_an_io_node_of_python_canopen() {
    let test = "peers::io_driver::the_driver_runs_an_io_node_of_python_canopen";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.6);
    let mut rig = Rig::up(&python);
    // Before the first command the outputs have the error values; output 9 is inverted at its terminal.
    rig.until("the error values", |image| reads(image, 0x001));
    rig.link.outputs.set_all(0x2A5);
    // The inputs are the levels at the terminals: output 9 is 0 there, and edges are counted.
    let image = rig.until("the first levels", |image| reads(image, 0x0A5));
    let edges: Vec<_> = (0..10).map(|number| image.input(number).expect("no fault").edges).collect();
    rig.link.outputs.set_all(0x0A4);
    let image = rig.until("the second levels", |image| reads(image, 0x2A4));
    let more = |number: usize| image.input(number as u8).expect("no fault").edges - edges[number];
    assert_eq!([0, 1, 2, 9].map(more), [1, 0, 0, 1]);
    assert_eq!(rig.command("outputs"), "a402000000000000");

    // A node that restarts has left the operational state. A reset configures and starts the node again.
    rig.command("reset");
    let image = rig.until("the restart", |image| image.fault.is_some());
    assert_eq!(image.fault, Some(IoFault::LeftOperational { node: NODE.raw() }));
    assert!(image.input(2).is_none());
    rig.link.reset_fault();
    rig.until("the node is back", |image| image.fault.is_none());
    rig.link.outputs.set_all(0x210);
    rig.until("the levels after the reset", |image| reads(image, 0x010));

    // A node without inputs is silent, although its heartbeat goes on.
    rig.command("silent");
    let image = rig.until("silence", |image| image.fault.is_some());
    assert!(matches!(image.fault, Some(IoFault::InputsSilent { .. })), "{image:?}");
    rig.command("speak");
    rig.link.reset_fault();
    rig.until("the node speaks", |image| image.fault.is_none());
    rig.link.outputs.set_all(0x010);
    rig.until("the levels after the silence", |image| reads(image, 0x210));

    // A host that ends leaves the outputs of the node in their error state.
    rig.bus = None;
    let end = clock::now() + PATIENCE;
    while rig.command("outputs") != "1100000000000000" {
        assert!(clock::now() < end, "outputs {}", rig.command("outputs"));
        rig.pass();
    }
    assert_eq!(rig.link.inputs.read().fault, Some(IoFault::Ended { node: NODE.raw() }));
}

#[test]
fn an_io_node_of_python_canopen_with_another_identity_is_refused() {
    let test = "peers::io_driver::an_io_node_of_python_canopen_with_another_identity_is_refused";
    let Some(python) = python(test) else { return };
    let _share = processors::take(0.6);
    let mut rig = Rig::new(&python);
    let (group, io) = config();
    let (port, peer) = virtual_port(256);
    let other = IoConfig { identity: Identity { product: Some(0x402), ..io.identity }, ..io };
    let (mut bus, _) = CanBus::with_io(port, group, &[], &[other]).expect("the configuration is sound");
    rig.adapter.replace(Box::new(HostEnd { peer, until: None }));
    let end = clock::now() + PATIENCE;
    let error = loop {
        match bus.bring_up(clock::now()) {
            Poll::Ready(result) => break result.expect_err("another device"),
            Poll::Pending => rig.pass(),
        }
        assert!(clock::now() < end, "bring-up does not end");
    };
    let expected = drive::BringUpError::WrongIdentity { node: NODE.raw(), subindex: 2, expected: 0x402, found: 0x401 };
    assert_eq!(error, expected);
}
