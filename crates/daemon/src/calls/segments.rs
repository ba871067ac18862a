//! Segments of the motion: learning to name them from recordings that somebody has labelled.
//!
//! A job on threads of its own, which leave the processor to tracking. What comes of it goes the way of every model: through the input
//! log, swapped in between two frames.

use std::path::PathBuf;

use serde_json::json;

use super::super::clock::StageClock;
use super::super::fusion::FusionInbox;
use super::super::jobs::{Failure, Job, aside};
use super::super::models::{Library, ModelError};
use super::super::server::Reply;
use super::Calls;
use posed_motion::segments::{Epoch, Options, Trainer};
use posed_recording::table::TrainingSet;
use posed_recording::table::read_labelled_recordings;
use posed_stage::input::{Entry, Input};
use posed_stage::layout::BodyLayout;

/// Under this name models are kept in their folder.
const NAME: &str = "segments";
/// Half the receptive field of the paper's network. The default sees 40 ahead, and takes more for that.
const LONGEST_LOOK_AHEAD: usize = 121;
const MOST_EPOCHS: u32 = 1000;

/// Where models come from and go to.
struct School {
    recordings: PathBuf,
    /// Names that the stage has a place for.
    joints: Vec<String>,
    library: Library,
    inbox: FusionInbox,
    clock: StageClock,
}

impl Calls {
    /// Begins to learn from the labelled recordings.
    pub(super) fn train_segments(&self, epochs: Option<u32>, look_ahead: Option<usize>, reply: Reply) {
        if epochs.is_some_and(|epochs| epochs == 0 || epochs > MOST_EPOCHS) {
            return reply.error("bad_request", format!("epochs: give 1 to {MOST_EPOCHS}"));
        }
        if look_ahead.is_some_and(|frames| frames > LONGEST_LOOK_AHEAD) {
            return reply.error("bad_request", format!("look_ahead: give 0 to {LONGEST_LOOK_AHEAD} frames"));
        }
        let mut options = Options::default();
        options.epochs = epochs.unwrap_or(options.epochs);
        options.ahead = look_ahead.or(options.ahead);
        let layouts = BodyLayout::all(&self.stage);
        let segments = layouts.iter().flatten().flat_map(BodyLayout::places).map(str::to_owned);
        let sensors = self.stage.sensors.iter().map(|sensor| sensor.name.clone());
        let school = School {
            recordings: self.recordings.clone(),
            joints: sensors.chain(segments).collect(),
            library: self.segments.clone(),
            inbox: self.inbox.clone(),
            clock: self.clock,
        };
        self.jobs.run("segments.train", reply, move |job| school.train(job, options));
    }
}

impl School {
    fn train(&self, job: &Job, options: Options) -> Result<String, Failure> {
        job.progress(None, Some("reading the labelled recordings".into()));
        let files = read_labelled_recordings(&self.recordings)?;
        if files.is_empty() {
            return Err(format!(
                "no recording in {} has labels beside it; label TAKE.mcap in TAKE.eaf or TAKE.labels.csv",
                self.recordings.display()
            )
            .into());
        }
        let set = TrainingSet::new(&files, |joint| self.joints.iter().any(|known| known == joint))?;
        drop(files);
        let mut trainer = set.trainer(options)?;
        let last = aside(|| learn(job, &mut trainer))??;
        let model = trainer.model(&set.labels, set.files.clone());
        // Whoever sends one has looked first.
        let _ = model.columns(self.joints.iter().map(String::as_str))?;
        let bytes = model.to_bytes()?;
        let kept = self.library.keep_next(NAME, |_| Ok::<_, ModelError>(&bytes))?;
        self.inbox.enter(Entry { t: self.clock.now(), input: Input::SegmentationNetwork(bytes) });
        job.result(json!({
            "revision": kept.revision, "file": kept.file(), "labels": set.labels, "files": set.files.len(),
            "frames": set.frames(), "accuracy": last.accuracy,
        }));
        Ok(format!(
            "{} labels from {} recordings, {:.1} % of their frames named right; kept as {}, which `[segments] model` loads at the next start",
            set.labels.len(),
            set.files.len(),
            100.0 * last.accuracy,
            kept.file()
        ))
    }
}

fn learn(job: &Job, trainer: &mut Trainer) -> Result<Epoch, Failure> {
    let mut last = Epoch::default();
    while !trainer.is_done() {
        if job.is_cancelled() {
            return Err("cancelled; the model is as it was".into());
        }
        last = trainer.epoch();
        let (done, epochs) = trainer.progress();
        let words =
            format!("loss {:.3}, {:.1} % of the frames named right", last.loss, 100.0 * last.accuracy);
        job.progress(Some(f64::from(done) / f64::from(epochs)), Some(words));
    }
    Ok(last)
}
