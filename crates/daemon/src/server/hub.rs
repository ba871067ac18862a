//! From the fusion thread to the server: handing over costs a copy of the frame and a wake-up, whatever the clients do.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use tokio::sync::Notify;

use posed_protocol::{Jobs, Payload, Sessions, Status};
use posed_stage::input::Truth;
use posed_stage::output::{Body, Estimate, Outcome, Output, Timecode};

/// Items that wait for the server; a healthy server has none or one.
const CAPACITY: usize = 256;
/// Events that wait for the server: a server that lags by so many serves nobody any more, and the oldest give way too.
const EVENTS: usize = 1 << 14;
/// Frames whose memory is kept.
const SPARES: usize = 8;

/// Something to publish, owned.
#[derive(Debug, Serialize, Deserialize)]
pub enum Item {
    /// A frame's poses.
    Estimate(Estimate),
    /// The body of a frame.
    Body(Box<Body>),
    /// Ground truth of a simulated stage.
    Truth(Box<Truth>),
    /// An event.
    Outcome(Box<Outcome>),
    /// The daemon's health.
    Status(Box<Status>),
    /// The list of jobs.
    Jobs(Box<Jobs>),
    /// The sessions that go on.
    Sessions(Box<Sessions>),
    /// Where time code lies.
    Timecode(Timecode),
    /// Time goes back: a replay was asked to.
    Rewind,
}

impl Item {
    /// What it publishes; a rewind publishes nothing.
    pub fn payload(&self) -> Option<Payload<'_>> {
        Some(match self {
            Self::Estimate(estimate) => Payload::Estimate(estimate),
            Self::Body(body) => Payload::Body(body),
            Self::Truth(truth) => Payload::Truth(truth),
            Self::Outcome(outcome) => Payload::Outcome(outcome),
            Self::Status(status) => Payload::Status(status),
            Self::Jobs(jobs) => Payload::Jobs(jobs),
            Self::Sessions(sessions) => Payload::Sessions(sessions),
            Self::Timecode(timecode) => Payload::Timecode(timecode),
            Self::Rewind => return None,
        })
    }

    /// Whether it may be dropped when the server lags.
    fn is_state(&self) -> bool {
        !matches!(self, Self::Outcome(_) | Self::Rewind)
    }
}

/// Handle for who publishes; clones share it.
///
/// No call waits for the server or for a client. When the server lags by more than 256 items, the oldest one that is
/// not an event is dropped and counted, and beyond 16,384 events the oldest of these.
#[derive(Clone, Debug, Default)]
pub struct Hub {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Notify,
}

#[derive(Debug, Default)]
struct Queue {
    items: VecDeque<Item>,
    spares: Vec<Estimate>,
    dropped: u64,
}

impl Hub {
    /// Publishes what clients receive of an output: estimates, the body, outcomes, truth, time code; the others are nothing to them.
    pub fn publish(&self, output: &Output<'_>) {
        match Payload::of(output) {
            Some(Payload::Estimate(estimate)) => self.publish_estimate(estimate),
            Some(Payload::Body(body)) => self.push(Item::Body(Box::new(body.clone()))),
            Some(Payload::Truth(truth)) => self.push(Item::Truth(Box::new(truth.clone()))),
            Some(Payload::Outcome(outcome)) => self.push(Item::Outcome(Box::new(outcome.clone()))),
            Some(Payload::Timecode(timecode)) => self.push(Item::Timecode(*timecode)),
            Some(Payload::Status(_) | Payload::Jobs(_) | Payload::Sessions(_)) | None => {}
        }
    }

    /// Publishes a frame's poses; copies them into memory that earlier frames have left.
    pub fn publish_estimate(&self, estimate: &Estimate) {
        let mut memory = self.lock().spares.pop().map(|spare| spare.sensors).unwrap_or_default();
        let Estimate { frame, t_valid, t_closed, sigma_t_s, fault, ref sensors } = *estimate;
        memory.clone_from(sensors);
        let copy = Estimate { frame, t_valid, t_closed, sigma_t_s, fault, sensors: memory };
        self.push(Item::Estimate(copy));
    }

    /// Publishes the daemon's health; its `t_s` is now.
    pub fn publish_status(&self, status: Status) {
        self.push(Item::Status(Box::new(status)));
    }

