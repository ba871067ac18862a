//! A stage's end for ROS 2: a thread with a session of its own, a client of the router that ROS 2 starts.
//!
//! In: frames and bodies, on the distributor's task, which turns them into messages while there is a router. Out: puts by that thread. Where it lags, messages
//! are lost, which the status says; nobody waits. Nothing comes in from ROS 2.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded, select, tick};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

use super::session::{open_client, thread};
use posed_daemon::StageClock;
use posed_daemon::link::{Context, Feed, Link};
use posed_daemon::server::Item;
use posed_protocol::ros2::{self, DEFAULT_ROUTER, attachment, gid};
use posed_protocol::{Names, Problem, Stamp};

/// Messages that wait for the thread: those of a hundred sensors for several frames.
const WAITING: usize = 2048;
/// How long a router may take to answer, ms, before the thread looks whether the stage has ended, and asks again.
const OPEN_MS: u32 = 1000;
/// How often the thread looks whether the router is there.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Publishes a stage as `[ros2]` of its file specifies, or as that table's defaults do, as soon as its router answers. Dropping the session takes the stage off ROS 2 and
/// waits for the thread to end.
///
/// # Errors
/// A [`LinkError`](super::session::LinkError): there is no thread.
pub fn publish_ros2(context: Context<'_>) -> zenoh::Result<Link> {
    let Context { stage, clock, .. } = context;
    let settings = stage.ros2.clone().unwrap_or_default();
    let routers = settings.connect.clone().unwrap_or_else(|| vec![DEFAULT_ROUTER.to_owned()]);
    let publisher = ros2::Publisher::new(stage, &settings, clock.epoch_utc_ns());
    let (sender, messages) = bounded(WAITING);
    let (stop, stopped) = bounded(0);
    let shared = Arc::new(Shared::default());
    let seen = Arc::clone(&shared);
    let (node, topics) = (publisher.node().clone(), publisher.topics().to_vec());
    let at = routers.join(", ");
    let runs = thread("ros2", move || {
        let run = Run { routers, node, topics, clock, shared: seen };
        run.until(&stopped, &messages);
    });
    let session = Running { stop: Some(stop), thread: Some(runs?) };
    let feed = Ros2Feed { publisher: Mutex::new(publisher), sender, shared, at };
    Ok(Link { feed: Box::new(feed), log: None, session: Box::new(session) })
}

/// What the thread and the feed know of each other.
#[derive(Debug, Default)]
struct Shared {
    is_connected: AtomicBool,
    /// The thread has panicked.
    is_broken: AtomicBool,
    /// Messages that found no room since the status last said so.
    lost: AtomicU64,
}

/// A message and the place of its topic.
type Message = (usize, Vec<u8>);

/// Where items go in.
struct Ros2Feed {
    /// Only the distributor's task has it; the lock is what makes that plain.
    publisher: Mutex<ros2::Publisher>,
    sender: Sender<Message>,
    shared: Arc<Shared>,
    /// The routers' addresses.
    at: String,
}

impl Feed for Ros2Feed {
    fn publish(&self, item: &Item, _: &Stamp, _: &Names) {
        if !self.shared.is_connected.load(Ordering::Relaxed) {
            return;
        }
        let mut publisher = self.publisher.lock().unwrap_or_else(PoisonError::into_inner);
        let send = |topic, bytes| match self.sender.try_send((topic, bytes)) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => _ = self.shared.lost.fetch_add(1, Ordering::Relaxed),
            Err(TrySendError::Disconnected(_)) => self.shared.is_broken.store(true, Ordering::Relaxed),
        };
        match item {
            Item::Estimate(estimate) => publisher.frame(estimate, send),
            Item::Body(body) => publisher.body(body, send),
            _ => {}
        }
    }

    fn problem(&self) -> Option<Problem> {
        if self.shared.is_broken.load(Ordering::Relaxed) {
            let message = "what publishes for ROS 2 had a fault of its own, and it gets nothing more: restart posed, and please report this";
            return Some(Problem::new("ros2", message.to_owned()));
        }
        let lost = self.shared.lost.swap(0, Ordering::Relaxed);
        if !self.shared.is_connected.load(Ordering::Relaxed) {
            let at = &self.at;
            let message = format!(
                "no router of ROS 2 answers at {at}: start it with `ros2 run rmw_zenoh_cpp rmw_zenohd`, or give its address as ros2.connect"
            );
            return Some(Problem::new("ros2_router", message).with("at", at));
        }
        (lost > 0).then(|| {
            let message = format!("zenoh is too slow for this stage: {lost} of its messages to ROS 2 were left out in the last second");
            Problem::new("ros2_slow", message).with("lost", lost)
        })
    }
}

