//! A person who walks: footholds first, then the hips over them, then the legs by inverse kinematics.
//!
//! In: a [`Path`] and how many steps along it have been made. Out: the hips, the legs and the swing of the arms in a [`Posture`]. A foot
//! that stands does not slide: it lands on its heel, lies flat, and rolls over its ball. Positions have two continuous derivatives in time.
//! It knows no stage and no sensor, and there is nothing that it could trip over.

use nalgebra::Vector3;

use super::kinematics::{ANKLE, BALL, Build, HEEL, Posture, about_x, about_y, about_z, upright};
use super::script::raise;
use crate::ease::{minimum_jerk, step};

/// Where somebody walks, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Path {
    /// Length of a step, of the legs' length.
    pub step: f64,
    /// Turn of the way to the left, rad per m; 0: straight on.
    pub curvature_per_m: f64,
    /// By how much each foothold lies above the one before, m.
    pub rise_m: f64,
    /// The last step, which brings the feet beside each other; `None`: there is none.
    pub last: Option<i64>,
}

/// Steps per second, of everybody.
pub(super) const STEPS_HZ: f64 = 1.7;
/// Of a step, so long both feet stand.
const DOUBLE_SUPPORT: f64 = 0.22;
/// Before the other foot has landed the heel leaves the floor, steps; after the toe has left it goes on turning for so long.
const HEEL_OFF: f64 = 0.35;
const PUSH_OFF: f64 = 0.2;
/// So long before its heel lands the toe begins to fall, and so long after that the foot lies flat, steps.
const LOADING: [f64; 2] = [0.08, 0.15];
/// How far a foot is turned where its toe leaves, and its heel lands, rad.
const TOE_DOWN_RAD: f64 = 0.85;
const TOE_UP_RAD: f64 = 0.26;
/// Who walks puts the feet nearer to the way than who stands, of the hips' width.
const TRACK: [f64; 2] = [0.5, 0.35];

/// A place on the way: m, and the heading there, rad.
struct Station {
    at_m: Vector3<f64>,
    heading_rad: f64,
}

impl Path {
    /// The hips are over the first foothold until so many steps before the first.
    pub(super) const BEGIN: f64 = -1.0;
    /// And over the last one from so many steps after that on.
    pub(super) const END: f64 = 1.0;

    /// Once round a circle to the left in `last` steps, and back to where it began.
    pub(super) fn lap(step: f64, last: i64, build: &Build) -> Self {
        let way_m = (last as f64 - 1.5) * step * (build.thigh_m + build.shank_m);
        Self { step, curvature_per_m: std::f64::consts::TAU / way_m, rise_m: 0.0, last: Some(last) }
    }

