//! A stage's session: two threads that hand what is published and what was logged to zenoh, and one that answers.
//!
//! zenoh makes who publishes an event wait while a link is congested: that is why they are threads of their own.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, Sender, bounded, select};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

use super::answers::Answers;
use super::feed::{Feed, Out, StageInfo};
use super::input_log::Log;
use super::session::{self, LinkError, thread};
use super::wire::Keys;
use posed_daemon::link::{Context, Link};
use posed_protocol::Topic;

/// Connects a stage as `[zenoh]` of its file specifies, or as that table's defaults do. Blocks while zenoh opens. Dropping the
/// link's session takes the stage off zenoh and waits for its threads to end.
///
/// # Errors
/// A [`LinkError`].
pub fn connect(context: Context<'_>) -> zenoh::Result<Link> {
    Ok(Threads::start(context)?)
}

/// The threads of a stage's session; end when dropped.
#[derive(Debug)]
struct Threads {
    log: Log,
    /// Ends the threads when it is gone.
    stop: Option<Sender<()>>,
    threads: Vec<JoinHandle<()>>,
}

impl Threads {
    /// Opens the session and declares the stage.
    fn start(context: Context<'_>) -> Result<Link, LinkError> {
        let Context { stage, clock, inbox, recordings } = context;
        let settings = stage.zenoh.clone().unwrap_or_default();
        let run = clock.epoch_utc_ns();
        let stage_toml = stage.shareable_toml().map_err(LinkError::Stage)?;
        let keys = Keys::new(settings.key_of(stage));
        let (feed, out) =
            Feed::new(StageInfo { key: keys.stage().to_owned(), run, stage_toml: stage_toml.clone() });
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
            move || session::open(&settings, session::End::Stage)
        })?
        .join()
        .map_err(|_| LinkError::Crashed)??;

        let (failed, begun) = bounded(2);
        let mut threads = vec![thread("zenoh-feed", {
            let (session, keys, feed, stopped, failed) =
                (session.clone(), keys.clone(), feed.clone(), stopped.clone(), failed.clone());
            move || {
                let declared = Publishers::declare(&session, &keys, &feed);
                let _ = failed.send(declared.as_ref().err().map(ToString::to_string));
                if let Ok(publishers) = declared {
                    feed.guard("what publishes on zenoh", || publishers.run(&out, &stopped));
                }
            }
        })?];
        threads.push(thread("zenoh-log", {
            let (session, keys, log, feed) = (session.clone(), keys.clone(), log.clone(), feed.clone());
            move || {
                let declared = declare_log(&session, &keys, &log);
                let _ = failed.send(declared.as_ref().err().map(ToString::to_string));
                if let Ok(publisher) = declared {
                    feed.guard("what passes the input log on", || run_log(&publisher, &log));
                }
            }
        })?);
        let mut this = Self { log: log.clone(), stop: Some(stop), threads };
        if let Some(error) = begun.iter().take(2).flatten().next() {
            return Err(LinkError::Zenoh(error.into()));
        }
        feed.links().watch(session.clone(), settings, stopped.clone())?;
        this.threads.push(answers.start(session, stopped)?);
        tracing::info!("on zenoh as {}", keys.stage());
        Ok(Link { feed: Box::new(feed), log: Some(Box::new(log)), session: Box::new(this) })
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.stop = None;
        self.log.end();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// What the feed goes out by.
struct Publishers {
    frames: Publisher<'static>,
    states: Publisher<'static>,
    events: Publisher<'static>,
    topics: Vec<Publisher<'static>>,
}

impl Publishers {
    fn declare(session: &Session, keys: &Keys, feed: &Feed) -> zenoh::Result<Self> {
        let frames = state(session, keys.frames())?;
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
        Ok(Self { topics: topics.collect::<zenoh::Result<_>>()?, frames, states, events })
    }

    /// Until the stage ends.
    fn run(&self, out: &Receiver<Out>, stopped: &Receiver<()>) {
        loop {
            let out = select! {
                recv(out) -> out => out,
                recv(stopped) -> _ => return,
            };
            let put = match out {
                Ok(Out::Frame(bytes)) => self.frames.put(bytes).wait(),
                Ok(Out::State(bytes)) => self.states.put(bytes.to_vec()).wait(),
                Ok(Out::Event(bytes)) => self.events.put(bytes.to_vec()).wait(),
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
    report: impl Fn(&Feed, bool) + Send + Sync + 'static,
) -> zenoh::Result<()> {
    let report = Arc::new(report);
    let (listening, reported) = (feed.clone(), Arc::clone(&report));
    publisher
        .matching_listener()
        .callback(move |status| reported(&listening, status.matching()))
        .background()
        .wait()?;
    report(feed, publisher.matching_status().wait()?.matching());
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
