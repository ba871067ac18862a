//! One stage after the other at one address: a stage file that clients change while the server's socket stays open.
//!
//! ```text
//!  client ── setup.save ──> Editor: check, rehearse, write ── Changed ──> Stages: old daemon ends, new one begins on the same socket
//! ```
//! What comes in: the options of the first daemon, and a stage file. What goes out: a daemon that is always there, with one status and one
//! address. What it never does: end a stage for one that was not checked and rehearsed, or leave a stage file in place that did not start.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use posed_recording::AtomicFile;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;

use super::clock::StageClock;
use super::server;
use super::server::phones::PhoneSocket;
use super::vital::PartEnded;
use super::{Daemon, Options, Place, StartError};
use posed_protocol::{Problem, Status};
use posed_stage::{Report, Stage};

/// Until then the answer to who changed the stage has gone out.
const ANSWERED: Duration = Duration::from_millis(100);

/// All that is wrong with the text of a stage file, whose relative paths begin at a folder.
pub type Check = fn(text: &str, folder: &Path) -> Report;
/// What a daemon is started with on a stage, whose text is given too.
pub type MakeOptions = Arc<dyn Fn(Stage, String) -> Options + Send + Sync>;

/// The stage file of a daemon that its clients may change.
#[derive(Clone)]
pub struct StageFile {
    /// Where it is.
    pub path: PathBuf,
    /// What `posed check` says.
    pub check: Check,
    /// What every changed stage is started with.
    pub options: MakeOptions,
}

/// The stage file in a daemon's hands; clones share it.
#[derive(Clone)]
pub(super) struct Editor {
    pub(super) file: StageFile,
    changed: mpsc::Sender<Changed>,
}

/// A stage file that was written.
struct Changed {
    /// What the changed stage is started with.
    options: Options,
    /// What stood in the file before.
    before: String,
}

impl Editor {
    /// The folder that relative paths of the file begin at.
    pub(super) fn folder(&self) -> &Path {
        folder_of(&self.file.path)
    }

    /// Why the file cannot be written; `None` where it can.
    pub(super) fn why_not(&self) -> Option<String> {
        use rustix::fs::{Access, access};
        // Through a link: its target is replaced.
        let path = self.file.path.canonicalize().unwrap_or_else(|_| self.file.path.clone());
        let folder = match folder_of(&path) {
            folder if folder.as_os_str().is_empty() => Path::new("."),
            folder => folder,
        };
        let error = access(&path, Access::WRITE_OK).and_then(|()| access(folder, Access::WRITE_OK)).err()?;
        Some(format!(
            "the daemon may not write {} ({}): give its user the right to the file and its folder, or change the file in an editor and restart posed",
            path.display(),
            io::Error::from(error)
        ))
    }

    /// Keeps the file of before beside it, and writes the new text in its place, whole or not at all.
    pub(super) fn write(&self, text: &str) -> io::Result<()> {
        let path = &self.file.path;
        let mut kept = path.as_os_str().to_owned();
        kept.push("~");
        // With its rights: it may hold secrets.
        std::fs::copy(path, kept)?;
        AtomicFile::replace(path, text.as_bytes())
    }

