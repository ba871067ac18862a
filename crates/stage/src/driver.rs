//! The drivers by name, and what the stage and the pipeline must know of each.

use posed_drivers::fastrak::{self, FastrakSession};
use posed_drivers::flock::{self, FlockSession, SettingsError};
use posed_drivers::motionstar::{self, MotionStarSession};
use posed_drivers::open_imu::{self, Carrier, OpenImuSession};
use posed_drivers::polhemus::{self, PolhemusSession};
use posed_drivers::slimevr::{self, SlimeVrSession};
use posed_drivers::vrpn::{self, VrpnSession};
use posed_drivers::witmotion::{self, WitMotionSession};
use posed_drivers::x_imu3::{self, XImu3Session};
use posed_drivers::xbus::{self, XbusSession};
use posed_fusion::noise::TrackerNoise;
use serde::{Deserialize, Serialize};

use super::PortAddress;

/// A driver by name, with its settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "driver", rename_all = "kebab-case")]
pub enum Driver {
    /// Ascension Flock of Birds.
    FlockOfBirds(flock::Settings),
    /// Ascension MotionStar.
    #[serde(rename = "motionstar")]
    MotionStar(motionstar::Settings),
    /// Polhemus Fastrak.
    Fastrak(fastrak::Settings),
    /// Polhemus Liberty or Patriot.
    Polhemus(polhemus::Settings),
    /// Xsens MTi, or a chain behind an Xbus Master.
    Xbus(xbus::Settings),
    /// x-io x-IMU3, alone or a chain.
    #[serde(rename = "x-imu3")]
    XImu3(x_imu3::Settings),
    /// SlimeVR trackers.
    #[serde(rename = "slimevr")]
    SlimeVr(slimevr::Settings),
    /// Trackers behind a VRPN server.
    Vrpn(vrpn::Settings),
    /// Devices that speak the open format: boards that people build, and phones.
    OpenImu(open_imu::Settings),
    /// WitMotion sensor with a serial line.
    #[serde(rename = "witmotion")]
    WitMotion(witmotion::Settings),
}

/// Noise that is the same at any distance: what is left of the law is a word's step, less than any tracker has, and the filter raises
/// it from its innovations.
const UNIFORM: TrackerNoise = TrackerNoise { r0_m: 1.0, sigma_radial_m: 0.0, sigma_rotation_rad: 0.0 };

/// What times the samples of a device ([`Driver::time_base`]). Samples of equal values share a clock within their device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeBase {
    /// One clock for all sensors: they measure in common cycles.
    Device,
    /// A clock in each unit, by its address; or units that one clock has measure one after the other.
    Unit(u16),
    /// None: samples come when there is something new. The number is the tracker whose packets they come in: the low byte of
    /// the address.
    OnChange(u16),
    /// A clock in each unit, by its address, behind a radio: what it sends comes late by tens of milliseconds, now more, now less.
    Radio(u16),
}

