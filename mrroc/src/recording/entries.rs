//! The messages of a recording in their types.

use can::TraceEntry;
use prost::Message;
use serial::LineEntry;

use super::content::{Content, Stored};
use super::messages::{BusEvent, Call, LineData, Lost, RobotOrder, Word};
use super::sources::Layout;

/// A recorded message in its own type.
pub(super) enum Entry {
    Call(Call),
    Order(RobotOrder),
    Word(Word),
    Lost(Lost),
    Bus(usize, TraceEntry),
    Line(usize, LineEntry),
    /// A cycle of a robot, a fault or a timing.
    Other,
}

impl Entry {
    /// The message `message`; what is wrong with it otherwise.
    fn of(layout: &Layout, message: &Stored) -> Result<Self, String> {
        let (channel, now, body) = (message.channel, message.time, message.body.as_slice());
        let invalid = |error: prost::DecodeError| error.to_string();
        let unknown = || "unknown contents".to_owned();
        Ok(if usize::from(channel) >= layout.channels().len() {
            return Err("the channel is not declared".to_owned());
        } else if channel == layout.calls() {
            Self::Call(Call::decode(body).map_err(invalid)?)
        } else if channel == layout.orders() {
            let order = RobotOrder::decode(body).map_err(invalid)?;
            order.order().ok_or_else(unknown)?;
            Self::Order(order)
        } else if channel == layout.words() {
            Self::Word(Word::decode(body).map_err(invalid)?)
        } else if channel == layout.lost() {
            Self::Lost(Lost::decode(body).map_err(invalid)?)
        } else if channel >= layout.line(0) {
            let entry = LineData::decode(body).map_err(invalid)?.entry(now).ok_or_else(unknown)?;
            Self::Line(usize::from(channel - layout.line(0)), entry)
        } else if channel >= layout.bus(0) {
            let entry = BusEvent::decode(body).map_err(invalid)?.entry(now).ok_or_else(unknown)?;
            Self::Bus(usize::from(channel - layout.bus(0)), entry)
        } else {
            Self::Other
        })
    }
}

/// The messages in their types. A message that cannot be decoded damages its chunk.
///
/// Of an incomplete recording, the last messages of some channels may be missing. The messages therefore end before the
/// last drain of the queues. A drain writes the journal of the servo, then buses and lines, and then cycles of robots.
pub(super) fn entries(layout: &Layout, content: &mut Content) -> Vec<(Stored, Entry)> {
    let mut entries = Vec::with_capacity(content.messages.len());
    for message in &content.messages {
        match Entry::of(layout, message) {
            Ok(entry) => entries.push(entry),
            Err(what) => {
                let topic = content.channels.get(&message.channel).map_or("an unknown channel", |(topic, _)| topic);
                let (byte, what) = (message.chunk, format!("a message of {topic}: {what}"));
                content.damage_at(byte, what);
                break;
            }
        }
    }
    if !content.complete {
        let is_journal = |message: &Stored| message.channel < layout.robot(0) && message.channel != layout.lost();
        let last = content.messages.windows(2).rposition(|pair| !is_journal(&pair[0]) && is_journal(&pair[1]));
        content.messages.truncate(last.map_or(0, |last| last + 1));
    }
    // The entries of dropped messages are dropped.
    std::mem::take(&mut content.messages).into_iter().zip(entries).collect()
}
