//! How sensors sit, from somebody who walks about: no pose is held.
//!
//! In: a recording of a body with magnetometers whose legs wear sensors on thighs and shanks. Out: a mounting of every sensor, good to some degrees, with what that leaves
//! open: the filters of arms and legs go on from there. It refuses where neither the feet nor the knees show which way the body faces.
//!
//! The axis between thigh and shank shows which way the body faces at every moment, but for its sign. Somebody who walks goes ahead, whichever way most [strides](super::strides)
//! go: whoever goes backwards all the time is taken to face the other way. Who walks on the spot shows it by knees that are straight most of the time, and far bent for a moment in each stride: the axis points to the side on
//! which the long tail of the angle lies. (Who strolls in small laps hardly straightens them, and has the long tail on the other side.) Relative to where the body faces, on
//! average over the strides, every segment hangs nearly upright.

use nalgebra::{UnitQuaternion, Vector3};

use super::super::SensorMount;
use super::super::block::Block;
use super::super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};
use super::facing::forward;
use super::session::Session;
use super::strides::strides;
use super::{Calibrated, CalibrationError, Contradiction, SegmentAxis, wahba};
use crate::mounting::Refused;
use posed_geometry::so3;

/// How well a knee shows its axis in walking, and how upright segments hang on average about the other axes, degrees: people walk with bent elbows and turned feet.
const KNEE_DEG: f64 = 4.0;
/// The knee is nearly straight at its straightest in each stride, rad; the part of the time in which it is straighter.
const STRAIGHT_RAD: f64 = 0.05;
const STRAIGHTER: f64 = 0.1;
/// A distribution that is less skewed than that shows no way in which a joint bends.
const SKEWED: f64 = 0.3;
/// A stride that is shorter is a step on the spot, m; so many that are longer, and so large a part of them one way, show which way somebody goes.
const GOES_M: f64 = 0.25;
const STRIDES: usize = 6;
const ONE_WAY: f64 = 0.8;

/// By how much the mean posture of a walk may differ from the N-pose about the segment's axes, degrees.
fn sigma_deg(segment: BodySegment) -> [f64; 3] {
    use BodySegment as S;
    match segment {
        S::Torso | S::Pelvis | S::ShoulderR | S::ShoulderL => [5.0, 8.0, 8.0],
        S::Head => [8.0, 10.0, 10.0],
        S::UpperArmR | S::UpperArmL => [10.0, 25.0, 15.0],
        S::ForearmR | S::ForearmL => [12.0, 30.0, 25.0],
        S::HandR | S::HandL => [20.0, 35.0, 30.0],
        S::ThighR | S::ThighL | S::ShankR | S::ShankL => [5.0, 6.0, 10.0],
        S::FootR | S::FootL => [8.0, 12.0, 15.0],
    }
}

/// The axis of a knee in both sensors, and the angles about it, rad: of which sign is open until [`Knee::turn`].
struct Knee {
    segments: [BodySegment; 2],
    axes: [Vector3<f64>; 2],
    /// About their mean, in the order of time.
    angles_rad: Vec<f64>,
}

impl Knee {
    /// The other way round.
    fn turn(&mut self) {
        self.axes.iter_mut().for_each(|axis| *axis = -*axis);
        self.angles_rad.iter_mut().for_each(|angle_rad| *angle_rad = -*angle_rad);
    }

    /// Positive where the long tail of the angles is; without unit.
    fn skewness(&self) -> f64 {
        let moment = |power: i32| {
            self.angles_rad.iter().map(|angle_rad| angle_rad.powi(power)).sum::<f64>()
                / self.angles_rad.len() as f64
        };
        moment(3) / moment(2).sqrt().powi(3).max(f64::MIN_POSITIVE)
    }

    /// By how much the shank is bent against the thigh on average, if the knee is nearly straight at its straightest, rad.
    fn mean_rad(&self) -> f64 {
        let mut sorted_rad = self.angles_rad.clone();
        sorted_rad.sort_by(f64::total_cmp);
        let last = sorted_rad.len().saturating_sub(1);
        STRAIGHT_RAD - sorted_rad.get((STRAIGHTER * last as f64) as usize).copied().unwrap_or_default()
    }

