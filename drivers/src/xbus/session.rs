//! The live session with an Xbus device: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, requests, the state of the link.
//! What it never does: wait, or believe that a device sends what it was asked for; data messages are read by
//! what the device itself has said about them.
//!
//! Life: `Closed -> SettingUp -> Streaming`; silence, a restart of the device, or data of another shape lead
//! back to SettingUp, failure to a pause and then there.

use std::time::Duration;

use posed_state::Plain;

use super::frame::{Found, Frame, Framer, PREAMBLE};
use super::message::{self, MASTER};
use super::settings::Settings;
use super::setup::{Progress, Setup};
use super::stream::{Outcome, Plan, Stream, Unit};
use crate::arrivals::Arrivals;
use crate::flock::SettingsError;
use crate::outbox::Outbox;
use crate::sample::Timestamp;
use crate::session::{Counters, LineEvent, Loss, Output, SensorInfo, Session, State};

/// Pauses between attempts: the first, and the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);
/// Shortest silence that counts as one, and periods that do.
const MIN_SILENCE_S: f64 = 0.3;
const SILENT_PERIODS: f64 = 20.0;
/// Refused data messages in a row after which the device is set up again.
const MOST_REFUSED: u32 = 10;

/// A live session with one device or one chain. Samples are in sensor axes; orientations are the device's own, sensor to a z-up
/// frame.
///
/// Messages have a checksum of one byte; on top of it angular velocity, specific force and field must be possible. Losses are
/// counted by the device's packet counter, over a new set-up by time.
#[derive(Clone, Debug, posed_state::State)]
pub struct XbusSession {
    #[state(keep)]
    settings: Settings,
    #[state(keep)]
    baud: u32,
    #[state(keep)]
    wanted: Vec<u16>,
    phase: Phase,
    framer: Framer,
    arrivals: Arrivals,
    outbox: Outbox,
    /// Bytes dropped in front of the session; the framer counts the others.
    dropped: u64,
    /// Of whole messages.
    refused_bytes: u64,
    sensors: Vec<SensorInfo>,
    /// All trackers that a scan has found, at the address of the first one.
    known: Vec<Unit>,
    losses: Vec<Loss>,
    /// When data last came, of this stream or an earlier one.
    last_data: Option<Timestamp>,
    rate_hz: Option<f64>,
    pause: Duration,
    /// The next failure to reach the device while it streams is answered by a reset.
    may_reset: bool,
}

#[derive(Clone, Debug, Plain)]
enum Phase {
    Closed,
    SettingUp { setup: Box<Setup>, bytes: u64 },
    Streaming { stream: Box<Stream>, silent_at: Timestamp, refused: u32 },
    Pausing { until: Timestamp },
}

impl XbusSession {
    /// A session for the trackers `wanted`, by bus address, in any order; a stand-alone device has address 1 (or 0).
    ///
    /// `baud` is the line rate, bit/s, to which the measurement rate is limited; 0 where the line has no such limit. Closed
    /// until the line opens.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names an address twice, 0 beside others, or one above 20.
    pub fn new(settings: Settings, baud: u32, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let mut addresses = wanted.to_vec();
        addresses.sort_unstable();
        addresses.dedup();
        let in_range = addresses == [0] || addresses.iter().all(|address| (1..=20).contains(address));
        if addresses.is_empty() || addresses.len() != wanted.len() || !in_range {
            return Err(SettingsError {
                key: "address",
                expected: "0 alone, or different numbers from 1 to 20",
            });
        }
        Ok(Self {
            settings,
            baud,
            wanted: addresses,
            phase: Phase::Closed,
            framer: Framer::default(),
            arrivals: Arrivals::default(),
            outbox: Outbox::new(),
            dropped: 0,
            refused_bytes: 0,
            sensors: Vec::new(),
            known: Vec::new(),
            losses: Vec::new(),
            last_data: None,
            rate_hz: None,
            pause: FIRST_PAUSE,
            may_reset: true,
        })
    }

    fn set_up(&mut self, now: Timestamp) {
        if !matches!(self.outbox.state(), State::Silent { .. } | State::Failed { .. }) {
            self.outbox.connecting("asking the device what it is");
        }
        let mut setup = Box::new(Setup::new(now, &self.settings, self.baud));
        self.transmit(&mut setup);
        self.phase = Phase::SettingUp { setup, bytes: 0 };
    }

    fn transmit(&mut self, setup: &mut Setup) {
        while let Some(request) = setup.poll_transmit() {
            self.outbox.transmit(request);
        }
    }

