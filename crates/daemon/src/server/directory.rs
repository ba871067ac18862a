//! One websocket for all stages of a hub: who wants what of which stage, also of stages that come later.
//!
//! In: clients, what they ask for, stages that come in, what is said of all of them. Out: subscriptions at each stage's
//! distributor, in the clients' name; the stages write into the clients' outboxes themselves. One task, one thing at a time.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use serde_json::Value;
use tokio::sync::mpsc;

use super::client::{Dialect, Received};
use super::distributor::{self, ClientId};
use super::listen::ConnectionContext;
use super::metrics::Metrics;
use super::outbox::{Close, Outbox, Outgoing};
use posed_protocol::{
    Encoding, ErrorReply, Feed, Hello, OkReply, Request, RequestId, ServerMessage, Stages, encode, parse,
    unpack,
};
use posed_stage::{Pose, Role};

/// Numbers of these clients are others than those of clients of one stage.
static NEXT: AtomicU64 = AtomicU64::new(1 << 63);
/// Standing subscriptions of one client at most, and the memory that their lists take, bytes.
const WISHES: usize = 256;
const WISH_BYTES: usize = 64 << 10;

/// What the directory receives.
pub(super) enum Command {
    Connect {
        client: ClientId,
        outbox: Arc<Outbox>,
    },
    Ask {
        client: ClientId,
        id: RequestId,
        stages: Option<Vec<String>>,
        feed: Feed,
    },
    Disconnect {
        client: ClientId,
    },
    /// A stage has come in, perhaps in the place of an older one.
    Joined {
        id: Arc<str>,
        commands: mpsc::Sender<super::Command>,
    },
    /// A stage is forgotten.
    Left {
        id: Arc<str>,
    },
    Tell(Stages),
}

/// What everybody gets first.
pub(super) struct Greeting {
    pub(super) name: String,
    pub(super) epoch_utc: String,
}

/// See the module.
pub(super) struct Directory {
    metrics: Arc<Metrics>,
    stages: BTreeMap<Arc<str>, mpsc::Sender<super::Command>>,
    clients: BTreeMap<ClientId, Client>,
    newest: Option<Stages>,
}

struct Client {
    outbox: Arc<Outbox>,
    /// Subscriptions as they were asked for, which hold for stages that come later too.
    wishes: Vec<(RequestId, Option<Vec<String>>, Feed)>,
}

impl Client {
    fn has_room_for(&self, stages: Option<&[String]>, feed: &Feed) -> bool {
        let taken: usize =
            self.wishes.iter().map(|(_, stages, feed)| bytes_of(stages.as_deref(), feed)).sum();
        self.wishes.len() < WISHES && taken + bytes_of(stages, feed) <= WISH_BYTES
    }
}

/// Memory that the lists of a request take.
fn bytes_of(stages: Option<&[String]>, feed: &Feed) -> usize {
    let names = |names: &[String]| names.iter().map(|name| size_of::<String>() + name.len()).sum::<usize>();
    let in_feed = match feed {
        Feed::Subscribe { topics, sensors, fields, .. } => {
            topics.len() + sensors.as_deref().map_or(0, names) + fields.as_ref().map_or(0, Vec::len)
        }
        Feed::Unsubscribe { topics } => topics.len(),
        Feed::Resume { .. } => 0,
    };
    stages.map_or(0, names) + in_feed
}

impl Directory {
    pub(super) fn new(metrics: Arc<Metrics>) -> Self {
        Self { metrics, stages: BTreeMap::new(), clients: BTreeMap::new(), newest: None }
    }

