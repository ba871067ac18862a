//! Guides a person through the poses and movements of a calibration, and notices by itself when each was done.
//!
//! In: samples of the whole body as they come. Out: what to do next, in words; how far it is; and in the end when which
//! pose or movement was held, for [`super::calibrate()`]. It has no clock: time is that of the samples.
//!
//! A pose is done once all sensors were still for [`HOLD_S`] in it; a movement once its own sensors moved and came to rest again.
//! Where it is to be found which sensor sits where, samples stand under the segments that sensors were taken to sit on: then any
//! sensor may show a movement, and as many as there are on the arms a T-pose.
//!
//! A step waits for sensors that are silent ([`Guide::silent`]): who poses should not hear at the end that one was never heard. Where it is known who sits
//! where, and a movement's neighbour or the same segment of the other side moves in its place, that is an objection at once: the person may
//! have moved the wrong limb, or two sensors are swapped, and would repeat it for ever.
//!
//! What contradicts that a step was done as asked ([`Contradiction`], [`super::places::Misplaced`]) is an objection: the movement is asked for
//! again, and from the second time on, or where it was a pose, all of it from the first pose on, since either of two poses may
//! have been the wrong one. Whoever begins with raised arms and lowers them has held the first pose second.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::block::{Block, BlockKind, Movement, Recorded};
use super::calibrate::{CalibrationError, Contradiction, Tracks, objection_to};
use super::health::usable;
use super::places::{Places, Trackers};
use super::{BodySamples, BodySegment, SEGMENTS};

/// For so long a pose is held, s.
const HOLD_S: f64 = 2.0;
/// Who turns more slowly than this is still, rad/s: what an uncalibrated gyro reports at rest, and some swaying.
const STILL_RAD_S: f64 = 0.15;
/// Who turns faster than this moves, rad/s.
const MOVES_RAD_S: f64 = 0.5;
/// Rates are smoothed over so long, s.
const SMOOTH_S: f64 = 0.15;
/// Rest that ends a movement, s; a reversal is shorter.
const REST_S: f64 = 1.0;
/// So long somebody has to walk about, s.
const WALK_S: f64 = 20.0;
/// Shortest movement, s.
const MOVEMENT_S: f64 = 1.5;
/// What belongs to a movement before it was noticed, s.
const LEAD_S: f64 = 0.4;
/// A sensor that was not heard for so long is silent, s.
const SILENT_S: f64 = 1.0;
/// Another segment has moved in the place of the one that was asked for where it has turned so far, rad.
const INSTEAD_RAD: f64 = 1.0;
/// Arms that are meant to be held sideways have turned so far against gravity, rad; whether it is enough is judged then.
const RAISED_RAD: f64 = 0.5;
/// Arms that are meant to hang again are within this of how they hung, rad; whether they do is judged then.
const HANGS_RAD: f64 = 1.2;

/// How much is done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Thoroughness {
    /// Poses only: good to a few degrees.
    Quick,
    /// Poses, and the bending of elbows and knees.
    #[default]
    Full,
    /// Walking about, without a pose: good to some degrees at first, and better as limbs move.
    Movement,
    /// A movement of every segment: shows also which sensor sits on which segment.
    Assign,
}

/// One calibration on its way.
#[derive(Clone, Debug)]
pub struct Guide {
    present: [bool; SEGMENTS],
    /// Whether it is known which sensor sits where.
    assigned: bool,
    steps: Vec<BlockKind>,
    at: usize,
    recording: Vec<Recorded>,
    /// What the recording shows of every sensor, kept up with it: after a step nobody waits until all is filtered anew.
    tracks: Tracks,
    blocks: Vec<Block>,
    /// Where trackers on the body were, since when the pose is held.
    trackers: Option<Trackers>,
    /// What contradicted the last step, and how many steps were contradicted.
    objection: Option<String>,
    objections: usize,
    /// Arms that are still raised are not to be taken for the first pose again.
    must_move: bool,
    /// Smoothed angular speeds, rad/s, and specific forces, m/s², per sensor.
    angular_speeds_rad_s: [f64; SEGMENTS],
    specific_forces_m_s2: [Vector3<f64>; SEGMENTS],
    /// Directions of the specific force while the arms hung.
    hung: Option<[Vector3<f64>; SEGMENTS]>,
    /// Since when the pose is held, or the walk goes on, s.
    still_since_s: Option<f64>,
    /// When each sensor was heard last, s.
    heard_s: [Option<f64>; SEGMENTS],
    /// What each sensor did since the step began.
    turns: [Turn; SEGMENTS],
    /// How long both legs have moved since then, s.
    walked_s: f64,
}

