//! From joint angles to where every segment is.
//!
//! Rotations are products of elementary matrices, written out from the table; left limbs have their own signs.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Names of the body segments, in the order of all arrays here; `_r` is the right side, `_l` the left.
pub const SEGMENT_NAMES: [&str; SEGMENTS] = [
    "torso",
    "pelvis",
    "upper_arm_r",
    "forearm_r",
    "thigh_r",
    "shank_r",
    "upper_arm_l",
    "forearm_l",
    "thigh_l",
    "shank_l",
    "head",
    "hand_r",
    "foot_r",
    "hand_l",
    "foot_l",
    "shoulder_r",
    "shoulder_l",
];

/// How many segments there are.
pub const SEGMENTS: usize = 17;

/// Lengths of a body, m, and whether its shoulders move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Build {
    /// Between the shoulders.
    pub shoulder_width_m: f64,
    /// Between the centres of the hips' joints.
    pub hip_width_m: f64,
    /// From hips to shoulders.
    pub trunk_m: f64,
    /// From the shoulders to the top of the head.
    pub head_m: f64,
    /// Shoulder to elbow.
    pub upper_arm_m: f64,
    /// Elbow to wrist.
    pub forearm_m: f64,
    /// Wrist to finger tips.
    pub hand_m: f64,
    /// Hip to knee.
    pub thigh_m: f64,
    /// Knee to ankle.
    pub shank_m: f64,
    /// Whether collar bones and shoulder blades move, as [`Posture::girdle`] says and with arms that are raised; else they go with the chest.
    pub girdle: bool,
}

impl Build {
    /// The lengths of a body of this height, m, in the proportions of Drillis and Contini (1966).
    pub fn of_height(height_m: f64) -> Self {
        Self {
            shoulder_width_m: 0.258 * height_m,
            hip_width_m: 0.1 * height_m,
            trunk_m: 0.288 * height_m,
            head_m: 0.182 * height_m,
            upper_arm_m: 0.186 * height_m,
            forearm_m: 0.146 * height_m,
            hand_m: 0.108 * height_m,
            thigh_m: 0.245 * height_m,
            shank_m: 0.246 * height_m,
            girdle: false,
        }
    }
}

/// From the middle to the root of a shoulder, of half the distance between the arms' joints.
const SHOULDER_ROOT: f64 = 0.14;
/// What a collar bone does with its arm, about as Ludewig et al. (2009) measured, rad: overhead it has risen and turned backwards about itself by so much, half of it where the
/// arm is level, and it goes ahead or back by so much where a level arm points forward or to the side.
const RISES_RAD: f64 = 0.21;
const ROLLS_RAD: f64 = 0.5;
const AHEAD_RAD: f64 = 0.2;
const BACK_RAD: f64 = 0.2;
/// Height of the ankles of somebody who stands, m.
pub(super) const ANKLE_M: f64 = 0.07;
/// From the ankle to the ball and to the heel along the sole, and down to it, of the legs' length.
pub(super) const BALL: f64 = 0.125;
pub(super) const HEEL: f64 = 0.057;
pub(super) const ANKLE: f64 = 0.08;
/// What stands moves by less, m, within 0.1 s, and is no further from the floor.
const STANDS_M: f64 = 0.004;
const NEAR_M: f64 = 0.03;

impl Build {
    /// Heel and ball on the soles of the right and the left foot, room, m.
    pub fn soles_m(&self, body: &TrueBody) -> [[Vector3<f64>; 2]; 2] {
        let leg_m = self.thigh_m + self.shank_m;
        [12, 14].map(|foot| {
            [-HEEL, BALL]
                .map(|ahead| body[foot].origin_m + body[foot].axes * Vector3::new(ahead, -ANKLE, 0.0) * leg_m)
        })
    }

    /// Whether heel and ball of the right and of the left foot stand at a time, s, in a movement: each moves by less than 4 mm within 0.1 s, and is less than 3 cm above
    /// a floor at that height, m.
    pub fn standing(&self, movement: impl Fn(f64) -> TrueBody, t_s: f64, floor_m: f64) -> [[bool; 2]; 2] {
        let [before_m, now_m, after_m] = [-0.05, 0.0, 0.05].map(|dt_s| self.soles_m(&movement(t_s + dt_s)));
        [0, 1].map(|side| {
            [0, 1].map(|end| {
                let moved_m = (after_m[side][end] - before_m[side][end]).norm();
                moved_m < STANDS_M && now_m[side][end].z < floor_m + NEAR_M
            })
        })
    }
}

