//! What a stage answers to other machines: its clock at once, everything else on a thread of its own.
//!
//! | key | answer |
//! |---|---|
//! | `KEY/status` | the newest `status`, JSON as on the websocket |
//! | `KEY/recordings` | JSON list of `{name, bytes}` |
//! | `KEY/recordings/NAME?offset=N;bytes=M` | bytes of one, at most 1 MiB; none at its end |
//! | `KEY/clock` | [`ClockReading`] |
//! | `KEY/ask/join?after=N` | [`Joined`](super::wire::Joined) |
//! | `KEY/ask/begin` | [`Begin`] |
//! | `KEY/ask/log?from=N` | [`LogChunk`](super::wire::LogChunk) |

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, bounded, select};
use serde::Serialize;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use super::feed::Feed;
use super::input_log::Log;
use super::session::{LinkError, thread};
use super::wire::{Begin, ClockReading, Keys};
use super::wishes;
use posed_daemon::FusionInbox;
use posed_daemon::StageClock;
use posed_daemon::recordings;
use posed_daemon::server::RemoteRecording;
use posed_recording::Reader;
use posed_stage::{Stage, without_secrets};

/// Questions that wait; more get no answer, and are asked again.
const WAITING: usize = 64;
/// Bytes of a recording in one answer at most.
const CHUNK_BYTES: u64 = 1 << 20;

/// What answers are made from.
pub(super) struct Answers {
    pub(super) keys: Keys,
    pub(super) feed: Feed,
    pub(super) log: Log,
    pub(super) clock: StageClock,
    pub(super) inbox: FusionInbox,
    pub(super) recordings: PathBuf,
    pub(super) stage_toml: String,
}

impl Answers {
    /// Declares the stage, last of all its token, and answers until `stopped`.
    pub(super) fn start(self, session: Session, stopped: Receiver<()>) -> Result<JoinHandle<()>, LinkError> {
        let (failed, begun) = bounded(1);
        let thread = thread("zenoh-answers", move || {
            let answer = || match self.run(&session, &stopped, || _ = failed.send(None)) {
                Ok(()) => _ = session.close().wait(),
                Err(error) => _ = failed.send(Some(LinkError::Zenoh(error))),
            };
            self.feed.guard("what answers on zenoh", answer);
        })?;
        match begun.recv() {
            Ok(None) => Ok(thread),
            Ok(Some(error)) => Err(error),
            Err(_) => Err(LinkError::Crashed),
        }
    }

    fn run(&self, session: &Session, stopped: &Receiver<()>, begun: impl FnOnce()) -> zenoh::Result<()> {
        let (clock, run, key, feed) = (self.clock, self.feed.run(), self.keys.clock(), self.feed.clone());
        let tell_time = move |query: Query| {
            let (frames, last_event_id) = feed.progress();
            let reading = ClockReading { run, t_ns: clock.now().as_nanos(), frames, last_event_id };
            if let Ok(bytes) = rmp_serde::to_vec(&reading) {
                let _ = query.reply(query.key_expr().clone(), bytes).wait();
            }
        };
        let _clock = session.declare_queryable(key).callback(tell_time).wait()?;
        let keys = [self.keys.status(), format!("{}/**", self.keys.recordings()), self.keys.ask("*")];
        let (_queryables, questions) = collect(session, keys)?;
        let _wishes = wishes::look(session, &self.keys, &self.feed)?;
        let _lookout = self.feed.twins().look(session, &self.keys, run)?;
        let _token = session.liveliness().declare_token(self.keys.token()).wait()?;
        begun();
        loop {
            let query = select! {
                recv(questions) -> query => query,
                recv(stopped) -> _ => return Ok(()),
            };
            let Ok(query) = query else { return Ok(()) };
            let replied = match self.answer(&query) {
                Ok(bytes) => query.reply(query.key_expr().clone(), bytes).wait(),
                Err(error) => query.reply_err(error.to_string()).wait(),
            };
            if let Err(error) = replied {
                tracing::debug!(%error, "zenoh: an answer");
            }
        }
    }

