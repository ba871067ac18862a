//! How well sets were counted, by the counts that somebody put right.

use std::path::{Path, PathBuf};

use posed_sessions::{CountAccuracy, Session, Store, TrainingSet};

use super::super::{Error, print, print_json};
use super::recording;

/// Exercise, count and truth of a set.
type Counted = (String, u32, u32);

/// Whose sets, and whether they are counted again.
#[derive(clap::Args)]
pub(super) struct Accuracy {
    /// Only of this person.
    #[arg(long)]
    person: Option<String>,
    /// Where the recordings of the sessions are: their sets are counted again, by this version.
    #[arg(long, value_name = "FOLDER")]
    recordings: Option<PathBuf>,
    /// Print one JSON object: `counted` and, with recordings, `counted_again`, a list of exercises each, and `not_counted_again`, the number
    /// of sets whose recording is not there or begins later.
    #[arg(long)]
    json: bool,
}

impl Accuracy {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let summaries = store.sessions(self.person.as_deref(), u32::MAX).map_err(Error::failed)?;
        let (mut counted, mut again, mut missing) = (Vec::new(), Vec::new(), 0_usize);
        for summary in summaries.into_iter().rev() {
            let session = store.session(summary.session).map_err(Error::failed)?;
            for (set, truth) in session.corrected() {
                counted.push((set.lesson.exercise.clone(), set.counted().count() as u32, truth));
            }
            if let Some(folder) = &self.recordings {
                let sets = counted_again(&session, folder)?;
                missing += sets.iter().filter(|set| set.is_none()).count();
                again.extend(sets.into_iter().flatten());
            }
        }
        let of = |sets: &[Counted]| {
            CountAccuracy::of(sets.iter().map(|(name, counted, truth)| (name.as_str(), *counted, *truth)))
        };
        let (counted, again) = (of(&counted), self.recordings.is_some().then(|| of(&again)));
        if self.json {
            let mut answer = serde_json::json!({ "counted": counted });
            if let Some(again) = again {
                answer["counted_again"] = serde_json::json!(again);
                answer["not_counted_again"] = missing.into();
            }
            return print_json(&answer);
        }
        if counted.is_empty() {
            return print(
                "no count was put right: `posed session correct SESSION SET COUNT`, or on the page\n",
            );
        }
        let mut text = table("counted", &counted);
        if let Some(again) = again {
            text.push_str(&table("counted again", &again));
            if missing > 0 {
                text.push_str(&format!(
                    "without a recording there, or with one that begins later: {missing}\n"
                ));
            }
        }
        print(&text)
    }
}

/// The sets of a session that somebody put right, as its recording in the folder gives them; `None` of one that it does not hold.
fn counted_again(session: &Session, folder: &Path) -> Result<Vec<Option<Counted>>, Error> {
    let path = session.summary.recording.as_ref().map(|name| folder.join(name)).filter(|path| path.is_file());
    let recording = match path.filter(|_| session.corrected().next().is_some()) {
        Some(path) => Some(recording::count(&path)?),
        None => None,
    };
    let of = |(set, truth): (&TrainingSet, u32)| {
        let recording = recording.as_ref()?;
        let again = session.counted_again(set.set, &recording.repetitions, recording.begun_s)?;
        Some((set.lesson.exercise.clone(), again, truth))
    };
    Ok(session.corrected().map(of).collect())
}

fn table(title: &str, exercises: &[CountAccuracy]) -> String {
    let mut text = format!("{title}:\n");
    for CountAccuracy { exercise, sets, exact, within_one } in exercises {
        let percent = |part: u32| 100.0 * f64::from(part) / f64::from((*sets).max(1));
        text.push_str(&format!(
            "  {exercise}: sets put right {sets}, exact {exact} ({:.1} %), within one {within_one} ({:.1} %)\n",
            percent(*exact),
            percent(*within_one)
        ));
    }
    text
}
