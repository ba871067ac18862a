//! Which packets of one tracker are new.
//!
//! A network keeps packets back, turns them round and doubles them, for seconds. Those that are older than the latest are identified by
//! their number; but a tracker that was switched off counts from the beginning, and what it had sent before is on its way still,
//! under greater numbers. It cannot have sent so many in so short a time: such a packet is of its life before, and believing it would
//! refuse all that come until the new count has passed it.

use posed_state::Plain;

use crate::sample::Timestamp;

/// More packets than a tracker sends in a second: 16 sensors every 10 ms, and what it says of itself.
const MOST_PER_S: f64 = 2000.0;
/// So many may come at once, each with the sensors' news of one instant.
const AT_ONCE: u64 = 20;
/// Longest gap of numbers that is a loss, and not a new count.
const MOST_LOST: u64 = 1_000_000;
/// After so long a time in which packets follow one another they are what the tracker counts now, s.
const BELIEVED_S: f64 = 1.0;

/// A run of packets by number.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Run {
    begun: Timestamp,
    /// When its latest came, and its number.
    t: Timestamp,
    number: u64,
}

impl Run {
    fn new(now: Timestamp, number: u64) -> Self {
        Self { begun: now, t: now, number }
    }

    /// Goes on with a packet that the tracker may have sent after the latest.
    fn follow(&mut self, now: Timestamp, number: u64) -> bool {
        let most = AT_ONCE + (MOST_PER_S * now.seconds_since(self.t).max(0.0)) as u64;
        let follows = number > self.number && number - self.number <= most;
        if follows {
            (self.t, self.number) = (now, number);
        }
        follows
    }
}

/// The order of one tracker's packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub(super) struct Order {
    latest: Option<Run>,
    /// Packets that do not follow the latest, but one another.
    rival: Option<Run>,
}

impl Order {
    /// How many packets are missing in front of this one, or `None` for one that is not new. A tracker's first packet is new.
    pub(super) fn push(&mut self, now: Timestamp, number: u64) -> Option<u64> {
        let before = self.latest.get_or_insert(Run::new(now, number - 1));
        let missing = number.saturating_sub(before.number.saturating_add(1));
        if before.follow(now, number) {
            self.rival = None;
            return Some(if missing < MOST_LOST { missing } else { 0 });
        }
        let mut rival = self.rival.unwrap_or(Run::new(now, number.saturating_sub(1)));
        if !rival.follow(now, number) {
            rival = Run::new(now, number);
        }
        self.rival = Some(rival);
        if now.seconds_since(rival.begun) < BELIEVED_S {
            return None;
        }
        self.latest = self.rival.take();
        Some(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(t_s: f64) -> Timestamp {
        Timestamp::from_secs_f64(t_s)
    }

    #[test]
    fn what_is_missing_is_counted_and_what_is_old_refused() {
        let mut order = Order::default();
        assert_eq!(order.push(at(0.0), 1000), Some(0));
        assert_eq!(order.push(at(0.01), 1001), Some(0));
        assert_eq!(order.push(at(0.02), 1003), Some(1));
        assert_eq!(order.push(at(0.02), 1002), None);
        assert_eq!(order.push(at(0.02), 1003), None);
        // Nine seconds in which the network lost everything.
        assert_eq!(order.push(at(9.02), 1903), Some(899));
    }

    #[test]
    fn a_packet_of_the_life_before_is_refused_and_stops_nothing() {
        let mut order = Order::default();
        assert_eq!(order.push(at(0.0), 4), Some(0));
        // They had waited: the tracker was switched off meanwhile.
        for (t_s, number) in [(0.008, 951), (0.008, 993), (0.009, 1133)] {
            assert_eq!(order.push(at(t_s), number), None, "{number}");
        }
        for k in 1..100 {
            assert_eq!(order.push(at(0.01 * k as f64), 4 + k), Some(0));
        }
    }

    #[test]
    fn a_first_packet_of_the_life_before_silences_the_new_one_for_a_second() {
        let mut order = Order::default();
        assert_eq!(order.push(at(0.0), 951), Some(0));
        let taken = (1..300).filter(|k| order.push(at(0.01 * *k as f64), *k).is_some()).collect::<Vec<_>>();
        assert_eq!(taken, (101..300).collect::<Vec<_>>());
    }

    #[test]
    fn what_comes_at_once_after_newer_ones_is_no_new_count() {
        let mut order = Order::default();
        assert_eq!(order.push(at(0.0), 2000), Some(0));
        assert!((1000..1900).all(|number| order.push(at(0.005), number).is_none()));
        assert_eq!(order.push(at(0.01), 2001), Some(0));
    }
}