/// A movement of one sensor.
#[derive(Clone, Copy, Debug, Default)]
struct Turn {
    /// How far it turned to and fro, rad.
    turned_rad: f64,
    began_s: Option<f64>,
    rests_since_s: Option<f64>,
}

impl Turn {
    fn push(&mut self, t_s: f64, dt_s: f64, angular_speed_rad_s: f64) {
        if angular_speed_rad_s > MOVES_RAD_S {
            self.began_s.get_or_insert(t_s);
        }
        if self.began_s.is_some() {
            self.turned_rad += angular_speed_rad_s * dt_s;
        }
        let rests = angular_speed_rad_s < STILL_RAD_S;
        self.rests_since_s = if rests { self.rests_since_s.or(Some(t_s)) } else { None };
    }

    /// Whether a whole movement lies behind it.
    fn is_whole(&self, t_s: f64) -> bool {
        let (Some(began_s), Some(rest_s)) = (self.began_s, self.rests_since_s) else { return false };
        rest_s - began_s >= MOVEMENT_S && t_s - rest_s >= REST_S && self.turned_rad > INSTEAD_RAD
    }
}

impl Guide {
    /// Longest calibration, s: whoever takes longer has gone away. It is for the caller to stop then.
    pub const LONGEST_S: f64 = 600.0;

    /// For these sensors, by [`BodySegment::index`]; `magnetic` where all of them have magnetometers: without, every sensor
    /// needs a movement, whatever `how` asks for.
    pub fn new(present: [bool; SEGMENTS], magnetic: bool, how: Thoroughness) -> Self {
        Self {
            steps: steps(&present, magnetic, how),
            assigned: how != Thoroughness::Assign,
            present,
            at: 0,
            recording: Vec::new(),
            tracks: Tracks::new(&present, magnetic),
            blocks: Vec::new(),
            trackers: None,
            objection: None,
            objections: 0,
            must_move: false,
            angular_speeds_rad_s: [0.0; SEGMENTS],
            specific_forces_m_s2: [Vector3::zeros(); SEGMENTS],
            hung: None,
            still_since_s: None,
            heard_s: [None; SEGMENTS],
            turns: [Turn::default(); SEGMENTS],
            walked_s: 0.0,
        }
    }

    /// With trackers on the same body: where they are contradicts poses, too.
    pub fn with_trackers(self, trackers: Trackers) -> Self {
        Self { trackers: Some(trackers), ..self }
    }

    /// Where trackers on the body are at the time of the next samples.
    pub fn push_places(&mut self, places: &Places) {
        if let Some(trackers) = &mut self.trackers {
            trackers.push(places);
        }
    }

