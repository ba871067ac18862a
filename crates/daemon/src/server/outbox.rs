//! What waits to be written to one client: two bounded queues that nobody ever waits for.
//!
//! Replies and events are lossless, and a client that lets them pile up is disconnected. Data messages give way: the
//! oldest is dropped and counted. The distributor fills, the client's task empties.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use posed_protocol::foxglove::wire;
use posed_protocol::{DropPolicy, Encoding, Topic, encode};
use posed_stage::Limits;

/// Why the daemon ends a connection, as a websocket closing code and a reason of at most 123 bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Close {
    pub(super) code: u16,
    pub(super) reason: &'static str,
}

impl Close {
    pub(super) const SHUTDOWN: Self = Self { code: 1001, reason: "the daemon is shutting down" };
    pub(super) const RESTART: Self = Self { code: 1012, reason: "the stage has changed: connect again" };
    pub(super) const TOO_SLOW: Self = Self {
        code: 1008,
        reason: "too slow: events and replies have piled up; read faster or subscribe to less",
    };
    pub(super) const TOO_MANY: Self = Self { code: 1008, reason: "too many messages per second" };
    pub(super) const SILENT: Self = Self { code: 1008, reason: "no answer to pings" };
    pub(super) const TOO_LARGE: Self =
        Self { code: 1009, reason: "the message is larger than this daemon takes" };

    /// Whether it is for what the client sent, not for what it did not read or answer.
    pub(super) fn is_breach(&self) -> bool {
        ![Self::SHUTDOWN, Self::RESTART, Self::TOO_SLOW, Self::SILENT].contains(self)
    }
}

/// One message to write.
#[derive(Debug)]
pub(super) enum Outgoing {
    /// A reply or greeting, complete.
    Whole(Vec<u8>),
    /// A data message: the stage's name for who sees several, the client's numbers, and the shared body.
    Shared { stage: Option<Arc<str>>, topic: Topic, stream: usize, seq: u64, body: Arc<[u8]> },
    /// The same for a Foxglove viewer: its number of the subscription, UTC in ns, the shared payload.
    Viewed { subscription: u32, utc_ns: u64, payload: Arc<[u8]> },
    /// What the clock of a Foxglove viewer is to show: UTC in ns.
    Clock(u64),
}

/// What kind of websocket message it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    Text,
    Binary,
}

/// The outboxes of all clients. Clones share the count.
#[derive(Clone, Debug)]
pub(super) struct Outboxes {
    limits: Limits,
    open: Arc<AtomicUsize>,
}

impl Outboxes {
    pub(super) fn new(limits: &Limits) -> Self {
        Self { limits: limits.clone(), open: Arc::default() }
    }

    /// One more, in which up to `queue_messages` data messages wait.
    pub(super) fn open(&self, encoding: Encoding, queue_messages: usize) -> Outbox {
        self.open.fetch_add(1, Ordering::Relaxed);
        let all =
            Self { limits: Limits { queue_messages, ..self.limits.clone() }, open: Arc::clone(&self.open) };
        Outbox { encoding, queues: Mutex::default(), filled: Notify::new(), all }
    }

    /// Bytes that may wait in each of them.
    fn share(&self) -> usize {
        let open = self.open.load(Ordering::Relaxed).max(1);
        self.limits.queue_bytes.min(self.limits.all_queues_bytes / open)
    }
}

/// The queues of one client.
#[derive(Debug)]
pub(super) struct Outbox {
    encoding: Encoding,
    queues: Mutex<Queues>,
    filled: Notify,
    all: Outboxes,
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.all.open.fetch_sub(1, Ordering::Relaxed);
    }
}

#[derive(Debug, Default)]
struct Queues {
    lossless: VecDeque<Outgoing>,
    data: VecDeque<Outgoing>,
    /// Bytes of both queues.
    bytes: usize,
    dropped: u64,
    /// Events or replies had to be refused: the connection ends.
    overflowed: bool,
}

impl Outbox {
    pub(super) fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// Queues a reply or an event. A client that has let too many pile up is closed instead.
    pub(super) fn push_lossless(&self, message: Outgoing) {
        let mut queues = self.lock();
        let bytes = message.bytes();
        let full = queues.lossless.len() >= self.all.limits.lossless_messages
            || queues.bytes + bytes > self.all.share() && !queues.lossless.is_empty();
        if full {
            queues.overflowed = true;
        } else {
            queues.bytes += bytes;
            queues.lossless.push_back(message);
        }
        drop(queues);
        self.filled.notify_one();
    }