    /// Adds to somebody who stands upright that `steps` have been made, from [`Self::BEGIN`] on, beginning with the right foot.
    pub(super) fn walk(&self, posture: &mut Posture, steps: f64, build: &Build) {
        let (from_m, facing) = (posture.pelvis_m, posture.pelvis[0]);
        let leg_m = build.thigh_m + build.shank_m;
        let ankle_m = from_m.z - leg_m;
        let into_room = |at_m: Vector3<f64>| from_m.xy().push(0.0) + about_z(facing) * at_m;
        // From standing to the full swing of everything, and back.
        let left = self.last.map_or(f64::INFINITY, |last| last as f64 + Self::END - steps);
        let grow = step((steps - Self::BEGIN) / 1.5) * step(left / 1.5);
        let swing = std::f64::consts::PI * steps;
        let (right_ahead, sway) = (-libm::cos(swing), libm::sin(swing));

        let along_m = spline(steps, |k| 0.5 * (self.foothold_m(k, build) + self.foothold_m(k - 1, build)));
        let hips = self.station(along_m, 0.02 * grow * sway);
        let over_m = spline(steps, |k| 0.5 * (self.height_m(k) + self.height_m(k - 1)));
        // Over a leg that stands one is higher than between two.
        let drop = 0.0425 + 0.0195 * libm::cos(2.0 * swing);
        let drop_m = grow * (drop * leg_m + 0.6 * self.rise_m.abs());
        posture.pelvis_m = into_room(hips.at_m) + Vector3::z() * (from_m.z + over_m - drop_m);
        posture.pelvis =
            [facing + hips.heading_rad + 0.07 * grow * right_ahead, 0.03 * grow, 0.03 * grow * sway];
        posture.spine = [0.03, -0.03 * sway, -0.14 * right_ahead].map(|angle| grow * angle);

        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let (foot, toe_up_rad) = self.foot(side, steps, build);
            let ankle_at_m = into_room(foot.at_m) + Vector3::z() * ankle_m;
            let turn = foot.heading_rad - (posture.pelvis[0] - facing);
            reach(posture, side, sign, ankle_at_m, turn, build);
            posture.plant(side, &(upright(facing + foot.heading_rad) * about_z(toe_up_rad)));
            // An arm swings against its leg.
            let ahead = -sign * right_ahead;
            raise(posture, side, grow * (0.05 + 0.3 * ahead), grow * 0.12, 0.0);
            posture.elbow[side] = [0.35 + 0.15 * ahead, 0.3].map(|angle| grow * angle);
        }
    }

    /// Whether any part of the right and of the left foot is on the floor.
    pub(super) fn contacts(&self, steps: f64) -> [bool; 2] {
        [0, 1].map(|side| {
            let (_, next) = swung(side, steps);
            self.is_over(next) || !(0.0..1.0).contains(&flight(steps, next))
        })
    }

    /// How far along the way the foothold of a step lies, m; the first two are beside each other, and the last two.
    fn foothold_m(&self, k: i64, build: &Build) -> f64 {
        let k = self.reached(k);
        if k <= 0 { 0.0 } else { (k as f64 - 0.5) * self.step * (build.thigh_m + build.shank_m) }
    }

    fn height_m(&self, k: i64) -> f64 {
        self.reached(k).max(0) as f64 * self.rise_m
    }

    /// The step that leads as far as this one.
    fn reached(&self, k: i64) -> i64 {
        self.last.map_or(k, |last| k.min(last - 1))
    }

    /// Whether the last step has been made before this one.
    fn is_over(&self, k: i64) -> bool {
        self.last.is_some_and(|last| k > last)
    }

    /// Whether somebody stands on the foothold of a step before the way or after it.
    fn rests(&self, k: i64) -> bool {
        k <= 0 || self.reached(k + 1) != k + 1
    }

    /// The place so far along the way, and so far to its left, m; the way begins in the origin along x.
    fn station(&self, along_m: f64, left_m: f64) -> Station {
        let heading_rad = self.curvature_per_m * along_m;
        let (s, c) = libm::sincos(heading_rad);
        let at_m = if self.curvature_per_m == 0.0 {
            Vector3::new(along_m, 0.0, 0.0)
        } else {
            Vector3::new(s, 1.0 - c, 0.0) / self.curvature_per_m
        };
        Station { at_m: at_m + Vector3::new(-s, c, 0.0) * left_m, heading_rad }
    }

    /// The ankle of a foot, as it would be with the hips' first foothold at height 0, and how far its toe points up, rad.
    fn foot(&self, side: usize, steps: f64, build: &Build) -> (Station, f64) {
        let leg_m = build.thigh_m + build.shank_m;
        let left = if side == 0 { -1.0 } else { 1.0 };
        let (last, next) = swung(side, steps);
        let stands = |k: i64| {
            let beside_m = left * TRACK[usize::from(!self.rests(k))] * build.hip_width_m;
            let station = self.station(self.foothold_m(k, build), beside_m);
            Station { at_m: station.at_m + Vector3::z() * self.height_m(k), ..station }
        };
        let mut station = stands(last);
        // How far the toe points up: as it leaves, and lands.
        let since = steps - (next - 1) as f64;
        // The first step is half a step, and so is the last; after that there is none.
        let size = if next <= 1 || self.last == Some(next) { 0.5 } else { 1.0 };
        let swings = if self.is_over(next) { 0.0 } else { 1.0 };
        let turned = DOUBLE_SUPPORT + PUSH_OFF;
        let leaves = minimum_jerk((since + HEEL_OFF) / (HEEL_OFF + turned))
            - minimum_jerk((since - turned) / (0.95 - turned));
        let falls =
            |landed: i64| minimum_jerk((steps - landed as f64 + LOADING[0]) / (LOADING[0] + LOADING[1]));
        let mut pitch = swings
            * (TOE_UP_RAD * (minimum_jerk((since - 0.5) / 0.42) - falls(next))
                - size * TOE_DOWN_RAD * leaves);
        if last > 0 && !self.is_over(last) {
            pitch += TOE_UP_RAD * (1.0 - falls(last));
        }
        let share = swings * minimum_jerk(flight(steps, next));
        // A foot that has lain down since it landed leaves the floor by its ball.
        let landing = if since > -HEEL_OFF { share } else { 1.0 };
        let ahead = stands(next);
        let clearance_m = 0.03 * leg_m * 64.0 * (share * (1.0 - share)).powi(3);
        station.at_m += share * (ahead.at_m - station.at_m) + Vector3::z() * clearance_m;
        station.heading_rad += share * (ahead.heading_rad - station.heading_rad);
        // Where the ankle goes while the foot turns about a point so far ahead of it on the floor.
        let (s, c) = libm::sincos(pitch);
        let rolled = |ahead: f64| {
            let forward = ahead - ahead * c - ANKLE * s;
            let up = -ahead * s + ANKLE * c - ANKLE;
            (forward * leg_m, up * leg_m)
        };
        let (ball, heel) = (rolled(BALL), rolled(-HEEL));
        let forward_m = ball.0 + landing * (heel.0 - ball.0);
        let up_m = ball.1 + landing * (heel.1 - ball.1);
        station.at_m +=
            about_z(station.heading_rad) * Vector3::new(forward_m, 0.0, 0.0) + Vector3::z() * up_m;
        (station, pitch)
    }
}

