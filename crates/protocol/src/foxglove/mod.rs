//! What Foxglove and Lichtblick are shown: channels of published schemas, live on a websocket and in recordings.
//!
//! What comes in: the pipeline's outputs with the stamps that clients know them by, and what a viewer says. What goes out: JSON
//! messages by channel, frames of the Foxglove websocket protocol. What it never does: show a pose that is not good as if it
//! were, own a socket or a clock.
//!
//! | channel | schema | holds |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | `room` to `transmitter`, to every sensor by name, to `body/SEGMENT`, or of several bodies `NAME/SEGMENT` |
//! | `/sensors/NAME/pose` | `foxglove.PoseInFrame` | one sensor, while it is good |
//! | `/scene/sensors` | `foxglove.SceneUpdate` | sensors as balls, coloured by how far to trust them, with their names |
//! | `/scene/body` | `foxglove.SceneUpdate` | the skeleton |
//! | `/log` | `foxglove.Log` | events as sentences |
//! | `/truth` | `foxglove.PosesInFrame` | ground truth of a simulated stage |
//! | `/posed/TOPIC` | `posed.TOPIC` | our own messages, as on our own websocket with all fields |
//!
//! Numbers are rounded as on our own websocket, so both say the same pose.

mod log;
mod publisher;
mod scene;
mod schema;
#[cfg(test)]
mod tests;
pub mod wire;

use std::sync::Arc;

use crate::{Payload, STREAMS, Stamp, Topic};
use posed_stage::input::{Model, SensorIndex};
use posed_stage::layout::BodyLayout;
use posed_stage::{RecordingContent, Stage};

pub use self::publisher::Publisher;

/// Frame of reference that everything is in: z up, m.
const ROOM: &str = "room";

/// One kind of message, under its own name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its name in the viewer.
    pub topic: String,
    /// Name of its schema, such as `foxglove.FrameTransforms`.
    pub schema_name: String,
    /// The schema, JSON.
    pub schema: String,
    content: Content,
}

/// What a channel holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    Transforms,
    Pose(SensorIndex),
    Sensors,
    Body,
    Log,
    Truth,
    Published(Topic),
}

impl Channel {
    /// Whether nothing of it may be left out: events, rather than states of which the newest counts.
    pub fn is_lossless(&self) -> bool {
        match self.content {
            Content::Log => true,
            Content::Published(topic) => topic.is_event(),
            _ => false,
        }
    }

    /// The topic whose messages it carries as they are; `None` of a channel in a schema of Foxglove's.
    pub fn published(&self) -> Option<Topic> {
        match self.content {
            Content::Published(topic) => Some(topic),
            _ => None,
        }
    }

    /// The topics that it shows something of; of the log none, since it shows events of all.
    pub fn topics(&self) -> &[Topic] {
        match &self.content {
            Content::Transforms => &[Topic::Sensors, Topic::Body],
            Content::Pose(_) | Content::Sensors => &[Topic::Sensors],
            Content::Body => &[Topic::Body],
            Content::Truth => &[Topic::Truth],
            Content::Log => &[],
            Content::Published(topic) => std::slice::from_ref(topic),
        }
    }

    /// Whether it is the log.
    pub fn is_log(&self) -> bool {
        self.content == Content::Log
    }

    fn new(topic: impl Into<String>, schema_name: &str, content: Content) -> Self {
        Self {
            topic: topic.into(),
            schema_name: schema_name.to_owned(),
            schema: schema::published(schema_name).to_string(),
            content,
        }
    }
}

/// The channels of a stage in schemas that viewers know; `truth` states whether there is ground truth.
pub fn views(stage: &Stage, truth: bool) -> Vec<Channel> {
    let mut channels = vec![Channel::new("/tf", "foxglove.FrameTransforms", Content::Transforms)];
    for (index, sensor) in (0..).zip(&stage.sensors) {
        let topic = format!("/sensors/{}/pose", sensor.name);
        channels.push(Channel::new(topic, "foxglove.PoseInFrame", Content::Pose(index)));
    }
    if !stage.magnetic_indices().is_empty() {
        channels.push(Channel::new("/scene/sensors", "foxglove.SceneUpdate", Content::Sensors));
    }
    if BodyLayout::all(stage).iter().any(Option::is_some) {
        channels.push(Channel::new("/scene/body", "foxglove.SceneUpdate", Content::Body));
    }
    channels.push(Channel::new("/log", "foxglove.Log", Content::Log));
    if truth {
        channels.push(Channel::new("/truth", "foxglove.PosesInFrame", Content::Truth));
    }
    channels
}

