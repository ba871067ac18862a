//! Places for connections: who waits to be let in, and who is in.
//!
//! A connection waits until it has asked for a websocket and its Origin and token were accepted; then it takes a place. Both are
//! counted by network: an IPv4 address, or 64 bits of an IPv6 address, of which one subscriber has as many as it likes. Whoever
//! comes may wait. Where too many do, the oldest of the network that has most of them is closed: a flood closes itself.
//!
//! Being closed costs whoever comes back at once nothing, but us a handshake and a greeting: so a network has a budget of new
//! connections, and pays fifty of them for one that is cut for what it sent. What is beyond is closed before anything is read of it.
//! Messages cost as much from many connections as from one: a network has a budget of them too.

use std::collections::{BTreeMap, VecDeque};
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use posed_stage::Limits;
use tokio::sync::Notify;

use super::budget::{Budget, now};

/// New connections that one costs which is cut for what it sent.
const BREACH: f64 = 50.0;
/// Networks whose budgets are kept; of one more, those of the one without a connection that has spent least are forgotten.
const NETWORKS: usize = 1024;

/// How many connections there may be, in all and from one network; clones count together.
#[derive(Clone, Debug)]
pub(super) struct Slots {
    limits: Limits,
    taken: Arc<Taken>,
}

#[derive(Debug, Default)]
struct Taken {
    counts: Mutex<Counts>,
    freed: Notify,
}

#[derive(Debug, Default)]
struct Counts {
    /// Of connections that are in, by network.
    inside: BTreeMap<IpAddr, usize>,
    /// Those that wait, oldest first, by network: what closes each of them.
    waiting: BTreeMap<IpAddr, VecDeque<Arc<Notify>>>,
    budgets: BTreeMap<IpAddr, Budgets>,
}

/// What may still come from one network.
#[derive(Debug)]
struct Budgets {
    connections: Budget,
    messages: Budget,
}

/// Why a connection gets no place; the sentences are answers.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum NoSlot {
    #[error("this daemon serves {0} connections at most; try again later")]
    Total(usize),
    #[error("this daemon serves {0} connections of one address at most; try again later")]
    PerAddress(usize),
    #[error("too many connections wait to be let in; try again later")]
    GivenUp,
}

/// A connection's place; freed when dropped.
#[derive(Debug)]
pub(super) struct Slot {
    network: IpAddr,
    given_up: Arc<Notify>,
    is_inside: AtomicBool,
    /// Pieces of a long answer that were taken so far.
    moved: AtomicU64,
    slots: Slots,
}

impl Slots {
    pub(super) fn new(limits: &Limits) -> Self {
        Self { limits: limits.clone(), taken: Arc::default() }
    }

    /// Lets a new connection wait; where too many do, another one is closed. `None` where its network has too many new ones.
    pub(super) fn wait(&self, address: IpAddr) -> Option<Slot> {
        let network = network(address);
        let mut counts = self.taken.lock();
        let limits = &self.limits;
        let new = || Budgets {
            connections: Budget::new(limits.connections_per_s, limits.connection_burst),
            messages: Budget::new(limits.messages_per_s_per_address, limits.message_burst_per_address),
        };
        if !counts.budgets.entry(network).or_insert_with(new).connections.spend(1.0, now()) {
            return None;
        }
        let given_up = Arc::new(Notify::new());
        counts.waiting.entry(network).or_default().push_back(Arc::clone(&given_up));
        counts.forget_networks();
        if counts.waiting.values().map(VecDeque::len).sum::<usize>() > limits.waiting {
            counts.give_up_one();
        }
        drop(counts);
        Some(Slot {
            network,
            given_up,
            is_inside: AtomicBool::new(false),
            moved: AtomicU64::new(0),
            slots: self.clone(),
        })
    }

    /// Waits until no connection is left.
    pub(super) async fn all_free(&self) {
        loop {
            let freed = self.taken.freed.notified();
            if self.taken.lock().is_empty() {
                return;
            }
            freed.await;
        }
    }
}

