//! Finds devices by asking: the shell of IO and time around the drivers' probes.
//!
//! What comes in: ports to ask, or a driver whose device is looked for. What goes out: who answers, or the open port of
//! the device that was meant. It configures nothing. Ports are distinguished by who answers there, never by their names.

pub mod proposal;
pub mod survey;

use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use posed_drivers::datagram::datagrams;
use posed_drivers::flock::examine::Failure;
use posed_drivers::flock::wire::Addressing;
use posed_drivers::flock::{Family, Findings};
use posed_drivers::port::{self, Options, Port, PortError, Stream, Udp};
use posed_drivers::probe::{Identity, Inquiry, NoAnswer};
use posed_drivers::session::SensorInfo;
use posed_drivers::slimevr::hid::{Contents, packets};
use posed_drivers::x_imu3::probe::{ANNOUNCEMENTS, Announcement};
use posed_drivers::{
    Output, Timestamp, fastrak, flock, motionstar, open_imu, polhemus, vrpn, witmotion, x_imu3, xbus,
};
use tokio::net::UdpSocket;

use super::clock::StageClock;
use posed_stage::{Device, Driver};

/// How long to listen for announcements: x-IMU3 units announce themselves once a second.
pub const ANNOUNCED: Duration = Duration::from_millis(1300);
/// Longest that a port may take to open: an attempt that hangs, such as a host that does not answer, is given up after this.
pub(super) const OPEN_TIMEOUT: Duration = Duration::from_secs(5);

/// A kind of device that can be asked who it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Flock of Birds.
    Flock,
    /// Xsens device or chain.
    Xbus,
    /// x-IMU3.
    XImu3,
    /// Fastrak.
    Fastrak,
    /// Polhemus Liberty or Patriot.
    Polhemus,
    /// WitMotion sensor.
    WitMotion,
    /// MotionStar.
    MotionStar,
    /// VRPN server.
    Vrpn,
    /// Devices that speak the open format.
    OpenImu,
}

impl Kind {
    /// All that may be on a serial port, in the order in which a port is asked: a later question means nothing to
    /// the devices before it.
    pub const SERIAL: [Self; 7] =
        [Self::Flock, Self::Xbus, Self::XImu3, Self::Fastrak, Self::Polhemus, Self::WitMotion, Self::OpenImu];

    /// The driver's word in the stage file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Flock => "flock-of-birds",
            Self::Xbus => "xbus",
            Self::XImu3 => "x-imu3",
            Self::Fastrak => "fastrak",
            Self::Polhemus => "polhemus",
            Self::WitMotion => "witmotion",
            Self::MotionStar => "motionstar",
            Self::Vrpn => "vrpn",
            Self::OpenImu => "open-imu",
        }
    }

    /// Line rates at which it may be, bit/s, the likeliest first; none for a MotionStar and a VRPN server, which are on a network.
    pub fn bauds(self) -> &'static [u32] {
        match self {
            Self::Flock => &flock::probe::BAUD_RATES,
            Self::Xbus => &xbus::probe::BAUD_RATES,
            Self::XImu3 => &x_imu3::probe::BAUD_RATES,
            Self::Fastrak => &fastrak::probe::BAUD_RATES,
            Self::OpenImu => &open_imu::probe::BAUD_RATES,
            Self::Polhemus => &polhemus::probe::BAUD_RATES,
            Self::WitMotion => &witmotion::probe::BAUD_RATES,
            Self::MotionStar | Self::Vrpn => &[],
        }
    }

    /// The kind of a driver's devices; `None` for SlimeVR, whose trackers come by themselves.
    pub fn of(driver: &Driver) -> Option<Self> {
        match driver {
            Driver::FlockOfBirds(_) => Some(Self::Flock),
            Driver::Xbus(_) => Some(Self::Xbus),
            Driver::XImu3(_) => Some(Self::XImu3),
            Driver::Fastrak(_) => Some(Self::Fastrak),
            Driver::Polhemus(_) => Some(Self::Polhemus),
            Driver::WitMotion(_) => Some(Self::WitMotion),
            Driver::MotionStar(_) => Some(Self::MotionStar),
            Driver::Vrpn(_) => Some(Self::Vrpn),
            Driver::OpenImu(_) => Some(Self::OpenImu),
            Driver::SlimeVr(_) => None,
        }
    }
}

