//! From the pipeline's outputs to the messages of every topic at the full rate: for recordings and for replay.
//!
//! Deterministic and without a clock: the same outputs give the same bytes. All its state is [`Counters`]; a recording
//! begun mid-run stores them beside the pipeline's snapshot.

use posed_drivers::Timestamp;
use serde::{Deserialize, Serialize};

use super::{Encoding, Fields, Names, Payload, Topic, View, encode, round};
use posed_stage::{BodyIndex, MOST_BODIES, Stage};
use posed_timecode::{Label, Relation};

/// When and as which event a payload is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// The topic it is published on.
    pub topic: Topic,
    /// On `body`, whose it is: each has times of its own. 0 on others.
    #[serde(default)]
    pub body: BodyIndex,
    /// Time of the message in microseconds since the stage's epoch; rises strictly within the topic, and on `body` within each one's.
    pub t_us: i64,
    /// Stage-wide number of an event, from 1; `None` for states.
    pub event_id: Option<u64>,
    /// Time code at that time, where it is known.
    #[serde(default)]
    pub timecode: Option<Label>,
}

/// Streams of messages, each with times that rise: the topics, and one more for every body after the first.
pub const STREAMS: usize = Topic::COUNT + MOST_BODIES - 1;

impl Topic {
    /// Which of the [`STREAMS`] its messages may belong to.
    pub fn streams(self) -> impl Iterator<Item = usize> {
        let further = if self == Self::Body { Self::COUNT..STREAMS } else { 0..0 };
        std::iter::once(self.index()).chain(further)
    }
}

impl Stamp {
    /// Which of the [`STREAMS`] it belongs to; topics are first, by their index.
    pub fn stream(&self) -> usize {
        match self.body {
            0 => self.topic.index(),
            body => (Topic::COUNT - 1 + usize::from(body)).min(STREAMS - 1),
        }
    }

    /// Time of the message since the stage's epoch, s.
    pub fn t_s(&self) -> f64 {
        round::seconds(self.t_us)
    }

    /// Time of the message since the stage's epoch, to the microsecond.
    pub fn t(&self) -> Timestamp {
        Timestamp::from_nanos(self.t_us.saturating_mul(1000))
    }
}

/// Numbers given out so far: of events, and the newest time of each stream; and where time code lies. The default has given out none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counters {
    events: u64,
    #[serde(with = "by_index")]
    last_t_us: [Option<i64>; STREAMS],
    /// Earlier versions know none.
    #[serde(default)]
    timecode: Option<Relation>,
}

impl Counters {
    /// Stamps a payload: the next event number, and its time, moved up to keep it rising by 1 µs at least within the topic. The
    /// time is the capture time of frames, bodies and ground truth, the stream time at which an event was decided, the host time
    /// of `status`, `jobs` and `session`; to the nearest microsecond.
    pub fn stamp(&mut self, payload: &Payload<'_>) -> Stamp {
        let topic = payload.topic();
        let t_us = match payload {
            Payload::Estimate(estimate) => round::microseconds(estimate.t_valid),
            Payload::Body(body) => round::microseconds(body.t_valid),
            Payload::Truth(truth) => round::microseconds(truth.t_valid),
            Payload::Outcome(outcome) => round::microseconds(outcome.t_decided),
            Payload::Status(status) => round::microseconds(Timestamp::from_secs_f64(status.t_s)),
            Payload::Jobs(jobs) => round::microseconds(Timestamp::from_secs_f64(jobs.t_s)),
            Payload::Sessions(sessions) => round::microseconds(Timestamp::from_secs_f64(sessions.t_s)),
            Payload::Timecode(timecode) => round::microseconds(timecode.t),
        };
        if let Payload::Timecode(timecode) = payload {
            self.timecode = Some(timecode.relation);
        }
        let body = if let Payload::Body(body) = payload { body.index } else { 0 };
        let mut stamp = Stamp { topic, body, t_us, event_id: None, timecode: None };
        let last = &mut self.last_t_us[stamp.stream()];
        stamp.t_us = last.map_or(t_us, |last| t_us.max(last + 1));
        *last = Some(stamp.t_us);
        stamp.event_id = topic.is_event().then(|| {
            self.events += 1;
            self.events
        });
        stamp.timecode = self.timecode.and_then(|relation| relation.label(stamp.t()));
        stamp
    }