    /// Where a body with that knee looks, room, level; short where the axis is steep.
    fn ahead(&self, session: &Session<'_>, at: usize) -> Vector3<f64> {
        forward(&(session.tracks[self.segments[0].index()][at] * self.axes[0]), &(upright() * -Vector3::z()))
    }
}

/// Both knees, with axes to the body's right.
fn knees(session: &Session<'_>, block: &Block, skeleton: &Skeleton) -> Result<Vec<Knee>, CalibrationError> {
    let legs = [[BodySegment::ThighR, BodySegment::ShankR], [BodySegment::ThighL, BodySegment::ShankL]];
    let worn = legs.into_iter().filter(|leg| leg.iter().all(|segment| session.present[segment.index()]));
    let mut knees: Vec<Knee> = worn.map(|leg| knee(session, block, leg)).collect::<Result<_, _>>()?;
    if knees.is_empty() {
        return Ok(knees);
    }
    let range = session.range(block);
    if let [first, second] = knees.as_mut_slice() {
        let along = range.clone().map(|k| first.ahead(session, k).dot(&second.ahead(session, k)));
        if along.sum::<f64>() < 0.0 {
            second.turn();
        }
    }
    let ahead = |at: usize| {
        let sum: Vector3<f64> = knees.iter().map(|knee| knee.ahead(session, at)).sum();
        sum.try_normalize(0.0).unwrap_or_default()
    };
    let strides_m: Vec<f64> = knees
        .iter()
        .flat_map(|knee| {
            let shank = knee.segments[1];
            let above_ankle_m = (skeleton.usual_sensor_m(shank) - skeleton.end_in_segment_m(shank)).norm();
            strides(session, shank, range.clone(), above_ankle_m)
        })
        .map(|stride| stride.way_m.dot(&ahead(stride.middle)))
        .collect();
    let skewnesses: Vec<f64> = knees.iter().map(Knee::skewness).collect();
    if way(&strides_m, &skewnesses).ok_or(Contradiction::NoWay)? < 0.0 {
        knees.iter_mut().for_each(Knee::turn);
    }
    Ok(knees)
}

/// Which way is ahead, 1 or -1: by strides of these lengths, m, or where hardly any goes anywhere, by knees of these skewnesses.
fn way(strides_m: &[f64], skewnesses: &[f64]) -> Option<f64> {
    let [ahead, back] =
        [1.0, -1.0].map(|way| strides_m.iter().filter(|stride_m| way * **stride_m > GOES_M).count());
    let all = ahead + back;
    if all >= STRIDES {
        let one_way = ahead.max(back) as f64 >= ONE_WAY * all as f64;
        return one_way.then_some(if ahead > back { 1.0 } else { -1.0 });
    }
    let mean = skewnesses.iter().sum::<f64>() / skewnesses.len() as f64;
    let agree = skewnesses.iter().all(|skewness| skewness * mean > 0.0);
    (agree && mean.abs() >= SKEWED).then_some(mean.signum())
}

