//! What clients ask of sessions. Reads and writes files: not for an asynchronous task.

use std::path::Path;

use jiff::tz::TimeZone;

use super::super::library;
use super::super::server::Refusal;
use super::Training;
use super::plan::PlanRun;
use super::state::{Running, State};
use posed_motion::exercise::Language;
use posed_pipeline::DEFAULT_SUBJECT;
use posed_protocol::{
    Answer, ListedSessions, People, Plans, RefusalReason, Report, ReportLanguage, SessionBegun, Shown,
};
use posed_sessions::{EndedBy, NewSession, Plan, SessionId, Store, StoreError, report};
use posed_stage::input::Model;

/// Sessions that are listed unless a client asks for more or fewer, and most.
const LISTED: u32 = 100;
const MOST_LISTED: u32 = 1000;
/// Sessions at a time.
pub(super) const RUNNING: usize = 64;

/// What a request is answered with.
type Outcome = Result<Option<Answer>, Refusal>;

impl From<StoreError> for Refusal {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::NoSession(_)
            | StoreError::NoSet(..)
            | StoreError::NoPerson(_)
            | StoreError::NoPlan(_) => Self::new("not_found", error),
            StoreError::Name | StoreError::Plan(_) => Self::bad_request(error),
            StoreError::Database(_) | StoreError::Version(_) | StoreError::Damaged(_) => Self::failed(error),
        }
    }
}

impl Training {
    /// Begins a session; with a plan selects its first exercise.
    pub(crate) fn begin(&self, person: &str, plan: Option<&str>, subject: Option<String>) -> Outcome {
        let subject = subject.unwrap_or_else(|| DEFAULT_SUBJECT.to_owned());
        let (mut state, decided) = self.shared.up_to_date();
        if state.running.iter().any(|running| running.subject == subject) {
            let sentence = format!("a session of {subject:?} goes on; end that first");
            return Err(Refusal::new("already", sentence)
                .because(RefusalReason::SessionRuns)
                .with("person", subject));
        }
        if state.running.len() >= RUNNING {
            return Err(Refusal::new("busy", format!("{RUNNING} sessions go on already")));
        }
        let plan = plan.map(|name| state.read(|store| store.plan(name))).transpose()?;
        let now_s = state.now_s();
        let plan = plan.map(|plan| state.prepared(plan, now_s)).transpose()?;
        let t_begin_s = state.moment_s(decided);
        let (stage, recording) = (state.stage.clone(), state.recording.clone());
        let epoch_utc_ns = state.tools.clock.epoch_utc_ns();
        let session = state.store()?.begin(&NewSession {
            person,
            plan: plan.as_ref().map(PlanRun::name),
            stage: &stage,
            subject: &subject,
            epoch_utc_ns,
            t_begin_s,
            recording: recording.as_deref(),
        })?;
        if let Some(plan) = &plan {
            state.tools.inbox.command(plan.select(&subject));
        }
        let person = person.to_owned();
        state.running.push(Running { session, person, subject, t_begin_s, counted: 0, plan });
        state.publish(self.shared.lost());
        Ok(Some(Answer::SessionBegun(SessionBegun { session })))
    }

    /// Ends a session.
    pub(crate) fn end(&self, subject: Option<String>) -> Outcome {
        let subject = subject.unwrap_or_else(|| DEFAULT_SUBJECT.to_owned());
        let (mut state, decided) = self.shared.up_to_date();
        let t_end_s = state.moment_s(decided);
        if !state.end(&subject, t_end_s, EndedBy::Request) {
            return Err(Refusal::new("not_found", format!("no session of {subject:?} goes on")));
        }
        state.publish(self.shared.lost());
        Ok(None)
    }

    pub(crate) fn list(&self, person: Option<&str>, limit: Option<u32>) -> Outcome {
        let limit = limit.unwrap_or(LISTED);
        if !(1..=MOST_LISTED).contains(&limit) {
            return Err(Refusal::bad_request(format!("limit: give 1 to {MOST_LISTED}")));
        }
        let sessions = self.shared.lock().read(|store| store.sessions(person, limit))?;
        Ok(Some(Answer::Sessions(ListedSessions { sessions })))
    }

    pub(crate) fn show(&self, session: SessionId) -> Outcome {
        let session = self.shared.lock().read(|store| store.session(session))?;
        let shown = serde_json::to_value(session).map_err(Refusal::failed)?;
        Ok(Some(Answer::Shown(Shown { shown })))
    }