    /// Takes the samples of one time, s; times that do not rise, and all after the last step, change nothing.
    pub fn push(&mut self, t_s: f64, samples: &BodySamples) {
        let Some(kind) = self.steps.get(self.at).copied() else { return };
        let dt_s = self.recording.last().map_or(0.01, |(last_s, _)| t_s - last_s);
        if dt_s <= 0.0 {
            return;
        }
        self.recording.push((t_s, *samples));
        self.tracks.push(t_s, samples);
        let gain = dt_s / (SMOOTH_S + dt_s);
        for (index, sample) in samples.iter().enumerate() {
            let Some(sample) = sample.filter(usable) else { continue };
            self.heard_s[index] = Some(t_s);
            self.angular_speeds_rad_s[index] +=
                gain * (sample.gyro_rad_s.norm() - self.angular_speeds_rad_s[index]);
            self.specific_forces_m_s2[index] += (sample.accel_m_s2 - self.specific_forces_m_s2[index]) * gain;
        }
        for (turn, angular_speed_rad_s) in self.turns.iter_mut().zip(&self.angular_speeds_rad_s) {
            turn.push(t_s, dt_s, *angular_speed_rad_s);
        }
        if self.silent().next().is_some() {
            // What is not heard can't have been done as asked.
            self.begin_step();
        } else if matches!(kind, BlockKind::NPose | BlockKind::TPose) {
            self.pose(kind, t_s)
        } else if kind == BlockKind::Walk {
            self.walk(t_s, dt_s);
        } else {
            self.movement(kind, t_s)
        }
    }

