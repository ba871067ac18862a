//! Samples of IMUs from a file of either kind: a table, or a recording.

use std::path::Path;

use posed_fusion::ahrs::{ImuSample, Sampling};
use posed_fusion::body::BodySegment;
use posed_recording::is_recording;
use posed_recording::table::{Imu, ImuRow};
use posed_stage::output::Inertial;
use posed_stage::{BodyIndex, Stage};

use super::Error;
use super::recorded::Recorded;

/// What samples of a table are of the interval since the one before; those of a recording are known.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Sampled {
    /// Means: what a unit that integrates inside sends.
    Mean,
    /// Values at their times.
    Instantaneous,
}

impl From<Sampled> for Sampling {
    fn from(sampled: Sampled) -> Self {
        match sampled {
            Sampled::Mean => Self::Mean,
            Sampled::Instantaneous => Self::Instantaneous,
        }
    }
}

/// The refusal of what was said of samples that are a recording's.
pub(super) fn sampling_is_known() -> Error {
    Error::Usage("--sampling is for tables: a recording's stage states it".into())
}

/// Moves the samples of each sensor to the middles of their intervals, where means are true.
pub(super) fn centre(imu: &mut Imu) {
    for sensor in 0..imu.sensors.len() {
        let times = || imu.rows.iter().filter(|row| row.sensor == sensor).map(|row| row.t_s);
        let mut intervals_s: Vec<f64> =
            times().skip(1).zip(times()).map(|(t_s, before_s)| t_s - before_s).collect();
        if intervals_s.is_empty() {
            continue;
        }
        let middle = intervals_s.len() / 2;
        let (_, interval_s, _) = intervals_s.select_nth_unstable_by(middle, f64::total_cmp);
        let half_s = 0.5 * *interval_s;
        imu.rows.iter_mut().filter(|row| row.sensor == sensor).for_each(|row| row.t_s -= half_s);
    }
}

/// Reads a table, with `rate_hz` where it has no column `t`, or a recording, which also gives its stage. Of a recording's units `which` takes
/// what they measured ([`Inertial::uncorrected`]) or the same by their intrinsics ([`Inertial::sample`]).
pub(super) fn read(
    path: &Path,
    rate_hz: Option<f64>,
    which: fn(&Inertial) -> Option<ImuSample>,
) -> Result<(Option<Stage>, Imu), Error> {
    if !is_recording(path) {
        return Ok((None, Imu::read(path, rate_hz).map_err(Error::failed)?));
    }
    let (stage, imu) = recorded(path, which)?;
    if imu.rows.is_empty() {
        return Err(Error::Failed(format!("{} holds no samples of IMUs", path.display())));
    }
    Ok((Some(stage), imu))
}

/// A unit that is faster than the stage's frames gives its newest sample of each.
fn recorded(path: &Path, which: fn(&Inertial) -> Option<ImuSample>) -> Result<(Stage, Imu), Error> {
    let (mut stage, recorded) = Recorded::open(path)?;
    let imus: Vec<usize> = (0..stage.sensors.len()).filter(|at| stage.is_imu(&stage.sensors[*at])).collect();
    let sensors = imus.iter().map(|at| stage.sensors[*at].name.clone()).collect();
    let mut table = Imu { sensors, ..Imu::default() };
    let mut last_s = vec![f64::NEG_INFINITY; imus.len()];
    let pipeline = recorded.estimates(|estimate| {
        for (sensor, at) in imus.iter().enumerate() {
            let Some(measured) = estimate.sensors[*at].measured else { continue };
            let Some(sample) = measured.inertial.as_ref().and_then(which) else { continue };
            let t_s = measured.t_valid.as_secs_f64();
            // A frame without news of a sensor shows its last record again.
            if t_s <= last_s[sensor] {
                continue;
            }
            last_s[sensor] = t_s;
            table.magnetometer |= sample.mag.is_some();
            table.rows.push(ImuRow {
                t_s,
                sensor,
                accel_m_s2: Some(sample.accel_m_s2.into()),
                gyro_rad_s: Some(sample.gyro_rad_s.into()),
                mag: sample.mag.map(Into::into),
            });
        }
    })?;
    // Where sensors turned out to sit while it was recorded.
    for body in 0..stage.bodies.len() as BodyIndex {
        for (segment, imu) in BodySegment::ALL.into_iter().zip(pipeline.body_imus(body)) {
            if let Some(imu) = imu {
                stage.sensors[usize::from(imu)].segment = Some(segment.name().into());
            }
        }
    }
    Ok((stage, table))
}
