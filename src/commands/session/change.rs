//! What is changed: counts, people, plans.

use std::path::{Path, PathBuf};

use posed_sessions::{Erasure, Plan, SessionId, Store};

use super::super::{Error, notify, print, print_json};
use super::{open, open_or_create};

/// Which set, and how many.
#[derive(clap::Args)]
pub(super) struct Correct {
    /// Number of the session.
    session: SessionId,
    /// Number of the set in it.
    set: u32,
    /// Repetitions that were really done.
    counted: u32,
}

impl Correct {
    pub(super) fn run(self, store: &mut Store) -> Result<(), Error> {
        let utc_ns = i64::try_from(jiff::Timestamp::now().as_nanosecond()).unwrap_or(i64::MAX);
        store.correct(self.session, self.set, self.counted, utc_ns).map_err(Error::failed)
    }
}

/// Whom to remove.
#[derive(clap::Args)]
pub(super) struct Forget {
    /// The person.
    person: String,
    /// The folder of the recordings, from which those of the person's sessions are removed too, whoever else is in them.
    #[arg(long, value_name = "FOLDER", conflicts_with = "keep_recordings")]
    recordings: Option<PathBuf>,
    /// Leave the recordings where they are.
    #[arg(long)]
    keep_recordings: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Forget {
    pub(super) fn run(self, store: &mut Store) -> Result<(), Error> {
        let kept = store.sessions(Some(&self.person), u32::MAX).map_err(Error::failed)?;
        let is_recorded = kept.iter().any(|session| session.recording.is_some());
        if is_recorded && self.recordings.is_none() && !self.keep_recordings {
            return Err(Error::Usage(
                "there are recordings of these sessions: give their folder with --recordings, or --keep-recordings".into(),
            ));
        }
        let forgotten = store.forget(&self.person).map_err(Error::failed)?;
        if let Some(folder) = &self.recordings {
            forgotten.recordings.iter().for_each(|name| remove(folder, name));
        }
        if forgotten.erasure == Erasure::Pending {
            notify(
                "another program reads the database: bytes are left in its journal until that has ended and posed opens it next",
            );
        }
        if self.json {
            return print_json(&forgotten);
        }
        print(&format!("{} and {} sessions are removed\n", self.person, forgotten.sessions))
    }
}

/// Removes a recording with what was made of it; the name has no path in it.
fn remove(folder: &Path, name: &str) {
    let Some(plain) = Path::new(name).file_name().and_then(|plain| plain.to_str()) else { return };
    if let Err(error) = posed_daemon::forget_recording(folder, plain) {
        notify(&format!("cannot remove {plain} from {}: {error}", folder.display()));
    }
}

/// What to do with plans.
#[derive(clap::Args)]
pub(super) struct PlanArgs {
    /// Keep the plan in this file, in the place of one of its name: JSON with `name` and `steps`, each with `exercise`, `sets`,
    /// `repetitions`, `rest_s`.
    #[arg(long, value_name = "PLAN.json", conflicts_with = "delete")]
    save: Option<PathBuf>,
    /// Remove the plan of this name.
    #[arg(long, value_name = "NAME")]
    delete: Option<String>,
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
}

impl PlanArgs {
    pub(super) fn run(self, data: &Path) -> Result<(), Error> {
        if let Some(path) = &self.save {
            let text = std::fs::read_to_string(path).map_err(|error| Error::file("read", path, &error))?;
            let wrong = |error: &dyn std::fmt::Display| Error::Failed(format!("{}: {error}", path.display()));
            let plan: Plan = serde_json::from_str(&text).map_err(|error| wrong(&error))?;
            return open_or_create(data)?.save_plan(&plan).map_err(|error| wrong(&error));
        }
        if let Some(name) = &self.delete {
            return open(data)?.delete_plan(name).map_err(Error::failed);
        }
        let plans = open(data)?.plans().map_err(Error::failed)?;
        if self.json {
            return print_json(&plans);
        }
        let mut text = String::new();
        for plan in &plans {
            text.push_str(&format!("{}\n", plan.name));
            for step in &plan.steps {
                let posed_sessions::PlanStep { exercise, sets, repetitions, rest_s } = step;
                text.push_str(&format!("  {exercise}: {sets} x {repetitions}, rest {rest_s} s\n"));
            }
        }
        print(&text)
    }
}
