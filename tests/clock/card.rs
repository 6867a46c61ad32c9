//! Emulators and controller as two processes on two CAN cards of one bus, under a PREEMPT_RT kernel.
//!
//! The test machine emulates every instruction, and a busy host may take its only processor away. The period of the
//! cell is therefore long, 20 ms. Its time limits are a second without answers and three seconds without cycles.
//! Required hardware, with `HIL_CARDS` set: two cards on one bus with nothing else on it, and root.

use std::fs;
use std::process::Command;

use ::mrroc::cell::Cell;
use can::card::{self, CardError, CardState};
use can::timing::Bitrate;
use kit::bench::bodies_on_cards;
use kit::mrroc::{self, Directory, Running};

use crate::doctor::{self, Attached};
use crate::slcan::Adapters;
use crate::vcan::{faulted, stand_without_power, started};

/// Directory with a cell that has a long period and long time limits.
fn directory_with_cell() -> Directory {
    let directory = Directory::new();
    directory.cell("irb6", |cell| {
        mrroc::shorten(cell);
        cell.robot[0].program.truncate(1);
        cell.period_us = 20_000;
        cell.macrostep = 4;
        cell.max_missed_in_row = 150;
        cell.bus[0].tolerated_missing = 50;
        cell.bus[0].heartbeat_ms = 1000;
        cell.bus[0].boot_timeout_ms = 20_000;
        // Delays of the test machine must not be taken for motion of the arm.
        for axis in &mut cell.robot[0].axis {
            axis.following_error = 100.0;
        }
    });
    directory
}

/// Starts the controller on `card` with output files for states and report.
fn start_controller(directory: &Directory, card: &str, further: &[&str]) -> Running {
    let cell = directory.path("cell.toml").display().to_string();
    let states = directory.path("states.csv").display().to_string();
    // Deletes the states of the previous run.
    let _ = fs::remove_file(&states);
    let run = ["run", &cell, "--bench", "card", "--can", card, "--json", "--record", &states];
    Running::start(run.iter().chain(further))
}

fn completed(run: Running) -> String {
    let output = run.output();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = output.json();
    assert_eq!(report["outcome"], "completed", "{report}");
    // SYNC is stamped when the card has sent it. The driver of the card has no clock of its own.
    let wire = &report["wire"][0];
    assert_eq!((&wire["source"], &wire["sync_stamp"]), (&"kernel".into(), &"sent".into()), "{wire}");
    let fastest = wire["nodes"][0]["sync_to_tpdo_us"]["p50"].as_f64();
    assert!(fastest > Some(0.0), "{wire}");
    output.stderr
}

/// Asserts that the run ended with this refusal before any motion.
fn refused(run: Running, line: &str) {
    let output = run.output();
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(output.stderr.contains(line), "{line}: {output:?}");
}