/// Who answers at a port.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// What it reports about itself.
    pub identity: Identity,
    /// How units on a Flock's bus are numbered; absent for all other kinds.
    pub addressing: Option<Addressing>,
    /// Which of Ascension's units a Flock is; absent for all other kinds.
    pub family: Option<Family>,
}

/// Asks an open port for one kind of device; `reset` lets a Flock out of its reset first, where the port has an RTS line.
///
/// The inner result is the answer, or why there is none: nothing came, or nothing that such a device says. It ends by time-outs
/// of its own.
///
/// # Errors
/// The port is gone.
pub async fn ask(line: &mut Port<Stream>, kind: Kind, reset: bool) -> io::Result<Result<Answer, Failure>> {
    let clock = StageClock::start();
    let mut probe = Probe::new(kind, clock.now(), reset && line.modem_lines());
    let mut buffer = [0; 1024];
    loop {
        while let Some(output) = probe.poll_output() {
            match output {
                Output::Transmit(bytes) => line.write_all(&bytes).await?,
                Output::SetRts(asserted) => line.set_rts(asserted)?,
                Output::Sample(_)
                | Output::StateChanged
                | Output::HeadingReset { .. }
                | Output::Pressed { .. }
                | Output::Warning(_) => {}
            }
        }
        if let Some(result) = probe.result() {
            return Ok(result);
        }
        let deadline = clock.instant(probe.poll_timeout().unwrap_or(clock.now()));
        match tokio::time::timeout_at(deadline.into(), line.read(&mut buffer)).await {
            Ok(read) => probe.handle_bytes(clock.now(), &buffer[..read?]),
            Err(_) => probe.handle_timeout(clock.now()),
        }
    }
}

/// The drivers' probes behind one face.
enum Probe {
    Flock(Box<flock::Probe>),
    Other(Box<Inquiry>),
}

impl Probe {
    fn new(kind: Kind, now: Timestamp, reset: bool) -> Self {
        let inquiry = match kind {
            Kind::Flock => return Self::Flock(Box::new(flock::Probe::new(now, reset))),
            Kind::Xbus => xbus::probe::inquiry(now),
            Kind::XImu3 => x_imu3::probe::inquiry(now),
            Kind::Fastrak => fastrak::probe::inquiry(now),
            Kind::Polhemus => polhemus::probe::inquiry(now),
            Kind::WitMotion => witmotion::probe::inquiry(now),
            Kind::MotionStar => motionstar::probe::inquiry(now),
            Kind::Vrpn => vrpn::probe::inquiry(now),
            Kind::OpenImu => open_imu::probe::inquiry(now),
        };
        Self::Other(Box::new(inquiry))
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        match self {
            Self::Flock(probe) => probe.handle_bytes(now, bytes),
            Self::Other(inquiry) => inquiry.handle_bytes(now, bytes),
        }
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        match self {
            Self::Flock(probe) => probe.handle_timeout(now),
            Self::Other(inquiry) => inquiry.handle_timeout(now),
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        match self {
            Self::Flock(probe) => probe.poll_output(),
            Self::Other(inquiry) => inquiry.poll_transmit().map(Output::Transmit),
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match self {
            Self::Flock(probe) => probe.poll_timeout(),
            Self::Other(inquiry) => inquiry.poll_timeout(),
        }
    }

    fn result(&self) -> Option<Result<Answer, Failure>> {
        match self {
            Self::Flock(probe) => probe.result().map(|result| result.map(of_flock)),
            Self::Other(inquiry) => inquiry.result().map(|result| match result {
                Ok(identity) => Ok(Answer { identity: identity.clone(), addressing: None, family: None }),
                Err(NoAnswer::Silent) => Err(Failure::Silent),
                Err(NoAnswer::Unintelligible) => Err(Failure::Unintelligible),
            }),
        }
    }
}

fn of_flock(findings: &Findings) -> Answer {
    let (whole, fraction) = findings.revision;
    let sensors: Vec<SensorInfo> = findings
        .sensors()
        .into_iter()
        .map(|address| SensorInfo { address: address.into(), serial: None })
        .collect();
    let problem = sensors.is_empty().then(|| {
        (
            "the units answer, but none of them has a sensor".to_owned(),
            "plug in the sensors, set the FLY switch (8) of each unit, and switch them off and on".to_owned(),
        )
    });
    Answer {
        identity: Identity {
            model: (!findings.model.is_empty()).then(|| findings.model.clone()),
            revision: Some(format!("{whole}.{fraction:02}")),
            rate_hz: Some(findings.rate_hz),
            sensors,
            problem,
        },
        addressing: Some(findings.addressing),
        family: Some(findings.family),
    }
}

/// How the port of a device is opened: its line rate, and on UDP whether this computer is the server (SlimeVR) or a peer.
pub fn options(device: &Device) -> Options {
    let udp = match device.driver {
        Driver::SlimeVr(_) | Driver::OpenImu(_) => Udp::Server,
        _ => Udp::Peer { local_port: device.local_port },
    };
    Options { baud: device.baud, udp }
}

/// Why the port of a device was not found.
#[derive(Debug, thiserror::Error)]
pub enum NotFound {
    /// The port at which it is does not open.
    #[error(transparent)]
    Port(#[from] PortError),
    /// No device of this kind answers.
    #[error("no port answers as {word} at {baud} baud; `posed doctor` shows what is there")]
    Nobody {
        /// [`Kind::word`].
        word: &'static str,
        /// Line rate at which ports were asked, bit/s.
        baud: u32,
    },
    /// One answers that is not meant.
    #[error(
        "one {word} answers, but not with the serial number of the stage file; `posed doctor` shows its own"
    )]
    Another {
        /// [`Kind::word`].
        word: &'static str,
    },
    /// Several answer, none of which is meant.
    #[error(
        "{count} devices answer as {word}, none with the serial number of the stage file; `posed doctor` shows theirs"
    )]
    Others {
        /// [`Kind::word`].
        word: &'static str,
        /// How many.
        count: usize,
    },
}

