//! Time code beside the frames.
//!
//! What comes in: frames of time code with the host times of their reads. What goes out: where the code lies, with each of them, and
//! once a second while none comes but the code is carried on. What it never does: change a pose.

use posed_drivers::Timestamp;
use posed_stage::output::{self, Output};
use posed_state::Plain;
use posed_timecode::{Follower, Reading, State};

/// How often a code that is carried on is told, ns: as often as a status.
const TOLD_NS: i64 = 1_000_000_000;

/// The time code of a stage.
#[derive(Clone, Debug, Plain)]
pub(super) struct Timecode {
    follower: Follower,
    /// There is something new to tell.
    changed: bool,
    /// When it is told again; `None` while there is no code.
    next: Option<Timestamp>,
}

impl Timecode {
    pub(super) fn new(settings: &posed_stage::Timecode) -> Self {
        let follower = Follower::new(settings.delay_ms * 1e-3, settings.pictures_per_frame());
        Self { follower, changed: false, next: None }
    }

    /// Takes a frame that a read at `t` has brought.
    pub(super) fn read(&mut self, t: Timestamp, reading: &Reading) {
        self.changed |= self.follower.push(t, reading);
    }

    /// Tells where the code lies, if it is time.
    pub(super) fn tell(&mut self, now: Timestamp, emit: &mut impl FnMut(Output<'_>)) {
        let is_due = self.changed || self.next.is_some_and(|next| next <= now);
        let Some(relation) = self.follower.relation().filter(|_| is_due) else { return };
        self.changed = false;
        // Once more when it is lost, then no more.
        let is_known = relation.state(now) != State::None;
        self.next = is_known.then(|| Timestamp::from_nanos(now.as_nanos().saturating_add(TOLD_NS)));
        let told = output::Timecode { t: now, relation: *relation, jumps: self.follower.jumps() };
        emit(Output::Timecode(&told));
    }

    pub(super) fn poll_timeout(&self) -> Option<Timestamp> {
        self.next
    }
}
