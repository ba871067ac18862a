//! Who looks on while the fusion thread works: one tap for all of them.
//!
//! In: every entry, every output of the pipeline, and the pipeline after each entry, on the fusion thread. Out: what each observer
//! makes of it. Never: a wait, or an allocation for a frame.

mod health;
mod history;
mod poses;
mod recent;
mod samples;

use std::fmt;

use posed_drivers::Timestamp;

pub(super) use self::health::Health;
pub(super) use self::history::Kept;
pub(super) use self::poses::RecentPoses;
pub(super) use self::recent::{Excerpt, Recent};
pub(super) use self::samples::{
    AlignmentSample, AlignmentSource, BodySource, ChainSource, GuidedCalibration, ImuSource, Samples, Source,
};
use super::calibration::Calibration;
use super::training::Follow;
use posed_pipeline::Pipeline;
use posed_stage::Stage;
use posed_stage::input::Entry;
use posed_stage::output::Output;

/// Looks on while the fusion thread works, on that thread; nothing that it does may make it wait. Each method does nothing by
/// default.
pub trait Observer {
    /// An entry, before the pipeline takes it. Every one comes, in order; the first has number 0.
    fn on_entry(&mut self, _entry: &Entry) {}

    /// What the pipeline puts out, before clients and recordings get it.
    fn on_output(&mut self, _output: &Output<'_>, _times: &Times) {}

    /// The pipeline has taken an entry.
    fn after_entry(&mut self, _pipeline: &Pipeline) {}
}

impl fmt::Debug for dyn Observer + Send {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Observer")
    }
}

/// Times around an output, on the stage's clock.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// When the entry that the output comes from was read.
    pub read: Timestamp,
    /// When the output before this one of the same entry was published; zero where there is none.
    pub published: Timestamp,
    /// When the output came out of the pipeline.
    pub now: Timestamp,
}

/// All observers of a live stage.
pub(super) struct Observers {
    pub(super) health: Health,
    /// What exercises are taught from.
    pub(super) recent: Recent,
    /// What fault maps are learnt from.
    pub(super) poses: RecentPoses,
    field: Calibration,
    pub(super) training: Follow,
    /// The input log of a link to other machines.
    log: Option<Box<dyn Observer + Send>>,
    /// What guided calibrations take, by [`GuidedCalibration`].
    guided: [Option<Box<dyn Observer + Send>>; GuidedCalibration::COUNT],
}

impl Observers {
    pub(super) fn new(
        stage: &Stage,
        field: Calibration,
        training: Follow,
        log: Option<Box<dyn Observer + Send>>,
    ) -> Self {
        Self {
            health: Health::new(stage),
            recent: Recent::new(stage),
            poses: RecentPoses::new(stage),
            field,
            training,
            log,
            guided: Default::default(),
        }
    }

    /// Lets a guided calibration look on; an older one of its kind gets nothing more.
    pub(super) fn watch(&mut self, calibration: GuidedCalibration, observer: Box<dyn Observer + Send>) {
        self.guided[calibration as usize] = Some(observer);
    }

    fn all(&mut self) -> impl Iterator<Item = &mut dyn Observer> {
        let Self { health, recent, poses, field, training, log, guided } = self;
        let own: [&mut dyn Observer; 5] = [health, recent, poses, field, training];
        let given = log.iter_mut().chain(guided.iter_mut().flatten());
        own.into_iter().chain(given.map(|observer| &mut **observer as &mut dyn Observer))
    }
}

impl Observer for Observers {
    fn on_entry(&mut self, entry: &Entry) {
        self.all().for_each(|observer| observer.on_entry(entry));
    }

    fn on_output(&mut self, output: &Output<'_>, times: &Times) {
        self.all().for_each(|observer| observer.on_output(output, times));
    }

    fn after_entry(&mut self, pipeline: &Pipeline) {
        self.all().for_each(|observer| observer.after_entry(pipeline));
    }
}
