//! The digest of a recording: what happens in it, so that a library and a timeline need no replay.
//!
//! What comes in: the entries and outputs that a recording follows, live or in a replay, which give the same digest. What goes out:
//! a [`Digest`], once, as the attachment [`NAME`] behind the last chunk, where the index finds it; of a recording without one, in a file
//! beside it. What it never does: grow with the recording.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use posed_drivers::Timestamp;
use serde::Deserialize;

use super::atomic_file::AtomicFile;
use super::brief::Ends;
use super::ending::ReadError;
use super::header::Header;
use super::machine::Machine;
use super::reader::{Item, Reader};
use super::thinned::Thinned;
use posed_fusion::faults::Cause;
use posed_motion::exercise::EventKind;
use posed_protocol::round;
use posed_protocol::{
    Digest, DigestCounts, DigestKeyPose, DigestMark, DigestRepetition, FaultSpan, Names, Picture,
    PicturePath, SegmentSpan,
};
use posed_stage::output::{Body, Estimate, ExerciseWhat, OutcomeKind, Output, Phase, SegmentEvent};
use posed_stage::{BodyIndex, Stage};

/// Name of the attachment.
pub(super) const NAME: &str = "digest.json";
/// Its media type.
pub(super) const MEDIA_TYPE: &str = "application/json";
/// Entries of one kind that are listed: more than a timeline has pixels.
const MOST: usize = 2000;
/// Points of a path while it is gathered, and of all paths of a picture in the end.
const PATH_POINTS: usize = 200;
const PICTURE_POINTS: usize = 400;
/// Paths of a picture: more are a tangle.
const PATHS: usize = 40;
/// Largest digest that is believed, bytes: a dozen times what the limits above allow.
const MOST_BYTES: u64 = 8 << 20;
/// What stands for a body where no sensor measures positions.
const ENDS: [&str; 5] = ["pelvis", "hand_r", "hand_l", "foot_r", "foot_l"];

/// Gathers the digest of one recording.
#[derive(Clone, Debug)]
pub struct Digester {
    names: Names,
    begun: Timestamp,
    end: Timestamp,
    first_frame: Option<Timestamp>,
    marks: Thinned<DigestMark>,
    faults: Thinned<FaultSpan>,
    /// Of each sensor the fault that it has, and since when, s.
    faulty: Vec<Option<(Cause, f64)>>,
    segments: Thinned<SegmentSpan>,
    /// Of each body what its motion shows, and since when, s.
    shown: BTreeMap<Option<BodyIndex>, (String, f64)>,
    repetitions: Thinned<DigestRepetition>,
    key_poses: Thinned<DigestKeyPose>,
    /// Of each sensor.
    paths: Vec<Thinned<[f64; 3]>>,
    /// Of each body: places of segments in its layout, with their paths.
    ends: Vec<Vec<(usize, Thinned<[f64; 3]>)>>,
}

impl Digester {
    /// Begins with the recording.
    pub fn new(stage: &Stage, begun: Timestamp) -> Self {
        let names = Names::new(stage);
        let sensors = names.sensors().count();
        let ends = names.bodies().map(|body| {
            let segments = names.body(body).map_or(&[][..], |layout| &layout.segments);
            let ends = segments.iter().enumerate().filter(|(_, segment)| ENDS.contains(&&*segment.name));
            ends.map(|(place, _)| (place, Thinned::new(PATH_POINTS))).collect()
        });
        Self {
            ends: ends.collect(),
            names,
            begun,
            end: begun,
            first_frame: None,
            marks: Thinned::new(MOST),
            faults: Thinned::new(MOST),
            faulty: vec![None; sensors],
            segments: Thinned::new(MOST),
            shown: BTreeMap::new(),
            repetitions: Thinned::new(MOST),
            key_poses: Thinned::new(MOST),
            paths: (0..sensors).map(|_| Thinned::new(PATH_POINTS)).collect(),
        }
    }

    /// One that has gathered nothing, of a recording of the same stage that begins then.
    #[must_use]
    pub fn begun_at(&self, begun: Timestamp) -> Self {
        Self { begun, end: begun, ..self.clone() }
    }

