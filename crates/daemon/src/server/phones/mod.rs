//! Phones as sensors: the page `/phone`, the websocket `/imu`, and an address of their own over TLS at which there is nothing else.
//!
//! In: connections of phones and other devices that bring measurements. Out: what they say, to the port `websocket` of a device
//! ([`Gate`]). Never: a frame, a request or a recording to who has only the token for sensors; and no address beyond this computer that is
//! listened on before a device of the stage file needs it, or somebody has pressed *Add a phone*.

mod announce;
mod certificate;
mod gate;
mod http;
mod placing;
mod secret;
mod socket;

use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use posed_protocol::{Invitation, Problem, Status};
use posed_stage::{PortAddress, Secret, Server, Stage, Tls};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;

pub use self::certificate::CertificateError;
pub(crate) use self::gate::{Connected, Gate, Reader};
pub(super) use self::http::{TokenIs, routes};
pub(crate) use self::placing::Placing;
pub use self::secret::write as write_secret;

use self::announce::Announced;
use self::certificate::Certificates;
use super::access::Access;
use super::listen::{self, ConnectionContext};
use super::listener::{bind_first, share};
use super::tls::{self, TlsError};
use crate::clock::StageClock;
use crate::ports::ended;

/// Where phones come unless the stage file specifies otherwise.
const LISTEN: &str = "0.0.0.0:8788";
/// How often this computer's addresses are looked at: a certificate is for those that it has.
const LOOK: Duration = Duration::from_secs(20);

