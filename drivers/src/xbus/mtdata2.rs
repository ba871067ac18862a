//! MTData2 (0x36): the data message of newer trackers, a list of items.
//!
//! An item is an identifier, a size and so many bytes. Items without a new value are left out, so that
//! messages in a row differ. An item that is not known, or has not the size that its identifier asks
//! for, is [`Value::Other`].

use serde::Serialize;

use super::message::device_id;
use super::number::{Number, be16};
pub use super::orientation::Axes;

/// Identifier without its number format and axes.
const KIND: u16 = 0xFFF0;

/// Identifiers, number format (bits 1 and 0) and axes (bits 3 and 2) zero. Units and meaning: [`Value`], under the same names.
pub mod id {
    #![expect(missing_docs, reason = "the names of the values")]
    pub const TEMPERATURE: u16 = 0x0810;
    pub const UTC: u16 = 0x1010;
    pub const PACKET_COUNTER: u16 = 0x1020;
    pub const SAMPLE_TIME_FINE: u16 = 0x1060;
    pub const SAMPLE_TIME_COARSE: u16 = 0x1070;
    pub const FRAME_RANGE: u16 = 0x1080;
    pub const PACKET_COUNTER_8: u16 = 0x1090;
    pub const SAMPLE_TIME_64: u16 = 0x10A0;
    pub const FRAME_COUNTER: u16 = 0x10B0;
    pub const QUATERNION: u16 = 0x2010;
    pub const ROTATION_MATRIX: u16 = 0x2020;
    pub const EULER: u16 = 0x2030;
    pub const PRESSURE: u16 = 0x3010;
    pub const DELTA_V: u16 = 0x4010;
    pub const ACCELERATION: u16 = 0x4020;
    pub const FREE_ACCELERATION: u16 = 0x4030;
    pub const ACCELERATION_HIGH_RATE: u16 = 0x4040;
    pub const ALTITUDE: u16 = 0x5020;
    pub const ECEF: u16 = 0x5030;
    pub const LAT_LON: u16 = 0x5040;
    pub const GNSS_PVT: u16 = 0x7010;
    pub const GNSS_SAT: u16 = 0x7020;
    pub const RATE_OF_TURN: u16 = 0x8020;
    pub const DELTA_Q: u16 = 0x8030;
    pub const RATE_OF_TURN_HIGH_RATE: u16 = 0x8040;
    pub const RAW: u16 = 0xA010;
    pub const MAGNETIC_FIELD: u16 = 0xC020;
    pub const VELOCITY: u16 = 0xD010;
    pub const STATUS_BYTE: u16 = 0xE010;
    pub const STATUS_WORD: u16 = 0xE020;
    pub const DEVICE_ID: u16 = 0xE080;
    pub const LOCATION_ID: u16 = 0xE090;
}

/// An item of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Item<'a> {
    /// Identifier as sent, number format and axes included.
    pub id: u16,
    /// What it says; [`Value::Other`] where that is not known.
    pub value: Value<'a>,
    /// Its bytes, without identifier and size; at most 255.
    pub data: &'a [u8],
}