    /// The sensors that are not heard any more, or never were, by the segments that they were taken to sit on: nothing goes on before they are.
    pub fn silent(&self) -> impl Iterator<Item = BodySegment> + '_ {
        let span = self.recording.first().zip(self.recording.last());
        let is_silent = move |index: usize| {
            span.is_some_and(|((first_s, _), (now_s, _))| {
                now_s - self.heard_s[index].unwrap_or(*first_s) > SILENT_S
            })
        };
        BodySegment::ALL
            .into_iter()
            .filter(move |segment| self.present[segment.index()] && is_silent(segment.index()))
    }

    /// How many steps (poses and movements) are done, of how many.
    pub fn progress(&self) -> (usize, usize) {
        (self.at, self.steps.len())
    }

    /// The pose or movement that is to be done now; `None` once all is done.
    pub fn step(&self) -> Option<BlockKind> {
        self.steps.get(self.at).copied()
    }

    /// What to do now, a sentence without a full stop; `None` once all is done.
    pub fn prompt(&self) -> Option<&'static str> {
        self.step().map(words)
    }

    /// What contradicted the step that was to be the last, a sentence without a full stop; `None` where nothing did. With how many
    /// steps were contradicted by now.
    pub fn objection(&self) -> (usize, Option<&str>) {
        (self.objections, self.objection.as_deref())
    }

    /// What has been recorded, and when which pose or movement was held: for [`super::calibrate::calibrate`] or
    /// [`super::assign::assign`].
    pub fn recorded(&self) -> (&[Recorded], &[Block]) {
        (&self.recording, &self.blocks)
    }

    fn pose(&mut self, kind: BlockKind, t_s: f64) {
        let moves = self.all().any(|index| self.angular_speeds_rad_s[index] > MOVES_RAD_S);
        self.must_move &= !moves;
        let still = self.all().all(|index| self.angular_speeds_rad_s[index] < STILL_RAD_S);
        if !still
            || self.must_move
            || (kind == BlockKind::TPose && !self.raised())
            || !self.upright_again(kind)
        {
            self.still_since_s = None;
            if let Some(trackers) = &mut self.trackers {
                trackers.clear();
            }
            return;
        }
        let since_s = *self.still_since_s.get_or_insert(t_s);
        if t_s - since_s >= HOLD_S {
            if kind == BlockKind::NPose && self.hung.is_none() {
                self.hung = Some(self.specific_forces_m_s2);
            }
            self.done(Block { kind, start_s: since_s, end_s: t_s });
        }
    }

    fn walk(&mut self, t_s: f64, dt_s: f64) {
        let moves = |segment: BodySegment| {
            let index = segment.index();
            self.present[index] && self.angular_speeds_rad_s[index] > MOVES_RAD_S
        };
        if BodySegment::LEGS.into_iter().any(moves) {
            self.walked_s += dt_s;
            self.still_since_s.get_or_insert(t_s);
        } else if self.walked_s == 0.0 {
            self.still_since_s = None;
        }
        if let Some(start_s) = self.still_since_s.filter(|_| self.walked_s >= WALK_S) {
            self.done(Block { kind: BlockKind::Walk, start_s, end_s: t_s });
        }
    }

    fn movement(&mut self, kind: BlockKind, t_s: f64) {
        let asked: Vec<usize> = self.moved_by(kind).collect();
        let turns = || asked.iter().map(|index| self.turns[*index]);
        let began_s = turns().filter_map(|turn| turn.began_s).reduce(f64::min);
        // All of them rest since the last one does.
        let rest_s = turns().map(|turn| turn.rests_since_s).reduce(|a, b| Some(a?.max(b?))).flatten();
        let Some(began_s) = began_s else {
            if let Some(instead) = self.moved_instead(kind, t_s) {
                self.objection = Some(instead.to_string());
                self.objections += 1;
                self.begin_step();
            }
            return;
        };
        let Some(rest_s) = rest_s.filter(|rest_s| *rest_s > began_s && t_s - rest_s >= REST_S) else {
            return;
        };
        if rest_s - began_s >= MOVEMENT_S {
            self.done(Block { kind, start_s: began_s - LEAD_S, end_s: rest_s });
        } else {
            asked.into_iter().for_each(|index| self.turns[index].began_s = None);
        }
    }

    /// What moved in the place of the segment that was asked for: that of the other side, or one beside it.
    fn moved_instead(&self, kind: BlockKind, t_s: f64) -> Option<Contradiction> {
        let BlockKind::Move(asked, _) = kind else { return None };
        if !self.assigned || !self.present[asked.index()] {
            return None;
        }
        let whole = |other: &BodySegment| {
            *other != asked && self.present[other.index()] && self.turns[other.index()].is_whole(t_s)
        };
        // What hangs on it moves with it, whoever wears its sensor: asked last.
        let below = BodySegment::ALL.into_iter().find(|other| other.parent() == Some(asked));
        let mut beside = std::iter::once(asked.mirrored()).chain(asked.parent()).chain(below);
        let moved = beside.find(whole)?;
        Some(Contradiction::Instead { movement: kind.name(), asked: asked.name(), moved: moved.name() })
    }

    /// Whatever was held or done before counts no more.
    fn begin_step(&mut self) {
        self.still_since_s = None;
        self.walked_s = 0.0;
        self.turns = [Turn::default(); SEGMENTS];
    }

    fn done(&mut self, block: Block) {
        self.begin_step();
        self.blocks.push(block);
        let is_pose = matches!(block.kind, BlockKind::NPose | BlockKind::TPose);
        let misplaced = self.trackers.as_mut().filter(|_| is_pose).and_then(|at| at.objection_to(block.kind));
        if !self.tracks.are_as_expected() {
            self.tracks = Tracks::of(&self.recording);
        }
        let contradicted = objection_to(&self.recording, &self.tracks, &self.blocks, self.assigned);
        let was_lowered =
            matches!(contradicted, Some(CalibrationError::Contradicted(Contradiction::Lowered)));
        let was_objected_to = self.objection.is_some();
        // Trackers know where arms are, but not that they were to be there first.
        let misplaced = misplaced.filter(|_| !was_lowered).map(|misplaced| misplaced.to_string());
        self.objection = misplaced.or_else(|| Some(contradicted?.to_string()));
        if self.objection.is_none() {
            self.at += 1;
            return;
        }
        self.objections += 1;
        if was_lowered {
            // What was taken for the second pose was the first.
            self.blocks = vec![Block { kind: BlockKind::NPose, ..block }];
            (self.at, self.hung) = (1, Some(self.specific_forces_m_s2));
        } else if is_pose || was_objected_to {
            self.blocks.clear();
            (self.at, self.hung) = (0, None);
            self.must_move = block.kind == BlockKind::TPose;
        } else {
            self.blocks.pop();
        }
    }

    /// The sensors there are.
    fn all(&self) -> impl Iterator<Item = usize> + '_ {
        (0..SEGMENTS).filter(|index| self.present[*index])
    }

    /// Whether the arms are held sideways, as far as gravity shows it.
    fn raised(&self) -> bool {
        let Some(hung) = &self.hung else { return true };
        let raised = |index: &usize| self.specific_forces_m_s2[*index].angle(&hung[*index]) > RAISED_RAD;
        if self.assigned {
            arms(&self.present).all(|index| raised(&index))
        } else {
            self.all().filter(raised).count() >= arms(&self.present).count()
        }
    }

    /// Whether an N-pose that comes again is one: the arms hang as they did.
    fn upright_again(&self, kind: BlockKind) -> bool {
        let Some(hung) = &self.hung else { return true };
        let hangs = |index: usize| self.specific_forces_m_s2[index].angle(&hung[index]) < HANGS_RAD;
        kind != BlockKind::NPose
            || if self.assigned { arms(&self.present).all(hangs) } else { self.all().all(hangs) }
    }

    /// The sensors that show a movement.
    fn moved_by(&self, kind: BlockKind) -> impl Iterator<Item = usize> + '_ {
        let present = |segment: &BodySegment| self.present[segment.index()];
        let moved = match kind {
            BlockKind::Move(segment, _) => Some(segment),
            _ => TRUNK.into_iter().find(present),
        };
        self.all().filter(move |index| !self.assigned || moved.is_some_and(|moved| *index == moved.index()))
    }
}

