//! `replay.look`: where everything was at a time of the open recording, beside the thread that plays it: that may be on its way to another time.

use std::sync::Arc;

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use posed_drivers::Timestamp;

use super::server::Reply;
use posed_protocol::Answer;
use posed_recording::{Chunks, Looker};

/// Looks that may wait: more than a second of who scrubs.
const WAITING: usize = 64;

/// Where looks are asked for; its thread ends with the last clone.
#[derive(Clone)]
pub(super) struct Looks {
    asks: Sender<Ask>,
}

enum Ask {
    /// Looks are into this recording from now on; `None` of one without an index.
    Open(Option<Arc<Chunks>>),
    At(f64, Reply),
}

impl Looks {
    /// Into this recording.
    ///
    /// # Errors
    /// The system gives no thread.
    pub(super) fn start(chunks: Option<Arc<Chunks>>) -> std::io::Result<Self> {
        let (asks, asked) = bounded(WAITING);
        #[expect(clippy::disallowed_methods, reason = "the daemon owns this thread, too")]
        std::thread::Builder::new().name("look".into()).spawn(move || answer(chunks, &asked))?;
        Ok(Self { asks })
    }

    /// Another recording is open. Waits for looks that are under way.
    pub(super) fn open(&self, chunks: Option<Arc<Chunks>>) {
        let _ = self.asks.send(Ask::Open(chunks));
    }

    /// Answers what was shown at a stage time, s.
    pub(super) fn at(&self, t_s: f64, reply: Reply) {
        if !t_s.is_finite() {
            return reply.error("bad_request", "t_s: give a number of seconds");
        }
        if let Err(TrySendError::Full(Ask::At(_, reply))) = self.asks.try_send(Ask::At(t_s, reply)) {
            reply.error("busy", "many looks wait already; ask for fewer");
        }
    }
}

fn answer(chunks: Option<Arc<Chunks>>, asked: &Receiver<Ask>) {
    let opened = |chunks: Option<Arc<Chunks>>| {
        let chunks =
            chunks.ok_or("the recording has no index; `posed info --repair` writes it".to_owned())?;
        Looker::new(chunks).map_err(|error| error.to_string())
    };
    let mut looker = opened(chunks);
    for ask in asked {
        match ask {
            Ask::Open(chunks) => looker = opened(chunks),
            Ask::At(t_s, reply) => match &mut looker {
                Err(reason) => reply.error("failed", reason.clone()),
                Ok(looker) => match looker.at(Timestamp::from_secs_f64(t_s)) {
                    Ok(look) => reply.ok(Some(Answer::Look(look))),
                    Err(error) => reply.error("failed", error.to_string()),
                },
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::server::testing::{Asking, ids};
    use super::*;

    #[test]
    fn more_looks_than_may_wait_for_a_disk_that_hangs_are_refused_and_those_that_wait_are_there() {
        let (asks, hangs) = bounded(WAITING);
        let (looks, asking) = (Looks { asks }, Asking::new());
        (0..WAITING + 50).for_each(|id| looks.at(1.0, asking.reply(id)));
        let refused = asking.answers();
        assert!(refused.iter().all(|answer| answer["code"] == "busy"), "{refused:?}");
        assert_eq!(ids(&refused), (WAITING..WAITING + 50).collect::<Vec<_>>());
        for ask in hangs.try_iter() {
            let Ask::At(_, reply) = ask else { panic!("nothing was opened") };
            reply.ok(None);
        }
        assert_eq!(ids(&asking.answers()), (0..WAITING).collect::<Vec<_>>());
    }
}