    /// An entry of the recording's log comes in at this time.
    pub fn entry(&mut self, t: Timestamp) {
        self.end = self.end.max(t);
    }

    /// What follows from it.
    pub fn output(&mut self, output: &Output<'_>) {
        match output {
            Output::Estimate(estimate) => self.estimate(estimate),
            Output::Body(body) => self.body(body),
            Output::Outcome(outcome) => self.outcome(milliseconds(outcome.t_valid), &outcome.what),
            _ => {}
        }
    }

    fn estimate(&mut self, estimate: &Estimate) {
        self.first_frame.get_or_insert(estimate.t_valid);
        for (path, sensor) in self.paths.iter_mut().zip(&estimate.sensors) {
            if let Some(position_m) = sensor.usable_pose().and_then(|pose| pose.position_m) {
                path.push(|| millimetres(position_m));
            }
        }
    }

    fn body(&mut self, body: &Body) {
        for (place, path) in self.ends.get_mut(usize::from(body.index)).into_iter().flatten() {
            let segment = body.segments.get(*place).filter(|segment| segment.state.is_shown());
            if let Some(position_m) = segment.and_then(|segment| segment.position_m) {
                path.push(|| millimetres(position_m));
            }
        }
    }

    fn outcome(&mut self, t_s: f64, what: &OutcomeKind) {
        match what {
            OutcomeKind::Mark { label } => self.marks.push(|| DigestMark { t_s, label: label.clone() }),
            OutcomeKind::Fault { sensor, cause, active } => {
                let Some(faulty) = self.faulty.get_mut(usize::from(*sensor)) else { return };
                let began = std::mem::replace(faulty, active.then_some((*cause, t_s)));
                // One that ends without having begun has gone on since before.
                let ended = began.or((!active).then_some((*cause, milliseconds(self.begun))));
                if let Some((fault, from_s)) = ended {
                    let sensor = self.names.sensor(*sensor).to_owned();
                    self.faults.push(|| FaultSpan { sensor, fault, from_s, to_s: t_s });
                }
            }
            OutcomeKind::MotionSegment(segment) if segment.event == SegmentEvent::Confirmed => {
                let began = self.shown.insert(segment.body, (segment.label.clone(), t_s));
                if let Some(began) = began {
                    let span = self.span(segment.body, began, t_s);
                    self.segments.push(|| span);
                }
            }
            OutcomeKind::Exercise(outcome) => {
                if let ExerciseWhat::Repetition(repetition) = &outcome.what
                    && matches!(repetition.kind, EventKind::Counted | EventKind::Rejected)
                {
                    self.repetitions.push(|| DigestRepetition {
                        subject: outcome.subject.to_string(),
                        exercise: repetition.exercise.to_string(),
                        from_s: round::to(1e3, repetition.t_start_s),
                        t_s,
                        counted: repetition.kind == EventKind::Counted,
                    });
                }
            }
            OutcomeKind::KeyPose(event) if event.phase == Phase::Confirmed => {
                let sensor = self.names.sensor(event.sensor);
                self.key_poses.push(|| DigestKeyPose { sensor: sensor.to_owned(), t_s });
            }
            _ => {}
        }
    }

    fn span(&self, body: Option<BodyIndex>, (label, from_s): (String, f64), to_s: f64) -> SegmentSpan {
        SegmentSpan { body: body.map(|body| self.names.body_name(body).to_owned()), label, from_s, to_s }
    }

