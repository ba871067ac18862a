//! Which joint of the body a name in a file means.
//!
//! In: names of bones (their upper end counts) or of points. Out: indices by [`Joint`]. It follows the names of Blender's Rigify, MotionBuilder, Mixamo, VRM,
//! MVN, 3ds Max, Poser, Unreal, SMPL, CMU and posed itself; what it does not know, it leaves out.

/// A joint's centre, or a point that shows where a segment points to; 0 is the right side, 1 the left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Joint {
    /// Between the hips, or near it.
    Root,
    /// A joint of the spine above the pelvis.
    Spine,
    /// Where the head begins.
    Neck,
    /// The top of the head, or a point within.
    Head,
    /// Centre of a hip.
    Hip(usize),
    /// Centre of a knee.
    Knee(usize),
    /// Centre of an ankle.
    Ankle(usize),
    /// Ball of a foot, or its toes.
    Ball(usize),
    /// Centre of a shoulder.
    Shoulder(usize),
    /// Centre of an elbow.
    Elbow(usize),
    /// Centre of a wrist.
    Wrist(usize),
}

/// How many there are.
pub(super) const JOINTS: usize = 18;

impl Joint {
    pub(super) const ALL: [Self; JOINTS] = [
        Self::Root,
        Self::Spine,
        Self::Neck,
        Self::Head,
        Self::Hip(0),
        Self::Hip(1),
        Self::Knee(0),
        Self::Knee(1),
        Self::Ankle(0),
        Self::Ankle(1),
        Self::Ball(0),
        Self::Ball(1),
        Self::Shoulder(0),
        Self::Shoulder(1),
        Self::Elbow(0),
        Self::Elbow(1),
        Self::Wrist(0),
        Self::Wrist(1),
    ];

    /// Its place in [`Self::ALL`].
    pub(super) fn index(self) -> usize {
        match self {
            Self::Root => 0,
            Self::Spine => 1,
            Self::Neck => 2,
            Self::Head => 3,
            Self::Hip(side) => 4 + side,
            Self::Knee(side) => 6 + side,
            Self::Ankle(side) => 8 + side,
            Self::Ball(side) => 10 + side,
            Self::Shoulder(side) => 12 + side,
            Self::Elbow(side) => 14 + side,
            Self::Wrist(side) => 16 + side,
        }
    }

    fn side(self) -> Option<usize> {
        match self {
            Self::Root | Self::Spine | Self::Neck | Self::Head => None,
            Self::Hip(side)
            | Self::Knee(side)
            | Self::Ankle(side)
            | Self::Ball(side)
            | Self::Shoulder(side)
            | Self::Elbow(side)
            | Self::Wrist(side) => Some(side),
        }
    }

    /// What a body cannot be followed without.
    pub(super) fn is_needed(self) -> bool {
        matches!(self, Self::Knee(_) | Self::Ankle(_) | Self::Shoulder(_) | Self::Elbow(_) | Self::Wrist(_))
    }

    /// What bones are called that begin there, or points that lie there, the surest first.
    fn names(self) -> &'static [&'static str] {
        match self {
            Self::Root => &["hips", "pelvis", "hip", "hipcenter", "midhip", "root", "spine"],
            Self::Spine => &[
                "l5",
                "jl5s1",
                "spine",
                "abdomen",
                "spine1",
                "spine01",
                "spine001",
                "l3",
                "spine2",
                "spine02",
                "spine002",
                "lowerback",
                "chest",
                "upperback",
                "t12",
            ],
            Self::Neck => &["neck", "neck1", "neck01", "spine004", "lowerneck", "upperneck"],
            Self::Head => &[
                "headtopend",
                "headtop",
                "headend",
                "headnub",
                "headsite",
                "spine006end",
                "head",
                "spine006",
            ],
            Self::Hip(_) => &["upleg", "upperleg", "thigh", "femur", "hip", "upleg1"],
            Self::Knee(_) => &["lowerleg", "lowleg", "leg", "shin", "calf", "shank", "knee", "tibia"],
            Self::Ankle(_) => &["ankle", "foot"],
            Self::Ball(_) => {
                &["toebase", "toe", "toes", "toe0", "ball", "forefoot", "bigtoe", "foot", "footend"]
            }
            Self::Shoulder(_) => &["upperarm", "uparm", "arm", "shldr", "humerus", "shoulder"],
            Self::Elbow(_) => &["forearm", "lowerarm", "lowarm", "elbow", "radius"],
            Self::Wrist(_) => &["wrist", "hand"],
        }
    }

    /// And bones that end there: points of a table with the names of an ASF skeleton.
    fn ends(self) -> &'static [&'static str] {
        match self {
            Self::Root => &["root"],
            Self::Spine => &["lowerback", "upperback"],
            Self::Neck => &["upperneck", "lowerneck", "thorax"],
            Self::Head => &["head"],
            Self::Hip(_) => &["hipjoint"],
            Self::Knee(_) => &["femur"],
            Self::Ankle(_) => &["tibia"],
            Self::Ball(_) => &["foot"],
            Self::Shoulder(_) => &["clavicle"],
            Self::Elbow(_) => &["humerus"],
            Self::Wrist(_) => &["radius"],
        }
    }
}

