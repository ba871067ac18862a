//! Columns of a recording: what follows from its log, as arrays, for readers that have no pipeline.
//!
//! What comes in: payloads with the stamps of their messages, live or in a replay, which give the same columns. What goes out: a [`Block`] every few
//! seconds, which [`Writer::columns`](crate::Writer::columns) puts into the file as messages of the channel [`TOPIC`], and a last one at the end: columns
//! without it are not all there are. What it never does: round otherwise than messages do, or grow with the recording.
//!
//! # Layout
//! A message is a MessagePack map ([`Part`]) whose `of` says which table it goes on with. Tables of numbers are `rows` by `width` whole numbers of 32 bits
//! each, in `values` as `Rows::packed` packs them; -2^31 is what is not known. Every row begins with the seconds and the microseconds of its time, and its time
//! code: second of the day, hundred times the frame and its hundredths, 1 for drop-frame counting. Then
//!
//! | `of` | of each | numbers, each in steps of a unit |
//! |---|---|---|
//! | `sensors` | sensor | state, position (1e5 to the metre), quaternion from sensor to room, scalar first (1e6), sigma (1e6), velocity and angular velocity (1e4) |
//! | | IMU, behind all sensors | 1 where the frame has a record of it, its seconds and microseconds, angular velocity, specific force, magnetic field (1e6); of a frame without one what was there before |
//! | `body` | row | how many rows of bodies the recording had before it |
//! | | angle | degrees (1e3) |
//! | | segment, behind all angles | state, position (1e5), quaternion from segment to room (1e6) |
//!
//! States are numbers of names in `states`. `events` has events as JSON texts, `end` is the last one.

mod rows;

use std::sync::Arc;

use posed_drivers::Timestamp;
use serde::Serialize;

use posed_protocol::{Encoding, Names, Payload, Stamp, View, encode, round};
use posed_stage::input::SensorIndex;
use posed_stage::output::{Body, Estimate, SegmentState, SensorEstimate, SensorState};
use posed_stage::{BodyIndex, Stage};
use rows::{Rows, Table};

/// Channel of the blocks.
pub(super) const TOPIC: &str = "/columns";
/// Longest stretch of a block, µs.
const LONGEST_US: i64 = 10_000_000;
/// Numbers after which a block is full: a mebibyte.
const MOST_NUMBERS: usize = 1 << 18;
/// Bytes of events after which a block is full.
const MOST_EVENT_BYTES: usize = 1 << 20;
/// By their numbers.
const SENSOR_STATES: [SensorState; 7] = [
    SensorState::Ok,
    SensorState::Suspect,
    SensorState::Missing,
    SensorState::Late,
    SensorState::Stuck,
    SensorState::Repaired,
    SensorState::Extrapolated,
];
const SEGMENT_STATES: [SegmentState; 4] =
    [SegmentState::Ok, SegmentState::Inferred, SegmentState::Suspect, SegmentState::Missing];
/// Numbers of an IMU's record: its time, and three vectors.
const RECORD: usize = 11;

/// Gathers the columns of one recording.
#[derive(Clone, Debug)]
pub struct Columns {
    stage: Arc<Named>,
    block: Block,
    /// Of each IMU what its latest record holds.
    latest: Vec<Rows>,
    /// Rows of bodies so far.
    body_rows: u32,
    /// Times of the block's first and latest row, µs.
    span_us: Option<(i64, i64)>,
    body: Vec<u8>,
}

/// What has columns.
#[derive(Debug)]
struct Named {
    names: Names,
    /// Indices of the IMUs among the sensors.
    imus: Vec<SensorIndex>,
}

/// What is written at a time.
#[derive(Clone, Debug)]
pub struct Block {
    stage: Arc<Named>,
    t: Timestamp,
    sensors: Rows,
    /// By their indices.
    bodies: Vec<Rows>,
    events: Vec<String>,
    event_bytes: usize,
    is_last: bool,
}

