//! A stage's session: two threads that hand what is published and what was logged to zenoh, and one that answers.
//!
//! zenoh makes who publishes an event wait while a link is congested: that is why they are threads of their own.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, Sender, bounded, select};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

use super::answers::Answers;
use super::feed::{About, Feed, Out};
use super::log::Log;
use super::session;
use super::wire::Keys;
use crate::daemon::clock::StageClock;
use crate::daemon::fusion::FusionInbox;
use crate::protocol::Topic;
use crate::stage::{Stage, Zenoh};

/// A stage's end of zenoh; ends when dropped.
#[derive(Debug)]
pub(in crate::daemon) struct Mesh {
    feed: Feed,
    log: Log,
    /// Ends the threads when it is gone.
    stop: Option<Sender<()>>,
    threads: Vec<JoinHandle<()>>,
}

impl Mesh {
    /// Opens the session and declares the stage; `recordings` is the folder they are in. The error is a sentence for the operator.
    pub(in crate::daemon) fn start(
        stage: &Stage,
        settings: &Zenoh,
        clock: StageClock,
        inbox: FusionInbox,
        recordings: PathBuf,
    ) -> Result<Self, String> {
        let run = clock.epoch_utc_ns();
        let stage_toml = stage.shareable_toml()?;
        let keys = Keys::new(settings.key_of(stage));
        let (feed, out) =
            Feed::new(About { key: keys.stage().to_owned(), run, stage_toml: stage_toml.clone() });
        let log = Log::new(run);
        let (stop, stopped) = bounded(0);
        let answers = Answers {
            keys: keys.clone(),
            feed: feed.clone(),
            log: log.clone(),
            clock,
            inbox,
            recordings,
            stage_toml,
        };
        let session = thread("zenoh-open", {
            let settings = settings.clone();
            move || session::open(&settings)
        })?
        .join()
        .map_err(|_| "[zenoh]: zenoh has crashed at its start".to_owned())??;

        let (failed, begun) = bounded(2);
        let mut threads = vec![thread("zenoh-feed", {
            let (session, keys, feed, stopped, failed) =
                (session.clone(), keys.clone(), feed.clone(), stopped.clone(), failed.clone());
            move || {
                let declared = Publishers::declare(&session, &keys, &feed);
                let _ = failed.send(declared.as_ref().err().map(ToString::to_string));
                if let Ok(publishers) = declared {
                    publishers.run(&out, &stopped);
                }
            }
        })?];
        threads.push(thread("zenoh-log", {
            let (session, keys, log) = (session.clone(), keys.clone(), log.clone());
            move || {
                let declared = declare_log(&session, &keys, &log);
                let _ = failed.send(declared.as_ref().err().map(ToString::to_string));
                if let Ok(publisher) = declared {
                    run_log(&publisher, &log);
                }
            }
        })?);
        let mesh = Self { feed, log, stop: Some(stop), threads };
        if let Some(error) = begun.iter().take(2).flatten().next() {
            return Err(format!("[zenoh]: {error}"));
        }
        let mut mesh = mesh;
        mesh.threads.push(answers.start(session, stopped)?);
        tracing::info!("on zenoh as {}", keys.stage());
        Ok(mesh)
    }

    /// Where what is published goes in.
    pub(in crate::daemon) fn feed(&self) -> Feed {
        self.feed.clone()
    }

    /// Where the input log goes in.
    pub(in crate::daemon) fn log(&self) -> Log {
        self.log.clone()
    }
}

impl Drop for Mesh {
    fn drop(&mut self) {
        self.stop = None;
        self.log.end();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "the daemon owns the threads that call zenoh")]
pub(super) fn thread<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, String> {
    let spawned = std::thread::Builder::new().name(name.to_owned()).spawn(run);
    spawned.map_err(|error| format!("the system gives no thread for zenoh: {error}"))
}

