//! What the person does: an N-pose and a T-pose, the calibration's movements one after the other, then an activity.
//!
//! Every angle is a smooth function of time (four continuous derivatives), so that angular velocities and specific forces exist.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::everyday::{jump, lie, sit, wave as waves};
use super::gait::{Path, STEPS_HZ, lower};
use super::kinematics::{ANKLE_M, Build, Posture};
use crate::ease::step;

/// What is done after the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Activity {
    /// Walks in a wide circle, 0.9 steps of each leg a second.
    Walking,
    /// Reaches forward, up and sideways with both arms.
    Reaching,
    /// Curls both arms, one after the other.
    Curls,
    /// Squats with the arms held forward.
    Squats,
    /// Raises and bends arms and legs as a patient does: slowly, half as far, with a tremor of 5 Hz that comes and goes.
    Rehabilitation,
    /// Walks about the room in laps of two metres' radius, a step of half a leg 1.7 times a second; feet that stand do not slide.
    Strolling,
    /// Walks once round a circle of a metre's radius, in 16 steps, and stands where it began.
    Lap,
    /// Climbs stairs without end, each 17 cm high.
    Climbing,
    /// Holds an N-pose and a T-pose in turn, three seconds each: what a quick guided calibration asks for.
    Poses,
    /// Stands, holds a T-pose, then bends elbows, knees, hips, head, feet and trunk with rests between, again and again: what a full calibration
    /// asks for, with or without magnetometers.
    Bends,
    /// Stands, holds a T-pose, then moves limb after limb, head, hands, feet, shoulders if they move, and the trunk with rests between, again and again: what a calibration asks
    /// for that finds which sensor sits where.
    Movements,
    /// Three sets of five curls, reaches, three sets of five squats, with five seconds of rest after each set, and a lap about the room: two minutes and a
    /// quarter, again and again.
    Workout,
    /// Sits down on a chair a quarter of the height high, rests, stands up, again and again.
    Sitting,
    /// Lies down on the back with bent knees, rests, gets up, again and again.
    Lying,
    /// Bends the knees and jumps straight up, 0.4 s in the air, every three seconds.
    Jumping,
    /// Waves with the right hand, and rests.
    Waving,
}

/// What somebody does wrong who holds the poses of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Mistake {
    /// The arms are raised forward, not sideways.
    ArmsForward,
    /// The arms are raised half way.
    ArmsLow,
    /// The palms look forward in the T-pose.
    PalmsForward,
    /// The elbows are bent by 60 degrees where the arms hang.
    BentElbows,
    /// The trunk is bent by 30 degrees where the arms hang.
    Stoops,
    /// The person turns round while the arms go up, and back while they go down.
    TurnsRound,
}

/// A part of a workout.
struct Part {
    activity: Activity,
    duration_s: f64,
    /// It comes and goes within this time.
    ramp_s: f64,
    rest_s: f64,
}

/// What a workout consists of. Sets are five whole repetitions, so that who teaches one sees the next counted.
const WORKOUT: [Part; 8] = [CURLS, CURLS, CURLS, REACHES, SQUATS, SQUATS, SQUATS, LAP];
const CURLS: Part =
    Part { activity: Activity::Curls, duration_s: 5.0 / CURLS_HZ, ramp_s: SET_RAMP_S, rest_s: REST_S };
const SQUATS: Part = Part { activity: Activity::Squats, duration_s: 5.0 / SQUATS_HZ, ..CURLS };
/// No set, so nobody rests after it.
const REACHES: Part = Part { activity: Activity::Reaching, duration_s: 14.0, ramp_s: RAMP_S, rest_s: 0.0 };
const LAP: Part = Part { activity: Activity::Lap, duration_s: LAP_S, ramp_s: SET_RAMP_S, rest_s: 3.0 };
const REST_S: f64 = 5.0;
/// Steps of a lap, of half a leg each, and how long it takes, s.
const LAP_STEPS: i64 = 16;
const LAP_S: f64 = RAMP_S + (LAP_STEPS as f64 + Path::END - Path::BEGIN) / STEPS_HZ;
/// How far somebody who rests sways, rad.
const SWAY_RAD: f64 = 0.015;
/// Before the first one stands still, as everybody does who switches sensors on, s.
const LEAD_S: f64 = 1.5;
/// Repetitions per second.
const CURLS_HZ: f64 = 0.5;
const SQUATS_HZ: f64 = 0.35;
/// Movements come and go within this time, s; those of a set sooner, so that its first repetition is as large as the others.
const RAMP_S: f64 = 3.0;
const SET_RAMP_S: f64 = 1.0;

