//! `posed replay REC.mcap`: a recording through the same pipeline.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use posed_daemon::Playback;
use posed_recording::{
    Comparison, Ending, Golden, GoldenError, Header, Item, Machine, Mapping, ReadError, Reader, Replayable,
    is_replayed,
};
use posed_stage::Stage;
use serde::Serialize;

use super::progress::Progress;
use super::run::block_on;
use super::{Error, output, print, print_json, watch};

/// What to replay, how fast, and where to.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed replay take-1.mcap\n  \
    posed replay take-1.mcap --speed max -o messages.jsonl\n  \
    posed replay take-1.mcap --speed max --expect golden.jsonl\n\n\
    Without -o, --expect and --pty the messages go to the websocket. Exit code 1 if a message differs.")]
pub(crate) struct Args {
    /// The recording.
    recording: PathBuf,
    /// How fast on the websocket and on pseudo-terminals: 1 is as it was, max as fast as this machine can.
    #[arg(long, default_value = "1", value_parser = speed)]
    speed: f64,
    /// Write the messages to a file, one JSON object on each line, as fast as this machine can.
    #[arg(short, long, value_name = "OUT.jsonl")]
    output: Option<PathBuf>,
    /// Process it anew with another stage file; devices are matched by name.
    #[arg(long, value_name = "STAGE.toml")]
    stage: Option<PathBuf>,
    /// Compare with the messages of this file, and name the first one that differs.
    #[arg(long, value_name = "GOLDEN.jsonl")]
    expect: Option<PathBuf>,
    /// Allow numbers to differ by so much when comparing: for golden files of another machine.
    #[arg(long, value_name = "NUMBER", requires = "expect")]
    tolerance: Option<f64>,
    /// Serve the recorded bytes on pseudo-terminals instead, for other programs to read.
    #[arg(long, conflicts_with_all = ["output", "stage", "expect"])]
    pty: bool,
    /// Address for the page and the websocket, in place of the recorded stage's.
    #[arg(long, value_name = "HOST:PORT")]
    listen: Option<String>,
    /// Print the result as one JSON object.
    #[arg(long)]
    json: bool,
}

fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        _ if text == "max" => Ok(f64::INFINITY),
        Ok(speed) if speed > 0.0 && speed.is_finite() => Ok(speed),
        _ => Err("write 1, 4, another number above 0, or max".to_owned()),
    }
}

/// What a replay into a file or against one has found.
#[derive(Serialize)]
struct Answer {
    entries: u64,
    messages: u64,
    /// Whether the messages are those expected; null where nothing was expected.
    equal: Option<bool>,
    /// The first message that differs, in words.
    difference: Option<String>,
    /// Devices of the recording that the stage file does not have.
    missing_devices: Vec<String>,
    /// Whether the recording ends in the middle.
    torn: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if args.pty {
        return super::replay_pty::run(&args.recording, args.speed, args.json);
    }
    if args.output.is_none() && args.expect.is_none() {
        if args.stage.is_some() {
            return Err(Error::Usage(
                "--stage processes the recording anew: give -o OUT.jsonl or --expect too".into(),
            ));
        }
        return serve(&args);
    }
    let answer = reprocess(&args)?;
    if args.json {
        print_json(&answer)?;
    } else {
        print(&format!("{} entries, {} messages\n", answer.entries, answer.messages))?;
        if let Some(difference) = &answer.difference {
            print(&format!("{difference}\n"))?;
        }
        if !answer.missing_devices.is_empty() {
            print(&format!("not in the stage file: {}\n", answer.missing_devices.join(", ")))?;
        }
        if answer.torn {
            print("the recording ends in the middle; everything before that was replayed\n")?;
        }
    }
    if answer.equal == Some(false) { Err(Error::Reported) } else { Ok(()) }
}

