//! Claims about error control: the heartbeat producer, the heartbeat consumers, and the effect of a lost heartbeat on
//! the NMT state.

use super::rig::{EMCY, HEARTBEAT, Heard, NODE, Rig, Verdict, ensure, hex, unit};
use super::{CIA_301, Row};

pub(super) const ROWS: &[Row] = &[
    CIA_301.row(
        "hb-period",
        "7.2.8.3.2.2",
        ("Heartbeat producer", &[0x1017]),
        "heartbeats come at the producer time, within 1 ms",
        period,
    ),
    CIA_301.row(
        "hb-immediate",
        "7.2.8.3.2.2",
        ("Heartbeat producer", &[0x1017]),
        "begins as soon as the producer time is written, and ends with 0",
        immediate,
    ),
    CIA_301.row(
        "hb-changed",
        "7.5.2.20",
        ("Heartbeat producer", &[0x1017]),
        "a changed producer time takes effect",
        changed,
    ),
    CIA_301.row(
        "hb-content",
        "7.2.8.3.2.2",
        ("Heartbeat producer", &[0x1017]),
        "one byte, bit 7 is 0, bits 0 to 6 are the NMT state",
        content,
    ),
    CIA_301.row(
        "hb-boot-up-first",
        "7.2.8.3.2.2",
        ("Heartbeat producer", &[0x1017]),
        "with a stored producer time the boot-up is the first heartbeat",
        boot_up_first,
    ),
    CIA_301.row(
        "hb-no-guarding",
        "7.2.8.3.2.1",
        ("Node guarding", &[]),
        "0x100C is absent, and a remote frame is not answered",
        no_guarding,
    ),
    CIA_301.row(
        "hbc-waits-for-first",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "a producer is not watched before its first heartbeat",
        waits_for_first,
    ),
    CIA_301.row(
        "hbc-lost",
        "7.2.8.2.2",
        ("Heartbeat consumer", &[0x1016]),
        "a lost heartbeat is EMCY 8130 after the consumer time, within 5 ms",
        lost,
    ),
    CIA_301.row(
        "hbc-in-time",
        "7.2.8.2.2",
        ("Heartbeat consumer", &[0x1016]),
        "heartbeats within the consumer time cause no event",
        in_time,
    ),
    CIA_301.row("hbc-once", "7.2.8.2.2", ("Heartbeat consumer", &[0x1016]), "one loss is one event", once),
    CIA_301.row(
        "hbc-two-producers",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "two entries watch two producers, each with its own time",
        two_producers,
    ),
    CIA_301.row(
        "hbc-other-node",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "heartbeats of a third node neither arm nor serve an entry",
        other_node,
    ),
    CIA_301.row(
        "hbc-same-producer",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "a second entry for the same producer is refused with 06040043",
        same_producer,
    ),
    CIA_301.row(
        "hbc-unused",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "time 0 or node-ID 0 is an unused entry",
        unused,
    ),
    CIA_301.row(
        "hbc-reserved-bits",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "node-IDs above 127 and bits 24 to 31 are refused or leave the entry unused",
        reserved_bits,
    ),
    CIA_301.row(
        "hbc-rewritten",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "an entry re-written after a loss watches again from the next heartbeat on",
        rewritten,
    ),
    CIA_301.row(
        "hbc-again",
        "7.2.8.2.2",
        ("Heartbeat consumer", &[0x1016]),
        "heartbeats that come back end the error, and their second loss is a second event",
        again,
    ),
    CIA_301.row(
        "hbc-reset",
        "7.5.2.19",
        ("Heartbeat consumer", &[0x1016]),
        "a reset of the communication ends the watch",
        ends_at_reset,
    ),
    CIA_301.row(
        "eb-pre-operational",
        "7.5.2.32",
        ("Error behaviour", &[0x1029]),
        "0 leads from operational to pre-operational",
        to_pre_operational,
    ),
    CIA_301.row(
        "eb-not-operational",
        "7.5.2.32",
        ("Error behaviour", &[0x1029]),
        "0 leaves pre-operational and stopped as they are",
        stays_outside_operational,
    ),
    CIA_301.row("eb-no-change", "7.5.2.32", ("Error behaviour", &[0x1029]), "1 changes no state", no_change),
    CIA_301.row(
        "eb-stopped",
        "7.5.2.32",
        ("Error behaviour", &[0x1029]),
        "2 leads from operational to stopped",
        to_stopped,
    ),
];

