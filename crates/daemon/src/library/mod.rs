//! The library: the recordings of one folder, listed, described, renamed, removed, exported.
//!
//! In: calls of clients, of a live stage and of replays beside it alike. Out: their answers, jobs. A thread of its own reads and moves
//! files, one call after the other, so that a disk that hangs holds up nothing else. Never: a path that leads out of the folder, a file that is
//! written over another, or one that is moved while somebody records into it or reads it.

mod export;
mod in_use;
mod labels;
mod list;
mod moving;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};

pub(super) use self::in_use::{Held, InUse, Use};
use self::list::Lists;
pub use self::moving::forget;
use super::jobs::{Jobs, give_way};
use super::recordings;
use super::server::{LetGo, Refusal, Reply};
use posed_protocol::{Answer, Call, Digested, RefusalReason, Takes};
use posed_recording::{ReadError, keep_digest, make_digest, read_digest};

/// Calls that may wait for the disk.
const WAITING: usize = 64;
/// What a replay or an export gives way to: live tracking goes on beside.
const NICE: i32 = 19;
/// Folder of what was removed, in that of the recordings.
const BIN: &str = "bin";
/// Folder of what was exported, in that of the recordings.
pub(super) const EXPORTS: &str = "exports";

/// Hears that a recording has another name: from, to.
pub(super) type OnRename = Box<dyn Fn(&str, &str) + Send + Sync>;

/// Answers calls about the folder; clones are the same library. Its thread ends with the last one.
#[derive(Clone)]
pub(super) struct TakeLibrary {
    asks: Sender<Ask>,
    in_use: InUse,
    shared: Arc<Shared>,
}

/// What is known only once other parts are there.
#[derive(Default)]
struct Shared {
    let_go: OnceLock<LetGo>,
    on_rename: OnceLock<OnRename>,
}

/// A call, and where its jobs are listed.
struct Ask {
    call: Call,
    reply: Reply,
    jobs: Jobs,
}

impl TakeLibrary {
    /// Of the recordings in `folder`, which need not be there yet.
    ///
    /// # Errors
    /// The system gives no thread.
    pub(super) fn start(folder: PathBuf) -> std::io::Result<Self> {
        let (asks, asked) = bounded(WAITING);
        let (in_use, shared) = (InUse::default(), Arc::<Shared>::default());
        let librarian = Librarian {
            folder,
            in_use: in_use.clone(),
            shared: Arc::clone(&shared),
            lists: Lists::default(),
        };
        #[expect(clippy::disallowed_methods, reason = "the daemon owns this thread, too")]
        std::thread::Builder::new().name("library".into()).spawn(move || librarian.run(&asked))?;
        Ok(Self { asks, in_use, shared })
    }

    /// Answers a call that [is about the folder](Call::is_of_library), when it is carried out; its jobs are listed in `jobs`.
    pub(super) fn ask(&self, call: Call, reply: Reply, jobs: &Jobs) {
        let ask = Ask { call, reply, jobs: jobs.clone() };
        if let Err(TrySendError::Full(Ask { reply, .. })) = self.asks.try_send(ask) {
            reply.error("busy", "the disk is slow, and many requests wait for it already; try again later");
        }
    }

    /// Which files must stay where they are.
    pub(super) fn in_use(&self) -> &InUse {
        &self.in_use
    }

    /// Tells what closes a take that nobody watches any more.
    pub(super) fn lend(&self, let_go: LetGo) {
        let _ = self.shared.let_go.set(let_go);
    }

    /// Tells who is to hear of new names.
    pub(super) fn on_rename(&self, on_rename: OnRename) {
        let _ = self.shared.on_rename.set(on_rename);
    }
}

/// The thread's state.
struct Librarian {
    folder: PathBuf,
    in_use: InUse,
    shared: Arc<Shared>,
    lists: Lists,
}

type Outcome = Result<Option<Answer>, Refusal>;

