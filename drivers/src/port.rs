//! The only file of this package that opens a port.
//!
//! What comes in: the path of a serial port or pseudo-terminal, `tcp://HOST:PORT`, `udp://HOST:PORT` or `usb://VENDOR:PRODUCT`. What goes out:
//! a [`Port`] to read from and write to, or a sentence for the operator. It decodes nothing.

#[cfg(target_os = "linux")]
mod hidraw;
mod udp;
mod usb;

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use thiserror::Error;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpStream;
use tokio_serial::{ClearBuffer, ErrorKind, SerialPort, SerialStream};

#[cfg(target_os = "linux")]
pub use hidraw::{HidStream, is_one as is_receiver, receivers};
pub use udp::{UdpStream, shared as shared_udp};
pub use usb::{UsbStream, UsbUnit, usb_units};

/// Receivers on USB that are plugged in, by path; none on this system.
#[cfg(not(target_os = "linux"))]
pub fn receivers() -> Vec<String> {
    Vec::new()
}

/// Why a port could not be opened; each states what to check.
#[derive(Debug, Error)]
pub enum PortError {
    /// No such file: the port does not exist.
    #[error(
        "{port} does not exist; check the cable and the adapter, or see `posed doctor` for the ports there are"
    )]
    Missing {
        /// The port as named in the stage file.
        port: String,
    },
    /// The operating system refuses.
    #[error(
        "no right to open {port}; add yourself to the group `dialout` (sudo usermod -aG dialout $USER) and log in again"
    )]
    NotAllowed {
        /// The port as named in the stage file.
        port: String,
    },
    /// The operating system refuses to open a unit or a receiver on USB.
    #[error(
        "no right to open {port}; it needs the udev rule of packaging/60-posed.rules and the group `dialout`, then plug it in again"
    )]
    ReceiverNotAllowed {
        /// The port as named in the stage file.
        port: String,
    },
    /// Another program has it (a serial port is opened exclusively), or another socket has the local UDP port.
    #[error("{port} is in use by another program; end that one first")]
    Busy {
        /// The port as named in the stage file.
        port: String,
    },
    /// The address of a socket cannot be resolved, reached or bound.
    #[error("{port} cannot be reached: {source}; check the address and that the device server runs")]
    Unreachable {
        /// The port as named in the stage file.
        port: String,
        /// What the operating system said.
        source: io::Error,
    },
    /// Anything else.
    #[error("{port} cannot be opened: {reason}")]
    Other {
        /// The port as named in the stage file.
        port: String,
        /// What the operating system said.
        reason: String,
    },
}

/// A stream of bytes with, perhaps, modem lines.
#[derive(Debug)]
pub struct Port<S> {
    stream: S,
    set_rts: Option<fn(&mut S, bool) -> io::Result<()>>,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Port<S> {
    /// A port without modem lines over any stream, for tests and pseudo-terminals.
    pub fn new(stream: S) -> Self {
        Self { stream, set_rts: None }
    }

    /// Whether RTS can be set. Pseudo-terminals and sockets have no such line.
    pub fn modem_lines(&self) -> bool {
        self.set_rts.is_some()
    }

    /// Sets RTS (`true` = asserted); does nothing where the line does not exist.
    ///
    /// # Errors
    /// The port is gone.
    pub fn set_rts(&mut self, asserted: bool) -> io::Result<()> {
        match self.set_rts {
            Some(set) => set(&mut self.stream, asserted),
            None => Ok(()),
        }
    }

    /// Reads what is there, at least one byte, into the front of `buffer`; returns how many. Safe to drop while it waits.
    ///
    /// # Errors
    /// The port is gone: an unplugged port reads zero bytes for ever, which counts as an error here (`UnexpectedEof`). So does
    /// an empty `buffer`. Other errors are those of the operating system.
    pub async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.stream.read(buffer).await? {
            0 => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the port was closed or unplugged")),
            n => Ok(n),
        }
    }

    /// Writes all bytes. On a socket for datagrams each call sends one; the server's takes envelopes ([`crate::datagram`]), one
    /// datagram each. Dropped while it waits, it may have written a part.
    ///
    /// # Errors
    /// The port is gone. A peer for datagrams that cannot be reached is no error.
    pub async fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes).await
    }
}

impl Port<Stream> {
    /// Sets the line rate of a serial port, bit/s; does nothing at a socket: a device server has its own rate.
    ///
    /// Unlike opening the port again this does not raise RTS, which would reset a Flock.
    ///
    /// # Errors
    /// The port is gone, or its driver does not know the rate.
    pub fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        match &mut self.stream {
            Stream::Serial(serial) => serial.set_baud_rate(baud).map_err(io::Error::from),
            _ => Ok(()),
        }
    }
}

/// How a port is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Line rate of a serial port, bit/s; sockets pass over it.
    pub baud: u32,
    /// Who is at the other end of a socket for datagrams; serial ports and TCP pass over it.
    pub udp: Udp,
}

