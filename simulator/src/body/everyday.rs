//! What people do besides walking and training: sitting down, lying down, jumping, waving.
//!
//! Each goes on in rounds, whose end is their beginning: somebody who stands. Feet that stand do not slide.

use nalgebra::Vector3;
use posed_geometry::GRAVITY_M_S2;

use super::gait::{lower, reach};
use super::kinematics::{ANKLE, BALL, Build, Posture, about_z, upright};
use super::script::raise;
use crate::ease::{minimum_jerk, step};

/// Sits down in this time, s, and stands up again in it, on a chair a quarter of the height high: there the thighs are level.
const SIT_S: f64 = 2.0;
const SITS_S: f64 = 5.0;
const STANDS_S: f64 = 2.5;
const LEVEL_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Down to the floor, and from there onto the back, s each; lies for so long. The knees stay bent, and the feet where they stood.
const FLOOR_S: f64 = 2.5;
const LIES_S: f64 = 6.0;
const FLOOR_KNEE_RAD: f64 = 2.2;
/// The hips of somebody on the floor are so much higher than the ankles, of the legs' length.
const FLOOR_HIPS: f64 = 0.1;
/// A jump: in the air, and before and after it bending the knees, s.
const FLIGHT_S: f64 = 0.4;
const BENDS_S: f64 = 0.6;
const JUMPS_S: f64 = 3.0;
/// Knees are never straight at the push-off, of the legs' length.
const SPRUNG: f64 = 0.97;
/// How high the balls of the feet go, and how far the toes hang in the air.
const BALLS_M: f64 = 0.15;
const TOES_RAD: f64 = 0.7;
/// Waves for so long, and rests, s; to and fro so often a second.
const WAVES_S: f64 = 6.0;
const RESTS_S: f64 = 3.0;
const WAVE_HZ: f64 = 1.5;

/// From 0 to 1 within a time, held, and back within the same, s.
fn there(t: f64, from_s: f64, within_s: f64, hold_s: f64) -> f64 {
    step((t - from_s) / within_s) - step((t - from_s - within_s - hold_s) / within_s)
}

/// Sits down, rests, stands up.
pub(super) fn sit(p: &mut Posture, t: f64, build: &Build) {
    let t = t.rem_euclid(2.0 * (STANDS_S + SIT_S) + SITS_S);
    let down = there(t, STANDS_S, SIT_S, SITS_S);
    // Who sits down and stands up leans forward: the weight stays over the feet.
    let leans = 4.0 * down * (1.0 - down);
    p.pelvis[1] = 0.35 * leans - 0.1 * down;
    p.spine[0] = 0.45 * leans + 0.15 * down;
    p.neck[0] = -0.4 * leans;
    for side in 0..2 {
        raise(p, side, 0.6 * leans + 0.45 * down, 0.05 * down, 0.1 * down);
        p.elbow[side] = [0.8 * down + 0.2 * leans, 0.6 * down];
    }
    lower(p, LEVEL_RAD * down, build.thigh_m * down, 0.05 * down, build);
}

/// Goes down to the floor, lies on the back with bent knees, gets up.
pub(super) fn lie(p: &mut Posture, t: f64, build: &Build) {
    let t = t.rem_euclid(2.0 * (STANDS_S + 2.0 * FLOOR_S) + LIES_S);
    let down = there(t, STANDS_S, FLOOR_S, 2.0 * FLOOR_S + LIES_S);
    let back = there(t, STANDS_S + FLOOR_S, FLOOR_S, LIES_S);
    let leans = 4.0 * down * (1.0 - down);
    let sits = down * (1.0 - back);
    p.pelvis[1] = 0.5 * leans - 0.2 * sits - std::f64::consts::FRAC_PI_2 * back;
    p.spine[0] = 0.6 * leans + 0.4 * sits;
    p.neck[0] = -0.4 * leans + 0.15 * back;
    for side in 0..2 {
        // The hands hold the knees, then lie beside the body.
        raise(p, side, 0.9 * leans + 0.9 * sits, 0.25 * back, 0.0);
        p.elbow[side] = [0.3 * leans + 0.4 * sits + 0.15 * back, 0.5 * down];
    }
    let (thigh_m, shank_m) = (build.thigh_m, build.shank_m);
    let reach_m =
        libm::hypot(thigh_m + shank_m * libm::cos(FLOOR_KNEE_RAD), shank_m * libm::sin(FLOOR_KNEE_RAD));
    let hips_m = FLOOR_HIPS * (thigh_m + shank_m);
    let behind_m = (reach_m * reach_m - hips_m * hips_m).sqrt();
    lower(p, FLOOR_KNEE_RAD * down, behind_m * down, 0.15 * down, build);
}

