//! Recorded people: the simulated person does what they did.
//!
//! ```text
//! BVH, CSV ──> recording ──> stand (axes, unit, hips) ──> fit (turns of segments) ──> 40 a second, joined in a ring ──> spline ──> posture(t)
//! ```
//! In: files of joints. Out: a [`Posture`] at any time, of a body in the recorded proportions and of the height that is given, with four continuous
//! derivatives; so truth is exactly what sensors feel. It keeps no more than the recording shows: a table's forearms, hands and gaze follow their neighbours.

mod bvh;
mod fit;
mod knot;
mod names;
mod recording;
mod stand;
mod table;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

pub use names::Joint;
pub use recording::{Recording, TakeError};

use super::kinematics::{ANKLE_M, Build, Posture, about_z};
use crate::ease::step;
use fit::fit;
use knot::{Knot, Move};
use recording::{Clip, Frame};

/// Knots a second: a spline of fifth degree over them passes movements of 7 Hz by half of their power, and noise above not.
const KNOTS_HZ: f64 = 40.0;
/// Where one clip goes over into the next: knots, and no more than this share of the shorter.
const SEAM: usize = 32;
const SEAM_SHARE: f64 = 0.33;
/// A clip is no shorter, s.
const SHORTEST_S: f64 = 0.5;
/// For so long somebody who stands goes over into the movement, s.
const BEGIN_S: f64 = 1.5;

/// Recorded people, one after the other, again and again. The same recordings give the same movement.
#[derive(Clone, Debug, PartialEq)]
pub struct Take {
    build: Build,
    /// Control points of the splines; after the last comes the first, moved by `lap`.
    knots: Vec<Knot>,
    lap: Move,
    stands: Knot,
    /// Knots in which one clip goes over into the next, in order; the first ones are those in which the last clip goes over into the first.
    seams: Vec<Range<usize>>,
}

impl Take {
    /// Reads files, relative to `folder`, for a body of that height, m; `rate_hz`: frames per second of tables without a column of times.
    ///
    /// # Errors
    /// A file cannot be read, or holds no person; the error names the file, and the line or the joint.
    pub fn read(
        files: &[PathBuf],
        folder: &Path,
        rate_hz: Option<f64>,
        height_m: f64,
    ) -> Result<Self, TakeError> {
        let read = |file: &PathBuf| Recording::read(&folder.join(file), rate_hz);
        Self::new(files.iter().map(read).collect::<Result<_, _>>()?, height_m)
    }

    /// Joins recordings of a body of that height, m, in the mean of their proportions.
    ///
    /// # Errors
    /// There is none, or one holds no person, or less than half a second of one.
    pub fn new(recordings: Vec<Recording>, height_m: f64) -> Result<Self, TakeError> {
        let mut builds = Vec::new();
        let mut clips: Vec<Vec<Knot>> = Vec::new();
        for mut recording in recordings {
            recording.clips = recording.clips.iter().filter_map(resampled).collect();
            if recording.clips.is_empty() {
                return Err(TakeError::Figure {
                    path: recording.path,
                    problem: format!("expected at least {SHORTEST_S} s of movement"),
                });
            }
            builds.push(recording.stand(height_m)?);
            clips.extend(on_floor(fit(&recording), &builds[builds.len() - 1]));
        }
        let build = mean(&builds).ok_or_else(|| TakeError::Figure {
            path: PathBuf::new(),
            problem: "no recording to follow".to_owned(),
        })?;
        let stands = Knot::standing(Vector3::z() * (build.thigh_m + build.shank_m + ANKLE_M));
        let mut knots: Vec<Knot> = Vec::new();
        let mut seams = Vec::new();
        for clip in clips {
            let seam = seam(knots.len(), clip.len());
            let onto = match knots.len().checked_sub(seam) {
                Some(begin) if seam > 0 => Move::between(&clip[seam / 2], &knots[begin + seam / 2]),
                _ => Move::between(&clip[0], &stands),
            };
            let begin = knots.len() - seam;
            seams.push(begin..knots.len());
            for (index, knot) in clip.iter().enumerate() {
                let knot = onto.of(knot);
                match knots.get_mut(begin + index) {
                    Some(last) => *last = crossed(last, &knot, index, seam),
                    None => knots.push(knot),
                }
            }
        }
        // From the end to the beginning.
        let seam = seam(knots.len(), knots.len());
        let tail = knots.split_off(knots.len() - seam);
        let lap = Move::between(&knots[seam / 2], &tail[seam / 2]);
        let back = lap.inverse();
        for (index, (knot, tail)) in knots.iter_mut().zip(&tail).enumerate() {
            *knot = crossed(&back.of(tail), knot, index, seam);
        }
        seams[0] = 0..seam;
        Ok(Self { build, knots, lap, stands, seams })
    }

