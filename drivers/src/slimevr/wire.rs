//! Packets between SlimeVR trackers and their server, both ways; all numbers big-endian.

/// Greatest acceleration that is believed, m/s².
const MOST_M_S2: f64 = 1000.0;
/// Bytes in front of the body: type and packet number.
const HEADER: usize = 12;
/// What somebody asks for at a tracker: that pose and heading, or the heading alone, be those of somebody who looks ahead.
pub const FULL_RESET: u8 = 2;
/// See [`FULL_RESET`].
pub const YAW_RESET: u8 = 3;

/// A packet of a tracker: head parsed, items still in their bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Number of the packet since the handshake; 0 in handshakes, returned pings, and where a tracker does not count.
    pub number: u64,
    kind: u32,
    body: &'a [u8],
}

/// What a tracker says, one item of a packet. Nothing but its form and the size of its numbers has been checked.
#[derive(Clone, Debug, PartialEq)]
pub enum Item<'a> {
    /// It is there.
    Heartbeat,
    /// It looks for a server.
    Handshake(Handshake<'a>),
    /// Orientation of a sensor as the tracker computed it: sensor to a z-up frame of the sensor's own heading.
    Rotation {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// Unit quaternion w, x, y, z (x, y, z, w on the wire); a norm further than 0.05 from 1 is refused.
        orientation_wxyz: [f64; 4],
    },
    /// Acceleration without gravity, m/s², each coordinate within 1000. In axes of the sensor from protocol 22 on; before, the
    /// sensor's x, y, z are y, -x, z of these.
    Acceleration {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// x, y, z.
        acceleration_m_s2: [f64; 3],
    },
    /// Orientation and acceleration at once, as in [`Item::Rotation`] and [`Item::Acceleration`].
    Motion {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// Unit quaternion w, x, y, z; 16 bits each on the wire.
        orientation_wxyz: [f64; 4],
        /// x, y, z, m/s²; steps of 1/128 m/s² on the wire.
        acceleration_m_s2: [f64; 3],
    },
    /// A ping of ours comes back, with the identifier that was sent.
    Pong(u32),
    /// Charge of the battery.
    Battery {
        /// Voltage, V; `None` where the tracker reports none, or no number.
        volts: Option<f64>,
        /// Share of a full charge, held within 0 and 1.
        level: f64,
    },
    /// Strength of the radio signal as the tracker receives it; one radio serves all its sensors.
    Signal {
        /// dBm.
        strength_dbm: f64,
    },
    /// A sensor has an error.
    Error {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// Number of the error; what it means depends on the sensor type.
        code: u8,
    },
    /// What a sensor is.
    SensorInfo(SensorInfo),
    /// What the tracker can do, and it asks what the server can.
    FeatureFlags,
    /// Somebody asks for something at the tracker: [`FULL_RESET`], [`YAW_RESET`], or what only the vendor's server does.
    Action(u8),
    /// Something else that trackers send, by its type: known, and without use here.
    Other(u32),
}

/// A tracker's first words. Imitations leave out fields from the end: numbers are then 0, the firmware empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Handshake<'a> {
    /// Type of the board.
    pub board: u32,
    /// Type of sensor 0.
    pub imu: u32,
    /// Type of the processor.
    pub mcu: u32,
    /// Version of the protocol; 0 where not reported.
    pub protocol: u32,
    /// Version of the firmware as text of the tracker's; need not be UTF-8.
    pub firmware: &'a [u8],
    /// Network address of the tracker; `None` where it is left out or zero. Claimed, not proven.
    pub mac: Option<[u8; 6]>,
}

/// What a sensor is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorInfo {
    /// Number of the sensor on the tracker.
    pub sensor: u8,
    /// 0 offline, 1 ok, 2 error.
    pub state: u8,
    /// Type of the sensor's chip, by the number that the firmware gives to it; 0 where left out.
    pub kind: u8,
    /// Place on the body as the tracker is set, 0 for none, by the numbers of the firmware.
    pub position: u8,
}

/// Reads the head of a tracker's datagram (without envelope): type and number, 12 bytes. `None` when it is shorter, or the type
/// is above 255. Whether the type is known, and the body whole, shows in [`Packet::items`].
pub fn parse(datagram: &[u8]) -> Option<Packet<'_>> {
    let (&[0, 0, 0, kind], rest) = datagram.split_first_chunk()? else { return None };
    let (number, body) = rest.split_first_chunk()?;
    Some(Packet { number: u64::from_be_bytes(*number), kind: kind.into(), body })
}

/// An item that is damaged, of an unknown type, or cannot have been measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused;

