//! What the operating system allows this process, raised to what it may have.

use rustix::process::{Resource, Rlimit, Signal, getrlimit, setrlimit};
use tokio::signal::unix::{SignalKind, signal};

/// Lets the daemon have as many descriptors as it may, and survive a limit on the size of files; needs a tokio
/// runtime. What the system refuses stays as it was.
pub(super) fn raise() {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum
        && let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })
    {
        tracing::debug!(%error, "the number of open files stays as it was");
    }
    // A recording that grows too large must fail with a sentence; the signal would end the whole daemon.
    // Once heard, it is heard for the life of the process.
    if let Err(error) = signal(SignalKind::from_raw(Signal::XFSZ.as_raw())) {
        tracing::debug!(%error, "a limit on the size of files will end the daemon");
    }
}
