//! Programs that speak VMC: datagrams to the addresses of the stage file.
//!
//! In: frames, bodies and statuses from the distributor's task. Out: datagrams, sent or lost; nobody is waited for and nobody answers.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;

use super::hub::Item;
use super::metrics::Metrics;
use posed_protocol::vmc::{DEFAULT_TARGET, Publisher};
use posed_stage::Stage;

/// Where frames go in.
pub(super) struct Outlet {
    publisher: Publisher,
    /// Each with the socket of its family.
    targets: Vec<(SocketAddr, Arc<UdpSocket>)>,
    metrics: Arc<Metrics>,
}

impl Outlet {
    /// Resolves the targets and opens a socket. On failure: which target, and why.
    pub(super) fn open(
        stage: &Stage,
        settings: &posed_stage::Vmc,
        metrics: Arc<Metrics>,
    ) -> Result<Self, (String, std::io::Error)> {
        let usual = [DEFAULT_TARGET.to_owned()];
        let names = settings.targets.as_deref().unwrap_or(&usual);
        let mut targets: Vec<(SocketAddr, Arc<UdpSocket>)> = Vec::new();
        for name in names {
            let failed = |error| (name.clone(), error);
            let resolved = name.to_socket_addrs().map_err(failed)?.next();
            let address = resolved.ok_or_else(|| failed(std::io::Error::other("the name has no address")))?;
            let same = targets.iter().find(|(other, _)| other.is_ipv4() == address.is_ipv4());
            let socket = match same {
                Some((_, socket)) => Arc::clone(socket),
                None => Arc::new(socket(address).map_err(failed)?),
            };
            targets.push((address, socket));
        }
        Ok(Self { publisher: Publisher::new(stage, settings), targets, metrics })
    }

    /// Sends an item, if it is something to them.
    pub(super) fn publish(&mut self, item: &Item) {
        let Self { publisher, targets, metrics } = self;
        let send = |datagram: &[u8]| {
            for (address, socket) in &*targets {
                match socket.send_to(datagram, address) {
                    Ok(_) => metrics.vmc_sent.inc(),
                    // No room in the system's queue, or no way there: the next frame says all of it again.
                    Err(_) => metrics.vmc_lost.inc(),
                };
            }
        };
        match item {
            Item::Body(body) => publisher.body(body, send),
            Item::Estimate(estimate) => publisher.frame(estimate, send),
            Item::Status(status) => publisher.look(status.t_s, send),
            Item::Rewind => publisher.rewind(),
            Item::Truth(_) | Item::Outcome(_) | Item::Jobs(_) | Item::Sessions(_) => {}
        }
    }
}

/// A socket that never waits.
fn socket(target: SocketAddr) -> std::io::Result<UdpSocket> {
    let any: SocketAddr = match target {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let socket = UdpSocket::bind(any)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}
