//! Where the bytes of an MCAP file go: counted, summed, and let through only when they belong to the file.

use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Lets bytes through to what takes them.
pub(super) struct Sink<W> {
    inner: W,
    checksum: crc32fast::Hasher,
    gate: Gate,
}

/// What is known of a sink, and said to it, while the library's writer has it.
#[derive(Clone, Default)]
pub(super) struct Gate {
    /// Bytes that went through.
    pub(super) bytes: Arc<AtomicU64>,
    closed: Arc<AtomicBool>,
}

impl Gate {
    /// Closed, it takes bytes and drops them.
    pub(super) fn close(&self, closed: bool) {
        self.closed.store(closed, Ordering::Relaxed);
    }
}

impl<W> Sink<W> {
    pub(super) fn new(inner: W, gate: Gate) -> Self {
        Self { inner, checksum: crc32fast::Hasher::new(), gate }
    }

    pub(super) fn into_inner(self) -> W {
        self.inner
    }

    /// Sum of the bytes that went through since it was asked for last.
    pub(super) fn take_checksum(&mut self) -> u32 {
        std::mem::take(&mut self.checksum).finalize()
    }

    /// Place of the next byte in the file.
    pub(super) fn position(&self) -> u64 {
        self.gate.bytes.load(Ordering::Relaxed)
    }
}

impl<W: Write> Write for Sink<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.gate.closed.load(Ordering::Relaxed) {
            return Ok(bytes.len());
        }
        let written = self.inner.write(bytes)?;
        self.checksum.update(&bytes[..written]);
        self.gate.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// The library asks where it is, and never goes anywhere.
impl<W> Seek for Sink<W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position()),
            _ => Err(io::ErrorKind::Unsupported.into()),
        }
    }
}