impl Librarian {
    fn run(mut self, asked: &Receiver<Ask>) {
        for Ask { call, reply, jobs } in asked {
            // One that panics is answered as one that was not carried out; the others go on.
            if catch_unwind(AssertUnwindSafe(|| self.carry_out(call, reply, &jobs))).is_err() {
                tracing::error!("a request was given up for a fault of the daemon's own; please report this");
            }
        }
    }

    fn carry_out(&mut self, call: Call, reply: Reply, jobs: &Jobs) {
        match call {
            Call::ReplayLabels { name } => reply.answer(self.labels(&name)),
            Call::ReplayLabel { name, from_s, to_s, label } => {
                reply.answer(self.label(&name, from_s, to_s, &label));
            }
            Call::LibraryList { bin } => reply.answer(self.list(bin)),
            Call::LibraryDigest { name, make } => self.digest(&name, make, reply, jobs),
            Call::LibraryRename { name, to } => reply.answer(self.rename(&name, &to)),
            Call::LibraryRemove { name } => reply.answer(self.remove(&name)),
            Call::LibraryRestore { name } => reply.answer(self.restore(&name)),
            Call::LibraryEmptyBin {} => reply.answer(self.empty_bin()),
            Call::LibraryExport { name, format, bones, model, body, frame } => {
                let wanted = export::Wanted { format, bones, model, body, frame };
                self.export(&name, wanted, reply, jobs);
            }
            _ => reply.error("unavailable", "this is not for the library"),
        }
    }

    fn list(&mut self, bin: bool) -> Outcome {
        let folder = if bin { self.folder.join(BIN) } else { self.folder.clone() };
        let takes = self.lists.of(&folder)?;
        let recording = self.in_use.recording(&self.folder);
        Ok(Some(Answer::Takes(Takes { takes, recording })))
    }

    fn digest(&self, name: &str, make: bool, reply: Reply, jobs: &Jobs) {
        let path = match recordings::find(&self.folder, name) {
            Ok(path) => path,
            Err(error) => return reply.refuse(error.into()),
        };
        match read_digest(&path) {
            Ok(Some(digest)) => {
                return reply.ok(Some(Answer::Digested(Digested::Known { digest: Box::new(digest) })));
            }
            Ok(None) if !make => {
                return reply.ok(Some(Answer::Digested(Digested::Unknown { unknown: true })));
            }
            Ok(None) => {}
            Err(error) => return reply.refuse(Refusal::failed(error)),
        }
        if self.in_use.is_recorded(&path) {
            let sentence = "it is still being recorded; it has a digest once that has ended";
            return reply.refuse(Refusal::new("busy", sentence).because(RefusalReason::IsRecorded));
        }
        let (held, name) = (self.in_use.hold(&path, Use::Read), name.to_owned());
        jobs.run("library.digest", reply, move |job| {
            let _held = held;
            give_way(NICE);
            let mut progress = Progress::over(&path);
            let made = make_digest(&path, |bytes| progress.at(bytes, job));
            match made {
                Ok(digest) => {
                    keep_digest(&path, &digest)?;
                    Ok(format!("{name} has a digest now"))
                }
                Err(ReadError::Cancelled) => Ok("nothing was kept".to_owned()),
                Err(error) => Err(error.into()),
            }
        });
    }
}

/// How far a job has read a recording.
struct Progress {
    of_bytes: f64,
    last: u64,
}

impl Progress {
    fn over(path: &Path) -> Self {
        let bytes = path.metadata().map_or(0, |known| known.len());
        Self { of_bytes: bytes as f64, last: 0 }
    }

    /// So many bytes have been read; false where the job is to end.
    fn at(&mut self, bytes: u64, job: &super::jobs::Job) -> bool {
        if bytes != self.last {
            self.last = bytes;
            job.progress((self.of_bytes > 0.0).then(|| bytes as f64 / self.of_bytes), None);
        }
        !job.is_cancelled()
    }
}

#[cfg(test)]
mod tests;