    /// Takes a message, and the byte behind it where that has come.
    fn message(&mut self, now: Timestamp, frame: Frame<'_>, found: Found, behind: Option<u8>) {
        match std::mem::replace(&mut self.phase, Phase::Closed) {
            Phase::SettingUp { mut setup, bytes } => {
                let progress = setup.handle(now, frame);
                self.on_progress(now, setup, bytes, progress);
            }
            Phase::Streaming { stream, silent_at, refused } => {
                self.stream_message(now, frame, (found, behind), (stream, silent_at, refused));
            }
            other => self.phase = other,
        }
    }

    fn on_progress(&mut self, now: Timestamp, mut setup: Box<Setup>, bytes: u64, progress: Progress) {
        for (kind, warning) in (100..).zip(setup.take_warnings()) {
            self.outbox.warn(now, kind, || warning);
        }
        self.transmit(&mut setup);
        match progress {
            Progress::Busy => self.phase = Phase::SettingUp { setup, bytes },
            Progress::Done(plan) => self.start(now, plan),
            Progress::Refused(reason) => {
                self.outbox.failed(reason);
                self.pause(now);
            }
            Progress::Unanswered => {
                if setup.received && std::mem::take(&mut self.may_reset) {
                    // Some devices pass over GotoConfig until they are reset.
                    self.outbox.transmit(message::request(MASTER, message::RESET, &[]));
                    return self.set_up(now);
                }
                self.may_reset = true;
                let baud = self.baud;
                if setup.received {
                    self.outbox.failed(
                        "the device sends, but does not answer; check the transmit wire, or switch it off and on",
                    );
                } else if bytes > 0 {
                    self.outbox.failed(format!(
                        "what arrives at {baud} baud is no Xbus message; try another baud rate (an Xbus Master has \
                         460800, an MTi 115200)"
                    ));
                } else {
                    self.outbox.silent(format!(
                        "nothing answers at {baud} baud; check power, cable and baud rate (an Xbus Master has 460800, \
                         an MTi 115200)"
                    ));
                }
                self.pause(now);
            }
        }
    }

    fn pause(&mut self, now: Timestamp) {
        self.phase = Phase::Pausing { until: now + self.pause };
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
    }

    fn start(&mut self, now: Timestamp, mut plan: Plan) {
        if self.wanted == [0]
            && let [unit] = plan.units.as_mut_slice()
        {
            unit.address = 0;
        }
        self.keep_addresses(&mut plan.units);
        for &address in &self.wanted {
            if !plan.units.iter().any(|unit| unit.address == address) {
                let there = plan.units.len();
                self.outbox.warn(now, 200 + u32::from(address), || {
                    format!("tracker {address} is not there; the device has {there}. Check its cable and the stage file")
                });
            }
        }
        let stream = Box::new(Stream::new(plan));
        self.rate_hz = Some(stream.rate_hz());
        self.sensors = stream.sensors().collect();
        let earlier = std::mem::take(&mut self.losses);
        self.losses = self
            .sensors
            .iter()
            .map(|sensor| {
                let known = earlier.iter().find(|loss| loss.address == sensor.address);
                known.copied().unwrap_or(Loss { address: sensor.address, ..Loss::default() })
            })
            .collect();
        let silent_at = now + silence(stream.rate_hz());
        self.phase = Phase::Streaming { stream, silent_at, refused: 0 };
    }

    /// A scan numbers what it finds along the chain. Without a tracker that died in its middle those behind it
    /// would be taken for one another, so each keeps the address that it had before.
    fn keep_addresses(&mut self, units: &mut [Unit]) {
        let known = |unit: &Unit| self.known.iter().find(|known| known.device_id == unit.device_id).copied();
        let mut taken: Vec<u16> = units.iter().filter_map(known).map(|known| known.address).collect();
        for unit in units.iter_mut() {
            let own = known(unit).map(|known| known.address);
            unit.address = own.unwrap_or_else(|| {
                let addresses = std::iter::once(unit.address).chain(1..);
                let free =
                    addresses.into_iter().find(|address| !taken.contains(address)).unwrap_or(unit.address);
                taken.push(free);
                free
            });
        }
        for unit in units.iter() {
            self.known.retain(|known| known.device_id != unit.device_id && known.address != unit.address);
            self.known.push(*unit);
        }
    }

