//! The messages of a recording in their types.

use std::collections::BTreeMap;

use can::TraceEntry;
use prost::Message;
use serial::LineEntry;

use super::messages::{BusEvent, Call, LineData, Lost, RobotOrder, Word};
use super::reader::{Damage, Stored};
use super::sources::Layout;

/// A recorded message in its own type.
pub(super) enum Entry {
    Call(Call),
    Order(RobotOrder),
    Word(Word),
    Lost(Lost),
    Bus(usize, TraceEntry),
    Line(usize, LineEntry),
    /// A cycle of a robot, a fault, a sample of a device or a timing.
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
        } else if channel >= layout.device(0) {
            Self::Other
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

/// The messages of a chunk in their types. A message that cannot be decoded damages its chunk.
pub(super) fn entries(
    layout: &Layout,
    channels: &BTreeMap<u16, (String, String)>,
    messages: Vec<Stored>,
) -> Result<Vec<(Stored, Entry)>, Damage> {
    let typed = messages.into_iter().map(|message| match Entry::of(layout, &message) {
        Ok(entry) => Ok((message, entry)),
        Err(what) => {
            let topic = channels.get(&message.channel).map_or("an unknown channel", |(topic, _)| topic);
            Err(Damage { byte: message.chunk, what: format!("a message of {topic}: {what}") })
        }
    });
    typed.collect()
}
