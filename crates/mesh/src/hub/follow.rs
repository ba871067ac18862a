//! One stage, followed: from the first sign of its life on, through cuts and restarts.
//!
//! In: its feed, what it answers, whether zenoh sees its token. Out: the same items, in the hub server, events complete and in their
//! order; what is said of it on the board. Never: a wait for an answer while frames come.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};
use zenoh::Session;

use super::asking::{Asking, subscribe};
use super::board::Board;
use super::fuse::{Fuser, Taken};
use super::questions::{Answer, Questions};
use super::relation::Relation;
use crate::wire::{self, Begin, Bytes, Joined, Keys, LogChunk, VERSION};
use posed_daemon::StageClock;
use posed_daemon::ended;
use posed_daemon::server::Item;
use posed_daemon::server::rfc3339;
use posed_daemon::server::{Incoming, StageEndpoint, StageRegistry};
use posed_protocol::{LinkState, Problem, RelatedClock, StagePresence, Stamp, Status, Topic, Wish, unpack};
use posed_stage::Stage;

/// Messages of zenoh that wait for this task; more are lost, and events among them asked for.
const WAITING: usize = 1024;
/// Answers that wait; those who bring more wait, too.
const ANSWERS: usize = 16;
/// Distance of two looks at what is missing.
const LOOK: Duration = Duration::from_millis(100);
/// Looks between two questions to a stage that has not answered yet: who is declared may be none.
const JOIN_EVERY: u32 = 5;
/// Looks between two readings of the stage's clock.
const CLOCK_EVERY: u32 = 10;
/// Looks after which a stage that says nothing is asked for its clock, though that is well known and nobody here looks at its poses.
const QUIET: u32 = 30;
/// Looks after which one that does not answer either is gone, whatever zenoh sees: a router in between may keep its token alive.
const SILENT: u32 = 60;

/// What a follower is made from.
pub(super) struct Follower {
    pub(super) id: String,
    pub(super) keys: Keys,
    pub(super) session: Session,
    pub(super) registry: StageRegistry,
    pub(super) board: Board,
    pub(super) clock: StageClock,
    /// Whether zenoh sees its token.
    pub(super) alive: watch::Receiver<bool>,
    /// Whether it is to be fused here.
    pub(super) fuse: bool,
}

/// The stage as it is known now.
struct Following {
    run: i64,
    end: StageEndpoint,
    fuser: Option<Fuser>,
    /// Newest event that was passed on.
    last_event_id: u64,
    /// Newest event that the stage has spoken of.
    newest_event_id: u64,
    relation: Relation,
    /// Its latest status; an empty one before the first.
    status: (Status, Stamp),
    /// What clients here want.
    wish: watch::Receiver<Wish>,
    /// When the stage last said how many frames it had, and how many, ns of its time.
    counted: Option<(i64, u64)>,
}

/// A follower at work.
struct Work {
    follower: Follower,
    questions: Questions,
    following: Option<Following>,
    asking_for: Asking,
    /// A question about events, or about the log, is on its way.
    asking: bool,
    asking_log: bool,
    /// Something came that cannot be read.
    unreadable: bool,
    /// Looks since it was last heard, once it has joined.
    quiet: u32,
}

