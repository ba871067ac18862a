//! Time code beside the frames.
//!
//! What comes in: frames of time code with the host times of their reads. What goes out: where the code lies, with each of them, and
//! once a second while none comes but the code is carried on. What it never does: change a pose.

use posed_drivers::Timestamp;
use posed_stage::output::{self, Output};
use posed_state::Plain;
use posed_timecode::{Follower, Reading, State};

/// How often a code that is carried on is reported, ns: as often as a status.
const REPORTED_NS: i64 = 1_000_000_000;

/// The time code of a stage.
#[derive(Clone, Debug, Plain)]
pub(super) struct Timecode {
    follower: Follower,
    /// There is something new to report.
    changed: bool,
    /// When it is reported again; `None` while there is no code.
    next: Option<Timestamp>,
}

impl Timecode {
    pub(super) fn new(settings: &posed_stage::Timecode) -> Self {
        Self { follower: settings.follower(), changed: false, next: None }
    }

    /// Takes a frame that a read at `t` has brought.
    pub(super) fn read(&mut self, t: Timestamp, reading: &Reading) {
        self.changed |= self.follower.push(t, reading);
    }

    /// Reports where the code lies, if it is time.
    pub(super) fn report(&mut self, now: Timestamp, emit: &mut dyn FnMut(Output<'_>)) {
        let is_due = self.changed || self.next.is_some_and(|next| next <= now);
        let Some(relation) = self.follower.relation().filter(|_| is_due) else { return };
        self.changed = false;
        // Once more when it is lost, then no more.
        let is_known = relation.state(now) != State::None;
        self.next = is_known.then(|| Timestamp::from_nanos(now.as_nanos().saturating_add(REPORTED_NS)));
        let jumps = self.follower.jumps();
        emit(Output::Timecode(&output::Timecode { t: now, relation: *relation, jumps }));
    }

    pub(super) fn poll_timeout(&self) -> Option<Timestamp> {
        self.next
    }
}
