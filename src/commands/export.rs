//! `posed export REC.mcap`: files that other programs open.

use std::path::PathBuf;

use posed_recording::animation::{self, BoneNames, OpensimModel};
use posed_recording::export::{self, Frame};
use posed_recording::movement;

use super::progress::Progress;
use super::{Error, print, print_json};

/// What to export, and as what.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed export take-1.mcap --to csv -o poses.csv\n  \
    posed export take-1.mcap --to csv --frame transmitter -o poses.csv.gz\n  \
    posed export take-1.mcap --to jsonl -o messages.jsonl\n  \
    posed export take-1.mcap --to bvh --bones mixamo -o take-1.bvh\n  \
    posed export take-1.mcap --to mcap -o take-1-full.mcap")]
pub(crate) struct Args {
    /// The recording.
    recording: PathBuf,
    /// csv: filtered poses with their state. jsonl: every published message, one on each line. bvh, glb, vrm, vrma, usda, trc, c3d, sto, mot: the body.
    /// mcap: a recording with every message and all channels for viewers.
    #[arg(long, value_enum)]
    to: Format,
    /// The file to write; csv is zipped where it ends in .gz.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Names of the bones in a bvh file, and its unit: m, or cm for MotionBuilder and Mixamo.
    #[arg(long, value_enum, default_value = "posed")]
    bones: BoneNames,
    /// The model of OpenSim whose coordinates a mot file has.
    #[arg(long, value_enum, default_value = "rajagopal")]
    model: OpensimModel,
    /// The body that an animation shows, by name, of a recording with several.
    #[arg(long, value_name = "NAME")]
    body: Option<String>,
    /// Axes of the poses in a csv file.
    #[arg(long, value_enum, default_value = "room")]
    frame: Frame,
    /// Print one JSON object: rows (of an animation its frames, of a recording its messages).
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Jsonl,
    Csv,
    Bvh,
    Trc,
    Glb,
    Vrm,
    Vrma,
    Usda,
    C3d,
    Sto,
    Mot,
    Mcap,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let Args { recording, to, output, bones, model, body: who, frame, json } = args;
    let mut progress = Progress::over(&recording, "exporting");
    if frame != Frame::Room && to != Format::Csv {
        return Err(Error::Usage("--frame is for --to csv; everything else is in the room's axes".into()));
    }
    if bones != BoneNames::Posed && to != Format::Bvh {
        return Err(Error::Usage(
            "--bones is for --to bvh; the other formats have names of their own".into(),
        ));
    }
    if model != OpensimModel::Rajagopal && to != Format::Mot {
        return Err(Error::Usage("--model is for --to mot".into()));
    }
    if who.is_some() && matches!(to, Format::Jsonl | Format::Csv | Format::Mcap) {
        return Err(Error::Usage(
            "--body is for formats that show a body; this one holds all of them".into(),
        ));
    }
    let mut body = |format| {
        let at = |bytes| progress.at(bytes);
        movement::animation(&recording, &output, format, who.as_deref(), at).map_err(Error::failed)
    };
    let rows = match to {
        Format::Bvh => body(animation::Format::Bvh(bones))?,
        Format::Trc => body(animation::Format::Trc)?,
        Format::Glb => body(animation::Format::Glb)?,
        Format::Vrm => body(animation::Format::Vrm)?,
        Format::Vrma => body(animation::Format::Vrma)?,
        Format::Usda => body(animation::Format::Usda)?,
        Format::C3d => body(animation::Format::C3d)?,
        Format::Sto => body(animation::Format::Sto)?,
        Format::Mot => body(animation::Format::Mot(model))?,
        Format::Jsonl => {
            export::jsonl(&recording, &output, |bytes| progress.at(bytes)).map_err(Error::failed)?
        }
        Format::Mcap => {
            export::full(&recording, &output, |bytes| progress.at(bytes)).map_err(Error::failed)?
        }
        Format::Csv => {
            export::csv(&recording, &output, frame, |bytes| progress.at(bytes)).map_err(Error::failed)?
        }
    };
    drop(progress);
    if json {
        print_json(&serde_json::json!({ "rows": rows }))
    } else {
        print(&format!("{}: {rows} rows\n", output.display()))
    }
}
