//! How far a foot goes in each stride, from the sensor on its shank: the foot stands between them.
//!
//! In: a sensor's samples and its orientations in the room. Out: the ways of the ankle, room, m. It needs no mounting: a shank that walks is upright on average, so that its
//! sensor knows which way the ankle lies. Each way is the specific force integrated twice between two moments in which the ankle stands, with what the velocity is wrong by
//! at the end taken off it as a drift (Skog et al. 2010, of a foot's sensor; here by the lever to the ankle).

use std::ops::Range;

use nalgebra::Vector3;

use super::super::skeleton::BodySegment;
use super::session::Session;
use posed_geometry::GRAVITY_M_S2;

/// A foot that stands does so for at least so long, s, and is the stillest within so long on either side, s.
const STANDS_S: f64 = 0.15;
const STRIDE_S: f64 = 0.35;
/// And its shank is accelerated by no more, root mean square, m/s²: it turns about the ankle by some 100 degrees per second.
const STILL_M_S2: f64 = 2.0;
/// A stride takes no longer, s.
const LONGEST_S: f64 = 2.5;

/// One stride: the sample in its middle, and the way of the ankle, room, m.
pub(super) struct Stride {
    pub(super) middle: usize,
    pub(super) way_m: Vector3<f64>,
}

/// The strides of a shank whose sensor sits so far above the ankle, m.
pub(super) fn strides(
    session: &Session<'_>,
    shank: BodySegment,
    range: Range<usize>,
    above_ankle_m: f64,
) -> Vec<Stride> {
    let index = shank.index();
    let track = &session.tracks[index];
    let up: Vector3<f64> = track[range.clone()].iter().map(|q| q.inverse() * Vector3::z()).sum();
    let lever_m = up.try_normalize(0.0).unwrap_or_default() * above_ankle_m;
    let begin = range.start;
    // Acceleration and velocity of the sensor against the ankle, room; none where a sample is missing.
    let moved: Vec<Option<[Vector3<f64>; 2]>> = range
        .map(|k| {
            let sample = session.recording[k].1[index]?;
            let (f, w) = (sample.accel_m_s2, sample.gyro_rad_s);
            let finite = f.iter().chain(w.iter()).all(|value| value.is_finite());
            let a = track[k] * f - Vector3::z() * GRAVITY_M_S2;
            finite.then(|| [a, track[k] * w.cross(&lever_m)])
        })
        .collect();
    let t_s = |at: usize| session.recording[begin + at].0;
    let stands = standing(&moved, t_s);
    stands
        .windows(2)
        .filter_map(|pair| {
            way(&moved, pair[0], pair[1], t_s).map(|way_m| {
                let lever = |at: usize| track[begin + at] * lever_m;
                Stride {
                    middle: begin + (pair[0] + pair[1]) / 2,
                    way_m: way_m - lever(pair[1]) + lever(pair[0]),
                }
            })
        })
        .collect()
}

/// When the foot stands: where the shank is accelerated least.
fn standing(moved: &[Option<[Vector3<f64>; 2]>], t_s: impl Fn(usize) -> f64) -> Vec<usize> {
    let around = |at: usize, reach_s: f64| {
        let begin = (0..at).rev().find(|k| t_s(at) - t_s(*k) > reach_s).map_or(0, |k| k + 1);
        let end = (at..moved.len()).find(|k| t_s(*k) - t_s(at) > reach_s).unwrap_or(moved.len());
        begin..end
    };
    let shaken: Vec<f64> = (0..moved.len())
        .map(|at| {
            let near = &moved[around(at, 0.5 * STANDS_S)];
            let squares: Option<f64> = near.iter().map(|moved| moved.map(|[a, _]| a.norm_squared())).sum();
            squares.map_or(f64::INFINITY, |squares| squares / near.len() as f64)
        })
        .collect();
    let least = |at: &usize| {
        let near = around(*at, STRIDE_S);
        // The first of equals.
        shaken[*at] < STILL_M_S2.powi(2)
            && shaken[near.start..*at].iter().all(|other| *other > shaken[*at])
            && shaken[*at..near.end].iter().all(|other| *other >= shaken[*at])
    };
    (0..moved.len()).filter(least).collect()
}

/// How far the sensor went between two moments in which the ankle stood, room, m.
fn way(
    moved: &[Option<[Vector3<f64>; 2]>],
    begin: usize,
    end: usize,
    t_s: impl Fn(usize) -> f64,
) -> Option<Vector3<f64>> {
    let span_s = t_s(end) - t_s(begin);
    if span_s > LONGEST_S {
        return None;
    }
    let [mut before, mut velocity] = moved[begin]?;
    let mut way_m = Vector3::zeros();
    for (at, moved) in moved.iter().enumerate().take(end + 1).skip(begin + 1) {
        let [now, _] = (*moved)?;
        let dt_s = t_s(at) - t_s(at - 1);
        let next = velocity + (before + now) * (0.5 * dt_s);
        way_m += (velocity + next) * (0.5 * dt_s);
        (before, velocity) = (now, next);
    }
    let drift = velocity - moved[end]?[1];
    Some(way_m - drift * (0.5 * span_s))
}
