//! Datagrams as a stream of bytes: each read gives one, each write sends one.
//!
//! With one peer the bytes are those of its datagrams. A server has many; there each datagram travels in an envelope
//! ([`crate::datagram`]) that says whose it is.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use socket2::{Domain, Protocol, Socket, Type};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{UdpSocket, lookup_host};

use crate::datagram::{Datagram, datagrams};

/// Room for the longest datagram there is, so that none is ever cut.
const LONGEST: usize = 1 << 16;

/// A socket for datagrams as a stream: each read gives one datagram, each write sends one.
///
/// No datagram is cut. Towards one peer the next reads give what the buffer of a read had no room for. A server drops a
/// datagram whose envelope does not fit the buffer, and logs it; a write takes one envelope, and drops what is none. Empty
/// datagrams of a peer are passed over.
#[derive(Debug)]
pub struct UdpStream {
    socket: UdpSocket,
    /// Where datagrams arrive.
    arrived: Box<[u8]>,
    /// What the next reads give: the rest of a datagram, or a server's envelope.
    pending: Vec<u8>,
    /// Whether there are many peers, and datagrams travel in envelopes.
    is_server: bool,
}

impl UdpStream {
    /// A socket for one peer, at `HOST:PORT`, which sends to `local_port` of this computer.
    pub(super) async fn connect(address: &str, local_port: Option<u16>) -> io::Result<Self> {
        let nobody = || io::Error::new(io::ErrorKind::NotFound, "the host has no address");
        let peer = lookup_host(address).await?.next().ok_or_else(nobody)?;
        let any = match peer {
            SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let local = SocketAddr::new(any, local_port.unwrap_or(0));
        // Several devices may send to the same port; the system tells them apart by where they send from.
        let socket = if local_port.is_some() { shared(local)? } else { UdpSocket::bind(local).await? };
        socket.connect(peer).await?;
        Ok(Self::new(socket, false))
    }

    /// A socket for many peers, at `HOST:PORT` of this computer.
    pub(super) async fn serve(address: &str) -> io::Result<Self> {
        let socket = UdpSocket::bind(address).await?;
        Ok(Self::new(socket, true))
    }

    fn new(socket: UdpSocket, is_server: bool) -> Self {
        Self { socket, arrived: vec![0; LONGEST].into(), pending: Vec::new(), is_server }
    }

    /// Gives as much of what is pending as there is room for.
    fn give(&mut self, buf: &mut ReadBuf<'_>) {
        let fits = self.pending.len().min(buf.remaining());
        buf.put_slice(&self.pending[..fits]);
        self.pending.drain(..fits);
    }

    /// Address and port of this computer that it is bound to.
    ///
    /// # Errors
    /// The operating system refuses to say it: the socket is gone.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}

/// A socket at an address of this computer that others may listen to as well (address reuse).
///
/// # Errors
/// The socket cannot be made or bound: the address is not one of this computer, or another program has the port and
/// does not share it.
///
/// # Panics
/// Outside a Tokio runtime.
pub fn shared(local: SocketAddr) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::for_address(local), Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&local.into())?;
    UdpSocket::from_std(socket.into())
}

/// A peer that is switched off lets the system say so; it is no fault of the port, which waits for its return.
fn is_absence(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionReset)
}

