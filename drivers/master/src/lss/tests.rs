//! Dialogues of the LSS master.

use super::*;
use crate::parse;

const TIME_OUT: Duration = Duration::from_millis(100);
const IDENTITY: Identity = Identity { vendor: 0xFB, product: 0x6552_0000, revision: 0x0170_0000, serial: 0x1234_5678 };

fn at(millis: u64) -> Instant {
    Instant::from_nanos(millis * 1_000_000)
}

fn started(service: Service) -> Master {
    let mut master = Master::default();
    master.start(service, TIME_OUT, at(0)).unwrap();
    master
}

/// Plays a dialogue: `7E5#…` must be sent by the master, anything else is handed to it. Nothing else
/// may be sent.
fn play(master: &mut Master, now: Instant, dialogue: &str) {
    for line in dialogue.split_whitespace() {
        if line.starts_with("7E5") {
            let sent = master.poll_transmit(now).map(|frame| frame.to_string());
            assert_eq!(sent.as_deref(), Some(line));
        } else {
            master.handle(&parse(line), now);
        }
    }
    assert_eq!(master.poll_transmit(now), None);
}

#[test]
fn each_service_sends_these_frames_and_takes_these_answers() {
    let node = NodeId::new(5);
    let table = [
        (Service::SwitchGlobal(Mode::Configuration), "7E5#0401000000000000", Answer::Done),
        (
            Service::SwitchSelective(IDENTITY),
            "7E5#40FB000000000000 7E5#4100005265000000 7E5#4200007001000000
             7E5#4378563412000000 7E4#4400000000000000",
            Answer::Done,
        ),
        (Service::ConfigureNodeId(node), "7E5#1105000000000000 7E4#1100000000000000", Answer::Done),
        (Service::ConfigureNodeId(None), "7E5#11FF000000000000 7E4#1100000000000000", Answer::Done),
        (Service::Store, "7E5#1700000000000000 7E4#1700000000000000", Answer::Done),
        (
            Service::InquireIdentity,
            "7E5#5A00000000000000 7E4#5AFB000000000000 7E5#5A00000000000000 7E4#5AFB000000000000
             7E5#5B00000000000000 7E4#5B00005265000000 7E5#5B00000000000000 7E4#5B00005265000000
             7E5#5C00000000000000 7E4#5C00007001000000 7E5#5C00000000000000 7E4#5C00007001000000
             7E5#5D00000000000000 7E4#5D78563412000000 7E5#5D00000000000000 7E4#5D78563412000000",
            Answer::Identity(IDENTITY),
        ),
        (
            Service::InquireNodeId,
            "7E5#5E00000000000000 7E4#5E05000000000000 7E5#5E00000000000000 7E4#5E05000000000000",
            Answer::NodeId(node),
        ),
        (
            Service::InquireNodeId,
            "7E5#5E00000000000000 7E4#5EFF000000000000 7E5#5E00000000000000 7E4#5EFF000000000000",
            Answer::NodeId(None),
        ),
    ];
    for (service, dialogue, answer) in table {
        let mut master = started(service);
        play(&mut master, at(0), dialogue);
        assert_eq!(master.poll(), Some(Ok(answer)), "{service}");
        assert_eq!(master.poll(), None);
        assert_eq!(master.poll_timeout(), None);
    }
}

#[test]
fn refusals_say_why() {
    let refused = |service, error, specific| LssError::Refused { service, outcome: Outcome { error, specific } };
    let table = [
        (Service::ConfigureNodeId(None), "7E4#1101000000000000", 1, 0),
        (Service::Store, "7E4#17FF070000000000", 0xFF, 7),
        (Service::Store, "7E4#1702000000000000", 2, 0),
    ];
    for (service, answer, error, specific) in table {
        let mut master = started(service);
        assert!(master.poll_transmit(at(0)).is_some());
        master.handle(&parse(answer), at(0));
        assert_eq!(master.poll(), Some(Err(refused(service, error, specific))));
    }
    let mut master = started(Service::InquireNodeId);
    play(&mut master, at(0), "7E5#5E00000000000000 7E4#5E80000000000000 7E5#5E00000000000000 7E4#5E80000000000000");
    assert_eq!(master.poll(), Some(Err(LssError::NodeId { node_id: 128 })));
    assert_eq!(
        refused(Service::Store, 2, 0).to_string(),
        "the slave refused store configuration: error 2, vendor code 0"
    );
}

#[test]
fn an_answer_that_does_not_come_in_time_fails_the_service() {
    let table = [
        (Service::SwitchSelective(IDENTITY), 4),
        (Service::ConfigureNodeId(None), 1),
        (Service::Store, 1),
        (Service::InquireIdentity, 1),
        (Service::InquireNodeId, 1),
    ];
    for (service, frames) in table {
        let mut master = started(service);
        for _ in 0..frames {
            assert!(master.poll_transmit(at(50)).is_some());
        }
        let own = match service {
            Service::SwitchSelective(_) => "7E4#44",
            Service::ConfigureNodeId(_) => "7E4#11",
            Service::Store => "7E4#17",
            Service::InquireIdentity => "7E4#5A",
            _ => "7E4#5E",
        };
        let answers = "7E4#1100000000000000 7E4#1300000000000000 7E4#1700000000000000
             7E4#4400000000000000 7E4#4F00000000000000 7E4#5000000000000000 7E4#5A00000000000000
             7E4#5D00000000000000 7E4#5E05000000000000 582#4F60600008000000";
        for late in answers.split_whitespace().filter(|line| !line.starts_with(own)) {
            play(&mut master, at(60), late);
        }
        assert_eq!(master.poll_timeout(), Some(at(150)), "{service}");
        master.handle_timeout(at(149));
        assert_eq!(master.poll(), None);
        master.handle_timeout(at(150));
        let waited = Duration::from_millis(150);
        assert_eq!(master.poll(), Some(Err(LssError::TimedOut { service, waited })));
    }
}