/// The last step that a foot has ended, 0 before its first, and the next that it makes; the right makes the odd ones.
fn swung(side: usize, steps: f64) -> (i64, i64) {
    let first = if side == 0 { 1 } else { 2 };
    if steps < first as f64 {
        return (0, first);
    }
    let last = first + 2 * ((steps - first as f64) / 2.0).floor() as i64;
    (last, last + 2)
}

/// How far a swing has come: 0 where the toe leaves, 1 where the heel lands.
fn flight(steps: f64, step: i64) -> f64 {
    (steps - (step - 1) as f64 - DOUBLE_SUPPORT) / (1.0 - DOUBLE_SUPPORT)
}

/// Uniform cubic B-spline over these control points: two continuous derivatives, straight where they are.
fn spline(at: f64, control: impl Fn(i64) -> f64) -> f64 {
    let (k, f) = (at.floor() as i64, at - at.floor());
    let weights = [
        (1.0 - f).powi(3),
        3.0 * f.powi(3) - 6.0 * f * f + 4.0,
        -3.0 * f.powi(3) + 3.0 * f * f + 3.0 * f + 1.0,
        f.powi(3),
    ];
    weights.iter().zip(k - 1..).map(|(weight, k)| weight * control(k)).sum::<f64>() / 6.0
}

/// Lowers somebody who stands upright over the feet: both knees bent by `knee`, the hips `back_m` behind, the knees turned outwards by `outwards`; rad, m. The
/// ankles stay.
pub(super) fn lower(posture: &mut Posture, knee: f64, back_m: f64, outwards: f64, build: &Build) {
    let leg_m = build.thigh_m + build.shank_m;
    let facing = about_z(posture.pelvis[0]);
    let ankles_m = [(0, 1.0), (1, -1.0)].map(|(side, sign)| {
        let beside_m = facing * Vector3::new(0.0, -sign * 0.5 * build.hip_width_m, 0.0);
        (side, sign, posture.pelvis_m + beside_m - Vector3::z() * leg_m)
    });
    let reach_m =
        libm::hypot(build.thigh_m + build.shank_m * libm::cos(knee), build.shank_m * libm::sin(knee));
    let height_m = (reach_m * reach_m - back_m * back_m).sqrt();
    posture.pelvis_m += facing * Vector3::new(-back_m, 0.0, 0.0) - Vector3::z() * (leg_m - height_m);
    for (side, sign, ankle_m) in ankles_m {
        hang(posture, side, sign, ankle_m, knee, -sign * outwards, build);
        posture.plant(side, &upright(posture.pelvis[0]));
    }
}

