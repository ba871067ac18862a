//! Whether another daemon runs under this stage's key: nobody could tell the messages of the two apart.
//!
//! In: liveliness tokens. Every daemon has one of its own, `KEY/posed-run/RUN`; and because two daemons that are connected to a hub do not
//! see each other through it, a hub that sees two of them says so by a token of its own, `KEY/posed-twin/HUB`. Out: the problem for the
//! status, as long as one of these is there. Never: a decision which of the two is right.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use super::wire::Keys;
use posed_protocol::Problem;

/// Tokens that are kept; of more it is not seen when they go.
const TOKENS: usize = 256;

/// What is seen of others; clones share it.
#[derive(Clone, Debug, Default)]
pub(super) struct Twins {
    /// Tokens that should not be there.
    seen: Arc<Mutex<BTreeSet<String>>>,
}

/// Reports that this daemon is here, and looks out for others, until it is dropped.
pub(super) struct Lookout {
    _token: LivelinessToken,
    _subscribers: [Subscriber<()>; 2],
}

impl Twins {
    /// Declares this run and begins to look.
    pub(super) fn look(&self, session: &Session, keys: &Keys, run: i64) -> zenoh::Result<Lookout> {
        let own = keys.run(&run.to_string());
        let subscribe = |tokens: String| {
            let (seen, own) = (self.clone(), own.clone());
            let see = move |sample: Sample| seen.see(&own, sample.key_expr().as_str(), sample.kind());
            session.liveliness().declare_subscriber(tokens).history(true).callback(see).wait()
        };
        let subscribers = [subscribe(keys.run("*"))?, subscribe(keys.twin("*"))?];
        let token = session.liveliness().declare_token(own.clone()).wait()?;
        Ok(Lookout { _token: token, _subscribers: subscribers })
    }

    fn see(&self, own: &str, token: &str, kind: SampleKind) {
        match kind {
            SampleKind::Put => {
                let mut seen = self.seen();
                if token != own && seen.len() < TOKENS {
                    seen.insert(token.to_owned());
                }
            }
            SampleKind::Delete => _ = self.seen().remove(token),
        }
    }

    /// What is wrong now, if anything.
    pub(super) fn problem(&self, key: &str) -> Option<Problem> {
        let message = format!(
            "another daemon runs under the key {key} on zenoh, and hubs take the two for one: end one of them, or give one another name or \
             zenoh.key"
        );
        (!self.seen().is_empty()).then(|| Problem::new("zenoh_twin", message).with("key", key))
    }

    fn seen(&self) -> MutexGuard<'_, BTreeSet<String>> {
        // Every change is complete before anything in it could panic.
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_twin_is_a_problem_as_long_as_it_is_seen() {
        let (twins, own) = (Twins::default(), "posed/a/posed-run/1");
        let is_problem = |token: &str, kind| {
            twins.see(own, token, kind);
            twins.problem("posed/a").is_some()
        };
        assert!(!is_problem(own, SampleKind::Put), "oneself");
        assert!(is_problem("posed/a/posed-run/2", SampleKind::Put));
        assert!(is_problem("posed/a/posed-twin/f0", SampleKind::Put));
        assert!(is_problem("posed/a/posed-run/2", SampleKind::Delete), "a hub still says so");
        assert!(!is_problem("posed/a/posed-twin/f0", SampleKind::Delete));
        twins.see(own, "posed/a/posed-run/3", SampleKind::Put);
        assert!(twins.problem("posed/a").unwrap().message.contains("posed/a"));
    }

    #[test]
    fn tokens_without_end_fill_nothing_and_a_twin_that_was_there_stays_seen() {
        let (twins, own) = (Twins::default(), "posed/a/posed-run/1");
        let tokens = (2..2 * TOKENS).map(|run| format!("posed/a/posed-run/{run}")).collect::<Vec<_>>();
        for token in &tokens {
            twins.see(own, token, SampleKind::Put);
        }
        assert_eq!(twins.seen().len(), TOKENS);
        for token in &tokens[1..] {
            twins.see(own, token, SampleKind::Delete);
        }
        assert!(twins.problem("posed/a").is_some());
        twins.see(own, &tokens[0], SampleKind::Delete);
        assert!(twins.problem("posed/a").is_none());
    }
}
