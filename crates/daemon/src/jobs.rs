//! Jobs: what takes its time, can be watched on the topic `jobs`, and can be cancelled.
//!
//! In: who works reports its progress. Out: the list of all jobs to the clients, on change and at most five times a second
//! between. A cancelled job is only asked to end: it ends where it can, and says itself what is left of it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use posed_drivers::Timestamp;

use super::clock::StageClock;
use super::server::{Hub, Refusal, Reply};
use posed_protocol::{Answer, JobState, RefusalReason, Started};

/// Jobs that have ended and are still listed.
const ENDED: usize = 16;
/// Jobs that may run at a time.
const RUNNING: usize = 8;
/// Distance of two messages that tell nothing but progress.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

/// Why a job came to nothing: for people, nobody decides by it.
pub(super) type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Why a job is not asked to end.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum CancelError {
    #[error("job {0} has ended already")]
    Ended(u64),
    #[error("no job {0} is running")]
    Unknown(u64),
}

/// Why work is not done aside.
#[derive(Debug, thiserror::Error)]
#[error("the system gives no threads: {0}")]
pub(super) struct NoThreads(#[from] rayon::ThreadPoolBuildError);

/// All jobs of a daemon; clones share them.
#[derive(Clone, Debug)]
pub(super) struct Jobs {
    clock: StageClock,
    hub: Hub,
    list: Arc<Mutex<List>>,
}

#[derive(Debug, Default)]
struct List {
    last: u64,
    jobs: Vec<Listed>,
    published: Timestamp,
}

#[derive(Debug)]
struct Listed {
    job: posed_protocol::Job,
    begun: Timestamp,
    cancelled: Arc<AtomicBool>,
}

/// A job at work; belongs to who does it. Dropped without an end, it has failed.
#[derive(Debug)]
pub(super) struct Job {
    jobs: Jobs,
    number: u64,
    cancelled: Arc<AtomicBool>,
}

impl Jobs {
    pub(super) fn new(clock: StageClock, hub: Hub) -> Self {
        Self { clock, hub, list: Arc::default() }
    }

    /// Begins a job; `kind` is the request that asks for it.
    pub(super) fn begin(&self, kind: &str) -> Job {
        let mut list = self.lock();
        list.last += 1;
        let number = list.last;
        let cancelled = Arc::<AtomicBool>::default();
        list.jobs.push(Listed {
            job: posed_protocol::Job {
                job: number,
                kind: kind.to_owned(),
                state: JobState::Running,
                progress: None,
                remaining_s: None,
                message: None,
                result: None,
            },
            begun: self.clock.now(),
            cancelled: Arc::clone(&cancelled),
        });
        self.publish(&mut list);
        Job { jobs: self.clone(), number, cancelled }
    }

    /// Begins a job on a thread of its own, answers with its number, and ends it with what `work` returns. Refused as `busy` while
    /// eight run.
    pub(super) fn run(
        &self,
        kind: &str,
        reply: Reply,
        work: impl FnOnce(&Job) -> Result<String, Failure> + Send + 'static,
    ) {
        if self.is_full() {
            let sentence = format!("{RUNNING} jobs are running already; wait for one, or cancel it");
            return reply.refuse(
                Refusal::new("busy", sentence).because(RefusalReason::JobsRun).with("count", RUNNING),
            );
        }
        let job = self.begin(kind);
        let number = job.number();
        #[expect(clippy::disallowed_methods, reason = "a long job has a thread of its own")]
        let thread = std::thread::Builder::new().name(kind.to_owned()).spawn(move || {
            let outcome = work(&job);
            job.end(outcome);
        });
        match thread {
            Ok(_) => reply.ok(Some(Answer::Started(Started { job: number }))),
            Err(error) => reply.error("failed", format!("the system gives no thread: {error}")),
        }
    }

    /// What runs, by the requests that asked for it.
    pub(super) fn running(&self) -> Vec<String> {
        let list = self.lock();
        let running = list.jobs.iter().filter(|listed| listed.job.state == JobState::Running);
        running.map(|listed| listed.job.kind.clone()).collect()
    }

    fn is_full(&self) -> bool {
        self.lock().jobs.iter().filter(|listed| listed.job.state == JobState::Running).count() >= RUNNING
    }

    /// Tells a job to end.
    ///
    /// # Errors
    /// No such job is running.
    pub(super) fn cancel(&self, number: u64) -> Result<(), CancelError> {
        let list = self.lock();
        let found = list.jobs.iter().find(|listed| listed.job.job == number);
        match found {
            Some(listed) if listed.job.state == JobState::Running => {
                listed.cancelled.store(true, Ordering::Relaxed);
                Ok(())
            }
            Some(_) => Err(CancelError::Ended(number)),
            None => Err(CancelError::Unknown(number)),
        }
    }

    fn change(&self, number: u64, change: impl FnOnce(&mut Listed, Timestamp)) {
        let mut list = self.lock();
        let now = self.clock.now();
        let Some(listed) = list.jobs.iter_mut().find(|listed| listed.job.job == number) else { return };
        let said_nothing = listed.job.message.is_none();
        change(listed, now);
        // What to do is said at once, the progress now and then.
        let begins_to_say = said_nothing && listed.job.message.is_some();
        if listed.job.state != JobState::Running {
            let ended = list.jobs.iter().filter(|listed| listed.job.state != JobState::Running).count();
            let mut surplus = ended.saturating_sub(ENDED);
            list.jobs.retain(|listed| {
                let keep = listed.job.state == JobState::Running || surplus == 0;
                surplus -= usize::from(!keep);
                keep
            });
        } else if !begins_to_say && now < list.published + PROGRESS_INTERVAL {
            return;
        }
        self.publish(&mut list);
    }

    fn publish(&self, list: &mut List) {
        list.published = self.clock.now();
        let jobs = list.jobs.iter().map(|listed| listed.job.clone()).collect();
        self.hub.publish_jobs(posed_protocol::Jobs { t_s: list.published.as_secs_f64(), jobs });
    }

    fn lock(&self) -> MutexGuard<'_, List> {
        // Every change is complete before anything in it could panic.
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Job {
    /// Its number, for the reply and for `job.cancel`.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Whether it was asked to end.
    pub(super) fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// How far it is, from 0 to 1, where that is known, and what it is at.
    pub(super) fn progress(&self, fraction: Option<f64>, message: Option<String>) {
        self.jobs.change(self.number, |listed, now| {
            let passed_s = now.seconds_since(listed.begun);
            listed.job.progress = fraction.map(|fraction| fraction.clamp(0.0, 1.0));
            listed.job.remaining_s =
                fraction.filter(|fraction| *fraction > 0.0).map(|fraction| passed_s * (1.0 / fraction - 1.0));
            listed.job.message = message;
        });
    }

    /// The same, with what has come of it so far.
    pub(super) fn progress_with(&self, fraction: Option<f64>, message: String, result: serde_json::Value) {
        // In one message: the second of two that follow one another waits for what comes next.
        if let Some(listed) = self.jobs.lock().jobs.iter_mut().find(|listed| listed.job.job == self.number) {
            listed.job.result = Some(result);
        }
        self.progress(fraction, Some(message));
    }

    /// What came of it, for programs; said when it ends.
    pub(super) fn result(&self, result: serde_json::Value) {
        self.jobs.change(self.number, |listed, _| listed.job.result = Some(result));
    }

    /// Ends it with its outcome, or with the reason why there is none.
    pub(super) fn end(self, outcome: Result<String, impl std::fmt::Display>) {
        let cancelled = self.is_cancelled();
        self.jobs.change(self.number, |listed, _| {
            let (state, message) = match outcome {
                Ok(message) if cancelled => (JobState::Cancelled, message),
                Ok(message) => (JobState::Done, message),
                Err(reason) => (JobState::Failed, reason.to_string()),
            };
            let progress = if state == JobState::Done { Some(1.0) } else { listed.job.progress };
            listed.job = posed_protocol::Job {
                state,
                progress,
                remaining_s: None,
                message: Some(message),
                ..listed.job.clone()
            };
        });
    }
}

impl Drop for Job {
    fn drop(&mut self) {
        self.jobs.change(self.number, |listed, _| {
            if listed.job.state == JobState::Running {
                listed.job.state = JobState::Failed;
                listed.job.message = Some("it broke off; see the daemon's log".into());
            }
        });
    }
}

/// Does work that spreads over several threads on half of the processor's cores, with less right to them than tracking has.
///
/// # Errors
/// The system gives no threads.
pub(super) fn aside<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T, NoThreads> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(cores.div_ceil(2))
        .thread_name(|_| "aside".to_owned())
        .start_handler(|_| give_way(10))
        .build()?;
    Ok(pool.install(work))
}

/// Leaves this thread less right to the processor, by so many steps of 19.
pub(super) fn give_way(steps: i32) {
    // A thread's own on Linux; elsewhere it would be the whole daemon's.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(steps);
    #[cfg(not(target_os = "linux"))]
    let _ = steps;
}

#[cfg(test)]
mod tests {
    use super::super::server::testing::{Asking, ids};
    use super::*;

    fn jobs() -> (Jobs, Hub) {
        let hub = Hub::default();
        (Jobs::new(StageClock::start(), hub.clone()), hub)
    }

    fn newest(hub: &Hub) -> Vec<posed_protocol::Job> {
        std::iter::from_fn(|| hub.take_jobs()).last().map(|jobs| jobs.jobs).unwrap_or_default()
    }

    #[test]
    fn a_job_is_reported_of_from_its_beginning_to_its_end() {
        let (jobs, hub) = jobs();
        let job = jobs.begin("record.start");
        let begun = newest(&hub);
        assert_eq!((begun.len(), begun[0].job, begun[0].state), (1, job.number(), JobState::Running));
        assert_eq!((begun[0].kind.as_str(), begun[0].progress), ("record.start", None));
        job.progress(Some(0.25), Some("a quarter".into()));
        assert_eq!(newest(&hub)[0].message.as_deref(), Some("a quarter"));
        job.end(Ok::<_, Failure>("all of it".into()));
        let ended = newest(&hub);
        assert_eq!((ended[0].state, ended[0].progress), (JobState::Done, Some(1.0)));
        assert_eq!(ended[0].message.as_deref(), Some("all of it"));
    }

    #[test]
    fn more_jobs_than_may_run_are_refused_and_those_that_run_go_on() {
        let (jobs, hub) = jobs();
        let (flooding, other) = (Asking::new(), Asking::new());
        let (release, held) = crossbeam_channel::bounded::<()>(0);
        let train = |reply| {
            let held = held.clone();
            jobs.run("faults.train", reply, move |_| {
                let _ = held.recv();
                Ok("trained".to_owned())
            });
        };
        (0..RUNNING + 3).for_each(|id| train(flooding.reply(id)));
        let answers = flooding.answers();
        let is_busy = |answer: &&serde_json::Value| answer["code"] == "busy";
        assert_eq!(ids(&answers), (0..RUNNING + 3).collect::<Vec<_>>());
        assert!(answers[..RUNNING].iter().all(|answer| answer["type"] == "ok"), "{answers:?}");
        assert_eq!(answers.iter().filter(is_busy).count(), 3);
        // A recording is none of them, and is not refused.
        let recording = jobs.begin("record.start");
        let mut listed = newest(&hub);
        assert_eq!((listed.len(), listed[RUNNING].job), (RUNNING + 1, recording.number()));
        drop((recording, release));
        while listed.iter().filter(|job| job.state == JobState::Done).count() < RUNNING {
            listed = std::iter::repeat_with(|| newest(&hub)).find(|listed| !listed.is_empty()).unwrap();
        }
        train(other.reply(7));
        assert_eq!(other.answers()[0]["type"], "ok");
    }

    #[test]
    fn a_cancelled_job_ends_by_itself_and_only_once() {
        let (jobs, hub) = jobs();
        let job = jobs.begin("replay.seek");
        assert!(!job.is_cancelled());
        jobs.cancel(job.number()).unwrap();
        assert!(job.is_cancelled());
        let number = job.number();
        job.end(Ok::<_, Failure>("stays where it is".into()));
        assert_eq!(newest(&hub)[0].state, JobState::Cancelled);
        assert_eq!(jobs.cancel(number), Err(CancelError::Ended(number)));
        assert_eq!(jobs.cancel(77), Err(CancelError::Unknown(77)));
    }

    #[test]
    fn a_job_that_is_dropped_has_failed_and_old_ones_are_forgotten() {
        let (jobs, hub) = jobs();
        let running = jobs.begin("record.start");
        for _ in 0..ENDED + 3 {
            drop(jobs.begin("replay.seek"));
        }
        let listed = newest(&hub);
        assert_eq!((listed.len(), listed[0].job), (ENDED + 1, running.number()));
        assert!(listed[1..].iter().all(|job| job.state == JobState::Failed && job.message.is_some()));
    }
}