/// Hip and knee of a leg whose ankle is to be there, m, room, with the thigh turned by this much to the left of the pelvis, rad. A place
/// that is too far is reached for with a straight leg.
pub(super) fn reach(
    posture: &mut Posture,
    side: usize,
    sign: f64,
    ankle_m: Vector3<f64>,
    turn: f64,
    build: &Build,
) {
    let (thigh_m, shank_m) = (build.thigh_m, build.shank_m);
    let leg_m = ankle_m - hip_m(posture, sign, build);
    let cos_knee = (leg_m.norm_squared() - thigh_m * thigh_m - shank_m * shank_m) / (2.0 * thigh_m * shank_m);
    hang(posture, side, sign, ankle_m, libm::acos(cos_knee.clamp(-1.0, 1.0)), turn, build);
}

/// Turns a hip so that the ankle below a knee that is bent so far is in the direction of that place.
fn hang(
    posture: &mut Posture,
    side: usize,
    sign: f64,
    ankle_m: Vector3<f64>,
    knee: f64,
    turn: f64,
    build: &Build,
) {
    let leg_m = posture.pelvis_axes().transpose() * (ankle_m - hip_m(posture, sign, build));
    // The ankle from the hip in the thigh's axes, then turned about the thigh.
    let (s, c) = libm::sincos(knee);
    let bent_m = -Vector3::new(build.shank_m * s, build.thigh_m + build.shank_m * c, 0.0);
    let turned_m = about_y(turn) * bent_m;
    // Adduction brings it beside the pelvis, flexion ahead.
    let level_m = libm::hypot(turned_m.y, turned_m.z);
    let down = libm::atan2(turned_m.z, turned_m.y);
    let beside = std::f64::consts::PI - libm::asin((leg_m.z / level_m).clamp(-1.0, 1.0)) - down;
    let beside = libm::remainder(beside, std::f64::consts::TAU);
    let hung_m = about_x(beside) * turned_m;
    let flexion = libm::atan2(leg_m.y, leg_m.x) - libm::atan2(hung_m.y, hung_m.x);
    posture.hip[side] = [libm::remainder(flexion, std::f64::consts::TAU), sign * beside, sign * turn];
    posture.knee[side] = knee;
}

