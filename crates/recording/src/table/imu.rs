//! IMU samples: `t` (or a rate), `sensor`, `ax,ay,az`, `gx,gy,gz`, optional `mx,my,mz`.

use std::path::Path;

use super::{Clock, TableError, TableReader, TableWriter, intern};

/// Samples of one or several IMUs, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Imu {
    /// Names, in the order of first appearance; a file without a column `sensor` has one sensor without a name.
    pub sensors: Vec<String>,
    /// Whether the file has magnetometer columns.
    pub magnetometer: bool,
    /// The rows.
    pub rows: Vec<ImuRow>,
}

/// One IMU at one time, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuRow {
    /// Time, s; its zero is the file's.
    pub t_s: f64,
    /// Index in [`Imu::sensors`].
    pub sensor: usize,
    /// Specific force, m/s² (+g on the axis that points up, at rest); `None` where the cells are empty.
    pub accel_m_s2: Option<[f64; 3]>,
    /// Angular velocity, rad/s; `None` where the cells are empty.
    pub gyro_rad_s: Option<[f64; 3]>,
    /// Magnetic field, in any unit of constant scale; `None` where the cells are empty or the file has no such columns.
    pub mag: Option<[f64; 3]>,
}

impl Imu {
    /// Reads samples from a CSV file; `rate_hz`, above 0, is for files without a column `t`.
    ///
    /// # Errors
    /// The file cannot be read; otherwise as [`Imu::from_table`].
    pub fn read(path: &Path, rate_hz: Option<f64>) -> Result<Self, TableError> {
        Self::from_table(TableReader::open(path)?, rate_hz)
    }

    /// Reads samples from CSV; without a column `t` every sensor's rows are `1 / rate_hz` apart, from 0.
    ///
    /// # Errors
    /// A column is missing, or both `t` and a rate that serves; a cell is not what it should be.
    pub fn from_table(mut table: TableReader, rate_hz: Option<f64>) -> Result<Self, TableError> {
        let clock = Clock::new(&table, rate_hz)?;
        let accel = table.require(["ax", "ay", "az"])?;
        let gyro = table.require(["gx", "gy", "gz"])?;
        let mag = table.all_or_none(["mx", "my", "mz"])?;
        let sensor = table.column("sensor")?;
        let mut imu = Self { magnetometer: mag.is_some(), ..Self::default() };
        let mut counts = Vec::new();
        while table.next_row()? {
            let name = sensor.map_or("", |column| table.text(column));
            if let (Some(column), "") = (sensor, name) {
                return Err(table.cell_error(column, "the name of a sensor"));
            }
            let last = imu.rows.last().map_or(0, |row| row.sensor);
            let index = intern(&mut imu.sensors, name, last);
            counts.resize(imu.sensors.len(), 0);
            imu.rows.push(ImuRow {
                t_s: clock.t_s(&table, counts[index])?,
                sensor: index,
                accel_m_s2: table.vector(accel)?,
                gyro_rad_s: table.vector(gyro)?,
                mag: mag.map_or(Ok(None), |columns| table.vector(columns))?,
            });
            counts[index] += 1;
        }
        Ok(imu)
    }

    /// Writes the samples; a column `sensor` where sensors have names.
    ///
    /// # Errors
    /// The file cannot be written; nothing is left behind.
    pub fn write(&self, path: &Path) -> Result<(), TableError> {
        let named = self.sensors.iter().any(|name| !name.is_empty());
        let mut columns = vec!["t"];
        columns.extend(named.then_some("sensor"));
        columns.extend(["ax", "ay", "az", "gx", "gy", "gz"]);
        columns.extend(["mx", "my", "mz"].iter().filter(|_| self.magnetometer));
        let mut table = TableWriter::create(path, &columns)?;
        for row in &self.rows {
            table.number(row.t_s)?;
            if named {
                table.text(self.sensors.get(row.sensor).map_or("", String::as_str))?;
            }
            table.vector(row.accel_m_s2)?;
            table.vector(row.gyro_rad_s)?;
            if self.magnetometer {
                table.vector(row.mag)?;
            }
            table.end_row()?;
        }
        table.finish()
    }
}