/// Node-ID of a producer that the check emulates.
const PRODUCER: u8 = 0x7E;

const LOST: [u8; 2] = [0x30, 0x81];

fn beat(rig: &mut Rig, node: u8) {
    rig.send(0x700 + u16::from(node), &[0x05]);
}

/// Configures a drive whose power stage does not react to a loss.
fn indifferent(rig: &mut Rig) -> Verdict {
    rig.write(0x6007, 0, 0, 2)?;
    rig.write(0x1029, 1, 1, 1)
}

fn watch(rig: &mut Rig, entry: u8, node: u8, millis: i64) -> Verdict {
    rig.write(0x1016, entry, i64::from(node) << 16 | millis, 4)
}

/// Losses reported since `mark`.
fn losses(rig: &Rig, mark: super::rig::Mark) -> Vec<Heard> {
    let mut heard = rig.heard(mark, EMCY);
    heard.retain(|heard| heard.data[..2] == LOST);
    heard
}

/// Milliseconds between frames.
fn gaps(heard: &[Heard]) -> Vec<f64> {
    heard.windows(2).map(|pair| pair[1].at.since(pair[0].at).as_secs_f64() * 1e3).collect()
}

fn expect_gaps(heard: &[Heard], millis: f64) -> Verdict {
    let gaps = gaps(heard);
    ensure!(
        gaps.len() >= 5 && gaps.iter().all(|gap| (gap - millis).abs() <= 1.0),
        "heartbeats {gaps:?} ms apart, expected {millis}"
    );
    Ok(())
}

fn period(rig: &mut Rig) -> Verdict {
    for millis in [10, 33, 100] {
        rig.write(0x1017, 0, millis, 2)?;
        rig.pass(5);
        let mark = rig.mark();
        rig.pass(700);
        expect_gaps(&rig.heard(mark, HEARTBEAT), millis as f64)?;
    }
    Ok(())
}

fn immediate(rig: &mut Rig) -> Verdict {
    let mark = rig.mark();
    rig.write(0x1017, 0, 20, 2)?;
    rig.pass(22);
    ensure!(!rig.heard(mark, HEARTBEAT).is_empty(), "no heartbeat within one period");
    rig.write(0x1017, 0, 0, 2)?;
    let mark = rig.mark();
    rig.pass(200);
    let heard = rig.heard(mark, HEARTBEAT);
    ensure!(heard.is_empty(), "{} heartbeats with producer time 0", heard.len());
    Ok(())
}

fn changed(rig: &mut Rig) -> Verdict {
    rig.write(0x1017, 0, 2_000, 2)?;
    rig.pass(100);
    let mark = rig.mark();
    rig.write(0x1017, 0, 25, 2)?;
    rig.pass(200);
    let heard = rig.heard(mark, HEARTBEAT);
    ensure!(heard.len() >= 7, "{} heartbeats within 200 ms at 25 ms", heard.len());
    expect_gaps(&heard[1..], 25.0)
}

fn content(rig: &mut Rig) -> Verdict {
    rig.write(0x1017, 0, 10, 2)?;
    for (command, state) in [(0x80, 0x7F), (0x01, 0x05), (0x02, 0x04)] {
        rig.nmt(command);
        rig.pass(12);
        let mark = rig.mark();
        rig.pass(50);
        for heartbeat in rig.heard(mark, HEARTBEAT) {
            ensure!(heartbeat.data == [state], "{} in state {state:#04x}", hex(&heartbeat.data));
        }
    }
    Ok(())
}

fn boot_up_first(rig: &mut Rig) -> Verdict {
    rig.write(0x1017, 0, 40, 2)?;
    rig.write(0x1010, 1, 0x6576_6173, 4)?;
    rig.nmt(0x80);
    let mark = rig.mark();
    rig.send(0x000, &[0x82, NODE]);
    rig.pass(400);
    let heard = rig.heard(mark, HEARTBEAT);
    let from = heard.iter().position(|heard| heard.data == [0]);
    ensure!(from == Some(0), "{heard:?}");
    ensure!(heard[1..].iter().all(|heard| heard.data == [0x7F]), "{heard:?}");
    expect_gaps(&heard, 40.0)
}

