//! A session of a device that is prepared, asked once, and then sends: all of it but what is the protocol's own.
//!
//! A driver gives a [`Protocol`]: a grammar that cuts its messages, its commands, and what a message means. Here are opening and closing, pauses,
//! repeated questions, a reset, silence, the bytes of no message, arrivals, state and counters.

use posed_state::{Plain, State as Stored};

use crate::arrivals::Arrivals;
use crate::cut::{Cutter, Grammar};
use crate::flock::SettingsError;
use crate::link::{Due, Link, Timing};
use crate::outbox::Outbox;
use crate::sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
use crate::session::{Counters, LineEvent, Loss, Output, SensorInfo, Session, State};

/// Why nothing comes, in words for the operator.
#[derive(Clone, Copy, Debug)]
pub struct Words {
    /// The line has opened.
    pub opened: &'static str,
    /// All questions have gone unanswered; what to check.
    pub no_answer: &'static str,
    /// The stream has ended; what to check.
    pub silent: &'static str,
}

/// What is of one protocol alone.
pub trait Protocol: Stored {
    /// Its messages.
    type Grammar: Grammar + Plain;
    /// Its pauses.
    const TIMING: Timing;
    /// Its words.
    const WORDS: Words;

    /// The line has opened: it may be another device.
    fn opened(&mut self) {}

    /// Sends this piece of what comes before the question, from 0.
    fn prepare(&mut self, step: u8, line: &mut Line);

    /// Asks; [`Line::started`] says that the answer has come.
    fn ask(&mut self, line: &mut Line);

    /// No question was answered: resets the device. True where it need not be answered, and the stream has been [`Line::started`].
    fn unanswered(&mut self, _now: Timestamp, _line: &mut Line) -> bool {
        false
    }

    /// Takes a message.
    fn take(&mut self, now: Timestamp, message: <Self::Grammar as Grammar>::Message, line: &mut Line);

    /// As [`Session::rate_hz`].
    fn rate_hz(&self) -> Option<f64>;

    /// As [`Session::losses`].
    fn losses(&self) -> &[Loss];
}

/// What a protocol acts on.
#[derive(Clone, Debug, Stored)]
pub struct Line {
    #[state(keep)]
    timing: Timing,
    link: Link,
    arrivals: Arrivals,
    outbox: Outbox,
    /// Bytes dropped in front of the session, and those of refused messages.
    dropped: u64,
    /// Bytes of no message, as the cutter counts them.
    cut_out: u64,
    /// What is pending at the cutter is to be given up.
    is_cut_off: bool,
    sensors: Vec<SensorInfo>,
}

impl Line {
    /// Sends bytes.
    pub(crate) fn transmit(&mut self, bytes: impl Into<Vec<u8>>) {
        self.outbox.transmit(bytes.into());
    }

    /// Warns, unless a warning of the same `kind` went out within the last ten seconds.
    pub(crate) fn warn(&mut self, now: Timestamp, kind: u32, sentence: impl FnOnce() -> String) {
        self.outbox.warn(now, kind, sentence);
    }

    /// What has come so far is no part of what comes next.
    pub(crate) fn cut_off(&mut self) {
        self.is_cut_off = true;
    }

    /// Whether the question waits for its answer.
    pub(crate) fn is_asking(&self) -> bool {
        self.link.is_asking()
    }

    /// Whether a stream is expected.
    pub(crate) fn is_streaming(&self) -> bool {
        self.link.is_streaming()
    }

    /// The question was answered: a stream is expected from now on.
    pub(crate) fn started(&mut self, now: Timestamp) {
        self.link.started(now, &self.timing);
    }

    /// A message of the stream has come, good or not.
    pub(crate) fn heard(&mut self, now: Timestamp) {
        self.link.heard(now, &self.timing);
    }

    /// A message of `len` bytes is refused for its contents.
    pub(crate) fn refuse(&mut self, len: usize) {
        self.outbox.counters.rejected += 1;
        self.dropped += len as u64;
    }

    /// Bytes of no message up to here.
    pub(crate) fn skipped(&self) -> u64 {
        self.dropped + self.cut_out
    }

    /// Counts a record that gives no sample.
    pub(crate) fn accept(&mut self) {
        self.outbox.counters.records += 1;
        self.outbox.streaming();
    }

