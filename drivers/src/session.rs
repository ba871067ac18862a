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
    /// Write these bytes to the line, whole and in order; SlimeVR, and open-imu but on a line: one envelope ([`crate::datagram`]).
    Transmit(Vec<u8>),
    /// Set the RTS line (`true` = asserted); comes only on a line with modem lines.
    SetRts(bool),
    /// A measurement of a sensor that the session was asked for, in the order of arrival.
    Sample(Sample),
    /// The state has changed; read it with [`Session::state`]. That a device streams which does not count its cycles comes before
    /// the first sample.
    StateChanged,
    /// Somebody asked on a tracker itself, in the way that it has for this, that headings begin anew.
    HeadingReset {
        /// The sensor that was asked, or the first of several on one tracker.
        address: u16,
    },
    /// The button of a sensor was pressed; what that means is not the driver's affair.
    Pressed {
        /// The sensor.
        address: u16,
    },
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
    /// Records accepted, those included that give no sample (of a sensor that was not asked for, or without a measurement).
    /// A Flock's records that are dropped while birds settle count, too.
    pub records: u64,
    /// Records seen on the line and refused: wrong length or checksum, unknown address, out of order, impossible values. An
    /// estimate where damage swallowed records.
    pub rejected: u64,
    /// Bytes that belong to no accepted record and to no answer, those dropped before the session included, and
    /// those of whole messages, packets and records that were refused for their contents.
    pub bytes_skipped: u64,
}

/// A sensor as its device names it.
#[derive(Clone, Debug, PartialEq, Eq, Plain)]
pub struct SensorInfo {
    /// Address on the device, that of [`Sample::address`].
    pub address: u16,
    /// Serial number, as text; for SlimeVR the tracker's network address (MAC or IP), for open-imu the device's identifier. `None` where the device reports none, or
    /// has not done so yet.
    pub serial: Option<String>,
}

/// A sensor that sends, and that nobody has asked for.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Found {
    /// Its device's identifier, which a stage file may name.
    pub id: String,
    /// Number of the sensor on that device.
    pub sensor: u8,
    /// Name of the device, for people; `None` where it gave none.
    pub name: Option<String>,
    /// Where it sits, in the device's own words.
    pub place: Option<String>,
    /// Samples per second that it claims, Hz.
    pub rate_hz: Option<f64>,
}

/// What one sensor is known to have measured without its record coming in; never reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct Loss {
    /// Address on the device, that of [`Sample::address`].
    pub address: u16,
    /// Records lost: by a counter of the device where it has one, else by order or by time.
    pub lost: u64,
    /// Whether some of them were inferred (from time, from order, from packets of which none says what it held) rather than
    /// counted by the device; gaps in the numbers that a device gives its packets are counted.
    pub estimated: bool,
}

/// What a sensor reports of itself beside what it measures: the newest of each, absent where it has reported none since it was last
/// connected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub struct Condition {
    /// Address on the device, that of [`Sample::address`].
    pub address: u16,
    /// Charge of its battery, 0 to 1.
    pub battery: Option<f64>,
    /// Voltage of its battery, V.
    pub battery_v: Option<f64>,
    /// Strength of its radio signal where it is received, dBm.
    pub signal_dbm: Option<f64>,
    /// Version of its firmware.
    pub firmware: Option<[u8; 3]>,
    /// Whether the receiver on USB through which it is to come knows it.
    pub registered: Option<bool>,
}

impl Condition {
    /// Of a sensor that has reported nothing.
    pub fn unknown(address: u16) -> Self {
        Self { address, ..Self::default() }
    }
}

/// A device session without IO; see the module's contract.
pub trait Session {
    /// The line opened, closed, or lost bytes. `Opened` begins the set-up anew, whatever went before.
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent);
    /// Bytes were read at `now`, any number of them, cut anywhere; SlimeVR, and open-imu but on a line: whole envelopes only ([`crate::datagram`]).
    /// `now` must not lie before that of an earlier call.
    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]);
    /// The time asked for by [`Session::poll_timeout`] has come. A call before that time does nothing.
    fn handle_timeout(&mut self, now: Timestamp);
    /// The next output, in order, until `None`. Outputs that nobody polls pile up.
    fn poll_output(&mut self) -> Option<Output>;
    /// When to call [`Session::handle_timeout`]; `None`: only an input can change anything. It may change with every input.
    fn poll_timeout(&self) -> Option<Timestamp>;
    /// What the session is doing.
    fn state(&self) -> &State;
    /// What it has counted since it was made.
    fn counters(&self) -> Counters;
    /// The sensors that stream, in the order of their records; empty until known. Flock and Xbus list those of the device, asked
    /// for or not; the other drivers, and a Flock that is only listened to, list those asked for, there or not.
    fn sensors(&self) -> &[SensorInfo];
    /// Nominal records per second of each sensor (x-IMU3: inertial ones), once known; nominal means by settings and answers, not
    /// measured. `None` for SlimeVR, whose trackers send on change, for a VRPN server, which does not say, and for a Flock that is only listened to.
    fn rate_hz(&self) -> Option<f64>;
    /// Records lost per sensor, in the order of [`Session::sensors`]; empty where a driver cannot know.
    fn losses(&self) -> &[Loss] {
        &[]
    }
    /// Battery and radio signal per sensor, in the order of [`Session::sensors`]; empty where the devices of a driver report neither.
    fn conditions(&self) -> &[Condition] {
        &[]
    }
    /// Sensors that send and were not asked for, in the order of their coming; they feed nothing. Empty where devices do not come by
    /// themselves.
    fn found(&self) -> &[Found] {
        &[]
    }
}
