//! What every driver produces: one [`Sample`] per sensor and measurement.

pub use posed_geometry::Timestamp;
use posed_state::Plain;

/// How the first byte of a record reached the host: all that a clock model may know about its time.
///
/// The byte was on the host's side after `t_previous_read` and at or before `t_read`. Bursts of a
/// USB adapter make the second bound loose, the first one stays true. Where records travel in a message (Xbus, x-IMU3), a packet
/// (MotionStar) or a datagram (SlimeVR), the first byte is that of the message, packet or envelope.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Arrival {
    /// Stamp of the read that delivered the record's first byte (`t_arrival` of the design).
    pub t_read: Timestamp,
    /// Stamp of the read before that one; `None` where the driver knows of none since the port was opened.
    pub t_previous_read: Option<Timestamp>,
    /// Bytes of the same read that came after that first byte (the rest of the record or packet, and later ones).
    pub bytes_after: u32,
    /// Bytes that the device sent in the same measurement cycle in front of this record
    /// (Flock, Polhemus: the records of lower addresses; MotionStar: the front of the packet), whether or not they arrived intact.
    /// 0 where the driver does not know.
    pub cycle_bytes_before: u32,
    /// Whether the read ended within the record, the rest of which came later: proof that bytes take their time.
    /// Only the Flock's driver looks; the others say `false`.
    pub split: bool,
    /// Whether bytes were lost since the record before, of this station (Fastrak) or of the device (Flock, WitMotion), by more than the bytes
    /// that came damaged account for, or than one record: whole cycles may have gone with them, and a number of
    /// [`DeviceTime::Cycle`] may be another here. The others say `false`.
    pub after_loss: bool,
}

/// The device's own idea of when a record was measured; not checked against the host's clock but for the x-IMU3.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub enum DeviceTime {
    /// No clock on the wire, only a number. Flock, Fastrak: the driver numbers measurement cycles by the order of addresses.
    /// Records damaged on the wire are counted; cycles that left no trace in the bytes are not, so the number may fall behind
    /// (see [`Arrival::after_loss`]); it never goes back. SlimeVR: the tracker's packet number, which begins anew with a
    /// handshake and is 0 where the tracker does not count or comes by radio. Xbus without a counter: the driver's count of data messages, which
    /// begins anew with each set-up. open-imu without a clock: the number of the sample. WitMotion: as Flock, of groups of frames.
    Cycle(u64),
    /// The unit's counter, unwrapped by the driver, in ticks of a nominal `tick_s` seconds. Xbus: sample time (0.1 ms), else
    /// sample counter (one period); x-IMU3: its clock (1 µs); Polhemus: its time since it was switched on (1 ms); MotionStar and VRPN:
    /// the server's time since 1970 (1 ms, 1 µs); open-imu: the device's clock (1 µs, or 1 ms).
    Counter {
        /// Unwrapped count. It goes back when the device has restarted or set its clock; for an x-IMU3 also from one kind of
        /// message to another, by less than half an inertial period, since an average is dated to its middle.
        ticks: u64,
        /// Nominal duration of a tick, s; the device's clock may run faster or slower.
        tick_s: f64,
    },
}

/// One measurement of one sensor, in SI units: poses in the device's axes (those of the transmitter), IMU values in sensor axes.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Sample {
    /// The sensor's address on its device, as the session was asked for it; 0 for a stand-alone Flock or x-IMU3.
    pub address: u16,
    /// When and how the record reached the host.
    pub arrival: Arrival,
    /// The device's counter, or the number of the cycle.
    pub t_device: DeviceTime,
    /// What was measured.
    pub measurement: Measurement,
}

/// What a sensor measured.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub enum Measurement {
    /// A magnetic tracker's pose: sensor in transmitter axes, as the device computed it, without a measure of its error; or that of a
    /// tracker of any kind behind a VRPN server, in the server's axes. No protocol of such a tracker has a checksum: drivers check form
    /// and plausibility, so a damaged record may rarely pass.
    Pose {
        /// Position of the sensor in the transmitter frame, m (Flock, MotionStar: x forward, y right, z down). Absent in
        /// orientation-only formats. In the wrong half-space around the transmitter it is the negative of the true one.
        position_m: Option<[f64; 3]>,
        /// Whether a coordinate of it is at the end of what the record can say: beyond, it stands still there, and the others go on; or
        /// whether the device itself doubts the pose (Polhemus: an error letter).
        clipped: bool,
        /// Unit quaternion (w, x, y, z) that turns sensor coordinates into transmitter coordinates.
        /// Absent in position-only formats.
        orientation_wxyz: Option<[f64; 4]>,
        /// Button byte as sent, where button mode is on, else absent. Flock: 0x00 none, 0x10, 0x30, 0x70, one value per button;
        /// MotionStar: the second of its two bytes; Fastrak: 1 while the stylus button is down, else 0.
        button: Option<u8>,
    },
    /// What a body-worn sensor measured, in its own axes; absent is what the record does not hold.
    Imu {
        /// Angular rate, rad/s.
        angular_velocity_rad_s: Option<[f64; 3]>,
        /// Specific force (what an accelerometer feels: +g upwards at rest), m/s².
        specific_force_m_s2: Option<[f64; 3]>,
        /// Acceleration with gravity taken out by the device, sensor axes, m/s².
        linear_acceleration_m_s2: Option<[f64; 3]>,
        /// Magnetic field in units of the field's strength at the place of calibration (so about 1).
        magnetic_field: Option<[f64; 3]>,
        /// Unit quaternion (w, x, y, z), computed by the device, that turns sensor coordinates into a
        /// z-up frame: x east, y north where the device trusts its magnetometer, else of any heading. Absent
        /// also where an Xbus device sent one that is no rotation.
        orientation_wxyz: Option<[f64; 4]>,
    },
}