/// A message of the channel.
#[derive(Serialize)]
#[serde(tag = "of", rename_all = "snake_case")]
enum Part<'a> {
    Sensors {
        names: Vec<&'a str>,
        imus: Vec<&'a str>,
        #[serde(flatten)]
        table: Table<'a, SensorState>,
    },
    Body {
        name: &'a str,
        angles: Vec<String>,
        segments: Vec<&'a str>,
        #[serde(flatten)]
        table: Table<'a, SegmentState>,
    },
    Events {
        messages: &'a [String],
    },
    End,
}

impl Columns {
    /// Begins with the recording.
    pub fn new(stage: &Stage) -> Self {
        let imus = (0..).zip(&stage.sensors).filter(|(_, sensor)| stage.is_imu(sensor));
        let imus: Vec<_> = imus.map(|(index, _)| index).collect();
        let mut none = Rows::default();
        none.each::<RECORD>(1.0, None);
        let latest = vec![none; imus.len()];
        let stage = Arc::new(Named { names: Names::new(stage), imus });
        let block = Block::begun(&stage, Timestamp::ZERO);
        Self { stage, block, latest, body_rows: 0, span_us: None, body: Vec::new() }
    }

    /// Takes up what a message says; gives the block that is full by now.
    pub fn publish(&mut self, payload: &Payload<'_>, stamp: &Stamp) -> Option<Block> {
        match payload {
            Payload::Estimate(estimate) => self.estimate(estimate, stamp),
            Payload::Body(body) => self.body(body, stamp),
            Payload::Outcome(_) => self.event(payload, stamp),
            _ => return None,
        }
        let (first, latest) = self.span_us.unwrap_or((stamp.t_us, stamp.t_us));
        let (first, latest) = (first.min(stamp.t_us), latest.max(stamp.t_us));
        self.span_us = Some((first, latest));
        self.block.t = Timestamp::from_nanos(latest.saturating_mul(1000));
        let is_full = latest - first >= LONGEST_US
            || self.block.numbers() >= MOST_NUMBERS
            || self.block.event_bytes >= MOST_EVENT_BYTES;
        is_full.then(|| self.take())
    }

    /// What is left, as the last block.
    #[must_use]
    pub fn finish(mut self) -> Block {
        Block { is_last: true, ..self.take() }
    }

    fn take(&mut self) -> Block {
        self.span_us = None;
        let next = Block::begun(&self.stage, self.block.t);
        std::mem::replace(&mut self.block, next)
    }

    fn estimate(&mut self, estimate: &Estimate, stamp: &Stamp) {
        let rows = &mut self.block.sensors;
        rows.begin(stamp);
        let none = SensorEstimate::default();
        for place in 0..self.stage.names.sensor_count() {
            let sensor = estimate.sensors.get(place).unwrap_or(&none);
            let pose = sensor.pose.as_ref();
            rows.push(sensor.state as i32);
            rows.each(round::POSITION, pose.and_then(|pose| pose.position_m));
            rows.each(round::QUATERNION, pose.map(|pose| pose.orientation_wxyz));
            rows.each(round::SIGMA, pose.and_then(|pose| pose.sigma_m).map(|sigma_m| [sigma_m]));
            rows.each(round::VELOCITY, pose.and_then(|pose| pose.velocity_m_s));
            rows.each(round::VELOCITY, pose.map(|pose| pose.angular_velocity_rad_s));
        }
        for (imu, latest) in self.stage.imus.iter().zip(&mut self.latest) {
            let measured =
                estimate.sensors.get(usize::from(*imu)).and_then(|sensor| sensor.measured.as_ref());
            let record = measured.and_then(|record| {
                let inertial =
                    record.inertial.filter(|inertial| inertial.angular_velocity_rad_s.is_some())?;
                Some((record.t_valid, inertial))
            });
            if let Some((t_valid, inertial)) = &record {
                *latest = Rows::default();
                latest.time(round::microseconds(*t_valid));
                latest.each(round::QUATERNION, inertial.angular_velocity_rad_s);
                latest.each(round::QUATERNION, inertial.specific_force_m_s2);
                latest.each(round::QUATERNION, inertial.magnetic_field);
            }
            rows.push(i32::from(record.is_some()));
            rows.append(latest);
        }
        rows.end();
    }

