//! From points to how every segment is turned: one [`Knot`] for each frame of a clip.
//!
//! Segments point where they were recorded to point; lengths are the body's own. What points do not show follows from the joints: knees and elbows are
//! hinges, whose axes are seen while they are bent; a straight leg is turned as its foot, a straight arm as the trunk. Feet roll with their shanks. A table does not show how
//! forearms are turned, nor hands, nor which way the head looks: these follow their neighbours.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::knot::Knot;
use super::median;
use super::names::Joint;
use super::recording::{Clip, Frame, Recording};
use crate::body::kinematics::{about_x, about_y, about_z};

/// How much what a hinge was before counts beside a limb that is bent by a right angle, and how bent it is where that fades (sine).
const STRAIGHT: f64 = 0.3;
const FADES: f64 = 0.2;
/// Of that, so much is where the hinge of a straight limb should be, frame by frame.
const USUAL: f64 = 0.05;

/// Axes of all segments at one time, columns forward, up, right.
struct Axes {
    pelvis: Matrix3<f64>,
    torso: Matrix3<f64>,
    head: Matrix3<f64>,
    arm: [Matrix3<f64>; 2],
    elbow: [[f64; 2]; 2],
    wrist: [[f64; 2]; 2],
    thigh: [Matrix3<f64>; 2],
    knee: [f64; 2],
    foot: [Matrix3<f64>; 2],
}

/// What stays the same in a recording: how its points sit on somebody who looks ahead and stands flat.
struct Neutral {
    spine: f64,
    neck: f64,
    feet: [f64; 2],
}

/// All clips of a recording that stands upright in metres. The feet's lowest point is not on the floor yet.
pub(super) fn fit(recording: &Recording) -> Vec<Vec<Knot>> {
    let neutral = Neutral::of(recording);
    recording.clips.iter().map(|clip| Fitter::new(recording).clip(clip, &neutral)).collect()
}

impl Neutral {
    fn of(recording: &Recording) -> Self {
        let none = Self { spine: 0.0, neck: 0.0, feet: [0.0; 2] };
        let raw: Vec<Axes> = recording
            .clips
            .iter()
            .flat_map(|clip| {
                let mut fitter = Fitter::new(recording);
                clip.frames.iter().map(|frame| fitter.axes(frame, &none)).collect::<Vec<_>>()
            })
            .collect();
        let spine = median(raw.iter().map(|axes| zxy(&(axes.pelvis.transpose() * axes.torso))[0]));
        let neck = median(raw.iter().map(|axes| zxy(&(axes.torso.transpose() * axes.head))[0]));
        // Who is low with an ankle stands on that foot.
        let feet = [0, 1].map(|side| {
            let mut heights: Vec<(f64, f64)> = recording
                .frames()
                .zip(&raw)
                .map(|(frame, axes)| (frame.at(Joint::Ankle(side)).z, axes.foot[side][(2, 0)]))
                .collect();
            heights.sort_by(|a, b| a.0.total_cmp(&b.0));
            heights.truncate(heights.len().div_ceil(3));
            -libm::asin(median(heights.into_iter().map(|(_, pitch)| pitch)).clamp(-1.0, 1.0))
        });
        Self { spine, neck, feet }
    }
}

/// Goes from frame to frame of a clip.
struct Fitter {
    head: [bool; 2],
    spine: bool,
    balls: bool,
    /// Hinges of the frame before: elbows, knees; room.
    hinges: [[Option<Vector3<f64>>; 2]; 2],
}

impl Fitter {
    fn new(recording: &Recording) -> Self {
        Self {
            head: [recording.has(Joint::Neck), recording.has(Joint::Head)],
            spine: recording.has(Joint::Spine),
            balls: recording.has(Joint::Ball(0)) && recording.has(Joint::Ball(1)),
            hinges: [[None; 2]; 2],
        }
    }

    fn clip(mut self, clip: &Clip, neutral: &Neutral) -> Vec<Knot> {
        clip.frames.iter().map(|frame| self.axes(frame, neutral).knot(frame.middle(Joint::Hip))).collect()
    }

