//! Fault scripts: what goes wrong, when, and the record of what it hit.
//!
//! Faults of the device (a bird that dies, a frozen sensor) act in the device, faults of the line (lost bytes,
//! unplugging) in [`crate::line`], faults of datagrams in [`crate::udp_network`]. Times are seconds of the stage's clock.

use posed_drivers::Timestamp;
use serde::{Deserialize, Serialize};

use crate::random::Random;

/// One line of a fault script.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Fault {
    /// Bytes of records that never arrive.
    LostBytes(Bytes),
    /// Random bytes in front of bytes of records.
    InsertedBytes(Bytes),
    /// Bytes of records with bit 7 flipped.
    Bit7Flips(Bytes),
    /// Bytes of records with one of bits 0 to 6 flipped.
    DataBitFlips(Bytes),
    /// The line delivers only every so many milliseconds, as a USB adapter does.
    Bursts {
        /// From, s.
        start_s: f64,
        /// Until, s.
        end_s: f64,
        /// Time between two deliveries, ms.
        burst_ms: f64,
    },
    /// The port disappears and comes back.
    Unplug {
        /// When, s.
        at_s: f64,
        /// For how long, s; absent: for good.
        duration_s: Option<f64>,
        /// The unit loses power with it and starts anew.
        #[serde(default)]
        power: bool,
    },
    /// The first bytes of the next frame are cut off, anywhere within its first record.
    PhaseCut {
        /// When, s.
        at_s: f64,
    },
    /// The unit does nothing for a while; input waits.
    Stall {
        /// When, s.
        at_s: f64,
        /// For how long, s.
        #[serde(default = "two")]
        duration_s: f64,
    },
    /// The device loses power for a moment and starts anew, with all its units.
    PowerCycle {
        /// When, s.
        at_s: f64,
    },
    /// A bird, tracker or station is gone; when it returns it goes on with its settings.
    BirdDies {
        /// Which.
        address: u16,
        /// When, s.
        at_s: f64,
        /// For how long, s; absent: for good.
        duration_s: Option<f64>,
    },
    /// Positions on the wrong side of the transmitter.
    HemisphereFlip {
        /// Which bird.
        address: u16,
        /// When, s.
        at_s: f64,
        /// For how long, s.
        duration_s: f64,
    },
    /// The sensor is taken out of range: its words repeat, and jump when it returns.
    OutOfRange {
        /// Which bird.
        address: u16,
        /// When, s.
        at_s: f64,
        /// For how long, s.
        duration_s: f64,
    },
    /// Orientations that are no rotation (matrix and quaternion formats).
    BadMatrix {
        /// Which bird.
        address: u16,
        /// When, s.
        at_s: f64,
        /// For how long, s.
        duration_s: f64,
    },
    /// An error code: it waits to be read (Flock), or comes between the data (Xbus, x-IMU3, SlimeVR, MotionStar, VRPN).
    Error {
        /// Which unit notes it.
        address: u16,
        /// When, s.
        at_s: f64,
        /// The code.
        code: u8,
        /// Second byte of the code: for code 13 of a Flock the silent unit's address, on an Xbus the tracker's.
        #[serde(default)]
        detail: u8,
    },
    /// The device's counter, or its clock where it has no counter, begins anew while it goes on measuring.
    CounterRestart {
        /// When, s.
        at_s: f64,
    },
    /// Measurements that the device counts and does not send.
    LostPeriods {
        /// When, s.
        at_s: f64,
        /// How many.
        count: u32,
    },
    /// The device sends something else than it was set to.
    WrongOutput {
        /// When, s.
        at_s: f64,
        /// For how long, s; absent: until it is set up again.
        duration_s: Option<f64>,
    },
    /// A unit reports that its battery is nearly empty.
    LowBattery {
        /// Which unit.
        address: u16,
        /// When, s.
        at_s: f64,
    },
    /// Somebody presses the button of a unit: an x-IMU3's, or the one that resets a SlimeVR tracker's heading.
    Button {
        /// Which unit.
        address: u16,
        /// When, s.
        at_s: f64,
    },
    /// Somebody taps an IMU of an Xbus device twice, within a quarter of a second.
    DoubleTap {
        /// Which unit.
        address: u16,
        /// When, s.
        at_s: f64,
    },
    /// A unit comes from another network address.
    AddressChange {
        /// Which unit.
        address: u16,
        /// When, s.
        at_s: f64,
    },
    /// Datagrams that never arrive.
    LostDatagrams(Bytes),
    /// Datagrams that arrive twice.
    DuplicatedDatagrams(Bytes),
    /// Datagrams that arrive after the one behind them.
    ReorderedDatagrams(Bytes),
    /// Datagrams that wait in the network, and then arrive all at once.
    DelayedDatagrams {
        /// When, s.
        at_s: f64,
        /// For how long, s.
        duration_s: f64,
    },
}