    /// Counts a record that began at `offset` of the stream, and gives its sample.
    pub(crate) fn publish(
        &mut self,
        offset: u64,
        address: u16,
        RecordTime { t_device, cycle_bytes_before, after_loss }: RecordTime,
        measurement: Measurement,
    ) {
        self.accept();
        let Some(arrival) = self.arrivals.of(offset) else { return };
        let arrival = Arrival { cycle_bytes_before, after_loss, ..arrival };
        self.outbox.sample(Sample { address, arrival, t_device, measurement });
    }
}

/// What a record says of its time, and what its session knows of its place; see [`Arrival`].
pub(crate) struct RecordTime {
    pub(crate) t_device: DeviceTime,
    pub(crate) cycle_bytes_before: u32,
    pub(crate) after_loss: bool,
}

/// See the module.
#[derive(Clone, Debug, Stored)]
pub struct SerialSession<P: Protocol> {
    protocol: P,
    line: Line,
    cutter: Cutter<P::Grammar>,
}

/// Stations that are asked for, in the order of their numbers: at least one, each once, from 1 to `most`.
///
/// # Errors
/// They are others; `expected` says which they may be.
pub(crate) fn stations(wanted: &[u16], most: u8, expected: &'static str) -> Result<Vec<u8>, SettingsError> {
    let bad = SettingsError { key: "address", expected };
    let mut stations: Vec<u8> =
        wanted.iter().map(|&station| u8::try_from(station).map_err(|_| bad)).collect::<Result<_, _>>()?;
    stations.sort_unstable();
    stations.dedup();
    let in_range = stations.iter().all(|station| (1..=most).contains(station));
    if stations.is_empty() || stations.len() != wanted.len() || !in_range {
        return Err(bad);
    }
    Ok(stations)
}

impl<P: Protocol> SerialSession<P> {
    /// A session before its line opens, with sensors at these addresses.
    pub(crate) fn of(protocol: P, grammar: P::Grammar, addresses: impl Iterator<Item = u16>) -> Self {
        Self {
            protocol,
            line: Line {
                timing: P::TIMING,
                link: Link::new(),
                arrivals: Arrivals::default(),
                outbox: Outbox::new(),
                dropped: 0,
                cut_out: 0,
                is_cut_off: false,
                sensors: addresses.map(|address| SensorInfo { address, serial: None }).collect(),
            },
            cutter: Cutter::of(grammar),
        }
    }

    fn settle(&mut self) {
        if std::mem::take(&mut self.line.is_cut_off) {
            self.cutter.interrupt();
        }
        self.line.cut_out = self.cutter.bytes_skipped();
    }
}

impl<P: Protocol> Session for SerialSession<P> {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        self.cutter.interrupt();
        match event {
            LineEvent::Opened { .. } => {
                self.line.arrivals.reopen();
                self.line.outbox.connecting(P::WORDS.opened);
                self.line.link.open(now, &P::TIMING);
                self.protocol.opened();
                self.protocol.prepare(0, &mut self.line);
            }
            LineEvent::Closed { reason } => {
                self.line.link.close();
                self.line.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => self.line.dropped += bytes,
        }
        self.settle();
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.line.arrivals.read(now, bytes.len());
        self.cutter.push(bytes);
        while let Some(message) = self.cutter.find() {
            self.line.cut_out = self.cutter.bytes_skipped();
            self.protocol.take(now, message, &mut self.line);
            self.settle();
        }
        self.settle();
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        match self.line.link.handle_timeout(now, &P::TIMING) {
            Due::Nothing => {}
            Due::Prepare(step) => self.protocol.prepare(step, &mut self.line),
            Due::Ask => self.protocol.ask(&mut self.line),
            Due::Reset => {
                if !self.protocol.unanswered(now, &mut self.line) {
                    self.line.outbox.silent(P::WORDS.no_answer);
                    self.protocol.prepare(0, &mut self.line);
                }
            }
            Due::Silent => {
                self.line.outbox.silent(P::WORDS.silent);
                self.protocol.prepare(0, &mut self.line);
            }
        }
        self.settle();
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.line.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        self.line.link.poll_timeout()
    }

    fn state(&self) -> &State {
        self.line.outbox.state()
    }

    fn counters(&self) -> Counters {
        let counters = self.line.outbox.counters;
        Counters {
            rejected: counters.rejected + self.cutter.rejected(),
            bytes_skipped: self.line.dropped + self.cutter.bytes_skipped(),
            ..counters
        }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.line.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        self.protocol.rate_hz()
    }

    fn losses(&self) -> &[Loss] {
        self.protocol.losses()
    }
}