impl<'a> Packet<'a> {
    /// Calls `each` with every item of the packet, those of a bundle one by one, in order. A bundle that is cut short ends with
    /// one `Err`; an item that is refused does not end it.
    pub fn items(&self, mut each: impl FnMut(Result<Item<'a>, Refused>)) {
        let mut rest = self.body;
        match self.kind {
            100 => {
                while !rest.is_empty() {
                    let inner = rest
                        .split_first_chunk()
                        .and_then(|(len, rest)| rest.split_at_checked(u16::from_be_bytes(*len).into()));
                    let Some((inner, after)) = inner else { return each(Err(Refused)) };
                    rest = after;
                    match inner.split_first_chunk() {
                        Some((kind, body)) => each(item(u32::from_be_bytes(*kind), body)),
                        None if inner.is_empty() => {}
                        None => each(Err(Refused)),
                    }
                }
            }
            101 => {
                while let Some((len, after)) = rest.split_first() {
                    let Some((inner, after)) = after.split_at_checked((*len).into()) else {
                        return each(Err(Refused));
                    };
                    rest = after;
                    if let Some((kind, body)) = inner.split_first() {
                        each(item((*kind).into(), body));
                    }
                }
            }
            kind => each(item(kind, self.body)),
        }
    }

    /// Whether it is a handshake, which begins a new count of packets.
    pub fn is_handshake(&self) -> bool {
        self.kind == 3
    }
}

fn item(kind: u32, body: &[u8]) -> Result<Item<'_>, Refused> {
    decode(kind, body).ok_or(Refused)
}

fn decode(kind: u32, body: &[u8]) -> Option<Item<'_>> {
    Some(match kind {
        0 => Item::Heartbeat,
        3 => Item::Handshake(handshake(body)),
        1 | 16 => {
            Item::Rotation { sensor: u8::from(kind == 16), orientation_wxyz: quaternion(floats(body)?)? }
        }
        4 => {
            let sensor = body.get(12).copied().unwrap_or_default();
            Item::Acceleration { sensor, acceleration_m_s2: acceleration(floats(body)?)? }
        }
        10 => Item::Pong(u32::from_be_bytes(*body.first_chunk()?)),
        12 if body.len() == 4 => Item::Battery { volts: None, level: level(floats(body)?)? },
        12 => {
            let [volts, charge] = floats(body)?;
            Item::Battery { volts: Some(volts).filter(|volts| volts.is_finite()), level: level([charge])? }
        }
        14 => Item::Error { sensor: *body.first()?, code: *body.get(1)? },
        15 => Item::SensorInfo(SensorInfo {
            sensor: *body.first()?,
            state: *body.get(1)?,
            kind: body.get(2).copied().unwrap_or_default(),
            position: body.get(6).copied().unwrap_or_default(),
        }),
        // A correction (data type 2) is not a measurement.
        17 if body.get(1) == Some(&2) => Item::Other(kind),
        17 => {
            Item::Rotation { sensor: *body.first()?, orientation_wxyz: quaternion(floats(body.get(2..)?)?)? }
        }
        // Who it is said of, one sensor or all (255), makes no difference.
        19 => Item::Signal { strength_dbm: body.get(1)?.cast_signed().into() },
        22 => Item::FeatureFlags,
        23 => {
            let (&sensor, rest) = body.split_first()?;
            let (words, _) = rest.first_chunk::<14>()?.as_chunks::<2>();
            let word = |k: usize| f64::from(i16::from_be_bytes(words[k]));
            Item::Motion {
                sensor,
                orientation_wxyz: quaternion([0, 1, 2, 3].map(|k| word(k) / 32768.0))?,
                acceleration_m_s2: acceleration([4, 5, 6].map(|k| word(k) / 128.0))?,
            }
        }
        21 => Item::Action(*body.first()?),
        11 | 13 | 18 | 20 | 24 | 26 | 27 | 105 => Item::Other(kind),
        _ => return None,
    })
}

fn floats<const N: usize>(body: &[u8]) -> Option<[f64; N]> {
    let (chunks, _) = body.get(..4 * N)?.as_chunks::<4>();
    Some(std::array::from_fn(|k| f64::from(f32::from_be_bytes(chunks[k]))))
}

/// Unit quaternion of x, y, z, w; `None` when it is none.
fn quaternion([x, y, z, w]: [f64; 4]) -> Option<[f64; 4]> {
    let norm = [x, y, z, w].iter().map(|value| value * value).sum::<f64>().sqrt();
    (0.95..=1.05).contains(&norm).then(|| [w, x, y, z].map(|value| value / norm))
}

