//! What a live stage and a replay have in common: a server, a thread that feeds it, and an orderly end.

use std::future::Future;
use std::net::SocketAddr;
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinSet;

use super::ports::ended;
use super::server::{MakesWay, Server};
use super::vital::{PartEnded, Vital};
use posed_protocol::Status;

/// Time that the thread has to end, a recording included.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(4);

/// A server that runs, the tasks around it, and the switch that ends them.
pub(super) struct Service {
    address: SocketAddr,
    vrpn_address: Option<SocketAddr>,
    url: String,
    status: watch::Receiver<Status>,
    shutdown: watch::Sender<bool>,
    vital: Vital,
    tasks: JoinSet<()>,
    makes_way: MakesWay,
}

impl Service {
    /// Serves clients. Needs a tokio runtime.
    pub(super) fn start(server: Server) -> Self {
        let (address, vrpn_address, url) = (server.address(), server.vrpn_address(), server.url());
        let (status, makes_way) = (server.status(), server.makes_way());
        let (shutdown, mut down) = watch::channel(false);
        let vital = Vital::new(shutdown.subscribe());
        let mut tasks = JoinSet::new();
        let serving = server.run(async move { ended(&mut down).await }, vital.clone());
        tasks.spawn(vital.task("the server", serving));
        Self { address, vrpn_address, url, status, shutdown, vital, tasks, makes_way }
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    pub(super) fn vrpn_address(&self) -> Option<SocketAddr> {
        self.vrpn_address
    }

    pub(super) fn url(&self) -> &str {
        &self.url
    }

    /// The newest status that clients have been sent: at least one a second while all that it passes through lives; empty before
    /// the first.
    pub(super) fn status(&self) -> watch::Receiver<Status> {
        self.status.clone()
    }

    /// True once everything is to end.
    pub(super) fn down(&self) -> watch::Receiver<bool> {
        self.shutdown.subscribe()
    }

    /// The first part that ended before it was asked to.
    pub(super) fn part_ended(&self) -> watch::Receiver<Option<PartEnded>> {
        self.vital.ended()
    }

    /// The parts whose end is reported.
    pub(super) fn vital(&self) -> &Vital {
        &self.vital
    }

    /// A part that ends when [`Self::down`] says so, and not before.
    pub(super) fn spawn(&mut self, part: impl Into<String>, task: impl Future<Output = ()> + Send + 'static) {
        self.tasks.spawn(self.vital.task(part, task));
    }

    /// A task that may end alone.
    pub(super) fn spawn_aside(&mut self, task: impl Future<Output = ()> + Send + 'static) {
        self.tasks.spawn(task);
    }

    /// Another stage follows at this address: what closes clients' connections reports it.
    pub(super) fn make_way(&self) {
        self.makes_way.set();
    }

    /// Ends the tasks, and waits for them and for the thread, which has been asked to end. Less than five seconds.
    pub(super) async fn shutdown(mut self, thread: JoinHandle<()>) {
        self.shutdown.send_replace(true);
        let joined = tokio::task::spawn_blocking(move || thread.join().is_ok());
        let all = async {
            while self.tasks.join_next().await.is_some() {}
            joined.await
        };
        match tokio::time::timeout(SHUTDOWN_TIMEOUT, all).await {
            Ok(Ok(true)) => {}
            Ok(_) => tracing::error!("the thread behind the server ended with a panic; please report this"),
            Err(_) => tracing::error!(
                "not everything has ended in time; a recording may lack its index: `posed info --repair` adds it"
            ),
        }
    }
}