impl std::fmt::Display for Joint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.side() {
            Some(0) => f.write_str("right ")?,
            Some(_) => f.write_str("left ")?,
            None => {}
        }
        f.write_str(match self {
            Self::Root => "hips",
            Self::Spine => "spine",
            Self::Neck => "neck",
            Self::Head => "head",
            Self::Hip(_) => "hip",
            Self::Knee(_) => "knee",
            Self::Ankle(_) => "ankle",
            Self::Ball(_) => "toes",
            Self::Shoulder(_) => "shoulder",
            Self::Elbow(_) => "elbow",
            Self::Wrist(_) => "wrist",
        })
    }
}

/// Words of a name in small letters: `mixamorig:LeftUpLeg` has `left`, `up`, `leg`.
pub(super) fn words(name: &str) -> Vec<String> {
    let name = name.rsplit(':').next().unwrap_or(name);
    let letters: Vec<char> = name.chars().collect();
    let mut words: Vec<String> = Vec::new();
    for (at, letter) in letters.iter().enumerate() {
        let before = at.checked_sub(1).map(|at| letters[at]);
        let next = letters.get(at + 1);
        let begins = match before {
            None => true,
            Some(before) => {
                !before.is_alphanumeric()
                    || letter.is_uppercase()
                        && (before.is_lowercase() || next.is_some_and(|next| next.is_lowercase()))
            }
        };
        if !letter.is_alphanumeric() {
            continue;
        }
        if begins {
            words.push(String::new());
        }
        if let Some(word) = words.last_mut() {
            word.extend(letter.to_lowercase());
        }
    }
    words
}

/// Words that say which program a bone is of, not which bone it is.
const PROGRAMS: [&str; 10] =
    ["mixamorig", "bip", "character", "valve", "j", "def", "org", "mvn", "biped", "c"];
/// Bones of ASF skeletons, whose side is written before them without a gap.
const ASF: [&str; 10] =
    ["hipjoint", "femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius", "wrist", "hand"];

/// Side and bone that these words name.
fn bone(words: &[String]) -> (Option<usize>, String) {
    let mut side = None;
    let mut bone = String::new();
    for word in words {
        let program = word.trim_end_matches(|letter: char| letter.is_ascii_digit());
        if PROGRAMS.contains(&program) {
            continue;
        }
        match word.as_str() {
            "r" | "right" => side = Some(0),
            "l" | "left" => side = Some(1),
            word => bone.push_str(word),
        }
    }
    for (at, long, short) in [(0, "right", 'r'), (1, "left", 'l')] {
        if side.is_none()
            && let Some(rest) = bone.strip_prefix(long).or_else(|| bone.strip_suffix(long))
            && !rest.is_empty()
        {
            (side, bone) = (Some(at), rest.to_owned());
        }
        if side.is_none()
            && let Some(rest) = bone.strip_prefix(short)
            && ASF.contains(&rest)
        {
            (side, bone) = (Some(at), rest.to_owned());
        }
    }
    (side, bone)
}