    /// Queues a data message; the oldest ones give way. Returns how many did.
    pub(super) fn push_data(&self, message: Outgoing, policy: DropPolicy) -> u64 {
        let mut queues = self.lock();
        let before = queues.dropped;
        match policy {
            // Streams share the queue, so the limit of "latest" counts this one's only.
            DropPolicy::Latest => {
                let waiting =
                    || queues.data.iter().enumerate().filter(|(_, item)| item.stream() == message.stream());
                if waiting().count() >= self.all.limits.latest_messages
                    && let Some((oldest, _)) = waiting().next()
                {
                    queues.drop_data(oldest);
                }
            }
            DropPolicy::Queue => {
                if queues.data.len() >= self.all.limits.queue_messages {
                    queues.drop_data(0);
                }
            }
        }
        let bytes = message.bytes();
        let share = self.all.share();
        while queues.bytes + bytes > share && !queues.data.is_empty() {
            queues.drop_data(0);
        }
        queues.bytes += bytes;
        queues.data.push_back(message);
        let dropped = queues.dropped - before;
        drop(queues);
        self.filled.notify_one();
        dropped
    }

    /// Waits until there may be something to take.
    pub(super) async fn filled(&self) {
        self.filled.notified().await;
    }

    /// Appends the next message to `out`, events and replies first; `None` if nothing waits. `Err` ends the connection.
    pub(super) fn pop(&self, out: &mut Vec<u8>) -> Result<Option<Form>, Close> {
        let mut queues = self.lock();
        if queues.overflowed {
            return Err(Close::TOO_SLOW);
        }
        let next = queues.lossless.pop_front().or_else(|| queues.data.pop_front());
        let Some(message) = next else { return Ok(None) };
        queues.bytes -= message.bytes();
        let dropped = queues.dropped;
        drop(queues);
        let form = match self.encoding {
            Encoding::Json => Form::Text,
            Encoding::MessagePack => Form::Binary,
        };
        Ok(Some(match message {
            Outgoing::Whole(bytes) => {
                out.extend_from_slice(&bytes);
                form
            }
            Outgoing::Shared { stage, topic, seq, body, .. } => {
                out.reserve(body.len() + 128);
                let head = encode::Head { stage: stage.as_deref(), topic, seq, dropped };
                encode::message(self.encoding, head, &body, out);
                form
            }
            Outgoing::Viewed { subscription, utc_ns, payload } => {
                wire::message_data(subscription, utc_ns, &payload, out);
                Form::Binary
            }
            Outgoing::Clock(utc_ns) => {
                wire::time(utc_ns, out);
                Form::Binary
            }
        }))
    }

