//! Datagrams of many peers in one stream of bytes.
//!
//! A session that serves many trackers on one socket must know which of them sent what. So the port puts each
//! datagram into an envelope, and unpacks those that the session transmits; read chunks, input log and
//! recordings stay plain bytes. A chunk holds whole envelopes only.
//!
//! Envelope: length of the rest (u16), family (4 or 6), address (4 or 16 bytes), port (u16), datagram; all
//! numbers big-endian.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// A datagram and where it comes from, or goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// The far end: address and UDP port. Scope and flow label of IPv6 are not in the envelope and read as 0.
    pub peer: SocketAddr,
    /// What was sent: the payload, without the envelope.
    pub data: &'a [u8],
}

impl Datagram<'_> {
    /// Appends the envelope to `out`: 9 bytes (IPv4) or 21 bytes (IPv6), then the data.
    ///
    /// # Panics
    /// With more data than its length field counts: 65528 bytes (IPv4), 65516 bytes (IPv6). No UDP datagram holds so many.
    pub fn encode_into(&self, out: &mut Vec<u8>) {
        let start = out.len();
        out.extend([0, 0]);
        match self.peer.ip() {
            IpAddr::V4(ip) => {
                out.push(4);
                out.extend(ip.octets());
            }
            IpAddr::V6(ip) => {
                out.push(6);
                out.extend(ip.octets());
            }
        }
        out.extend(self.peer.port().to_be_bytes());
        out.extend(self.data);
        let len = u16::try_from(out.len() - start - 2).expect("a datagram is shorter than 64 KiB");
        out[start..start + 2].copy_from_slice(&len.to_be_bytes());
    }

    /// Bytes of the whole envelope, the data included.
    pub fn envelope_len(&self) -> usize {
        2 + 1 + if self.peer.is_ipv4() { 4 } else { 16 } + 2 + self.data.len()
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
/// The chunk must begin with an envelope. An envelope that is cut short, or of another family than 4 and 6, ends the reading:
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
    let (ip, envelope) = match family {
        4 => {
            let (ip, envelope) = envelope.split_first_chunk::<4>()?;
            (IpAddr::V4(Ipv4Addr::from(*ip)), envelope)
        }
        6 => {
            let (ip, envelope) = envelope.split_first_chunk::<16>()?;
            (IpAddr::V6(Ipv6Addr::from(*ip)), envelope)
        }
        _ => return None,
    };
    let (port, data) = envelope.split_first_chunk()?;
    Some((Datagram { peer: SocketAddr::new(ip, u16::from_be_bytes(*port)), data }, after))
}

#[cfg(test)]
mod tests {
    use super::*;

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