/// To the websocket.
fn serve(args: &Args) -> Result<(), Error> {
    block_on(async {
        let playback =
            Playback::start(&args.recording, args.listen.clone(), args.speed).map_err(Error::failed)?;
        let ended = watch::until_end(playback.url(), playback.status(), playback.part_ended(), None).await;
        playback.shutdown().await;
        ended
    })
}

/// To a file, against a file, or both.
fn reprocess(args: &Args) -> Result<Answer, Error> {
    let mut reader = Reader::open(&args.recording).map_err(Error::failed)?;
    let (stage, machine) = machine(args.stage.as_deref(), reader.header())?;
    let mapping = Mapping::new(reader.header(), &stage);
    let comparison = Comparison { tolerance: args.tolerance };
    let golden = args
        .expect
        .as_deref()
        .map(|path| Golden::open(path, comparison).map_err(|error| Error::file("read", path, &error)));
    let progress = Progress::over(&args.recording, "replaying");
    let mut pass = Pass { machine, mapping, golden: golden.transpose()?, progress, entries: 0, messages: 0 };
    let outcome = match &args.output {
        None => pass.run(&mut reader, &mut std::io::sink()),
        Some(path) => {
            let mut outcome = Ok(());
            output::replace(path, |file| {
                outcome = pass.run(&mut reader, file);
                match &outcome {
                    Err(Stop::Write(error)) => Err(std::io::Error::new(error.kind(), error.to_string())),
                    _ => Ok(()),
                }
            })?;
            outcome
        }
    };
    let difference = match outcome {
        Ok(()) => None,
        Err(Stop::Different(error)) => Some(error.to_string()),
        Err(Stop::Read(error)) => return Err(Error::failed(error)),
        Err(Stop::Write(error)) => return Err(Error::failed(error)),
    };
    Ok(Answer {
        entries: pass.entries,
        messages: pass.messages,
        equal: args.expect.is_some().then_some(difference.is_none()),
        difference,
        missing_devices: pass.mapping.missing_devices,
        torn: reader.ending() == Some(Ending::Torn),
    })
}

/// The stage and the machine: as recorded, or another one.
fn machine(stage: Option<&Path>, header: &Header) -> Result<(Stage, Machine), Error> {
    match stage {
        None => Machine::as_recorded(header).map_err(Error::failed),
        Some(path) => {
            let stage = Stage::load(path).map_err(Error::failed)?;
            let machine = Machine::on_stage(header, &stage).map_err(Error::failed)?;
            Ok((stage, machine))
        }
    }
}

/// One pass through a recording.
struct Pass<R> {
    machine: Machine,
    mapping: Mapping,
    golden: Option<Golden<R>>,
    progress: Progress,
    entries: u64,
    messages: u64,
}

/// Why a pass ends early.
enum Stop {
    Read(ReadError),
    Different(GoldenError),
    Write(io::Error),
}

impl<R: BufRead> Pass<R> {
    fn run(&mut self, reader: &mut Reader<BufReader<File>>, file: &mut dyn Write) -> Result<(), Stop> {
        while let Some(item) = reader.next() {
            self.progress.at(reader.bytes_read());
            let Item::Entry(entry) = item.map_err(Stop::Read)? else { continue };
            let Some(entry) = self.mapping.entry(entry) else { continue };
            self.entries += 1;
            let Self { machine, golden, messages, .. } = self;
            let mut stop = None;
            machine.push(&entry, &mut |topic, _, json| {
                if stop.is_some() || !is_replayed(topic) {
                    return;
                }
                *messages += 1;
                let written = file.write_all(json).and_then(|()| file.write_all(b"\n")).map_err(Stop::Write);
                let compared = match golden {
                    Some(golden) => golden.message(topic, json).map_err(Stop::Different),
                    None => Ok(()),
                };
                stop = written.and(compared).err();
            });
            if let Some(stop) = stop {
                return Err(stop);
            }
        }
        match &mut self.golden {
            Some(golden) => golden.finish().map_err(Stop::Different),
            None => Ok(()),
        }
    }
}