fn hip_m(posture: &Posture, sign: f64, build: &Build) -> Vector3<f64> {
    posture.pelvis_m + posture.pelvis_axes() * Vector3::new(0.0, 0.0, sign * 0.5 * build.hip_width_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAPS: Path = Path { step: 0.55, curvature_per_m: 0.5, rise_m: 0.0, last: None };
    const STAIRS: Path = Path { step: 0.32, curvature_per_m: 0.0, rise_m: 0.17, last: None };

    fn standing(build: &Build) -> Posture {
        Posture {
            pelvis_m: Vector3::new(0.3, -0.2, build.thigh_m + build.shank_m + 0.07),
            pelvis: [0.7, 0.0, 0.0],
            ..Posture::default()
        }
    }

    /// The right and the left ankle in the room, m.
    fn ankles_m(posture: &Posture, build: &Build) -> [Vector3<f64>; 2] {
        let body = posture.place(build);
        [5, 9].map(|shank| body[shank].origin_m - body[shank].axes * Vector3::new(0.0, build.shank_m, 0.0))
    }

    /// Legs reach where the feet are, a flat foot stays where it is, and nothing leaps.
    #[test]
    fn feet_that_stand_stay() {
        let tall = Build::of_height(1.8);
        let lap = Path::lap(0.5, 24, &tall);
        for (path, build) in [(LAPS, tall), (STAIRS, Build::of_height(1.6)), (lap, tall)] {
            let leg_m = build.thigh_m + build.shank_m;
            let mut before: Option<[Vector3<f64>; 2]> = None;
            let mut still = [0; 2];
            for tick in -100..2000 {
                let steps = f64::from(tick) * 0.01;
                let mut posture = standing(&build);
                path.walk(&mut posture, steps, &build);
                let ankles = ankles_m(&posture, &build);
                for side in 0..2 {
                    let (asked, toe_up_rad) = path.foot(side, steps, &build);
                    let asked_m = Vector3::new(0.3, -0.2, 0.07) + about_z(0.7) * asked.at_m;
                    let missed_m = (ankles[side] - asked_m).norm();
                    assert!(missed_m < 2e-3 * leg_m, "{path:?} {steps:.2} {side}: {missed_m}");
                    let foot = posture.place(&build)[[12, 14][side]].axes;
                    let toe = (foot * Vector3::x()).z;
                    assert!((toe - libm::sin(toe_up_rad)).abs() < 1e-9, "{path:?} {steps:.2} {side}: {toe}");
                    if let Some(before) = before {
                        let moved_m = (ankles[side] - before[side]).norm();
                        assert!(moved_m < 0.05, "{path:?} {steps:.2} {side}: {moved_m}");
                        still[side] += usize::from(moved_m < 1e-4);
                    }
                }
                before = Some(ankles);
            }
            assert!(still.iter().all(|still| (600..1300).contains(still)), "{still:?}");
        }
    }

    #[test]
    fn who_begins_to_walk_stands() {
        let build = Build::of_height(1.8);
        let mut posture = standing(&build);
        LAPS.walk(&mut posture, Path::BEGIN, &build);
        let (begun, stood) = (posture.place(&build), standing(&build).place(&build));
        for (begun, stood) in begun.iter().zip(&stood) {
            assert!(
                (begun.axes - stood.axes).norm() < 1e-6 && (begun.origin_m - stood.origin_m).norm() < 1e-6
            );
        }
    }

    /// And nothing leaps on the way to it, nor do its feet slide: `feet_that_stand_stay`.
    #[test]
    fn who_has_walked_a_lap_stands_as_before() {
        let build = Build::of_height(1.75);
        let lap = Path::lap(0.5, 16, &build);
        let mut before = standing(&build).place(&build);
        for tick in -100..=1700 {
            let mut posture = standing(&build);
            lap.walk(&mut posture, f64::from(tick) * 0.01, &build);
            let after = posture.place(&build);
            for (before, after) in before.iter().zip(&after) {
                assert!((before.origin_m - after.origin_m).norm() < 0.05, "{tick}");
                assert!((before.axes - after.axes).norm() < 0.15, "{tick}");
            }
            before = after;
        }
        for (begun, ended) in standing(&build).place(&build).iter().zip(&before) {
            assert!((begun.axes - ended.axes).norm() < 1e-6);
            assert!((begun.origin_m - ended.origin_m).norm() < 1e-6, "{}", begun.origin_m - ended.origin_m);
        }
        assert_eq!(lap.contacts(17.0), [true, true]);
    }

    #[test]
    fn a_squat_leaves_the_feet_where_they_are() {
        let build = Build::of_height(1.7);
        for percent in 0..=100 {
            let down = f64::from(percent) * 0.01;
            let mut posture = standing(&build);
            posture.pelvis[1] = 0.35 * down;
            lower(&mut posture, 1.7 * down, 0.15 * down, 0.15 * down, &build);
            let (found, stood) = (ankles_m(&posture, &build), ankles_m(&standing(&build), &build));
            for (found_m, stood_m) in found.iter().zip(&stood) {
                assert!((found_m - stood_m).norm() < 1e-3, "{down} {}", found_m - stood_m);
            }
        }
    }

    #[test]
    fn one_foot_stands_at_least() {
        let mut both = 0;
        for tick in -100..2000 {
            let [right, left] = LAPS.contacts(f64::from(tick) * 0.01);
            assert!(right || left);
            both += usize::from(right && left);
        }
        assert!((100 + 400..100 + 500).contains(&both), "{both}");
    }
}
