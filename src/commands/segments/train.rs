//! `posed segments train DIR -o MODEL`: learns from a folder of labelled sequences.

use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use posed_motion::segments::{Augmentation, Epoch, Options, Trainer};
use posed_recording::table::TrainingSet;
use posed_recording::table::read_labelled_folder;
use serde::Serialize;

use super::super::reading::Reading;
use super::super::{Error, notify, output, print, print_json};

/// What to learn from, and how.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed segments train labelled/ --rate-hz 120 --unit mm -o moves.safetensors\n\n\
    The folder holds CSV sequences with a column `label`, or with labels beside them in NAME.labels.csv or NAME.eaf.\n\
    Every tenth epoch the training is put aside in MODEL.training; with --resume it goes on from there."
)]
pub(crate) struct Args {
    /// A folder of labelled sequences.
    folder: PathBuf,
    /// Write the model here (safetensors).
    #[arg(short, long, value_name = "MODEL")]
    output: PathBuf,
    #[command(flatten)]
    reading: Reading,
    /// Most epochs.
    #[arg(long)]
    epochs: Option<u32>,
    /// Seed of all that is random.
    #[arg(long)]
    seed: Option<u64>,
    /// Frames per second of the model.
    #[arg(long, value_name = "HZ")]
    model_rate_hz: Option<f64>,
    /// Taps of each layer; the receptive field is this to the power of the number of layers.
    #[arg(long, value_parser = ["3", "5", "7"])]
    width: Option<String>,
    /// Filters of each layer; as many layers as numbers.
    #[arg(long, value_delimiter = ',', value_name = "N,N,..")]
    filters: Option<Vec<usize>>,
    /// Frames the network may look ahead (0, 12, ...), for labels sooner; half its receptive field if absent.
    #[arg(long, value_name = "FRAMES")]
    look_ahead: Option<usize>,
    /// Width of the border around each change of label that is not learned from, s.
    #[arg(long, value_name = "S")]
    mask_s: Option<f64>,
    /// Share of the frames held out; training keeps the epoch that names them best.
    #[arg(long, value_name = "SHARE")]
    held_out: Option<f64>,
    /// Stop after so many epochs without a better loss on the held-out part.
    #[arg(long, value_name = "EPOCHS")]
    patience: Option<u32>,
    /// Share of labels to replace by random ones, to see how much is tolerated.
    #[arg(long, value_name = "SHARE")]
    label_noise: Option<f64>,
    /// Do not change the sequences (turn, mirror, stretch, scale, drop joints) while learning.
    #[arg(long)]
    no_augmentation: bool,
    /// Train as the paper does: each coordinate from 0 to 1 at the files' own rate, nothing changed, no durations.
    #[arg(long)]
    paper: bool,
    /// Joint rows of the paper's image (with --paper); one per joint if absent.
    #[arg(long, value_name = "ROWS", requires = "paper")]
    rows: Option<usize>,
    /// Go on with the training put aside in MODEL.training.
    #[arg(long)]
    resume: bool,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

/// The answer for programs.
#[derive(Serialize)]
struct Answer {
    files: usize,
    frames: u64,
    labels: Vec<String>,
    joints: Vec<String>,
    parameters: usize,
    receptive_field_s: f64,
    delay_s: f64,
    epochs: u32,
    loss: f64,
    accuracy: f64,
    held_out_accuracy: Option<f64>,
}

impl Args {
    fn options(&self) -> Result<Options, Error> {
        let mut options = if self.paper { posed_baselines::segments::options() } else { Options::default() };
        options.seed = self.seed.unwrap_or(options.seed);
        options.epochs = self.epochs.unwrap_or(options.epochs);
        options.rate_hz = self.model_rate_hz.or(options.rate_hz);
        options.width = self.width.as_ref().and_then(|width| width.parse().ok()).unwrap_or(options.width);
        options.filters = self.filters.clone().unwrap_or(options.filters);
        options.ahead = self.look_ahead.or(options.ahead);
        options.mask_s = self.mask_s.unwrap_or(options.mask_s);
        options.held_out = self.held_out.unwrap_or(options.held_out);
        options.patience = self.patience.unwrap_or(options.patience);
        options.spoiling.label_noise = self.label_noise.unwrap_or(0.0);
        options.features.rows = self.rows;
        if self.no_augmentation {
            options.augmentation = Augmentation::OFF;
        }
        let within = |name: &str, value: f64, low: f64, high: f64| {
            let ok = (low..=high).contains(&value);
            if ok { Ok(()) } else { Err(Error::Usage(format!("--{name} must be {low} to {high}"))) }
        };
        within("epochs", f64::from(options.epochs), 1.0, 1e6)?;
        within("model-rate-hz", options.rate_hz.unwrap_or(1.0), 1.0, 1000.0)?;
        within("mask-s", options.mask_s, 0.0, 60.0)?;
        within("held-out", options.held_out, 0.0, 0.5)?;
        within("label-noise", options.spoiling.label_noise, 0.0, 1.0)?;
        within("filters", options.filters.len() as f64, 1.0, 8.0)?;
        for filters in &options.filters {
            within("filters", *filters as f64, 1.0, 4096.0)?;
        }
        Ok(options)
    }
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let options = args.options()?;
    let files = read_labelled_folder(&args.folder, &args.reading.options()).map_err(Error::failed)?;
    let set = TrainingSet::new(&files, |_| true).map_err(Error::Failed)?;
    set.notes.iter().for_each(|note| notify(note));
    let mut trainer = set.trainer(options).map_err(Error::Failed)?;
    let aside = aside(&args.output);
    if args.resume {
        let bytes = std::fs::read(&aside).map_err(|error| Error::file("read", &aside, &error))?;
        trainer.resume(&bytes).map_err(|what| Error::Failed(format!("{}: {what}", aside.display())))?;
    }
    let last = train(&mut trainer, &aside)?;
    let model = trainer.model(&set.labels, set.files.clone());
    let bytes = model.to_bytes().map_err(Error::failed)?;
    output::replace(&args.output, |file| file.write_all(&bytes))?;
    // The model is there: nothing is left to resume.
    let _ = std::fs::remove_file(&aside);
    let (rate_hz, shape) = (model.card.preparation.rate_hz, &model.card.shape);
    let answer = Answer {
        files: files.len(),
        frames: set.frames(),
        labels: set.labels,
        joints: set.joints,
        parameters: shape.parameters(),
        receptive_field_s: shape.receptive_field() as f64 / rate_hz,
        delay_s: posed_motion::segments::Labeller::delay_s(&model),
        epochs: model.card.provenance.epochs,
        loss: last.loss,
        accuracy: last.accuracy,
        held_out_accuracy: model.card.provenance.held_out_accuracy,
    };
    if args.json { print_json(&answer) } else { print(&sentences(&answer)) }
}

/// Trains to the end, with a bar that says loss and accuracy, and puts the training aside now and then.
fn train(trainer: &mut Trainer, aside: &Path) -> Result<Epoch, Error> {
    const ASIDE_EVERY: u32 = 10;
    let (done, epochs) = trainer.progress();
    let bar = ProgressBar::with_draw_target(Some(u64::from(epochs)), ProgressDrawTarget::hidden());
    bar.set_position(u64::from(done));
    let mut shown = false;
    let mut last = Epoch { number: done, ..Epoch::default() };
    while !trainer.is_done() {
        last = trainer.epoch();
        if !shown && bar.elapsed() > Duration::from_secs(2) {
            shown = true;
            // Draws nothing unless stderr is a terminal.
            bar.set_draw_target(ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("epoch {pos}/{len} {wide_bar} {msg} {eta} left") {
                bar.set_style(style);
            }
        }
        let held_out =
            last.held_out.map_or(String::new(), |(_, right)| format!(", held out {:.1} %", 100.0 * right));
        bar.set_message(format!("loss {:.3}, right {:.1} %{held_out}", last.loss, 100.0 * last.accuracy));
        bar.set_position(u64::from(last.number));
        if last.number.is_multiple_of(ASIDE_EVERY) && !trainer.is_done() {
            let bytes = trainer.checkpoint();
            output::replace(aside, |file| file.write_all(&bytes))?;
        }
    }
    bar.finish_and_clear();
    Ok(last)
}

fn aside(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".training");
    PathBuf::from(name)
}

/// For people.
fn sentences(answer: &Answer) -> String {
    let held_out = answer
        .held_out_accuracy
        .map_or(String::new(), |right| format!(", {:.1} % of the held-out frames", 100.0 * right));
    format!(
        "learned {} labels from {} frames of {} files: {}\n\
         {} parameters; each label sees {:.1} s and is final {:.1} s later\n\
         after {} epochs {:.1} % of the training frames are named right{held_out}\n",
        answer.labels.len(),
        answer.frames,
        answer.files,
        answer.labels.join(", "),
        answer.parameters,
        answer.receptive_field_s,
        answer.delay_s,
        answer.epochs,
        100.0 * answer.accuracy,
    )
}