    /// Publishes the list of jobs; its `t_s` is now.
    pub fn publish_jobs(&self, jobs: Jobs) {
        self.push(Item::Jobs(Box::new(jobs)));
    }

    /// Publishes the sessions that go on; its `t_s` is now.
    pub fn publish_sessions(&self, sessions: Sessions) {
        self.push(Item::Sessions(Box::new(sessions)));
    }

    /// Lets time go back: what follows was captured before what came before. Only for a replay.
    pub fn rewind(&self) {
        self.push(Item::Rewind);
    }

    /// Items that were dropped so far because the server itself was too slow.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// The next list of jobs that nobody has taken.
    #[cfg(test)]
    pub(crate) fn take_jobs(&self) -> Option<Jobs> {
        std::iter::from_fn(|| self.take()).find_map(|item| match item {
            Item::Jobs(jobs) => Some(*jobs),
            _ => None,
        })
    }

    /// The next list of sessions that nobody has taken.
    #[cfg(test)]
    pub(crate) fn take_sessions(&self) -> Option<Sessions> {
        std::iter::from_fn(|| self.take()).find_map(|item| match item {
            Item::Sessions(sessions) => Some(*sessions),
            _ => None,
        })
    }

    fn push(&self, item: Item) {
        let mut queue = self.lock();
        let oldest = queue.items.iter().position(Item::is_state);
        if queue.items.len() >= CAPACITY
            && let Some(oldest) = oldest.or((queue.items.len() >= EVENTS).then_some(0))
            && let Some(item) = queue.items.remove(oldest)
        {
            queue.dropped += 1;
            queue.recycle(item);
        }
        queue.items.push_back(item);
        drop(queue);
        self.shared.filled.notify_one();
    }

    pub(super) fn take(&self) -> Option<Item> {
        self.lock().items.pop_front()
    }

    pub(super) fn recycle(&self, item: Item) {
        self.lock().recycle(item);
    }

    pub(super) async fn filled(&self) {
        self.shared.filled.notified().await;
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // Every change is complete before anything in it could panic.
        self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Queue {
    fn recycle(&mut self, item: Item) {
        if let Item::Estimate(estimate) = item
            && self.spares.len() < SPARES
        {
            self.spares.push(estimate);
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::*;
    use posed_fusion::faults::Cause;
    use posed_stage::output::OutcomeKind;

    #[test]
    fn a_server_that_has_stopped_fills_no_memory() {
        let hub = Hub::default();
        let surplus = 100;
        for n in 0..(EVENTS + surplus) as i64 {
            let what = OutcomeKind::Fault { sensor: 0, cause: Cause::Gate, active: true };
            let outcome = Outcome { t_valid: Timestamp::from_nanos(n), t_decided: Timestamp::ZERO, what };
            hub.publish(&Output::Outcome(&outcome));
        }
        assert_eq!(hub.lock().items.len(), EVENTS);
        assert_eq!(hub.dropped(), surplus as u64);
        // The newest are there, in their order, for a server that goes on.
        for n in surplus..EVENTS + surplus {
            let Some(Item::Outcome(outcome)) = hub.take() else { panic!("{n} is not there") };
            assert_eq!(outcome.t_valid, Timestamp::from_nanos(n as i64));
        }
        hub.publish_estimate(&Estimate::default());
        assert!(matches!(hub.take(), Some(Item::Estimate(_))));
    }

    #[test]
    fn a_lagging_server_loses_the_oldest_frames_and_no_event() {
        let hub = Hub::default();
        let what = OutcomeKind::Fault { sensor: 0, cause: Cause::Gate, active: true };
        let outcome = Outcome { t_valid: Timestamp::ZERO, t_decided: Timestamp::ZERO, what };
        hub.publish(&Output::Outcome(&outcome));
        for frame in 0..CAPACITY as u64 + 9 {
            hub.publish_estimate(&Estimate { frame, ..Estimate::default() });
        }
        assert_eq!(hub.dropped(), 10);
        assert!(matches!(hub.take(), Some(Item::Outcome(_))));
        for newest in 10..CAPACITY as u64 + 9 {
            assert!(matches!(hub.take(), Some(Item::Estimate(estimate)) if estimate.frame == newest));
        }
    }
}
