//! One change of the host as a value: a knob and its new setting. All reading and setting of knobs is in this file.

use std::fmt;

use anyhow::{Context, bail, ensure};
use can::card;
use serde::{Deserialize, Serialize};

use super::admissible::Inadmissible;
use super::record::{Change, Record};
use super::tree::Tree;

/// Largest difference between a requested sample point and the sample point that a card's clock allows, as a share of
/// the bit time.
const SAMPLE_POINT_STEP: f64 = 0.02;

/// A setting of the host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Knob {
    /// A file of the kernel, by its path below `/proc` or `/sys`.
    Kernel(String),
    /// A whole file, by its path.
    File(String),
    /// Bit timing of a card, such as `500000 0.875`: bit rate, bit/s, and optional sample point. Without a sample
    /// point, the kernel chooses it.
    BitTiming(String),
    /// Time from bus-off to the restart of a card, ms; 0 means no automatic restart.
    RestartMs(String),
    /// State of a CAN interface: `up` or `down`.
    State(String),
}

/// A knob and its new setting.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Fix {
    pub knob: Knob,
    pub after: String,
}

impl fmt::Display for Knob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kernel(path) | Self::File(path) => write!(f, "{path}"),
            Self::BitTiming(interface) => write!(f, "bit rate of {interface}"),
            Self::RestartMs(interface) => write!(f, "restart-ms of {interface}"),
            Self::State(interface) => write!(f, "state of {interface}"),
        }
    }
}

impl fmt::Display for Fix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}", self.knob, shown(Some(&self.after)))
    }
}

impl Knob {
    /// Name of the interface that must go down for this knob to be set to `value`, if any.
    pub(super) fn takes_down(&self, value: &str) -> Option<&str> {
        match self {
            Self::BitTiming(interface) | Self::RestartMs(interface) => Some(interface),
            Self::State(interface) if value == "down" => Some(interface),
            _ => None,
        }
    }

    pub(super) fn to(self, after: impl Into<String>) -> Fix {
        Fix { knob: self, after: after.into() }
    }

    /// Present setting; `None` for a file that does not exist, and for a bit rate that was never set.
    pub(super) fn read(&self, tree: &Tree) -> anyhow::Result<Option<String>> {
        let card = |interface: &str| {
            of_host(tree)?;
            Ok::<_, anyhow::Error>(card::read(interface)?)
        };
        Ok(match self {
            Self::Kernel(path) => {
                let text = tree.whole(path).with_context(|| path.clone())?;
                let text = text.with_context(|| format!("{path} is not there"))?;
                Some(text.trim().to_owned())
            }
            Self::File(path) => tree.whole(path).with_context(|| path.clone())?,
            Self::BitTiming(interface) => {
                let card = card(interface)?;
                let point = f64::from(card.sample_point.unwrap_or(0)) / 1000.0;
                card.bitrate.map(|bitrate| format!("{bitrate} {point:.3}"))
            }
            Self::RestartMs(interface) => Some(card(interface)?.restart_ms.to_string()),
            Self::State(interface) => {
                of_host(tree)?;
                let up = card::is_up(interface)?;
                Some(if up { "up" } else { "down" }.to_owned())
            }
        })
    }

    /// Sets the knob to `value`, in the form that [`read`](Self::read) returns.
    fn write(&self, tree: &Tree, value: Option<&str>) -> anyhow::Result<()> {
        let none = card::Change::default();
        let (interface, change) = match (self, value) {
            (Self::File(path), value) => return tree.replace(path, value).with_context(|| path.clone()),
            (Self::Kernel(path), Some(value)) => return tree.set(path, value).with_context(|| path.clone()),
            (Self::BitTiming(interface), Some(value)) => {
                let (bitrate, point) = timing(value).context("no bit timing")?;
                // Sample point in tenths of a percent, below 1000.
                let point = point.map(|point| (point * 1000.0).round() as u32);
                let timing = Some((bitrate, point));
                (interface, card::Change { timing, ..none })
            }
            (Self::RestartMs(interface), Some(value)) => {
                let restart_ms = Some(value.parse().with_context(|| format!("{value}: no number"))?);
                (interface, card::Change { restart_ms, ..none })
            }
            (Self::State(interface), Some(value)) => (interface, card::Change { up: Some(value == "up"), ..none }),
            // An interface without a bit rate was down. The bit rate cannot be removed, so only the state is put back.
            (Self::BitTiming(interface), None) => (interface, card::Change { up: Some(false), ..none }),
            (Self::Kernel(_) | Self::RestartMs(_) | Self::State(_), None) => bail!("it cannot be without a value"),
        };
        // The receiver may be the controller of an arm.
        ensure!(
            !is_heard(tree, interface),
            "somebody receives on {interface} and would lose the bus: end what runs on it first"
        );
        of_host(tree)?;
        Ok(card::change(interface, &change)?)
    }

