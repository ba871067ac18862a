//! The sessions that go on, and the database behind them.

use std::collections::VecDeque;
use std::path::PathBuf;

use posed_drivers::Timestamp;
use posed_protocol::{RunningSession, Sessions};
use posed_sessions::{EndedBy, Repetition, SessionId, Store, StoreError};

use super::Tools;
use super::follow::Report;
use super::plan::PlanRun;

/// Repetitions that may wait for the disk.
pub(super) const UNWRITTEN: usize = 4096;

/// A frame older than this is none of now, s.
const FRESH_S: f64 = 1.0;

/// All of it.
#[derive(Debug)]
pub(super) struct State {
    pub(super) stage: String,
    file: PathBuf,
    pub(super) tools: Tools,
    store: Option<Store>,
    pub(super) running: Vec<Running>,
    /// What could not be written yet, in order.
    unwritten: VecDeque<(SessionId, Change)>,
    /// Why.
    problem: Option<String>,
    /// The recording that runs.
    pub(super) recording: Option<String>,
    /// What was published last.
    published: Sessions,
}

/// A session that goes on.
#[derive(Debug)]
pub(super) struct Running {
    pub(super) session: SessionId,
    pub(super) person: String,
    pub(super) subject: String,
    pub(super) t_begin_s: f64,
    pub(super) counted: u32,
    pub(super) plan: Option<PlanRun>,
}

/// What a session gets.
#[derive(Debug)]
enum Change {
    Repetition(Box<Repetition>),
    Recording(String),
    End(f64, EndedBy),
}

impl State {
    pub(super) fn new(stage: String, file: PathBuf, tools: Tools) -> Self {
        Self {
            stage,
            file,
            tools,
            store: None,
            running: Vec::new(),
            unwritten: VecDeque::new(),
            problem: None,
            recording: None,
            published: Sessions::default(),
        }
    }

    /// What an earlier daemon has left open ends.
    pub(super) fn begin(&mut self) {
        if !self.file.exists() {
            return;
        }
        let stage = self.stage.clone();
        match self.store().and_then(|store| store.end_interrupted(&stage)) {
            Ok(0) => {}
            Ok(ended) => tracing::warn!("{ended} sessions had broken off with the daemon; they are ended"),
            Err(error) => tracing::warn!("{error}"),
        }
    }

    /// The database; opened when it is first needed, and again after it could not be.
    pub(super) fn store(&mut self) -> Result<&mut Store, StoreError> {
        let store = match self.store.take() {
            Some(store) => store,
            None => {
                if let Some(folder) = self.file.parent() {
                    // Where it cannot be made the database says so.
                    let _ = std::fs::create_dir_all(folder);
                }
                Store::open(&self.file)?
            }
        };
        Ok(self.store.insert(store))
    }

    /// Whether anything was ever kept.
    pub(super) fn has_sessions(&self) -> bool {
        self.store.is_some() || self.file.exists()
    }

    /// Reads what is kept. A database that is not there is an empty one: looking makes no file.
    pub(super) fn read<T>(
        &mut self,
        read: impl FnOnce(&Store) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        if !self.has_sessions() {
            return read(&Store::in_memory()?);
        }
        read(self.store()?)
    }

    pub(super) fn now_s(&self) -> f64 {
        self.tools.clock.now().as_secs_f64()
    }

    /// Where a session begins or ends: at the newest frame, so that a replay draws the same line between repetitions; where nothing
    /// is tracked, now.
    pub(super) fn moment_s(&self, decided: Timestamp) -> f64 {
        let (now_s, decided_s) = (self.now_s(), decided.as_secs_f64());
        let t_s = if (now_s - decided_s).abs() <= FRESH_S { decided_s } else { now_s };
        // As times of repetitions are rounded.
        (t_s * 1e6).round() / 1e6
    }

    /// Takes a report.
    pub(super) fn take(&mut self, report: Report) {
        match report {
            Report::Recording(name) => {
                self.recording.clone_from(&name);
                if let Some(name) = name {
                    for running in &self.running {
                        self.unwritten.push_back((running.session, Change::Recording(name.clone())));
                    }
                    self.write_what_waits();
                }
            }
            Report::Repetition(repetition) => {
                let of_it = |running: &&mut Running| {
                    running.subject == repetition.subject && running.t_begin_s < repetition.t_decided_s
                };
                let Some(running) = self.running.iter_mut().find(of_it) else { return };
                running.counted += u32::from(repetition.is_counted());
                let session = running.session;
                self.write(session, Change::Repetition(repetition));
            }
            Report::Progress { subject, state } => {
                let now_s = self.now_s();
                let of_it = |running: &&mut Running| running.subject == subject;
                if let Some(plan) =
                    self.running.iter_mut().find(of_it).and_then(|running| running.plan.as_mut())
                {
                    plan.progress(&state, now_s);
                }
            }
        }
    }