/// Looks for a device on all serial ports but `taken`, and by its announcement where it makes one.
///
/// `serials` are the units that are meant; without any, the first device that answers is. Serial ports are asked at the device's
/// own line rate. Gives the name of the port and the open port. For SlimeVR, whose trackers come by themselves, it asks nobody:
/// it opens a receiver on USB where one is plugged in, else `udp://0.0.0.0:6969`.
///
/// # Errors
/// [`NotFound`]: no device answers, none with such a serial number, or the port that was found does not open.
pub async fn search(
    device: &Device,
    serials: &[String],
    taken: &[String],
) -> Result<(String, Port<Stream>), NotFound> {
    let Some(kind) = Kind::of(&device.driver) else {
        if let Some(name) = port::receivers().into_iter().find(|name| !taken.contains(name)) {
            let opened = port::open(&name, options(device)).await?;
            return Ok((name, opened));
        }
        let all = "udp://0.0.0.0:6969";
        let opened = port::open(all, options(device)).await?;
        return Ok((all.to_owned(), opened));
    };
    let mut others = 0;
    for name in port::list().into_iter().filter(|name| !taken.contains(name)) {
        let opened = tokio::time::timeout(OPEN_TIMEOUT, port::open(&name, options(device))).await;
        let Ok(Ok(mut line)) = opened else { continue };
        let Ok(Ok(answer)) = ask(&mut line, kind, true).await else { continue };
        let family =
            if let Driver::FlockOfBirds(settings) = &device.driver { Some(settings.family) } else { None };
        if answer.family == family && is_meant(&answer.identity, serials) {
            return Ok((name, line));
        }
        others += 1;
    }
    if kind == Kind::XImu3 {
        let announced = announcements(ANNOUNCED).await.unwrap_or_default();
        for unit in &announced {
            if serials.is_empty() || serials.contains(&unit.serial) {
                let name = unit.port();
                let local_port = device.local_port.or(Some(unit.sends_to).filter(|port| *port > 0));
                let options = Options { baud: device.baud, udp: Udp::Peer { local_port } };
                let opened = port::open(&name, options).await?;
                return Ok((name, opened));
            }
        }
        others += announced.len();
    }
    let word = kind.word();
    Err(match others {
        0 => NotFound::Nobody { word, baud: device.baud },
        1 => NotFound::Another { word },
        count => NotFound::Others { word, count },
    })
}

fn is_meant(identity: &Identity, serials: &[String]) -> bool {
    let reported =
        |serial: &String| identity.sensors.iter().any(|sensor| sensor.serial.as_ref() == Some(serial));
    serials.is_empty() || serials.iter().any(reported)
}

