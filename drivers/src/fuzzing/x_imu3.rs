//! x-IMU3.

use super::head::Head;
use super::script::{cut_both_ways, pieces, probe, session};
use crate::sample::Timestamp;
use crate::x_imu3::probe::{Announcement, inquiry};
use crate::x_imu3::wire::{self, Lines};
use crate::x_imu3::{Settings, XImu3Session, data};

/// Lines, data, announcements, the probe and a session.
///
/// # Panics
/// As all others of this module.
pub fn x_imu3(input: &[u8]) -> usize {
    let (mut head, script) = Head::of(input);
    let default = Settings::default();
    let settings = Settings {
        rate_hz: head.number(4.0, 400.0).unwrap_or(default.rate_hz),
        orientation: head.flag(default.orientation),
    };
    let answers = head.flag(false);
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[0]);
    let bytes = pieces(script);
    cut_both_ways(&bytes, |pieces| {
        let mut lines = Lines::default();
        let mut scratch = Vec::new();
        let mut out = Vec::new();
        for piece in pieces {
            lines.push(piece);
            while let Some(found) = lines.find() {
                let emitted = wire::parse(lines.line(found), &mut scratch).map(|message| {
                    let stamped = data::decode(&message.body);
                    let measured = stamped.map(|stamped| stamped.data.measurement());
                    format!("{message:?} {stamped:?} {measured:?}")
                });
                out.push((found.offset, emitted));
            }
        }
        (out, lines.bytes_skipped())
    });
    for announcement in bytes.iter().filter_map(|datagram| Announcement::parse(datagram)) {
        assert!(announcement.listens_on > 0, "nobody listens on port 0");
    }
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = XImu3Session::new(settings.clone(), &wanted) else { return 0 };
    // Each unit acknowledges every command.
    let commands = settings.commands();
    let lead: Vec<Vec<u8>> = commands
        .iter()
        .filter(|_| answers)
        .flat_map(|(key, value)| wanted.iter().map(|&address| wire::command(address, key, value)))
        .collect();
    session(&mut live, modem_lines, &lead, script, 0.0)
}
