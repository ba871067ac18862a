//! Foxglove viewers on the daemon's own port: who has subscribed to which channel, and what each receives.
//!
//! In: items from the fusion thread, what viewers ask for. Out: frames in their outboxes. Never: a socket, a wait. Each message of a channel
//! that somebody has subscribed to is written once.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::Shared;
use super::client::{Dialect, Received};
use super::distributor::ClientId;
use super::hub::Item;
use super::metrics::Metrics;
use super::outbox::{Close, Outbox, Outgoing};
use posed_protocol::foxglove::wire::{self, Level, Request, ServerInfo, Subscription};
use posed_protocol::foxglove::{Channel, Publisher, channels};
use posed_protocol::{DropPolicy, Encoding, Fields, Payload, Problem, Stamp, Topic, Wish};
use posed_stage::Stage;

/// Messages that wait for a viewer; older ones give way.
const WAITING: usize = 1024;
/// Sentences of the log that who subscribes later receives.
const LOG: usize = 100;

/// What a viewer's task tells.
pub(super) enum Command {
    Connect { client: ClientId, outbox: Arc<Outbox> },
    Ask { client: ClientId, request: Request },
    Disconnect { client: ClientId },
}

/// Server info and list of channels, ready to be sent.
pub(super) struct Greeting {
    info: String,
    advertise: String,
    channels: usize,
}

/// All viewers; belongs to the distributing task.
pub(super) struct Viewers {
    channels: Vec<Channel>,
    publisher: Publisher,
    metrics: Arc<Metrics>,
    clients: Vec<Client>,
    /// Subscriptions by channel.
    wanted: Vec<usize>,
    /// What is reported to who subscribes: the newest message of states that seldom change, the newest events of the log.
    latest: Vec<VecDeque<(u64, Arc<[u8]>)>>,
    /// Problems of the last status, with the names that viewers know them by.
    problems: Vec<(String, Problem)>,
    /// Viewers' clocks follow the recording's.
    replay: bool,
}

struct Client {
    id: ClientId,
    outbox: Arc<Outbox>,
    /// The viewer's number of its subscription, by channel.
    subscriptions: Vec<Option<u32>>,
}

impl Viewers {
    /// Nobody yet.
    pub(super) fn new(
        stage: &Stage,
        topics: &[Topic],
        epoch_utc_ns: i64,
        replay: bool,
        metrics: &Arc<Metrics>,
    ) -> Self {
        let channels = channels(stage, topics);
        Self {
            publisher: Publisher::new(stage, epoch_utc_ns),
            metrics: Arc::clone(metrics),
            clients: Vec::new(),
            wanted: vec![0; channels.len()],
            latest: vec![VecDeque::new(); channels.len()],
            problems: Vec::new(),
            replay,
            channels,
        }
    }

    /// What every viewer gets first. The session differs after every start, even of the same recording.
    pub(super) fn greeting(&self, stage: &str, epoch_utc: &str) -> Greeting {
        let session = format!("{epoch_utc} {}", std::process::id());
        let info = ServerInfo { stage, epoch_utc, session: &session, time: self.replay };
        Greeting {
            info: wire::server_info(&info),
            advertise: wire::advertise(&self.channels),
            channels: self.channels.len(),
        }
    }

    /// How many there are.
    pub(super) fn count(&self) -> usize {
        self.clients.len()
    }

    /// What they want of states: whole frames, as often as there are any. Problems are reported to all.
    pub(super) fn wish(&self) -> Wish {
        let mut wish = Wish::default();
        if !self.clients.is_empty() {
            wish.add(Topic::Status, None);
        }
        for (channel, wanted) in self.channels.iter().zip(&self.wanted) {
            for topic in channel.topics().iter().filter(|_| *wanted > 0) {
                wish.add(*topic, None);
                if *topic == Topic::Sensors {
                    wish.select(Fields::all(), None);
                }
            }
        }
        wish
    }