/// Indices of the names that mean the joints, several for a spine, from its lower end; `points`: the names of a table, which may be those of bones that end there.
///
/// # Errors
/// The first joint that is missing.
pub(super) fn find(names: &[Vec<String>], points: bool) -> Result<[Vec<usize>; JOINTS], Joint> {
    let bones: Vec<(Option<usize>, String)> = names.iter().map(|words| bone(words)).collect();
    let asf =
        points && ["femur", "tibia", "humerus"].iter().all(|name| bones.iter().any(|(_, bone)| bone == name));
    let mut found: [Vec<usize>; JOINTS] = Default::default();
    for joint in Joint::ALL {
        let known = if asf { joint.ends() } else { joint.names() };
        found[joint.index()] = known
            .iter()
            .filter_map(|name| bones.iter().position(|(side, bone)| *side == joint.side() && bone == name))
            .collect();
    }
    // The same bone is not two joints: `foot` is where SMPL's toes begin, `spine` is Rigify's pelvis.
    for (taken, of) in
        [(Joint::Ankle(0), Joint::Ball(0)), (Joint::Ankle(1), Joint::Ball(1)), (Joint::Root, Joint::Spine)]
    {
        let first = found[taken.index()].first().copied();
        found[of.index()].retain(|at| Some(*at) != first);
    }
    if found[Joint::Root.index()].is_empty() && found[Joint::Hip(0).index()].is_empty() {
        return Err(Joint::Root);
    }
    match Joint::ALL.into_iter().find(|joint| joint.is_needed() && found[joint.index()].is_empty()) {
        Some(joint) => Err(joint),
        None => Ok(found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hips, knees, ankles, toes, shoulders, elbows and wrists of a program's figure, right and left by turns.
    fn found(names: &str) -> [Vec<usize>; JOINTS] {
        let names: Vec<Vec<String>> = names.split(',').map(words).collect();
        find(&names, false).unwrap()
    }

    #[test]
    fn the_names_of_the_usual_programs_are_known() {
        for names in [
            "Hips,RightUpLeg,LeftUpLeg,RightLeg,LeftLeg,RightFoot,LeftFoot,RightToeBase,LeftToeBase,RightArm,LeftArm,RightForeArm,LeftForeArm,RightHand,LeftHand,RightShoulder,LeftShoulder,Spine,Neck,Head",
            "mixamorig:Hips,mixamorig:RightUpLeg,mixamorig:LeftUpLeg,mixamorig:RightLeg,mixamorig:LeftLeg,mixamorig:RightFoot,mixamorig:LeftFoot,mixamorig:RightToeBase,mixamorig:LeftToeBase,mixamorig:RightArm,mixamorig:LeftArm,mixamorig:RightForeArm,mixamorig:LeftForeArm,mixamorig:RightHand,mixamorig:LeftHand",
            "spine,thigh.R,thigh.L,shin.R,shin.L,foot.R,foot.L,toe.R,toe.L,upper_arm.R,upper_arm.L,forearm.R,forearm.L,hand.R,hand.L,shoulder.R,shoulder.L,spine.001,spine.004,spine.006",
            "J_Bip_C_Hips,J_Bip_R_UpperLeg,J_Bip_L_UpperLeg,J_Bip_R_LowerLeg,J_Bip_L_LowerLeg,J_Bip_R_Foot,J_Bip_L_Foot,J_Bip_R_ToeBase,J_Bip_L_ToeBase,J_Bip_R_UpperArm,J_Bip_L_UpperArm,J_Bip_R_LowerArm,J_Bip_L_LowerArm,J_Bip_R_Hand,J_Bip_L_Hand",
            "hips,rightUpperLeg,leftUpperLeg,rightLowerLeg,leftLowerLeg,rightFoot,leftFoot,rightToes,leftToes,rightUpperArm,leftUpperArm,rightLowerArm,leftLowerArm,rightHand,leftHand",
            "Pelvis,RightUpperLeg,LeftUpperLeg,RightLowerLeg,LeftLowerLeg,RightFoot,LeftFoot,RightToe,LeftToe,RightUpperArm,LeftUpperArm,RightForeArm,LeftForeArm,RightHand,LeftHand,RightShoulder,LeftShoulder,L5",
            "Hips,RightHip,LeftHip,RightKnee,LeftKnee,RightAnkle,LeftAnkle,RightToe,LeftToe,RightShoulder,LeftShoulder,RightElbow,LeftElbow,RightWrist,LeftWrist,RightCollar,LeftCollar",
            "Bip01 Pelvis,Bip01 R Thigh,Bip01 L Thigh,Bip01 R Calf,Bip01 L Calf,Bip01 R Foot,Bip01 L Foot,Bip01 R Toe0,Bip01 L Toe0,Bip01 R UpperArm,Bip01 L UpperArm,Bip01 R Forearm,Bip01 L Forearm,Bip01 R Hand,Bip01 L Hand,Bip01 R Clavicle",
            "hip,rThigh,lThigh,rShin,lShin,rFoot,lFoot,rToe,lToe,rShldr,lShldr,rForeArm,lForeArm,rHand,lHand,rCollar,abdomen",
            "pelvis,thigh_r,thigh_l,calf_r,calf_l,foot_r,foot_l,ball_r,ball_l,upperarm_r,upperarm_l,lowerarm_r,lowerarm_l,hand_r,hand_l,clavicle_r,spine_01",
            "pelvis,right_hip,left_hip,right_knee,left_knee,right_ankle,left_ankle,right_foot,left_foot,right_shoulder,left_shoulder,right_elbow,left_elbow,right_wrist,left_wrist,right_collar,right_hand",
            "root,rfemur,lfemur,rtibia,ltibia,rfoot,lfoot,rtoes,ltoes,rhumerus,lhumerus,rradius,lradius,rwrist,lwrist,rhipjoint,lowerback",
            "Hips,UpperLeg_R,UpperLeg_L,LowerLeg_R,LowerLeg_L,Foot_R,Foot_L,Toes_R,Toes_L,UpperArm_R,UpperArm_L,LowerArm_R,LowerArm_L,Hand_R,Hand_L,Shoulder_R",
            "pelvis,upper_leg_r,upper_leg_l,lower_leg_r,lower_leg_l,foot_r,foot_l,toe_r,toe_l,upper_arm_r,upper_arm_l,forearm_r,forearm_l,hand_r,hand_l,shoulder_r,l5",
            "HIPS,RIGHTUPLEG,LEFTUPLEG,RIGHTLEG,LEFTLEG,RIGHTFOOT,LEFTFOOT,RIGHTTOE,LEFTTOE,RIGHTARM,LEFTARM,RIGHTFOREARM,LEFTFOREARM,RIGHTHAND,LEFTHAND",
        ] {
            let found = found(names);
            assert_eq!(found[0][0], 0, "{names}");
            for (index, joint) in Joint::ALL.iter().enumerate().skip(4) {
                assert_eq!(found[index].first(), Some(&(index - 3)), "{joint} in {names}");
            }
        }
    }

    #[test]
    fn points_of_an_asf_skeleton_are_the_ends_of_its_bones() {
        let names = "root,lfemur,ltibia,lfoot,ltoes,rfemur,rtibia,rfoot,rtoes,lowerback,thorax,head,lclavicle,lhumerus,lradius,rclavicle,rhumerus,rradius,upperneck";
        let names: Vec<Vec<String>> = names.split(',').map(words).collect();
        let found = find(&names, true).unwrap();
        let of = |joint: Joint| found[joint.index()].first().copied();
        assert_eq!(
            [of(Joint::Knee(1)), of(Joint::Ankle(0)), of(Joint::Ball(0))],
            [Some(1), Some(6), Some(7)]
        );
        assert_eq!(
            [of(Joint::Shoulder(0)), of(Joint::Wrist(1)), of(Joint::Hip(0))],
            [Some(15), Some(14), None]
        );
    }

    #[test]
    fn what_is_missing_is_named() {
        let names: Vec<Vec<String>> = ["Hips", "RightLeg", "LeftLeg", "RightFoot"].map(words).to_vec();
        assert_eq!(find(&names, false).unwrap_err().to_string(), "left ankle");
        assert_eq!(find(&[words("RightLeg")], false).unwrap_err().to_string(), "hips");
    }
}