    /// Goes on after a stamp that was given elsewhere; one without an event number leaves the count of events.
    pub fn follow(&mut self, stamp: &Stamp) {
        self.last_t_us[stamp.stream()] = Some(stamp.t_us);
        if let Some(event_id) = stamp.event_id {
            self.events = event_id;
        }
    }

    /// Lets the times of all topics start anew; event numbers go on.
    pub fn rewind(&mut self) {
        self.last_t_us = [None; STREAMS];
        // What comes may be another recording.
        self.timecode = None;
    }

    /// Number of the newest event, 0 before the first.
    pub fn last_event_id(&self) -> u64 {
        self.events
    }
}

/// A value per topic or stream. What an earlier version wrote has fewer: those that it did not know have given out nothing.
mod by_index {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    pub(super) fn serialize<T: Serialize, S: Serializer, const N: usize>(
        values: &[T; N],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        values.as_slice().serialize(serializer)
    }

    pub(super) fn deserialize<'de, T, D, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
    where
        T: Copy + Default + Deserialize<'de>,
        D: Deserializer<'de>,
    {
        let read = Vec::<T>::deserialize(deserializer)?;
        let mut values = [T::default(); N];
        let known = values.get_mut(..read.len());
        known.ok_or_else(|| de::Error::custom("more topics than this version knows"))?.copy_from_slice(&read);
        Ok(values)
    }
}

/// Writes the JSON messages of all topics as a client would get them who misses nothing.
#[derive(Clone, Debug)]
pub struct Publisher {
    names: Names,
    view: View,
    counters: Counters,
    seq: [u64; Topic::COUNT],
    body: Vec<u8>,
    message: Vec<u8>,
}

/// State of a [`Publisher`] between two outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PublisherState {
    counters: Counters,
    #[serde(with = "by_index")]
    seq: [u64; Topic::COUNT],
}

impl Publisher {
    /// Starts counting, for all sensors of a stage; `fields` are those of `sensors` and `truth`.
    pub fn new(stage: &Stage, fields: Fields) -> Self {
        Self {
            names: Names::new(stage),
            view: View { fields, ..View::all(Encoding::Json) },
            counters: Counters::default(),
            seq: [0; Topic::COUNT],
            body: Vec::new(),
            message: Vec::new(),
        }
    }

    /// What to store in order to go on from here.
    pub fn state(&self) -> PublisherState {
        PublisherState { counters: self.counters, seq: self.seq }
    }

    /// Goes on from a stored state; stage and fields stay those of [`Publisher::new`].
    pub fn restore(&mut self, state: PublisherState) {
        self.counters = state.counters;
        self.seq = state.seq;
    }

    /// Number of the newest event, 0 before the first.
    pub fn last_event_id(&self) -> u64 {
        self.counters.last_event_id()
    }

    /// Counts a payload without writing it, and returns its stamp: while nothing records.
    pub fn skip(&mut self, payload: &Payload<'_>) -> Stamp {
        let stamp = self.counters.stamp(payload);
        self.seq[stamp.topic.index()] += 1;
        stamp
    }

