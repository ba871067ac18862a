//! From outputs to the messages of channels.

use std::borrow::Borrow;

use serde::Serialize;

use super::scene::{Pose, SceneUpdate, Time};
use super::{Channel, Content, ROOM, log};
use crate::{Encoding, Fields, Names, Payload, Stamp, Topic, View, encode};
use posed_fusion::body::Skeleton;
use posed_stage::input::{Model, Truth};
use posed_stage::layout::skeleton_of;
use posed_stage::output::{Body, Estimate, Outcome, OutcomeKind, SensorEstimate};
use posed_stage::{BodyIndex, Stage};

/// Writes the messages of channels; knows where the transmitter is.
#[derive(Clone, Debug)]
pub struct Publisher {
    epoch_utc_ns: i64,
    names: Names,
    /// By body.
    skeletons: Vec<Option<Skeleton>>,
    /// Where the transmitter stands, of a stage that has one.
    transmitter: Option<Pose>,
    /// Names of the sensors' frames, and by body of the segments'.
    sensor_frames: Vec<String>,
    segment_frames: Vec<Vec<String>>,
    seq: [u64; Topic::COUNT],
    body: Vec<u8>,
    message: Vec<u8>,
}

#[derive(Serialize)]
struct FrameTransforms<'a> {
    transforms: Vec<FrameTransform<'a>>,
}

#[derive(Serialize)]
struct FrameTransform<'a> {
    timestamp: Time,
    parent_frame_id: &'static str,
    child_frame_id: &'a str,
    translation: super::scene::Xyz,
    rotation: super::scene::Xyzw,
}

#[derive(Serialize)]
struct PoseInFrame {
    timestamp: Time,
    frame_id: &'static str,
    pose: Pose,
}

#[derive(Serialize)]
struct PosesInFrame {
    timestamp: Time,
    frame_id: &'static str,
    poses: Vec<Pose>,
}

#[derive(Serialize)]
struct Log<'a> {
    timestamp: Time,
    level: u8,
    message: &'a str,
    name: &'a str,
    file: &'static str,
    line: u32,
}

impl Publisher {
    /// For a stage whose epoch is `epoch_utc_ns`, ns since 1970.
    pub fn new(stage: &Stage, epoch_utc_ns: i64) -> Self {
        let names = Names::new(stage);
        let frames = |body: BodyIndex| -> Vec<String> {
            let segments = names.body(body).map_or(&[][..], |layout| &layout.segments);
            let of = if stage.bodies.len() > 1 { names.body_name(body) } else { "body" };
            segments.iter().map(|segment| format!("{of}/{}", segment.name)).collect()
        };
        let placed = stage.transmitter.pose_in_room.unwrap_or(posed_stage::Pose::IDENTITY);
        let transmitter = Pose::of(placed.position_m, placed.orientation_wxyz);
        Self {
            epoch_utc_ns,
            skeletons: stage.bodies.iter().map(skeleton_of).collect(),
            sensor_frames: names.sensors().map(|(name, _)| format!("sensors/{name}")).collect(),
            segment_frames: names.bodies().map(frames).collect(),
            names,
            transmitter: transmitter.filter(|_| !stage.magnetic_indices().is_empty()),
            seq: [0; Topic::COUNT],
            body: Vec::new(),
            message: Vec::new(),
        }
    }

    /// Takes over what a model changes in what is shown: where the transmitter stands. [`Publisher::publish`] does so by itself.
    pub fn swap(&mut self, model: &Model) {
        if let Model::Transmitter { position_m, orientation_wxyz } = model
            && self.transmitter.is_some()
        {
            // Numbers that are none change nothing, as in the pipeline.
            self.transmitter = Pose::of(*position_m, *orientation_wxyz).or(self.transmitter);
        }
    }

    /// UTC of a message, ns since 1970; 0 for what lies before.
    pub fn utc_ns(&self, stamp: &Stamp) -> u64 {
        u64::try_from(self.epoch_utc_ns.saturating_add(stamp.t().as_nanos())).unwrap_or(0)
    }

