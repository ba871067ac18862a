//! Both sensors' own records, each on its own clock, as samples at common times.
//!
//! In: magnetic poses and IMU samples with their capture times. Out: the alignment, and the constant by which the two clocks
//! differ. A magnetometer, where it is believed, gives the heading and nothing else.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::super::ahrs::{Ahrs, ImuSample, Params};
use super::{AlignError, Alignment, AnchorPoint, HALF_S, PairedSample, align, attached};
use posed_geometry::so3::exp;

/// Step of the common times, s.
const STEP_S: f64 = 0.01;
/// Over a longer gap between two records nothing is interpolated, s.
const GAP_S: f64 = 0.06;
/// Largest difference of the clocks that is looked for, s, and its steps; the best one is then halved to the last.
const LARGEST_OFFSET_S: f64 = 0.1;
const COARSE_S: f64 = 0.01;
const FINE_S: f64 = 5e-5;
/// Share of the time in which the field must be believed for its heading to count.
const BELIEVED: f64 = 0.8;

/// Every eighth rotation does for the clocks.
const SPARSE: usize = 8;

/// What a sensor that has both was seen to do, each record on the clock of its own device.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Capture time, s, and sensor to transmitter; times rise.
    pub magnetic: Vec<(f64, Isometry3<f64>)>,
    /// Capture time, s, and sample; times rise.
    pub imu: Vec<(f64, ImuSample)>,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Transmitter and IMU.
    pub alignment: Alignment,
    /// Capture time of a magnetic record on the IMU's clock minus the one it has, s; within 0.1 s, in steps of 40 us.
    pub clock_offset_s: f64,
    /// Whether the magnetic field gave the heading.
    pub heading: bool,
}

/// Aligns a recording of fast rotations about all axes (the guide asks for 25 s); `magnetometer` states whether the IMU's
/// field may give the heading, which it does where it is believed for 80 % of the time. Both are interpolated to steps of 10
/// ms; gaps above 60 ms split the recording. Offline: the clocks are compared some forty times, the IMU's filter runs twice.
///
/// # Errors
/// As [`align`].
pub fn align_recording(
    recording: &Recording,
    anchors: &[AnchorPoint],
    magnetometer: bool,
) -> Result<Found, AlignError> {
    let (oriented, heading) = oriented(&recording.imu, magnetometer);
    let misfit = |offset_s: f64| Ok(attached(&both(recording, &oriented, offset_s), SPARSE)?.1);
    let mut best = (f64::INFINITY, 0.0);
    let steps = (LARGEST_OFFSET_S / COARSE_S) as i32;
    for k in -steps..=steps {
        let offset_s = f64::from(k) * COARSE_S;
        let left = misfit(offset_s)?;
        if left < best.0 {
            best = (left, offset_s);
        }
    }
    let mut step_s = COARSE_S;
    while step_s > FINE_S {
        step_s *= 0.5;
        for offset_s in [best.1 - step_s, best.1 + step_s] {
            let left = misfit(offset_s)?;
            if left < best.0 {
                best = (left, offset_s);
            }
        }
    }
    let clock_offset_s = best.1;
    let alignment = align(&both(recording, &oriented, clock_offset_s), anchors, heading)?;
    Ok(Found { alignment, clock_offset_s, heading })
}

/// Orientation and specific force over time: the second of two runs of the filter, which begins with the bias that the first
/// one found. Whether a field was believed says the second value; the orientation is that of the room then, and of a level
/// frame otherwise.
fn oriented(imu: &[(f64, ImuSample)], magnetometer: bool) -> (Vec<Oriented>, bool) {
    let mut filter = Ahrs::new(Params::instantaneous());
    let mut gyro = UnitQuaternion::identity();
    let mut believed = 0;
    let mut out = Vec::with_capacity(imu.len());
    for pass in 0..2 {
        let mut last_s: Option<f64> = None;
        for (t_s, sample) in imu {
            let since_s = last_s.map_or(STEP_S, |last| t_s - last);
            last_s = Some(*t_s);
            if since_s > GAP_S {
                // How it turned meanwhile is not guessed, or the bias would pay for it.
                filter.restart();
            }
            let dt_s = since_s.min(GAP_S);
            let mag = sample.mag.filter(|_| magnetometer);
            let level = filter.push(&ImuSample { mag, ..*sample }, dt_s);
            if pass == 0 {
                continue;
            }
            believed += usize::from(filter.has_field() && !filter.magnetic_disturbance());
            gyro *= exp(&(filter.angular_velocity_rad_s() * dt_s));
            out.push(Oriented { t_s: *t_s, dt_s, level, gyro, specific_force_m_s2: sample.accel_m_s2 });
        }
        filter.restart();
    }
    let heading = magnetometer && believed as f64 >= BELIEVED * out.len().max(1) as f64;
    (out, heading)
}

