//! Decodes a capture made elsewhere: the raw bytes of a device, or a vendor's `.mtb` log.
//!
//! What comes in: the bytes of a file. What goes out: one [`Record`] per message, one per tracker for the
//! messages of an Xbus Master, and a [`Summary`]. A legacy data message can be decoded only after the
//! configuration message that describes it; before that, its bytes are passed on undecoded.

use std::collections::BTreeMap;

use serde::Serialize;

use super::counter::{PacketCounter, SAMPLE_TIME_TICK_S, SampleTime, Step};
use super::frame::{Frame, Framer};
use super::message::{self, Configuration};
use super::mtdata::{self, Block};
use super::mtdata2::{self, Axes, GnssPvt, Value};
use super::number::be16;
use crate::rate::Rate;

/// A message, or one tracker's part of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Record {
    /// Bus identifier as sent (255 the master or a stand-alone device); that of the tracker for its part of a chain's message.
    pub bid: u8,
    /// Message identifier, see [`message`].
    pub mid: u8,
    /// What a data message holds; empty for others.
    pub items: Items,
    /// Bytes of a message that was not decoded, in hexadecimal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data: Option<String>,
    /// The device's time in seconds, from its sample time, else from its counter and period; `None`
    /// where it tells neither, or a period that cannot be.
    #[serde(skip)]
    pub t_s: Option<f64>,
}

impl Record {
    /// Number of the tracker whose data this is, a stand-alone one's is 1; `None` for messages without data, and for data that
    /// could not be decoded.
    pub fn tracker(&self) -> Option<u16> {
        let is_data = matches!(self.mid, message::MTDATA | message::MTDATA2) && self.data.is_none();
        is_data.then_some(if self.bid == message::MASTER { 1 } else { self.bid.into() })
    }
}

/// What a data message holds, each under its name; numbers as sent, in 64 bits; `None`: not in this message.
///
/// Units and axes are those of [`Value`]: acceleration m/s², rate of turn rad/s, time fine 0.1 ms, time coarse s, velocity m/s.
/// The counters are as sent, with their wraps. Nothing is checked to be possible, or normalised.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the names and units are those of the values of mtdata2")]
pub struct Items {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub packet_counter: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_time_fine: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_time_coarse: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub utc: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub utc_flags: Option<u8>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub status_byte: Option<u8>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub status_word: Option<u32>,
    /// w, x, y, z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Row by row, sensor to the frame of `axes`; of a legacy message as sent, see [`mtdata::Orientation::Matrix`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_matrix: Option<[f64; 9]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub euler_deg: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free_acceleration: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delta_v: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_of_turn: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delta_q: Option<[f64; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub magnetic_field: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pressure_pa: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lat_lon_deg: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ecef_m: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gnss_pvt: Option<GnssPvt>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gnss_sat: Option<GnssSat>,
    /// Axes of orientation, free acceleration and velocity, where they are not east-north-up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<Axes>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub other: Vec<Other>,
}

/// Satellites in view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GnssSat {
    /// Time of week, ms.
    pub itow_ms: u32,
    /// Each of them, in the order of the receiver.
    pub satellites: Vec<Satellite>,
}

/// A satellite in view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Satellite {
    /// System: 0 GPS, 1 SBAS, 2 Galileo, 3 BeiDou, 5 QZSS, 6 GLONASS.
    pub gnss_id: u8,
    /// Number within the system.
    pub sv_id: u8,
    /// Carrier to noise ratio, dBHz.
    pub cno_dbhz: u8,
    /// Quality, use and health, as sent.
    pub flags: u8,
}

/// An item that has no field of its own in [`Items`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Other {
    /// Identifier, four hexadecimal digits; empty for parts of a legacy message.
    pub id: String,
    /// Its name, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<&'static str>,
    /// Its numbers, where they are known and an `f64` holds them; else empty.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<f64>,
    /// Its bytes, hexadecimal.
    pub data: String,
}

/// Counts over a capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Records given out, those of messages without data included.
    pub records: u64,
    /// Bytes of no message.
    pub bytes_skipped: u64,
    /// Candidates refused for their checksum or their impossible contents.
    pub bad_checksums: u64,
    /// Data messages missing between those that came, by the counters of the devices; of messages without a counter none is
    /// missed.
    pub packets_lost: u64,
}

/// Decodes a capture piece by piece; what comes out does not depend on the pieces. Every message has a right checksum, of one
/// byte: a false match is possible.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    framer: Framer,
    configuration: Option<Configuration>,
    /// By bus identifier: its counter and its time.
    clocks: BTreeMap<u8, (PacketCounter, SampleTime)>,
    summary: Summary,
}

impl Decoder {
    /// A decoder before the first byte.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes more bytes and gives out the records that they complete, in order.
    pub fn push(&mut self, bytes: &[u8], mut emit: impl FnMut(Record)) {
        let mut framer = std::mem::take(&mut self.framer);
        framer.push(bytes);
        while let Some(found) = framer.find() {
            self.message(framer.frame(found), &mut emit);
        }
        self.framer = framer;
    }

