//! Packets between SlimeVR trackers and their server, both ways; all numbers big-endian.

/// Greatest acceleration that is believed, m/s².
const MOST_M_S2: f64 = 1000.0;
/// Bytes in front of the body: type and packet number.
const HEADER: usize = 12;

/// A packet of a tracker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Number of the packet; 0 in handshakes and returned pings.
    pub number: u64,
    kind: u32,
    body: &'a [u8],
}

/// What a tracker says, one item of a packet.
#[derive(Clone, Debug, PartialEq)]
pub enum Item<'a> {
    /// It is there.
    Heartbeat,
    /// It looks for a server.
    Handshake(Handshake<'a>),
    /// Orientation of a sensor: unit quaternion, sensor to a z-up frame of any heading.
    Rotation {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// w, x, y, z.
        orientation_wxyz: [f64; 4],
    },
    /// Acceleration without gravity, sensor axes, m/s².
    Acceleration {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// x, y, z.
        acceleration_m_s2: [f64; 3],
    },
    /// Both at once.
    Motion {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// w, x, y, z.
        orientation_wxyz: [f64; 4],
        /// x, y, z.
        acceleration_m_s2: [f64; 3],
    },
    /// A ping of ours comes back.
    Pong(u32),
    /// Charge.
    Battery {
        /// Volts, where reported.
        volts: Option<f64>,
        /// 0 to 1.
        level: f64,
    },
    /// A sensor has an error.
    Error {
        /// Number of the sensor on the tracker.
        sensor: u8,
        /// Number of the error.
        code: u8,
    },
    /// What a sensor is.
    SensorInfo(SensorInfo),
    /// What the tracker can do, and it asks what the server can.
    FeatureFlags,
    /// Something else that trackers send.
    Other(u32),
}

/// A tracker's first words. Imitations leave out fields from the end.
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
    /// Version of the firmware.
    pub firmware: &'a [u8],
    /// Network address of the tracker; none where it is zero.
    pub mac: Option<[u8; 6]>,
}

/// What a sensor is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorInfo {
    /// Number of the sensor on the tracker.
    pub sensor: u8,
    /// 0 offline, 1 ok, 2 error.
    pub state: u8,
    /// Type.
    pub kind: u8,
    /// Place on the body as the tracker is set, 0 for none.
    pub position: u8,
}

/// Reads a datagram of a tracker; `None` when it cannot be one.
pub fn parse(datagram: &[u8]) -> Option<Packet<'_>> {
    let (&[0, 0, 0, kind], rest) = datagram.split_first_chunk()? else { return None };
    let (number, body) = rest.split_first_chunk()?;
    Some(Packet { number: u64::from_be_bytes(*number), kind: kind.into(), body })
}

/// An item that is damaged or cannot have been measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused;

impl<'a> Packet<'a> {
    /// Calls `each` with every item of the packet, those of a bundle one by one.
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
        11 | 13 | 18..=21 | 24 | 26 | 27 | 105 => Item::Other(kind),
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

/// The server's answer to a handshake.
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

/// The server is there.
pub fn heartbeat() -> Vec<u8> {
    server_packet(1, &[])
}

/// A ping; the tracker returns it unchanged.
pub fn ping(id: u32) -> Vec<u8> {
    server_packet(10, &id.to_be_bytes())
}

/// What the server can: bundles, compact bundles.
pub fn feature_flags() -> Vec<u8> {
    server_packet(22, &[3])
}

/// A sensor's state has been taken note of. This packet has no number.
pub fn sensor_info_ack(sensor: u8, state: u8) -> Vec<u8> {
    vec![0, 0, 0, 15, sensor, state]
}

/// A packet of a tracker, for tests and virtual trackers.
pub fn encode(number: u64, kind: u32, body: &[u8]) -> Vec<u8> {
    let mut packet = kind.to_be_bytes().to_vec();
    packet.extend(number.to_be_bytes());
    packet.extend(body);
    packet
}

/// Body of a rotation (type 17).
pub fn rotation_body(sensor: u8, [w, x, y, z]: [f64; 4]) -> Vec<u8> {
    let mut body = vec![sensor, 1];
    body.extend([x, y, z, w].iter().flat_map(|&value| (value as f32).to_be_bytes()));
    body.push(0);
    body
}

/// Body of an acceleration (type 4), m/s².
pub fn acceleration_body(sensor: u8, values: [f64; 3]) -> Vec<u8> {
    let mut body: Vec<u8> = values.iter().flat_map(|&value| (value as f32).to_be_bytes()).collect();
    body.push(sensor);
    body
}

/// Body of rotation and acceleration in fixed point (type 23).
pub fn motion_body(sensor: u8, [w, x, y, z]: [f64; 4], acceleration_m_s2: [f64; 3]) -> Vec<u8> {
    let q = [x, y, z, w].map(|value| (value * 32768.0).round().clamp(-32768.0, 32767.0) as i16);
    let a = acceleration_m_s2.map(|value| (value * 128.0).round().clamp(-32768.0, 32767.0) as i16);
    let mut body = vec![sensor];
    body.extend(q.into_iter().chain(a).flat_map(i16::to_be_bytes));
    body
}

/// Body of a handshake of the current protocol.
pub fn handshake_body(mac: [u8; 6], protocol: u32, firmware: &str) -> Vec<u8> {
    let mut body: Vec<u8> = [9, 4, 1, 0, 0, 0, protocol].into_iter().flat_map(u32::to_be_bytes).collect();
    body.push(firmware.len() as u8);
    body.extend(firmware.bytes());
    body.extend(mac);
    body.push(0);
    body
}
