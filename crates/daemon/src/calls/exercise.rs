//! Exercises: selecting, and teaching from what is tracked.
//!
//! Teaching is a job on a thread of its own. It asks the fusion thread for the newest seconds, and what it has learned
//! goes the way of every model and request: through the input log.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::json;

use super::super::fusion::{Command, Ended, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::models::Library;
use super::super::observers::Excerpt;
use super::super::server::{self, Reply};
use super::Calls;
use posed_motion::exercise::{Exercise, Options, Refusal, Report, Stream, columns_of, rests, teach};
use posed_pipeline::DEFAULT_SUBJECT;
use posed_protocol::RefusalReason;
use posed_stage::input::{Model, Plan, Request};
use posed_stage::{BodyIndex, body_counted, signals};

/// Longest time that repetitions may take, s.
const LONGEST_S: f64 = 120.0;
/// Channels that a sentence names at most.
const MOST_NAMED: usize = 4;
/// Distance of two looks at whether the repetitions were done.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);

/// What to teach.
#[derive(Clone, Debug)]
pub(super) struct Lesson {
    pub(super) name: String,
    pub(super) repetitions: u32,
    pub(super) last_s: Option<f64>,
    pub(super) sensors: Option<Vec<String>>,
    pub(super) channels: Option<Vec<String>>,
    pub(super) subject: Option<String>,
    pub(super) body: Option<String>,
}

/// Who moves, and which body that is.
pub(super) struct Who {
    pub(super) subject: Option<String>,
    pub(super) body: Option<String>,
}

impl Who {
    /// The subject: who is not named is called as the body.
    fn subject(&self) -> String {
        self.subject.as_ref().or(self.body.as_ref()).map_or_else(|| DEFAULT_SUBJECT.to_owned(), String::clone)
    }
}

impl Calls {
    /// Counts exercises; those that are not loaded come from the folder.
    pub(super) fn select(
        &self,
        exercises: Vec<String>,
        plan: Plan,
        who: Who,
        sensors: BTreeMap<String, String>,
        reply: Reply,
    ) {
        let mut kept = Vec::new();
        for name in &exercises {
            match self.exercises.newest(name) {
                Ok(Some(exercise)) => kept.push(Model::Exercise { exercise: Box::new(exercise) }),
                Ok(None) => {}
                Err(error) => return reply.refuse(server::Refusal::failed(error)),
            }
        }
        let request =
            Request::ExerciseSelect { subject: who.subject(), exercises, plan, sensors, body: who.body };
        self.request(request, kept, reply);
    }

    /// Hands a request to the pipeline; `models` are swapped in before if it lacks them.
    pub(super) fn request(&self, request: Request, models: Vec<Model>, reply: Reply) {
        self.inbox.command(Command::Request { request, models, reply: Some(reply) });
    }

    /// Begins to teach.
    pub(super) fn teach(&self, lesson: Lesson, reply: Reply) {
        if let Err(refusal) = self.check_lesson(&lesson) {
            return reply.refuse(refusal);
        }
        let body = match self.looked_at(&lesson) {
            Ok(body) => body,
            Err(refusal) => return reply.refuse(refusal),
        };
        let columns = match &lesson.sensors {
            Some(names) => {
                let names = || names.iter().map(String::as_str);
                [signals::columns(names()), signals::inertial_columns(names())].concat()
            }
            None => self.columns_of_wearer(body, lesson.channels.as_deref()),
        };
        let prefix = signals::prefix_of(&self.stage, body);
        let (inbox, library) = (self.inbox.clone(), self.exercises.clone());
        let classroom = Classroom { lesson, columns, prefix, inbox, library };
        let from_s = self.clock.now().as_secs_f64();
        self.jobs.run("exercise.teach", reply, move |job| classroom.run(job, from_s));
    }

    /// The body that a lesson is about: that of this name, else the one that is called as the subject, else the first.
    fn looked_at(&self, lesson: &Lesson) -> Result<BodyIndex, server::Refusal> {
        let (name, subject) = (lesson.body.as_deref(), lesson.subject.as_deref());
        body_counted(self.stage.body_names(), name, subject).map_err(|_| {
            let name = name.unwrap_or_default();
            server::Refusal::bad_request(format!("body: this stage has no body {name:?}"))
        })
    }

    /// What the named channels come from; without names all that tells of who exercises.
    fn columns_of_wearer(&self, body: BodyIndex, channels: Option<&[String]>) -> Vec<String> {
        let of_wearer = signals::columns_of_wearer(&self.stage, body);
        let Some(channels) = channels else { return of_wearer };
        let prefix = signals::prefix_of(&self.stage, body);
        let all = signals::columns_of(&self.stage);
        // An exercise may be anybody's.
        let own = |channel: &String| signals::column_of(channel, &prefix, &all);
        let channels: Vec<String> = channels.iter().map(own).collect();
        // A name that is none is refused when it is taught.
        columns_of(&channels, &all).unwrap_or(all)
    }

    fn check_lesson(&self, lesson: &Lesson) -> Result<(), server::Refusal> {
        Library::check_name(&lesson.name).map_err(server::Refusal::bad_request)?;
        if !(2..=100).contains(&lesson.repetitions) {
            let sentence = "repetitions: give 2 to 100; 3 to 10 are good";
            return Err(server::Refusal::bad_request(sentence).because(RefusalReason::Repetitions));
        }
        if lesson.last_s.is_some_and(|last_s| !(1.0..=LONGEST_S).contains(&last_s)) {
            return Err(server::Refusal::bad_request(format!("last_s: give 1 to {LONGEST_S:.0} seconds")));
        }
        if self.stage.sensors.is_empty() {
            return Err(server::Refusal::bad_request("this stage has no sensors to teach from"));
        }
        let known = |name: &String| self.stage.sensors.iter().any(|sensor| sensor.name == *name);
        match lesson.sensors.iter().flatten().find(|name| !known(name)) {
            Some(name) => {
                Err(server::Refusal::bad_request(format!("sensors: this stage has no sensor {name:?}")))
            }
            None => Ok(()),
        }
    }
}

/// A lesson at work.
struct Classroom {
    lesson: Lesson,
    /// What is looked at.
    columns: Vec<String>,
    /// What stands in front of the names of this body's joints on the stage, and in no exercise.
    prefix: String,
    inbox: FusionInbox,
    library: Library,
}

/// A demonstration that did not teach.
#[derive(Clone)]
struct Refused {
    sentence: String,
    /// What was seen.
    report: Option<Box<Report>>,
    /// How many more repetitions are asked for.
    more: usize,
}

impl Classroom {
    fn run(self, job: &Job, requested_s: f64) -> Result<String, Failure> {
        let (exercise, report) = match self.lesson.last_s {
            Some(last_s) => self.taught(job, requested_s - last_s),
            None => self.watch(job, requested_s),
        }?;
        // Which channels, why these, and what else was tried.
        job.result(json!({ "channels": exercise.channels, "report": report }));
        self.keep(exercise, &report)
    }

    /// Waits until the repetitions were done.
    #[expect(clippy::disallowed_methods, reason = "a job may sleep on its own thread")]
    fn watch(&self, job: &Job, from_s: f64) -> Result<(Exercise, Report), Failure> {
        let announced = self.lesson.repetitions;
        let mut refusal = format!("saw no {announced} repetitions in {LONGEST_S:.0} s");
        job.progress(None, Some(format!("do {announced} repetitions, then rest")));
        // After a rest that taught nothing they may begin anew; while it lasts, when it was last seen.
        let (mut anew_s, mut rest_s) = (from_s, None);
        // How many repetitions were asked for beside those announced.
        let mut asked = 0;
        loop {
            std::thread::sleep(LOOK_INTERVAL);
            if job.is_cancelled() {
                return Err("cancelled; nothing was taught".into());
            }
            let excerpt = self.excerpt(from_s)?;
            let now_s = excerpt.t_s.last().copied().unwrap_or(from_s);
            if rests(&since(&excerpt, anew_s)) {
                rest_s = Some(now_s);
                // What follows the last rest, or else all of it: also who rests after each repetition can teach.
                let lesson = self.learn(&since(&excerpt, anew_s), 0).or_else(|why| {
                    if anew_s <= from_s {
                        return Err(why);
                    }
                    let whole = since(&excerpt, from_s);
                    // Those that were asked for once more may be counted among them, or take the place of those that were different.
                    let with_more = |_| if asked > 0 { self.learn(&whole, asked) } else { Err(why.clone()) };
                    self.learn(&whole, 0)
                        .or_else(with_more)
                        .map_err(|later| if later.more > 0 { later } else { why })
                });
                match lesson {
                    Ok(lesson) => return Ok(lesson),
                    Err(refused) => {
                        if let Some(report) = refused.report {
                            job.result(json!({ "report": report }));
                        }
                        job.progress(None, Some(format!("not yet: {}", refused.sentence)));
                        refusal = refused.sentence;
                        asked = asked.max(refused.more);
                    }
                }
            } else if let Some(rest_s) = rest_s.take() {
                anew_s = rest_s;
            }
            // Counted by what was tracked: a stage that stands still waits.
            if now_s - from_s > LONGEST_S - 1.0 {
                return Err(refusal.into());
            }
        }
    }

    fn taught(&self, job: &Job, from_s: f64) -> Result<(Exercise, Report), Failure> {
        let excerpt = self.excerpt(from_s)?;
        self.learn(&since(&excerpt, from_s), 0).map_err(|refused| {
            if let Some(report) = refused.report {
                job.result(json!({ "report": report }));
            }
            refused.sentence.into()
        })
    }

    /// What was tracked after a time.
    fn excerpt(&self, from_s: f64) -> Result<Excerpt, Ended> {
        let columns = self.columns.clone();
        let mut excerpt = self.inbox.ask(|to| Command::Recent { from_s, columns, to })?;
        for column in &mut excerpt.columns {
            if let Some(own) = column.strip_prefix(&self.prefix) {
                *column = own.to_owned();
            }
        }
        Ok(excerpt)
    }

    /// Teaches from a stream that holds the announced repetitions and so many more.
    fn learn(&self, stream: &Stream<'_>, more: usize) -> Result<(Exercise, Report), Refused> {
        let options = Options {
            name: self.lesson.name.trim().to_owned(),
            repetitions: self.lesson.repetitions as usize + more,
            channels: self.lesson.channels.clone(),
            ..Options::default()
        };
        match teach(stream, &options) {
            Ok(lesson) => Ok((lesson.exercise, lesson.report)),
            Err(refusal) => {
                let sentence = refusal.to_string();
                let Refusal::Count { report, more, .. } = refusal else {
                    return Err(Refused { sentence, report: None, more: 0 });
                };
                Err(Refused { sentence, report: Some(report), more })
            }
        }
    }

    /// Keeps the exercise, loads it, and has it counted.
    fn keep(&self, mut exercise: Exercise, report: &Report) -> Result<String, Failure> {
        self.library.keep(&mut exercise)?;
        let sentence = format!(
            "saw {} of {} repetitions of {}, {:.0} % similar, in {}",
            report.repetitions.len(),
            report.announced,
            exercise.name,
            100.0 * report.quality,
            channels_in_words(&exercise.channels)
        );
        let Lesson { subject, body, .. } = self.lesson.clone();
        let who = Who { subject, body };
        let exercises = vec![exercise.name.clone()];
        self.inbox.command(Command::load(Model::Exercise { exercise: Box::new(exercise) }));
        let (plan, sensors) = (Plan::default(), BTreeMap::new());
        let request =
            Request::ExerciseSelect { subject: who.subject(), exercises, plan, sensors, body: who.body };
        self.inbox.command(Command::Request { request, models: Vec::new(), reply: None });
        let remarks = report.remarks.iter().map(|remark| format!("; {remark}"));
        Ok(std::iter::once(sentence).chain(remarks).collect())
    }
}

/// All of a few channels, or the first ones of many.
fn channels_in_words(channels: &[String]) -> String {
    match channels.split_at_checked(MOST_NAMED) {
        Some((named, rest)) if !rest.is_empty() => format!("{} and {} more", named.join(", "), rest.len()),
        _ => channels.join(", "),
    }
}

/// What an excerpt holds after a time.
fn since(excerpt: &Excerpt, from_s: f64) -> Stream<'_> {
    let first = excerpt.t_s.partition_point(|t_s| *t_s <= from_s);
    let values = excerpt.values.get(first * excerpt.columns.len()..).unwrap_or_default();
    Stream { columns: &excerpt.columns, t_s: &excerpt.t_s[first..], values }
}