/// What the feed goes out by.
struct Publishers {
    states: Publisher<'static>,
    events: Publisher<'static>,
    topics: Vec<Publisher<'static>>,
}

impl Publishers {
    fn declare(session: &Session, keys: &Keys, feed: &Feed) -> zenoh::Result<Self> {
        let states = state(session, keys.states())?;
        let events = event(session, keys.events())?;
        follow(&states, feed, |feed, wanted| feed.wanted().feed.store(wanted, Ordering::Relaxed))?;
        let topics = Topic::ALL.into_iter().map(|topic| {
            let publisher = if topic.is_event() {
                event(session, keys.topic(topic))
            } else {
                state(session, keys.topic(topic))
            }?;
            follow(&publisher, feed, move |feed, wanted| {
                feed.wanted().topics[topic.index()].store(wanted, Ordering::Relaxed);
            })?;
            Ok(publisher)
        });
        Ok(Self { topics: topics.collect::<zenoh::Result<_>>()?, states, events })
    }

    /// Until the stage ends.
    fn run(&self, out: &Receiver<Out>, stopped: &Receiver<()>) {
        loop {
            let out = select! {
                recv(out) -> out => out,
                recv(stopped) -> _ => return,
            };
            let put = match out {
                Ok(Out::States(bytes)) => self.states.put(bytes).wait(),
                Ok(Out::Events(bytes)) => self.events.put(bytes.to_vec()).wait(),
                Ok(Out::Public(topic, json)) => self.topics[topic.index()].put(json).wait(),
                Err(_) => return,
            };
            if let Err(error) = put {
                // The session is closed, or the link just broke: who misses something asks for it.
                tracing::debug!(%error, "zenoh");
            }
        }
    }
}

/// A publisher of what may be dropped.
fn state(session: &Session, key: String) -> zenoh::Result<Publisher<'static>> {
    session.declare_publisher(key).congestion_control(CongestionControl::Drop).express(true).wait()
}

/// A publisher of what should not, and goes first.
fn event(session: &Session, key: String) -> zenoh::Result<Publisher<'static>> {
    let publisher = session.declare_publisher(key).congestion_control(CongestionControl::Block);
    publisher.priority(Priority::DataHigh).express(true).wait()
}

/// Tells the feed, now and whenever it changes, whether somebody has subscribed.
fn follow(
    publisher: &Publisher<'static>,
    feed: &Feed,
    tell: impl Fn(&Feed, bool) + Send + Sync + 'static,
) -> zenoh::Result<()> {
    let tell = Arc::new(tell);
    let (listening, told) = (feed.clone(), Arc::clone(&tell));
    publisher
        .matching_listener()
        .callback(move |status| told(&listening, status.matching()))
        .background()
        .wait()?;
    tell(feed, publisher.matching_status().wait()?.matching());
    Ok(())
}

fn declare_log(session: &Session, keys: &Keys, log: &Log) -> zenoh::Result<Publisher<'static>> {
    let publisher = session.declare_publisher(keys.log()).congestion_control(CongestionControl::Block);
    // Behind everything that a person looks at.
    let publisher = publisher.priority(Priority::DataLow).wait()?;
    let wanted = log.clone();
    publisher
        .matching_listener()
        .callback(move |status| wanted.want(status.matching()))
        .background()
        .wait()?;
    log.want(publisher.matching_status().wait()?.matching());
    Ok(publisher)
}

/// Sends the log while somebody follows it, until it ends. Who has missed something sees it by the numbers, and asks.
fn run_log(publisher: &Publisher<'static>, log: &Log) {
    let mut from = log.next();
    while let Some(chunk) = log.wait_from(from) {
        from = chunk.first + chunk.entries.len() as u64;
        if !log.is_wanted() {
            continue;
        }
        match rmp_serde::to_vec(&chunk).map(|bytes| publisher.put(bytes).wait()) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::debug!(%error, "zenoh: log"),
            Err(error) => tracing::error!(%error, "zenoh: log"),
        }
    }
}