    /// Lengths of the body.
    pub fn build(&self) -> Build {
        self.build
    }

    /// After how long it begins again, s.
    pub fn duration_s(&self) -> f64 {
        self.knots.len() as f64 / KNOTS_HZ
    }

    /// The posture at a time, s: before 0 somebody stands in an N-pose above the room's origin and looks along x, who then goes over into the movement within 1.5 s.
    pub fn at(&self, t_s: f64) -> Posture {
        let moved = self.share(t_s);
        if moved == 0.0 {
            return self.stands.posture();
        }
        let at = t_s * KNOTS_HZ;
        let (base, rest) = (at.floor(), at - at.floor());
        let count = self.knots.len() as i64;
        let first = base as i64 - 2;
        let lap = first.div_euclid(count);
        let window: [Knot; 6] = std::array::from_fn(|k| {
            let index = first + k as i64;
            let knot = &self.knots[index.rem_euclid(count) as usize];
            self.lap.repeated((index.div_euclid(count) - lap).unsigned_abs()).of(knot)
        });
        let knot = Knot::mean(quintic(rest).into_iter().zip(&window));
        let laps = self.lap.repeated(lap.unsigned_abs());
        let knot = (if lap < 0 { laps.inverse() } else { laps }).of(&knot);
        if moved == 1.0 {
            return knot.posture();
        }
        Knot::mean([(1.0 - moved, &self.stands), (moved, &knot)]).posture()
    }

    /// Which clip the movement follows at a time, s, from 0; `None` where it goes over from one to the next, or is not begun: there feet slide that stand.
    pub fn clip(&self, t_s: f64) -> Option<usize> {
        // Control points of the spline at that time.
        let first = (t_s * KNOTS_HZ).floor() as i64 - 2;
        let count = self.knots.len() as i64;
        let seamless = |knot: i64| {
            let knot = knot.rem_euclid(count) as usize;
            let clip = self.seams.partition_point(|seam| seam.start <= knot) - 1;
            (!self.seams[clip].contains(&knot)).then_some(clip)
        };
        let clip = seamless(first)?;
        (self.share(t_s) == 1.0 && seamless(first + 5) == Some(clip)).then_some(clip)
    }

    /// Whether heel and ball of the right and of the left foot stand: see [`Build::standing`].
    pub fn standing(&self, t_s: f64) -> [[bool; 2]; 2] {
        self.build.standing(|t_s| self.at(t_s).place(&self.build), t_s, 0.0)
    }

    /// The same of somebody who looks that way at first, rad to the left of the room's x.
    pub fn facing(&self, heading_rad: f64, t_s: f64) -> Posture {
        let mut posture = self.at(t_s);
        posture.pelvis[0] += heading_rad;
        posture.pelvis_m = about_z(heading_rad) * posture.pelvis_m;
        posture
    }

    /// How far somebody who stood has gone over into the movement, 0 to 1.
    pub fn share(&self, t_s: f64) -> f64 {
        step(t_s / BEGIN_S)
    }
}