impl Slot {
    /// Takes a place for a connection that waits.
    ///
    /// # Errors
    /// There is none; it waits on, for the answer.
    pub(super) fn enter(&self) -> Result<(), NoSlot> {
        let mut counts = self.slots.taken.lock();
        let &Limits { connections, connections_per_address, .. } = &self.slots.limits;
        if counts.inside.values().sum::<usize>() >= connections {
            return Err(NoSlot::Total(connections));
        }
        if counts.inside.get(&self.network).is_some_and(|inside| *inside >= connections_per_address) {
            return Err(NoSlot::PerAddress(connections_per_address));
        }
        if !counts.remove(self.network, &self.given_up) {
            return Err(NoSlot::GivenUp);
        }
        *counts.inside.entry(self.network).or_insert(0) += 1;
        self.is_inside.store(true, Ordering::Relaxed);
        Ok(())
    }

    /// A piece of a long answer was taken.
    pub(super) fn moves(&self) {
        self.moved.fetch_add(1, Ordering::Relaxed);
    }

    /// How many pieces were taken so far: somebody reads where there are more than a while ago.
    pub(super) fn moved(&self) -> u64 {
        self.moved.load(Ordering::Relaxed)
    }

    /// Its connection is cut for what it sent.
    pub(super) fn breach(&self) {
        if let Some(budgets) = self.slots.taken.lock().budgets.get_mut(&self.network) {
            budgets.connections.charge(BREACH, now());
        }
    }

    /// Counts a message; false where its network has sent too many.
    pub(super) fn may_speak(&self) -> bool {
        let mut counts = self.slots.taken.lock();
        counts.budgets.get_mut(&self.network).is_none_or(|budgets| budgets.messages.spend(1.0, now()))
    }

    /// Waits until the connection has waited too long beside too many others.
    pub(super) async fn given_up(&self) {
        self.given_up.notified().await;
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut counts = self.slots.taken.lock();
        if *self.is_inside.get_mut() {
            if let Some(inside) = counts.inside.get_mut(&self.network) {
                *inside -= 1;
                if *inside == 0 {
                    counts.inside.remove(&self.network);
                }
            }
        } else {
            counts.remove(self.network, &self.given_up);
        }
        drop(counts);
        self.slots.taken.freed.notify_one();
    }
}

