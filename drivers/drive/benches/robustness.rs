//! Positions that the host of axis controllers believes on damaged lines: ten million cycles of each kind, or the
//! number in the first argument. `cargo bench -p mrroc-drive --bench robustness`

#[path = "robustness/study.rs"]
mod study;

use mrroc_drive::axis_controller::Protocol;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let benched = std::env::args().any(|argument| argument == "--bench");
    let cycles =
        arguments.find_map(|argument| argument.parse().ok()).unwrap_or(if benched { 10_000_000 } else { 1_000 });
    println!("{cycles} cycles each");
    println!(
        "{:<8} {:<17} {:>10} {:>10} {:>15} {:>8} {:>6} {:>5} {:>7} {:>7}",
        "", "", "damaged", "believed", "wrong position", "by up to", "beyond", "found", "believed", "faults"
    );
    for protocol in [Protocol::Nfv2, Protocol::HiMoxa] {
        for (name, damage) in study::DAMAGES {
            let tally = study::run(protocol, damage, cycles, 0x5EED);
            println!(
                "{:<8} {name:<17} {:>10} {:>10} {:>7} {:>7.0e} {:>8} {:>6} {:>5} {:>7} {:>7}",
                format!("{protocol:?}"),
                tally.damaged,
                tally.accepted,
                tally.wrong_positions,
                tally.wrong_positions as f64 / tally.accepted.max(1) as f64,
                tally.greatest_error,
                tally.beyond_reach,
                tally.frames_to_find,
                tally.frames_to_believe,
                tally.faults,
            );
        }
    }
}
