//! A pipeline that outlives its own faults.
//!
//! What comes in: entries, as for a [`Pipeline`]. What goes out: its outputs; where it panics, it is put back to where it stood before
//! that entry, from its newest checkpoint and the entries since, and goes on without the entry. Where that does not help, because
//! what is wrong is in its state, or cannot be, because the entry says that a port has opened or closed, it begins anew with the
//! stage and the models in use, and all devices are set up again. What it never
//! does: publish a frame twice, go back in time, or depend on anything but the entries. So a replay leaves out what the live
//! stage left out, and goes on as it did.
//!
//! A pipeline that cannot even begin anew lets its panic go on, for whoever runs it to end with it. So does a panic of whoever
//! takes the outputs: that is not the pipeline's.

use std::any::Any;
use std::ops::{Deref, Range};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use posed_drivers::{LineEvent, Timestamp};
use posed_stage::input::{DeviceIndex, Entry, Input};
use posed_stage::output::Output;
use posed_stage::{LoadedModels, Stage};
use posed_state::Plain;

use crate::{Pipeline, PipelineError};

/// Time between two checkpoints, s: so much is gone through again after a panic.
const CHECKPOINT_S: f64 = 1.0;
/// Bytes of entries after which there is one all the same.
const MOST_BYTES: usize = 256 << 10;
/// Entries after which there is one all the same.
const MOST_ENTRIES: usize = 4096;
/// Panics without a frame between them after which a pipeline that has begun anew is given up.
const MOST_IN_VAIN: u32 = 4;
/// What runs so long without one has recovered, though it closes no frame, s: what is wrong in a state shows at once and again.
const CALM_S: f64 = 1.0;

/// Panics that a pipeline has outlived: part of its state, so that a replay which begins anywhere knows them.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub(crate) struct Recoveries {
    entries_left_out: u64,
    begun_anew: u64,
    /// Panics since the last frame.
    in_vain: u32,
    last: Option<Timestamp>,
    /// Newest frame: its number and its tick.
    frame: Option<(u64, Timestamp)>,
}

impl Recoveries {
    /// Entries that were left out because the pipeline panicked at them.
    pub(crate) fn entries_left_out(&self) -> u64 {
        self.entries_left_out
    }

    /// A frame is published.
    pub(crate) fn closed(&mut self, number: u64, tick: Timestamp) {
        (self.frame, self.in_vain) = (Some((number, tick)), 0);
    }

    /// How often the pipeline has begun anew.
    pub(crate) fn begun_anew(&self) -> u64 {
        self.begun_anew
    }
}

/// An entry since the checkpoint. Nearly all are bytes, which lie together: keeping one takes no memory of its own.
#[derive(Clone, Debug)]
enum Kept {
    Bytes { t: Timestamp, device: DeviceIndex, range: Range<usize> },
    Other(Entry),
}

/// Where a pipeline can be put back to.
#[derive(Clone, Debug)]
struct Checkpoint {
    at: Timestamp,
    models: LoadedModels,
    state: Vec<u8>,
    since: Vec<Kept>,
    bytes: Vec<u8>,
    /// A model has come since: those above are no longer the ones in use.
    stale_models: bool,
}

impl Checkpoint {
    fn of(pipeline: &Pipeline) -> Self {
        Self {
            at: pipeline.now,
            models: pipeline.models().clone(),
            state: pipeline.snapshot(),
            since: Vec::new(),
            bytes: Vec::new(),
            stale_models: false,
        }
    }

    fn renew(&mut self, pipeline: &Pipeline) {
        self.at = pipeline.now;
        if std::mem::take(&mut self.stale_models) {
            self.models.clone_from(pipeline.models());
        }
        self.state = pipeline.snapshot();
        self.since.clear();
        self.bytes.clear();
    }

    fn is_due(&self, now: Timestamp) -> bool {
        now.seconds_since(self.at) >= CHECKPOINT_S
            || self.bytes.len() > MOST_BYTES
            || self.since.len() >= MOST_ENTRIES
    }

    fn keep(&mut self, entry: &Entry) {
        self.since.push(match &entry.input {
            Input::Bytes { device, bytes } => {
                let from = self.bytes.len();
                self.bytes.extend_from_slice(bytes);
                Kept::Bytes { t: entry.t, device: *device, range: from..self.bytes.len() }
            }
            _ => Kept::Other(entry.clone()),
        });
        self.stale_models |= matches!(entry.input, Input::Model(_) | Input::SegmentationNetwork(_));
    }

    /// The entries since, in order.
    fn entries(&self) -> impl Iterator<Item = Entry> {
        self.since.iter().map(|kept| match kept {
            Kept::Bytes { t, device, range } => {
                let bytes = self.bytes[range.clone()].to_vec();
                Entry { t: *t, input: Input::Bytes { device: *device, bytes } }
            }
            Kept::Other(entry) => entry.clone(),
        })
    }
}