fn arms(present: &[bool; SEGMENTS]) -> impl Iterator<Item = usize> + '_ {
    BodySegment::ARMS.into_iter().map(BodySegment::index).filter(|index| present[*index])
}

/// What a bow moves; the first that is worn shows it.
const TRUNK: [BodySegment; 4] =
    [BodySegment::Torso, BodySegment::Pelvis, BodySegment::ShoulderR, BodySegment::ShoulderL];

/// In the order in which they are bent where it is not known who is who.
const LIMBS: [BodySegment; 8] = [
    BodySegment::ForearmR,
    BodySegment::UpperArmR,
    BodySegment::ForearmL,
    BodySegment::UpperArmL,
    BodySegment::ShankR,
    BodySegment::ThighR,
    BodySegment::ShankL,
    BodySegment::ThighL,
];

/// What has to be done so that every sensor's mounting shows.
fn steps(present: &[bool; SEGMENTS], magnetic: bool, how: Thoroughness) -> Vec<BlockKind> {
    let has = |segment: BodySegment| present[segment.index()];
    if how == Thoroughness::Movement && magnetic {
        return vec![BlockKind::Walk];
    }
    let mut steps = vec![BlockKind::NPose];
    let bows = TRUNK.into_iter().any(has);
    let with_arms = arms(present).next().is_some();
    if with_arms {
        steps.push(BlockKind::TPose);
    }
    if how == Thoroughness::Assign {
        if with_arms {
            steps.push(BlockKind::NPose);
        }
        let bends = LIMBS.into_iter().chain(BodySegment::EXTREMITIES).filter(|limb| has(*limb));
        steps.extend(bends.map(|limb| BlockKind::Move(limb, Movement::Flexion)));
        let shrugs = BodySegment::SHOULDERS.into_iter().filter(|shoulder| has(*shoulder));
        steps.extend(shrugs.map(|shoulder| BlockKind::Move(shoulder, Movement::Elevation)));
        if bows {
            steps.push(BlockKind::Bow);
        }
        if has(BodySegment::Torso) && has(BodySegment::Pelvis) {
            steps.push(BlockKind::TrunkRotation);
        }
        steps.push(BlockKind::NPose);
        return steps;
    }
    let limbs = [BodySegment::ForearmR, BodySegment::ForearmL, BodySegment::ShankR, BodySegment::ShankL];
    // Without a field every sensor needs a movement of its own.
    let full = how == Thoroughness::Full || !magnetic;
    let mut moved = limbs.into_iter().filter(|moved| has(*moved) && full).peekable();
    let bends = moved.peek().is_some();
    if with_arms && bends {
        // Arms that are lowered must not be taken for the first movement.
        steps.push(BlockKind::NPose);
    }
    steps.extend(moved.map(|moved| BlockKind::Move(moved, Movement::Flexion)));
    if !magnetic {
        let thighs = [BodySegment::ThighR, BodySegment::ThighL].into_iter().filter(|thigh| has(*thigh));
        // The T-pose shows how hands are turned.
        let ends =
            [BodySegment::Head, BodySegment::FootR, BodySegment::FootL].into_iter().filter(|end| has(*end));
        steps.extend(thighs.chain(ends).map(|moved| BlockKind::Move(moved, Movement::Flexion)));
        if bows {
            steps.push(BlockKind::Bow);
        }
        // The headings begin anew from a posture that looks straight ahead.
        steps.push(BlockKind::NPose);
    } else if !with_arms && !bends {
        // Something must show which way the body faces. Feet and heads nod both ways alike, and show it to who wears nothing else.
        let leg = [BodySegment::ShankR, BodySegment::ShankL, BodySegment::ThighR, BodySegment::ThighL];
        let end = [BodySegment::Head, BodySegment::FootR, BodySegment::FootL];
        let ends = end.into_iter().filter(|_| !bows);
        let moved = leg.into_iter().chain(ends).find(|segment| has(*segment));
        steps.push(moved.map_or(BlockKind::Bow, |moved| BlockKind::Move(moved, Movement::Flexion)));
    }
    steps
}

