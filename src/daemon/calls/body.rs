//! `body.calibrate`: guides a person through poses and movements, and finds how the sensors sit.
//!
//! In: samples from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's message; in
//! the end a mounting for the pipeline, with who sits where if that was asked too, or one sentence about what to repeat. A mounting
//! that is not good is not used.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use serde_json::{Map, Value, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::inbox::Event;
use super::super::jobs::Job;
use super::super::server::Reply;
use super::Calls;
use crate::fusion::body::assign::assign;
use crate::fusion::body::calibrate::{Block, Calibrated, CalibrationError, Recorded, calibrate};
use crate::fusion::body::guide::{Guide, LONGEST_S, Thoroughness};
use crate::fusion::body::{SEGMENTS, Segment, Skeleton};
use crate::geometry::orientation_to_wxyz;
use crate::input::{Model, MountedSensor, SensorIndex};
use crate::layout::{ChainLayout, Wearers, offset_on, segment_of, skeleton_of};
use crate::pipeline::all_have_field;
use crate::stage::{self, Stage};

/// Samples that may wait for the thread: ten seconds at 100 Hz.
const WAITING: usize = 1024;
/// Distance of two looks at whether the job was cancelled.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);
/// Without a sample for so many looks the stage is silent.
const SILENT_LOOKS: u32 = 10;

impl Calls {
    /// Begins a calibration.
    pub(super) fn calibrate_body(&self, how: Thoroughness, reply: Reply) {
        if let Some(layout) = ChainLayout::of(&self.stage) {
            return self.calibrate_chain(layout, reply);
        }
        match self.wearer(how) {
            Ok(session) => self.jobs.run("body.calibrate", reply, move |job| session.run(job)),
            Err(sentence) => reply.error("no_body", sentence),
        }
    }

    /// Who wears IMUs; a sentence where there is nobody to calibrate.
    fn wearer(&self, how: Thoroughness) -> Result<Session, String> {
        let body = self.stage.body.as_ref().filter(|body| body.skeleton == stage::Skeleton::Human);
        let skeleton = body.and_then(skeleton_of).ok_or("this stage has no human [body] with `height_m`")?;
        let wearers = Wearers::of(&self.stage).unwrap_or_default();
        if wearers.imus.iter().all(Option::is_none) {
            return Err("this stage has no IMU on a segment of the body".into());
        }
        let magnetic = all_have_field(&self.stage, &wearers.imus);
        Ok(Session { stage: self.stage.clone(), skeleton, magnetic, how, inbox: self.inbox.clone() })
    }
}

/// The IMU on each segment.
type Worn = [Option<SensorIndex>; SEGMENTS];

/// A calibration at work.
struct Session {
    stage: Stage,
    skeleton: Skeleton,
    magnetic: bool,
    how: Thoroughness,
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, String> {
        let (to, samples) = sync_channel(WAITING);
        let worn = self.inbox.ask(|worn| Command::WatchBody { worn, to })?;
        let guide = self.guided(job, &worn, &samples)?;
        drop(samples);
        self.solve(job, worn, &guide)
    }

