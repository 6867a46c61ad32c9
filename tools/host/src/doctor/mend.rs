//! `--fix` and `--undo`: asks for each finding, applies its changes, and undoes changes.

use std::io::{self, BufRead, Write};

use super::finding::Finding;
use super::fix::{apply, put_back, shown};
use super::record::Record;
use super::tree::Tree;
use mrroc::streams;

/// Applies the changes of all findings that `agreed` accepts, and reports each change on stderr.
///
/// A change that fails is reported, and the next change follows. Only a record that cannot be written ends the
/// sequence.
pub(super) fn fix(
    tree: &Tree,
    findings: &[Finding],
    record: &mut Record,
    mut agreed: impl FnMut(&Finding) -> io::Result<bool>,
) -> anyhow::Result<()> {
    let before = record.changes().len();
    for finding in findings.iter().filter(|finding| !finding.fixes.is_empty()) {
        if !agreed(finding)? {
            continue;
        }
        for fix in &finding.fixes {
            match apply(tree, fix, record) {
                Ok(None) => {}
                Ok(Some(change)) => {
                    streams::warn(format_args!("set {fix}, before {}", shown(change.before.as_deref())));
                }
                Err(error) => streams::warn(format_args!("not set: {fix}: {error:#}")),
            }
        }
    }
    if record.changes().len() > before {
        let path = record.path().display();
        streams::warn(format_args!("`mrroc doctor --undo --state {path}` puts it back"));
    }
    Ok(())
}

/// Asks for consent on the terminal.
pub(super) fn asked(finding: &Finding) -> io::Result<bool> {
    write!(io::stderr(), "{}", streams::plain(question(finding)))?;
    io::stderr().flush()?;
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}

fn question(finding: &Finding) -> String {
    let Finding { of, what, read, why, fixes, .. } = finding;
    let sets: String = fixes.iter().map(|fix| format!("  set: {fix}\n")).collect();
    let down = fixes.iter().find_map(|fix| fix.knob.takes_down(&fix.after));
    let down = down.map(|interface| format!("  {interface} goes down for it: nothing may run on its bus\n"));
    let down = down.unwrap_or_default();
    format!("\n{of}: {what}: {read}\n  why: {why}\n{sets}{down}Set it? [y/N] ")
}

/// Undoes all changes in the record, the latest first. Returns the number of changes that could not be undone; these
/// stay in the record.
pub(super) fn undo(tree: &Tree, record: &mut Record) -> anyhow::Result<usize> {
    let mut left = 0;
    for index in (0..record.changes().len()).rev() {
        let change = record.changes()[index].clone();
        let before = shown(change.before.as_deref());
        match put_back(tree, &change) {
            Ok(word) => {
                let word = word.map_or(String::new(), |word| format!(": {word}"));
                record.remove(index)?;
                streams::say(format_args!("put back {} = {before}{word}", change.knob))?;
            }
            Err(error) => {
                left += 1;
                streams::say(format_args!("left {}, which was {before}: {error:#}", change.knob))?;
            }
        }
    }
    Ok(left)
}

#[cfg(test)]
mod tests {
    use super::super::finding::Verdict;
    use super::super::fix::Knob;
    use super::*;

    #[test]
    fn who_is_asked_is_told_that_the_bus_goes_down() {
        let can = || "can0".to_owned();
        let table = [
            (Knob::BitTiming(can()).to("500000"), true),
            (Knob::RestartMs(can()).to("100"), true),
            (Knob::State(can()).to("down"), true),
            (Knob::State(can()).to("up"), false),
            (Knob::Kernel("/sys/class/net/can0/tx_queue_len".into()).to("128"), false),
        ];
        for (fix, down) in table {
            let finding = Finding::new("bus", "x", "y", "z").judged(Verdict::Warning, "m");
            let finding = finding.fixed_by([fix.clone()]);
            let asked = question(&finding);
            assert!(asked.contains(&format!("set: {fix}\n")), "{asked}");
            assert_eq!(asked.contains("can0 goes down for it"), down, "{asked}");
        }
    }
}