/// A clip at the times of the knots: means over triangles as wide as the frames or the knots lie apart. `None`: it is too short.
fn resampled(clip: &Clip) -> Option<Clip> {
    let (first, last) = (*clip.t_s.first()?, *clip.t_s.last()?);
    if last - first < SHORTEST_S {
        return None;
    }
    let apart_s = ((last - first) / (clip.t_s.len() - 1) as f64).max(1.0 / KNOTS_HZ);
    let count = ((last - first) * KNOTS_HZ) as usize;
    let mut out = Clip::default();
    for index in 0..=count {
        let t_s = first + index as f64 / KNOTS_HZ;
        let begin = clip.t_s.partition_point(|at| *at <= t_s - apart_s);
        let end = clip.t_s.partition_point(|at| *at < t_s + apart_s);
        let mut weights: Vec<(f64, &Frame)> =
            (begin..end).map(|at| (1.0 - (clip.t_s[at] - t_s).abs() / apart_s, &clip.frames[at])).collect();
        if weights.len() < 2 {
            // In a gap: straight on.
            let after = clip.t_s.partition_point(|at| *at <= t_s).clamp(1, clip.t_s.len() - 1);
            let part = (t_s - clip.t_s[after - 1]) / (clip.t_s[after] - clip.t_s[after - 1]);
            weights = vec![(1.0 - part, &clip.frames[after - 1]), (part, &clip.frames[after])];
        }
        let sum: f64 = weights.iter().map(|(weight, _)| weight).sum();
        weights.iter_mut().for_each(|(weight, _)| *weight /= sum);
        out.t_s.push(t_s);
        out.frames.push(Frame::mean(&weights));
    }
    Some(out)
}

/// Puts a recording's lowest soles on the floor; a few frames may lie below it.
fn on_floor(mut clips: Vec<Vec<Knot>>, build: &Build) -> Vec<Vec<Knot>> {
    let mut lowest: Vec<f64> = clips
        .iter()
        .flatten()
        .map(|knot| {
            let soles = build.soles_m(&knot.posture().place(build));
            soles.iter().flatten().map(|at_m| at_m.z).fold(f64::INFINITY, f64::min)
        })
        .collect();
    lowest.sort_by(f64::total_cmp);
    let floor_m = lowest[lowest.len() / 50];
    clips.iter_mut().flatten().for_each(|knot| knot.pelvis_m.z -= floor_m);
    clips
}

fn seam(before: usize, next: usize) -> usize {
    SEAM.min((SEAM_SHARE * before.min(next) as f64) as usize)
}

/// From the one to the other in the course of a seam.
fn crossed(from: &Knot, to: &Knot, index: usize, seam: usize) -> Knot {
    let share = step((index as f64 + 0.5) / seam as f64);
    Knot::mean([(1.0 - share, from), (share, to)])
}

/// Weights of six control points of a uniform B-spline of fifth degree, so far behind the third.
fn quintic(x: f64) -> [f64; 6] {
    // Cox and de Boor's recursion for uniform knots.
    let mut weights = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    for degree in 1..=5_usize {
        for k in 0..6 {
            let own = weights[k];
            let next = weights.get(k + 1).copied().unwrap_or(0.0);
            // Distance of x from the beginning of the k-th piece of this degree.
            let from = x + 5.0 - k as f64;
            let degree = degree as f64;
            weights[k] = (from * own + (degree + 1.0 - from) * next) / degree;
        }
    }
    weights
}

/// The value in the middle; there is at least one.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn mean(builds: &[Build]) -> Option<Build> {
    let mean = |of: fn(&Build) -> f64| builds.iter().map(of).sum::<f64>() / builds.len() as f64;
    (!builds.is_empty()).then(|| Build {
        shoulder_width_m: mean(|build| build.shoulder_width_m),
        hip_width_m: mean(|build| build.hip_width_m),
        trunk_m: mean(|build| build.trunk_m),
        head_m: mean(|build| build.head_m),
        upper_arm_m: mean(|build| build.upper_arm_m),
        forearm_m: mean(|build| build.forearm_m),
        hand_m: mean(|build| build.hand_m),
        thigh_m: mean(|build| build.thigh_m),
        shank_m: mean(|build| build.shank_m),
        girdle: false,
    })
}
