//! All sessions there are, as one closed type: so that a pipeline is plain data.

use posed_drivers::Session;
use posed_drivers::fastrak::FastrakSession;
use posed_drivers::flock::{FlockSession, SettingsError};
use posed_drivers::motionstar::MotionStarSession;
use posed_drivers::open_imu::{Carrier, OpenImuSession};
use posed_drivers::polhemus::PolhemusSession;
use posed_drivers::slimevr::SlimeVrSession;
use posed_drivers::vrpn::VrpnSession;
use posed_drivers::witmotion::WitMotionSession;
use posed_drivers::x_imu3::XImu3Session;
use posed_drivers::xbus::XbusSession;
use posed_state::State;

use posed_stage::{Device, Driver, PortAddress};

/// The session of one device.
#[derive(Clone, Debug, State)]
pub(super) enum DeviceSession {
    Flock(#[state(inner)] Box<FlockSession>),
    MotionStar(#[state(inner)] Box<MotionStarSession>),
    Fastrak(#[state(inner)] Box<FastrakSession>),
    Polhemus(#[state(inner)] Box<PolhemusSession>),
    Xbus(#[state(inner)] Box<XbusSession>),
    XImu3(#[state(inner)] Box<XImu3Session>),
    SlimeVr(#[state(inner)] Box<SlimeVrSession>),
    Vrpn(#[state(inner)] Box<VrpnSession>),
    OpenImu(#[state(inner)] Box<OpenImuSession>),
    WitMotion(#[state(inner)] Box<WitMotionSession>),
}

impl DeviceSession {
    /// A session for a device of the stage file and the addresses of its sensors; others reach the daemon's websocket at the port `websocket`,
    /// or not at all (0).
    pub(super) fn new(device: &Device, wanted: &[u16], websocket: u16) -> Result<Self, SettingsError> {
        // Some drivers fit their output to the line; 0 is a line that does not limit it.
        let line_baud = device.driver.line_baud(&device.port, device.baud).unwrap_or(0);
        Ok(match &device.driver {
            Driver::FlockOfBirds(settings) => {
                Self::Flock(Box::new(FlockSession::new(settings.clone(), device.baud, wanted)?))
            }
            Driver::MotionStar(settings) => {
                Self::MotionStar(Box::new(MotionStarSession::new(settings.clone(), wanted)?))
            }
            Driver::Fastrak(settings) => {
                Self::Fastrak(Box::new(FastrakSession::new(settings.clone(), wanted)?))
            }
            Driver::Polhemus(settings) => {
                Self::Polhemus(Box::new(PolhemusSession::new(settings.clone(), line_baud, wanted)?))
            }
            Driver::Xbus(settings) => {
                Self::Xbus(Box::new(XbusSession::new(settings.clone(), line_baud, wanted)?))
            }
            Driver::XImu3(settings) => Self::XImu3(Box::new(XImu3Session::new(settings.clone(), wanted)?)),
            Driver::SlimeVr(settings) => {
                Self::SlimeVr(Box::new(SlimeVrSession::new(settings.clone(), wanted)?))
            }
            Driver::Vrpn(settings) => Self::Vrpn(Box::new(VrpnSession::new(settings.clone(), wanted)?)),
            Driver::OpenImu(settings) => {
                let carrier = match device.port.parse() {
                    Ok(PortAddress::Serial(_) | PortAddress::Tcp { .. } | PortAddress::Auto) => Carrier::Line,
                    Ok(PortAddress::Udp { port, .. }) => Carrier::Envelopes { port, websocket },
                    _ => Carrier::Envelopes { port: 0, websocket },
                };
                Self::OpenImu(Box::new(OpenImuSession::new(settings.clone(), carrier, wanted)?))
            }
            Driver::WitMotion(settings) => {
                Self::WitMotion(Box::new(WitMotionSession::new(settings.clone(), line_baud, wanted)?))
            }
        })
    }

    /// Whether the session counts what is lost of each sensor.
    pub(super) fn counts_losses(&self) -> bool {
        !matches!(self, Self::Flock(_) | Self::Vrpn(_))
    }

    pub(super) fn get(&self) -> &dyn Session {
        match self {
            Self::Flock(session) => session.as_ref(),
            Self::MotionStar(session) => session.as_ref(),
            Self::Fastrak(session) => session.as_ref(),
            Self::Polhemus(session) => session.as_ref(),
            Self::Xbus(session) => session.as_ref(),
            Self::XImu3(session) => session.as_ref(),
            Self::SlimeVr(session) => session.as_ref(),
            Self::Vrpn(session) => session.as_ref(),
            Self::OpenImu(session) => session.as_ref(),
            Self::WitMotion(session) => session.as_ref(),
        }
    }

    pub(super) fn get_mut(&mut self) -> &mut dyn Session {
        match self {
            Self::Flock(session) => session.as_mut(),
            Self::MotionStar(session) => session.as_mut(),
            Self::Fastrak(session) => session.as_mut(),
            Self::Polhemus(session) => session.as_mut(),
            Self::Xbus(session) => session.as_mut(),
            Self::XImu3(session) => session.as_mut(),
            Self::SlimeVr(session) => session.as_mut(),
            Self::Vrpn(session) => session.as_mut(),
            Self::OpenImu(session) => session.as_mut(),
            Self::WitMotion(session) => session.as_mut(),
        }
    }
}
