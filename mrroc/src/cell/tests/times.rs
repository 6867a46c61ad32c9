//! Times that do not fit the servo period, the nodes of a bus, or each other.

use super::*;

/// The message about a time in the first bus of `text`, or in its bundle of lines.
#[track_caller]
fn refusal(text: &str, period_us: u32, table: &str, key: &str, value: u32) -> Option<String> {
    let text = text.replacen("period_us = 2000", &format!("period_us = {period_us}"), 1);
    let given = format!("[[{table}]]\n{key} = {value}");
    let text = text.replacen(&format!("[[{table}]]"), &given, 1);
    match Cell::parse(&text) {
        Ok(_) => None,
        Err(error) => {
            assert_eq!(error.key, format!("{table}[0].{key}"), "{error}");
            Some(error.problem)
        }
    }
}

/// Asserts that `least` is the smallest value of the key, and that a smaller one is refused with these words.
#[track_caller]
fn least(text: &str, period_us: u32, key: &str, least: u32, why: &str) {
    assert_eq!(refusal(text, period_us, "bus", key, least), None, "{period_us} µs");
    let said = refusal(text, period_us, "bus", key, least - 1).expect("a smaller value is refused");
    assert!(said.contains(&format!("is {}, must be between {least} and", least - 1)), "{said}");
    assert!(said.contains(why), "{said}");
}

#[test]
fn a_heartbeat_more_frequent_than_the_cycles_is_refused() {
    for (period_us, period) in [(2_000, 2), (10_000, 10), (100_000, 100)] {
        least(IRB6, period_us, "heartbeat_ms", period, "one heartbeat per cycle at the most");
    }
}

#[test]
fn an_sdo_timeout_shorter_than_the_turn_of_all_nodes_is_refused() {
    for (text, nodes) in [(IRB6, 5), (IRP6, 6), (TRACK, 4)] {
        for period in [2, 4, 10] {
            least(text, 1_000 * period, "sdo_timeout_ms", nodes * period, "one request leaves per cycle");
        }
    }
    // I/O nodes and force sensors take their turns as well.
    least(
        include_str!("../../../../cells/irb6-can-wrist.toml"),
        2_000,
        "sdo_timeout_ms",
        12,
        "one request leaves per cycle",
    );
}

#[test]
fn a_boot_timeout_that_no_emulated_node_keeps_is_refused() {
    // The boot takes 50 ms and is heard in the next cycle, and the answer comes one cycle later.
    for (period, timeout) in [(1, 52), (2, 54), (10, 70), (100, 200)] {
        least(IRB6, 1_000 * period, "boot_timeout_ms", timeout, "boots in 50 ms");
    }
}

#[test]
fn an_emulated_adapter_that_holds_answers_for_a_period_is_refused() {
    for period in [2, 3] {
        let of = |latency| refusal(SERIAL, 1_000 * period, "serial", "emulated_latency_ms", latency);
        assert_eq!(of(period - 1), None, "{period} ms");
        let said = of(period).expect("a longer latency is refused");
        assert!(said.contains(&format!("is {period}, must be below the servo period of {period} ms")), "{said}");
        assert!(said.contains("the latency timer"), "{said}");
    }
}
