//! What all virtual devices have in common: bytes and time in, bytes, truth and losses out.
//!
//! A device knows no port and no clock. Call one of the `handle` functions, then [`Device::poll_output`] until
//! `None`, then [`Device::poll_timeout`]. What its link does to the bytes is the business of [`crate::line`] and
//! [`crate::udp_network`].

use std::fmt;
use std::net::SocketAddr;

use nalgebra::Isometry3;
use posed_drivers::Timestamp;

use crate::faults::{Fault, FaultHit};
use crate::line::{RecordByte, WireByte};
use crate::motion::Body;
use crate::truth::{Loss, TruthCycle};

/// A virtual device; see the module. All times are those of the stage's clock and must not go backwards.
pub trait Device: fmt::Debug + Send {
    /// Bytes of the host arrive: any piece of a stream, or one datagram (in its envelope, where the device has
    /// several peers).
    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]);

    /// The host sets the RTS line (`true` = asserted); does nothing where the device has none.
    fn handle_rts(&mut self, _now: Timestamp, _asserted: bool) {}

    /// Time has passed: does everything that is due at or before `now`.
    fn handle_timeout(&mut self, now: Timestamp);

    /// The next output, until `None`.
    fn poll_output(&mut self) -> Option<DeviceOutput>;

    /// When something happens next; `None`: never, unless bytes arrive.
    fn poll_timeout(&self) -> Option<Timestamp>;
}

/// What a device gives.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceOutput {
    /// Bytes that go onto the wire in one go; over a network one datagram.
    Send(Vec<WireByte>),
    /// A datagram of one of several units that share a server, and that unit's network address.
    SendFrom(SocketAddr, Vec<WireByte>),
    /// A reset at this time: bytes that would leave later never do.
    Cut(Timestamp),
    /// Ground truth of a measurement cycle; it comes for every cycle, whether a record is sent or not.
    Truth(TruthCycle),
    /// A fault of the script has begun, or hit a measurement.
    Fault(FaultHit),
    /// A record that was due and is never sent.
    Lost(Loss),
}

/// A sensor and what it rides on.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Index in the stage's list of sensors.
    pub index: usize,
    /// The body that it rides on.
    pub body: Body,
    /// Index of the segment of that body, as in [`Body::segments`].
    pub segment: usize,
    /// How the sensor sits on the segment: sensor to segment, m.
    pub mount: Isometry3<f64>,
}

impl Sensor {
    /// Sensor to room at `t`.
    pub(crate) fn pose_in_room(&self, t: Timestamp) -> Isometry3<f64> {
        self.pose_in_room_s(t.as_secs_f64())
    }

    /// Sensor to room, `t_s` seconds after the stage's epoch.
    pub(crate) fn pose_in_room_s(&self, t_s: f64) -> Isometry3<f64> {
        let Isometry3 { translation, rotation } = self.mount;
        let skin = self.body.skin(self.segment, &translation.vector, t_s);
        let worn = Isometry3::from_parts(translation, skin * rotation);
        self.body.pose(self.segment, t_s) * (self.body.strap(self.segment, t_s) * worn)
    }
}

/// Measurement cycles on a clock that drifts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    start: Timestamp,
    first: u64,
    /// True duration of a cycle, ns.
    period_ns: f64,
}

impl Pace {
    /// Cycle `first` begins at `start`; the clock runs `drift_ppm` slower than nominal.
    pub(crate) fn new(start: Timestamp, first: u64, nominal_s: f64, drift_ppm: f64) -> Self {
        Self { start, first, period_ns: 1e9 * nominal_s * (1.0 + drift_ppm * 1e-6) }
    }

    /// When a cycle begins.
    pub(crate) fn time(&self, cycle: u64) -> Timestamp {
        let cycles = cycle.saturating_sub(self.first) as f64;
        Timestamp::from_nanos(self.start.as_nanos() + (cycles * self.period_ns).round() as i64)
    }
}

/// Seconds that a clock which runs `drift_ppm` slower than nominal shows between two times.
pub(crate) fn shown_s(from: Timestamp, to: Timestamp, drift_ppm: f64) -> f64 {
    to.seconds_since(from) / (1.0 + drift_ppm * 1e-6)
}