fn no_guarding(rig: &mut Rig) -> Verdict {
    let mark = rig.mark();
    rig.send_remote(HEARTBEAT, 1);
    rig.pass(20);
    let heard = rig.all_heard(mark);
    ensure!(heard.is_empty(), "answer to a remote frame: {heard:?}");
    rig.refuse((0x100C, 0), 0, 2, &[0x0602_0000])
}

fn waits_for_first(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 20)?;
    let mark = rig.mark();
    rig.pass(300);
    ensure!(rig.heard(mark, EMCY).is_empty(), "EMCY before the first heartbeat");
    beat(rig, PRODUCER);
    rig.pass(60);
    ensure!(losses(rig, mark).len() == 1, "no EMCY 8130 after the first heartbeat");
    Ok(())
}

fn lost(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    for millis in [20, 50, 200] {
        watch(rig, 1, 0, 0)?;
        watch(rig, 1, PRODUCER, millis)?;
        let mark = rig.mark();
        beat(rig, PRODUCER);
        let begin = rig.now();
        rig.pass(300);
        let heard = losses(rig, mark);
        ensure!(heard.len() == 1, "{} EMCY 8130 at {millis} ms", heard.len());
        let after = heard[0].at.since(begin).as_secs_f64() * 1e3;
        ensure!((millis as f64..=millis as f64 + 5.0).contains(&after), "EMCY after {after:.1} ms, expected {millis}");
    }
    Ok(())
}

fn in_time(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 20)?;
    let mark = rig.mark();
    for _ in 0..30 {
        beat(rig, PRODUCER);
        rig.pass(18);
    }
    let heard = rig.all_heard(mark);
    ensure!(heard.is_empty(), "{heard:?}");
    Ok(())
}

fn once(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 20)?;
    let mark = rig.mark();
    beat(rig, PRODUCER);
    rig.pass(500);
    let heard = rig.heard(mark, EMCY);
    ensure!(heard.len() == 1, "{} EMCY of one loss", heard.len());
    Ok(())
}

fn two_producers(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 30)?;
    watch(rig, 2, PRODUCER - 1, 90)?;
    let mark = rig.mark();
    for _ in 0..10 {
        beat(rig, PRODUCER);
        beat(rig, PRODUCER - 1);
        rig.pass(20);
    }
    ensure!(losses(rig, mark).is_empty(), "a loss while both producers send");
    // The first producer falls silent, then the second.
    for _ in 0..10 {
        beat(rig, PRODUCER - 1);
        rig.pass(20);
    }
    ensure!(losses(rig, mark).len() == 1, "{} losses with the first producer silent", losses(rig, mark).len());
    rig.pass(60);
    ensure!(losses(rig, mark).len() == 1, "the second producer is lost before its time");
    for _ in 0..3 {
        beat(rig, PRODUCER);
        rig.pass(20);
    }
    ensure!(losses(rig, mark).len() == 2, "{} losses with both producers silent", losses(rig, mark).len());
    Ok(())
}

fn other_node(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 20)?;
    let mark = rig.mark();
    beat(rig, PRODUCER - 1);
    rig.pass(60);
    ensure!(losses(rig, mark).is_empty(), "a third node armed the entry");
    beat(rig, PRODUCER);
    for _ in 0..6 {
        rig.pass(10);
        beat(rig, PRODUCER - 1);
    }
    ensure!(losses(rig, mark).len() == 1, "a third node served the entry");
    Ok(())
}

fn same_producer(rig: &mut Rig) -> Verdict {
    watch(rig, 1, PRODUCER, 20)?;
    let value = i64::from(PRODUCER) << 16 | 50;
    rig.refuse((0x1016, 2), value, 4, &[0x0604_0043])?;
    rig.expect(0x1016, 2, 0)?;
    // The same entry may change its own time, and a producer that was released may be assigned to another entry.
    watch(rig, 1, PRODUCER, 30)?;
    watch(rig, 1, 0, 0)?;
    watch(rig, 2, PRODUCER, 50)
}