fn two() -> f64 {
    2.0
}

/// A number of damaged bytes, at seeded random times in a span and random places in the frames there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bytes {
    /// How many.
    pub count: u32,
    /// From, s.
    pub start_s: f64,
    /// Until, s.
    pub end_s: f64,
}

impl Fault {
    /// Its word in scripts and logs, as in the key `kind`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::LostBytes(_) => "lost-bytes",
            Self::InsertedBytes(_) => "inserted-bytes",
            Self::Bit7Flips(_) => "bit7-flips",
            Self::DataBitFlips(_) => "data-bit-flips",
            Self::Bursts { .. } => "bursts",
            Self::Unplug { .. } => "unplug",
            Self::PhaseCut { .. } => "phase-cut",
            Self::Stall { .. } => "stall",
            Self::PowerCycle { .. } => "power-cycle",
            Self::BirdDies { .. } => "bird-dies",
            Self::HemisphereFlip { .. } => "hemisphere-flip",
            Self::OutOfRange { .. } => "out-of-range",
            Self::BadMatrix { .. } => "bad-matrix",
            Self::Error { .. } => "error",
            Self::CounterRestart { .. } => "counter-restart",
            Self::LostPeriods { .. } => "lost-periods",
            Self::WrongOutput { .. } => "wrong-output",
            Self::LowBattery { .. } => "low-battery",
            Self::Button { .. } => "button",
            Self::DoubleTap { .. } => "double-tap",
            Self::AddressChange { .. } => "address-change",
            Self::LostDatagrams(_) => "lost-datagrams",
            Self::DuplicatedDatagrams(_) => "duplicated-datagrams",
            Self::ReorderedDatagrams(_) => "reordered-datagrams",
            Self::DelayedDatagrams { .. } => "delayed-datagrams",
        }
    }

    /// When it is over; after thirty years where it lasts for good.
    pub fn until(&self) -> Timestamp {
        let (_, end_s) = self.span_s();
        Timestamp::from_secs_f64(end_s.min(1e9))
    }

    /// From when to when it lasts, s of the stage's clock; a single moment where both are equal, infinite where it lasts for
    /// good.
    pub fn span_s(&self) -> (f64, f64) {
        match *self {
            Self::LostBytes(bytes)
            | Self::InsertedBytes(bytes)
            | Self::Bit7Flips(bytes)
            | Self::DataBitFlips(bytes)
            | Self::LostDatagrams(bytes)
            | Self::DuplicatedDatagrams(bytes)
            | Self::ReorderedDatagrams(bytes) => (bytes.start_s, bytes.end_s),
            Self::Bursts { start_s, end_s, .. } => (start_s, end_s),
            Self::PhaseCut { at_s }
            | Self::PowerCycle { at_s }
            | Self::Error { at_s, .. }
            | Self::CounterRestart { at_s }
            | Self::LostPeriods { at_s, .. }
            | Self::LowBattery { at_s, .. }
            | Self::Button { at_s, .. }
            | Self::DoubleTap { at_s, .. }
            | Self::AddressChange { at_s, .. } => (at_s, at_s),
            Self::Unplug { at_s, duration_s, .. }
            | Self::BirdDies { at_s, duration_s, .. }
            | Self::WrongOutput { at_s, duration_s } => {
                (at_s, duration_s.map_or(f64::INFINITY, |d| at_s + d))
            }
            Self::Stall { at_s, duration_s }
            | Self::DelayedDatagrams { at_s, duration_s }
            | Self::HemisphereFlip { at_s, duration_s, .. }
            | Self::OutOfRange { at_s, duration_s, .. }
            | Self::BadMatrix { at_s, duration_s, .. } => (at_s, at_s + duration_s),
        }
    }

    /// Whether it names no end.
    pub(crate) fn is_for_good(&self) -> bool {
        matches!(
            self,
            Self::Unplug { duration_s: None, .. }
                | Self::BirdDies { duration_s: None, .. }
                | Self::WrongOutput { duration_s: None, .. }
        )
    }

    /// Address of the unit or sensor that it is about; `None` for faults of the link and of the whole device.
    pub fn address(&self) -> Option<u16> {
        match *self {
            Self::BirdDies { address, .. }
            | Self::HemisphereFlip { address, .. }
            | Self::OutOfRange { address, .. }
            | Self::BadMatrix { address, .. }
            | Self::Error { address, .. }
            | Self::LowBattery { address, .. }
            | Self::Button { address, .. }
            | Self::DoubleTap { address, .. }
            | Self::AddressChange { address, .. } => Some(address),
            _ => None,
        }
    }

    /// Whether the device itself has to do something when it begins.
    pub(crate) fn is_of_the_device(&self) -> bool {
        matches!(
            self,
            Self::Stall { .. }
                | Self::Error { .. }
                | Self::PowerCycle { .. }
                | Self::BirdDies { .. }
                | Self::Unplug { .. }
                | Self::CounterRestart { .. }
                | Self::LostPeriods { .. }
                | Self::WrongOutput { .. }
                | Self::LowBattery { .. }
                | Self::Button { .. }
                | Self::DoubleTap { .. }
                | Self::AddressChange { .. }
        )
    }

    /// Whether it lasts at `t` (its end excluded).
    pub(crate) fn is_active(&self, t: Timestamp) -> bool {
        let (start_s, end_s) = self.span_s();
        let t_s = t.as_secs_f64();
        start_s <= t_s && t_s < end_s
    }
}

