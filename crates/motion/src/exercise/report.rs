//! What was seen in a demonstration, for the person who shows it.
//!
//! What comes in: the repetitions that teaching saw. What goes out: a report, sentences about what could be better, and why a
//! demonstration is refused. What it never does: decide whether it is.

use serde::{Deserialize, Serialize};

use super::choice::TriedChannels;
use super::exercise::Durations;
use super::hmm::median;
use super::judge::Measures;
use super::material::Material;

/// A stretch without packets may hide a repetition from so much of the median one on.
const LOST: f64 = 0.25;

/// What was seen in a demonstration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Announced number of repetitions.
    pub announced: usize,
    /// Where the repetitions were, in order of time.
    pub repetitions: Vec<TaughtRepetition>,
    /// Mean similarity of each repetition with the others, from 0 (nothing alike) to 1 (all the same).
    pub quality: f64,
    /// What could be better, in sentences; empty when nothing.
    pub remarks: Vec<String>,
    /// Why the exercise has the channels that it has, a sentence.
    #[serde(default)]
    pub because: String,
    /// Sets of channels that were tried, the richest first; empty where there was nothing to choose from.
    #[serde(default)]
    pub tried: Vec<TriedChannels>,
}

/// A repetition of the demonstration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaughtRepetition {
    /// Beginning, s.
    pub t_start_s: f64,
    /// End, s.
    pub t_end_s: f64,
    /// Its measures against a model of the other repetitions.
    pub measures: Measures,
}

/// What is wrong with a demonstration in which not the announced number was seen.
pub(super) fn reason_of(report: &Report) -> String {
    let seen = &report.repetitions;
    if seen.len() > report.announced {
        return "the recording holds more repetitions than announced, or other movements like them"
            .to_owned();
    }
    let lengths: Vec<f64> = seen.iter().map(|seen| seen.t_end_s - seen.t_start_s).collect();
    let typical = median(lengths.iter().copied()).unwrap_or(1.0);
    for (index, pair) in seen.windows(2).enumerate() {
        let gap = pair[1].t_start_s - pair[0].t_end_s;
        let (number, from, to) = (index + 2, pair[0].t_end_s, pair[1].t_start_s);
        if gap > 1.4 * typical {
            return format!("number {number}, from {from:.1} to {to:.1} s, was much slower");
        }
        if gap > 0.3 * typical {
            return format!("number {number}, from {from:.1} to {to:.1} s, was different");
        }
    }
    "the others differ too much from these; do them evenly, with a short rest before and after".to_owned()
}

/// Stretches without packets that may hide a repetition, s, each as often as it may hide one: they lie in none that was seen.
pub(super) fn hidden(material: &Material, seen: &[TaughtRepetition]) -> Vec<[f64; 2]> {
    let Some(median_s) = median(seen.iter().map(|one| one.t_end_s - one.t_start_s)) else {
        return Vec::new();
    };
    let lost = material.lost(LOST * median_s).into_iter();
    let is_apart = |[from_s, to_s]: &[f64; 2]| {
        let middle_s = from_s.midpoint(*to_s);
        seen.iter().all(|one| !(one.t_start_s..one.t_end_s).contains(&middle_s))
    };
    let often = |stretch: [f64; 2]| {
        let count = 1 + ((stretch[1] - stretch[0]) / median_s) as usize;
        std::iter::repeat_n(stretch, count)
    };
    lost.filter(is_apart).flat_map(often).collect()
}

pub(super) fn remarks_of(report: &Report, durations: &Durations, hidden: &[[f64; 2]]) -> Vec<String> {
    let mut remarks = Vec::new();
    if let (true, Some([from_s, to_s])) = (report.repetitions.len() < report.announced, hidden.first()) {
        remarks.push(format!(
            "saw {} repetitions, {} were announced: no packets came from {from_s:.1} to {to_s:.1} s",
            report.repetitions.len(),
            report.announced
        ));
    } else if report.repetitions.len() != report.announced {
        remarks.push(format!(
            "saw {} repetitions, {} were announced: {}",
            report.repetitions.len(),
            report.announced,
            reason_of(report)
        ));
    }
    if durations.longest_s > 1.6 * durations.shortest_s {
        remarks.push(format!(
            "uneven speed: repetitions took {:.1} to {:.1} s",
            durations.shortest_s, durations.longest_s
        ));
    }
    for (index, seen) in report.repetitions.iter().enumerate() {
        if seen.measures.similarity < 0.8 {
            let (number, percent) = (index + 1, 100.0 * seen.measures.similarity);
            remarks.push(format!("number {number} is only {percent:.0} % like the others"));
        }
    }
    remarks
}
