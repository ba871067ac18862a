//! A picture of the published calibration of a field: Figs. 5 and 7 of Piperakis et al.

use nalgebra::Vector3;
use posed_baselines::cascade::Cascade;

use super::svg::Svg;

const WIDTH: f64 = 960.0;
const MARGIN: f64 = 50.0;
const TOP: f64 = 240.0;
const SIDE: f64 = 405.0;
const MEASURED: &str = "#999999";
const FILTERED: &str = "#1f77b4";
const CORRECTED: &str = "#d62728";
/// Below this a step or a residual is drawn as nothing, m.
const LEAST_M: f64 = 1e-7;

/// Draws how the filter's iterations and the rounds converged, and below it the two ends of the pole as they were measured, filtered and
/// corrected, from above and from the side, m.
pub(crate) fn draw(solved: &Cascade) -> String {
    let mut svg = Svg::new(WIDTH, TOP + SIDE + MARGIN);
    let steps_m = solved.track.steps.mean_m();
    curve(&mut svg, MARGIN, "mean step of the filter's iterations, m", &steps_m);
    let corner = MARGIN + SIDE + MARGIN;
    curve(&mut svg, corner, "network to filter after each round, rms, m", &solved.residuals_m);
    let mut x = MARGIN;
    for (name, colour) in [("measured", MEASURED), ("filtered", FILTERED), ("corrected", CORRECTED)] {
        svg.rectangle([x, TOP - 22.0], [10.0, 10.0], colour);
        svg.text([x + 16.0, TOP - 13.0], name);
        x += 110.0;
    }
    trajectories(&mut svg, [MARGIN, TOP], "from above", solved, |p| [p.x, p.y]);
    trajectories(&mut svg, [corner, TOP], "from the side", solved, |p| [p.x, p.z]);
    svg.finish()
}

/// One value for each iteration, on a logarithmic scale.
fn curve(svg: &mut Svg, left: f64, title: &str, values_m: &[f64]) {
    let (top, bottom) = (MARGIN, TOP - 60.0);
    svg.text([left, top - 20.0], title);
    let log = |m: f64| libm::log10(m.max(LEAST_M));
    let (low, high) = values_m
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| (low.min(log(*m)), high.max(log(*m))));
    let (low, high) = (low.floor(), high.ceil().max(low.floor() + 1.0));
    let last = values_m.len().saturating_sub(1).max(1);
    let x = |k: usize| left + 40.0 + (SIDE - 60.0) * k as f64 / last as f64;
    let y = |m: f64| bottom - (bottom - top) * (log(m) - low) / (high - low);
    for power in low as i32..=high as i32 {
        let m = 10f64.powi(power);
        svg.line([x(0), y(m)], [x(last), y(m)], "#ddd");
        svg.text([left, y(m) + 4.0], &format!("1e{power}"));
    }
    svg.polyline(values_m.iter().enumerate().map(|(k, m)| [x(k), y(*m)]), FILTERED);
    for (k, m) in values_m.iter().enumerate() {
        svg.disc([x(k), y(*m)], 3.0, FILTERED);
        svg.text([x(k) - 3.0, bottom + 16.0], &(k + 1).to_string());
    }
}

fn trajectories(
    svg: &mut Svg,
    [left, top]: [f64; 2],
    title: &str,
    solved: &Cascade,
    view: fn(&Vector3<f64>) -> [f64; 2],
) {
    svg.text([left, top + 8.0], title);
    let run = &solved.run;
    let mut lines: Vec<(Vec<[f64; 2]>, &str)> = Vec::new();
    for sensor in [0, run.sensors.len().saturating_sub(1)] {
        let [mut measured, mut filtered, mut corrected] = [const { Vec::new() }; 3];
        for (frame, pole) in run.frames.iter().zip(&solved.track.poles) {
            let Some(Some(reading)) = frame.readings.get(sensor) else { continue };
            measured.push(view(&reading.position_m));
            filtered.extend(pole.map(|pole| view(&pole.position_m(run.offset_m(sensor)))));
            corrected.push(view(&solved.network.correct(&reading.position_m)));
        }
        lines.extend([(measured, MEASURED), (filtered, FILTERED), (corrected, CORRECTED)]);
    }
    let points = || lines.iter().flat_map(|(points, _)| points);
    let bound =
        |axis: usize, pick: fn(f64, f64) -> f64, start: f64| points().map(|p| p[axis]).fold(start, pick);
    let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
    let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
    let scale = (SIDE - 20.0) / (high[0] - low[0]).max(high[1] - low[1]).max(1e-3);
    let place = |p: &[f64; 2]| [left + (p[0] - low[0]) * scale, top + 20.0 + (high[1] - p[1]) * scale];
    for (points, colour) in &lines {
        svg.polyline(points.iter().map(place), colour);
    }
    svg.line([left, top + SIDE + 10.0], [left + 0.5 * scale, top + SIDE + 10.0], "black");
    svg.text([left + 0.5 * scale + 6.0, top + SIDE + 14.0], "0.5 m");
}
