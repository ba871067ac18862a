//! VRPN clients: accepted or called back, greeted, sent every frame, answered.
//!
//! In: frames and outcomes from the distributor's task, connections and datagrams from sockets. Out: messages of [`posed_protocol::vrpn`]. Never: a wait for a
//! client. Each frame is serialised once; a client that does not read loses the oldest frames, and its connection in the end.

use std::collections::{BTreeMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{Notify, watch};
use tokio::time::timeout;

use super::budget::Metered;
use super::hub::Item;
use super::listen;
use super::listener::bind_first;
use super::metrics::Metrics;
use super::slots::{Slot, Slots};
use crate::ports::ended;
use posed_drivers::vrpn::wire::{self, Refused};
use posed_protocol::vrpn::{Catalogue, Peer, Publisher};
use posed_stage::Limits;

/// Where it listens unless the stage file specifies otherwise.
const DEFAULT_LISTEN: &str = "127.0.0.1:3883";
/// Time for a client's greeting, and for calling it back.
const GREETING_TIMEOUT: Duration = Duration::from_secs(2);
/// A client that has not read for so long is gone.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);
/// Calls back that are under way at a time, and those of them that go to one address: one that asks for many locks nobody out.
const CALLS: usize = 16;
const CALLS_PER_ADDRESS: usize = 4;
/// Longest datagram that asks for a call.
const MAX_REQUEST: usize = 199;

/// A bound VRPN server that does not run yet.
pub(super) struct Vrpn {
    tcp: TcpListener,
    udp: UdpSocket,
    shared: Arc<Shared>,
    slots: Slots,
    metrics: Arc<Metrics>,
    /// Whether computers other than this one may ask to be called.
    call_back: bool,
}

/// What the connections share.
struct Shared {
    catalogue: Arc<Catalogue>,
    clients: Mutex<Vec<Arc<Waiting>>>,
    limits: Limits,
}

/// The frames that wait for one client.
#[derive(Default)]
struct Waiting {
    frames: Mutex<VecDeque<Arc<[u8]>>>,
    filled: Notify,
}

/// Where frames go in.
pub(super) struct Outlet {
    publisher: Publisher,
    shared: Arc<Shared>,
    metrics: Arc<Metrics>,
    scratch: Vec<u8>,
}

impl Vrpn {
    /// Binds both ports and returns where frames go in.
    pub(super) fn bind(
        settings: &posed_stage::Vrpn,
        publisher: Publisher,
        limits: &Limits,
        metrics: Arc<Metrics>,
    ) -> Result<(Self, Outlet), (String, std::io::Error)> {
        let listen = settings.listen.as_deref().unwrap_or(DEFAULT_LISTEN);
        let bind = || {
            let addresses: Vec<SocketAddr> = std::net::ToSocketAddrs::to_socket_addrs(listen)?.collect();
            let (tcp, address) = bind_first(&addresses)?;
            let udp = std::net::UdpSocket::bind(address)?;
            udp.set_nonblocking(true)?;
            Ok((tcp, UdpSocket::from_std(udp)?))
        };
        let (tcp, udp) = bind().map_err(|error| (listen.to_owned(), error))?;
        let shared = Arc::new(Shared {
            catalogue: publisher.catalogue(),
            clients: Mutex::default(),
            limits: limits.clone(),
        });
        let outlet = Outlet {
            publisher,
            shared: Arc::clone(&shared),
            metrics: Arc::clone(&metrics),
            scratch: Vec::new(),
        };
        let slots = Slots::new(limits);
        Ok((Self { tcp, udp, shared, slots, metrics, call_back: settings.call_back }, outlet))
    }

    /// The address it listens on, with TCP and UDP.
    pub(super) fn address(&self) -> std::io::Result<SocketAddr> {
        self.tcp.local_addr()
    }

    /// Serves until `down` says so.
    pub(super) async fn run(self, down: watch::Receiver<bool>) {
        let mut end = down.clone();
        tokio::select! {
            () = self.accept(&down) => {}
            () = self.call_back(&down) => {}
            () = ended(&mut end) => {}
        }
        // Their tasks see it by themselves.
        let _ = timeout(GREETING_TIMEOUT, self.slots.all_free()).await;
    }

    /// Takes the connections of clients that come.
    async fn accept(&self, down: &watch::Receiver<bool>) {
        loop {
            let (stream, address) = listen::next(&self.tcp).await;
            if let Some(connection) = self.connection(address.ip()) {
                tokio::spawn(connection.serve(stream, down.clone()));
            }
        }
    }

    /// Connects to the clients that ask for it by a datagram: to where it came from, not to the host that it names.
    async fn call_back(&self, down: &watch::Receiver<bool>) {
        let calls = Calls::default();
        let mut datagram = [0; MAX_REQUEST + 1];
        loop {
            let Ok((length, source)) = self.udp.recv_from(&mut datagram).await else {
                let _ = timeout(Duration::from_millis(100), std::future::pending::<()>()).await;
                continue;
            };
            let Some(port) = requested_port(&datagram[..length]) else {
                self.metrics.refuse("vrpn");
                continue;
            };
            let here = source.ip().to_canonical().is_loopback();
            if !here && !self.call_back {
                self.metrics.refuse("vrpn");
                continue;
            }
            let target = SocketAddr::new(source.ip(), port);
            // It asks again and again until it is connected.
            let Some(call) = calls.begin(target) else { continue };
            let Some(connection) = self.connection(source.ip()) else { continue };
            let down = down.clone();
            tokio::spawn(async move {
                let called = timeout(GREETING_TIMEOUT, TcpStream::connect(target)).await;
                call.settled();
                if let Ok(Ok(stream)) = called {
                    let _ = stream.set_nodelay(true);
                    connection.serve(stream, down).await;
                }
                drop(call);
            });
        }
    }

    fn connection(&self, address: IpAddr) -> Option<Connection> {
        let Some(slot) = self.slots.wait(address) else {
            self.metrics.refuse("rate");
            return None;
        };
        if slot.enter().is_err() {
            self.metrics.refuse("limit");
            return None;
        }
        Some(Connection {
            shared: Arc::clone(&self.shared),
            metrics: Arc::clone(&self.metrics),
            slot: Arc::new(slot),
        })
    }
}

impl Outlet {
    /// Tells all clients, if it is something to them.
    pub(super) fn publish(&mut self, item: &Item) {
        let clients = self.shared.clients();
        if clients.is_empty() {
            return;
        }
        self.scratch.clear();
        match item {
            Item::Estimate(estimate) => self.publisher.frame(estimate, &mut self.scratch),
            Item::Outcome(outcome) => self.publisher.outcome(outcome, &mut self.scratch),
            _ => return,
        }
        if self.scratch.is_empty() {
            return;
        }
        let bytes: Arc<[u8]> = self.scratch.as_slice().into();
        for client in clients.iter() {
            let dropped = client.push(Arc::clone(&bytes), self.shared.limits.latest_messages);
            self.metrics.vrpn_dropped.inc_by(u64::from(dropped));
        }
    }
}

impl Shared {
    fn clients(&self) -> MutexGuard<'_, Vec<Arc<Waiting>>> {
        // Every change is complete before anything in it could panic.
        self.clients.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    /// Queues a frame; the oldest one gives way. Whether it did.
    fn push(&self, bytes: Arc<[u8]>, latest: usize) -> bool {
        let mut frames = self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        let full = frames.len() >= latest;
        if full {
            frames.pop_front();
        }
        frames.push_back(bytes);
        drop(frames);
        self.filled.notify_one();
        full
    }

    fn pop(&self) -> Option<Arc<[u8]>> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }
}

