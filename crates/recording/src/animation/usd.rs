//! USD as text: a skeleton of UsdSkel at rest in a T-pose, and its animation. Sheets of the format: `UsdSkel` of OpenUSD.

use std::fmt::Write;

use nalgebra::Vector3;

use super::Frame;
use super::humanoid::{Pose, bones, joints_m};
use posed_fusion::body::{Skeleton, WholeSegment};

/// Time codes are frames.
pub(super) fn text(skeleton: &Skeleton, rate_hz: f64, frames: &[Frame]) -> String {
    let bones = bones(skeleton, |segment: WholeSegment| Some(segment.name().to_owned()));
    let mut paths: Vec<String> = Vec::with_capacity(bones.len());
    for bone in &bones {
        let above = bone.parent.map_or_else(String::new, |parent| format!("{}/", paths[parent]));
        paths.push(above + &bone.name);
    }
    let joints = list(paths.iter().map(|path| format!("\"{path}\"")));
    // Matrices of row vectors: what they move by is in the last row.
    let moves =
        |m: &Vector3<f64>| format!("( (1,0,0,0),(0,1,0,0),(0,0,1,0),({:.6},{:.6},{:.6},1) )", m.x, m.y, m.z);
    let vector = |m: &Vector3<f64>| format!("({:.6},{:.6},{:.6})", m.x, m.y, m.z);
    let last = frames.len().saturating_sub(1);
    let mut out = format!(
        "#usda 1.0\n(\n    defaultPrim = \"Body\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n    startTimeCode = 0\n    endTimeCode = {last}\n    \
         timeCodesPerSecond = {rate_hz:.6}\n    framesPerSecond = {rate_hz:.6}\n)\n\
         def SkelRoot \"Body\" (\n    prepend apiSchemas = [\"SkelBindingAPI\"]\n    kind = \"component\"\n)\n{{\n    \
         rel skel:skeleton = </Body/Skel>\n    rel skel:animationSource = </Body/Anim>\n    def Skeleton \"Skel\"\n    {{\n        \
         uniform token[] joints = {joints}\n        uniform matrix4d[] bindTransforms = {}\n        \
         uniform matrix4d[] restTransforms = {}\n    }}\n    def SkelAnimation \"Anim\"\n    {{\n        \
         uniform token[] joints = {joints}\n        half3[] scales = {}\n",
        list(joints_m(&bones).iter().map(moves)),
        list(bones.iter().map(|bone| moves(&bone.offset_m))),
        list(bones.iter().map(|_| "(1,1,1)".to_owned())),
    );
    let poses: Vec<Pose> = frames.iter().map(Pose::of).collect();
    out.push_str("        float3[] translations.timeSamples = {\n");
    let offsets = list(bones.iter().skip(1).map(|bone| vector(&bone.offset_m)));
    for (k, pose) in poses.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "            {k}: [{}, {}],",
            vector(&pose.hips_m),
            offsets.trim_matches(['[', ']'])
        );
    }
    out.push_str("        }\n        quatf[] rotations.timeSamples = {\n");
    for (k, pose) in poses.iter().enumerate() {
        let rotations = (0..bones.len()).map(|at| {
            let q = pose.local(&bones, at);
            format!("({:.7},{:.7},{:.7},{:.7})", q.w, q.i, q.j, q.k)
        });
        let _ = writeln!(out, "            {k}: {},", list(rotations));
    }
    out.push_str("        }\n    }\n}\n");
    out
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}
