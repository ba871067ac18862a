//! Parts without which the daemon serves nobody, and the word that one of them is gone.
//!
//! What comes in: tasks and threads that are to last until the daemon is asked to end. What goes out: which of them ended before,
//! by a panic or by itself. What it never does: start a part again. Whoever runs the daemon ends it with an error, and a service
//! manager starts it anew in a second, from a state that holds together.
//!
//! What becomes of each part that panics:
//!
//! | part | what happens |
//! |---|---|
//! | the pipeline | goes on without the entry, or from the beginning ([`posed_pipeline::SupervisedPipeline`]); a problem in `status` |
//! | a device's port | begins again, as after an unplugged cable; the device's state says so |
//! | what reads time code | begins again likewise; a problem in `status` |
//! | a request | is answered with an error; the others go on |
//! | a job, a recording | ends with a reason; the others go on |
//! | what keeps sessions of training | goes on without the report that it panicked at |
//! | a client's connection | ends; the others go on |
//! | what feeds LSL or zenoh | ends; a problem in `status` |
//! | tracking around the pipeline, the server, what sends to clients, what serves VRPN, what answers requests | the program ends with its name and exit code 1 |

use std::future::Future;

use tokio::sync::watch;

/// A part ended that was to last.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{part} ended by itself; the log says why above, please report it")]
pub struct PartEnded {
    /// What it was, like `tracking`.
    pub part: String,
}

/// The parts of one daemon; clones share them.
#[derive(Clone, Debug)]
pub struct Vital {
    ended: watch::Sender<Option<PartEnded>>,
    /// True once everything is to end.
    down: watch::Receiver<bool>,
}

/// Parts of what nobody asks to end.
impl Default for Vital {
    fn default() -> Self {
        Self::new(watch::channel(false).1)
    }
}

impl Vital {
    /// Parts that are to last until `down` is true.
    pub fn new(down: watch::Receiver<bool>) -> Self {
        Self { ended: watch::channel(None).0, down }
    }

    /// The first part that ended too early, once there is one.
    pub fn ended(&self) -> watch::Receiver<Option<PartEnded>> {
        self.ended.subscribe()
    }

    /// A task whose end is reported, unless everything is to end.
    pub fn task(
        &self,
        part: impl Into<String>,
        task: impl Future<Output = ()> + Send + 'static,
    ) -> impl Future<Output = ()> + Send + 'static {
        let watched = self.watched(part);
        async move {
            task.await;
            drop(watched);
        }
    }

    /// What a thread runs, with its end reported likewise.
    pub fn thread(
        &self,
        part: impl Into<String>,
        run: impl FnOnce() + Send + 'static,
    ) -> impl FnOnce() + Send + 'static {
        let watched = self.watched(part);
        move || {
            run();
            drop(watched);
        }
    }

    fn watched(&self, part: impl Into<String>) -> Watched {
        Watched { part: part.into(), vital: self.clone() }
    }
}

/// Dropped when its part ends, however that comes.
struct Watched {
    part: String,
    vital: Vital,
}

impl Drop for Watched {
    fn drop(&mut self) {
        if *self.vital.down.borrow() {
            return;
        }
        let part = std::mem::take(&mut self.part);
        self.vital.ended.send_if_modified(|first| {
            if first.is_some() {
                return false;
            }
            *first = Some(PartEnded { part });
            true
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_part_that_panics_or_ends_is_named_and_an_orderly_end_is_not() {
        for panics in [true, false] {
            let (_down, is_down) = watch::channel(false);
            let vital = Vital::new(is_down);
            let task = vital.task("port of flock", async move { assert!(!panics, "a test's own panic") });
            assert_eq!(tokio::spawn(task).await.is_err(), panics);
            let ended = vital.ended().borrow().clone();
            assert_eq!(ended.map(|ended| ended.part).as_deref(), Some("port of flock"));
        }
        let (down, is_down) = watch::channel(false);
        let vital = Vital::new(is_down);
        let (task, thread) = (vital.task("clients", async {}), vital.thread("tracking", || {}));
        down.send_replace(true);
        task.await;
        thread();
        assert_eq!(*vital.ended().borrow(), None);
    }

    #[test]
    fn the_first_of_several_is_told() {
        let (_down, is_down) = watch::channel(false);
        let vital = Vital::new(is_down);
        let panicking = vital.thread("tracking", || panic!("a test's own panic"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(panicking)).is_err());
        vital.thread("clients", || {})();
        let ended = vital.ended().borrow().clone();
        assert!(ended.is_some_and(|ended| ended.to_string().starts_with("tracking ended by itself")));
    }
}
