//! The one queue into the fusion thread.
//!
//! Bounded, and it never blocks who pushes: when it is full, the oldest read chunk in it becomes a
//! [`LineEvent::Dropped`] of its device, in the same place of the order, so that the decoder knows of the hole, the loss is
//! counted, and the input log stays true. Line events, models and commands are never dropped. (A plain channel can drop the oldest item
//! only whatever it is, and leaves no trace where it was.)

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use posed_drivers::{LineEvent, Timestamp};

use posed_stage::input::{Entry, Input};

/// What the fusion thread receives.
#[derive(Debug)]
pub(super) enum Event<C> {
    /// Something for the pipeline and the log.
    Entry(Entry),
    /// Something for the thread itself.
    Command(C),
}

/// Sending and receiving end of the queue; clones share it.
#[derive(Debug)]
pub struct Inbox<C> {
    shared: Arc<Shared<C>>,
}

impl<C> Clone for Inbox<C> {
    fn clone(&self) -> Self {
        Self { shared: Arc::clone(&self.shared) }
    }
}

#[derive(Debug)]
struct Shared<C> {
    queue: Mutex<VecDeque<Event<C>>>,
    filled: Condvar,
    capacity: usize,
}

impl<C> Inbox<C> {
    /// A queue in which chunks give way once it holds `capacity` events.
    pub fn new(capacity: usize) -> Self {
        let queue = Mutex::new(VecDeque::with_capacity(capacity));
        Self { shared: Arc::new(Shared { queue, filled: Condvar::new(), capacity }) }
    }

    /// Appends something for the pipeline and the log. Never waits: where the queue is full, its oldest read chunk gives way, and
    /// a mark of the loss stays in its place. Entries of all other kinds are never dropped.
    pub fn enter(&self, entry: Entry) {
        self.push(Event::Entry(entry));
    }

    /// Appends something for the thread itself.
    pub(super) fn command(&self, command: C) {
        self.push(Event::Command(command));
    }

    fn push(&self, event: Event<C>) {
        let mut queue = self.lock();
        if queue.len() >= self.shared.capacity {
            drop_oldest_chunk(&mut queue);
        }
        queue.push_back(event);
        drop(queue);
        self.shared.filled.notify_one();
    }

