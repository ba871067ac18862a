//! The page around a report.

use std::fmt::Write;

use super::Reader;

/// The style of every report: one look in the browser and on paper. A page that shows a report under a policy of its own allows it by its
/// hash.
pub const STYLE: &str = "\
:root{color-scheme:light;--ink:#1c2430;--soft:#5b6675;--line:#d5dbe3;--own:#0b6bcb;--taught:#b45309}\
*{box-sizing:border-box}body{font:15px/1.45 system-ui,sans-serif;color:var(--ink);margin:2rem auto;max-width:60rem;padding:0 1rem}\
h1{font-size:1.6rem;margin:0 0 .2rem}h2{font-size:1.2rem;margin:2rem 0 .5rem;border-bottom:1px solid var(--line);padding-bottom:.2rem}\
p{margin:.4rem 0}.soft{color:var(--soft)}table{border-collapse:collapse;width:100%;margin:.6rem 0;font-variant-numeric:tabular-nums}\
th,td{text-align:right;padding:.25rem .5rem;border-bottom:1px solid var(--line);vertical-align:top}\
th{font-weight:600;color:var(--soft)}th:first-child,td:first-child{text-align:left}\
.charts{display:grid;grid-template-columns:repeat(auto-fill,minmax(17rem,1fr));gap:1rem}figure{margin:0}figcaption{font-size:.85rem;color:var(--soft)}\
svg{width:100%;height:auto;display:block}svg text{font:10px system-ui,sans-serif;fill:var(--soft)}\
.axis{stroke:var(--line);stroke-width:1}.taught{fill:none;stroke:var(--taught);stroke-width:3;stroke-linejoin:round}\
.own{fill:none;stroke:var(--own);stroke-width:1;opacity:.45;stroke-linejoin:round}.trend{fill:none;stroke:var(--own);stroke-width:1.5}\
.dot{fill:var(--own)}.goal{stroke:var(--taught);stroke-width:1.5;stroke-dasharray:5 4}\
section,figure,tr{break-inside:avoid}h2{break-after:avoid}@page{size:A4;margin:15mm}@media print{body{margin:0;max-width:none;padding:0;font-size:11px}}";

/// Writes a page.
pub(super) struct Page {
    text: String,
}

impl Page {
    pub(super) fn new(reader: &Reader, title: &str) -> Self {
        let language = reader.say("en", "de");
        let title = escaped(title);
        let text = format!(
            "<!doctype html>\n<html lang=\"{language}\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
             <title>{title}</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
        );
        Self { text }
    }

    /// A paragraph in the colour of what is beside the point.
    pub(super) fn note(&mut self, sentence: &str) {
        self.push(&format!("<p class=\"soft\">{}</p>\n", escaped(sentence)));
    }

    pub(super) fn heading(&mut self, heading: &str) {
        self.push(&format!("<h2>{}</h2>\n", escaped(heading)));
    }

    /// A table with a row of headings.
    pub(super) fn table(&mut self, headings: &[&str], rows: impl Iterator<Item = Vec<String>>) {
        self.push("<table><thead><tr>");
        headings.iter().for_each(|heading| self.push(&format!("<th>{}</th>", escaped(heading))));
        self.push("</tr></thead><tbody>\n");
        for row in rows {
            let cells: String = row.iter().map(|cell| format!("<td>{}</td>", escaped(cell))).collect();
            self.push(&format!("<tr>{cells}</tr>\n"));
        }
        self.push("</tbody></table>\n");
    }

    /// Drawings beside each other, each with what it shows; they are SVG already.
    pub(super) fn charts(&mut self, charts: impl Iterator<Item = (String, String)>) {
        self.push("<div class=\"charts\">\n");
        for (caption, svg) in charts {
            self.push(&format!("<figure>{svg}<figcaption>{}</figcaption></figure>\n", escaped(&caption)));
        }
        self.push("</div>\n");
    }

    pub(super) fn finish(mut self) -> String {
        self.push("</body></html>\n");
        self.text
    }

    fn push(&mut self, html: &str) {
        // Writing to a string cannot fail.
        let _ = self.text.write_str(html);
    }
}

/// A text in which nothing is a tag.
pub(super) fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            c => escaped.push(c),
        }
    }
    escaped
}
