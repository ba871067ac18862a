//! BVH: the hierarchy with its offsets at rest in a T-pose, then one line per frame: the hips' place, and angles in degrees, Z then X then Y.

use std::fmt::Write;

use nalgebra::{UnitQuaternion, Vector3};

use super::Frame;
use super::humanoid::{Bone, Pose, below, bones};
use posed_fusion::body::{Skeleton, WholeSegment as W};

/// Which program's names a BVH file has, and its unit of length, which the format does not state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum BoneNames {
    /// All 23 segments by posed's own names; m.
    #[default]
    Posed,
    /// Those of Blender's Rigify; m.
    Blender,
    /// Those of MotionBuilder's HumanIK; cm.
    Motionbuilder,
    /// Those of Mixamo, `mixamorig:Hips`; cm.
    Mixamo,
}

impl BoneNames {
    /// `None` where the program knows no such bone.
    fn of(self, segment: W) -> Option<String> {
        let side = segment.side();
        let sided = |right: &'static str, left: &'static str| match side {
            side if side > 0.0 => right,
            side if side < 0.0 => left,
            _ => "",
        };
        match self {
            Self::Posed => Some(segment.name().to_owned()),
            Self::Blender => {
                let name = match segment {
                    W::Pelvis => "spine",
                    W::L5 => "spine.001",
                    W::L3 => return None,
                    W::T12 => "spine.002",
                    W::T8 => "spine.003",
                    W::Neck => "spine.004",
                    W::Head => "spine.006",
                    W::ShoulderR | W::ShoulderL => "shoulder",
                    W::UpperArmR | W::UpperArmL => "upper_arm",
                    W::ForearmR | W::ForearmL => "forearm",
                    W::HandR | W::HandL => "hand",
                    W::UpperLegR | W::UpperLegL => "thigh",
                    W::LowerLegR | W::LowerLegL => "shin",
                    W::FootR | W::FootL => "foot",
                    W::ToeR | W::ToeL => "toe",
                };
                Some(format!("{name}{}", sided(".R", ".L")))
            }
            Self::Motionbuilder | Self::Mixamo => {
                let name = match segment {
                    W::Pelvis => "Hips",
                    W::L5 => "Spine",
                    // HumanIK has up to ten pieces of the spine, Mixamo three.
                    W::L3 if self == Self::Mixamo => return None,
                    W::L3 => "Spine1",
                    W::T12 if self == Self::Mixamo => "Spine1",
                    W::T12 => "Spine2",
                    W::T8 if self == Self::Mixamo => "Spine2",
                    W::T8 => "Spine3",
                    W::Neck => "Neck",
                    W::Head => "Head",
                    W::ShoulderR | W::ShoulderL => "Shoulder",
                    W::UpperArmR | W::UpperArmL => "Arm",
                    W::ForearmR | W::ForearmL => "ForeArm",
                    W::HandR | W::HandL => "Hand",
                    W::UpperLegR | W::UpperLegL => "UpLeg",
                    W::LowerLegR | W::LowerLegL => "Leg",
                    W::FootR | W::FootL => "Foot",
                    W::ToeR | W::ToeL => "ToeBase",
                };
                let prefix = if self == Self::Mixamo { "mixamorig:" } else { "" };
                Some(format!("{prefix}{}{name}", sided("Right", "Left")))
            }
        }
    }

    /// Units of the file in a metre.
    fn per_m(self) -> f64 {
        match self {
            Self::Posed | Self::Blender => 1.0,
            Self::Motionbuilder | Self::Mixamo => 100.0,
        }
    }
}

/// Programs with names of their own take the first frame for the rest: for them it is the T-pose, above where the movement begins.
pub(super) fn text(skeleton: &Skeleton, rate_hz: f64, frames: &[Frame], names: BoneNames) -> String {
    let bones = bones(skeleton, |segment| names.of(segment));
    let per_m = names.per_m();
    let mut out = String::from("HIERARCHY\n");
    let mut order = Vec::new();
    joint(&mut out, &bones, 0, 0, per_m, &mut order);
    // Writing to a string cannot fail.
    let rest = frames.first().filter(|_| names != BoneNames::Posed);
    let count = frames.len() + usize::from(rest.is_some());
    let _ = writeln!(out, "MOTION\nFrames: {count}\nFrame Time: {:.9}", 1.0 / rate_hz);
    if let Some(first) = rest {
        let begin_m = Pose::of(first).hips_m;
        let stands_m = bones[0].offset_m.y;
        line(&mut out, Vector3::new(begin_m.x, stands_m, begin_m.z) * per_m, order.iter().map(|_| [0.0; 3]));
    }
    for frame in frames {
        let pose = Pose::of(frame);
        line(&mut out, pose.hips_m * per_m, order.iter().map(|at| zxy(&pose.local(&bones, *at))));
    }
    out
}

fn line(out: &mut String, hips: Vector3<f64>, angles_rad: impl Iterator<Item = [f64; 3]>) {
    let _ = write!(out, "{:.6} {:.6} {:.6}", hips.x, hips.y, hips.z);
    for angles_rad in angles_rad {
        let [z, x, y] = angles_rad.map(f64::to_degrees);
        let _ = write!(out, " {z:.6} {x:.6} {y:.6}");
    }
    out.push('\n');
}

fn joint(out: &mut String, bones: &[Bone], at: usize, depth: usize, per_m: f64, order: &mut Vec<usize>) {
    order.push(at);
    let pad = "\t".repeat(depth);
    let bone = &bones[at];
    let offset = |m: &Vector3<f64>| {
        let o = m * per_m;
        format!("OFFSET {:.6} {:.6} {:.6}", o.x, o.y, o.z)
    };
    // The root's place is among its channels.
    let (word, at_m, channels) = match bone.parent {
        None => ("ROOT", Vector3::zeros(), "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
        Some(_) => ("JOINT", bone.offset_m, "3 Zrotation Xrotation Yrotation"),
    };
    let _ = writeln!(out, "{pad}{word} {}\n{pad}{{", bone.name);
    let _ = writeln!(out, "{pad}\t{}\n{pad}\tCHANNELS {channels}", offset(&at_m));
    for child in below(bones, at) {
        joint(out, bones, child, depth + 1, per_m, order);
    }
    if let Some(end_m) = &bone.end_m {
        let _ = writeln!(out, "{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\t{}\n{pad}\t}}", offset(end_m));
    }
    let _ = writeln!(out, "{pad}}}");
}

/// Angles of `R_z(a) R_x(b) R_y(c)`, rad.
pub(super) fn zxy(q: &UnitQuaternion<f64>) -> [f64; 3] {
    let m = q.to_rotation_matrix().into_inner();
    let b = libm::asin(m[(2, 1)].clamp(-1.0, 1.0));
    if libm::cos(b) < 1e-6 {
        return [libm::atan2(m[(1, 0)], m[(0, 0)]), b, 0.0];
    }
    [libm::atan2(-m[(0, 1)], m[(1, 1)]), b, libm::atan2(-m[(2, 0)], m[(2, 2)])]
}
