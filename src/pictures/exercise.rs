//! A picture of a recording: its channels, and where the repetitions were seen.

use posed_recording::table::Streams;

const WIDTH: f64 = 1000.0;
/// Height of one channel.
const STRIP: f64 = 90.0;
const MARGIN: f64 = 10.0;
/// Points per channel: as many as the picture has pixels.
const POINTS: usize = 1000;

/// SVG of the columns among `shown`, with a band for every repetition: its beginning and end, s.
pub(crate) fn draw(streams: &Streams, shown: &[String], repetitions: &[[f64; 2]]) -> String {
    let columns: Vec<usize> =
        (0..streams.columns.len()).filter(|column| shown.contains(&streams.columns[*column])).collect();
    let height = STRIP * columns.len() as f64 + 30.0;
    let (from, to) = match (streams.t_s.first(), streams.t_s.last()) {
        (Some(from), Some(to)) if to > from => (*from, *to),
        _ => (0.0, 1.0),
    };
    let x = |t_s: f64| MARGIN + (t_s - from) / (to - from) * (WIDTH - 2.0 * MARGIN);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"{WIDTH}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (index, [start_s, end_s]) in repetitions.iter().enumerate() {
        let (left, right) = (x(*start_s), x(*end_s));
        let shade = if index % 2 == 0 { "#cfe8cf" } else { "#b4d8b4" };
        svg.push_str(&format!(
            "<rect x=\"{left:.1}\" y=\"20\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{shade}\"/>\n\
             <text x=\"{left:.1}\" y=\"15\">{}</text>\n",
            right - left,
            height - 30.0,
            index + 1
        ));
    }
    for (strip, column) in columns.iter().enumerate() {
        let top = 20.0 + STRIP * strip as f64;
        let value = |row: usize| streams.row(row).get(*column).copied().flatten();
        let there = (0..streams.t_s.len()).filter_map(value);
        let (low, high) =
            there.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let scale = if high > low { (STRIP - 10.0) / (high - low) } else { 0.0 };
        let step = streams.t_s.len().div_ceil(POINTS).max(1);
        let points: String = (0..streams.t_s.len())
            .step_by(step)
            .filter_map(|row| {
                let y = top + STRIP - 5.0 - (value(row)? - low) * scale;
                Some(format!("{:.1},{y:.1} ", x(streams.t_s[row])))
            })
            .collect();
        svg.push_str(&format!(
            "<polyline points=\"{points}\" fill=\"none\" stroke=\"#246\" stroke-width=\"1\"/>\n\
             <text x=\"{MARGIN}\" y=\"{:.1}\">{}</text>\n",
            top + 12.0,
            escaped(&streams.columns[*column])
        ));
    }
    let end = height - 2.0;
    svg.push_str(&format!(
        "<text x=\"{MARGIN}\" y=\"{end}\">{from:.1} s</text>\n\
         <text x=\"{:.1}\" y=\"{end}\" text-anchor=\"end\">{to:.1} s</text>\n</svg>\n",
        WIDTH - MARGIN
    ));
    svg
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