impl Follower {
    /// Until `down`.
    pub(super) async fn run(self, mut down: watch::Receiver<bool>) {
        let (fed_in, mut fed) = mpsc::channel::<Vec<u8>>(WAITING);
        let (log_in, mut log) = mpsc::channel::<Vec<u8>>(WAITING);
        let mut always = vec![(self.keys.states(), fed_in.clone()), (self.keys.events(), fed_in.clone())];
        always.extend(self.fuse.then(|| (self.keys.log(), log_in)));
        let mut subscribers = Vec::new();
        for (key, to) in always {
            match subscribe(&self.session, key, to).await {
                Ok(subscriber) => subscribers.push(subscriber),
                Err(error) => return tracing::error!("{}: {error}", self.id),
            }
        }
        let asking_for = Asking::new(self.session.clone(), self.keys.clone(), fed_in);
        let (answers_in, mut answers) = mpsc::channel(ANSWERS);
        let questions = Questions {
            session: self.session.clone(),
            keys: self.keys.clone(),
            clock: self.clock,
            answers: answers_in,
        };
        let mut alive = self.alive.clone();
        let mut work = Work {
            follower: self,
            questions,
            following: None,
            asking_for,
            asking: false,
            asking_log: false,
            unreadable: false,
            quiet: 0,
        };
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut look = 0;
        let there = *alive.borrow_and_update();
        work.presence(there).await;
        loop {
            tokio::select! {
                () = ended(&mut down) => return,
                changed = alive.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    let there = *alive.borrow_and_update();
                    work.token(there).await;
                }
                wish = wished(&mut work.following) => work.ask_for(wish).await,
                Some(payload) = fed.recv() => work.fed(&payload).await,
                Some(payload) = log.recv() => work.log(&payload),
                Some(answer) = answers.recv() => work.answer(answer).await,
                _ = looks.tick() => {
                    look += 1;
                    work.listen().await;
                    work.look(look);
                }
            }
        }
    }
}

/// What clients want of the stage, when that has changed.
async fn wished(following: &mut Option<Following>) -> Wish {
    if let Some(Following { wish, .. }) = following
        && wish.changed().await.is_ok()
    {
        return wish.borrow_and_update().clone();
    }
    std::future::pending().await
}

impl Work {
    /// Clients here want something else than before.
    async fn ask_for(&mut self, mut wish: Wish) {
        // What is fused here comes from here.
        if self.following.as_ref().is_some_and(|following| following.fuser.is_some()) {
            wish = wish.of_topic(Topic::Status);
        }
        if let Err(error) = self.asking_for.ask(&wish).await {
            tracing::warn!("stage {}: {error}", self.follower.id);
        }
    }

    fn is_there(&self) -> bool {
        *self.follower.alive.borrow() && !self.is_silent()
    }

    /// Whether it is taken as gone because it says nothing.
    fn is_silent(&self) -> bool {
        self.quiet > SILENT
    }

    /// Its token has come or gone.
    async fn token(&mut self, there: bool) {
        // Gone is gone.
        let is_news = there || !self.is_silent();
        self.quiet = 0;
        if is_news {
            self.presence(there).await;
        }
    }

    /// Something came from it.
    async fn hear(&mut self) {
        let returns = self.is_silent();
        self.quiet = 0;
        if returns && self.is_there() {
            self.presence(true).await;
        }
    }

    /// Whether it still says something.
    async fn listen(&mut self) {
        let was_there = self.is_there();
        // One that has not joined is asked until it answers.
        self.quiet = if self.following.is_some() { self.quiet.saturating_add(1) } else { 0 };
        if was_there && self.is_silent() {
            self.presence(false).await;
        }
    }

    /// The stage has come, vanished or returned.
    async fn presence(&mut self, there: bool) {
        let Follower { id, board, .. } = &self.follower;
        match (there, &mut self.following) {
            (true, None) => _ = board.presence(id, StagePresence::Joining),
            (true, Some(following)) => {
                let gone_s = board.presence(id, StagePresence::Present);
                tracing::info!("stage {id} has returned after {gone_s:.1} s");
                // What happened meanwhile is asked for at the next look.
                following.newest_event_id = u64::MAX;
            }
            (false, following) => {
                board.presence(id, StagePresence::Gone);
                tracing::warn!("stage {id} has vanished: it has ended, or the network to it is cut");
                if let Some(following) = following {
                    let (status, stamp) = &mut following.status;
                    // Times rise, and the stage's own next status is later than that.
                    stamp.t_us += 1;
                    following.end.publish(Item::Status(Box::new(vanished(status))), *stamp).await;
                }
            }
        }
        if there {
            self.look(0);
        }
    }

