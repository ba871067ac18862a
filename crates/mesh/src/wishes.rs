//! What hubs want of this stage's states. Each says so by a liveliness token below `KEY/posed-wish`, which goes when the hub goes.
//!
//! In: tokens. Out: whether a frame is due, and how much of it: each is written once for all hubs, at the highest rate and with the union of
//! the fields that any of them wants. Never: a wish that cannot be read, or a rate that is none.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use super::feed::Feed;
use super::wire::Keys;
use posed_protocol::{Fields, LinkState, Rate, STREAMS, Selection, Stamp, Status, Topic, Wish};

/// Wishes that are kept apart; where there are more, all is sent until they are gone.
const WISHES: usize = 256;
/// Bytes of a token; no hub declares a longer one.
const BYTES: usize = 4096;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Wishes {
    wished: Mutex<Wished>,
}

#[derive(Debug, Default)]
struct Wished {
    by_token: BTreeMap<String, Wish>,
    /// More tokens have come than are kept.
    overflowed: bool,
    /// The union.
    all: Wish,
    rates: [Option<Rate>; STREAMS],
}

/// What a hub's list says of a status.
#[derive(Debug, PartialEq)]
pub(super) struct Health {
    devices: Vec<LinkState>,
    problems: Vec<String>,
}

impl Health {
    pub(super) fn of(status: &Status) -> Self {
        let devices = status.devices.iter().map(|device| device.state).collect();
        Self { devices, problems: status.problems.iter().map(|problem| problem.code.clone()).collect() }
    }
}

/// Looks for wishes, as long as what it gives is kept.
pub(super) fn look(session: &Session, keys: &Keys, feed: &Feed) -> zenoh::Result<Subscriber<()>> {
    let feed = feed.clone();
    let see = move |sample: Sample| feed.wishes().see(sample.key_expr().as_str(), sample.kind());
    session.liveliness().declare_subscriber(keys.wishes()).history(true).callback(see).wait()
}

impl Wishes {
    /// A token has come or gone.
    fn see(&self, token: &str, kind: SampleKind) {
        match (kind, Keys::wish_of(token)) {
            (SampleKind::Delete, _) => self.put(token, None),
            (SampleKind::Put, Some(wish)) if token.len() <= BYTES => self.put(token, Some(wish)),
            (SampleKind::Put, _) => tracing::debug!("zenoh: no wish: {token:.128}"),
        }
    }

    /// Somebody wants this, or nothing any more.
    pub(super) fn put(&self, who: &str, wish: Option<Wish>) {
        let mut wished = self.lock();
        match wish {
            None => _ = wished.by_token.remove(who),
            Some(wish) if wished.by_token.len() < WISHES => _ = wished.by_token.insert(who.to_owned(), wish),
            Some(_) => wished.overflowed = true,
        }
        wished.overflowed &= !wished.by_token.is_empty();
        let mut all = Wish::default();
        wished.by_token.values().for_each(|wish| all.join(wish));
        if wished.overflowed {
            Topic::ALL.into_iter().for_each(|topic| all.add(topic, None));
            all.select(Fields::all(), None);
        }
        for topic in Topic::ALL {
            let rate_hz = all.max_rate_hz(topic);
            // Another hub with the same wish changes nothing.
            if rate_hz != wished.all.max_rate_hz(topic) {
                let rate = rate_hz.map(|rate_hz| Rate::every(1e6 / rate_hz));
                topic.streams().for_each(|stream| wished.rates[stream] = rate);
            }
        }
        wished.all = all;
    }

    /// Whether states of a topic are wanted.
    pub(super) fn has(&self, topic: Topic) -> bool {
        self.lock().all.has(topic)
    }

