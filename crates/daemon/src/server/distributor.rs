//! Who gets what: the subscriptions of all clients, and every message on its way to their outboxes.
//!
//! In: items from the fusion thread, commands from the clients' tasks, one at a time. Out: bytes in outboxes. Never: a
//! socket, a clock, a wait. Each distinct (topic, fields, sensors, encoding) is serialised once.

use std::collections::VecDeque;
use std::sync::Arc;

use super::holding::Holding;
use super::hub::Item;
use super::metrics::Metrics;
use super::outbox::{Outbox, Outgoing};
use super::views::Views;
use posed_protocol::{
    Answer, Counters, DropPolicy, Encoding, ErrorReply, Feed, Field, Fields, Names, OkReply, Payload,
    Problem, Rate, RequestId, Resumed, STREAMS, Selection, ServerMessage, Stamp, Topic, View, Wish, encode,
};
use posed_stage::Limits;

/// Events older than this are not resumed, in microseconds.
const EVENT_AGE_US: i64 = 600_000_000;

/// Number of a connection; never used again.
pub(super) type ClientId = u64;

/// What a client's task tells the distributor.
#[derive(Debug)]
pub(super) enum Command {
    /// `stage` is put into every message, for a client that sees several.
    Connect {
        client: ClientId,
        outbox: Arc<Outbox>,
        stage: Option<Arc<str>>,
    },
    Feed {
        client: ClientId,
        id: RequestId,
        feed: Feed,
    },
    Disconnect {
        client: ClientId,
    },
}

/// See the module.
pub(super) struct Distributor {
    names: Arc<Names>,
    /// Of those that are kept for who resumes.
    most_events: usize,
    metrics: Arc<Metrics>,
    counters: Counters,
    clients: Vec<Client>,
    views: Views,
    /// The newest state of each stream.
    last: [Option<(Stamp, Item)>; STREAMS],
    /// What there is of the newest frame; all of it, unless it comes from elsewhere and nobody has asked for more.
    held: Selection,
    events: VecDeque<Event>,
    /// Events that still hold: faults that have not ended, the newest model of each kind, counts.
    current: Holding<Event>,
    newest_us: i64,
    /// Connections refused as of the last status.
    refused: u64,
    scratch: Vec<u8>,
}

struct Client {
    id: ClientId,
    outbox: Arc<Outbox>,
    /// Name of this stage, for a client that sees several.
    stage: Option<Arc<str>>,
    subscriptions: [Option<Subscription>; Topic::COUNT],
    seq: [u64; Topic::COUNT],
    /// Time of the newest state of each stream that was sent under the present subscription.
    sent_us: [Option<i64>; STREAMS],
    /// When the next one of each may go out, of subscriptions that have a rate.
    rates: [Option<Rate>; STREAMS],
}

#[derive(Clone, Copy)]
struct Subscription {
    view: usize,
    policy: DropPolicy,
    max_rate_hz: Option<f64>,
    /// Newest event when the subscription began: later ones came by themselves.
    live_after: u64,
}

#[derive(Clone)]
struct Event {
    stamp: Stamp,
    json: Arc<[u8]>,
    message_pack: Arc<[u8]>,
}

impl Distributor {
    pub(super) fn new(names: Arc<Names>, limits: Limits, metrics: Arc<Metrics>, counters: Counters) -> Self {
        Self {
            names,
            most_events: limits.events,
            metrics,
            counters,
            clients: Vec::new(),
            views: Views::new(limits.views),
            last: std::array::from_fn(|_| None),
            held: Selection::whole(),
            events: VecDeque::new(),
            current: Holding::default(),
            newest_us: i64::MIN,
            refused: 0,
            scratch: Vec::new(),
        }
    }