    /// Asks for what is missing, and for the time.
    fn look(&mut self, look: u32) {
        let is_due = look.is_multiple_of(CLOCK_EVERY);
        if !self.is_there() {
            // One that only fell silent may answer again.
            if self.is_silent() && is_due {
                self.questions.clock();
            }
            return;
        }
        let Follower { fuse, .. } = &self.follower;
        let Some(following) = &mut self.following else {
            if !self.asking && look.is_multiple_of(JOIN_EVERY) {
                self.asking = true;
                self.questions.join(0, *fuse);
            }
            return;
        };
        if following.fuser.is_none() && following.last_event_id < following.newest_event_id && !self.asking {
            self.asking = true;
            self.questions.join(following.last_event_id, false);
        }
        if let Some(fuser) = &following.fuser
            && following.newest_event_id == u64::MAX
            && !self.asking_log
        {
            self.asking_log = true;
            self.questions.log(fuser.next());
        }
        let idles = following.relation.is_settled() && following.wish.borrow().is_empty();
        if is_due && (!idles || self.quiet >= QUIET) {
            self.questions.clock();
        }
    }

    /// Something of the feed.
    async fn fed(&mut self, payload: &[u8]) {
        self.hear().await;
        let (head, item, held) = match wire::read_fed(payload) {
            Ok(read) => read,
            Err(error) => {
                // Once: who sends such things sends many.
                if !std::mem::replace(&mut self.unreadable, true) {
                    tracing::warn!("stage {}: {error}: is it of another version?", self.follower.id);
                }
                return;
            }
        };
        let Some(following) = &mut self.following else { return };
        if head.run != following.run {
            tracing::info!("stage {} was started anew", self.follower.id);
            self.following = None;
            self.follower.board.presence(&self.follower.id, StagePresence::Joining);
            return self.look(0);
        }
        following.hear_of(head.last_event_id);
        match (item, head.stamp.event_id) {
            (Item::Status(status), _) => following.status(&self.follower, *status, head.stamp).await,
            (item @ Item::Jobs(_), _) => following.end.publish(item, head.stamp).await,
            (_, _) if following.fuser.is_some() => {
                self.follower
                    .board
                    .write(&self.follower.id, |entry| entry.last_event_id = head.last_event_id);
            }
            (item, None) => following.end.pass(Incoming { item, stamp: head.stamp, held }).await,
            (item, Some(event_id)) => {
                if event_id == following.last_event_id + 1 {
                    following.event(&self.follower, item, head.stamp).await;
                } else if event_id > following.last_event_id {
                    // One before it is missing: all that follow come with the answer, in their order.
                    self.look(1);
                }
            }
        }
    }

    /// Entries of the input log.
    fn log(&mut self, payload: &[u8]) {
        match unpack::<LogChunk>(payload) {
            Ok(chunk) => _ = self.entries(chunk),
            Err(error) => tracing::warn!("stage {}: {error}: is it of another version?", self.follower.id),
        }
    }

    /// Whether there was something new in it.
    fn entries(&mut self, chunk: LogChunk) -> bool {
        let Some(Following { run, fuser: Some(fuser), .. }) = &mut self.following else { return false };
        if chunk.run != *run {
            return false;
        }
        let before = fuser.next();
        if let Taken::Missing(from) = fuser.take(chunk)
            && !self.asking_log
        {
            self.asking_log = true;
            self.questions.log(from);
        }
        fuser.next() > before
    }

