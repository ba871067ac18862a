//! Drawings: the courses of a joint, and a figure over weeks.

use std::fmt::Write;

use super::html::escaped;

const WIDTH: f64 = 300.0;
const HEIGHT: f64 = 150.0;
/// Room for numbers on the left and below.
const LEFT: f64 = 34.0;
const BELOW: f64 = 16.0;
const EDGE: f64 = 6.0;
/// Lines across, at most.
const LINES: f64 = 4.0;
/// Least span of a drawing: points, degrees or repetitions.
const LEAST_SPAN: f64 = 10.0;
/// Distances of the lines.
const STEPS: [f64; 12] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 1e4, 1e5];
/// Repetitions that are drawn at most; of more, some at equal distances.
const CURVES: usize = 60;

/// Places within the drawing.
struct Scale {
    x: [f64; 2],
    y: [f64; 2],
    step: f64,
}

impl Scale {
    /// Whole steps around all values.
    fn around(x: [f64; 2], values: impl Iterator<Item = f64> + Clone) -> Self {
        let least = values.clone().fold(f64::INFINITY, f64::min);
        let greatest = values.fold(f64::NEG_INFINITY, f64::max);
        let (least, greatest) = if least > greatest { (0.0, 0.0) } else { (least, greatest) };
        // What hardly changes is not drawn as if it did.
        let missing = (LEAST_SPAN - (greatest - least)).max(0.0);
        let (least, greatest) = (least - missing / 2.0, greatest + missing / 2.0);
        let rough = (greatest - least) / LINES;
        let step = STEPS.into_iter().find(|step| *step >= rough).unwrap_or(rough);
        let (low, high) = ((least / step).floor() * step, (greatest / step).ceil() * step);
        Self { x, y: [low, if high > low { high } else { low + step }], step }
    }

    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let share =
            |value: f64, [low, high]: [f64; 2]| if high > low { (value - low) / (high - low) } else { 0.5 };
        let (width, height) = (WIDTH - LEFT - EDGE, HEIGHT - BELOW - EDGE);
        (LEFT + width * share(x, self.x), EDGE + height * (1.0 - share(y, self.y)))
    }

    fn line(&self, class: &str, points: impl Iterator<Item = (f64, f64)>) -> String {
        let mut line = format!("<polyline class=\"{class}\" points=\"");
        for (x, y) in points {
            let (x, y) = self.at(x, y);
            let _ = write!(line, "{x:.1},{y:.1} ");
        }
        line.truncate(line.trim_end().len());
        line + "\"/>"
    }

    /// The frame with its numbers; below at the left and at the right end stand two texts.
    fn begin(&self, name: &str, ends: [&str; 2]) -> String {
        let mut svg =
            format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">", escaped(name));
        let lines = ((self.y[1] - self.y[0]) / self.step).round() as u32;
        for line in 0..=lines {
            let value = self.y[0] + f64::from(line) * self.step;
            let (_, y) = self.at(self.x[0], value);
            let (right, text, below) = (WIDTH - EDGE, LEFT - 4.0, y + 3.5);
            let _ = write!(
                svg,
                "<line class=\"axis\" x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\"/>\
                 <text x=\"{text}\" y=\"{below:.1}\" text-anchor=\"end\">{value:.0}</text>"
            );
        }
        let [left, right] = ends.map(escaped);
        let (end, below) = (WIDTH - EDGE, HEIGHT - 3.0);
        let _ = write!(
            svg,
            "<text x=\"{LEFT}\" y=\"{below}\">{left}</text>\
             <text x=\"{end}\" y=\"{below}\" text-anchor=\"end\">{right}</text>"
        );
        svg
    }
}

/// The courses of a joint over repetitions, degrees, over the demonstration.
pub(super) fn courses(name: &str, demonstration_deg: &[f64], own_deg: &[&[f64]], ends: [&str; 2]) -> String {
    let all = demonstration_deg.iter().chain(own_deg.iter().copied().flatten()).copied();
    let scale = Scale::around([0.0, 1.0], all);
    let line = |class: &str, course: &[f64]| {
        let last = course.len().saturating_sub(1).max(1) as f64;
        scale.line(class, course.iter().enumerate().map(|(at, angle)| (at as f64 / last, *angle)))
    };
    let mut svg = scale.begin(name, ends);
    own_deg
        .iter()
        .step_by(own_deg.len().div_ceil(CURVES).max(1))
        .for_each(|course| svg += &line("own", course));
    svg += &line("taught", demonstration_deg);
    svg + "</svg>"
}

/// A figure over weeks: a point per session, and the goal where there is one.
pub(super) fn trend(name: &str, points: &[(f64, f64)], goal: Option<f64>, ends: [&str; 2]) -> String {
    let weeks = |pick: fn(f64, f64) -> f64| points.iter().map(|point| point.0).reduce(pick).unwrap_or(0.0);
    let x = [weeks(f64::min), weeks(f64::max)];
    let scale = Scale::around(x, points.iter().map(|point| point.1).chain(goal));
    let mut svg = scale.begin(name, ends);
    if let Some(goal) = goal {
        let ((_, y), right) = (scale.at(x[0], goal), WIDTH - EDGE);
        let _ =
            write!(svg, "<line class=\"goal\" x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{right}\" y2=\"{y:.1}\"/>");
    }
    svg += &scale.line("trend", points.iter().copied());
    for (week, value) in points {
        let (x, y) = scale.at(*week, *value);
        let _ = write!(svg, "<circle class=\"dot\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.5\"/>");
    }
    svg + "</svg>"
}
