//! `posed info REC.mcap`: what is inside a recording, and its repair.

use std::path::PathBuf;

use posed_protocol::DigestCounts;
use posed_recording::{Info, Repaired, TimecodeInfo};
use posed_stage::RecordingContent;

use super::progress::Progress;
use super::{Error, print, print_json};

/// What to look at.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed info take-1.mcap\n  posed info take-1.mcap --repair\n\n\
    Exit code 1 if the recording is not complete.")]
pub(crate) struct Args {
    /// The recording.
    recording: PathBuf,
    /// Complete a recording that breaks off or is damaged: all before the break is kept, the rest goes.
    #[arg(long)]
    repair: bool,
    /// Print one JSON object: complete, problem, times, devices, counts per topic.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let path = &args.recording;
    let failed = |error: &dyn std::fmt::Display| Error::Failed(format!("{}: {error}", path.display()));
    let repaired = match args.repair {
        true => {
            let mut progress = Progress::over(path, "repairing");
            Some(posed_recording::repair(path, |bytes| progress.at(bytes)).map_err(|error| failed(&error))?)
        }
        false => None,
    };
    let mut progress = Progress::over(path, "reading");
    let info = Info::read(path, |bytes| progress.at(bytes)).map_err(|error| failed(&error))?;
    drop(progress);
    if args.json {
        print_json(&info)?;
    } else {
        let file = path.display();
        match repaired {
            None => {}
            Some(Repaired::WasComplete) => print(&format!("{file}: was complete, nothing changed\n"))?,
            Some(Repaired::Completed { messages }) => {
                print(&format!("{file}: completed, {messages} messages kept\n"))?;
            }
        }
        print(&sentences(&info))?;
    }
    if info.complete { Ok(()) } else { Err(Error::Reported) }
}

/// For people.
fn sentences(info: &Info) -> String {
    let mut text = format!(
        "stage     {}\nepoch     {}\nbegun     {:.3} s{}\nduration  {:.3} s\nsize      {:.1} MB\ncontent   {}\nwritten   by posed {}\n",
        info.stage,
        info.epoch_utc,
        info.begun_s,
        if info.mid_run { " (in the middle of a run)" } else { "" },
        info.duration_s,
        info.bytes as f64 * 1e-6,
        match info.content {
            RecordingContent::Log => "the input log; `posed export --to mcap` makes the rest anew",
            RecordingContent::Full => "the input log, messages, all channels for viewers",
        },
        info.version,
    );
    for device in &info.devices {
        text.push_str(&format!(
            "device    {}: {} bytes in, {} bytes out\n",
            device.name, device.bytes_in, device.bytes_out
        ));
    }
    let width = info.topics.keys().map(|topic| topic.chars().count()).max().unwrap_or(0);
    for (topic, count) in &info.topics {
        text.push_str(&format!("topic     {topic:width$}  {count:>9}\n"));
    }
    if let Some(DigestCounts { marks, faults, segments, repetitions, key_poses }) = info.digest {
        text.push_str(&format!(
            "digest    {marks} marks, {faults} faults, {segments} segments, {repetitions} repetitions, {key_poses} key poses\n"
        ));
    }
    if let Some(TimecodeInfo { from, to, rate, frames, jumps }) = &info.timecode {
        let rate = rate.unwrap_or("a rate that is not known");
        text.push_str(&format!("timecode  {from} to {to} at {rate}, {frames} frames read, {jumps} jumps\n"));
    }
    match (&info.problem, &info.ended) {
        (Some(problem), _) => text.push_str(&format!("problem   {problem}\n")),
        (None, Some(reason)) => text.push_str(&format!("complete  {reason}\n")),
        (None, None) => text.push_str("complete\n"),
    }
    text
}