    async fn answer(&mut self, answer: Answer) {
        match answer {
            Answer::Clock { left, reading, came } => {
                self.hear().await;
                let Some(following) = &mut self.following else { return };
                if reading.run == following.run {
                    let (left, came) = (left.as_nanos(), came.as_nanos());
                    following.hear_of(reading.last_event_id);
                    let count = (reading.t_ns, reading.frames);
                    if let Some((t_ns, frames)) = following.counted.replace(count) {
                        let frames = reading.frames.saturating_sub(frames);
                        let frames_hz = frames as f64 * 1e9 / reading.t_ns.saturating_sub(t_ns).max(1) as f64;
                        self.follower.board.write(&self.follower.id, |entry| entry.frames_hz = frames_hz);
                    }
                    following.relation.push(left, reading.t_ns, came);
                    if let Some(related) = following.relation.at(came) {
                        let seconds = |ns: i64| (ns / 1000) as f64 * 1e-6;
                        let clock = RelatedClock {
                            offset_s: seconds(related.offset),
                            uncertainty_s: seconds(related.uncertainty + 999),
                            round_trip_s: seconds(related.round_trip),
                        };
                        self.follower.board.write(&self.follower.id, |entry| entry.clock = Some(clock));
                    }
                }
            }
            Answer::Log(answer) => {
                self.asking_log = false;
                let Some(following) = &mut self.following else { return };
                let Some(fuser) = &following.fuser else { return };
                match answer {
                    Ok(chunk) if chunk.run == following.run && chunk.first > fuser.next() => {
                        let missing = chunk.first - fuser.next();
                        tracing::warn!(
                            "stage {}: {missing} entries are lost; its fusion begins anew",
                            self.follower.id
                        );
                        self.following = None;
                    }
                    Ok(chunk) => {
                        following.newest_event_id = following.newest_event_id.min(u64::MAX - 1);
                        if self.entries(chunk)
                            && let Some(Following { fuser: Some(fuser), .. }) = &self.following
                        {
                            // Until nothing new comes: the next live entries then fit.
                            self.asking_log = true;
                            self.questions.log(fuser.next());
                        }
                    }
                    Err(error) => tracing::debug!("stage {}: {error}", self.follower.id),
                }
            }
            Answer::Joined { after, answer } => {
                self.asking = false;
                match answer {
                    Ok(answer) => self.joined(after, *answer).await,
                    Err(error) => tracing::debug!("stage {}: {error}", self.follower.id),
                }
            }
        }
    }

    async fn joined(&mut self, after: u64, (joined, begin): (Joined, Option<Begin>)) {
        if joined.wire != VERSION {
            let message = format!(
                "it runs posed {}, which speaks another version of the hub's language",
                joined.version
            );
            tracing::error!("stage {}: {message}", self.follower.id);
            let problem = Problem::new("version", message).with("version", &joined.version);
            return self.follower.board.write(&self.follower.id, |entry| entry.problems = vec![problem]);
        }
        let mut until = u64::MAX;
        if after == 0 && self.following.is_none() {
            match self.begin(&joined, begin).await {
                Ok((following, fused_from)) => {
                    until = fused_from;
                    self.following = Some(following);
                }
                Err(sentence) => {
                    tracing::error!("stage {}: {sentence}", self.follower.id);
                    let problem = Problem::new("join", sentence);
                    return self
                        .follower
                        .board
                        .write(&self.follower.id, |entry| entry.problems = vec![problem]);
                }
            }
        }
        let Work { follower, following: Some(following), .. } = self else { return };
        if joined.run != following.run {
            self.following = None;
            return;
        }
        if following.newest_event_id == u64::MAX || after == 0 {
            following.newest_event_id = joined.last_event_id;
        }
        let fed = |Bytes(bytes): &Bytes| wire::read_fed(bytes).ok().map(|(head, item, _)| (head, item));
        for (head, item) in joined.events.iter().filter_map(fed) {
            let event_id = head.stamp.event_id.unwrap_or(0);
            if event_id > following.last_event_id && event_id <= until {
                if after > 0 && event_id > following.last_event_id + 1 {
                    let lost = event_id - following.last_event_id - 1;
                    tracing::warn!(
                        "stage {}: {lost} events are lost: it does not keep them any longer",
                        follower.id
                    );
                    follower.board.write(&follower.id, |entry| entry.events_lost += lost);
                }
                following.event(follower, item, head.stamp).await;
            }
        }
        // Nothing that could still be asked for is missing.
        following.last_event_id = following.last_event_id.max(joined.last_event_id);
        if after == 0 {
            for (head, item) in joined.states.iter().filter_map(fed) {
                match item {
                    Item::Status(status) => following.status(follower, *status, head.stamp).await,
                    item => following.end.publish(item, head.stamp).await,
                }
            }
        }
    }

