//! `posed timecode`: what time code a sound file or a recording has, where the two lie together, and where somebody clapped.

mod claps;
mod sound;

use std::path::PathBuf;

use posed_drivers::Timestamp;
use posed_recording::{Item, Reader, TimecodeTrack, is_recording};
use posed_timecode::{Rate, Relation};
use serde::Serialize;

use self::claps::{Clap, Motion};
use self::sound::{Sound, Stretch};
use super::recorded::Recorded;
use super::{Error, print, print_json};

/// What to look at.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  posed timecode camera.wav\n  posed timecode camera.wav --take take-1.mcap\n  \
    posed timecode take-1.mcap --claps\n\nExit code 1 if there is no time code, or no clap."
)]
pub(crate) struct Args {
    /// A WAV file with LTC on one of its channels, or a recording (.mcap).
    file: PathBuf,
    /// With a sound file: the recording that it belongs to; says where in it the sound begins.
    #[arg(long, value_name = "REC.mcap")]
    take: Option<PathBuf>,
    /// With a sound file: the channel that carries the code, from 1.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    channel: u16,
    /// With a sound file: rate of the pictures, where it is twice that of the code, such as 50 or 59.94df.
    #[arg(long, value_parser = rate)]
    rate: Option<Rate>,
    /// With a recording: list the sharp peaks of acceleration, as of a clap, with the time code of each.
    #[arg(long)]
    claps: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

fn rate(text: &str) -> Result<Rate, String> {
    let named = Rate::ALL.into_iter().find(|rate| rate.name() == text);
    named.ok_or_else(|| format!("one of {}", Rate::ALL.map(Rate::name).join(", ")))
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match (is_recording(&args.file), &args.take) {
        (true, Some(_)) => Err(Error::Usage("--take is for sound files".into())),
        (true, None) => recording(&args),
        (false, _) if args.claps => Err(Error::Usage("--claps looks at the motion in a recording".into())),
        (false, _) => sound(&args),
    }
}

/// What a sound file has.
#[derive(Serialize)]
struct OfSound {
    duration_s: f64,
    stretches: Vec<Stretch>,
    /// Stage time of the sound's beginning, s, and how long after the recording's own beginning that is; null without a recording.
    begins_at_s: Option<f64>,
    after_beginning_s: Option<f64>,
}

fn sound(args: &Args) -> Result<(), Error> {
    let pictures = args.rate.map_or(1, Rate::pictures_per_frame);
    let Sound { duration_s, stretches, relation } = sound::read(&args.file, args.channel, pictures)?;
    let Some(relation) = relation else {
        let file = args.file.display();
        return Err(Error::Failed(format!(
            "{file}: no time code on channel {}; --channel names another",
            args.channel
        )));
    };
    let mut found = OfSound { duration_s, stretches, begins_at_s: None, after_beginning_s: None };
    if let Some(take) = &args.take {
        let (begun, _, track) = track(take)?;
        let of_take =
            track.relation().filter(|of_take| of_take.counting == relation.counting).ok_or_else(|| {
                Error::Failed(format!(
                    "{}: it has no time code, or one that counts otherwise",
                    take.display()
                ))
            })?;
        let begins = of_take.time_of(relation.number_at(Timestamp::ZERO));
        found.begins_at_s = Some(begins.as_secs_f64());
        found.after_beginning_s = Some(begins.seconds_since(begun));
    }
    if args.json {
        return print_json(&found);
    }
    let mut text = format!("sound     {:.3} s\n", found.duration_s);
    found.stretches.iter().for_each(|stretch| text.push_str(&stretch.sentence()));
    if let (Some(t_s), Some(after_s)) = (found.begins_at_s, found.after_beginning_s) {
        text.push_str(&format!(
            "begins    {after_s:+.4} s after the recording does, at {t_s:.4} s of the stage's time\n"
        ));
    }
    print(&text)
}

/// The code in a recording's log: its beginning and end, and the code.
fn track(path: &std::path::Path) -> Result<(Timestamp, Timestamp, TimecodeTrack), Error> {
    let mut reader = Reader::open(path).map_err(Error::failed)?;
    let mut track = TimecodeTrack::new(reader.header());
    let begun = reader.header().begun;
    let mut end = begun;
    for item in reader.by_ref() {
        if let Item::Entry(entry) = item.map_err(Error::failed)? {
            end = end.max(entry.t);
            track.entry(&entry);
        }
    }
    Ok((begun, end, track))
}

/// What a recording has.
#[derive(Serialize)]
struct OfRecording {
    timecode: Option<posed_recording::TimecodeInfo>,
    /// Null where they were not asked for.
    claps: Option<Vec<Clap>>,
}

fn recording(args: &Args) -> Result<(), Error> {
    let (begun, end, track) = track(&args.file)?;
    let label = |relation: Option<&Relation>, t_s: f64| {
        relation
            .and_then(|relation| relation.label(Timestamp::from_secs_f64(t_s)))
            .map(|label| label.to_string())
    };
    let claps = match args.claps {
        false => None,
        true => {
            let (stage, recorded) = Recorded::open(&args.file)?;
            let mut motion = Motion::new(stage.sensors.iter().map(|sensor| sensor.name.clone()));
            recorded.estimates(|estimate| motion.push(estimate))?;
            if !motion.is_known() {
                return Err(Error::Failed(format!(
                    "{}: no sensor measures acceleration: claps are seen by IMUs alone",
                    args.file.display()
                )));
            }
            let mut claps = motion.claps();
            // The code of the whole log: of one that went on elsewhere, that of its end.
            claps.iter_mut().for_each(|clap| clap.timecode = label(track.relation(), clap.t_s));
            Some(claps)
        }
    };
    let found = OfRecording { timecode: track.info(end), claps };
    let has_nothing = match &found.claps {
        None => found.timecode.is_none(),
        Some(claps) => claps.is_empty(),
    };
    if args.json {
        print_json(&found)?;
        return if has_nothing { Err(Error::Reported) } else { Ok(()) };
    }
    let mut text = match &found.timecode {
        None => "no time code\n".to_owned(),
        Some(timecode) => format!(
            "timecode  {} to {} at {}, {} frames read, {} jumps\n",
            timecode.from,
            timecode.to,
            timecode.rate.unwrap_or("a rate that is not known"),
            timecode.frames,
            timecode.jumps
        ),
    };
    for clap in found.claps.iter().flatten() {
        let code = clap.timecode.as_deref().unwrap_or("-");
        let after_s = clap.t_s - begun.as_secs_f64();
        text.push_str(&format!(
            "clap      {code}  {after_s:.3} s after the beginning  {:.0} m/s²  {}\n",
            clap.peak_m_s2,
            clap.sensors.join(", ")
        ));
    }
    if found.claps.as_ref().is_some_and(Vec::is_empty) {
        text.push_str("no clap\n");
    }
    print(&text)?;
    if has_nothing { Err(Error::Reported) } else { Ok(()) }
}