/// What to do, for the person who wears the sensors.
fn words(kind: BlockKind) -> &'static str {
    match kind {
        BlockKind::NPose => "Stand upright, arms hanging, palms to the body, and hold still",
        BlockKind::TPose => {
            "Raise both arms sideways to the height of the shoulders, palms down, thumbs forward, and hold still"
        }
        BlockKind::Bow => "Bow forward with a straight back and come up again, twice; then stand still",
        BlockKind::Walk => {
            "Walk about as you do, always forwards, arms swinging, straight on and in turns, for half a minute"
        }
        BlockKind::TrunkRotation => {
            "Turn the chest to the left and back, twice, hips still; then stand still"
        }
        BlockKind::Move(BodySegment::ForearmR, _) => {
            "Bend the right elbow and let it hang again, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ForearmL, _) => {
            "Bend the left elbow and let it hang again, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ShankR, _) => {
            "Bend the right knee, heel to the back, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ShankL, _) => {
            "Bend the left knee, heel to the back, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ThighR, _) => {
            "Lift the right thigh forward, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ThighL, _) => {
            "Lift the left thigh forward, three times; then stand still"
        }
        BlockKind::Move(BodySegment::UpperArmL, _) => {
            "Lift the stretched left arm forward, three times; then stand still"
        }
        BlockKind::Move(BodySegment::Head, _) => {
            "Nod, chin to the chest and up again, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ShoulderR, _) => {
            "Raise the right shoulder towards the ear and let it sink, arm hanging, three times; then stand still"
        }
        BlockKind::Move(BodySegment::ShoulderL, _) => {
            "Raise the left shoulder towards the ear and let it sink, arm hanging, three times; then stand still"
        }
        BlockKind::Move(BodySegment::HandR, _) => {
            "Bend the right wrist towards the palm and back, three times; then stand still"
        }
        BlockKind::Move(BodySegment::HandL, _) => {
            "Bend the left wrist towards the palm and back, three times; then stand still"
        }
        BlockKind::Move(BodySegment::FootR, _) => {
            "Raise the toes of the right foot, heel on the floor, three times; then stand still"
        }
        BlockKind::Move(BodySegment::FootL, _) => {
            "Raise the toes of the left foot, heel on the floor, three times; then stand still"
        }
        BlockKind::Move(..) => "Lift the stretched right arm forward, three times; then stand still",
    }
}
