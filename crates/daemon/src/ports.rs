//! One task per device: opens its port, reads, stamps, forwards; writes what the pipeline transmits; opens it again.
//!
//! It decodes nothing and knows no protocol. A port that is away costs nobody else anything. One that takes no bytes is given up,
//! and one that gives none although its device is asked is opened anew: a handle may outlive what it was opened on.

use std::panic::AssertUnwindSafe;
use std::time::Duration;

use futures_util::FutureExt;
use posed_drivers::LineEvent;
use posed_drivers::port::{self, Port, PortError, Stream};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

use super::clock::StageClock;
use super::fault_points;
use super::find::{self, NotFound, OPEN_TIMEOUT};
use super::fusion::FusionInbox;
use super::server::phones::{Gate, Reader};
use posed_stage::input::{DeviceIndex, Entry, Input};
use posed_stage::{Device, PortAddress, Stage};

/// A port that returned is seen after half of this at the median; an attempt costs one failed `open`.
const RETRY: Duration = Duration::from_millis(200);
/// A write that takes longer is one into a port that takes nothing: a full queue of the slowest line is gone in half of it.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// Silence after which a port whose device was asked something is opened anew: sessions ask every second or sooner.
const DEAF: Duration = Duration::from_secs(8);
/// Longer than anything a device sends between two wake-ups of a healthy reader.
const READ_BYTES: usize = 4096;

/// What is said where it has panicked.
const FAULT: &str = "what reads the port has had a fault of its own; please report this";

/// What the fusion thread asks of a port.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum PortCommand {
    /// Write these bytes.
    Transmit(Vec<u8>),
    /// Set RTS (`true` = asserted).
    SetRts(bool),
}

