//! A picture of labels: two coloured bands per sequence, the truth and what was named.

use super::svg::Svg;
use posed_recording::table::Sequences;

use posed_motion::segments::runs;

const WIDTH: f64 = 960.0;
const LEFT: f64 = 150.0;
const BAND: f64 = 22.0;
const COLOURS: [&str; 14] = [
    "#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22",
    "#17becf", "#aec7e8", "#ffbb78", "#98df8a", "#c5b0d5",
];

/// One sequence.
#[derive(Clone, Debug)]
pub(crate) struct Bands<'a> {
    /// Its name.
    pub(crate) name: String,
    /// Times of its frames, s.
    pub(crate) t_s: &'a [f64],
    /// The truth, if it is known.
    pub(crate) truth: Option<Vec<Option<u16>>>,
    /// What was named.
    pub(crate) named: Vec<u16>,
}

/// Classes of a file's labels among `labels`, to which new ones are added; `None` where a frame is not scored.
pub(crate) fn classes(file: &Sequences, labels: &mut Vec<String>) -> Vec<Option<u16>> {
    let mut class = |label: &String| match labels.iter().position(|known| known == label) {
        Some(class) => class as u16,
        None => {
            labels.push(label.clone());
            (labels.len() - 1) as u16
        }
    };
    file.frames
        .iter()
        .map(|frame| frame.label.as_ref().filter(|_| !frame.transition).map(&mut class))
        .collect()
}

/// Draws all sequences below each other, on one scale of time, with a key of the colours.
pub(crate) fn draw(labels: &[String], sequences: &[Bands<'_>]) -> String {
    const COLUMNS: usize = 5;
    let rows = labels.len().div_ceil(COLUMNS);
    let height = 20.0 + sequences.len() as f64 * (2.0 * BAND + 30.0) + rows as f64 * 18.0 + 20.0;
    let mut svg = Svg::new(WIDTH, height);
    let length = |bands: &Bands<'_>| match (bands.t_s.first(), bands.t_s.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    };
    let longest = sequences.iter().map(length).fold(1e-9, f64::max);
    let mut y = 20.0;
    for bands in sequences {
        svg.text([8.0, y + BAND - 6.0], &format!("{}: truth", bands.name));
        svg.text([8.0, y + 2.0 * BAND - 4.0], "named");
        let truth: Vec<u16> = match &bands.truth {
            Some(truth) => truth.iter().map(|class| class.unwrap_or(u16::MAX)).collect(),
            None => Vec::new(),
        };
        for (row, classes) in [&truth, &bands.named].into_iter().enumerate() {
            for (class, first, end) in runs(classes.iter().copied()) {
                let Some(colour) = colour(class, labels) else { continue };
                let at = |frame: usize| {
                    let t_s = bands.t_s[frame.min(bands.t_s.len() - 1)] - bands.t_s[0];
                    LEFT + (WIDTH - LEFT - 20.0) * t_s / longest
                };
                svg.rectangle(
                    [at(first), y + row as f64 * (BAND + 2.0)],
                    [at(end) - at(first), BAND],
                    colour,
                );
            }
        }
        y += 2.0 * BAND + 12.0;
        svg.text([LEFT, y], "0 s");
        svg.text([WIDTH - 70.0, y], &format!("{longest:.1} s"));
        y += 18.0;
    }
    for (index, label) in labels.iter().enumerate() {
        let x = 20.0 + (index % COLUMNS) as f64 * (WIDTH - 40.0) / COLUMNS as f64;
        let y = y + (index / COLUMNS) as f64 * 18.0;
        if let Some(colour) = colour(index as u16, labels) {
            svg.rectangle([x, y], [12.0, 12.0], colour);
        }
        svg.text([x + 18.0, y + 10.0], label);
    }
    svg.finish()
}

fn colour(class: u16, labels: &[String]) -> Option<&'static str> {
    (usize::from(class) < labels.len()).then(|| COLOURS[usize::from(class) % COLOURS.len()])
}
