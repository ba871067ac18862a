//! TRC: joint centres as markers, metres.

use std::fmt::Write;
use std::path::Path;

use super::Frame;
use super::markers::{MARKERS, points};
use posed_fusion::body::{Skeleton, upright};

pub(super) fn text(skeleton: &Skeleton, rate_hz: f64, frames: &[Frame], path: &Path) -> String {
    let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let (count, markers) = (frames.len(), MARKERS.len());
    let mut out = format!("PathFileType\t4\t(X/Y/Z)\t{name}\n");
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
         {rate_hz:.6}\t{rate_hz:.6}\t{count}\t{markers}\tm\t{rate_hz:.6}\t1\t{count}"
    );
    let _ = writeln!(out, "Frame#\tTime\t{}", MARKERS.map(|marker| format!("{marker}\t\t")).join("\t"));
    let numbers: Vec<String> = (1..=markers).map(|k| format!("X{k}\tY{k}\tZ{k}")).collect();
    let _ = writeln!(out, "\t\t{}\n", numbers.join("\t"));
    // To x forward, y up, z right.
    let up = upright().inverse();
    for (k, frame) in frames.iter().enumerate() {
        let _ = write!(out, "{}\t{:.6}", k + 1, frame.t_s);
        for point in points(skeleton, frame).map(|point| up * point) {
            let _ = write!(out, "\t{:.6}\t{:.6}\t{:.6}", point.x, point.y, point.z);
        }
        out.push('\n');
    }
    out
}
