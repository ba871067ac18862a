//! A name on the local network: `NAME.local` and the service `_imu._tcp`, by multicast DNS.
//!
//! In: name and port. Out: answers to who asks. Never: an error that keeps the daemon from running; a network without multicast
//! has no names, and phones come by the address in the QR code.

use mdns_sd::{ServiceDaemon, ServiceInfo};

/// The kind of service, as devices look for it.
const SERVICE: &str = "_imu._tcp.local.";
/// Letters of one part of a name.
const LONGEST: usize = 63;

/// The name of this computer on the local network: its own, so that each has another, behind `posed-`, because the plain one is
/// answered for by the system where it answers at all.
pub(super) fn host_name() -> String {
    let node = rustix::system::uname();
    let node = node.nodename().to_string_lossy();
    let plain = |letter: char| if letter.is_ascii_alphanumeric() { letter.to_ascii_lowercase() } else { '-' };
    let first = node.split('.').next().unwrap_or_default();
    let name: String = format!("posed-{first}").chars().map(plain).take(LONGEST).collect();
    format!("{}.local", name.trim_matches('-'))
}

/// A service that is announced, until dropped.
pub(super) struct Announced(ServiceDaemon);

/// Announces the service; `None` where there is no multicast.
pub(super) fn announce(stage: &str, host: &str, port: u16) -> Option<Announced> {
    let announced = ServiceDaemon::new().and_then(|daemon| {
        let txt = [("v", "1"), ("ws", "/imu"), ("tls", "1"), ("page", "/phone")];
        let info = ServiceInfo::new(SERVICE, stage, &format!("{host}."), "", port, &txt[..])?;
        daemon.register(info.enable_addr_auto())?;
        Ok(Announced(daemon))
    });
    match announced {
        Ok(announced) => Some(announced),
        Err(error) => {
            tracing::info!("no name on the local network: {error}");
            None
        }
    }
}

impl Drop for Announced {
    fn drop(&mut self) {
        // It says goodbye from a thread of its own.
        let _ = self.0.shutdown();
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_name_is_one_part_before_local() {
        let name = super::host_name();
        let first = name.strip_suffix(".local").unwrap();
        assert!(
            first.starts_with("posed-") && !first.contains('.') && first.len() <= super::LONGEST,
            "{name}"
        );
    }
}