    /// Until nobody can ask any more.
    pub(super) async fn run(mut self, mut commands: mpsc::Receiver<Command>) {
        while let Some(command) = commands.recv().await {
            match command {
                Command::Connect { client, outbox } => {
                    if let Some(stages) = &self.newest {
                        report(&outbox, &ServerMessage::Stages(stages.clone()));
                    }
                    for (id, stage) in &self.stages {
                        connect(stage, client, &outbox, id).await;
                    }
                    self.clients.insert(client, Client { outbox, wishes: Vec::new() });
                }
                Command::Disconnect { client } => {
                    self.clients.remove(&client);
                    for stage in self.stages.values() {
                        send(stage, distributor::Command::Disconnect { client }).await;
                    }
                }
                Command::Ask { client, id, stages, feed } => self.ask(client, id, stages, feed).await,
                Command::Joined { id, commands } => {
                    for (client, Client { outbox, wishes }) in &self.clients {
                        connect(&commands, *client, outbox, &id).await;
                        for (request, stages, feed) in wishes {
                            if wanted(stages.as_deref(), &id) {
                                let (id, feed) = (request.clone(), feed.clone());
                                send(&commands, distributor::Command::Feed { client: *client, id, feed })
                                    .await;
                            }
                        }
                    }
                    self.stages.insert(id, commands);
                }
                Command::Left { id } => _ = self.stages.remove(&id),
                Command::Tell(stages) => {
                    for client in self.clients.values() {
                        report(&client.outbox, &ServerMessage::Stages(stages.clone()));
                        self.metrics.messages.inc();
                    }
                    self.newest = Some(stages);
                }
            }
        }
    }

    async fn ask(&mut self, client: ClientId, id: RequestId, stages: Option<Vec<String>>, feed: Feed) {
        let Some(asking) = self.clients.get_mut(&client) else { return };
        let outbox = Arc::clone(&asking.outbox);
        let refuse = |code: &str, message: String| {
            report(&outbox, &ServerMessage::Error(ErrorReply::new(Some(id.clone()), code, message)));
        };
        match &feed {
            Feed::Subscribe { .. } if !asking.has_room_for(stages.as_deref(), &feed) => {
                return refuse("busy", "too many subscriptions on one connection; unsubscribe first".into());
            }
            Feed::Subscribe { topics, .. } if topics.is_empty() => {
                return refuse("bad_request", "subscribe to at least one topic".into());
            }
            Feed::Subscribe { .. } => asking.wishes.push((id.clone(), stages.clone(), feed.clone())),
            Feed::Unsubscribe { topics } => {
                for (_, of, wish) in &mut asking.wishes {
                    if let Feed::Subscribe { topics: wished, .. } = wish
                        && (stages.is_none() || *of == stages)
                    {
                        wished.retain(|topic| !topics.contains(topic));
                    }
                }
                asking.wishes.retain(
                    |(_, _, wish)| !matches!(wish, Feed::Subscribe { topics, .. } if topics.is_empty()),
                );
            }
            Feed::Resume { .. } => {
                // Each stage counts its own events.
                if stages.as_ref().is_none_or(|stages| stages.len() != 1) {
                    return refuse("bad_request", "resume: name the stage, as \"stages\": [\"NAME\"]".into());
                }
            }
        }
        let unknown = stages.iter().flatten().find(|name| !self.stages.contains_key(name.as_str()));
        if let (Some(unknown), Feed::Resume { .. }) = (unknown, &feed) {
            return refuse("unknown_stage", format!("this hub has not heard of a stage {unknown:?}"));
        }
        if !matches!(feed, Feed::Resume { .. }) {
            // Before what follows from it.
            report(&outbox, &ServerMessage::Ok(OkReply { id: Some(id.clone()), result: None }));
        }
        for (name, stage) in &self.stages {
            if wanted(stages.as_deref(), name) {
                let (id, feed) = (id.clone(), feed.clone());
                send(stage, distributor::Command::Feed { client, id, feed }).await;
            }
        }
    }
}

fn wanted(stages: Option<&[String]>, id: &str) -> bool {
    stages.is_none_or(|stages| stages.iter().any(|name| name == id))
}