    /// Writes a frame that is wanted now.
    pub(super) fn due<T>(&self, stamp: &Stamp, write: impl FnOnce(&Selection) -> T) -> Option<T> {
        let mut wished = self.lock();
        let Wished { all, rates, .. } = &mut *wished;
        let is_due = rates[stamp.stream()].as_mut().is_none_or(|rate| rate.is_due(stamp.t_us as f64));
        (all.has(stamp.topic) && is_due).then(|| write(all.selection()))
    }

    fn lock(&self) -> MutexGuard<'_, Wished> {
        // Every change is complete before anything in it could panic.
        self.wished.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_protocol::Field;

    fn wish(rate_hz: f64, field: Field) -> Wish {
        let mut wish = Wish::default();
        wish.add(Topic::Sensors, Some(rate_hz));
        wish.select(Fields::of(&[field]), None);
        wish
    }

    /// Frames of a second of 100 Hz that go out.
    fn sent(wishes: &Wishes) -> usize {
        let stamp = |n: i64| Stamp {
            topic: Topic::Sensors,
            body: 0,
            t_us: n * 10_000,
            event_id: None,
            timecode: None,
        };
        (0..100).filter(|n| wishes.due(&stamp(*n), |_| ()).is_some()).count()
    }

    #[test]
    fn frames_go_out_as_often_as_somebody_wants_them_and_stop_with_the_last() {
        let (wishes, keys) = (Wishes::default(), Keys::new("posed/a"));
        assert_eq!(sent(&wishes), 0);
        let tokens = [("one", 20.0, Field::PositionM), ("two", 50.0, Field::Measured)]
            .map(|(hub, rate_hz, field)| keys.wish(hub, &wish(rate_hz, field)));
        for (token, expected) in tokens.iter().zip([20, 50]) {
            wishes.see(token, SampleKind::Put);
            assert_eq!(sent(&wishes), expected);
        }
        let stamp =
            Stamp { topic: Topic::Sensors, body: 0, t_us: 10_000_000, event_id: None, timecode: None };
        let fields = wishes.due(&stamp, |selection| selection.fields).unwrap();
        assert!(
            fields.has(Field::PositionM) && fields.has(Field::Measured) && !fields.has(Field::Covariance)
        );
        let body = Stamp { topic: Topic::Body, ..stamp };
        assert_eq!(wishes.due(&body, |_| ()), None, "nobody wants bodies");
        wishes.see(&tokens[1], SampleKind::Delete);
        // As a stage that is played again.
        wishes.see(&tokens[0], SampleKind::Put);
        assert_eq!(wishes.lock().all.max_rate_hz(Topic::Sensors), Some(20.0));
        wishes.see(&tokens[0], SampleKind::Delete);
        assert_eq!(sent(&wishes), 0);
    }

    #[test]
    fn garbage_on_the_wish_key_is_passed_over_and_wishes_without_end_keep_no_hub_out() {
        let (wishes, keys) = (Wishes::default(), Keys::new("posed/a"));
        let rate_0 = r#"{"topics":{"sensors":0.0}}"#;
        for garbage in
            ["", "x", "{}", rate_0, &"[".repeat(100_000), &format!("{{\"topics\":{{}}{}}}", " ".repeat(9000))]
        {
            wishes.see(&format!("posed/a/posed-wish/hub/{garbage}"), SampleKind::Put);
            wishes.see(garbage, SampleKind::Delete);
        }
        assert!(wishes.lock().by_token.is_empty());
        let tokens: Vec<String> =
            (1..=2 * WISHES).map(|n| keys.wish("stranger", &wish(n as f64 * 1e-3, Field::Name))).collect();
        tokens.iter().for_each(|token| wishes.see(token, SampleKind::Put));
        assert_eq!(wishes.lock().by_token.len(), WISHES);
        wishes.see(&keys.wish("hub", &wish(60.0, Field::Covariance)), SampleKind::Put);
        assert_eq!(sent(&wishes), 100, "more than it wants");
        tokens.iter().for_each(|token| wishes.see(token, SampleKind::Delete));
        assert_eq!(sent(&wishes), 0);
    }
}
