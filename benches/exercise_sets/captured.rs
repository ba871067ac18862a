//! Captured people: the joint angles of real movement, as noiseless sensors would have them.
//!
//! What comes in: a table of joint positions of a motion capture. What goes out: the simulated people's [`ANGLES`] of one side of the
//! body, frame by frame. What it never does: invent what positions cannot show; the turn of the forearm is missing.

use std::path::Path;

use nalgebra::Vector3;
use posed_recording::table::{SequenceFrame, SequenceOptions, Sequences, TableError, stem};
use posed_simulator::exercises::ANGLES;

/// A point that goes further than this from one frame to the next, m, is of another clip.
const CUT_M: f64 = 0.3;
/// Time without frames between two clips, s.
const BETWEEN_CLIPS_S: f64 = 5.0;

/// Joints by the names that motion captures give them, of the left and right side where there are two.
const PELVIS: [&str; 2] = ["root", "Hips"];
const NECK: [&str; 2] = ["thorax", "Neck"];
const SHOULDER: [[&str; 2]; 2] = [["lclavicle", "UpperArm_L"], ["rclavicle", "UpperArm_R"]];
const ELBOW: [[&str; 2]; 2] = [["lhumerus", "LowerArm_L"], ["rhumerus", "LowerArm_R"]];
const WRIST: [[&str; 2]; 2] = [["lradius", "Hand_L"], ["rradius", "Hand_R"]];
const KNEE: [[&str; 2]; 2] = [["lfemur", "LowerLeg_L"], ["rfemur", "LowerLeg_R"]];
const ANKLE: [[&str; 2]; 2] = [["ltibia", "Foot_L"], ["rtibia", "Foot_R"]];

/// One side of a captured person.
pub(crate) struct Captured {
    pub(crate) t_s: Vec<f64>,
    /// Angles, degrees: those of [`ANGLES`], frame by frame.
    pub(crate) angles_deg: Vec<Option<f64>>,
    /// What each frame shows; where nobody says, the name of the file.
    pub(crate) labels: Vec<String>,
}

/// Both sides of whom a table shows; `None` where it lacks a joint.
pub(crate) fn read(path: &Path, options: &SequenceOptions) -> Result<Option<[Captured; 2]>, TableError> {
    let sequences = Sequences::read(path, options)?;
    let [left, right] = [0, 1].map(|side| Side::of(&sequences.joints, side));
    let sides = left.zip(right);
    Ok(sides.map(|(left, right)| [left, right].map(|side| side.follow(&sequences, &stem(path)))))
}

/// Where the joints of one side are in a frame.
struct Side {
    left: bool,
    pelvis: usize,
    neck: usize,
    shoulders: [usize; 2],
    elbow: usize,
    wrist: usize,
    knee: usize,
    ankle: usize,
}

impl Side {
    fn of(joints: &[String], side: usize) -> Option<Self> {
        let find = |names: [&str; 2]| joints.iter().position(|joint| names.contains(&joint.as_str()));
        Some(Self {
            left: side == 0,
            pelvis: find(PELVIS)?,
            neck: find(NECK)?,
            shoulders: [find(SHOULDER[0])?, find(SHOULDER[1])?],
            elbow: find(ELBOW[side])?,
            wrist: find(WRIST[side])?,
            knee: find(KNEE[side])?,
            ankle: find(ANKLE[side])?,
        })
    }

    fn follow(&self, sequences: &Sequences, name: &str) -> Captured {
        let mut captured = Captured { t_s: Vec::new(), angles_deg: Vec::new(), labels: Vec::new() };
        let (mut before, mut shift_s): (Option<Vector3<f64>>, f64) = (None, 0.0);
        let rows = sequences.positions_m.chunks_exact(sequences.joints.len());
        for (SequenceFrame { t_s, label, .. }, row) in sequences.frames.iter().zip(rows) {
            let pelvis = row[self.pelvis].map(Vector3::from);
            if before.zip(pelvis).is_some_and(|(before, pelvis)| (pelvis - before).norm() > CUT_M) {
                shift_s += BETWEEN_CLIPS_S;
            }
            before = pelvis.or(before);
            captured.t_s.push(t_s + shift_s);
            captured.labels.push(label.as_deref().unwrap_or(name).to_owned());
            let angles = self.angles_deg(row);
            captured.angles_deg.extend(angles.unwrap_or([None; ANGLES.len()]));
        }
        captured
    }

    /// In the order of [`ANGLES`].
    fn angles_deg(&self, row: &[Option<[f64; 3]>]) -> Option<[Option<f64>; ANGLES.len()]> {
        let at = |joint: usize| row[joint].map(Vector3::from);
        let [left, right] = self.shoulders;
        let [pelvis, neck, left, right] = [at(self.pelvis)?, at(self.neck)?, at(left)?, at(right)?];
        let shoulder = if self.left { left } else { right };
        let [elbow, wrist, knee, ankle] = [at(self.elbow)?, at(self.wrist)?, at(self.knee)?, at(self.ankle)?];
        let trunk = (neck - pelvis).normalize();
        // Outwards on this side.
        let outwards = if self.left { left - right } else { right - left };
        let across = right - left;
        let upright = Axes::new(Vector3::z(), across, outwards)?;
        let of_trunk = Axes::new(trunk, across, outwards)?;
        let (upper_arm, thigh) = (elbow - shoulder, knee - pelvis);
        let [shoulder_flexion, shoulder_abduction] = of_trunk.swing_deg(upper_arm);
        let [hip_flexion, _] = upright.swing_deg(thigh);
        let trunk_flexion = libm::atan2(trunk.dot(&upright.forward), trunk.z).to_degrees();
        let between = |a: Vector3<f64>, b: Vector3<f64>| a.angle(&b).to_degrees();
        Some([
            Some(shoulder_flexion),
            Some(shoulder_abduction),
            Some(between(upper_arm, wrist - elbow)),
            None,
            Some(hip_flexion + trunk_flexion),
            Some(between(thigh, ankle - knee)),
            Some(trunk_flexion),
        ])
    }
}

/// Axes of a body: along it, to the front, and outwards on one side.
struct Axes {
    up: Vector3<f64>,
    forward: Vector3<f64>,
    outwards: Vector3<f64>,
}

impl Axes {
    /// From what is up, and from one shoulder to the other, to the right and outwards.
    fn new(up: Vector3<f64>, across: Vector3<f64>, outwards: Vector3<f64>) -> Option<Self> {
        let forward = up.cross(&across).try_normalize(1e-9)?;
        let outwards = (outwards - up * up.dot(&outwards)).try_normalize(1e-9)?;
        Some(Self { up, forward, outwards })
    }

    /// By how much a limb has swung from hanging, forwards and outwards, degrees: the way to it, without a place where that is undefined but
    /// straight above.
    fn swing_deg(&self, limb: Vector3<f64>) -> [f64; 2] {
        let (forward, outwards) = (limb.dot(&self.forward), limb.dot(&self.outwards));
        let sideways = libm::hypot(forward, outwards);
        let swung = libm::atan2(sideways, -limb.dot(&self.up)).to_degrees();
        if sideways < 1e-9 { [0.0; 2] } else { [swung * forward / sideways, swung * outwards / sideways] }
    }
}
