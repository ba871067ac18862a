//! A picture of a map: three slices through its middle, before and after.
//!
//! What comes in: a map. What goes out: an SVG drawing. Above, what the metal did: colour is the length of the
//! correction, arrows are the correction itself, magnified. Below, what is expected to remain.

use std::fmt::Write;

use nalgebra::Vector3;

use super::map::FieldMap;

/// Side of a panel and margins, in the picture's own units.
const PANEL: f64 = 320.0;
const MARGIN: f64 = 46.0;
/// Cells along the longer side of a panel; every second one in each direction has an arrow.
const CELLS: usize = 26;

/// A slice: the axes that run right and up, and the one that it cuts.
const SLICES: [(usize, usize, usize); 3] = [(0, 1, 2), (0, 2, 1), (1, 2, 0)];
const NAMES: [&str; 3] = ["x", "y", "z"];

struct Cell {
    right_m: f64,
    up_m: f64,
    correction_m: [f64; 2],
    before_m: f64,
    after_m: f64,
}

/// Draws a map as one SVG document: slices through the middle of the hull, before and after the correction. It makes
/// the fast form of the map for this, which takes a good part of a second.
pub fn svg(map: &FieldMap) -> String {
    let corrector = map.corrector();
    let [low, high] = map.hull.bounds_m();
    let center = Vector3::from(map.hull.center_m);
    let side_m = (high - low).max();
    let step_m = side_m / CELLS as f64;
    let slices = SLICES.map(|(right, up, cut)| {
        let mut cells = Vec::new();
        for i in 0..CELLS {
            for j in 0..CELLS {
                let mut z = center;
                z[right] = low[right] + (i as f64 + 0.5) * step_m;
                z[up] = low[up] + (j as f64 + 0.5) * step_m;
                if map.hull.outside_m(&z) > 0.0 {
                    continue;
                }
                let correction = corrector.unaligned(&z).0 - z;
                let corrected = corrector.correct(&z);
                cells.push(Cell {
                    right_m: z[right] - low[right],
                    up_m: z[up] - low[up],
                    correction_m: [correction[right], correction[up]],
                    before_m: correction.norm(),
                    after_m: corrected.sigma_m,
                });
            }
        }
        (right, up, cut, cells)
    });
    let all = || slices.iter().flat_map(|slice| &slice.3);
    let largest = |of: fn(&Cell) -> f64| all().map(of).fold(1e-6, f64::max);
    let (before_m, after_m) = (largest(|cell| cell.before_m), largest(|cell| cell.after_m));
    let scale = PANEL / side_m;
    // The longest arrow spans two cells.
    let magnify = 2.0 * step_m / before_m;
    let width = 3.0 * (PANEL + MARGIN) + MARGIN;
    let height = 2.0 * (PANEL + MARGIN) + 2.0 * MARGIN;
    let mut out = String::new();
    let _ = write!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" \
         font-size=\"13\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>"
    );
    for (row, (title, most_m)) in [
        (format!("Before: correction, up to {:.1} mm; arrows {magnify:.0} times", 1e3 * before_m), before_m),
        (format!("After: expected error, up to {:.1} mm ({})", 1e3 * after_m, map.report.model), after_m),
    ]
    .into_iter()
    .enumerate()
    {
        let top = MARGIN + row as f64 * (PANEL + 1.5 * MARGIN);
        let _ = write!(out, "<text x=\"{MARGIN}\" y=\"{:.0}\" font-size=\"16\">{title}</text>", top - 16.0);
        for (column, (right, up, cut, cells)) in slices.iter().enumerate() {
            let left = MARGIN + column as f64 * (PANEL + MARGIN);
            let _ = write!(
                out,
                "<g transform=\"translate({left:.0} {top:.0})\"><rect width=\"{PANEL}\" height=\"{PANEL}\" \
                 fill=\"none\" stroke=\"#999\"/>"
            );
            let size = step_m * scale;
            for cell in cells {
                let value = if row == 0 { cell.before_m } else { cell.after_m };
                let (x, y) = (cell.right_m * scale, PANEL - cell.up_m * scale);
                let _ = write!(
                    out,
                    "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{size:.1}\" height=\"{size:.1}\" fill=\"{}\"/>",
                    x - size / 2.0,
                    y - size / 2.0,
                    colour(value / most_m)
                );
            }
            if row == 0 {
                for cell in cells.iter().step_by(2) {
                    let (x, y) = (cell.right_m * scale, PANEL - cell.up_m * scale);
                    let dx = cell.correction_m[0] * magnify * scale;
                    let dy = -cell.correction_m[1] * magnify * scale;
                    let _ = write!(
                        out,
                        "<path d=\"M{x:.1} {y:.1}l{dx:.1} {dy:.1}\" stroke=\"#000\"/><circle cx=\"{x:.1}\" \
                         cy=\"{y:.1}\" r=\"1.3\"/>"
                    );
                }
            }
            let _ = write!(
                out,
                "<text x=\"0\" y=\"{:.0}\">{} {:.1} to {:.1} m, {} from {:.1} m up, at {} = {:.2} m</text></g>",
                PANEL + 16.0,
                NAMES[*right],
                low[*right],
                low[*right] + side_m,
                NAMES[*up],
                low[*up],
                NAMES[*cut],
                center[*cut]
            );
        }
    }
    out.push_str("</svg>\n");
    out
}

/// White to red over yellow.
fn colour(share: f64) -> String {
    let share = share.clamp(0.0, 1.0);
    let green = 255.0 * (1.0 - share * share);
    let blue = 225.0 * (1.0 - share).powi(3);
    format!("#ff{:02x}{:02x}", green.round() as u8, blue.round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_run_from_pale_to_red() {
        assert_eq!(colour(0.0), "#ffffe1");
        assert_eq!(colour(1.0), "#ff0000");
    }
}
