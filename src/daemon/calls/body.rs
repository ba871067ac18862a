//! `body.calibrate`: guides a person through poses and movements, and finds how the sensors sit.
//!
//! In: samples from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's message; in
//! the end a mounting for the pipeline, or one sentence about what to repeat. A mounting that is not good is not used.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use nalgebra::Vector3;
use serde_json::{Map, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::inbox::Event;
use super::super::jobs::Job;
use super::super::server::Reply;
use super::Calls;
use crate::fusion::body::calibrate::{Calibrated, Recorded, calibrate};
use crate::fusion::body::guide::{Guide, LONGEST_S, Thoroughness};
use crate::fusion::body::{SEGMENTS, Segment, Skeleton};
use crate::geometry::orientation_to_wxyz;
use crate::input::{Model, MountedSensor};
use crate::layout::{ChainLayout, Wearers, skeleton_of};
use crate::pipeline::all_have_field;
use crate::stage;

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
        let worn = match self.worn() {
            Ok(worn) => worn,
            Err(sentence) => return reply.error("no_body", sentence),
        };
        let session = Session { worn, how, inbox: self.inbox.clone() };
        self.jobs.run("body.calibrate", reply, move |job| session.run(job));
    }

    /// Who sits where; a sentence where there is nobody to calibrate.
    fn worn(&self) -> Result<Worn, String> {
        let body = self.stage.body.as_ref().filter(|body| body.skeleton == stage::Skeleton::Human);
        let skeleton = body.and_then(skeleton_of).ok_or("this stage has no human [body] with `height_m`")?;
        let wearers = Wearers::of(&self.stage).unwrap_or_default();
        if wearers.imus.iter().all(Option::is_none) {
            return Err("this stage has no IMU on a segment of the body".into());
        }
        let sensor = |index: u16| &self.stage.sensors[usize::from(index)];
        Ok(Worn {
            names: wearers.imus.map(|index| index.map(|index| sensor(index).name.clone())),
            offsets_m: wearers.imus.map(|index| Some(Vector3::from(sensor(index?).offset_m?))),
            magnetic: all_have_field(&self.stage, &wearers.imus),
            skeleton,
        })
    }
}

/// The sensors to calibrate.
struct Worn {
    names: [Option<String>; SEGMENTS],
    offsets_m: [Option<Vector3<f64>>; SEGMENTS],
    magnetic: bool,
    skeleton: Skeleton,
}

/// A calibration at work.
struct Session {
    worn: Worn,
    how: Thoroughness,
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, String> {
        let (to, samples) = sync_channel(WAITING);
        self.inbox.push(Event::Command(Command::WatchBody(to)));
        let guide = self.guided(job, &samples)?;
        self.solve(job, &guide)
    }

    /// Until everything was done.
    fn guided(&self, job: &Job, samples: &Receiver<Recorded>) -> Result<Guide, String> {
        let present = self.worn.names.each_ref().map(Option::is_some);
        let mut guide = Guide::new(present, self.worn.magnetic, self.how);
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

    fn solve(&self, job: &Job, guide: &Guide) -> Result<String, String> {
        let (recording, blocks) = guide.recorded();
        let found = calibrate(recording, blocks, &self.worn.skeleton, &self.worn.offsets_m)
            .map_err(|error| format!("{error}; begin again"))?;
        let quality: Map<String, serde_json::Value> = Segment::ALL
            .into_iter()
            .filter_map(|segment| {
                Some((segment.name().to_owned(), json!(found.quality_deg[segment.index()]?)))
            })
            .collect();
        job.result(json!({ "quality_deg": quality }));
        if !found.warnings.is_empty() {
            return Err(format!("{}; begin again", found.warnings.join("; ")));
        }
        let worst = Segment::ALL
            .into_iter()
            .filter_map(|segment| Some((segment, found.quality_deg[segment.index()]?)))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        let sensors = self.mounted(&found);
        self.inbox.push(Event::Command(Command::LoadModel(Model::Mounting { sensors })));
        let worst = worst.map_or_else(String::new, |(segment, quality_deg)| {
            format!("; the worst is {} with {quality_deg:.1} degrees", segment.name())
        });
        Ok(format!("the sensors' mounting is known{worst}"))
    }

    fn mounted(&self, found: &Calibrated) -> Vec<MountedSensor> {
        let mounted = |(name, worn): (&Option<String>, &Option<crate::fusion::body::Worn>)| {
            let worn = (*worn)?;
            Some(MountedSensor {
                sensor: name.clone()?,
                mount_quat_wxyz: orientation_to_wxyz(&worn.q_segment_sensor),
                offset_m: worn.offset_m.into(),
            })
        };
        self.worn.names.iter().zip(&found.worn).filter_map(mounted).collect()
    }
}
