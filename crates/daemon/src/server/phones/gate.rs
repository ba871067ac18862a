//! Who is connected to `/imu`, between the websockets and the port of a device.
//!
//! In: text messages of each connection. Out: the same as envelopes ([`posed_drivers::datagram`]) in the log, where a device of the stage
//! has the port `websocket`; what the device's session transmits, back to its connection. Never: a connection or a device that
//! waits for the other, or more connections than a session takes devices.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use posed_drivers::datagram::{Datagram, datagrams};
use posed_drivers::{LineEvent, Timestamp};
use posed_stage::input::{DeviceIndex, Entry, Input};
use serde::Deserialize;
use tokio::sync::mpsc;

use super::super::outbox::Close;
use crate::clock::StageClock;
use crate::fusion::FusionInbox;

/// Connections at a time: as many as a session takes devices.
const MOST: usize = 64;
/// Messages that wait for one connection; of one that takes none, more are dropped: each answers something that is over by then.
const WAITING: usize = 64;

/// What a message of a connection must not be.
const REFUSED: Close =
    Close { code: 1008, reason: "too many messages that are none, or another connection with this id" };

/// Where connections and a device's port meet; clones share it.
#[derive(Clone, Default)]
pub(crate) struct Gate(Arc<Mutex<Meeting>>);

#[derive(Default)]
struct Meeting {
    connections: BTreeMap<SocketAddr, Connection>,
    reader: Option<Reader>,
}

/// What reads for a device: the pipeline's inbox.
pub(crate) struct Reader {
    pub(crate) device: DeviceIndex,
    pub(crate) clock: StageClock,
    pub(crate) inbox: FusionInbox,
}

struct Connection {
    to: mpsc::Sender<ToPeer>,
    /// Its newest greeting.
    hello: Option<Hello>,
    /// Its newest message with measurements, and when it came.
    newest: Option<String>,
}

/// A connection that has its place, until dropped.
pub(super) struct Entered {
    gate: Gate,
    pub(super) peer: SocketAddr,
    /// What goes out to it.
    pub(super) outgoing: mpsc::Receiver<ToPeer>,
}

impl Entered {
    /// It says something.
    pub(super) fn hear(&self, text: &str) {
        self.gate.hear(self.peer, text);
    }

    /// Its greeting.
    pub(super) fn hello(&self) -> Option<Hello> {
        self.gate.lock().connections.get(&self.peer)?.hello.clone()
    }
}

impl Drop for Entered {
    fn drop(&mut self) {
        self.gate.leave(self.peer);
    }
}

/// What is to be done with a connection.
#[derive(Debug, PartialEq)]
pub(super) enum ToPeer {
    Text(String),
    Close(Close),
}

/// What a greeting says of its device.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub(crate) struct Hello {
    pub(crate) id: String,
    #[serde(default)]
    pub(crate) name: String,
}

/// A connection as others see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Connected {
    pub(crate) peer: SocketAddr,
    pub(crate) hello: Hello,
    /// Newest orientation that it has sent, w, x, y, z.
    pub(crate) orientation_wxyz: Option<[f64; 4]>,
}

impl Reader {
    fn read(&self, peer: SocketAddr, data: &[u8]) {
        self.enter(Input::Bytes { device: self.device, bytes: Datagram { peer, data }.encode() });
    }

    fn enter(&self, input: Input) {
        self.inbox.enter(Entry { t: self.now(), input });
    }

    fn now(&self) -> Timestamp {
        self.clock.now()
    }
}

impl Gate {
    /// From now on what connections say goes to this device.
    pub(crate) fn lead_to(&self, reader: Reader) {
        reader.enter(Input::Line { device: reader.device, event: LineEvent::Opened { modem_lines: false } });
        self.lock().reader = Some(reader);
    }

    /// A connection comes. `None` where there are too many.
    pub(super) fn enter(&self, peer: SocketAddr) -> Option<Entered> {
        let (to, outgoing) = mpsc::channel(WAITING);
        let mut meeting = self.lock();
        if meeting.connections.len() >= MOST {
            return None;
        }
        meeting.connections.insert(peer, Connection { to, hello: None, newest: None });
        drop(meeting);
        Some(Entered { gate: self.clone(), peer, outgoing })
    }