    /// The next event; `None` when `deadline` passes first. Without a deadline it waits for ever.
    #[expect(clippy::disallowed_methods, reason = "the fusion thread waits here")]
    pub(super) fn pop_until(&self, deadline: Option<Instant>) -> Option<Event<C>> {
        let mut queue = self.lock();
        loop {
            if let Some(event) = queue.pop_front() {
                return Some(event);
            }
            queue = match deadline {
                None => self.shared.filled.wait(queue).unwrap_or_else(PoisonError::into_inner),
                Some(deadline) => {
                    let left = deadline.saturating_duration_since(Instant::now());
                    if left.is_zero() {
                        return None;
                    }
                    self.shared.filled.wait_timeout(queue, left).unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }

    /// Things for the thread itself that wait.
    pub(super) fn commands(&self) -> usize {
        self.lock().iter().filter(|event| matches!(event, Event::Command(_))).count()
    }

    /// Stamp of the oldest entry that waits.
    pub(super) fn waiting_since(&self) -> Option<Timestamp> {
        self.lock().iter().find_map(|event| match event {
            Event::Entry(entry) => Some(entry.t),
            Event::Command(_) => None,
        })
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Event<C>>> {
        // A panic elsewhere cannot leave the queue half-changed: every change is one call.
        self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Turns the oldest chunk into a mark of the bytes lost, merged into an older mark of the same device.
fn drop_oldest_chunk<C>(queue: &mut VecDeque<Event<C>>) {
    let chunk = queue.iter().enumerate().find_map(|(at, event)| match event {
        Event::Entry(Entry { t, input: Input::Bytes { device, bytes } }) => {
            Some((at, *t, *device, bytes.len() as u64))
        }
        _ => None,
    });
    let Some((at, t, device, lost)) = chunk else {
        // Only what must not be lost: the bound gives way rather than the order.
        return;
    };
    // The device's last line event before the chunk: only a mark that is not behind a reopening may take it in.
    let mark = queue.range_mut(..at).rev().find_map(|event| match event {
        Event::Entry(Entry { input: Input::Line { device: of, event }, .. }) if *of == device => Some(event),
        _ => None,
    });
    if let Some(LineEvent::Dropped { bytes }) = mark {
        *bytes += lost;
        queue.remove(at);
    } else {
        let input = Input::Line { device, event: LineEvent::Dropped { bytes: lost } };
        queue[at] = Event::Entry(Entry { t, input });
    }
}

#[cfg(test)]
mod tests {
    use super::super::fusion::INBOX_CAPACITY;
    use super::*;

    fn chunk(device: u16, n: i64, len: usize) -> Event<()> {
        let input = Input::Bytes { device, bytes: vec![0; len] };
        Event::Entry(Entry { t: Timestamp::from_nanos(n), input })
    }

    fn opened(device: u16, n: i64) -> Event<()> {
        let input = Input::Line { device, event: LineEvent::Opened { modem_lines: false } };
        Event::Entry(Entry { t: Timestamp::from_nanos(n), input })
    }

    #[expect(clippy::disallowed_methods, reason = "a deadline that has passed")]
    fn now() -> Option<Instant> {
        Some(Instant::now())
    }

    fn drain(inbox: &Inbox<()>) -> Vec<Input> {
        let mut inputs = Vec::new();
        while let Some(event) = inbox.pop_until(now()) {
            if let Event::Entry(entry) = event {
                inputs.push(entry.input);
            }
        }
        inputs
    }

    #[test]
    fn given_room_events_keep_their_order() {
        let inbox = Inbox::new(4);
        inbox.push(opened(0, 0));
        inbox.push(chunk(0, 1, 3));
        inbox.push(chunk(1, 2, 5));
        let inputs = drain(&inbox);
        assert!(matches!(inputs[0], Input::Line { device: 0, .. }));
        assert!(matches!(inputs[2], Input::Bytes { device: 1, .. }));
    }

    #[test]
    fn given_a_full_queue_the_oldest_chunks_become_one_mark_in_their_place() {
        let inbox = Inbox::new(4);
        inbox.push(opened(0, 0));
        for n in 1..=9 {
            inbox.push(chunk(0, n, 10));
        }
        let inputs = drain(&inbox);
        assert!(matches!(inputs[0], Input::Line { event: LineEvent::Opened { .. }, .. }));
        let Input::Line { event: LineEvent::Dropped { bytes }, .. } = inputs[1] else {
            panic!("no mark where the bytes were: {inputs:?}");
        };
        let kept: u64 = inputs
            .iter()
            .map(|input| if let Input::Bytes { bytes, .. } = input { bytes.len() as u64 } else { 0 })
            .sum();
        assert_eq!(bytes + kept, 90, "every byte is either delivered or counted");
        assert!(kept >= 20, "the newest chunks stay");
    }

    #[test]
    fn beyond_its_capacity_the_oldest_bytes_are_counted_and_all_else_is_there() {
        let inbox = Inbox::new(INBOX_CAPACITY);
        let surplus = 1000;
        inbox.push(opened(0, 0));
        inbox.push(opened(1, 1));
        (0..INBOX_CAPACITY + surplus).for_each(|n| inbox.push(chunk(0, 2 + n as i64, 10)));
        inbox.command(());
        inbox.push(chunk(1, 9000, 5));
        inbox.push(opened(1, 9001));
        // A mark takes a place of its own, one for each device.
        assert!(inbox.lock().len() <= INBOX_CAPACITY + 2, "{}", inbox.lock().len());
        assert_eq!(inbox.commands(), 1);
        let inputs = drain(&inbox);
        let bytes_of = |device: u16| {
            let bytes = |input: &Input| match input {
                Input::Bytes { device: of, bytes } if *of == device => (bytes.len() as u64, 0),
                Input::Line { device: of, event: LineEvent::Dropped { bytes } } if *of == device => {
                    (0, *bytes)
                }
                _ => (0, 0),
            };
            inputs.iter().map(bytes).fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
        };
        let (kept, lost) = bytes_of(0);
        assert_eq!(kept + lost, 10 * (INBOX_CAPACITY + surplus) as u64);
        assert!(lost / 10 <= surplus as u64 + 10, "no more gives way than must: {lost} bytes");
        assert_eq!(bytes_of(1), (5, 0), "the other device");
        let is_opened = |input: &&Input| matches!(input, Input::Line { event: LineEvent::Opened { .. }, .. });
        assert_eq!(inputs.iter().filter(is_opened).count(), 3);
        assert!(matches!(inputs[2], Input::Line { device: 0, event: LineEvent::Dropped { .. } }));
    }

    #[test]
    fn given_no_chunks_nothing_is_lost() {
        let inbox = Inbox::new(2);
        for n in 0..5 {
            inbox.push(opened(0, n));
        }
        assert_eq!(drain(&inbox).len(), 5);
    }

    #[test]
    fn given_a_passed_deadline_it_does_not_wait() {
        assert!(Inbox::<()>::new(1).pop_until(now()).is_none());
    }
}