/// The x-IMU3 units that announce themselves within `time`, each once, in the order of their coming. Takes the whole `time`.
///
/// # Errors
/// The port of the announcements cannot be listened to.
pub async fn announcements(time: Duration) -> io::Result<Vec<Announcement>> {
    let socket = port::shared_udp((Ipv4Addr::UNSPECIFIED, ANNOUNCEMENTS).into())?;
    let mut found: Vec<Announcement> = Vec::new();
    collect(&socket, time, &mut |datagram, _| {
        if let Some(unit) = Announcement::parse(datagram)
            && found.iter().all(|known| known.serial != unit.serial)
        {
            found.push(unit);
        }
    })
    .await;
    Ok(found)
}

/// Hands on all datagrams that arrive within `time`, with where they come from.
async fn collect(socket: &UdpSocket, time: Duration, each: &mut impl FnMut(&[u8], SocketAddr)) {
    let mut buffer = [0; 1500];
    let clock = StageClock::start();
    let end = clock.instant(clock.now() + time);
    while let Ok(received) = tokio::time::timeout_at(end.into(), socket.recv_from(&mut buffer)).await {
        // A datagram that cannot be received is none.
        if let Ok((n, peer)) = received {
            each(&buffer[..n], peer);
        }
    }
}

/// Devices that speak the open format and send to a port of this computer within `time`, by port; ports at which nobody sends are left out.
/// Whoever looks for a server is answered, so that devices which wait for one begin to send. Takes the whole `time`.
pub async fn open_imus(time: Duration) -> Vec<(u16, open_imu::probe::Heard)> {
    let [osc, csv] = open_imu::probe::PORTS;
    let (first, second) = tokio::join!(open_imus_at(osc, time), open_imus_at(csv, time));
    [(osc, first), (csv, second)].into_iter().filter_map(|(port, heard)| Some((port, heard?))).collect()
}

/// The same at one port. Where it is taken, a daemon serves them already.
async fn open_imus_at(port: u16, time: Duration) -> Option<open_imu::probe::Heard> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).await.ok()?;
    let mut heard = open_imu::probe::Heard::default();
    collect(&socket, time, &mut |datagram, peer| {
        if open_imu::wire::Kind::of(datagram) == open_imu::wire::Kind::Discovery {
            let answer = open_imu::wire::discovered("posed", 0, port, port);
            // Who does not get it asks again.
            let _ = socket.try_send_to(&answer, peer);
        }
        heard.datagram(datagram);
    })
    .await;
    heard.identity().is_some().then_some(heard)
}

/// Network addresses of the trackers that a receiver on USB knows, switched on or not, each once, in the order of their numbers. Takes the
/// whole `time`.
///
/// # Errors
/// The receiver does not open, or is gone.
pub async fn radio_trackers(port: &str, time: Duration) -> Result<Vec<String>, PortError> {
    let mut line = port::open(port, Options::baud(115_200)).await?;
    let mut found: BTreeMap<u8, [u8; 6]> = BTreeMap::new();
    let mut buffer = [0; 1024];
    let clock = StageClock::start();
    let end = clock.instant(clock.now() + time);
    while let Ok(read) = tokio::time::timeout_at(end.into(), line.read(&mut buffer)).await {
        let gone = |error: io::Error| PortError::Other { port: port.to_owned(), reason: error.to_string() };
        let chunk = &buffer[..read.map_err(gone)?];
        for packet in
            datagrams(chunk).flatten().filter_map(|datagram| packets(datagram.data)).flatten().flatten()
        {
            if let Contents::Registration(mac) = packet.contents {
                found.insert(packet.id, mac);
            }
        }
    }
    Ok(found.into_values().map(written).collect())
}

/// A network address as the stage file has it.
fn written(mac: [u8; 6]) -> String {
    mac.map(|byte| format!("{byte:02X}")).join(":")
}

/// Network addresses of the SlimeVR trackers that look for a server within `time`, like `A4:CF:12:D4:E5:F6`, each once, in the
/// order of their coming. Takes the whole `time`.
///
/// # Errors
/// Their port cannot be listened to: a server is running.
pub async fn slimevr_trackers(time: Duration) -> io::Result<Vec<String>> {
    let socket = UdpSocket::bind("0.0.0.0:6969").await?;
    let mut found: Vec<String> = Vec::new();
    collect(&socket, time, &mut |datagram, _| {
        let Some(packet) = posed_drivers::slimevr::wire::parse(datagram) else { return };
        packet.items(|item| {
            if let Ok(posed_drivers::slimevr::wire::Item::Handshake(handshake)) = item
                && let Some(mac) = handshake.mac
            {
                let text = written(mac);
                if !found.contains(&text) {
                    found.push(text);
                }
            }
        });
    })
    .await;
    Ok(found)
}
