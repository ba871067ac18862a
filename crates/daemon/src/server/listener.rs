//! The way into a server: the bound socket, until it lets connections in.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpSocket};
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;

use super::access::Access;
use super::listen::{self, ConnectionContext, MakesWay};
use super::metrics::Metrics;
use super::outbox::Outboxes;
use super::slots::Slots;
use super::{BindError, DEFAULT_LISTEN, tls};

/// Time that all clients have for their goodbye.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(3);

/// A bound socket that nobody is let in by yet.
pub(super) struct Listener {
    listener: TcpListener,
    address: SocketAddr,
    tls: Option<TlsAcceptor>,
    pub(super) report: watch::Sender<bool>,
    pub(super) context: Arc<ConnectionContext>,
}

impl Listener {
    /// Binds the address of the settings, or `listen` in its place; relative paths begin at `folder`.
    /// A `socket` that is given is open there already.
    pub(super) fn open(
        settings: &posed_stage::Server,
        listen: Option<String>,
        socket: Option<&std::net::TcpListener>,
        folder: &Path,
    ) -> Result<Self, BindError> {
        let (listen, addresses) = addresses(settings, listen)?;
        let tls = settings.tls.as_ref().map(|files| tls::acceptor(files, folder)).transpose()?;
        let bound = match socket {
            Some(socket) => share(socket),
            None => bind_first(&addresses),
        };
        let (listener, address) = bound.map_err(|error| BindError::Bind { listen: listen.clone(), error })?;
        let (report, shutdown) = watch::channel(false);
        let access = Access {
            tokens: settings.tokens.clone(),
            allowed_origins: settings.allowed_origins.iter().map(|o| o.to_ascii_lowercase()).collect(),
            listen_host: listen.rsplit_once(':').map_or("", |(host, _)| host).to_owned(),
            port: address.port(),
            tls: tls.is_some(),
        };
        let limits = settings.limits.clone();
        let (slots, outboxes) = (Slots::new(&limits), Outboxes::new(&limits));
        let context = ConnectionContext {
            access,
            limits,
            metrics: Arc::new(Metrics::new()),
            slots,
            outboxes,
            shutdown,
            makes_way: MakesWay::default(),
        };
        Ok(Self { listener, address, tls, report, context: Arc::new(context) })
    }

    /// The address it listens on.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to open in a browser.
    pub(super) fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        let mut address = self.address;
        if address.ip().is_unspecified() {
            address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
        }
        format!("{scheme}://{address}/")
    }

    /// Lets connections in until `shutdown` resolves; then tells everybody so and waits until they have left, or the
    /// shutdown timeout.
    pub(super) async fn serve(self, app: axum::Router, shutdown: impl Future<Output = ()>) {
        let Self { listener, tls, report, context, .. } = self;
        tokio::select! {
            () = listen::accept(&listener, || tls.clone(), &context, app) => {}
            () = shutdown => {}
        }
        drop(listener);
        report.send_replace(true);
        let _ = tokio::time::timeout(SHUTDOWN_TIMEOUT, context.slots.all_free()).await;
    }
}

/// An open socket for one daemon after the other: who connects meanwhile waits.
pub(crate) struct Socket {
    pub(crate) listener: Arc<std::net::TcpListener>,
    /// The address as it was given.
    pub(crate) listen: String,
}

/// Binds the address of the settings, or `listen` in its place. Inside a tokio runtime.
pub(crate) fn socket(settings: &posed_stage::Server, listen: Option<String>) -> Result<Socket, BindError> {
    let (listen, addresses) = addresses(settings, listen)?;
    let bound = bind_first(&addresses).and_then(|(listener, _)| listener.into_std());
    match bound {
        Ok(listener) => Ok(Socket { listener: Arc::new(listener), listen }),
        Err(error) => Err(BindError::Bind { listen, error }),
    }
}

/// Where to listen, as it is written and as addresses.
fn addresses(
    settings: &posed_stage::Server,
    listen: Option<String>,
) -> Result<(String, Vec<SocketAddr>), BindError> {
    let listen = listen.or_else(|| settings.listen.clone()).unwrap_or_else(|| DEFAULT_LISTEN.into());
    let addresses: Vec<SocketAddr> = match listen.to_socket_addrs() {
        Ok(addresses) => addresses.collect(),
        Err(error) => return Err(BindError::Address { listen, error }),
    };
    let open = addresses.iter().any(|address| !address.ip().is_loopback());
    if open && settings.tokens.is_empty() {
        return Err(BindError::NeedsToken { listen });
    }
    Ok((listen, addresses))
}

pub(super) fn share(socket: &std::net::TcpListener) -> std::io::Result<(TcpListener, SocketAddr)> {
    let listener = TcpListener::from_std(socket.try_clone()?)?;
    let address = listener.local_addr()?;
    Ok((listener, address))
}

pub(super) fn bind_first(addresses: &[SocketAddr]) -> std::io::Result<(TcpListener, SocketAddr)> {
    let mut refused = std::io::Error::other("the name has no address");
    for &address in addresses {
        match bind(address) {
            Ok(bound) => return Ok(bound),
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

fn bind(address: SocketAddr) -> std::io::Result<(TcpListener, SocketAddr)> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?;
    // Inherited by each connection: what the kernel holds for a client that stalls is soon old, and bounded by this.
    socket.set_send_buffer_size(256 * 1024)?;
    socket.bind(address)?;
    let listener = socket.listen(1024)?;
    let address = listener.local_addr()?;
    Ok((listener, address))
}