    /// Ends the capture and returns its counts; what is pending counts as skipped.
    pub fn finish(mut self) -> Summary {
        self.framer.interrupt();
        self.summary()
    }

    fn message(&mut self, frame: Frame<'_>, emit: &mut impl FnMut(Record)) {
        match frame.mid {
            message::MTDATA2 => {
                let items = from_items(frame.data);
                let t_s = self.note_time(frame.bid, items.packet_counter, items.sample_time_fine, None);
                self.emit(Record { bid: frame.bid, mid: frame.mid, items, data: None, t_s }, emit);
            }
            message::MTDATA if self.legacy(frame, emit) => {}
            _ => {
                if frame.mid == message::CONFIGURATION {
                    self.configuration = Configuration::parse(frame.data);
                }
                let data = (!frame.data.is_empty()).then(|| hex(frame.data));
                let items = Items::default();
                self.emit(Record { bid: frame.bid, mid: frame.mid, items, data, t_s: None }, emit);
            }
        }
    }

    fn emit(&mut self, record: Record, emit: &mut impl FnMut(Record)) {
        self.summary.records += 1;
        emit(record);
    }

    /// Decodes a legacy data message; false when the configuration does not describe it.
    fn legacy(&mut self, frame: Frame<'_>, emit: &mut impl FnMut(Record)) -> bool {
        let Some(configuration) = self.configuration.take() else { return false };
        let period_s = configuration.rate().ok().map(Rate::period_s);
        let blocks = legacy_blocks(&configuration, frame.data);
        self.configuration = Some(configuration);
        let Some((counter, blocks)) = blocks else { return false };
        let counter = counter.map(u64::from);
        let t_s = self.note_time(message::MASTER, counter, None, period_s);
        for (bid, block) in blocks {
            let mut items = from_block(&block);
            items.packet_counter = counter;
            self.emit(Record { bid, mid: frame.mid, items, data: None, t_s }, emit);
        }
        true
    }

    /// Follows the counters of a device, counts what they leave out, and tells its time in seconds.
    fn note_time(
        &mut self,
        bid: u8,
        packet: Option<u64>,
        time: Option<u64>,
        period_s: Option<f64>,
    ) -> Option<f64> {
        let (packets, times) = self.clocks.entry(bid).or_default();
        if let Some(packet) = packet
            && let Step::Forward(step) = packets.step(packet as u16)
        {
            self.summary.packets_lost += step.saturating_sub(1);
        }
        match (time, packet, period_s) {
            (Some(time), ..) => {
                times.step(time as u32);
                Some(times.unwrapped() as f64 * SAMPLE_TIME_TICK_S)
            }
            (None, Some(_), Some(period_s)) => Some(packets.unwrapped() as f64 * period_s),
            _ => None,
        }
    }

    /// Counts so far; bytes still pending are not among them.
    pub fn summary(&self) -> Summary {
        Summary {
            bytes_skipped: self.framer.bytes_skipped(),
            bad_checksums: self.framer.bad_checksums(),
            ..self.summary
        }
    }
}

/// Decodes a whole capture: gives its records to `emit`, in order, and returns the counts. Any bytes will do.
pub fn decode(bytes: &[u8], emit: impl FnMut(Record)) -> Summary {
    let mut decoder = Decoder::new();
    decoder.push(bytes, emit);
    decoder.finish()
}

type Blocks = (Option<u16>, Vec<(u8, Block)>);

/// The sample counter and each tracker's block; `None` when they do not fill the message.
fn legacy_blocks(configuration: &Configuration, data: &[u8]) -> Option<Blocks> {
    if !configuration.is_chain() {
        let layout = configuration.trackers.first()?.layout;
        layout.check().ok()?;
        let (block, counter) = data.split_at_checked(layout.block_len())?;
        if counter.len() != if layout.has_counter() { 2 } else { 0 } {
            return None;
        }
        return Some((be16(counter, 0), vec![(message::MASTER, layout.decode(block)?)]));
    }
    let mut rest = data.get(2..)?;
    let mut blocks = Vec::new();
    for (bid, tracker) in (1..).zip(&configuration.trackers) {
        tracker.layout.check().ok()?;
        let (block, after) = rest.split_at_checked(tracker.layout.block_len())?;
        // A tracker whose time stamp was left on repeats the counter behind its block.
        rest = if tracker.layout.has_counter() { after.get(2..)? } else { after };
        blocks.push((bid, tracker.layout.decode(block)?));
    }
    rest.is_empty().then_some((be16(data, 0), blocks))
}

