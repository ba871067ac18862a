//! From the listening socket to an HTTP connection: limits on how many there are and how long a greeting takes.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Extension;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::timeout;
use tokio_rustls::{TlsAcceptor, rustls};

use super::access::Access;
use super::budget::Metered;
use super::metrics::Metrics;
use super::outbox::{Close, Outboxes};
use super::slots::{Slot, Slots};
use posed_stage::Limits;

/// Longest request head, in bytes.
const HEAD_BYTES: usize = 16 * 1024;
/// A plain HTTP answer of which nothing was taken for longer than this has nobody reading it.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);

/// What every connection needs, whichever stage it looks at.
pub(super) struct ConnectionContext {
    pub(super) access: Access,
    pub(super) limits: Limits,
    pub(super) metrics: Arc<Metrics>,
    pub(super) slots: Slots,
    pub(super) outboxes: Outboxes,
    pub(super) shutdown: watch::Receiver<bool>,
    pub(super) makes_way: MakesWay,
}

/// Whether another stage follows at this address; clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct MakesWay(Arc<AtomicBool>);

impl MakesWay {
    pub(crate) fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// What the connections of clients are closed with.
    pub(super) fn goodbye(&self) -> Close {
        if self.0.load(Ordering::Relaxed) { Close::RESTART } else { Close::SHUTDOWN }
    }
}

impl ConnectionContext {
    /// The same for connections that come another way.
    pub(super) fn with_access(&self, access: Access) -> Self {
        Self { access, ..self.until(self.shutdown.clone()) }
    }

    /// The same for connections that end by a word of their own.
    pub(super) fn until(&self, shutdown: watch::Receiver<bool>) -> Self {
        let Self { access, limits, metrics, slots, outboxes, shutdown: _, makes_way } = self;
        Self {
            access: access.clone(),
            limits: limits.clone(),
            metrics: Arc::clone(metrics),
            slots: slots.clone(),
            outboxes: outboxes.clone(),
            shutdown,
            makes_way: makes_way.clone(),
        }
    }
}

/// A time of the limits.
pub(super) fn seconds(s: f64) -> Duration {
    Duration::from_secs_f64(s)
}

/// Where a connection comes from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peer(pub(super) SocketAddr);

/// Accepts connections for ever; `tls` gives what serves them as they come, where it is over TLS.
pub(super) async fn accept(
    listener: &TcpListener,
    tls: impl Fn() -> Option<TlsAcceptor>,
    context: &Arc<ConnectionContext>,
    app: axum::Router,
) {
    loop {
        let (stream, address) = next(listener).await;
        let Some(slot) = context.slots.wait(address.ip()).map(Arc::new) else {
            context.metrics.refuse("rate");
            drop(stream);
            // Who comes in hundreds must not keep the others waiting until all of them are gone.
            tokio::task::yield_now().await;
            continue;
        };
        let app = app.clone().layer(Extension(Arc::clone(&slot))).layer(Extension(Peer(address)));
        let context = Arc::clone(context);
        let tls = tls();
        tokio::spawn(async move {
            let served = async {
                match tls {
                    None => serve(stream, app, &context, &slot).await,
                    Some(tls) => {
                        match timeout(seconds(context.limits.greeting_timeout_s), tls.accept(stream)).await {
                            Ok(Ok(stream)) => serve(stream, app, &context, &slot).await,
                            Ok(Err(error)) => {
                                if !is_leave(&error) {
                                    slot.breach();
                                }
                                context.metrics.refuse("tls");
                            }
                            Err(_) => context.metrics.refuse("timeout"),
                        }
                    }
                }
            };
            tokio::select! {
                () = served => {}
                () = slot.given_up() => context.metrics.refuse("limit"),
            }
        });
    }
}

/// Whether a handshake has ended because the other side left it: browsers do at a certificate that they do not know, and come again once
/// somebody lets them go on.
fn is_leave(error: &std::io::Error) -> bool {
    let inner = error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>());
    matches!(inner, Some(rustls::Error::AlertReceived(_)))
        || matches!(error.kind(), ErrorKind::UnexpectedEof | ErrorKind::ConnectionReset)
}

/// The next connection, which hands over what is written without waiting for more.
pub(super) async fn next(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok((stream, address)) => {
                // A frame must not wait for the acknowledgement of the one before it.
                if let Err(error) = stream.set_nodelay(true) {
                    tracing::debug!(%error, "TCP_NODELAY");
                }
                return (stream, address);
            }
            Err(error)
                if matches!(error.kind(), ErrorKind::ConnectionAborted | ErrorKind::ConnectionReset) => {}
            Err(error) => {
                // Out of descriptors, most likely: connections end, and then it goes on.
                tracing::warn!(%error, "cannot accept connections for a moment");
                let _ = timeout(Duration::from_millis(100), std::future::pending::<()>()).await;
            }
        }
    }
}

/// One request per connection (every answer says `Connection: close`); a websocket goes on in a task of its own.
async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    app: axum::Router,
    context: &ConnectionContext,
    slot: &Arc<Slot>,
) {
    let greeting = seconds(context.limits.greeting_timeout_s);
    let stream = Metered::new(stream, &context.limits, Arc::clone(slot));
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(greeting)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(app))
        .with_upgrades();
    let mut connection = pin!(connection);
    let (mut patience, mut moved) = (greeting + ANSWER_TIMEOUT, slot.moved());
    let served = loop {
        let served = timeout(patience, connection.as_mut()).await;
        if served.is_ok() || slot.moved() == moved {
            break served;
        }
        // A large file takes as long as its way does.
        (patience, moved) = (ANSWER_TIMEOUT, slot.moved());
    };
    match served {
        Ok(Ok(())) => {}
        Ok(Err(error)) if error.is_timeout() => context.metrics.refuse("timeout"),
        Ok(Err(error)) => {
            if error.is_parse() {
                slot.breach();
            }
            tracing::trace!(%error, "connection");
        }
        Err(_) => context.metrics.refuse("timeout"),
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    use super::super::testing::context;
    use super::*;

    /// A request whose head has so many bytes.
    fn request(head_bytes: usize) -> String {
        let begin = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nA: ";
        let end = "\r\n\r\n";
        format!("{begin}{}{end}", "b".repeat(head_bytes - begin.len() - end.len()))
    }

    async fn answer(mut connection: DuplexStream, rest: &str) -> String {
        connection.write_all(rest.as_bytes()).await.unwrap();
        let mut answer = String::new();
        connection.read_to_string(&mut answer).await.unwrap();
        answer.lines().next().unwrap_or_default().to_owned()
    }

    #[tokio::test]
    async fn a_head_beyond_what_is_read_ends_its_connection_and_no_other() {
        let context = context(&Limits::default());
        let connect = |address: &str| {
            let slot = Arc::new(context.slots.wait(address.parse().unwrap()).unwrap());
            let (near, far) = duplex(4 * HEAD_BYTES);
            let context = Arc::clone(&context);
            tokio::spawn(async move { serve(far, axum::Router::new(), &context, &slot).await });
            near
        };
        // Another one is at its own head meanwhile, and there is nothing at the end of its way.
        let (mut other, head) = (connect("192.0.2.2"), request(HEAD_BYTES - 100));
        other.write_all(&head.as_bytes()[..100]).await.unwrap();
        let refused = answer(connect("192.0.2.1"), &request(HEAD_BYTES + 100)).await;
        assert_eq!(refused, "HTTP/1.1 431 Request Header Fields Too Large");
        assert_eq!(answer(other, &head[100..]).await, "HTTP/1.1 404 Not Found");
    }
}
