//! A network between a device and the host: whole datagrams, which get lost, doubled, late, out of order.
//!
//! What comes in: datagrams with the time at which each was sent. What goes out: datagrams at the times at
//! which the host can read them, in an envelope ([`posed_drivers::datagram`]) where several units share a
//! server, and the coming and going of the network.

use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddr;
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::datagram::Datagram;

use crate::faults::{Bytes, Fault, FaultHit};
use crate::line::{LineOutput, WireByte};
use crate::random::Random;
use crate::truth::Loss;

/// Time that a datagram takes when nothing is wrong.
const LATENCY: Duration = Duration::from_micros(300);
/// How much later than its turn a reordered datagram comes: behind one at 100 Hz, and before the next.
const REORDER: Duration = Duration::from_millis(15);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Lose,
    Double,
    Delay,
}

#[derive(Debug)]
struct Flight {
    deliver: Timestamp,
    bytes: Vec<u8>,
    records: Vec<Loss>,
}

/// The network of one device. Which datagrams are hit is seeded.
///
/// Modelled: a latency of 0.3 ms, datagrams that the script loses, doubles, delays or reorders (15 ms late; as many as it says, or
/// as come in the fault's span), the jitter of a radio, and a network that goes away. Only datagrams with measurements are lost, doubled or
/// reordered, and none from the host. Congestion is not modelled.
#[derive(Debug)]
pub struct UdpNetwork {
    /// Datagrams still to hit, next one first: from when on and until when, for a fault does not outlast its span.
    fates: VecDeque<([Timestamp; 2], Fate, &'static str)>,
    /// Times during which datagrams wait.
    delays: Vec<(Timestamp, Timestamp)>,
    plugging: VecDeque<(Timestamp, bool)>,
    plugged: bool,
    /// In the order of their deliveries.
    flights: VecDeque<Flight>,
    output: VecDeque<(Timestamp, LineOutput)>,
    /// What is added to each datagram at most, and when the latest of each unit comes: none overtakes another.
    jitter: Duration,
    random: Random,
    delivered: BTreeMap<Option<SocketAddr>, Timestamp>,
}

impl UdpNetwork {
    /// A network that adds up to `jitter` to each datagram.
    pub(crate) fn new(faults: &[Fault], jitter: Duration, mut random: Random) -> Self {
        let mut fates: Vec<([Timestamp; 2], Fate, &'static str)> = Vec::new();
        let mut plugging = Vec::new();
        let mut delays = Vec::new();
        for fault in faults {
            let (start_s, end_s) = fault.span_s();
            let [start, end] = [start_s, end_s].map(Timestamp::from_secs_f64);
            let mut spread = |Bytes { count, .. }: Bytes, fate| {
                fates.extend((0..count).map(|_| {
                    let t_s = start_s + random.uniform() * (end_s - start_s);
                    ([Timestamp::from_secs_f64(t_s), end], fate, fault.name())
                }));
            };
            match *fault {
                Fault::LostDatagrams(datagrams) => spread(datagrams, Fate::Lose),
                Fault::DuplicatedDatagrams(datagrams) => spread(datagrams, Fate::Double),
                Fault::ReorderedDatagrams(datagrams) => spread(datagrams, Fate::Delay),
                Fault::DelayedDatagrams { .. } => delays.push((start, end)),
                Fault::Unplug { .. } => {
                    plugging.push((start, false));
                    if end_s.is_finite() {
                        plugging.push((end, true));
                    }
                }
                _ => {}
            }
        }
        fates.sort_by_key(|&([from, _], ..)| from);
        plugging.sort();
        Self {
            fates: fates.into(),
            delays,
            plugging: plugging.into(),
            plugged: true,
            flights: VecDeque::new(),
            output: VecDeque::new(),
            jitter,
            random,
            delivered: BTreeMap::new(),
        }
    }

    /// Whether the network is there.
    pub(crate) fn is_plugged(&self) -> bool {
        self.plugged
    }

    /// Takes a datagram.
    pub(crate) fn send(&mut self, from: Option<SocketAddr>, wire: &[WireByte]) {
        let Some(sent) = wire.last().map(|last| last.t) else { return };
        let data: Vec<u8> = wire.iter().map(|byte| byte.byte).collect();
        let bytes = match from {
            Some(peer) => Datagram { peer, data: &data }.encode(),
            None => data,
        };
        let mut records: Vec<Loss> = wire.iter().flat_map(|byte| &byte.record).map(|r| r.loss()).collect();
        records.dedup();
        let held = self.delays.iter().find(|&&(from, to)| from <= sent && sent < to);
        let mut deliver = held.map_or(sent, |&(_, to)| to) + LATENCY;
        if self.jitter > Duration::ZERO {
            deliver = deliver + self.jitter.mul_f64(self.random.uniform());
            let last = self.delivered.entry(from).or_insert(deliver);
            deliver = deliver.max(*last);
            *last = deliver;
        }
        // Only datagrams with data are hit, so that the script states what is lost.
        while self.fates.front().is_some_and(|&([_, until], ..)| until < sent) {
            self.fates.pop_front();
        }
        let due = self.fates.front().copied().filter(|&([from, _], ..)| from <= sent && !records.is_empty());
        if let Some((_, fate, name)) = due {
            self.fates.pop_front();
            let (cycle, address) = records.first().map_or((None, None), |r| (Some(r.cycle), r.address));
            let hit = FaultHit { t: sent, fault: name, address, cycle, byte: None };
            self.output.push_back((sent, LineOutput::Fault(hit)));
            match fate {
                Fate::Lose => return self.lose(sent, &records),
                Fate::Double => {
                    self.insert(Flight { deliver, bytes: bytes.clone(), records: Vec::new() });
                }
                Fate::Delay => return self.insert(Flight { deliver: deliver + REORDER, bytes, records }),
            }
        }
        self.insert(Flight { deliver, bytes, records });
    }

    fn insert(&mut self, flight: Flight) {
        let at = self.flights.partition_point(|other| other.deliver <= flight.deliver);
        self.flights.insert(at, flight);
    }

    fn lose(&mut self, t: Timestamp, records: &[Loss]) {
        self.output.extend(records.iter().map(|&loss| (t, LineOutput::Lost(loss))));
    }

    /// When something happens next.
    pub(crate) fn poll_timeout(&self) -> Option<Timestamp> {
        let flight = self.flights.front().map(|flight| flight.deliver);
        let plug = self.plugging.front().map(|&(t, _)| t);
        [flight, plug].into_iter().flatten().min()
    }

    /// Does what is due at or before `now`.
    pub(crate) fn handle_timeout(&mut self, now: Timestamp) {
        while let Some(due) = self.poll_timeout().filter(|&due| due <= now) {
            if let Some(&(t, plugged)) = self.plugging.front()
                && t == due
            {
                self.plugging.pop_front();
                self.plugged = plugged;
                let change = if plugged { LineOutput::Replugged } else { LineOutput::Unplugged };
                self.output.push_back((t, change));
                if !plugged {
                    let hit = FaultHit { t, fault: "unplug", address: None, cycle: None, byte: None };
                    self.output.push_back((t, LineOutput::Fault(hit)));
                }
            } else if let Some(flight) = self.flights.pop_front() {
                if self.plugged {
                    self.output.push_back((due, LineOutput::Data(flight.bytes)));
                } else {
                    self.lose(due, &flight.records);
                }
            }
        }
    }

    /// The next output and its time, until `None`.
    pub(crate) fn poll_output(&mut self) -> Option<(Timestamp, LineOutput)> {
        self.output.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Transmitter;
    use crate::random::Purpose;

    /// Sends a numbered datagram every 10 ms, and gives what arrives.
    fn run(faults: &[Fault]) -> (Vec<(Timestamp, LineOutput)>, Vec<u8>) {
        let mut network = UdpNetwork::new(faults, Duration::ZERO, Random::new(3, Purpose::Faults(0)));
        let mut transmitter = Transmitter::new(100_000_000);
        let mut output = Vec::new();
        for cycle in 0..100u8 {
            let t = Timestamp::from_secs_f64(f64::from(cycle) * 0.01);
            network.handle_timeout(t);
            network.send(None, &transmitter.record(t, &[cycle], cycle.into(), Some(1)));
            output.extend(std::iter::from_fn(|| network.poll_output()));
        }
        network.handle_timeout(Timestamp::from_secs_f64(5.0));
        output.extend(std::iter::from_fn(|| network.poll_output()));
        let data = output.iter().filter_map(|(_, output)| match output {
            LineOutput::Data(bytes) => Some(bytes[0]),
            _ => None,
        });
        let data = data.collect();
        (output, data)
    }

    fn few(count: u32) -> Bytes {
        Bytes { start_s: 0.1, end_s: 0.9, count }
    }

    #[test]
    fn a_quiet_network_delivers_all_in_order() {
        assert_eq!(run(&[]).1, (0..100).collect::<Vec<u8>>());
    }

    #[test]
    fn each_fault_hits_as_many_as_it_says_and_losses_are_reported() {
        let (output, data) = run(&[Fault::LostDatagrams(few(7))]);
        assert_eq!(data.len(), 93);
        let lost = output.iter().filter_map(|(_, output)| match output {
            LineOutput::Lost(loss) => Some(loss.cycle),
            _ => None,
        });
        let missing = (0..100).filter(|&cycle| !data.contains(&(cycle as u8)));
        assert!(lost.eq(missing));
        let (_, data) = run(&[Fault::DuplicatedDatagrams(few(7))]);
        assert_eq!(data.len(), 107);
        let (_, data) = run(&[Fault::ReorderedDatagrams(few(1))]);
        assert_eq!(data.len(), 100);
        assert_eq!(data.windows(2).filter(|pair| pair[1] < pair[0]).count(), 1);
    }

    #[test]
    fn no_fault_outlasts_its_span() {
        let (_, data) = run(&[Fault::LostDatagrams(Bytes { start_s: 0.1, end_s: 0.15, count: 40 })]);
        let lost: Vec<u8> = (0..100).filter(|cycle| !data.contains(cycle)).collect();
        assert!(!lost.is_empty() && lost.iter().all(|cycle| (10..=15).contains(cycle)), "{lost:?}");
    }

    #[test]
    fn delayed_datagrams_arrive_at_once_and_unplugged_ones_never() {
        let (output, data) = run(&[Fault::DelayedDatagrams { at_s: 0.2, duration_s: 0.3 }]);
        assert_eq!(data, (0..100).collect::<Vec<u8>>());
        let at = |cycle: u8| output.iter().find(|(_, out)| *out == LineOutput::Data(vec![cycle])).unwrap().0;
        assert_eq!(at(20), at(49));
        let unplug = Fault::Unplug { at_s: 0.2005, duration_s: Some(0.3), power: false };
        let (_, data) = run(&[unplug]);
        assert_eq!(data.len(), 70);
    }
}
