//! Key poses, live: a track per watched sensor.
//!
//! What comes in: closed frames. What goes out: the statistic of each watched sensor, and an outcome per provisional,
//! confirmed or withdrawn key pose. What it never does: look at poses that may not be used as good. What is said agrees
//! with `posed keyframes` on a recording.

use nalgebra::Isometry3;
use posed_drivers::Timestamp;
use posed_state::{Plain, State};

use super::PipelineError;
use posed_motion::keyframes::{Detector, Event, KeyPose, Method, MethodSettings, Track};
use posed_stage::Stage;
use posed_stage::input::SensorIndex;
use posed_stage::output::{
    Change, Estimate, KeyPoseEvent, Outcome, OutcomeKind, Output, Phase, ScrewSegment, SensorEstimate,
};

/// Frames whose mean interval is taken for the stage's, where the file does not say it.
const MEASURED_FRAMES: u32 = 30;

/// Room for the events of one frame; more than enough, as a sensor has three at most.
const EVENTS: usize = 256;

/// The beginning of a segment, which may be longer ago than the latest frames.
#[derive(Clone, Copy, Debug, Plain)]
struct Begun {
    frame: u64,
    t: Timestamp,
    /// Whether its poses have positions: a screw of others would be anywhere.
    has_position: bool,
}

#[derive(Clone, Debug, State)]
pub(super) struct Keyframes {
    /// Without the rate, where the stage file does not say it.
    #[state(keep)]
    settings: MethodSettings,
    #[state(keep)]
    watched: Vec<SensorIndex>,
    /// Absent where the stage file does not say a rate, until it is measured.
    tracks: Vec<Track<Method>>,
    /// By track: where its segment began.
    begun: Vec<Option<Begun>>,
    first: Option<Timestamp>,
    seen: u32,
    /// Times of the latest frames, the newest at `frames % len`.
    times: Vec<Timestamp>,
    frames: u64,
    /// What became known with the latest frame, and of which time.
    events: Vec<(Timestamp, KeyPoseEvent)>,
}

impl Keyframes {
    /// `None` where the stage does not ask for key poses.
    pub(super) fn new(stage: &Stage) -> Result<Option<Self>, PipelineError> {
        let Some(table) = &stage.keyframes else { return Ok(None) };
        let index = |name: &String| {
            let found = stage.sensors.iter().position(|sensor| sensor.name == *name);
            found
                .map(|index| index as SensorIndex)
                .ok_or(PipelineError::Value { key: "keyframes.sensors", expected: "names of sensors" })
        };
        let watched = match &table.sensors {
            Some(names) => names.iter().map(index).collect::<Result<_, _>>()?,
            None => (0..stage.sensors.len() as SensorIndex).collect(),
        };
        let mut keyframes = Self {
            settings: table.settings(stage.frame_rate_hz.unwrap_or(0.0), true),
            watched,
            tracks: Vec::new(),
            begun: Vec::new(),
            first: None,
            seen: 0,
            times: Vec::new(),
            frames: 0,
            events: Vec::with_capacity(EVENTS),
        };
        if let Some(frame_rate_hz) = stage.frame_rate_hz {
            keyframes.begin(frame_rate_hz);
        }
        Ok(Some(keyframes))
    }

    /// Makes the tracks, now that the rate is known.
    fn begin(&mut self, frame_rate_hz: f64) {
        let track = Track::new(Detector::new(Method::new(self.settings.at(frame_rate_hz))));
        self.times = vec![Timestamp::ZERO; track.reach_frames() + 1];
        self.tracks = vec![track; self.watched.len()];
        self.begun = vec![None; self.watched.len()];
    }

    /// Takes a closed frame, and gives it the statistic of each sensor.
    pub(super) fn frame(&mut self, estimate: &mut Estimate) {
        let now = estimate.t_valid;
        if self.times.is_empty() {
            let first = *self.first.get_or_insert(now);
            if self.seen < MEASURED_FRAMES {
                self.seen += 1;
                return;
            }
            let span_s = now.seconds_since(first);
            self.begin(f64::from(self.seen) / span_s.max(1e-3));
        }
        let count = self.times.len() as u64;
        self.times[(self.frames % count) as usize] = now;
        self.frames += 1;
        let Self { watched, tracks, begun, times, events, .. } = self;
        let time = |frame: u64| times[(frame % count) as usize];
        for ((sensor, track), begun) in watched.iter().zip(tracks).zip(begun) {
            let Some(estimate) = estimate.sensors.get_mut(usize::from(*sensor)) else { continue };
            let pose = usable(estimate);
            let has_position = estimate.pose.as_ref().is_some_and(|pose| pose.position_m.is_some());
            let trace = track.push(pose.as_ref(), &mut |report| {
                let (phase, key) = match report.event {
                    Event::Provisional(key) => (Phase::Provisional, key),
                    Event::Confirmed(key) => (Phase::Confirmed, key),
                    Event::Withdrawn(key) => (Phase::Withdrawn, key),
                };
                let since = |frame| {
                    begun.filter(|begun| begun.frame == frame).map_or_else(|| time(frame), |begun| begun.t)
                };
                let segment = report.segment.filter(|_| begun.is_some_and(|begun| begun.has_position));
                let segment = segment.map(|segment| ScrewSegment {
                    since: since(segment.since),
                    from_m: segment.from.translation.vector.into(),
                    screw: segment.screw,
                });
                let KeyPose { score, corner, .. } = key;
                events
                    .push((time(key.frame), KeyPoseEvent { sensor: *sensor, phase, score, corner, segment }));
            });
            let since = track.segment_since();
            if begun.map(|begun| begun.frame) != since {
                *begun = since.map(|frame| Begun { frame, t: time(frame), has_position });
            }
            estimate.change = trace.map(|trace| Change {
                t_valid: time(trace.frame),
                score: trace.score.value,
                threshold: trace.score.threshold,
            });
        }
    }

    /// Reports what became known with the frame.
    pub(super) fn outcomes(&mut self, estimate: &Estimate, emit: &mut dyn FnMut(Output<'_>)) {
        for (t_valid, event) in self.events.drain(..) {
            let what = OutcomeKind::KeyPose(event);
            emit(Output::Outcome(&Outcome { t_valid, t_decided: estimate.t_valid, what }));
        }
    }
}

/// The pose of a sensor, if it may be used as good; without a position or an orientation, that part stays put.
fn usable(sensor: &SensorEstimate) -> Option<Isometry3<f64>> {
    let pose = sensor.usable_pose()?;
    posed_geometry::isometry(pose.position_m.unwrap_or_default(), pose.orientation_wxyz)
}
