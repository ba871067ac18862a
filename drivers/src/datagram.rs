//! Datagrams of many peers in one stream of bytes.
//!
//! A session that serves many trackers on one socket must know which of them sent what. So the port puts each
//! datagram into an envelope, and unpacks those that the session transmits; read chunks, input log and
//! recordings stay plain bytes. A chunk holds whole envelopes only.
//!
//! Envelope: length of the rest (u16), family, address, port (u16), datagram; all numbers big-endian. The address is 4 bytes
//! (family 4), 16 bytes (6), or 16 bytes and a scope (u32; 16): a link-local address leads nowhere without it.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4, SocketAddrV6};

/// Families of addresses, as an envelope names them.
const V4: u8 = 4;
const V6: u8 = 6;
const V6_SCOPED: u8 = 16;

/// A datagram and where it comes from, or goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// The far end: address, scope and UDP port. The flow label of IPv6 is not in the envelope and reads as 0.
    pub peer: SocketAddr,
    /// What was sent: the payload, without the envelope.
    pub data: &'a [u8],
}

impl Datagram<'_> {
    /// Appends the envelope to `out`: 9 bytes (IPv4), 21 bytes (IPv6) or 25 bytes (IPv6 with a scope), then the data.
    ///
    /// # Panics
    /// With more data than its length field counts: 65528, 65516 or 65512 bytes. No UDP datagram holds so many.
    pub fn encode_into(&self, out: &mut Vec<u8>) {
        let start = out.len();
        out.extend([0, 0]);
        match self.peer {
            SocketAddr::V4(peer) => {
                out.push(V4);
                out.extend(peer.ip().octets());
            }
            SocketAddr::V6(peer) => {
                out.push(if peer.scope_id() == 0 { V6 } else { V6_SCOPED });
                out.extend(peer.ip().octets());
                if peer.scope_id() != 0 {
                    out.extend(peer.scope_id().to_be_bytes());
                }
            }
        }
        out.extend(self.peer.port().to_be_bytes());
        out.extend(self.data);
        let len = u16::try_from(out.len() - start - 2).expect("a datagram is shorter than 64 KiB");
        out[start..start + 2].copy_from_slice(&len.to_be_bytes());
    }

    /// Bytes of the whole envelope, the data included.
    pub fn envelope_len(&self) -> usize {
        let address = match self.peer {
            SocketAddr::V4(_) => 4,
            SocketAddr::V6(peer) if peer.scope_id() == 0 => 16,
            SocketAddr::V6(_) => 20,
        };
        2 + 1 + address + 2 + self.data.len()
    }

    /// The whole envelope; see [`Datagram::encode_into`].
    ///
    /// # Panics
    /// As [`Datagram::encode_into`].
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.envelope_len());
        self.encode_into(&mut out);
        out
    }
}

/// The datagrams of a chunk, in order, each as `Ok`; in the end `Err` with the number of bytes that are none, if any.
///
/// The chunk must begin with an envelope. An envelope that is cut short, or of an unknown family, ends the reading:
/// all bytes from there on are in the `Err`. Lengths alone part the envelopes; there is no mark to find the next one by.
pub fn datagrams(chunk: &[u8]) -> impl Iterator<Item = Result<Datagram<'_>, usize>> {
    let mut rest = chunk;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        Some(match open(rest) {
            Some((datagram, after)) => {
                rest = after;
                Ok(datagram)
            }
            None => Err(std::mem::take(&mut rest).len()),
        })
    })
}

fn open(bytes: &[u8]) -> Option<(Datagram<'_>, &[u8])> {
    let (len, rest) = bytes.split_first_chunk()?;
    let (envelope, after) = rest.split_at_checked(u16::from_be_bytes(*len).into())?;
    let (family, envelope) = envelope.split_first()?;
    let (peer, data) = match *family {
        V4 => {
            let (ip, envelope) = envelope.split_first_chunk::<4>()?;
            let (port, data) = split_u16(envelope)?;
            (SocketAddrV4::new(Ipv4Addr::from(*ip), port).into(), data)
        }
        V6 | V6_SCOPED => {
            let (ip, envelope) = envelope.split_first_chunk::<16>()?;
            let (scope, envelope) = match *family {
                V6 => (0, envelope),
                _ => envelope.split_first_chunk().map(|(scope, rest)| (u32::from_be_bytes(*scope), rest))?,
            };
            let (port, data) = split_u16(envelope)?;
            (SocketAddrV6::new(Ipv6Addr::from(*ip), port, 0, scope).into(), data)
        }
        _ => return None,
    };
    Some((Datagram { peer, data }, after))
}

fn split_u16(bytes: &[u8]) -> Option<(u16, &[u8])> {
    bytes.split_first_chunk().map(|(word, rest)| (u16::from_be_bytes(*word), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_local_peer_keeps_its_scope() {
        let peer = "[fe80::1%3]:6969".parse().unwrap();
        let datagram = Datagram { peer, data: b"abc" };
        let envelope = datagram.encode();
        assert_eq!(datagrams(&envelope).collect::<Vec<_>>(), [Ok(datagram)]);
        assert_eq!(envelope.len(), datagram.envelope_len());
    }

    #[test]
    fn envelopes_open_again() {
        let peers: [SocketAddr; 2] =
            ["192.0.2.7:6969".parse().unwrap(), "[2001:db8::1]:9000".parse().unwrap()];
        let mut chunk = Vec::new();
        for (peer, data) in peers.into_iter().zip([&b"abc"[..], b""]) {
            Datagram { peer, data }.encode_into(&mut chunk);
        }
        let found: Vec<_> = datagrams(&chunk).collect();
        assert_eq!(
            found,
            [Ok(Datagram { peer: peers[0], data: b"abc" }), Ok(Datagram { peer: peers[1], data: b"" })]
        );
        for end in 1..chunk.len() {
            let opened: Vec<_> = datagrams(&chunk[..end]).collect();
            let whole = if end >= 12 { 1 } else { 0 };
            let left = end - 12 * whole;
            assert_eq!(opened.iter().filter(|found| found.is_ok()).count(), whole);
            assert_eq!(opened.last().unwrap().err(), (left > 0).then_some(left));
        }
        assert_eq!(datagrams(&[0, 1, 9]).next(), Some(Err(3)));
        assert_eq!(found.iter().flatten().map(Datagram::envelope_len).sum::<usize>(), chunk.len());
    }
}
