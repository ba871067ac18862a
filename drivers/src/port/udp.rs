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

/// Longest datagram that a server takes: what an Ethernet frame holds.
const LONGEST: usize = 1500;

/// A socket for datagrams as a stream: each read gives one datagram, each write sends one.
///
/// Towards one peer a datagram longer than the buffer of the read is cut. A server reads at most 1500 bytes of a datagram,
/// and drops it where its envelope does not fit the buffer; a write takes one envelope, and drops what is none. Empty
/// datagrams of a peer are passed over.
#[derive(Debug)]
pub struct UdpStream {
    socket: UdpSocket,
    /// Where a server's datagrams arrive, and their envelopes.
    server: Option<(Box<[u8; LONGEST]>, Vec<u8>)>,
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
        Ok(Self { socket, server: None })
    }

    /// A socket for many peers, at `HOST:PORT` of this computer.
    pub(super) async fn serve(address: &str) -> io::Result<Self> {
        let socket = UdpSocket::bind(address).await?;
        let server = Some((Box::new([0; LONGEST]), Vec::with_capacity(LONGEST + 32)));
        Ok(Self { socket, server })
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
        let Self { socket, server } = self.get_mut();
        let before = buf.filled().len();
        loop {
            let received = match server {
                None => ready!(socket.poll_recv(cx, buf)),
                Some((datagram, envelope)) => {
                    let mut datagram = ReadBuf::new(&mut datagram[..]);
                    ready!(socket.poll_recv_from(cx, &mut datagram)).map(|peer| {
                        envelope.clear();
                        Datagram { peer, data: datagram.filled() }.encode_into(envelope);
                        if envelope.len() <= buf.remaining() {
                            buf.put_slice(envelope);
                        }
                    })
                }
            };
            match received {
                // No bytes would look like the end of the stream.
                Ok(()) if buf.filled().len() == before => {}
                Err(error) if is_absence(&error) => {}
                other => return Poll::Ready(other),
            }
        }
    }
}

impl AsyncWrite for UdpStream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if self.server.is_none() {
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