async fn connect(
    stage: &mpsc::Sender<super::Command>,
    client: ClientId,
    outbox: &Arc<Outbox>,
    id: &Arc<str>,
) {
    let (outbox, stage_name) = (Arc::clone(outbox), Some(Arc::clone(id)));
    send(stage, distributor::Command::Connect { client, outbox, stage: stage_name }).await;
}

/// A stage that has just left has nobody to tell.
async fn send(stage: &mpsc::Sender<super::Command>, command: distributor::Command) {
    let _ = stage.send(super::Command::Client(command)).await;
}

fn report(outbox: &Outbox, message: &ServerMessage) {
    outbox.push_lossless(Outgoing::Whole(encode::whole(outbox.encoding(), message)));
}

/// One client's side of it.
pub(super) struct Member {
    id: ClientId,
    outbox: Arc<Outbox>,
    directory: mpsc::Sender<Command>,
}

impl Member {
    /// Greets the client and makes it known; `None` at shutdown.
    pub(super) async fn begin(
        encoding: Encoding,
        greeting: &Greeting,
        directory: mpsc::Sender<Command>,
        context: &ConnectionContext,
    ) -> Option<Self> {
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        let outbox = Arc::new(context.outboxes.open(encoding, context.limits.queue_messages));
        let hello = Hello {
            version: env!("CARGO_PKG_VERSION").into(),
            stage: greeting.name.clone(),
            epoch_utc: greeting.epoch_utc.clone(),
            bodies: Vec::new(),
            skeleton: None,
            height_m: None,
            topics: Vec::new(),
            sensors: Vec::new(),
            transmitter: Pose::IDENTITY,
            transmitter_given: false,
            role: Role::Watch,
            last_event_id: 0,
        };
        report(&outbox, &ServerMessage::Hello(hello));
        directory.send(Command::Connect { client: id, outbox: Arc::clone(&outbox) }).await.ok()?;
        Some(Self { id, outbox, directory })
    }
}

impl Dialect for Member {
    fn outbox(&self) -> Arc<Outbox> {
        Arc::clone(&self.outbox)
    }

    async fn hear(&mut self, received: Received<'_>) -> Result<(), Close> {
        match read(received) {
            Ok((id, stages, feed)) => {
                let command = Command::Ask { client: self.id, id, stages, feed };
                self.directory.send(command).await.map_err(|_| Close::SHUTDOWN)
            }
            Err(error) => {
                report(&self.outbox, &ServerMessage::Error(error));
                Ok(())
            }
        }
    }

    async fn leave(self) {
        let _ = self.directory.send(Command::Disconnect { client: self.id }).await;
    }
}

/// A request as at one stage, with `stages` beside it: names, absent for all.
fn read(received: Received<'_>) -> Result<(RequestId, Option<Vec<String>>, Feed), ErrorReply> {
    let bad = |message: String| ErrorReply::new(None, "bad_request", message);
    let mut value: Value = match received {
        Received::Text(text) => serde_json::from_str(text).map_err(|error| bad(error.to_string()))?,
        Received::Binary(bytes) => unpack(bytes).map_err(|error| bad(error.to_string()))?,
    };
    let stages = value.as_object_mut().and_then(|map| map.remove("stages"));
    let stages = stages.map(serde_json::from_value::<Vec<String>>).transpose();
    let stages = stages.map_err(|_| bad("stages: give a list of names".into()))?;
    match parse(Encoding::Json, value.to_string().as_bytes()) {
        // Before it waits anywhere.
        Ok((id, Request::Feed(feed))) if bytes_of(stages.as_deref(), &feed) > WISH_BYTES => {
            let message = "the lists of this request are too long".to_owned();
            Err(ErrorReply::new(Some(id), "too_large", message))
        }
        Ok((id, Request::Feed(feed))) => Ok((id, stages, feed)),
        Ok((id, Request::Call(_))) => {
            let message = "a hub shows its stages; ask the daemon of the stage itself for this";
            Err(ErrorReply::new(Some(id), "hub", message))
        }
        Err(error) => Err(ErrorReply::new(error.id, error.code, error.message)),
    }
}

