//! From zenoh's threads to who follows the stages: which tokens have come and gone.
//!
//! The newest word on a token takes the place of an older one that nobody has read: who declares and takes back the same token all
//! day fills nothing. Tokens that are new while 1024 wait are not taken.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

/// Tokens that wait at a time.
const WAITING: usize = 1024;
/// Bytes of a token; a longer one is no stage's.
const BYTES: usize = 256;

/// Clones share what waits.
#[derive(Clone, Debug, Default)]
pub(super) struct Tokens {
    waiting: Arc<Mutex<BTreeMap<String, bool>>>,
    filled: Arc<Notify>,
}

impl Tokens {
    /// A token has come, or is gone. Never waits.
    pub(super) fn put(&self, token: &str, there: bool) {
        let mut waiting = self.lock();
        if let Some(newest) = waiting.get_mut(token) {
            *newest = there;
        } else if token.len() <= BYTES && waiting.len() < WAITING {
            waiting.insert(token.to_owned(), there);
        } else {
            tracing::warn!("too many stages at once, or one with too long a key: {token:.64}");
        }
        drop(waiting);
        self.filled.notify_one();
    }

    /// The next one, and whether it is there.
    pub(super) async fn next(&self) -> (String, bool) {
        loop {
            if let Some(next) = self.lock().pop_first() {
                return next;
            }
            self.filled.notified().await;
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, bool>> {
        // Every change is complete before anything in it could panic.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_flaps_or_comes_without_end_fills_nothing() {
        let tokens = Tokens::default();
        for n in 0..100_000 {
            tokens.put("posed/a/token", n % 2 == 0);
            tokens.put(&format!("posed/{n}/token"), true);
        }
        tokens.put(&"x".repeat(257), true);
        assert_eq!(tokens.lock().len(), WAITING);
        assert_eq!(tokens.lock().get("posed/a/token"), Some(&false));
        for _ in 0..WAITING {
            tokens.next().await;
        }
        tokens.put("posed/b/token", true);
        assert_eq!(tokens.next().await, ("posed/b/token".to_owned(), true));
    }
}
