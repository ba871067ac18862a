//! What ends a command that runs until it is asked to: Ctrl-C, SIGTERM, or its time.

use std::time::Duration;

use tokio::signal::unix::{Signal, SignalKind, signal};

use super::Error;

/// Waits for the end; needs a tokio runtime.
pub(crate) struct End {
    interrupt: Signal,
    terminate: Signal,
    timer: Option<tokio::time::Interval>,
}

impl End {
    /// Listens from now on.
    pub(crate) fn new(duration_s: Option<f64>) -> Result<Self, Error> {
        let listen =
            |kind| signal(kind).map_err(|error| Error::Failed(format!("cannot hear signals: {error}")));
        let timer = duration_s.map(|seconds| {
            let mut timer = tokio::time::interval(Duration::from_secs_f64(seconds));
            timer.reset();
            timer
        });
        Ok(Self {
            interrupt: listen(SignalKind::interrupt())?,
            terminate: listen(SignalKind::terminate())?,
            timer,
        })
    }

    /// May be cancelled and called again.
    pub(crate) async fn wait(&mut self) {
        let time_is_up = async {
            match &mut self.timer {
                Some(timer) => timer.tick().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = time_is_up => {}
        }
    }
}