/// A [`Pipeline`] that outlives its own panics: see the module. All that only looks at it goes to the pipeline itself.
#[derive(Clone, Debug)]
pub struct SupervisedPipeline {
    stage: Stage,
    pipeline: Pipeline,
    checkpoint: Checkpoint,
    #[cfg(feature = "fault-points")]
    panic_next: bool,
}

impl Deref for SupervisedPipeline {
    type Target = Pipeline;

    fn deref(&self) -> &Pipeline {
        &self.pipeline
    }
}

impl SupervisedPipeline {
    /// As [`Pipeline::new`].
    ///
    /// # Errors
    /// As [`Pipeline::new`].
    pub fn new(stage: &Stage) -> Result<Self, PipelineError> {
        Ok(Self::of(stage, Pipeline::new(stage)?))
    }

    /// As [`Pipeline::restore`].
    ///
    /// # Errors
    /// As [`Pipeline::restore`].
    pub fn restore(stage: &Stage, models: &LoadedModels, snapshot: &[u8]) -> Result<Self, PipelineError> {
        Ok(Self::of(stage, Pipeline::restore(stage, models, snapshot)?))
    }

    fn of(stage: &Stage, pipeline: Pipeline) -> Self {
        Self {
            stage: stage.clone(),
            checkpoint: Checkpoint::of(&pipeline),
            pipeline,
            #[cfg(feature = "fault-points")]
            panic_next: false,
        }
    }

