//! Samples of a chain's IMUs for a calibration that is under way.
//!
//! In: estimates, on the fusion thread. Out: samples of the whole chain, frame by frame, to one who watches. It never waits for
//! that one: what he does not take in time is left out, and once he has gone nothing is done.

use std::sync::mpsc::{SyncSender, TrySendError};

use crate::fusion::chain::Epoch;
use crate::input::SensorIndex;
use crate::layout::ChainLayout;
use crate::output::Estimate;
use crate::stage::Stage;

/// See the module.
pub(super) struct Chained {
    imus: Vec<SensorIndex>,
    watcher: Option<SyncSender<Epoch>>,
}

impl Chained {
    pub(super) fn new(stage: &Stage) -> Self {
        Self { imus: ChainLayout::of(stage).map_or_else(Vec::new, |layout| layout.imus), watcher: None }
    }

    /// Begins to send; whoever watched before gets nothing more.
    pub(super) fn watch(&mut self, to: SyncSender<Epoch>) {
        self.watcher = Some(to);
    }

    pub(super) fn frame(&mut self, estimate: &Estimate) {
        let Some(to) = &self.watcher else { return };
        let sample =
            |imu: &SensorIndex| estimate.sensors.get(usize::from(*imu))?.measured?.inertial?.sample();
        let samples: Vec<_> = self.imus.iter().map(sample).collect();
        if samples.iter().all(Option::is_none) {
            return;
        }
        let sent = to.try_send(Epoch { t_s: estimate.t_valid.as_secs_f64(), samples });
        if matches!(sent, Err(TrySendError::Disconnected(_))) {
            self.watcher = None;
        }
    }
}