    fn body(&mut self, body: &Body, stamp: &Stamp) {
        let Some(layout) = self.stage.names.body(body.index) else { return };
        let Some(rows) = self.block.bodies.get_mut(usize::from(body.index)) else { return };
        rows.begin(stamp);
        rows.push(self.body_rows.cast_signed());
        self.body_rows = self.body_rows.wrapping_add(1);
        for angle in layout.segments.iter().flat_map(|segment| segment.angles.clone()) {
            rows.each(round::DEGREES, body.angles_rad[angle].map(|rad| [rad.to_degrees()]));
        }
        for segment in body.segments.iter().take(layout.segments.len()) {
            rows.push(segment.state as i32);
            rows.each(round::POSITION, segment.position_m);
            rows.each(round::QUATERNION, segment.orientation_wxyz);
        }
        rows.end();
    }

    fn event(&mut self, payload: &Payload<'_>, stamp: &Stamp) {
        self.body.clear();
        encode::body(payload, stamp, &self.stage.names, &View::all(Encoding::Json), &mut self.body);
        let Some((_, rest)) = self.body.split_first() else { return };
        // It is JSON, and so UTF-8. A client's count of messages is not known here.
        let message = format!(r#"{{"type":"{}",{}"#, stamp.topic.name(), String::from_utf8_lossy(rest));
        self.block.event_bytes += message.len();
        self.block.events.push(message);
    }
}

impl Block {
    fn begun(stage: &Arc<Named>, t: Timestamp) -> Self {
        Self {
            t,
            sensors: Rows::default(),
            bodies: stage.names.bodies().map(|_| Rows::default()).collect(),
            events: Vec::new(),
            event_bytes: 0,
            is_last: false,
            stage: Arc::clone(stage),
        }
    }

    /// Time of its latest row, or of the block before where it has none.
    pub(super) fn t(&self) -> Timestamp {
        self.t
    }

    /// Bytes that it keeps in memory, roughly.
    pub fn size(&self) -> usize {
        self.numbers() * size_of::<i32>() + self.event_bytes
    }

    fn numbers(&self) -> usize {
        self.sensors.numbers() + self.bodies.iter().map(Rows::numbers).sum::<usize>()
    }

    /// Gives `write` its messages, one after the other.
    pub(super) fn each_message<E: From<rmp_serde::encode::Error>>(
        &self,
        mut write: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut part = |part: &Part<'_>| write(&rmp_serde::to_vec_named(part)?);
        if let Some(table) = self.sensors.table(&SENSOR_STATES) {
            let Named { names, imus } = &*self.stage;
            part(&Part::Sensors {
                names: names.sensors().map(|(name, _)| name).collect(),
                imus: imus.iter().map(|imu| names.sensor(*imu)).collect(),
                table,
            })?;
        }
        for (index, rows) in (0..).zip(&self.bodies) {
            if let Some(table) = rows.table(&SEGMENT_STATES) {
                part(&self.body(index, table))?;
            }
        }
        if !self.events.is_empty() {
            part(&Part::Events { messages: &self.events })?;
        }
        if self.is_last {
            part(&Part::End)?;
        }
        Ok(())
    }

    fn body<'a>(&'a self, index: BodyIndex, table: Table<'a, SegmentState>) -> Part<'a> {
        let segments = self.stage.names.body(index).map_or(&[][..], |layout| &layout.segments);
        let angles = segments.iter().flat_map(|segment| {
            segment.angles.clone().map(|angle| format!("{}_{}", segment.joint, segment.angle(angle)))
        });
        Part::Body {
            name: self.stage.names.body_name(index),
            angles: angles.collect(),
            segments: segments.iter().map(|segment| &*segment.name).collect(),
            table,
        }
    }
}

#[cfg(test)]
mod tests;
