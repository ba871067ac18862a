//! `posed segments evaluate MODEL DIR`: how well a model names labelled sequences.

use std::path::PathBuf;

use posed_motion::segments::Measures;
use posed_motion::segments::label;

use crate::pictures::segments as picture;
use posed_recording::table::read_labelled_folder;
use serde::Serialize;

use super::super::reading::Reading;
use super::super::{Error, output, print, print_json};
use super::files;
use super::load;

/// What to judge by what.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed segments evaluate moves.safetensors test/ --picture bands.svg\n\n\
    Frames without a label, and those whose `transition` is 1, are not scored.")]
pub(crate) struct Args {
    /// The model.
    model: PathBuf,
    /// A folder of labelled sequences, or one file.
    folder: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Draw truth and labels of each sequence as coloured bands.
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// Print one JSON object: accuracy, edit, f1, confusion, files.
    #[arg(long)]
    json: bool,
}

/// The answer for programs; shares in %.
#[derive(Serialize)]
struct Answer {
    frames: u64,
    accuracy: f64,
    edit: f64,
    f1_10: f64,
    f1_25: f64,
    f1_50: f64,
    /// Rows and columns of the confusion; labels that the model does not know come last.
    labels: Vec<String>,
    confusion: Vec<Vec<u64>>,
    files: Vec<File>,
}

#[derive(Serialize)]
struct File {
    name: String,
    frames: u64,
    accuracy: f64,
    edit: f64,
    f1_50: f64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let model = load(&args.model)?;
    let card = &model.card;
    let files = read_labelled_folder(&args.folder, &args.reading.options()).map_err(Error::failed)?;
    let mut labels = card.labels.clone();
    // A label that the model does not know is named wrong, not left out.
    let truths: Vec<_> = files.iter().map(|(_, file)| picture::classes(file, &mut labels)).collect();
    let mut all = Measures::new(labels.len());
    let mut answers = Vec::new();
    let mut bands = Vec::new();
    let mut times = Vec::new();
    for ((name, mut file), truth) in files.into_iter().zip(truths) {
        files::fits(&name, &file, &model)?;
        file.frames.iter_mut().for_each(|frame| frame.label = None);
        let sequence = file.sequence(&card.preparation.joints, &card.labels).map_err(Error::Failed)?;
        let named: Vec<u16> = label(&model, &sequence).into_iter().map(|frame| frame.0).collect();
        let mut one = Measures::new(labels.len());
        one.add(&truth, &named);
        all.add(&truth, &named);
        answers.push(File {
            name: name.clone(),
            frames: one.frames,
            accuracy: one.accuracy(),
            edit: one.edit(),
            f1_50: one.f1()[2],
        });
        bands.push((name, truth, named));
        times.push(sequence.t_s);
    }
    if let Some(path) = &args.picture {
        let bands: Vec<picture::Bands<'_>> = bands
            .into_iter()
            .zip(&times)
            .map(|((name, truth, named), t_s)| picture::Bands { name, t_s, truth: Some(truth), named })
            .collect();
        let svg = picture::draw(&labels, &bands);
        output::replace(path, |file| file.write_all(svg.as_bytes()))?;
    }
    let [f1_10, f1_25, f1_50] = all.f1();
    let answer = Answer {
        frames: all.frames,
        accuracy: all.accuracy(),
        edit: all.edit(),
        f1_10,
        f1_25,
        f1_50,
        labels,
        confusion: all.confusion,
        files: answers,
    };
    if args.json { print_json(&answer) } else { print(&sentences(&answer)) }
}

/// For people.
fn sentences(answer: &Answer) -> String {
    let mut text = String::from("sequence                  frames  right %   edit  F1@50\n");
    for file in &answer.files {
        text.push_str(&format!(
            "{:24} {:7} {:8.1} {:6.1} {:6.1}\n",
            file.name, file.frames, file.accuracy, file.edit, file.f1_50
        ));
    }
    text.push_str(&format!(
        "{:24} {:7} {:8.1} {:6.1} {:6.1}  (F1@10 {:.1}, F1@25 {:.1})\n\nof each label, % named:\n",
        "all", answer.frames, answer.accuracy, answer.edit, answer.f1_50, answer.f1_10, answer.f1_25
    ));
    for (label, row) in answer.labels.iter().zip(&answer.confusion) {
        let sum = row.iter().sum::<u64>();
        if sum == 0 {
            continue;
        }
        let mut named: Vec<(u64, &String)> = row.iter().copied().zip(&answer.labels).collect();
        named.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        let parts: Vec<String> = named
            .iter()
            .take(3)
            .filter(|(count, _)| *count > 0)
            .map(|(count, name)| format!("{name} {:.1}", 100.0 * *count as f64 / sum as f64))
            .collect();
        text.push_str(&format!("{label:24} {}\n", parts.join(", ")));
    }
    text
}
