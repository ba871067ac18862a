//! Samples of the worn IMUs for a calibration that is under way.
//!
//! In: estimates, on the fusion thread. Out: samples of the whole body, frame by frame, to one who watches. It never waits for
//! that one: what he does not take in time is left out, and once he has gone nothing is done.

use std::sync::mpsc::{SyncSender, TrySendError};

use crate::fusion::body::SEGMENTS;
use crate::fusion::body::calibrate::Recorded;
use crate::input::SensorIndex;
use crate::layout::Wearers;
use crate::output::Estimate;
use crate::pipeline::{ImuRecords, all_have_field};
use crate::stage::Stage;

/// See the module.
pub(super) struct Worn {
    /// Whether all of them have magnetometers.
    field: bool,
    watcher: Option<Watcher>,
}

struct Watcher {
    to: SyncSender<Recorded>,
    imus: [Option<SensorIndex>; SEGMENTS],
    records: ImuRecords,
}

impl Worn {
    pub(super) fn new(stage: &Stage) -> Self {
        let imus = Wearers::of(stage).unwrap_or_default().imus;
        Self { field: all_have_field(stage, &imus), watcher: None }
    }

    /// Begins to send what the IMU of each segment measures; whoever watched before gets nothing more.
    pub(super) fn watch(&mut self, imus: [Option<SensorIndex>; SEGMENTS], to: SyncSender<Recorded>) {
        self.watcher = Some(Watcher { to, imus, records: ImuRecords::new(self.field) });
    }

    pub(super) fn frame(&mut self, estimate: &Estimate) {
        let Some(Watcher { to, imus, records }) = &mut self.watcher else { return };
        let samples = std::array::from_fn(|segment| {
            let sensor = estimate.sensors.get(usize::from(imus[segment]?))?;
            records.sample(segment, sensor.measured.as_ref()?)
        });
        let sent = to.try_send((estimate.t_valid.as_secs_f64(), samples));
        if matches!(sent, Err(TrySendError::Disconnected(_))) {
            self.watcher = None;
        }
    }
}
