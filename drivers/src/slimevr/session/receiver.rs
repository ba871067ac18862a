//! Trackers that come by radio, through a receiver on USB: who has which of its numbers, and what they say.

use super::super::hid::{self, Battery, Button, Contents, Packet, RECEIVER};
use super::{Identity, SlimeVrSession};
use crate::sample::{Arrival, DeviceTime, Timestamp};
use crate::session::Condition;

/// "Error", as a tracker states how it is.
const ERROR: u8 = 3;
/// A receiver names all trackers that it knows in less, s: 256 at most, four in each of ten reports a second.
const NAMED_S: f64 = 10.0;

impl SlimeVrSession {
    /// A report of the receiver.
    pub(super) fn report(&mut self, now: Timestamp, offset: u64, report: &[u8]) {
        let Some(packets) = hid::packets(report) else { return self.refuse(report.len()) };
        let Some(arrival) = self.arrivals.of(offset) else { return };
        self.look_for_strangers(now);
        for packet in packets {
            match packet {
                Ok(packet) => self.by_radio(now, packet, arrival),
                Err(hid::Impossible) => self.refuse(hid::PACKET),
            }
        }
    }

    fn by_radio(&mut self, now: Timestamp, Packet { id, contents }: Packet, arrival: Arrival) {
        if let Contents::Registration(mac) = contents {
            return self.register(now, id, mac);
        }
        // Nobody knows whose it is until the receiver says so, ten times a second.
        let Some(&k) = self.numbered.get(&id) else {
            self.bytes_skipped += hid::PACKET as u64;
            return;
        };
        if self.trackers[k].peer != Some(RECEIVER) {
            self.arrive(now, k, RECEIVER);
        }
        self.hear(now, k);
        let number = self.trackers[k].number;
        match contents {
            Contents::Motion { orientation_wxyz, acceleration_m_s2, battery, button, signal_dbm } => {
                self.trackers[k].proven = true;
                self.motion(number, arrival, DeviceTime::Cycle(0), Some(orientation_wxyz), acceleration_m_s2);
                self.tell_condition(number, battery, signal_dbm);
                if let Some(button) = button {
                    self.button(now, k, button);
                }
            }
            Contents::Info { battery, firmware, signal_dbm } => {
                self.tell_condition(number, Some(battery), Some(signal_dbm));
                self.conditions_of(number).for_each(|condition| condition.firmware = Some(firmware));
            }
            Contents::Status { code, signal_dbm } => {
                self.tell_condition(number, None, Some(signal_dbm));
                if code == ERROR {
                    self.outbox.warn(now, 0x300 + (u32::from(number) << 8), || {
                        format!("tracker {number} reports an error; restart it")
                    });
                }
            }
            Contents::Button(button) => self.button(now, k, button),
            Contents::Registration(_) | Contents::Other(_) => {}
        }
    }

    /// The receiver names a tracker that it knows, switched on or not. A number may have been another's before.
    fn register(&mut self, now: Timestamp, id: u8, mac: [u8; 6]) {
        match self.admit(now, Identity::Mac(mac)) {
            Some(k) => {
                self.numbered.insert(id, k);
                let number = self.trackers[k].number;
                self.conditions_of(number).for_each(|condition| condition.registered = Some(true));
                // While it is switched off its place is kept.
                let tracker = &mut self.trackers[k];
                if tracker.peer.is_none() {
                    tracker.received_at = now;
                }
            }
            None => _ = self.numbered.remove(&id),
        }
    }

    /// Reports trackers of the settings that the receiver would have named by now.
    fn look_for_strangers(&mut self, now: Timestamp) {
        let since = *self.receiver_since.get_or_insert(now);
        if now.seconds_since(since) < NAMED_S {
            return;
        }
        for k in 0..if self.open_to_all { 0 } else { self.trackers.len() } {
            let number = self.trackers[k].number;
            let unknown =
                |condition: &Condition| condition.address & 0xFF == number && condition.registered.is_none();
            if !self.conditions.iter().any(unknown) {
                continue;
            }
            self.conditions_of(number).for_each(|condition| condition.registered = Some(false));
            let identity = self.trackers[k].identity;
            self.outbox.warn(now, 0x700 + u32::from(number), || {
                format!(
                    "the receiver does not know tracker {number} ({identity}); pair it: `pair` on the receiver's serial console"
                )
            });
        }
    }

    fn tell_condition(&mut self, number: u16, battery: Option<Battery>, signal_dbm: Option<f64>) {
        self.conditions_of(number).for_each(|condition| {
            if let Some(battery) = battery {
                (condition.battery, condition.battery_v) = (battery.level, battery.volts);
            }
            condition.signal_dbm = signal_dbm.or(condition.signal_dbm);
        });
    }

    /// A press is repeated for a second: what counts is that it begins.
    fn button(&mut self, now: Timestamp, k: usize, button: Button) {
        let tracker = &mut self.trackers[k];
        let number = tracker.number;
        if std::mem::replace(&mut tracker.presses, button.presses) == 0 && button.presses > 0 {
            self.outbox.pressed(number);
        }
        if button.switches_off {
            self.forget_condition(number);
            self.outbox
                .warn(now, 0x600 + u32::from(number), || format!("tracker {number} switches itself off"));
        }
    }
}