    pub(crate) fn report(
        &self,
        session: Option<SessionId>,
        person: Option<&str>,
        language: ReportLanguage,
        time_zone: Option<&str>,
    ) -> Outcome {
        let language = match language {
            ReportLanguage::English => Language::English,
            ReportLanguage::German => Language::German,
        };
        let time_zone = match time_zone {
            Some(name) => {
                TimeZone::get(name).map_err(|error| Refusal::bad_request(format!("time_zone: {error}")))?
            }
            None => TimeZone::system(),
        };
        let reader = report::Reader { language, time_zone };
        let mut state = self.shared.lock();
        let html = match (session, person) {
            (Some(session), None) => report::session(&state.read(|store| store.session(session))?, &reader),
            (None, Some(person)) => {
                report::course(person, &state.read(|store| store.course(person))?, &reader)
            }
            _ => return Err(Refusal::bad_request("give session or person")),
        };
        Ok(Some(Answer::Report(Report { html })))
    }

    pub(crate) fn correct(&self, session: SessionId, set: u32, counted: u32) -> Outcome {
        let mut state = self.shared.lock();
        let now = state.tools.clock.now().as_nanos();
        let utc_ns = state.tools.clock.epoch_utc_ns().saturating_add(now);
        state.store()?.correct(session, set, counted, utc_ns)?;
        Ok(None)
    }

    pub(crate) fn people(&self) -> Outcome {
        let people = self.shared.lock().read(Store::people)?;
        Ok(Some(Answer::People(People { people })))
    }

    /// Removes somebody; their session ends. Recordings go where they are asked to, but not the one that runs.
    pub(crate) fn forget(&self, person: &str, recordings: Option<&Path>) -> Outcome {
        let (mut state, decided) = self.shared.up_to_date();
        let t_end_s = state.moment_s(decided);
        let running = state.running.iter().find(|running| running.person == person);
        if let Some(subject) = running.map(|running| running.subject.clone()) {
            state.end(&subject, t_end_s, EndedBy::Request);
        }
        let current = state.recording.clone();
        let mut forgotten = state.store()?.forget(person)?;
        if let Some(folder) = recordings {
            // What is left is what could not be removed.
            forgotten.recordings.retain(|name| {
                let is_plain = Path::new(name).file_name().is_some_and(|plain| plain == name.as_str());
                let is_running = current.as_ref() == Some(name);
                is_running || !is_plain || !is_removed(folder, name)
            });
        }
        state.publish(self.shared.lost());
        Ok(Some(Answer::Forgotten(forgotten)))
    }

    /// A recording has another name: that of a session is found by it.
    pub(crate) fn recording_renamed(&self, from: &str, to: &str) {
        let mut state = self.shared.lock();
        // Without sessions there is nothing to say.
        if !state.has_sessions() {
            return;
        }
        let renamed = state.store().and_then(|store| store.rename_recording(from, to));
        if let Err(error) = renamed {
            tracing::warn!("sessions that were recorded in {from} do not know that it is {to} now: {error}");
        }
    }

    pub(crate) fn plans(&self) -> Outcome {
        let plans = self.shared.lock().read(Store::plans)?;
        Ok(Some(Answer::Plans(Plans { plans })))
    }

    pub(crate) fn save_plan(&self, plan: &Plan) -> Outcome {
        self.shared.lock().store()?.save_plan(plan)?;
        Ok(None)
    }

    pub(crate) fn delete_plan(&self, name: &str) -> Outcome {
        self.shared.lock().store()?.delete_plan(name)?;
        Ok(None)
    }
}

/// Whether a recording is gone, with all that was made of it.
fn is_removed(folder: &Path, name: &str) -> bool {
    let removed = library::forget(folder, name);
    if let Err(error) = &removed {
        tracing::warn!("cannot remove {name} from {}: {error}", folder.display());
    }
    removed.is_ok()
}

impl State {
    /// A plan with the exercises that its steps need from the folder.
    fn prepared(&self, plan: Plan, now_s: f64) -> Result<PlanRun, Refusal> {
        let newest = |exercise: &str| match self.tools.exercises.newest(exercise) {
            Ok(Some(exercise)) => Ok(Some(Model::Exercise { exercise: Box::new(exercise) })),
            // The stage file may name it.
            Ok(None) => Ok(None),
            Err(error) => Err(Refusal::failed(error)),
        };
        let models = plan.steps.iter().map(|step| newest(&step.exercise)).collect::<Result<_, _>>()?;
        Ok(PlanRun::new(plan, models, now_s))
    }
}