    /// The digest of what has come in.
    pub fn finish(mut self) -> Digest {
        let end_s = milliseconds(self.end);
        for (sensor, began) in (0..).zip(std::mem::take(&mut self.faulty)) {
            if let Some((fault, from_s)) = began {
                let sensor = self.names.sensor(sensor).to_owned();
                self.faults.push(|| FaultSpan { sensor, fault, from_s, to_s: end_s.max(from_s) });
            }
        }
        for (body, began) in std::mem::take(&mut self.shown) {
            let to_s = end_s.max(began.1);
            let span = self.span(body, began, to_s);
            self.segments.push(|| span);
        }
        let Self { marks, faults, segments, repetitions, key_poses, .. } = &self;
        let counts = DigestCounts {
            marks: marks.seen(),
            faults: faults.seen(),
            segments: segments.seen(),
            repetitions: repetitions.seen(),
            key_poses: key_poses.seen(),
        };
        let dropped = DigestCounts {
            marks: left_out(marks),
            faults: left_out(faults),
            segments: left_out(segments),
            repetitions: left_out(repetitions),
            key_poses: left_out(key_poses),
        };
        Digest {
            begun_s: milliseconds(self.begun),
            length_s: round::to(1e3, self.end.seconds_since(self.begun)),
            // As messages have it.
            first_frame_s: self.first_frame.map(|t| round::to(1e6, t.as_secs_f64())),
            counts,
            dropped,
            picture: self.picture(),
            marks: self.marks.into_kept(),
            faults: self.faults.into_kept(),
            segments: self.segments.into_kept(),
            repetitions: self.repetitions.into_kept(),
            key_poses: self.key_poses.into_kept(),
        }
    }

    fn picture(&self) -> Picture {
        let names = self.names.sensors().map(|(name, _)| name.to_owned());
        let mut paths: Vec<(String, &[[f64; 3]])> =
            names.zip(self.paths.iter().map(Thinned::kept)).filter(|(_, path)| !path.is_empty()).collect();
        if paths.is_empty() {
            for (body, ends) in self.names.bodies().zip(&self.ends) {
                let segments = self.names.body(body).map_or(&[][..], |layout| &layout.segments);
                let name = |place: usize| format!("{}/{}", self.names.body_name(body), segments[place].name);
                let seen = ends.iter().filter(|(_, path)| !path.kept().is_empty());
                paths.extend(seen.map(|(place, path)| (name(*place), path.kept())));
            }
        }
        paths.truncate(PATHS);
        let most = PICTURE_POINTS / paths.len().max(1);
        let thin = |(name, path): (String, &[[f64; 3]])| PicturePath {
            name,
            position_m: path.iter().step_by(path.len().div_ceil(most)).copied().collect(),
        };
        Picture { paths: paths.into_iter().map(thin).collect() }
    }
}

fn left_out<T>(lane: &Thinned<T>) -> u64 {
    lane.seen() - lane.kept().len() as u64
}

/// Stage time to whole milliseconds, s: finer than any frame.
fn milliseconds(t: Timestamp) -> f64 {
    round::to(1e3, t.as_secs_f64())
}

fn millimetres(position_m: [f64; 3]) -> [f64; 3] {
    round::each(1e3, position_m)
}

/// The digest of a recording, from the recording or from the file beside it; `None` where there is none.
///
/// # Errors
/// The system fails to read.
pub fn read_digest(recording: &Path) -> io::Result<Option<Digest>> {
    read(recording)
}

/// The same, or so much of it as `D` has.
pub(super) fn read<D: for<'a> Deserialize<'a>>(recording: &Path) -> io::Result<Option<D>> {
    let mut file = File::open(recording)?;
    let attached = match Ends::read(&mut file)? {
        Some(ends) => ends.attachment(&mut file, NAME, MOST_BYTES)?,
        None => None,
    };
    let bytes = match attached {
        Some(bytes) => Some(bytes),
        None => beside(recording, file.metadata()?.modified().ok())?,
    };
    // What cannot be read is made anew.
    Ok(bytes.and_then(|bytes| serde_json::from_slice(&bytes).ok()))
}

/// The file beside a recording that holds the digest of one which has none.
pub fn digest_file(recording: &Path) -> PathBuf {
    let mut name = recording.file_name().map(OsString::from).unwrap_or_default();
    name.push(".");
    name.push(NAME);
    recording.with_file_name(name)
}