    /// As [`Pipeline::push`]. Where the pipeline panics, the entry is left out, as the status reports.
    ///
    /// # Panics
    /// Where `emit` does, and where the pipeline cannot begin anew either: throw it away then.
    pub fn push(&mut self, entry: &Entry, emit: &mut dyn FnMut(Output<'_>)) {
        if self.checkpoint.is_due(self.pipeline.now.max(entry.t)) {
            self.checkpoint.renew(&self.pipeline);
        }
        match self.attempt(entry, emit) {
            Ok(()) => self.checkpoint.keep(entry),
            Err(panic) => self.recover(entry, panic, emit),
        }
    }

    /// Entries that were left out because the pipeline panicked at them.
    pub fn entries_left_out(&self) -> u64 {
        self.pipeline.recoveries.entries_left_out()
    }

    /// How often the pipeline has begun anew, because that did not help.
    pub fn begun_anew(&self) -> u64 {
        self.pipeline.recoveries.begun_anew()
    }

    /// Pushes an entry; gives the panic that it ends with.
    fn attempt(
        &mut self,
        entry: &Entry,
        emit: &mut dyn FnMut(Output<'_>),
    ) -> Result<(), Box<dyn Any + Send>> {
        let mut emitting = false;
        #[cfg(feature = "fault-points")]
        let panics = std::mem::take(&mut self.panic_next);
        let pipeline = &mut self.pipeline;
        let attempt = catch_unwind(AssertUnwindSafe(|| {
            pipeline.push(entry, &mut |output| {
                emitting = true;
                emit(output);
                emitting = false;
            });
            #[cfg(feature = "fault-points")]
            assert!(!panics, "a panic that a test asked for");
        }));
        attempt.map_err(|panic| if emitting { resume_unwind(panic) } else { panic })
    }

    /// Goes on after a panic at an entry.
    fn recover(&mut self, entry: &Entry, panic: Box<dyn Any + Send>, emit: &mut dyn FnMut(Output<'_>)) {
        let now = self.pipeline.now.max(entry.t);
        let mut recoveries = self.pipeline.recoveries.clone();
        if recoveries.last.is_some_and(|last| now.seconds_since(last) > CALM_S) {
            recoveries.in_vain = 0;
        }
        recoveries.in_vain += 1;
        recoveries.last = Some(now);
        if recoveries.in_vain > MOST_IN_VAIN {
            resume_unwind(panic);
        }
        recoveries.entries_left_out += 1;
        // A session that has missed that its port has opened would wait for ever.
        let may_lack = !matches!(
            entry.input,
            Input::Line { event: LineEvent::Opened { .. } | LineEvent::Closed { .. }, .. }
        );
        let before = if recoveries.in_vain == 1 && may_lack { self.before() } else { None };
        let is_anew = before.is_none();
        recoveries.begun_anew += u64::from(is_anew);
        let opened = self.pipeline.opened.clone();
        let Some(mut pipeline) = before.or_else(|| self.anew()) else { resume_unwind(panic) };
        if is_anew {
            // A tracker that is on the other side, or stuck, is that still.
            let sensors = pipeline.sensors.iter_mut().zip(&self.pipeline.sensors);
            sensors.for_each(|(sensor, before)| sensor.follow(before));
        }
        self.pipeline = pipeline;
        self.pipeline.now = now;
        if let Some((number, tick)) = recoveries.frame {
            self.pipeline.frames.go_on_after(number, tick);
        }
        self.pipeline.recoveries = recoveries;
        self.checkpoint = Checkpoint::of(&self.pipeline);
        let mut line = |device, event| {
            self.push(&Entry { t: now, input: Input::Line { device, event } }, emit);
        };
        if is_anew {
            // Sessions set their devices up when ports open, and these are open.
            for (device, modem_lines) in (0..).zip(opened) {
                if let Some(modem_lines) = modem_lines {
                    line(device, LineEvent::Opened { modem_lines });
                }
            }
        } else if let Input::Bytes { device, bytes } = &entry.input {
            line(*device, LineEvent::Dropped { bytes: bytes.len() as u64 });
        }
    }

    /// The pipeline as it stood before the entry at which it panicked; `None` where it panics on the way there.
    fn before(&self) -> Option<Pipeline> {
        let Checkpoint { models, state, .. } = &self.checkpoint;
        unless_it_panics(|| {
            let mut pipeline = Pipeline::restore(&self.stage, models, state)?;
            self.checkpoint.entries().for_each(|entry| pipeline.push(&entry, &mut |_| {}));
            Ok(pipeline)
        })
    }

    /// The pipeline before its first entry, with the models that were in use when it had not panicked yet.
    fn anew(&self) -> Option<Pipeline> {
        unless_it_panics(|| Pipeline::with_models(&self.stage, &self.checkpoint.models))
    }

    /// Lets the pipeline panic at the end of the next entry, all of whose outputs have gone out then. For tests of what is around it.
    #[cfg(feature = "fault-points")]
    pub fn panic_next(&mut self) {
        self.panic_next = true;
    }
}

/// What is made, where that succeeds.
fn unless_it_panics(make: impl FnOnce() -> Result<Pipeline, PipelineError>) -> Option<Pipeline> {
    catch_unwind(AssertUnwindSafe(make)).ok()?.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pipeline() -> SupervisedPipeline {
        let device = |name: &str| {
            format!(
                "[[device]]\nname = \"{name}\"\ndriver = \"flock-of-birds\"\nport = \"/dev/{name}\"\n\
                 [[sensor]]\nname = \"of {name}\"\ndevice = \"{name}\"\naddress = 1\n"
            )
        };
        let stage = format!("name = \"s\"\n{}{}", device("d"), device("e"));
        SupervisedPipeline::new(&Stage::parse(&stage).unwrap()).unwrap()
    }

    /// Pushes entries of one instant; the most entries and bytes that a panic would have had to go through again.
    fn most_kept(pipeline: &mut SupervisedPipeline, entries: impl Iterator<Item = Input>) -> (usize, usize) {
        let mut most = (0, 0);
        for input in entries {
            pipeline.push(&Entry { t: Timestamp::ZERO, input }, &mut |_| {});
            let Checkpoint { since, bytes, .. } = &pipeline.checkpoint;
            most = (most.0.max(since.len()), most.1.max(bytes.len()));
        }
        most
    }

    /// After a panic it stands as before: with all that came before the checkpoint, and all since.
    fn outlives_a_panic(mut pipeline: SupervisedPipeline) {
        let before = pipeline.pipeline.snapshot();
        assert!(pipeline.before().is_some_and(|again| again.snapshot() == before));
        let entry = Entry { t: Timestamp::ZERO, input: Input::Timer };
        pipeline.recover(&entry, Box::new("a panic that a test asked for"), &mut |_| {});
        assert_eq!((pipeline.entries_left_out(), pipeline.begun_anew()), (1, 0));
        pipeline.pipeline.recoveries = Recoveries::default();
        assert!(pipeline.pipeline.snapshot() == before, "something is lost");
    }

    #[test]
    fn more_entries_than_a_panic_may_have_to_go_through_bring_a_checkpoint_and_none_is_lost() {
        let mut pipeline = pipeline();
        let bytes = |n: usize| Input::Bytes { device: (n % 2) as DeviceIndex, bytes: vec![n as u8] };
        let (entries, _) = most_kept(&mut pipeline, (0..MOST_ENTRIES + 100).map(bytes));
        assert_eq!((entries, pipeline.checkpoint.since.len()), (MOST_ENTRIES, 100));
        outlives_a_panic(pipeline);
    }

    #[test]
    fn more_bytes_than_a_panic_may_have_to_go_through_bring_a_checkpoint_and_none_is_lost() {
        let mut pipeline = pipeline();
        let read = 4096;
        let bytes = |n: usize| Input::Bytes { device: (n % 2) as DeviceIndex, bytes: vec![n as u8; read] };
        let fit = MOST_BYTES / read + 1;
        let (_, most) = most_kept(&mut pipeline, (0..fit + 3).map(bytes));
        assert_eq!((most, pipeline.checkpoint.bytes.len()), (fit * read, 3 * read));
        outlives_a_panic(pipeline);
    }
}