fn sh(command: &str) -> String {
    let output = Command::new("sh").args(["-ec", command]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{command}: {text}");
    text
}

#[test]
fn cards_under_a_real_time_kernel() {
    bodies_on_cards(
        "card::cards_under_a_real_time_kernel",
        &[
            (
                "an arm on a card stops when its interface goes down and moves again when it is up",
                an_arm_stops_when_its_interface_goes_down_and_moves_again_when_it_is_up,
            ),
            ("an arm behind a card is not moved unasked", an_arm_behind_a_card_is_not_moved_unasked),
            (
                "a bit rate that cannot be set is refused and doctor puts back what it sets",
                a_bit_rate_that_cannot_be_set_is_refused_and_doctor_puts_back_what_it_sets,
            ),
        ],
    );
}

fn an_arm_stops_when_its_interface_goes_down_and_moves_again_when_it_is_up(here: &str, there: &str) {
    let directory = directory_with_cell();
    let slow = format!("ip link set {here} down; ip link set {here} type can bitrate 500000; ip link set {here} up");
    sh(&slow);
    sh(&format!("ip link set {there} down; ip link set {there} type can bitrate 1000000; ip link set {there} up"));
    let cell = directory.path("cell.toml");
    let emulators = started(|| {
        let arguments = ["emulate".as_ref(), cell.as_os_str()];
        let can = ["--can".as_ref(), there.as_ref()];
        Running::start(arguments.into_iter().chain(can))
    });

    refused(
        start_controller(&directory, here, &[]),
        &format!("bus arm: {here}: the card is at 500 kbit/s, the cell's bus at 1000 kbit/s: --set-bitrate"),
    );
    let said = completed(start_controller(&directory, here, &["--set-bitrate"]));
    let read_back = format!("bus arm: {here} is running at 1000 kbit/s, sample point 75 %");
    assert!(said.contains(&read_back), "{said}");
    let link = sh(&format!("ip -d link show {here}"));
    assert!(link.contains("bitrate 1000000 "), "{link}");

    let moving = start_controller(&directory, here, &[]);
    moving.wait_for(&directory.path("states.csv"), |states| states.matches(",Moving,").count() > 100);
    sh(&format!("ip link set {here} down"));
    faulted(&moving.output(), &["bus arm: interface is down"]);

    sh(&format!("ip link set {here} up"));
    let text = fs::read_to_string(&cell).unwrap();
    stand_without_power(here, &directory, &Cell::parse(&text).unwrap());
    completed(start_controller(&directory, here, &[]));
    emulators.signal("INT");
    assert_eq!(emulators.output().status.code(), Some(0));
}

fn a_bit_rate_that_cannot_be_set_is_refused_and_doctor_puts_back_what_it_sets(here: &str, _: &str) {
    let directory = directory_with_cell();
    sh(&format!("ip link set {here} down; ip link set {here} type can bitrate 500000"));
    sh("ip link del vcanrate 2>/dev/null || true; ip link add dev vcanrate type vcan && ip link set vcanrate up");
    let set = &["--set-bitrate"];
    refused(
        start_controller(&directory, "vcanrate", set),
        "bus arm: vcanrate: no CAN card: a virtual interface has no bit rate",
    );
    refused(start_controller(&directory, "lo", set), "bus arm: lo: not a CAN interface");
    sh("ip link del vcanrate");
    let run = format!(
        "chmod -R a+rwX {0}; setpriv --reuid=65534 --clear-groups --bounding-set=-all --inh-caps=-all \
                 {1} run {0}/cell.toml --bench card --can {here} --set-bitrate 2>&1 || echo \"exit $?\"",
        directory.path(".").display(),
        mrroc::binary().display(),
    );
    let said = sh(&run);
    let refusal = format!(
        "bus arm: {here}: setting the bit rate needs CAP_NET_ADMIN: run as root, or run `ip link set \
                 {here} down` and `ip link set {here} up type can bitrate 1000000` before"
    );
    assert!(said.contains(&refusal) && said.ends_with("exit 2\n"), "{said}");

    sh(&format!(
        "ip link set {here} down; ip link set {here} type can bitrate 500000 restart-ms 0; \
                 ip link set {here} txqueuelen 3 up; echo 400000 >/proc/sys/kernel/sched_rt_runtime_us"
    ));
    let of = format!("bus arm, {here}");
    let knobs = [("kernel", "real-time throttling"), (&of, "bit rate"), (&of, "restart-ms"), (&of, "txqueuelen")];
    doctor::preempts(here);
    doctor::mended_and_put_back(here, &knobs, || doctor::standing(here));
}

/// Independent of the name of the bench.
fn an_arm_behind_a_card_is_not_moved_unasked(here: &str, _: &str) {
    let directory = directory_with_cell();
    let cell = directory.path("cell.toml").display().to_string();
    let identify = ["identify", &cell, "--axis=column", "--to=20"];
    let no_card = format!("--bench vcan: {here} may be hardware");
    let cases: [(&[&str], _, _); 3] = [
        (&identify, "card", "the card bench moves column by up to"),
        (&identify, "vcan", &no_card),
        (&["run", &cell], "vcan", &no_card),
    ];
    for (words, bench, line) in cases {
        let options = ["--bench", bench, "--can", here];
        refused(Running::start(words.iter().chain(&options)), line);
    }
}

/// A body of a test of `doctor`, in user-mode Linux.
pub(crate) fn a_card_that_was_up_comes_up_again_if_its_bit_rate_cannot_be_set(_: &str) {
    let adapters = Adapters::with(1, &[]);
    let _attached = Attached::card(&adapters, "rate0");
    // The driver has a table of bit rates, which does not contain this bit rate.
    let none = Bitrate::from_kbps(400).unwrap();
    let refused = |error| matches!(error, CardError::Unreachable { bitrate: 400_000, .. });
    assert!(refused(card::set_bitrate("rate0", none).unwrap_err()));
    assert!(!card::is_up("rate0").unwrap(), "one that was down stays so");

    let wanted = Bitrate::KBPS_500;
    let before = card::set_bitrate("rate0", wanted).unwrap();
    assert_eq!((before.bitrate, before.state), (Some(500_000), CardState::Running));
    assert!(refused(card::set_bitrate("rate0", none).unwrap_err()));
    assert_eq!(card::read("rate0"), Ok(before));
    sh("ip link set rate0 down");
}
