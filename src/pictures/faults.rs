//! The paper's figures: winner cells by class, and the distance over time.

use super::svg::Svg;
use posed_fusion::faults::Class;

const CELL: f64 = 18.0;
const MARGIN: f64 = 40.0;
const WIDTH: f64 = 960.0;
const HEIGHT: f64 = 200.0;

fn colour(class: Class) -> &'static str {
    match class {
        Class::Clean => "#2ca02c",
        Class::Inverted => "#1f77b4",
        Class::Anomalous => "#d62728",
        Class::Unknown => "#bbb",
    }
}

/// Draws the second layer, each cell in the colour of its class, cells that win for a frame in full and others pale;
/// below it every frame's distance from its cell, in the colour of the frame's class.
///
/// `frames` are winner cell, distance and class of each frame.
pub(crate) fn draw(
    title: &str,
    (rows, columns): (usize, usize),
    cells: &[Class],
    frames: &[(Option<usize>, f64, Class)],
) -> String {
    let top = MARGIN + rows as f64 * CELL + MARGIN;
    let mut svg = Svg::new(WIDTH, top + HEIGHT + MARGIN);
    svg.text([MARGIN, 24.0], title);
    let mut wins = vec![0u32; cells.len()];
    for cell in frames.iter().filter_map(|frame| frame.0) {
        if let Some(count) = wins.get_mut(cell) {
            *count += 1;
        }
    }
    for (cell, class) in cells.iter().enumerate() {
        let corner = [MARGIN + (cell % columns) as f64 * CELL, MARGIN + (cell / columns) as f64 * CELL];
        svg.rectangle(corner, [CELL - 1.0, CELL - 1.0], "#eee");
        let centre = [corner[0] + 0.5 * CELL, corner[1] + 0.5 * CELL];
        let radius = if wins[cell] > 0 { 0.4 * CELL } else { 0.1 * CELL };
        svg.disc(centre, radius, colour(*class));
    }
    let legend = MARGIN + columns as f64 * CELL + MARGIN;
    let classes = [Class::Clean, Class::Inverted, Class::Anomalous, Class::Unknown];
    for (k, class) in classes.into_iter().enumerate() {
        let y = MARGIN + 20.0 * (k + 1) as f64;
        svg.disc([legend, y - 4.0], 6.0, colour(class));
        svg.text([legend + 14.0, y], class.name());
    }
    let highest = frames.iter().map(|frame| frame.1).filter(|d| d.is_finite()).fold(1e-9, f64::max);
    let last = frames.len().saturating_sub(1).max(1) as f64;
    let bottom = top + HEIGHT;
    for (k, (_, distance, class)) in frames.iter().enumerate() {
        let x = MARGIN + (WIDTH - 2.0 * MARGIN) * k as f64 / last;
        if distance.is_finite() {
            svg.line([x, bottom], [x, bottom - HEIGHT * distance / highest], colour(*class));
        }
    }
    svg.text(
        [MARGIN, bottom + 18.0],
        &format!("distance over time, {} frames, at most {highest:.3}", frames.len()),
    );
    svg.finish()
}