/// A span of the script, named as in a stage file; its times are seconds of the script.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockSpan {
    /// The pose or movement: `n_pose`, `t_pose`, `elbow_flexion_r`, ...
    pub kind: &'static str,
    /// Its begin, s.
    pub start_s: f64,
    /// Its end, s.
    pub end_s: f64,
}

/// What the person does over time: poses and movements of a calibration, if asked for, then an activity without end.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// What follows the calibration.
    pub activity: Activity,
    /// Whether poses and movements come first: an N-pose, a T-pose and 13 movements in 88.5 s.
    pub calibration: bool,
    /// Which way the person faces at first, rad: 0 is along the room's x, positive to the left.
    pub facing: f64,
    /// What is done wrong in the first round of [`Activity::Poses`], [`Activity::Bends`] and [`Activity::Movements`].
    pub mistake: Option<Mistake>,
}

/// The movements: name, amplitude in rad; three seconds there and back, twice.
const MOVEMENTS: [(&str, f64); 20] = [
    ("elbow_flexion_r", 1.7),
    ("elbow_flexion_l", 1.7),
    ("elbow_pronation_r", 1.2),
    ("elbow_pronation_l", 1.2),
    ("shoulder_flexion_r", 1.3),
    ("shoulder_flexion_l", 1.3),
    ("knee_flexion_r", 1.4),
    ("knee_flexion_l", 1.4),
    ("hip_flexion_r", 1.0),
    ("hip_flexion_l", 1.0),
    ("bow", 0.8),
    ("trunk_rotation", 0.7),
    ("shoulder_abduction_r", 1.0),
    ("neck_flexion", 0.6),
    ("wrist_flexion_r", 0.9),
    ("ankle_flexion_r", 0.4),
    ("wrist_flexion_l", 0.9),
    ("ankle_flexion_l", 0.4),
    ("shrug_r", 0.4),
    ("shrug_l", 0.4),
];
/// Of these, so many come first in a script that begins with a calibration.
const FIRST: usize = 13;
/// Those that a full calibration asks for: elbows, knees, hips, head, feet and a bow.
const BENDS: [usize; 10] = [0, 1, 6, 7, 8, 9, 13, 15, 17, 10];
/// And those that move one segment or the trunk: arms, legs, head, hands, feet, bow and trunk.
const EACH_LIMB: [usize; 15] = [0, 4, 1, 5, 6, 8, 7, 9, 13, 14, 15, 16, 17, 10, 11];
/// The same of somebody whose shoulders move.
const EACH_LIMB_AND_SHOULDER: [usize; 17] = [0, 4, 1, 5, 6, 8, 7, 9, 13, 14, 15, 16, 17, 18, 19, 10, 11];
const POSE_S: f64 = 3.0;
const CHANGE_S: f64 = 2.0;
const MOVE_S: f64 = 5.0;
/// A round of two poses, s.
const POSES_S: f64 = 2.0 * (POSE_S + CHANGE_S);
/// Where movements follow on the poses: so long somebody stands before them, s, after so long they begin, and so often they come.
const STAND_S: f64 = 8.0;
const BEGIN_S: f64 = STAND_S + 2.0 * CHANGE_S + POSE_S + 0.5 * STAND_S;
const MOVED_S: f64 = MOVE_S + 2.0;

impl Script {
    /// When which pose or movement is held, in the order of time; empty without a calibration.
    pub fn blocks(&self) -> Vec<BlockSpan> {
        if !self.calibration {
            return Vec::new();
        }
        let t_pose = POSE_S + CHANGE_S;
        let mut blocks = vec![
            BlockSpan { kind: "n_pose", start_s: 0.2, end_s: POSE_S },
            BlockSpan { kind: "t_pose", start_s: t_pose + 0.2, end_s: t_pose + POSE_S - 0.2 },
        ];
        for (index, (kind, _)) in MOVEMENTS.into_iter().take(FIRST).enumerate() {
            let start_s = movement_s(index);
            blocks.push(BlockSpan { kind, start_s, end_s: start_s + MOVE_S });
        }
        blocks
    }