/// Why phones cannot come.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PhoneError {
    #[error("phones cannot come: {0}")]
    Certificate(#[from] CertificateError),
    #[error("phones cannot come: {0}")]
    Tls(#[from] TlsError),
    #[error("phones cannot come to {listen}: {error}; choose another address with `phones` in [server]")]
    Bind { listen: String, error: std::io::Error },
    #[error("cannot keep the token for phones: {0}")]
    Token(std::io::Error),
}

/// The address at which phones come, for one daemon after the other: who connects meanwhile waits.
#[derive(Clone, Default)]
pub(crate) struct PhoneSocket(Arc<Mutex<Option<Arc<std::net::TcpListener>>>>);

/// What serves phones; clones share it.
#[derive(Clone)]
pub(crate) struct Phones(Arc<Inner>);

struct Inner {
    stage: String,
    /// Whether a device of the stage reads what they send.
    is_read: bool,
    settings: Server,
    /// Where certificate and token are kept.
    folder: PathBuf,
    /// Where relative paths of the stage file begin.
    stage_folder: PathBuf,
    socket: PhoneSocket,
    clock: StageClock,
    gate: Gate,
    placing: Placing,
    context: Arc<ConnectionContext>,
    status: OnceLock<watch::Receiver<Status>>,
    open: Mutex<Opened>,
}

/// Whether phones can come, or what kept them from it last; `None` before anybody has wanted it.
type Opened = Option<Result<Open, Arc<PhoneError>>>;

/// By which certificate phones know the daemon.
enum Identity {
    /// That of the stage file.
    Files(Tls),
    /// Its own.
    Own(Box<Certificates>),
}

impl Identity {
    fn authority(&self) -> Option<&Certificates> {
        match self {
            Self::Files(_) => None,
            Self::Own(own) => Some(own),
        }
    }
}

/// Phones can come.
struct Open {
    token: Secret,
    host: String,
    /// Where it is listened.
    bound: SocketAddr,
    identity: Identity,
    _announced: Option<Announced>,
}

/// What [`Phones::new`] needs beside the stage.
pub(crate) struct PhonePlace {
    /// Folder of what the daemon keeps.
    pub(crate) data: PathBuf,
    pub(crate) socket: PhoneSocket,
    pub(crate) clock: StageClock,
}

impl Phones {
    pub(super) fn new(
        stage: &Stage,
        place: PhonePlace,
        stage_folder: PathBuf,
        context: &Arc<ConnectionContext>,
    ) -> Self {
        let is_read = stage.devices.iter().any(|device| device.port.parse() == Ok(PortAddress::Websocket));
        let PhonePlace { data, socket, clock } = place;
        Self(Arc::new(Inner {
            stage: stage.name.clone(),
            is_read,
            settings: stage.server.clone(),
            folder: data.join("phones"),
            stage_folder,
            socket,
            clock,
            gate: Gate::default(),
            placing: Placing::new(stage),
            context: Arc::clone(context),
            status: OnceLock::new(),
            open: Mutex::default(),
        }))
    }

    /// From where phones hear what the stage thinks of them.
    pub(super) fn hear_from(&self, status: watch::Receiver<Status>) {
        let _ = self.0.status.set(status);
    }

    /// Lets phones come, where a device of the stage reads what they send.
    pub(super) fn open_if_read(&self) {
        if self.0.is_read {
            // What keeps them from it is among the problems.
            let _ = self.open(|_| ());
        }
    }

    /// Lets phones come; how, to be shown to whoever has one.
    pub(crate) fn invite(&self) -> Result<Invitation, Arc<PhoneError>> {
        self.open(|open| self.invitation(open))
    }

    /// Where connections and the port of a device meet.
    pub(crate) fn gate(&self) -> Gate {
        self.0.gate.clone()
    }

    /// Where the stage has each device.
    pub(crate) fn placing(&self) -> Placing {
        self.0.placing.clone()
    }

    /// What keeps phones from coming, where one should.
    pub(super) fn problem(&self) -> Option<Problem> {
        match &*self.opened() {
            Some(Err(error)) => Some(Problem::new("phones", error.to_string())),
            _ => None,
        }
    }

    /// The token for sensors that the daemon itself has made.
    fn token(&self) -> Option<Secret> {
        match &*self.opened() {
            Some(Ok(open)) => Some(open.token.clone()),
            _ => None,
        }
    }

    /// The certificate that a phone can be set to trust.
    fn authority(&self) -> Option<Vec<u8>> {
        match &*self.opened() {
            Some(Ok(open)) => open.identity.authority().map(|own| own.der().to_vec()),
            _ => None,
        }
    }

    fn status(&self) -> watch::Receiver<Status> {
        let none = || watch::channel(Status::default()).1;
        self.0.status.get().cloned().unwrap_or_else(none)
    }

    fn opened(&self) -> MutexGuard<'_, Opened> {
        // Every change is complete before anything in it could panic.
        self.0.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens it where it is not, then asks of it.
    fn open<T>(&self, ask: impl FnOnce(&Open) -> T) -> Result<T, Arc<PhoneError>> {
        let mut opened = self.opened();
        let before = opened.take().and_then(Result::ok);
        let now = before.map_or_else(|| self.begin().map_err(Arc::new), Ok);
        if let Err(error) = &now {
            tracing::warn!("{error}");
        }
        opened.insert(now).as_ref().map(ask).map_err(Arc::clone)
    }

    /// Binds the address, and serves phones there until the daemon ends.
    fn begin(&self) -> Result<Open, PhoneError> {
        let inner = &self.0;
        let token = secret::token(&inner.folder).map_err(PhoneError::Token)?;
        let identity = match &inner.settings.tls {
            Some(files) => Identity::Files(files.clone()),
            None => Identity::Own(Box::new(Certificates::open(&inner.folder, inner.utc_ns())?)),
        };
        let host = announce::host_name();
        let addresses = reachable();
        let acceptor = inner.acceptor(&identity, &host, &addresses)?;
        let listener = inner.socket.open(inner.settings.phones.as_deref())?;
        let (listener, address) =
            share(&listener).map_err(|error| PhoneError::Bind { listen: LISTEN.to_owned(), error })?;
        let port = address.port();
        // At an address of this computer alone nobody else comes.
        let announced =
            if address.ip().is_loopback() { None } else { announce::announce(&inner.stage, &host, port) };
        let (served, serves) = watch::channel(acceptor);
        self.serve(listener, &host, port, serves);
        if identity.authority().is_some() {
            tokio::spawn(self.clone().renew(served));
        }
        let open = Open { token, host, bound: address, identity, _announced: announced };
        let Invitation { page, fingerprint, .. } = self.invitation(&open);
        let page = page.split('#').next().unwrap_or_default();
        tracing::info!("phones come to {page}; the certificate's fingerprint is {fingerprint}");
        Ok(open)
    }

    fn serve(&self, listener: TcpListener, host: &str, port: u16, serves: watch::Receiver<TlsAcceptor>) {
        let access = Access {
            tokens: self.0.settings.tokens.clone(),
            allowed_origins: self.0.context.access.allowed_origins.clone(),
            listen_host: host.to_owned(),
            port,
            tls: true,
        };
        let context = Arc::new(self.0.context.with_access(access));
        let app = listen_routes(self.clone(), &context);
        let mut down = context.shutdown.clone();
        tokio::spawn(async move {
            let tls = move || Some(serves.borrow().clone());
            tokio::select! {
                () = listen::accept(&listener, tls, &context, app) => {}
                () = ended(&mut down) => {}
            }
        });
    }

    /// A new certificate when the addresses have changed, or the one before grows old.
    #[expect(clippy::disallowed_methods, reason = "the daemon looks on its own clock")]
    async fn renew(self, served: watch::Sender<TlsAcceptor>) {
        let mut down = self.0.context.shutdown.clone();
        let mut made = (reachable(), self.0.utc_ns());
        let old_ns = (certificate::LEAF_DAYS / 2) * 86_400_000_000_000;
        loop {
            tokio::select! {
                () = ended(&mut down) => return,
                () = tokio::time::sleep(LOOK) => {}
            }
            let now = (reachable(), self.0.utc_ns());
            if now.0 == made.0 && now.1 - made.1 < old_ns {
                continue;
            }
            let opened = self.opened();
            let Some(Ok(open)) = &*opened else { return };
            if let Ok(acceptor) = self.0.acceptor(&open.identity, &open.host, &now.0) {
                served.send_replace(acceptor);
                made = now;
            }
        }
    }

    fn invitation(&self, open: &Open) -> Invitation {
        let written = |address: IpAddr| match address {
            IpAddr::V4(address) => address.to_string(),
            IpAddr::V6(address) => format!("[{address}]"),
        };
        // The certificate is for no public address.
        let (private, public): (Vec<IpAddr>, Vec<IpAddr>) =
            served_at(open.bound).into_iter().partition(|address| certificate::is_private(*address));
        let hosts = private.into_iter().map(written).chain(std::iter::once(open.host.clone()));
        let hosts = hosts.chain(public.into_iter().map(written));
        let page =
            |host: String| format!("https://{host}:{}/phone#k={}", open.bound.port(), open.token.reveal());
        let mut pages: Vec<String> = hosts.map(page).collect();
        let page = pages.remove(0);
        Invitation {
            qr: qr(&page),
            page,
            others: pages,
            authority: open.identity.authority().map(|own| own.name().to_owned()),
            fingerprint: open.identity.authority().map(Certificates::fingerprint).unwrap_or_default(),
        }
    }
}

/// What is answered where phones come, and nothing else.
fn listen_routes(phones: Phones, context: &Arc<ConnectionContext>) -> axum::Router {
    let routes = routes(phones, context, TokenIs::Needed)
        .route("/", axum::routing::get(async || axum::response::Redirect::temporary("/phone")))
        .route("/assets/{name}", axum::routing::get(super::http::asset));
    super::http::guarded(routes, Arc::clone(context))
}

impl Inner {
    fn utc_ns(&self) -> i64 {
        self.clock.epoch_utc_ns().saturating_add(self.clock.now().as_nanos())
    }

    fn acceptor(
        &self,
        identity: &Identity,
        host: &str,
        addresses: &[IpAddr],
    ) -> Result<TlsAcceptor, PhoneError> {
        match identity {
            Identity::Files(files) => Ok(tls::acceptor(files, &self.stage_folder)?),
            Identity::Own(own) => {
                let names = [host.to_owned(), "localhost".to_owned()];
                let loopback = [IpAddr::from([127, 0, 0, 1])];
                Ok(own.acceptor(&names, &[addresses, &loopback].concat(), self.utc_ns())?)
            }
        }
    }
}

impl PhoneSocket {
    /// The socket that is open, or a new one. Where nobody has chosen the port, another one serves as well.
    fn open(&self, chosen: Option<&str>) -> Result<Arc<std::net::TcpListener>, PhoneError> {
        let mut socket = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open) = &*socket {
            return Ok(Arc::clone(open));
        }
        let listen = chosen.unwrap_or(LISTEN);
        let bind = |listen: &str| {
            let addresses: Vec<SocketAddr> = listen.to_socket_addrs()?.collect();
            bind_first(&addresses)?.0.into_std()
        };
        let bound = bind(listen).or_else(|error| match chosen {
            Some(_) => Err(error),
            None => bind("0.0.0.0:0"),
        });
        let bound = bound.map_err(|error| PhoneError::Bind { listen: listen.to_owned(), error })?;
        Ok(Arc::clone(socket.insert(Arc::new(bound))))
    }
}