    /// Whether the setting `found` equals `wanted`. Sample points are compared with a tolerance.
    fn stands_at(&self, wanted: Option<&str>, found: Option<&str>) -> bool {
        let (Self::BitTiming(_), Some(wanted), Some(found)) = (self, wanted, found) else {
            return wanted == found;
        };
        let (Some((rate, point)), Some((at, sampled))) = (timing(wanted), timing(found)) else {
            return false;
        };
        let near = match (point, sampled) {
            (Some(point), Some(sampled)) => (point - sampled).abs() < SAMPLE_POINT_STEP,
            _ => true,
        };
        rate == at && near
    }
}

/// Bit rate, bit/s, and sample point of a [`Knob::BitTiming`]. A sample point of 0 is not set.
pub(super) fn timing(value: &str) -> Option<(u32, Option<f64>)> {
    let mut words = value.split(' ');
    let bitrate = words.next()?.parse().ok()?;
    let point = words.next().map(str::parse).transpose().ok()?;
    let valid = point.is_none_or(|point| (0.0..1.0).contains(&point)) && words.next().is_none();
    valid.then(|| (bitrate, point.filter(|&point| point > 0.0)))
}

/// Whether a socket receives on `interface`, or on all interfaces.
fn is_heard(tree: &Tree, interface: &str) -> bool {
    const LISTS: &str = "/proc/net/can";
    let lists = tree.names(LISTS).into_iter().filter(|name| name.starts_with("rcvlist_"));
    let mut texts = lists.filter_map(|name| tree.text(&format!("{LISTS}/{name}")));
    // The line of a receiver begins with its interface. The other lines are headings or name an interface without
    // receivers.
    texts.any(|text| {
        let mut devices = text.lines().filter_map(|line| line.split_whitespace().next());
        devices.any(|device| [interface, "any"].contains(&device))
    })
}

fn of_host(tree: &Tree) -> anyhow::Result<()> {
    ensure!(tree.is_host(), "a tree of files has no interfaces");
    Ok(())
}

/// Text of a setting in one line.
pub(super) fn shown(value: Option<&str>) -> String {
    value.map_or("nothing".to_owned(), |value| value.trim_end().replace('\n', "; "))
}

/// Applies `fix` and verifies the result by reading it back. Returns the change, or `None` if the knob had the setting
/// already.
///
/// The change is written to the record on the disk before it is made. A change that could not be undone is refused.
pub(super) fn apply(tree: &Tree, fix: &Fix, record: &mut Record) -> anyhow::Result<Option<Change>> {
    turn(tree, fix, record, Change::check)
}

fn turn(
    tree: &Tree,
    fix: &Fix,
    record: &mut Record,
    check: impl Fn(&Change) -> Result<(), Inadmissible>,
) -> anyhow::Result<Option<Change>> {
    let Fix { knob, after } = fix;
    let before = knob.read(tree)?;
    if knob.stands_at(Some(after), before.as_deref()) {
        return Ok(None);
    }
    let change = Change { knob: knob.clone(), before, after: after.clone() };
    check(&change).context("--undo could not put back the value found")?;
    record.push(change.clone())?;
    let written = knob.write(tree, Some(after));
    let found = knob.read(tree)?;
    if written.is_err() && knob.stands_at(change.before.as_deref(), found.as_deref()) {
        record.pop()?;
    }
    written?;
    if !knob.stands_at(Some(after), found.as_deref()) {
        let found = found.unwrap_or_default();
        // The kernel accepted another value than the requested one. That value is recorded, so that `--undo` can put
        // the old value back.
        record.amend(found.clone())?;
        bail!("it reads {}", shown(Some(&found)));
    }
    Ok(Some(change))
}

/// Puts back the setting from before `change`. Returns a remark if the setting cannot be restored completely.
pub(super) fn put_back(tree: &Tree, change: &Change) -> anyhow::Result<Option<&'static str>> {
    let Change { knob, before, after } = change;
    let (before, found) = (before.as_deref(), knob.read(tree)?);
    // The change was never made, or a restart of the host undid it.
    if knob.stands_at(before, found.as_deref()) {
        return Ok(None);
    }
    ensure!(knob.stands_at(Some(after), found.as_deref()), "changed by somebody since, to {}", shown(found.as_deref()));
    knob.write(tree, before)?;
    if let (Knob::BitTiming(_), None) = (knob, before) {
        return Ok(Some("the card is down, and keeps its bit rate until its driver is loaded anew"));
    }
    let found = knob.read(tree)?;
    ensure!(knob.stands_at(before, found.as_deref()), "it reads {}", shown(found.as_deref()));
    Ok(None)
}

#[cfg(test)]
mod tests;
