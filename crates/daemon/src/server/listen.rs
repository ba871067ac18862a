//! From the listening socket to an HTTP connection: limits on how many there are and how long a greeting takes.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::Extension;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;

use super::Limits;
use super::access::Access;
use super::metrics::Metrics;

/// Longest request head, in bytes.
const HEAD_BYTES: usize = 16 * 1024;
/// Connections that are reported at a time why they are refused; more are just closed.
const REFUSALS: usize = 32;
/// A plain HTTP answer that takes longer than this has nobody reading it.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);

/// What every connection needs, whichever stage it looks at.
pub(super) struct ConnectionContext {
    pub(super) access: Access,
    pub(super) limits: Limits,
    pub(super) metrics: Arc<Metrics>,
    pub(super) slots: Slots,
    pub(super) shutdown: watch::Receiver<bool>,
}

/// Accepts connections for ever.
pub(super) async fn accept(
    listener: &TcpListener,
    tls: Option<&TlsAcceptor>,
    context: &Arc<ConnectionContext>,
    app: axum::Router,
) {
    let refusals = Arc::new(tokio::sync::Semaphore::new(REFUSALS));
    loop {
        let (stream, address) = next(listener).await;
        let slot = match context.slots.take(address.ip()) {
            Ok(slot) => slot,
            Err(reason) => {
                context.metrics.refuse("limit");
                if let Ok(permit) = Arc::clone(&refusals).try_acquire_owned() {
                    let plain = tls.is_none();
                    tokio::spawn(async move {
                        if plain {
                            let _ =
                                timeout(Duration::from_secs(1), refuse(stream, &reason.to_string())).await;
                        }
                        drop(permit);
                    });
                }
                continue;
            }
        };
        let slot = Arc::new(slot);
        let app = app.clone().layer(Extension(Arc::clone(&slot)));
        let context = Arc::clone(context);
        let tls = tls.cloned();
        tokio::spawn(async move {
            match tls {
                None => serve(stream, app, &context).await,
                Some(tls) => match timeout(context.limits.greeting_timeout, tls.accept(stream)).await {
                    Ok(Ok(stream)) => serve(stream, app, &context).await,
                    Ok(Err(_)) => context.metrics.refuse("tls"),
                    Err(_) => context.metrics.refuse("timeout"),
                },
            }
            drop(slot);
        });
    }
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
) {
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(context.limits.greeting_timeout)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(app))
        .with_upgrades();
    match timeout(context.limits.greeting_timeout + ANSWER_TIMEOUT, connection).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) if error.is_timeout() => context.metrics.refuse("timeout"),
        Ok(Err(error)) => tracing::trace!(%error, "connection"),
        Err(_) => context.metrics.refuse("timeout"),
    }
}

/// Tells a client over the limit so, after it has said what it wants: closing earlier would reset the connection
/// under the answer.
async fn refuse(mut stream: TcpStream, reason: &str) -> std::io::Result<()> {
    let mut head = [0; 1024];
    let mut seen = Vec::new();
    while !seen.windows(4).any(|end| end == b"\r\n\r\n") && seen.len() < HEAD_BYTES {
        let read = stream.read(&mut head).await?;
        if read == 0 {
            break;
        }
        seen.extend_from_slice(&head[..read]);
    }
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain\r\nContent-Length: {}\r\nRetry-After: 5\r\n\
         Connection: close\r\n\r\n{reason}",
        reason.len()
    );
    stream.write_all(answer.as_bytes()).await?;
    stream.shutdown().await
}

/// How many connections there may be, in all and from one address; clones count together.
#[derive(Clone, Debug)]
pub(super) struct Slots {
    total: usize,
    per_address: usize,
    taken: Arc<Taken>,
}

#[derive(Debug, Default)]
struct Taken {
    count: Mutex<(usize, BTreeMap<IpAddr, usize>)>,
    freed: Notify,
}

/// Why a connection gets no place; the sentences are answers.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum NoSlot {
    #[error("this daemon serves {0} connections at most; try again later\n")]
    Total(usize),
    #[error("this daemon serves {0} connections of one address at most; try again later\n")]
    PerAddress(usize),
}

/// A connection's place; freed when dropped.
#[derive(Debug)]
pub(super) struct Slot {
    address: IpAddr,
    taken: Arc<Taken>,
}

impl Slots {
    pub(super) fn new(total: usize, per_address: usize) -> Self {
        Self { total, per_address, taken: Arc::default() }
    }

    /// A place, or why there is none.
    pub(super) fn take(&self, address: IpAddr) -> Result<Slot, NoSlot> {
        let mut count = self.taken.lock();
        let (total, by_address) = &mut *count;
        if *total >= self.total {
            return Err(NoSlot::Total(self.total));
        }
        let of_address = by_address.entry(address).or_insert(0);
        if *of_address >= self.per_address {
            return Err(NoSlot::PerAddress(self.per_address));
        }
        *of_address += 1;
        *total += 1;
        Ok(Slot { address, taken: Arc::clone(&self.taken) })
    }

    /// Waits until no connection is left.
    pub(super) async fn all_free(&self) {
        loop {
            let freed = self.taken.freed.notified();
            if self.taken.lock().0 == 0 {
                return;
            }
            freed.await;
        }
    }
}

impl Taken {
    fn lock(&self) -> MutexGuard<'_, (usize, BTreeMap<IpAddr, usize>)> {
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut count = self.taken.lock();
        count.0 -= 1;
        if let Some(of_address) = count.1.get_mut(&self.address) {
            *of_address -= 1;
            if *of_address == 0 {
                count.1.remove(&self.address);
            }
        }
        drop(count);
        self.taken.freed.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_in_all_and_per_address() {
        let [one, two]: [IpAddr; 2] = [[127, 0, 0, 1].into(), [127, 0, 0, 2].into()];
        let slots = Slots::new(3, 2);
        let first = slots.take(one).unwrap();
        let _second = slots.take(one).unwrap();
        assert!(matches!(slots.take(one), Err(NoSlot::PerAddress(_))));
        let _third = slots.take(two).unwrap();
        assert!(matches!(slots.take(two), Err(NoSlot::Total(3))));
        drop(first);
        assert!(slots.take(one).is_ok());
    }
}
