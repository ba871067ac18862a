//! ELAN annotation files (`.eaf`): segments on one tier, to be corrected by a person and read again.

use std::fmt::Write;
use std::path::Path;

use super::{Sequences, TableError};

/// The tier that is written, and read first.
const TIER: &str = "segments";

/// Segments of an annotation file: label, beginning and end, s since the sequence's first frame, in order of time.
pub type ElanSegments = Vec<(String, f64, f64)>;

/// Reads the segments of an annotation file: of its tier `segments`, or of its only one.
///
/// # Errors
/// The file cannot be read, or is none of ELAN's.
pub fn read_elan_segments(path: &Path) -> Result<ElanSegments, TableError> {
    let segments = read(path)?.into_iter();
    Ok(segments.map(|(from_ms, end_ms, label)| (label, from_ms * 1e-3, end_ms * 1e-3)).collect())
}

/// Says `label` of the time between, s, in the place of what was said of it; nothing where it is empty.
pub fn relabel(segments: ElanSegments, from_s: f64, end_s: f64, label: &str) -> ElanSegments {
    // Times in whole milliseconds, as the file has them: a remnant of less would be a segment without length in it.
    let [from_s, end_s] = [from_s, end_s].map(|t_s| milliseconds(t_s) * 1e-3);
    let mut all = ElanSegments::new();
    for (known, known_from_s, known_end_s) in segments {
        for (from_s, end_s) in
            [(known_from_s, known_end_s.min(from_s)), (known_from_s.max(end_s), known_end_s)]
        {
            if milliseconds(end_s) > milliseconds(from_s) {
                all.push((known.clone(), from_s, end_s));
            }
        }
    }
    if !label.is_empty() {
        all.push((label.to_owned(), from_s, end_s));
    }
    all.sort_by(|one, other| one.1.total_cmp(&other.1));
    // What is said twice in a row is one segment.
    let mut joined: ElanSegments = Vec::with_capacity(all.len());
    for segment in all {
        match joined.last_mut() {
            Some(last) if last.0 == segment.0 && last.2 >= segment.1 => last.2 = last.2.max(segment.2),
            _ => joined.push(segment),
        }
    }
    joined
}

fn milliseconds(t_s: f64) -> f64 {
    (t_s * 1000.0).round()
}

