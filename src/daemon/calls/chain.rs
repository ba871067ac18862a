//! `body.calibrate` on a stage with a chain of hinges: guides somebody through a posture and a movement, and finds the axes.
//!
//! In: samples from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's message; in
//! the end a model for the pipeline, through its log, or one sentence about what to repeat. Axes that are not known well enough
//! are not used.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use serde_json::{Map, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::inbox::Event;
use super::super::jobs::Job;
use super::super::server::Reply;
use super::Calls;
use crate::fusion::chain::calibrate::calibrate;
use crate::fusion::chain::guide::{Guide, LONGEST_S};
use crate::fusion::chain::{ChainSegment, Epoch};
use crate::input::Model;
use crate::layout::ChainLayout;

/// Samples that may wait for the thread: ten seconds at 100 Hz.
const WAITING: usize = 1024;
/// Distance of two looks at whether the job was cancelled.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);
/// Without a sample for so many looks the stage is silent.
const SILENT_LOOKS: u32 = 10;
/// Axes are used that are known to so much, degrees.
const GOOD_DEG: f64 = 5.0;

impl Calls {
    /// Begins a calibration of the chain.
    pub(super) fn calibrate_chain(&self, layout: ChainLayout, reply: Reply) {
        let session = Session { segments: layout.segments, inbox: self.inbox.clone() };
        self.jobs.run("body.calibrate", reply, move |job| session.run(job));
    }
}

/// A calibration at work.
struct Session {
    segments: Vec<ChainSegment>,
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, String> {
        let (to, samples) = sync_channel(WAITING);
        self.inbox.push(Event::Command(Command::WatchChain(to)));
        let guide = guided(job, &samples)?;
        let calibration = calibrate(&self.segments, guide.recorded())
            .map_err(|error| format!("{error}; begin again, and move that joint more"))?;
        let hinges = self.segments.iter().zip(&calibration.segments).filter_map(|(segment, found)| {
            Some((segment.hinge.as_ref()?.1.clone(), found.hinge?.quality_deg))
        });
        let hinges: Vec<(String, f64)> = hinges.collect();
        let quality: Map<String, serde_json::Value> =
            hinges.iter().map(|(joint, quality_deg)| (joint.clone(), json!(quality_deg))).collect();
        job.result(json!({ "quality_deg": quality }));
        let worst = hinges.iter().max_by(|(_, a), (_, b)| a.total_cmp(b));
        if let Some((joint, quality_deg)) = worst.filter(|(_, quality_deg)| *quality_deg > GOOD_DEG) {
            return Err(format!(
                "the axis of {joint} is known to {quality_deg:.1} degrees only; begin again, bend that joint more, and turn the whole \
                 chain so that its axis does not stay level"
            ));
        }
        let calibration = Box::new(calibration);
        self.inbox.push(Event::Command(Command::LoadModel(Model::Chain { calibration })));
        let worst = worst.map_or_else(String::new, |(joint, quality_deg)| {
            format!("; the worst is {joint} with {quality_deg:.1} degrees")
        });
        Ok(format!("the axes of the chain are known{worst}"))
    }
}

/// Until everything was done.
fn guided(job: &Job, samples: &Receiver<Epoch>) -> Result<Guide, String> {
    let mut guide = Guide::default();
    let (mut silent, mut first_s) = (0, None);
    while let Some(prompt) = guide.prompt() {
        job.progress(Some(guide.progress()), Some(prompt.to_owned()));
        if job.is_cancelled() {
            return Err("cancelled; the sensors count as they did before".into());
        }
        match samples.recv_timeout(LOOK_INTERVAL) {
            Ok(epoch) => {
                silent = 0;
                if epoch.t_s - *first_s.get_or_insert(epoch.t_s) > LONGEST_S {
                    return Err(format!("the step \"{prompt}\" was not seen; begin again"));
                }
                guide.push(epoch);
            }
            Err(RecvTimeoutError::Timeout) => {
                silent += 1;
                if silent > SILENT_LOOKS {
                    return Err("no sensor sends anything; see to the devices and begin again".into());
                }
            }
            Err(RecvTimeoutError::Disconnected) => return Err("another calibration was begun".into()),
        }
    }
    Ok(guide)
}
