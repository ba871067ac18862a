//! A recording served to clients as a live stage would be: by a daemon without devices, and beside the stage of one that has them.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};

use tokio::sync::{mpsc, watch};

use super::clock::StageClock;
use super::jobs::Jobs;
use super::library::TakeLibrary;
use super::look::Looks;
use super::player::{Outlet, PlayError, Played, Player};
use super::ports::ended;
use super::recordings;
use super::server::{BindError, Config, Hub, LetGo, PendingCall, Server, Shelf, Sides, Take, TakeError};
use super::service::Service;
use super::vital::PartEnded;
use posed_protocol::{Call, Status, Topic};
use posed_recording::{Header, Outline, ReadError, Reader};
use posed_stage::{Problems, Secret, Stage, Token};

/// Requests that wait for the player.
const WAITING: usize = 64;

/// The MCAP topic of the ground truth.
const TRUTH: &str = "/input/truth";

/// Why a recording cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum PlaybackError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Its stage file does not fit this version.
    #[error("the recording's stage file does not fit this version of posed: {0}")]
    Stage(#[from] Problems),
    /// It cannot be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// The server cannot listen.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// A thread could not be made.
    #[error("the system gives no thread: {0}")]
    Thread(std::io::Error),
}

/// A recording holds placeholders for tokens, which everybody knows. Without its tokens it is served on this computer only.
fn forget_placeholders(server: &mut posed_stage::Server) {
    let is_known = |token: &Token| token.secret.as_ref().is_none_or(Secret::is_placeholder);
    if server.tokens.iter().any(is_known) {
        (server.tokens, server.listen) = (Vec::new(), None);
    }
}

/// A recording that was opened, and is not played yet.
struct Opened {
    header: Header,
    stage: Stage,
    played: Played,
    /// Topics beside those that its stage shows.
    topics: Vec<Topic>,
}

impl Opened {
    /// Reads its header and its index.
    fn read(recording: &Path) -> Result<Self, PlaybackError> {
        let played = Played::read(recording)?;
        let (header, has_truth) = match &played.chunks {
            Some(chunks) => (chunks.header().clone(), chunks.topics().any(|topic| topic == TRUTH)),
            None => {
                let header = Reader::open(recording)?.header().clone();
                (header, Outline::read(recording)?.topics.contains(TRUTH))
            }
        };
        let stage = Stage::parse(&header.stage_toml)?;
        let topics = Vec::from_iter(has_truth.then_some(Topic::Truth));
        Ok(Self { header, stage, played, topics })
    }
}

/// Where the calls for a recording go.
#[derive(Clone)]
struct Desk {
    player: SyncSender<PendingCall>,
    looks: Looks,
}

/// What plays into `hub` at `speed` times real time, and where it takes calls; it ends when nobody can call any more.
fn player(
    played: Played,
    hub: Hub,
    library: TakeLibrary,
    folder: PathBuf,
    speed: f64,
) -> Result<(Player, Desk), PlaybackError> {
    let (calls, received) = sync_channel(WAITING);
    let clock = StageClock::start();
    let jobs = Jobs::new(clock, hub.clone());
    let looks = Looks::start(played.chunks.clone()).map_err(PlaybackError::Thread)?;
    let outlet = Outlet { clock, hub, jobs, library, looks: looks.clone() };
    Ok((Player::new(outlet, received, played, folder, speed)?, Desk { player: calls, looks }))
}

/// A folder of recordings that are watched beside a live stage.
pub(super) struct Recordings {
    folder: PathBuf,
    library: TakeLibrary,
}

impl Recordings {
    pub(super) fn new(folder: PathBuf, library: TakeLibrary) -> Self {
        Self { folder, library }
    }
}

impl Shelf for Recordings {
    fn open(&self, name: &str) -> Result<Take, TakeError> {
        let path = recordings::find(&self.folder, name)?;
        let unplayable = |error: PlaybackError| TakeError::Unplayable(error.to_string());
        let Opened { header, stage, played, topics } = Opened::read(&path).map_err(unplayable)?;
        let (folder, library) = (self.folder.clone(), self.library.clone());
        let play = move |hub: Hub, pending, down| {
            let unplayable = |error: &dyn std::error::Error| TakeError::Unplayable(error.to_string());
            let (player, desk) =
                player(played, hub, library, folder, 1.0).map_err(|error| unplayable(&error))?;
            #[expect(clippy::disallowed_methods, reason = "the daemon owns the player's thread")]
            std::thread::Builder::new()
                .name("take".into())
                .spawn(move || player.run())
                .map_err(|error| unplayable(&error))?;
            tokio::spawn(forward(pending, desk, down));
            Ok(())
        };
        Ok(Take { stage, epoch_utc_ns: header.epoch_utc_ns, topics, play: Box::new(play) })
    }