fn from_items(data: &[u8]) -> Items {
    let mut items = Items::default();
    for item in mtdata2::items(data) {
        match item.value {
            Value::Temperature(value) => set(&mut items.temperature_c, value),
            Value::Utc(utc) => {
                items.utc_flags = Some(utc.flags);
                set(&mut items.utc, utc.to_string())
            }
            Value::PacketCounter(value) => set(&mut items.packet_counter, value.into()),
            Value::SampleTimeFine(value) => set(&mut items.sample_time_fine, value.into()),
            Value::SampleTimeCoarse(value) => set(&mut items.sample_time_coarse, value.into()),
            Value::Quaternion(value) => set(&mut items.quaternion, value),
            Value::RotationMatrix(rows) => {
                let mut flat = [0.0; 9];
                flat.copy_from_slice(rows.as_flattened());
                set(&mut items.rotation_matrix, flat)
            }
            Value::EulerDeg(value) => set(&mut items.euler_deg, value),
            Value::Pressure(value) => set(&mut items.pressure_pa, value),
            Value::DeltaV(value) => set(&mut items.delta_v, value),
            Value::Acceleration(value) => set(&mut items.acceleration, value),
            Value::FreeAcceleration(value) => set(&mut items.free_acceleration, value),
            Value::Altitude(value) => set(&mut items.altitude_m, value),
            Value::Ecef(value) => set(&mut items.ecef_m, value),
            Value::LatLon(value) => set(&mut items.lat_lon_deg, value),
            Value::GnssPvt(value) => set(&mut items.gnss_pvt, value),
            Value::GnssSat(value) => {
                let satellites = value
                    .satellites()
                    .map(|[gnss_id, sv_id, cno_dbhz, flags]| Satellite { gnss_id, sv_id, cno_dbhz, flags })
                    .collect();
                set(&mut items.gnss_sat, GnssSat { itow_ms: value.itow_ms, satellites })
            }
            Value::RateOfTurn(value) => set(&mut items.rate_of_turn, value),
            Value::DeltaQ(value) => set(&mut items.delta_q, value),
            Value::MagneticField(value) => set(&mut items.magnetic_field, value),
            Value::Velocity(value) => set(&mut items.velocity, value),
            Value::StatusByte(value) => set(&mut items.status_byte, value),
            Value::StatusWord(value) => set(&mut items.status_word, value),
            Value::AccelerationHighRate(value) => other(&mut items, &item, "acceleration_high_rate", &value),
            Value::RateOfTurnHighRate(value) => other(&mut items, &item, "rate_of_turn_high_rate", &value),
            Value::FrameRange(first, last) => {
                other(&mut items, &item, "frame_range", &[first.into(), last.into()])
            }
            Value::PacketCounter8(value) => other(&mut items, &item, "packet_counter_8", &[value.into()]),
            Value::FrameCounter(value) => other(&mut items, &item, "frame_counter", &[value.into()]),
            Value::LocationId(value) => other(&mut items, &item, "location_id", &[value.into()]),
            Value::Raw(words) => other(&mut items, &item, "raw", &words.map(f64::from)),
            // Numbers that an f64 might not hold: their bytes say it all.
            Value::SampleTime64(_) => other(&mut items, &item, "sample_time_64", &[]),
            Value::DeviceId(_) => other(&mut items, &item, "device_id", &[]),
            Value::Other => {
                let id = format!("{:04X}", item.id);
                items.other.push(Other { id, name: None, values: vec![], data: hex(item.data) });
            }
        }
        let axes = mtdata2::axes(item.id);
        if mtdata2::has_axes(item.id) && axes != Axes::Enu {
            items.axes = Some(axes);
        }
    }
    items
}

fn set<T>(field: &mut Option<T>, value: T) {
    *field = Some(value);
}

fn other(items: &mut Items, item: &mtdata2::Item<'_>, name: &'static str, values: &[f64]) {
    let id = format!("{:04X}", item.id);
    items.other.push(Other { id, name: Some(name), values: values.to_vec(), data: hex(item.data) });
}

fn from_block(block: &Block) -> Items {
    let mut items = Items {
        temperature_c: block.temperature_c,
        acceleration: block.acceleration,
        rate_of_turn: block.rate_of_turn,
        magnetic_field: block.magnetic_field,
        lat_lon_deg: block.position.map(|[lat, lon, _]| [lat, lon]),
        altitude_m: block.position.map(|[_, _, altitude]| altitude),
        velocity: block.velocity,
        status_byte: block.status,
        ..Items::default()
    };
    match block.orientation {
        Some(mtdata::Orientation::Quaternion(q)) => items.quaternion = Some(q),
        Some(mtdata::Orientation::EulerDeg(angles)) => items.euler_deg = Some(angles),
        Some(mtdata::Orientation::Matrix([a, b, c])) => {
            items.rotation_matrix = Some([a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]);
        }
        None => {}
    }
    let mut words = |name, values: &[u16]| {
        let data = values.iter().map(|word| format!("{word:04X}")).collect();
        let values = values.iter().copied().map(f64::from).collect();
        items.other.push(Other { id: String::new(), name: Some(name), values, data });
    };
    if let Some(raw) = block.raw {
        words("raw", &raw);
    }
    for (name, value) in ["auxiliary_1", "auxiliary_2"].into_iter().zip(block.auxiliary) {
        if let Some(value) = value {
            words(name, &[value]);
        }
    }
    items
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}