pub(super) fn calibrate(
    session: &Session<'_>,
    block: &Block,
    skeleton: &Skeleton,
    offsets_m: &[Option<Vector3<f64>>; SEGMENTS],
) -> Result<Calibrated, CalibrationError> {
    if !session.magnetic {
        let fix = "poses: without magnetometers in all sensors walking does not show it";
        return Err(CalibrationError::Facing { of: "the body", fix });
    }
    let knees = knees(session, block, skeleton)?;
    if knees.is_empty() {
        let fix = "sensors on a thigh and its shank, or poses";
        return Err(CalibrationError::Facing { of: "the body", fix });
    }
    // Which way the body faces at every moment.
    let range = session.range(block);
    let bodies: Vec<UnitQuaternion<f64>> = range
        .clone()
        .map(|k| {
            let ahead: Vector3<f64> = knees.iter().map(|knee| knee.ahead(session, k)).sum();
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), libm::atan2(ahead.y, ahead.x)) * upright()
        })
        .collect();
    let mut out =
        Calibrated { mounts: [None; SEGMENTS], quality_deg: [None; SEGMENTS], warnings: Vec::new() };
    for segment in BodySegment::ALL.into_iter().filter(|segment| session.present[segment.index()]) {
        let index = segment.index();
        let track = &session.tracks[index][range.clone()];
        let relative: Vec<_> = bodies.iter().zip(track).map(|(body, q)| body.inverse() * q).collect();
        // Twice: the mean is taken about the first, which may be far from it.
        let rough = so3::mean(&relative);
        let centred: Vec<_> = relative.iter().map(|q| rough.inverse() * q).collect();
        let mut q_segment_sensor = rough * so3::mean(&centred);
        let sigma_deg = Vector3::from(sigma_deg(segment));
        let mut sigma = sigma_deg;
        if let Some((knee, which)) = knees
            .iter()
            .find_map(|knee| Some((knee, knee.segments.iter().position(|known| *known == segment)?)))
        {
            // What the knee bends is shared by thigh and shank: forwards the one, backwards the other.
            let bent = so3::exp(&(Vector3::z() * knee.mean_rad() * [-0.5, 0.5][which]));
            q_segment_sensor = bent * q_segment_sensor;
            let upright = [Vector3::x(), Vector3::y()].map(|axis| SegmentAxis {
                sensor: q_segment_sensor.inverse() * axis,
                segment: axis,
                sigma_deg: sigma_deg.z,
            });
            let hinge = SegmentAxis { sensor: knee.axes[which], segment: -Vector3::z(), sigma_deg: KNEE_DEG };
            let [ahead, up] = upright;
            (q_segment_sensor, _) = wahba(&[ahead, up, hinge]);
            sigma = Vector3::new(KNEE_DEG, KNEE_DEG, sigma_deg.z);
        }
        out.mounts[index] = Some(SensorMount {
            q_segment_sensor,
            sigma_rad: sigma.map(f64::to_radians),
            offset_m: offsets_m[index].unwrap_or_else(|| skeleton.usual_sensor_m(segment)),
            heading_rad: None,
        });
    }
    Ok(out)
}

/// Of one leg, its axis to either side.
fn knee(session: &Session<'_>, block: &Block, segments: [BodySegment; 2]) -> Result<Knee, CalibrationError> {
    let [thigh, shank] = segments;
    let range = session.range(block);
    let failed = |reason| CalibrationError::movement(block, reason);
    let (axes, _) = session.pair(thigh, shank, None, range.clone()).map_err(failed)?;
    let [Some(first), Some(second)] = axes else {
        return Err(failed(Refused::Excitation { found: 0.0, needed: 1.0 }));
    };
    let (above, below) =
        (&session.tracks[thigh.index()][range.clone()], &session.tracks[shank.index()][range]);
    // From an orientation in the middle of them, so that no angle is beyond half a turn.
    let middle = above[above.len() / 2].inverse() * below[below.len() / 2];
    let angle = |(a, b): (&UnitQuaternion<f64>, &UnitQuaternion<f64>)| {
        so3::log(&(middle.inverse() * (a.inverse() * b))).dot(&second)
    };
    let mut angles_rad: Vec<f64> = above.iter().zip(below).map(angle).collect();
    let mean_rad = angles_rad.iter().sum::<f64>() / angles_rad.len() as f64;
    angles_rad.iter_mut().for_each(|angle_rad| *angle_rad -= mean_rad);
    Ok(Knee { segments, axes: [first, second], angles_rad })
}

/// Whether a walk shows which way the body faces.
///
/// # Errors
/// [`Contradiction::NoWay`] where neither its strides nor the knees do.
pub(super) fn check(
    session: &Session<'_>,
    block: &Block,
    skeleton: &Skeleton,
) -> Result<(), CalibrationError> {
    knees(session, block, skeleton).map(|_| ())
}