    fn lend(&self, let_go: LetGo) {
        self.library.lend(let_go);
    }
}

/// A recording being served; ends with [`Playback::shutdown`].
pub struct Playback {
    service: Service,
    player: std::thread::JoinHandle<()>,
}

impl Playback {
    /// Serves `recording` at `speed` times real time (0 is a pause, infinity as fast as it goes); `replay.list` and `replay.open`
    /// speak of its folder. `listen`: `HOST:PORT` instead of the one in the recording's stage file. A recording holds no tokens: one
    /// of a stage that has some is served on [`server::DEFAULT_LISTEN`](super::server::DEFAULT_LISTEN). VRPN, VMC, MVN and LSL are not served.
    ///
    /// # Errors
    /// The recording cannot be read or played, or the address does not serve; see [`PlaybackError`].
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn start(recording: &Path, listen: Option<String>, speed: f64) -> Result<Self, PlaybackError> {
        super::process_limits::raise();
        let folder = match recording.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        let Opened { header, mut stage, played, topics } = Opened::read(recording)?;
        forget_placeholders(&mut stage.server);
        let mut config = Config::new(&folder, header.epoch_utc_ns);
        config.listen = listen;
        config.replay = true;
        config.more_topics = topics;
        let sides = Sides { files: Some(folder.clone()), ..Sides::default() };
        let (server, hub, pending) = Server::bind_with(&stage, config, sides)?;
        let mut service = Service::start(server);

        let library = TakeLibrary::start(folder.clone()).map_err(PlaybackError::Thread)?;
        let (player, desk) = player(played, hub, library, folder, speed)?;
        #[expect(clippy::disallowed_methods, reason = "the daemon owns the player's thread")]
        let player = std::thread::Builder::new()
            .name("player".into())
            .spawn(service.vital().thread("the player", move || player.run()))
            .map_err(PlaybackError::Thread)?;

        let down = service.down();
        service.spawn("what answers requests", forward(pending, desk, down));
        Ok(Self { service, player })
    }

    /// The address to open in a browser, as [`Daemon::url`](super::Daemon::url).
    pub fn url(&self) -> &str {
        self.service.url()
    }

    /// The first part that ended before [`Self::shutdown`], as [`Daemon::part_ended`](super::Daemon::part_ended).
    pub fn part_ended(&self) -> watch::Receiver<Option<PartEnded>> {
        self.service.part_ended()
    }

    /// The newest status that clients have been sent: about one a second; empty before the first.
    pub fn status(&self) -> watch::Receiver<Status> {
        self.service.status()
    }

    /// Ends everything; clients are notified of the end. Takes less than five seconds.
    pub async fn shutdown(self) {
        self.service.shutdown(self.player).await;
    }
}

/// Hands requests on to the player until the end, which ends the player too; looks are answered beside it.
async fn forward(
    mut pending: mpsc::Receiver<PendingCall>,
    Desk { player, looks }: Desk,
    mut down: watch::Receiver<bool>,
) {
    loop {
        tokio::select! {
            () = ended(&mut down) => return,
            call = pending.recv() => {
                let Some(call) = call else { return };
                if let PendingCall { call: Call::ReplayLook { t_s }, reply } = call {
                    looks.at(t_s, reply);
                    continue;
                }
                match player.try_send(call) {
                    Ok(()) => {}
                    Err(TrySendError::Full(PendingCall { reply, .. })) => {
                        reply.error("busy", "the player is slow, and many requests wait for it already; try again later");
                    }
                    Err(TrySendError::Disconnected(_)) => return,
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::server::testing::{Asking, ids};
    use super::*;

    #[tokio::test]
    async fn more_requests_than_may_wait_for_a_player_that_hangs_are_refused_and_those_that_wait_are_there() {
        let (calls, player) = sync_channel(WAITING);
        let (sender, pending) = mpsc::channel(1);
        let (_up, down) = watch::channel(false);
        let desk = Desk { player: calls, looks: Looks::start(None).unwrap() };
        let task = tokio::spawn(forward(pending, desk, down));
        let asking = Asking::new();
        for id in 0..WAITING + 50 {
            sender.send(PendingCall { call: Call::ReplayList {}, reply: asking.reply(id) }).await.unwrap();
        }
        drop(sender);
        task.await.unwrap();
        let refused = asking.answers();
        assert!(refused.iter().all(|answer| answer["code"] == "busy"), "{refused:?}");
        assert_eq!(ids(&refused), (WAITING..WAITING + 50).collect::<Vec<_>>());
        for PendingCall { reply, .. } in player.try_iter() {
            reply.ok(None);
        }
        assert_eq!(ids(&asking.answers()), (0..WAITING).collect::<Vec<_>>());
    }
}
