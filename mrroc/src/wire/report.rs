//! The report on the timing of the wire: one JSON object per bus, or a table.

use std::fmt;

use serde::Serialize;

use crate::report::{Percentiles, counted_as};

/// Source of the times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// The virtual bus, exact to the bit. Its time waits for the host, so delays of the host are not visible.
    Virtual,
    /// Time stamps of the kernel.
    Kernel,
    /// Time stamps of the CAN card.
    Hardware,
}

/// The moment at which a SYNC of this host is stamped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SyncStamp {
    /// When the bus has carried the frame.
    Sent,
    /// When the driver takes the frame. The frame's wait for the bus is then part of the times to the answers.
    HandedOver,
}

/// Timing of one bus. Each time is between the ends of two frames.
#[derive(Debug, Serialize)]
pub struct WireReport {
    /// Name of the bus.
    pub bus: String,
    /// Source of the times; null where frames have no time stamps.
    pub source: Option<Source>,
    /// The moment at which SYNC is stamped; null without a source.
    pub sync_stamp: Option<SyncStamp>,
    /// Time between two successive SYNCs, µs; null with less than two.
    pub sync_to_sync_us: Option<Percentiles>,
    /// Absolute deviation of that time from the period, µs.
    pub sync_off_period_us: Option<Percentiles>,
    /// All drives, in the order of the cell; empty without measurements.
    pub nodes: Vec<NodeReport>,
    /// Frames that were not read in time. Such a frame may cause a SYNC to seem missing or unanswered.
    pub lost_frames: u64,
}

/// The answers of one drive.
#[derive(Debug, Serialize)]
pub struct NodeReport {
    /// Names of robot and axis.
    pub axis: String,
    /// Its node-ID.
    pub node: u8,
    /// Time from SYNC to the answer, µs; null without answers.
    pub sync_to_tpdo_us: Option<Percentiles>,
    /// SYNCs without an answer.
    pub unanswered: u64,
    /// Answers that came after the next SYNC and were recognised as late.
    pub late: u64,
    /// Answers without a SYNC.
    pub surplus: u64,
}

impl fmt::Display for WireReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(source) = self.source else {
            let bus = &self.bus;
            return writeln!(f, "\nbus {bus}: times on the wire not measured, nothing here tells them");
        };
        let by = match source {
            Source::Virtual => "on the virtual bus",
            Source::Kernel => "by the kernel's stamps",
            Source::Hardware => "by the card's stamps",
        };
        let title = match self.sync_stamp {
            Some(SyncStamp::HandedOver) => format!("bus {} {by}, SYNC as handed over, µs", self.bus),
            _ => format!("bus {} {by}, µs", self.bus),
        };
        let answers = self.nodes.iter().map(|node| {
            let counts = [(node.unanswered, "unanswered"), (node.late, "late"), (node.surplus, "surplus")];
            let counts = counts.iter().filter(|(count, _)| *count > 0);
            let counts: String = counts.map(|(count, what)| format!("  {count} {what}")).collect();
            let name = format!("SYNC to {}", node.axis);
            (name, node.sync_to_tpdo_us, counts)
        });
        let syncs = [
            ("SYNC to SYNC".to_owned(), self.sync_to_sync_us),
            ("SYNC off the period".to_owned(), self.sync_off_period_us),
        ];
        let rows: Vec<_> = syncs.map(|(name, times)| (name, times, String::new())).into_iter().chain(answers).collect();
        let names = rows.iter().map(|(name, ..)| name).chain([&title]);
        let names = names.map(|name| name.chars().count()).max().unwrap_or(0);
        writeln!(f, "\n{title:names$} {}", Percentiles::HEAD)?;
        for (name, times, counts) in rows {
            let none = || format!("{:>11}", "-").repeat(4);
            let times = times.map_or_else(none, |times| format!(" {times}"));
            writeln!(f, "{name:names$}{times}{counts}")?;
        }
        match self.lost_frames {
            0 => Ok(()),
            lost => writeln!(f, "{} lost to this table", counted_as(lost, "frame was", "frames were")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bus(source: Option<Source>, sync_stamp: Option<SyncStamp>) -> WireReport {
        let times = |us: f64| Some(Percentiles { p50: us, p99: us + 1.0, p999: us + 2.0, max: us + 3.0 });
        let node = |axis: &str, sync_to_tpdo_us, [unanswered, late, surplus]: [u64; 3]| NodeReport {
            axis: axis.to_owned(),
            node: 1,
            sync_to_tpdo_us,
            unanswered,
            late,
            surplus,
        };
        WireReport {
            bus: "arm".to_owned(),
            source,
            sync_stamp,
            sync_to_sync_us: times(2000.0),
            sync_off_period_us: times(0.5),
            nodes: vec![
                node("column", times(120.0), [0, 0, 0]),
                node("wrist", times(240.0), [3, 2, 1]),
                node("hand", None, [9, 0, 0]),
            ],
            lost_frames: 0,
        }
    }

    #[test]
    fn a_table_has_a_row_per_drive_and_says_what_is_not_as_it_should_be() {
        let table = bus(Some(Source::Hardware), Some(SyncStamp::Sent)).to_string();
        assert_eq!(
            table,
            "\n\
             bus arm by the card's stamps, µs        p50        p99      p99.9        max\n\
             SYNC to SYNC                         2000.0     2001.0     2002.0     2003.0\n\
             SYNC off the period                     0.5        1.5        2.5        3.5\n\
             SYNC to column                        120.0      121.0      122.0      123.0\n\
             SYNC to wrist                         240.0      241.0      242.0      243.0  3 unanswered  2 late  1 surplus\n\
             SYNC to hand                              -          -          -          -  9 unanswered\n"
        );
    }

    #[test]
    fn whose_stamps_they_are_is_in_the_title() {
        for (source, stamp, title) in [
            (Source::Virtual, SyncStamp::Sent, "on the virtual bus, µs"),
            (Source::Kernel, SyncStamp::Sent, "by the kernel's stamps, µs"),
            (Source::Kernel, SyncStamp::HandedOver, "by the kernel's stamps, SYNC as handed over, µs"),
        ] {
            let table = bus(Some(source), Some(stamp)).to_string();
            assert!(table.starts_with(&format!("\nbus arm {title} ")), "{table}");
        }
        let lost = WireReport { lost_frames: 7, ..bus(Some(Source::Kernel), Some(SyncStamp::Sent)) };
        assert!(lost.to_string().ends_with("7 frames were lost to this table\n"));
        assert!(bus(None, None).to_string().contains("bus arm: times on the wire not measured"));
    }
}