    /// When the activity begins, s of the script: 88.5 after a calibration, else 0.
    pub fn activity_s(&self) -> f64 {
        if self.calibration { movement_s(FIRST) } else { 0.0 }
    }

    /// Whether any part of the right and of the left foot is on the floor at that time; `None` in what has no floor.
    pub fn contacts(&self, t_s: f64) -> Option<[bool; 2]> {
        let t = t_s - self.activity_s();
        // They do not depend on the person's size.
        let path = self.activity.path(&Build::of_height(1.0))?;
        Some(path.contacts(self.activity.steps(t.max(0.0))))
    }

    /// Whether heel and ball of the right and of the left foot stand: see [`Build::standing`]. Stairs are floor, too.
    pub fn standing(&self, t_s: f64, build: &Build) -> [[bool; 2]; 2] {
        let floor_m = if self.activity == Activity::Climbing { f64::INFINITY } else { 0.0 };
        build.standing(|t_s| self.at(t_s, build).place(build), t_s, floor_m)
    }

    /// The posture at `t_s` seconds of the script, any time; before 0 the person stands in an N-pose.
    ///
    /// The hips begin above the room's origin, 0.07 m higher than the legs are long. Feet stay where they stand while somebody strolls or climbs, and
    /// where nobody leaves the place; else there is no floor, and they may slide.
    pub fn at(&self, t_s: f64, build: &Build) -> Posture {
        let mut posture = Posture {
            pelvis: [self.facing, 0.0, 0.0],
            pelvis_m: Vector3::new(0.0, 0.0, build.thigh_m + build.shank_m + ANKLE_M),
            ..Posture::default()
        };
        if self.calibration {
            hold_t_pose(&mut posture, t_s, POSE_S);
            for (index, (kind, amplitude)) in MOVEMENTS.into_iter().take(FIRST).enumerate() {
                let phase = (t_s - movement_s(index)) / MOVE_S;
                if (0.0..1.0).contains(&phase) {
                    bend(&mut posture, kind, amplitude * there_and_back(phase));
                }
            }
        }
        let t = t_s - self.activity_s();
        if t > 0.0 {
            self.activity.act(&mut posture, t, step(t / RAMP_S), build);
        }
        if let (Some(mistake), Some(round_s)) = (self.mistake, self.activity.round_s(build)) {
            mistake.spoil(&mut posture, step((round_s - t) / CHANGE_S));
        }
        posture
    }
}

impl Activity {
    /// Where somebody walks whose feet stay where they stand.
    fn path(self, build: &Build) -> Option<Path> {
        match self {
            Activity::Strolling => Some(Path { step: 0.55, curvature_per_m: 0.5, rise_m: 0.0, last: None }),
            Activity::Climbing => Some(Path { step: 0.32, curvature_per_m: 0.0, rise_m: 0.17, last: None }),
            Activity::Lap => Some(Path::lap(0.5, LAP_STEPS, build)),
            _ => None,
        }
    }

    /// Steps along its [`Path`] after so long, s: who comes back to a stand does so as slowly as it began.
    fn steps(self, t: f64) -> f64 {
        match self {
            Activity::Lap if t > 0.5 * LAP_S => {
                LAP_STEPS as f64 + Path::END + Path::BEGIN - steps_after((LAP_S - t).max(0.0))
            }
            _ => steps_after(t),
        }
    }

    /// After how long a calibration's poses and movements come again, s; `None` of what is no calibration.
    fn round_s(self, build: &Build) -> Option<f64> {
        match self {
            Activity::Poses => Some(POSES_S),
            Activity::Bends => Some(round_s(&BENDS)),
            Activity::Movements => Some(round_s(each_limb(build))),
            _ => None,
        }
    }

    /// How far a movement of this duration has come, from 0 to 1 and back to 0.
    pub(super) fn swell(t: f64, duration_s: f64) -> f64 {
        Self::swell_within(RAMP_S, t, duration_s)
    }

    fn swell_within(ramp_s: f64, t: f64, duration_s: f64) -> f64 {
        step(t / ramp_s).min(step((duration_s - t) / ramp_s))
    }

