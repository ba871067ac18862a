//! What is published, on its way to other machines: kept and numbered, so that what was missed can be asked for.
//!
//! In: items with their stamps, on the distributor's task. Out: bytes for the thread that hands them to zenoh, behind a bounded
//! queue: where that is full, states are lost, which the status says, and events are asked for later. Never: a wait. What nobody has subscribed to is not
//! written, and of frames only as many, and so much, as somebody wants.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::links::Links;
use super::twins::Twins;
use super::wire::{Bytes, Head, Joined, VERSION, write_fed};
use super::wishes::{Health, Wishes};
use posed_daemon::server::Holding;
use posed_daemon::server::Item;
use posed_protocol::{Encoding, Names, Payload, Problem, Selection, Stamp, Topic, View, encode};

/// Messages that wait for zenoh's thread.
const WAITING: usize = 256;
/// Events that are kept, as for websocket clients: so many, so long, so large.
const EVENTS: usize = 4096;
const EVENT_AGE_US: i64 = 600_000_000;
const EVENT_BYTES: usize = 16 << 20;

/// Time after which the status goes out to hubs that have not asked for it though it is as it was.
const STATUS_US: i64 = 10_000_000;

/// Where items go in, and where questions about them are answered; clones share it.
#[derive(Clone, Debug)]
pub(crate) struct Feed {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    about: StageInfo,
    kept: Mutex<Kept>,
    wanted: Wanted,
    wishes: Wishes,
    links: Links,
    twins: Twins,
    /// Frames so far.
    frames: AtomicU64,
    /// The thread that has panicked.
    broken: OnceLock<&'static str>,
    out: Sender<Out>,
    /// Messages that found it full since the status last said so.
    lost: AtomicU64,
}

/// What every hub receives of a stage.
#[derive(Debug)]
pub(super) struct StageInfo {
    pub(super) key: String,
    pub(super) run: i64,
    pub(super) stage_toml: String,
}

/// What somebody has subscribed to.
#[derive(Debug, Default)]
pub(super) struct Wanted {
    pub(super) feed: AtomicBool,
    pub(super) topics: [AtomicBool; Topic::COUNT],
}

/// Bytes for zenoh.
#[derive(Debug)]
pub(super) enum Out {
    Frame(Vec<u8>),
    State(Arc<[u8]>),
    Event(Arc<[u8]>),
    Public(Topic, Vec<u8>),
}

#[derive(Debug, Default)]
struct Kept {
    last_event_id: u64,
    newest_us: i64,
    events: VecDeque<Event>,
    event_bytes: usize,
    holding: Holding<Event>,
    /// Newest states that come seldom.
    status: Option<Arc<[u8]>>,
    /// What was last reported of it to hubs that had not asked, and when.
    reported: Option<(Health, i64)>,
    jobs: Option<Arc<[u8]>>,
    /// The newest status as its public message.
    status_json: Vec<u8>,
    topics: [bool; Topic::COUNT],
    seq: [u64; Topic::COUNT],
}

#[derive(Clone, Debug)]
struct Event {
    id: u64,
    t_us: i64,
    bytes: Arc<[u8]>,
}

impl Feed {
    /// Empty; what goes out is to be taken from the other end.
    pub(super) fn new(about: StageInfo) -> (Self, Receiver<Out>) {
        let (out, taken) = bounded(WAITING);
        let shared = Shared {
            about,
            kept: Mutex::default(),
            wanted: Wanted::default(),
            wishes: Wishes::default(),
            links: Links::default(),
            twins: Twins::default(),
            frames: AtomicU64::new(0),
            broken: OnceLock::new(),
            out,
            lost: AtomicU64::new(0),
        };
        (Self { shared: Arc::new(shared) }, taken)
    }