/// What an item says. Numbers are in the units of the wire, and exact; vectors in sensor axes, where nothing else is said. None
/// is checked to be possible: floats may be NaN, quaternions of another norm than 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// Degrees Celsius.
    Temperature(f64),
    /// Universal time.
    Utc(Utc),
    /// One step per message; wraps after 65535 ([`super::counter::PacketCounter`]).
    PacketCounter(u16),
    /// Ticks of 0.1 ms; wraps after a day or after 2^32 ([`super::counter::SampleTime`]).
    SampleTimeFine(u32),
    /// Seconds.
    SampleTimeCoarse(u32),
    /// First and last frame.
    FrameRange(u16, u16),
    /// One step per message; wraps after 255.
    PacketCounter8(u8),
    /// Ticks.
    SampleTime64(u64),
    /// One step per frame.
    FrameCounter(u32),
    /// w, x, y, z; sensor to [`axes`].
    Quaternion([f64; 4]),
    /// Rows of the matrix, sensor to [`axes`] (it travels column by column).
    RotationMatrix([[f64; 3]; 3]),
    /// Roll, pitch, yaw in degrees: rotations about z, then y, then x; sensor to [`axes`].
    EulerDeg([f64; 3]),
    /// Pa.
    Pressure(u32),
    /// Change of velocity over the last output period, m/s.
    DeltaV([f64; 3]),
    /// m/s², gravity included (+g upwards at rest).
    Acceleration([f64; 3]),
    /// m/s² in [`axes`], gravity taken out.
    FreeAcceleration([f64; 3]),
    /// m/s², gravity included, before the filter.
    AccelerationHighRate([f64; 3]),
    /// m above the ellipsoid.
    Altitude(f64),
    /// Position in the axes fixed to the Earth (centre, equator, pole), m.
    Ecef([f64; 3]),
    /// Latitude, longitude, degrees.
    LatLon([f64; 2]),
    /// Satellite position, velocity and time.
    GnssPvt(GnssPvt),
    /// Satellites in view.
    GnssSat(GnssSat<'a>),
    /// Angular velocity, rad/s.
    RateOfTurn([f64; 3]),
    /// Rotation over the last output period, w, x, y, z.
    DeltaQ([f64; 4]),
    /// rad/s, before the filter.
    RateOfTurnHighRate([f64; 3]),
    /// Acceleration, rate of turn, magnetic field (3 words each) and temperature as converted, unscaled.
    Raw([u16; 10]),
    /// In units of the field's strength at the place of calibration (so about 1).
    MagneticField([f64; 3]),
    /// m/s in [`axes`].
    Velocity([f64; 3]),
    /// Flags.
    StatusByte(u8),
    /// Flags: bit 0 self-test passed, 1 filter valid, 2 satellite fix, 8 to 16 a range exceeded (accelerometer, gyro,
    /// magnetometer; x, y, z each), 19 any of these.
    StatusWord(u32),
    /// Device identifier.
    DeviceId(u64),
    /// Number that the user gave to the device.
    LocationId(u16),
    /// An identifier that is not known, or another size than it asks for.
    Other,
}

/// Axes named by an identifier (bits 3 and 2); meant for what [`has_axes`].
pub fn axes(id: u16) -> Axes {
    match id & 0x000C {
        0x4 => Axes::Ned,
        0x8 => Axes::Nwu,
        _ => Axes::Enu,
    }
}

/// Whether the value of an identifier is expressed in [`axes`]: orientation, free acceleration, velocity.
pub fn has_axes(id: u16) -> bool {
    matches!(
        id & KIND,
        id::QUATERNION | id::ROTATION_MATRIX | id::EULER | id::FREE_ACCELERATION | id::VELOCITY
    )
}

/// Universal time as the device reports it; whether it is one is not checked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Utc {
    /// Nanoseconds of the second.
    pub nanos: u32,
    /// Year.
    pub year: u16,
    /// Month, day, hour, minute, second.
    pub fields: [u8; 5],
    /// Which parts are valid.
    pub flags: u8,
}

impl std::fmt::Display for Utc {
    /// RFC 3339, with as many decimals as the time has.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [month, day, hour, minute, second] = self.fields;
        write!(f, "{:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}", self.year)?;
        if self.nanos != 0 {
            write!(f, ".{}", format!("{:09}", self.nanos).trim_end_matches('0'))?;
        }
        f.write_str("Z")
    }
}