    /// The stage is known: its endpoint, and the newest event that is not fused here.
    async fn begin(&self, joined: &Joined, begin: Option<Begin>) -> Result<(Following, u64), String> {
        let Follower { id, registry, board, .. } = &self.follower;
        let stage = Stage::parse(&joined.stage_toml).map_err(|problems| {
            format!("the stage file of its posed {} does not fit this version: {problems}", joined.version)
        })?;
        let end = registry.join(
            id,
            &stage,
            joined.run,
            &joined.topics,
            joined.last_event_id,
            Arc::new(self.questions.recordings()),
        );
        let end = end.await;
        let (fuser, until) = match begin {
            None => (None, u64::MAX),
            Some(begin) => {
                let (fuser, until) = Fuser::start(&begin, end.items())?;
                (Some(fuser), until)
            }
        };
        let fused = fuser.is_some();
        let mut wish = end.wish();
        // Clients of all stages may have asked already, and those of an earlier run are gone.
        wish.mark_changed();
        board.write(id, |entry| {
            entry.name.clone_from(&stage.name);
            entry.epoch_utc = Some(rfc3339(joined.run));
            entry.fused = fused;
            entry.clock = None;
            entry.problems = Vec::new();
        });
        board.presence(id, StagePresence::Present);
        tracing::info!("stage {id} ({:?}) has joined", stage.name);
        let following = Following {
            run: joined.run,
            end,
            fuser,
            last_event_id: 0,
            newest_event_id: joined.last_event_id,
            relation: Relation::default(),
            wish,
            counted: None,
            status: (
                Status::default(),
                Stamp { topic: Topic::Status, body: 0, t_us: 0, event_id: None, timecode: None },
            ),
        };
        Ok((following, until))
    }
}

impl Following {
    /// The stage speaks of an event: where it has not come, it is asked for.
    fn hear_of(&mut self, event_id: u64) {
        if self.newest_event_id != u64::MAX {
            self.newest_event_id = self.newest_event_id.max(event_id);
        }
    }

    async fn event(&mut self, follower: &Follower, item: Item, stamp: Stamp) {
        self.last_event_id = stamp.event_id.unwrap_or(self.last_event_id);
        let last_event_id = self.last_event_id;
        follower.board.write(&follower.id, |entry| entry.last_event_id = last_event_id);
        self.end.publish(item, stamp).await;
    }

    async fn status(&mut self, follower: &Follower, status: Status, stamp: Stamp) {
        follower.board.write(&follower.id, |entry| {
            entry.devices = status.devices.len() as u32;
            let streaming = status.devices.iter().filter(|device| device.state == LinkState::Streaming);
            entry.streaming = streaming.count() as u32;
            entry.problems.clone_from(&status.problems);
        });
        self.status = (status.clone(), stamp);
        self.end.publish(Item::Status(Box::new(status)), stamp).await;
    }
}

/// What a stage's clients receive when it vanishes: the last status, and that it is the last.
fn vanished(status: &Status) -> Status {
    let mut status = status.clone();
    let message = "the hub does not see this stage any more: its daemon has ended, or the network to it is cut; what is shown is old";
    status.problems.push(Problem::new("vanished", message));
    for device in &mut status.devices {
        device.state = LinkState::Silent;
        device.reason = Some("its stage has vanished".to_owned());
    }
    status
}