struct Oriented {
    t_s: f64,
    /// Since the sample before, s; of a gap only its limit.
    dt_s: f64,
    level: UnitQuaternion<f64>,
    gyro: UnitQuaternion<f64>,
    specific_force_m_s2: Vector3<f64>,
}

/// Both at common times: the stretches without a gap in which there is a second difference.
fn both(recording: &Recording, oriented: &[Oriented], offset_s: f64) -> Vec<Vec<PairedSample>> {
    let (mut stretches, mut current) = (Vec::new(), Vec::new());
    let Some((start_s, _)) = recording.magnetic.first() else { return stretches };
    let end_s = recording.magnetic.last().map_or(*start_s, |(t_s, _)| *t_s);
    let (mut m, mut a, mut f) = (0, 0, 0);
    for k in 0..=((end_s - start_s) / STEP_S) as usize {
        let t_s = start_s + k as f64 * STEP_S;
        let sample = magnetic_at(&recording.magnetic, &mut m, t_s).and_then(|transmitter_from_sensor| {
            let (before, after, part) = imu_at(oriented, &mut a, t_s + offset_s)?;
            // A sample's specific force is that of the middle of its step, the orientation that of its end.
            let half_s = 0.5 * before.dt_s;
            let (older, newer, share) = imu_at(oriented, &mut f, t_s + offset_s + half_s)?;
            Some(PairedSample {
                t_s,
                transmitter_from_sensor,
                level_from_imu: between(&before.level, &after.level, part),
                gyro_from_imu: between(&before.gyro, &after.gyro, part),
                specific_force_m_s2: older.specific_force_m_s2.lerp(&newer.specific_force_m_s2, share),
            })
        });
        match sample {
            Some(sample) => current.push(sample),
            None => stretches.push(std::mem::take(&mut current)),
        }
    }
    stretches.push(current);
    stretches.retain(|samples| samples.len() as f64 * STEP_S > 2.0 * HALF_S);
    stretches
}

fn magnetic_at(records: &[(f64, Isometry3<f64>)], at: &mut usize, t_s: f64) -> Option<Isometry3<f64>> {
    while records.get(*at + 1).is_some_and(|(next_s, _)| *next_s < t_s) {
        *at += 1;
    }
    let ((before_s, before), (after_s, after)) = (records.get(*at)?, records.get(*at + 1)?);
    let part = part(*before_s, *after_s, t_s)?;
    before.try_lerp_slerp(after, part, 1e-9).or(Some(*before))
}

/// The samples before and after a time, and where it lies between them.
fn imu_at<'a>(
    oriented: &'a [Oriented],
    at: &mut usize,
    t_s: f64,
) -> Option<(&'a Oriented, &'a Oriented, f64)> {
    while oriented.get(*at + 1).is_some_and(|next| next.t_s < t_s) {
        *at += 1;
    }
    let (before, after) = (oriented.get(*at)?, oriented.get(*at + 1)?);
    Some((before, after, part(before.t_s, after.t_s, t_s)?))
}

fn between(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, part: f64) -> UnitQuaternion<f64> {
    a.try_slerp(b, part, 1e-9).unwrap_or(*a)
}

/// Where a time lies between two, 0 to 1; `None` outside, and where they are too far apart.
fn part(before_s: f64, after_s: f64, t_s: f64) -> Option<f64> {
    let span_s = after_s - before_s;
    let inside = (before_s..=after_s).contains(&t_s) && span_s > 0.0 && span_s <= GAP_S;
    inside.then(|| (t_s - before_s) / span_s)
}