    /// Writes the message of a payload; returns its stamp and the message, JSON text whose `dropped` is 0. The bytes stay valid
    /// until the next call.
    pub fn publish(&mut self, payload: &Payload<'_>) -> (Stamp, &[u8]) {
        let stamp = self.counters.stamp(payload);
        let seq = &mut self.seq[stamp.topic.index()];
        self.body.clear();
        self.message.clear();
        encode::body(payload, &stamp, &self.names, &self.view, &mut self.body);
        let head = encode::Head { stage: None, topic: stamp.topic, seq: *seq, dropped: 0 };
        encode::message(self.view.encoding, head, &self.body, &mut self.message);
        *seq += 1;
        (stamp, &self.message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Jobs, ServerMessage, Status};
    use posed_fusion::body::{ANGLES, BodySegment, Heading, SEGMENTS};
    use posed_fusion::faults::Cause;
    use posed_motion::exercise::{DeviationKind, EventKind, Feedback, MovementPhase, Reason, Score};
    use posed_stage::Sensor;
    use posed_stage::input::{Model, Truth, TruthSensor};
    use posed_stage::output::{
        Body, Estimate, ExerciseOutcome, ExerciseState, ExerciseWhat, KeyPoseEvent, Outcome, OutcomeKind,
        Phase, PoseEstimate, PositionSource, Repetition, SegmentEstimate, SegmentState, SensorEstimate,
        SensorState,
    };

    fn stage() -> Stage {
        let mut stage = Stage::parse("name = \"test\"").unwrap();
        let sensor = |name: &str, address| Sensor {
            name: name.into(),
            device: "flock".into(),
            address,
            body: None,
            segment: None,
            mount_quat_wxyz: None,
            offset_m: None,
            imu: None,
            serial: None,
            magnetometer: true,
            gyro_delay_ms: 0.0,
        };
        stage.sensors = vec![sensor("left", 1), sensor("ri\"ght", 2)];
        stage.sensors[0].segment = Some("forearm_r".into());
        stage.bodies = vec![toml::from_str("height_m = 1.8").unwrap()];
        stage
    }

    fn estimate(t_ns: i64) -> Estimate {
        let pose = PoseEstimate {
            position_m: Some([0.1, -0.2, 1.0 / 3.0]),
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            velocity_m_s: Some([0.0; 3]),
            angular_velocity_rad_s: [0.0; 3],
            covariance: [1e-6; 21],
            sigma_m: Some(1e-3),
        };
        let left = SensorEstimate {
            state: SensorState::Ok,
            pose: Some(pose),
            measured: None,
            fault: None,
            ..SensorEstimate::default()
        };
        Estimate {
            t_valid: Timestamp::from_nanos(t_ns),
            sensors: vec![left, SensorEstimate::default()],
            ..Estimate::default()
        }
    }

    /// An arm whose forearm's sensor is dead.
    fn figure() -> Body {
        let mut body = Body {
            index: 0,
            t_valid: Timestamp::from_nanos(2_000_000),
            heading: Heading::Held(1.25),
            heading_sigma_rad: Some(0.02),
            position_source: PositionSource::Trackers,
            position_sigma_m: Some(0.02),
            contacts: None,
            segments: vec![SegmentEstimate::default(); SEGMENTS],
            angles_rad: [None; ANGLES],
            spread: Default::default(),
        };
        let shown = SegmentEstimate {
            state: SegmentState::Ok,
            sensor: None,
            position_m: Some([0.0, 1.0, 2.0]),
            orientation_wxyz: Some([1.0, 0.0, 0.0, 0.0]),
            sigma_rad: 0.01,
            fault: None,
            learnt: None,
        };
        body.segments[BodySegment::UpperArmR.index()] = shown;
        let fault = Some(Cause::Missing);
        body.segments[BodySegment::ForearmR.index()] =
            SegmentEstimate { state: SegmentState::Suspect, fault, ..shown };
        body.angles_rad[8] = Some(1.0);
        body
    }

    fn fault(active: bool) -> Outcome {
        let t = Timestamp::from_nanos(5_000_000);
        let what = OutcomeKind::Fault { sensor: 1, cause: Cause::Stuck, active };
        Outcome { t_valid: t, t_decided: t, what }
    }

    /// A repetition with all that can be said of one.
    fn counted() -> Repetition {
        let feedback = Feedback {
            channel: 0,
            deviation: -22.04999,
            worth: 2.0,
            kind: DeviationKind::Short,
            place: MovementPhase::Top,
            phase: 0.5,
            rms_sd: 1.0,
            range: 0.8,
            size: None,
            tempo: 1.0,
            off_tempo: false,
            fifth_tempo: [1.0; 5],
            jerk: 0.0,
            score: Score { total: 88.88, amplitude: 80.0, tempo: 100.0, smoothness: 100.0, symmetry: None },
        };
        Repetition {
            exercise: "curl".into(),
            kind: EventKind::Counted,
            count: 3,
            set_count: 3,
            t_start_s: 1.0,
            reason: Some(Reason::TooSmall),
            is_attempt: true,
            feedback: Some(("elbow_deg".into(), feedback)),
            remark: feedback.remark(),
        }
    }

    fn text(publisher: &mut Publisher, payload: &Payload<'_>) -> String {
        String::from_utf8(publisher.publish(payload).1.to_vec()).unwrap()
    }

    #[test]
    fn a_message_is_written_as_clients_read_it() {
        let mut publisher = Publisher::new(&stage(), Fields::default());
        insta::assert_snapshot!(text(&mut publisher, &Payload::Estimate(&estimate(1_234_567))));
    }

    #[test]
    fn every_payload_reads_back_in_both_encodings() {
        let names = Names::new(&stage());
        let model = Model::Transmitter { position_m: [0.0; 3], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] };
        let swapped = Outcome { what: OutcomeKind::ModelSwapped(model), ..fault(true) };
        let exercise = [
            ExerciseWhat::State(ExerciseState::default()),
            ExerciseWhat::Hint(None),
            ExerciseWhat::Repetition(counted()),
            ExerciseWhat::Repetition(Repetition { kind: EventKind::Withdrawn, ..counted() }),
        ]
        .map(|what| {
            let what = OutcomeKind::Exercise(ExerciseOutcome { subject: "a".into(), what });
            Outcome { what, ..fault(true) }
        });
        let event =
            KeyPoseEvent { sensor: 0, phase: Phase::Confirmed, score: 31.0, corner: true, segment: None };
        let key = Outcome { what: OutcomeKind::KeyPose(event), ..fault(true) };
        let sensors = vec![TruthSensor {
            sensor: 1,
            position_m: [0.0; 3],
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            class: "clean".into(),
        }];
        let truth = Truth { t_valid: Timestamp::ZERO, sensors };
        let body = figure();
        let (estimate, fault, status, jobs) = (estimate(0), fault(true), Status::default(), Jobs::default());
        let mut counters = Counters::default();
        let exercise = exercise.iter().map(Payload::Outcome);
        for payload in [
            Payload::Estimate(&estimate),
            Payload::Body(&body),
            Payload::Truth(&truth),
            Payload::Outcome(&fault),
            Payload::Outcome(&swapped),
            Payload::Outcome(&key),
            Payload::Status(&status),
            Payload::Jobs(&jobs),
            // From here on each has the code of its time.
            Payload::Timecode(&timecode(0)),
            Payload::Estimate(&estimate),
            Payload::Body(&body),
            Payload::Status(&status),
            Payload::Jobs(&jobs),
        ]
        .into_iter()
        .chain(exercise)
        {
            let stamp = counters.stamp(&payload);
            let write = |encoding| {
                let (mut body, mut message) = (Vec::new(), Vec::new());
                encode::body(&payload, &stamp, &names, &View::all(encoding), &mut body);
                let head = encode::Head { stage: None, topic: stamp.topic, seq: 70_000, dropped: 3 };
                encode::message(encoding, head, &body, &mut message);
                message
            };
            let text = |text: &'static str| [&[0xa0 | text.len() as u8], text.as_bytes()].concat();
            let head = [text("type"), text(stamp.topic.name()), text("seq")].concat();
            let packed = write(Encoding::MessagePack);
            let keys = if packed[0] == 0xde { 3 } else { 1 };
            assert!(packed[keys..].starts_with(&head), "{payload:?}: the order of JSON");
            let json: ServerMessage = serde_json::from_slice(&write(Encoding::Json)).unwrap();
            let packed: ServerMessage = rmp_serde::from_slice(&write(Encoding::MessagePack)).unwrap();
            assert_eq!(json, packed, "{payload:?}");
            assert_eq!(serde_json::to_value(&json).unwrap()["type"], stamp.topic.name());
            assert_eq!(serde_json::to_value(&json).unwrap()["seq"], 70_000);
        }
    }