/// One client's connection, before it begins.
struct Connection {
    shared: Arc<Shared>,
    metrics: Arc<Metrics>,
    slot: Arc<Slot>,
}

impl Connection {
    async fn serve(self, stream: TcpStream, mut down: watch::Receiver<bool>) {
        let end = tokio::select! {
            end = self.talk(stream) => end,
            () = ended(&mut down) => return,
        };
        match end {
            Ok(()) | Err(End::Gone) => {}
            Err(End::Silent) => self.metrics.refuse("timeout"),
            Err(End::Refused(why)) => {
                tracing::warn!("a VRPN client was sent away: {why}");
                self.slot.breach();
                self.metrics.refuse("vrpn");
            }
        }
    }

    async fn talk(&self, stream: TcpStream) -> Result<(), End> {
        let mut stream = Metered::new(stream, &self.shared.limits, Arc::clone(&self.slot));
        // Both sides speak first.
        let mut greeting = [0; wire::GREETING.len()];
        let greet = async {
            stream.write_all(&wire::GREETING).await?;
            stream.read_exact(&mut greeting).await
        };
        match timeout(GREETING_TIMEOUT, greet).await {
            Ok(Ok(_)) => wire::check_greeting(&greeting)?,
            Ok(Err(_)) => return Err(End::Gone),
            Err(_) => return Err(End::Silent),
        }
        write(&mut stream, &self.shared.catalogue.descriptions()).await?;
        let present = Present::enter(&self.shared, &self.metrics);
        let (mut messages, mut peer) = (wire::Messages::default(), Peer::default());
        let mut bytes = [0; 4096];
        loop {
            tokio::select! {
                biased;
                read = stream.read(&mut bytes) => {
                    let Ok(read @ 1..) = read else { return Ok(()) };
                    messages.push(&bytes[..read]);
                    let mut answer = Vec::new();
                    while let Some(message) = messages.find()? {
                        peer.take(message, &self.shared.catalogue, &mut answer)?;
                    }
                    write(&mut stream, &answer).await?;
                }
                () = present.waiting.filled.notified() => {
                    while let Some(frame) = present.waiting.pop() {
                        self.metrics.bytes.inc_by(frame.len() as u64);
                        write(&mut stream, &frame).await?;
                    }
                }
            }
        }
    }
}

/// Why a connection ends.
enum End {
    /// The other side has closed it, or it broke.
    Gone,
    /// It has not greeted, or not read, for too long.
    Silent,
    /// What it says is not to be served.
    Refused(Refused),
}