/// The other end of a socket for datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Udp {
    /// One device, at the port's address; only its datagrams are read.
    Peer {
        /// Port of this computer to which the device sends, shared with other sockets that ask for it; `None`: any free port.
        local_port: Option<u16>,
    },
    /// Any number of devices, which send to the port's address, one of this computer; datagrams come and go in envelopes.
    Server,
}

impl Options {
    /// A serial port with this line rate, bit/s, or a socket for one device that sends to any port of this computer.
    pub const fn baud(baud: u32) -> Self {
        Self { baud, udp: Udp::Peer { local_port: None } }
    }
}

/// What [`open`] opens. Needs a Tokio runtime to read and write.
#[derive(Debug)]
pub enum Stream {
    /// A serial port or a pseudo-terminal.
    Serial(SerialStream),
    /// A device server, or a device with a TCP port of its own.
    Tcp(TcpStream),
    /// Datagrams.
    Udp(UdpStream),
    /// Reports of a receiver on USB.
    #[cfg(target_os = "linux")]
    Hid(HidStream),
    /// A unit with a USB port of its own.
    Usb(Box<UsbStream>),
}

impl AsyncRead for Stream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Serial(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Tcp(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Udp(stream) => Pin::new(stream).poll_read(cx, buf),
            #[cfg(target_os = "linux")]
            Self::Hid(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Usb(stream) => Pin::new(&mut **stream).poll_read(cx, buf),
        }
    }
}

impl AsyncWrite for Stream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Serial(stream) => Pin::new(stream).poll_write(cx, bytes),
            Self::Tcp(stream) => Pin::new(stream).poll_write(cx, bytes),
            Self::Udp(stream) => Pin::new(stream).poll_write(cx, bytes),
            #[cfg(target_os = "linux")]
            Self::Hid(stream) => Pin::new(stream).poll_write(cx, bytes),
            Self::Usb(stream) => Pin::new(&mut **stream).poll_write(cx, bytes),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(stream) => Pin::new(stream).poll_flush(cx),
            Self::Usb(stream) => Pin::new(&mut **stream).poll_flush(cx),
            // A serial flush blocks until the last bit is out; nobody here needs to know when.
            _ => Poll::Ready(Ok(())),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Tcp(stream) => Pin::new(stream).poll_shutdown(cx),
            Self::Usb(stream) => Pin::new(&mut **stream).poll_shutdown(cx),
            _ => Poll::Ready(Ok(())),
        }
    }
}

/// Opens a receiver on USB (`/dev/hidrawN`, under Linux), a serial port (8 data bits, no parity, 1 stop bit, raw, exclusive), `tcp://HOST:PORT`, `udp://HOST:PORT`, or a unit on USB (`usb://VENDOR:PRODUCT`).
///
/// What a serial port has received before is thrown away. RTS is let go at once, where it exists: opening a port raises it, and it holds a Flock in reset. TCP sends without delay (no
/// Nagle). Under Linux an FTDI adapter is set to a latency of 1 ms; where that is not allowed, its bytes may come in bursts of
/// 16 ms. The opening has no time limit of its own: an address that does not answer takes as long as the operating system waits.
///
/// # Errors
/// [`PortError`]: the port is missing, not allowed, in use or not reachable. Each states what the operator should check.
pub async fn open(port: &str, options: Options) -> Result<Port<Stream>, PortError> {
    if let Some(address) = port.strip_prefix("tcp://") {
        let unreachable = |source| PortError::Unreachable { port: port.into(), source };
        let stream = TcpStream::connect(address).await.map_err(unreachable)?;
        stream.set_nodelay(true).map_err(unreachable)?;
        return Ok(Port::new(Stream::Tcp(stream)));
    }
    if let Some(address) = port.strip_prefix("udp://") {
        let opened = match options.udp {
            Udp::Peer { local_port } => UdpStream::connect(address, local_port).await,
            Udp::Server => UdpStream::serve(address).await,
        };
        let stream = opened.map_err(|source| match source.kind() {
            io::ErrorKind::AddrInUse => PortError::Busy { port: port.into() },
            _ => PortError::Unreachable { port: port.into(), source },
        })?;
        return Ok(Port::new(Stream::Udp(stream)));
    }
    let on_usb = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => PortError::Missing { port: port.into() },
        io::ErrorKind::PermissionDenied => PortError::ReceiverNotAllowed { port: port.into() },
        io::ErrorKind::ResourceBusy => PortError::Busy { port: port.into() },
        _ => PortError::Other { port: port.into(), reason: error.to_string() },
    };
    if let Some(address) = port.strip_prefix("usb://") {
        let stream = UsbStream::open(address).await.map_err(on_usb)?;
        return Ok(Port::new(Stream::Usb(Box::new(stream))));
    }
    #[cfg(target_os = "linux")]
    if is_receiver(port) {
        return Ok(Port::new(Stream::Hid(HidStream::open(port).map_err(on_usb)?)));
    }
    let baud = options.baud;
    let mut serial =
        SerialStream::open(&tokio_serial::new(port, baud)).map_err(|error| in_words(port, &error))?;
    // What came before the line had its rate and form is noise; where it cannot be cleared, the session skips it.
    let _ = serial.clear(ClearBuffer::Input);
    ask_for_low_latency(port);
    // A pseudo-terminal has no modem lines and says so with an error, which is no fault.
    let modem_lines = serial.write_request_to_send(false).is_ok();
    let set_rts: fn(&mut Stream, bool) -> io::Result<()> = |stream, asserted| match stream {
        Stream::Serial(serial) => serial.write_request_to_send(asserted).map_err(io::Error::from),
        _ => Ok(()),
    };
    Ok(Port { stream: Stream::Serial(serial), set_rts: modem_lines.then_some(set_rts) })
}

