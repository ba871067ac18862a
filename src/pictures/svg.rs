//! Pictures: a few shapes of SVG, as text.
//!
//! What comes in: shapes in pixels and text. What goes out: one SVG document that needs nothing else. What it never
//! does: know what it draws.

use std::fmt::Write;

/// An SVG document in the making.
#[derive(Clone, Debug)]
pub(crate) struct Svg {
    text: String,
}

impl Svg {
    /// A white page, sizes in pixels.
    pub(crate) fn new(width: f64, height: f64) -> Self {
        let mut svg = Self { text: String::new() };
        svg.add(&format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">"#
        ));
        svg.rectangle([0.0, 0.0], [width, height], "#fff");
        svg
    }

    /// A filled rectangle.
    pub(crate) fn rectangle(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], colour: &str) {
        self.add(&format!(
            r#"<rect x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}" fill="{colour}"/>"#
        ));
    }

    /// A straight line.
    pub(crate) fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], colour: &str) {
        self.add(&format!(
            r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" stroke="{colour}"/>"#
        ));
    }

    /// A line through points.
    pub(crate) fn polyline(&mut self, points: impl IntoIterator<Item = [f64; 2]>, colour: &str) {
        let mut path = String::new();
        for [x, y] in points {
            // Writing to a string cannot fail.
            let _ = write!(path, "{x:.1},{y:.1} ");
        }
        let path = path.trim_end();
        self.add(&format!(r#"<polyline points="{path}" fill="none" stroke="{colour}"/>"#));
    }

    /// A filled disc.
    pub(crate) fn disc(&mut self, [x, y]: [f64; 2], radius: f64, colour: &str) {
        self.add(&format!(r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius:.1}" fill="{colour}"/>"#));
    }

    /// Text, its baseline's left end at the point.
    pub(crate) fn text(&mut self, [x, y]: [f64; 2], text: &str) {
        let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        self.add(&format!(r#"<text x="{x:.1}" y="{y:.1}" fill="black">{text}</text>"#));
    }

    /// The document.
    pub(crate) fn finish(mut self) -> String {
        self.add("</svg>");
        self.text
    }

    fn add(&mut self, element: &str) {
        self.text.push_str(element);
        self.text.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_break_out_of_the_document() {
        let mut svg = Svg::new(100.0, 50.0);
        svg.text([1.0, 2.0], "<a> & b");
        svg.polyline([[0.0, 1.0], [2.0, 3.0]], "#000");
        let text = svg.finish();
        assert!(text.contains("&lt;a&gt; &amp; b"));
        assert!(text.contains(r#"points="0.0,1.0 2.0,3.0""#));
        assert!(text.starts_with("<svg") && text.ends_with("</svg>\n"));
    }
}