impl Driver {
    /// The driver's word in the stage file, as the key `driver` has it.
    pub fn word(&self) -> &'static str {
        match self {
            Self::FlockOfBirds(_) => "flock-of-birds",
            Self::MotionStar(_) => "motionstar",
            Self::Fastrak(_) => "fastrak",
            Self::Polhemus(_) => "polhemus",
            Self::Xbus(_) => "xbus",
            Self::XImu3(_) => "x-imu3",
            Self::SlimeVr(_) => "slimevr",
            Self::Vrpn(_) => "vrpn",
            Self::OpenImu(_) => "open-imu",
            Self::WitMotion(_) => "witmotion",
        }
    }

    /// Whether the sensors are body-worn IMUs: they measure an orientation and no position.
    pub fn is_inertial(&self) -> bool {
        matches!(
            self,
            Self::Xbus(_) | Self::XImu3(_) | Self::SlimeVr(_) | Self::OpenImu(_) | Self::WitMotion(_)
        )
    }

    /// Whether the sensors of an inertial driver send the magnetic field; false for magnetic trackers.
    pub fn measures_field(&self) -> bool {
        matches!(self, Self::Xbus(_) | Self::XImu3(_) | Self::OpenImu(_))
    }

    /// Noise of the poses that the device measures, until something is learnt of it: that of a magnetic tracker grows with the distance
    /// from its transmitter. IMUs have none.
    pub fn pose_noise(&self) -> TrackerNoise {
        match self {
            Self::Vrpn(_) => UNIFORM,
            _ => TrackerNoise::default(),
        }
    }

    /// Which clock times the sensor at `address` on the device; equal values share one.
    pub fn time_base(&self, address: u16) -> TimeBase {
        match self {
            // A VRPN server stamps each sensor for itself, as its own device has it.
            Self::XImu3(_) | Self::Fastrak(_) | Self::Vrpn(_) => TimeBase::Unit(address),
            // The sensors of a tracker share its address's low byte, and its packets.
            Self::SlimeVr(_) => TimeBase::OnChange(address & 0xFF),
            // The sensors of a device have its clock, and times of their own on it.
            Self::OpenImu(_) => TimeBase::Radio(address),
            _ => TimeBase::Device,
        }
    }

    /// How much earlier than it is sent a record is true by the device's own doing, s, at least 0: half of what it
    /// averages over. `measurement_delay_ms` of the stage file comes on top.
    pub fn delay_s(&self) -> f64 {
        match self {
            Self::XImu3(settings) => settings.averaging_s(),
            Self::Xbus(settings) => settings.averaging_s(),
            _ => 0.0,
        }
    }

    /// Rate of the line that limits the device, bit/s: `baud`, or `None` where bytes cost no time that is known. `port` and
    /// `baud` are those of the stage file; a `port` that is no address counts as a line.
    pub fn line_baud(&self, port: &str, baud: u32) -> Option<u32> {
        let limited = match port.parse::<PortAddress>() {
            Ok(PortAddress::Udp { .. } | PortAddress::Websocket | PortAddress::Usb) => false,
            Ok(port) if port.is_receiver() => false,
            // A serial server has a line behind it; units with a socket of their own have none.
            Ok(PortAddress::Tcp { .. }) => {
                !matches!(self, Self::MotionStar(_) | Self::XImu3(_) | Self::Vrpn(_))
            }
            _ => true,
        };
        limited.then_some(baud)
    }

    /// Whether the device can be at such a port. Nobody looks whether it is.
    ///
    /// # Errors
    /// What to write instead, as part of a sentence.
    pub fn check_port(&self, port: &PortAddress) -> Result<(), &'static str> {
        let (fits, instead) = match (self, port) {
            (Self::SlimeVr(_), port) => (
                matches!(port, PortAddress::Udp { .. } | PortAddress::Auto) || port.is_receiver(),
                "udp://0.0.0.0:6969, the address of this computer that trackers send to, or /dev/hidrawN of a receiver",
            ),
            (Self::MotionStar(_), port) => (
                matches!(port, PortAddress::Tcp { .. } | PortAddress::Udp { .. }),
                "tcp://HOST:6000 or udp://HOST:5000",
            ),
            (Self::OpenImu(_), port) => (
                *port != PortAddress::Usb && !port.is_receiver(),
                "websocket, udp://HOST:PORT, the path of a serial port, tcp://HOST:PORT, or auto",
            ),
            (Self::Vrpn(_), port) => (matches!(port, PortAddress::Tcp { .. }), "tcp://HOST:3883"),
            (Self::XImu3(_), port) => (
                !matches!(port, PortAddress::Websocket | PortAddress::Usb) && !port.is_receiver(),
                "the path of a serial port, tcp://HOST:PORT, udp://HOST:PORT, or auto",
            ),
            (Self::Polhemus(_), port) => (
                !matches!(port, PortAddress::Udp { .. } | PortAddress::Websocket) && !port.is_receiver(),
                "the path of a serial port, usb://0f44:ff20 of a Liberty or usb://0f44:ef20 of a Patriot, tcp://HOST:PORT of a serial server, or auto",
            ),
            (_, port) => (
                !matches!(port, PortAddress::Udp { .. } | PortAddress::Websocket | PortAddress::Usb)
                    && !port.is_receiver(),
                "the path of a serial port, tcp://HOST:PORT of a serial server, or auto",
            ),
        };
        if fits { Ok(()) } else { Err(instead) }
    }

    /// Whether a session with these settings can be made for the sensors at the addresses `wanted`. The line rate is no part of
    /// the check: 115200 bit/s are taken.
    ///
    /// # Errors
    /// The first key that cannot be so, and what it must be: a setting out of its range, or `address` where the addresses cannot
    /// be on one device, which has one at least.
    pub fn check(&self, wanted: &[u16]) -> Result<(), SettingsError> {
        const BAUD: u32 = 115_200;
        match self {
            Self::FlockOfBirds(settings) => FlockSession::new(settings.clone(), BAUD, wanted).map(drop),
            Self::MotionStar(settings) => MotionStarSession::new(settings.clone(), wanted).map(drop),
            Self::Fastrak(settings) => FastrakSession::new(settings.clone(), wanted).map(drop),
            Self::Polhemus(settings) => PolhemusSession::new(settings.clone(), BAUD, wanted).map(drop),
            Self::Xbus(settings) => XbusSession::new(settings.clone(), BAUD, wanted).map(drop),
            Self::XImu3(settings) => XImu3Session::new(settings.clone(), wanted).map(drop),
            Self::SlimeVr(settings) => SlimeVrSession::new(settings.clone(), wanted).map(drop),
            Self::Vrpn(settings) => VrpnSession::new(settings.clone(), wanted).map(drop),
            Self::OpenImu(settings) => OpenImuSession::new(settings.clone(), Carrier::Line, wanted).map(drop),
            Self::WitMotion(settings) => WitMotionSession::new(settings.clone(), BAUD, wanted).map(drop),
        }
    }
}