    fn send(&self, out: Out) {
        if self.shared.out.try_send(out).is_err() {
            self.shared.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// What a hub needs that has all events up to `after`.
    pub(super) fn join(&self, after: u64) -> Joined {
        let kept = self.kept();
        let oldest = kept.events.front().map_or(kept.last_event_id + 1, |event| event.id);
        let holding = kept.holding.iter().filter(|event| after == 0 && event.id < oldest);
        let mut events: Vec<&Event> =
            holding.chain(kept.events.iter().filter(|event| event.id > after)).collect();
        events.sort_by_key(|event| event.id);
        let states = [&kept.status, &kept.jobs].into_iter().flatten();
        let bytes = |bytes: &Arc<[u8]>| Bytes(bytes.to_vec());
        Joined {
            wire: VERSION,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            run: self.shared.about.run,
            stage_toml: if after == 0 { self.shared.about.stage_toml.clone() } else { String::new() },
            topics: Topic::ALL.into_iter().filter(|topic| kept.topics[topic.index()]).collect(),
            last_event_id: kept.last_event_id,
            complete: oldest <= after + 1,
            events: events.into_iter().map(|event| bytes(&event.bytes)).collect(),
            states: states.map(bytes).collect(),
        }
    }

    /// The newest status, as on the websocket; empty before the first.
    pub(super) fn status(&self) -> Vec<u8> {
        self.kept().status_json.clone()
    }

    pub(super) fn twins(&self) -> &Twins {
        &self.shared.twins
    }

    /// Whether the links are there.
    pub(super) fn links(&self) -> &Links {
        &self.shared.links
    }

    /// What hubs want of states.
    pub(super) fn wishes(&self) -> &Wishes {
        &self.shared.wishes
    }

    pub(super) fn run(&self) -> i64 {
        self.shared.about.run
    }

    /// Frames so far, and the number of the newest event.
    pub(super) fn progress(&self) -> (u64, u64) {
        (self.shared.frames.load(Ordering::Relaxed), self.kept().last_event_id)
    }

    /// Runs a thread of the session; where it panics, that is reported instead of passed over.
    pub(super) fn guard(&self, thread: &'static str, run: impl FnOnce()) {
        if catch_unwind(AssertUnwindSafe(run)).is_err() {
            let _ = self.shared.broken.set(thread);
        }
    }

    pub(super) fn wanted(&self) -> &Wanted {
        &self.shared.wanted
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        // Every change is complete before anything in it could panic.
        self.shared.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl posed_daemon::link::Feed for Feed {
    fn publish(&self, item: &Item, stamp: &Stamp, names: &Names) {
        let Shared { about, wanted, wishes, frames, .. } = &*self.shared;
        let Some(payload) = item.payload() else { return };
        // Who trains is nobody else's business: it stays on this machine.
        if matches!(item, Item::Sessions(_)) {
            return;
        }
        if matches!(item, Item::Estimate(_)) {
            frames.fetch_add(1, Ordering::Relaxed);
        }
        let topic = stamp.topic;
        let is_fed = wanted.feed.load(Ordering::Relaxed);
        let mut kept = self.kept();
        kept.newest_us = kept.newest_us.max(stamp.t_us);
        kept.last_event_id = stamp.event_id.unwrap_or(kept.last_event_id);
        kept.topics[topic.index()] = true;
        let head = Head { run: about.run, last_event_id: kept.last_event_id, stamp: *stamp };
        let whole = || write_fed(&head, item, &Selection::whole());
        match item {
            _ if topic.is_frequent() => {
                let due = wishes.due(stamp, |selection| write_fed(&head, item, selection));
                if let Some(bytes) = due.flatten() {
                    self.send(Out::Frame(bytes));
                }
            }
            Item::Outcome(outcome) => {
                let (Some(bytes), Some(id)) = (whole(), stamp.event_id) else { return };
                let event = Event { id, t_us: stamp.t_us, bytes: bytes.into() };
                kept.holding.take(outcome, || event.clone());
                kept.keep(event.clone());
                if is_fed {
                    self.send(Out::Event(event.bytes));
                }
            }
            Item::Status(status) => {
                let Some(bytes) = whole().map(Arc::from) else { return };
                kept.status = Some(Arc::clone(&bytes));
                if is_fed && (wishes.has(topic) || kept.is_news(Health::of(status), stamp.t_us)) {
                    self.send(Out::State(bytes));
                }
            }
            Item::Jobs(_) => {
                let Some(bytes) = whole().map(Arc::from) else { return };
                kept.jobs = Some(Arc::clone(&bytes));
                if is_fed {
                    self.send(Out::State(bytes));
                }
            }
            // Frequent, or nobody else's business.
            Item::Estimate(_)
            | Item::Body(_)
            | Item::Truth(_)
            | Item::Timecode(_)
            | Item::Sessions(_)
            | Item::Rewind => {}
        }
        let is_public = wanted.topics[topic.index()].load(Ordering::Relaxed);
        if is_public || topic == Topic::Status {
            let json = kept.public(&payload, stamp, names);
            if topic == Topic::Status {
                kept.status_json.clone_from(&json);
            }
            if is_public {
                self.send(Out::Public(topic, json));
            }
        }
    }

    fn problem(&self) -> Option<Problem> {
        let broken = self.shared.broken.get().map(|thread| {
            let fix = "and other machines get nothing more: restart posed, and please report this";
            Problem::new("zenoh", format!("{thread} had a fault of its own, {fix}"))
        });
        let lost = self.shared.lost.swap(0, Ordering::Relaxed);
        let slow = (lost > 0).then(|| {
            let rest = "of its messages to other machines were left out in the last second";
            Problem::new("zenoh_slow", format!("zenoh is too slow for this stage: {lost} {rest}"))
                .with("lost", lost)
        });
        let Shared { twins, links, about, .. } = &*self.shared;
        broken.or_else(|| twins.problem(&about.key)).or_else(|| links.problem()).or(slow)
    }
}

impl Kept {
    /// Whether hubs that have not asked for the status are to have this one: another state than they know, or old news.
    fn is_news(&mut self, health: Health, t_us: i64) -> bool {
        let is_known = self
            .reported
            .as_ref()
            .is_some_and(|(reported, at_us)| *reported == health && t_us - at_us < STATUS_US);
        if !is_known {
            self.reported = Some((health, t_us));
        }
        !is_known
    }

    fn keep(&mut self, event: Event) {
        self.event_bytes += event.bytes.len();
        self.events.push_back(event);
        let too_old = self.newest_us.saturating_sub(EVENT_AGE_US);
        while let Some(oldest) = self.events.front()
            && (self.events.len() > EVENTS || self.event_bytes > EVENT_BYTES || oldest.t_us < too_old)
        {
            self.event_bytes -= oldest.bytes.len();
            self.events.pop_front();
        }
    }

    /// The message as a websocket client gets it who has subscribed to all fields and misses nothing.
    fn public(&mut self, payload: &Payload<'_>, stamp: &Stamp, names: &Names) -> Vec<u8> {
        let seq = &mut self.seq[stamp.topic.index()];
        let head = encode::Head { stage: None, topic: stamp.topic, seq: *seq, dropped: 0 };
        *seq += 1;
        let (mut body, mut json) = (Vec::new(), Vec::new());
        encode::body(payload, stamp, names, &View::all(Encoding::Json), &mut body);
        encode::message(Encoding::Json, head, &body, &mut json);
        json
    }
}

#[cfg(test)]
mod tests {
    use posed_daemon::link::Feed as _;
    use posed_drivers::Timestamp;
    use posed_fusion::faults::Cause;
    use posed_protocol::{Status, Wish};
    use posed_stage::output::{Outcome, OutcomeKind};

    use super::*;

    #[test]
    fn what_zenoh_is_too_slow_for_is_left_out_and_said_and_events_can_be_asked_for() {
        let about = StageInfo { key: "posed/a".to_owned(), run: 1, stage_toml: String::new() };
        let (feed, taken) = Feed::new(about);
        feed.wanted().feed.store(true, Ordering::Relaxed);
        let names = Names::default();
        let surplus = 100;
        for n in 1..=(EVENTS + surplus) as u64 {
            let what = OutcomeKind::Fault { sensor: 0, cause: Cause::Gate, active: true };
            let (t_valid, t_decided) = (Timestamp::from_nanos(n as i64), Timestamp::ZERO);
            let item = Item::Outcome(Box::new(Outcome { t_valid, t_decided, what }));
            let stamp =
                Stamp { topic: Topic::Faults, body: 0, t_us: n as i64, event_id: Some(n), timecode: None };
            feed.publish(&item, &stamp, &names);
        }
        assert_eq!(taken.try_iter().count(), WAITING);
        let said = feed.problem().unwrap().message;
        assert!(said.contains(&format!(" {} of its messages", EVENTS + surplus - WAITING)), "{said}");
        assert_eq!(feed.problem(), None, "once");
        // All that are kept can be had; that more is missing is reported.
        let joined = feed.join(surplus as u64);
        assert_eq!((joined.events.len(), joined.complete), (EVENTS, true));
        let late = feed.join(1);
        assert_eq!((late.events.len(), late.complete), (EVENTS, false));
        // And what comes next goes out.
        let status = Stamp { topic: Topic::Status, body: 0, t_us: 1 << 20, event_id: None, timecode: None };
        feed.publish(&Item::Status(Box::default()), &status, &names);
        assert!(matches!(taken.try_recv(), Ok(Out::State(_))));
    }

    #[test]
    fn what_is_frequent_is_sent_only_where_it_is_asked_for() {
        let about = StageInfo { key: "posed/a".to_owned(), run: 1, stage_toml: String::new() };
        let (feed, taken) = Feed::new(about);
        feed.wanted().feed.store(true, Ordering::Relaxed);
        let item = Item::Estimate(Default::default());
        let frequent: Vec<Topic> = Topic::ALL.into_iter().filter(|topic| topic.is_frequent()).collect();
        assert_eq!(frequent, [Topic::Sensors, Topic::Body, Topic::Truth, Topic::Timecode]);
        for topic in frequent {
            let stamp = Stamp { topic, body: 0, t_us: 0, event_id: None, timecode: None };
            feed.publish(&item, &stamp, &Names::default());
            assert_eq!(taken.try_iter().count(), 0, "{topic:?}");
            let mut wish = Wish::default();
            wish.add(topic, None);
            feed.wishes().put("hub", Some(wish));
            feed.publish(&item, &stamp, &Names::default());
            assert!(matches!(taken.try_recv(), Ok(Out::Frame(_))), "{topic:?}");
            feed.wishes().put("hub", None);
        }
    }

    #[test]
    fn a_hub_where_nobody_looks_hears_of_a_change_at_once_and_else_every_ten_seconds() {
        let about = StageInfo { key: "posed/a".to_owned(), run: 1, stage_toml: String::new() };
        let (feed, taken) = Feed::new(about);
        feed.wanted().feed.store(true, Ordering::Relaxed);
        let names = Names::default();
        let mut second = 0;
        let mut sent = |feed: &Feed, problems: &[Problem]| {
            let stamp = Stamp {
                topic: Topic::Status,
                body: 0,
                t_us: second * 1_000_000,
                event_id: None,
                timecode: None,
            };
            second += 1;
            let status = Status { problems: problems.to_vec(), clients: second as u32, ..Status::default() };
            feed.publish(&Item::Status(Box::new(status)), &stamp, &names);
            taken.try_iter().count()
        };
        let quiet: Vec<usize> = (0..21).map(|_| sent(&feed, &[])).collect();
        assert_eq!((quiet.iter().sum::<usize>(), quiet[0], quiet[10], quiet[20]), (3, 1, 1, 1));
        let problem = [Problem::new("lsl", "none")];
        assert_eq!((sent(&feed, &problem), sent(&feed, &problem), sent(&feed, &[])), (1, 0, 1));
        let mut wish = Wish::default();
        wish.add(Topic::Status, None);
        feed.wishes().put("hub", Some(wish));
        assert_eq!((0..5).map(|_| sent(&feed, &[])).sum::<usize>(), 5, "somebody looks");
    }

    #[test]
    fn large_events_are_kept_up_to_their_bytes() {
        let mut kept = Kept::default();
        let mebibyte: Arc<[u8]> = vec![0; 1 << 20].into();
        for id in 1..=40 {
            kept.keep(Event { id, t_us: id as i64, bytes: Arc::clone(&mebibyte) });
        }
        let ids = kept.events.iter().map(|event| event.id);
        assert!(ids.eq(25..=40) && kept.event_bytes == EVENT_BYTES);
    }
}