/// Addresses of this computer that others may reach, those that a certificate can be for first, IPv4 before IPv6; link-local ones lead
/// nowhere without their scope.
fn reachable() -> Vec<IpAddr> {
    let mut all: Vec<IpAddr> = if_addrs::get_if_addrs()
        .unwrap_or_default()
        .into_iter()
        .filter(|interface| !interface.is_loopback() && !interface.is_link_local())
        .map(|interface| interface.ip())
        .collect();
    all.sort_by_key(|address| (!certificate::is_private(*address), address.is_ipv6(), *address));
    all.dedup();
    all
}

/// Addresses by which phones reach a socket; at one of this computer alone nobody else comes.
fn served_at(bound: SocketAddr) -> Vec<IpAddr> {
    if !bound.ip().is_unspecified() {
        return vec![bound.ip()];
    }
    reachable().into_iter().filter(|address| bound.is_ipv6() || address.is_ipv4()).collect()
}

/// A text as a QR code: a path of squares, and how many there are side by side.
fn qr(text: &str) -> posed_protocol::QrCode {
    use std::fmt::Write;
    let Ok(code) = qrcode::QrCode::with_error_correction_level(text, qrcode::EcLevel::L) else {
        return posed_protocol::QrCode::default();
    };
    let width = code.width();
    let mut path = String::new();
    for (at, color) in code.to_colors().into_iter().enumerate() {
        if color == qrcode::Color::Dark {
            let _ = write!(path, "M{} {}h1v1h-1z", at % width, at / width);
        }
    }
    posed_protocol::QrCode { width, path }
}
