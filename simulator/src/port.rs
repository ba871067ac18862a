//! What a device's line ends in, whatever it is.

use std::io;
use std::os::fd::OwnedFd;

use tokio::io::unix::AsyncFd;

/// Something that a device's line ends in.
pub(crate) trait Port {
    /// Bytes of the host; 0 when it has hung up. Waits for ever while unplugged. May be cancelled.
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;
    /// Gives bytes to the host at once; what it has no room for is lost, as on a wire.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// The rate that the host has set, where there is one.
    fn baud(&self) -> Option<u32>;
    /// The port disappears.
    fn unplug(&mut self);
    /// The port comes back.
    fn replug(&mut self) -> io::Result<()>;
}

/// A descriptor that the runtime watches.
#[expect(
    deprecated,
    reason = "the new constructor is unsafe since a type may lie about its descriptor; OwnedFd does not"
)]
pub(crate) fn watched(fd: OwnedFd) -> io::Result<AsyncFd<OwnedFd>> {
    AsyncFd::new(fd)
}
