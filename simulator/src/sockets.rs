//! A device's end of a network: a TCP server, or UDP sockets, on the loopback interface.
//!
//! A stage file names where the daemon finds a device (`tcp://HOST:PORT`, `udp://HOST:PORT`), or where SlimeVR
//! trackers find the daemon. Whatever the host, the virtual device is on this machine, at the same port number.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::task::Poll;

use posed_drivers::datagram::{Datagram, datagrams};
use tokio::io::ReadBuf;
use tokio::net::{TcpListener, TcpStream, UdpSocket};

use crate::port::Port;

/// Bytes that wait for a host which does not read, before the connection is given up.
const MOST_UNSENT: usize = 1 << 20;

/// The loopback address with the port number of `tcp://HOST:PORT` or `udp://HOST:PORT`.
pub(crate) fn loopback(port: &str) -> io::Result<SocketAddr> {
    let number = port.rsplit_once(':').and_then(|(_, number)| number.parse::<u16>().ok());
    let number = number.ok_or_else(|| io::Error::other(format!("`{port}` has no port number")))?;
    Ok(SocketAddr::from((Ipv4Addr::LOCALHOST, number)))
}

/// What went wrong at an address.
fn at(address: SocketAddr) -> impl Fn(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{address}: {error}"))
}

/// A server for one connection at a time.
pub(crate) struct Tcp {
    pub(crate) address: SocketAddr,
    listener: Option<TcpListener>,
    stream: Option<TcpStream>,
    unsent: Vec<u8>,
}

impl Tcp {
    /// Listens at an address; port 0 takes any that is free.
    pub(crate) fn open(address: SocketAddr) -> io::Result<Self> {
        let mut tcp = Self { address, listener: None, stream: None, unsent: Vec::new() };
        tcp.replug()?;
        Ok(tcp)
    }

    fn hang_up(&mut self) {
        self.stream = None;
        self.unsent.clear();
    }
}

impl Port for Tcp {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let Some(listener) = &self.listener else { return std::future::pending().await };
            let Some(stream) = &self.stream else {
                let (stream, _) = listener.accept().await?;
                stream.set_nodelay(true)?;
                self.stream = Some(stream);
                continue;
            };
            if stream.readable().await.is_err() {
                self.hang_up();
                continue;
            }
            match stream.try_read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // The host hung up; another one may come.
                Ok(0) | Err(_) => self.hang_up(),
                Ok(count) => return Ok(count),
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Some(stream) = &self.stream else { return Ok(()) };
        self.unsent.extend(bytes);
        while !self.unsent.is_empty() {
            match stream.try_write(&self.unsent) {
                Ok(count) => drop(self.unsent.drain(..count)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    if self.unsent.len() > MOST_UNSENT {
                        self.hang_up();
                    }
                    break;
                }
                Err(_) => {
                    self.hang_up();
                    break;
                }
            }
        }
        Ok(())
    }

    fn baud(&self) -> Option<u32> {
        None
    }

    fn unplug(&mut self) {
        self.hang_up();
        self.listener = None;
    }

    fn replug(&mut self) -> io::Result<()> {
        let listener = std::net::TcpListener::bind(self.address).map_err(at(self.address))?;
        listener.set_nonblocking(true)?;
        self.address = listener.local_addr()?;
        self.listener = Some(TcpListener::from_std(listener)?);
        Ok(())
    }
}

fn udp(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = std::net::UdpSocket::bind(address).map_err(at(address))?;
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket)
}

/// A device that answers whoever has spoken to it last.
pub(crate) struct Udp {
    pub(crate) address: SocketAddr,
    socket: Option<UdpSocket>,
    host: Option<SocketAddr>,
}

impl Udp {
    /// Listens at an address; port 0 takes any that is free.
    pub(crate) fn open(address: SocketAddr) -> io::Result<Self> {
        let mut udp = Self { address, socket: None, host: None };
        udp.replug()?;
        Ok(udp)
    }
}