    /// Tells an item to all who want it; without a stamp, time goes back.
    pub(super) fn publish(&mut self, item: &Item, stamp: Option<&Stamp>) {
        let (Some(payload), Some(stamp)) = (item.payload(), stamp) else {
            self.latest.iter_mut().for_each(VecDeque::clear);
            return;
        };
        let Self { channels, publisher, clients, wanted, latest, metrics, .. } = self;
        let utc_ns = publisher.utc_ns(stamp);
        if self.replay && matches!(payload, Payload::Estimate(_)) {
            for client in clients.iter() {
                client.outbox.push_data(Outgoing::Clock(utc_ns), DropPolicy::Queue);
            }
        }
        let keep = |place: usize| kept(&channels[place]);
        publisher.publish(
            &payload,
            stamp,
            channels,
            &|place| wanted[place] > 0 || keep(place) > 0,
            &mut |place, json| {
                let payload: Arc<[u8]> = json.into();
                if keep(place) > 0 {
                    if latest[place].len() >= keep(place) {
                        latest[place].pop_front();
                    }
                    latest[place].push_back((utc_ns, Arc::clone(&payload)));
                }
                for client in clients.iter().filter(|_| wanted[place] > 0) {
                    client.send(place, &channels[place], utc_ns, &payload, metrics);
                }
            },
        );
        if let Payload::Status(status) = payload {
            self.tell_problems(&status.problems);
        }
    }

    /// Carries out what a viewer's task asks for.
    pub(super) fn handle(&mut self, command: Command) {
        match command {
            Command::Connect { client, outbox } => {
                for (id, problem) in &self.problems {
                    report(&outbox, wire::status(Level::Warning, &problem.message, Some(id)));
                }
                let subscriptions = vec![None; self.channels.len()];
                self.clients.push(Client { id: client, outbox, subscriptions });
            }
            Command::Disconnect { client } => {
                if let Some(at) = self.clients.iter().position(|other| other.id == client) {
                    let client = self.clients.swap_remove(at);
                    let places = client.subscriptions.iter().zip(&mut self.wanted);
                    places.filter(|(id, _)| id.is_some()).for_each(|(_, wanted)| *wanted -= 1);
                }
            }
            Command::Ask { client, request } => {
                let Some(at) = self.clients.iter().position(|other| other.id == client) else { return };
                let refused = match request {
                    Request::Subscribe(list) => self.subscribe(at, &list),
                    Request::Unsubscribe(list) => self.unsubscribe(at, &list),
                };
                if let Some((first, others)) = refused {
                    let more = if others > 0 {
                        format!(" (and {others} others of the same message)")
                    } else {
                        String::new()
                    };
                    report(
                        &self.clients[at].outbox,
                        wire::status(Level::Warning, &format!("{first}{more}"), None),
                    );
                }
            }
        }
    }

    /// The first entry that was refused, and how many others.
    fn subscribe(&mut self, at: usize, list: &[Subscription]) -> Option<(String, usize)> {
        let mut refused = Vec::new();
        for &Subscription { id, channel_id } in list {
            let Self { channels, clients, wanted, latest, metrics, .. } = self;
            let client = &mut clients[at];
            let place = wire::place(channel_id, channels.len());
            let Some(place) = place.filter(|place| client.subscriptions[*place].is_none()) else {
                let why = if place.is_some() { "is subscribed to already" } else { "does not exist" };
                refused.push(format!("channel {channel_id} {why}"));
                continue;
            };
            if client.subscriptions.contains(&Some(id)) {
                refused.push(format!("subscription {id} is in use already"));
                continue;
            }
            client.subscriptions[place] = Some(id);
            wanted[place] += 1;
            for (utc_ns, payload) in &latest[place] {
                client.send(place, &channels[place], *utc_ns, payload, metrics);
            }
        }
        first_of(refused)
    }