/// The transmitting half of a port, paced at its rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transmitter {
    baud: u32,
    /// When the last byte has left.
    free: Timestamp,
}

impl Transmitter {
    pub(crate) fn new(baud: u32) -> Self {
        Self { baud: baud.max(1), free: Timestamp::ZERO }
    }

    /// Seconds until all bytes have left.
    pub(crate) fn backlog_s(&self, t: Timestamp) -> f64 {
        self.free.seconds_since(t).max(0.0)
    }

    /// Seconds that so many bytes take.
    pub(crate) fn duration_s(&self, bytes: usize) -> f64 {
        10.0 * bytes as f64 / f64::from(self.baud)
    }

    /// What is still to leave never does.
    pub(crate) fn stop(&mut self, t: Timestamp) {
        self.free = self.free.min(t);
    }

    /// Puts an answer on the wire behind what is still leaving.
    pub(crate) fn answer(&mut self, t: Timestamp, bytes: &[u8]) -> Vec<WireByte> {
        self.wire(t, bytes.iter().map(|&byte| (byte, None)))
    }

    /// Puts a record on the wire; `address` is absent where it holds those of all sensors.
    pub(crate) fn record(
        &mut self,
        t: Timestamp,
        bytes: &[u8],
        cycle: u64,
        address: Option<u16>,
    ) -> Vec<WireByte> {
        let frame_len = bytes.len() as u16;
        let tagged = bytes.iter().zip(0..).map(|(&byte, index)| {
            (byte, Some(RecordByte { cycle, address, index, frame_index: index, frame_len }))
        });
        self.wire(t, tagged)
    }

    /// Puts bytes with their places in records on the wire.
    pub(crate) fn wire(
        &mut self,
        t: Timestamp,
        bytes: impl Iterator<Item = (u8, Option<RecordByte>)>,
    ) -> Vec<WireByte> {
        let start = self.free.max(t).as_nanos();
        let bits = |n: usize| (n as i64 * 10_000_000_000) / i64::from(self.baud);
        let wire: Vec<WireByte> = bytes
            .enumerate()
            .map(|(i, (byte, record))| WireByte {
                t: Timestamp::from_nanos(start + bits(i + 1)),
                byte,
                record,
            })
            .collect();
        self.free = Timestamp::from_nanos(start + bits(wire.len()));
        wire
    }
}

/// The moments at which a device's own faults begin, next one first.
pub(crate) fn moments(faults: &[Fault]) -> std::collections::VecDeque<(Timestamp, Fault)> {
    let mut moments = Vec::new();
    for fault in faults.iter().filter(|fault| fault.is_of_the_device()) {
        let (start_s, end_s) = fault.span_s();
        match fault {
            // Power returns with the port.
            Fault::Unplug { power, .. } => {
                if *power && end_s.is_finite() {
                    moments.push((Timestamp::from_secs_f64(end_s), fault.clone()));
                }
            }
            _ => moments.push((Timestamp::from_secs_f64(start_s), fault.clone())),
        }
    }
    moments.sort_by_key(|&(t, _)| t);
    moments.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_clock_has_long_cycles_and_shows_less_time() {
        let start = Timestamp::from_secs_f64(1.0);
        let pace = Pace::new(start, 5, 0.01, 50.0);
        assert_eq!(pace.time(5), start);
        let end = pace.time(100_005);
        assert!((end.seconds_since(start) - 1000.05).abs() < 1e-9);
        assert!((shown_s(start, end, 50.0) - 1000.0).abs() < 1e-6);
    }

    #[test]
    fn bytes_leave_one_after_the_other() {
        let mut transmitter = Transmitter::new(115_200);
        let t = Timestamp::from_secs_f64(2.0);
        let first = transmitter.answer(t, &[1; 1152]);
        assert!((first[1151].t.seconds_since(t) - 0.1).abs() < 1e-6);
        let second = transmitter.record(t, &[2; 2], 7, Some(3));
        assert!((second[0].t.seconds_since(t) - 0.1 - transmitter.duration_s(1)).abs() < 1e-6);
        let record = RecordByte { cycle: 7, address: Some(3), index: 1, frame_index: 1, frame_len: 2 };
        assert_eq!(second[1].record, Some(record));
        transmitter.stop(t);
        assert_eq!(transmitter.backlog_s(t), 0.0);
    }
}