/// Where the pelvis is in the room, and the angles of all joints, rad, signs as in the table of `docs/body.md`; index 0 is the
/// right side, 1 the left. The default has all angles zero: the N-pose of a person who looks along the room's x.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Posture {
    /// Mid-point of the hips in the room (z up), m.
    pub pelvis_m: Vector3<f64>,
    /// Pelvis, rad: heading to the left of the room's x; forward tilt; list to the right.
    pub pelvis: [f64; 3],
    /// Torso against the pelvis, rad: flexion, lateral flexion, rotation.
    pub spine: [f64; 3],
    /// Head against the torso, rad: flexion, lateral flexion, rotation.
    pub neck: [f64; 3],
    /// Collar bone and shoulder blade against the torso, rad: protraction, elevation, rotation backwards; besides what they do with the arm, and where a [`Build`]'s shoulders
    /// move.
    pub girdle: [[f64; 3]; 2],
    /// Upper arm against the torso, rad: plane of elevation, elevation, rotation.
    pub shoulder: [[f64; 3]; 2],
    /// How a raised shoulder departs from those, about its x and z, rad; smooth where the arm hangs, unlike plane and elevation.
    pub shoulder_lean: [[f64; 2]; 2],
    /// Forearm against the upper arm, rad: flexion, pronation.
    pub elbow: [[f64; 2]; 2],
    /// Hand against the forearm, rad: flexion, ulnar deviation.
    pub wrist: [[f64; 2]; 2],
    /// Thigh against the pelvis, rad: flexion, adduction, rotation.
    pub hip: [[f64; 3]; 2],
    /// Shank against the thigh, rad: knee flexion.
    pub knee: [f64; 2],
    /// Foot against the shank, rad: dorsiflexion, inversion, rotation inwards.
    pub ankle: [[f64; 3]; 2],
}

/// Where a segment is in the room (z up). The origin is the proximal joint of a limb's segment, of head, hand, foot and shoulder, the mid-point of the hips for the
/// pelvis, and the middle between hips and shoulders for the torso.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Segment to room: a rotation whose columns are forward, up and right of a person in the N-pose.
    pub axes: Matrix3<f64>,
    /// Origin in the room, m.
    pub origin_m: Vector3<f64>,
}

impl Placement {
    /// Segment to room.
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        quaternion(self.axes)
    }
}

