//! The run of a guided calibration, whatever it calibrates.
//!
//! In: samples from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's message, until
//! everything was done, or why it was not. Never: a wait without an end.

use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use super::super::fusion::FusionInbox;
use super::super::jobs::Job;
use super::super::observers::Source;

/// Distance of two looks at whether the job was cancelled.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);
/// Without a sample for so many looks the devices are silent.
const SILENT_LOOKS: u32 = 10;

/// What guides somebody through a calibration.
pub(super) trait Guided {
    type Source: Source;
    /// What another one of its kind would be.
    const NAME: &'static str;
    /// What holds after it was cancelled.
    const UNCHANGED: &'static str;
    /// Longer than this nobody takes, s of stage time.
    const LONGEST_S: f64;

    /// What to do next; `None` when everything was done.
    fn prompt(&self) -> Option<String>;

    /// Tells how far it is.
    fn report(&mut self, job: &Job, prompt: &str);

    /// Capture time of a sample, s.
    fn time_s(sample: &<Self::Source as Source>::Sample) -> f64;

    fn push(&mut self, sample: <Self::Source as Source>::Sample);

    /// Who is silent, and what to do about it.
    fn silence(&self) -> String;

    /// The step under way, for a sentence.
    fn step(&self, prompt: &str) -> String {
        format!("the step \"{prompt}\"")
    }

    /// Whether somebody has stopped before everything was done: then it goes by what there is.
    fn is_left(&self) -> bool {
        false
    }
}

/// Why a guided calibration was not finished.
#[derive(Debug, thiserror::Error)]
pub(super) enum GuidedError {
    /// With what holds now.
    #[error("cancelled; {0}")]
    Cancelled(&'static str),
    /// With its name.
    #[error("another {0} was begun")]
    Replaced(&'static str),
    #[error("{0} and begin again")]
    Silent(String),
    /// With the step.
    #[error("{0} was not seen; begin again")]
    NotSeen(String),
}

/// Guides until everything was done.
pub(super) fn run<G: Guided>(
    guided: &mut G,
    job: &Job,
    inbox: &FusionInbox,
    source: G::Source,
) -> Result<(), GuidedError> {
    let samples = inbox.watch(source);
    let (mut silent_looks, mut first_s) = (0, None);
    while let Some(prompt) = guided.prompt() {
        guided.report(job, &prompt);
        if job.is_cancelled() {
            return Err(GuidedError::Cancelled(G::UNCHANGED));
        }
        match samples.recv_timeout(LOOK_INTERVAL) {
            Ok(sample) => {
                silent_looks = 0;
                let t_s = G::time_s(&sample);
                if t_s - *first_s.get_or_insert(t_s) > G::LONGEST_S {
                    return Err(GuidedError::NotSeen(guided.step(&prompt)));
                }
                guided.push(sample);
            }
            Err(RecvTimeoutError::Timeout) => {
                silent_looks += 1;
                if silent_looks > SILENT_LOOKS {
                    return Err(GuidedError::Silent(guided.silence()));
                }
            }
            Err(RecvTimeoutError::Disconnected) => return Err(GuidedError::Replaced(G::NAME)),
        }
        if guided.is_left() {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::super::clock::StageClock;
    use super::super::super::inbox::Inbox;
    use super::super::super::jobs::Jobs;
    use super::super::super::observers::ImuSource;
    use super::super::super::server::Hub;
    use super::*;
    use posed_fusion::ahrs::ImuSample;

    struct Still;

    impl Guided for Still {
        type Source = ImuSource;
        const NAME: &'static str = "calibration";
        const UNCHANGED: &'static str = "all is as it was";
        const LONGEST_S: f64 = 1.0;

        fn prompt(&self) -> Option<String> {
            Some("lay it down".to_owned())
        }

        fn report(&mut self, _: &Job, _: &str) {}

        fn time_s((t_s, _): &(f64, ImuSample)) -> f64 {
            *t_s
        }

        fn push(&mut self, _: (f64, ImuSample)) {}

        fn silence(&self) -> String {
            "it is silent; see to it".to_owned()
        }
    }

    #[test]
    fn who_is_cancelled_or_replaced_is_informed() {
        let (inbox, jobs): (FusionInbox, _) = (Inbox::new(4), Jobs::new(StageClock::start(), Hub::default()));
        let job = jobs.begin("imu.calibrate");
        let guided = || run(&mut Still, &job, &inbox, ImuSource { sensor: 0 });
        let error = std::thread::scope(|scope| {
            let running = scope.spawn(guided);
            // Its observer goes, as in the place of another one.
            drop(inbox.pop_until(None));
            running.join().unwrap().unwrap_err()
        });
        assert_eq!(error.to_string(), "another calibration was begun");
        jobs.cancel(job.number()).unwrap();
        assert_eq!(guided().unwrap_err().to_string(), "cancelled; all is as it was");
    }
}