    /// Adds to a status what only the server knows; `viewers` are clients that are not among these.
    pub(super) fn complete(&mut self, item: &mut Item, viewers: usize) {
        if let Item::Status(status) = item {
            status.clients = (self.clients.len() + viewers) as u32;
            let refused = self.metrics.refused_over_limit();
            if refused > self.refused {
                let new = refused - self.refused;
                let sentence = format!(
                    "{new} connections were refused because too many are open, or come at once; end programs that connect again \
                     and again"
                );
                status.problems.push(Problem::new("connections", sentence).with("times", new));
                self.refused = refused;
            }
        }
    }

    /// When and as which event an item is published; `None` where time goes back.
    pub(super) fn stamp(&mut self, item: &Item) -> Option<Stamp> {
        item.payload().map(|payload| self.counters.stamp(&payload))
    }

    /// Sends an item to all who want it, with its stamp. Returns the item it replaces, for its memory.
    pub(super) fn publish(&mut self, item: Item, stamp: Option<Stamp>) -> Option<Item> {
        let (Some(payload), Some(stamp)) = (item.payload(), stamp) else {
            self.rewind();
            return None;
        };
        self.newest_us = self.newest_us.max(stamp.t_us);
        self.views.begin();
        let topic = stamp.topic;
        let Self { clients, views, names, scratch, metrics, held, .. } = self;
        for client in clients {
            let Some(subscription) = &mut client.subscriptions[topic.index()] else { continue };
            if topic == Topic::Sensors && !held.covers(views.get(subscription.view)) {
                continue;
            }
            let rate = &mut client.rates[stamp.stream()];
            if !topic.is_event() && rate.as_mut().is_some_and(|rate| !rate.is_due(stamp.t_us as f64)) {
                continue;
            }
            let body = views.body(subscription.view, |view| {
                metrics.bodies.inc();
                written(&payload, &stamp, names, view, scratch)
            });
            let policy = subscription.policy;
            client.send(&stamp, body, policy, metrics);
        }
        self.remember(stamp, item)
    }

    /// Carries out what a client's task asks for.
    pub(super) fn handle(&mut self, command: Command) {
        match command {
            Command::Connect { client, outbox, stage } => self.clients.push(Client {
                id: client,
                outbox,
                stage,
                subscriptions: [None; Topic::COUNT],
                seq: [0; Topic::COUNT],
                sent_us: [None; STREAMS],
                rates: [None; STREAMS],
            }),
            Command::Disconnect { client } => {
                if let Some(at) = self.clients.iter().position(|c| c.id == client) {
                    self.unsubscribe(at, &Topic::ALL);
                    self.clients.swap_remove(at);
                }
            }
            Command::Feed { client, id, feed } => {
                let Some(at) = self.clients.iter().position(|c| c.id == client) else { return };
                if let Err((code, message)) = self.feed(at, &id, feed) {
                    let error = ErrorReply::new(Some(id), code, message);
                    self.clients[at].reply(&ServerMessage::Error(error));
                }
            }
        }
    }

    /// Says how much there is of the frames that follow: who wants more of them gets none.
    pub(super) fn hold(&mut self, held: Selection) {
        self.held = held;
    }

    /// What its clients want of states.
    pub(super) fn wish(&self) -> Wish {
        let mut wish = Wish::default();
        for client in &self.clients {
            for (topic, subscription) in Topic::ALL.into_iter().zip(&client.subscriptions) {
                let Some(Subscription { view, max_rate_hz, .. }) = subscription else { continue };
                wish.add(topic, *max_rate_hz);
                if topic == Topic::Sensors {
                    let view = self.views.get(*view);
                    wish.select(view.fields, view.sensors.as_deref());
                }
            }
        }
        wish
    }

    /// Forgets the newest states of a topic, since no newer ones come.
    pub(super) fn forget(&mut self, topic: Topic) {
        topic.streams().for_each(|stream| self.last[stream] = None);
    }

    /// Forgets what holds of a later time; sequence and event numbers go on.
    fn rewind(&mut self) {
        self.counters.rewind();
        self.newest_us = i64::MIN;
        self.current.clear();
        for last in &mut self.last {
            last.take_if(|(stamp, _)| [Topic::Sensors, Topic::Body, Topic::Truth].contains(&stamp.topic));
        }
        for client in &mut self.clients {
            client.sent_us = [None; STREAMS];
            client.rates.iter_mut().flatten().for_each(Rate::rewind);
        }
    }