fn acceleration(values: [f64; 3]) -> Option<[f64; 3]> {
    values.iter().all(|value| value.abs() <= MOST_M_S2).then_some(values)
}

fn level([level]: [f64; 1]) -> Option<f64> {
    (-0.01..=1.5).contains(&level).then(|| level.clamp(0.0, 1.0))
}

fn handshake(body: &[u8]) -> Handshake<'_> {
    let word = |at: usize| {
        body.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |&word| u32::from_be_bytes(word))
    };
    let mut handshake =
        Handshake { board: word(0), imu: word(4), mcu: word(8), protocol: word(24), ..Handshake::default() };
    if let Some((&len, rest)) = body.get(28..).and_then(<[u8]>::split_first)
        && let Some((firmware, rest)) = rest.split_at_checked(len.into())
    {
        handshake.firmware = firmware;
        handshake.mac = rest.first_chunk().copied().filter(|mac| *mac != [0; 6]);
    }
    handshake
}

/// The server's answer to a handshake: 64 bytes, of which the tracker checks the text.
pub fn handshake_reply() -> Vec<u8> {
    let mut reply = b"\x03Hey OVR =D 5".to_vec();
    reply.resize(64, 0);
    reply
}

/// The server's packet of a type: number 0, and the body.
fn server_packet(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut packet = vec![0; HEADER];
    packet[3] = kind;
    packet.extend(body);
    packet
}

/// The server is there: 12 bytes. A tracker that hears nothing for 3 s looks for its server anew.
pub fn heartbeat() -> Vec<u8> {
    server_packet(1, &[])
}

/// A ping with an identifier of the caller's choice; the tracker returns it unchanged ([`Item::Pong`]).
pub fn ping(id: u32) -> Vec<u8> {
    server_packet(10, &id.to_be_bytes())
}

/// What the server can: bundles and compact bundles, without which trackers send one item per datagram.
pub fn feature_flags() -> Vec<u8> {
    server_packet(22, &[3])
}

/// A sensor's state has been taken note of; until this comes with the state that it sent, the tracker repeats itself. This
/// packet has no number.
pub fn sensor_info_ack(sensor: u8, state: u8) -> Vec<u8> {
    vec![0, 0, 0, 15, sensor, state]
}

/// A packet of a tracker as it travels, for tests and virtual trackers: type and number big-endian, then the body.
pub fn encode(number: u64, kind: u32, body: &[u8]) -> Vec<u8> {
    let mut packet = kind.to_be_bytes().to_vec();
    packet.extend(number.to_be_bytes());
    packet.extend(body);
    packet
}

/// Body of a rotation (type 17) of a unit quaternion w, x, y, z: data type 1 (normal), x, y, z, w in single precision, accuracy
/// 0.
pub fn rotation_body(sensor: u8, [w, x, y, z]: [f64; 4]) -> Vec<u8> {
    let mut body = vec![sensor, 1];
    body.extend([x, y, z, w].iter().flat_map(|&value| (value as f32).to_be_bytes()));
    body.push(0);
    body
}

/// Body of an acceleration (type 4), x, y, z in m/s², single precision.
pub fn acceleration_body(sensor: u8, values: [f64; 3]) -> Vec<u8> {
    let mut body: Vec<u8> = values.iter().flat_map(|&value| (value as f32).to_be_bytes()).collect();
    body.push(sensor);
    body
}

/// Body of rotation and acceleration in fixed point (type 23): x, y, z, w in 1/32768, then m/s² in 1/128. Values beyond 16 bits
/// are held at their limit (256 m/s²).
pub fn motion_body(sensor: u8, [w, x, y, z]: [f64; 4], acceleration_m_s2: [f64; 3]) -> Vec<u8> {
    let q = [x, y, z, w].map(|value| (value * 32768.0).round().clamp(-32768.0, 32767.0) as i16);
    let a = acceleration_m_s2.map(|value| (value * 128.0).round().clamp(-32768.0, 32767.0) as i16);
    let mut body = vec![sensor];
    body.extend(q.into_iter().chain(a).flat_map(i16::to_be_bytes));
    body
}

/// Body of a handshake of the current form, as a SlimeVR board with a BNO085 on an ESP8266 sends it. `firmware` has at most 255
/// bytes: a longer one gives a body that does not read back.
pub fn handshake_body(mac: [u8; 6], protocol: u32, firmware: &str) -> Vec<u8> {
    let mut body: Vec<u8> = [9, 4, 1, 0, 0, 0, protocol].into_iter().flat_map(u32::to_be_bytes).collect();
    body.push(firmware.len() as u8);
    body.extend(firmware.bytes());
    body.extend(mac);
    body.push(0);
    body
}