    /// Adds what is done after a time `t` in s, in size `grow`.
    pub(super) fn act(self, p: &mut Posture, t: f64, grow: f64, build: &Build) {
        let wave = |hz: f64, phase: f64| libm::sin(std::f64::consts::TAU * hz * t + phase);
        let rise = |hz: f64, phase: f64| 0.5 - 0.5 * libm::cos(std::f64::consts::TAU * hz * t + phase);
        match self {
            Activity::Walking => {
                const HZ: f64 = 0.9;
                p.pelvis[0] += grow * 0.25 * t;
                let (s, c) = libm::sincos(p.pelvis[0]);
                p.pelvis_m += Vector3::new(4.0 * s, -4.0 * c, 0.0) * grow;
                p.pelvis_m.z += grow * 0.02 * wave(2.0 * HZ, 0.4);
                p.pelvis[1] = grow * 0.04 * wave(2.0 * HZ, 1.0);
                p.pelvis[2] = grow * 0.05 * wave(HZ, 0.3);
                p.spine = [0.05, 0.04 * wave(HZ, 2.0), 0.12 * wave(HZ, 0.9)].map(|a| grow * a);
                for (side, phase) in [(0, 0.0), (1, std::f64::consts::PI)] {
                    p.hip[side] = [
                        0.1 + 0.42 * wave(HZ, phase),
                        0.05 * wave(HZ, phase + 0.8),
                        0.07 * wave(HZ, phase + 1.9),
                    ]
                    .map(|a| grow * a);
                    p.knee[side] = grow * (0.15 + 0.95 * rise(HZ, phase + 1.2).powi(2));
                    // An arm swings against its leg.
                    let swing = 0.35 * wave(HZ, phase + std::f64::consts::PI);
                    raise(p, side, grow * (0.05 + swing), grow * 0.12, grow * 0.1 * wave(HZ, phase));
                    p.elbow[side] =
                        [0.35 + 0.2 * wave(HZ, phase + 2.8), 0.3 + 0.1 * wave(HZ, phase)].map(|a| grow * a);
                    p.wrist[side] = [0.15 * wave(HZ, phase + 0.5), 0.1 * wave(HZ, phase)].map(|a| grow * a);
                    p.ankle[side] =
                        [0.05 + 0.25 * wave(HZ, phase + 2.2), 0.04 * wave(HZ, phase), 0.0].map(|a| grow * a);
                }
                p.neck = [0.05 + 0.03 * wave(2.0 * HZ, 0.0), -0.04 * wave(HZ, 2.0), 0.3 * wave(0.11, 0.0)]
                    .map(|a| grow * a);
            }
            Activity::Reaching => {
                p.spine = [0.25 * rise(0.13, 0.0), 0.15 * wave(0.11, 0.4), 0.35 * wave(0.17, 0.0)]
                    .map(|a| grow * a);
                p.pelvis[0] += grow * 0.3 * wave(0.07, 0.0);
                p.pelvis[1] = grow * 0.1 * rise(0.13, 0.3);
                for (side, hz) in [(0, 0.45), (1, 0.38)] {
                    raise(
                        p,
                        side,
                        grow * 1.5 * rise(hz, 0.0),
                        grow * 0.9 * rise(hz * 0.43, 0.6),
                        grow * 0.5 * wave(0.31, hz),
                    );
                    p.elbow[side] = [0.2 + 1.2 * rise(hz, 2.4), 0.6 * wave(hz * 0.7, 1.0)].map(|a| grow * a);
                }
                // The eyes follow the right hand, which turns what it holds.
                p.neck =
                    [0.3 * rise(0.45, 1.0), 0.1 * wave(0.11, 1.2), 0.4 * wave(0.17, 0.5)].map(|a| grow * a);
                for (side, phase) in [(0, 0.0), (1, 1.3)] {
                    p.wrist[side] = [0.5 * wave(0.37, phase), 0.25 * wave(0.29, phase)].map(|a| grow * a);
                }
                p.hip[0][0] = grow * 0.12 * rise(0.13, 0.0);
                p.hip[1][0] = grow * 0.12 * rise(0.13, 0.0);
            }
            Activity::Curls => {
                for (side, phase) in [(0, 0.0), (1, std::f64::consts::PI)] {
                    p.elbow[side] = [2.2 * rise(CURLS_HZ, phase), -rise(CURLS_HZ, phase)].map(|a| grow * a);
                    raise(p, side, grow * 0.15 * rise(CURLS_HZ, phase), grow * 0.08, 0.0);
                }
                p.spine = [0.03 * wave(CURLS_HZ, 0.0), 0.0, 0.06 * wave(0.25, 0.0)].map(|a| grow * a);
            }
            Activity::Squats => {
                let down = grow * rise(SQUATS_HZ, 0.0);
                for side in 0..2 {
                    raise(p, side, grow * (0.4 + 0.9 * rise(SQUATS_HZ, 0.0)), grow * 0.1, 0.0);
                    p.elbow[side] = [grow * 0.2, grow * 0.3];
                }
                p.pelvis[1] = 0.35 * down;
                p.spine[0] = 0.3 * down;
                lower(p, 1.7 * down, 0.15 * down, 0.15 * down, build);
            }
            Activity::Rehabilitation => {
                const HZ: f64 = 0.12;
                // Between 4 and 6 Hz, as that of Parkinson's disease.
                const TREMOR_HZ: f64 = 5.0;
                let tremor = |degrees: f64, phase: f64| {
                    degrees.to_radians() * (0.6 + 0.4 * wave(0.07, phase)) * wave(TREMOR_HZ, phase)
                };
                for (side, phase) in [(0, 0.0), (1, 2.1)] {
                    p.elbow[side] = [
                        0.3 + 0.9 * rise(HZ, phase) + tremor(1.5, phase),
                        0.2 - 0.5 * rise(HZ, phase) + tremor(3.0, phase + 1.1),
                    ]
                    .map(|a| grow * a);
                    raise(
                        p,
                        side,
                        grow * (0.6 * rise(0.7 * HZ, phase) + tremor(0.7, phase)),
                        grow * 0.1,
                        0.0,
                    );
                    p.hip[side][0] = grow * 0.5 * rise(0.8 * HZ, phase + 0.7);
                    p.knee[side] = grow * (0.6 * rise(0.8 * HZ, phase + 0.5) + tremor(0.5, phase + 0.4));
                }
                p.spine = [0.08 * rise(0.05, 0.0), 0.04 * wave(0.06, 0.4), 0.06 * wave(0.04, 1.0)]
                    .map(|a| grow * a);
            }
            Activity::Strolling | Activity::Climbing | Activity::Lap => {
                self.path(build).into_iter().for_each(|path| path.walk(p, self.steps(t), build));
            }
            Activity::Sitting => sit(p, t, build),
            Activity::Lying => lie(p, t, build),
            Activity::Jumping => jump(p, t, grow, build),
            Activity::Waving => waves(p, t),
            Activity::Poses => hold_t_pose(p, t.rem_euclid(POSES_S), POSE_S),
            Activity::Bends => pose_and_move(p, t, &BENDS),
            Activity::Movements => pose_and_move(p, t, each_limb(build)),
            Activity::Workout => {
                let round_s: f64 = WORKOUT.iter().map(|part| part.duration_s + part.rest_s).sum();
                let mut at = (t - LEAD_S).rem_euclid(round_s);
                let mut stands = 1.0;
                for Part { activity, duration_s, ramp_s, rest_s } in WORKOUT {
                    if (0.0..duration_s).contains(&at) {
                        let swell = Self::swell_within(ramp_s, at, duration_s);
                        activity.act(p, at, swell, build);
                        if activity == Activity::Lap {
                            stands = 1.0 - swell;
                        }
                    }
                    at -= duration_s + rest_s;
                }
                // Nobody stands like a post: to and fro about the ankles, and breath.
                let lean = grow * stands * SWAY_RAD * wave(0.23, 0.0);
                let (s, c) = libm::sincos(p.pelvis[0]);
                p.pelvis[1] += lean;
                p.pelvis_m += Vector3::new(c, s, 0.0) * (lean * p.pelvis_m.z);
                p.spine[0] += grow * stands * SWAY_RAD * wave(0.27, 1.0);
            }
        }
    }
}