    /// Has the changed stage begin; `before` is what stood in the file.
    pub(super) fn begin(&self, options: Options, before: String) {
        // Full, one is under way that was refused as changed meanwhile; closed, the daemon ends.
        let _ = self.changed.try_send(Changed { options, before });
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

/// A daemon on a stage file that its clients may change; ends with [`Stages::shutdown`].
pub struct Stages {
    url: String,
    vrpn_address: Option<SocketAddr>,
    status: watch::Receiver<Status>,
    part_ended: watch::Receiver<Option<PartEnded>>,
    stop: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Stages {
    /// Starts the first daemon. The address stays open until the end, whatever the changed file says about it.
    ///
    /// # Errors
    /// As for [`Daemon::start`].
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn start(options: Options, file: StageFile) -> Result<Self, StartError> {
        let socket = server::socket(&options.stage.server, options.listen.clone())?;
        // A changed stage is served at the address of the first one.
        let listen = Some(socket.listen.clone());
        let (changed, changes) = mpsc::channel(1);
        let place = Place {
            socket: Some(Arc::clone(&socket.listener)),
            phones: PhoneSocket::default(),
            editor: Some(Editor { file, changed }),
            problems: Vec::new(),
        };
        let options = Options { listen, ..options };
        let again = Options { record: None, ..options.clone() };
        let daemon = Daemon::start_at(options, place.clone())?;
        let (status_to, status) = watch::channel(Status::default());
        let (part_ended_to, part_ended) = watch::channel(None);
        let (url, vrpn_address) = (daemon.url().to_owned(), daemon.vrpn_address());
        let (stop, stopped) = oneshot::channel();
        let running =
            Running { place, options: again, changes, status: status_to, part_ended: part_ended_to };
        let task = tokio::spawn(running.run(daemon, stopped));
        Ok(Self { url, vrpn_address, status, part_ended, stop, task })
    }

    /// As [`Daemon::url`].
    pub fn url(&self) -> &str {
        &self.url
    }

    /// As [`Daemon::vrpn_address`], of the first stage.
    pub fn vrpn_address(&self) -> Option<SocketAddr> {
        self.vrpn_address
    }

    /// As [`Daemon::status`], of whichever stage runs.
    pub fn status(&self) -> watch::Receiver<Status> {
        self.status.clone()
    }

    /// As [`Daemon::part_ended`], of whichever stage runs; also where neither a changed stage nor the one before it starts.
    pub fn part_ended(&self) -> watch::Receiver<Option<PartEnded>> {
        self.part_ended.clone()
    }

    /// As [`Daemon::shutdown`].
    pub async fn shutdown(self) {
        let _ = self.stop.send(());
        let _ = self.task.await;
    }
}

/// What the stages have in common.
struct Running {
    place: Place,
    /// Of the stage that runs, for when a changed one does not start.
    options: Options,
    changes: mpsc::Receiver<Changed>,
    status: watch::Sender<Status>,
    part_ended: watch::Sender<Option<PartEnded>>,
}

impl Running {
    async fn run(mut self, first: Daemon, mut stop: oneshot::Receiver<()>) {
        let mut daemon = first;
        loop {
            let (mut status, mut part_ended) = (daemon.status(), daemon.part_ended());
            let changed = loop {
                tokio::select! {
                    _ = &mut stop => {
                        // Who connects now is refused.
                        self.place.socket = None;
                        self.place.phones = PhoneSocket::default();
                        return daemon.shutdown().await;
                    }
                    Some(changed) = self.changes.recv() => break changed,
                    Ok(()) = status.changed() => {
                        let newest = status.borrow_and_update().clone();
                        self.status.send_replace(newest);
                    }
                    part = ended_part(&mut part_ended), if self.part_ended.borrow().is_none() => {
                        self.part_ended.send_replace(part);
                    }
                }
            };
            answered().await;
            daemon.make_way().await;
            if stop.try_recv().is_ok() {
                return;
            }
            daemon = match self.next(changed) {
                Ok(next) => next,
                Err(error) => {
                    tracing::error!("{error}");
                    let part = format!("the stage ({error})");
                    self.part_ended.send_replace(Some(PartEnded { part }));
                    let _ = stop.await;
                    return;
                }
            };
        }
    }

    /// The changed stage, or the one before it.
    fn next(&mut self, Changed { options, before }: Changed) -> Result<Daemon, StartError> {
        let options = Options { listen: self.options.listen.clone(), record: None, ..options };
        self.place.problems.clear();
        let refused = match Daemon::start_at(options.clone(), self.place.clone()) {
            Ok(daemon) => {
                tracing::info!("the stage has changed: {}", options.stage.name);
                self.options = options;
                return Ok(daemon);
            }
            Err(refused) => refused,
        };
        let message = format!(
            "the changed stage does not start: {refused}; the one before goes on, and its file is as it was"
        );
        tracing::error!("{message}");
        if let Some(editor) = &self.place.editor
            && let Err(error) = AtomicFile::replace(&editor.file.path, before.as_bytes())
        {
            tracing::error!("cannot write {} as it was: {error}", editor.file.path.display());
        }
        self.place.problems.push(Problem::new("stage", message));
        let before = Options { clock: StageClock::start(), ..self.options.clone() };
        Daemon::start_at(before, self.place.clone())
    }
}

/// The part that ended; never where none does.
async fn ended_part(part_ended: &mut watch::Receiver<Option<PartEnded>>) -> Option<PartEnded> {
    if let Ok(part) = part_ended.wait_for(Option::is_some).await {
        return part.clone();
    }
    std::future::pending().await
}

#[expect(clippy::disallowed_methods, reason = "what is on its way to a client cannot be waited for")]
async fn answered() {
    tokio::time::sleep(ANSWERED).await;
}
