//! Emergency stop by an input of an I/O node, from the terminal of the node to the drives.

use ::mrroc::bench::BenchKind;
use ::mrroc::cell::{CellFile, EmergencyContact, InputLine};
use ::mrroc::prelude::*;
use ::mrroc::report::RunReport;
use kit::mrroc::Directory;

const ASIDE: [[f64; 5]; 2] = [[0.6, -1.571, 0.0, 0.0, 0.0], [-0.6, -1.571, 0.0, 0.0, 0.0]];

/// The cell of the IRb-6 with an I/O node, and a contact that changes at `edges`, s since power-on.
fn cell(edges: &[f64]) -> CellFile {
    let directory = Directory::new();
    let cell = directory.cell("irb6-touch", |cell| {
        cell.io[0].input.push(InputLine {
            name: "red-button".into(),
            line: 5,
            inverted: false,
            emergency_stop: true,
            filtered: false,
            emulated_edges_s: edges.to_vec(),
        });
    });
    CellFile::read(cell).unwrap()
}

/// Moves until the emergency stop, and then resets and moves again. A reset fails while the contact is open.
async fn recover(cell: &mut Cell) -> Outcome {
    let mut irb6 = cell.robot("irb6")?;
    irb6.enable().await?;
    irb6.home().await?;
    cell.end_rehearsal("a rehearsal has no emergency stop")?;
    while irb6.execute(irb6.motions().joints(0.5, &ASIDE)?).await.is_ok() {}
    let mut refused = 0.0;
    while irb6.reset_fault().await.is_err() {
        refused += 1.0;
        cell.sleep(Duration::from_millis(200)).await;
    }
    cell.figure("refused_resets", refused);
    irb6.enable().await?;
    irb6.execute(irb6.motions().joints(0.5, &[ASIDE[0]])?).await?;
    irb6.disable().await
}

/// The same arm with the contact at a digital input of the wrist's drive.
fn with_drive(edges: &[f64]) -> CellFile {
    let directory = Directory::new();
    let cell = directory.cell("irb6", |cell| {
        let axis = &mut cell.robot[0].axis[4];
        let contact = EmergencyContact { input: 16, emulated_edges_s: edges.to_vec() };
        axis.drive.as_mut().expect("a drive on CAN").emergency_stop = Some(contact);
    });
    CellFile::read(cell).unwrap()
}

fn first_fault(report: &RunReport) -> (&str, Option<u8>) {
    let fault = report.faults.iter().chain(&report.recovered).next().expect("a fault");
    (&fault.what, fault.stop_category.map(u8::from))
}

#[test]
fn an_open_contact_stops_the_arm_and_a_closed_one_allows_a_reset() {
    let report = ::mrroc::run(&cell(&[0.0, 20.0, 23.0]), BenchKind::Lockstep, recover).unwrap();
    let told: Vec<_> = report.faults.iter().chain(&report.recovered).map(|fault| (&fault.what, fault.place)).collect();
    assert_eq!(report.outcome, RunOutcome::Completed, "{told:?} {:?}", report.figures);
    let what = "input red-button of I/O node tool: emergency stop by input 5 of node 40: the contact is open";
    assert_eq!(first_fault(&report), (what, Some(1)));
    assert!(report.figures["refused_resets"] >= 1.0, "{:?}", report.figures);
}

#[test]
fn a_contact_that_is_open_from_the_beginning_keeps_the_arm_off() {
    let report = ::mrroc::run(&cell(&[]), BenchKind::Lockstep, recover).unwrap();
    assert_eq!(report.outcome, RunOutcome::Faulted);
    assert!(first_fault(&report).0.contains("the contact is open"), "{:?}", report.faults);
}

#[test]
fn a_contact_at_a_drive_stops_the_arm_and_allows_a_reset_after_it_is_closed() {
    let report = ::mrroc::run(&with_drive(&[20.0, 23.0]), BenchKind::Lockstep, recover).unwrap();
    let told: Vec<_> = report.faults.iter().chain(&report.recovered).map(|fault| (&fault.what, fault.place)).collect();
    assert_eq!(report.outcome, RunOutcome::Completed, "{told:?} {:?}", report.figures);
    let what = "wrist-roll: emergency stop by input 16 of node 5: the contact is open";
    assert_eq!(first_fault(&report), (what, Some(1)));
    assert!(report.figures["refused_resets"] >= 1.0, "{:?}", report.figures);
}
