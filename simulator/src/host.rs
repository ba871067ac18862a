//! Runs virtual devices in real time: on pseudo-terminals, on loopback sockets, or on any pair of byte streams.
//!
//! What comes in: a [`VirtualStage`] and a clock. What goes out: ports that programs can open, truth and
//! faults to a watcher. The behaviour of the devices is elsewhere: this file only moves bytes on time.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::{Duration, Instant};

use posed_drivers::Timestamp;
use posed_drivers::datagram::datagrams;
use rustix::time::{Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec};
use serde::Serialize;
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite};
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::port::{Port, watched};
use crate::pty::Pty;
use crate::sockets::{Tcp, Udp, Units, loopback};
use crate::stage::{Event, Output, VirtualDevice, VirtualStage};

/// Where hosts listen for x-IMU3 units.
const ANNOUNCEMENTS: u16 = 10_000;

/// The stage's clock: times count from an epoch on the monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    epoch: Instant,
}

impl Clock {
    /// A clock that others started: the daemon's own, so that truth and measurements share their times.
    pub fn since(epoch: Instant) -> Self {
        Self { epoch }
    }

    /// A clock that starts now.
    #[expect(clippy::disallowed_methods, reason = "real time enters the simulator here")]
    pub fn start() -> Self {
        Self::since(Instant::now())
    }

    /// Time since the epoch; the epoch while that lies ahead.
    #[expect(clippy::disallowed_methods, reason = "real time enters the simulator here")]
    pub fn now(&self) -> Timestamp {
        Timestamp::ZERO + Instant::now().saturating_duration_since(self.epoch)
    }
}

/// Gets truth, faults and the coming and going of ports; called from the devices' tasks, so it must be quick.
pub type Watcher = Arc<dyn Fn(&Event) + Send + Sync>;

/// A device that can be opened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceInfo {
    /// Its name in the stage.
    pub name: String,
    /// Its driver, as in the stage file.
    pub driver: String,
    /// Path or address of the port; the same after unplugging and replugging.
    pub port: String,
}

/// A port that gives what stands in envelopes without them, as a receiver on USB does: each write is a whole report.
struct Opened<P>(P);

impl<P: Port> Port for Opened<P> {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer).await
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        datagrams(bytes).flatten().try_for_each(|datagram| self.0.write(datagram.data))
    }

    fn baud(&self) -> Option<u32> {
        None
    }

    fn unplug(&mut self) {
        self.0.unplug();
    }

    fn replug(&mut self) -> io::Result<()> {
        self.0.replug()
    }
}

/// Devices that run on tasks of their own, in real time; stopped by [`Host::stop`] or by dropping it. A dropped host may leave
/// events that the watcher has not seen.
pub struct Host {
    devices: Vec<DeviceInfo>,
    stop: watch::Sender<bool>,
    tasks: JoinSet<io::Result<()>>,
}