impl Taken {
    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Counts {
    fn is_empty(&self) -> bool {
        self.inside.is_empty() && self.waiting.is_empty()
    }

    /// Keeps no more budgets than it may.
    fn forget_networks(&mut self) {
        if self.budgets.len() <= NETWORKS {
            return;
        }
        let now = now();
        let Self { inside, waiting, budgets } = self;
        let spent_least = budgets
            .iter_mut()
            .filter(|(network, _)| !inside.contains_key(network) && !waiting.contains_key(network))
            .map(|(network, budgets)| (*network, budgets.connections.left(now)))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        if let Some((network, _)) = spent_least {
            self.budgets.remove(&network);
        }
    }

    /// Closes the oldest connection of the network of which most wait.
    fn give_up_one(&mut self) {
        let most = self.waiting.iter().max_by_key(|(_, waiting)| waiting.len());
        let oldest = most.and_then(|(network, waiting)| Some((*network, Arc::clone(waiting.front()?))));
        if let Some((network, given_up)) = oldest {
            given_up.notify_one();
            self.remove(network, &given_up);
        }
    }

    /// Takes a connection from those that wait; false where it is not among them.
    fn remove(&mut self, network: IpAddr, given_up: &Arc<Notify>) -> bool {
        let Some(waiting) = self.waiting.get_mut(&network) else { return false };
        let Some(at) = waiting.iter().position(|waits| Arc::ptr_eq(waits, given_up)) else { return false };
        waiting.remove(at);
        if waiting.is_empty() {
            self.waiting.remove(&network);
        }
        true
    }
}

/// What counts as one: an IPv4 address, or the first 64 bits of an IPv6 address.
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => {
            let [a, b, c, d, ..] = address.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slots(connections: usize, connections_per_address: usize, waiting: usize) -> Slots {
        let connection_burst = 2000.0;
        let limits =
            Limits { connections, connections_per_address, waiting, connection_burst, ..Limits::default() };
        Slots::new(&limits)
    }

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn places_are_counted_in_all_and_per_network() {
        let slots = slots(3, 2, 10);
        let enter = |text: &str| {
            let slot = slots.wait(address(text)).unwrap();
            slot.enter().map(|()| slot)
        };
        // All addresses of a subscriber are one.
        let first = enter("2001:db8:1:2::1").unwrap();
        let _second = enter("2001:db8:1:2:a:b:c:d").unwrap();
        assert_eq!(enter("2001:db8:1:2::3").unwrap_err(), NoSlot::PerAddress(2));
        let _third = enter("127.0.0.1").unwrap();
        assert_eq!(enter("::ffff:127.0.0.1").unwrap_err(), NoSlot::Total(3));
        drop(first);
        assert!(enter("2001:db8:1:2::3").is_ok());
    }

    #[tokio::test]
    async fn a_flood_of_connections_that_wait_closes_itself_and_no_other() {
        let slots = slots(512, 256, 8);
        let honest = slots.wait(address("192.0.2.1")).unwrap();
        let floods = ["198.51.100.1", "198.51.100.2"].map(address);
        let flood: Vec<Slot> = (0..1000).map(|k| slots.wait(floods[k % 2]).unwrap()).collect();
        flood[0].given_up().await;
        assert_eq!(flood[0].enter().unwrap_err(), NoSlot::GivenUp);
        // Neither who came before nor who comes now.
        assert!(honest.enter().is_ok() && slots.wait(address("192.0.2.2")).unwrap().enter().is_ok());
        let left = flood.iter().filter(|slot| slot.enter().is_ok()).count();
        assert_eq!(left, 7);
        drop((flood, honest));
        slots.all_free().await;
    }

    #[test]
    fn a_network_that_comes_again_and_again_is_not_looked_at_and_no_other_suffers() {
        // Nothing comes back while the test lasts, however slow the machine.
        let limits = Limits { connections_per_s: 1e-9, ..Limits::default() };
        let slots = Slots::new(&limits);
        let flood = address("2001:db8:1:2::1");
        let come = |address| slots.wait(address).is_some();
        assert_eq!((0..10_000).filter(|_| come(flood)).count() as f64, limits.connection_burst);
        assert!(!come(address("2001:db8:1:2::3")) && come(address("2001:db8:1:3::1")));
        // Nor do those that are counted grow without end, whoever comes; who has spent most is not forgotten.
        for k in 0..5000_u16 {
            assert!(come(Ipv6Addr::new(0x2001, 0xdb8, 2, k, 0, 0, 0, 1).into()));
        }
        assert_eq!(slots.taken.lock().budgets.len(), NETWORKS);
        assert!(!(0..100).any(|_| come(flood)));
    }

    #[test]
    fn messages_are_counted_over_all_connections_of_a_network() {
        let limits = Limits {
            message_burst_per_address: 100.0,
            messages_per_s_per_address: 1e-9,
            ..Limits::default()
        };
        let slots = Slots::new(&limits);
        let come = |text: &str| slots.wait(address(text)).unwrap();
        let talkers = ["192.0.2.1"; 10].map(come);
        let other = come("192.0.2.2");
        let taken = (0..1000).filter(|k| talkers[k % 10].may_speak()).count();
        assert_eq!(taken, 100);
        assert!(other.may_speak() && !come("192.0.2.1").may_speak());
        // Nor are they forgotten while it is there, whoever else comes.
        for k in 0..5000_u16 {
            let newcomer = || slots.wait(Ipv6Addr::new(0x2001, 0xdb8, 2, k, 0, 0, 0, 1).into());
            assert!(newcomer().is_some() && newcomer().is_some());
        }
        assert_eq!((0..1000).filter(|_| other.may_speak()).count(), 99);
    }
}