    /// Until everything was done.
    fn guided(&self, job: &Job, worn: &Worn, samples: &Receiver<Recorded>) -> Result<Guide, String> {
        let mut guide = Guide::new(worn.map(|imu| imu.is_some()), self.magnetic, self.how);
        let mut told = None;
        let mut silent = 0;
        let mut first_s = None;
        while let Some(prompt) = guide.prompt() {
            let (done, steps) = guide.progress();
            if told != Some(done) {
                told = Some(done);
                let message = format!("{} of {steps}: {prompt}", done + 1);
                job.progress(Some(done as f64 / steps as f64), Some(message));
            }
            if job.is_cancelled() {
                return Err("cancelled; the sensors count as they did before".into());
            }
            match samples.recv_timeout(LOOK_INTERVAL) {
                Ok((t_s, samples)) => {
                    silent = 0;
                    if t_s - *first_s.get_or_insert(t_s) > LONGEST_S {
                        return Err(format!("step {}, \"{prompt}\", was not seen; begin again", done + 1));
                    }
                    guide.push(t_s, &samples);
                }
                Err(RecvTimeoutError::Timeout) => {
                    silent += 1;
                    if silent > SILENT_LOOKS {
                        return Err("no sensor sends anything; see to the devices and begin again".into());
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err("another calibration was begun".into());
                }
            }
        }
        Ok(guide)
    }

    fn solve(&self, job: &Job, taken_for: Worn, guide: &Guide) -> Result<String, String> {
        let (recording, blocks) = guide.recorded();
        let again = |error: &dyn std::fmt::Display| format!("{error}; begin again");
        let mut worn = taken_for;
        let found = if self.how == Thoroughness::Assign {
            let assignment = assign(recording, blocks).map_err(|error| again(&error))?;
            worn = assignment.place(&taken_for);
            self.calibrate(&assignment.placed(recording), blocks, &worn)
        } else {
            self.calibrate(recording, blocks, &worn)
        };
        let found = found.map_err(|error| again(&error))?;
        let has_mounting =
            |imu| worn.iter().zip(&found.worn).any(|(at, sits)| *at == Some(imu) && sits.is_some());
        if let Some(lost) = taken_for.into_iter().flatten().find(|imu| !has_mounting(*imu)) {
            return Err(again(&format!("{} sent nothing; see to it", self.name(lost))));
        }
        let quality = self.by_segment(|segment| json!(found.quality_deg[segment.index()]));
        let sensors = self.by_segment(|segment| json!(worn[segment.index()].map(|imu| self.name(imu))));
        job.result(json!({ "quality_deg": quality, "sensors": sensors }));
        if !found.warnings.is_empty() {
            return Err(again(&found.warnings.join("; ")));
        }
        let worst = Segment::ALL
            .into_iter()
            .filter_map(|segment| Some((segment, found.quality_deg[segment.index()]?)))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        let sensors = self.mounted(&worn, &found);
        self.inbox.push(Event::Command(Command::LoadModel(Model::Mounting { sensors })));
        let worst = worst.map_or_else(String::new, |(segment, quality_deg)| {
            format!("; the worst is {} with {quality_deg:.1} degrees", segment.name())
        });
        Ok(format!("the sensors' mounting is known{worst}{}", self.told(&worn)))
    }

    fn calibrate(
        &self,
        recording: &[Recorded],
        blocks: &[Block],
        worn: &Worn,
    ) -> Result<Calibrated, CalibrationError> {
        let offsets_m = Segment::ALL
            .map(|segment| offset_on(&self.stage.sensors[usize::from(worn[segment.index()]?)], segment));
        calibrate(recording, blocks, &self.skeleton, &offsets_m)
    }

    fn name(&self, imu: SensorIndex) -> &str {
        &self.stage.sensors[usize::from(imu)].name
    }

    /// What there is to say of each segment.
    fn by_segment(&self, say: impl Fn(Segment) -> Value) -> Map<String, Value> {
        let said = Segment::ALL.into_iter().map(|segment| (segment.name().to_owned(), say(segment)));
        said.filter(|(_, value)| !value.is_null()).collect()
    }

    /// Who does not sit where the stage file says.
    fn told(&self, worn: &Worn) -> String {
        let elsewhere: Vec<String> = Segment::ALL
            .into_iter()
            .filter_map(|segment| {
                let sensor = &self.stage.sensors[usize::from(worn[segment.index()]?)];
                let moved = segment_of(sensor) != Some(segment);
                moved.then(|| format!("{} sits on {}", sensor.name, segment.name()))
            })
            .collect();
        match (elsewhere.is_empty(), self.how) {
            (false, _) => format!("; {}: the stage file says otherwise", elsewhere.join(", ")),
            (true, Thoroughness::Assign) => "; every sensor sits where the stage file says".into(),
            (true, _) => String::new(),
        }
    }

    fn mounted(&self, worn: &Worn, found: &Calibrated) -> Vec<MountedSensor> {
        let mounted = |segment: Segment| {
            let mounting = found.worn[segment.index()]?;
            Some(MountedSensor {
                sensor: self.name(worn[segment.index()]?).to_owned(),
                segment: Some(segment.name().to_owned()),
                mount_quat_wxyz: orientation_to_wxyz(&mounting.q_segment_sensor),
                offset_m: mounting.offset_m.into(),
            })
        };
        Segment::ALL.into_iter().filter_map(mounted).collect()
    }
}