    /// Goes on from the numbers of another place: the stamp of an item that was published there.
    pub(super) fn follow(&mut self, stamp: &Stamp) {
        self.counters.follow(stamp);
    }

    /// Newest event so far.
    pub(super) fn last_event_id(&self) -> u64 {
        self.counters.last_event_id()
    }

    fn feed(&mut self, at: usize, id: &RequestId, feed: Feed) -> Result<(), (&'static str, String)> {
        match feed {
            Feed::Subscribe { topics, max_rate_hz, sensors, fields, drop } => {
                if topics.is_empty() {
                    return Err(("bad_request", "subscribe to at least one topic".into()));
                }
                let rate = match max_rate_hz {
                    Some(rate) if rate.is_finite() && rate > 0.0 => Some(Rate::every(1e6 / rate)),
                    Some(_) => return Err(("bad_request", "max_rate_hz must be above 0".into())),
                    None => None,
                };
                let view = self.view(at, sensors, fields)?;
                let live_after = self.counters.last_event_id();
                let mut begun = Vec::with_capacity(topics.len());
                for topic in topics {
                    if begun.iter().any(|(other, _)| *other == topic) {
                        continue;
                    }
                    match self.views.take(&view.for_topic(topic)) {
                        Ok(view) => begun.push((topic, view)),
                        Err(busy) => {
                            // All or nothing: what there was before goes on.
                            begun.iter().for_each(|(_, view)| self.views.release(*view));
                            return Err(busy);
                        }
                    }
                }
                self.reply_ok(at, id, None);
                for (topic, view) in begun {
                    let policy = drop.unwrap_or_default();
                    let subscription = Subscription { view, policy, max_rate_hz, live_after };
                    topic.streams().for_each(|stream| self.clients[at].rates[stream] = rate);
                    let replaced = self.clients[at].subscriptions[topic.index()].replace(subscription);
                    if let Some(old) = replaced {
                        self.views.release(old.view);
                    }
                    self.send_last_state(at, topic);
                }
            }
            Feed::Unsubscribe { topics } => {
                self.unsubscribe(at, &topics);
                self.reply_ok(at, id, None);
            }
            Feed::Resume { after } => self.resume(at, id, after)?,
        }
        Ok(())
    }

    fn view(
        &self,
        at: usize,
        sensors: Option<Vec<String>>,
        fields: Option<Vec<Field>>,
    ) -> Result<View, (&'static str, String)> {
        let find = |name: String| {
            let unknown = || ("unknown_sensor", format!("this stage has no sensor `{name}`"));
            self.names.find_sensor(&name).ok_or_else(unknown)
        };
        let sensors = match sensors {
            None => None,
            Some(names) => {
                let mut sensors = names.into_iter().map(find).collect::<Result<Vec<_>, _>>()?;
                sensors.sort_unstable();
                sensors.dedup();
                Some(sensors.into_boxed_slice())
            }
        };
        let fields = fields.map_or_else(Fields::default, |fields| Fields::of(&fields));
        Ok(View { encoding: self.clients[at].outbox.encoding(), fields, sensors })
    }

    fn unsubscribe(&mut self, at: usize, topics: &[Topic]) {
        for topic in topics {
            if let Some(old) = self.clients[at].subscriptions[topic.index()].take() {
                self.views.release(old.view);
            }
            topic.streams().for_each(|stream| self.clients[at].sent_us[stream] = None);
        }
    }

