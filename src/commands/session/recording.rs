//! Recordings: counted again, kept as a session, compared with one.

use std::path::{Path, PathBuf};

use posed_recording::{Item, Machine, Reader};
use posed_sessions::{EndedBy, Follower, NewSession, Repetition, SessionId, Store};

use super::super::progress::Progress;
use super::super::{Error, print, print_json};
use super::open_or_create;

/// What a recording shows.
pub(super) struct Counted {
    stage: String,
    epoch_utc_ns: i64,
    pub(super) begun_s: f64,
    end_s: f64,
    pub(super) repetitions: Vec<Repetition>,
}

/// Plays a recording through the pipeline that it was made with, and counts.
pub(super) fn count(path: &Path) -> Result<Counted, Error> {
    let mut reader = Reader::open(path).map_err(Error::failed)?;
    let header = reader.header().clone();
    let (stage, mut machine) = Machine::as_recorded(&header).map_err(Error::failed)?;
    let mut follower = Follower::new(&stage, &header.models);
    let mut progress = Progress::over(path, "counting");
    let begun_s = header.begun.as_secs_f64();
    let (mut repetitions, mut end_s) = (Vec::new(), begun_s);
    while let Some(item) = reader.next() {
        let Item::Entry(entry) = item.map_err(Error::failed)? else { continue };
        end_s = entry.t.as_secs_f64();
        machine.pipeline.push(&entry, &mut |output| repetitions.extend(follower.output(&output)));
        progress.at(reader.bytes_read());
    }
    Ok(Counted { stage: header.stage, epoch_utc_ns: header.epoch_utc_ns, begun_s, end_s, repetitions })
}

/// What to count, and for whom.
#[derive(clap::Args)]
pub(super) struct Count {
    /// The recording.
    recording: PathBuf,
    /// Keep what was counted as a session of this person.
    #[arg(long)]
    person: Option<String>,
    /// Only the repetitions of this subject; absent: of all, and `default` where they are kept.
    #[arg(long)]
    subject: Option<String>,
    /// Print one JSON object: the repetitions with the courses of their joints, and the number of the session.
    #[arg(long)]
    json: bool,
}

impl Count {
    pub(super) fn run(self, data: &Path) -> Result<(), Error> {
        let mut counted = count(&self.recording)?;
        let subject = self.subject.or_else(|| self.person.as_ref().map(|_| "default".to_owned()));
        if let Some(subject) = &subject {
            counted.repetitions.retain(|repetition| repetition.subject == *subject);
        }
        let session = match &self.person {
            None => None,
            Some(person) => {
                let mut store = open_or_create(data)?;
                let recording = self.recording.file_name().map(|name| name.to_string_lossy());
                Some(keep(
                    &mut store,
                    &counted,
                    person,
                    subject.as_deref().unwrap_or(""),
                    recording.as_deref(),
                )?)
            }
        };
        if self.json {
            let repetitions = counted.repetitions.iter().map(|repetition| {
                serde_json::json!({
                    "subject": repetition.subject, "exercise": repetition.lesson.exercise, "repetition": repetition
                })
            });
            let repetitions: Vec<_> = repetitions.collect();
            return print_json(&serde_json::json!({ "session": session, "repetitions": repetitions }));
        }
        let mut exercises: Vec<(&str, usize, usize)> = Vec::new();
        for repetition in &counted.repetitions {
            let name = repetition.lesson.exercise.as_str();
            let at = exercises.iter().position(|known| known.0 == name).unwrap_or_else(|| {
                exercises.push((name, 0, 0));
                exercises.len() - 1
            });
            exercises[at].1 += usize::from(repetition.is_counted());
            exercises[at].2 += usize::from(!repetition.is_counted());
        }
        let line = |(name, counted, rejected): &(&str, usize, usize)| {
            format!("{name}: {counted} counted, {rejected} not\n")
        };
        let mut text: String = exercises.iter().map(line).collect();
        if let Some(session) = session {
            text.push_str(&format!("kept as session {session}\n"));
        }
        print(&text)
    }
}

fn keep(
    store: &mut Store,
    counted: &Counted,
    person: &str,
    subject: &str,
    recording: Option<&str>,
) -> Result<SessionId, Error> {
    let new = NewSession {
        person,
        plan: None,
        stage: &counted.stage,
        subject,
        epoch_utc_ns: counted.epoch_utc_ns,
        t_begin_s: counted.begun_s,
        recording,
    };
    let session = store.begin(&new).map_err(Error::failed)?;
    for repetition in &counted.repetitions {
        store.add(session, repetition).map_err(Error::failed)?;
    }
    store.end(session, counted.end_s, EndedBy::Recording).map_err(Error::failed)?;
    Ok(session)
}

/// What to compare with what.
#[derive(clap::Args)]
pub(super) struct Verify {
    /// Number of the session.
    session: SessionId,
    /// Its recording.
    recording: PathBuf,
    /// Print one JSON object: repetitions compared, and the differences.
    #[arg(long)]
    json: bool,
}

impl Verify {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let session = store.session(self.session).map_err(Error::failed)?;
        let counted = count(&self.recording)?;
        if counted.epoch_utc_ns != session.epoch_utc_ns {
            return Err(Error::Failed("the recording is of another run than the session".to_owned()));
        }
        let differences = session.differences(&counted.repetitions, counted.begun_s);
        let compared =
            session.repetitions().filter(|repetition| repetition.t_start_s >= counted.begun_s).count();
        if self.json {
            print_json(&serde_json::json!({ "compared": compared, "differences": differences }))?;
        } else {
            differences.iter().try_for_each(|difference| print(&format!("{difference}\n")))?;
            print(&format!("{compared} repetitions compared, {} differences\n", differences.len()))?;
        }
        if differences.is_empty() { Ok(()) } else { Err(Error::Reported) }
    }
}