#[test]
fn a_request_that_was_never_sent_times_out_and_is_not_sent_later() {
    for service in [
        Service::SwitchGlobal(Mode::Waiting),
        Service::IdentifyUnconfigured,
        Service::Fastscan,
        Service::FastscanAbove(IDENTITY),
        Service::Store,
    ] {
        let mut master = started(service);
        master.handle(&parse("7E4#1700000000000000"), at(0));
        master.handle_timeout(at(100));
        let waited = Duration::from_millis(100);
        assert_eq!(master.poll(), Some(Err(LssError::TimedOut { service, waited })));
        assert_eq!(master.poll_transmit(at(100)), None);
    }
}

#[test]
fn all_slaves_have_the_whole_time_to_say_that_they_have_no_node_id() {
    let mut master = started(Service::IdentifyUnconfigured);
    play(&mut master, at(0), "7E5#4C00000000000000");
    play(&mut master, at(5), "7E4#5000000000000000 7E4#5000000000000000");
    assert_eq!(master.poll(), None);
    master.handle_timeout(at(100));
    assert_eq!(master.poll(), Some(Ok(Answer::Unconfigured(true))));
}

#[test]
fn slaves_that_know_only_fastscan_are_asked_for_by_its_first_question() {
    for (answers, any) in [("", false), ("7E4#4F00000000000000 7E4#4F00000000000000", true)] {
        let mut master = started(Service::IdentifyUnconfigured);
        play(&mut master, at(0), "7E5#4C00000000000000");
        master.handle_timeout(at(100));
        play(&mut master, at(100), "7E5#5100000000800000");
        play(&mut master, at(105), answers);
        master.handle_timeout(at(199));
        assert_eq!(master.poll(), None);
        master.handle_timeout(at(200));
        assert_eq!(master.poll(), Some(Ok(Answer::Unconfigured(any))));
    }
}

#[test]
fn a_scan_that_nobody_owns_up_to_fails() {
    let mut master = started(Service::Fastscan);
    play(&mut master, at(0), "7E5#5100000000800000 7E4#4F00000000000000");
    let mut millis = 0;
    // A question out of turn, 32 bits and their confirmation.
    for question in 0..34 {
        millis += 100;
        master.handle_timeout(at(millis));
        if question == 33 {
            // The confirmation waits for late answers.
            assert!(master.poll_transmit(at(millis)).is_none());
            millis += 100;
            master.handle_timeout(at(millis));
        }
        assert!(master.poll_transmit(at(millis)).is_some());
    }
    master.handle_timeout(at(millis + 100));
    let error = LssError::Vanished { part: Part::Vendor, number: u32::MAX };
    assert_eq!(master.poll(), Some(Err(error)));
}

#[test]
fn one_service_at_a_time() {
    let mut master = started(Service::Store);
    let busy = |service| Err(Busy { service });
    let inquire = Service::InquireNodeId;
    assert_eq!(master.start(inquire, TIME_OUT, at(0)), busy(Service::Store));
    play(&mut master, at(0), "7E5#1700000000000000 7E4#1700000000000000");
    assert_eq!(master.start(inquire, TIME_OUT, at(0)), busy(inquire));
    assert_eq!(master.poll(), Some(Ok(Answer::Done)));
    assert_eq!(master.start(inquire, TIME_OUT, at(0)), Ok(()));
}

#[test]
fn the_late_answer_to_an_earlier_inquiry_is_not_that_of_the_next() {
    // Node 3 answered too late, and node 5 is asked.
    let mut master = started(Service::InquireNodeId);
    play(
        &mut master,
        at(0),
        "7E5#5E00000000000000 7E4#5E03000000000000 7E5#5E00000000000000 7E4#5E05000000000000
         7E5#5E00000000000000 7E4#5E05000000000000",
    );
    assert_eq!(master.poll(), Some(Ok(Answer::NodeId(NodeId::new(5)))));
    // The vendor-ID of another slave.
    let mut master = started(Service::InquireIdentity);
    play(
        &mut master,
        at(0),
        "7E5#5A00000000000000 7E4#5A12000000000000 7E5#5A00000000000000 7E4#5AFB000000000000
         7E5#5A00000000000000 7E4#5AFB000000000000 7E5#5B00000000000000 7E4#5AFB000000000000
         7E4#5B00005265000000 7E5#5B00000000000000 7E4#5B00005265000000
         7E5#5C00000000000000 7E4#5C00007001000000 7E5#5C00000000000000 7E4#5C00007001000000
         7E5#5D00000000000000 7E4#5D78563412000000 7E5#5D00000000000000 7E4#5D78563412000000",
    );
    assert_eq!(master.poll(), Some(Ok(Answer::Identity(IDENTITY))));
}

#[test]
fn answers_that_never_agree_fail_the_inquiry() {
    let mut master = started(Service::InquireNodeId);
    let dialogue: String = (1..=4).map(|node| format!("7E5#5E00000000000000 7E4#5E0{node}000000000000 ")).collect();
    play(&mut master, at(0), &dialogue);
    let service = Service::InquireNodeId;
    assert_eq!(master.poll(), Some(Err(LssError::Disagree { service })));
}