    fn send_last_state(&mut self, at: usize, topic: Topic) {
        let client = &mut self.clients[at];
        let Some(Subscription { view, policy, .. }) = client.subscriptions[topic.index()] else { return };
        if topic.is_event() {
            for event in self.current.iter().filter(|event| event.stamp.topic == topic) {
                client.send(&event.stamp, event.body(client.outbox.encoding()), policy, &self.metrics);
            }
            return;
        }
        if topic == Topic::Sensors && !self.held.covers(self.views.get(view)) {
            return;
        }
        for stream in topic.streams() {
            if let Some((stamp, item)) = &self.last[stream]
                && client.sent_us[stream].is_none_or(|sent_us| sent_us < stamp.t_us)
                && client.rates[stream].as_mut().is_none_or(|rate| rate.is_due(stamp.t_us as f64))
                && let Some(payload) = item.payload()
            {
                let view = self.views.get(view);
                let body = written(&payload, stamp, &self.names, view, &mut self.scratch);
                client.send(stamp, body, policy, &self.metrics);
            }
        }
    }

    fn resume(&mut self, at: usize, id: &RequestId, after: u64) -> Result<(), (&'static str, String)> {
        let newest = self.counters.last_event_id();
        if after > newest {
            let message = format!(
                "the newest event is {newest}: the daemon has restarted since {after}; resume after 0 for what it has"
            );
            return Err(("unknown_event", message));
        }
        let oldest = self.events.front().and_then(|event| event.stamp.event_id).unwrap_or(newest + 1);
        let result = Resumed { complete: oldest <= after + 1, last_event_id: newest };
        self.reply_ok(at, id, Some(Answer::Resumed(result)));
        let client = &mut self.clients[at];
        let none = !Topic::ALL.iter().any(|t| t.is_event() && client.subscriptions[t.index()].is_some());
        for event in &self.events {
            let event_id = event.stamp.event_id.unwrap_or(0);
            // Without any subscription to events it is all of them; with one, the later ones came by themselves.
            let until = match &client.subscriptions[event.stamp.topic.index()] {
                Some(subscription) => subscription.live_after,
                None if none => newest,
                None => 0,
            };
            if event_id > after && event_id <= until {
                let body = event.body(client.outbox.encoding());
                client.send(&event.stamp, body, DropPolicy::Queue, &self.metrics);
            }
        }
        Ok(())
    }

    fn reply_ok(&self, at: usize, id: &RequestId, result: Option<Answer>) {
        self.clients[at].reply(&ServerMessage::Ok(OkReply { id: Some(id.clone()), result }));
    }

    fn remember(&mut self, stamp: Stamp, item: Item) -> Option<Item> {
        let Item::Outcome(outcome) = &item else {
            return self.last[stamp.stream()].replace((stamp, item)).map(|(_, old)| old);
        };
        let mut body = |encoding| {
            let view = View::all(encoding);
            written(&Payload::Outcome(outcome), &stamp, &self.names, &view, &mut self.scratch)
        };
        let event = Event { stamp, json: body(Encoding::Json), message_pack: body(Encoding::MessagePack) };
        self.current.take(outcome, || event.clone());
        self.keep(event)
    }

    /// Keeps an event for those who resume.
    fn keep(&mut self, event: Event) -> Option<Item> {
        self.events.push_back(event);
        let too_old = self.newest_us.saturating_sub(EVENT_AGE_US);
        while self.events.len() > self.most_events
            || self.events.front().is_some_and(|oldest| oldest.stamp.t_us < too_old)
        {
            self.events.pop_front();
        }
        None
    }
}

impl Client {
    fn send(&mut self, stamp: &Stamp, body: Arc<[u8]>, policy: DropPolicy, metrics: &Metrics) {
        let topic = stamp.topic;
        let seq = &mut self.seq[topic.index()];
        let (stage, stream) = (self.stage.clone(), stamp.stream());
        let message = Outgoing::Shared { stage, topic, stream, seq: *seq, body };
        *seq += 1;
        metrics.messages.inc();
        if topic.is_event() {
            self.outbox.push_lossless(message);
        } else {
            self.sent_us[stamp.stream()] = Some(stamp.t_us);
            metrics.dropped.inc_by(self.outbox.push_data(message, policy));
        }
    }

