//! One change of the host as a value: which knob, and what it is set to. Here alone are knobs read and turned.

use std::fmt;

use anyhow::{Context, bail, ensure};
use can::card;
use serde::{Deserialize, Serialize};

use super::admissible::Inadmissible;
use super::record::{Change, Record};
use super::tree::Tree;

/// Two sample points that a card's clock may make of one, shares of the bit.
const SAMPLE_POINT_STEP: f64 = 0.02;

/// Something that can be set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Knob {
    /// A value that the kernel keeps, by its path below `/proc` or `/sys`.
    Kernel(String),
    /// A whole file, by its path.
    File(String),
    /// Of a card: `500000 0.875`, its bit rate, bit/s, and its sample point, which may be left to the kernel.
    BitTiming(String),
    /// Of a card: the time from bus-off to the restart, ms; 0 for never.
    RestartMs(String),
    /// Of a CAN interface: `up` or `down`.
    State(String),
}

/// A knob and what it is set to.
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
    /// The interface that goes down for it to be set to `value`.
    pub(super) fn takes_down(&self, value: &str) -> Option<&str> {
        match self {
            Self::BitTiming(interface) | Self::RestartMs(interface) => Some(interface),
            Self::State(interface) if value == "down" => Some(interface),
            _ => None,
        }
    }

    pub(super) fn to(self, after: impl Into<String>) -> Fix {
        Fix {
            knob: self,
            after: after.into(),
        }
    }

    /// What it stands at; none for a file that is not there and a bit rate that was never set.
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

    /// Sets it to `value`, as [`read`](Self::read) returned it.
    fn write(&self, tree: &Tree, value: Option<&str>) -> anyhow::Result<()> {
        let change = |interface: &str, change: card::Change| {
            unheard(tree, interface)?;
            of_host(tree)?;
            Ok(card::change(interface, &change)?)
        };
        let number = |text: &str| text.parse().with_context(|| format!("{text}: no number"));
        match (self, value) {
            (Self::File(path), value) => tree.replace(path, value).with_context(|| path.clone()),
            (Self::Kernel(path), Some(value)) => {
                tree.set(path, value).with_context(|| path.clone())
            }
            (Self::BitTiming(interface), Some(value)) => {
                let (bitrate, point) = timing(value).context("no bit rate")?;
                // Tenths of a percent, below 1000.
                let point = point.map(|point| (point * 1000.0).round() as u32);
                change(
                    interface,
                    card::Change {
                        timing: Some((bitrate, point)),
                        ..card::Change::default()
                    },
                )
            }
            (Self::RestartMs(interface), Some(value)) => change(
                interface,
                card::Change {
                    restart_ms: Some(number(value)?),
                    ..card::Change::default()
                },
            ),
            (Self::State(interface), Some(value)) => change(
                interface,
                card::Change {
                    up: Some(value == "up"),
                    ..card::Change::default()
                },
            ),
            // Before it had a bit rate it was down, and that is what can be put back.
            (Self::BitTiming(interface), None) => change(
                interface,
                card::Change {
                    up: Some(false),
                    ..card::Change::default()
                },
            ),
            (Self::Kernel(_) | Self::RestartMs(_) | Self::State(_), None) => {
                bail!("it cannot be without a value")
            }
        }
    }

    /// Whether a knob at `found` stands at `wanted`.
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

/// Bit rate and sample point of a [`Knob::BitTiming`].
fn timing(value: &str) -> Option<(u32, Option<f64>)> {
    let mut words = value.split(' ');
    let bitrate = words.next()?.parse().ok()?;
    let point = words.next().map(str::parse).transpose().ok()?;
    let point = point.filter(|&point| point > 0.0 && point < 1.0);
    Some((bitrate, point))
}

/// Refuses an interface on which another process receives, such as the controller of an arm.
fn unheard(tree: &Tree, interface: &str) -> anyhow::Result<()> {
    ensure!(
        !is_heard(tree, interface),
        "somebody receives on {interface} and would lose the bus: end what runs on it first"
    );
    Ok(())
}

/// Whether a socket receives on `interface`, or on all there are.
fn is_heard(tree: &Tree, interface: &str) -> bool {
    const LISTS: &str = "/proc/net/can";
    let names = tree.names(LISTS).into_iter();
    let lists = names.filter(|name| name.starts_with("rcvlist_"));
    let mut texts = lists.filter_map(|name| tree.text(&format!("{LISTS}/{name}")));
    // A receiver's line is its device and numbers; others say that a device has none, or name the columns.
    texts.any(|text| {
        let mut devices = text
            .lines()
            .filter_map(|line| line.split_whitespace().next());
        devices.any(|device| [interface, "any"].contains(&device))
    })
}

fn of_host(tree: &Tree) -> anyhow::Result<()> {
    ensure!(tree.is_host(), "a tree of files has no interfaces");
    Ok(())
}

/// A value in one line.
pub(super) fn shown(value: Option<&str>) -> String {
    value.map_or("nothing".to_owned(), |value| {
        value.trim_end().replace('\n', "; ")
    })
}

/// Applies `fix` and reads it back; returns what was there before, none where nothing had to be done.
///
/// The change is in the record, on the disk, before it is made, and is one that can be put back.
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
    let change = Change {
        knob: knob.clone(),
        before,
        after: after.clone(),
    };
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
        // What the kernel made of it is ours all the same, and to be put back.
        record.amend(found.clone())?;
        bail!("it reads {}", shown(Some(&found)));
    }
    Ok(Some(change))
}

/// Puts back what was there before `change`; returns a word on what cannot be.
pub(super) fn put_back(tree: &Tree, change: &Change) -> anyhow::Result<Option<&'static str>> {
    let Change {
        knob,
        before,
        after,
    } = change;
    let (before, found) = (before.as_deref(), knob.read(tree)?);
    // It was never made, or the host was started since.
    if knob.stands_at(before, found.as_deref()) {
        return Ok(None);
    }
    ensure!(
        knob.stands_at(Some(after), found.as_deref()),
        "changed by somebody since, to {}",
        shown(found.as_deref())
    );
    knob.write(tree, before)?;
    if let (Knob::BitTiming(_), None) = (knob, before) {
        return Ok(Some(
            "the card is down, and keeps its bit rate until its driver is loaded anew",
        ));
    }
    let found = knob.read(tree)?;
    ensure!(
        knob.stands_at(before, found.as_deref()),
        "it reads {}",
        shown(found.as_deref())
    );
    Ok(None)
}

#[cfg(test)]
mod tests;