/// The thread; ends when dropped.
#[derive(Debug)]
struct Running {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread has.
struct Run {
    routers: Vec<String>,
    node: ros2::Node,
    topics: Vec<ros2::Topic>,
    clock: StageClock,
    shared: Arc<Shared>,
}

impl Run {
    /// Until the stage ends.
    fn until(&self, stopped: &Receiver<()>, messages: &Receiver<Message>) {
        loop {
            match open_client(&self.routers, OPEN_MS) {
                Ok(session) => {
                    if let Err(error) = self.publish(&session, messages, stopped) {
                        tracing::warn!("[ros2]: {error}");
                    }
                    self.shared.is_connected.store(false, Ordering::Relaxed);
                    let _ = session.close().wait();
                }
                Err(error) => tracing::debug!(%error, "[ros2]"),
            }
            match stopped.recv_timeout(LOOK_EVERY) {
                Err(RecvTimeoutError::Timeout) => {}
                _ => return,
            }
        }
    }

    /// Declares the node and its publishers, and puts what comes, until the stage ends.
    fn publish(
        &self,
        session: &Session,
        messages: &Receiver<Message>,
        stopped: &Receiver<()>,
    ) -> zenoh::Result<()> {
        let zid = session.zid().to_string();
        let _node = session.liveliness().declare_token(self.node.token(&zid)).wait()?;
        let declare = |(at, topic)| Declared::new(session, &self.node, &zid, at, topic);
        let mut topics = self.topics.iter().enumerate().map(declare).collect::<zenoh::Result<Vec<_>>>()?;
        tracing::info!("on ROS 2 by the router at {}", self.routers.join(", "));
        let look = || {
            let has_router = session.info().routers_zid().wait().next().is_some();
            self.shared.is_connected.store(has_router, Ordering::Relaxed);
        };
        look();
        let looks = tick(LOOK_EVERY);
        loop {
            select! {
                recv(messages) -> message => {
                    let Ok((topic, bytes)) = message else { return Ok(()) };
                    let utc_ns = self.clock.epoch_utc_ns() + self.clock.now().as_nanos();
                    if let Err(error) = topics[topic].put(bytes, utc_ns) {
                        // The link just broke; the next message says all of it again.
                        tracing::debug!(%error, "[ros2]");
                    }
                }
                recv(looks) -> _ => look(),
                recv(stopped) -> _ => return Ok(()),
            }
        }
    }
}

/// A topic's publisher.
struct Declared {
    publisher: Publisher<'static>,
    _token: LivelinessToken,
    gid: [u8; 16],
    number: i64,
}

impl Declared {
    fn new(
        session: &Session,
        node: &ros2::Node,
        zid: &str,
        at: usize,
        topic: &ros2::Topic,
    ) -> zenoh::Result<Self> {
        let token = node.publisher_token(zid, at, topic);
        let publisher = session.declare_publisher(node.key(topic));
        Ok(Self {
            publisher: publisher.congestion_control(CongestionControl::Drop).wait()?,
            gid: gid(&token),
            _token: session.liveliness().declare_token(token).wait()?,
            number: 0,
        })
    }

    fn put(&mut self, bytes: Vec<u8>, utc_ns: i64) -> zenoh::Result<()> {
        self.number += 1;
        self.publisher.put(bytes).attachment(attachment(self.number, utc_ns, self.gid)).wait()
    }
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;
    use posed_protocol::Topic;
    use posed_stage::Stage;
    use posed_stage::output::{Body, SegmentState};

    use super::*;

    #[test]
    fn what_finds_no_room_is_counted_and_said_once_and_a_thread_that_is_gone_for_good() {
        let stage = Stage::parse(
            "name = \"a\"\n[ros2]\n[body]\nheight_m = 1.8\n[[device]]\nname = \"f\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
             [[sensor]]\nname = \"torso\"\ndevice = \"f\"\naddress = 1\n",
        )
        .unwrap();
        let (sender, messages) = bounded(WAITING);
        let publisher = ros2::Publisher::new(&stage, &posed_stage::Ros2::default(), 0);
        let (shared, at) = (Arc::new(Shared::default()), DEFAULT_ROUTER.to_owned());
        let feed = Ros2Feed { publisher: Mutex::new(publisher), sender, shared: Arc::clone(&shared), at };
        let mut body = Body::unknown(0, 1);
        (body.segments[0].state, body.segments[0].position_m) = (SegmentState::Ok, Some([0.0; 3]));
        body.segments[0].orientation_wxyz = Some([1.0, 0.0, 0.0, 0.0]);
        let mut t_ns = 0..;
        let mut publish = |count: usize| {
            for n in t_ns.by_ref().take(count) {
                let body = Body { t_valid: Timestamp::from_nanos(n), ..body.clone() };
                let stamp = Stamp { topic: Topic::Body, body: 0, t_us: n, event_id: None, timecode: None };
                feed.publish(&Item::Body(Box::new(body)), &stamp, &Names::default());
            }
        };
        publish(1);
        assert!(messages.is_empty() && feed.problem().unwrap().message.contains(DEFAULT_ROUTER));
        shared.is_connected.store(true, Ordering::Relaxed);
        publish(WAITING + 5);
        assert_eq!(messages.len(), WAITING);
        assert!(feed.problem().unwrap().message.contains(": 5 of its messages"));
        assert_eq!(feed.problem(), None);
        drop(messages);
        publish(1);
        assert_eq!(feed.problem().unwrap().code, "ros2");
    }
}
