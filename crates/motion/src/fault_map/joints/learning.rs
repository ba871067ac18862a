//! Which sensors of a recording share a joint, and how well it holds.
//!
//! What comes in: a recording, and where its sensors are on the clean side as far as they are believed. What goes out: [`Joints`], and the lever arms of this
//! very recording. Least squares in rounds that leave out what does not fit; each fifth of the recording is held against the lever arms of the others, so that a
//! pair that hardly turns promises nothing.

use nalgebra::{Matrix6, Vector6};

use super::lever::{FRAMES_PER_WORD, UNKNOWN_M, left_over, turned};
use super::{Joint, Joints, Pose, far};
use crate::fault_map::frames::Frames;
use crate::fault_map::memory::Point;
use crate::fault_map::pairs::quantile;

/// So many frames are enough for a pair, and so many are needed.
const MOST_FRAMES: usize = 4000;
const LEAST_FRAMES: usize = 300;
/// Parts that are held against each other, and rounds.
const PARTS: usize = 5;
const ROUNDS: usize = 4;
/// What is left over is left out beyond so many spreads.
const TRIM: f64 = 3.0;
/// A pair whose point is not shared better than this is no joint, m an axis.
const LOOSEST_M: f64 = 0.04;
/// Skin and straps are never better than this, m an axis.
const TIGHTEST_M: f64 = 0.003;
/// The median of the sum of three squared normal numbers.
const MEDIAN_OF_SQUARES: f64 = 2.366;
/// Sensors of the smallest tree that knows which of its sensors is wrong.
const TREE: usize = 3;

/// Joints of a recording and its own lever arms, joint by joint; `here` is where a sensor is, on the clean side, if it is believed.
pub(in crate::fault_map) fn learn(
    frames: &Frames,
    here: impl Fn(usize, usize) -> Option<Point>,
) -> (Joints, Vec<Vector6<f64>>) {
    let sensors = frames.sensors.len();
    let stride = frames.len().div_ceil(MOST_FRAMES).max(1);
    let pose = |k: usize, sensor: usize| {
        Some(Pose { position: here(k, sensor)?.into(), ..Pose::of(frames.frame(k), sensor)? })
    };
    let poses: Vec<Vec<Option<Pose>>> = (0..sensors)
        .map(|sensor| (0..frames.len()).step_by(stride).map(|k| pose(k, sensor)).collect())
        .collect();
    let mut found = Vec::new();
    for a in 0..sensors {
        for b in a + 1..sensors {
            let both = poses[a].iter().zip(&poses[b]);
            let rows: Vec<(Pose, Pose)> = both.filter_map(|(a, b)| (*a).zip(*b)).collect();
            if rows.len() >= LEAST_FRAMES {
                found.extend(Pair::learn(&rows).and_then(|pair| pair.joint(a, b)));
            }
        }
    }
    found.sort_by(|x, y| x.loose_m2.total_cmp(&y.loose_m2));
    forest(sensors, &found)
}

/// A pair that has a joint.
struct Found {
    joint: Joint,
    arms: Vector6<f64>,
    /// Its usual variance, by which it is chosen.
    loose_m2: f64,
}

/// What is known of a pair of sensors.
struct Pair {
    arms: Vector6<f64>,
    variance_m2: f64,
    variance_per_m8: f64,
    usual_far_m8: f64,
}

/// Sums for least squares.
#[derive(Clone, Copy)]
struct Sums {
    square: Matrix6<f64>,
    product: Vector6<f64>,
}

impl Sums {
    fn nothing() -> Self {
        Self { square: Matrix6::zeros(), product: Vector6::zeros() }
    }

    fn solve(&self) -> Option<Vector6<f64>> {
        self.square.cholesky().map(|root| root.solve(&self.product))
    }
}