    /// The answer, or why there is none.
    fn answer(&self, query: &Query) -> zenoh::Result<Vec<u8>> {
        let requested = query.key_expr().as_str().strip_prefix(self.keys.stage()).unwrap_or_default();
        let number = |name: &str, absent: u64| match query.parameters().get(name) {
            None => Ok(absent),
            Some(text) => text.parse::<u64>().map_err(|_| format!("{name}: give a number, not {text:?}")),
        };
        match requested.split('/').collect::<Vec<_>>()[..] {
            ["", "status"] => match self.feed.status() {
                status if status.is_empty() => Err("there is no status yet".into()),
                status => Ok(status),
            },
            ["", "recordings"] => self.list(),
            ["", "recordings", name] => self.piece(name, number("offset", 0)?, number("bytes", CHUNK_BYTES)?),
            ["", "ask", "join"] => packed(&self.feed.join(number("after", 0)?)),
            ["", "ask", "log"] => packed(&self.log.from(number("from", 0)?)),
            ["", "ask", "begin"] => {
                let mut begin = self.inbox.begin()?;
                begin.header.stage_toml.clone_from(&self.stage_toml);
                packed(&Begin { next: begin.next, header: begin.header })
            }
            _ => Err(format!("{}: nothing is answered under this key", query.key_expr()).into()),
        }
    }

    fn list(&self) -> zenoh::Result<Vec<u8>> {
        let size = |name: &str| std::fs::metadata(self.recordings.join(name)).map_or(0, |file| file.len());
        let entry = |name: String| RemoteRecording { bytes: size(&name), name };
        let entries = recordings::list(&self.recordings)?.into_iter().map(entry);
        Ok(serde_json::to_vec(&entries.collect::<Vec<_>>())?)
    }

    fn piece(&self, name: &str, offset: u64, bytes: u64) -> zenoh::Result<Vec<u8>> {
        let path = recordings::find(&self.recordings, name)?;
        check_secrets(&path)?;
        let read = || {
            let mut file = File::open(&path)?;
            file.seek(SeekFrom::Start(offset))?;
            let mut piece = Vec::new();
            file.take(bytes.min(CHUNK_BYTES)).read_to_end(&mut piece)?;
            Ok::<_, std::io::Error>(piece)
        };
        read().map_err(|error| format!("cannot read {name}: {error}").into())
    }
}

/// Recordings of before hold the stage file as it was, with its tokens: those are not given away.
fn check_secrets(path: &Path) -> zenoh::Result<()> {
    let reader = Reader::open(path)?;
    let text = &reader.header().stage_toml;
    // A stage file of another version: nobody knows what is in it.
    if Stage::parse(text).is_err() || without_secrets(text) != *text {
        return Err("this recording holds a stage file with tokens, or one of another version: copy it from its machine".into());
    }
    Ok(())
}

fn packed(answer: &impl Serialize) -> zenoh::Result<Vec<u8>> {
    Ok(rmp_serde::to_vec_named(answer)?)
}

/// What is asked under these keys, as long as the first is kept.
fn collect<const N: usize>(
    session: &Session,
    keys: [String; N],
) -> zenoh::Result<(Vec<Queryable<()>>, Receiver<Query>)> {
    let (sender, questions) = bounded(WAITING);
    let declare = |key| {
        let sender = sender.clone();
        // Where too many wait, who asks sees that there is no answer.
        session.declare_queryable(key).callback(move |query| _ = sender.try_send(query)).wait()
    };
    Ok((keys.into_iter().map(declare).collect::<zenoh::Result<_>>()?, questions))
}

#[cfg(test)]
mod tests {
    use posed_stage::Zenoh;

    use super::*;
    use crate::session::{End, open};

    #[test]
    fn more_questions_than_may_wait_get_no_answer_at_once_and_those_that_wait_get_theirs() {
        let session = open(&Zenoh::default(), End::Stage).unwrap();
        let (_queryables, questions) = collect(&session, ["posed/a/status".to_owned()]).unwrap();
        let ask = |_| session.get("posed/a/status").wait().unwrap();
        let asked = (0..WAITING + 50).map(ask).collect::<Vec<_>>();
        let (waiting, surplus) = asked.split_at(WAITING);
        assert!(surplus.iter().all(|answer| answer.recv().is_err()));
        for query in questions.try_iter() {
            query.reply("posed/a/status", "here").wait().unwrap();
        }
        let is_here =
            |answer: zenoh::query::Reply| answer.result().is_ok_and(|sample| sample.payload().len() == 4);
        assert!(waiting.iter().all(|answer| answer.recv().is_ok_and(is_here)));
        let late = ask(0);
        questions.recv().unwrap().reply("posed/a/status", "here").wait().unwrap();
        assert!(late.recv().is_ok_and(is_here));
    }
}
