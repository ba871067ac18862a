//! `posed exercise teach RECORDING --propose`: where a recording repeats itself.

use std::path::Path;

use posed_motion::exercise::{Options, RepeatingRange, Stream, repeating_ranges};
use serde::Serialize;

use super::super::{Error, print, print_json};

/// The answer for programs.
#[derive(Serialize)]
struct Answer {
    ranges: Vec<Proposed>,
}

#[derive(Serialize)]
struct Proposed {
    from_s: f64,
    to_s: f64,
    repetitions: usize,
    /// Median duration of a repetition, s.
    median_s: f64,
    /// Mean similarity of the repetitions, 0 to 1.
    quality: f64,
    channels: Vec<String>,
}

impl From<RepeatingRange> for Proposed {
    fn from(range: RepeatingRange) -> Self {
        let RepeatingRange { from_s, to_s, lesson } = range;
        Self {
            from_s,
            to_s,
            repetitions: lesson.report.repetitions.len(),
            median_s: lesson.exercise.durations.median_s,
            quality: lesson.report.quality,
            channels: lesson.exercise.channels,
        }
    }
}

/// Lists the ranges of `stream` that can be taught as they are. `arguments` name the recording and how it is read.
pub(super) fn run(
    stream: &Stream<'_>,
    options: &Options,
    path: &Path,
    arguments: &str,
    json: bool,
) -> Result<(), Error> {
    let ranges = repeating_ranges(stream, options).map_err(Error::failed)?;
    let answer = Answer { ranges: ranges.into_iter().map(Proposed::from).collect() };
    if json {
        return print_json(&answer);
    }
    if answer.ranges.is_empty() {
        let path = path.display();
        return Err(Error::Failed(format!(
            "{path}: nothing in it is repeated three times and can be taught"
        )));
    }
    print(&answer.ranges.iter().map(|range| range.sentence(arguments)).collect::<String>())
}

impl Proposed {
    /// For people, with the command that teaches it.
    fn sentence(&self, arguments: &str) -> String {
        let Self { from_s, to_s, repetitions, median_s, quality, channels } = self;
        let (channels, percent) = (channels.join(", "), 100.0 * quality);
        format!(
            "{from_s:7.2} to {to_s:7.2} s  {repetitions} repetitions of {median_s:.1} s, {percent:.0} % similar, in {channels}\n  \
             posed exercise teach {arguments} --from-s {from_s} --to-s {to_s} --repetitions {repetitions} --name NAME -o NAME.json\n"
        )
    }
}