    fn stream_message(
        &mut self,
        now: Timestamp,
        frame: Frame<'_>,
        (found, behind): (Found, Option<u8>),
        (mut stream, silent_at, refused): (Box<Stream>, Timestamp, u32),
    ) {
        let Some(arrival) = self.arrivals.of(found.offset) else { return };
        let Self { outbox, wanted, losses, .. } = self;
        let outcome = if behind.is_some_and(|byte| byte != PREAMBLE) {
            // A byte was lost or added in front of it, and the sum fits by chance: it ends within another message.
            Outcome::Refused
        } else {
            stream.handle(frame, arrival, losses, &mut |sample| {
                if wanted.contains(&sample.address) {
                    outbox.sample(sample);
                }
            })
        };
        self.phase =
            match outcome {
                Outcome::Data(samples) => {
                    let is_first = *outbox.state() != State::Streaming;
                    if let Some(last) = self.last_data.replace(now).filter(|_| is_first) {
                        // Counters start again with a new measurement: what was missed is estimated from time alone.
                        let missed = (now.seconds_since(last) * stream.rate_hz()).round() as u64;
                        for loss in losses {
                            loss.lost += missed.saturating_sub(1);
                            loss.estimated |= missed > 1;
                        }
                    }
                    outbox.counters.records += u64::from(samples.max(1));
                    outbox.streaming();
                    self.pause = FIRST_PAUSE;
                    self.may_reset = true;
                    let silent_at = now + silence(stream.rate_hz());
                    Phase::Streaming { stream, silent_at, refused: 0 }
                }
                Outcome::Refused => {
                    outbox.counters.rejected += 1;
                    self.refused_bytes += found.len as u64;
                    if refused + 1 < MOST_REFUSED {
                        Phase::Streaming { stream, silent_at, refused: refused + 1 }
                    } else {
                        outbox.warn(now, 1, || {
                            "the device sends something else than it was set to; setting it up again".into()
                        });
                        return self.set_up(now);
                    }
                }
                Outcome::Other => match frame.mid {
                    message::WAKE_UP => {
                        outbox.warn(now, 2, || "the device has restarted; check its power".into());
                        outbox.connecting("the device has restarted");
                        outbox.transmit(message::request(MASTER, message::WAKE_UP_ACK, &[]));
                        return self.set_up(now);
                    }
                    message::ERROR => {
                        let code = frame.data.first().copied().unwrap_or_default();
                        let words = message::error_words(code);
                        let tracker = frame.data.get(1).copied().unwrap_or_default();
                        outbox.warn(now, 0x1000 + 0x100 * u32::from(code) + u32::from(tracker), || {
                            match tracker {
                                0 => format!("the device reports error {code:#04x}: {words}"),
                                _ => format!(
                                    "the device reports error {code:#04x} of tracker {tracker}: {words}"
                                ),
                            }
                        });
                        Phase::Streaming { stream, silent_at, refused }
                    }
                    _ => Phase::Streaming { stream, silent_at, refused },
                },
            };
    }
}

fn silence(rate_hz: f64) -> Duration {
    Duration::from_secs_f64((SILENT_PERIODS / rate_hz).max(MIN_SILENCE_S))
}

impl Session for XbusSession {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { modem_lines } => {
                self.framer.interrupt();
                self.arrivals.reopen();
                self.pause = FIRST_PAUSE;
                self.outbox.connecting("the port is open");
                if *modem_lines {
                    // Without RTS an Xbus Master does not transmit.
                    self.outbox.set_rts(true);
                }
                self.set_up(now);
            }
            LineEvent::Closed { reason } => {
                self.framer.interrupt();
                self.phase = Phase::Closed;
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => {
                self.framer.interrupt();
                self.dropped += bytes;
            }
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        if let Phase::SettingUp { bytes: received, .. } = &mut self.phase {
            *received += bytes.len() as u64;
        }
        // The messages lie in the framer while the session changes.
        let mut framer = std::mem::take(&mut self.framer);
        framer.push(bytes);
        while let Some(found) = framer.find() {
            self.message(now, framer.frame(found), found, framer.behind(found));
        }
        self.framer = framer;
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return;
        }
        match std::mem::replace(&mut self.phase, Phase::Closed) {
            Phase::Closed => {}
            Phase::Pausing { .. } => self.set_up(now),
            Phase::SettingUp { mut setup, bytes } => {
                let progress = setup.handle_timeout(now);
                self.on_progress(now, setup, bytes, progress);
            }
            Phase::Streaming { .. } => {
                self.outbox.silent("no data any more; check the device's power and cable");
                self.set_up(now);
            }
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match &self.phase {
            Phase::Closed => None,
            Phase::SettingUp { setup, .. } => Some(setup.poll_timeout()),
            Phase::Streaming { silent_at, .. } => Some(*silent_at),
            Phase::Pausing { until } => Some(*until),
        }
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        Counters {
            bytes_skipped: self.dropped + self.refused_bytes + self.framer.bytes_skipped(),
            rejected: self.outbox.counters.rejected + self.framer.bad_checksums(),
            ..self.outbox.counters
        }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        self.rate_hz
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }
}
