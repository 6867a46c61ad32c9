//! Shortest times with which a bus of several nodes works.

use std::time::Duration;

use super::SDO_FRAMES_PER_CALL;

/// Shortest time-out of an SDO answer on a bus of `nodes`. All nodes may have a request in the same cycle, for example
/// for a change of mode. In operation, one request leaves per cycle, and each answer is read in the cycle after its
/// request.
pub fn least_sdo_timeout(period: Duration, nodes: usize) -> Duration {
    period * nodes as u32
}

/// Shortest time-out of the boot of `nodes` that send their boot-up message `boot` after a reset. The message is read
/// in the next cycle. Each node is then asked for its device type, by up to eight requests per cycle, and the last
/// answer is read in the cycle after its request.
pub fn least_boot_timeout(period: Duration, nodes: usize, boot: Duration) -> Duration {
    let until_heard = boot.div_duration_f64(period).floor() as u32 + 1;
    period * (until_heard + nodes.div_ceil(SDO_FRAMES_PER_CALL) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_node_of_a_bus_gets_its_turn_and_its_answer_in_time() {
        let ms = Duration::from_millis;
        for (period, nodes, sdo, boot) in
            [(1, 1, 1, 52), (2, 5, 10, 54), (2, 9, 18, 56), (10, 6, 60, 70), (100, 7, 700, 200)]
        {
            assert_eq!(least_sdo_timeout(ms(period), nodes), ms(sdo), "{period} ms, {nodes} nodes");
            assert_eq!(least_boot_timeout(ms(period), nodes, ms(50)), ms(boot), "{period} ms, {nodes} nodes");
        }
    }
}