impl Host {
    /// Gives each device its port: a loopback socket where the stage has it on a network, at the same port
    /// number, else a pseudo-terminal with a link of its name in `folder`, which is made if absent. In a link's name, what is
    /// neither letter, digit nor `-` is `_`. Every x-IMU3 on UDP is announced once a second to port 10000 of this machine.
    ///
    /// # Errors
    /// What the operating system said about the folder, a link, a pseudo-terminal or a socket.
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn open(stage: VirtualStage, folder: &Path, clock: Clock, watcher: Watcher) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let (stop, stopped) = watch::channel(false);
        let mut host = Self { devices: Vec::new(), stop, tasks: JoinSet::new() };
        for device in stage.into_devices() {
            let (name, driver) = (device.name().to_owned(), device.driver().to_owned());
            let tasks = &mut host.tasks;
            let (watcher, stopped) = (Arc::clone(&watcher), stopped.clone());
            let port = if device.port().starts_with("tcp://") {
                let tcp = Tcp::open(loopback(device.port())?)?;
                let port = format!("tcp://{}", tcp.address);
                tasks.spawn(run(device, tcp, clock, watcher, stopped));
                port
            } else if device.port().starts_with("udp://") && matches!(driver.as_str(), "slimevr" | "open-imu")
            {
                let server = loopback(device.port())?;
                tasks.spawn(run(device, Units::new(server), clock, watcher, stopped));
                format!("udp://{server}")
            } else if device.port().starts_with("udp://") {
                let udp = Udp::open(loopback(device.port())?)?;
                let port = format!("udp://{}", udp.address);
                if driver == "x-imu3" {
                    tasks.spawn(announce(name.clone(), udp.address, stopped.clone()));
                }
                tasks.spawn(run(device, udp, clock, watcher, stopped));
                port
            } else if device.port() == "websocket" {
                // A phone comes by itself, over the daemon's own port: there is none to open.
                device.port().to_owned()
            } else {
                let is_receiver = driver == "slimevr";
                let file_name = name.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '_' });
                let link = folder.join(file_name.collect::<String>());
                let pty = Pty::open(&link)?;
                if is_receiver {
                    tasks.spawn(run(device, Opened(pty), clock, watcher, stopped));
                } else {
                    tasks.spawn(run(device, pty, clock, watcher, stopped));
                }
                link.to_string_lossy().into_owned()
            };
            host.devices.push(DeviceInfo { name, driver, port });
        }
        Ok(host)
    }

    /// The devices and their ports, in the stage's order.
    pub fn devices(&self) -> &[DeviceInfo] {
        &self.devices
    }

    /// Stops all devices; the watcher has had everything up to now when this returns.
    ///
    /// # Errors
    /// The first device found that had failed, or whose task had panicked; the rest are then ended as by dropping.
    pub async fn stop(mut self) -> io::Result<()> {
        self.stop.send_replace(true);
        while let Some(task) = self.tasks.join_next().await {
            task.map_err(io::Error::other)??;
        }
        Ok(())
    }
}

/// Runs a device on a byte stream (a socket pair, an in-memory duplex) until the other side hangs up.
///
/// A stream has no rate: nothing is checked. Unplugging closes it for good: the device then runs on without a host, and this
/// returns only by being dropped.
///
/// # Errors
/// What the stream or the operating system's timer said; a broken pipe on writing is none.
///
/// # Panics
/// Outside a tokio runtime with IO.
pub async fn serve_stream<S>(
    device: VirtualDevice,
    stream: S,
    clock: Clock,
    watcher: Watcher,
) -> io::Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let (_stop, stopped) = watch::channel(false);
    run(device, Stream(Some(stream)), clock, watcher, stopped).await
}

/// Tells once a second where a unit is, as it would on its network.
async fn announce(name: String, address: SocketAddr, mut stopped: watch::Receiver<bool>) -> io::Result<()> {
    let host = SocketAddr::from((Ipv4Addr::LOCALHOST, ANNOUNCEMENTS));
    let socket = tokio::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await?;
    let words = crate::x_imu3::announcement(&name, address, host);
    let timer = Timer::new()?;
    loop {
        // Nobody need listen.
        let _ = socket.try_send_to(words.as_bytes(), host);
        timer.set(1.0)?;
        tokio::select! {
            expired = timer.expired() => expired?,
            _ = stopped.wait_for(|&stop| stop) => return Ok(()),
        }
    }
}

/// One device, until stopped.
async fn run<P: Port>(
    mut device: VirtualDevice,
    mut port: P,
    clock: Clock,
    watcher: Watcher,
    mut stopped: watch::Receiver<bool>,
) -> io::Result<()> {
    let timer = Timer::new()?;
    let mut buffer = [0; 2048];
    loop {
        if let Some(baud) = port.baud() {
            device.set_host_baud(baud);
        }
        device.handle_timeout(clock.now());
        while let Some(event) = device.poll_event() {
            match &event.output {
                Output::Data(bytes) => {
                    port.write(bytes)?;
                    continue;
                }
                Output::Unplugged => port.unplug(),
                Output::Replugged => port.replug()?,
                Output::Truth(_) | Output::Fault(_) | Output::Lost(_) => {}
            }
            watcher(&event);
        }
        if *stopped.borrow() {
            return Ok(());
        }
        if let Some(due) = device.poll_timeout() {
            timer.set(due.seconds_since(clock.now()))?;
        }
        tokio::select! {
            read = port.read(&mut buffer) => match read? {
                0 => return Ok(()),
                count => {
                    if let Some(baud) = port.baud() {
                        device.set_host_baud(baud);
                    }
                    device.handle_bytes(clock.now(), &buffer[..count]);
                }
            },
            expired = timer.expired() => expired?,
            _ = stopped.wait_for(|&stop| stop) => {}
        }
    }
}