    /// A connection says something.
    fn hear(&self, peer: SocketAddr, text: &str) {
        let mut meeting = self.lock();
        let Meeting { connections, reader } = &mut *meeting;
        let Some(connection) = connections.get_mut(&peer) else { return };
        if text.contains("\"imu\"")
            && let Ok(hello) = serde_json::from_str(text)
        {
            connection.hello = Some(hello);
        } else if text.contains("\"b\"") || text.contains("\"q\"") {
            connection.newest = Some(text.to_owned());
        }
        match reader {
            Some(reader) => reader.read(peer, text.as_bytes()),
            // Nothing of it is measured by anybody; its page shows that it is here.
            None => {
                if let Some(answer) = answer_of_nobody(text) {
                    let _ = connection.to.try_send(ToPeer::Text(answer));
                }
            }
        }
    }

    /// A connection is gone.
    fn leave(&self, peer: SocketAddr) {
        let mut meeting = self.lock();
        meeting.connections.remove(&peer);
        if let Some(reader) = &meeting.reader {
            reader.read(peer, &[]);
        }
    }

    /// What a device's session transmits: envelopes, of which one without data ends its connection.
    pub(crate) fn transmit(&self, envelopes: &[u8]) {
        let meeting = self.lock();
        for Datagram { peer, data } in datagrams(envelopes).flatten() {
            let Some(connection) = meeting.connections.get(&peer) else { continue };
            let outgoing = match std::str::from_utf8(data) {
                _ if data.is_empty() => ToPeer::Close(REFUSED),
                Ok(text) => ToPeer::Text(text.to_owned()),
                Err(_) => continue,
            };
            let _ = connection.to.try_send(outgoing);
        }
    }