/// What the file beside holds; one that is older than the recording is of another.
fn beside(recording: &Path, modified: Option<SystemTime>) -> io::Result<Option<Vec<u8>>> {
    let path = digest_file(recording);
    let known = match path.metadata() {
        Ok(known) => known,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    let is_older = matches!((known.modified(), modified), (Ok(own), Some(recorded)) if own < recorded);
    if is_older || known.len() > MOST_BYTES {
        return Ok(None);
    }
    std::fs::read(path).map(Some)
}

/// Makes the digest of a recording by a replay. `progress` receives the bytes read so far and says whether to go on.
///
/// # Errors
/// It cannot be read or replayed to its end, or `progress` has ended it ([`ReadError::Cancelled`]).
pub fn make_digest(recording: &Path, mut progress: impl FnMut(u64) -> bool) -> Result<Digest, ReadError> {
    let mut reader = Reader::open(recording)?;
    let header: &Header = reader.header();
    let (stage, mut machine) = Machine::as_recorded(header)?;
    let mut digester = Digester::new(&stage, header.begun);
    while let Some(item) = reader.next() {
        if !progress(reader.bytes_read()) {
            return Err(ReadError::Cancelled);
        }
        if let Item::Entry(entry) = item? {
            digester.entry(entry.t);
            machine.pipeline.push(&entry, &mut |output| digester.output(&output));
        }
    }
    Ok(digester.finish())
}

/// Keeps a digest in the file beside a recording.
///
/// # Errors
/// The folder may not be written to.
pub fn keep_digest(recording: &Path, digest: &Digest) -> io::Result<()> {
    let mut file = AtomicFile::create(&digest_file(recording))?;
    serde_json::to_writer(&mut file, digest).map_err(io::Error::from)?;
    file.flush()?;
    file.commit()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::testing::{STAGE, chunk, header};
    use crate::{Brief, Ending, Writer};
    use posed_stage::output::{Outcome, PoseEstimate, SensorEstimate, SensorState};

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn digester() -> Digester {
        Digester::new(&Stage::parse(STAGE).unwrap(), at(1.0))
    }

    fn happens(digester: &mut Digester, t_s: f64, what: OutcomeKind) {
        digester.entry(at(t_s) + Duration::from_millis(20));
        let outcome = Outcome { t_valid: at(t_s), t_decided: at(t_s), what };
        digester.output(&Output::Outcome(&outcome));
    }

    fn fault(sensor: u16, active: bool) -> OutcomeKind {
        OutcomeKind::Fault { sensor, cause: Cause::Stuck, active }
    }

    #[test]
    fn faults_are_spans_from_the_beginning_and_to_the_end_of_the_recording_where_they_go_on() {
        let mut digester = digester();
        happens(&mut digester, 2.0, fault(0, false));
        happens(&mut digester, 3.0, fault(1, true));
        happens(&mut digester, 4.5, fault(1, false));
        happens(&mut digester, 5.0, fault(1, true));
        happens(&mut digester, 6.0, OutcomeKind::Mark { label: "pain".to_owned() });
        let digest = digester.finish();
        let spans = digest.faults.iter().map(|span| (span.sensor.as_str(), span.from_s, span.to_s));
        assert_eq!(
            spans.collect::<Vec<_>>(),
            [("left", 1.0, 2.0), ("right", 3.0, 4.5), ("right", 5.0, 6.02)]
        );
        assert_eq!((digest.begun_s, digest.length_s), (1.0, 5.02));
        assert_eq!(digest.marks, [DigestMark { t_s: 6.0, label: "pain".to_owned() }]);
        assert_eq!((digest.counts.faults, digest.counts.marks, digest.dropped.faults), (3, 1, 0));
    }

    #[test]
    fn a_long_recording_takes_no_more_room_and_says_what_it_leaves_out() {
        let mut digester = digester();
        let mut estimate = Estimate::default();
        for second in 0..20_000_u32 {
            let t_s = 1.0 + f64::from(second);
            happens(&mut digester, t_s, OutcomeKind::Mark { label: second.to_string() });
            let position_m = Some([f64::from(second) * 1e-4, 0.12345, -1.0]);
            let pose = Some(PoseEstimate { position_m, ..still() });
            let state = SensorState::Ok;
            estimate.sensors = vec![SensorEstimate { pose, state, ..Default::default() }; 2];
            digester.output(&Output::Estimate(&estimate));
        }
        let digest = digester.finish();
        assert_eq!(digest.counts.marks, 20_000);
        assert_eq!(digest.dropped.marks, 20_000 - digest.marks.len() as u64);
        assert!((MOST / 2..=MOST).contains(&digest.marks.len()));
        let points: Vec<usize> = digest.picture.paths.iter().map(|path| path.position_m.len()).collect();
        assert!(points.len() == 2 && points.iter().sum::<usize>() <= PICTURE_POINTS, "{points:?}");
        assert_eq!(digest.picture.paths[0].position_m[0], [0.0, 0.123, -1.0]);
        assert!(digest.picture.paths[0].position_m.last().unwrap()[0] > 1.9, "to the end");
        assert!(serde_json::to_vec(&digest).unwrap().len() < 100_000);
    }

    fn still() -> PoseEstimate {
        PoseEstimate {
            position_m: None,
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            velocity_m_s: None,
            angular_velocity_rad_s: [0.0; 3],
            covariance: [0.0; 21],
            sigma_m: None,
        }
    }

    #[test]
    fn it_is_found_from_the_end_of_the_file_and_changes_nothing_for_who_reads_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = Writer::new(File::create(&path).unwrap(), header()).unwrap();
        (0..50).for_each(|n| writer.entry(&chunk(n * 1_000_000)).unwrap());
        writer.flush().unwrap();
        let torn = folder.path().join("torn.mcap");
        std::fs::copy(&path, &torn).unwrap();
        let mut digester = digester();
        happens(&mut digester, 2.0, OutcomeKind::Mark { label: "ü".to_owned() });
        let digest = digester.finish();
        writer.digest(&digest).unwrap();
        writer.finish("enough").unwrap();
        assert_eq!(read_digest(&path).unwrap(), Some(digest.clone()));
        let mut reader = Reader::open(&path).unwrap();
        assert_eq!(reader.by_ref().map(Result::unwrap).count(), 50);
        assert_eq!((reader.ending(), reader.end_reason()), (Some(Ending::Complete), Some("enough")));
        let brief = Brief::read(&path).unwrap();
        assert_eq!((brief.stage.as_str(), brief.counts), ("Test stage", Some(digest.counts)));
        assert!(brief.is_complete() && (brief.length_s.unwrap() - 0.049).abs() < 1e-6, "{brief:?}");
        assert_eq!(brief.utc(), "2023-11-14T22:13:20.123456784Z");

        // One that was torn has none, and one that is kept beside it counts as long as the recording stays as it is.
        assert_eq!(read_digest(&torn).unwrap(), None);
        let brief = Brief::read(&torn).unwrap();
        assert_eq!((brief.stage.as_str(), brief.length_s, brief.counts), ("Test stage", None, None));
        keep_digest(&torn, &digest).unwrap();
        assert_eq!(digest_file(&torn), folder.path().join("torn.mcap.digest.json"));
        assert_eq!(read_digest(&torn).unwrap(), Some(digest));
        let later = SystemTime::UNIX_EPOCH + Duration::from_secs(4_000_000_000);
        File::options().write(true).open(&torn).unwrap().set_modified(later).unwrap();
        assert_eq!(read_digest(&torn).unwrap(), None);
        std::fs::write(digest_file(&path), "{").unwrap();
        assert!(read_digest(&path).unwrap().is_some(), "its own comes first");
        // Whatever the end of a file claims, nothing is believed that is not there.
        let bytes = std::fs::read(&path).unwrap();
        for cut in (0..bytes.len()).step_by(7) {
            std::fs::write(&torn, &bytes[..cut]).unwrap();
            let _ = Brief::read(&torn);
        }
        for at in bytes.len() - 400..bytes.len() {
            let mut bytes = bytes.clone();
            bytes[at] ^= 0xFF;
            std::fs::write(&torn, &bytes).unwrap();
            let _ = (Brief::read(&torn), read_digest(&torn));
        }
    }
}
