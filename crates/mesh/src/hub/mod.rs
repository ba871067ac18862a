//! `posed hub`: many stages on one page.
//!
//! ```text
//! zenoh ── tokens ──> followers ─> a follower per stage ──> server ──> pages and websockets
//!                                   feed, answers             an endpoint per stage, one for all
//! ```
//! In: stages that zenoh shows. Out: the same messages as at the stages, and a board of what is there. Never: a change at a
//! stage.

mod asking;
mod board;
mod follow;
mod fuse;
mod questions;
mod relation;
mod runs;
mod tokens;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::interval;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::sample::SampleKind;

use self::board::Board;
use self::follow::Follower;
use self::runs::{RUNS, Runs};
use self::tokens::Tokens;
use super::links::Links;
use super::session::{self, LinkError};
use super::wire::{Keys, RUN, TOKEN};
use posed_daemon::server::{BindError, HubServer, StageRegistry};
use posed_daemon::{PartEnded, StageClock, Vital, ended};
use posed_protocol::Stages;
use posed_stage::Stage;

/// Distance of two words about all stages when nothing changes.
const TELL: Duration = Duration::from_secs(1);
/// Stages that are followed at a time.
const STAGES: usize = 256;
/// Time that everything has to end.
const SHUTDOWN: Duration = Duration::from_secs(4);

/// What a hub is started with.
#[derive(Clone, Debug)]
pub struct HubOptions {
    /// Name, access, TLS and zenoh's addresses, as in the file of a stage without devices.
    pub stage: Stage,
    /// Folder that relative paths of that file start from.
    pub folder: PathBuf,
    /// `HOST:PORT` of the page, instead of the file's; `None`: the file's, or the default.
    pub http: Option<String>,
    /// Stages to fuse on this machine from their input logs, by their names at this hub
    /// ([`StageEntry::id`](posed_protocol::StageEntry)). A name that no stage has is passed over.
    pub fuse: Vec<String>,
}

/// Why a hub cannot start.
#[derive(Debug, thiserror::Error)]
pub enum HubError {
    /// The page's address does not serve, or its TLS does not.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// zenoh cannot be opened.
    #[error(transparent)]
    Zenoh(#[from] LinkError),
}

/// A running hub; ends with [`Hub::shutdown`].
pub struct Hub {
    address: SocketAddr,
    url: String,
    shutdown: watch::Sender<bool>,
    stages: watch::Receiver<Stages>,
    vital: Vital,
    tasks: JoinSet<()>,
    session: Session,
    /// Ends the thread that looks at the links when it is dropped.
    _links: crossbeam_channel::Sender<()>,
}

impl Hub {
    /// Binds the page, opens zenoh, follows every stage that it shows. Needs a tokio runtime of several threads; blocks while
    /// zenoh opens.
    ///
    /// # Errors
    /// An address does not serve, for the page or for zenoh, or zenoh's settings do not.
    ///
    /// # Panics
    /// Outside of a tokio runtime.
    pub fn start(options: HubOptions) -> Result<Self, HubError> {
        let HubOptions { stage, folder, http, fuse } = options;
        let clock = StageClock::start();
        let (server, registry) =
            HubServer::bind(&stage.name, clock.epoch_utc_ns(), &stage.server, http, &folder)?;
        let settings = stage.zenoh.unwrap_or_default();
        #[expect(clippy::disallowed_methods, reason = "zenoh is opened where it may block")]
        let opened = std::thread::spawn({
            let settings = settings.clone();
            move || session::open(&settings, session::End::Hub)
        })
        .join();
        let session = opened.map_err(|_| LinkError::Crashed)??;
        let (links_end, links_down) = crossbeam_channel::bounded(0);
        Links::default().watch(session.clone(), settings, links_down)?;
        let (shutdown, down) = watch::channel(false);
        let (reported, stages) = watch::channel(Stages::default());
        let (address, url) = (server.address(), server.url());
        let mut tasks = JoinSet::new();
        let mut server_down = down.clone();
        let vital = Vital::new(down.clone());
        tasks.spawn(vital.task("the server", server.run(async move { ended(&mut server_down).await })));
        let board = Board::new(clock);
        let report = report(board.clone(), registry.clone(), reported, down.clone());
        tasks.spawn(vital.task("what reports the stages", report));
        let followers = Followers {
            session: session.clone(),
            registry,
            board,
            clock,
            fuse,
            followed: BTreeMap::new(),
            runs: Runs::default(),
            reported: BTreeMap::new(),
        };
        tasks.spawn(vital.task("what follows the stages", followers.run(down)));
        Ok(Self { address, url, shutdown, stages, vital, tasks, session, _links: links_end })
    }

    /// The address that the page listens on; its port is the one given by the system where 0 was asked for.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to open in a browser.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// What is reported of all stages: a new value once a second and when a stage comes or goes; empty before the first.
    pub fn stages(&self) -> watch::Receiver<Stages> {
        self.stages.clone()
    }

    /// The first part of the hub that ended before [`Self::shutdown`], once there is one; `None` until then.
    pub fn part_ended(&self) -> watch::Receiver<Option<PartEnded>> {
        self.vital.ended()
    }