    fn lock(&self) -> MutexGuard<'_, Queues> {
        // Every change is complete before anything in it could panic.
        self.queues.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Outgoing {
    fn bytes(&self) -> usize {
        match self {
            Self::Whole(bytes) => bytes.len(),
            Self::Shared { body, .. } | Self::Viewed { payload: body, .. } => body.len(),
            Self::Clock(_) => size_of::<Self>(),
        }
    }

    /// What it is one of many of.
    fn stream(&self) -> Option<(Option<&str>, usize)> {
        match self {
            Self::Shared { stage, stream, .. } => Some((stage.as_deref(), *stream)),
            Self::Whole(_) | Self::Viewed { .. } | Self::Clock(_) => None,
        }
    }
}

impl Queues {
    fn drop_data(&mut self, at: usize) {
        if let Some(message) = self.data.remove(at) {
            self.bytes -= message.bytes();
            self.dropped += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits {
            latest_messages: 2,
            queue_messages: 4,
            lossless_messages: 3,
            queue_bytes: 1000,
            ..Limits::default()
        }
    }

    fn outbox() -> Outbox {
        let limits = limits();
        Outboxes::new(&limits).open(Encoding::Json, limits.queue_messages)
    }

    fn data(topic: Topic, seq: u64, bytes: usize) -> Outgoing {
        let body = format!("{:<1$}", r#"{"x":0}"#, bytes).into_bytes();
        Outgoing::Shared { stage: None, topic, stream: topic.index(), seq, body: body.into() }
    }

    fn taken(outbox: &Outbox) -> Vec<String> {
        let mut out = Vec::new();
        let mut all = Vec::new();
        while let Ok(Some(Form::Text)) = outbox.pop(&mut out) {
            let value: serde_json::Value = serde_json::from_slice(&out).unwrap();
            all.push(format!("{} {} {}", value["type"].as_str().unwrap(), value["seq"], value["dropped"]));
            out.clear();
        }
        all
    }

    #[test]
    fn latest_drops_the_oldest_of_its_own_topic() {
        let outbox = outbox();
        outbox.push_data(data(Topic::Status, 0, 10), DropPolicy::Latest);
        for seq in 0..5 {
            outbox.push_data(data(Topic::Sensors, seq, 10), DropPolicy::Latest);
        }
        assert_eq!(taken(&outbox), ["status 0 3", "sensors 3 3", "sensors 4 3"]);
    }

    #[test]
    fn a_queue_is_bounded_by_messages_and_by_bytes() {
        let outbox = outbox();
        for seq in 0..6 {
            outbox.push_data(data(Topic::Sensors, seq, 10), DropPolicy::Queue);
        }
        assert_eq!(taken(&outbox), ["sensors 2 2", "sensors 3 2", "sensors 4 2", "sensors 5 2"]);
        for seq in 6..9 {
            outbox.push_data(data(Topic::Sensors, seq, 400), DropPolicy::Queue);
        }
        assert_eq!(taken(&outbox), ["sensors 7 3", "sensors 8 3"]);
    }

    #[test]
    fn what_all_may_let_wait_is_shared_among_them() {
        let limits = Limits { queue_bytes: 1000, all_queues_bytes: 1200, ..Limits::default() };
        let outboxes = Outboxes::new(&limits);
        let one = outboxes.open(Encoding::Json, 100);
        let fill =
            || (0..10).for_each(|seq| _ = one.push_data(data(Topic::Sensors, seq, 100), DropPolicy::Queue));
        fill();
        assert_eq!(one.lock().bytes, 1000);
        let others = [(); 3].map(|()| outboxes.open(Encoding::Json, 100));
        fill();
        assert_eq!(one.lock().bytes, 300, "a quarter of all");
        drop(others);
        fill();
        assert_eq!(one.lock().bytes, 1000);
    }

    #[test]
    fn what_one_client_lets_wait_costs_no_other_anything() {
        let limits = limits();
        let outboxes = Outboxes::new(&limits);
        let open = || outboxes.open(Encoding::Json, limits.queue_messages);
        let (latest, queue, large, events, other) = (open(), open(), open(), open(), open());
        let mut got = Vec::new();
        for seq in 0..20 {
            latest.push_data(data(Topic::Sensors, seq, 10), DropPolicy::Latest);
            queue.push_data(data(Topic::Sensors, seq, 10), DropPolicy::Queue);
            large.push_data(data(Topic::Sensors, seq, 400), DropPolicy::Queue);
            events.push_lossless(data(Topic::Faults, seq, 10));
            other.push_data(data(Topic::Sensors, seq, 400), DropPolicy::Queue);
            other.push_lossless(data(Topic::Faults, seq, 10));
            got.extend(taken(&other));
        }
        assert_eq!([latest, queue, large].map(|outbox| taken(&outbox).len()), [2, 4, 2]);
        assert_eq!(events.pop(&mut Vec::new()), Err(Close::TOO_SLOW));
        let all = (0..20).flat_map(|seq| [format!("faults {seq} 0"), format!("sensors {seq} 0")]);
        assert!(got.into_iter().eq(all));
    }

    #[test]
    fn events_go_first_and_close_whom_they_flood() {
        let outbox = outbox();
        outbox.push_data(data(Topic::Sensors, 0, 10), DropPolicy::Latest);
        outbox.push_lossless(data(Topic::Faults, 0, 10));
        assert_eq!(taken(&outbox), ["faults 0 0", "sensors 0 0"]);
        for seq in 1..5 {
            outbox.push_lossless(data(Topic::Faults, seq, 10));
        }
        assert_eq!(outbox.pop(&mut Vec::new()), Err(Close::TOO_SLOW));
    }
}