/// What the fuzz target does with any message of a hub's client: a request, or an error with a sentence.
#[doc(hidden)]
pub fn fuzz_hub_message(data: &[u8]) {
    let text = std::str::from_utf8(data).ok().map(Received::Text);
    for received in text.into_iter().chain([Received::Binary(data)]) {
        match read(received) {
            Ok((_, stages, feed)) => assert!(bytes_of(stages.as_deref(), &feed) <= WISH_BYTES),
            Err(error) => assert!(!error.message.is_empty()),
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_protocol::Topic;
    use serde_json::json;

    use super::super::testing::received;
    use super::*;

    fn subscribe() -> Feed {
        Feed::Subscribe {
            topics: vec![Topic::Sensors],
            max_rate_hz: None,
            sensors: None,
            fields: None,
            drop: None,
        }
    }

    #[tokio::test]
    async fn who_subscribes_without_end_is_refused_and_the_others_are_not() {
        let mut directory = Directory::new(Arc::new(Metrics::new()));
        let (stage_in, mut stage) = mpsc::channel(4 * WISHES);
        directory.stages.insert("a".into(), stage_in);
        let outboxes = super::super::outbox::Outboxes::new(&posed_stage::Limits::default());
        let clients = [1, 2, 3].map(|client| {
            let outbox = Arc::new(outboxes.open(Encoding::Json, 16));
            directory.clients.insert(client, Client { outbox: Arc::clone(&outbox), wishes: Vec::new() });
            outbox
        });
        for id in 0..WISHES as i64 + 10 {
            directory.ask(1, RequestId::Number(id), None, subscribe()).await;
        }
        // One whose lists are long is refused before.
        let long = Some(vec!["a".repeat(14); 500]);
        for id in 0..5 {
            directory.ask(2, RequestId::Number(id), long.clone(), subscribe()).await;
        }
        directory.ask(3, RequestId::Number(7), None, subscribe()).await;
        let [many, large, other] = clients.map(|outbox| received(&outbox));
        let served = |answers: &[Value]| answers.iter().take_while(|answer| answer["type"] == "ok").count();
        let is_busy = |answers: &[Value]| answers.iter().all(|answer| answer["code"] == "busy");
        assert_eq!((many.len(), served(&many)), (WISHES + 10, WISHES));
        assert!(is_busy(&many[WISHES..]));
        assert_eq!((large.len(), served(&large)), (5, 3));
        assert!(is_busy(&large[3..]));
        assert_eq!((other.len(), served(&other)), (1, 1));
        // The stage has heard of those that were taken and are about it.
        assert_eq!(std::iter::from_fn(|| stage.try_recv().ok()).count(), WISHES + 1);
    }

    #[test]
    fn what_a_client_wants_takes_no_more_than_its_budget() {
        let long = json!({"id": 1, "type": "subscribe", "topics": ["sensors"], "stages": vec![""; 10_000]})
            .to_string();
        let refused = read(Received::Text(&long)).unwrap_err();
        assert_eq!((refused.id, refused.code.as_ref()), (Some(RequestId::Number(1)), "too_large"));

        let outboxes = crate::server::outbox::Outboxes::new(&posed_stage::Limits::default());
        let outbox = Arc::new(outboxes.open(Encoding::Json, 16));
        let mut client = Client { outbox, wishes: Vec::new() };
        let stages = vec!["a stage's name".to_owned(); 500];
        let feed = subscribe();
        while client.has_room_for(Some(&stages), &feed) {
            client.wishes.push((RequestId::Number(2), Some(stages.clone()), feed.clone()));
        }
        assert_eq!(client.wishes.len(), 3);
        assert!(client.has_room_for(None, &feed), "a short one still has room");
    }
}