/// Serial ports of this machine that a device may be at, by path, sorted by name; empty where the system does not list them.
///
/// Pseudo-terminals are not listed, but for those that the environment variable `POSED_PORTS` names: paths of ports, or
/// of folders with ports, separated by colons (semicolons on Windows). Nothing is opened: a listed port may be in use.
pub fn list() -> Vec<String> {
    let mut ports: Vec<String> =
        tokio_serial::available_ports().unwrap_or_default().into_iter().map(|port| port.port_name).collect();
    let more = std::env::var_os("POSED_PORTS").unwrap_or_default();
    for path in std::env::split_paths(&more).filter(|path| !path.as_os_str().is_empty()) {
        match std::fs::read_dir(&path) {
            Ok(folder) => ports.extend(folder.flatten().map(|port| port.path().display().to_string())),
            Err(_) => ports.push(path.display().to_string()),
        }
    }
    ports.sort();
    ports.dedup();
    ports
}

fn in_words(port: &str, error: &tokio_serial::Error) -> PortError {
    let busy = error.description.contains("exclusive lock") || error.description.contains("busy");
    let port = port.to_owned();
    match error.kind() {
        _ if busy => PortError::Busy { port },
        ErrorKind::Io(io::ErrorKind::NotFound) => PortError::Missing { port },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => PortError::NotAllowed { port },
        ErrorKind::Io(io::ErrorKind::ResourceBusy) => PortError::Busy { port },
        _ => PortError::Other { port, reason: error.description.clone() },
    }
}

/// FTDI adapters hold bytes back for up to 16 ms; their driver takes 1 ms through a file, if we may write it.
fn ask_for_low_latency(port: &str) {
    let Some(name) = std::path::Path::new(port).file_name() else { return };
    let timer = std::path::Path::new("/sys/class/tty").join(name).join("device/latency_timer");
    if timer.exists()
        && let Err(error) = std::fs::write(&timer, "1")
    {
        tracing::info!(
            port,
            %error,
            "the USB adapter's latency timer cannot be set; its bytes may come in bursts of 16 ms"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_missing_port_is_named() {
        let error = open("/dev/no-such-tracker", Options::baud(115_200)).await.unwrap_err();
        assert!(matches!(error, PortError::Missing { .. }), "{error}");
        assert!(error.to_string().contains("/dev/no-such-tracker"));
    }

    #[tokio::test]
    async fn a_server_that_is_not_there_is_named() {
        let error = open("tcp://127.0.0.1:1", Options::baud(115_200)).await.unwrap_err();
        assert!(matches!(error, PortError::Unreachable { .. }), "{error}");
    }

    #[tokio::test]
    async fn bytes_pass_and_a_closed_port_is_an_error() {
        let (near, far) = tokio::io::duplex(64);
        let (mut near, mut far) = (Port::new(near), Port::new(far));
        assert!(!near.modem_lines());
        near.set_rts(true).unwrap();
        near.write_all(b"B").await.unwrap();
        let mut buffer = [0; 8];
        assert_eq!(far.read(&mut buffer).await.unwrap(), 1);
        drop(near);
        assert_eq!(far.read(&mut buffer).await.unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn what_came_before_a_port_was_open_is_not_read() {
        let (device, host) = SerialStream::pair().unwrap();
        let path = host.name().unwrap();
        drop(host);
        let mut device = Port::new(device);
        device.write_all(b"noise of another rate").await.unwrap();
        let mut port = open(&path, Options::baud(115_200)).await.unwrap();
        device.write_all(b"new").await.unwrap();
        let mut buffer = [0; 64];
        assert_eq!(port.read(&mut buffer).await.unwrap(), 3);
        assert_eq!(&buffer[..3], b"new");
    }

    #[test]
    fn refusals_are_distinguished() {
        let error = |kind, text: &str| in_words("/dev/ttyUSB0", &tokio_serial::Error::new(kind, text));
        let denied = error(ErrorKind::Io(io::ErrorKind::PermissionDenied), "Permission denied");
        assert!(denied.to_string().contains("dialout"), "{denied}");
        let busy = error(ErrorKind::NoDevice, "Unable to acquire exclusive lock on serial port");
        assert!(matches!(busy, PortError::Busy { .. }));
        let busy = error(ErrorKind::NoDevice, "Device or resource busy");
        assert!(matches!(busy, PortError::Busy { .. }));
    }
}
