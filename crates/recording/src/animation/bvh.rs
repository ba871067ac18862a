//! BVH: the hierarchy with offsets in metres, then one line of angles per frame, degrees, Z then X then Y.

use std::fmt::Write;

use nalgebra::UnitQuaternion;

use super::{Frame, children, end_m, offset_m};
use posed_fusion::body::{BodySegment, Skeleton};

pub(super) fn text(skeleton: &Skeleton, rate_hz: f64, frames: &[Frame]) -> String {
    let mut out = String::from("HIERARCHY\n");
    let mut order = Vec::new();
    joint(&mut out, skeleton, BodySegment::Pelvis, 0, &mut order);
    // Writing to a string cannot fail.
    let _ = writeln!(out, "MOTION\nFrames: {}\nFrame Time: {:.9}", frames.len(), 1.0 / rate_hz);
    for frame in frames {
        let p = frame.pelvis_m;
        let _ = write!(out, "{:.6} {:.6} {:.6}", p.x, p.y, p.z);
        for segment in &order {
            let own = frame.orientations[segment.index()];
            let local = match segment.parent() {
                Some(parent) => frame.orientations[parent.index()].inverse() * own,
                None => own,
            };
            let [z, x, y] = zxy(&local).map(f64::to_degrees);
            let _ = write!(out, " {z:.6} {x:.6} {y:.6}");
        }
        out.push('\n');
    }
    out
}

fn joint(
    out: &mut String,
    skeleton: &Skeleton,
    segment: BodySegment,
    depth: usize,
    order: &mut Vec<BodySegment>,
) {
    order.push(segment);
    let pad = "\t".repeat(depth);
    let o = offset_m(skeleton, segment);
    let (word, channels) = match segment.parent() {
        None => ("ROOT", "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
        Some(_) => ("JOINT", "3 Zrotation Xrotation Yrotation"),
    };
    let _ = writeln!(out, "{pad}{word} {}\n{pad}{{", segment.name());
    let _ = writeln!(out, "{pad}\tOFFSET {:.6} {:.6} {:.6}\n{pad}\tCHANNELS {channels}", o.x, o.y, o.z);
    let mut leaf = true;
    for child in children(segment) {
        leaf = false;
        joint(out, skeleton, child, depth + 1, order);
    }
    if leaf {
        let e = end_m(skeleton, segment);
        let _ = writeln!(
            out,
            "{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\tOFFSET {:.6} {:.6} {:.6}\n{pad}\t}}",
            e.x, e.y, e.z
        );
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