    /// Ends everything; clients are notified of the end. What has not ended after 4 s is cut off, with an error in the log.
    pub async fn shutdown(mut self) {
        self.shutdown.send_replace(true);
        let all = async {
            while self.tasks.join_next().await.is_some() {}
            let _ = self.session.close().await;
        };
        if tokio::time::timeout(SHUTDOWN, all).await.is_err() {
            tracing::error!("not everything has ended in time");
        }
    }
}

/// Reports what is there, once a second and when something changes.
async fn report(
    board: Board,
    registry: StageRegistry,
    reported: watch::Sender<Stages>,
    mut down: watch::Receiver<bool>,
) {
    let mut seconds = interval(TELL);
    loop {
        tokio::select! {
            () = ended(&mut down) => return,
            () = board.changed() => {}
            _ = seconds.tick() => {}
        }
        let stages = board.stages();
        reported.send_replace(stages.clone());
        registry.report(stages).await;
    }
}

/// Which stages there are.
struct Followers {
    session: Session,
    registry: StageRegistry,
    board: Board,
    clock: StageClock,
    fuse: Vec<String>,
    followed: BTreeMap<String, watch::Sender<bool>>,
    runs: Runs,
    /// What the daemons of a key with several are identified by.
    reported: BTreeMap<String, LivelinessToken>,
}

impl Followers {
    async fn run(mut self, mut down: watch::Receiver<bool>) {
        let seen = Tokens::default();
        let see = {
            let seen = seen.clone();
            move |sample: zenoh::sample::Sample| {
                seen.put(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
            }
        };
        let mut subscribers = Vec::new();
        for tokens in [format!("**/{TOKEN}"), format!("**/{RUN}/*")] {
            let liveliness = self.session.liveliness();
            match liveliness.declare_subscriber(tokens).history(true).callback(see.clone()).await {
                Ok(subscriber) => subscribers.push(subscriber),
                Err(error) => return tracing::error!("zenoh shows no stages: {error}"),
            }
        }
        let mut followers = JoinSet::new();
        loop {
            tokio::select! {
                () = ended(&mut down) => break,
                (token, there) = seen.next() => match Keys::of_run(&token) {
                    Some((keys, run)) => self.run_seen(&keys, run, there).await,
                    None => self.seen(&token, there, &mut followers, &down).await,
                },
            }
        }
        while followers.join_next().await.is_some() {}
    }

    /// A daemon has come or gone: two under one key do not see each other through this hub, and are notified.
    async fn run_seen(&mut self, keys: &Keys, run: &str, there: bool) {
        let key = keys.stage();
        let Some(runs) = self.runs.see(key, run, there) else {
            return tracing::warn!("more than {RUNS} daemons: {key} is not looked at for a second one");
        };
        if runs < 2 {
            self.reported.remove(key);
        } else if !self.reported.contains_key(key) {
            tracing::warn!("{runs} daemons run under the key {key}: give all but one another zenoh.key");
            match self.session.liveliness().declare_token(keys.twin(&self.session.zid().to_string())).await {
                Ok(token) => _ = self.reported.insert(key.to_owned(), token),
                Err(error) => tracing::warn!("{key}: {error}"),
            }
        }
    }

    /// A token has come or gone.
    async fn seen(
        &mut self,
        token: &str,
        there: bool,
        followers: &mut JoinSet<()>,
        down: &watch::Receiver<bool>,
    ) {
        let Some(keys) = Keys::of_token(token) else { return };
        match self.followed.get(keys.stage()) {
            Some(alive) => _ = alive.send_if_modified(|alive| std::mem::replace(alive, there) != there),
            None if !there => {}
            None => {
                let id = id_of(keys.stage());
                if self.followed.keys().any(|key| id_of(key) == id) {
                    return tracing::warn!(
                        "two stages are known as {id:?}: give {} another zenoh.key",
                        keys.stage()
                    );
                }
                if self.followed.len() >= STAGES && !self.forget_one().await {
                    return tracing::warn!(
                        "{STAGES} stages are there, which is the most: {id:?} is not followed"
                    );
                }
                self.board.enter(&id);
                let (alive, seen) = watch::channel(true);
                let follower = Follower {
                    fuse: self.fuse.contains(&id),
                    id,
                    session: self.session.clone(),
                    registry: self.registry.clone(),
                    board: self.board.clone(),
                    clock: self.clock,
                    alive: seen,
                    keys: keys.clone(),
                };
                self.followed.insert(keys.stage().to_owned(), alive);
                followers.spawn(follower.run(down.clone()));
            }
        }
    }
}

impl Followers {
    /// Makes a place: the stage that has been gone longest gives up its own. False where all are there.
    async fn forget_one(&mut self) -> bool {
        let Some(id) = self.board.forget_one() else { return false };
        tracing::info!("stage {id} is forgotten: another one has come");
        // Its follower ends as nobody can say any more whether it is there.
        self.followed.retain(|key, _| id_of(key) != id);
        self.registry.leave(&id).await;
        true
    }
}

/// A stage's name at this hub, from its key: `posed/` in front says nothing, and a path has other uses for `/`.
fn id_of(key: &str) -> String {
    let name = key.strip_prefix("posed/").unwrap_or(key).replace('/', ".");
    // The hub's own addresses.
    if matches!(name.as_str(), "ws" | "assets" | "health" | "metrics") {
        format!("{name}.stage")
    } else {
        name
    }
}

#[cfg(test)]
mod tests {
    use super::id_of;

    #[test]
    fn a_stage_is_known_by_its_key() {
        assert_eq!(id_of("posed/stage-a"), "stage-a");
        assert_eq!(id_of("hall-2/left/a"), "hall-2.left.a");
        assert_eq!(id_of("posed/ws"), "ws.stage");
    }
}