    fn axes(&mut self, frame: &Frame, neutral: &Neutral) -> Axes {
        let (hips, shoulders) = (frame.middle(Joint::Hip), frame.middle(Joint::Shoulder));
        let trunk = shoulders - hips;
        let above = if self.spine { frame.at(Joint::Spine) - hips } else { trunk };
        let across = frame.across(Joint::Hip);
        // Hips are exactly to the right, shoulders exactly above.
        let right = across.normalize();
        let up = (above - right * right.dot(&above)).normalize();
        let pelvis = Matrix3::from_columns(&[up.cross(&right), up, right]) * about_z(neutral.spine);
        let torso = upward(trunk, frame.across(Joint::Shoulder));
        let head = match (&frame.turns, self.head) {
            (Some([head, ..]), _) => head.to_rotation_matrix().into_inner(),
            (None, [true, true]) => {
                let up = frame.at(Joint::Head) - frame.at(Joint::Neck);
                let head = upward(up, torso.column(2).into_owned());
                torso * about_z(-neutral.neck) * torso.transpose() * head
            }
            _ => torso,
        };
        let mut axes = Axes {
            pelvis,
            torso,
            head,
            arm: [torso; 2],
            elbow: [[0.0; 2]; 2],
            wrist: [[0.0; 2]; 2],
            thigh: [pelvis; 2],
            knee: [0.0; 2],
            foot: [pelvis; 2],
        };
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let upper = frame.at(Joint::Shoulder(side)) - frame.at(Joint::Elbow(side));
            let lower = frame.at(Joint::Elbow(side)) - frame.at(Joint::Wrist(side));
            // A straight arm is turned as if it had been raised from where it hangs.
            let raised =
                Rotation3::rotation_between(&torso.column(1), &upper).unwrap_or_else(Rotation3::identity);
            let usual = raised * torso.column(2);
            let hinge = hinge_axis(&mut self.hinges[0][side], upper, lower, usual);
            let arm = upward(upper, hinge);
            let bent = arm.transpose() * lower;
            let flexion = libm::atan2(-bent.x, bent.y);
            axes.arm[side] = arm;
            axes.elbow[side][0] = flexion;
            if let Some([_, hands @ ..]) = &frame.turns {
                let hand = hands[side].to_rotation_matrix().into_inner();
                let [pronation, bend, deviation] = yxz(&((arm * about_z(flexion)).transpose() * hand));
                axes.elbow[side][1] = sign * pronation;
                axes.wrist[side] = [sign * bend, -deviation];
            }
            let upper = frame.at(Joint::Hip(side)) - frame.at(Joint::Knee(side));
            let lower = frame.at(Joint::Knee(side)) - frame.at(Joint::Ankle(side));
            let toes = if self.balls {
                (frame.at(Joint::Ball(side)) - frame.at(Joint::Ankle(side))).normalize()
            } else {
                Vector3::zeros()
            };
            let usual = toes.cross(&Vector3::z()) + right * 0.3;
            let hinge = hinge_axis(&mut self.hinges[1][side], lower, upper, usual);
            let thigh = upward(upper, hinge);
            let bent = thigh.transpose() * lower;
            axes.thigh[side] = thigh;
            axes.knee[side] = libm::atan2(bent.x, bent.y);
            let across = thigh.column(2).into_owned();
            axes.foot[side] = if self.balls {
                let toes = toes.normalize();
                let across = (across - toes * toes.dot(&across)).normalize();
                Matrix3::from_columns(&[toes, across.cross(&toes), across]) * about_z(neutral.feet[side])
            } else {
                upward(Vector3::z(), across)
            };
        }
        axes
    }
}

/// The axis of a hinge about which the first of two limbs turns into the second one: what they show, and where it was; room.
fn hinge_axis(
    last: &mut Option<Vector3<f64>>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    usual: Vector3<f64>,
) -> Vector3<f64> {
    let (first, second) = (first.normalize(), second.normalize());
    let shown = first.cross(&second);
    let straight = STRAIGHT * libm::exp(-(shown.norm() / FADES).powi(2));
    let usual = usual.try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
    let before = last.map_or(usual, |last| (last * (1.0 - USUAL) + usual * USUAL).normalize());
    let axis = (shown + before * straight).try_normalize(1e-9).unwrap_or(before);
    *last = Some(axis);
    axis
}

/// Axes of a segment that goes up this way, with its right as near to that as can be.
pub(super) fn upward(up: Vector3<f64>, right: Vector3<f64>) -> Matrix3<f64> {
    let up = up.normalize();
    let right = (right - up * up.dot(&right)).try_normalize(1e-9).unwrap_or_else(|| {
        let other = Vector3::ith(up.iamin(), 1.0);
        (other - up * up.dot(&other)).normalize()
    });
    Matrix3::from_columns(&[up.cross(&right), up, right])
}

impl Axes {
    fn knot(&self, pelvis_m: Vector3<f64>) -> Knot {
        let shank = [0, 1].map(|side| self.thigh[side] * about_z(-self.knee[side]));
        Knot::new(
            pelvis_m,
            [
                self.pelvis,
                self.pelvis.transpose() * self.torso,
                self.torso.transpose() * self.head,
                self.torso.transpose() * self.arm[0],
                self.torso.transpose() * self.arm[1],
                self.pelvis.transpose() * self.thigh[0],
                self.pelvis.transpose() * self.thigh[1],
                shank[0].transpose() * self.foot[0],
                shank[1].transpose() * self.foot[1],
            ],
            [
                self.knee[0],
                self.knee[1],
                self.elbow[0][0],
                self.elbow[0][1],
                self.elbow[1][0],
                self.elbow[1][1],
                self.wrist[0][0],
                self.wrist[0][1],
                self.wrist[1][0],
                self.wrist[1][1],
            ],
        )
    }
}

/// Angles of R_z R_x R_y.
pub(super) fn zxy(m: &Matrix3<f64>) -> [f64; 3] {
    let z = libm::atan2(-m[(0, 1)], m[(1, 1)]);
    let m = about_z(-z) * m;
    let x = libm::atan2(m[(2, 1)], m[(1, 1)]);
    let m = about_x(-x) * m;
    [z, x, libm::atan2(m[(0, 2)], m[(0, 0)])]
}

/// Angles of R_y R_x R_z.
pub(super) fn yxz(m: &Matrix3<f64>) -> [f64; 3] {
    let y = libm::atan2(m[(0, 2)], m[(2, 2)]);
    let m = about_y(-y) * m;
    let x = libm::atan2(-m[(1, 2)], m[(2, 2)]);
    let m = about_x(-x) * m;
    [y, x, libm::atan2(m[(1, 0)], m[(0, 0)])]
}

/// Angles of R_y R_z R_x.
pub(super) fn yzx(m: &Matrix3<f64>) -> [f64; 3] {
    let y = libm::atan2(-m[(2, 0)], m[(0, 0)]);
    let m = about_y(-y) * m;
    let z = libm::atan2(m[(1, 0)], m[(0, 0)]);
    let m = about_z(-z) * m;
    [y, z, libm::atan2(m[(2, 1)], m[(1, 1)])]
}