/// Declares the fields of a record that follow each other on the wire, big-endian.
macro_rules! wire_record {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
        pub struct $name { $($(#[$doc])* pub $field: $type,)* }

        impl $name {
            /// Bytes of the record on the wire.
            pub const LEN: usize = 0 $(+ size_of::<$type>())*;

            /// Reads the record, big-endian; `None` unless it fills `data`. Values are not checked.
            pub fn parse(data: &[u8]) -> Option<Self> {
                if data.len() != Self::LEN {
                    return None;
                }
                let mut rest = data;
                $(
                    let (bytes, after) = rest.split_first_chunk()?;
                    let $field = <$type>::from_be_bytes(*bytes);
                    rest = after;
                )*
                debug_assert!(rest.is_empty());
                Some(Self { $($field),* })
            }

            /// Appends the record as it travels, [`Self::LEN`] bytes.
            pub fn encode(&self, out: &mut Vec<u8>) {
                $(out.extend(self.$field.to_be_bytes());)*
            }
        }
    };
}

wire_record! {
    /// Satellite position, velocity and time. Integers as sent, each with the unit of the wire in its name (`e7`: 1e-7). The
    /// receiver's own estimate: look at `fix_type`, `valid` and the accuracies before any use. Velocity is north, east, down.
    GnssPvt {
        /// Time of week.
        itow_ms: u32,
        /// Year.
        year: u16,
        /// Month.
        month: u8,
        /// Day.
        day: u8,
        /// Hour.
        hour: u8,
        /// Minute.
        min: u8,
        /// Second.
        sec: u8,
        /// Which parts of date and time are valid.
        valid: u8,
        /// Accuracy of the time.
        tacc_ns: u32,
        /// Nanoseconds of the second, may be negative.
        nano_ns: i32,
        /// 0 none, 2 plane, 3 space.
        fix_type: u8,
        /// Flags of the fix.
        flags: u8,
        /// Satellites in use.
        num_sv: u8,
        /// Reserved.
        reserved1: u8,
        /// Longitude, 1e-7 degrees.
        lon_deg_e7: i32,
        /// Latitude, 1e-7 degrees.
        lat_deg_e7: i32,
        /// Height above the ellipsoid.
        height_mm: i32,
        /// Height above mean sea level.
        hmsl_mm: i32,
        /// Horizontal accuracy.
        hacc_mm: u32,
        /// Vertical accuracy.
        vacc_mm: u32,
        /// Velocity north.
        vel_n_mm_s: i32,
        /// Velocity east.
        vel_e_mm_s: i32,
        /// Velocity down.
        vel_d_mm_s: i32,
        /// Speed over ground.
        gspeed_mm_s: i32,
        /// Heading of motion, 1e-5 degrees.
        head_mot_deg_e5: i32,
        /// Accuracy of the speed.
        sacc_mm_s: u32,
        /// Accuracy of the heading, 1e-5 degrees.
        head_acc_deg_e5: u32,
        /// Heading of the vehicle, 1e-5 degrees.
        head_veh_deg_e5: i32,
        /// Dilution of precision, 0.01 in this and the next six: geometry.
        gdop_e2: u16,
        /// Position.
        pdop_e2: u16,
        /// Time.
        tdop_e2: u16,
        /// Vertical.
        vdop_e2: u16,
        /// Horizontal.
        hdop_e2: u16,
        /// North.
        ndop_e2: u16,
        /// East.
        edop_e2: u16,
    }
}

/// Satellites in view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GnssSat<'a> {
    /// Time of week, ms.
    pub itow_ms: u32,
    satellites: &'a [[u8; 4]],
}

impl GnssSat<'_> {
    fn parse(data: &[u8]) -> Option<GnssSat<'_>> {
        let (head, rest) = data.split_first_chunk::<8>()?;
        let (satellites, []) = rest.as_chunks::<4>() else { return None };
        let [t3, t2, t1, t0, count, ..] = *head;
        (usize::from(count) == satellites.len())
            .then_some(GnssSat { itow_ms: u32::from_be_bytes([t3, t2, t1, t0]), satellites })
    }

    /// System, satellite, carrier to noise ratio (dBHz) and flags of each, in the order of the receiver.
    pub fn satellites(&self) -> impl Iterator<Item = [u8; 4]> + '_ {
        self.satellites.iter().copied()
    }
}

/// Whether items, known or not, fill `data` exactly; false for no data. A message without it is damaged.
pub fn fills(data: &[u8]) -> bool {
    let mut rest = data;
    while let [_, _, size, after @ ..] = rest {
        match after.get(usize::from(*size)..) {
            Some(next) => rest = next,
            None => return false,
        }
    }
    rest.is_empty() && !data.is_empty()
}

/// The items of a message, in order. Bytes at the end that are no item are left out: see [`fills`].
pub fn items(data: &[u8]) -> impl Iterator<Item = Item<'_>> {
    let mut rest = data;
    std::iter::from_fn(move || {
        let (&[hi, lo, size], after) = rest.split_first_chunk()?;
        let (data, after) = after.split_at_checked(size.into())?;
        rest = after;
        let id = u16::from_be_bytes([hi, lo]);
        Some(Item { id, value: decode(id, data).unwrap_or(Value::Other), data })
    })
}