/// The text of an annotation file with segments: label, beginning and end, s since the sequence's first frame. Times are rounded
/// to whole milliseconds, as the format has them.
pub fn write_elan<'a>(segments: impl IntoIterator<Item = (&'a str, f64, f64)>) -> String {
    let (mut slots, mut annotations) = (String::new(), String::new());
    for (number, (label, first, end)) in segments.into_iter().enumerate() {
        let (a, b) = (2 * number + 1, 2 * number + 2);
        let label = escaped(label);
        // Writing to a string cannot fail.
        let _ =
            writeln!(slots, r#"    <TIME_SLOT TIME_SLOT_ID="ts{a}" TIME_VALUE="{}"/>"#, milliseconds(first));
        let _ =
            writeln!(slots, r#"    <TIME_SLOT TIME_SLOT_ID="ts{b}" TIME_VALUE="{}"/>"#, milliseconds(end));
        let _ = writeln!(
            annotations,
            r#"    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a{}" TIME_SLOT_REF1="ts{a}" TIME_SLOT_REF2="ts{b}"><ANNOTATION_VALUE>{label}</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>"#,
            number + 1
        );
    }
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<ANNOTATION_DOCUMENT AUTHOR="posed" DATE="1970-01-01T00:00:00+00:00" FORMAT="3.0" VERSION="3.0" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">
  <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"/>
  <TIME_ORDER>
{slots}  </TIME_ORDER>
  <TIER LINGUISTIC_TYPE_REF="default-lt" TIER_ID="{TIER}">
{annotations}  </TIER>
  <LINGUISTIC_TYPE GRAPHIC_REFERENCES="false" LINGUISTIC_TYPE_ID="default-lt" TIME_ALIGNABLE="true"/>
</ANNOTATION_DOCUMENT>
"#
    )
}

/// Takes the labels of an annotation file: of its tier `segments`, or of its only one. Frames outside every annotation have no
/// label. The last frame has that of an annotation which ends with it.
///
/// # Errors
/// The file cannot be read, or is none of ELAN's.
pub(super) fn read_elan(path: &Path, sequences: &mut Sequences) -> Result<(), TableError> {
    let segments = read(path)?;
    let start_s = sequences.frames.first().map_or(0.0, |frame| frame.t_s);
    for frame in &mut sequences.frames {
        let at_ms = (frame.t_s - start_s) * 1000.0;
        // Times are whole milliseconds: a frame on a border belongs to what begins there.
        let here = segments.iter().rev().find(|(from, end, _)| at_ms >= from - 0.5 && at_ms < end - 0.5);
        frame.label = here.map(|(_, _, label)| label.clone());
    }
    if let (Some(frame), Some((_, end, label))) = (sequences.frames.last_mut(), segments.last()) {
        // The end is exclusive, and after the last frame there is none that could be it. A millisecond is the format's own.
        if (frame.t_s - start_s) * 1000.0 < end + 1.0 {
            frame.label.get_or_insert_with(|| label.clone());
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<Vec<(f64, f64, String)>, TableError> {
    let file = path.display().to_string();
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(source) => return Err(TableError::Io { tried: "read", file, source }),
    };
    parse(&text).map_err(|what| TableError::Labels { file, what })
}

/// (from, end, label) of each annotation, in milliseconds, by time.
fn parse(text: &str) -> Result<Vec<(f64, f64, String)>, String> {
    let document = roxmltree::Document::parse(text).map_err(|error| error.to_string())?;
    let named = |name: &'static str| document.descendants().filter(move |node| node.has_tag_name(name));
    let time = |id: Option<&str>| {
        let slot = named("TIME_SLOT").find(|slot| slot.attribute("TIME_SLOT_ID") == id && id.is_some());
        slot.and_then(|slot| slot.attribute("TIME_VALUE")).and_then(|value| value.parse::<f64>().ok())
    };
    let mut tiers = named("TIER");
    let tier = match named("TIER").find(|tier| tier.attribute("TIER_ID") == Some(TIER)) {
        Some(tier) => tier,
        None => match (tiers.next(), tiers.next()) {
            (Some(tier), None) => tier,
            _ => return Err(format!("expected a tier `{TIER}`, or only one")),
        },
    };
    let mut segments = Vec::new();
    for node in tier.descendants().filter(|node| node.has_tag_name("ALIGNABLE_ANNOTATION")) {
        let value = node.children().find(|child| child.has_tag_name("ANNOTATION_VALUE"));
        let label = value.and_then(|value| value.text()).unwrap_or("").trim().to_owned();
        let times = (time(node.attribute("TIME_SLOT_REF1")), time(node.attribute("TIME_SLOT_REF2")));
        let (Some(from), Some(end)) = times else {
            return Err(format!("annotation `{label}` has no times"));
        };
        if !label.is_empty() {
            segments.push((from, end, label));
        }
    }
    segments.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(segments)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use crate::table::SequenceFrame;

    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let labels = ["walk & <turn>", "pick"];
        let t_s: Vec<f64> = (0..100).map(|frame| 5.0 + frame as f64 / 72.0).collect();
        let classes: Vec<usize> = (0..100).map(|frame| usize::from((30..71).contains(&frame))).collect();
        let at = |frame: usize| frame as f64 / 72.0;
        let text =
            write_elan([(labels[0], 0.0, at(30)), (labels[1], at(30), at(71)), (labels[0], at(71), at(99))]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.eaf");
        std::fs::write(&path, text).unwrap();
        let frames = t_s.iter().map(|t_s| SequenceFrame { t_s: *t_s, ..SequenceFrame::default() }).collect();
        let mut sequences = Sequences { frames, ..Sequences::default() };
        read_elan(&path, &mut sequences).unwrap();
        for (frame, class) in sequences.frames.iter().zip(classes) {
            assert_eq!(frame.label.as_deref(), Some(labels[class]), "{}", frame.t_s);
        }
        // An annotation that ends before says nothing of the last frame.
        let text = write_elan([(labels[0], 0.0, at(30))]);
        std::fs::write(&path, text).unwrap();
        read_elan(&path, &mut sequences).unwrap();
        let labelled = sequences.frames.iter().filter(|frame| frame.label.is_some()).count();
        assert_eq!((labelled, sequences.frames[99].label.as_deref()), (30, None));
        assert!(parse("<x/>").unwrap_err().contains("tier"));
    }

    #[test]
    fn what_is_said_anew_takes_the_place_of_what_was_said_of_that_time() {
        let said = |segments: &[(&str, f64, f64)]| -> ElanSegments {
            segments.iter().map(|(label, from_s, end_s)| ((*label).to_owned(), *from_s, *end_s)).collect()
        };
        let walk = said(&[("walk", 0.0, 10.0)]);
        let bent = relabel(walk.clone(), 4.0, 6.0, "pick");
        assert_eq!(bent, said(&[("walk", 0.0, 4.0), ("pick", 4.0, 6.0), ("walk", 6.0, 10.0)]));
        assert_eq!(relabel(bent.clone(), 4.0, 6.0, "walk"), walk);
        assert_eq!(relabel(bent.clone(), 3.0, 12.0, ""), said(&[("walk", 0.0, 3.0)]));
        assert_eq!(relabel(bent, -1.0, 20.0, "rest"), said(&[("rest", -1.0, 20.0)]));
        assert_eq!(relabel(Vec::new(), 1.0, 2.0, "rest"), said(&[("rest", 1.0, 2.0)]));
        // A remnant that the file could not hold.
        assert_eq!(relabel(said(&[("walk", 0.0, 7.208)]), 0.0, 7.2077, ""), []);
    }
}