impl Pair {
    fn learn(rows: &[(Pose, Pose)]) -> Option<Self> {
        let fars: Vec<f64> = rows.iter().map(|(a, b)| far(a) + far(b)).collect();
        let mut pair = Self {
            arms: Vector6::zeros(),
            variance_m2: LOOSEST_M * LOOSEST_M,
            variance_per_m8: 0.0,
            usual_far_m8: quantile(&mut fars.clone(), 0.5),
        };
        let mut left_m2: Option<Vec<f64>> = None;
        for _ in 0..ROUNDS {
            let mut parts = [Sums::nothing(); PARTS];
            for (k, (a, b)) in rows.iter().enumerate() {
                let variance = pair.variance_m2 + pair.variance_per_m8 * fars[k];
                if left_m2.as_ref().is_some_and(|left| left[k] > 3.0 * TRIM * TRIM * variance) {
                    continue;
                }
                let h = turned(a, b);
                let sums = &mut parts[k * PARTS / rows.len()];
                sums.square += h.transpose() * h / variance;
                sums.product += h.transpose() * (b.position - a.position) / variance;
            }
            let mut all = Sums {
                square: Matrix6::identity() * (FRAMES_PER_WORD / (UNKNOWN_M * UNKNOWN_M)),
                product: Vector6::zeros(),
            };
            for part in &parts {
                all.square += part.square;
                all.product += part.product;
            }
            pair.arms = all.solve()?;
            let mut left = Vec::with_capacity(rows.len());
            for (number, part) in parts.iter().enumerate() {
                let others = Sums { square: all.square - part.square, product: all.product - part.product };
                let arms = others.solve()?;
                let of_part = rows.iter().enumerate().filter(|(k, _)| k * PARTS / rows.len() == number);
                left.extend(of_part.map(|(_, (a, b))| left_over(a, b, &arms).norm_squared()));
            }
            pair.spread(&left, &fars);
            left_m2 = Some(left);
        }
        Some(pair)
    }

    /// Variances by what is left over near and far.
    fn spread(&mut self, left_m2: &[f64], fars: &[f64]) {
        let [near, away] = [0.3, 0.8].map(|share| quantile(&mut fars.to_vec(), share));
        let of = |which: &dyn Fn(f64) -> bool| {
            let rows = || left_m2.iter().zip(fars).filter(|(_, far)| which(**far));
            let mut squares: Vec<f64> = rows().map(|(left, _)| *left).collect();
            let mean_far = rows().map(|(_, far)| far).sum::<f64>() / squares.len().max(1) as f64;
            (quantile(&mut squares, 0.5) / MEDIAN_OF_SQUARES, mean_far)
        };
        let (low, far_low) = of(&|far| far <= near);
        let (high, far_high) = of(&|far| far >= away);
        let slope = (high - low) / (far_high - far_low);
        self.variance_per_m8 = if slope.is_finite() { slope.max(0.0) } else { 0.0 };
        self.variance_m2 = (low - self.variance_per_m8 * far_low).max(TIGHTEST_M * TIGHTEST_M);
    }

    fn joint(self, a: usize, b: usize) -> Option<Found> {
        let Self { arms, variance_m2, variance_per_m8, usual_far_m8 } = self;
        let loose_m2 = variance_m2 + variance_per_m8 * usual_far_m8;
        let joint = Joint { a, b, variance_m2, variance_per_m8 };
        (loose_m2 < LOOSEST_M * LOOSEST_M).then_some(Found { joint, arms, loose_m2 })
    }
}

/// The tightest joints that make no ring, in trees large enough, from their roots on.
fn forest(sensors: usize, found: &[Found]) -> (Joints, Vec<Vector6<f64>>) {
    let mut tree: Vec<usize> = (0..sensors).collect();
    let mut kept: Vec<&Found> = Vec::new();
    for one in found {
        let (a, b) = (tree[one.joint.a], tree[one.joint.b]);
        if a != b {
            tree.iter_mut().filter(|number| **number == b).for_each(|number| *number = a);
            kept.push(one);
        }
    }
    let (mut joints, mut arms) = (Vec::new(), Vec::new());
    let mut is_reached = vec![false; sensors];
    for root in 0..sensors {
        let size = tree.iter().filter(|number| **number == tree[root]).count();
        if size < TREE || is_reached[root] {
            continue;
        }
        is_reached[root] = true;
        let mut open = std::collections::VecDeque::from([root]);
        while let Some(a) = open.pop_front() {
            for one in &kept {
                let Joint { a: first, b: second, .. } = one.joint;
                let b = match a {
                    _ if first == a => second,
                    _ if second == a => first,
                    _ => continue,
                };
                if std::mem::replace(&mut is_reached[b], true) {
                    continue;
                }
                let own = one.arms;
                let swapped = Vector6::new(own[3], own[4], own[5], own[0], own[1], own[2]);
                arms.push(if first == a { own } else { swapped });
                joints.push(Joint { a, b, ..one.joint });
                open.push_back(b);
            }
        }
    }
    (Joints(joints), arms)
}
