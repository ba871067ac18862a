//! What is read: lists, sessions, exports, reports.

use std::path::PathBuf;

use clap::ValueEnum;
use posed_motion::exercise::Language;
use posed_sessions::{Session, SessionId, SessionSummary, Store, export, report};

use super::super::{Error, output, print, print_json};

/// Which sessions.
#[derive(clap::Args)]
pub(super) struct List {
    /// Only those of this person.
    #[arg(long)]
    person: Option<String>,
    /// At most so many.
    #[arg(long, default_value_t = 50)]
    limit: u32,
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
}

impl List {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let sessions = store.sessions(self.person.as_deref(), self.limit).map_err(Error::failed)?;
        if self.json {
            return print_json(&sessions);
        }
        print(&sessions.iter().map(line).collect::<String>())
    }
}

fn line(summary: &SessionSummary) -> String {
    let SessionSummary { session, person, begun, sets, counted, rejected, .. } = summary;
    let duration =
        summary.duration_s.map_or("goes on".to_owned(), |seconds| format!("{:.0} min", seconds / 60.0));
    let score = summary.score.map_or(String::new(), |score| format!(", score {score:.0}"));
    let plan = summary.plan.as_ref().map_or(String::new(), |plan| format!(", plan {plan}"));
    format!(
        "{session:>5}  {begun}  {person}  {duration}: sets {sets}, counted {counted}, not counted {rejected}{score}{plan}\n"
    )
}

/// How to show people.
#[derive(clap::Args)]
pub(super) struct People {
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
}

impl People {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let people = store.people().map_err(Error::failed)?;
        if self.json {
            return print_json(&people);
        }
        let line = |person: &posed_sessions::Person| {
            let last = person.last.as_deref().unwrap_or("never");
            format!("{}  {} sessions, last {last}\n", person.name, person.sessions)
        };
        print(&people.iter().map(line).collect::<String>())
    }
}

/// Which session.
#[derive(clap::Args)]
pub(super) struct Show {
    /// Its number, as `list` gives it.
    session: SessionId,
    /// Print one JSON object with every repetition and the courses of its joints.
    #[arg(long)]
    json: bool,
}

impl Show {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let session = store.session(self.session).map_err(Error::failed)?;
        if self.json {
            return print_json(&session);
        }
        let mut text = line(&session.summary);
        for set in &session.training {
            let of_planned = set.planned.map_or(String::new(), |planned| format!(" of {planned}"));
            let corrected =
                set.corrected.map_or(String::new(), |corrected| format!(", corrected to {corrected}"));
            let exercise = &set.lesson.exercise;
            text.push_str(&format!(
                "set {}: {exercise}, {}{of_planned}{corrected}\n",
                set.set,
                set.counted().count()
            ));
            for repetition in &set.repetitions {
                let number = repetition.number.map_or("  -".to_owned(), |number| format!("{number:>3}"));
                let score = repetition.score.map_or(String::new(), |score| format!("  {:>5.1}", score.total));
                let sentence = repetition.sentence.as_deref().unwrap_or("");
                let (t_s, duration_s) = (repetition.t_start_s, repetition.duration_s());
                text.push_str(&format!("  {number}  {t_s:>9.2} s  {duration_s:>5.2} s{score}  {sentence}\n"));
            }
        }
        print(&text)
    }
}

/// One session, or all of a person.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct Which {
    /// Number of a session, as `list` gives it.
    session: Option<SessionId>,
    /// All sessions of this person.
    #[arg(long)]
    person: Option<String>,
}

impl Which {
    fn sessions(&self, store: &Store) -> Result<Vec<Session>, Error> {
        match (self.session, &self.person) {
            (Some(session), _) => store.session(session).map(|session| vec![session]),
            (None, Some(person)) => store.course(person),
            (None, None) => Ok(Vec::new()),
        }
        .map_err(Error::failed)
    }
}

/// What to write where.
#[derive(clap::Args)]
pub(super) struct Export {
    #[command(flatten)]
    which: Which,
    /// The file; its ending chooses the format.
    #[arg(short, long, value_name = "FILE.json|FILE.csv|FILE.fhir.json")]
    output: PathBuf,
}

impl Export {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let sessions = self.which.sessions(store)?;
        let name = self.output.to_string_lossy().to_lowercase();
        let text = if name.ends_with(".fhir.json") {
            format!("{:#}\n", export::fhir(&sessions))
        } else if name.ends_with(".json") {
            export::json(&sessions).map_err(Error::failed)?
        } else if name.ends_with(".csv") {
            export::csv(&sessions).map_err(Error::failed)?
        } else {
            return Err(Error::Usage(
                "--output: give a file that ends in .json, .csv or .fhir.json".to_owned(),
            ));
        };
        output::replace(&self.output, |file| file.write_all(text.as_bytes()))
    }
}

/// Languages of reports.
#[derive(Clone, Copy, ValueEnum)]
enum ReportLanguage {
    /// English.
    En,
    /// German.
    De,
}

/// What to report where.
#[derive(clap::Args)]
pub(super) struct Report {
    #[command(flatten)]
    which: Which,
    /// The page; open it in a browser, print it.
    #[arg(short, long, value_name = "FILE.html")]
    output: PathBuf,
    /// In which language.
    #[arg(long, value_enum, default_value = "en")]
    language: ReportLanguage,
}

impl Report {
    pub(super) fn run(self, store: &Store) -> Result<(), Error> {
        let sessions = self.which.sessions(store)?;
        let language = match self.language {
            ReportLanguage::En => Language::English,
            ReportLanguage::De => Language::German,
        };
        let reader = report::Reader { language, time_zone: jiff::tz::TimeZone::system() };
        let page = match (&self.which.person, sessions.first()) {
            (Some(person), _) => report::course(person, &sessions, &reader),
            (None, Some(session)) => report::session(session, &reader),
            (None, None) => return Ok(()),
        };
        output::replace(&self.output, |file| file.write_all(page.as_bytes()))
    }
}