/// What a fault of the script hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultHit {
    /// When, on the stage's clock.
    pub t: Timestamp,
    /// The fault, by [`Fault::name`].
    pub fault: &'static str,
    /// The sensor whose record or unit was hit; absent where it was none or all of them.
    pub address: Option<u16>,
    /// Measurement cycle of the record or measurement that was hit; absent where it was none.
    pub cycle: Option<u64>,
    /// Which byte of the record, from 0; absent where it was no single byte.
    pub byte: Option<u16>,
}

/// How a byte is damaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Damage {
    Lose,
    Insert,
    FlipBit7,
    FlipData,
}

/// The damaged bytes of a script, in the order of their times.
pub(crate) fn damage_schedule(
    faults: &[Fault],
    random: &mut Random,
) -> Vec<(Timestamp, Damage, &'static str)> {
    let mut schedule = Vec::new();
    for fault in faults {
        let (bytes, damage) = match *fault {
            Fault::LostBytes(bytes) => (bytes, Damage::Lose),
            Fault::InsertedBytes(bytes) => (bytes, Damage::Insert),
            Fault::Bit7Flips(bytes) => (bytes, Damage::FlipBit7),
            Fault::DataBitFlips(bytes) => (bytes, Damage::FlipData),
            _ => continue,
        };
        for _ in 0..bytes.count {
            let t_s = bytes.start_s + random.uniform() * (bytes.end_s - bytes.start_s);
            schedule.push((Timestamp::from_secs_f64(t_s), damage, fault.name()));
        }
    }
    schedule.sort_by_key(|&(t, ..)| t);
    schedule
}

#[cfg(test)]
mod tests;