/// A byte stream as a port.
struct Stream<S>(Option<S>);

impl<S: AsyncRead + AsyncWrite + Unpin> Port for Stream<S> {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.0 {
            Some(stream) => stream.read(buffer).await,
            None => std::future::pending().await,
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Some(stream) = &mut self.0 else { return Ok(()) };
        // One attempt, without waiting: the context is only needed to ask.
        let mut context = std::task::Context::from_waker(std::task::Waker::noop());
        match Pin::new(stream).poll_write(&mut context, bytes) {
            Poll::Ready(Err(error)) if error.kind() != io::ErrorKind::BrokenPipe => Err(error),
            _ => Ok(()),
        }
    }

    fn baud(&self) -> Option<u32> {
        None
    }

    fn unplug(&mut self) {
        self.0 = None;
    }

    fn replug(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A timer that is finer than the runtime's millisecond.
struct Timer(AsyncFd<OwnedFd>);

impl Timer {
    fn new() -> io::Result<Self> {
        let flags = TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC;
        Ok(Self(watched(rustix::time::timerfd_create(TimerfdClockId::Monotonic, flags)?)?))
    }

    /// Expires in `seconds`; at once when that is not above 0.
    fn set(&self, seconds: f64) -> io::Result<()> {
        // Zero would switch the timer off.
        let wait = Duration::from_secs_f64(seconds.clamp(1e-9, 3600.0)).max(Duration::from_nanos(1));
        let none = Timespec { tv_sec: 0, tv_nsec: 0 };
        let it_value = Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: i64::from(wait.subsec_nanos()) };
        let once = Itimerspec { it_interval: none, it_value };
        rustix::time::timerfd_settime(self.0.get_ref(), TimerfdTimerFlags::empty(), &once)?;
        Ok(())
    }

    async fn expired(&self) -> io::Result<()> {
        loop {
            let mut guard = self.0.readable().await?;
            let mut count = [0; 8];
            match guard.try_io(|fd| rustix::io::read(fd.get_ref(), &mut count).map_err(io::Error::from)) {
                Ok(read) => return read.map(|_| ()),
                Err(_would_block) => continue,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::DeviceScenario;
    use crate::testing::{scenario, stage};
    use std::sync::Mutex;
    use tokio::io::AsyncWriteExt;

    fn quick() -> DeviceScenario {
        DeviceScenario { boot_ms: 0.0, ..DeviceScenario::default() }
    }

    #[tokio::test]
    async fn a_device_on_a_stream_answers_streams_and_reports_the_truth() {
        let virtual_stage =
            VirtualStage::new(&stage(&[0], 115_200), &scenario(quick()), Path::new(".")).unwrap();
        let device = virtual_stage.into_devices().remove(0);
        let (mut ours, theirs) = tokio::io::duplex(4096);
        let seen = Arc::new(Mutex::new(0));
        let count = Arc::clone(&seen);
        let watcher: Watcher = Arc::new(move |event: &Event| {
            if matches!(event.output, Output::Truth(_)) {
                *count.lock().unwrap() += 1;
            }
        });
        let task = tokio::spawn(serve_stream(device, theirs, Clock::start(), watcher));
        ours.write_all(b"O\x01").await.unwrap();
        let mut answer = [0; 2];
        ours.read_exact(&mut answer).await.unwrap();
        assert_eq!(answer, [3, 67]);
        ours.write_all(b"V@").await.unwrap();
        let mut records = [0; 60];
        ours.read_exact(&mut records).await.unwrap();
        assert!(
            records.iter().enumerate().all(|(i, byte)| (byte & 0x80 != 0) == (i % 6 == 0)),
            "{records:?}"
        );
        drop(ours);
        task.await.unwrap().unwrap();
        assert!(*seen.lock().unwrap() >= 10);
    }
}
