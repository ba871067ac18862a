//! `posed segments label MODEL SEQ.csv -o LABELS.csv`: names every frame.

use std::path::PathBuf;

use posed_motion::segments::{label, runs};

use crate::pictures::segments as picture;
use posed_recording::table::{SegmentLabel, SegmentLabels, read_labelled, write_elan};
use serde::Serialize;

use super::super::reading::Reading;
use super::super::{Error, output, print, print_json};
use super::files;
use super::load;

/// What to name.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed segments label moves.safetensors new.csv --rate-hz 120 -o new.labels.csv\n\n\
    Correct NEW.labels.csv or NEW.eaf, leave it beside NEW.csv in the training folder, and train again:\n\
    its labels count instead of the column `label`."
)]
pub(crate) struct Args {
    /// The model.
    model: PathBuf,
    /// The sequence: CSV with NAME_x,NAME_y,NAME_z per joint, or a recording (.mcap) with the model's
    /// joints as sensors or segments of a body.
    sequence: PathBuf,
    /// Write the labels here: `.csv`, or `.eaf` for ELAN.
    #[arg(short, long, value_name = "LABELS.csv")]
    output: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Draw the labels as a coloured band, under the file's own where it has any.
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// Print one JSON object: frames, segments and their times.
    #[arg(long)]
    json: bool,
}

/// The answer for programs.
#[derive(Serialize)]
struct Answer<'a> {
    frames: usize,
    segments: Vec<MotionSegment<'a>>,
}

#[derive(Serialize)]
struct MotionSegment<'a> {
    label: &'a str,
    t_start_s: f64,
    t_end_s: f64,
    confidence: f64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let model = load(&args.model)?;
    let card = &model.card;
    let file = read_labelled(&args.sequence, &args.reading.options()).map_err(Error::failed)?;
    let name = args.sequence.display().to_string();
    if file.frames.is_empty() {
        return Err(Error::Failed(format!("{name}: there are no frames")));
    }
    files::fits(&name, &file, &model)?;
    let mut unlabelled = file.clone();
    unlabelled.frames.iter_mut().for_each(|frame| frame.label = None);
    let sequence = unlabelled.sequence(&card.preparation.joints, &card.labels).map_err(Error::Failed)?;
    let named = label(&model, &sequence);
    let classes: Vec<u16> = named.iter().map(|frame| frame.0).collect();
    if args.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("eaf")) {
        let after_s = |frame: usize| {
            let t_s = sequence.t_s.get(frame).or(sequence.t_s.last()).copied().unwrap_or(0.0);
            t_s - sequence.t_s[0]
        };
        let segments = runs(classes.iter().copied());
        let segment = |(class, first, end): (u16, usize, usize)| {
            (card.labels[usize::from(class)].as_str(), after_s(first), after_s(end))
        };
        let text = write_elan(segments.into_iter().map(segment));
        output::replace(&args.output, |file| file.write_all(text.as_bytes()))?;
    } else {
        let row = |((class, confidence), t_s): (&(u16, f64), &f64)| SegmentLabel {
            t_s: Some(*t_s),
            label: Some(card.labels[usize::from(*class)].clone()),
            confidence: Some(*confidence),
        };
        let rows = named.iter().zip(&sequence.t_s).map(row).collect();
        SegmentLabels { rows }.write(&args.output).map_err(Error::failed)?;
    }
    if let Some(path) = &args.picture {
        let mut names = card.labels.clone();
        let truth = file.labelled.then(|| picture::classes(&file, &mut names));
        let bands = picture::Bands { name, t_s: &sequence.t_s, truth, named: classes.clone() };
        let svg = picture::draw(&names, &[bands]);
        output::replace(path, |file| file.write_all(svg.as_bytes()))?;
    }
    let segments: Vec<MotionSegment<'_>> = runs(classes.iter().copied())
        .into_iter()
        .map(|(class, first, end)| MotionSegment {
            label: &card.labels[usize::from(class)],
            t_start_s: sequence.t_s[first],
            t_end_s: sequence.t_s[end.min(sequence.frames() - 1)],
            confidence: named[first..end].iter().map(|frame| frame.1).sum::<f64>() / (end - first) as f64,
        })
        .collect();
    if args.json {
        return print_json(&Answer { frames: sequence.frames(), segments });
    }
    for segment in &segments {
        print(&format!(
            "{:8.2} to {:8.2} s  {:3.0} %  {}\n",
            segment.t_start_s,
            segment.t_end_s,
            100.0 * segment.confidence,
            segment.label
        ))?;
    }
    Ok(())
}
