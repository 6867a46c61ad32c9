//! Scans: order of the queries, echoes, times, and lost queries.

use super::*;

fn micros(time: u16) -> Option<Duration> {
    (time != 0xFFFF).then(|| Duration::from_micros(time.into()))
}

#[test]
fn a_scan_by_rows_has_the_echo_of_each_element_and_the_time_of_its_emission() {
    let mut rig = Rig::up();
    let begun = rig.now;
    let state = rig.until(|state| state.scan.number == 1);
    assert_eq!(rig.line.script().heard[1..4], [[3, 0], [3, 1], [3, 2]]);
    let scan = state.measured().unwrap();
    for row in 0..3 {
        for column in 0..3 {
            let element = (row, column);
            let echo = scan.echo(row.into(), column.into());
            assert_eq!(echo, micros(Script::time(element, element)), "{element:?}");
        }
    }
    assert_eq!((scan.echo(3, 0), scan.echo(0, 3), scan.echo(16, 0)), (None, None, None));
    // A query is sent in the cycle that reads the last reply. Its 5 bytes arrive 434 µs later.
    let slot = Duration::from_micros(3_500);
    let query = Duration::from_nanos(434_028);
    let first = scan.emission(0, 0, slot);
    assert_eq!(first, begun + PERIOD + query);
    // The script answers in the fourth reading.
    assert_eq!(scan.emission(1, 0, slot), first + 4 * PERIOD);
    assert_eq!(scan.emission(1, 2, slot), first + 4 * PERIOD + 2 * slot);
    assert_eq!(scan.ended, state.at);
    let counters = rig.matrix.sensor_counters();
    assert_eq!((counters.scans, counters.replies, counters.missing, counters.garbage), (1, 3, 0, 0));
    assert_eq!(rig.until(|state| state.scan.number == 2).at, state.at + 12 * PERIOD);
}

#[test]
fn a_scan_by_pairs_has_the_echo_of_each_pair() {
    let config = UltrasonicConfig { size: 2, scan: ScanKind::Pairs, ..config() };
    let mut rig = Rig::up_with(config, Script::new(2));
    let state = rig.until(|state| state.scan.number == 1);
    let elements = [(0, 0), (0, 1), (1, 0), (1, 1)];
    for (shot, emitter) in elements.into_iter().enumerate() {
        for (number, receiver) in elements.into_iter().enumerate() {
            assert_eq!(state.scan.echo(shot, number), micros(Script::time(emitter, receiver)));
        }
    }
    assert_eq!(rig.matrix.sensor_counters().replies, 16);
}

#[test]
fn echoes_of_a_lost_query_are_missing_in_the_scan() {
    for broken in [false, true] {
        let mut rig = Rig::up();
        if broken {
            rig.line.script().broken = 1;
        } else {
            rig.line.script().mute = 1;
        }
        let scan = rig.until(|state| state.scan.number == 1).scan;
        let echoes = [0, 1, 2].map(|row| [0, 1, 2].map(|column| scan.echo(row, column).is_some()));
        assert_eq!(echoes, [[false; 3], [true, false, true], [true; 3]]);
        assert_eq!(rig.matrix.sensor_counters().missing, 1);
        // A stalled line may still hold the query.
        assert!(rig.line.script().discarded > 0);
        let scan = rig.until(|state| state.scan.number == 2).scan;
        assert!(scan.echo(0, 0).is_some());
    }
}

#[test]
fn a_late_reply_is_not_taken_for_the_reply_to_the_next_query() {
    let mut rig = Rig::up();
    // 10 readings more than a query may take.
    rig.line.script().delay =
        config().answer_timeout(serial::ultrasonic::Request::Row(0)).as_millis() as usize / 2 + 10;
    let line = rig.line.clone();
    rig.until(|_| line.script().heard.len() >= 3);
    rig.line.script().delay = 3;
    let scan = rig.until(|state| state.scan.number == 1).scan;
    for row in 0..3 {
        for column in 0..3 {
            let time = micros(Script::time((row, column), (row, column)));
            let echo = scan.echo(row.into(), column.into());
            assert!(echo.is_none() || echo == time, "{row} {column}: {echo:?}");
        }
    }
    assert!(rig.matrix.sensor_counters().garbage > 0);
}