    fn unsubscribe(&mut self, at: usize, list: &[u32]) -> Option<(String, usize)> {
        let mut refused = Vec::new();
        for &id in list {
            let subscriptions = &mut self.clients[at].subscriptions;
            match subscriptions.iter().position(|other| *other == Some(id)) {
                Some(place) => {
                    subscriptions[place] = None;
                    self.wanted[place] -= 1;
                }
                None => refused.push(format!("there is no subscription {id}")),
            }
        }
        first_of(refused)
    }

    /// Tells what is new and takes back what is over.
    fn tell_problems(&mut self, problems: &[Problem]) {
        let mut named: Vec<(String, Problem)> = Vec::with_capacity(problems.len());
        for problem in problems {
            let same = named.iter().filter(|(_, other)| other.code == problem.code).count();
            named.push((format!("{} {same}", problem.code), problem.clone()));
        }
        for new in named.iter().filter(|new| !self.problems.contains(new)) {
            let text = wire::status(Level::Warning, &new.1.message, Some(&new.0));
            self.clients.iter().for_each(|client| report(&client.outbox, text.clone()));
        }
        let over = |(id, _): &&(String, Problem)| !named.iter().any(|(other, _)| other == id);
        let over: Vec<&str> = self.problems.iter().filter(over).map(|(id, _)| id.as_str()).collect();
        if !over.is_empty() {
            let text = wire::remove_status(&over);
            self.clients.iter().for_each(|client| report(&client.outbox, text.clone()));
        }
        self.problems = named;
    }
}

/// How many messages of a channel are kept for who subscribes later; states come by themselves many times a second.
fn kept(channel: &Channel) -> usize {
    match channel.published() {
        Some(Topic::Status | Topic::Jobs | Topic::Session) => 1,
        _ if channel.is_log() => LOG,
        _ => 0,
    }
}

fn first_of(refused: Vec<String>) -> Option<(String, usize)> {
    let others = refused.len().saturating_sub(1);
    refused.into_iter().next().map(|first| (first, others))
}

fn report(outbox: &Outbox, text: String) {
    outbox.push_lossless(Outgoing::Whole(text.into_bytes()));
}

impl Client {
    fn send(&self, place: usize, channel: &Channel, utc_ns: u64, payload: &Arc<[u8]>, metrics: &Metrics) {
        let Some(subscription) = self.subscriptions[place] else { return };
        let message = Outgoing::Viewed { subscription, utc_ns, payload: Arc::clone(payload) };
        metrics.messages.inc();
        if channel.is_lossless() {
            self.outbox.push_lossless(message);
        } else {
            metrics.dropped.inc_by(self.outbox.push_data(message, DropPolicy::Queue));
        }
    }
}

/// One viewer's side of it.
pub(super) struct Viewer {
    id: ClientId,
    outbox: Arc<Outbox>,
    shared: Arc<Shared>,
}

impl Viewer {
    /// Greets the viewer and makes it known; `None` at shutdown.
    pub(super) async fn begin(shared: &Arc<Shared>) -> Option<Self> {
        let id = shared.next_client.fetch_add(1, Ordering::Relaxed);
        let outbox = Arc::new(shared.context.outboxes.open(Encoding::Json, WAITING));
        report(&outbox, shared.viewing.info.clone());
        report(&outbox, shared.viewing.advertise.clone());
        let viewer = Self { id, outbox: Arc::clone(&outbox), shared: Arc::clone(shared) };
        viewer.command(Command::Connect { client: id, outbox }).await.ok()?;
        Some(viewer)
    }

    /// How many channels there are.
    pub(super) fn channels(&self) -> usize {
        self.shared.viewing.channels
    }

    async fn command(&self, command: Command) -> Result<(), Close> {
        self.shared.commands.send(super::Command::Viewer(command)).await.map_err(|_| Close::SHUTDOWN)
    }
}

impl Dialect for Viewer {
    fn outbox(&self) -> Arc<Outbox> {
        Arc::clone(&self.outbox)
    }