/// Time between two messages of a thinned channel, µs.
const THINNED_US: i64 = 200_000;

/// The channels that a recording holds beside our own messages, and who writes them.
#[derive(Clone, Debug)]
pub struct Views {
    channels: Vec<Arc<Channel>>,
    publisher: Publisher,
    pace: Option<Pace>,
}

impl Views {
    /// Of a stage whose epoch is `epoch_utc_ns`, ns since 1970. Where a recording holds no more than its log, what moves is
    /// shown five times a second, once in `/tf` and in the scene, and events are in `/log`.
    pub fn new(stage: &Stage, epoch_utc_ns: i64, content: RecordingContent) -> Self {
        let thinned = content == RecordingContent::Log;
        // Truth comes from a simulator beside any stage; a channel without messages is not written.
        let channels = views(stage, true).into_iter();
        // What is in `/tf`, and the truth, which is in the log, need no channel of their own.
        let shown = channels
            .filter(|channel| !(thinned && matches!(channel.content, Content::Pose(_) | Content::Truth)));
        Self {
            channels: shown.map(Arc::new).collect(),
            publisher: Publisher::new(stage, epoch_utc_ns),
            pace: thinned.then(Pace::default),
        }
    }

    /// Takes over what a model changes in what is shown: where the transmitter stands. [`Views::publish`] does so by itself.
    pub fn swap(&mut self, model: &Model) {
        self.publisher.swap(model);
    }

    /// Gives `emit` the message (JSON text) of every channel that shows something of a payload. Poses are in the room, m; `stamp`
    /// is that of the payload's own message, and times are UTC.
    pub fn publish(
        &mut self,
        payload: &Payload<'_>,
        stamp: &Stamp,
        mut emit: impl FnMut(&Arc<Channel>, &[u8]),
    ) {
        let Self { channels, publisher, pace } = self;
        if pace.as_mut().is_none_or(|pace| pace.is_due(stamp)) {
            publisher.publish(payload, stamp, channels, &|_| true, &mut |place, json| {
                emit(&channels[place], json)
            });
        }
    }
}

/// Which states a thinned recording shows: the first of each step of time, so that sensors and body are of the same moment.
#[derive(Clone, Debug, Default)]
struct Pace {
    /// The step that was shown last, by stream.
    shown: [Option<i64>; STREAMS],
}

impl Pace {
    /// Every event, and the first state of a stream in each step.
    fn is_due(&mut self, stamp: &Stamp) -> bool {
        let step = Some(stamp.t_us.div_euclid(THINNED_US));
        let before = std::mem::replace(&mut self.shown[stamp.stream()], step);
        stamp.topic.is_event() || before != step
    }
}

/// [`views`] and the messages of these topics as they are.
pub fn channels(stage: &Stage, topics: &[Topic]) -> Vec<Channel> {
    let mut channels = views(stage, topics.contains(&Topic::Truth));
    for &topic in topics {
        channels.push(Channel {
            topic: format!("/posed/{}", topic.name()),
            schema_name: format!("posed.{}", topic.name()),
            schema: crate::schema::of_topic(topic),
            content: Content::Published(topic),
        });
    }
    channels
}

/// What the fuzz target does with any message of a viewer: it is understood or refused with a sentence.
#[doc(hidden)]
pub fn fuzz_viewer(data: &[u8]) {
    match wire::parse(data) {
        Ok(wire::Request::Subscribe(list)) => assert!(list.len() <= data.len()),
        Ok(wire::Request::Unsubscribe(list)) => assert!(list.len() <= data.len()),
        Err(sentence) => assert!(!sentence.is_empty() && sentence.len() < 400),
    }
}
