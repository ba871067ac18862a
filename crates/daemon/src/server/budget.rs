//! What may come in at what rate: messages of a client, and bytes of a connection, whatever they are.
//!
//! Bytes are counted below everything that reads them: frames without an end or a content, pings, half requests and messages too
//! many all cost what they take on the line. A connection that spends more is cut.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use posed_stage::Limits;

use super::slots::Slot;

/// What may still come: refilled at a steady rate up to a burst.
#[derive(Debug)]
pub(super) struct Budget {
    per_s: f64,
    burst: f64,
    left: f64,
    at: Instant,
}

impl Budget {
    pub(super) fn new(per_s: f64, burst: f64) -> Self {
        Self { per_s, burst, left: burst, at: now() }
    }

    /// Takes from it; false, and nothing is taken, where it does not hold so much.
    pub(super) fn spend(&mut self, amount: f64, now: Instant) -> bool {
        self.refill(now);
        let is_enough = self.left >= amount;
        if is_enough {
            self.left -= amount;
        }
        is_enough
    }

    /// Takes from it what it may not hold: then it is paid back first, a whole burst at most.
    pub(super) fn charge(&mut self, amount: f64, now: Instant) {
        self.refill(now);
        self.left = (self.left - amount).max(-self.burst);
    }

    /// What may still come.
    pub(super) fn left(&mut self, now: Instant) -> f64 {
        self.refill(now);
        self.left
    }

    fn refill(&mut self, now: Instant) {
        let elapsed_s = now.saturating_duration_since(self.at).as_secs_f64();
        self.left = (self.left + elapsed_s * self.per_s).min(self.burst);
        self.at = now;
    }
}

/// Bytes that are read of one connection before all others have had their turn: some seven hundred of the smallest frames.
const TURN_BYTES: usize = 4096;

/// A connection of which no more is read than its budget allows: then reading fails, and its network pays.
pub(super) struct Metered<S> {
    stream: S,
    bytes: Budget,
    /// What has been read in this turn.
    turn: usize,
    /// More came than it may hold: it pays once.
    is_cut: bool,
    slot: Arc<Slot>,
}

impl<S> Metered<S> {
    pub(super) fn new(stream: S, limits: &Limits, slot: Arc<Slot>) -> Self {
        Self {
            stream,
            bytes: Budget::new(limits.bytes_per_s, limits.byte_burst),
            turn: 0,
            is_cut: false,
            slot,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Metered<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.is_cut {
            return Poll::Ready(Err(too_many()));
        }
        if self.turn >= TURN_BYTES {
            // The runtime would go on for a hundred reads.
            self.turn = 0;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let before = buffer.filled().len();
        let Poll::Ready(read) = Pin::new(&mut self.stream).poll_read(context, buffer) else {
            self.turn = 0;
            return Poll::Pending;
        };
        read?;
        let came = buffer.filled().len() - before;
        self.turn += came;
        self.is_cut = !self.bytes.spend(came as f64, now());
        if self.is_cut {
            self.slot.breach();
            return Poll::Ready(Err(too_many()));
        }
        Poll::Ready(Ok(()))
    }
}

fn too_many() -> io::Error {
    io::Error::new(io::ErrorKind::QuotaExceeded, "more bytes a second than are taken")
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Metered<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, parts)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

#[expect(clippy::disallowed_methods, reason = "rates of a connection")]
pub(super) fn now() -> Instant {
    Instant::now()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::io::AsyncReadExt;

    use super::super::slots::Slots;
    use super::*;

    #[test]
    fn a_budget_allows_bursts_and_a_rate() {
        let mut budget = Budget::new(10.0, 3.0);
        let start = budget.at;
        assert!((0..3).all(|_| budget.spend(1.0, start)));
        assert!(!budget.spend(1.0, start), "and nothing is owed for it");
        let later = start + Duration::from_millis(100);
        assert!(budget.spend(1.0, later) && !budget.spend(1.0, later));
        budget.charge(1e6, later);
        let left = budget.left(later + Duration::from_millis(300));
        assert!(left.abs() < 1e-9, "no more than a burst is owed");
    }

    #[tokio::test]
    async fn a_connection_is_read_up_to_its_budget() {
        let limits = Limits {
            bytes_per_s: 1.0,
            byte_burst: 100.0,
            connections_per_s: 1e-3,
            connection_burst: 60.0,
            ..Limits::default()
        };
        let slots = Slots::new(&limits);
        let home = "192.0.2.1".parse().unwrap();
        let slot = Arc::new(slots.wait(home).unwrap());
        let mut metered = Metered::new(&[7_u8; 300][..], &limits, slot);
        let mut read = [0; 64];
        metered.read_exact(&mut read).await.unwrap();
        for _ in 0..3 {
            assert_eq!(metered.read(&mut read).await.unwrap_err().kind(), io::ErrorKind::QuotaExceeded);
        }
        let left = (0..100).filter(|_| slots.wait(home).is_some()).count();
        assert_eq!(left, 9, "it has cost fifty connections, once");
    }
}