/// Of a rotation.
pub(super) fn quaternion(axes: Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// All segments, in the order of [`SEGMENT_NAMES`].
pub type TrueBody = [Placement; SEGMENTS];

pub(super) fn about_x(angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

pub(super) fn about_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

pub(super) fn about_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

/// Axes (forward, up, right) of what stands upright and looks so far to the left of the room's x (z up), rad.
pub(super) fn upright(heading_rad: f64) -> Matrix3<f64> {
    about_z(heading_rad) * Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0)
}

impl Posture {
    /// Pelvis to room.
    pub(super) fn pelvis_axes(&self) -> Matrix3<f64> {
        let [rotation, tilt, list] = self.pelvis;
        upright(rotation) * about_z(-tilt) * about_x(list)
    }

    /// Thigh and shank to room below a pelvis with these axes; `sign` is 1 on the right and -1 on the left.
    fn leg_axes(&self, side: usize, sign: f64, pelvis: &Matrix3<f64>) -> [Matrix3<f64>; 2] {
        let [flexion, adduction, rotation] = self.hip[side];
        let thigh = pelvis * about_z(flexion) * about_x(sign * adduction) * about_y(sign * rotation);
        [thigh, thigh * about_z(-self.knee[side])]
    }

    /// Turns an ankle so that the foot has these axes in the room.
    pub(super) fn plant(&mut self, side: usize, foot: &Matrix3<f64>) {
        let sign = if side == 0 { 1.0 } else { -1.0 };
        let [_, shank] = self.leg_axes(side, sign, &self.pelvis_axes());
        let m = shank.transpose() * foot;
        self.ankle[side] = [
            libm::atan2(-m[(0, 1)], m[(1, 1)]),
            sign * libm::asin(m[(2, 1)].clamp(-1.0, 1.0)),
            sign * libm::atan2(-m[(2, 0)], m[(2, 2)]),
        ];
    }

    /// A collar bone's axes against the torso's.
    fn girdle_axes(&self, side: usize, sign: f64) -> Matrix3<f64> {
        let [plane, elevation, _] = self.shoulder[side];
        // Smooth where the arm hangs: from 0 there to 1 overhead, and how far the arm points forward and to the side.
        let raised = 0.5 - 0.5 * libm::cos(elevation);
        let [forward, sideways] =
            [libm::sin(plane), libm::cos(plane)].map(|part| part * libm::sin(elevation));
        let [protraction, lifted, rolled] = self.girdle[side];
        let protraction = protraction + AHEAD_RAD * forward - BACK_RAD * sideways;
        about_y(sign * protraction)
            * about_x(-sign * (lifted + RISES_RAD * raised))
            * about_z(rolled + ROLLS_RAD * raised)
    }

    /// Where every segment of a body of these lengths is in the room: rigid segments, joints without translation.
    pub fn place(&self, build: &Build) -> TrueBody {
        let pelvis = self.pelvis_axes();
        let [flexion, lateral, rotation] = self.spine;
        let torso = pelvis * about_z(-flexion) * about_x(lateral) * about_y(rotation);
        let hips_m = self.pelvis_m;
        let shoulders_m = hips_m + torso * Vector3::new(0.0, build.trunk_m, 0.0);
        let mut body = [Placement { axes: pelvis, origin_m: hips_m }; SEGMENTS];
        body[0] = Placement { axes: torso, origin_m: (hips_m + shoulders_m) * 0.5 };
        let [flexion, lateral, rotation] = self.neck;
        let head = torso * about_z(-flexion) * about_x(lateral) * about_y(rotation);
        body[10] = Placement { axes: head, origin_m: shoulders_m };
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let [plane, elevation, rotation] = self.shoulder[side];
            let [sideways, forward] = self.shoulder_lean[side];
            let lean = torso * about_x(-sign * sideways) * about_z(forward);
            let arm = lean * about_y(sign * plane) * about_x(-sign * elevation) * about_y(sign * rotation);
            let [flexion, pronation] = self.elbow[side];
            let forearm = arm * about_z(flexion) * about_y(sign * pronation);
            let half_m = sign * 0.5 * build.shoulder_width_m;
            let root = shoulders_m + torso * Vector3::new(0.0, 0.0, SHOULDER_ROOT * half_m);
            let (girdle, shoulder) = if build.girdle {
                let girdle = torso * self.girdle_axes(side, sign);
                (girdle, root + girdle * Vector3::new(0.0, 0.0, (1.0 - SHOULDER_ROOT) * half_m))
            } else {
                (torso, shoulders_m + torso * Vector3::new(0.0, 0.0, half_m))
            };
            body[15 + side] = Placement { axes: girdle, origin_m: root };
            let elbow = shoulder - arm * Vector3::new(0.0, build.upper_arm_m, 0.0);
            let [thigh, shank] = self.leg_axes(side, sign, &pelvis);
            let hip = hips_m + pelvis * Vector3::new(0.0, 0.0, sign * 0.5 * build.hip_width_m);
            let knee = hip - thigh * Vector3::new(0.0, build.thigh_m, 0.0);
            let [flexion, deviation] = self.wrist[side];
            let hand = forearm * about_x(sign * flexion) * about_z(-deviation);
            let wrist = elbow - forearm * Vector3::new(0.0, build.forearm_m, 0.0);
            let [flexion, inversion, rotation] = self.ankle[side];
            let foot = shank * about_z(flexion) * about_x(sign * inversion) * about_y(sign * rotation);
            let ankle = knee - shank * Vector3::new(0.0, build.shank_m, 0.0);
            body[11 + 2 * side] = Placement { axes: hand, origin_m: wrist };
            body[12 + 2 * side] = Placement { axes: foot, origin_m: ankle };
            let first = 2 + 4 * side;
            body[first] = Placement { axes: arm, origin_m: shoulder };
            body[first + 1] = Placement { axes: forearm, origin_m: elbow };
            body[first + 2] = Placement { axes: thigh, origin_m: hip };
            body[first + 3] = Placement { axes: shank, origin_m: knee };
        }
        body
    }
}
