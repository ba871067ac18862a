//! A picture of a motion cut at its changes: the statistic over time, and the path.

use nalgebra::{Isometry3, Vector3};

use super::svg::Svg;
use posed_motion::keyframes::Spline;
use posed_motion::keyframes::{KeyPose, Trace};

const WIDTH: f64 = 960.0;
const MARGIN: f64 = 50.0;
const TOP: f64 = 260.0;
const SIDE: f64 = 400.0;
/// Colours of successive segments.
const COLOURS: [&str; 6] = ["#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf"];

/// Draws the statistic (on a root scale) with its threshold and the detections, and below it the recording in grey
/// and the spline, a colour per segment, obliquely and from above.
pub(crate) fn draw(
    title: &str,
    poses: &[Isometry3<f64>],
    trace: &[Trace],
    keys: &[KeyPose],
    spline: Option<&Spline>,
) -> String {
    let mut svg = Svg::new(WIDTH, TOP + SIDE + MARGIN);
    svg.text([MARGIN, 20.0], title);
    let last = poses.len().saturating_sub(1).max(1) as f64;
    let x = |frame: f64| MARGIN + (WIDTH - 2.0 * MARGIN) * frame / last;
    let highest =
        trace.iter().map(|trace| trace.score.value.max(trace.score.threshold)).fold(1e-12, f64::max);
    let y = |value: f64| TOP - MARGIN - (TOP - 2.0 * MARGIN) * (value.max(0.0) / highest).sqrt();
    svg.line([x(0.0), y(0.0)], [x(last), y(0.0)], "#999");
    svg.text([x(last) - 60.0, TOP - MARGIN + 16.0], &format!("frame {last}"));
    svg.text([4.0, y(highest) + 4.0], &format!("{highest:.3}"));
    svg.polyline(trace.iter().map(|trace| [x(trace.frame as f64), y(trace.score.threshold)]), "#c66");
    if let Some(first) = trace.first() {
        svg.text([4.0, y(first.score.threshold)], &format!("{:.3}", first.score.threshold));
    }
    svg.polyline(trace.iter().map(|trace| [x(trace.frame as f64), y(trace.score.value)]), "#1f77b4");
    for key in keys {
        let place = [x(key.frame as f64), y(key.score)];
        svg.line([place[0], y(0.0)], place, "#d62728");
        svg.disc(place, 3.0, "#d62728");
        svg.text([place[0] + 4.0, place[1] - 4.0], &key.frame.to_string());
    }
    let views: [(&str, View); 2] = [("oblique", oblique), ("from above", from_above)];
    for (index, (name, view)) in views.into_iter().enumerate() {
        let corner = [MARGIN + index as f64 * (SIDE + MARGIN), TOP];
        svg.text([corner[0], corner[1] - 6.0], name);
        draw_path(&mut svg, corner, poses, keys, spline, view);
    }
    svg.finish()
}

type View = fn(&Vector3<f64>) -> [f64; 2];

fn oblique(p: &Vector3<f64>) -> [f64; 2] {
    [p.x + 0.5 * p.y, p.z + 0.3 * p.y]
}

fn from_above(p: &Vector3<f64>) -> [f64; 2] {
    [p.x, p.y]
}

fn draw_path(
    svg: &mut Svg,
    corner: [f64; 2],
    poses: &[Isometry3<f64>],
    keys: &[KeyPose],
    spline: Option<&Spline>,
    view: View,
) {
    let flat: Vec<[f64; 2]> = poses.iter().map(|pose| view(&pose.translation.vector)).collect();
    let bounds = |c: usize| {
        let low = flat.iter().map(|point| point[c]).fold(f64::INFINITY, f64::min);
        let high = flat.iter().map(|point| point[c]).fold(f64::NEG_INFINITY, f64::max);
        (low, high)
    };
    let ((left, right), (bottom, top)) = (bounds(0), bounds(1));
    let scale = SIDE / (right - left).max(top - bottom).max(1e-9);
    let place = |point: &[f64; 2]| {
        [corner[0] + (point[0] - left) * scale, corner[1] + SIDE - (point[1] - bottom) * scale]
    };
    svg.polyline(flat.iter().map(place), "#bbb");
    let mut start = 0;
    let ends = keys.iter().map(|key| key.frame as usize).chain([poses.len().saturating_sub(1)]);
    for (index, end) in ends.enumerate() {
        if let Some(spline) = spline {
            let points =
                (start..=end).map(|frame| place(&view(&spline.pose(frame as f64).translation.vector)));
            svg.polyline(points, COLOURS[index % COLOURS.len()]);
        }
        if let Some(point) = flat.get(end) {
            svg.disc(place(point), 3.0, "#333");
        }
        start = end;
    }
}
