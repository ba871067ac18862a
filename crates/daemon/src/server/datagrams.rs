//! Datagrams to the addresses of the stage file: avatars by VMC, programs that read MVN's network stream.
//!
//! In: frames, bodies and statuses from the distributor's task. Out: datagrams, sent or lost; nobody is waited for and nobody answers.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;

use prometheus_client::metrics::counter::Counter;

use super::BindError;
use super::hub::Item;
use super::metrics::Metrics;
use posed_protocol::{mvn, vmc};
use posed_stage::{BodyIndex, Stage};

/// What makes datagrams of what is published.
enum Publisher {
    Vmc(vmc::Publisher),
    Mvn(mvn::Publisher),
}

/// Where frames go in.
pub(super) struct Outlet {
    publisher: Publisher,
    /// Each with the socket of its family.
    targets: Vec<(SocketAddr, Arc<UdpSocket>)>,
    sent: Counter,
    lost: Counter,
}

impl Outlet {
    /// All that the stage file asks for: targets resolved, sockets opened. On failure: which target, and why.
    pub(super) fn open(stage: &Stage, metrics: &Metrics) -> Result<Vec<Self>, BindError> {
        // Sensors that nobody wears are sent, too.
        let bodies = 0..stage.bodies.len().max(1) as BodyIndex;
        let vmc = stage.vmc.iter().flat_map(|settings| {
            bodies.clone().map(move |body| {
                // A program that listens by VMC shows one avatar: that of each body has a port of its own.
                let targets = targets("vmc", &settings.targets, vmc::DEFAULT_TARGET, body.into())?;
                let publisher = Publisher::Vmc(vmc::Publisher::new(stage, body, settings));
                let (sent, lost) = (metrics.vmc_sent.clone(), metrics.vmc_lost.clone());
                Ok(Self { publisher, targets, sent, lost })
            })
        });
        let mvn = stage.mvn.iter().flat_map(|settings| {
            bodies.clone().map(move |body| {
                let targets = targets("mvn", &settings.targets, mvn::DEFAULT_TARGET, 0)?;
                let publisher = Publisher::Mvn(mvn::Publisher::new(stage, body, settings));
                let (sent, lost) = (metrics.mvn_sent.clone(), metrics.mvn_lost.clone());
                Ok(Self { publisher, targets, sent, lost })
            })
        });
        vmc.chain(mvn).collect()
    }

    /// Sends an item, if it is something to them.
    pub(super) fn publish(&mut self, item: &Item) {
        let Self { publisher, targets, sent, lost } = self;
        let send = |datagram: &[u8]| {
            for (address, socket) in &*targets {
                match socket.send_to(datagram, address) {
                    Ok(_) => sent.inc(),
                    // No room in the system's queue, or no way there: the next frame says all of it again.
                    Err(_) => lost.inc(),
                };
            }
        };
        match (publisher, item) {
            (Publisher::Vmc(publisher), Item::Body(body)) => publisher.body(body, send),
            (Publisher::Vmc(publisher), Item::Estimate(estimate)) => publisher.frame(estimate, send),
            (Publisher::Vmc(publisher), Item::Status(status)) => publisher.look(status.t_s, send),
            (Publisher::Vmc(publisher), Item::Rewind) => publisher.rewind(),
            (Publisher::Mvn(publisher), Item::Body(body)) => publisher.body(body, send),
            (Publisher::Mvn(publisher), Item::Rewind) => publisher.rewind(),
            _ => {}
        }
    }
}

/// Where a table's datagrams go, on ports that are so much higher than in the stage file.
fn targets(
    table: &'static str,
    names: &Option<Vec<String>>,
    usual: &'static str,
    higher: u16,
) -> Result<Vec<(SocketAddr, Arc<UdpSocket>)>, BindError> {
    let alone = [usual.to_owned()];
    let mut targets: Vec<(SocketAddr, Arc<UdpSocket>)> = Vec::new();
    for name in names.as_deref().unwrap_or(&alone) {
        let failed = |error| BindError::Target { table, target: name.clone(), usual, error };
        let resolved = name.to_socket_addrs().map_err(failed)?.next();
        let mut address = resolved.ok_or_else(|| failed(std::io::Error::other("the name has no address")))?;
        let port = address.port().checked_add(higher);
        address.set_port(
            port.ok_or_else(|| failed(std::io::Error::other("there are not enough ports above it")))?,
        );
        let same = targets.iter().find(|(other, _)| other.is_ipv4() == address.is_ipv4());
        let socket = match same {
            Some((_, socket)) => Arc::clone(socket),
            None => Arc::new(socket(address).map_err(failed)?),
        };
        targets.push((address, socket));
    }
    Ok(targets)
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
