//! `replay.labels` and `replay.label`: what somebody says that a recording shows, kept beside it where training reads it.

use std::path::Path;

use super::{Librarian, Outcome};
use crate::recordings;
use crate::server::Refusal;
use posed_protocol::{Answer, LabelSpan, Labels, round};
use posed_recording::table::{
    ElanSegments, LabelFiles, SegmentLabels, read_elan_segments, relabel, write_elan,
};
use posed_recording::{AtomicFile, read_digest};

/// Longest label, bytes: as of a mark.
const LABEL_BYTES: usize = 200;

/// The segments of a file that need not be there.
fn segments(elan: &Path) -> Result<ElanSegments, Refusal> {
    if elan.exists() { read_elan_segments(elan).map_err(Refusal::failed) } else { Ok(Vec::new()) }
}

impl Librarian {
    pub(super) fn labels(&self, name: &str) -> Outcome {
        let path = recordings::find(&self.folder, name)?;
        let beside = LabelFiles::beside(&path);
        if beside.rows.exists() {
            let rows = SegmentLabels::read(&beside.rows).map_err(Refusal::failed)?;
            return Ok(Some(Answer::Labels(Labels { labels: spans(&rows) })));
        }
        let segments = segments(&beside.elan)?;
        let first_s = if segments.is_empty() { 0.0 } else { first_frame_s(&path)? };
        Ok(Some(answer(segments, first_s)))
    }

    pub(super) fn label(&self, name: &str, from_s: f64, to_s: f64, label: &str) -> Outcome {
        let label = label.trim();
        if !(from_s.is_finite() && to_s.is_finite() && from_s < to_s) {
            return Err(Refusal::bad_request("from_s, to_s: give two times, the later one last"));
        }
        if label.len() > LABEL_BYTES || label.chars().any(char::is_control) {
            return Err(Refusal::bad_request(format!(
                "label: give {LABEL_BYTES} bytes at most, in one line"
            )));
        }
        let path = recordings::find(&self.folder, name)?;
        let beside = LabelFiles::beside(&path);
        if beside.rows.exists() {
            let rows = beside.rows.file_name().unwrap_or_default().to_string_lossy();
            return Err(Refusal::new(
                "exists",
                format!("{rows} has its labels frame by frame, and counts; change it there, or remove it"),
            ));
        }
        let first_s = first_frame_s(&path)?;
        let segments = relabel(segments(&beside.elan)?, from_s - first_s, to_s - first_s, label);
        let text =
            write_elan(segments.iter().map(|(label, from_s, end_s)| (label.as_str(), *from_s, *end_s)));
        AtomicFile::replace(&beside.elan, text.as_bytes()).map_err(Refusal::failed)?;
        Ok(Some(answer(segments, first_s)))
    }
}

fn answer(segments: ElanSegments, first_s: f64) -> Answer {
    let span = |(label, from_s, end_s): (String, f64, f64)| LabelSpan {
        label,
        from_s: round::to(1e3, first_s + from_s),
        to_s: round::to(1e3, first_s + end_s),
    };
    Answer::Labels(Labels { labels: segments.into_iter().map(span).collect() })
}

/// What the labels of a recording count from.
fn first_frame_s(path: &Path) -> Result<f64, Refusal> {
    let digest = read_digest(path).map_err(Refusal::failed)?;
    digest.and_then(|digest| digest.first_frame_s).ok_or_else(|| {
        Refusal::new(
            "no_digest",
            "its digest does not say when it has its first frame; make it: library.digest",
        )
    })
}

/// Rows with a time and one label after another, as spans; the last row of a span is where the next one begins.
fn spans(rows: &SegmentLabels) -> Vec<LabelSpan> {
    let mut spans: Vec<LabelSpan> = Vec::new();
    let mut goes_on = false;
    for row in &rows.rows {
        let Some(t_s) = row.t_s else { continue };
        if let Some(last) = spans.last_mut().filter(|_| goes_on) {
            last.to_s = t_s;
        }
        goes_on = match (&row.label, spans.last()) {
            (Some(label), Some(last)) if goes_on && last.label == *label => true,
            (Some(label), _) => {
                spans.push(LabelSpan { label: label.clone(), from_s: t_s, to_s: t_s });
                true
            }
            (None, _) => false,
        };
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_recording::table::SegmentLabel;

    #[test]
    fn rows_are_spans_and_gaps_stay_gaps() {
        let labels = ["a", "a", "b", "", "b", "b"];
        let row = |(n, label): (usize, &&str)| SegmentLabel {
            t_s: Some(n as f64),
            label: (!label.is_empty()).then(|| (*label).to_owned()),
            confidence: None,
        };
        let rows = SegmentLabels { rows: labels.iter().enumerate().map(row).collect() };
        let spans = spans(&rows);
        let found: Vec<_> = spans.iter().map(|span| (span.label.as_str(), span.from_s, span.to_s)).collect();
        assert_eq!(found, [("a", 0.0, 2.0), ("b", 2.0, 3.0), ("b", 4.0, 5.0)]);
    }
}