fn decode(id: u16, data: &[u8]) -> Option<Value<'_>> {
    let number = Number::from_code(id);
    let scalar = || number.decode_array(data).map(|[value]: [f64; 1]| value);
    let triple = || number.decode_array::<3>(data);
    let quaternion = || number.decode_array::<4>(data);
    let be32 = || data.try_into().ok().map(u32::from_be_bytes);
    let word = || if data.len() == 2 { be16(data, 0) } else { None };
    let byte = || if let [byte] = data { Some(*byte) } else { None };
    Some(match id & KIND {
        id::TEMPERATURE => Value::Temperature(scalar()?),
        id::UTC => {
            let &[n3, n2, n1, n0, y1, y0, month, day, hour, minute, second, flags] = data else {
                return None;
            };
            Value::Utc(Utc {
                nanos: u32::from_be_bytes([n3, n2, n1, n0]),
                year: u16::from_be_bytes([y1, y0]),
                fields: [month, day, hour, minute, second],
                flags,
            })
        }
        id::PACKET_COUNTER => Value::PacketCounter(word()?),
        id::SAMPLE_TIME_FINE => Value::SampleTimeFine(be32()?),
        id::SAMPLE_TIME_COARSE => Value::SampleTimeCoarse(be32()?),
        id::FRAME_RANGE if data.len() == 4 => Value::FrameRange(be16(data, 0)?, be16(data, 2)?),
        id::PACKET_COUNTER_8 => Value::PacketCounter8(byte()?),
        id::SAMPLE_TIME_64 => Value::SampleTime64(data.try_into().ok().map(u64::from_be_bytes)?),
        id::FRAME_COUNTER => Value::FrameCounter(be32()?),
        id::QUATERNION => Value::Quaternion(quaternion()?),
        id::ROTATION_MATRIX => {
            let [a, b, c, d, e, f, g, h, i] = number.decode_array(data)?;
            Value::RotationMatrix([[a, d, g], [b, e, h], [c, f, i]])
        }
        id::EULER => Value::EulerDeg(triple()?),
        id::PRESSURE => Value::Pressure(be32()?),
        id::DELTA_V => Value::DeltaV(triple()?),
        id::ACCELERATION => Value::Acceleration(triple()?),
        id::FREE_ACCELERATION => Value::FreeAcceleration(triple()?),
        id::ACCELERATION_HIGH_RATE => Value::AccelerationHighRate(triple()?),
        id::ALTITUDE => Value::Altitude(scalar()?),
        id::ECEF => Value::Ecef(triple()?),
        id::LAT_LON => Value::LatLon(number.decode_array(data)?),
        id::GNSS_PVT => Value::GnssPvt(GnssPvt::parse(data)?),
        id::GNSS_SAT => Value::GnssSat(GnssSat::parse(data)?),
        id::RATE_OF_TURN => Value::RateOfTurn(triple()?),
        id::DELTA_Q => Value::DeltaQ(quaternion()?),
        id::RATE_OF_TURN_HIGH_RATE => Value::RateOfTurnHighRate(triple()?),
        id::RAW if data.len() == 20 => {
            let (words, _) = data.as_chunks::<2>();
            Value::Raw(std::array::from_fn(|k| u16::from_be_bytes(words[k])))
        }
        id::MAGNETIC_FIELD => Value::MagneticField(triple()?),
        id::VELOCITY => Value::Velocity(triple()?),
        id::STATUS_BYTE => Value::StatusByte(byte()?),
        id::STATUS_WORD => Value::StatusWord(be32()?),
        id::DEVICE_ID => Value::DeviceId(device_id(data)?),
        id::LOCATION_ID => Value::LocationId(word()?),
        _ => return None,
    })
}

/// Appends an item with the given bytes: identifier (big-endian), size, bytes.
///
/// # Panics
/// With more than 255 bytes.
pub fn encode_bytes(id: u16, data: &[u8], out: &mut Vec<u8>) {
    out.extend(id.to_be_bytes());
    out.push(u8::try_from(data.len()).expect("an item holds at most 255 bytes"));
    out.extend(data);
}

/// Appends an item of real numbers, in the number format that `id` names. They must fit 255 bytes (31 of double precision): more
/// give an item with a wrong size.
pub fn encode_numbers(id: u16, values: &[f64], out: &mut Vec<u8>) {
    let number = Number::from_code(id);
    out.extend(id.to_be_bytes());
    out.push((values.len() * number.size()) as u8);
    values.iter().for_each(|&value| number.encode(value, out));
}
