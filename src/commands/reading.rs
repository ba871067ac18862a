//! How the commands read tables with columns for each joint: `NAME_x,NAME_y,NAME_z`.

use posed_recording::table::{SequenceOptions, Unit, Up};

/// How to read a table with columns for each joint.
#[derive(clap::Args)]
pub(crate) struct Reading {
    /// Rows per second of files without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Unit of its positions.
    #[arg(long, value_enum, default_value_t)]
    unit: Unit,
    /// Its upward axis.
    #[arg(long, value_enum, default_value_t)]
    up: Up,
}

impl Reading {
    pub(crate) fn options(&self) -> SequenceOptions {
        SequenceOptions { rate_hz: self.rate_hz, unit: self.unit, up: self.up }
    }
}
