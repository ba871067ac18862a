//! Ground truth: where every sensor is in every measurement cycle, what was done to its measurement, and how that reaches a file.

use std::io::{self, Write};

use nalgebra::{Isometry3, Vector3};
use posed_drivers::Timestamp;
use serde::{Deserialize, Serialize};

/// What the simulator did to a measurement; of inertial sensors only `Clean` and, in a disturbed magnetic field, `Disturbed`
/// occur.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Nothing but noise and mild distortion.
    Clean,
    /// The position is mirrored through the transmitter (hemisphere inversion).
    Inverted,
    /// Nothing new is measured: the words of an earlier cycle are repeated.
    Stuck,
    /// The first measurement after being stuck.
    Jump,
    /// Metal, hum, saturation or a start bend the measurement beyond the scene's limit, or its orientation is no rotation.
    Disturbed,
}

impl Class {
    /// Its word in files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Inverted => "inverted",
            Self::Stuck => "stuck",
            Self::Jump => "jump",
            Self::Disturbed => "disturbed",
        }
    }
}

/// Ground truth of one sensor in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthRow {
    /// Index in the stage's list of sensors.
    pub sensor: usize,
    /// True pose at the cycle's time: sensor to room, m.
    pub pose: Isometry3<f64>,
    /// What happened to the measurement.
    pub class: Class,
    /// Position that is measured without noise, minus the true one, in room axes, m; mirroring and repeating left out. Zero out
    /// of range and for inertial sensors.
    pub distortion_m: Vector3<f64>,
}

/// Ground truth of one measurement cycle of one device.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthCycle {
    /// Capture time on the stage's clock, exact: free of the device's drift and of all delays.
    pub t: Timestamp,
    /// Index in the stage's list of devices.
    pub device: usize,
    /// Number of the cycle, from 0; it goes on while the device is off, and where the device's own counter restarts. Each unit of
    /// an x-IMU3 device and each SlimeVR tracker counts its own.
    pub cycle: u64,
    /// One row for each sensor that is measured in this cycle: all of the device's, but the one station of a Fastrak whose turn
    /// it is, the one unit of an x-IMU3 device, or those of one SlimeVR tracker.
    pub sensors: Vec<TruthRow>,
}

/// A record that did not reach the host as the device measured it: never sent, damaged, or dropped on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The device's number of the cycle, as in [`TruthCycle`].
    pub cycle: u64,
    /// Address of the sensor; absent where the record held those of all sensors of the device.
    pub address: Option<u16>,
}

/// Writes ground truth as CSV, one row per sensor and cycle: `t,sensor,x,y,z,qw,qx,qy,qz,class,distortion_x,distortion_y,distortion_z`.
pub struct TruthWriter<W: Write> {
    writer: W,
    sensors: Vec<String>,
}

impl<W: Write> TruthWriter<W> {
    /// Begins a file: a comment with the UTC time of t = 0, then the header.
    ///
    /// `sensors` are the names by index, written as they are; `epoch_utc` is RFC 3339.
    ///
    /// # Errors
    /// The writer fails.
    pub fn new(mut writer: W, sensors: Vec<String>, epoch_utc: &str) -> io::Result<Self> {
        writeln!(writer, "# epoch_utc = {epoch_utc}")?;
        writeln!(writer, "t,sensor,x,y,z,qw,qx,qy,qz,class,distortion_x,distortion_y,distortion_z")?;
        Ok(Self { writer, sensors })
    }

    /// Writes the rows of a cycle: time in s with nanoseconds, pose in the room (m; quaternion w, x, y, z), class, distortion in
    /// m. A sensor without a name has an empty one.
    ///
    /// # Errors
    /// The writer fails; a row may then be there in part.
    pub fn write(&mut self, cycle: &TruthCycle) -> io::Result<()> {
        let nanos = cycle.t.as_nanos();
        let (sign, nanos) = if nanos < 0 { ("-", nanos.unsigned_abs()) } else { ("", nanos.unsigned_abs()) };
        for row in &cycle.sensors {
            let (p, q, d) = (row.pose.translation.vector, row.pose.rotation, row.distortion_m);
            writeln!(
                self.writer,
                "{sign}{}.{:09},{},{:.7},{:.7},{:.7},{:.8},{:.8},{:.8},{:.8},{},{:.7},{:.7},{:.7}",
                nanos / 1_000_000_000,
                nanos % 1_000_000_000,
                self.sensors.get(row.sensor).map_or("", String::as_str),
                p.x,
                p.y,
                p.z,
                q.w,
                q.i,
                q.j,
                q.k,
                row.class.name(),
                d.x,
                d.y,
                d.z,
            )?;
        }
        Ok(())
    }

    /// Flushes the writer and gives it back.
    ///
    /// # Errors
    /// The writer fails.
    pub fn finish(mut self) -> io::Result<W> {
        self.writer.flush()?;
        Ok(self.writer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_those_of_the_design() {
        let mut writer =
            TruthWriter::new(Vec::new(), vec!["left".into()], "2024-05-01T12:00:00.000000000Z").unwrap();
        let row = TruthRow {
            sensor: 0,
            pose: Isometry3::translation(1.0, -2.0, 0.5),
            class: Class::Inverted,
            distortion_m: Vector3::new(0.001, 0.0, 0.0),
        };
        let t = Timestamp::from_nanos(1_000_000_005);
        writer.write(&TruthCycle { t, device: 0, cycle: 7, sensors: vec![row] }).unwrap();
        let text = String::from_utf8(writer.finish().unwrap()).unwrap();
        assert_eq!(
            text,
            "# epoch_utc = 2024-05-01T12:00:00.000000000Z\n\
             t,sensor,x,y,z,qw,qx,qy,qz,class,distortion_x,distortion_y,distortion_z\n\
             1.000000005,left,1.0000000,-2.0000000,0.5000000,1.00000000,0.00000000,0.00000000,0.00000000,\
             inverted,0.0010000,0.0000000,0.0000000\n"
        );
    }
}
