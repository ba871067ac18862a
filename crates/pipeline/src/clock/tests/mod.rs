//! The clock on simulated lines with known truth.

mod counting;
mod gaps;
mod line;

use posed_drivers::{Arrival, Measurement};

use super::*;

/// A small generator of our own: tests must give the same numbers for ever.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

const BYTE_S: f64 = 10.0 / 115_200.0;

/// A whole record without values, read by itself.
pub(super) fn sample(
    address: u16,
    t_read: Timestamp,
    t_previous_read: Option<Timestamp>,
    t_device: DeviceTime,
) -> Sample {
    let arrival = Arrival {
        t_read,
        t_previous_read,
        bytes_after: 0,
        cycle_bytes_before: 0,
        split: false,
        after_loss: false,
    };
    let measurement =
        Measurement::Pose { position_m: None, clipped: false, orientation_wxyz: None, button: None };
    Sample { address, arrival, t_device, measurement }
}