/// Bends the knees, jumps straight up, lands, stands.
pub(super) fn jump(p: &mut Posture, t: f64, grow: f64, build: &Build) {
    let (facing, stood_m) = (p.pelvis[0], p.pelvis_m);
    let leg_m = build.thigh_m + build.shank_m;
    // Since the feet left the floor.
    let t = t.rem_euclid(JUMPS_S) - 1.5;
    let hips_m = risen_m(t);
    let bends = (-hips_m / 0.25).max(0.0);
    let sprung_m = grow * (1.0 - SPRUNG) * leg_m;
    p.pelvis_m.z += grow * hips_m - sprung_m;
    p.pelvis[1] = grow * 0.3 * bends;
    p.spine[0] = grow * 0.25 * bends;
    let swings = minimum_jerk((t + 0.35) / 0.4) - minimum_jerk((t - FLIGHT_S) / 0.5);
    let air = (t / FLIGHT_S).clamp(0.0, 1.0);
    let balls_m = grow * BALLS_M * 64.0 * (air * (1.0 - air)).powi(3);
    let toes = grow * TOES_RAD * (minimum_jerk((t + 0.2) / 0.3) - minimum_jerk((t - FLIGHT_S + 0.1) / 0.3));
    let (s, c) = libm::sincos(toes);
    let forward_m = (BALL - BALL * c + ANKLE * s) * leg_m;
    let up_m = (BALL * s + ANKLE * c - ANKLE) * leg_m;
    for (side, sign) in [(0, 1.0), (1, -1.0)] {
        raise(p, side, grow * (1.6 * swings - 0.5 * bends), grow * 0.1, 0.0);
        p.elbow[side] = [grow * (0.3 + 0.3 * swings), 0.0];
        let beside_m = -sign * 0.5 * build.hip_width_m;
        let ankle_m = stood_m
            + about_z(facing) * Vector3::new(forward_m, beside_m, 0.0)
            + Vector3::z() * (up_m + balls_m - leg_m);
        reach(p, side, sign, ankle_m, 0.0, build);
        p.plant(side, &(upright(facing) * about_z(-toes)));
    }
}

/// How high the hips are over where they stand, m: a fall freely upwards and down, and before and after it polynomials of fifth degree to rest, which end with the
/// velocity and the acceleration of the fall.
fn risen_m(t: f64) -> f64 {
    let speed_m_s = 0.5 * GRAVITY_M_S2 * FLIGHT_S;
    if (0.0..=FLIGHT_S).contains(&t) {
        return speed_m_s * t - 0.5 * GRAVITY_M_S2 * t * t;
    }
    // As long after the landing as before the push-off.
    let before_s = if t < 0.0 { -t } else { t - FLIGHT_S };
    let u = (1.0 - before_s / BENDS_S).max(0.0);
    let (v, a) = (speed_m_s * BENDS_S, -GRAVITY_M_S2 * BENDS_S * BENDS_S);
    let [c3, c4, c5] = [0.5 * a - 4.0 * v, 7.0 * v - a, 0.5 * a - 3.0 * v];
    u.powi(3) * (c3 + u * (c4 + u * c5))
}

