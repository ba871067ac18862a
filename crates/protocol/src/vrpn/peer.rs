//! What one client has said of itself, and what it is answered.

use std::collections::BTreeMap;

use posed_drivers::vrpn::wire::{self, From, Message, Refused, system, types};

use super::{Catalogue, PONG};

/// One client: its numbers for types and senders, which have nothing to do with ours.
#[derive(Clone, Debug, Default)]
pub struct Peer {
    types: BTreeMap<i32, String>,
    senders: BTreeMap<i32, String>,
}

impl Peer {
    /// Takes a message; what is to be answered is appended to `out`. What is not understood is passed over.
    ///
    /// # Errors
    /// The client is not to be served any longer: it asks for a log file, or a number or a name that it describes is out of
    /// range.
    pub fn take(
        &mut self,
        message: Message<'_>,
        catalogue: &Catalogue,
        out: &mut Vec<u8>,
    ) -> Result<(), Refused> {
        match message.kind {
            system::SENDER => self.senders.extend([message.description()?]),
            system::TYPE => self.types.extend([message.description()?]),
            system::LOG => return Err(Refused::Log),
            kind if self.types.get(&kind).is_some_and(|name| name == types::PING) => {
                // A name that is not here gets no answer, so that the client's operator is warned.
                let requested = self.senders.get(&message.sender).and_then(|name| catalogue.number(name));
                if let Some(sender) = requested {
                    let from = From { sender, kind: PONG, utc_ns: catalogue.epoch_utc_ns };
                    wire::message(from, &[], out);
                }
            }
            _ => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pings_of_known_trackers_are_answered_and_logs_refused() {
        let catalogue = Catalogue::new(["a", "b"], 0);
        let mut peer = Peer::default();
        let mut emitted = Vec::new();
        wire::description(system::SENDER, 7, "b", 0, &mut emitted);
        wire::description(system::SENDER, 8, "c", 0, &mut emitted);
        wire::description(system::TYPE, 3, types::PING, 0, &mut emitted);
        for sender in [7, 8, 9] {
            wire::message(From { sender, kind: 3, utc_ns: 0 }, &[], &mut emitted);
        }
        wire::message(From { sender: 1, kind: 5, utc_ns: 0 }, b"what nobody knows", &mut emitted);
        let mut messages = wire::Messages::default();
        messages.push(&emitted);
        let mut out = Vec::new();
        while let Some(message) = messages.find().unwrap() {
            peer.take(message, &catalogue, &mut out).unwrap();
        }
        let mut pong = Vec::new();
        wire::message(From { sender: 1, kind: PONG, utc_ns: 0 }, &[], &mut pong);
        assert_eq!(out, pong);
        let log = Message { offset: 0, utc_us: 0, sender: 3, kind: system::LOG, payload: &[] };
        assert_eq!(peer.take(log, &catalogue, &mut out), Err(Refused::Log));
        let bad = Message {
            offset: 0,
            utc_us: 0,
            sender: 2000,
            kind: system::TYPE,
            payload: &[0, 0, 0, 2, b'x', 0],
        };
        assert_eq!(peer.take(bad, &catalogue, &mut out), Err(Refused::Malformed));
    }
}