impl Mistake {
    /// Adds this share of it to a posture as it should be.
    fn spoil(self, p: &mut Posture, share: f64) {
        for side in 0..2 {
            let elevation = p.shoulder[side][1];
            let hangs = 1.0 - elevation / std::f64::consts::FRAC_PI_2;
            match self {
                // Of arms that go up sideways: in a movement they have a plane.
                Mistake::ArmsForward if p.shoulder[side][0] != 0.0 => {}
                Mistake::ArmsForward => {
                    p.shoulder[side][0] += share * std::f64::consts::FRAC_PI_2;
                    p.shoulder[side][2] -= share * std::f64::consts::FRAC_PI_2;
                }
                Mistake::ArmsLow => p.shoulder[side][1] *= 1.0 - 0.5 * share,
                Mistake::PalmsForward => p.shoulder[side][2] -= share * elevation,
                Mistake::BentElbows => p.elbow[side][0] += share * 1.05 * hangs,
                // Once for each side.
                Mistake::Stoops => p.spine[0] += share * 0.26 * hangs,
                Mistake::TurnsRound => p.pelvis[0] += share * std::f64::consts::FRAC_PI_2 * (1.0 - hangs),
            }
        }
    }
}

/// Stands, holds a T-pose, stands, and makes these movements one after the other, again and again.
fn pose_and_move(p: &mut Posture, t: f64, movements: &[usize]) {
    let at = t.rem_euclid(round_s(movements));
    hold_t_pose(p, at, STAND_S);
    if at >= BEGIN_S {
        let index = ((at - BEGIN_S) / MOVED_S) as usize;
        let (kind, amplitude) = MOVEMENTS[movements[index]];
        bend(p, kind, amplitude * there_and_back((at - BEGIN_S - MOVED_S * index as f64) / MOVE_S));
    }
}