/// Waves with the right hand, and rests.
pub(super) fn wave(p: &mut Posture, t: f64) {
    let t = t.rem_euclid(WAVES_S + RESTS_S);
    let raised = there(t, 0.0, 1.2, WAVES_S - 2.4);
    let to_and_fro = libm::sin(std::f64::consts::TAU * WAVE_HZ * t);
    raise(p, 0, 0.5 * raised, 1.6 * raised, raised * (-1.1 + 0.35 * to_and_fro));
    p.elbow[0] = [raised * (1.3 + 0.15 * to_and_fro), 0.2 * raised];
    p.wrist[0] = [0.0, raised * 0.3 * to_and_fro];
    p.spine[1] = -0.05 * raised;
    p.neck[2] = -0.3 * raised;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{Activity, Script, TrueBody};

    const EVERYDAY: [Activity; 4] = [Activity::Sitting, Activity::Lying, Activity::Jumping, Activity::Waving];

    fn at(activity: Activity, t_s: f64, build: &Build) -> TrueBody {
        let script = Script { activity, calibration: false, facing: 0.4, mistake: None };
        script.at(t_s, build).place(build)
    }

    #[test]
    fn nothing_leaps_and_feet_that_stand_stay() {
        let build = Build::of_height(1.75);
        for activity in EVERYDAY {
            let mut before = at(activity, 0.0, &build);
            let stood_m = build.soles_m(&before);
            for tick in 1..5000 {
                let t_s = 0.005 * f64::from(tick);
                let body = at(activity, t_s, &build);
                for (segment, (now, before)) in body.iter().zip(&before).enumerate() {
                    let moved_m = (now.origin_m - before.origin_m).norm();
                    assert!(moved_m < 0.05, "{activity:?} {t_s} {segment}: {moved_m} m");
                    let turned = (now.axes - before.axes).norm();
                    assert!(turned < 0.2, "{activity:?} {t_s} {segment}: {turned}");
                    assert!(now.origin_m.z > 0.02, "{activity:?} {t_s} {segment}: {}", now.origin_m.z);
                }
                if activity != Activity::Jumping {
                    for (now_m, stood_m) in
                        build.soles_m(&body).iter().flatten().zip(stood_m.iter().flatten())
                    {
                        let slid_m = (now_m - stood_m).norm();
                        assert!(slid_m < 2e-3, "{activity:?} {t_s}: {slid_m} m");
                    }
                }
                before = body;
            }
        }
    }

    #[test]
    fn who_sits_has_level_thighs_and_who_lies_lies() {
        let build = Build::of_height(1.75);
        let seat = at(Activity::Sitting, STANDS_S + SIT_S + 0.5 * SITS_S, &build);
        let hips_m = seat[1].origin_m.z;
        assert!((hips_m - 0.29 * 1.75).abs() < 0.03, "{hips_m}");
        assert!((seat[4].axes * Vector3::y()).z.abs() < 0.1);
        let floor = at(Activity::Lying, STANDS_S + 2.0 * FLOOR_S + 0.5 * LIES_S, &build);
        assert!((floor[0].axes * Vector3::x()).z > 0.99 && floor[0].origin_m.z < 0.3);
    }

    /// In the air the hips fall freely, and no foot stands.
    #[test]
    fn who_jumps_is_in_the_air_for_so_long() {
        let build = Build::of_height(1.75);
        let script = Script { activity: Activity::Jumping, calibration: false, facing: 0.4, mistake: None };
        let (mut air_s, mut highest_m): (f64, f64) = (0.0, 0.0);
        let stood_m = at(Activity::Jumping, 0.0, &build)[1].origin_m.z;
        for tick in 0..300 {
            let t_s = 9.0 + 0.01 * f64::from(tick);
            if script.standing(t_s, &build).iter().flatten().all(|stands| !stands) {
                air_s += 0.01;
            }
            let hips_m =
                [-2e-3, 0.0, 2e-3].map(|dt_s| at(Activity::Jumping, t_s + dt_s, &build)[1].origin_m.z);
            highest_m = highest_m.max(hips_m[1]);
            let since_s = (t_s - 9.0) - 1.5;
            if (0.01..FLIGHT_S - 0.01).contains(&since_s) {
                let accel_m_s2 = (hips_m[0] + hips_m[2] - 2.0 * hips_m[1]) / 4e-6;
                assert!((accel_m_s2 + GRAVITY_M_S2).abs() < 0.01, "{t_s}: {accel_m_s2}");
            }
        }
        assert!((0.3..0.6).contains(&air_s), "{air_s}");
        let jumped_m = highest_m - stood_m;
        assert!((0.1..0.2).contains(&jumped_m), "{jumped_m}");
    }

    #[test]
    fn who_strolls_stands_on_heel_and_ball_by_turns() {
        let build = Build::of_height(1.75);
        let script = Script { activity: Activity::Strolling, calibration: false, facing: 0.0, mistake: None };
        let mut counts = [0; 4];
        for tick in 0..400 {
            let [right, _] = script.standing(10.0 + 0.01 * f64::from(tick), &build);
            counts[usize::from(right[0]) + 2 * usize::from(right[1])] += 1;
        }
        // In the air, on the heel alone, on the ball alone, flat.
        assert!(counts[0] > 80 && counts[2] > 30 && counts[3] > 80, "{counts:?}");
    }
}