    /// Goes on with plans and with what could not be written, and publishes what has changed. All that was `decided` by then
    /// has been taken; `lost` reports never came.
    pub(super) fn tick(&mut self, decided: Timestamp, lost: u64) {
        if self.running.is_empty() && self.unwritten.is_empty() && self.published.sessions.is_empty() {
            return;
        }
        let now_s = self.now_s();
        for running in &mut self.running {
            let command = running.plan.as_mut().and_then(|plan| plan.tick(&running.subject, now_s));
            if let Some(command) = command {
                self.tools.inbox.command(command);
            }
        }
        let is_done = |running: &&Running| running.plan.as_ref().is_some_and(PlanRun::is_done);
        let t_end_s = self.moment_s(decided);
        while let Some(subject) = self.running.iter().find(is_done).map(|running| running.subject.clone()) {
            self.end(&subject, t_end_s, EndedBy::Plan);
        }
        self.write_what_waits();
        self.publish(lost);
    }

    /// Ends the session of a subject; false where none goes on.
    pub(super) fn end(&mut self, subject: &str, t_end_s: f64, ended_by: EndedBy) -> bool {
        let Some(at) = self.running.iter().position(|running| running.subject == subject) else {
            return false;
        };
        let session = self.running.remove(at).session;
        self.write(session, Change::End(t_end_s, ended_by));
        true
    }

    /// The daemon ends.
    pub(super) fn shut_down(&mut self) {
        let now_s = self.now_s();
        while let Some(subject) = self.running.first().map(|running| running.subject.clone()) {
            self.end(&subject, now_s, EndedBy::Daemon);
        }
        self.write_what_waits();
        if !self.unwritten.is_empty() {
            tracing::error!("{} changes of sessions could not be written and are lost", self.unwritten.len());
        }
    }

    fn write(&mut self, session: SessionId, change: Change) {
        self.unwritten.push_back((session, change));
        if self.unwritten.len() > UNWRITTEN {
            // The oldest repetition, not the end of a session.
            let oldest =
                self.unwritten.iter().position(|(_, change)| matches!(change, Change::Repetition(_)));
            self.unwritten.remove(oldest.unwrap_or(0));
        }
        self.write_what_waits();
    }

    fn write_what_waits(&mut self) {
        while let Some((session, change)) = self.unwritten.pop_front() {
            let written = self.store().and_then(|store| match &change {
                Change::Repetition(repetition) => store.add(session, repetition),
                Change::Recording(name) => store.link_recording(session, name),
                Change::End(t_end_s, ended_by) => store.end(session, *t_end_s, *ended_by),
            });
            match written {
                Ok(()) => self.problem = None,
                Err(error) if error.may_pass() => {
                    self.unwritten.push_front((session, change));
                    self.problem = Some(format!("{error}; it is tried again"));
                    return;
                }
                // Somebody was forgotten meanwhile, for example.
                Err(error) => tracing::warn!("{error}"),
            }
        }
    }

    /// Tells clients of what goes on, if that has changed.
    pub(super) fn publish(&mut self, lost: u64) {
        let now_s = self.now_s();
        let lost = (lost > 0).then(|| format!("{lost} reports of tracking were lost"));
        let sessions = self.running.iter().map(|running| RunningSession {
            session: running.session,
            person: running.person.clone(),
            subject: running.subject.clone(),
            begun_s: running.t_begin_s,
            counted: running.counted,
            plan: running.plan.as_ref().map(PlanRun::shown),
            problem: running
                .plan
                .as_ref()
                .and_then(|plan| plan.problem(now_s))
                .or_else(|| self.problem.clone())
                .or_else(|| lost.clone()),
        });
        let sessions: Vec<RunningSession> = sessions.collect();
        if sessions != self.published.sessions {
            self.published = Sessions { t_s: now_s, sessions };
            self.tools.hub.publish_sessions(self.published.clone());
        }
    }
}