    fn reply(&self, message: &ServerMessage) {
        // Who asks many stages at once has been answered for all of them.
        if self.stage.is_some() && matches!(message, ServerMessage::Ok(OkReply { result: None, .. })) {
            return;
        }
        self.outbox.push_lossless(Outgoing::Whole(encode::whole(self.outbox.encoding(), message)));
    }
}

impl Event {
    fn body(&self, encoding: Encoding) -> Arc<[u8]> {
        match encoding {
            Encoding::Json => Arc::clone(&self.json),
            Encoding::MessagePack => Arc::clone(&self.message_pack),
        }
    }
}

fn written(
    payload: &Payload<'_>,
    stamp: &Stamp,
    names: &Names,
    view: &View,
    scratch: &mut Vec<u8>,
) -> Arc<[u8]> {
    scratch.clear();
    encode::body(payload, stamp, names, view, scratch);
    Arc::from(scratch.as_slice())
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::super::testing::received;
    use super::*;
    use posed_fusion::faults::Cause;
    use posed_motion::exercise::EventKind;
    use posed_stage::Stage;
    use posed_stage::output::{Body, Estimate, Outcome};
    use posed_stage::output::{ExerciseOutcome, ExerciseWhat, OutcomeKind};

    fn distributor(limits: &Limits) -> Distributor {
        let stage = Stage::parse("name = \"test\"").unwrap();
        let names = Arc::new(Names::new(&stage));
        Distributor::new(names, limits.clone(), Arc::new(Metrics::new()), Counters::default())
    }

    fn connect(distributor: &mut Distributor, client: ClientId, limits: &Limits) -> Arc<Outbox> {
        let outbox =
            Arc::new(super::super::outbox::Outboxes::new(limits).open(Encoding::Json, limits.queue_messages));
        distributor.handle(Command::Connect { client, outbox: Arc::clone(&outbox), stage: None });
        outbox
    }

    fn subscribe(
        distributor: &mut Distributor,
        client: ClientId,
        max_rate_hz: Option<f64>,
        fields: &[Field],
    ) {
        let feed = Feed::Subscribe {
            topics: vec![Topic::Sensors],
            max_rate_hz,
            sensors: None,
            fields: Some(fields.to_vec()),
            drop: Some(DropPolicy::Queue),
        };
        distributor.handle(Command::Feed { client, id: RequestId::Number(1), feed });
    }

    fn publish(distributor: &mut Distributor, item: Item) {
        let stamp = distributor.stamp(&item);
        distributor.publish(item, stamp);
    }

    fn frame(distributor: &mut Distributor, t_us: i64) {
        let t_valid = Timestamp::from_nanos(t_us * 1000);
        publish(distributor, Item::Estimate(Estimate { t_valid, ..Estimate::default() }));
    }

    fn to(topic: Topic) -> Feed {
        Feed::Subscribe { topics: vec![topic], max_rate_hz: None, sensors: None, fields: None, drop: None }
    }

    #[test]
    fn who_subscribes_late_is_reported_the_state_and_the_newest_counts() {
        use posed_stage::output::{ExerciseState, Repetition};
        let limits = Limits::default();
        let mut distributor = distributor(&limits);
        let mut emit = |subject: &str, what| {
            let what = OutcomeKind::Exercise(ExerciseOutcome { subject: subject.into(), what });
            let t = Timestamp::ZERO;
            publish(&mut distributor, Item::Outcome(Box::new(Outcome { t_valid: t, t_decided: t, what })));
        };
        let state = || ExerciseWhat::State(ExerciseState::default());
        let repetition = |kind, count| {
            let (exercise, set_count) = ("curl".into(), count as u32);
            let (reason, feedback, remark) = (None, None, None);
            let t_start_s = 0.0;
            ExerciseWhat::Repetition(Repetition {
                exercise,
                kind,
                count,
                set_count,
                t_start_s,
                reason,
                is_attempt: true,
                feedback,
                remark,
            })
        };
        emit("a", state());
        emit("a", repetition(EventKind::Counted, 1));
        emit("b", state());
        emit("b", repetition(EventKind::Counted, 1));
        emit("b", repetition(EventKind::Counted, 2));
        emit("b", repetition(EventKind::Provisional, 2));
        emit("a", state());
        let outbox = connect(&mut distributor, 1, &limits);
        let feed = to(Topic::Exercise);
        distributor.handle(Command::Feed { client: 1, id: RequestId::Number(1), feed });
        let reported: Vec<_> = received(&outbox)
            .into_iter()
            .skip(1)
            .map(|message| format!("{} {} {}", message["subject"], message["event"], message["count"]))
            .collect();
        assert_eq!(reported, [r#""b" "state" null"#, r#""b" "counted" 2"#, r#""a" "state" null"#]);
    }

    #[test]
    fn events_beyond_those_that_are_kept_are_the_oldest_and_who_was_there_has_had_them() {
        let limits = Limits { events: 3, ..Limits::default() };
        let mut distributor = distributor(&limits);
        let feed = |distributor: &mut Distributor, client, feed| {
            distributor.handle(Command::Feed { client, id: RequestId::Number(1), feed });
        };
        let was_there = connect(&mut distributor, 1, &limits);
        let faults = to(Topic::Faults);
        feed(&mut distributor, 1, faults);
        for sensor in 0..5 {
            let what = OutcomeKind::Fault { sensor, cause: Cause::Gate, active: true };
            let t = Timestamp::ZERO;
            publish(&mut distributor, Item::Outcome(Box::new(Outcome { t_valid: t, t_decided: t, what })));
        }
        let back = connect(&mut distributor, 2, &limits);
        feed(&mut distributor, 2, Feed::Resume { after: 0 });
        let ids = |outbox: &Outbox| {
            let mut messages = received(outbox);
            let answer = messages.remove(0);
            assert_eq!(answer["type"], "ok");
            let ids: Vec<_> = messages.iter().map(|message| message["event_id"].as_u64().unwrap()).collect();
            (answer["result"]["complete"].clone(), ids)
        };
        assert_eq!(ids(&back), (false.into(), vec![3, 4, 5]));
        assert_eq!(ids(&was_there).1, [1, 2, 3, 4, 5]);
    }

    #[test]
    fn a_maximum_rate_is_kept_on_average_whatever_the_frames_do() {
        let limits = Limits::default();
        for (frame_us, max_rate_hz, expected) in [
            (10_000, 30.0, 30),
            (10_000, 60.0, 60),
            (6_944, 50.0, 50),
            (10_000, 250.0, 100),
            (20_000, 50.0, 50),
        ] {
            let mut distributor = distributor(&limits);
            let outbox = connect(&mut distributor, 1, &limits);
            subscribe(&mut distributor, 1, Some(max_rate_hz), &[]);
            for n in 0..(1_000_000 / frame_us) {
                frame(&mut distributor, n * frame_us);
            }
            let got = received(&outbox).len() as i64 - 1;
            assert!((expected - 1..=expected).contains(&got), "{got} of {expected} per second");
        }
    }

    /// Who looks at several people sees each of them as often, the newest of all who waits for one, and all of them at once who comes late.
    #[test]
    fn bodies_are_streams_of_their_own() {
        let stage = "name = \"two\"\n[[body]]\nname = \"anna\"\n[[body]]\nname = \"bert\"\n";
        let limits = Limits { latest_messages: 1, ..Limits::default() };
        let mut distributor = distributor(&limits);
        distributor.names = Arc::new(Names::new(&Stage::parse(stage).unwrap()));
        let body = |distributor: &mut Distributor, index, t_us: i64| {
            let t_valid = Timestamp::from_nanos(t_us * 1000);
            let body = Body { t_valid, ..Body::unknown(index, 0) };
            publish(distributor, Item::Body(Box::new(body)));
        };
        let names = |outbox: &Outbox| -> Vec<(String, i64)> {
            let said = received(outbox).into_iter().filter(|message| message["type"] == "body");
            let t_us = |t_s: &serde_json::Value| (t_s.as_f64().unwrap() * 1e6).round() as i64;
            said.map(|said| (said["name"].as_str().unwrap().to_owned(), t_us(&said["t_s"]))).collect()
        };
        let outbox = connect(&mut distributor, 1, &limits);
        let feed = Feed::Subscribe {
            topics: vec![Topic::Body],
            max_rate_hz: Some(10.0),
            sensors: None,
            fields: None,
            drop: Some(DropPolicy::Latest),
        };
        distributor.handle(Command::Feed { client: 1, id: RequestId::Number(1), feed });
        // The second one's sensors are later by 5 ms, the first one's newest sample of a frame older.
        for n in 0..20 {
            body(&mut distributor, 1, n * 10_000);
            body(&mut distributor, 0, n * 10_000 - 5_000);
        }
        let expected = [("bert".to_owned(), 100_000), ("anna".to_owned(), 95_000)];
        assert_eq!(names(&outbox), expected, "one of each waits, at its own time");
        let late = connect(&mut distributor, 2, &limits);
        distributor.handle(Command::Feed { client: 2, id: RequestId::Number(1), feed: to(Topic::Body) });
        assert_eq!(names(&late), [("anna".to_owned(), 185_000), ("bert".to_owned(), 190_000)]);
    }

    /// At a hub: what was not asked of the stage is nothing that could be shown.
    #[test]
    fn who_wants_more_of_a_frame_than_there_is_gets_the_first_that_has_it_all() {
        let limits = Limits::default();
        let mut distributor = distributor(&limits);
        let little = connect(&mut distributor, 1, &limits);
        subscribe(&mut distributor, 1, Some(20.0), &[Field::PositionM]);
        let held = distributor.wish().selection().clone();
        distributor.hold(held);
        frame(&mut distributor, 0);
        let much = connect(&mut distributor, 2, &limits);
        subscribe(&mut distributor, 2, Some(50.0), &[Field::Covariance]);
        frame(&mut distributor, 50_000);
        assert_eq!((received(&little).len(), received(&much).len()), (3, 1), "frames beside the answer");
        let wish = distributor.wish();
        assert_eq!(wish.max_rate_hz(Topic::Sensors), Some(50.0));
        distributor.hold(wish.selection().clone());
        frame(&mut distributor, 100_000);
        assert_eq!((received(&little).len(), received(&much).len()), (1, 1));
        // What is no longer asked for is not shown as if it were of now.
        distributor.forget(Topic::Sensors);
        let late = connect(&mut distributor, 3, &limits);
        subscribe(&mut distributor, 3, None, &[Field::PositionM]);
        assert_eq!(received(&late).len(), 1);
        for client in 1..=3 {
            distributor.handle(Command::Disconnect { client });
        }
        assert!(distributor.wish().is_empty());
    }

    #[test]
    fn equal_views_are_serialised_once_and_places_are_reused() {
        let limits = Limits { views: 2, ..Limits::default() };
        let mut distributor = distributor(&limits);
        let outboxes: Vec<_> = (0..10).map(|client| connect(&mut distributor, client, &limits)).collect();
        for client in 0..9 {
            subscribe(
                &mut distributor,
                client,
                None,
                &[[Field::PositionM, Field::SigmaM][client as usize % 2]],
            );
        }
        frame(&mut distributor, 0);
        assert_eq!(distributor.metrics.bodies.get(), 2);
        subscribe(&mut distributor, 9, None, &[Field::Device]);
        assert_eq!(received(&outboxes[9])[0]["code"], "busy", "no third view");
        frame(&mut distributor, 10_000);
        assert!(outboxes[..9].iter().all(|outbox| received(outbox).len() == 3), "an answer and both frames");
        for client in (0..9).filter(|client| client % 2 == 0) {
            distributor.handle(Command::Disconnect { client });
        }
        subscribe(&mut distributor, 9, None, &[Field::Device]);
        assert_eq!(received(&outboxes[9])[0]["type"], "ok");
    }
}
