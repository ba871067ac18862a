//! The contract of every device session.
//!
//! A session is a state machine without IO: feed it one input ([`Session::handle_line`],
//! [`Session::handle_bytes`] or [`Session::handle_timeout`]), then call [`Session::poll_output`] until
//! it returns `None`, then ask [`Session::poll_timeout`] when it wants to be woken. Time enters only as
//! the `now` argument and never runs backwards. The same inputs give the same outputs, always, and a
//! session can be serialised between two inputs and go on from there.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use crate::sample::{Sample, Timestamp};

/// What happened to the line under a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum LineEvent {
    /// The port is open; a session starts its set-up from the beginning.
    Opened {
        /// Whether modem lines (RTS) exist; a pseudo-terminal or a socket has none.
        modem_lines: bool,
    },
    /// The port is gone, or could not be opened; the sentence states why.
    Closed {
        /// What the operating system said, in words for the operator.
        reason: String,
    },
    /// Bytes that were read but had to be dropped before the session saw them.
    Dropped {
        /// How many.
        bytes: u64,
    },
}

/// What a session asks for or tells.
#[derive(Clone, Debug, PartialEq, Plain)]
#[expect(clippy::large_enum_variant, reason = "nearly all outputs are samples, and none may allocate")]
pub enum Output {
    /// Write these bytes to the line.
    Transmit(Vec<u8>),
    /// Set the RTS line (`true` = asserted).
    SetRts(bool),
    /// A measurement.
    Sample(Sample),
    /// The state has changed; read it with [`Session::state`].
    StateChanged,
    /// Something the operator should know, in one sentence that states what to do.
    Warning(String),
}

/// What a session is doing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum State {
    /// The port is not open, or set-up is under way.
    Connecting {
        /// What it waits for, in words.
        reason: String,
    },
    /// Records are coming in.
    Streaming,
    /// The port is open, and nothing comes.
    Silent {
        /// What to check.
        reason: String,
    },
    /// The device refused to work; the session tries again by itself.
    Failed {
        /// What the device said and what to check.
        reason: String,
    },
}

/// What a session has seen since it was made; never reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct Counters {
    /// Records accepted.
    pub records: u64,
    /// Records seen on the line and refused: wrong length, unknown address, out of order, impossible values.
    pub rejected: u64,
    /// Bytes that belong to no accepted record and to no answer.
    pub bytes_skipped: u64,
}

/// A sensor as its device names it.
#[derive(Clone, Debug, PartialEq, Eq, Plain)]
pub struct SensorInfo {
    /// Address on the device.
    pub address: u16,
    /// Serial number, where the device reports one.
    pub serial: Option<String>,
}

/// What one sensor is known to have measured without its record coming in; never reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct Loss {
    /// Address on the device.
    pub address: u16,
    /// Records lost.
    pub lost: u64,
    /// Whether some of them were inferred from time rather than counted by the device.
    pub estimated: bool,
}

/// A device session without IO; see the module's contract.
pub trait Session {
    /// The line opened, closed, or lost bytes.
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent);
    /// Bytes were read at `now`, any number of them.
    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]);
    /// The time asked for by [`Session::poll_timeout`] has come.
    fn handle_timeout(&mut self, now: Timestamp);
    /// The next output, until `None`.
    fn poll_output(&mut self) -> Option<Output>;
    /// When to call [`Session::handle_timeout`].
    fn poll_timeout(&self) -> Option<Timestamp>;
    /// What the session is doing.
    fn state(&self) -> &State;
    /// What it has counted.
    fn counters(&self) -> Counters;
    /// The sensors that stream, in the order of their records; empty until known.
    fn sensors(&self) -> &[SensorInfo];
    /// Nominal measurement rate in Hz, once known.
    fn rate_hz(&self) -> Option<f64>;
    /// Records lost per sensor, in the order of [`Session::sensors`]; empty where a driver cannot know.
    fn losses(&self) -> &[Loss] {
        &[]
    }
}
