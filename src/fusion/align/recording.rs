//! Both sensors' own records, each on its own clock, as samples at common times.
//!
//! In: magnetic poses and IMU samples with their capture times. Out: the alignment, and the constant by which the two clocks
//! differ. The IMU's tilt comes from gravity alone; a magnetometer, where it is believed, gives one heading for the whole recording,
//! so that its wavering disturbs nothing else.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::super::ahrs::{Ahrs, ImuSample, Params};
use super::{AlignError, Alignment, AnchorPoint, BothSample, HALF_S, about_z, align, fastened};

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

/// Every eighth turn does for the clocks.
const SPARSE: usize = 8;

/// What a sensor that has both was seen to do.
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
    /// Capture time of a magnetic record on the IMU's clock minus the one it has, s.
    pub clock_offset_s: f64,
    /// Whether a field gave the heading.
    pub heading: bool,
}

/// Aligns a recording; `magnetometer` says whether the IMU's field may give the heading.
///
/// # Errors
/// What the movement does not show.
pub fn align_recording(
    recording: &Recording,
    anchors: &[AnchorPoint],
    magnetometer: bool,
) -> Result<Found, AlignError> {
    let (oriented, heading) = oriented(&recording.imu, magnetometer);
    let misfit = |offset_s: f64| Ok(fastened(&both(recording, &oriented, offset_s), SPARSE)?.1);
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

/// Orientation and force over time: the second of two runs of the filter, which begins with the bias that the first one found. In a
/// level frame, and turned north where a field was believed.
fn oriented(imu: &[(f64, ImuSample)], magnetometer: bool) -> (Vec<Oriented>, bool) {
    let mut filter = Ahrs::new(Params::default());
    let mut north = Vector3::zeros();
    let (mut believed, mut all) = (0.0, 0.0);
    let mut out = Vec::with_capacity(imu.len());
    for pass in 0..2 {
        let mut last_s: Option<f64> = None;
        for (t_s, sample) in imu {
            let dt_s = last_s.map_or(STEP_S, |last| t_s - last);
            last_s = Some(*t_s);
            let mag = sample.mag.filter(|_| magnetometer);
            filter.push(&ImuSample { mag, ..*sample }, dt_s);
            if pass == 0 {
                continue;
            }
            let level = filter.orientation_6d();
            let turn = filter.orientation() * level.inverse();
            all += 1.0;
            if filter.has_field() && !filter.magnetic_disturbance() {
                believed += 1.0;
                north += turn * Vector3::x();
            }
            // After a gap the sample's own step is a short one.
            let dt_s = dt_s.min(GAP_S);
            out.push(Oriented { t_s: *t_s, dt_s, level, force_m_s2: sample.accel_m_s2 });
        }
        filter.restart();
    }
    let heading = magnetometer && all > 0.0 && believed / all >= BELIEVED;
    if heading {
        let turn = about_z(north.y.atan2(north.x));
        out.iter_mut().for_each(|oriented| oriented.level = turn * oriented.level);
    }
    (out, heading)
}

struct Oriented {
    t_s: f64,
    /// Since the sample before, without a gap, s.
    dt_s: f64,
    level: UnitQuaternion<f64>,
    force_m_s2: Vector3<f64>,
}

/// Both at common times: the stretches without a gap in which there is a second difference.
fn both(recording: &Recording, oriented: &[Oriented], offset_s: f64) -> Vec<Vec<BothSample>> {
    let (mut stretches, mut current) = (Vec::new(), Vec::new());
    let Some((start_s, _)) = recording.magnetic.first() else { return stretches };
    let end_s = recording.magnetic.last().map_or(*start_s, |(t_s, _)| *t_s);
    let (mut m, mut a, mut f) = (0, 0, 0);
    for k in 0..=((end_s - start_s) / STEP_S) as usize {
        let t_s = start_s + k as f64 * STEP_S;
        let sample = magnetic_at(&recording.magnetic, &mut m, t_s).and_then(|pose| {
            let (level, _) = imu_at(oriented, &mut a, t_s + offset_s)?;
            // A sample's force is that of the middle of its step, the orientation that of its end.
            let half_s = 0.5 * oriented[a].dt_s;
            let (_, force_m_s2) = imu_at(oriented, &mut f, t_s + offset_s + half_s)?;
            Some(BothSample { t_s, transmitter_from_sensor: pose, level_from_imu: level, force_m_s2 })
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

fn imu_at(oriented: &[Oriented], at: &mut usize, t_s: f64) -> Option<(UnitQuaternion<f64>, Vector3<f64>)> {
    while oriented.get(*at + 1).is_some_and(|next| next.t_s < t_s) {
        *at += 1;
    }
    let (before, after) = (oriented.get(*at)?, oriented.get(*at + 1)?);
    let part = part(before.t_s, after.t_s, t_s)?;
    let level = before.level.try_slerp(&after.level, part, 1e-9).unwrap_or(before.level);
    Some((level, before.force_m_s2.lerp(&after.force_m_s2, part)))
}

/// Where a time lies between two, 0 to 1; `None` outside, and where they are too far apart.
fn part(before_s: f64, after_s: f64, t_s: f64) -> Option<f64> {
    let span_s = after_s - before_s;
    let inside = (before_s..=after_s).contains(&t_s) && span_s > 0.0 && span_s <= GAP_S;
    inside.then(|| (t_s - before_s) / span_s)
}