impl Port for Udp {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(socket) = &self.socket else { return std::future::pending().await };
        loop {
            // An error tells that an earlier datagram found nobody: that is the network's normal life.
            if let Ok((count, host)) = socket.recv_from(buffer).await {
                self.host = Some(host);
                if count > 0 {
                    return Ok(count);
                }
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if let (Some(socket), Some(host)) = (&self.socket, self.host) {
            // A datagram that cannot be sent is lost, as on any network.
            let _ = socket.try_send_to(bytes, host);
        }
        Ok(())
    }

    fn baud(&self) -> Option<u32> {
        None
    }

    fn unplug(&mut self) {
        self.socket = None;
    }

    fn replug(&mut self) -> io::Result<()> {
        let socket = udp(self.address)?;
        self.address = socket.local_addr()?;
        self.socket = Some(socket);
        Ok(())
    }
}

/// Several units, each with a socket of its own, that speak to one server.
pub(crate) struct Units {
    server: SocketAddr,
    /// The address by which the simulation knows a unit, and the socket that stands for it.
    sockets: Vec<(SocketAddr, UdpSocket)>,
    /// The read waits here for a unit's first word.
    wake: Option<std::task::Waker>,
}

impl Units {
    pub(crate) fn new(server: SocketAddr) -> Self {
        Self { server, sockets: Vec::new(), wake: None }
    }
}

impl Port for Units {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        std::future::poll_fn(|context| {
            for (peer, socket) in &self.sockets {
                let mut datagram = [0; 512];
                let mut datagram = ReadBuf::new(&mut datagram);
                if let Poll::Ready(Ok(())) = socket.poll_recv(context, &mut datagram) {
                    let envelope = Datagram { peer: *peer, data: datagram.filled() }.encode();
                    let count = envelope.len().min(buffer.len());
                    buffer[..count].copy_from_slice(&envelope[..count]);
                    return Poll::Ready(Ok(count));
                }
            }
            self.wake = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        for Datagram { peer, data } in datagrams(bytes).flatten() {
            let known = self.sockets.iter().position(|(known, _)| *known == peer);
            let k = match known {
                Some(k) => k,
                None => {
                    self.sockets.push((peer, udp(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)))?));
                    self.sockets.len() - 1
                }
            };
            let _ = self.sockets[k].1.try_send_to(data, self.server);
        }
        if let Some(waker) = self.wake.take() {
            waker.wake();
        }
        Ok(())
    }

    fn baud(&self) -> Option<u32> {
        None
    }

    fn unplug(&mut self) {
        self.sockets.clear();
    }

    fn replug(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use posed_drivers::motionstar::wire::{HEADER, Header, kind};
    use posed_drivers::slimevr::wire;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;
    use crate::host::{Clock, Host, Watcher};
    use crate::scenario::DeviceScenario;
    use crate::stage::{Event, VirtualStage};
    use crate::testing::{scenario_of, stage_of};

    /// Puts a device on its socket, in real time, and gives its address.
    fn host(driver: &str, port: &str, addresses: &[u16]) -> (Host, SocketAddr) {
        let spec = stage_of(driver, port, 0, addresses);
        let stage =
            VirtualStage::new(&spec, &scenario_of(DeviceScenario::default()), Path::new(".")).unwrap();
        let watcher: Watcher = Arc::new(|_: &Event| {});
        let folder = std::env::temp_dir();
        let host = Host::open(stage, &folder, Clock::start(), watcher).unwrap();
        let (_, address) = host.devices()[0].port.split_once("://").unwrap();
        let address = address.parse().unwrap();
        (host, address)
    }

    fn packet(kind: u8) -> Vec<u8> {
        let mut packet = Vec::new();
        Header { sequence: 7, kind, ..Header::default() }.encode(&[], &mut packet);
        packet
    }

    #[tokio::test]
    async fn a_motionstar_serves_one_connection_after_the_other() {
        let (host, address) = host("motionstar", "tcp://far.away:0", &[2]);
        for _ in 0..2 {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(&packet(kind::STOP_DATA)).await.unwrap();
            let mut answer = [0; HEADER];
            stream.read_exact(&mut answer).await.unwrap();
            assert_eq!((answer[1], answer[8]), (7, kind::RSP_STOP_DATA));
        }
        host.stop().await.unwrap();
        assert!(TcpStream::connect(address).await.is_err());
    }

    #[tokio::test]
    async fn an_x_imu3_answers_whoever_asks() {
        let (host, address) = host("x-imu3", "udp://192.168.1.9:0", &[0]);
        let ours = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        ours.send_to(b"{\"ping\":null}\n", address).await.unwrap();
        let mut buffer = [0; 512];
        loop {
            let count = ours.recv(&mut buffer).await.unwrap();
            if buffer[..count].starts_with(b"{\"ping\":{") {
                break;
            }
        }
        host.stop().await.unwrap();
    }

    #[tokio::test]
    async fn slimevr_trackers_come_each_from_a_socket_of_its_own() {
        let server = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let port = server.local_addr().unwrap().port();
        let (host, address) = host("slimevr", &format!("udp://0.0.0.0:{port}"), &[1, 2]);
        assert_eq!(address.port(), port);
        let mut buffer = [0; 1500];
        let mut moving = Vec::new();
        while moving.len() < 2 {
            let (_, peer) = server.recv_from(&mut buffer).await.unwrap();
            match buffer[3] {
                3 => {
                    server.send_to(&wire::handshake_reply(), peer).await.unwrap();
                }
                17 if !moving.contains(&peer) => moving.push(peer),
                _ => {}
            }
        }
        assert_ne!(moving[0], moving[1]);
        host.stop().await.unwrap();
    }
}