/// Why a port is not open.
#[derive(Debug, thiserror::Error)]
enum NotOpen {
    /// It was looked for.
    #[error(transparent)]
    NotFound(#[from] NotFound),
    /// It does not open.
    #[error(transparent)]
    Port(#[from] PortError),
    /// Nothing came of it in time.
    #[error("{port} does not answer; check the address and the cable")]
    NoAnswer { port: String },
}

/// Why reading and writing ended.
enum End {
    Shutdown,
    /// A sentence for the operator.
    Gone(String),
    /// Nothing came for long, though the device was asked.
    Deaf,
}

/// A device's task: where it reports to and when it ends.
pub(super) struct PortTask {
    /// Whose port.
    pub(super) device: DeviceIndex,
    /// Stamps what was read.
    pub(super) clock: StageClock,
    /// Takes what was read.
    pub(super) inbox: FusionInbox,
    /// What to write.
    pub(super) commands: mpsc::Receiver<PortCommand>,
    /// Turns true when the daemon ends.
    pub(super) shutdown: watch::Receiver<bool>,
}

/// A device's port, as the stage file describes it.
pub(super) struct DevicePort {
    device: Device,
    /// Serial numbers of its sensors, by which a search knows it.
    serials: Vec<String>,
    /// Ports of other devices, which are not asked.
    taken: Vec<String>,
}

impl DevicePort {
    /// The place of the device at `index` of a stage.
    pub(super) fn of(stage: &Stage, index: usize) -> Option<Self> {
        let device = stage.devices.get(index)?.clone();
        let mine = stage.sensors.iter().filter(|sensor| sensor.device == device.name);
        Some(Self {
            serials: mine.filter_map(|sensor| sensor.serial.clone()).collect(),
            taken: stage.devices.iter().map(|other| other.port.clone()).collect(),
            device,
        })
    }

    /// Name of the device.
    pub(super) fn device(&self) -> &str {
        &self.device.name
    }

    /// Whether what comes over the daemon's own websocket is for it.
    pub(super) fn is_websocket(&self) -> bool {
        self.device.port.parse() == Ok(PortAddress::Websocket)
    }

    /// Opens the port, or finds it.
    async fn open(&self) -> Result<Port<Stream>, NotOpen> {
        let path = &self.device.port;
        if path.parse() == Ok(PortAddress::Auto) {
            let (found, port) = find::search(&self.device, &self.serials, &self.taken).await?;
            tracing::info!("{} is at {found}", self.device.name);
            return Ok(port);
        }
        let opened = tokio::time::timeout(OPEN_TIMEOUT, port::open(path, find::options(&self.device))).await;
        Ok(opened.map_err(|_| NotOpen::NoAnswer { port: path.clone() })??)
    }
}

impl PortTask {
    /// Keeps the port of a device open until shutdown. Where that panics it begins again, as after an unplugged cable: one port's
    /// fault ends nothing else.
    #[expect(clippy::disallowed_methods, reason = "the daemon retries on its own clock")]
    pub(super) async fn keep_open(mut self, place: DevicePort) {
        while AssertUnwindSafe(self.open_and_serve(&place)).catch_unwind().await.is_err() {
            let device = place.device();
            tracing::error!(
                "what reads the port of {device} has panicked and begins again; please report this"
            );
            self.closed(FAULT.to_owned());
            tokio::time::sleep(RETRY).await;
        }
    }

    /// Leads what comes over the daemon's own websocket to a device, until shutdown. The connections are the server's: nothing is opened.
    pub(super) async fn lead_websocket(mut self, gate: Gate) {
        let (device, clock, inbox) = (self.device, self.clock, self.inbox.clone());
        gate.lead_to(Reader { device, clock, inbox });
        loop {
            tokio::select! {
                () = ended(&mut self.shutdown) => return,
                command = self.commands.recv() => match command {
                    Some(PortCommand::Transmit(envelopes)) => gate.transmit(&envelopes),
                    Some(PortCommand::SetRts(_)) => {}
                    // Tracking has ended: as at any port.
                    None => return ended(&mut self.shutdown).await,
                },
            }
        }
    }

    /// The same without that; where a port is looked for, it may be another one each time.
    #[expect(clippy::disallowed_methods, reason = "the daemon retries on its own clock")]
    async fn open_and_serve(&mut self, place: &DevicePort) {
        let mut reported = None;
        loop {
            let opened = tokio::select! {
                () = ended(&mut self.shutdown) => return,
                opened = place.open() => opened,
            };
            let reason = match opened {
                Ok(port) => {
                    let Some(reason) = self.serve(port, place).await else { return };
                    reason
                }
                Err(not_open) => not_open.to_string(),
            };
            // The log holds changes, not five attempts a second.
            if reported.as_ref() != Some(&reason) {
                tracing::warn!(device = place.device(), "{reason}");
                self.closed(reason.clone());
                reported = Some(reason);
            }
            tokio::select! {
                () = ended(&mut self.shutdown) => return,
                () = tokio::time::sleep(RETRY) => {}
            }
        }
    }

    /// Reads and writes until the port is gone, and returns why; `None` on shutdown. A deaf one is opened anew, of which the device's
    /// session need not know: it asks on.
    async fn serve(&mut self, mut port: Port<Stream>, place: &DevicePort) -> Option<String> {
        self.opened(&port);
        loop {
            match self.pump(&mut port).await {
                End::Shutdown => return None,
                End::Gone(reason) => return Some(reason),
                End::Deaf => {
                    // It is exclusive.
                    drop(port);
                    let again = tokio::select! {
                        () = ended(&mut self.shutdown) => return None,
                        again = place.open() => again,
                    };
                    port = match again {
                        Ok(port) => port,
                        Err(not_open) => return Some(not_open.to_string()),
                    };
                }
            }
        }
    }

    /// The same for a stream that cannot be opened anew, and a panic is one more reason.
    pub(super) async fn serve_once<S: AsyncRead + AsyncWrite + Unpin>(
        &mut self,
        port: Port<S>,
    ) -> Option<String> {
        let served = AssertUnwindSafe(self.serve_stream(port)).catch_unwind().await;
        served.unwrap_or_else(|_| Some(FAULT.to_owned()))
    }

    async fn serve_stream<S: AsyncRead + AsyncWrite + Unpin>(&mut self, mut port: Port<S>) -> Option<String> {
        self.opened(&port);
        loop {
            match self.pump(&mut port).await {
                End::Shutdown => return None,
                End::Gone(reason) => return Some(reason),
                End::Deaf => {}
            }
        }
    }

    fn opened<S: AsyncRead + AsyncWrite + Unpin>(&mut self, port: &Port<S>) {
        // What was meant for the port before it went away is not for this one.
        while self.commands.try_recv().is_ok() {}
        self.line(LineEvent::Opened { modem_lines: port.modem_lines() });
    }

    #[expect(clippy::disallowed_methods, reason = "the daemon looks after its ports on its own clock")]
    async fn pump<S: AsyncRead + AsyncWrite + Unpin>(&mut self, port: &mut Port<S>) -> End {
        let mut buffer = vec![0; READ_BYTES];
        // Since when the device has been asked, and has said nothing.
        let mut asked = None;
        loop {
            let deaf_at = asked.unwrap_or_else(Instant::now) + DEAF;
            let done = tokio::select! {
                () = ended(&mut self.shutdown) => return End::Shutdown,
                () = tokio::time::sleep_until(deaf_at), if asked.is_some() => return End::Deaf,
                read = port.read(&mut buffer) => match read {
                    Ok(n) => {
                        let _ = fault_points::pass("port");
                        let t = self.clock.now();
                        let input = Input::Bytes { device: self.device, bytes: buffer[..n].to_vec() };
                        self.inbox.enter(Entry { t, input });
                        asked = None;
                        Ok(())
                    }
                    Err(error) => Err(error),
                },
                command = self.commands.recv() => match command {
                    Some(PortCommand::Transmit(bytes)) => {
                        asked.get_or_insert_with(Instant::now);
                        let written = tokio::time::timeout(WRITE_TIMEOUT, port.write_all(&bytes)).await;
                        written.unwrap_or_else(|_| Err(std::io::Error::other("it takes no bytes")))
                    }
                    Some(PortCommand::SetRts(asserted)) => port.set_rts(asserted),
                    // Tracking has ended; who ends the daemon is to hear of that, and not of what follows from it.
                    None => {
                        ended(&mut self.shutdown).await;
                        return End::Shutdown;
                    }
                },
            };
            if let Err(error) = done {
                return End::Gone(format!("the port is gone ({error}); check the cable and the adapter"));
            }
        }
    }

    /// Tells that the port is away.
    pub(super) fn closed(&self, reason: String) {
        self.line(LineEvent::Closed { reason });
    }

    fn line(&self, event: LineEvent) {
        let input = Input::Line { device: self.device, event };
        self.inbox.enter(Entry { t: self.clock.now(), input });
    }
}

/// Waits until `shutdown` turns true or its sender is gone: the daemon's end.
pub async fn ended(shutdown: &mut watch::Receiver<bool>) {
    // The sender outlives every task; without it, the daemon is gone too.
    let _ = shutdown.wait_for(|&down| down).await;
}
