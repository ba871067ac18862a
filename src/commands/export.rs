//! `posed export REC.mcap`: files that other programs open.

use std::path::PathBuf;

use posed_recording::animation::{BoneNames, OpensimModel};
use posed_recording::export::{Export, Format, Frame};

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
    /// mcap: a recording with every message and all channels for viewers. columns: a recording as this version makes it, for one that has no columns.
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

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let Args { recording, to, output, bones, model, body, frame, json } = args;
    let export = Export { format: to, bones, model, body, frame };
    export.check().map_err(|error| Error::Usage(error.to_string()))?;
    let mut progress = Progress::over(&recording, "exporting");
    let at = |bytes| {
        progress.at(bytes);
        true
    };
    let rows = export.write(&recording, &output, at).map_err(Error::failed)?;
    drop(progress);
    if json {
        print_json(&serde_json::json!({ "rows": rows }))
    } else {
        print(&format!("{}: {rows} rows\n", output.display()))
    }
}