impl From<Refused> for End {
    fn from(why: Refused) -> Self {
        Self::Refused(why)
    }
}

async fn write(stream: &mut Metered<TcpStream>, bytes: &[u8]) -> Result<(), End> {
    match timeout(WRITE_TIMEOUT, stream.write_all(bytes)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(End::Gone),
        Err(_) => Err(End::Silent),
    }
}

/// A client among those that receive frames; gone when dropped.
struct Present<'a> {
    shared: &'a Shared,
    metrics: &'a Metrics,
    waiting: Arc<Waiting>,
}

impl<'a> Present<'a> {
    fn enter(shared: &'a Shared, metrics: &'a Metrics) -> Self {
        let waiting: Arc<Waiting> = Arc::default();
        shared.clients().push(Arc::clone(&waiting));
        metrics.vrpn_clients.inc();
        Self { shared, metrics, waiting }
    }
}

impl Drop for Present<'_> {
    fn drop(&mut self) {
        self.shared.clients().retain(|waiting| !Arc::ptr_eq(waiting, &self.waiting));
        self.metrics.vrpn_clients.dec();
    }
}

/// Addresses that are being called, or have been and are connected; clones share them. True: it is under way.
#[derive(Clone, Default)]
struct Calls(Arc<Mutex<BTreeMap<SocketAddr, bool>>>);

/// One of them; free when dropped.
struct Call {
    calls: Calls,
    target: SocketAddr,
}

impl Calls {
    /// Takes a place for a call; `None` where there is none, or this target has one already.
    fn begin(&self, target: SocketAddr) -> Option<Call> {
        let mut known = self.lock();
        let under_way = || known.iter().filter(|(_, is_under_way)| **is_under_way).map(|(known, _)| known);
        let is_full = under_way().count() >= CALLS
            || under_way().filter(|known| known.ip() == target.ip()).count() >= CALLS_PER_ADDRESS;
        if is_full || known.contains_key(&target) {
            return None;
        }
        known.insert(target, true);
        Some(Call { calls: self.clone(), target })
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<SocketAddr, bool>> {
        // Every change is complete before anything in it could panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Call {
    /// It has been answered, or is given up: another one may begin.
    fn settled(&self) {
        self.calls.lock().insert(self.target, false);
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        self.calls.lock().remove(&self.target);
    }
}

/// The port of `HOST PORT`, with or without a zero byte behind it.
fn requested_port(datagram: &[u8]) -> Option<u16> {
    let text = datagram.strip_suffix(&[0]).unwrap_or(datagram);
    let text = std::str::from_utf8(text).ok().filter(|text| text.len() <= MAX_REQUEST)?;
    let (host, port) = text.split_once(' ')?;
    let is_host = !host.is_empty() && host.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'.');
    let port: u16 = port.bytes().all(|c| c.is_ascii_digit()).then(|| port.parse().ok()).flatten()?;
    (is_host && port >= 1024).then_some(port)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(host: u8, port: u16) -> SocketAddr {
        SocketAddr::from(([192, 0, 2, host], port))
    }

    #[test]
    fn more_calls_than_may_be_under_way_are_not_made_and_those_that_are_go_on() {
        let calls = Calls::default();
        let mut under_way: Vec<Call> =
            (0..CALLS as u8).map(|host| calls.begin(target(host, 4000)).unwrap()).collect();
        assert!(calls.begin(target(99, 4000)).is_none());
        // Who is connected has a place and takes none of another one, and is not called twice.
        under_way[0].settled();
        let late = calls.begin(target(99, 4000)).unwrap();
        assert!(calls.begin(target(98, 4000)).is_none());
        drop(late);
        assert!(calls.begin(target(0, 4000)).is_none());
        drop(under_way.remove(0));
        assert!(calls.begin(target(0, 4000)).is_some());
    }

    #[test]
    fn an_address_that_asks_for_many_calls_locks_no_other_out() {
        let calls = Calls::default();
        let flood: Vec<Call> = (1024..=u16::MAX).filter_map(|port| calls.begin(target(1, port))).collect();
        assert_eq!(flood.len(), CALLS_PER_ADDRESS);
        assert!(calls.begin(target(2, 4000)).is_some());
        // Nor itself, once they are through.
        flood.iter().for_each(Call::settled);
        assert!(calls.begin(target(1, 9)).is_some());
    }

    #[test]
    fn only_a_host_and_a_high_port_are_a_request() {
        assert_eq!(requested_port(b"127.0.0.1 33039\0"), Some(33039));
        assert_eq!(requested_port(b"somewhere.example 1024"), Some(1024));
        for bad in [
            &b""[..],
            b"127.0.0.1",
            b"127.0.0.1 80\0",
            b"a b c",
            b" 4000",
            b"h 70000",
            b"h +4000",
            b"h 4000\0\0",
        ] {
            assert_eq!(requested_port(bad), None, "{bad:?}");
        }
        assert_eq!(requested_port(&[b'1'; 400]), None);
    }
}