    async fn hear(&mut self, received: Received<'_>) -> Result<(), Close> {
        let parsed = match received {
            Received::Text(text) => wire::parse(text.as_bytes()),
            Received::Binary(_) => {
                Err("nothing can be published or called here: this stage is watched".to_owned())
            }
        };
        match parsed {
            Ok(request) => self.command(Command::Ask { client: self.id, request }).await?,
            Err(sentence) => report(&self.outbox, wire::status(Level::Error, &sentence, None)),
        }
        Ok(())
    }

    async fn leave(self) {
        let _ = self.command(Command::Disconnect { client: self.id }).await;
    }
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::super::outbox::Form;
    use super::super::testing::services;
    use super::super::{Command as Publishing, StageServices};
    use super::*;
    use posed_fusion::faults::Cause;
    use posed_protocol::Counters;
    use posed_stage::output::{Estimate, Outcome, OutcomeKind};

    /// Numbers of the subscriptions and times of the messages that wait for a viewer.
    fn data(outbox: &Outbox) -> Vec<(u32, u64)> {
        let (mut out, mut all) = (Vec::new(), Vec::new());
        while let Ok(Some(form)) = outbox.pop(&mut out) {
            if form == Form::Binary {
                let subscription = u32::from_le_bytes(out[1..5].try_into().unwrap());
                all.push((subscription, u64::from_le_bytes(out[5..13].try_into().unwrap())));
            }
            out.clear();
        }
        all
    }

    #[tokio::test]
    async fn a_viewer_that_reads_nothing_loses_the_oldest_and_no_event_and_another_loses_nothing() {
        let stage = "name = \"s\"\n[[device]]\nname = \"d\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
                     [[sensor]]\nname = \"a\"\ndevice = \"d\"\naddress = 1\n";
        let StageServices { shared, mut viewers, mut commands, .. } = services(&Stage::parse(stage).unwrap());
        let channel = |topic| {
            let place = viewers.channels.iter().position(|channel| channel.published() == Some(topic));
            place.unwrap() + 1
        };
        let subscribe = format!(
            r#"{{"op": "subscribe", "subscriptions": [{{"id": 1, "channelId": {}}}, {{"id": 2, "channelId": {}}}]}}"#,
            channel(Topic::Sensors),
            channel(Topic::Faults)
        );
        let (mut stalled, mut reading) =
            (Viewer::begin(&shared).await.unwrap(), Viewer::begin(&shared).await.unwrap());
        for viewer in [&mut stalled, &mut reading] {
            viewer.hear(Received::Text(&subscribe)).await.unwrap();
        }
        while let Ok(Publishing::Viewer(command)) = commands.try_recv() {
            viewers.handle(command);
        }
        let mut counters = Counters::default();
        let mut publish = |item: Item| {
            let stamp = counters.stamp(&item.payload().unwrap());
            viewers.publish(&item, Some(&stamp));
        };
        let what = OutcomeKind::Fault { sensor: 0, cause: Cause::Gate, active: true };
        let t = Timestamp::ZERO;
        publish(Item::Outcome(Box::new(Outcome { t_valid: t, t_decided: t, what })));
        assert_eq!(data(&reading.outbox).len(), 1);
        let surplus = 50;
        for frame in 1..=(WAITING + surplus) as u64 {
            let t_valid = Timestamp::from_nanos(frame as i64 * 1_000_000);
            publish(Item::Estimate(Estimate { frame, t_valid, ..Estimate::default() }));
            assert_eq!(data(&reading.outbox), [(1, frame * 1_000_000)]);
        }
        assert_eq!(shared.metrics.dropped.get(), surplus as u64);
        let waiting = data(&stalled.outbox);
        assert_eq!(waiting[0].0, 2, "the event is first, and there");
        let newest = (surplus + 1..=WAITING + surplus).map(|frame| (1, frame as u64 * 1_000_000));
        assert!(waiting[1..].iter().copied().eq(newest), "{waiting:?}");
    }
}