    /// Gives `emit` the message of every channel that is `wanted` (by its place in `channels`) and shows something of a payload:
    /// place, JSON text. Poses are in the room, m; one that is not good is left out, or drawn in another colour. `stamp` is that
    /// of the payload's own message.
    pub fn publish(
        &mut self,
        payload: &Payload<'_>,
        stamp: &Stamp,
        channels: &[impl Borrow<Channel>],
        wanted: &dyn Fn(usize) -> bool,
        emit: &mut dyn FnMut(usize, &[u8]),
    ) {
        if let Payload::Outcome(Outcome { what: OutcomeKind::ModelSwapped(model), .. }) = payload {
            self.swap(model);
        }
        let time = Time::of(self.utc_ns(stamp));
        let mut body = std::mem::take(&mut self.body);
        for (place, channel) in channels.iter().enumerate().filter(|(place, _)| wanted(*place)) {
            let channel = channel.borrow();
            body.clear();
            match (channel.content, payload) {
                (Content::Transforms, Payload::Estimate(estimate)) => {
                    json(&self.sensor_frames(time, estimate), &mut body);
                }
                (Content::Transforms, Payload::Body(figure)) => {
                    json(&self.segment_frames(time, figure), &mut body);
                }
                (Content::Pose(sensor), Payload::Estimate(estimate)) => {
                    let sensor = estimate.sensors.get(usize::from(sensor));
                    if let Some(pose) = sensor.and_then(good) {
                        json(&PoseInFrame { timestamp: time, frame_id: ROOM, pose }, &mut body);
                    }
                }
                (Content::Sensors, Payload::Estimate(estimate)) => {
                    json(&SceneUpdate::sensors(time, estimate, &self.names, self.transmitter), &mut body);
                }
                (Content::Body, Payload::Body(figure)) => {
                    if let Some(Some(skeleton)) = self.skeletons.get(usize::from(figure.index)) {
                        json(&SceneUpdate::body(time, figure, skeleton), &mut body);
                    }
                }
                (Content::Truth, Payload::Truth(truth)) => json(&poses(time, truth), &mut body),
                (Content::Log, Payload::Outcome(outcome)) => {
                    if let Some((level, name, message)) = log::sentence(outcome, &self.names) {
                        let (level, message, name) = (level as u8, message.as_str(), name.as_str());
                        json(&Log { timestamp: time, level, message, name, file: "", line: 0 }, &mut body);
                    }
                }
                (Content::Published(topic), payload) if topic == stamp.topic => {
                    let view = View { fields: Fields::all(), ..View::all(Encoding::Json) };
                    encode::body(payload, stamp, &self.names, &view, &mut body);
                    let seq = &mut self.seq[topic.index()];
                    self.message.clear();
                    let head = encode::Head { stage: None, topic, seq: *seq, dropped: 0 };
                    encode::message(Encoding::Json, head, &body, &mut self.message);
                    *seq += 1;
                    emit(place, &self.message);
                    continue;
                }
                _ => continue,
            }
            if !body.is_empty() {
                emit(place, &body);
            }
        }
        self.body = body;
    }

    /// From the room to the transmitter and to every sensor that is good.
    fn sensor_frames(&self, timestamp: Time, estimate: &Estimate) -> FrameTransforms<'_> {
        let transmitter = self.transmitter.map(|pose| FrameTransform::new(timestamp, "transmitter", pose));
        let sensors = self.sensor_frames.iter().zip(&estimate.sensors);
        let sensors =
            sensors.filter_map(|(frame, sensor)| Some(FrameTransform::new(timestamp, frame, good(sensor)?)));
        FrameTransforms { transforms: transmitter.into_iter().chain(sensors).collect() }
    }

    /// From the room to every segment that sensors show.
    fn segment_frames(&self, timestamp: Time, body: &Body) -> FrameTransforms<'_> {
        let frames = self.segment_frames.get(usize::from(body.index)).map_or(&[][..], Vec::as_slice);
        let transforms = frames.iter().zip(&body.segments).filter_map(|(frame, segment)| {
            let shown = segment.state.is_shown();
            let pose = Pose::of(segment.position_m.filter(|_| shown)?, segment.orientation_wxyz?)?;
            Some(FrameTransform::new(timestamp, frame, pose))
        });
        FrameTransforms { transforms: transforms.collect() }
    }
}

impl<'a> FrameTransform<'a> {
    fn new(timestamp: Time, child_frame_id: &'a str, pose: Pose) -> Self {
        let Pose { position: translation, orientation: rotation } = pose;
        Self { timestamp, parent_frame_id: ROOM, child_frame_id, translation, rotation }
    }
}

/// The pose of a sensor, if it may be used as good; one that measures no position is at the origin.
fn good(sensor: &SensorEstimate) -> Option<Pose> {
    let pose = sensor.usable_pose()?;
    Pose::of(pose.position_m.unwrap_or_default(), pose.orientation_wxyz)
}

fn poses(timestamp: Time, truth: &Truth) -> PosesInFrame {
    let poses =
        truth.sensors.iter().filter_map(|sensor| Pose::of(sensor.position_m, sensor.orientation_wxyz));
    PosesInFrame { timestamp, frame_id: ROOM, poses: poses.collect() }
}

/// Our own types are maps with text keys, whose numbers are finite: JSON cannot refuse them.
fn json<T: Serialize>(value: &T, out: &mut Vec<u8>) {
    if let Err(error) = serde_json::to_writer(&mut *out, value) {
        debug_assert!(false, "a message could not be written: {error}");
        out.clear();
    }
}