    /// Has the device of this id show itself; whether it is there.
    pub(crate) fn blink(&self, id: &str) -> bool {
        let meeting = self.lock();
        let is_it = |connection: &&Connection| connection.hello.as_ref().is_some_and(|hello| hello.id == id);
        let asked = |connection: &Connection| {
            connection.to.try_send(ToPeer::Text(r#"{"blink":true}"#.to_owned())).is_ok()
        };
        // Of several with one id the old ones are closed: whoever takes it is the one.
        meeting.connections.values().filter(is_it).filter(|connection| asked(connection)).count() > 0
    }

    /// Those that have said who they are, by their ids; of several with one id the latest.
    pub(crate) fn connected(&self) -> Vec<Connected> {
        let meeting = self.lock();
        let mut by_id = BTreeMap::new();
        for (&peer, connection) in &meeting.connections {
            if let Some(hello) = &connection.hello {
                let orientation_wxyz = connection.newest.as_deref().and_then(orientation);
                by_id.insert(hello.id.clone(), Connected { peer, hello: hello.clone(), orientation_wxyz });
            }
        }
        by_id.into_values().collect()
    }

    fn lock(&self) -> MutexGuard<'_, Meeting> {
        // Every change is complete before anything in it could panic.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a device is answered where the stage has none that it could be.
fn answer_of_nobody(text: &str) -> Option<String> {
    #[derive(Deserialize)]
    struct Said {
        imu: Option<u32>,
        id: Option<String>,
        ping: Option<serde_json::Value>,
    }
    let said: Said = serde_json::from_str(text).ok()?;
    match said {
        Said { imu: Some(_), id: Some(id), .. } => {
            Some(serde_json::json!({"ok": 1, "id": id, "epoch": 0}).to_string())
        }
        Said { ping: Some(ping), .. } => Some(serde_json::json!({"pong": ping}).to_string()),
        _ => None,
    }
}

/// The newest orientation of a message: that of a sample, or of the last row of a block.
fn orientation(text: &str) -> Option<[f64; 4]> {
    #[derive(Deserialize)]
    struct Measured {
        q: Option<[f64; 4]>,
        #[serde(default)]
        b: Vec<Vec<Option<f64>>>,
    }
    let measured: Measured = serde_json::from_str(text).ok()?;
    let in_row = |row: &Vec<Option<f64>>| match row.len() {
        // Number, time, gyro, acceleration; with or without the magnetic field; the orientation last.
        12 | 15 => row.last_chunk::<4>().and_then(|[w, x, y, z]| Some([(*w)?, (*x)?, (*y)?, (*z)?])),
        _ => None,
    };
    let q = measured.q.or_else(|| measured.b.iter().rev().find_map(in_row))?;
    let norm = q.iter().map(|part| part * part).sum::<f64>().sqrt();
    (0.9..1.1).contains(&norm).then(|| q.map(|part| part / norm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::{Command, INBOX_CAPACITY};
    use crate::inbox::{Event, Inbox};

    fn peer(port: u16) -> SocketAddr {
        ([192, 0, 2, 7], port).into()
    }

    fn entries(inbox: &Inbox<Command>, clock: StageClock) -> Vec<Input> {
        let pop = || match inbox.pop_until(Some(clock.instant(clock.now()))) {
            Some(Event::Entry(entry)) => Some(entry.input),
            _ => None,
        };
        std::iter::from_fn(pop).collect()
    }

    #[test]
    fn what_is_said_is_in_the_log_and_what_is_transmitted_comes_back() {
        let (gate, clock, inbox) = (Gate::default(), StageClock::start(), Inbox::new(INBOX_CAPACITY));
        gate.lead_to(Reader { device: 3, clock, inbox: inbox.clone() });
        let mut entered = gate.enter(peer(1)).unwrap();
        gate.hear(peer(1), r#"{"imu":1,"id":"p-1","name":"Left"}"#);
        gate.transmit(&Datagram { peer: peer(1), data: b"{\"ok\":1}" }.encode());
        gate.transmit(&Datagram { peer: peer(2), data: b"nobody" }.encode());
        gate.transmit(&Datagram { peer: peer(1), data: b"" }.encode());
        assert_eq!(entered.outgoing.try_recv(), Ok(ToPeer::Text("{\"ok\":1}".to_owned())));
        assert_eq!(entered.outgoing.try_recv(), Ok(ToPeer::Close(REFUSED)));
        drop(entered);
        let said: Vec<Input> = entries(&inbox, clock);
        let Input::Bytes { device: 3, bytes } = &said[1] else { panic!("{said:?}") };
        assert!(datagrams(bytes).next().unwrap().unwrap().data.starts_with(b"{\"imu\""));
        let Input::Bytes { bytes, .. } = &said[2] else { panic!("{said:?}") };
        assert_eq!(datagrams(bytes).next(), Some(Ok(Datagram { peer: peer(1), data: b"" })));
    }

    #[test]
    fn who_is_connected_is_known_without_a_device() {
        let gate = Gate::default();
        let mut entered = gate.enter(peer(1)).unwrap();
        gate.hear(peer(1), "nonsense");
        assert_eq!(gate.connected(), []);
        gate.hear(peer(1), r#"{"imu":1,"id":"p-1","name":"Left"}"#);
        assert_eq!(
            entered.outgoing.try_recv(),
            Ok(ToPeer::Text(r#"{"epoch":0,"id":"p-1","ok":1}"#.to_owned()))
        );
        gate.hear(peer(1), r#"{"s":0,"b":[[1,2,0,0,0,0,0,9.8,1,0,0,0],[2,3,0,0,0,0,0,9.8,0.6,0.8,0,0]]}"#);
        let [connected] = &gate.connected()[..] else { panic!() };
        assert_eq!(
            (connected.hello.name.as_str(), connected.orientation_wxyz),
            ("Left", Some([0.6, 0.8, 0.0, 0.0]))
        );
        drop(entered);
        assert_eq!(gate.connected(), []);
    }

    #[test]
    fn answers_that_a_phone_does_not_take_are_left_out() {
        let gate = Gate::default();
        let mut entered = gate.enter(peer(1)).unwrap();
        for n in 0..2 * WAITING {
            gate.transmit(&Datagram { peer: peer(1), data: n.to_string().as_bytes() }.encode());
        }
        let taken = std::iter::from_fn(|| entered.outgoing.try_recv().ok()).count();
        assert_eq!(taken, WAITING);
    }

    #[test]
    fn there_are_no_more_connections_than_devices() {
        let gate = Gate::default();
        let mut all: Vec<_> = (0..64).map(|port| gate.enter(peer(port)).unwrap()).collect();
        assert!(gate.enter(peer(64)).is_none());
        all.remove(7);
        assert!(gate.enter(peer(64)).is_some());
    }

    #[test]
    fn an_orientation_is_that_of_the_newest_row() {
        assert_eq!(orientation(r#"{"n":1,"q":[2,0,0,0]}"#), None, "none that has the length of another");
        assert_eq!(orientation(r#"{"n":1,"g":[0,0,0]}"#), None);
        assert_eq!(orientation(r#"{"b":[[1,2,0,0,0,0,0,9.8]]}"#), None);
        assert_eq!(orientation(r#"{"n":1,"q":[1,0,0,0]}"#), Some([1.0, 0.0, 0.0, 0.0]));
    }
}