impl AsyncRead for UdpStream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        // No bytes would look like the end of the stream.
        while this.pending.is_empty() {
            let mut datagram = ReadBuf::new(&mut this.arrived);
            let received = if this.is_server {
                ready!(this.socket.poll_recv_from(cx, &mut datagram)).map(Some)
            } else {
                ready!(this.socket.poll_recv(cx, &mut datagram)).map(|()| None)
            };
            match received {
                Ok(None) => this.pending.extend_from_slice(datagram.filled()),
                Ok(Some(peer)) => {
                    let datagram = Datagram { peer, data: datagram.filled() };
                    // A session takes whole envelopes only.
                    if datagram.envelope_len() <= buf.remaining() {
                        datagram.encode_into(&mut this.pending);
                    } else {
                        tracing::warn!(%peer, bytes = datagram.data.len(), "a datagram is too long for a tracker's; dropped");
                    }
                }
                Err(error) if is_absence(&error) => {}
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
        this.give(buf);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for UdpStream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if !self.is_server {
            return match ready!(self.socket.poll_send(cx, bytes)) {
                Err(error) if is_absence(&error) => Poll::Ready(Ok(bytes.len())),
                other => Poll::Ready(other),
            };
        }
        let Some(Ok(datagram)) = datagrams(bytes).next() else { return Poll::Ready(Ok(bytes.len())) };
        // One peer that cannot be reached is nothing to the others.
        let _ = ready!(self.socket.poll_send_to(cx, datagram.data, datagram.peer));
        Poll::Ready(Ok(datagram.envelope_len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    #[tokio::test]
    async fn a_datagram_is_a_read_and_an_absent_peer_is_no_end() {
        let device = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let at = device.local_addr().unwrap();
        let mut port = UdpStream::connect(&at.to_string(), None).await.unwrap();
        port.write_all(b"{\"ping\":null}\n").await.unwrap();
        let mut buffer = [0; 64];
        let (n, host) = device.recv_from(&mut buffer).await.unwrap();
        assert_eq!(&buffer[..n], b"{\"ping\":null}\n");
        for data in [&b""[..], b"one", b"two"] {
            device.send_to(data, host).await.unwrap();
        }
        assert_eq!(port.read(&mut buffer).await.unwrap(), 3, "an empty datagram is passed over");
        assert_eq!(port.read(&mut buffer).await.unwrap(), 3);
        assert_eq!(&buffer[..3], b"two");

        drop(device);
        port.write_all(b"nobody").await.unwrap();
        port.write_all(b"there").await.unwrap();
        // The device is back at its address: the port has waited for it.
        let device = UdpSocket::bind(at).await.unwrap();
        device.send_to(b"back", host).await.unwrap();
        assert_eq!(port.read(&mut buffer).await.unwrap(), 4);
    }

    #[tokio::test]
    async fn no_datagram_is_cut() {
        let long: Vec<u8> = (0..9000_u32).map(|k| k as u8).collect();
        let device = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let at = device.local_addr().unwrap();
        let mut port = UdpStream::connect(&at.to_string(), None).await.unwrap();
        device.send_to(&long, port.local_addr().unwrap()).await.unwrap();
        let mut read = vec![0; long.len()];
        port.read_exact(&mut read[..4000]).await.unwrap();
        port.read_exact(&mut read[4000..]).await.unwrap();
        assert_eq!(read, long);

        let mut server = UdpStream::serve("127.0.0.1:0").await.unwrap();
        let at = server.local_addr().unwrap();
        let mut buffer = vec![0; 10_000];
        device.send_to(&long, at).await.unwrap();
        let n = server.read(&mut buffer).await.unwrap();
        assert_eq!(datagrams(&buffer[..n]).next().unwrap().unwrap().data, long);
        // Without room for all of it, none of it.
        device.send_to(&long, at).await.unwrap();
        device.send_to(b"short", at).await.unwrap();
        let n = server.read(&mut buffer[..4096]).await.unwrap();
        assert_eq!(datagrams(&buffer[..n]).next().unwrap().unwrap().data, b"short");
    }

    #[tokio::test]
    async fn a_server_knows_its_peers_apart() {
        let mut server = UdpStream::serve("127.0.0.1:0").await.unwrap();
        let at = server.local_addr().unwrap();
        let trackers =
            [UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap()];
        let mut buffer = [0; 256];
        let mut replies = Vec::new();
        for (tracker, data) in trackers.iter().zip([&b"left"[..], b"right"]) {
            tracker.send_to(data, at).await.unwrap();
            let n = server.read(&mut buffer).await.unwrap();
            let found = datagrams(&buffer[..n]).next().unwrap().unwrap();
            assert_eq!((found.peer, found.data), (tracker.local_addr().unwrap(), data));
            Datagram { peer: found.peer, data }.encode_into(&mut replies);
        }
        server.write_all(&replies).await.unwrap();
        for (tracker, data) in trackers.iter().zip([&b"left"[..], b"right"]) {
            let n = tracker.recv(&mut buffer).await.unwrap();
            assert_eq!(&buffer[..n], data);
        }
    }
}