fn unused(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    for (node, millis) in [(PRODUCER, 0), (0, 20)] {
        watch(rig, 1, node, millis)?;
        let mark = rig.mark();
        beat(rig, node);
        beat(rig, PRODUCER);
        rig.pass(100);
        ensure!(rig.heard(mark, EMCY).is_empty(), "node {node}, {millis} ms is watched");
    }
    Ok(())
}

fn reserved_bits(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    for value in [0x0080_0014, 0x00FF_0014, 0x017E_0014, 0x807E_0014_u32] {
        let answer = rig.download(0x1016, 1, i64::from(value), 4)?;
        let mark = rig.mark();
        beat(rig, PRODUCER);
        rig.pass(60);
        let watched = !rig.heard(mark, EMCY).is_empty();
        ensure!(!watched && matches!(answer[0], 0x60 | 0x80), "{value:#010x}: {}, watched: {watched}", hex(&answer));
    }
    Ok(())
}

fn rewritten(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 20)?;
    for round in 1..=3 {
        let mark = rig.mark();
        beat(rig, PRODUCER);
        rig.pass(60);
        ensure!(losses(rig, mark).len() == 1, "{} losses in round {round}", losses(rig, mark).len());
        watch(rig, 1, PRODUCER, 20)?;
        let mark = rig.mark();
        rig.pass(60);
        ensure!(losses(rig, mark).is_empty(), "a loss before the next heartbeat in round {round}");
    }
    Ok(())
}

fn again(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 20)?;
    for round in 1..=3 {
        let mark = rig.mark();
        beat(rig, PRODUCER);
        rig.pass(60);
        let heard = rig.heard(mark, EMCY);
        ensure!(losses(rig, mark).len() == 1, "{} losses in round {round}", losses(rig, mark).len());
        ensure!(rig.read(0x1001, 0)? & 0x11 == 0x11, "error register after the loss");
        if round > 1 {
            ensure!(heard[0].data[..3] == [0, 0, 0], "{} as the heartbeat came back", hex(&heard[0].data));
        }
    }
    Ok(())
}

fn ends_at_reset(rig: &mut Rig) -> Verdict {
    indifferent(rig)?;
    watch(rig, 1, PRODUCER, 100)?;
    beat(rig, PRODUCER);
    rig.pass(5);
    let mark = rig.mark();
    rig.reset(0x82);
    beat(rig, PRODUCER);
    rig.pass(300);
    rig.expect(0x1016, 1, 0)?;
    ensure!(losses(rig, mark).is_empty(), "the watch outlived the reset");
    Ok(())
}

/// NMT state after a loss that occurs in the state reached by `command`.
fn state_after_loss(rig: &mut Rig, behaviour: i64, command: u8) -> Result<u8, super::rig::Deviation> {
    rig.boot(unit());
    rig.write(0x6007, 0, 0, 2)?;
    rig.write(0x1029, 1, behaviour, 1)?;
    rig.write(0x1017, 0, 10, 2)?;
    watch(rig, 1, PRODUCER, 20)?;
    rig.nmt(command);
    beat(rig, PRODUCER);
    rig.pass(60);
    rig.nmt_state()
}

fn expect_states(rig: &mut Rig, behaviour: i64, cases: &[(u8, u8)]) -> Verdict {
    for &(command, state) in cases {
        let found = state_after_loss(rig, behaviour, command)?;
        ensure!(found == state, "state {found:#04x} after {command:02X} and a loss, expected {state:#04x}");
    }
    Ok(())
}

fn to_pre_operational(rig: &mut Rig) -> Verdict {
    rig.expect(0x1029, 1, 0)?;
    expect_states(rig, 0, &[(0x01, 0x7F)])
}

fn stays_outside_operational(rig: &mut Rig) -> Verdict {
    expect_states(rig, 0, &[(0x80, 0x7F), (0x02, 0x04)])
}

fn no_change(rig: &mut Rig) -> Verdict {
    expect_states(rig, 1, &[(0x80, 0x7F), (0x01, 0x05), (0x02, 0x04)])
}

fn to_stopped(rig: &mut Rig) -> Verdict {
    expect_states(rig, 2, &[(0x01, 0x04)])
}
