//! What every driver produces: one [`Sample`] per sensor and measurement.

pub use posed_geometry::Timestamp;
use posed_state::Plain;

/// How the first byte of a record reached the host: all that a clock model may know about its time.
///
/// The byte was on the host's side after `t_previous_read` and at or before `t_read`. Bursts of a
/// USB adapter make the second bound loose, the first one stays true.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Arrival {
    /// Stamp of the read that delivered the record's first byte (`t_arrival` of the design).
    pub t_read: Timestamp,
    /// Stamp of the read before that one, if there was one since the port was opened.
    pub t_previous_read: Option<Timestamp>,
    /// Bytes of the same read that came after the record's first byte (its own rest and later records).
    pub bytes_after: u32,
    /// Bytes that the device sent in the same measurement cycle in front of this record
    /// (the records of lower addresses), whether or not they arrived intact.
    pub cycle_bytes_before: u32,
    /// Whether the read ended within the record, the rest of which came later: proof that bytes take their time.
    /// Drivers that do not look say no.
    pub split: bool,
}

/// The device's own idea of when a record was measured.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub enum DeviceTime {
    /// No counter on the wire: the driver numbers measurement cycles by the order of addresses. Records
    /// damaged on the wire are counted; cycles that left no trace in the bytes are not, so the number may fall behind.
    Cycle(u64),
    /// The unit's counter, unwrapped by the driver, in ticks of a nominal `tick_s` seconds.
    Counter {
        /// Unwrapped count. It goes back only when the device has restarted.
        ticks: u64,
        /// Nominal duration of a tick, in seconds.
        tick_s: f64,
    },
}

/// One measurement of one sensor, in device axes and SI units.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Sample {
    /// The sensor's address on its device; 0 for a stand-alone Flock.
    pub address: u16,
    /// When and how the record reached the host.
    pub arrival: Arrival,
    /// The device's counter, or the driver's count of cycles.
    pub t_device: DeviceTime,
    /// What was measured.
    pub measurement: Measurement,
}

/// What a sensor measured.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub enum Measurement {
    /// A magnetic tracker's pose: sensor in transmitter axes.
    Pose {
        /// Position of the sensor in the transmitter frame, m. Absent in orientation-only formats.
        position_m: Option<[f64; 3]>,
        /// Unit quaternion (w, x, y, z) that turns sensor coordinates into transmitter coordinates.
        /// Absent in position-only formats.
        orientation_wxyz: Option<[f64; 4]>,
        /// Button byte as sent, where button mode is on.
        button: Option<u8>,
    },
    /// What a body-worn sensor measured, in its own axes; absent is what the record does not hold.
    Imu {
        /// Angular rate, rad/s.
        angular_velocity_rad_s: Option<[f64; 3]>,
        /// Specific force (what an accelerometer feels: +g upwards at rest), m/s².
        specific_force_m_s2: Option<[f64; 3]>,
        /// Acceleration with gravity taken out by the device, m/s².
        linear_acceleration_m_s2: Option<[f64; 3]>,
        /// Magnetic field in units of the field at the place of calibration (about 1).
        magnetic_field: Option<[f64; 3]>,
        /// Unit quaternion (w, x, y, z), computed by the device, that turns sensor coordinates into a
        /// z-up frame: x east, y north where the device trusts its magnetometer, else of any heading.
        orientation_wxyz: Option<[f64; 4]>,
    },
}
