//! SlimeVR.

use super::head::Head;
use super::script::{pieces, session};
use crate::datagram::datagrams;
use crate::slimevr::{Settings, SlimeVrSession, hid, wire};

/// Envelopes, packets and a session. Nobody looks for trackers: they come by themselves.
///
/// # Panics
/// Where an envelope changes when written; and as all others of this module.
pub fn slimevr(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    // Served to all, to some, to one twice, to more than there can be, and to what has no such address.
    let trackers = match head.byte() {
        0 => vec![],
        255 => vec!["01:01:01:01:01".to_owned()],
        count => (0..count).map(|k| format!("01:01:01:01:01:{:02X}", 1 + k % 70)).collect(),
    };
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[1, 2, 257]);
    for bytes in pieces(script) {
        for datagram in datagrams(bytes).flatten() {
            assert_eq!(datagrams(&datagram.encode()).next(), Some(Ok(datagram)), "an envelope changed");
            if let Some(packet) = wire::parse(datagram.data) {
                packet.items(drop);
            }
            // As what a receiver gives, too.
            hid::packets(datagram.data).into_iter().flatten().for_each(drop);
        }
    }
    let Ok(mut live) = SlimeVrSession::new(Settings { trackers }, &wanted) else { return 0 };
    session(&mut live, modem_lines, &[], script, 0.0)
}
