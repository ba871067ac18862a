//! What a stage saw, from the log of a recording.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use posed_pipeline::SupervisedPipeline;
use posed_recording::{Item, Machine, Reader};
use posed_stage::Stage;
use posed_stage::output::{Estimate, Output};

use super::Error;

/// A recording that is about to be gone through.
pub(super) struct Recorded {
    reader: Reader<BufReader<File>>,
    machine: Machine,
}

impl Recorded {
    /// Opens it; the stage is the one that was recorded.
    pub(super) fn open(path: &Path) -> Result<(Stage, Self), Error> {
        let reader = Reader::open(path).map_err(Error::failed)?;
        let (stage, machine) = Machine::as_recorded(reader.header()).map_err(Error::failed)?;
        Ok((stage, Self { reader, machine }))
    }

    /// Shows every estimate, in the order of the frames; the pipeline as it stood in the end.
    pub(super) fn estimates(mut self, mut see: impl FnMut(&Estimate)) -> Result<SupervisedPipeline, Error> {
        for item in self.reader.by_ref() {
            let Item::Entry(entry) = item.map_err(Error::failed)? else { continue };
            self.machine.pipeline.push(&entry, &mut |output| {
                if let Output::Estimate(estimate) = output {
                    see(estimate);
                }
            });
        }
        Ok(self.machine.pipeline)
    }
}