    /// Ten o'clock at that time, 25 frames a second.
    fn timecode(t_ns: i64) -> posed_stage::output::Timecode {
        let relation = Relation {
            at: Timestamp::from_nanos(t_ns),
            number: 900_000.0,
            frames_per_s: 25.0,
            pace_sigma: 1e-6,
            counting: posed_timecode::Counting { frames_per_s: 25, drop: false },
            pictures: 1,
            sigma_s: 1e-4,
        };
        posed_stage::output::Timecode { t: Timestamp::from_nanos(t_ns), relation, jumps: 0 }
    }

    #[test]
    fn every_message_has_the_code_of_its_time_once_there_is_one_and_none_after_a_rewind() {
        let (code, second) = (timecode(0), estimate(1_020_000_000));
        let mut publisher = Publisher::new(&stage(), Fields::default());
        assert!(!text(&mut publisher, &Payload::Estimate(&estimate(0))).contains("timecode"));
        let written = text(&mut publisher, &Payload::Timecode(&code));
        assert!(
            written.contains(r#""state":"locked","rate":"25""#) && written.contains("10:00:00:00.00"),
            "{written}"
        );
        assert!(
            text(&mut publisher, &Payload::Estimate(&second)).ends_with(r#","timecode":"10:00:01:00.50"}"#)
        );
        // A recording that begins here goes on with it.
        let stored = rmp_serde::to_vec(&publisher.state()).unwrap();
        let mut again = Publisher::new(&stage(), Fields::default());
        again.restore(rmp_serde::from_slice(&stored).unwrap());
        let third = estimate(2_000_000_000);
        let expected = text(&mut publisher, &Payload::Estimate(&third));
        assert_eq!(text(&mut again, &Payload::Estimate(&third)), expected);
        // After a year on the host's clock alone it is not known.
        let year = estimate(31_536_000_000_000_000);
        assert!(!text(&mut publisher, &Payload::Estimate(&year)).contains("timecode"));
        let mut counters = again.state().counters;
        counters.rewind();
        assert_eq!(counters.stamp(&Payload::Estimate(&third)).timecode, None);
    }

    #[test]
    fn times_rise_and_events_are_counted() {
        let mut counters = Counters::default();
        let stamps = [fault(true), fault(false)].map(|outcome| counters.stamp(&Payload::Outcome(&outcome)));
        assert_eq!(stamps.map(|stamp| stamp.event_id), [Some(1), Some(2)]);
        assert_eq!(stamps.map(|stamp| stamp.t_us), [5000, 5001]);
        assert_eq!(counters.last_event_id(), 2);
        let frames = [1_000_499, 1_000_500, 1_000_400].map(|t_ns| {
            let estimate = estimate(t_ns);
            counters.stamp(&Payload::Estimate(&estimate)).t_us
        });
        assert_eq!(frames, [1000, 1001, 1002]);
    }

    #[test]
    fn a_recording_begun_late_goes_on_with_the_same_bytes() {
        let (a, b, c) = (estimate(1), fault(true), fault(false));
        let payloads = [Payload::Estimate(&a), Payload::Outcome(&b), Payload::Outcome(&c)];
        let mut whole = Publisher::new(&stage(), Fields::default());
        let expected = payloads.map(|payload| text(&mut whole, &payload));
        let mut live = Publisher::new(&stage(), Fields::default());
        live.skip(&payloads[0]);
        live.skip(&payloads[1]);
        let stored = rmp_serde::to_vec(&live.state()).unwrap();
        let mut replay = Publisher::new(&stage(), Fields::default());
        replay.restore(rmp_serde::from_slice(&stored).unwrap());
        assert_eq!(text(&mut live, &payloads[2]), expected[2]);
        assert_eq!(text(&mut replay, &payloads[2]), expected[2]);
    }

    #[test]
    fn numbers_that_a_version_with_fewer_topics_wrote_go_on_and_more_topics_are_refused() {
        let read = |streams: usize, topics: usize| {
            let times: Vec<Option<i64>> = (0..streams as i64).map(Some).collect();
            let seq: Vec<u64> = (0..topics as u64).collect();
            let written = rmp_serde::to_vec(&((7_u64, times), seq)).unwrap();
            rmp_serde::from_slice::<PublisherState>(&written)
        };
        let state = read(10, 10).unwrap();
        assert_eq!((state.seq[9], state.seq[10]), (9, 0));
        assert_eq!((state.counters.last_t_us[9], state.counters.last_t_us[10]), (Some(9), None));
        assert!(read(STREAMS, Topic::COUNT).is_ok());
        assert!(read(STREAMS + 1, Topic::COUNT).is_err() && read(STREAMS, Topic::COUNT + 1).is_err());
    }
}
