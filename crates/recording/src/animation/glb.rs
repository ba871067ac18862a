//! Binary glTF 2.0: a skinned figure in a T-pose and one animation of its bones; the same as a VRM 1.0 model, and the animation alone for any VRM model.

use serde_json::{Map, Value, json};

use super::Frame;
use super::gltf::{Buffer, Channels, Contents, file};
use super::humanoid::{Bone, Pose, below, bones};
use super::skin::Skin;
use posed_fusion::body::{Skeleton, WholeSegment as W};

/// What a file is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Figure and animation, for browsers and programs for animation.
    Glb,
    /// The same as a model of VRM 1.0.
    Vrm,
    /// The animation of VRM 1.0, which any such model can play.
    Vrma,
}

/// The bone of VRM 1.0, and of the Unity humanoid; `None` of what it does not have.
fn vrm_bone(segment: W) -> Option<String> {
    let (name, side) = match segment {
        W::Pelvis => ("hips", ""),
        W::L5 => ("spine", ""),
        W::L3 => return None,
        W::T12 => ("chest", ""),
        W::T8 => ("upperChest", ""),
        W::Neck => ("neck", ""),
        W::Head => ("head", ""),
        W::ShoulderR => ("Shoulder", "right"),
        W::UpperArmR => ("UpperArm", "right"),
        W::ForearmR => ("LowerArm", "right"),
        W::HandR => ("Hand", "right"),
        W::ShoulderL => ("Shoulder", "left"),
        W::UpperArmL => ("UpperArm", "left"),
        W::ForearmL => ("LowerArm", "left"),
        W::HandL => ("Hand", "left"),
        W::UpperLegR => ("UpperLeg", "right"),
        W::LowerLegR => ("LowerLeg", "right"),
        W::FootR => ("Foot", "right"),
        W::ToeR => ("Toes", "right"),
        W::UpperLegL => ("UpperLeg", "left"),
        W::LowerLegL => ("LowerLeg", "left"),
        W::FootL => ("Foot", "left"),
        W::ToeL => ("Toes", "left"),
    };
    Some(format!("{side}{name}"))
}

/// Soles at height 0 in the rest pose, the hips above the origin.
pub(super) fn bytes(skeleton: &Skeleton, frames: &[Frame], kind: Kind) -> Vec<u8> {
    let bones = bones(skeleton, vrm_bone);
    let mut nodes = nodes(&bones);
    let mut roots = vec![0];
    let mut buffer = Buffer::default();
    let (mut meshes, mut skins) = (Vec::new(), Vec::new());
    if kind != Kind::Vrma {
        let skin = Skin::of(skeleton, &bones);
        roots.push(nodes.len());
        nodes.push(json!({"name": "body", "mesh": 0, "skin": 0}));
        meshes.push(json!({"name": "body", "primitives": [skin.primitive(&mut buffer)]}));
        let joints: Vec<usize> = (0..bones.len()).collect();
        let inverse_bind_matrices = buffer.matrices_of_translations(skin.joints_m.iter().map(|m| -m));
        skins.push(json!({"joints": joints, "skeleton": 0, "inverseBindMatrices": inverse_bind_matrices}));
    }
    let human_bones: Map<String, Value> =
        bones.iter().enumerate().map(|(node, bone)| (bone.name.clone(), json!({"node": node}))).collect();
    let humanoid = json!({"humanBones": human_bones});
    let extension = match kind {
        Kind::Glb => None,
        Kind::Vrm => {
            let meta = json!({
                "name": "posed", "authors": ["posed"], "licenseUrl": "https://vrm.dev/licenses/1.0/",
                "avatarPermission": "everyone", "commercialUsage": "corporation", "creditNotation": "unnecessary",
                "modification": "allowModificationRedistribution", "allowRedistribution": true
            });
            Some(("VRMC_vrm", json!({"specVersion": "1.0", "meta": meta, "humanoid": humanoid})))
        }
        Kind::Vrma => Some(("VRMC_vrm_animation", json!({"specVersion": "1.0", "humanoid": humanoid}))),
    };
    let channels = channels(&bones, frames, &mut buffer);
    let materials = vec![json!({"name": "body", "pbrMetallicRoughness": {
        "baseColorFactor": [0.435, 0.58, 0.72, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7
    }})];
    let materials = if meshes.is_empty() { Vec::new() } else { materials };
    file(Contents { name: "body", roots, nodes, meshes, skins, materials, extension }, channels, buffer)
}

fn nodes(bones: &[Bone]) -> Vec<Value> {
    let node = |(at, bone): (usize, &Bone)| {
        let m = bone.offset_m;
        let mut node = json!({"name": bone.name, "translation": [m.x, m.y, m.z]});
        let below: Vec<usize> = below(bones, at).collect();
        // An empty list is against the format.
        if !below.is_empty() {
            node["children"] = json!(below);
        }
        node
    };
    bones.iter().enumerate().map(node).collect()
}

fn channels(bones: &[Bone], frames: &[Frame], buffer: &mut Buffer) -> Channels {
    let begin_s = frames.first().map_or(0.0, |frame| frame.t_s);
    let times: Vec<f32> = frames.iter().map(|frame| (frame.t_s - begin_s) as f32).collect();
    let mut channels = Channels::new(buffer.floats("SCALAR", 1, &times));
    let poses: Vec<Pose> = frames.iter().map(Pose::of).collect();
    for at in 0..bones.len() {
        let output = buffer.rotations(poses.iter().map(|pose| pose.local(bones, at)));
        channels.push(at, "rotation", output);
    }
    let output = buffer.vectors(poses.iter().map(|pose| pose.hips_m));
    channels.push(0, "translation", output);
    channels
}