fn each_limb(build: &Build) -> &'static [usize] {
    if build.girdle { &EACH_LIMB_AND_SHOULDER } else { &EACH_LIMB }
}

fn round_s(movements: &[usize]) -> f64 {
    BEGIN_S + MOVED_S * movements.len() as f64
}

/// Both arms go up sideways from a time on, s, are held, and come down again.
fn hold_t_pose(p: &mut Posture, t: f64, from_s: f64) {
    let raised = step((t - from_s) / CHANGE_S) - step((t - from_s - CHANGE_S - POSE_S) / CHANGE_S);
    for side in 0..2 {
        p.shoulder[side][1] = raised * std::f64::consts::FRAC_PI_2;
    }
}

/// Steps along a [`Path`] after so long, s: nobody walks off at full speed.
fn steps_after(t: f64) -> f64 {
    // The integral of `step`.
    let x = (t / RAMP_S).clamp(0.0, 1.0);
    let begun = x.powi(6) * (21.0 - 60.0 * x + 67.5 * x * x - 35.0 * x.powi(3) + 7.0 * x.powi(4));
    Path::BEGIN + STEPS_HZ * (RAMP_S * begun + (t - RAMP_S).max(0.0))
}

fn movement_s(index: usize) -> f64 {
    2.0 * (POSE_S + CHANGE_S) + 0.5 + (MOVE_S + 1.0) * index as f64
}

/// Twice from 0 to 1 and back with smooth ends, while `phase` goes from 0 to 1.
fn there_and_back(phase: f64) -> f64 {
    0.5 - 0.5 * libm::cos(2.0 * std::f64::consts::TAU * step(phase))
}

/// Raises an arm: so far forward, sideways and turned inwards, rad.
pub(super) fn raise(p: &mut Posture, side: usize, forward: f64, sideways: f64, inwards: f64) {
    // Smooth through the hanging arm: plane and elevation of the direction, and no rotation against the shortest way there.
    let elevation = libm::hypot(forward, sideways);
    let plane = libm::atan2(forward, sideways);
    p.shoulder[side] = [plane, elevation, inwards - plane];
}

fn bend(p: &mut Posture, kind: &str, angle: f64) {
    let side = usize::from(kind.ends_with("_l"));
    match kind.trim_end_matches("_r").trim_end_matches("_l") {
        "elbow_flexion" => p.elbow[side][0] = angle,
        "elbow_pronation" => p.elbow[side][1] = angle,
        "shoulder_flexion" => raise(p, side, angle, 0.0, 0.0),
        "shoulder_abduction" => raise(p, side, 0.0, angle, 0.0),
        "knee_flexion" => p.knee[side] = angle,
        "hip_flexion" => p.hip[side][0] = angle,
        "trunk_rotation" => p.spine[2] = angle,
        "neck_flexion" => p.neck[0] = angle,
        "wrist_flexion" => p.wrist[side][0] = angle,
        "ankle_flexion" => p.ankle[side][0] = angle,
        "shrug" => p.girdle[side][1] = angle,
        _ => {
            // A bow from the hips: the legs stay upright.
            p.pelvis[1] = angle;
            p.hip = [[angle, 0.0, 0.0]; 2];
        }
    }
}
